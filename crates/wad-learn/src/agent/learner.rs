//! TD3 or SAC behind one interface: batches in, an actor out, and a state that can be saved.

use super::action::{ACTION_SIZE, Action};
use super::batch::{Batch, InputScale, Metrics, Scale};
use super::networks::{ActorT, Dims, Params, PolicyS, flat_values};
pub use super::params::{Algorithm, Misfit};
use super::sac::Sac;
use super::td3::Td3;
use crate::optim::Adam;
use std::collections::BTreeMap;
use tch::{Device, Tensor, no_grad};

/// TD3 or SAC, and the average of its actor.
#[derive(Debug)]
pub struct Learner {
    networks: Networks,
    average: Average,
}

#[derive(Debug)]
enum Networks {
    /// WAD-T.
    Td3(Box<Td3>),
    /// WAD-S.
    Sac(Box<Sac>),
}

/// The mean of the actor's parameters over its last updates, exponentially weighted (after Polyak and Juditsky 1992).
#[derive(Debug)]
struct Average {
    /// Updates over which the weight of an actor falls to 1/e; 0: the newest actor alone counts.
    updates: u64,
    /// The flat parameters; None while it is the actor itself.
    values: Option<Tensor>,
}

impl Average {
    /// Takes in the actor after `done` updates of it. The first ones count alike.
    fn add(&mut self, actor: &Tensor, done: u64) {
        if self.updates == 0 {
            return;
        }
        let share = 1.0 / done.clamp(1, self.updates) as f64;
        no_grad(|| match &mut self.values {
            Some(values) => _ = values.lerp_(actor, share),
            none => *none = Some(actor.detach().copy()),
        });
    }
}

/// The average's name in a checkpoint.
const AVERAGE: &str = "actor_average";
/// Updates between two that are measured.
const MEASURE_EVERY: u64 = 16;

impl Learner {
    /// New networks, drawn from `seed`.
    pub fn new(algorithm: &Algorithm, dims: Dims, seed: u64, device: Device) -> Self {
        wad_see::torch::one_thread();
        let mut rng = sumo_network::seeds::rng(seed, "networks");
        let (networks, updates) = match algorithm {
            Algorithm::Td3(params) => {
                let td3 = Td3::new(params.clone(), dims, &mut rng, device);
                (Networks::Td3(Box::new(td3)), params.actor_average)
            }
            Algorithm::Sac(params) => {
                let sac = Sac::new(params.clone(), dims, &mut rng, device);
                (Networks::Sac(Box::new(sac)), params.actor_average)
            }
        };
        Self { networks, average: Average { updates, values: None } }
    }

    /// Updates so far.
    pub fn updates(&self) -> u64 {
        match &self.networks {
            Networks::Td3(td3) => td3.updates,
            Networks::Sac(sac) => sac.updates,
        }
    }

    /// One update. Every so often it adds to `metrics`.
    pub fn update(&mut self, batch: &Batch, metrics: &mut Metrics) {
        // Measured updates must meet those of the actor.
        let metrics = (self.updates() % MEASURE_EVERY == MEASURE_EVERY - 1).then_some(metrics);
        match &mut self.networks {
            Networks::Td3(td3) => td3.update(batch, metrics),
            Networks::Sac(sac) => sac.update(batch, metrics),
        }
        self.average.add(actor_params(&self.networks).flat(), self.updates());
    }

    /// The discounted return that the critics expect of `action` after the scaled `observation` (scaled rewards);
    /// WAD-S' holds its entropy bonus too.
    pub fn value(&self, observation: &Tensor, action: &Action) -> f64 {
        no_grad(|| {
            let observation = observation.unsqueeze(0);
            let action = Tensor::from_slice(action).unsqueeze(0).to_device(observation.device());
            let value = match &self.networks {
                Networks::Td3(td3) => td3.value(&observation, &action),
                Networks::Sac(sac) => {
                    sac.critics.forward(&observation, &action).amin([0i64].as_slice(), false)
                }
            };
            value.double_value(&[0])
        })
    }

    /// One step of behaviour cloning: trains only the actor; it does not count as an update.
    pub fn clone_expert(&mut self, batch: &Batch, learning_rate: f64) {
        match &mut self.networks {
            Networks::Td3(td3) => td3.clone_expert(batch, learning_rate),
            Networks::Sac(sac) => sac.clone_expert(batch, learning_rate),
        }
    }

    /// Sets the actor's parameters, and those of its target network.
    ///
    /// # Errors
    /// The number of parameters differs.
    pub fn set_actor(&mut self, values: &[f32]) -> Result<(), Misfit> {
        self.average.values = None;
        match &mut self.networks {
            Networks::Td3(td3) => {
                fill(&mut td3.actor.params, values)?;
                fill(&mut td3.actor_target.params, values)
            }
            Networks::Sac(sac) => fill(&mut sac.policy.params, values),
        }
    }

    /// The newest actor's parameters, on the CPU: it explores.
    pub fn actor_values(&self) -> Vec<f32> {
        actor_params(&self.networks).values()
    }

    /// The parameters of the actor that is kept and validated, on the CPU: the average, where one is asked for.
    pub fn kept_actor_values(&self) -> Vec<f32> {
        self.average.values.as_ref().map_or_else(|| self.actor_values(), flat_values)
    }

    /// Every tensor of the state by name, flat, on its device; without counters.
    pub fn tensors(&mut self) -> Vec<(&'static str, &mut Tensor)> {
        let mut tensors = match &mut self.networks {
            Networks::Td3(td3) => vec![
                ("actor", td3.actor.params.flat_mut()),
                ("actor_target", td3.actor_target.params.flat_mut()),
                ("critics", td3.critics.params.flat_mut()),
                ("critics_target", td3.critics_target.params.flat_mut()),
                ("actor_adam.m", &mut td3.actor_adam.m),
                ("actor_adam.v", &mut td3.actor_adam.v),
                ("critics_adam.m", &mut td3.critics_adam.m),
                ("critics_adam.v", &mut td3.critics_adam.v),
            ],
            Networks::Sac(sac) => vec![
                ("policy", sac.policy.params.flat_mut()),
                ("critics", sac.critics.params.flat_mut()),
                ("value", sac.value.params.flat_mut()),
                ("value_target", sac.value_target.params.flat_mut()),
                ("log_alpha", &mut sac.log_alpha),
                ("policy_adam.m", &mut sac.policy_adam.m),
                ("policy_adam.v", &mut sac.policy_adam.v),
                ("critics_adam.m", &mut sac.critics_adam.m),
                ("critics_adam.v", &mut sac.critics_adam.v),
                ("value_adam.m", &mut sac.value_adam.m),
                ("value_adam.v", &mut sac.value_adam.v),
                ("alpha_adam.m", &mut sac.alpha_adam.m),
                ("alpha_adam.v", &mut sac.alpha_adam.v),
            ],
        };
        tensors.extend(self.average.values.as_mut().map(|values| (AVERAGE, values)));
        tensors
    }

    /// Updates, and the steps of each optimiser.
    pub fn counters(&mut self) -> (u64, Vec<i64>) {
        let updates = self.updates();
        (updates, self.adams().into_iter().map(|adam| adam.t).collect())
    }

    fn adams(&mut self) -> Vec<&mut Adam> {
        match &mut self.networks {
            Networks::Td3(td3) => vec![&mut td3.actor_adam, &mut td3.critics_adam],
            Networks::Sac(sac) => {
                vec![&mut sac.policy_adam, &mut sac.critics_adam, &mut sac.value_adam, &mut sac.alpha_adam]
            }
        }
    }

    /// Restores a saved state.
    ///
    /// # Errors
    /// A tensor or counter is missing, or has another size.
    pub fn restore(
        &mut self,
        saved: &BTreeMap<String, Tensor>,
        updates: u64,
        steps: &[i64],
    ) -> Result<(), Misfit> {
        // A checkpoint of before its first update has none; one that is no longer asked for would stand still.
        let kept = saved.get(AVERAGE).filter(|_| self.average.updates > 0);
        self.average.values = kept.map(|_| actor_params(&self.networks).flat().detach().copy());
        for (name, tensor) in self.tensors() {
            let expected = tensor.size();
            match saved.get(name) {
                Some(found) if found.size() == expected => no_grad(|| tensor.copy_(found)),
                found => {
                    return Err(Misfit {
                        name: name.to_string(),
                        expected: expected.iter().product(),
                        found: found.map_or("none".to_string(), |t| t.numel().to_string()),
                    });
                }
            }
        }
        let adams = self.adams();
        if adams.len() != steps.len() {
            return Err(Misfit {
                name: "optimiser steps".to_string(),
                expected: adams.len() as i64,
                found: steps.len().to_string(),
            });
        }
        for (adam, t) in adams.into_iter().zip(steps) {
            adam.t = *t;
        }
        match &mut self.networks {
            Networks::Td3(td3) => td3.updates = updates,
            Networks::Sac(sac) => sac.updates = updates,
        }
        Ok(())
    }
}

fn actor_params(networks: &Networks) -> &Params {
    match networks {
        Networks::Td3(td3) => &td3.actor.params,
        Networks::Sac(sac) => &sac.policy.params,
    }
}

/// Gives an actor's network its parameters.
fn fill(params: &mut Params, values: &[f32]) -> Result<(), Misfit> {
    let (expected, found) = (params.size(), values.len());
    if expected != found as i64 {
        return Err(Misfit { name: "actor".to_string(), expected, found: found.to_string() });
    }
    params.set(&Tensor::from_slice(values));
    Ok(())
}

/// An actor on the CPU, for one thread, for collectors and trained agents.
#[derive(Debug)]
pub struct Actor {
    net: Net,
    scale: Scale,
    dims: Dims,
}

#[derive(Debug)]
enum Net {
    T(ActorT),
    S(PolicyS),
}

impl Actor {
    /// An actor of `algorithm`'s form; set its parameters with [`Actor::set`].
    pub fn new(algorithm: &Algorithm, dims: Dims, scale: &InputScale) -> Self {
        wad_see::torch::one_thread();
        let mut rng = sumo_network::seeds::rng(0, "networks");
        let net = match algorithm {
            Algorithm::Td3(_) => Net::T(ActorT::new(dims, &mut rng, Device::Cpu)),
            Algorithm::Sac(_) => Net::S(PolicyS::new(dims, &mut rng, Device::Cpu)),
        };
        Self { net, scale: scale.tensors(Device::Cpu), dims }
    }

    /// Sets the parameters.
    ///
    /// # Errors
    /// The number of parameters differs.
    pub fn set(&mut self, values: &[f32]) -> Result<(), Misfit> {
        match &mut self.net {
            Net::T(actor) => fill(&mut actor.params, values),
            Net::S(policy) => fill(&mut policy.params, values),
        }
    }

    /// Sizes of its inputs and outputs.
    pub fn dims(&self) -> Dims {
        self.dims
    }

    /// Number of parameters.
    pub fn size(&self) -> usize {
        match &self.net {
            Net::T(actor) => actor.params.size() as usize,
            Net::S(policy) => policy.params.size() as usize,
        }
    }

    /// Sets the scale of the inputs.
    pub fn set_scale(&mut self, scale: &InputScale) {
        self.scale = scale.tensors(Device::Cpu);
    }

    /// The deterministic action for `observation` (latent, then raw).
    ///
    /// # Panics
    /// The observation has another size than the network's.
    pub fn act(&self, observation: &[f32]) -> Action {
        self.run(observation, None)
    }

    /// The action in training: WAD-S samples it with standard normal `noise`; WAD-T ignores `noise`.
    ///
    /// # Panics
    /// The observation has another size than the network's.
    pub fn draw(&self, observation: &[f32], noise: Action) -> Action {
        self.run(observation, Some(noise))
    }

    fn run(&self, observation: &[f32], noise: Option<Action>) -> Action {
        no_grad(|| {
            let observation = self.scale.apply(&Tensor::from_slice(observation).view([1, -1]));
            let action = match (&self.net, noise) {
                (Net::T(actor), _) => actor.forward(&observation),
                (Net::S(policy), None) => policy.mean_action(&observation),
                (Net::S(policy), Some(noise)) => {
                    let noise = Tensor::from_slice(&noise[..self.dims.actions as usize]).view([1, -1]);
                    policy.sample(&observation, &noise)
                }
            };
            let mut out = [0.0; ACTION_SIZE];
            let n = self.dims.actions as usize;
            action.copy_data(&mut out[..n], n);
            out
        })
    }

    /// Whether exploration comes from the stochastic policy (WAD-S) rather than from added noise.
    pub fn is_stochastic(&self) -> bool {
        matches!(self.net, Net::S(_))
    }
}
