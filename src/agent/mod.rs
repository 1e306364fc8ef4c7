//! Drive: agents that turn observations into controls (paper, section "Watch and Drive Agents").

use crate::observation::Observation;
use crate::vehicle::Control;

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
}
