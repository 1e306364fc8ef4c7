//! TD3 or SAC behind one face: batches in, an actor out, and a state that can be saved.

use super::action::{ACTION_SIZE, Action};
use super::networks::{ActorT, Dims, Params, PolicyS};
use super::replay_buffer::Sampled;
use super::sac::{Sac, SacParams};
use super::td3::{Td3, Td3Params};
use crate::optim::Adam;
use rand::{Rng, RngExt};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use tch::{Device, Kind, Tensor, no_grad};

/// What learns, with its constants.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "algo", rename_all = "snake_case", deny_unknown_fields)]
pub enum Algorithm {
    /// WAD-T.
    Td3(Td3Params),
    /// WAD-S.
    Sac(SacParams),
}

impl Algorithm {
    /// Discount per tick.
    pub fn gamma(&self) -> f64 {
        match self {
            Self::Td3(params) => params.gamma,
            Self::Sac(params) => params.gamma,
        }
    }

    /// What the paper calls the agent: `wad-t`, `wad-s`.
    pub fn agent_name(&self) -> &'static str {
        match self {
            Self::Td3(_) => "wad-t",
            Self::Sac(_) => "wad-s",
        }
    }
}

/// One update's transitions, on the learner's device, observations scaled.
#[derive(Debug)]
pub struct Batch {
    /// [B, latent + raw]
    pub observation: Tensor,
    pub next_observation: Tensor,
    /// [B, A]
    pub action: Tensor,
    /// [B], scaled.
    pub reward: Tensor,
    /// gamma^n, or 0 where the episode terminated, [B].
    pub discount: Tensor,
    /// 1 where an expert's action is known, [B], and that action, [B, A].
    pub is_shown: Tensor,
    pub shown: Tensor,
    /// Standard normal, [B, A]: all the chance that an update takes.
    pub noise: Tensor,
}

/// Several batches, brought to the device together.
#[derive(Debug)]
pub struct Batches {
    /// [K, 2, B, D]: now and next.
    observations: Tensor,
    /// [K, B, 3 A + 3]: action, noise, reward, discount, whether shown, the shown action.
    rest: Tensor,
    actions: i64,
}

impl Batches {
    /// Takes what the replay buffer sampled to `device`, and scales the observations.
    ///
    /// # Panics
    /// `sampled` is not of `dims`.
    pub fn upload(sampled: &Sampled, dims: Dims, scale: &Scale, device: Device) -> Self {
        let (k, b) = (sampled.batches as i64, sampled.size as i64);
        let bytes = unsafe {
            std::slice::from_raw_parts(sampled.latents.as_ptr().cast::<u8>(), 2 * sampled.latents.len())
        };
        let latents = Tensor::from_data_size(bytes, &[k, 2, b, dims.latent], Kind::Half);
        let latents = latents.to_device(device).to_kind(Kind::Float);
        let raw = Tensor::from_slice(&sampled.raw).view([k, 2, b, dims.raw]).to_device(device);
        let observations = scale.apply(&Tensor::cat(&[latents, raw], 3));
        let rest = Tensor::from_slice(&sampled.rest).view([k, b, 3 * dims.actions + 3]).to_device(device);
        Self { observations, rest, actions: dims.actions }
    }

    /// Adds to each latent, now and next alike, a share of the difference between two others of its batch, drawn
    /// with `rng` evenly from 0 to `most` per transition: what is learned then rests less on how a day looks.
    pub fn mix_latents(&self, dims: Dims, most: f64, rng: &mut impl Rng) {
        no_grad(|| {
            let mut latents = self.observations.narrow(3, 0, dims.latent);
            let others = latents.select(1, 0);
            let (k, b) = (others.size()[0], others.size()[1]);
            let share: Vec<f32> = (0..k * b).map(|_| rng.random::<f32>() * most as f32).collect();
            let share = Tensor::from_slice(&share).view([k, b, 1]).to_device(latents.device());
            let difference = (others.roll(1, 1) - others.roll(2, 1)) * share;
            let _ = latents.g_add_(&difference.unsqueeze(1));
        });
    }

    /// Batch `i`.
    pub fn get(&self, i: usize) -> Batch {
        let observations = self.observations.get(i as i64);
        let rest = self.rest.get(i as i64);
        let a = self.actions;
        Batch {
            observation: observations.get(0),
            next_observation: observations.get(1),
            action: rest.narrow(1, 0, a),
            noise: rest.narrow(1, a, a),
            reward: rest.select(1, 2 * a),
            discount: rest.select(1, 2 * a + 1),
            is_shown: rest.select(1, 2 * a + 2),
            shown: rest.narrow(1, 2 * a + 3, a),
        }
    }
}

/// Which inputs an agent sees; what it does not see is 0. For ablations.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Inputs {
    #[default]
    Both,
    Latent,
    Raw,
}

/// What makes of an observation about -1 to 1: x' = (x - offset) factor. Measured once, on the first
/// experience, and part of the actor from then on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct InputScale {
    pub offset: Vec<f32>,
    pub factor: Vec<f32>,
}

impl InputScale {
    /// Leaves observations as they are.
    pub fn identity(dims: Dims) -> Self {
        let n = dims.observation() as usize;
        Self { offset: vec![0.0; n], factor: vec![1.0; n] }
    }

    /// From means and standard deviations of the latent; the raw vector is scaled by definition. Numbers
    /// that hardly vary are not blown up: the smallest deviation taken is a tenth of the mean one. `gain` is the deviation
    /// that the latent is given.
    pub fn measured(mean: &[f32], deviation: &[f32], dims: Dims, inputs: Inputs, gain: f64) -> Self {
        let (latent, n) = (dims.latent as usize, dims.observation() as usize);
        let floor = 0.1 * deviation[..latent].iter().sum::<f32>() / (latent as f32).max(1.0);
        let mut scale = Self::identity(dims);
        scale.offset[..latent].copy_from_slice(&mean[..latent]);
        for (factor, deviation) in scale.factor[..latent].iter_mut().zip(deviation) {
            *factor = gain as f32 / deviation.max(floor).max(1e-6);
        }
        match inputs {
            Inputs::Both => {}
            Inputs::Latent => scale.factor[latent..n].fill(0.0),
            Inputs::Raw => scale.factor[..latent].fill(0.0),
        }
        scale
    }

    /// On a device.
    pub fn tensors(&self, device: Device) -> Scale {
        Scale {
            offset: Tensor::from_slice(&self.offset).to_device(device),
            factor: Tensor::from_slice(&self.factor).to_device(device),
        }
    }
}

/// [`InputScale`] as tensors.
#[derive(Debug)]
pub struct Scale {
    offset: Tensor,
    factor: Tensor,
}

impl Scale {
    /// Scales observations [.., D].
    pub fn apply(&self, observation: &Tensor) -> Tensor {
        (observation - &self.offset) * &self.factor
    }
}

/// Sums of figures, kept on the device until someone reads them.
#[derive(Debug, Default)]
pub struct Metrics {
    sums: BTreeMap<&'static str, (Tensor, u32)>,
}

impl Metrics {
    pub(super) fn add(&mut self, name: &'static str, value: &Tensor) {
        no_grad(|| match self.sums.get_mut(name) {
            Some((sum, count)) => {
                *sum += value;
                *count += 1;
            }
            None => {
                self.sums.insert(name, (value.detach().copy(), 1));
            }
        });
    }

    pub(super) fn add_pair(&mut self, names: [&'static str; 2], pair: &Tensor) {
        for (i, name) in names.into_iter().enumerate() {
            self.add(name, &pair.get(i as i64));
        }
    }

    /// The means since the last call.
    pub fn take(&mut self) -> BTreeMap<&'static str, f64> {
        std::mem::take(&mut self.sums)
            .into_iter()
            .map(|(name, (sum, count))| (name, sum.double_value(&[]) / f64::from(count)))
            .collect()
    }
}

/// A saved state that does not fit.
#[derive(Debug, thiserror::Error)]
#[error(
    "tensor `{name}`: expected {expected} numbers, found {found}; the file belongs to networks of another form"
)]
pub struct Misfit {
    pub name: String,
    pub expected: i64,
    pub found: String,
}

/// TD3 or SAC.
#[derive(Debug)]
pub enum Learner {
    Td3(Box<Td3>),
    Sac(Box<Sac>),
}

/// Updates between two that are measured.
const MEASURE_EVERY: u64 = 16;

impl Learner {
    /// New networks, drawn from `seed`.
    pub fn new(algorithm: &Algorithm, dims: Dims, seed: u64, device: Device) -> Self {
        wad_see::torch::one_thread();
        let mut rng = sumo_network::seeds::rng(seed, "networks");
        match algorithm {
            Algorithm::Td3(params) => Self::Td3(Box::new(Td3::new(params.clone(), dims, &mut rng, device))),
            Algorithm::Sac(params) => Self::Sac(Box::new(Sac::new(params.clone(), dims, &mut rng, device))),
        }
    }

    /// Updates so far.
    pub fn updates(&self) -> u64 {
        match self {
            Self::Td3(td3) => td3.updates,
            Self::Sac(sac) => sac.updates,
        }
    }

    /// One update. Every so often `metrics` hears of it.
    pub fn update(&mut self, batch: &Batch, metrics: &mut Metrics) {
        // Measured updates must meet those of the actor.
        let metrics = (self.updates() % MEASURE_EVERY == MEASURE_EVERY - 1).then_some(metrics);
        match self {
            Self::Td3(td3) => td3.update(batch, metrics),
            Self::Sac(sac) => sac.update(batch, metrics),
        }
    }

    /// One step of behaviour cloning: the actor alone imitates; this counts as no update.
    pub fn clone_expert(&mut self, batch: &Batch, learning_rate: f64) {
        match self {
            Self::Td3(td3) => td3.clone_expert(batch, learning_rate),
            Self::Sac(sac) => sac.clone_expert(batch, learning_rate),
        }
    }

    fn actor_params(&self) -> &Params {
        match self {
            Self::Td3(td3) => &td3.actor.params,
            Self::Sac(sac) => &sac.policy.params,
        }
    }

    /// Begins with an actor's parameters; whatever follows it follows from there.
    ///
    /// # Errors
    /// They are of another number.
    pub fn set_actor(&mut self, values: &[f32]) -> Result<(), Misfit> {
        match self {
            Self::Td3(td3) => {
                fill(&mut td3.actor.params, values)?;
                fill(&mut td3.actor_target.params, values)
            }
            Self::Sac(sac) => fill(&mut sac.policy.params, values),
        }
    }

    /// The actor's parameters, on the CPU.
    pub fn actor_values(&self) -> Vec<f32> {
        self.actor_params().values()
    }

    /// Every tensor of the state by name, flat, on its device; counters apart.
    pub fn tensors(&mut self) -> Vec<(&'static str, &mut Tensor)> {
        match self {
            Self::Td3(td3) => vec![
                ("actor", td3.actor.params.flat_mut()),
                ("actor_target", td3.actor_target.params.flat_mut()),
                ("critics", td3.critics.params.flat_mut()),
                ("critics_target", td3.critics_target.params.flat_mut()),
                ("actor_adam.m", &mut td3.actor_adam.m),
                ("actor_adam.v", &mut td3.actor_adam.v),
                ("critics_adam.m", &mut td3.critics_adam.m),
                ("critics_adam.v", &mut td3.critics_adam.v),
            ],
            Self::Sac(sac) => vec![
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
        }
    }

    /// Updates, and the steps of each optimiser.
    pub fn counters(&mut self) -> (u64, Vec<i64>) {
        let updates = self.updates();
        (updates, self.adams().into_iter().map(|adam| adam.t).collect())
    }

    fn adams(&mut self) -> Vec<&mut Adam> {
        match self {
            Self::Td3(td3) => vec![&mut td3.actor_adam, &mut td3.critics_adam],
            Self::Sac(sac) => {
                vec![&mut sac.policy_adam, &mut sac.critics_adam, &mut sac.value_adam, &mut sac.alpha_adam]
            }
        }
    }

    /// Goes on from a saved state.
    ///
    /// # Errors
    /// A tensor or counter is missing, or has another size.
    pub fn restore(
        &mut self,
        saved: &BTreeMap<String, Tensor>,
        updates: u64,
        steps: &[i64],
    ) -> Result<(), Misfit> {
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
        match self {
            Self::Td3(td3) => td3.updates = updates,
            Self::Sac(sac) => sac.updates = updates,
        }
        Ok(())
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

/// An actor on the CPU, for one thread: what collectors and trained agents act with.
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
    /// An actor of the form that `algorithm` has, its parameters still to be [`Actor::set`].
    pub fn new(algorithm: &Algorithm, dims: Dims, scale: &InputScale) -> Self {
        wad_see::torch::one_thread();
        let mut rng = sumo_network::seeds::rng(0, "networks");
        let net = match algorithm {
            Algorithm::Td3(_) => Net::T(ActorT::new(dims, &mut rng, Device::Cpu)),
            Algorithm::Sac(_) => Net::S(PolicyS::new(dims, &mut rng, Device::Cpu)),
        };
        Self { net, scale: scale.tensors(Device::Cpu), dims }
    }

    /// Takes over parameters.
    ///
    /// # Errors
    /// They are of another number.
    pub fn set(&mut self, values: &[f32]) -> Result<(), Misfit> {
        match &mut self.net {
            Net::T(actor) => fill(&mut actor.params, values),
            Net::S(policy) => fill(&mut policy.params, values),
        }
    }

    /// Takes over another scale of the inputs.
    pub fn set_scale(&mut self, scale: &InputScale) {
        self.scale = scale.tensors(Device::Cpu);
    }

    /// The action for `observation` (latent, then raw), without chance.
    ///
    /// # Panics
    /// The observation has another size than the network's.
    pub fn act(&self, observation: &[f32]) -> Action {
        self.run(observation, None)
    }

    /// WAD-S draws its action with standard normal `noise`; WAD-T has no chance in it.
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

    /// Whether exploration comes from the policy's own chance (WAD-S) rather than from added noise.
    pub fn is_stochastic(&self) -> bool {
        matches!(self.net, Net::S(_))
    }
}
