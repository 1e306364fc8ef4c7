//! A frame's ground truth that the latent should hold: the labels of the linear probes.

use crate::dataset::{FrameRecord, Labels};

/// A vehicle nearer than this counts (m).
pub const LEAD: f64 = 20.0;
/// A pedestrian nearer than this counts (m).
pub const PEDESTRIAN: f64 = 15.0;
/// An ego further from its lane's centre has left it (m).
const NEAR_LANE: f64 = 1.75;
/// A route that turns less than this is straight (rad).
const STRAIGHT: f64 = 0.15;

/// The labels that probes are fitted to and measured by; `--label-weight` trains on them too.
#[derive(Clone, Copy, Debug)]
pub struct Told {
    /// Vehicle, pedestrian and light.
    pub labels: Labels,
    /// Offset from the lane's centre (m) and heading error (rad), if a boundary is in sight.
    pub on_lane: Option<[f64; 2]>,
    /// The route goes straight on for the next waypoints.
    pub straight: bool,
    /// Middle (m) and slope of the painted boundaries.
    pub painted: Option<[f64; 2]>,
}

impl Told {
    /// From a frame's record.
    pub fn of(record: &FrameRecord) -> Self {
        let sees = record.lanes.left.is_some() || record.lanes.right.is_some();
        let near = record.raw.lateral.abs() < NEAR_LANE;
        let on_lane = (sees && near).then_some([record.raw.lateral, record.raw.heading_error]);
        let turns = [record.raw.heading_error, record.raw.heading_error_far];
        let straight = turns.iter().all(|turn| turn.abs() < STRAIGHT);
        let painted = record.lanes.left.as_ref().zip(record.lanes.right.as_ref());
        let painted = painted.map(|(l, r)| [0.5 * f64::from(l.offset + r.offset), f64::from(l.slope)]);
        Self { labels: record.labels, on_lane, straight, painted }
    }

    /// A vehicle is in the ego's lane within [`LEAD`].
    pub fn has_lead(&self) -> bool {
        self.gap().is_some()
    }

    /// A pedestrian is in the ego's lane within [`PEDESTRIAN`].
    pub fn has_pedestrian(&self) -> bool {
        self.labels.pedestrian.is_some_and(|gap| gap <= PEDESTRIAN)
    }

    /// Gap to the vehicle in the ego's lane (m), within [`LEAD`].
    pub fn gap(&self) -> Option<f64> {
        self.labels.lead.filter(|gap| *gap <= LEAD)
    }

    /// Middle of the painted boundaries (m, left of the ego).
    pub fn middle(&self) -> Option<f64> {
        self.painted.map(|[middle, _]| middle)
    }

    /// Their slope.
    pub fn slope(&self) -> Option<f64> {
        self.painted.map(|[_, slope]| slope)
    }
}
