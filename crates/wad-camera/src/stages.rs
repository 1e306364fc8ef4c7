//! The time of a frame's stages.

use std::time::Instant;

/// The parts of a frame's making, in ms.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct Stages {
    /// Culling, vertices, the map of shadows.
    pub geometry: f64,
    /// Faces into the visibility buffer, with the ground plane.
    pub raster: f64,
    /// Paint, surfaces, colours, haze, and the other outputs per pixel.
    pub shade: f64,
    /// Mirrors, smooth outlines, rain, bytes, glows, boxes.
    pub effects: f64,
}

/// Measures the time of stages while it is on.
#[derive(Debug, Default)]
pub(super) struct Watch {
    on: bool,
    since: Option<Instant>,
    pub spent: Stages,
}

impl Watch {
    pub fn switch(&mut self, on: bool) {
        self.on = on;
    }

    /// A new frame.
    pub fn start(&mut self) {
        self.spent = Stages::default();
        self.since = self.on.then(Instant::now);
    }

    /// What passed since the last call belongs to `stage`.
    #[inline(always)]
    pub fn lap(&mut self, stage: fn(&mut Stages) -> &mut f64) {
        if let Some(since) = &mut self.since {
            let now = Instant::now();
            *stage(&mut self.spent) += (now - *since).as_secs_f64() * 1000.0;
            *since = now;
        }
    }
}
