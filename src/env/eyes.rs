//! From the ego's world to its observation: camera, perception, encoder.

use super::{Assets, EnvError, EnvOptions, ObservationMode, Stages};
use crate::bridge::Ego;
use crate::camera::{Camera, Frame, Preset, Town, Weather};
use crate::latent::Encoder;
use crate::network::Network;
use crate::observation::{LATENT_SIZE, Observation, RAW_SIZE, RawState};
use crate::perception::{self, EgoFacts, LightAhead, Perception, StopLight, TransformedImage};
use std::time::Instant;

/// Looks at the world after each tick.
pub struct Eyes {
    mode: ObservationMode,
    encoder: Box<dyn Encoder>,
    /// None where nothing is looked at.
    sight: Option<Sight>,
    weather: Weather,
    light: Option<LightAhead>,
    /// Where nothing is looked at.
    stop_light: StopLight,
    raw: RawState,
    latent: Vec<f32>,
}

struct Sight {
    camera: Camera,
    perception: Perception,
    town: Town,
}

impl Eyes {
    pub fn new(assets: &Assets, options: &EnvOptions, encoder: Box<dyn Encoder>) -> Result<Self, EnvError> {
        let sight = if options.observation.looks() {
            Some(Sight {
                camera: Camera::new(options.camera)?,
                perception: Perception::new(
                    perception::detector(&options.detector, perception::MIN_SCORE)?,
                    options.camera,
                )?,
                town: assets.town(),
            })
        } else {
            None
        };
        Ok(Self {
            mode: options.observation,
            encoder,
            sight,
            weather: Weather::from(Preset::ClearNoon),
            light: None,
            stop_light: StopLight::default(),
            raw: RawState::STANDING,
            latent: vec![0.0; LATENT_SIZE],
        })
    }

    /// Begins an episode.
    pub fn reset(&mut self, weather: Preset, seed: u64) {
        self.weather = Weather::from(weather);
        self.stop_light.reset();
        if let Some(sight) = &mut self.sight {
            sight.perception.reset(seed);
            sight.town = sight.town.share();
        }
    }

    /// Another weather, in the middle of an episode.
    pub fn set_weather(&mut self, weather: Preset) {
        self.weather = Weather::from(weather);
    }

    /// Looks at the world that `ego` is in after a tick of `tick` s.
    pub fn look(
        &mut self,
        network: &Network,
        ego: &Ego,
        tick: f64,
        stages: &mut Stages,
    ) -> Result<Observation, EnvError> {
        let facts = EgoFacts::of(network, ego, tick);
        let Some(sight) = &mut self.sight else {
            self.light = LightAhead::find(&facts);
            let stop = self.stop_light.update(self.light.as_ref(), facts.on_route.state.speed);
            self.raw = RawState::of(facts.route, &facts.on_route, None, stop);
            return Ok(self.observation());
        };
        let clock = Instant::now();
        sight.town.follow(ego.world(), None);
        let encodes = self.mode.encodes();
        let mut outputs = sight.perception.needs();
        if !encodes && sight.perception.detector() == "truth" {
            outputs.rgb = false;
        }
        let (scene, actors) = (sight.town.scene(), sight.town.actors());
        let frame = sight.camera.render(scene, actors, &ego.state().pose, &self.weather, outputs);
        let seen = clock.elapsed().as_secs_f64();
        if encodes {
            sight.perception.perceive(frame, &facts)?;
        } else {
            sight.perception.detect(frame)?;
            sight.perception.judge(&facts);
        }
        let perceived = clock.elapsed().as_secs_f64();
        let percept = sight.perception.percept();
        (self.light, self.raw) = (percept.light, percept.raw);
        if encodes {
            self.encoder.encode(&percept.transformed, &mut self.latent)?;
        }
        stages.camera += seen;
        stages.perception += perceived - seen;
        stages.encoder += clock.elapsed().as_secs_f64() - perceived;
        Ok(self.observation())
    }

    /// What the last look gave.
    pub fn observation(&self) -> Observation {
        let raw = match self.mode {
            ObservationMode::LatentOnly => [0.0; RAW_SIZE],
            _ => self.raw.vector(),
        };
        Observation { latent: self.latent.clone(), raw }
    }

    pub fn raw(&self) -> &RawState {
        &self.raw
    }

    /// The next signal on the route.
    pub fn light(&self) -> Option<&LightAhead> {
        self.light.as_ref()
    }

    pub fn frame(&self) -> Option<&Frame> {
        self.sight.as_ref().map(|sight| sight.camera.frame())
    }

    pub fn image(&self) -> Option<&TransformedImage> {
        self.sight.as_ref().map(|sight| &sight.perception.percept().transformed)
    }
}
