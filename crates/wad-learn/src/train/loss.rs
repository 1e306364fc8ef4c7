//! The encoder-decoder's loss, and the augmentation of its pictures; all on the device.

use rand_chacha::ChaCha8Rng;
use tch::{Kind, TchError, Tensor};
use wad_see::latent::chance;

/// Painted pixels: 1 where a picture (n, 3, 128, 128) is blue, green or red as the painter paints.
/// (n, 1, 128, 128).
///
/// # Errors
/// torch fails.
pub fn painted(pictures: &Tensor) -> Result<Tensor, TchError> {
    // One channel high and the two others low: in a town only lamps look like this.
    let highest = pictures.f_amax([1], true)?;
    let sum = pictures.f_sum_dim_intlist([1].as_slice(), true, Kind::Float)?;
    let others = sum.f_sub(&highest)?;
    highest.f_gt(0.7)?.f_logical_and(&others.f_lt(0.45)?)?.f_to_kind(Kind::Float)
}

/// The weight of each pixel (n, 1, 128, 128): 1, and on painted ones up to `paint` x (1 + `small`) more.
/// The fewer painted pixels are around, the greater the weight: small far objects weigh like large near
/// ones. The rim around painted pixels counts half of that, so that edges stay where they are.
///
/// # Errors
/// torch fails.
pub fn pixel_weights(painted: &Tensor, paint: f64, small: f64) -> Result<Tensor, TchError> {
    // Rows, then columns: libtorch sums every window again.
    let around = |side: i64| {
        let rows = painted.f_avg_pool2d([side, 1], [1, 1], [side / 2, 0], false, true, None)?;
        rows.f_avg_pool2d([1, side], [1, 1], [0, side / 2], false, true, None)
    };
    // 1 where a pixel is alone, 0 in the middle of a large object.
    let alone = around(15)?.f_neg()?.f_add_scalar(1.0)?.f_square()?;
    let rim = around(5)?.f_gt(0.0)?.f_to_kind(Kind::Float)?;
    let base = alone.f_mul_scalar(small)?.f_add_scalar(1.0)?.f_mul_scalar(paint)?;
    let share = painted.f_add(&rim)?.f_mul_scalar(0.5)?;
    base.f_mul(&share)?.f_add_scalar(1.0)
}

/// Changes the light: each picture brighter or darker and tinted, except painted pixels. The new
/// town is driven in weathers that were not trained on.
///
/// # Errors
/// torch fails.
pub fn relight(rng: &mut ChaCha8Rng, pictures: &Tensor, painted: &Tensor) -> Result<Tensor, TchError> {
    let count = pictures.size()[0];
    let drawn = chance::uniform(rng, &[count, 5, 1, 1], pictures.device())?;
    let between = |channel: i64, channels: i64, low: f64, high: f64| {
        drawn.f_narrow(1, channel, channels)?.f_mul_scalar(high - low)?.f_add_scalar(low)
    };
    let gain = between(0, 1, 0.6, 1.15)?.f_mul(&between(1, 3, 0.88, 1.12)?)?;
    // Half of the pictures stay unchanged.
    let some = drawn.f_narrow(1, 4, 1)?.f_gt(0.5)?.f_to_kind(Kind::Float)?;
    let gain = gain.f_sub_scalar(1.0)?.f_mul(&some)?.f_add_scalar(1.0)?;
    let lit = pictures.f_mul(&gain)?.f_clamp(0.0, 1.0)?;
    lit.f_add(&pictures.f_sub(&lit)?.f_mul(painted)?)
}

/// Mean weighted square error of pictures 0..1.
///
/// # Errors
/// torch fails.
pub fn reconstruction(made: &Tensor, wanted: &Tensor, weights: &Tensor) -> Result<Tensor, TchError> {
    made.f_sub(wanted)?.f_square()?.f_mul(weights)?.f_mean(Kind::Float)
}

/// Divergence of (means, log variances) (n, 400) from the unit normal, mean over the batch.
///
/// # Errors
/// torch fails.
pub fn divergence(mean: &Tensor, log_variance: &Tensor) -> Result<Tensor, TchError> {
    let sum = log_variance.f_exp()?.f_add(&mean.f_square()?)?.f_sub_scalar(1.0)?.f_sub(log_variance)?;
    sum.f_sum(Kind::Float)?.f_mul_scalar(0.5 / mean.size()[0].max(1) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use tch::Device;

    /// Grey, with a blue 2x2 at (10, 10) and a blue 40x40 at (60, 60).
    fn picture() -> Tensor {
        let picture = Tensor::full([1, 3, 128, 128], 0.5, (Kind::Float, Device::Cpu));
        for (at, side) in [(10, 2), (60, 40)] {
            let spot = picture.narrow(2, at, side).narrow(3, at, side);
            let _ = spot.narrow(1, 0, 2).fill_(0.0);
            let _ = spot.narrow(1, 2, 1).fill_(1.0);
        }
        picture
    }

    #[test]
    fn paint_is_found_and_small_objects_weigh_more() {
        let painted = painted(&picture()).unwrap();
        assert_eq!(painted.sum(Kind::Float).double_value(&[]), (4 + 40 * 40) as f64);
        let weights = pixel_weights(&painted, 4.0, 3.0).unwrap();
        let at = |y: i64, x: i64| weights.double_value(&[0, 0, y, x]);
        assert_eq!(at(100, 10), 1.0);
        assert!(at(10, 10) > 15.0 && (at(80, 80) - 5.0).abs() < 1e-3, "{} {}", at(10, 10), at(80, 80));
        assert!(at(10, 13) > 5.0 && at(10, 13) < at(10, 10));
    }

    #[test]
    fn relighting_leaves_paint_alone() {
        let mut rng = sumo_network::seeds::rng(3, "light");
        let picture = picture().repeat([8, 1, 1, 1]);
        let mask = painted(&picture).unwrap();
        let lit = relight(&mut rng, &picture, &mask).unwrap();
        let change = (&lit - &picture).abs();
        assert_eq!((&change * &mask).max().double_value(&[]), 0.0);
        assert!(change.max().double_value(&[]) > 0.02);
    }

    #[test]
    fn divergence_is_0_at_the_unit_normal_only() {
        let zeros = Tensor::zeros([3, 200], (Kind::Float, Device::Cpu));
        assert_eq!(divergence(&zeros, &zeros).unwrap().double_value(&[]), 0.0);
        let ones = zeros.ones_like();
        assert!((divergence(&ones, &zeros).unwrap().double_value(&[]) - 100.0).abs() < 1e-3);
    }
}
