//! AdamW (Loshchilov and Hutter 2019) over the variables of a store, with moments that can be saved.

use std::collections::BTreeMap;
use tch::{Kind, TchError, Tensor, nn::VarStore};

const BETA1: f64 = 0.9;
const BETA2: f64 = 0.999;
const EPSILON: f64 = 1e-8;

/// The optimiser's memory.
#[derive(Debug)]
pub struct AdamW {
    /// Name, variable, first and second moment.
    parts: Vec<(String, Tensor, Tensor, Tensor)>,
    steps: i32,
    weight_decay: f64,
}

impl AdamW {
    /// Over the trainable variables. Biases and norms do not decay.
    ///
    /// # Errors
    /// torch fails.
    pub fn new(store: &VarStore, weight_decay: f64) -> Result<Self, TchError> {
        let sorted: BTreeMap<String, Tensor> = store.variables().into_iter().collect();
        let mut parts = Vec::new();
        for (name, variable) in sorted.into_iter().filter(|(_, v)| v.requires_grad()) {
            let zeros = || variable.f_detach()?.f_zeros_like();
            let (first, second) = (zeros()?, zeros()?);
            parts.push((name, variable, first, second));
        }
        Ok(Self { parts, steps: 0, weight_decay })
    }

    /// One step down the gradients of `loss`. Gradients longer than `most` in all are shortened to it;
    /// where they are no numbers, the step is not taken and false comes back.
    ///
    /// # Errors
    /// torch fails.
    pub fn step(&mut self, loss: &Tensor, rate: f64, most: f64) -> Result<bool, TchError> {
        for (_, variable, ..) in &mut self.parts {
            variable.zero_grad();
        }
        loss.f_backward()?;
        tch::no_grad(|| {
            let mut squares = Tensor::f_zeros([], (Kind::Float, loss.device()))?;
            for (_, variable, ..) in &self.parts {
                let grad = variable.grad();
                if grad.defined() {
                    squares = squares.f_add(&grad.f_norm()?.f_square()?)?;
                }
            }
            let length = squares.f_sqrt()?.f_double_value(&[])?;
            if !length.is_finite() {
                return Ok(false);
            }
            let factor = (most / length.max(1e-12)).min(1.0);
            self.steps += 1;
            let (c1, c2) = (1.0 - BETA1.powi(self.steps), 1.0 - BETA2.powi(self.steps));
            for (_, variable, first, second) in &mut self.parts {
                let mut grad = variable.grad();
                if !grad.defined() {
                    continue;
                }
                // In place where it can be: large networks otherwise spend their time on getting memory.
                let _ = grad.f_mul_scalar_(factor)?;
                let _ = first.f_lerp_(&grad, 1.0 - BETA1)?;
                let _ = second.f_lerp_(&grad.f_square_()?, 1.0 - BETA2)?;
                if variable.dim() > 1 {
                    let _ = variable.f_mul_scalar_(1.0 - rate * self.weight_decay)?;
                }
                let mut root = second.f_div_scalar(c2)?;
                let _ = root.f_sqrt_()?.f_add_scalar_(EPSILON)?;
                let step = first.f_div(&root)?.f_mul_scalar_(-rate / c1)?;
                let _ = variable.f_add_(&step)?;
            }
            Ok(true)
        })
    }

    /// The moments by name, for a checkpoint.
    pub fn tensors(&self) -> Vec<(String, Tensor)> {
        let named = |(name, _, first, second): &(String, Tensor, Tensor, Tensor)| {
            [
                (format!("first.{name}"), first.shallow_clone()),
                (format!("second.{name}"), second.shallow_clone()),
            ]
        };
        self.parts.iter().flat_map(named).collect()
    }

    /// Steps so far.
    pub fn steps(&self) -> i32 {
        self.steps
    }

    /// Takes moments from a checkpoint; `find` gives each in the shape asked for.
    ///
    /// # Errors
    /// What `find` says, or torch fails.
    pub fn restore<E: From<TchError>>(
        &mut self,
        steps: i32,
        find: impl Fn(&str, &[i64]) -> Result<Tensor, E>,
    ) -> Result<(), E> {
        self.steps = steps;
        tch::no_grad(|| {
            for (name, _, first, second) in &mut self.parts {
                for (kind, moment) in [("first", first), ("second", second)] {
                    let saved = find(&format!("{kind}.{name}"), &moment.size())?;
                    moment.f_copy_(&saved)?;
                }
            }
            Ok(())
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tch::{Device, nn};

    #[test]
    fn the_first_step_is_the_rate_long_and_a_broken_gradient_is_no_step() {
        let store = nn::VarStore::new(Device::Cpu);
        let x = store.root().var("x", &[2], nn::Init::Const(1.0));
        let mut adam = AdamW::new(&store, 0.1).unwrap();
        let loss = (&x * Tensor::from_slice(&[3.0_f32, -5.0])).sum(Kind::Float);
        assert!(adam.step(&loss, 0.01, 1e9).unwrap());
        // Adam's first step is the rate against the gradient's sign; vectors do not decay.
        let found = Vec::<f32>::try_from(&x).unwrap();
        assert!((found[0] - 0.99).abs() < 1e-6 && (found[1] - 1.01).abs() < 1e-6, "{found:?}");
        let broken = (&x * f64::NAN).sum(Kind::Float);
        assert!(!adam.step(&broken, 0.01, 1e9).unwrap());
        assert_eq!(Vec::<f32>::try_from(&x).unwrap(), found);
    }
}
