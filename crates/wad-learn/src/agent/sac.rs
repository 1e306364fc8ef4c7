//! SAC in its first form (Haarnoja et al. 2018, "Off-Policy Maximum Entropy"), with a value network:
//! WAD-S' learning step.

use super::batch::{Batch, Metrics};
use super::imitation::cloning_loss;
use super::networks::{Critics, Dims, HIDDEN_S, PolicyS, Value};
pub use super::params::SacParams;
use crate::optim::Adam;
use rand::Rng;
use tch::{Device, Kind, Tensor, no_grad};

/// Policy, critics, value network with its target, and optimisers.
#[derive(Debug)]
pub struct Sac {
    /// The constants.
    pub params: SacParams,
    /// pi.
    pub policy: PolicyS,
    /// Q1 and Q2.
    pub critics: Critics,
    /// V.
    pub value: Value,
    /// V', the slow copy of V in the critics' target.
    pub value_target: Value,
    /// The policy's optimiser.
    pub policy_adam: Adam,
    /// The critics' optimiser.
    pub critics_adam: Adam,
    /// The value network's optimiser.
    pub value_adam: Adam,
    /// Logarithm of the temperature, `[1]`.
    pub log_alpha: Tensor,
    /// The optimiser of the temperature.
    pub alpha_adam: Adam,
    /// Updates so far.
    pub updates: u64,
    target_entropy: f64,
    /// Half the range of each number of an action.
    half: Tensor,
}

impl Sac {
    /// New networks from `rng`.
    pub fn new(params: SacParams, dims: Dims, rng: &mut impl Rng, device: Device) -> Self {
        let policy = PolicyS::new(dims, rng, device);
        let critics = Critics::new(dims, &HIDDEN_S, rng, device);
        let value = Value::new(dims, rng, device);
        let log_alpha = Tensor::from_slice(&[params.alpha.ln() as f32]).to_device(device);
        let lr = params.learning_rate;
        Self {
            policy_adam: Adam::new(policy.params.flat(), lr),
            critics_adam: Adam::new(critics.params.flat(), lr),
            value_adam: Adam::new(value.params.flat(), lr),
            alpha_adam: Adam::new(&log_alpha, lr),
            value_target: value.copy(device),
            policy,
            critics,
            value,
            log_alpha,
            updates: 0,
            half: Tensor::from_slice(
                &(0..dims.actions).map(|i| if i == 0 { 1.0 } else { 0.5 }).collect::<Vec<f32>>(),
            )
            .to_device(device),
            target_entropy: params.target_entropy.unwrap_or(-dims.actions as f64),
            params,
        }
    }

    /// One step of behaviour cloning: the policy only. The loss uses the sampled action, not the mean.
    pub fn clone_expert(&mut self, batch: &Batch, learning_rate: f64) {
        let (action, _) = self.policy.sample_with_log_prob(&batch.observation, &batch.noise);
        let gradient = self.policy.params.gradient(&cloning_loss(batch, &action, &self.half));
        self.policy_adam.learning_rate = learning_rate;
        self.policy_adam.step(self.policy.params.flat_mut(), &gradient);
        self.policy_adam.learning_rate = self.params.learning_rate;
    }

    /// One update of every network.
    pub fn update(&mut self, batch: &Batch, metrics: Option<&mut Metrics>) {
        self.updates += 1;
        let mean = |x: &Tensor| x.mean(Kind::Float);
        let alpha = no_grad(|| self.log_alpha.exp());

        // Q: r + gamma (1 - terminated) V'(s')
        let y =
            no_grad(|| &batch.reward + &batch.discount * self.value_target.forward(&batch.next_observation));
        let q = self.critics.forward(&batch.observation, &batch.action);
        let q_error = (&q - &y).square().mean_dim([1i64].as_slice(), false, Kind::Float);
        let q_gradient = self.critics.params.gradient(&(q_error.sum(Kind::Float) * 0.5));

        // pi: alpha log pi(a|s) - min Q(s, a), with a new sample a
        let (action, log_prob) = self.policy.sample_with_log_prob(&batch.observation, &batch.noise);
        let q_new = self.critics.forward(&batch.observation, &action).amin([0i64].as_slice(), false);
        let weight = self.params.imitation.at(self.updates);
        let policy_loss = if weight == 0.0 {
            mean(&(&log_prob * &alpha - &q_new))
        } else {
            // The drawn action is pulled, not the mean: so the spread learns how exact one must be.
            let value = &q_new - &log_prob * &alpha;
            let shown =
                || self.critics.forward(&batch.observation, &batch.shown).amin([0i64].as_slice(), false);
            self.params.imitation.loss(weight, batch, &action, &self.half, &value, shown)
        };

        // V: min Q(s, a) - alpha log pi(a|s)
        let v_target = no_grad(|| q_new.detach() - log_prob.detach() * &alpha);
        let v_error = (self.value.forward(&batch.observation) - v_target).square();
        let v_loss = mean(&v_error) * 0.5;

        let v_gradient = self.value.params.gradient(&v_loss);
        let actor_learns = self.updates > self.params.critics_first;
        let policy_gradient = actor_learns.then(|| self.policy.params.gradient(&policy_loss));
        self.critics_adam.step(self.critics.params.flat_mut(), &q_gradient);
        self.value_adam.step(self.value.params.flat_mut(), &v_gradient);
        if let Some(gradient) = policy_gradient {
            self.policy_adam.step(self.policy.params.flat_mut(), &gradient);
        }
        if actor_learns && self.params.autotune {
            // d/d(log alpha) of -log alpha (log pi + target entropy), as in Stable-Baselines and cleanrl
            let gradient = no_grad(|| (mean(&log_prob.detach()) + self.target_entropy).neg().view([1]) * 1.0);
            self.alpha_adam.step(&mut self.log_alpha, &gradient);
        }
        self.value_target.params.follow(&self.value.params, self.params.tau);

        if let Some(metrics) = metrics {
            metrics.add_pair(["losses/qf1_loss", "losses/qf2_loss"], &q_error);
            let values = no_grad(|| q.mean_dim([1i64].as_slice(), false, Kind::Float));
            metrics.add_pair(["losses/qf1_values", "losses/qf2_values"], &values);
            metrics.add("losses/actor_loss", &policy_loss);
            metrics.add("losses/vf_loss", &v_loss);
            metrics.add("losses/alpha", &alpha.squeeze());
            metrics.add("losses/entropy", &mean(&log_prob).neg());
        }
    }
}
