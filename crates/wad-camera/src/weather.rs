//! CARLA's 14 kinds of weather and what they do to light, air and ground.
//!
//! The numbers that name the weather (clouds, rain, wetness, the sun's place) are CARLA's presets';
//! colours and strengths of light are ours, on a scale where sunlit white at noon is about 1.

use super::error::CameraError;
use super::model::Rgb;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// A kind of weather by CARLA's name.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Preset {
    /// High sun, few clouds, dry.
    #[default]
    ClearNoon,
    /// High sun behind clouds, dry.
    CloudyNoon,
    /// High sun, wet road.
    WetNoon,
    /// High sun behind clouds, wet road.
    WetCloudyNoon,
    /// Light rain by day.
    SoftRainNoon,
    /// Rain by day.
    MidRainyNoon,
    /// A downpour by day.
    HardRainNoon,
    /// Low sun, few clouds, dry.
    ClearSunset,
    /// Low sun, cloudy, dry.
    CloudySunset,
    /// Low sun, wet road.
    WetSunset,
    /// Low sun, cloudy, wet road.
    WetCloudySunset,
    /// Light rain at sunset.
    SoftRainSunset,
    /// Rain at sunset.
    MidRainSunset,
    /// A downpour at sunset.
    HardRainSunset,
}

impl Preset {
    /// All of them, noon first.
    pub const ALL: [Self; 14] = [
        Self::ClearNoon,
        Self::CloudyNoon,
        Self::WetNoon,
        Self::WetCloudyNoon,
        Self::SoftRainNoon,
        Self::MidRainyNoon,
        Self::HardRainNoon,
        Self::ClearSunset,
        Self::CloudySunset,
        Self::WetSunset,
        Self::WetCloudySunset,
        Self::SoftRainSunset,
        Self::MidRainSunset,
        Self::HardRainSunset,
    ];

    /// CARLA's name.
    pub fn name(self) -> &'static str {
        match self {
            Self::ClearNoon => "ClearNoon",
            Self::CloudyNoon => "CloudyNoon",
            Self::WetNoon => "WetNoon",
            Self::WetCloudyNoon => "WetCloudyNoon",
            Self::SoftRainNoon => "SoftRainNoon",
            Self::MidRainyNoon => "MidRainyNoon",
            Self::HardRainNoon => "HardRainNoon",
            Self::ClearSunset => "ClearSunset",
            Self::CloudySunset => "CloudySunset",
            Self::WetSunset => "WetSunset",
            Self::WetCloudySunset => "WetCloudySunset",
            Self::SoftRainSunset => "SoftRainSunset",
            Self::MidRainSunset => "MidRainSunset",
            Self::HardRainSunset => "HardRainSunset",
        }
    }

    /// CARLA's numbers: clouds, rain, wetness (0..1), sunset.
    fn numbers(self) -> (f32, f32, f32, bool) {
        match self {
            Self::ClearNoon => (0.15, 0.0, 0.0, false),
            Self::CloudyNoon => (0.7, 0.0, 0.0, false),
            Self::WetNoon => (0.2, 0.0, 0.6, false),
            Self::WetCloudyNoon => (0.7, 0.0, 0.6, false),
            Self::SoftRainNoon => (0.75, 0.25, 0.6, false),
            Self::MidRainyNoon => (0.9, 0.6, 0.8, false),
            Self::HardRainNoon => (1.0, 1.0, 1.0, false),
            Self::ClearSunset => (0.15, 0.0, 0.0, true),
            Self::CloudySunset => (0.7, 0.0, 0.0, true),
            Self::WetSunset => (0.2, 0.0, 0.6, true),
            Self::WetCloudySunset => (0.7, 0.0, 0.6, true),
            Self::SoftRainSunset => (0.75, 0.25, 0.6, true),
            Self::MidRainSunset => (0.9, 0.6, 0.8, true),
            Self::HardRainSunset => (1.0, 1.0, 1.0, true),
        }
    }
}

impl fmt::Display for Preset {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Preset {
    type Err = CameraError;

    fn from_str(text: &str) -> Result<Self, CameraError> {
        let folded = |s: &str| s.replace(['-', '_', ' '], "").to_ascii_lowercase();
        let wanted = folded(text);
        if let Some(preset) = Self::ALL.into_iter().find(|p| folded(p.name()) == wanted) {
            return Ok(preset);
        }
        let mut near: Vec<(usize, &str)> =
            Self::ALL.iter().map(|p| (distance(&wanted, &folded(p.name())), p.name())).collect();
        near.sort();
        let near: Vec<&str> = near.into_iter().take(3).map(|(_, name)| name).collect();
        Err(CameraError::Weather { found: text.to_string(), near: near.join(", ") })
    }
}

/// Letters to insert, drop or replace to get from one word to the other.
pub fn distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, x) in a.chars().enumerate() {
        let mut corner = row[0];
        row[0] = i + 1;
        for (j, y) in b.iter().enumerate() {
            let next = (row[j] + 1).min(row[j + 1] + 1).min(corner + usize::from(x != *y));
            corner = row[j + 1];
            row[j + 1] = next;
        }
    }
    row[b.len()]
}

/// What the renderer needs to know of the weather.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Weather {
    /// The name that it began from.
    pub preset: Preset,
    /// Unit vector to the sun, world frame.
    pub sun: [f32; 3],
    /// The sun's light on a surface that faces it; dim behind clouds.
    pub sun_light: Rgb,
    /// Light from the sky on a surface that faces up, and from below on one that faces down.
    pub sky_light: Rgb,
    /// Light from below on a surface that faces down.
    pub ground_light: Rgb,
    /// Colour of the sky overhead and at the horizon.
    pub zenith: Rgb,
    /// Colour of the sky at the horizon.
    pub horizon: Rgb,
    /// Share of the sky behind clouds (0..1), their lit and shaded colour.
    pub clouds: f32,
    /// Colour of clouds where the sun lights them.
    pub cloud_light: Rgb,
    /// Colour of clouds in their shade.
    pub cloud_shade: Rgb,
    /// Strength of shadows the sun casts (0..1).
    pub shadows: f32,
    /// Share of the light that haze and rain take per metre.
    pub fog: f32,
    /// Rain: 0 none .. 1 a downpour.
    pub rain: f32,
    /// Wet ground: 0 dry .. 1 puddles everywhere.
    pub wetness: f32,
    /// Street lamps and the cars' head and tail lamps are on.
    pub lamps: bool,
    /// Rises as the light falls, so that lamps glow brighter in dull light; 1 at noon.
    pub lamp_gain: f32,
}

fn mix(a: Rgb, b: Rgb, t: f32) -> Rgb {
    std::array::from_fn(|i| a[i] + (b[i] - a[i]) * t)
}

fn scale(a: Rgb, s: f32) -> Rgb {
    a.map(|c| c * s)
}

impl From<Preset> for Weather {
    fn from(preset: Preset) -> Self {
        let (clouds, rain, wetness, sunset) = preset.numbers();
        // How much of the direct sun the clouds take.
        let overcast = ((clouds - 0.35) / 0.5).clamp(0.0, 1.0);
        let (altitude, azimuth) = if sunset { (15.0_f32, 200.0_f32) } else { (48.0, 215.0) };
        let (alt, az) = (altitude.to_radians(), azimuth.to_radians());
        let sun = [alt.cos() * az.cos(), alt.cos() * az.sin(), alt.sin()];
        // Clear and overcast ends of each quantity.
        let (sun_light, sky, grey_sky) = if sunset {
            ([1.30, 0.74, 0.36], [0.24, 0.25, 0.34], [0.30, 0.27, 0.28])
        } else {
            ([1.18, 1.08, 0.92], [0.26, 0.31, 0.40], [0.50, 0.52, 0.56])
        };
        let (zenith, grey_zenith) = if sunset {
            ([0.13, 0.22, 0.42], [0.22, 0.22, 0.27])
        } else {
            ([0.13, 0.30, 0.68], [0.46, 0.49, 0.54])
        };
        let (horizon, grey_horizon) = if sunset {
            ([0.98, 0.60, 0.32], [0.46, 0.38, 0.34])
        } else {
            ([0.68, 0.80, 0.95], [0.68, 0.71, 0.75])
        };
        let gloom = 1.0 - 0.38 * rain;
        Self {
            preset,
            sun,
            sun_light: scale(sun_light, 1.0 - 0.93 * overcast),
            sky_light: scale(mix(sky, grey_sky, overcast), gloom),
            ground_light: scale(mix(scale(sky, 0.5), scale(grey_sky, 0.35), overcast), gloom),
            zenith: scale(mix(zenith, grey_zenith, overcast), gloom),
            horizon: scale(mix(horizon, grey_horizon, overcast), gloom),
            clouds,
            cloud_light: scale(
                if sunset {
                    mix([1.15, 0.72, 0.48], [0.44, 0.38, 0.37], overcast)
                } else {
                    mix([1.2, 1.2, 1.2], [0.78, 0.80, 0.83], overcast)
                },
                gloom,
            ),
            cloud_shade: scale(
                if sunset {
                    mix([0.48, 0.36, 0.38], [0.20, 0.19, 0.22], overcast)
                } else {
                    mix([0.62, 0.66, 0.72], [0.36, 0.38, 0.42], overcast)
                },
                gloom,
            ),
            shadows: 1.0 - overcast,
            fog: 0.0007 + 0.0009 * overcast + 0.0062 * rain * rain.sqrt() + if sunset { 0.0006 } else { 0.0 },
            rain,
            wetness,
            lamps: sunset || rain >= 0.25,
            lamp_gain: if sunset { 1.6 } else { 1.0 },
        }
    }
}

impl Weather {
    /// The sun at `azimuth` (radians, anticlockwise from the east), and `higher` times as high.
    pub fn turn_sun(&mut self, azimuth: f32, higher: f32) {
        let altitude = (self.sun[2].clamp(-1.0, 1.0).asin() * higher).clamp(0.1, 1.4);
        self.sun = [altitude.cos() * azimuth.cos(), altitude.cos() * azimuth.sin(), altitude.sin()];
    }

    /// The same clouds, rain and wetness at night: the moon in the sun's place, the sky dim, all lamps lit.
    pub fn be_night(&mut self) {
        // What a camera that exposes for lamps shows.
        for (light, share) in [
            (&mut self.sun_light, 0.05),
            (&mut self.sky_light, 0.16),
            (&mut self.ground_light, 0.16),
            (&mut self.zenith, 0.05),
            (&mut self.horizon, 0.08),
            (&mut self.cloud_light, 0.06),
            (&mut self.cloud_shade, 0.06),
        ] {
            *light = [light[0] * share * 0.8, light[1] * share * 0.9, light[2] * share * 1.2];
        }
        self.shadows *= 0.5;
        self.lamps = true;
        self.lamp_gain = 2.2;
    }
}

impl Default for Weather {
    fn default() -> Self {
        Preset::default().into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_read_back_and_near_ones_offered() {
        for preset in Preset::ALL {
            assert_eq!(preset.name().parse::<Preset>().unwrap(), preset);
        }
        assert_eq!("hard-rain-noon".parse::<Preset>().unwrap(), Preset::HardRainNoon);
        let error = "ClearNon".parse::<Preset>().unwrap_err().to_string();
        assert!(error.contains("ClearNon") && error.contains("ClearNoon"), "{error}");
        let error = "MidRainNoon".parse::<Preset>().unwrap_err().to_string();
        assert!(error.contains("MidRainyNoon"), "{error}");
    }

    #[test]
    fn rain_is_darker_and_wetter_than_clear() {
        let (clear, rain) = (Weather::from(Preset::ClearNoon), Weather::from(Preset::HardRainNoon));
        assert!(rain.sun_light[0] < 0.2 * clear.sun_light[0] && rain.fog > 4.0 * clear.fog);
        assert!(rain.wetness > 0.9 && clear.wetness == 0.0 && clear.shadows == 1.0);
    }
}
