//! One run seed derives all others: SUMO's, the traffic's, the tasks', later torch's.

use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// The seed of the part of a run called `part`, independent of every other part's.
pub fn derive(run_seed: u64, part: &str) -> u64 {
    let name = part
        .bytes()
        .fold(0xcbf2_9ce4_8422_2325_u64, |h, b| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3));
    mix(run_seed ^ mix(name))
}

/// SUMO's own seed: a positive 31-bit number.
pub fn sumo(run_seed: u64) -> u32 {
    (derive(run_seed, "sumo") >> 33) as u32
}

/// The random generator of the part of a run called `part`.
pub fn rng(run_seed: u64, part: &str) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(derive(run_seed, part))
}

/// A standard normal number (Box and Muller).
pub fn normal(rng: &mut impl Rng) -> f64 {
    let radius = (-2.0 * (1.0 - rng.random::<f64>()).ln()).sqrt();
    radius * (std::f64::consts::TAU * rng.random::<f64>()).cos()
}

/// Vigna's splitmix64 finaliser: neighbouring seeds end far apart.
fn mix(seed: u64) -> u64 {
    let z = seed.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_and_neighbouring_seeds_differ() {
        assert_ne!(derive(0, "sumo"), derive(0, "traffic"));
        assert_ne!(derive(0, "sumo"), derive(1, "sumo"));
        assert_eq!(derive(7, "traffic"), derive(7, "traffic"));
        assert!(sumo(u64::MAX) < 1 << 31);
    }
}
