//! Training of the driving agents: collectors drive, one learner learns, the curriculum moves on.
//!
//! ```text
//! collector 1 (env, SUMO, actor's copy) --segments--\
//! collector 2 ...                       --segments----> learner: replay buffer, TD3 or SAC
//!        ^---- episodes from the schedule, newest actor ----/
//! ```
//!
//! The channel between them is short: where the learner falls behind its fixed ratio of updates to
//! steps, collectors wait; where it is ahead, it waits. So what is learned does not depend on
//! the speed of either.

mod checkpoint;
mod collector;
mod config;
mod learning;
mod log;
mod other_days;
mod recording;
mod schedule;
#[cfg(test)]
mod tests;

pub use checkpoint::Best;
pub use collector::Times;
pub use config::{TrainConfig, ValidationParams};
pub use learning::train;

use crate::agent::learner::Misfit;
use crate::agent::policy::PolicyError;
use crate::agent::replay_buffer::BufferError;
use crate::env::{Env, EnvError, EnvOptions};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Duration;
use tch::Device;
use wad_see::latent::Encoder;

/// How long a run goes on, with what and where: may change when it is resumed.
#[derive(Clone, Debug)]
pub struct Limits {
    /// Environment steps of the agent, those before a resume included.
    pub steps: u64,
    /// Wall time of this call.
    pub time: Option<Duration>,
    pub collectors: usize,
    /// Where the learner computes; collectors act on the CPU.
    pub device: Device,
    pub out: PathBuf,
    /// Where episodes are kept with their images, if anywhere.
    pub record: Option<PathBuf>,
}

/// Makes an environment that sees through an encoder.
type MakeEnv = dyn Fn(EnvOptions, Box<dyn Encoder>) -> Result<Env, EnvError> + Send + Sync;

/// Makes environments, each on the thread that will use it.
pub struct Maker {
    pub env: Box<MakeEnv>,
    /// The encoder that they see through.
    pub encoder: Box<dyn Fn() -> Result<Box<dyn Encoder>, EnvError> + Send + Sync>,
}

/// Why training stopped.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    #[error(transparent)]
    Env(#[from] EnvError),
    #[error(transparent)]
    Buffer(#[from] BufferError),
    #[error(transparent)]
    Policy(#[from] PolicyError),
    #[error(transparent)]
    Misfit(#[from] Misfit),
    #[error("the training's configuration is invalid: {0}")]
    Config(String),
    #[error("could not write `{}`: {source}; what was written before stays", path.display())]
    Write { path: PathBuf, source: std::io::Error },
    #[error("could not read `{}`: {source}", path.display())]
    Read { path: PathBuf, source: std::io::Error },
    #[error("`{}` is not a training's configuration: {why}", path.display())]
    ConfigFile { path: PathBuf, why: String },
    #[error("`{}` already holds a training; go on with --resume, or name another folder with --out", path.display())]
    Taken { path: PathBuf },
    #[error("nothing to resume in `{}`: {why}", folder.display())]
    NoCheckpoint { folder: PathBuf, why: String },
    #[error(
        "learning diverged at step {steps}: {what} is not a number. {kept}; \
         go on from there with a smaller learning rate or another seed"
    )]
    Diverged { steps: u64, what: String, kept: String },
    #[error("a collector failed: {0}")]
    Broken(String),
    #[error("cannot start a thread: {0}")]
    Thread(std::io::Error),
}

/// What a progress bar shows.
#[derive(Clone, Debug)]
pub struct Progress<'a> {
    pub steps: u64,
    pub demonstrated: u64,
    pub updates: u64,
    /// Task of the present stage, its number and how many there are.
    pub task: &'a str,
    pub stage: usize,
    pub stages: usize,
    /// Success of the stage's last episodes.
    pub success_rate: f64,
    pub mean_return: f64,
    pub validating: bool,
    /// Something worth a line of its own.
    pub news: Option<String>,
}

/// The result of a training; `summary.json`.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Trained {
    pub algorithm: String,
    pub seed: u64,
    pub steps: u64,
    pub demonstrated: u64,
    pub updates: u64,
    pub episodes: u64,
    pub stage: usize,
    pub stage_task: String,
    /// The last stage's threshold has been passed.
    pub curriculum_done: bool,
    pub best: Option<Best>,
    /// Of this call, and of all calls together (s).
    pub wall_seconds: f64,
    pub total_seconds: f64,
    /// While both collected and learned.
    pub env_steps_per_s: f64,
    pub updates_per_s: f64,
    /// Milliseconds per environment step, by stage, summed over collectors; `update` per update.
    pub stages: BTreeMap<&'static str, f64>,
    pub interrupted: bool,
    pub out: PathBuf,
}
