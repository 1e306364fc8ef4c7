//! The record of one frame in a dataset.

use serde::{Deserialize, Serialize};
use sumo_network::world::SignalState;
use wad_camera::model::ObjectClass;
use wad_camera::{ObjectTruth, Preset};
use wad_see::observation::RawState;
use wad_see::perception::{LaneEstimate, RoadTruth, TransformedImage};
use wad_vehicle::{Control, EgoState};

/// An object in the picture: ground truth, not a detection.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct BoxRecord {
    /// The detector's class.
    pub class: ObjectClass,
    /// Equal over the frames of a shard.
    pub id: u32,
    /// Left, top, right, bottom of the pixels that show it (camera pixels; right and bottom exclusive).
    pub visible: [u32; 4],
    /// The same for the whole object, hidden pixels included, cut at the picture's borders.
    pub full: [f32; 4],
    /// Camera pixels that show it.
    pub pixels: u32,
    /// Depth of its middle (m).
    pub depth: f32,
}

impl From<&ObjectTruth> for BoxRecord {
    fn from(truth: &ObjectTruth) -> Self {
        Self {
            class: truth.class,
            id: truth.id,
            visible: truth.visible_box,
            full: truth.full_box,
            pixels: truth.visible_pixels,
            depth: truth.depth,
        }
    }
}

/// The labels of the linear probes: from SUMO's truth, but only for what the picture shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Labels {
    /// Gap to the nearest visible vehicle in the ego's lane (m, from the front bumper).
    pub lead: Option<f64>,
    /// Distance to the nearest visible pedestrian in the ego's lane (m, from the front bumper).
    pub pedestrian: Option<f64>,
    /// The transformed image shows a red light.
    pub red: bool,
}

/// Everything of a frame except its pictures.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrameRecord {
    /// Simulation time (s).
    pub time: f64,
    /// The frame's weather.
    pub weather: Preset,
    /// The ego's state.
    pub ego: EgoState,
    /// The control of the tick before, with noise.
    pub control: Control,
    /// Noise acts, or the ego is still recovering from it.
    pub disturbed: bool,
    /// Objects in the picture, near and far.
    pub boxes: Vec<BoxRecord>,
    /// The next signal's state and the distance from the front bumper to its stop line (m).
    pub light: Option<(SignalState, f64)>,
    /// The six raw states with the truth detector.
    pub raw: RawState,
    /// Labels for linear probes.
    pub labels: Labels,
    /// Lane boundaries as perception found them.
    pub lanes: LaneEstimate,
    /// What is true of lane and light; None in datasets that were collected before this was kept. Its ids are those
    /// of `boxes`.
    #[serde(default)]
    pub road: Option<RoadTruth>,
}

/// A frame of a shard.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// Everything but the pictures.
    pub record: FrameRecord,
    /// The transformed image, 128x128.
    pub transformed: TransformedImage,
    /// The camera's picture, encoded as the shard's header says; empty where not kept.
    pub camera: Vec<u8>,
}
