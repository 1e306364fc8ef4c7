//! TD3 (Fujimoto et al. 2018): WAD-T's learning step.

use super::batch::{Batch, Metrics};
use super::imitation::cloning_loss;
use super::networks::{ActorT, CriticEnd, Critics, Dims};
pub use super::params::Td3Params;
use crate::optim::Adam;
use rand::Rng;
use tch::{Device, Kind, Tensor, no_grad};

/// Actor, critics, their targets and optimisers.
#[derive(Debug)]
pub struct Td3 {
    /// The constants.
    pub params: Td3Params,
    /// pi.
    pub actor: ActorT,
    /// pi', the slow copy of pi in the critics' target.
    pub actor_target: ActorT,
    /// Q1 and Q2.
    pub critics: Critics,
    /// Q1' and Q2', the slow copies in the critics' target.
    pub critics_target: Critics,
    /// The actor's optimiser.
    pub actor_adam: Adam,
    /// The critics' optimiser.
    pub critics_adam: Adam,
    /// Updates so far.
    pub updates: u64,
    /// Range of each number of an action.
    low: Tensor,
    high: Tensor,
    half: Tensor,
}

impl Td3 {
    /// New networks from `rng`.
    pub fn new(params: Td3Params, dims: Dims, rng: &mut impl Rng, device: Device) -> Self {
        let actor = ActorT::new(dims, rng, device);
        let critics = Critics::new(dims, &params.critic_hidden, rng, device);
        let range = |steer: f32, pedal: f32| {
            let values: Vec<f32> = (0..dims.actions).map(|i| if i == 0 { steer } else { pedal }).collect();
            Tensor::from_slice(&values).to_device(device)
        };
        Self {
            actor_target: actor.copy(device),
            critics_target: critics.copy(device),
            actor_adam: Adam::new(actor.params.flat(), params.actor_learning_rate),
            critics_adam: Adam::new(critics.params.flat(), params.critic_learning_rate),
            actor,
            critics,
            params,
            updates: 0,
            low: range(-1.0, 0.0),
            high: range(1.0, 1.0),
            half: range(1.0, 0.5),
        }
    }

    /// One update; the critics always, the actor and the targets every `policy_frequency`-th time.
    pub fn update(&mut self, batch: &Batch, metrics: Option<&mut Metrics>) {
        self.updates += 1;
        let y = self.target(batch);
        let q = self.end(&self.critics.forward(&batch.observation, &batch.action));
        // [2, B] - [B]: both critics against one target.
        let error = (&q - &y).square().mean_dim([1i64].as_slice(), false, Kind::Float);
        let gradient = self.critics.params.gradient(&error.sum(Kind::Float));
        self.critics_adam.step(self.critics.params.flat_mut(), &gradient);
        let mut actor_loss = None;
        if self.updates.is_multiple_of(self.params.policy_frequency) {
            if self.updates > self.params.critics_first {
                let loss = self.actor_loss(batch);
                let gradient = self.actor.params.gradient(&loss);
                self.actor_adam.step(self.actor.params.flat_mut(), &gradient);
                actor_loss = Some(loss);
            }
            self.actor_target.params.follow(&self.actor.params, self.params.tau);
            self.critics_target.params.follow(&self.critics.params, self.params.tau);
        }
        if let Some(metrics) = metrics {
            let values = no_grad(|| self.meaning(&q.mean_dim([1i64].as_slice(), false, Kind::Float)));
            metrics.add_pair(["losses/qf1_loss", "losses/qf2_loss"], &error);
            metrics.add_pair(["losses/qf1_values", "losses/qf2_values"], &values);
            if let Some(loss) = actor_loss {
                metrics.add("losses/actor_loss", &loss);
            }
        }
    }

    /// One step of behaviour cloning: the actor and its target only.
    pub fn clone_expert(&mut self, batch: &Batch, learning_rate: f64) {
        let loss = cloning_loss(batch, &self.actor.forward(&batch.observation), &self.half);
        let gradient = self.actor.params.gradient(&loss);
        self.actor_adam.learning_rate = learning_rate;
        self.actor_adam.step(self.actor.params.flat_mut(), &gradient);
        self.actor_adam.learning_rate = self.params.actor_learning_rate;
        self.actor_target.params.set(self.actor.params.flat());
    }

    /// y = r + gamma (1 - terminated) min(Q1', Q2')(s', pi'(s') + clipped noise), in the end's units.
    fn target(&self, batch: &Batch) -> Tensor {
        no_grad(|| {
            let p = &self.params;
            let noise = (&batch.noise * p.policy_noise).clamp(-p.noise_clip, p.noise_clip) * &self.half;
            let action = (self.actor_target.forward(&batch.next_observation) + noise)
                .clamp_tensor(Some(&self.low), Some(&self.high));
            let q = self.end(&self.critics_target.forward(&batch.next_observation, &action));
            let q = q.amin([0i64].as_slice(), false);
            match p.critic_end {
                CriticEnd::Linear => &batch.reward + &batch.discount * q,
                CriticEnd::Sigmoid { low, high } => {
                    let y = &batch.reward + &batch.discount * (q * (high - low) + low);
                    ((y - low) / (high - low)).clamp(0.0, 1.0)
                }
            }
        })
    }

    /// -mean Q1(s, pi(s)), plus imitation if it is on, plus what keeps actions off the flat ends of their sigmoids.
    fn actor_loss(&self, batch: &Batch) -> Tensor {
        let p = &self.params;
        let (action, saturation) = self.actor.forward_with_saturation(&batch.observation);
        let q = self.end(&self.critics.first(&batch.observation, &action));
        let weight = p.imitation.at(self.updates);
        if weight == 0.0 {
            return saturation.mean(Kind::Float) * p.saturation - q.mean(Kind::Float);
        }
        // In units of the return: the sigmoid's own size says nothing about the return's.
        let shown = || self.meaning(&self.end(&self.critics.first(&batch.observation, &batch.shown)));
        p.imitation.loss(weight, batch, &action, &self.half, &self.meaning(&q), shown)
            + saturation.mean(Kind::Float) * p.saturation
    }

    /// What the critics expect, the lower of both (scaled rewards), `[B]`.
    pub fn value(&self, observation: &Tensor, action: &Tensor) -> Tensor {
        let q = self.end(&self.critics.forward(observation, action));
        self.meaning(&q.amin([0i64].as_slice(), false))
    }

    /// The critics' last activation.
    fn end(&self, q: &Tensor) -> Tensor {
        match self.params.critic_end {
            CriticEnd::Linear => q.shallow_clone(),
            CriticEnd::Sigmoid { .. } => q.sigmoid(),
        }
    }

    /// The critics' output as a return.
    fn meaning(&self, q: &Tensor) -> Tensor {
        match self.params.critic_end {
            CriticEnd::Linear => q.shallow_clone(),
            CriticEnd::Sigmoid { low, high } => q * (high - low) + low,
        }
    }
}
