//! The ego's eyes in a run: its front camera and what it makes of the picture, tick by tick.

use crate::bridge::Ego;
use crate::camera::{Camera, CameraConfig, CameraError, Frame, Picture, Town, Weather};
use crate::latent::Decoder;
use crate::network::Network;
use crate::perception::{Detector, EgoFacts, Percept, Perception, PerceptionError, TransformedImage, stages};

/// Why the ego sees nothing.
#[derive(Debug, thiserror::Error)]
pub enum WatchError {
    #[error(transparent)]
    Camera(#[from] CameraError),
    #[error(transparent)]
    Perception(#[from] PerceptionError),
    #[error(transparent)]
    Latent(#[from] crate::latent::LatentError),
}

/// A front camera with perception behind it.
pub struct Watch {
    camera: Camera,
    perception: Perception,
    decoder: Option<Box<dyn Decoder>>,
    reconstruction: Option<TransformedImage>,
}

impl Watch {
    /// A camera of `config` and perception with `detector`.
    ///
    /// # Errors
    /// A camera that cannot be, or a build without OpenCV.
    pub fn new(detector: Box<dyn Detector>, config: CameraConfig) -> Result<Self, WatchError> {
        let perception = Perception::new(detector, config)?;
        Ok(Self { camera: Camera::new(config)?, perception, decoder: None, reconstruction: None })
    }

    /// Also shows what the latent of each transformed image holds.
    pub fn with_decoder(self, decoder: Box<dyn Decoder>) -> Self {
        Self { decoder: Some(decoder), ..self }
    }

    /// Begins an episode.
    pub fn reset(&mut self, seed: u64) {
        self.perception.reset(seed);
    }

    /// What `ego` sees in `town` after a tick of `tick` s.
    ///
    /// # Errors
    /// A stage fails.
    pub fn look(
        &mut self,
        town: &Town,
        weather: &Weather,
        network: &Network,
        ego: &Ego,
        tick: f64,
    ) -> Result<&Percept, WatchError> {
        let outputs = self.perception.needs();
        let frame = self.camera.render(town.scene(), town.actors(), &ego.state().pose, weather, outputs);
        self.perception.perceive(frame, &EgoFacts::of(network, ego, tick))?;
        if let Some(decoder) = &mut self.decoder {
            self.reconstruction = Some(decoder.reconstruct(&self.perception.percept().transformed)?);
        }
        Ok(self.perception.percept())
    }

    /// The last frame.
    pub fn frame(&self) -> &Frame {
        self.camera.frame()
    }

    /// What was made of it.
    pub fn percept(&self) -> &Percept {
        self.perception.percept()
    }

    /// The perception.
    pub fn perception(&self) -> &Perception {
        &self.perception
    }

    /// The last transformed image as the latent holds it, where a decoder is there.
    pub fn reconstruction(&self) -> Option<&TransformedImage> {
        self.reconstruction.as_ref()
    }

    /// How many pictures [`Watch::strip`] has.
    pub fn panels(&self) -> usize {
        if self.decoder.is_some() { 4 } else { 3 }
    }

    /// The stages side by side, `side` pixels each: camera, detections, transformed, reconstruction.
    pub fn strip(&self, side: usize) -> Picture {
        stages::strip(self.frame(), self.percept(), self.reconstruction(), side)
    }
}
