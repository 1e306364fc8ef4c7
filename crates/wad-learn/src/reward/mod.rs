//! The paper's reward: R = r_timeout + r_collision + r_lane + r_speed + r_light + r_steps.
//!
//! Each term is a pure function of a few numbers and of [`RewardParams`]; docs/reward.md plots them.
//! [`Facts`] holds the paper's four data points (waypoints, light, collision sensor, and the vehicle in
//! front as the detector sees it) and the ego's own motion; nothing else of the simulator.
//!
//! **Scale.** At six ticks a second and gamma 0.98 an agent looks 50 ticks (8 s) ahead. Driving well is worth
//! about +1.2 a tick, so about +60; necessary waiting +0.6; standing without a reason about -1, and in training
//! it ends the episode after 4 s. An ending costs 20 to 50 once, besides all later rewards. So: better to drive
//! than to wait, better to wait than to run the light, and standing is never a way out.

mod params;
#[cfg(test)]
mod tests;

pub use params::RewardParams;

use serde::{Deserialize, Serialize};
use sumo_network::network::Route;
use wad_see::observation::LeadState;

/// How far ahead bends are looked at (m, and s of driving), and how closely (m).
const BENDS: (f64, f64) = (15.0, 4.0);
const BEND_STEP: f64 = 2.0;

/// The named terms of one tick.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RewardTerms {
    /// r_timeout.
    pub timeout: f64,
    /// r_collision.
    pub collision: f64,
    /// r_lane.
    pub lane: f64,
    /// r_speed.
    pub speed: f64,
    /// r_light.
    pub light: f64,
    /// r_steps.
    pub steps: f64,
}

impl RewardTerms {
    /// Names in the paper's order.
    pub const NAMES: [&'static str; 6] = ["timeout", "collision", "lane", "speed", "light", "steps"];

    /// The terms in the paper's order.
    pub fn values(&self) -> [f64; 6] {
        [self.timeout, self.collision, self.lane, self.speed, self.light, self.steps]
    }

    /// R.
    pub fn total(&self) -> f64 {
        self.values().iter().sum()
    }

    /// Adds another tick's terms.
    pub fn add(&mut self, other: &Self) {
        self.timeout += other.timeout;
        self.collision += other.collision;
        self.lane += other.lane;
        self.speed += other.speed;
        self.light += other.light;
        self.steps += other.steps;
    }
}

/// The light ahead.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Light {
    /// From the front bumper to the stop line (m).
    pub distance: f64,
    /// Red or red with yellow; false: yellow.
    pub red: bool,
}

/// The facts for the reward of a tick: the state after the tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Facts {
    /// The ego's speed (m/s).
    pub speed: f64,
    /// Acceleration over this tick (m/s2).
    pub acceleration: f64,
    /// Acceleration over the tick before (m/s2).
    pub previous_acceleration: f64,
    /// The ego's steering in this tick (-1..1).
    pub steer: f64,
    /// Steering in the tick before (-1..1).
    pub previous_steer: f64,
    /// The speed limit here (m/s), from the waypoints as are the next three.
    pub speed_limit: f64,
    /// The speed at which the bend ahead is comfortable (m/s, see [`curve_speed`]).
    pub curve_speed: f64,
    /// The steering that the bend here needs (-1..1).
    pub curve_steer: f64,
    /// Distance outside the centre of the lane or lane change (m, >= 0).
    pub offset: f64,
    /// The vehicle in front, from the detector in use.
    pub lead: Option<LeadState>,
    /// The red or yellow light ahead.
    pub light: Option<Light>,
    /// The stop line was crossed on red.
    pub ran_red: bool,
    /// Impulse of the tick's worst collision (N s).
    pub collision: Option<f64>,
    /// The ego stood too long without a reason.
    pub blocked: bool,
    /// The episode ends because the ego left its lane or the road.
    pub left_road: bool,
}

impl Facts {
    /// Driving at `speed` (m/s) on an empty straight road with this limit (m/s), in the lane's middle.
    pub fn cruising(speed: f64, speed_limit: f64) -> Self {
        Self {
            speed,
            acceleration: 0.0,
            previous_acceleration: 0.0,
            steer: 0.0,
            previous_steer: 0.0,
            speed_limit,
            curve_speed: f64::INFINITY,
            curve_steer: 0.0,
            offset: 0.0,
            lead: None,
            light: None,
            ran_red: false,
            collision: None,
            blocked: false,
            left_road: false,
        }
    }
}

/// All terms of a tick.
pub fn compute(p: &RewardParams, facts: &Facts) -> RewardTerms {
    RewardTerms {
        timeout: timeout(p, facts.blocked),
        collision: collision(p, facts.collision),
        lane: lane(p, facts.offset, facts.left_road, way(p, facts)),
        speed: longitudinal(p, facts) + smoothness(p, facts),
        light: light(p, facts),
        steps: steps(p),
    }
}

/// r_timeout: `-p.timeout` once, when the ego has stood too long without a reason; terminal. Waiting at a red
/// light or behind a vehicle does not count (spec.md "Events").
pub fn timeout(p: &RewardParams, blocked: bool) -> f64 {
    if blocked { -p.timeout } else { 0.0 }
}

/// r_collision: `-(p.collision + p.collision_hard min(1, impulse / p.collision_impulse))` once; terminal. It
/// grows with the impulse (N s).
pub fn collision(p: &RewardParams, impulse: Option<f64>) -> f64 {
    impulse.map_or(0.0, |impulse| {
        -(p.collision + p.collision_hard * (impulse / p.collision_impulse).clamp(0.0, 1.0))
    })
}

/// r_lane: `p.lane (1 - (offset / t)^2)` times `way` (0..1, the share of the wanted speed, see [`way`]) within
/// the threshold t = `p.lane_threshold` (m), `-p.lane_outside (offset - t)` beyond it, down to `-p.lane_most`, and
/// `-p.lane_exit` more once when leaving the lane or the road ends the episode: hard termination pays at once
/// what would have added up, and leaving the road is no cheap way out of a collision. The lane's middle is earned by driving along it: paid to an ego that stands, it
/// was worth as much as driving badly, and agents that learn by reward alone stood still for ever.
pub fn lane(p: &RewardParams, offset: f64, left_road: bool, way: f64) -> f64 {
    let t = p.lane_threshold;
    let dense = if offset <= t {
        p.lane * (1.0 - (offset / t).powi(2)) * way
    } else {
        -(p.lane_outside * (offset - t)).min(p.lane_most)
    };
    if left_road { dense - p.lane_exit } else { dense }
}

/// The ego's speed as a share (0..1) of the wanted one.
pub fn way(p: &RewardParams, facts: &Facts) -> f64 {
    (facts.speed / wanted(p, facts).speed.max(p.least_wanted)).clamp(0.0, 1.0)
}

/// What holds the ego, and how fast it may be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wanted {
    /// m/s.
    pub speed: f64,
    /// A red light or a standing vehicle so near that standing is right.
    pub stop: bool,
}

/// The speed wanted here: the least of limit, bend, vehicle in front, and light.
///
/// Behind a vehicle at speed u with gap g: `sqrt(u^2 + 2 b (g - g0 - h u))` where the root is real (b =
/// `p.braking`, g0 = `p.gap`, h = `p.headway`), nothing below; before a stop line at distance d: `sqrt(2 b (d
/// - d0))`. A yellow light counts only where the ego can still stop at `p.yellow_braking`.
pub fn wanted(p: &RewardParams, facts: &Facts) -> Wanted {
    let mut speed = facts.speed_limit.min(facts.curve_speed);
    let mut stop = false;
    if let Some(lead) = facts.lead {
        let other = lead.speed(facts.speed);
        let room = lead.gap - p.gap - p.headway * other;
        speed = speed.min((other * other + 2.0 * p.braking * room).max(0.0).sqrt());
        stop |= other < p.standing_other && lead.gap <= p.stop_zone;
    }
    if let Some(light) = facts.light.filter(|light| must_stop(p, light, facts.speed)) {
        speed = speed.min((2.0 * p.braking * (light.distance - p.line_gap).max(0.0)).sqrt());
        stop |= light.distance <= p.stop_zone;
    }
    Wanted { speed, stop }
}

/// Whether a light binds: red always, yellow where the ego can stop at `p.yellow_braking` (m/s2).
fn must_stop(p: &RewardParams, light: &Light, speed: f64) -> bool {
    light.red || speed * speed <= 2.0 * p.yellow_braking * light.distance.max(0.0)
}

/// The longitudinal part of r_speed. With v the speed and w the wanted one:
///
/// - standing (v < `p.standing`) where a red light or a standing vehicle is at most `p.stop_zone` ahead:
///   `+p.stopped`;
/// - v <= w: from `-p.idle` at rest to `+p.speed` at v = w, in a straight line;
/// - v > w: `p.speed - p.excess (v - w)`, down to `-p.excess_most`: over the limit, too fast behind a
///   vehicle, towards a red light, into a bend.
pub fn longitudinal(p: &RewardParams, facts: &Facts) -> f64 {
    let v = facts.speed.max(0.0);
    let wanted = wanted(p, facts);
    if wanted.stop && v < p.standing {
        return p.stopped;
    }
    // Below walking pace a share means nothing: half of 0.2 m/s is not driving.
    let w = wanted.speed;
    let value = if v <= w {
        (p.speed + p.idle) * v / w.max(p.least_wanted) - p.idle
    } else {
        let at_wanted = (p.speed + p.idle) * (w / p.least_wanted).min(1.0) - p.idle;
        (at_wanted - p.excess * (v - w)).max(-p.excess_most)
    };
    // Driving in reverse earns nothing.
    if facts.speed < -p.standing { -p.idle } else { value }
}

/// The other part of r_speed, all of it a cost: `-p.steer |steer - curve_steer|` for the steering's
/// magnitude beside what the bend needs, `-p.steer_change |steer - previous_steer|` for oscillation,
/// `-p.jolt max(0, |a| - p.comfortable)` for hard acceleration and `-p.jerk |a - previous a|` for its change
/// beyond `p.jerk_free`.
pub fn smoothness(p: &RewardParams, facts: &Facts) -> f64 {
    let steer = p.steer * (facts.steer - facts.curve_steer).abs();
    let change = p.steer_change * (facts.steer - facts.previous_steer).abs();
    let jolt = p.jolt * (facts.acceleration.abs() - p.comfortable).max(0.0);
    let jerk = (facts.acceleration - facts.previous_acceleration).abs();
    let cost = steer + change + jolt + p.jerk * (jerk - p.jerk_free).max(0.0);
    -cost.min(p.smoothness_most)
}

/// r_light: `-(p.red + p.red_speed v)` once when the stop line was crossed on red (terminal); before a red
/// light within `p.intersection` (m), `+p.red_stopped` while standing within `p.stop_zone` of the line, and
/// `-p.red_approach v` while faster than what still stops there.
pub fn light(p: &RewardParams, facts: &Facts) -> f64 {
    let v = facts.speed.max(0.0);
    if facts.ran_red {
        return -(p.red + p.red_speed * v);
    }
    let Some(light) = facts.light.filter(|light| light.red && light.distance <= p.intersection) else {
        return 0.0;
    };
    if v < p.standing {
        return if light.distance <= p.stop_zone { p.red_stopped } else { 0.0 };
    }
    let safe = (2.0 * p.yellow_braking * light.distance.max(0.0)).sqrt();
    if v > safe { -p.red_approach * v } else { 0.0 }
}

/// r_steps: `+p.steps` for every tick.
pub fn steps(p: &RewardParams) -> f64 {
    p.steps
}

/// The speed (m/s) from which, braking at `p.curve_braking`, every bend of `(distance m, curvature 1/m)`
/// is met at no more than `p.lateral` (m/s2) across.
pub fn curve_speed(p: &RewardParams, bends: impl IntoIterator<Item = (f64, f64)>) -> f64 {
    bends.into_iter().fold(f64::INFINITY, |speed, (distance, curvature)| {
        let square = p.lateral / curvature.abs().max(1e-6) + 2.0 * p.curve_braking * distance.max(0.0);
        speed.min(square.sqrt())
    })
}

/// Distance (m) and curvature (1/m) of what the route has ahead.
pub fn bends(route: &Route, s: f64, speed: f64) -> impl Iterator<Item = (f64, f64)> + '_ {
    let reach = (BENDS.0 + BENDS.1 * speed.max(0.0)).min(route.length() - s);
    let count = (reach.max(0.0) / BEND_STEP) as usize;
    (0..=count).map(move |i| {
        let ahead = i as f64 * BEND_STEP;
        (ahead, route.at(s + ahead).curvature)
    })
}
