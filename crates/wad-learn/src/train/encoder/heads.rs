//! Linear heads on the latent, trained with it on the labels of the linear probes (`--label-weight`).
//!
//! The reconstruction loss hardly separates cases that differ by few pixels but matter on the road: a
//! pedestrian in the lane and one beside it. The heads are dropped when the training ends.

use crate::encoder_score::told::{LEAD, Told};
use crate::optim::Adam;
use tch::{Device, Kind, TchError, Tensor};

/// Yes or no: a vehicle in the lane, a pedestrian in the lane, a red light.
const QUESTIONS: i64 = 3;
/// Numbers: the vehicle's gap, middle and slope of the painted boundaries.
const NUMBERS: i64 = 3;
/// Numbers per frame.
pub const LABELS: usize = (QUESTIONS + NUMBERS) as usize;
/// Positives rarer than this share get no more weight.
const RAREST: f64 = 0.01;

/// A frame's labels; NaN where a label does not apply.
pub fn labels(told: &Told) -> [f32; LABELS] {
    let yes = |is: bool| f32::from(u8::from(is));
    let number = |value: Option<f64>, unit: f64| value.map_or(f32::NAN, |value| (value / unit) as f32);
    [
        yes(told.has_lead()),
        yes(told.has_pedestrian()),
        yes(told.labels.red),
        number(told.gap(), LEAD),
        number(told.middle(), 1.0),
        number(told.slope(), 1.0),
    ]
}

/// The heads, and the statistics of the training's labels.
#[derive(Debug)]
pub struct Heads {
    /// Weights (latent x [`LABELS`]), then biases, flat.
    pub theta: Tensor,
    /// The heads' optimiser.
    pub adam: Adam,
    latent: i64,
    /// Share of yes ([`QUESTIONS`]); mean and deviation of the numbers ([`NUMBERS`]).
    yes: Tensor,
    mean: Tensor,
    deviation: Tensor,
}

impl Heads {
    /// Untrained heads for a latent of `latent` numbers, with the training's labels (n, 6).
    ///
    /// # Errors
    /// torch fails.
    pub fn new(latent: i64, labels: &Tensor, device: Device) -> Result<Self, TchError> {
        let theta = Tensor::f_zeros([(latent + 1) * LABELS as i64], (Kind::Float, device))?;
        let yes = labels.f_narrow(1, 0, QUESTIONS)?.f_mean_dim([0].as_slice(), false, Kind::Float)?;
        let numbers = labels.f_narrow(1, QUESTIONS, NUMBERS)?;
        let (values, there) = known(&numbers)?;
        let count = there.f_sum_dim_intlist([0].as_slice(), false, Kind::Float)?.f_clamp_min(1.0)?;
        let mean = values.f_sum_dim_intlist([0].as_slice(), false, Kind::Float)?.f_div(&count)?;
        let apart = values.f_sub(&mean)?.f_mul(&there)?.f_square()?;
        let square = apart.f_sum_dim_intlist([0].as_slice(), false, Kind::Float)?.f_div(&count)?;
        Ok(Self {
            adam: Adam::new(&theta, 0.0),
            theta,
            latent,
            yes: yes.f_clamp(RAREST, 1.0 - RAREST)?,
            mean,
            deviation: square.f_sqrt()?.f_clamp_min(1e-3)?,
        })
    }

    /// Loss of `theta`'s heads on `labels` (n, 6) from raw latents (n, 200): cross entropy in which all
    /// yes and all no weigh the same, and the numbers' errors in deviations (square up to one, then
    /// linear); the mean of both kinds.
    ///
    /// # Errors
    /// torch fails.
    pub fn loss(&self, theta: &Tensor, latents: &Tensor, labels: &Tensor) -> Result<Tensor, TchError> {
        let heads = LABELS as i64;
        let weights = theta.f_narrow(0, 0, self.latent * heads)?.f_view([heads, self.latent])?;
        let biases = theta.f_narrow(0, self.latent * heads, heads)?;
        let said = latents.f_linear(&weights, Some(&biases))?;
        let (logits, asked) = (said.f_narrow(1, 0, QUESTIONS)?, labels.f_narrow(1, 0, QUESTIONS)?);
        // -log p where it is yes, -log (1 - p) where it is no; each kind counts half of all.
        let no = asked.f_neg()?.f_add_scalar(1.0)?;
        let rare = asked.f_div(&self.yes)?.f_add(&no.f_div(&self.yes.f_neg()?.f_add_scalar(1.0)?)?)?;
        let surprise = logits.f_softplus()?.f_sub(&logits.f_mul(&asked)?)?;
        let questions = surprise.f_mul(&rare)?.f_mean(Kind::Float)?.f_mul_scalar(0.5)?;
        let (numbers, there) = known(&labels.f_narrow(1, QUESTIONS, NUMBERS)?)?;
        let wanted = numbers.f_sub(&self.mean)?.f_div(&self.deviation)?;
        let error = said.f_narrow(1, QUESTIONS, NUMBERS)?.f_sub(&wanted)?.f_mul(&there)?.f_abs()?;
        let near = error.f_clamp_max(1.0)?;
        // e^2 / 2 below one, e - 1/2 above.
        let badness = near.f_mul(&error.f_sub(&near.f_mul_scalar(0.5)?)?)?;
        let count = there.f_sum(Kind::Float)?.f_clamp_min(1.0)?;
        questions.f_add(&badness.f_sum(Kind::Float)?.f_div(&count)?)?.f_mul_scalar(0.5)
    }
}

/// The numbers with 0 where there is none, and 1 where there is one.
fn known(numbers: &Tensor) -> Result<(Tensor, Tensor), TchError> {
    let there = numbers.f_isnan()?.f_logical_not()?.f_to_kind(Kind::Float)?;
    Ok((numbers.f_nan_to_num(0.0, None, None)?, there))
}

#[cfg(test)]
mod tests {
    use super::*;

    const NONE: f32 = f32::NAN;

    /// Latents of two numbers: the first says whether there is a vehicle, the second how near.
    fn frames() -> (Tensor, Tensor) {
        let latents = [[2.0_f32, 0.5], [2.0, -0.5], [-2.0, 0.0], [-2.0, 0.0]];
        let labels = [
            [1.0, 0.0, 0.0, 0.75, NONE, NONE],
            [1.0, 0.0, 0.0, 0.25, NONE, NONE],
            [0.0, 0.0, 0.0, NONE, NONE, NONE],
            [0.0, 0.0, 1.0, NONE, NONE, NONE],
        ];
        let flat: Vec<f32> = labels.iter().flatten().copied().collect();
        let shape = [4, LABELS as i64];
        (Tensor::from_slice2(&latents), Tensor::from_slice(&flat).view(shape))
    }

    #[test]
    fn heads_that_know_nothing_are_as_bad_as_a_coin() {
        let (latents, labels) = frames();
        let heads = Heads::new(2, &labels, Device::Cpu).unwrap();
        let loss = heads.loss(&heads.theta, &latents, &labels).unwrap().double_value(&[]);
        // The balanced cross entropy of p = 0.5 is log 2 (a question without a yes has its no's only, half of
        // that); both gaps are one deviation off.
        let questions = std::f64::consts::LN_2 * (1.0 + 0.5 / 0.99 + 1.0) / 3.0;
        assert!((loss - 0.5 * (questions + 0.5)).abs() < 1e-4, "{loss}");
    }

    #[test]
    fn what_is_not_there_is_not_taught_and_what_is_there_is_learnt() {
        let (latents, labels) = frames();
        let mut heads = Heads::new(2, &labels, Device::Cpu).unwrap();
        heads.adam.learning_rate = 0.05;
        let mut last = f64::INFINITY;
        for _ in 0..400 {
            let theta = heads.theta.detach().set_requires_grad(true);
            let loss = heads.loss(&theta, &latents, &labels).unwrap();
            let gradient = Tensor::run_backward(&[&loss], &[&theta], false, false).remove(0);
            last = loss.double_value(&[]);
            heads.adam.step(&mut heads.theta, &gradient);
        }
        // These latents hold nothing about the red light.
        assert!(last < 0.15, "{last}");
        let weights = heads.theta.narrow(0, 0, 12).view([6, 2]);
        let at = |row: i64, column: i64| weights.double_value(&[row, column]);
        assert!(at(0, 0) > 1.0 && at(3, 1) > 1.0, "{weights}");
        // Nothing was painted in any frame.
        assert_eq!((at(4, 0), at(4, 1), at(5, 0), at(5, 1)), (0.0, 0.0, 0.0, 0.0));
    }
}
