//! Training of the driving agents: collectors drive, one learner updates the networks, a curriculum sets the
//! tasks.
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
mod curve;
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
pub use curve::{Curve, StagePassed};
pub use learning::train;

use crate::agent::batch::Inputs;
use crate::agent::learner::Misfit;
use crate::agent::policy::PolicyError;
use crate::agent::replay_buffer::BufferError;
use crate::env::{Assets, EnvError};
use crate::folder_lock::LockError;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;
use tch::Device;
use wad_see::latent::Encoder;
use wad_see::perception::PerceptionError;
use wad_sim::telemetry::WriteError;

/// Time, workers and folder of a call of a training.
#[derive(Clone, Debug)]
pub struct Limits {
    /// Wall time limit of this call.
    pub time: Option<Duration>,
    /// Environments in parallel.
    pub collectors: usize,
    /// The learner's device; collectors use the CPU.
    pub device: Device,
    /// The training's folder.
    pub out: PathBuf,
    /// Folder for recorded episodes; None: they are not kept.
    pub record: Option<PathBuf>,
}

impl Limits {
    /// Why a training with `config` cannot be recorded, if that is asked.
    fn problem(&self, config: &TrainConfig) -> Option<String> {
        self.record.as_ref()?;
        if config.egos > 1 {
            let egos = config.egos;
            Some(format!("--record needs one ego to a SUMO, and --egos is {egos}; leave out one of the two"))
        } else if config.inputs == Inputs::Vector {
            Some("--record does not keep what --inputs vector sees; leave out one of the two".to_string())
        } else {
            None
        }
    }
}

/// What environments are made of, each on the thread that uses it.
pub struct Maker {
    /// Their town.
    pub assets: Arc<Assets>,
    /// Their encoder.
    pub encoder: Box<dyn Fn() -> Result<Box<dyn Encoder>, EnvError> + Send + Sync>,
}

/// Why training stopped.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// An environment cannot be made.
    #[error(transparent)]
    Env(#[from] EnvError),
    /// There is no such detector.
    #[error(transparent)]
    Detector(#[from] PerceptionError),
    /// The replay buffer cannot be made.
    #[error(transparent)]
    Buffer(#[from] BufferError),
    /// An agent's file cannot be read or written.
    #[error(transparent)]
    Policy(#[from] PolicyError),
    /// A saved state does not fit.
    #[error(transparent)]
    Misfit(#[from] Misfit),
    /// The folder cannot be locked.
    #[error(transparent)]
    Lock(#[from] LockError),
    /// A setting is invalid.
    #[error("the training's configuration is invalid: {0}")]
    Config(String),
    /// A file cannot be written.
    #[error("could not write `{}`: {source}; what was written before stays", path.display())]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// A file cannot be read.
    #[error("could not read `{}`: {source}", path.display())]
    Read {
        /// The file or folder.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// A file is not a training's configuration.
    #[error("`{}` is not a training's configuration: {why}", path.display())]
    ConfigFile {
        /// The file or folder.
        path: PathBuf,
        /// The cause.
        why: String,
    },
    /// The folder holds a training already.
    #[error("`{}` already holds a training; continue it with --resume, or name another folder with --out", path.display())]
    Taken {
        /// The file or folder.
        path: PathBuf,
    },
    /// There is no checkpoint to resume from.
    #[error("nothing to resume in `{}`: {why}", folder.display())]
    NoCheckpoint {
        /// The training's folder.
        folder: PathBuf,
        /// The cause.
        why: String,
    },
    /// Learning diverged: a number is not finite.
    #[error("learning diverged at step {steps}: {what} is not a number; {kept}")]
    Diverged {
        /// Environment steps so far.
        steps: u64,
        /// The number.
        what: String,
        /// The rest of the message: which checkpoint is kept, and what to do.
        kept: String,
    },
    /// All collectors have failed.
    #[error("a collector failed: {0}")]
    Broken(String),
    /// A thread cannot be started.
    #[error("cannot start a thread: {0}")]
    Thread(std::io::Error),
}

impl From<WriteError> for TrainError {
    fn from(error: WriteError) -> Self {
        Self::Write { path: error.path, source: error.source }
    }
}

/// Facts for a progress bar.
#[derive(Clone, Debug)]
pub struct Progress<'a> {
    /// Environment steps of the agent.
    pub steps: u64,
    /// Environment steps of the autopilot and of recorded episodes.
    pub demonstrated: u64,
    /// Updates of the networks.
    pub updates: u64,
    /// Task of the present stage.
    pub task: &'a str,
    /// The stage's number, from 0.
    pub stage: usize,
    /// Number of stages.
    pub stages: usize,
    /// Success rate of the stage's last episodes.
    pub success_rate: f64,
    /// Mean return of the agent's last 20 training episodes, of any stage.
    pub mean_return: f64,
    /// A validation is running.
    pub validating: bool,
    /// News for a line of its own.
    pub news: Option<String>,
}

/// The result of a training; `summary.json`.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Trained {
    /// The algorithm's name.
    pub algorithm: String,
    /// The training's seed.
    pub seed: u64,
    /// Environment steps of the agent.
    pub steps: u64,
    /// Environment steps of the autopilot and of recorded episodes.
    pub demonstrated: u64,
    /// Updates of the networks.
    pub updates: u64,
    /// Episodes handed out to collectors: lost and unfinished ones count, validations do not.
    pub episodes: u64,
    /// The last stage's number, from 0.
    pub stage: usize,
    /// The last stage's task.
    pub stage_task: String,
    /// The last stage's threshold has been passed.
    pub curriculum_done: bool,
    /// The best actor's validation; None without a validation.
    pub best: Option<Best>,
    /// Wall time of this call (s).
    pub wall_seconds: f64,
    /// Wall time of all calls together (s).
    pub total_seconds: f64,
    /// Environment steps per second while both collected and learned.
    pub env_steps_per_s: f64,
    /// Updates per second while both collected and learned.
    pub updates_per_s: f64,
    /// Milliseconds per environment step, by stage, summed over collectors; `update` per update.
    pub stages: BTreeMap<&'static str, f64>,
    /// The user interrupted.
    pub interrupted: bool,
    /// The training's folder.
    pub out: PathBuf,
}
