//! The camera: renders SUMO's town and traffic, with depth, semantic tags, instance ids and boxes.
//!
//! ```text
//! Network --scene--> Scene    (built once)     \
//! WorldState --actors--> ActorFrame (per tick)  > Camera::render --> Frame: rgb, depth, tags, ids, boxes
//! Weather (one of CARLA's 14)                  /
//! ```
//!
//! `camera.render(&scene, &actors, &pose, &weather, Outputs::ALL) -> &Frame`, where `pose` is the ego's
//! (centre of the footprint, world frame) and the mount says where on it the camera sits. Equal input
//! gives equal bits on one machine. One thread, no GPU; another [`Renderer`] can take its place.

pub mod actors;
mod config;
mod cpu;
mod effects;
mod error;
mod frame;
mod gather;
mod grid;
mod ground_marks;
mod lanes;
mod large;
mod material;
mod mesh;
pub mod model;
mod noise;
mod outlines;
mod picture;
mod raster;
mod row;
pub mod scene;
mod shade;
mod shade_ground;
mod shadow_map;
mod shape;
mod simd;
mod sky;
mod stages;
mod surface;
mod town;
pub mod variety;
mod view;
mod walls;
mod weather;

#[cfg(test)]
mod tests;

pub use config::{CameraConfig, MAX_PIXELS, Mount};
pub use cpu::CpuRenderer;
pub use error::CameraError;
pub use frame::{Frame, ObjectTruth, Outputs};
pub use picture::Picture;
pub use simd::{Instructions, instructions};
pub use stages::Stages;
pub use town::Town;
pub use view::View;
pub use weather::distance;
pub use weather::{Preset, Weather};

use model::{ActorFrame, Scene};
use sumo_network::geometry::Pose;

/// Everything that a renderer needs for a picture.
#[derive(Clone, Copy)]
pub struct Shot<'a> {
    /// The town.
    pub scene: &'a Scene,
    /// The road users.
    pub actors: &'a ActorFrame,
    /// The camera's place and optics.
    pub view: &'a View,
    /// The weather.
    pub weather: &'a Weather,
    /// The buffers that the frame needs.
    pub outputs: Outputs,
    /// Draws [`ActorFrame::ego`] too.
    pub shows_ego: bool,
}

/// Renders shots into frames. It may keep caches, but equal shots give equal frames.
pub trait Renderer {
    /// Renders into `frame`, whose buffers are reused.
    fn render(&mut self, shot: &Shot<'_>, frame: &mut Frame);
    /// Times the stages of frames from now on, or stops that. Timing itself takes some time.
    fn time_stages(&mut self, _on: bool) {}
    /// Time of the last frame's stages, if it was timed.
    fn stages(&self) -> Stages {
        Stages::default()
    }
}

/// A camera on a vehicle.
pub struct Camera {
    config: CameraConfig,
    renderer: Box<dyn Renderer + Send>,
    frame: Frame,
}

impl Camera {
    /// A camera that renders on the processor.
    ///
    /// # Errors
    /// The size or the field of view is out of range.
    pub fn new(config: CameraConfig) -> Result<Self, CameraError> {
        Self::with_renderer(config, Box::<CpuRenderer>::default())
    }

    /// A camera with another renderer.
    ///
    /// # Errors
    /// As [`Camera::new`].
    pub fn with_renderer(
        config: CameraConfig,
        renderer: Box<dyn Renderer + Send>,
    ) -> Result<Self, CameraError> {
        config.check()?;
        Ok(Self { config, renderer, frame: Frame::default() })
    }

    /// Its configuration.
    pub fn config(&self) -> &CameraConfig {
        &self.config
    }

    /// Renders the view from a vehicle whose footprint's centre is at `pose`.
    pub fn render(
        &mut self,
        scene: &Scene,
        actors: &ActorFrame,
        pose: &Pose,
        weather: &Weather,
        outputs: Outputs,
    ) -> &Frame {
        let view = View::new(&self.config, pose);
        let shows_ego = self.config.shows_ego();
        self.renderer
            .render(&Shot { scene, actors, view: &view, weather, outputs, shows_ego }, &mut self.frame);
        &self.frame
    }

    /// Times the stages of frames from now on, or stops that. Timing costs some percent.
    pub fn time_stages(&mut self, on: bool) {
        self.renderer.time_stages(on);
    }

    /// Time of the last frame's stages; zeros if it was not timed.
    pub fn stages(&self) -> Stages {
        self.renderer.stages()
    }

    /// The last frame.
    pub fn frame(&self) -> &Frame {
        &self.frame
    }
}

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
