//! An encoder without training: coarse averages of the image.

use super::{Encoder, LatentError};
use crate::observation::LATENT_SIZE;
use crate::perception::{TRANSFORMED_SIZE, TransformedImage};

/// Columns and rows of the grid: 8 x 8 cells of three colours are 192 numbers; the last eight are zero.
const CELLS: usize = 8;

/// The transformed image averaged over 16 x 16 pixels: a deterministic encoder without weights, for
/// tests, and for the ablation that asks what learned features are worth.
///
/// Number `3 (8 row + column) + colour` of the latent is the mean of that cell's colour, 0 to 1, less a half.
#[derive(Clone, Copy, Debug, Default)]
pub struct PooledEncoder;

impl Encoder for PooledEncoder {
    fn hash(&self) -> &str {
        "pooled-8x8-1"
    }

    fn encode(&mut self, image: &TransformedImage, latent: &mut Vec<f32>) -> Result<(), LatentError> {
        let cell = TRANSFORMED_SIZE / CELLS;
        latent.clear();
        latent.resize(LATENT_SIZE, 0.0);
        let mut sums = [0u32; CELLS * CELLS * 3];
        for (y, row) in image.bytes().chunks_exact(3 * TRANSFORMED_SIZE).enumerate() {
            for (x, pixel) in row.chunks_exact(3).enumerate() {
                let at = 3 * (CELLS * (y / cell) + x / cell);
                for (sum, byte) in sums[at..at + 3].iter_mut().zip(pixel) {
                    *sum += u32::from(*byte);
                }
            }
        }
        let scale = 1.0 / (255.0 * (cell * cell) as f32);
        for (number, sum) in latent.iter_mut().zip(sums) {
            *number = sum as f32 * scale - 0.5;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_cell_has_its_own_numbers() {
        let mut image = TransformedImage::default();
        // The cell of row 1, column 2 in full green.
        for y in 16..32 {
            for x in 32..48 {
                image.bytes_mut()[3 * (TRANSFORMED_SIZE * y + x) + 1] = 255;
            }
        }
        let mut latent = Vec::new();
        PooledEncoder.encode(&image, &mut latent).unwrap();
        assert_eq!(latent.len(), LATENT_SIZE);
        let bright: Vec<usize> = (0..192).filter(|&i| latent[i] > 0.0).collect();
        assert_eq!(bright, [3 * (8 + 2) + 1]);
        assert!((latent[31] - 0.5).abs() < 1e-6);
    }
}
