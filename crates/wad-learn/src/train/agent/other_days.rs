//! Changes transformed images of the training weathers to other days: light, tints, haze, wet roads, rain.
//!
//! Agents train in three weathers and drive in eleven others, which shift the latent. Nothing here comes from
//! the renderer's weathers: random numbers change the pixels, and paint stays.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use wad_camera::CameraConfig;
use wad_see::latent::{Encoder, LatentError};
use wad_see::perception::{ImageKind, TRANSFORMED_SIZE, TransformedImage};

/// An encoder that gets a share of its images changed to other days. A day lasts 30 to 300 images.
pub struct OtherDays {
    inner: Box<dyn Encoder>,
    /// Share of changed days.
    share: f64,
    rng: ChaCha8Rng,
    day: Option<Day>,
    left: u32,
    image: TransformedImage,
}

impl OtherDays {
    /// Wraps `inner`, with randomness from `rng`; `inner` itself if `share` is 0.
    pub fn before(inner: Box<dyn Encoder>, share: f64, rng: ChaCha8Rng) -> Box<dyn Encoder> {
        if share == 0.0 {
            return inner;
        }
        Box::new(Self { inner, share, rng, day: None, left: 0, image: TransformedImage::default() })
    }
}

impl Encoder for OtherDays {
    fn hash(&self) -> &str {
        self.inner.hash()
    }

    fn image_kind(&self) -> ImageKind {
        self.inner.image_kind()
    }

    fn camera(&self) -> Option<CameraConfig> {
        self.inner.camera()
    }

    fn encode(&mut self, image: &TransformedImage, latent: &mut Vec<f32>) -> Result<(), LatentError> {
        if self.left == 0 {
            self.left = self.rng.random_range(30..300);
            let other = self.rng.random::<f64>() < self.share;
            self.day = other.then(|| Day::draw(&mut self.rng));
        }
        self.left -= 1;
        let Some(day) = &self.day else { return self.inner.encode(image, latent) };
        day.show(image.bytes(), self.image.bytes_mut(), &mut self.rng);
        self.inner.encode(&self.image, latent)
    }
}

/// The changes of a day to the camera's image.
#[derive(Clone, Debug)]
struct Day {
    /// Brightness by channel and byte, before the rest.
    light: [[f32; 256]; 3],
    /// Share of its saturation that a pixel keeps.
    saturation: f32,
    /// Pixels above the horizon are mixed with this colour by this share, most at the top.
    sky: ([f32; 3], f32),
    /// Share of the light that haze takes per metre, and its colour.
    haze: (f32, [f32; 3]),
    /// Share of the light that the ground mirrors at the horizon.
    wet: f32,
    /// Largest change of a pixel by rain, up and down.
    rain: f32,
}

const SIDE: usize = TRANSFORMED_SIZE;
/// Row of the horizon and focal length (pixels of the transformed image), and the camera's height (m).
const HORIZON: usize = SIDE / 2;
const FOCAL: f32 = SIDE as f32 / 2.0;
const UP: f32 = 1.4;
/// Distance of everything above the horizon (m).
const FAR: f32 = 60.0;

impl Day {
    fn draw(rng: &mut impl RngExt) -> Self {
        let mut within = |low: f32, high: f32| rng.random_range(low..high);
        // Half of the days are darker, some a little brighter; half have a warm low sun.
        let brightness = within(0.4, 1.25);
        let warm = if within(0.0, 1.0) < 0.5 { within(0.0, 0.35) } else { within(-0.1, 0.1) };
        let gamma = within(0.8, 1.3);
        let gains = [1.0 + warm, 1.0, 1.0 - warm].map(|tint| tint * brightness);
        let light = gains.map(|gain| {
            std::array::from_fn(|byte| (255.0 * gain * (byte as f32 / 255.0).powf(gamma)).min(255.0))
        });
        let grey = within(50.0, 200.0);
        let tinted = [grey * (1.0 + warm), grey, grey * (1.0 - 0.5 * warm)];
        let mut on = |share: f32, low: f32, high: f32| {
            let (drawn, value) = (within(0.0, 1.0), within(low, high));
            if drawn < share { value } else { 0.0 }
        };
        Self {
            light,
            saturation: 1.0 - on(0.5, 0.0, 0.8),
            sky: (tinted, on(0.6, 0.2, 1.0)),
            haze: (on(0.4, 0.001, 0.015), tinted),
            wet: on(0.4, 0.05, 0.4),
            rain: on(0.4, 4.0, 22.0),
        }
    }

    /// `from` on this day, into `to`: bytes of transformed images.
    fn show(&self, from: &[u8], to: &mut [u8], rng: &mut impl RngExt) {
        let row_of = |y: usize| &from[3 * SIDE * y..][..3 * SIDE];
        for (y, out) in to.chunks_exact_mut(3 * SIDE).enumerate() {
            let below = y as f32 + 0.5 - HORIZON as f32;
            let depth = if below > 0.0 { (UP * FOCAL / below).min(FAR) } else { FAR };
            let clear = (-self.haze.0 * depth).exp();
            let wet = if y >= HORIZON { self.wet * (1.0 - 0.5 * below / HORIZON as f32) } else { 0.0 };
            let sky = if y < HORIZON { self.sky.1 * (-below / HORIZON as f32) } else { 0.0 };
            let above = row_of(if y >= HORIZON { SIDE - 1 - y } else { y });
            for ((out, pixel), mirrored) in
                out.chunks_exact_mut(3).zip(row_of(y).chunks_exact(3)).zip(above.chunks_exact(3))
            {
                let lit =
                    |p: &[u8]| -> [f32; 3] { std::array::from_fn(|c| self.light[c][usize::from(p[c])]) };
                let mut colour = lit(pixel);
                if wet > 0.0 {
                    let mirrored = lit(mirrored);
                    colour = std::array::from_fn(|c| colour[c] + wet * (mirrored[c] - colour[c]));
                }
                let grey = (colour[0] + colour[1] + colour[2]) / 3.0;
                let noise = if self.rain > 0.0 { self.rain * (2.0 * rng.random::<f32>() - 1.0) } else { 0.0 };
                let kept = painted(pixel);
                for (c, out) in out.iter_mut().enumerate() {
                    let mut value = grey + self.saturation * (colour[c] - grey);
                    value += sky * (self.sky.0[c] - value);
                    value = self.haze.1[c] + clear * (value - self.haze.1[c]) + noise;
                    let own = f32::from(pixel[c]);
                    *out = (value.clamp(0.0, 255.0) + kept * (own - value.clamp(0.0, 255.0)) + 0.5) as u8;
                }
            }
        }
    }
}

/// Share of paint in a pixel: how far one channel is above the others. Nothing else in a town
/// is as saturated.
fn painted(pixel: &[u8]) -> f32 {
    let [r, g, b] = [pixel[0], pixel[1], pixel[2]].map(f32::from);
    let above = (r - g.max(b)).max(g - r.max(b)).max(b - r.max(g));
    ((above - 70.0) / 90.0).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use wad_see::latent::PooledEncoder;
    use wad_see::perception::paint::{BLUE, GREEN, RED};

    #[test]
    fn paint_stays_and_the_rest_changes() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut image = TransformedImage::default();
        image.bytes_mut().fill(120);
        for (i, colour) in [BLUE, GREEN, RED].iter().enumerate() {
            image.bytes_mut()[3 * 9000 + 3 * i..][..3].copy_from_slice(colour);
        }
        let (mut out, mut changed) = (TransformedImage::default(), 0);
        for _ in 0..20 {
            Day::draw(&mut rng).show(image.bytes(), out.bytes_mut(), &mut rng);
            assert_eq!(out.bytes()[27_000..27_009], image.bytes()[27_000..27_009]);
            changed += usize::from(out.bytes()[..9000].iter().any(|byte| byte.abs_diff(120) > 8));
        }
        assert!(changed >= 15, "{changed} of 20");
    }

    #[test]
    fn the_share_says_how_many_images_change_and_0_changes_none() {
        let mut image = TransformedImage::default();
        image.bytes_mut().fill(120);
        let (mut plain, mut latent) = (Vec::new(), Vec::new());
        PooledEncoder.encode(&image, &mut plain).unwrap();
        for (share, expected) in [(0.0, 0..1), (0.5, 1500..4500), (1.0, 5500..6001)] {
            let rng = ChaCha8Rng::seed_from_u64(2);
            let mut encoder = OtherDays::before(Box::new(PooledEncoder), share, rng);
            let mut changed = 0;
            for _ in 0..6000 {
                encoder.encode(&image, &mut latent).unwrap();
                changed += usize::from(latent != plain);
            }
            assert!(expected.contains(&changed), "{share}: {changed} of 6000");
            assert_eq!(encoder.hash(), PooledEncoder.hash());
        }
    }
}
