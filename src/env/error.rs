//! What can go wrong in an environment.

use crate::bridge::BridgeError;
use crate::bundled::ResolveError;
use crate::camera::CameraError;
use crate::latent::LatentError;
use crate::network::NetworkError;
use crate::perception::PerceptionError;
use crate::scenario::ScenarioError;
use crate::sumo_config::ConfigError;
use crate::tasks::TaskError;
use crate::traci::process::InstallError;

/// Why an environment cannot be made or go on.
#[derive(Debug, thiserror::Error)]
pub enum EnvError {
    #[error(transparent)]
    Resolve(#[from] ResolveError),
    #[error(transparent)]
    Config(#[from] ConfigError),
    #[error(transparent)]
    Network(#[from] NetworkError),
    #[error(transparent)]
    Install(#[from] InstallError),
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    #[error(transparent)]
    Task(#[from] TaskError),
    #[error(transparent)]
    Bridge(#[from] BridgeError),
    #[error(transparent)]
    Camera(#[from] CameraError),
    #[error(transparent)]
    Perception(#[from] PerceptionError),
    #[error(transparent)]
    Latent(#[from] LatentError),
    #[error("no episode is under way: call reset first")]
    NoEpisode,
    #[error(
        "SUMO failed {attempts} times in a row at the start of an episode of `{task}` with seed {seed}; the last time: {source}"
    )]
    Start { attempts: usize, task: String, seed: u64, source: Box<BridgeError> },
    #[error(
        "no free place for `{task}` in {town} after {tries} draws: too much traffic; ask for fewer vehicles"
    )]
    Crowded { task: String, town: String, tries: usize },
    #[error("cannot make a folder for SUMO's files: {source}; check that the temporary folder is writable")]
    Folder { source: std::io::Error },
    #[error("cannot start the asynchronous runtime: {source}")]
    Runtime { source: std::io::Error },
}

impl EnvError {
    /// True where the user's input is at fault, not SUMO.
    pub fn is_input(&self) -> bool {
        match self {
            Self::Resolve(_)
            | Self::Config(_)
            | Self::Network(_)
            | Self::Scenario(_)
            | Self::Task(_)
            | Self::Crowded { .. } => true,
            Self::Bridge(bridge) => bridge.is_input(),
            Self::Start { source, .. } => source.is_input(),
            _ => false,
        }
    }

    /// True where SUMO is at fault.
    pub fn is_sumo(&self) -> bool {
        matches!(self, Self::Bridge(_) | Self::Start { .. } | Self::Install(_)) && !self.is_input()
    }
}
