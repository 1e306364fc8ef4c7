//! Draws from the seeded generator that more than one part needs.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// The index of one of `weights`, drawn in proportion; None where they add up to nothing.
pub fn pick_weighted(rng: &mut ChaCha8Rng, weights: impl Iterator<Item = f64> + Clone) -> Option<usize> {
    let total: f64 = weights.clone().sum();
    if total <= 0.0 {
        return None;
    }
    let mut left = rng.random::<f64>() * total;
    let mut last = None;
    for (i, weight) in weights.enumerate() {
        if weight <= 0.0 {
            continue;
        }
        last = Some(i);
        left -= weight;
        if left < 0.0 {
            break;
        }
    }
    last
}

/// A number in `from..to`; `from` where the range is empty.
pub fn between(rng: &mut ChaCha8Rng, from: f64, to: f64) -> f64 {
    from + (to - from).max(0.0) * rng.random::<f64>()
}
