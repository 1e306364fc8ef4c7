//! Adam (Kingma and Ba 2015) with a state that can be saved: on one flat tensor ([`Adam`]), and with
//! decoupled weight decay (Loshchilov and Hutter 2019) over the variables of a store ([`AdamW`]).
//!
//! tch's own optimisers do not expose their moments, so a run could not be resumed where it
//! stopped. If all of a network's parameters lie in one tensor, a step is eight operations however many
//! layers there are, which saves kernel launches on a GPU.

use std::collections::BTreeMap;
use tch::{Kind, TchError, Tensor, nn::VarStore, no_grad};

const BETA1: f64 = 0.9;
const BETA2: f64 = 0.999;
const EPSILON: f64 = 1e-8;

/// Moments below this are 0. They change no parameter: beside [`EPSILON`] they are nothing.
const NOTHING: f64 = 1e-30;

/// Steps between two looks for moments that are nothing. In them a mean of gradients that have become 0 shrinks to 0.43.
const FLUSH_EVERY: i64 = 8;

/// What the moments fall short by after `t` steps, since they began at 0: 1 - b1^t and 1 - b2^t.
fn shortfalls(t: i64) -> (f64, f64) {
    (1.0 - BETA1.powi(t as i32), 1.0 - BETA2.powi(t as i32))
}

/// Adam for one flat tensor of parameters.
#[derive(Debug)]
pub struct Adam {
    /// The learning rate.
    pub learning_rate: f64,
    /// Running mean of the gradient.
    pub m: Tensor,
    /// Running mean of the gradient's square.
    pub v: Tensor,
    /// Steps taken.
    pub t: i64,
}

impl Adam {
    /// An optimiser of `parameters`, on their device.
    pub fn new(parameters: &Tensor, learning_rate: f64) -> Self {
        Self { learning_rate, m: parameters.zeros_like(), v: parameters.zeros_like(), t: 0 }
    }

    /// The moments with their names in a checkpoint.
    pub fn moments(&mut self) -> [(&'static str, &mut Tensor); 2] {
        [("first", &mut self.m), ("second", &mut self.v)]
    }

    /// Sets moments that are [`NOTHING`] to 0. Behind a unit that is switched off gradients are 0 and moments fade to
    /// subnormal numbers and stay there (0.9 times the smallest number rounds to itself); processors compute with those about a
    /// hundred times slower. A sixth of the critics' moments were subnormal after 150,000 steps of a training, and
    /// Adam took two fifths of its time.
    fn flush(&mut self) -> Result<(), TchError> {
        for moment in [&mut self.m, &mut self.v] {
            let _ = moment.f_masked_fill_(&moment.f_abs()?.f_lt(NOTHING)?, 0.0)?;
        }
        Ok(())
    }

    /// Moves `parameters` against `gradient`; both are flat and of one length.
    ///
    /// # Panics
    /// torch fails, as in tch's plain methods; [`Self::f_step`] returns an error instead.
    pub fn step(&mut self, parameters: &mut Tensor, gradient: &Tensor) {
        if let Err(error) = self.f_step(parameters, gradient) {
            panic!("Adam: {error}");
        }
    }

    /// The same.
    ///
    /// # Errors
    /// torch fails, e.g. out of memory.
    pub fn f_step(&mut self, parameters: &mut Tensor, gradient: &Tensor) -> Result<(), TchError> {
        no_grad(|| {
            self.t += 1;
            // m = b1 m + (1 - b1) g;  v = b2 v + (1 - b2) g^2
            let _ = self.m.f_lerp_(gradient, 1.0 - BETA1)?;
            let _ = self.v.f_lerp_(&gradient.f_mul(gradient)?, 1.0 - BETA2)?;
            // theta -= lr * (m / (1 - b1^t)) / (sqrt(v / (1 - b2^t)) + eps)
            let (first, second) = shortfalls(self.t);
            let root = self.v.f_sqrt()?.f_mul_scalar(1.0 / second.sqrt())?;
            let change = self.m.f_mul_scalar(-self.learning_rate / first)?;
            let _ = parameters.f_addcdiv_(&change, &root.f_add_scalar(EPSILON)?)?;
            if self.t % FLUSH_EVERY == 0 { self.flush() } else { Ok(()) }
        })
    }
}

/// AdamW over the variables of a store.
#[derive(Debug)]
pub struct AdamW {
    /// Name, variable, and its moments.
    parts: Vec<(String, Tensor, Adam)>,
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
            let adam = Adam { learning_rate: 0.0, m: zeros()?, v: zeros()?, t: 0 };
            parts.push((name, variable, adam));
        }
        Ok(Self { parts, steps: 0, weight_decay })
    }

    /// One step down the gradients of `loss`. A gradient with a norm above `most` is scaled down to it;
    /// if it is not finite, no step is taken and false is returned.
    ///
    /// # Errors
    /// torch fails.
    pub fn step(&mut self, loss: &Tensor, rate: f64, most: f64) -> Result<bool, TchError> {
        for (_, variable, _) in &mut self.parts {
            variable.zero_grad();
        }
        loss.f_backward()?;
        no_grad(|| {
            let mut squares = Tensor::f_zeros([], (Kind::Float, loss.device()))?;
            for (_, variable, _) in &self.parts {
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
            let (first, second) = shortfalls(self.steps.into());
            for (_, variable, Adam { m, v, .. }) in &mut self.parts {
                let mut grad = variable.grad();
                if !grad.defined() {
                    continue;
                }
                // In place where possible: large networks otherwise spend their time allocating memory.
                let _ = grad.f_mul_scalar_(factor)?;
                let _ = m.f_lerp_(&grad, 1.0 - BETA1)?;
                let _ = v.f_lerp_(&grad.f_square_()?, 1.0 - BETA2)?;
                if variable.dim() > 1 {
                    let _ = variable.f_mul_scalar_(1.0 - rate * self.weight_decay)?;
                }
                let mut root = v.f_div_scalar(second)?;
                let _ = root.f_sqrt_()?.f_add_scalar_(EPSILON)?;
                let step = m.f_div(&root)?.f_mul_scalar_(-rate / first)?;
                let _ = variable.f_add_(&step)?;
            }
            if i64::from(self.steps) % FLUSH_EVERY == 0 {
                for (_, _, adam) in &mut self.parts {
                    adam.flush()?;
                }
            }
            Ok(true)
        })
    }

    /// The moments by name, for a checkpoint.
    pub fn tensors(&mut self) -> Vec<(String, Tensor)> {
        let named = |(name, _, adam): &mut (String, Tensor, Adam)| {
            adam.moments().map(|(kind, moment)| (format!("{kind}.{name}"), moment.shallow_clone()))
        };
        self.parts.iter_mut().flat_map(named).collect()
    }

    /// Steps so far.
    pub fn steps(&self) -> i32 {
        self.steps
    }

    /// Restores moments from a checkpoint; `find` returns each in the given shape.
    ///
    /// # Errors
    /// `find`'s error, or torch fails.
    pub fn restore<E: From<TchError>>(
        &mut self,
        steps: i32,
        find: impl Fn(&str, &[i64]) -> Result<Tensor, E>,
    ) -> Result<(), E> {
        self.steps = steps;
        no_grad(|| {
            for (name, _, adam) in &mut self.parts {
                for (kind, moment) in adam.moments() {
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
    use tch::nn::OptimizerConfig;
    use tch::{Device, nn};

    #[test]
    fn steps_as_libtorchs_adam_does() {
        wad_see::torch::one_thread();
        let store = nn::VarStore::new(Device::Cpu);
        let values: Vec<f32> = (0..20).map(|i| (i as f32 * 0.7).sin()).collect();
        let mut theirs = store.root().var("x", &[20], nn::Init::Const(0.0));
        no_grad(|| theirs.copy_(&Tensor::from_slice(&values)));
        let mut optimiser = nn::Adam::default().build(&store, 3e-3).unwrap();
        let mut ours = Tensor::from_slice(&values);
        let mut adam = Adam::new(&ours, 3e-3);
        for step in 0..50 {
            // A loss whose gradient is known: sum of x^4 / 4 + step x.
            let loss = (theirs.pow_tensor_scalar(4) / 4.0 + &theirs * (step as f64 * 0.01)).sum(Kind::Float);
            optimiser.backward_step(&loss);
            let gradient = ours.pow_tensor_scalar(3) + step as f64 * 0.01;
            adam.step(&mut ours, &gradient);
        }
        let apart = f64::try_from((&ours - &theirs).abs().max()).unwrap();
        assert!(apart < 2e-6, "{apart} apart after 50 steps");
    }

    #[test]
    fn moments_of_a_unit_that_is_off_become_zero_not_subnormal() {
        let mut parameters = Tensor::from_slice(&[1.0_f32, 1.0]);
        let mut adam = Adam::new(&parameters, 1e-3);
        adam.step(&mut parameters, &Tensor::from_slice(&[1e-3_f32, 1e-3]));
        for _ in 0..2000 {
            adam.step(&mut parameters, &Tensor::from_slice(&[0.0_f32, 1e-3]));
        }
        let first = Vec::<f32>::try_from(&adam.m).unwrap();
        assert_eq!(first[0], 0.0);
        assert!((first[1] - 1e-3).abs() < 1e-8, "{first:?}");
        assert!(Vec::<f32>::try_from(&adam.v).unwrap().iter().all(|v| v.is_normal()));
    }

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
