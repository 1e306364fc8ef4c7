//! A learned agent in `run`: it sees through camera, perception and encoder, tick by tick, as in [`crate::env`].

use crate::agent::{Agent, AgentError, Seen};
use crate::bridge::Ego;
use crate::camera::Preset;
use crate::env::eyes::Eyes;
use crate::env::{Assets, EnvError, EnvOptions, Stages};
use crate::latent::Encoder;
use crate::network::Network;
use crate::vehicle::Control;
use serde::Serialize;

/// Why it cannot drive.
#[derive(Debug, thiserror::Error)]
pub enum LearnedDriverError {
    #[error(transparent)]
    Agent(#[from] AgentError),
    #[error(transparent)]
    Eyes(#[from] EnvError),
}

/// What a run's `config.json` says of its driver.
#[derive(Clone, Debug, Serialize)]
pub struct DriverRecord {
    pub agent: String,
    pub encoder_hash: String,
    pub detector: String,
    pub weather: Preset,
}

/// An agent with its eyes.
pub struct LearnedDriver {
    agent: Box<dyn Agent>,
    eyes: Eyes,
    stages: Stages,
    record: DriverRecord,
    seed: u64,
}

impl LearnedDriver {
    /// `agent` behind `encoder`, in the town of a CONFIG; what it sees is as in `options`. `seed` draws
    /// the detector's faults.
    ///
    /// # Errors
    /// The town, the camera or the detector cannot be made.
    pub fn new(
        config: &str,
        agent: Box<dyn Agent>,
        encoder: Box<dyn Encoder>,
        options: &EnvOptions,
        weather: Preset,
        seed: u64,
    ) -> Result<Self, EnvError> {
        let record = DriverRecord {
            agent: agent.name().to_string(),
            encoder_hash: encoder.hash().to_string(),
            detector: options.detector.clone(),
            weather,
        };
        let eyes = Eyes::new(&*Assets::load(config)?, options, encoder)?;
        let mut driver = Self { agent, eyes, stages: Stages::default(), record, seed };
        driver.reset();
        Ok(driver)
    }

    /// Forgets what it remembers: the ego was put down elsewhere.
    pub fn reset(&mut self) {
        self.eyes.reset(self.record.weather, self.seed);
        self.agent.reset(self.seed);
    }

    /// The control for the next tick of `tick` s.
    ///
    /// # Errors
    /// Perception, encoder or agent fail.
    pub fn control(
        &mut self,
        network: &Network,
        ego: &Ego,
        tick: f64,
    ) -> Result<Control, LearnedDriverError> {
        let observation = self.eyes.look(network, ego, tick, &mut self.stages)?;
        let seen = Seen { observation: &observation, raw: self.eyes.raw(), frame: self.eyes.frame() };
        Ok(self.agent.act_seeing(&seen)?)
    }

    /// The weather from the next tick on.
    pub fn set_weather(&mut self, weather: Preset) {
        self.record.weather = weather;
        self.eyes.set_weather(weather);
    }

    /// For the run's configuration.
    pub fn record(&self) -> &DriverRecord {
        &self.record
    }
}
