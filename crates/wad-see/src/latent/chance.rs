//! Random tensors from our own generator. torch has one generator for all threads, so two trainings in one
//! process would disturb each other, and its state cannot be saved.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use tch::{Device, TchError, Tensor};

/// Numbers from 0 to 1.
///
/// # Errors
/// torch fails.
pub fn uniform(rng: &mut ChaCha8Rng, shape: &[i64], device: Device) -> Result<Tensor, TchError> {
    let count = shape.iter().product::<i64>().max(0);
    let numbers: Vec<f32> = (0..count).map(|_| rng.random()).collect();
    Tensor::f_from_slice(&numbers)?.f_view(shape)?.f_to_device(device)
}

/// Numbers of the unit normal distribution.
///
/// # Errors
/// torch fails.
pub fn normal(rng: &mut ChaCha8Rng, shape: &[i64], device: Device) -> Result<Tensor, TchError> {
    let count = shape.iter().product::<i64>().max(0) as usize;
    let mut numbers: Vec<f32> = Vec::with_capacity(count + 1);
    // Box and Muller.
    while numbers.len() < count {
        let radius = (-2.0 * (1.0 - rng.random::<f32>()).max(1e-12).ln()).sqrt();
        let (sine, cosine) = (std::f32::consts::TAU * rng.random::<f32>()).sin_cos();
        numbers.extend([radius * cosine, radius * sine]);
    }
    numbers.truncate(count);
    Tensor::f_from_slice(&numbers)?.f_view(shape)?.f_to_device(device)
}

#[cfg(test)]
mod tests {
    use super::*;
    use sumo_network::seeds;
    use tch::Kind;

    #[test]
    fn moments_are_those_of_the_distributions() {
        let mut rng = seeds::rng(4, "chance");
        let moments = |t: &Tensor| (t.mean(Kind::Float).double_value(&[]), t.std(true).double_value(&[]));
        let (mean, deviation) = moments(&normal(&mut rng, &[301, 100], Device::Cpu).unwrap());
        assert!(mean.abs() < 0.02 && (deviation - 1.0).abs() < 0.02, "{mean} {deviation}");
        let (mean, deviation) = moments(&uniform(&mut rng, &[300, 100], Device::Cpu).unwrap());
        assert!((mean - 0.5).abs() < 0.01 && (deviation - 12_f64.sqrt().recip()).abs() < 0.01);
    }
}
