//! Pedestrians on the ego's path, on crossings over it, and about to step onto either.

use super::junction::{CrossingZone, LinkPlan};
use super::params::AutopilotParams;
use super::path::Path;
use super::speed::time_to_cover;
use sumo_network::geometry::{Point, Vector, direction, polygon_contains};
use sumo_network::network::{EdgeKind, LaneId, Network, VehicleClass};
use sumo_network::world::{Actor, SignalState, WorldState};

/// Half the width of a pedestrian (m).
const RADIUS: f64 = 0.3;
/// Step of the prediction (s).
const DT: f64 = 0.3;
/// How near the crossing's edge a pedestrian who walks towards it is about to enter it (m).
const KERB: f64 = 2.0;

/// Where to stand for a pedestrian.
#[derive(Clone, Copy, Debug)]
pub struct Halt {
    /// Where the front bumper is to stand (m on the route).
    pub stop_s: f64,
    /// Whether it is on (or about to step onto) a crossing.
    pub crossing: bool,
}

/// The ego's motion as far as pedestrians matter.
#[derive(Clone, Copy, Debug)]
pub struct Approach {
    pub front_s: f64,
    pub rear_s: f64,
    /// m/s, and the speed that it may reach.
    pub speed: f64,
    pub top: f64,
}

/// The nearest place at which the ego has to stand for pedestrians.
pub fn judge(
    network: &Network,
    path: &Path,
    plans: &[LinkPlan],
    world: &WorldState,
    ego: &Approach,
    params: &AutopilotParams,
) -> Option<Halt> {
    let mut nearest: Option<Halt> = None;
    for actor in &world.pedestrians {
        let reach = 9.0 + actor.speed * params.pedestrian_horizon * 2.0;
        let Some(hint) = path.nearest(actor.pose.xy(), reach) else { continue };
        if (path.samples[hint].z - actor.pose.position.z).abs() > 3.0 {
            continue;
        }
        let halt = walk(network, path, plans, world, actor, hint, ego, params);
        if let Some(halt) = halt
            && nearest.is_none_or(|n| halt.stop_s < n.stop_s)
        {
            nearest = Some(halt);
        }
    }
    nearest
}

/// The crossing over the path that `actor` is on, or is about to step onto (true).
fn crossing_of<'a>(
    network: &Network,
    plans: &'a [LinkPlan],
    world_point: Point,
    velocity: Vector,
    actor: &Actor,
    world: &WorldState,
) -> Option<(&'a CrossingZone, bool)> {
    let on_walkingarea =
        actor.lane.is_none_or(|l| matches!(network.edge(network.lane(l).edge).kind, EdgeKind::WalkingArea));
    for zone in plans.iter().flat_map(|p| &p.crossings) {
        let crossing = network.crossing(zone.crossing);
        if actor.lane == Some(crossing.lane)
            || actor.lane.is_none() && polygon_contains(&crossing.outline, world_point)
        {
            return Some((zone, false));
        }
        // Where cars go first, or while their light is red, pedestrians wait at the kerb.
        let may_enter = match crossing.signal.and_then(|s| world.signal(s)) {
            Some(state) => matches!(state, SignalState::GreenMajor | SignalState::GreenMinor),
            None => zone.yields,
        };
        if !may_enter || !on_walkingarea || velocity.norm() < 0.2 {
            continue;
        }
        let line = &network.lane(crossing.lane).shape;
        for (end, other) in [(0.0, line.length()), (line.length(), 0.0)] {
            let (kerb, far) = (line.at(end).xy(), line.at(other).xy());
            let to_kerb = kerb - world_point;
            let heads_for_it =
                velocity.dot(&(far - world_point)) > 0.5 * velocity.norm() * (far - world_point).norm();
            if to_kerb.norm() < KERB && heads_for_it {
                return Some((zone, true));
            }
        }
    }
    None
}

/// The kind of a lane that is for pedestrians alone, off the road; None for all others.
fn footway(network: &Network, lane: LaneId) -> Option<EdgeKind> {
    let lane = network.lane(lane);
    let kind = network.edge(lane.edge).kind;
    match kind {
        EdgeKind::WalkingArea => Some(kind),
        EdgeKind::Normal => (!lane.permissions.allows(VehicleClass::Passenger)).then_some(kind),
        EdgeKind::Internal | EdgeKind::Crossing | EdgeKind::Other => None,
    }
}

#[allow(clippy::too_many_arguments)]
fn walk(
    network: &Network,
    path: &Path,
    plans: &[LinkPlan],
    world: &WorldState,
    actor: &Actor,
    hint: usize,
    ego: &Approach,
    params: &AutopilotParams,
) -> Option<Halt> {
    let mut velocity = direction(actor.pose.heading) * actor.speed;
    let start = actor.pose.xy();
    let zone = crossing_of(network, plans, start, velocity, actor, world);
    if let Some((zone, true)) = zone {
        // About to step onto the crossing: it will walk along it.
        let line = &network.lane(network.crossing(zone.crossing).lane).shape;
        let (a, b) = (line.at(0.0).xy(), line.at(line.length()).xy());
        let along = if (a - start).norm() < (b - start).norm() { b - start } else { a - start };
        if along.norm() > 0.1 {
            velocity = along.normalize() * actor.speed.max(1.0);
        }
    }
    // Pedestrians on a sidewalk, or at a kerb where they have to wait, stay there.
    let footway = if zone.is_some() { None } else { actor.lane.and_then(|l| footway(network, l)) };
    let horizon = match (zone, footway) {
        (Some(_), _) => 2.0 * params.pedestrian_horizon,
        (None, Some(EdgeKind::WalkingArea)) => 0.0,
        (None, Some(_)) => 0.6,
        (None, None) => params.pedestrian_horizon,
    };
    let margin = match footway {
        Some(_) => 0.3,
        None if actor.speed > 0.2 => RADIUS + params.pedestrian_margin,
        None => RADIUS + 0.25,
    };
    // When and where the walk is in the corridor.
    let (mut enter, mut leave) = (f64::INFINITY, f64::NEG_INFINITY);
    let (mut near_s, mut far_s) = (f64::INFINITY, f64::NEG_INFINITY);
    let steps = if actor.speed < 0.05 { 0 } else { (horizon / DT) as usize };
    let mut index = hint;
    for k in 0..=steps {
        let t = k as f64 * DT;
        let on = path.locate(start + velocity * t, index);
        index = on.index;
        let half = path.samples[on.index].half_width + margin;
        let beyond = on.s < path.samples[0].s - 0.5 || on.s > path.end() + 0.5;
        if on.d.abs() <= half && !beyond {
            enter = enter.min(t);
            leave = t;
            near_s = near_s.min(on.s);
            far_s = far_s.max(on.s);
        } else if enter.is_finite() || actor.speed * (horizon - t) + half < on.d.abs() {
            break;
        }
    }
    if !enter.is_finite() {
        return None;
    }
    if steps == 0 {
        leave = f64::INFINITY;
    } else {
        leave += DT;
    }
    if far_s + RADIUS < ego.rear_s || near_s + RADIUS < ego.front_s - 1.0 {
        return None;
    }
    let arrive = time_to_cover(near_s - RADIUS - ego.front_s, ego.speed, 1.5, ego.top);
    let gone = time_to_cover(far_s + RADIUS - ego.rear_s, ego.speed, 1.5, ego.top);
    let ahead_of_it = if zone.is_some() { 1.5 } else { 1.0 };
    if enter > gone + ahead_of_it || leave + 0.5 < arrive {
        return None;
    }
    let own = near_s - RADIUS - params.pedestrian_gap;
    let stop_s = match zone {
        Some((zone, _)) => {
            let before = zone.from_s - 0.7;
            // On the crossing already: stop where there still is room.
            if ego.front_s <= before + 0.5 { before } else { (near_s - RADIUS - 0.8).max(before) }
        }
        None => own.max((ego.front_s + 0.3).min(near_s - RADIUS - 0.5)),
    };
    Some(Halt { stop_s, crossing: zone.is_some() })
}
