//! Detected lane boundaries against the painted ones.

use super::{Spread, share};
use crate::perception::road_truth::ego_lane;
use crate::perception::{EgoFacts, GroundPlane, LaneEstimate};
use serde::Serialize;
use sumo_network::geometry::{Pose, Vector};
use sumo_network::network::Network;
use wad_camera::Frame;
use wad_camera::model::SemanticTag;
use wad_camera::scene::painted_sides;

/// Where lateral errors are measured (m ahead of the ego's centre).
pub const MEASURED_AT: f64 = 10.0;
/// A boundary within this of the true one is found (m).
pub(super) const FOUND: f64 = 0.5;

/// A painted boundary next to the ego's lane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PaintedLine {
    /// y (m, left positive) at [`MEASURED_AT`].
    pub y: f64,
    /// Whether no road user hides most of it.
    pub visible: bool,
}

/// The painted boundaries of the lane that the ego's centre is on. None if the ego is inside a junction, or
/// will be within [`MEASURED_AT`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LaneTruth {
    /// Left and right boundary; None without a painted line.
    pub sides: [Option<PaintedLine>; 2],
}

impl LaneTruth {
    /// From the network; `frame` must hold semantic tags.
    pub fn find(facts: &EgoFacts<'_>, ground: &GroundPlane, frame: &Frame) -> Option<Self> {
        let network = facts.network;
        let pose = facts.on_route.state.pose;
        let lane = ego_lane(facts)?;
        let begin = network.lane(lane).shape.project(pose.xy()).s;
        let sides = painted_sides(network, lane)
            .map(|side| side.map(|d| line(network, lane, begin, d, &pose, ground, frame)));
        // A lane that ends before the place of measurement has no line there.
        match sides {
            [Some(None), _] | [_, Some(None)] => None,
            [left, right] => Some(Self { sides: [left.flatten(), right.flatten()] }),
        }
    }
}

/// The line `d` m left of a lane's centre, in the ego's frame.
fn line(
    network: &Network,
    lane: sumo_network::network::LaneId,
    begin: f64,
    d: f64,
    pose: &Pose,
    ground: &GroundPlane,
    frame: &Frame,
) -> Option<PaintedLine> {
    let shape = &network.lane(lane).shape;
    let place = |s: f64| pose.to_local(shape.at(s).to_world(Vector::new(0.0, d)));
    let end = shape.length() - 0.5;
    let (mut before, mut y) = (place(begin), None);
    let (mut shown, mut all) = (0, 0);
    let mut s = begin;
    while s < (begin + 25.0).min(end) {
        s += 0.5;
        let here = place(s);
        if before.x < MEASURED_AT && here.x >= MEASURED_AT {
            let t = (MEASURED_AT - before.x) / (here.x - before.x);
            y = Some(before.y + t * (here.y - before.y));
        }
        if (5.0..15.0).contains(&here.x)
            && let Some([px, py]) = ground.pixel([here.x as f32, here.y as f32])
            && px >= 0.0
            && py >= 0.0
            && (px as usize) < frame.width
            && (py as usize) < frame.height
        {
            let tag = frame.semantic.get(py as usize * frame.width + px as usize).copied();
            let road =
                [SemanticTag::Road, SemanticTag::RoadLine, SemanticTag::SideWalk, SemanticTag::Terrain];
            all += 1;
            shown += usize::from(tag.is_some_and(|tag| road.iter().any(|r| *r as u8 == tag)));
        }
        before = here;
    }
    Some(PaintedLine { y: y?, visible: 2 * shown > all })
}

/// Counts over frames.
#[derive(Clone, Debug, Default)]
pub struct LaneScore {
    frames: usize,
    /// Painted boundaries, and the found ones; of all and of the visible.
    painted: [usize; 2],
    found: [usize; 2],
    detected: usize,
    errors: Vec<f64>,
}

/// The figures of a weather.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct LaneReport {
    /// Frames on a marked road with no junction within 10 m.
    pub frames: usize,
    /// Painted boundaries next to the ego's lane that no road user hides.
    pub painted: usize,
    /// Share of the detected ones that are within 0.5 m of the painted one at 10 m.
    pub precision: Option<f64>,
    /// Share of the painted ones that are detected within 0.5 m at 10 m; of the visible ones, and of all.
    pub recall: Option<f64>,
    pub recall_hidden_too: Option<f64>,
    /// Absolute lateral error at 10 m (m) of everything detected where a boundary is.
    pub lateral_error: Spread,
    /// Mean lateral error (m, left positive).
    pub bias: Option<f64>,
}

impl LaneScore {
    /// Counts a frame.
    pub fn add(&mut self, lanes: &LaneEstimate, truth: &LaneTruth) {
        self.frames += 1;
        for (seen, painted) in [lanes.left, lanes.right].iter().zip(truth.sides) {
            let y = seen.map(|line| f64::from(line.y(MEASURED_AT as f32)));
            self.detected += usize::from(y.is_some());
            let Some(painted) = painted else { continue };
            let error = y.map(|y| y - painted.y);
            self.errors.extend(error);
            let found = error.is_some_and(|e| e.abs() <= FOUND);
            for (kind, counts) in [true, painted.visible].into_iter().enumerate() {
                self.painted[kind] += usize::from(counts);
                self.found[kind] += usize::from(counts && found);
            }
        }
    }

    /// The figures.
    pub fn report(&self) -> LaneReport {
        LaneReport {
            frames: self.frames,
            painted: self.painted[1],
            precision: share(self.found[0], self.detected),
            recall: share(self.found[1], self.painted[1]),
            recall_hidden_too: share(self.found[0], self.painted[0]),
            lateral_error: Spread::of(&self.errors),
            bias: (!self.errors.is_empty())
                .then(|| self.errors.iter().sum::<f64>() / self.errors.len() as f64),
        }
    }
}
