//! Agents: they turn observations into controls (paper, section "Watch and Drive Agents").
//!
//! | module | what it is |
//! |---|---|
//! | [`action`] | the three numbers of an action, and their [`Control`] |
//! | [`exploration`] | noise for exploration at six decisions a second |
//! | [`networks`] | WAD-T's and WAD-S' actors and critics |
//! | [`td3`], [`sac`] | one learning step each, in the papers' order |
//! | [`imitation`] | an expert's actions as a second teacher, beyond the paper |
//! | [`replay_buffer`], [`replay_files`], [`places`] | a million transitions of latents, in memory and on disk, and where they were driven |
//! | [`params`] | what a trained agent's file says of it |
//! | [`actor`] | a trained actor without libtorch |
//! | [`policy`] | a trained actor as a file, and as an [`Agent`] |
//! | [`external`] | another process as an [`Agent`], over a pipe |

pub mod action;
pub mod actor;
#[cfg(feature = "learn")]
pub mod batch;
pub mod exploration;
pub mod external;
#[cfg(feature = "learn")]
pub mod imitation;
#[cfg(feature = "learn")]
pub mod learner;
#[cfg(feature = "learn")]
pub mod networks;
pub mod params;
#[cfg(feature = "learn")]
pub mod places;
pub mod policy;
#[cfg(feature = "learn")]
pub mod replay_buffer;
#[cfg(feature = "learn")]
pub mod replay_files;
#[cfg(feature = "learn")]
pub mod sac;
#[cfg(feature = "learn")]
pub mod td3;
#[cfg(all(test, feature = "learn"))]
mod tests;

use wad_camera::Frame;
use wad_see::observation::{Observation, ObservationMode, RawState};
use wad_vehicle::Control;

/// Why an agent gave no control.
#[derive(Debug, thiserror::Error)]
pub enum AgentError {
    /// The agent failed.
    #[error("agent {name}: {why}")]
    Failed {
        /// The agent's name.
        name: String,
        /// The cause.
        why: String,
    },
}

/// A learned (or external) driver.
pub trait Agent: Send {
    /// Its name in tables and options, e.g. `wad-t`.
    fn name(&self) -> &str;

    /// The parts of the observation that it needs.
    fn observes(&self) -> ObservationMode {
        ObservationMode::default()
    }

    /// Begins an episode.
    fn reset(&mut self, seed: u64) {
        let _ = seed;
    }

    /// The control for the next tick, without exploration.
    ///
    /// # Errors
    /// The network or the external process fails.
    fn act(&mut self, observation: &Observation) -> Result<Control, AgentError>;

    /// The same with more than the paper's observation, for external agents. Trained agents ignore the rest.
    ///
    /// # Errors
    /// As [`Agent::act`].
    fn act_seeing(&mut self, seen: &Seen<'_>) -> Result<Control, AgentError> {
        self.act(seen.observation)
    }
}

/// An observation, and its sources.
#[derive(Clone, Copy, Debug)]
pub struct Seen<'a> {
    /// The paper's observation: latent and raw vector.
    pub observation: &'a Observation,
    /// The raw states by name, in units.
    pub raw: &'a RawState,
    /// The front camera's picture; None if the camera is off.
    pub frame: Option<&'a Frame>,
}
