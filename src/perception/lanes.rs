//! The ego lane's painted boundaries (paper, "Lane Detection").

use super::GroundPlane;
use serde::{Deserialize, Serialize};

/// A painted line along the lane, on the ground: `y(x) = offset + slope x + bend x^2 / 2`, x ahead and y
/// left of the ego's centre (m).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LaneBoundary {
    /// y beside the ego (m).
    pub offset: f32,
    pub slope: f32,
    /// 1/m.
    pub bend: f32,
    /// How far ahead it holds: from, to (m).
    pub reach: [f32; 2],
}

impl LaneBoundary {
    /// y (m, left positive) at `x` m ahead.
    pub fn y(&self, x: f32) -> f32 {
        self.offset + x * (self.slope + 0.5 * x * self.bend)
    }

    /// The line in the picture, from near to far, about every 1.5 m where it is near and wider apart beyond.
    pub fn pixels(&self, ground: &GroundPlane) -> Vec<[f32; 2]> {
        let [from, to] = self.reach;
        let steps = 12;
        // Even in the picture rather than on the ground: distances grow geometrically.
        let (low, ratio) = (from.max(1.0), (to.max(from + 0.5) / from.max(1.0)).powf(1.0 / steps as f32));
        (0..=steps)
            .filter_map(|i| {
                ground.pixel({
                    let x = low * ratio.powi(i);
                    [x, self.y(x)]
                })
            })
            .collect()
    }
}

/// What is seen of the ego's lane. Nothing inside junctions, where there are no lines.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LaneEstimate {
    pub left: Option<LaneBoundary>,
    pub right: Option<LaneBoundary>,
}
