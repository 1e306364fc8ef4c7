//! The record of one frame in a dataset.

use serde::{Deserialize, Serialize};
use sumo_network::world::SignalState;
use wad_camera::model::ObjectClass;
use wad_camera::{ObjectTruth, Preset};
use wad_see::observation::RawState;
use wad_see::perception::{LaneEstimate, TransformedImage};
use wad_vehicle::{Control, EgoState};

/// An object in the picture: the truth, not a detector's opinion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct BoxRecord {
    pub class: ObjectClass,
    /// Equal over the frames of a shard.
    pub id: u32,
    /// Left, top, right, bottom of the pixels that show it (camera pixels; right and bottom exclusive).
    pub visible: [u32; 4],
    /// The same of all of it, cut at the picture's borders.
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

/// What linear probes look for; from SUMO's truth, but only what the picture shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Labels {
    /// Gap to the nearest visible vehicle in the ego's lane (m, from the front bumper).
    pub lead: Option<f64>,
    /// Distance to the nearest visible pedestrian in the ego's lane (m, from the front bumper).
    pub pedestrian: Option<f64>,
    /// The light is painted red.
    pub red: bool,
}

/// Everything about a frame but its pictures.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrameRecord {
    /// Simulation time (s).
    pub time: f64,
    pub weather: Preset,
    pub ego: EgoState,
    /// What the ego was steered with in the tick before, noise included.
    pub control: Control,
    /// Noise acts, or the ego is still recovering from it.
    pub disturbed: bool,
    pub boxes: Vec<BoxRecord>,
    /// The next signal's state and the distance from the front bumper to its stop line (m).
    pub light: Option<(SignalState, f64)>,
    /// The six raw states with the truth detector.
    pub raw: RawState,
    pub labels: Labels,
    /// Lane boundaries as perception found them.
    pub lanes: LaneEstimate,
}

/// A frame as it lies in a shard.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    pub record: FrameRecord,
    pub transformed: TransformedImage,
    /// The camera's picture, encoded as the shard's header says; empty where not kept.
    pub camera: Vec<u8>,
}
