//! Right of way: whether the gaps in the traffic that crosses or joins the ego's path are long enough.

use super::junction::{Conflict, LinkPlan};
use super::params::AutopilotParams;
use super::speed::time_to_cover;
use sumo_network::network::{LaneId, LinkDirection, Network};
use sumo_network::world::{Actor, SignalState, VehicleSignals, WorldState};

/// How far beyond the place where it should stand a vehicle may come to rest without harm (m).
const LINE_SLACK: f64 = 1.0;

/// Vehicles by the lane that SUMO maps them to.
#[derive(Clone, Debug, Default)]
pub struct ByLane {
    entries: Vec<(LaneId, usize)>,
}

impl ByLane {
    /// Indexes the vehicles of `world`.
    pub fn new(world: &WorldState) -> Self {
        let mut entries: Vec<(LaneId, usize)> =
            world.vehicles.iter().enumerate().filter_map(|(i, v)| Some((v.lane?, i))).collect();
        entries.sort_unstable();
        Self { entries }
    }

    /// Indices of the vehicles on `lane`.
    pub fn on(&self, lane: LaneId) -> impl Iterator<Item = usize> + '_ {
        let from = self.entries.partition_point(|e| e.0 < lane);
        self.entries[from..].iter().take_while(move |e| e.0 == lane).map(|e| e.1)
    }
}

/// The ego's motion, for judging the gaps.
#[derive(Clone, Copy, Debug)]
pub struct Motion {
    /// Bumpers on the route (m).
    pub front_s: f64,
    pub rear_s: f64,
    /// m/s.
    pub speed: f64,
    /// Speed that it may reach over the junction (m/s).
    pub top: f64,
    /// 0 (patient) to 1 (takes the smallest gaps).
    pub impatience: f64,
    /// Whether the ego no longer waits for standing vehicles.
    pub breaks_deadlock: bool,
    /// Whether the ego gives way to vehicles with right of way.
    pub yields: bool,
    /// Whether a light rules the junction.
    pub signalled: bool,
    /// Whether the ego and another have waited for each other for so long that the ego goes first.
    pub ends_standoff: bool,
}

/// A reason to wait.
#[derive(Clone, Copy, Debug)]
pub struct Hold {
    /// Where the front bumper is to stand (m on the route).
    pub stop_s: f64,
}

/// Waiting for a vehicle that waits for the ego ends after this (s).
pub const STANDOFF: f64 = 3.0;

/// A vehicle to follow at a merge.
#[derive(Clone, Copy, Debug)]
pub struct Merging {
    /// m and m/s.
    pub gap: f64,
    pub speed: f64,
}

/// What the traffic at a junction requires.
#[derive(Clone, Debug, Default)]
pub struct Outcome {
    pub hold: Option<Hold>,
    pub merging: Vec<Merging>,
}

/// A foe on its way over a conflict.
struct Foe<'a> {
    actor: &'a Actor,
    /// Front bumper from the foe link's stop line (m, negative before it).
    x: f64,
    inside: bool,
    /// It is in the junction while its light is red: it goes on.
    clearing: bool,
    top: f64,
    /// Whether its way over the conflict is only a guess.
    unsure: bool,
}

impl Foe<'_> {
    /// Way to where the conflict begins, and until the rear has left it (m).
    fn ways(&self, conflict: &Conflict) -> (f64, f64) {
        let length = self.actor.actor_type.length;
        (conflict.foe_enter - self.x, conflict.foe_leave + length - self.x)
    }

    fn stands(&self) -> bool {
        self.actor.speed < 0.3
    }

    /// When it enters and when it leaves the conflict (s); `yields`: whether the ego waits for it.
    fn times(&self, conflict: &Conflict, yields: bool) -> (f64, f64) {
        let speed = self.actor.speed;
        let (to_enter, to_leave) = self.ways(conflict);
        let start = if self.stands() { 0.7 } else { 0.0 };
        let enter = start + time_to_cover(to_enter, speed, 1.5, self.top.max(speed));
        if to_enter <= 0.0 || !yields {
            return (enter, to_leave / speed.max(0.5));
        }
        // It slows down for its turn.
        let over = conflict.foe_speed.clamp(2.0, self.top.max(2.0));
        let before_line = (-self.x).max(0.0);
        let approach = if speed > over { before_line / (0.5 * (speed + over)) } else { 0.0 };
        let rest = if speed > over { to_leave - before_line } else { to_leave };
        (enter, approach + time_to_cover(rest, speed.clamp(0.5, over), 0.8, over))
    }
}

/// Judges every conflict of `plan`.
pub fn judge(
    network: &Network,
    plan: &LinkPlan,
    world: &WorldState,
    by_lane: &ByLane,
    ego: &Motion,
    params: &AutopilotParams,
) -> Outcome {
    let mut outcome = Outcome::default();
    let own_lane = network.link(plan.link).from;
    for conflict in &plan.conflicts {
        if ego.rear_s > conflict.leave_s {
            continue;
        }
        let link = network.link(conflict.link);
        let signal = link.signal.and_then(|s| world.signal(s));
        let stopped_by_light = signal.is_some_and(|s| s.is_red() || s == SignalState::Yellow);
        let yields = ego.yields && conflict.must_yield;
        let red = signal.is_some_and(|s| s.is_red());
        for &(lane, begin, length) in &conflict.inside {
            let scale = length / network.lane(lane).length.max(0.1);
            for index in by_lane.on(lane) {
                let actor = &world.vehicles[index];
                let x = begin + actor.lane_position * scale;
                let top = network.lane(lane).speed_limit;
                consider(
                    conflict,
                    plan,
                    &Foe { actor, x, inside: true, clearing: red, top, unsure: false },
                    ego,
                    yields,
                    params,
                    &mut outcome,
                );
            }
        }
        for approach in &conflict.approaches {
            if approach.lane == own_lane {
                continue;
            }
            let lane = network.lane(approach.lane);
            for index in by_lane.on(approach.lane) {
                let actor = &world.vehicles[index];
                let x = actor.lane_position - lane.length - approach.beyond;
                if approach.beyond == 0.0
                    && !approach.certain
                    && turns_elsewhere(network, actor, conflict.direction)
                {
                    continue;
                }
                // A red or yellow light holds vehicles that can still stop.
                let needed = actor.speed * actor.speed / (2.0 * ((-x).max(0.0) + LINE_SLACK));
                if stopped_by_light && needed < 4.8 {
                    continue;
                }
                let top = lane.speed_limit.max(actor.speed);
                let foe = Foe { actor, x, inside: false, clearing: false, top, unsure: !approach.certain };
                consider(conflict, plan, &foe, ego, yields, params, &mut outcome);
            }
        }
    }
    outcome
}

/// Whether the blinkers say that the vehicle does not take a link that turns like `direction`.
fn turns_elsewhere(network: &Network, actor: &Actor, direction: LinkDirection) -> bool {
    let right = actor.signals.has(VehicleSignals::BLINKER_RIGHT);
    let left = actor.signals.has(VehicleSignals::BLINKER_LEFT);
    let close = actor.speed < 12.0;
    match network.turns_left(direction) {
        Some(true) => right,
        Some(false) => left,
        None => direction == LinkDirection::Straight && close && (right || left),
    }
}

fn consider(
    conflict: &Conflict,
    plan: &LinkPlan,
    foe: &Foe,
    ego: &Motion,
    yields: bool,
    params: &AutopilotParams,
    outcome: &mut Outcome,
) {
    let speed = foe.actor.speed;
    let (to_enter, to_leave) = foe.ways(conflict);
    if to_leave <= 0.0 {
        return;
    }
    let in_zone = to_enter <= 0.0;
    let standing = foe.stands();
    let ego_in = ego.front_s >= conflict.enter_s - 0.3;
    // Once in the junction it clears it rather than stand in the next one's way.
    let entered = ego.front_s > plan.stop_s + 1.0
        && plan.wait_s.is_none_or(|w| w > conflict.enter_s + 0.3 || ego.front_s > w + 0.3);
    // Without a light SUMO's vehicles wait for vehicles inside the junction, even with right of way: a
    // vehicle that stands before the ego's path waits for the ego.
    let committed = entered && !ego.signalled;
    if committed && standing && (!in_zone || conflict.merge && ego.ends_standoff) {
        // What stands in the path itself is a leader.
        return;
    }

    // At a merge, the vehicle ahead on the common stretch leads.
    if conflict.merge && (in_zone || foe.inside && foe.x > 0.0) {
        let ours = conflict.leave_s - ego.front_s;
        let theirs = conflict.foe_leave - foe.x;
        let gap = ours - theirs - foe.actor.actor_type.length;
        let goes_first = in_zone || yields;
        if gap > 0.0 && goes_first && ego.front_s > plan.stop_s - 40.0 {
            outcome.merging.push(Merging { gap, speed });
            return;
        }
        if ego_in && ours < theirs {
            return;
        }
    }
    if ego_in {
        // Being in the way already, the best is to get out of it; what stands in the path is a leader.
        return;
    }
    // It cannot stop any more, before the path or (being on its way there) before its line.
    let braking_room = if foe.inside { to_enter } else { -foe.x };
    let needed = speed * speed / (2.0 * (braking_room.max(0.0) + LINE_SLACK));
    let inevitable = in_zone || needed > 4.8;
    let goes_on = inevitable || foe.clearing && speed > 2.0;
    if !yields && !goes_on {
        return;
    }
    if standing && in_zone && !conflict.merge {
        // It blocks the path, or its tail does: the swept corridor knows exactly.
        return;
    }
    if standing && !in_zone && (ego.breaks_deadlock || !yields) {
        return;
    }

    let acceleration = 1.7;
    let ego_enter = time_to_cover(conflict.enter_s - ego.front_s, ego.speed, acceleration, ego.top);
    let ego_leave = time_to_cover(conflict.leave_s - ego.rear_s, ego.speed, acceleration, ego.top);
    let (foe_enter, foe_leave) = foe.times(conflict, yields);

    let share = 1.0 - (1.0 - params.impatient_share) * ego.impatience;
    let (before, after) = if !yields || entered {
        (0.5, 0.2)
    } else if conflict.merge {
        let closing = (speed - ego.top.min(ego.speed + 4.0)).max(0.0);
        (params.merge_gap * share + closing / 3.0, params.clear_gap)
    } else {
        (params.crossing_gap * share, params.clear_gap)
    };
    let ours_first = if conflict.merge { ego_enter } else { ego_leave };
    let unsure_discount = if foe.unsure && ego.impatience >= 1.0 { 0.7 } else { 1.0 };
    let we_are_gone = foe_enter - ours_first >= before * unsure_discount;
    let they_are_gone = ego_enter - foe_leave >= after;
    if we_are_gone || they_are_gone {
        return;
    }

    if let Some(stop_s) = waiting_place(conflict, plan, ego, params, foe_enter < ego_enter)
        && outcome.hold.is_none_or(|h| stop_s < h.stop_s)
    {
        outcome.hold = Some(Hold { stop_s });
    }
}

/// Where to wait (m on the route): at the place inside the junction if it lies before the conflict, else at
/// the line, else just before the conflict, where that is better than to go on; `late`: the foe is there first.
fn waiting_place(
    conflict: &Conflict,
    plan: &LinkPlan,
    ego: &Motion,
    params: &AutopilotParams,
    late: bool,
) -> Option<f64> {
    let places = [plan.wait_s.filter(|&w| w <= conflict.enter_s + 0.3), Some(plan.stop_s)];
    let reachable = |s: f64| {
        let room = s - ego.front_s;
        room > -0.3 && ego.speed * ego.speed / (2.0 * room.max(0.3)) < 4.0
    };
    let last_chance = conflict.enter_s - 0.5;
    places.iter().flatten().copied().find(|&s| reachable(s)).or_else(|| {
        let room = last_chance - ego.front_s;
        let hard = ego.speed * ego.speed / (2.0 * room.max(0.1));
        (room > 0.0 && (hard < params.emergency_deceleration || late)).then_some(last_chance)
    })
}
