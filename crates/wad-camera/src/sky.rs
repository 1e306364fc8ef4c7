//! The sky all round, with clouds, sun and a hazy skyline: drawn once per weather, then looked up.

use super::lanes::lanes;
use super::model::Rgb;
use super::noise::tiles;
use super::raster::PAD;
use super::simd::{pack, tone, unit};
use super::view::View;
use super::weather::Weather;
use std::f32::consts::TAU;

/// Columns all round, a power of two, and rows of the panorama.
const COLUMNS: usize = 2048;
const ROWS: usize = 384;
/// Height (tangent of the elevation) of the lowest and highest row.
const LOWEST: f32 = -0.02;
const HIGHEST: f32 = 1.5;

/// The panorama of one weather.
pub struct Sky {
    weather: Weather,
    /// Display colours, row by row from the lowest.
    pixels: Vec<u32>,
    /// Scene light at the horizon, by column: what haze is made of.
    horizon: Vec<Rgb>,
}

impl Sky {
    /// The sky of `weather`.
    pub fn new(weather: &Weather) -> Self {
        let mut pixels = vec![0; COLUMNS * ROWS];
        let mut horizon = vec![[0.0; 3]; COLUMNS];
        for (column, haze) in horizon.iter_mut().enumerate() {
            let azimuth = column as f32 / COLUMNS as f32 * TAU;
            let (sin, cos) = azimuth.sin_cos();
            let skyline = skyline(column);
            *haze = light(weather, [cos, sin, 0.015]);
            for row in 0..ROWS {
                let height = LOWEST + (HIGHEST - LOWEST) * row as f32 / (ROWS - 1) as f32;
                let mut c = light(weather, [cos, sin, height]);
                let inside = ((skyline - height) * 350.0).clamp(0.0, 1.0);
                let far = (0.30 - 24.0 * weather.fog).clamp(0.0, 0.3) * inside;
                for i in 0..3 {
                    c[i] += ([0.03, 0.05, 0.045][i] * haze[i] - c[i]) * far;
                }
                pixels[row * COLUMNS + column] = pack(tone(c[0]), tone(c[1]), tone(c[2]));
            }
        }
        Self { weather: weather.clone(), pixels, horizon }
    }

    /// Whether it is that of `weather`.
    pub fn is_of(&self, weather: &Weather) -> bool {
        self.weather == *weather
    }

    /// Looks up the sky and the haze for a view.
    pub fn look(&self, view: &View, out: &mut Look) {
        out.level = view.ahead[2].abs() < 1e-6;
        out.column.clear();
        out.squeeze.clear();
        out.haze.iter_mut().for_each(Vec::clear);
        for x in 0..view.width {
            let rx = (x as f32 + 0.5 - view.centre[0]) / view.focal;
            let azimuth = view.heading as f32 - rx.atan();
            let column = (azimuth.rem_euclid(TAU) / TAU * COLUMNS as f32) as usize & (COLUMNS - 1);
            out.column.push(column as f32);
            out.squeeze.push(1.0 / (1.0 + rx * rx).sqrt());
            for (haze, value) in out.haze.iter_mut().zip(self.horizon[column]) {
                haze.push(value);
            }
        }
        // Whole lanes are read.
        for line in out.haze.iter_mut().chain([&mut out.column, &mut out.squeeze]) {
            line.resize(view.width + PAD, 0.0);
        }
    }

    /// The sky's pixels `span` of row `y`; `out` is padded.
    pub fn row(&self, view: &View, look: &Look, y: usize, span: (usize, usize), out: &mut [u32]) {
        if look.level {
            let ry = (view.centre[1] - y as f32 - 0.5) / view.focal;
            level_row(&self.pixels, &look.column, &look.squeeze, ry, span, out);
            return;
        }
        for (x, pixel) in out.iter_mut().enumerate().take(span.1).skip(span.0) {
            let r = view.ray(x as f32 + 0.5, y as f32 + 0.5);
            let across = (r[0] * r[0] + r[1] * r[1]).sqrt().max(1e-6);
            let column = ((r[1].atan2(r[0]).rem_euclid(TAU) / TAU * COLUMNS as f32) as usize) & (COLUMNS - 1);
            *pixel = self.pixels[row_of(r[2] / across) * COLUMNS + column];
        }
    }
}

/// What a view needs of the sky, by column of the picture.
#[derive(Default)]
pub struct Look {
    level: bool,
    column: Vec<f32>,
    squeeze: Vec<f32>,
    /// Scene light of the haze: red, green, blue.
    pub haze: [Vec<f32>; 3],
}

#[inline(always)]
fn row_of(height: f32) -> usize {
    let at = (height - LOWEST) * ((ROWS - 1) as f32 / (HIGHEST - LOWEST));
    (at.max(0.0).min((ROWS - 1) as f32) + 0.5) as usize
}

lanes! {
    /// A row of a level view; all are padded.
    fn level_row<L>(pixels: &[u32], column: &[f32], squeeze: &[f32], ry: f32, span: (usize, usize), out: &mut [u32]) {
        let scale = (ROWS - 1) as f32 / (HIGHEST - LOWEST);
        let (first, last) = (L::splat(0.5 - LOWEST * scale), L::splat((ROWS - 1) as f32 + 0.25));
        let zero = L::splat(0.0);
        let mut x = span.0;
        while x < span.1 {
            let at = L::splat(ry * scale) * L::load(&squeeze[x..]) + first;
            let row = at.max(zero).min(last).floor().max(zero);
            let index = row * L::splat(COLUMNS as f32) + L::load(&column[x..]);
            L::lookup(pixels, index, 2 * COLUMNS, &mut out[x..]);
            x += L::COUNT;
        }
    }
}

/// Tangent of the elevation of far trees, roofs and hills.
fn skyline(column: usize) -> f32 {
    let t = column as f32 / COLUMNS as f32;
    let hills = tiles().clouds.at(t * 256.0, 40.0);
    let trees = tiles().clouds.at(t * 1024.0 * 2.0, 77.0);
    let block = unit((t * 190.0) as u32) * f32::from(u8::from(unit((t * 190.0) as u32 + 999) < 0.35));
    0.008 + 0.020 * hills * hills + 0.010 * trees + 0.014 * block
}

/// Scene light from a direction (horizontal part of length 1, upward `d[2]`).
fn light(weather: &Weather, d: [f32; 3]) -> Rgb {
    let length = (1.0 + d[2] * d[2]).sqrt();
    let up = (d[2] / length).max(0.0);
    let towards = (d[0] * weather.sun[0] + d[1] * weather.sun[1] + d[2] * weather.sun[2]) / length;
    let low = 1.0 - up;
    let haze = low * low * low * low;
    // At sunset only the sun's side glows.
    let sunset = weather.sun[2] < 0.4;
    let side = if sunset { 0.35 + 0.65 * (0.5 + 0.5 * towards).powi(2) } else { 1.0 };
    let mut c: Rgb = std::array::from_fn(|i| {
        let away = 0.55 * weather.zenith[i] + 0.25 * weather.horizon[i];
        let edge = away + (weather.horizon[i] - away) * side;
        weather.zenith[i] + (edge - weather.zenith[i]) * haze
    });
    // Clouds on a plane overhead.
    let scale = 1.0 / (d[2].max(0.0) + 0.10);
    let (u, v) = (d[0] * scale * 5.0, d[1] * scale * 5.0);
    let noise = &tiles().clouds;
    let shape = 0.62 * noise.at(u * 2.1 + 5.0, v * 2.1) + 0.38 * noise.at(u * 7.3, v * 7.3 + 31.0);
    let cover = ((shape - (1.02 - weather.clouds)) * 3.2).clamp(0.0, 1.0);
    let depth = ((shape - (1.02 - weather.clouds)) * 1.5).clamp(0.0, 1.0);
    let fade = (d[2] * 7.0).clamp(0.0, 1.0) * 0.9;
    c = std::array::from_fn(|i| {
        let cloud = weather.cloud_light[i] + (weather.cloud_shade[i] - weather.cloud_light[i]) * depth;
        c[i] + (cloud - c[i]) * cover * fade
    });
    // The sun and its glow, as far as clouds let them through.
    if weather.shadows > 0.0 {
        let clear = weather.shadows * (1.0 - 0.7 * cover * fade);
        let angle = towards.clamp(-1.0, 1.0).acos();
        let disc = ((0.022 - angle) * 250.0).clamp(0.0, 1.0) * 4.0;
        let glow = 0.35 * (-angle * 5.5).exp() + 0.5 * (-angle * 26.0).exp();
        c = std::array::from_fn(|i| c[i] + (disc + glow) * weather.sun_light[i] * clear);
    }
    c
}

/// Scene light that a mirror sees in direction `d` (unit), without clouds: for gloss.
#[inline]
pub fn mirrored(weather: &Weather, d: [f32; 3]) -> Rgb {
    let t = (d[2] * 3.0).clamp(-1.0, 1.0);
    let low = (1.0 - d[2].max(0.0)).powi(4);
    std::array::from_fn(|i| {
        let sky = weather.zenith[i] + (weather.horizon[i] - weather.zenith[i]) * low;
        let ground = 0.35 * weather.ground_light[i] + 0.04;
        // Houses and trees stand along the horizon.
        let dim = if t < 0.6 { 0.45 + 0.55 * (t / 0.6).max(0.0) } else { 1.0 };
        if t < 0.0 { ground + (sky * 0.45 - ground) * (1.0 + t) * 0.5 } else { sky * dim }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::CameraConfig;
    use crate::weather::Preset;
    use std::f32::consts::PI;
    use sumo_network::geometry::Pose;

    #[test]
    fn level_and_general_lookups_agree() {
        let sky = Sky::new(&Weather::from(Preset::ClearNoon));
        let view = View::new(&CameraConfig::sized(64, 64), &Pose::new(0.0, 0.0, 0.0, f64::from(PI) * 0.3));
        let mut look = Look::default();
        sky.look(&view, &mut look);
        let (mut fast, mut slow) = (vec![0; 64 + PAD], vec![0; 64 + PAD]);
        let mut differing = 0;
        for y in 0..30 {
            look.level = true;
            sky.row(&view, &look, y, (0, 64), &mut fast);
            look.level = false;
            sky.row(&view, &look, y, (0, 64), &mut slow);
            for (a, b) in fast[..64].iter().zip(&slow) {
                let gap =
                    (0..3).map(|i| (a >> (8 * i) & 255).abs_diff(b >> (8 * i) & 255)).max().unwrap_or(0);
                differing += usize::from(gap > 6);
            }
        }
        assert!(differing < 20, "{differing} of 1920 pixels differ");
    }
}
