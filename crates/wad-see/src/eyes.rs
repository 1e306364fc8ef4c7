//! The eyes of an ego: front camera, perception, encoder and decoder, each optional. No other code looks for an
//! ego.
//!
//! ```text
//! follow(world)   the town's road users move, once a tick
//! look(facts)     camera -> detect, lanes, judge, transform -> encode -> reconstruct
//! ```

use crate::latent::{Decoder, Encoder, LatentError};
use crate::observation::{LATENT_SIZE, Observation, ObservationMode, RAW_SIZE, RawState};
use crate::perception::{
    self, Detector, EgoFacts, ImageKind, LightAhead, Percept, Perception, PerceptionError, StopLight,
    TransformedImage, mirrors, stages,
};
use crate::surroundings::Surroundings;
use std::time::Instant;
use sumo_network::geometry::Pose;
use sumo_network::seeds;
use sumo_network::world::WorldState;
use wad_camera::{Camera, CameraConfig, CameraError, Frame, Outputs, Picture, Preset, Town, Weather};
use wad_sim::assets::Assets;

/// Why the eyes fail.
#[derive(Debug, thiserror::Error)]
pub enum EyesError {
    /// The camera's configuration is invalid.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// The detector cannot be made or used, or a frame does not fit.
    #[error(transparent)]
    Perception(#[from] PerceptionError),
    /// The encoder cannot be made or used.
    #[error(transparent)]
    Latent(#[from] LatentError),
    /// A detector's or an encoder's weights belong to another camera.
    #[error(
        "{name}: expected the camera that its weights belong to, {expected}, found {found}: use that camera, or the \
         detectors truth or outlines and the encoder pooled, which see through any"
    )]
    OtherCamera {
        /// The detector, or `encoder`.
        name: String,
        /// The weights' camera.
        expected: String,
        /// The camera in use.
        found: String,
    },
}

impl EyesError {
    /// Whether the user's input is wrong: the camera.
    pub fn is_input(&self) -> bool {
        matches!(self, Self::Camera(_) | Self::OtherCamera { .. })
    }
}

/// Whether weights that belong to `theirs` see through `camera`.
fn check_camera(name: &str, theirs: Option<CameraConfig>, camera: &CameraConfig) -> Result<(), EyesError> {
    match theirs.filter(|theirs| theirs.hash() != camera.hash()) {
        None => Ok(()),
        Some(theirs) => Err(EyesError::OtherCamera {
            name: name.to_string(),
            expected: theirs.to_string(),
            found: camera.to_string(),
        }),
    }
}

/// Wall time of the parts of a look (s).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LookTimes {
    /// Rendering the frame.
    pub camera: f64,
    /// Detecting objects.
    pub detect: f64,
    /// Detecting lanes.
    pub lanes: f64,
    /// Light, vehicle in front, raw states.
    pub judge: f64,
    /// Drawing the transformed image.
    pub transform: f64,
    /// Encoding it.
    pub encode: f64,
}

impl LookTimes {
    /// Detection, lanes, judging and the transformed image together (s).
    pub fn perception(&self) -> f64 {
        self.detect + self.lanes + self.judge + self.transform
    }
}

/// The result of a look, for display.
#[derive(Clone, Debug)]
pub struct Look {
    /// The camera's frame.
    pub frame: Frame,
    /// What was perceived in it.
    pub percept: Percept,
    /// What was seen in a mirror at the same time.
    pub mirror: Option<stages::MirrorView>,
}

/// The eyes of one ego.
pub struct Eyes {
    mode: ObservationMode,
    /// None: without a camera; the raw states come from the route and the lights alone.
    sight: Option<Sight>,
    encoder: Option<Box<dyn Encoder>>,
    decoder: Option<Box<dyn Decoder>>,
    weather: Preset,
    light: Option<LightAhead>,
    /// With [`ObservationMode::Vector`].
    surroundings: Option<Surroundings>,
    /// Without a camera.
    stop_light: StopLight,
    raw: RawState,
    latent: Vec<f32>,
    reconstruction: Option<TransformedImage>,
    times: LookTimes,
}

struct Sight {
    town: Town,
    camera: Camera,
    perception: Option<Perception>,
    /// Looks back where the route changes lanes.
    mirror: Option<Camera>,
    /// Whether the last look went into the left mirror; None: into no mirror.
    left: Option<bool>,
    /// The cameras' outputs beside perception's.
    outputs: Outputs,
    weather: Weather,
}

impl Eyes {
    /// Eyes that do not look, for drivers that need none: several times faster.
    pub fn blind() -> Self {
        Self {
            mode: ObservationMode::Blind,
            sight: None,
            encoder: None,
            decoder: None,
            weather: Preset::default(),
            light: None,
            surroundings: None,
            stop_light: StopLight::default(),
            raw: RawState::STANDING,
            latent: vec![0.0; LATENT_SIZE],
            reconstruction: None,
            times: LookTimes::default(),
        }
    }

    /// A camera of `config` in `town`, and nothing behind it.
    ///
    /// # Errors
    /// The camera's size or field of view is out of range.
    pub fn camera(town: Town, config: CameraConfig) -> Result<Self, EyesError> {
        let weather = Preset::default();
        let sight = Sight {
            town,
            camera: Camera::new(config)?,
            perception: None,
            mirror: None,
            left: None,
            outputs: Outputs::NONE,
            weather: Weather::from(weather),
        };
        Ok(Self { mode: ObservationMode::LatentAndRaw, sight: Some(sight), ..Self::blind() })
    }

    /// A camera of `config` with perception by `detector` behind it.
    ///
    /// # Errors
    /// As [`Eyes::camera`], or the detector's weights belong to another camera.
    pub fn new(town: Town, config: CameraConfig, detector: Box<dyn Detector>) -> Result<Self, EyesError> {
        check_camera(&format!("detector {}", detector.name()), detector.camera(), &config)?;
        let mut eyes = Self::camera(town, config)?;
        if let Some(sight) = &mut eyes.sight {
            sight.perception = Some(Perception::new(detector, config));
        }
        Ok(eyes)
    }

    /// The eyes of an agent in the town of `assets`: the parts that `mode` needs, with the detector of that name.
    ///
    /// # Errors
    /// No such detector, one that does not see what `mode` needs, or as [`Eyes::new`] and [`Eyes::with_encoder`].
    pub fn of_agent(
        assets: &Assets,
        mode: ObservationMode,
        detector: &str,
        camera: CameraConfig,
        encoder: Box<dyn Encoder>,
    ) -> Result<Self, EyesError> {
        if mode == ObservationMode::Camera && !perception::sees_the_road(detector) {
            let why = "the agent has nothing but the camera, the route and its own motion (--inputs camera): expected a \
                       detector that sees lane and light, eyes or eyes:FILE";
            return Err(PerceptionError::Detector { name: detector.to_string(), why: why.to_string() }.into());
        }
        let eyes = if mode.looks() {
            let detector = perception::detector(detector, perception::LeastScore::Usual)?;
            Self::new(assets.town(), camera, detector)?
        } else {
            Self::blind()
        };
        let surroundings = (mode == ObservationMode::Vector).then(Surroundings::default);
        let latent = vec![0.0; mode.latent_size()];
        Self { mode, surroundings, latent, ..eyes }.with_encoder(encoder)
    }

    /// Also looks into [mirrors], if `wanted`.
    ///
    /// # Errors
    /// The camera's size or field of view is out of range.
    pub fn with_mirrors(mut self, wanted: bool) -> Result<Self, EyesError> {
        if let (true, Some(Sight { camera, perception: Some(perception), mirror, .. })) =
            (wanted, &mut self.sight)
        {
            *mirror = Some(Camera::new(mirrors::camera(camera.config()))?);
            perception.look_back();
        }
        Ok(self)
    }

    /// Also makes the latent.
    ///
    /// # Errors
    /// The encoder's weights belong to another camera.
    pub fn with_encoder(self, encoder: Box<dyn Encoder>) -> Result<Self, EyesError> {
        if let Some(sight) = self.sight.as_ref().filter(|_| self.mode.encodes()) {
            check_camera("encoder", encoder.camera(), sight.camera.config())?;
        }
        let eyes = self.with_image(encoder.image_kind());
        Ok(Self { encoder: Some(encoder), ..eyes })
    }

    /// Makes this image in place of the transformed image.
    #[must_use]
    pub fn with_image(mut self, kind: ImageKind) -> Self {
        if let Some(Sight { perception: Some(perception), .. }) = &mut self.sight {
            perception.show(kind);
        }
        self
    }

    /// What [`Percept::transformed`] is.
    pub fn image_kind(&self) -> ImageKind {
        let perception = self.sight.as_ref().and_then(|sight| sight.perception.as_ref());
        perception.map_or(ImageKind::Transformed, Perception::image_kind)
    }

    /// Also shows what the latent of each image holds; without an encoder, of the image that `decoder` was trained on.
    #[must_use]
    pub fn with_decoder(self, decoder: Box<dyn Decoder>) -> Self {
        let eyes = if self.encoder.is_none() { self.with_image(decoder.image_kind()) } else { self };
        Self { decoder: Some(decoder), ..eyes }
    }

    /// The cameras also make `outputs`.
    #[must_use]
    pub fn with_outputs(mut self, outputs: Outputs) -> Self {
        if let Some(sight) = &mut self.sight {
            sight.outputs = outputs;
        }
        self
    }

    /// Begins an episode in a weather: forgets everything. `seed` is the run's or the episode's; the
    /// detector's faults derive from it.
    pub fn reset(&mut self, weather: impl Into<Weather>, seed: u64) {
        self.stop_light.reset();
        if let Some(surroundings) = &mut self.surroundings {
            surroundings.reset();
        }
        if let Some(sight) = &mut self.sight {
            sight.town = sight.town.share();
            sight.left = None;
            if let Some(perception) = &mut sight.perception {
                perception.reset(seeds::derive(seed, "detector"));
            }
        }
        self.set_weather(weather);
    }

    /// Another weather from the next look on.
    pub fn set_weather(&mut self, weather: impl Into<Weather>) {
        let weather = weather.into();
        self.weather = weather.preset;
        if let Some(sight) = &mut self.sight {
            sight.weather = weather;
        }
    }

    /// The weather by name.
    pub fn weather(&self) -> Preset {
        self.weather
    }

    /// Moves the town's road users to their places in `world`. Call it once a tick, also for ticks without a
    /// look.
    pub fn follow(&mut self, world: &WorldState) {
        if let Some(sight) = &mut self.sight {
            sight.town.follow(world, None);
        }
        if let Some(surroundings) = &mut self.surroundings {
            surroundings.follow(world);
        }
    }

    /// Looks at the town as it was last followed. `facts.tick` is the time since the last look (s).
    ///
    /// # Errors
    /// A stage fails.
    pub fn look(&mut self, facts: &EgoFacts<'_>) -> Result<(), EyesError> {
        self.times = LookTimes::default();
        if let Some(surroundings) = &mut self.surroundings {
            self.raw = surroundings.look(facts, &mut self.latent);
            self.light = surroundings.light();
            return Ok(());
        }
        let Some(sight) = &mut self.sight else {
            self.light = LightAhead::find(facts);
            let stop = self.stop_light.update(self.light.as_ref(), false, facts.on_route.state.speed);
            self.raw = RawState::of(facts.route, &facts.on_route, None, stop);
            return Ok(());
        };
        let mut clock = Instant::now();
        let mut lap = || {
            let now = Instant::now();
            (now - std::mem::replace(&mut clock, now)).as_secs_f64()
        };
        sight.render(&facts.on_route.state.pose, self.mode);
        let behind = sight.render_behind(facts);
        self.times.camera = lap();
        let Some(perception) = &mut sight.perception else { return Ok(()) };
        let ego = &facts.on_route.state.pose;
        sight.left = behind.map(|mirror| ego.to_local(mirror.xy()).y > 0.0);
        if let (Some(pose), Some(mirror)) = (behind, &sight.mirror) {
            perception.detect_behind(mirror.frame(), &pose, facts.tick)?;
        }
        let frame = sight.camera.frame();
        perception.detect(frame)?;
        self.times.detect = lap();
        let encodes = self.mode.encodes();
        if encodes {
            perception.find_lanes(frame, facts);
            self.times.lanes = lap();
        }
        perception.judge(facts);
        self.times.judge = lap();
        if encodes {
            perception.transform(frame)?;
            self.times.transform = lap();
        }
        let percept = perception.percept();
        (self.light, self.raw) = (percept.light, percept.raw);
        if let Some(encoder) = self.encoder.as_mut().filter(|_| encodes) {
            encoder.encode(&percept.transformed, &mut self.latent)?;
            self.times.encode = lap();
        }
        if let Some(decoder) = self.decoder.as_mut().filter(|_| encodes) {
            let image = self.reconstruction.get_or_insert_default();
            match &self.encoder {
                Some(encoder) if encoder.hash() == decoder.hash() => decoder.decode(&self.latent, image)?,
                _ => *image = decoder.reconstruct(&percept.transformed)?,
            }
        }
        Ok(())
    }

    /// Takes the camera's picture from `pose` and perceives nothing.
    pub fn glance(&mut self, pose: &Pose) {
        if let Some(sight) = &mut self.sight {
            sight.render(pose, self.mode);
        }
    }

    /// The same, and finds the objects in it, for display: nothing is judged by them.
    ///
    /// # Errors
    /// The detector fails.
    pub fn spot(&mut self, pose: &Pose) -> Result<(), EyesError> {
        self.glance(pose);
        if let Some(Sight { camera, perception: Some(perception), .. }) = &mut self.sight {
            perception.detect(camera.frame())?;
        }
        Ok(())
    }

    /// The agent's observation of the last look.
    pub fn observation(&self) -> Observation {
        let raw = match self.mode {
            ObservationMode::LatentOnly => [0.0; RAW_SIZE],
            _ => self.raw.vector(),
        };
        Observation { latent: self.latent.clone(), raw }
    }

    /// The same into `row`: [`ObservationMode::latent_size`] numbers, then [`RAW_SIZE`].
    ///
    /// # Panics
    /// `row` has another length.
    pub fn write_observation(&self, row: &mut [f32]) {
        let (latent, raw) = row.split_at_mut(self.latent.len());
        latent.copy_from_slice(&self.latent);
        match self.mode {
            ObservationMode::LatentOnly => raw.fill(0.0),
            _ => raw.copy_from_slice(&self.raw.vector()),
        }
    }

    /// The raw states by name, in units.
    pub fn raw(&self) -> &RawState {
        &self.raw
    }

    /// The latent: [`LATENT_SIZE`] numbers.
    pub fn latent(&self) -> &[f32] {
        &self.latent
    }

    /// Whether looks make a latent.
    pub fn encodes(&self) -> bool {
        self.encoder.is_some() && self.mode.encodes() && self.perception().is_some()
    }

    /// The next signal on the route.
    pub fn light(&self) -> Option<&LightAhead> {
        self.light.as_ref()
    }

    /// The last frame; None without a camera.
    pub fn frame(&self) -> Option<&Frame> {
        self.sight.as_ref().map(|sight| sight.camera.frame())
    }

    /// The perception; None where there is none.
    pub fn perception(&self) -> Option<&Perception> {
        self.sight.as_ref()?.perception.as_ref()
    }

    /// The last frame's percept; None without perception.
    pub fn percept(&self) -> Option<&Percept> {
        self.perception().map(Perception::percept)
    }

    /// The last transformed image; None where none is made.
    pub fn image(&self) -> Option<&TransformedImage> {
        self.percept().filter(|_| self.mode.encodes()).map(|percept| &percept.transformed)
    }

    /// The last transformed image as the latent holds it; None without a decoder.
    pub fn reconstruction(&self) -> Option<&TransformedImage> {
        self.reconstruction.as_ref()
    }

    /// Frame and percept of the last look, to be handed to another thread; None where there is no perception.
    pub fn last_look(&self) -> Option<Look> {
        // Before the first look, and where the boxes alone were rendered, there is no picture.
        let frame = self.frame().filter(|frame| !frame.rgb.is_empty())?;
        Some(Look { frame: frame.clone(), percept: self.percept()?.clone(), mirror: self.mirror() })
    }

    /// What the last look saw in a mirror; None where it went into none, or the detector needs no picture.
    pub fn mirror(&self) -> Option<stages::MirrorView> {
        let Sight { mirror, perception, left, .. } = self.sight.as_ref()?;
        let (left, perception) = ((*left)?, perception.as_ref()?);
        let frame = mirror.as_ref()?.frame();
        let has_picture = !frame.rgb.is_empty();
        let picture = || stages::detections(frame, perception.behind()).mirrored();
        has_picture.then(|| stages::MirrorView { left, picture: picture() })
    }

    /// Wall time of the last look, by part.
    pub fn times(&self) -> LookTimes {
        self.times
    }

    /// How many pictures [`Eyes::strip`] has.
    pub fn panels(&self) -> usize {
        match (self.perception(), &self.decoder) {
            (None, _) => 0,
            (Some(_), None) => 3,
            (Some(_), Some(_)) => 4,
        }
    }

    /// The stages side by side, `side` pixels each: camera, what was seen (in a mirror too), transformed, reconstruction.
    /// None where there is no perception.
    pub fn strip(&self, side: usize) -> Option<Picture> {
        let ground = self.perception()?.ground();
        Some(stages::strip(
            self.frame()?,
            self.percept()?,
            ground,
            self.mirror().as_ref(),
            self.reconstruction(),
            side,
        ))
    }
}

impl Sight {
    fn render(&mut self, pose: &Pose, mode: ObservationMode) {
        let needs = self.perception.as_ref().map_or(Outputs::RGB, Perception::needs);
        let picture = if mode.encodes() { Outputs::RGB } else { Outputs::NONE };
        let outputs = self.outputs.with(needs).with(picture);
        self.camera.render(self.town.scene(), self.town.actors(), pose, &self.weather, outputs);
    }

    /// Renders what is in the mirror, if there is one to look into, and tells from where.
    fn render_behind(&mut self, facts: &EgoFacts<'_>) -> Option<Pose> {
        let (mirror, needs) = (self.mirror.as_mut()?, self.perception.as_ref()?.needs());
        let pose = mirrors::pose(facts)?;
        let outputs = self.outputs.with(needs);
        mirror.render(self.town.scene(), self.town.actors(), &pose, &self.weather, outputs);
        Some(pose)
    }
}

#[cfg(test)]
mod tests;
