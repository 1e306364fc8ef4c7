//! The lane changes that the route needs: kept back until the target lane has a gap.
//!
//! The route's centre line moves over by itself; holding back is an offset that leads back to the
//! centre of the lane that is left.

use super::leader::Located;
use super::params::{AutopilotParams, EgoModel};
use sumo_network::geometry::Point;
use sumo_network::network::{LaneId, Network, RoadOption, Route};
use sumo_network::world::WorldState;

/// Length (m) that the latest possible change takes at walking pace.
const LAST_CHANGE: f64 = 12.0;

/// The share of a change's length until which there is a way back.
pub const BEGUN: f64 = 0.2;

/// The room (m) that a change of lane leaves between the ego, `speed` (m/s) fast, and somebody on the other lane, `along` (m/s)
/// fast, ahead of or behind it: a metre, and a `share` of what speeds differ by in a moment and of what braking takes.
pub fn room(is_ahead: bool, along: f64, speed: f64, share: f64) -> f64 {
    let closing = along - speed;
    let more = if is_ahead {
        (-closing).max(0.0) * 0.6 + closing.min(0.0).powi(2) / 6.0
    } else {
        0.25 * along.max(0.0) + closing.max(0.0) * 0.8 + closing.max(0.0).powi(2) / 6.0
    };
    1.0 + share * more
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Phase {
    /// Along the route's own line.
    Follow,
    /// On the lane to be left.
    Hold,
    /// Moving over from here (m on the route) within a length (m).
    Move { from_s: f64, length: f64 },
}

/// The change under way or coming up.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Change {
    s_start: f64,
    s_end: f64,
    from_lane: LaneId,
    to_lane: LaneId,
    left: bool,
    phase: Phase,
    waited: f64,
}

/// What the lane change asks of speed and signals.
#[derive(Clone, Copy, Debug, Default)]
pub struct Wish {
    /// -1 right, 1 left, 0 none.
    pub blinker: i8,
    /// Where the centre of the ego has to wait for a gap (m on the route).
    pub wait_s: Option<f64>,
    /// Gap (m) and speed (m/s) of the vehicle ahead on the target lane while waiting for a gap.
    pub beside: Option<(f64, f64)>,
}

/// Plans lane changes.
#[derive(Clone, Debug, Default)]
pub struct LaneChanger {
    change: Option<Change>,
}

impl LaneChanger {
    /// Takes up the change that is due at `route_s` (m), or drops the one that is over.
    pub fn select(&mut self, route: &Route, route_s: f64, speed: f64) {
        if self.change.is_some_and(|c| {
            let over = match c.phase {
                Phase::Follow | Phase::Hold => c.s_end,
                Phase::Move { from_s, length } => c.s_end.max(from_s + length),
            };
            route_s > over || route_s < c.s_start - 120.0
        }) {
            self.change = None;
        }
        let notice = 15.0 + 3.5 * speed;
        let due = route.sections.iter().find(|x| {
            x.from_lane.is_some() && x.s_end > route_s && x.s_start < route_s + notice && x.s_end > x.s_start
        });
        let Some(section) = due else { return };
        if self.change.is_some_and(|c| c.s_start == section.s_start && c.to_lane == section.lane) {
            return;
        }
        if self.change.is_some_and(|c| route_s <= c.s_end) {
            return;
        }
        let Some(from_lane) = section.from_lane else { return };
        self.change = Some(Change {
            s_start: section.s_start,
            s_end: section.s_end,
            from_lane,
            to_lane: section.lane,
            left: section.option == RoadOption::ChangeLaneLeft,
            phase: Phase::Follow,
            waited: 0.0,
        });
    }

    /// Whether a change is under way or coming up.
    pub fn active(&self) -> bool {
        self.change.is_some()
    }

    /// How far to the left of the route's line (m) the planned path lies at `s`, where the route is at `point`.
    pub fn offset(&self, network: &Network, s: f64, point: Point) -> f64 {
        let Some(change) = &self.change else { return 0.0 };
        let (from_s, length) = match change.phase {
            Phase::Follow => return 0.0,
            Phase::Hold => (change.last_start(), LAST_CHANGE),
            Phase::Move { from_s, length } => (from_s, length),
        };
        if s < change.s_start || s > from_s + length {
            return 0.0;
        }
        let x = ((s - from_s) / length).clamp(0.0, 1.0);
        let stay = 1.0 - x * x * x * (10.0 - 15.0 * x + 6.0 * x * x);
        -network.lane(change.from_lane).shape.project(point).d * stay
    }

    /// Decides whether to move over now.
    #[allow(clippy::too_many_arguments)]
    pub fn decide(
        &mut self,
        network: &Network,
        route_s: f64,
        speed: f64,
        world: &WorldState,
        located: &[Located],
        tick_s: f64,
        ego: &EgoModel,
        params: &AutopilotParams,
    ) -> Wish {
        let Some(change) = &mut self.change else { return Wish::default() };
        let blinker = if change.left { 1 } else { -1 };
        let half = 0.5 * ego.length;
        let target = &network.lane(change.to_lane);
        let forced = change.waited > params.lane_change_patience;
        let share = if forced { 0.4 } else { 1.0 };
        let mut free = true;
        let mut beside: Option<(f64, f64)> = None;
        for v in located {
            if v.d.abs() > 9.0 {
                continue;
            }
            let actor = &world.vehicles[v.vehicle];
            let p = target.shape.project(actor.pose.xy());
            if p.distance > 0.5 * target.width + v.half_across - 0.2 {
                continue;
            }
            let ahead = v.s - v.half_along - (route_s + half);
            let behind = route_s - half - (v.s + v.half_along);
            let is_ahead = v.s > route_s;
            free &= if is_ahead { ahead } else { behind } >= room(is_ahead, v.along, speed, share);
            if v.s > route_s - 1.0 && beside.is_none_or(|b| ahead < b.0) {
                beside = Some((ahead, v.along));
            }
        }
        change.phase = match change.phase {
            Phase::Follow if route_s < change.s_start + BEGUN * (change.s_end - change.s_start) => {
                // Not moved over by much yet: look again.
                if free || route_s < change.s_start - 2.0 - speed { Phase::Follow } else { Phase::Hold }
            }
            Phase::Follow => Phase::Follow,
            Phase::Hold if free => {
                let from_s = route_s.max(change.s_start);
                let length =
                    (2.6 * speed).clamp(LAST_CHANGE - 2.0, (change.s_end - from_s).max(LAST_CHANGE - 2.0));
                Phase::Move { from_s, length }
            }
            Phase::Hold => Phase::Hold,
            Phase::Move { from_s, length } => {
                if !free && !forced && route_s < from_s + BEGUN * length && route_s < change.last_start() {
                    Phase::Hold
                } else {
                    Phase::Move { from_s, length }
                }
            }
        };
        if change.phase == Phase::Hold && speed < 0.5 {
            change.waited += tick_s;
        }
        if change.phase == Phase::Hold {
            Wish { blinker, wait_s: Some(change.last_start()), beside }
        } else {
            Wish { blinker, wait_s: None, beside: None }
        }
    }
}

impl Change {
    /// Where the latest possible change begins (m on the route).
    fn last_start(&self) -> f64 {
        (self.s_end - LAST_CHANGE).max(self.s_start)
    }
}
