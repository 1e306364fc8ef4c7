//! Errors of an environment.

use wad_see::eyes::EyesError;
use wad_sim::assets::AssetsError;
use wad_sim::bridge::BridgeError;
use wad_sim::tasks::TaskError;

/// Why an environment cannot be made or cannot go on.
#[derive(Debug, thiserror::Error)]
pub enum EnvError {
    /// The town cannot be read.
    #[error(transparent)]
    Assets(#[from] AssetsError),
    /// Camera, perception or encoder fail.
    #[error(transparent)]
    Eyes(#[from] EyesError),
    /// The task has no place on this net.
    #[error(transparent)]
    Task(#[from] TaskError),
    /// SUMO or the bridge fail.
    #[error(transparent)]
    Bridge(#[from] BridgeError),
    /// `step` without `reset`.
    #[error("no episode is running: call reset first")]
    NoEpisode,
    /// SUMO failed at every start.
    #[error(
        "SUMO failed {attempts} times in a row at the start of an episode of `{task}` with seed {seed}; the last time: {source}"
    )]
    Start {
        /// Number of starts.
        attempts: usize,
        /// The task.
        task: String,
        /// The episode's seed.
        seed: u64,
        /// The last error.
        source: Box<BridgeError>,
    },
    /// The town has no room for so many egos.
    #[error(
        "{town} has room for {fit} egos at their starts, not for {egos}: they begin 25 m apart, and each task has \
         starts of its own; ask for {fit} egos or fewer, or for tasks with more starts (composite has the most)"
    )]
    Full {
        /// The number of egos asked for.
        egos: usize,
        /// How many found a start.
        fit: usize,
        /// The town.
        town: String,
    },
    /// The folder for SUMO's files cannot be made.
    #[error("cannot make a folder for SUMO's files: {source}; check that the temporary folder is writable")]
    Folder {
        /// The cause.
        source: std::io::Error,
    },
    /// The asynchronous runtime cannot be started.
    #[error("cannot start the asynchronous runtime: {source}")]
    Runtime {
        /// The cause.
        source: std::io::Error,
    },
}

impl EnvError {
    /// Whether the user's input is wrong, not SUMO.
    pub fn is_input(&self) -> bool {
        match self {
            Self::Task(_) | Self::Full { .. } => true,
            Self::Assets(assets) => assets.is_input(),
            Self::Bridge(bridge) => bridge.is_input(),
            Self::Start { source, .. } => source.is_input(),
            Self::Eyes(eyes) => eyes.is_input(),
            _ => false,
        }
    }

    /// Whether SUMO failed.
    pub fn is_sumo(&self) -> bool {
        match self {
            Self::Assets(assets) => !assets.is_input(),
            Self::Bridge(bridge) => bridge.is_sumo(),
            Self::Start { source, .. } => source.is_sumo(),
            _ => false,
        }
    }
}
