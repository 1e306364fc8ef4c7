//! Errors that end a co-simulation.

use crate::sumo_config::ConfigError;
use std::path::PathBuf;
use sumo_network::network::NetworkError;
use wad_vehicle::ParamsError;

/// Why the bridge could not start or go on.
#[derive(Debug, thiserror::Error)]
pub enum BridgeError {
    /// The `.sumocfg` cannot be used.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The `.net.xml` cannot be read.
    #[error(transparent)]
    Network(#[from] NetworkError),
    /// SUMO is missing, refused a command, died, hung or sent garbage.
    #[error(transparent)]
    Traci(#[from] sumo_traci::Error),
    /// SUMO does not start.
    #[error(transparent)]
    Launch(#[from] sumo_traci::LaunchError),
    /// SUMO is not installed, or its version is too old.
    #[error(transparent)]
    Install(#[from] sumo_traci::process::InstallError),
    /// One of the ego's parameters is out of range.
    #[error(transparent)]
    Ego(#[from] ParamsError),
    /// The step length is out of range.
    #[error("the step length must be 1 to 1000 ms, found {found:?} ms; give another with --tick-ms")]
    Tick {
        /// The asked step length (ms).
        found: f64,
    },
    /// An attached SUMO runs with another step length.
    #[error(
        "the SUMO at {address} runs {found} ms steps, but {wanted} ms were asked for; \
         start it with --step-length {}, or leave out --tick-ms",
        wanted / 1000.0
    )]
    AttachedTick {
        /// SUMO's host and port.
        address: String,
        /// SUMO's step length (ms).
        found: f64,
        /// The asked step length (ms).
        wanted: f64,
    },
    /// SUMO no longer has the ego.
    #[error("SUMO lost the ego vehicle `{id}` at {time:.2} s: {why}")]
    EgoLost {
        /// The ego's id in SUMO.
        id: String,
        /// Simulation time (s).
        time: f64,
        /// The reason, as far as it is known.
        why: String,
    },
    /// SUMO's files cannot be written.
    #[error("could not write `{}` for SUMO: {source}; is the disk full?", path.display())]
    Folder {
        /// The file or folder.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
}

impl BridgeError {
    /// True where the user's input is at fault, not SUMO.
    pub fn is_input(&self) -> bool {
        matches!(
            self,
            Self::Config(_) | Self::Network(_) | Self::Ego(_) | Self::Tick { .. } | Self::AttachedTick { .. }
        )
    }

    /// True where SUMO failed.
    pub fn is_sumo(&self) -> bool {
        !self.is_input() && !matches!(self, Self::Folder { .. })
    }
}
