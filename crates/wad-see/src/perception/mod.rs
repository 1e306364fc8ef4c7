//! Perception: from the camera's picture to the agent's percept (paper, section "Detection Module").
//!
//! ```text
//! Frame --Detector--> detections --\
//!       --lanes-----> boundaries ---> transformed image 128x128x3 --> latent::Encoder
//! signals --light---> red or not --/
//! ```

mod area;
pub mod centernet;
mod choice;
pub mod coco;
mod crossing;
mod facts;
mod ground;
pub mod heads;
mod image;
mod lanes;
pub mod lead;
mod least_score;
mod light;
pub mod metrics;
pub mod mirrors;
#[cfg(feature = "vision")]
mod onnx;
pub mod onnx_file;
pub mod paint;
mod pipeline;
mod road_truth;
mod road_users;
pub mod score;
pub mod sight_score;
mod signs;
pub mod stages;
#[cfg(test)]
pub(crate) mod testing;
mod truth;

pub use area::DrivableArea;
pub use choice::{
    DEFAULT_DETECTOR, DETECTORS, centernet_weights, check, detector, sees_the_road, weights_hash,
};
pub use facts::{EgoFacts, NearGaps};
pub use ground::GroundPlane;
pub use image::{ImageKind, TRANSFORMED_SIZE, TransformedImage};
pub use lanes::{LaneBoundary, LaneDetector, LaneEstimate};
pub use least_score::LeastScore;
pub use light::{AT_INTERSECTION, BY_SIGHT, LightAhead, SeenLights, StopLight};
#[cfg(feature = "vision")]
pub use onnx::OnnxDetector;
pub use pipeline::{Percept, Perception};
pub use road_truth::{Heads, RoadTruth, RoadWanted, colour};
pub use signs::{IN_TOWNS, SeenLimit, SeenSign, SignTruth};
pub use truth::{Faults, TruthDetector};

use sumo_network::world::SignalState;
use wad_camera::model::ObjectClass;
use wad_camera::{CameraConfig, Frame, Outputs};

/// An object found in a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Detection {
    /// Its class.
    pub class: ObjectClass,
    /// Left, top, right, bottom (pixels of the picture; right and bottom exclusive).
    pub bounds: [f32; 4],
    /// Confidence, 0 to 1.
    pub score: f32,
}

impl Detection {
    /// Width and height (pixels).
    pub fn size(&self) -> [f32; 2] {
        let [left, top, right, bottom] = self.bounds;
        [right - left, bottom - top]
    }

    /// Intersection over union with another box.
    pub fn iou(&self, other: &[f32; 4]) -> f32 {
        let [l, t, r, b] = self.bounds;
        let [ol, ot, or, ob] = *other;
        let area = |l: f32, t: f32, r: f32, b: f32| (r - l).max(0.0) * (b - t).max(0.0);
        let common = area(l.max(ol), t.max(ot), r.min(or), b.min(ob));
        let union = area(l, t, r, b) + area(ol, ot, or, ob) - common;
        if union > 0.0 { common / union } else { 0.0 }
    }
}

/// What a detector that sees the road found in a picture beside objects.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Seen {
    /// The boundaries of the ego's lane; none inside junctions.
    pub lanes: LaneEstimate,
    /// The light that is the ego's.
    pub light: Option<SeenLight>,
    /// Signs, the surest first.
    pub signs: [Option<SeenSign>; 4],
    /// What is road.
    pub area: DrivableArea,
}

/// A light in a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SeenLight {
    /// The lamp that is lit: red, yellow or green.
    pub state: SignalState,
    /// From the front bumper to the stop line (m).
    pub distance: f64,
    /// 0 to 1.
    pub certainty: f32,
}

/// Why perception fails.
#[derive(Debug, thiserror::Error)]
pub enum PerceptionError {
    /// The detector fails.
    #[error("detector {name}: {why}")]
    Detector {
        /// The detector's name.
        name: String,
        /// What went wrong.
        why: String,
    },
    /// The picture's size is not the camera's.
    #[error("expected a picture of {expected:?} (width, height), found {found:?}: {hint}")]
    Size {
        /// Width and height expected (pixels).
        expected: (usize, usize),
        /// Width and height found (pixels).
        found: (usize, usize),
        /// What to do.
        hint: String,
    },
}

/// Finds objects of the eight classes in front of the ego.
pub trait Detector: Send {
    /// Its name in tables and options, e.g. `truth` or `centernet`.
    fn name(&self) -> &str;

    /// The outputs that the camera must render for it.
    fn needs(&self) -> Outputs {
        Outputs::RGB
    }

    /// The camera that its weights belong to; None where it sees through any.
    fn camera(&self) -> Option<CameraConfig> {
        None
    }

    /// The same for another camera of the ego's, with a memory of its own. None where it remembers nothing from frame to
    /// frame: then one serves both.
    fn for_another_camera(&self) -> Option<Box<dyn Detector>> {
        None
    }

    /// Begins an episode: clears its memory and draws its faults from `seed`.
    fn reset(&mut self, seed: u64) {
        let _ = seed;
    }

    /// The objects in `frame`, best first, appended to `found` (which is emptied first).
    ///
    /// # Errors
    /// The frame has another size than the network wants, or the network fails.
    fn detect(
        &mut self,
        frame: &Frame,
        camera: &CameraConfig,
        found: &mut Vec<Detection>,
    ) -> Result<(), PerceptionError>;

    /// What it saw of lane and light in the last frame. None where it sees objects only: then lanes are detected by
    /// Canny and Hough, and the light's state comes from the simulator, as in the paper.
    fn seen(&self) -> Option<&Seen> {
        None
    }
}
