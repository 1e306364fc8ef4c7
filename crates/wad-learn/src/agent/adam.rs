//! Adam (Kingma and Ba 2015), on one flat tensor, with a state that can be saved.
//!
//! tch's own optimisers keep their moments to themselves, so that a run could not go on where it
//! stopped. All of a network's parameters lie in one tensor here, which makes a step eight operations
//! however many layers there are: what counts on a GPU, where each costs its launch.

use tch::{TchError, Tensor, no_grad};

/// Adam for one flat tensor of parameters.
#[derive(Debug)]
pub struct Adam {
    pub learning_rate: f64,
    /// Running means of the gradient and of its square.
    pub m: Tensor,
    pub v: Tensor,
    /// Steps taken.
    pub t: i64,
}

const BETA1: f64 = 0.9;
const BETA2: f64 = 0.999;
const EPSILON: f64 = 1e-8;

impl Adam {
    /// An optimiser of `parameters`, on their device.
    pub fn new(parameters: &Tensor, learning_rate: f64) -> Self {
        Self { learning_rate, m: parameters.zeros_like(), v: parameters.zeros_like(), t: 0 }
    }

    /// Moves `parameters` against `gradient`; both are flat and of one length.
    ///
    /// # Panics
    /// torch fails, as with tch's own plain methods; [`Self::f_step`] says so instead.
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
            let first = 1.0 - BETA1.powi(self.t as i32);
            let second = 1.0 - BETA2.powi(self.t as i32);
            let root = self.v.f_sqrt()?.f_mul_scalar(1.0 / second.sqrt())?;
            let change = self.m.f_mul_scalar(-self.learning_rate / first)?;
            let _ = parameters.f_addcdiv_(&change, &root.f_add_scalar(EPSILON)?)?;
            Ok(())
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tch::nn::OptimizerConfig;
    use tch::{Device, Kind, nn};

    #[test]
    fn steps_as_libtorchs_adam_does() {
        tch::set_num_threads(1);
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
}
