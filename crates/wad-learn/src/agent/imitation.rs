//! Imitation beside reinforcement: beyond the paper, off by default.
//!
//! The actor's loss gets a second term that pulls its action towards the autopilot's action in the same
//! situation (TD3+BC, Fujimoto and Gu 2021). The situation need not be the autopilot's own:
//! while the agent or noise drives, the autopilot is queried too (DAgger, Ross et al. 2011), so
//! that the data includes ways back to the lane's middle.

use super::batch::Batch;
pub use super::params::Imitation;
use tch::{Kind, Tensor, no_grad};

/// Weight of a steering error against the same share of a pedal's travel: at 10 m/s a hundredth
/// of full lock matters, and a tenth of a pedal does not.
pub const STEERING: f64 = 50.0;

/// A sample in which the autopilot brakes harder than this (0..1) has more weight: it is one in
/// seventy, and avoids a collision.
pub const HARD_BRAKE: f64 = 0.45;
/// Weight of those samples in the loss.
pub const HARD_BRAKING: f64 = 5.0;

impl Imitation {
    /// The weight at an update.
    pub fn at(&self, updates: u64) -> f64 {
        let left = 1.0 - (updates as f64 / self.updates.max(1) as f64).min(1.0);
        self.weight * (self.floor + (1.0 - self.floor) * left)
    }

    /// -mean(value), with `value` `[B]` in units of the critic's mean size `size` `[B]`, and `weight` times
    /// the mean square distance of `action` [B, A] from the shown action, each number in units of `half` its
    /// range. `shown_value` `[B]` is the critic's value of the shown action, for the filter.
    pub fn loss(
        &self,
        weight: f64,
        batch: &Batch,
        action: &Tensor,
        half: &Tensor,
        value: &Tensor,
        shown_value: impl FnOnce() -> Tensor,
    ) -> Tensor {
        let (scale, mask) = no_grad(|| {
            let mask = if self.filter {
                shown_value().ge_tensor(value).to_kind(Kind::Float) * &batch.is_shown
            } else {
                batch.is_shown.shallow_clone()
            };
            // The critic's own size must not decide between climbing and imitating.
            ((value.abs().mean(Kind::Float) + 1e-6).reciprocal(), mask)
        });
        apart(batch, action, half, &mask) * weight - value.mean(Kind::Float) * scale
    }
}

/// Behaviour cloning's loss: the mean square distance of `action` [B, A] from the shown action, over samples
/// that have one, each number in units of `half` its range.
pub fn cloning_loss(batch: &Batch, action: &Tensor, half: &Tensor) -> Tensor {
    apart(batch, action, half, &batch.is_shown)
}

/// The mean over the rows of `mask` `[B]` that are 1, with more weight on hard braking.
fn apart(batch: &Batch, action: &Tensor, half: &Tensor, mask: &Tensor) -> Tensor {
    let apart = ((action - &batch.shown) / half).square();
    let steering = apart.select(1, 0) * (STEERING - 1.0);
    let apart =
        (apart.sum_dim_intlist([1i64].as_slice(), false, Kind::Float) + steering) / action.size()[1] as f64;
    let hard = batch.shown.select(1, 2).ge(HARD_BRAKE).to_kind(Kind::Float);
    (apart * mask * (hard * (HARD_BRAKING - 1.0) + 1.0)).sum(Kind::Float) / (mask.sum(Kind::Float) + 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_weight_falls_to_its_floor() {
        let imitation = Imitation { weight: 4.0, updates: 100, floor: 0.25, ..Imitation::default() };
        assert_eq!(imitation.at(0), 4.0);
        assert_eq!(imitation.at(50), 2.5);
        assert_eq!(imitation.at(100), 1.0);
        assert_eq!(imitation.at(1_000_000), 1.0);
        assert_eq!(Imitation::default().at(0), 0.0);
    }
}
