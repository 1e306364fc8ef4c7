//! A training's settings; saved as its `config.json`.

use crate::agent::batch::Inputs;
use crate::agent::exploration::ExplorationParams;
use crate::agent::learner::Algorithm;
use crate::agent::networks::Dims;
use crate::agent::replay_buffer::Sampling;
use crate::env::EnvOptions;
use crate::one::{is_one, one};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use wad_sim::tasks::Curriculum;

/// Every setting that changes what is learned. Wall time, number of collectors, folder and device are in
/// [`super::Limits`], so that a run can go on elsewhere.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainConfig {
    /// Algorithm and its constants.
    pub algorithm: Algorithm,
    /// The networks' inputs.
    pub inputs: Inputs,
    /// Egos in each collector's SUMO.
    #[serde(default = "one", skip_serializing_if = "is_one")]
    pub egos: u32,
    /// Standard deviation to which the latent is scaled; less than 1 gives the raw states more weight
    /// early in training.
    pub latent_gain: f64,
    /// Share of the images changed to other days, so that other weathers than the training's
    /// are less unfamiliar; never in validation.
    #[serde(default)]
    pub other_days: f64,
    /// Largest share of the difference between two other latents of the batch that is added to each latent
    /// in an update.
    #[serde(default)]
    pub latent_mixing: f64,
    /// The seed of everything random.
    pub seed: u64,
    /// The tasks in order.
    pub curriculum: Curriculum,
    /// The environment's options.
    pub env: EnvOptions,
    /// The encoder's name or file.
    pub encoder: String,
    /// Hash of the encoder's weights.
    pub encoder_hash: String,
    /// Noise on the actions.
    pub exploration: ExplorationParams,
    /// Updates per environment step; 0: drives and does not learn.
    pub update_ratio: f64,
    /// Transitions per update.
    pub batch_size: usize,
    /// Rewards summed before the critic's estimate is used (n-step return); 1 as in the papers.
    pub n_step: usize,
    /// Factor on the rewards.
    pub reward_scale: f64,
    /// Share of each batch that is drawn from the places where episodes end; 0: drawn uniformly.
    #[serde(default)]
    pub near_ends: f64,
    /// Capacity of the replay buffer (transitions).
    pub buffer: usize,
    /// Environment steps before the first update.
    pub learning_starts: u64,
    /// Environment steps that the autopilot drives first, into the replay buffer; 0: none.
    pub demonstrations: u64,
    /// Share of the autopilot's episodes with exploration noise, so that the buffer
    /// holds ways back to the lane's middle as well.
    pub noisy_demonstrations: f64,
    /// Folders of recorded episodes that fill the replay buffer first.
    pub recorded: Vec<PathBuf>,
    /// The trained agent (name or file) whose actor and scale of inputs this training starts with.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub init: Option<String>,
    /// Steps of behaviour cloning before all other updates; trains only the actor.
    #[serde(default)]
    pub cloning: u64,
    /// Adam's initial learning rate for cloning; it falls linearly to a tenth.
    #[serde(default = "cloning_rate")]
    pub cloning_rate: f64,
    /// Updates on the demonstrations before the agent drives.
    pub pretrain: u64,
    /// Choice of the best actor.
    pub validation: ValidationParams,
    /// Environment steps between checkpoints.
    pub checkpoint_every: u64,
    /// Environment steps of the agent, including those before a resume, which may set others.
    #[serde(default = "steps")]
    pub steps: u64,
}

fn cloning_rate() -> f64 {
    1e-3
}

fn steps() -> u64 {
    400_000
}

/// The choice of the best actor by validation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ValidationParams {
    /// Environment steps between validations; 0: never.
    pub every: u64,
    /// Episodes of each of the curriculum's tasks, in fresh worlds, always the same.
    pub episodes: usize,
    /// Their seed; never one of an evaluation.
    pub seed: u64,
}

impl Default for ValidationParams {
    fn default() -> Self {
        Self { every: 50_000, episodes: 4, seed: 900_001 }
    }
}

impl TrainConfig {
    /// The defaults for an algorithm with an encoder.
    pub fn new(algorithm: Algorithm, curriculum: Curriculum, encoder: &str, encoder_hash: &str) -> Self {
        Self {
            algorithm,
            inputs: Inputs::Both,
            egos: 1,
            latent_gain: Inputs::Both.latent_gain(),
            other_days: 0.0,
            latent_mixing: 0.0,
            seed: 0,
            curriculum,
            env: EnvOptions::training(),
            encoder: encoder.to_string(),
            encoder_hash: encoder_hash.to_string(),
            exploration: ExplorationParams::default(),
            update_ratio: 1.0,
            batch_size: 128,
            n_step: 3,
            reward_scale: 1.0,
            near_ends: 0.3,
            buffer: 1_000_000,
            learning_starts: 5_000,
            demonstrations: 0,
            noisy_demonstrations: 0.7,
            recorded: Vec::new(),
            init: None,
            cloning: 0,
            cloning_rate: cloning_rate(),
            pretrain: 0,
            validation: ValidationParams::default(),
            checkpoint_every: 25_000,
            steps: steps(),
        }
    }

    /// The networks' sizes.
    pub fn dims(&self) -> Dims {
        self.inputs.dims()
    }

    /// Drops a part of the observation, in the networks and in the environment; the latent's scale is then
    /// [`Inputs::latent_gain`].
    pub fn set_inputs(&mut self, inputs: Inputs) {
        self.inputs = inputs;
        self.latent_gain = inputs.latent_gain();
        self.env.observation = inputs.observation();
    }

    /// Whether the buffer holds experience before the agent drives.
    pub fn is_warm(&self) -> bool {
        self.demonstrations > 0 || !self.recorded.is_empty()
    }

    /// Whether the expert's action is recorded at every tick.
    pub fn asks(&self) -> bool {
        match &self.algorithm {
            Algorithm::Td3(params) => params.imitation.weight > 0.0,
            Algorithm::Sac(params) => params.imitation.weight > 0.0,
        }
    }

    /// How batches are sampled.
    pub fn sampling(&self) -> Sampling {
        Sampling {
            batch_size: self.batch_size,
            n_step: self.n_step,
            gamma: self.algorithm.gamma(),
            reward_scale: self.reward_scale,
            near_ends: self.near_ends,
        }
    }

    /// The first invalid setting, if there is one.
    pub fn problem(&self) -> Option<String> {
        let gamma = self.algorithm.gamma();
        let alpha = match &self.algorithm {
            Algorithm::Td3(_) => None,
            Algorithm::Sac(params) => Some(params.alpha),
        };
        if !(0.0..1.0).contains(&gamma) {
            Some(format!("expected gamma from 0 to below 1, found {gamma}"))
        } else if let Some(alpha) = alpha.filter(|alpha| !(alpha.is_finite() && *alpha > 0.0)) {
            Some(format!("expected a temperature (alpha) above 0, found {alpha}"))
        } else if self.validation.every > 0 && self.validation.episodes == 0 {
            Some(
                "expected one validation episode or more of each task, found 0; to validate never, --validate-every 0"
                    .to_string(),
            )
        } else if self.inputs == Inputs::Vector && !self.recorded.is_empty() {
            Some("recorded episodes do not serve --inputs vector; leave out one of the two".to_string())
        } else if self.batch_size == 0 || self.n_step == 0 {
            Some("expected a batch size and a number of steps of 1 or more, found 0".to_string())
        } else if !(0.0..=64.0).contains(&self.update_ratio) {
            Some(format!("expected an update ratio from 0 to 64, found {}", self.update_ratio))
        } else if !(0.0..=1.0).contains(&self.near_ends) {
            Some(format!("expected a share of transitions near ends from 0 to 1, found {}", self.near_ends))
        } else if !(0.0..=1.0).contains(&self.other_days) {
            Some(format!("expected a share of other days from 0 to 1, found {}", self.other_days))
        } else if !(0.0..=1.0).contains(&self.latent_mixing) {
            Some(format!("expected a share of other latents from 0 to 1, found {}", self.latent_mixing))
        } else if !(self.cloning_rate > 0.0 && self.cloning_rate <= 0.1) {
            Some(format!("expected a cloning rate above 0 and up to 0.1, found {}", self.cloning_rate))
        } else if self.recorded.is_empty()
            && self.learning_starts + self.demonstrations < self.batch_size as u64
        {
            Some(format!(
                "expected at least a batch ({}) of steps before learning starts, found {}",
                self.batch_size,
                self.learning_starts + self.demonstrations
            ))
        } else if self.pretrain + self.cloning > 0 && !self.is_warm() {
            Some("updates before the agent drives need demonstrations, found none".to_string())
        } else {
            self.curriculum.problem()
        }
    }
}
