//! What can go wrong in an environment.

use wad_see::eyes::EyesError;
use wad_sim::assets::AssetsError;
use wad_sim::bridge::BridgeError;
use wad_sim::tasks::TaskError;

/// Why an environment cannot be made or go on.
#[derive(Debug, thiserror::Error)]
pub enum EnvError {
    #[error(transparent)]
    Assets(#[from] AssetsError),
    #[error(transparent)]
    Eyes(#[from] EyesError),
    #[error(transparent)]
    Task(#[from] TaskError),
    #[error(transparent)]
    Bridge(#[from] BridgeError),
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
            Self::Task(_) | Self::Crowded { .. } => true,
            Self::Assets(assets) => assets.is_input(),
            Self::Bridge(bridge) => bridge.is_input(),
            Self::Start { source, .. } => source.is_input(),
            _ => false,
        }
    }

    /// True where SUMO is at fault.
    pub fn is_sumo(&self) -> bool {
        matches!(self, Self::Bridge(_) | Self::Start { .. } | Self::Assets(_)) && !self.is_input()
    }
}
