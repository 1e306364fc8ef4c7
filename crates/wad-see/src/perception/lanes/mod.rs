//! The ego lane's painted boundaries (paper, "Lane Detection").
//!
//! ```text
//! picture --region of interest, Canny, threshold, Hough--> pieces of lines --on the ground--> fit --> boundaries
//! ```
//!
//! Inside junctions there are no lines to detect (as in the paper), and the region of interest ends at a
//! stop line. The waypoints say where junctions and stop lines are.

mod canny;
mod edges;
mod fit;
mod hough;
#[cfg(test)]
mod tests;

use super::{EgoFacts, GroundPlane};
use serde::{Deserialize, Serialize};
use sumo_network::geometry::{Pose, Vector};
use wad_camera::Frame;

/// A painted line along the lane, on the ground: `y(x) = offset + slope x + bend x^2 / 2`, x ahead and y
/// left of the ego's centre (m).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LaneBoundary {
    /// y beside the ego (m).
    pub offset: f32,
    /// dy/dx beside the ego.
    pub slope: f32,
    /// 1/m.
    pub bend: f32,
    /// Range ahead of the ego in which it holds: from, to (m).
    pub reach: [f32; 2],
}

impl LaneBoundary {
    /// y (m, left positive) at `x` m ahead.
    pub fn y(&self, x: f32) -> f32 {
        self.offset + x * (self.slope + 0.5 * x * self.bend)
    }

    /// The line in the picture, 13 points from near to far, even in the picture rather than on the ground.
    pub fn pixels(&self, ground: &GroundPlane) -> Vec<[f32; 2]> {
        const STEPS: i32 = 12;
        let near = self.reach[0].max(1.0);
        let ratio = (self.reach[1].max(near + 0.5) / near).powf(1.0 / STEPS as f32);
        let places = (0..=STEPS).map(|i| near * ratio.powi(i));
        places.filter_map(|x| ground.pixel([x, self.y(x)])).collect()
    }
}

/// The detected boundaries of the ego's lane; none inside junctions, where there are no lines.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LaneEstimate {
    /// The left boundary.
    pub left: Option<LaneBoundary>,
    /// The right boundary.
    pub right: Option<LaneBoundary>,
}

/// Pieces of painted lines on the ground (m, ego frame).
#[derive(Clone, Debug, Default)]
struct Pieces {
    /// Straight pieces, near end first.
    segments: Vec<[[f32; 2]; 2]>,
    /// The pixels of stripes.
    stripes: Vec<[f32; 2]>,
}

/// Range in which lines are searched (m ahead of the ego's centre).
const NEAR: f32 = 4.0;
const FAR: f32 = 28.0;
/// With less road than this between [`NEAR`] and the stop line (m), no detection runs.
const LEAST_ROAD: f32 = 5.0;
/// Ticks that a boundary is kept without being detected.
const COAST: u32 = 3;

/// Finds the boundaries, tick by tick.
#[derive(Debug, Default)]
pub struct LaneDetector {
    finder: edges::EdgeFinder,
    fitter: fit::Fitter,
    pieces: Pieces,
    /// Where the ego was at the last tick, and the boundaries and their ages (ticks) then.
    last: Option<(Pose, [Option<Aged>; 2])>,
}

/// A boundary and for how many ticks it has not been seen.
type Aged = (LaneBoundary, u32);

impl LaneDetector {
    /// Forgets what it saw.
    pub fn reset(&mut self) {
        self.last = None;
    }

    /// The boundaries in `frame`.
    pub fn find(&mut self, frame: &Frame, ground: &GroundPlane, facts: &EgoFacts<'_>) -> LaneEstimate {
        let far = road_ahead(facts).min(f64::from(FAR)) as f32;
        if far < NEAR + LEAST_ROAD {
            self.last = None;
            return LaneEstimate::default();
        }
        let pose = facts.on_route.state.pose;
        let before = self.last.take().map(|(was, sides)| {
            sides.map(|side| side.and_then(|(line, age)| Some((moved(&line, &was, &pose)?, age))))
        });
        self.finder.find(frame, ground, [NEAR, far], &mut self.pieces);
        let expected = before.iter().flatten().flatten().next();
        let expected = expected.map(|(line, _)| fit::Course { slope: line.slope, bend: line.bend });
        let seen = self.fitter.fit(&self.pieces, expected, NEAR);
        let mut sides = [None; 2];
        for (side, line) in seen.into_iter().enumerate() {
            let old = before.and_then(|before| before[side]);
            sides[side] = match (line, old) {
                (Some(line), _) => Some((line, 0)),
                (None, Some((line, age))) if age < COAST => {
                    let reach = [line.reach[0], line.reach[1].min(far)];
                    Some((LaneBoundary { reach, ..line }, age + 1))
                }
                _ => None,
            };
        }
        self.last = Some((pose, sides));
        let [left, right] = sides.map(|side| side.map(|(line, _)| line));
        LaneEstimate { left, right }
    }
}

/// How far the road goes before the next junction (m ahead of the ego's centre); negative inside one.
fn road_ahead(facts: &EgoFacts<'_>) -> f64 {
    let s = facts.on_route.s;
    if facts.route.link_at(s).is_some() {
        return -1.0;
    }
    facts.route.next_link(s).map_or(f64::INFINITY, |link| link.stop_s - s)
}

/// A boundary as seen from where the ego has moved to.
fn moved(line: &LaneBoundary, was: &Pose, is: &Pose) -> Option<LaneBoundary> {
    let place = |x: f32| {
        let local = is.to_local(was.to_world(Vector::new(f64::from(x), f64::from(line.y(x)))));
        [local.x as f32, local.y as f32]
    };
    let [a, b, c] = [5.0, 12.5, 20.0].map(place);
    // The parabola through three places.
    let (ab, bc) = ((b[1] - a[1]) / (b[0] - a[0]), (c[1] - b[1]) / (c[0] - b[0]));
    let half = (bc - ab) / (c[0] - a[0]);
    let slope = ab - half * (a[0] + b[0]);
    let offset = a[1] - a[0] * (slope + half * a[0]);
    let gone = (is.xy() - was.xy()).norm() as f32;
    let far = line.reach[1] - gone;
    let sound = offset.is_finite() && gone < 6.0 && far > line.reach[0] + 2.0;
    sound.then_some(LaneBoundary { offset, slope, bend: 2.0 * half, reach: [line.reach[0], far] })
}
