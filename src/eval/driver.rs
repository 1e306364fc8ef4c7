//! Who drives in an evaluation.

use crate::agent::{Agent, AgentError, Seen};
use crate::env::{Env, EnvError};
use crate::observation::Observation;
use crate::seeds;
use crate::vehicle::Control;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::fmt;
use std::str::FromStr;

/// A driver by name: `autopilot`, `random`, `constant`, `constant:THROTTLE,STEER,BRAKE`, `exec:COMMAND`, or
/// an agent's name or file.
#[derive(Clone, Debug, PartialEq)]
pub enum DriverSpec {
    /// The rule-based expert, which sees the whole world.
    Autopilot,
    /// Every pedal anywhere, every tick.
    Random,
    /// The same control for ever.
    Constant(Control),
    /// Another process, started by this shell command ([`crate::agent::external`]).
    Exec(String),
    /// A learned agent by name or file.
    Agent(String),
}

/// Why there is no such driver.
#[derive(Debug, thiserror::Error)]
pub enum DriverError {
    #[error(
        "`{found}` is no constant control: expected constant:THROTTLE,STEER,BRAKE, e.g. constant:0.5,0,0"
    )]
    Constant { found: String },
    #[error(
        "no agent is called `{found}`: expected autopilot, random or constant; this build cannot open trained ones"
    )]
    Unknown { found: String },
    /// A trained agent or its encoder that cannot be opened.
    #[cfg(feature = "learn")]
    #[error(transparent)]
    Policy(#[from] crate::agent::policy::PolicyError),
    #[cfg(feature = "learn")]
    #[error(transparent)]
    Encoder(#[from] crate::latent::LatentError),
    #[error(transparent)]
    Agent(#[from] AgentError),
    #[error(transparent)]
    Env(#[from] EnvError),
}

/// Half throttle, straight on.
const CONSTANT: Control = Control { throttle: 0.5, steer: 0.0, brake: 0.0 };

impl FromStr for DriverSpec {
    type Err = DriverError;

    fn from_str(text: &str) -> Result<Self, DriverError> {
        match text {
            "autopilot" => Ok(Self::Autopilot),
            "random" => Ok(Self::Random),
            "constant" => Ok(Self::Constant(CONSTANT)),
            _ => match text.strip_prefix("constant:") {
                Some(numbers) => {
                    let parsed: Option<Vec<f64>> =
                        numbers.split(',').map(|n| n.trim().parse().ok()).collect();
                    match parsed.as_deref() {
                        Some(&[throttle, steer, brake]) => {
                            Ok(Self::Constant(Control { throttle, steer, brake }.clamped()))
                        }
                        _ => Err(DriverError::Constant { found: text.to_string() }),
                    }
                }
                None => Ok(match text.strip_prefix("exec:") {
                    Some(command) => Self::Exec(command.to_string()),
                    None => Self::Agent(text.to_string()),
                }),
            },
        }
    }
}

impl fmt::Display for DriverSpec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Autopilot => f.write_str("autopilot"),
            Self::Random => f.write_str("random"),
            Self::Constant(c) if *c == CONSTANT => f.write_str("constant"),
            Self::Constant(c) => write!(f, "constant:{},{},{}", c.throttle, c.steer, c.brake),
            Self::Exec(command) => write!(f, "exec:{command}"),
            Self::Agent(name) => f.write_str(name),
        }
    }
}

impl Serialize for DriverSpec {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for DriverSpec {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer)?.parse().map_err(serde::de::Error::custom)
    }
}

impl DriverSpec {
    /// Whether it looks at observations.
    pub fn looks(&self) -> bool {
        matches!(self, Self::Agent(_) | Self::Exec(_))
    }
}

/// A driver at work.
pub enum Driver {
    Autopilot,
    Random(Box<ChaCha8Rng>),
    Constant(Control),
    Agent(Box<dyn Agent>),
}

impl Driver {
    /// Begins an episode.
    pub fn reset(&mut self, seed: u64) {
        match self {
            Self::Random(rng) => **rng = seeds::rng(seed, "driver"),
            Self::Agent(agent) => agent.reset(seed),
            Self::Autopilot | Self::Constant(_) => {}
        }
    }

    /// The control for the next tick.
    ///
    /// # Errors
    /// The agent fails, or no episode is under way.
    pub fn act(&mut self, env: &mut Env, observation: &Observation) -> Result<Control, DriverError> {
        Ok(match self {
            Self::Autopilot => env.expert()?,
            Self::Random(rng) => Control {
                throttle: rng.random_range(0.0..1.0),
                steer: rng.random_range(-1.0..1.0),
                brake: rng.random_range(0.0..1.0),
            },
            Self::Constant(control) => *control,
            Self::Agent(agent) => {
                agent.act_seeing(&Seen { observation, raw: env.raw(), frame: env.frame() })?
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn drivers_are_read_as_they_are_written() {
        for text in
            ["autopilot", "random", "constant", "constant:0.3,-0.1,0", "wad-t", "exec:python3 a.py --x"]
        {
            assert_eq!(text.parse::<DriverSpec>().unwrap().to_string(), text);
        }
        let error = "constant:1,2".parse::<DriverSpec>().unwrap_err().to_string();
        assert!(error.contains("constant:1,2") && error.contains("THROTTLE"), "{error}");
    }
}
