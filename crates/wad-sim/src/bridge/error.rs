//! Errors that end a co-simulation.

use crate::sumo_config::ConfigError;
use std::path::PathBuf;
use sumo_network::network::NetworkError;
use wad_vehicle::ParamsError;

/// Why the bridge could not start or go on.
#[derive(Debug, thiserror::Error)]
pub enum BridgeError {
    #[error(transparent)]
    Config(#[from] ConfigError),
    #[error(transparent)]
    Network(#[from] NetworkError),
    /// SUMO is missing, refused a command, died, hung or sent garbage.
    #[error(transparent)]
    Traci(#[from] sumo_traci::Error),
    #[error(transparent)]
    Launch(#[from] sumo_traci::LaunchError),
    #[error(transparent)]
    Install(#[from] sumo_traci::process::InstallError),
    #[error(transparent)]
    Ego(#[from] ParamsError),
    #[error("the step length must be 1 to 1000 ms, found {found} ms; give another with --tick-ms")]
    Tick { found: f64 },
    #[error(
        "the SUMO at {address} runs {found} ms steps, but {wanted} ms were asked for; \
         start it with --step-length {}, or leave out --tick-ms",
        wanted / 1000.0
    )]
    AttachedTick { address: String, found: f64, wanted: f64 },
    #[error("SUMO lost the ego vehicle `{id}` at {time:.2} s: {why}")]
    EgoLost { id: String, time: f64, why: String },
    #[error("could not make the folder `{}` for SUMO's files: {source}", path.display())]
    Folder { path: PathBuf, source: std::io::Error },
}

impl BridgeError {
    /// True where the user's input is at fault, not SUMO.
    pub fn is_input(&self) -> bool {
        matches!(
            self,
            Self::Config(_) | Self::Network(_) | Self::Ego(_) | Self::Tick { .. } | Self::AttachedTick { .. }
        )
    }
}
