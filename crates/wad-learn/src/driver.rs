//! Drivers: one list for `run`, `eval`, scenarios and the live view.

use crate::agent::external::{ExternalAgent, Limits};
use crate::agent::{Agent, AgentError, Seen, policy};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::fmt;
use std::str::FromStr;
use sumo_network::seeds;
use wad_camera::{CameraConfig, Preset, Weather};
use wad_see::eyes::{Eyes, EyesError};
use wad_see::latent::Encoder;
use wad_see::observation::ObservationMode;
use wad_sim::assets::Assets;
use wad_sim::session::Act;
use wad_vehicle::Control;

/// A driver by name: `autopilot`, `manual`, `random`, `constant`, `constant:THROTTLE,STEER,BRAKE`,
/// `exec:COMMAND`, or an agent's name or file.
#[derive(Clone, Debug, PartialEq)]
pub enum DriverSpec {
    /// The rule-based expert, which sees the whole world.
    Autopilot,
    /// A person at the live view's wheel.
    Manual,
    /// The wheel anywhere, and one of the pedals, every tick.
    Random,
    /// The same control for ever.
    Constant(Control),
    /// An external process, started by this shell command ([`crate::agent::external`]).
    Exec(String),
    /// A learned agent by name or file.
    Agent(String),
}

/// Why a driver cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum DriverError {
    /// The control of `constant:...` is invalid.
    #[error("expected constant:THROTTLE,STEER,BRAKE, e.g. constant:0.5,0,0, found `{found}`")]
    Constant {
        /// The text.
        found: String,
    },
    /// No driver has this name.
    #[error(
        "no agent is called `{found}`: expected autopilot, random or constant; this build cannot open trained ones"
    )]
    Unknown {
        /// The name.
        found: String,
    },
    /// A trained agent or its encoder cannot be opened.
    #[error(transparent)]
    Policy(#[from] policy::PolicyError),
    /// An encoder cannot be opened.
    #[error(transparent)]
    Encoder(#[from] wad_see::latent::LatentError),
    /// An agent cannot be started.
    #[error(transparent)]
    Agent(#[from] AgentError),
    /// Camera or perception cannot be made.
    #[error(transparent)]
    Eyes(#[from] EyesError),
    /// `manual` outside the live view.
    #[error("`manual` drives only in the live view: expected another driver here, or `run --view`")]
    Manual,
}

/// An agent and its encoder.
pub struct Made {
    /// The agent.
    pub agent: Box<dyn Agent>,
    /// The encoder that makes its latents.
    pub encoder: Box<dyn Encoder>,
    /// Identifies the weights of both.
    pub id: String,
}

impl Made {
    /// The agent of a specification that names one, and its encoder: `encoder`, or the one that it was trained with. External agents
    /// have the time limits `limits`, and the default encoder.
    ///
    /// # Errors
    /// The agent or the encoder does not exist, or they do not fit together or this camera.
    pub fn open(
        spec: &DriverSpec,
        encoder: Option<&str>,
        camera: &CameraConfig,
        limits: Limits,
    ) -> Result<Self, DriverError> {
        match spec {
            DriverSpec::Exec(command) => {
                let encoder = policy::find_encoder(encoder.unwrap_or("default"))?;
                let id = format!("exec:{command}, encoder {}", encoder.hash());
                Ok(Self { agent: Box::new(ExternalAgent::new(command, limits)), encoder, id })
            }
            other => Self::trained(&other.to_string(), encoder, camera),
        }
    }

    /// The trained agent called `name`, and `encoder` or the one that it was trained with.
    ///
    /// # Errors
    /// The agent or the encoder does not exist, or they do not fit together or this camera.
    pub fn trained(name: &str, encoder: Option<&str>, camera: &CameraConfig) -> Result<Self, DriverError> {
        let (agent, encoder) = policy::open(name, encoder, camera)?;
        let id = format!("{}, encoder {}", Self::weights(name), encoder.hash());
        Ok(Self { agent, encoder, id })
    }

    /// `weights` and the checksum of the file of the trained agent `name`.
    pub fn weights(name: &str) -> String {
        let bytes = match wad_sim::bundled::agent(name) {
            Some(bytes) if !std::path::Path::new(name).is_file() => bytes.to_vec(),
            _ => std::fs::read(name).unwrap_or_default(),
        };
        format!("weights {:08x}", crc32fast::hash(&bytes))
    }
}

/// Half throttle, straight on.
const CONSTANT: Control = Control { throttle: 0.5, steer: 0.0, brake: 0.0, reverse: false };

impl FromStr for DriverSpec {
    type Err = DriverError;

    fn from_str(text: &str) -> Result<Self, DriverError> {
        match text {
            "autopilot" => Ok(Self::Autopilot),
            "manual" => Ok(Self::Manual),
            "random" => Ok(Self::Random),
            "constant" => Ok(Self::Constant(CONSTANT)),
            _ => match text.strip_prefix("constant:") {
                Some(numbers) => {
                    let parsed: Option<Vec<f64>> =
                        numbers.split(',').map(|n| n.trim().parse().ok()).collect();
                    match parsed.as_deref() {
                        Some(&[throttle, steer, brake]) => {
                            Ok(Self::Constant(Control { throttle, steer, brake, reverse: false }.clamped()))
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
            Self::Manual => f.write_str("manual"),
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
    /// Whether it needs observations.
    pub fn looks(&self) -> bool {
        matches!(self, Self::Agent(_) | Self::Exec(_))
    }
}

/// A running driver.
pub enum Driver {
    /// The rule-based expert, which sees the whole world.
    Autopilot,
    /// A person in the live view, with their current control.
    Manual(Control),
    /// The wheel anywhere, and one of the pedals, every tick.
    Random(Box<ChaCha8Rng>),
    /// The same control for ever.
    Constant(Control),
    /// A trained agent, or another process.
    Agent(Box<dyn Agent>),
}

/// Brakes: a person who is not there yet.
const PARKED: Control = Control { throttle: 0.0, steer: 0.0, brake: 1.0, reverse: false };

impl Driver {
    /// The driver of a specification without an agent; None if it names one.
    pub fn blind(spec: &DriverSpec) -> Option<Self> {
        match spec {
            DriverSpec::Autopilot => Some(Self::Autopilot),
            DriverSpec::Manual => Some(Self::Manual(PARKED)),
            DriverSpec::Random => Some(Self::Random(Box::new(seeds::rng(0, "driver")))),
            DriverSpec::Constant(control) => Some(Self::Constant(*control)),
            DriverSpec::Exec(_) | DriverSpec::Agent(_) => None,
        }
    }

    /// Begins an episode.
    pub fn reset(&mut self, seed: u64) {
        match self {
            Self::Random(rng) => **rng = seeds::rng(seed, "driver"),
            Self::Agent(agent) => agent.reset(seed),
            Self::Autopilot | Self::Manual(_) | Self::Constant(_) => {}
        }
    }

    /// Whether the expert drives.
    pub fn is_autopilot(&self) -> bool {
        matches!(self, Self::Autopilot)
    }

    /// Whether it needs camera and perception.
    pub fn looks(&self) -> bool {
        matches!(self, Self::Agent(_))
    }

    /// The control for the next tick, from the last frame of `eyes`.
    ///
    /// # Errors
    /// The agent fails.
    pub fn act(&mut self, eyes: &Eyes) -> Result<Act, AgentError> {
        Ok(Act::Control(match self {
            Self::Autopilot => return Ok(Act::Expert),
            Self::Manual(control) | Self::Constant(control) => *control,
            Self::Random(rng) => {
                // One pedal at a time: the brake wins over the throttle, and with both it would never move.
                let pedal = rng.random_range(-1.0..1.0_f64);
                Control {
                    throttle: pedal.max(0.0),
                    steer: rng.random_range(-1.0..1.0),
                    brake: (-pedal).max(0.0),
                    reverse: false,
                }
            }
            Self::Agent(agent) => {
                let observation = eyes.observation();
                agent.act_seeing(&Seen { observation: &observation, raw: eyes.raw(), frame: eyes.frame() })?
            }
        }))
    }
}

/// A driver with its eyes.
pub struct Pilot {
    /// The driver.
    pub driver: Driver,
    /// Camera and perception, if the driver needs them.
    pub eyes: Eyes,
    /// Its entry in the run's `config.json`.
    pub record: PilotRecord,
}

/// The driver in a run's `config.json`.
#[derive(Clone, Debug, Default, Serialize)]
pub struct PilotRecord {
    /// The [`DriverSpec`] as text.
    pub agent: String,
    /// Hash of the encoder's weights, of drivers that use one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub encoder_hash: Option<String>,
    /// The detector's name, of drivers that use one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub detector: Option<String>,
    /// Whether it looks back before a change of lane.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub mirrors: bool,
    /// The camera's weather, of drivers that use one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub weather: Option<Preset>,
}

impl Pilot {
    /// A blind driver; None if the specification names an agent.
    pub fn blind(spec: &DriverSpec) -> Option<Self> {
        let driver = Driver::blind(spec)?;
        let record = PilotRecord { agent: spec.to_string(), ..PilotRecord::default() };
        Some(Self { driver, eyes: Eyes::blind(), record })
    }

    /// The expert.
    pub fn autopilot() -> Self {
        let agent = DriverSpec::Autopilot.to_string();
        let record = PilotRecord { agent, ..PilotRecord::default() };
        Self { driver: Driver::Autopilot, eyes: Eyes::blind(), record }
    }

    /// A person.
    pub fn manual() -> Self {
        let record = PilotRecord { agent: DriverSpec::Manual.to_string(), ..Self::autopilot().record };
        Self { driver: Driver::Manual(PARKED), record, ..Self::autopilot() }
    }

    /// `agent` with `encoder` in the town of `assets`, with the detector of that name.
    ///
    /// # Errors
    /// The camera or the detector cannot be made.
    pub fn of_agent(
        assets: &Assets,
        agent: Box<dyn Agent>,
        encoder: Box<dyn Encoder>,
        detector: &str,
        camera: CameraConfig,
    ) -> Result<Self, EyesError> {
        let record = PilotRecord {
            agent: agent.name().to_string(),
            encoder_hash: Some(encoder.hash().to_string()),
            detector: Some(detector.to_string()),
            ..PilotRecord::default()
        };
        // People who watch want to see the whole chain, also where the agent leaves a part of it out.
        let mode = match agent.observes() {
            mode @ (ObservationMode::Vector | ObservationMode::Camera) => mode,
            _ => ObservationMode::default(),
        };
        let eyes = Eyes::of_agent(assets, mode, detector, camera, encoder)?;
        Ok(Self { driver: Driver::Agent(agent), eyes, record })
    }

    /// Also looks back before a change of lane, by cameras in place of the door mirrors, if `wanted`.
    ///
    /// # Errors
    /// The cameras cannot be made.
    pub fn with_mirrors(self, wanted: bool) -> Result<Self, EyesError> {
        let record = PilotRecord { mirrors: wanted && self.driver.looks(), ..self.record };
        Ok(Self { eyes: self.eyes.with_mirrors(wanted)?, record, driver: self.driver })
    }

    /// Begins a drive in a weather: clears its memory. `seed` is the run's.
    pub fn reset(&mut self, weather: impl Into<Weather>, seed: u64) {
        let weather = weather.into();
        let preset = weather.preset;
        self.eyes.reset(weather, seed);
        self.driver.reset(seed);
        if self.driver.looks() {
            self.record.weather = Some(preset);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn random_presses_one_pedal_at_a_time() {
        let mut driver = Driver::Random(Box::new(seeds::rng(1, "random")));
        let eyes = Eyes::blind();
        let controls: Vec<Control> = (0..200)
            .map(|_| match driver.act(&eyes).unwrap() {
                Act::Control(control) => control,
                other => panic!("{other:?}"),
            })
            .collect();
        assert!(controls.iter().all(|c| c.throttle == 0.0 || c.brake == 0.0));
        assert!(controls.iter().any(|c| c.throttle > 0.8) && controls.iter().any(|c| c.brake > 0.8));
    }

    #[test]
    fn drivers_are_read_as_they_are_written() {
        for text in [
            "autopilot",
            "manual",
            "random",
            "constant",
            "constant:0.3,-0.1,0",
            "wad-t",
            "exec:python3 a.py --x",
        ] {
            assert_eq!(text.parse::<DriverSpec>().unwrap().to_string(), text);
        }
        let error = "constant:1,2".parse::<DriverSpec>().unwrap_err().to_string();
        assert!(error.contains("constant:1,2") && error.contains("THROTTLE"), "{error}");
    }
}
