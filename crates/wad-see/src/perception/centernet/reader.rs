//! Reads a sign that has been found: a small network over a picture of its plate alone, always as large.
//!
//! Digits are 5 pixels high at 12 m and 15 at 4 m; the head that finds signs sees them at all these sizes, and reads few.
//! One plate is so little work that it needs no library: the same numbers come out on every processor.
//!
//! ```text
//! 3 x 24 x 24 --3x3--> 16, largest of 2x2 --3x3--> 32, largest of 2x2 --> 64 --> 13 signs, or none
//! ```

use super::graph::{READ, READ_HIDDEN};
use wad_camera::model::Sign;

/// Columns and rows of a plate's picture.
pub const PLATE: usize = 24;
/// What it may say: signs by [`Sign::index`], then that there is none.
pub const ANSWERS: usize = Sign::KINDS + 1;
/// Half of what it shows, in radii of the plate.
const SHOWN: f32 = 1.4;

/// The colour (0..255) of an RGB picture at (x, y) between the middles of its pixels; its border's beyond them.
pub fn between(rgb: &[u8], width: usize, [x, y]: [f32; 2]) -> [f32; 3] {
    let height = rgb.len() / (3 * width).max(1);
    // The two pixels next to it, and the second one's share.
    let along = |at: f32, side: usize| {
        let most = side.saturating_sub(1);
        let at = at.clamp(0.0, most as f32);
        (at as usize, (at as usize + 1).min(most), at.fract())
    };
    let ((left, right, over), (top, bottom, down)) = (along(x, width), along(y, height));
    std::array::from_fn(|channel| {
        let pixel = |row: usize, column: usize| f32::from(rgb[3 * (row * width + column) + channel]);
        let row = |row: usize| pixel(row, left) * (1.0 - over) + pixel(row, right) * over;
        row(top) * (1.0 - down) + row(bottom) * down
    })
}

/// A plate's picture (3 x 24 x 24; its mean 0, its deviation about 1): what is round (x, y) of an RGB picture, where the plate
/// has this radius (pixels).
pub fn plate(rgb: &[u8], width: usize, [x, y]: [f32; 2], radius: f32) -> Vec<f32> {
    let step = 2.0 * SHOWN * radius / PLATE as f32;
    let along = |middle: f32, cell: usize| middle + (cell as f32 + 0.5 - 0.5 * PLATE as f32) * step - 0.5;
    let mut plate = vec![0.0; 3 * PLATE * PLATE];
    for cell in 0..PLATE * PLATE {
        let colour = between(rgb, width, [along(x, cell % PLATE), along(y, cell / PLATE)]);
        for (channel, value) in colour.into_iter().enumerate() {
            plate[channel * PLATE * PLATE + cell] = value;
        }
    }
    let count = plate.len() as f32;
    let mean = plate.iter().sum::<f32>() / count;
    let deviation = (plate.iter().map(|v| (v - mean).powi(2)).sum::<f32>() / count).sqrt();
    // At night a plate is nearly black: its noise stays small.
    plate.iter_mut().for_each(|v| *v = (*v - mean) / (deviation + 8.0));
    plate
}

/// The network.
#[derive(Clone, Debug)]
pub struct SignReader {
    /// Weight and bias of each layer.
    layers: [(Vec<f32>, Vec<f32>); 4],
}

/// Name and shape of each layer's weight.
pub(super) fn layers() -> [(&'static str, [i64; 4]); 4] {
    let [first, second] = READ;
    let cells = (PLATE / 4 * PLATE / 4) as i64;
    [
        ("signs_read1", [first, 3, 3, 3]),
        ("signs_read2", [second, first, 3, 3]),
        ("signs_read3", [READ_HIDDEN, second * cells, 1, 1]),
        ("signs_read4", [ANSWERS as i64, READ_HIDDEN, 1, 1]),
    ]
}

impl SignReader {
    /// From the tensors of the network that finds the signs, by name and shape.
    ///
    /// # Errors
    /// Those of `floats`.
    pub fn new<E>(floats: impl Fn(&str, &[i64]) -> Result<Vec<f32>, E>) -> Result<Self, E> {
        let layer = |(name, shape): (&str, [i64; 4])| {
            Ok((
                floats(&format!("road.{name}.weight"), &shape)?,
                floats(&format!("road.{name}.bias"), &shape[..1])?,
            ))
        };
        let [a, b, c, d] = layers();
        Ok(Self { layers: [layer(a)?, layer(b)?, layer(c)?, layer(d)?] })
    }

    /// What the plate of a picture says, and how likely that is (0 to 1); None: it is no sign.
    pub fn read(&self, plate: &[f32]) -> Option<(Sign, f32)> {
        let [first, second, third, fourth] = &self.layers;
        let x = convolved(plate, PLATE, first);
        let x = convolved(&x, PLATE / 2, second);
        let mut x = answered(&x, third);
        x.iter_mut().for_each(|v| *v = v.max(0.0));
        let x = answered(&x, fourth);
        let (best, most) =
            x.iter().copied().enumerate().fold((0, f32::MIN), |a, b| if b.1 > a.1 { b } else { a });
        let likely = 1.0 / x.iter().map(|v| (v - most).exp()).sum::<f32>();
        (best < Sign::KINDS).then(|| (Sign::of(best), likely))
    }
}

/// A 3x3 convolution of a square of `side` in each channel, what is above 0 of it, and of that the largest of each 2x2.
fn convolved(x: &[f32], side: usize, (weight, bias): &(Vec<f32>, Vec<f32>)) -> Vec<f32> {
    let wide = side + 2;
    let channels = x.len() / (side * side);
    // With a border of 0.
    let mut padded = vec![0.0; channels * wide * wide];
    for (to, from) in padded.chunks_exact_mut(wide * wide).zip(x.chunks_exact(side * side)) {
        for (to, from) in to.chunks_exact_mut(wide).skip(1).zip(from.chunks_exact(side)) {
            to[1..=side].copy_from_slice(from);
        }
    }
    let half = side / 2;
    let mut pooled = Vec::with_capacity(bias.len() * half * half);
    let mut sum = vec![0.0; side * side];
    for (weight, bias) in weight.chunks_exact(9 * channels).zip(bias) {
        sum.fill(*bias);
        for (weight, from) in weight.chunks_exact(9).zip(padded.chunks_exact(wide * wide)) {
            for (at, w) in weight.iter().enumerate() {
                let (down, over) = (at / 3, at % 3);
                let rows = from[down * wide..].chunks(wide);
                for (to, from) in sum.chunks_exact_mut(side).zip(rows) {
                    for (to, from) in to.iter_mut().zip(&from[over..]) {
                        *to += w * from;
                    }
                }
            }
        }
        for rows in sum.chunks_exact(2 * side) {
            let (above, below) = rows.split_at(side);
            let pairs = above.chunks_exact(2).zip(below.chunks_exact(2));
            pooled.extend(pairs.map(|(a, b)| a[0].max(a[1]).max(b[0]).max(b[1]).max(0.0)));
        }
    }
    pooled
}

/// A layer that sees all numbers.
fn answered(x: &[f32], (weight, bias): &(Vec<f32>, Vec<f32>)) -> Vec<f32> {
    let rows = weight.chunks_exact(x.len());
    rows.zip(bias).map(|(row, bias)| bias + row.iter().zip(x).map(|(w, v)| w * v).sum::<f32>()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plate_is_as_large_at_every_distance_and_as_bright_at_night() {
        // A grey disc with a white half, of this radius.
        let picture = |radius: f32, light: f32| {
            let mut rgb = vec![0; 3 * 64 * 64];
            for (at, pixel) in rgb.chunks_exact_mut(3).enumerate() {
                let (x, y) = (at as f32 % 64.0 + 0.5 - 32.0, (at / 64) as f32 + 0.5 - 32.0);
                let value = if x.hypot(y) > radius {
                    40.0
                } else if x > 0.0 {
                    240.0
                } else {
                    120.0
                };
                pixel.fill((value * light) as u8);
            }
            plate(&rgb, 64, [32.0, 32.0], radius)
        };
        let near = picture(20.0, 1.0);
        assert!(near.iter().sum::<f32>().abs() < 0.1);
        let apart = |other: &[f32]| {
            near.iter().zip(other).map(|(a, b)| (a - b).abs()).sum::<f32>() / near.len() as f32
        };
        assert!(apart(&picture(10.0, 1.0)) < 0.15, "{}", apart(&picture(10.0, 1.0)));
        assert!(apart(&picture(20.0, 0.4)) < 0.15, "{}", apart(&picture(20.0, 0.4)));
        assert!(near[12 * PLATE + 15] > 1.0 && near[12 * PLATE + 8] < 0.5, "bright on its right");
    }

    #[cfg(feature = "learn")]
    #[test]
    fn it_reads_as_the_network_that_learned() {
        use super::super::{Backbone, CenterNet, Sees};
        // Many networks, since some read nothing in any picture, and no seed helps: other tests draw from torch's numbers too.
        let mut signs = 0;
        for seed in 0..40_usize {
            let network = CenterNet::new(Backbone::Light, Sees::Road, tch::Device::Cpu).unwrap();
            let reader = network.sign_reader().unwrap().unwrap();
            let rgb: Vec<u8> = (0..3 * 64 * 48).map(|n| (n * (37 + seed) % 251) as u8).collect();
            let plate = plate(&rgb, 64, [20.0, 9.0], 7.5);
            let x = tch::Tensor::from_slice(&plate).view([1, 3, PLATE as i64, PLATE as i64]);
            let said = network.read_signs(&x).unwrap().unwrap().softmax(1, tch::Kind::Float);
            let best = said.argmax(1, false).int64_value(&[0]) as usize;
            let read = reader.read(&plate);
            assert_eq!(read.map_or(Sign::KINDS, |(sign, _)| sign.index()), best);
            if let Some((_, likely)) = read {
                signs += 1;
                assert!((f64::from(likely) - said.max().double_value(&[])).abs() < 1e-5);
            }
        }
        assert!(signs > 4, "{signs}");
    }
}
