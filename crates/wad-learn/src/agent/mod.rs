//! Drive: agents that turn observations into controls (paper, section "Watch and Drive Agents").
//!
//! | module | what it is |
//! |---|---|
//! | [`action`] | the three numbers of an action, and the [`Control`] they mean |
//! | [`exploration`] | noise that explores a road at six decisions a second |
//! | [`networks`] | WAD-T's and WAD-S' actors and critics |
//! | [`td3`], [`sac`] | one learning step each, in the papers' order |
//! | [`imitation`] | an expert's actions as a second teacher, beyond the paper |
//! | [`replay_buffer`], [`replay_files`] | a million transitions of latents, in memory and on disk |
//! | [`policy`] | a trained actor as a file, and as an [`Agent`] |
//! | [`external`] | another process as an [`Agent`], over a pipe |

pub mod action;
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
#[cfg(feature = "learn")]
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
use wad_see::observation::{Observation, RawState};
use wad_vehicle::Control;

/// Why an agent has no answer.
#[derive(Debug, thiserror::Error)]
pub enum AgentError {
    #[error("agent {name}: {why}")]
    Failed { name: String, why: String },
}

/// A learned (or external) driver.
pub trait Agent: Send {
    /// What it is called in tables and options, e.g. `wad-t`.
    fn name(&self) -> &str;

    /// Begins an episode.
    fn reset(&mut self, seed: u64) {
        let _ = seed;
    }

    /// The control for the next tick, without exploration.
    ///
    /// # Errors
    /// The network or the process behind it fails.
    fn act(&mut self, observation: &Observation) -> Result<Control, AgentError>;

    /// The same for an agent that wants more than the paper's observation. A trained one does not.
    ///
    /// # Errors
    /// As [`Agent::act`].
    fn act_seeing(&mut self, seen: &Seen<'_>) -> Result<Control, AgentError> {
        self.act(seen.observation)
    }
}

/// An observation, and what it was made from.
#[derive(Clone, Copy, Debug)]
pub struct Seen<'a> {
    pub observation: &'a Observation,
    /// The raw states by name, in units.
    pub raw: &'a RawState,
    /// The front camera's picture; None where nothing is looked at.
    pub frame: Option<&'a Frame>,
}
