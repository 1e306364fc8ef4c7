//! The rule-based expert: drives for data sets, and is the baseline for every agent.
//!
//! It sees the whole [`WorldState`], drives a [`Route`] and answers one [`Decision`] per tick:
//! path, then the acceleration that each rule allows, then the smallest of them, then the pedals.
//! It draws no random numbers; equal input gives equal output.

mod junction;
pub mod lane_change;
mod leader;
mod lights;
mod params;
mod path;
mod pedestrians;
mod right_of_way;
mod speed;
mod steering;
#[cfg(test)]
mod tests;

pub use params::{AutopilotParams, EgoModel};

use junction::LinkPlan;
use lane_change::LaneChanger;
use leader::{Obstacle, Tracker};
use lights::{Lights, Verdict};
use path::Path;
use right_of_way::{ByLane, Motion};
use serde::{Deserialize, Serialize};
use speed::{Pedals, follow, stop_in, time_to_cover};
use sumo_network::network::{Link, LinkId, Network, Route};
use sumo_network::signal_ahead::SignalAhead;
use sumo_network::world::{SignalState, WorldState};
use wad_vehicle::{Control, EgoState};

/// What decided the speed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum Reason {
    /// Nothing: it accelerates freely.
    Free,
    /// The speed limit.
    Limit,
    /// A curve ahead.
    Curve,
    /// A vehicle ahead: gap (m) and speed along the path (m/s).
    Leader {
        /// Bumper to bumper (m).
        gap: f64,
        /// Its speed along the path (m/s).
        speed: f64,
    },
    /// A vehicle with which the ego merges: gap (m) and speed (m/s).
    Merge {
        /// To its place on the common path, bumper to bumper (m).
        gap: f64,
        /// Its speed (m/s).
        speed: f64,
    },
    /// A light (or stop sign) at this distance (m) from the front bumper.
    RedLight {
        /// To the stop line (m).
        distance: f64,
    },
    /// Others with right of way; where it will stand (m from the front bumper).
    Yield {
        /// To the stopping point (m).
        distance: f64,
    },
    /// No room beyond the junction; distance of the stop line (m).
    JunctionBlocked {
        /// To the stop line (m).
        distance: f64,
    },
    /// A pedestrian away from crossings; where it will stand (m from the front bumper).
    Pedestrian {
        /// To the stopping point (m).
        distance: f64,
    },
    /// A pedestrian on or about to step onto a crossing; the same.
    Crossing {
        /// To the stopping point (m).
        distance: f64,
    },
    /// No gap yet on the lane that the route needs; where it will wait (m from the front bumper).
    LaneChange {
        /// To the waiting point (m).
        distance: f64,
    },
    /// The end of the route is near, at this distance (m) from the front bumper.
    RouteEnd {
        /// To the route's end (m).
        distance: f64,
    },
    /// Far off the route's line.
    OffRoute,
}

/// The vehicle ahead.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Leader {
    /// Bumper to bumper (m).
    pub gap_m: f64,
    /// Along the path (m/s).
    pub speed_mps: f64,
}

/// What to do over the next tick, and why.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Decision {
    /// The pedals and the wheel.
    pub control: Control,
    /// What decided the speed.
    pub reason: Reason,
    /// Speed wanted here without others (m/s): limits and curves.
    pub target_speed: f64,
    /// Acceleration asked for (m/s2).
    pub acceleration: f64,
    /// The vehicle ahead, if there is one.
    pub leader: Option<Leader>,
    /// State of the signal that counts and the distance of its stop line from the front bumper (m).
    pub light: Option<(SignalState, f64)>,
    /// Held by a light, a jam (a leader slower than 2 m/s), right of way, a pedestrian or a full junction.
    pub held: bool,
    /// Left indicator.
    pub blinker_left: bool,
    /// Right indicator.
    pub blinker_right: bool,
    /// Brake lights.
    pub brake_light: bool,
}

/// What an agent is told, for an expert that is to show it nothing that it is not told.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Told {
    /// What a detector believes of the ego's light; None: the expert goes by SUMO's.
    pub light: Option<ToldLight>,
    /// The road user in the path: the expert follows it beside those that it sees itself, so that it does not drive on
    /// where an agent is told that it must not.
    pub lead: Option<Leader>,
}

/// What others believe of the ego's light, such as a detector.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToldLight {
    /// The line at which to stop, from the front bumper (m); None: nothing to stop for.
    pub stop: Option<f64>,
    /// The speed limit that is told with it (m/s).
    pub limit: f64,
}

/// The rule-based driver of one ego.
#[derive(Clone, Debug)]
pub struct Autopilot {
    params: AutopilotParams,
    model: EgoModel,
    path: Path,
    plans: Vec<LinkPlan>,
    tracker: Tracker,
    lights: Lights,
    told: Told,
    changer: LaneChanger,
    pedals: Pedals,
    /// Acceleration asked for at the last tick (m/s2).
    last_acceleration: f64,
    /// How long it has stood for right of way (s), and at which link.
    waited: f64,
    waiting_at: Option<LinkId>,
}

/// The smallest acceleration so far, and its reason.
struct Choice {
    acceleration: f64,
    reason: Reason,
}

impl Choice {
    fn offer(&mut self, acceleration: f64, reason: Reason) {
        if acceleration < self.acceleration {
            *self = Self { acceleration, reason };
        }
    }
}

/// A tick's state, as the rules look at it.
struct Situation<'a> {
    network: &'a Network,
    world: &'a WorldState,
    obstacles: &'a [Obstacle],
    profile: &'a speed::Profile,
    /// Bumpers on the route (m).
    front_s: f64,
    rear_s: f64,
    /// m/s.
    speed: f64,
    /// Until the pedals act, and length of the tick (s).
    latency: f64,
    tick_s: f64,
}

impl Situation<'_> {
    /// From here on a junction ahead matters (m).
    fn reach(&self) -> f64 {
        15.0 + 4.0 * self.speed + 0.25 * self.speed * self.speed
    }

    /// Acceleration (m/s2) behind somebody `gap` (m) ahead at `other` m/s, once the pedals act.
    fn behind(&self, gap: f64, other: f64, params: &AutopilotParams) -> f64 {
        let then = gap - (self.speed - other) * self.latency;
        follow(self.speed, then, other, self.profile.target.max(1.0), params)
    }
}

impl Autopilot {
    /// A driver of the vehicle described by `ego`.
    pub fn new(params: AutopilotParams, ego: EgoModel) -> Self {
        Self {
            params,
            model: ego,
            path: Path::default(),
            plans: Vec::new(),
            tracker: Tracker::default(),
            lights: Lights::default(),
            told: Told::default(),
            changer: LaneChanger::default(),
            pedals: Pedals::default(),
            last_acceleration: 0.0,
            waited: 0.0,
            waiting_at: None,
        }
    }

    /// Call it if another driver drove the last tick, before the next [`Autopilot::control`]. Otherwise the
    /// pedals' correction learns from another driver's control.
    pub fn overruled(&mut self) {
        self.pedals.overruled();
    }

    /// Forgets what belongs to the old route; call when the ego gets another one.
    pub fn route_changed(&mut self) {
        self.changer = LaneChanger::default();
        self.plans.clear();
    }

    /// For the next [`Autopilot::control`] it goes by what `told` says too.
    pub fn tell(&mut self, told: Told) {
        self.told = told;
    }

    /// One tick: from the state after the last SUMO step, the control for the next `tick_s` seconds.
    /// `route_s` is where the ego's centre is on `route` (m).
    pub fn control(
        &mut self,
        network: &Network,
        route: &Route,
        route_s: f64,
        ego: &EgoState,
        world: &WorldState,
        tick_s: f64,
    ) -> Decision {
        let params = self.params;
        let model = self.model;
        let speed = ego.speed.max(0.0);
        let latency = speed::latency(tick_s);
        let front_s = route_s + 0.5 * model.length;
        let rear_s = route_s - 0.5 * model.length;

        self.changer.select(route, route_s, speed);
        let ahead = (0.25 * speed * speed + 3.5 * speed + 30.0).clamp(50.0, params.sight);
        let behind = if self.changer.active() { 70.0 } else { 25.0 };
        let changer = &self.changer;
        self.path.plan(route, route_s, (behind, ahead), &model, &params, |s, point| {
            changer.offset(network, s, point)
        });
        self.update_plans(network, route, rear_s, front_s + ahead);

        let (located, obstacles) =
            leader::find(&self.path, route_s, world, &mut self.tracker, tick_s, &model, &params);
        let profile = speed::profile(&self.path, route_s, speed, tick_s, &params);
        let mut choice = Choice { acceleration: params.max_acceleration, reason: Reason::Free };
        let bound = if profile.curve { Reason::Curve } else { Reason::Limit };
        choice.offer(profile.acceleration.max(-4.5), bound);

        let now = Situation {
            network,
            world,
            obstacles: &obstacles,
            profile: &profile,
            front_s,
            rear_s,
            speed,
            latency,
            tick_s,
        };
        let leader = self.follow_leaders(&now, &mut choice);
        let light = SignalAhead::find(network, route, front_s - 0.5, |signal| world.signal(signal));
        self.pass_junctions(&now, light, &mut choice);
        self.told = Told::default();

        let walk = pedestrians::Approach { front_s, rear_s, speed, top: profile.target.max(2.0) };
        if let Some(halt) = pedestrians::judge(network, &self.path, &self.plans, world, &walk, &params) {
            let distance = halt.stop_s - front_s;
            let reason =
                if halt.crossing { Reason::Crossing { distance } } else { Reason::Pedestrian { distance } };
            choice.offer(self.stop(speed, distance, latency), reason);
        }

        let wish = self.changer.decide(network, route_s, speed, world, &located, tick_s, &model, &params);
        if let Some(wait_s) = wish.wait_s {
            let distance = wait_s - route_s;
            choice.offer(self.stop(speed, distance, latency), Reason::LaneChange { distance });
            if let Some((gap, other)) = wish.beside
                && speed > 2.0
            {
                let a = follow(speed, gap.max(0.5), other, profile.target, &params).max(-1.2);
                choice.offer(a, Reason::LaneChange { distance });
            }
        }
        let to_end = route.length() - 1.0 - route_s;
        if to_end < params.sight {
            choice.offer(self.stop(speed, to_end, latency), Reason::RouteEnd { distance: to_end });
        }
        let off = self.path.locate(ego.pose.xy(), self.path.index_at(route_s)).d.abs();
        if off > 1.5 {
            choice.offer(speed::track(speed, 3.5).max(-3.0), Reason::OffRoute);
        }

        let (control, acceleration) = self.act(choice.acceleration, route_s, ego, tick_s);
        let blinker =
            if wish.blinker != 0 { wish.blinker } else { self.turn_signal(network, front_s, speed) };
        Decision {
            control,
            reason: choice.reason,
            target_speed: profile.target,
            acceleration,
            leader,
            light: light.map(|light| (light.state, light.stop_s - front_s)),
            held: is_held(&choice.reason),
            blinker_left: blinker > 0,
            blinker_right: blinker < 0,
            brake_light: control.brake > 0.0,
        }
    }

    /// Pedals and wheel for the acceleration `wanted`, and the acceleration that they are to give (m/s2).
    fn act(&mut self, wanted: f64, route_s: f64, ego: &EgoState, tick_s: f64) -> (Control, f64) {
        let (model, speed) = (self.model, ego.speed.max(0.0));
        // Smooth onset, except where it matters.
        let mut acceleration = wanted.min(self.last_acceleration.max(-0.5) + 4.0 * tick_s);
        if acceleration > -3.5 {
            acceleration = acceleration.max(self.last_acceleration.min(0.0) - 9.0 * tick_s);
        }
        self.last_acceleration = acceleration;
        let mut control = self.pedals.press(acceleration, speed, tick_s, &model);
        let wheel = steering::wheel_angle(&self.path, route_s, ego, &model, acceleration, tick_s);
        // At rest the wheels stay where they are.
        let wheel = if speed < 0.05 && control.throttle == 0.0 { ego.steer_angle } else { wheel };
        control.steer = (wheel / model.max_steer).clamp(-1.0, 1.0);
        (control, acceleration)
    }

    fn stop(&self, speed: f64, distance: f64, latency: f64) -> f64 {
        let p = &self.params;
        stop_in(speed, distance - speed * latency, p.comfortable_deceleration, p.emergency_deceleration)
    }

    /// Keeps the plans of the links between `from` and `to` (m on the route).
    fn update_plans(&mut self, network: &Network, route: &Route, from: f64, to: f64) {
        let mut plans = Vec::new();
        for link in route.links.iter().filter(|l| l.end_s + 10.0 > from && l.stop_s < to) {
            match self.plans.iter().position(|p| p.is_for(link)) {
                Some(i) => plans.push(self.plans.swap_remove(i)),
                None => plans.push(LinkPlan::new(network, route, link, &self.model)),
            }
        }
        self.plans = plans;
    }

    fn follow_leaders(&self, now: &Situation<'_>, choice: &mut Choice) -> Option<Leader> {
        let params = &self.params;
        let &Situation { front_s, speed, profile, .. } = now;
        let mut leader: Option<Leader> = None;
        for obstacle in now.obstacles {
            let gap = obstacle.near_s - front_s;
            let passes = obstacle.crossing && obstacle.clear_time.is_finite();
            if passes {
                let arrive = time_to_cover(gap - 0.5, speed, 1.5, profile.target.max(3.0));
                if arrive > obstacle.clear_time + 0.5 {
                    continue;
                }
            }
            let other = if passes { obstacle.speed.clamp(0.0, 0.5) } else { obstacle.speed };
            let mut a = now.behind(gap, other, params);
            if obstacle.predicted {
                // It is not there yet: open the gap without a shock unless it is tight.
                a = a.max(if gap < 0.3 * speed { -4.0 } else { -2.5 });
            }
            choice.offer(a, Reason::Leader { gap, speed: obstacle.speed });
            if !obstacle.crossing && leader.is_none_or(|l| gap < l.gap_m) {
                leader = Some(Leader { gap_m: gap, speed_mps: obstacle.speed });
            }
        }
        if let Some(Leader { gap_m, speed_mps }) = self.told.lead {
            let a = now.behind(gap_m, speed_mps, params);
            choice.offer(a, Reason::Leader { gap: gap_m, speed: speed_mps });
        }
        leader
    }

    /// Lights, full junctions and right of way at the links ahead. `light` is the signal that counts.
    fn pass_junctions(&mut self, now: &Situation<'_>, light: Option<SignalAhead>, choice: &mut Choice) {
        let by_lane = ByLane::new(now.world);
        let mut yielding_at = None;
        let told_stop = self.told.light.and_then(|light| light.stop);
        if let Some(ToldLight { limit, .. }) = self.told.light {
            choice.offer(speed::track(now.speed, limit).max(-3.0), Reason::Limit);
        }
        if let Some(distance) = told_stop {
            let a = self.stop(now.speed, distance - self.params.stop_margin, now.latency);
            choice.offer(a, Reason::RedLight { distance });
        }
        let plans = std::mem::take(&mut self.plans);
        for plan in plans.iter().filter(|plan| now.rear_s <= plan.end_s) {
            let distance = plan.stop_s - now.front_s;
            let yields = if distance > -0.5 {
                let line = line_to_wait_at(plan, light, now);
                // Behind a red light nothing matters.
                let Some(yields) = self.approach_line(plan, line, now, choice) else { break };
                yields
            } else {
                yields_at(now.network.link(plan.link), now.world)
            };
            if distance > now.reach() || told_stop.is_some_and(|stop| stop < distance + 1.0) {
                break;
            }
            if self.give_way(plan, yields, &by_lane, now, choice) {
                yielding_at = yielding_at.or(Some(plan.link));
            }
        }
        self.plans = plans;
        self.note_waiting(yielding_at, now);
    }

    /// The stop line of `plan`, `distance` ahead (m): its light, and whether there is room behind the junction.
    /// Whether to give way to vehicles with right of way; None: it stops here.
    fn approach_line(
        &mut self,
        plan: &LinkPlan,
        distance: f64,
        now: &Situation<'_>,
        choice: &mut Choice,
    ) -> Option<bool> {
        let (params, speed, latency) = (self.params, now.speed, now.latency);
        let top = now.profile.target.max(speed);
        let link = now.network.link(plan.link);
        let verdict = if self.told.light.is_some() && link.signal.is_some() {
            Verdict::Go { yields: yields_at(link, now.world) }
        } else {
            self.lights.judge(now.network, plan, now.world, distance, speed, top, latency, &params)
        };
        let Verdict::Go { yields } = verdict else {
            let a = self.stop(speed, distance - params.stop_margin, latency);
            choice.offer(a, Reason::RedLight { distance });
            return None;
        };
        let matters = !plan.conflicts.is_empty() || !plan.crossings.is_empty();
        let can_stop = speed * speed / (2.0 * (distance - speed * latency).max(0.3)) < 3.0;
        if matters && can_stop && distance < now.reach() {
            let needed = self.model.length + 12.0;
            let room =
                leader::room_behind_queue(now.obstacles, now.front_s, plan.clear_s, needed, params.min_gap);
            if room.is_some_and(|r| r < self.model.length + params.min_gap + 0.5) {
                let a = self.stop(speed, distance - params.stop_margin, latency);
                choice.offer(a, Reason::JunctionBlocked { distance });
            }
        }
        Some(yields)
    }

    /// The gaps in the traffic over the link of `plan`; whether it waits for one.
    fn give_way(
        &self,
        plan: &LinkPlan,
        yields: bool,
        by_lane: &ByLane,
        now: &Situation<'_>,
        choice: &mut Choice,
    ) -> bool {
        let params = self.params;
        let (network, world, front_s, speed) = (now.network, now.world, now.front_s, now.speed);
        let waited = if self.waiting_at == Some(plan.link) { self.waited } else { 0.0 };
        let impatience =
            ((waited - params.patience) / (params.patience_end - params.patience)).clamp(0.0, 1.0);
        let from = self.path.index_at(plan.stop_s.max(front_s));
        let to = self.path.index_at(plan.end_s);
        let top = self.path.samples[from..=to.max(from)]
            .iter()
            .map(|p| p.limit.min(speed::curve_speed(p.curvature, &params)))
            .fold(f64::INFINITY, f64::min)
            .max(2.0);
        let signal = network.link(plan.link).signal;
        let motion = Motion {
            front_s,
            rear_s: now.rear_s,
            speed,
            top,
            impatience,
            breaks_deadlock: waited >= params.patience_end,
            yields,
            signalled: signal.is_some_and(|s| world.signal(s) != Some(SignalState::Off)),
            ends_standoff: waited >= right_of_way::STANDOFF,
        };
        let mut waits = false;
        let outcome = right_of_way::judge(network, plan, world, by_lane, &motion, &params);
        for merging in &outcome.merging {
            let a = now.behind(merging.gap, merging.speed, &params).max(-4.0);
            choice.offer(a, Reason::Merge { gap: merging.gap, speed: merging.speed });
            waits |= merging.speed < 0.3 && front_s > plan.stop_s;
        }
        if let Some(hold) = outcome.hold {
            let distance = hold.stop_s - front_s;
            let inside = plan.wait_s == Some(hold.stop_s);
            let margin = if inside || hold.stop_s == plan.stop_s { params.stop_margin } else { 0.3 };
            choice.offer(self.stop(speed, distance - margin, now.latency), Reason::Yield { distance });
            waits = true;
        }
        waits
    }

    /// Counts how long it has stood for right of way.
    fn note_waiting(&mut self, yielding_at: Option<LinkId>, now: &Situation<'_>) {
        if let Some(link) = yielding_at {
            if self.waiting_at != Some(link) {
                self.waiting_at = Some(link);
                self.waited = 0.0;
            }
            if now.speed < 0.5 {
                self.waited += now.tick_s;
            }
        } else if now.speed > 3.0 {
            self.waiting_at = None;
            self.waited = 0.0;
        }
    }

    /// Which way the next link turns: -1 right, 1 left, 0 neither or too far off.
    fn turn_signal(&self, network: &Network, front_s: f64, speed: f64) -> i8 {
        let notice = 15.0 + 2.5 * speed;
        let next = self.plans.iter().find(|p| front_s < p.end_s + 1.0 && p.stop_s - front_s < notice);
        let turns_left = next.and_then(|plan| network.turns_left(network.link(plan.link).direction));
        turns_left.map_or(0, |left| if left { 1 } else { -1 })
    }
}

/// How far ahead (m) the ego waits for the light of `plan`: at its own stop line or, where that one stands without room
/// behind another junction and the ego can still stop in comfort, before that junction.
fn line_to_wait_at(plan: &LinkPlan, light: Option<SignalAhead>, now: &Situation<'_>) -> f64 {
    let before = light
        .filter(|light| light.line_s == plan.stop_s && light.stop_s < plan.stop_s)
        .map(|light| light.stop_s - now.front_s)
        .filter(|distance| {
            let room = (distance - now.speed * now.latency).max(0.3);
            now.speed * now.speed / (2.0 * room) < 3.0
        });
    before.unwrap_or(plan.stop_s - now.front_s)
}

/// Whether others have right of way at a link, were it not for a red light.
fn yields_at(link: &Link, world: &WorldState) -> bool {
    let green = link.signal.is_some_and(|signal| world.signal(signal) == Some(SignalState::GreenMajor));
    !link.must_yield_to.is_empty() && !green
}

fn is_held(reason: &Reason) -> bool {
    match *reason {
        Reason::Leader { speed, .. } | Reason::Merge { speed, .. } => speed < 2.0,
        Reason::RedLight { .. }
        | Reason::Yield { .. }
        | Reason::JunctionBlocked { .. }
        | Reason::Pedestrian { .. }
        | Reason::Crossing { .. } => true,
        Reason::Free
        | Reason::Limit
        | Reason::Curve
        | Reason::LaneChange { .. }
        | Reason::RouteEnd { .. }
        | Reason::OffRoute => false,
    }
}
