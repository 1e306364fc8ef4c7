//! Places for background road users: the sight rule, and the occupied places at the start.

use super::draw::between;
use super::roads::{Roads, StartLane};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use sumo_network::geometry::{Point, Pose};
use sumo_network::network::{LaneId, Network};

/// Areas round the egos where no road user is added.
///
/// The sight rule: everything within [`Avoid::sight`] of an ego's centre, in any direction, counts
/// as seen, even behind a building (views from behind and above exist too). Replacements are added out
/// of sight; where the town is too small for that, as far off as it allows.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Avoid {
    /// No road user is added or removed nearer to the ego than this during the run (m), unless the town
    /// has no place further off.
    pub sight: f64,
    /// No road user is nearer to the ego than this at the start (m).
    pub start: f64,
    /// No road user is this far ahead of the ego in its lane at the start (m).
    pub start_ahead: f64,
    /// Replacements keep this distance from road users near the ego (m).
    pub actors: f64,
}

impl Default for Avoid {
    fn default() -> Self {
        Self { sight: 100.0, start: 25.0, start_ahead: 40.0, actors: 20.0 }
    }
}

/// Half the width of what counts as the ego's own lane ahead at the start (m).
const OWN_LANE: f64 = 3.0;

impl Avoid {
    /// Whether a road user may be at `point` at the start.
    pub fn allows_at_start(&self, egos: &[Pose], point: Point) -> bool {
        egos.iter().all(|ego| {
            let local = ego.to_local(point);
            let ahead = local.x > 0.0 && local.x < self.start_ahead && local.y.abs() < OWN_LANE;
            local.norm() >= self.start && !ahead
        })
    }

    /// Whether an ego sees `point`.
    pub fn in_sight(&self, egos: &[Pose], point: Point) -> bool {
        distance(egos, point) < self.sight
    }

    /// Whether `point` keeps its distance from road users near the ego.
    pub fn clear_of(&self, near: &[Point], point: Point) -> bool {
        near.iter().all(|other| (other - point).norm() >= self.actors)
    }
}

/// From the nearest ego to `point` (m); infinite without egos.
pub(super) fn distance(egos: &[Pose], point: Point) -> f64 {
    egos.iter().map(|ego| (ego.xy() - point).norm()).fold(f64::INFINITY, f64::min)
}

/// The world point of a SUMO lane_position (m) on a lane.
pub(super) fn point_on(network: &Network, lane: LaneId, position: f64) -> Point {
    let lane = network.lane(lane);
    let scale = if lane.length > 0.0 { lane.shape.length() / lane.length } else { 1.0 };
    lane.shape.at(position * scale).xy()
}

/// A vehicle's place at the start.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    pub lane: LaneId,
    /// Front bumper (m, SUMO lane_position).
    pub front: f64,
    /// Free road ahead: to the next vehicle's rear or the lane's end (m).
    pub free: f64,
}

/// Gaps (m) between vehicles on a lane that are tried in turn at the start.
const GAPS: [f64; 3] = [20.0, 9.0, 4.0];
/// Random places tried with each gap before all lanes are searched.
const DRAWS: usize = 24;

/// The occupied places before the first step.
#[derive(Debug)]
pub(super) struct Occupancy {
    /// By lane: rear and front bumper (m) of every vehicle, from the lane's begin on.
    taken: Vec<Vec<(f64, f64)>>,
}

impl Occupancy {
    pub fn new(network: &Network) -> Self {
        Self { taken: vec![Vec::new(); network.lanes.len()] }
    }

    /// Finds and takes a place for a vehicle of `length` (m) among the roads of its class; None where
    /// the town is full.
    pub fn take(
        &mut self,
        rng: &mut ChaCha8Rng,
        network: &Network,
        roads: &Roads,
        length: f64,
        allowed: impl Fn(Point) -> bool,
    ) -> Option<(StartLane, f64)> {
        for gap in GAPS {
            for _ in 0..DRAWS {
                let (start, front) = roads.draw_start(rng, length)?;
                if self.is_free(start.lane, front, length, gap)
                    && stands_clear(network, start.lane, front, length, &allowed)
                {
                    return Some(self.occupy(start, front, length));
                }
            }
        }
        // The town is nearly full: the first hole that a random starting lane finds.
        let smallest = GAPS[GAPS.len() - 1];
        let offset = between(rng, 0.0, roads.starts.len() as f64) as usize;
        for i in 0..roads.starts.len() {
            let start = roads.starts[(offset + i) % roads.starts.len()];
            let mut front = start.last;
            while front >= (length + 1.0).min(start.last) {
                if self.is_free(start.lane, front, length, smallest)
                    && stands_clear(network, start.lane, front, length, &allowed)
                {
                    return Some(self.occupy(start, front, length));
                }
                front -= 1.0;
            }
        }
        None
    }

    fn is_free(&self, lane: LaneId, front: f64, length: f64, gap: f64) -> bool {
        let rear = front - length;
        rear >= 0.0 && self.taken[lane.index()].iter().all(|&(r, f)| rear >= f + gap || front + gap <= r)
    }

    fn occupy(&mut self, start: StartLane, front: f64, length: f64) -> (StartLane, f64) {
        let lane = &mut self.taken[start.lane.index()];
        let at = lane.partition_point(|&(_, f)| f < front);
        lane.insert(at, (front - length, front));
        (start, front)
    }

    /// The place of the vehicle whose front is at `front`, with the free road ahead of it.
    pub fn place(&self, network: &Network, lane: LaneId, front: f64) -> Place {
        let taken = &self.taken[lane.index()];
        let next = taken.get(taken.partition_point(|&(_, f)| f <= front));
        let end = next.map_or(network.lane(lane).length, |&(rear, _)| rear);
        Place { lane, front, free: (end - front).max(0.0) }
    }
}

/// Whether both ends of a vehicle are at allowed points.
fn stands_clear(
    network: &Network,
    lane: LaneId,
    front: f64,
    length: f64,
    allowed: &impl Fn(Point) -> bool,
) -> bool {
    allowed(point_on(network, lane, front)) && allowed(point_on(network, lane, (front - length).max(0.0)))
}

/// A speed (m/s) from which a vehicle braking at `decel` (m/s2) after one second stops within `free`
/// metres less its gap, with half its braking in hand; at most three quarters of `limit` (m/s).
pub(super) fn start_speed(limit: f64, free: f64, min_gap: f64, decel: f64) -> f64 {
    let b = 0.5 * decel;
    let free = (free - min_gap - 1.0).max(0.0);
    let safe = -b + (b * b + 2.0 * b * free).sqrt();
    // Whole centimetres a second: the text that SUMO reads holds exactly this number.
    (safe.min(0.75 * limit) * 100.0).floor() / 100.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_starting_vehicle_can_always_stop() {
        for (limit, free, decel) in
            [(13.89, 8.0, 4.5), (25.0, 60.0, 4.0), (5.0, 0.5, 3.0), (13.89, 500.0, 4.5)]
        {
            let v = start_speed(limit, free, 2.5, decel);
            assert!(v >= 0.0 && v <= 0.75 * limit);
            assert!(v == 0.0 || v + v * v / (2.0 * decel) < free - 2.5, "{v} m/s in {free} m");
        }
    }

    #[test]
    fn the_ego_keeps_its_room() {
        let avoid = Avoid::default();
        let ego = &[Pose::new(100.0, 50.0, 0.0, 0.0)];
        assert!(!avoid.allows_at_start(ego, Point::new(120.0, 50.0)));
        assert!(!avoid.allows_at_start(ego, Point::new(139.0, 51.0)), "in its lane ahead");
        assert!(avoid.allows_at_start(ego, Point::new(141.0, 50.0)));
        assert!(avoid.allows_at_start(ego, Point::new(70.0, 50.0)), "behind it");
        assert!(!avoid.allows_at_start(ego, Point::new(100.0, 70.0)));
        assert!(avoid.in_sight(ego, Point::new(1.0, 50.0)));
        assert!(!avoid.in_sight(ego, Point::new(-1.0, 50.0)));
        assert!(!avoid.in_sight(&[], Point::new(100.0, 50.0)));
    }
}
