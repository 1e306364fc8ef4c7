//! Longitudinal control: accelerations that each constraint allows, and the pedals for the smallest.

use super::params::{AutopilotParams, EgoModel};
use super::path::Path;
use wad_vehicle::Control;

/// Gain from a speed error to an acceleration (1/s).
const SPEED_GAIN: f64 = 1.0;
/// Time constant of the last metre before a stop (s).
const STOP_TIME: f64 = 0.8;

/// Seconds to cover `distance` (m) from `speed` (m/s), accelerating at `acceleration` (m/s2, > 0)
/// up to `top` (m/s).
pub fn time_to_cover(distance: f64, speed: f64, acceleration: f64, top: f64) -> f64 {
    if distance <= 0.0 {
        return 0.0;
    }
    let speed = speed.max(0.0);
    if speed >= top {
        return distance / speed.max(0.1);
    }
    let ramp = (top * top - speed * speed) / (2.0 * acceleration);
    if distance <= ramp {
        ((speed * speed + 2.0 * acceleration * distance).sqrt() - speed) / acceleration
    } else {
        (top - speed) / acceleration + (distance - ramp) / top.max(0.1)
    }
}

/// Acceleration (m/s2) towards `target` m/s that has to be kept from here on.
pub fn track(speed: f64, target: f64) -> f64 {
    SPEED_GAIN * (target - speed)
}

/// Acceleration (m/s2) so as to be at `target` m/s in `distance` (m): unbounded while that is far
/// off, the planned deceleration on its curve, more beyond it.
pub fn slow_down(speed: f64, target: f64, distance: f64, deceleration: f64) -> f64 {
    if speed <= target {
        return f64::INFINITY;
    }
    let allowed = (target * target + 2.0 * deceleration * distance.max(0.0)).sqrt();
    let share = (speed - target).min(1.0);
    track(speed, allowed) - deceleration * (speed / allowed.max(0.5)).min(1.5) * share
}

/// Acceleration (m/s2) so as to stand in `distance` (m): planned deceleration, soft in the last metre,
/// harder where the plan no longer fits.
pub fn stop_in(speed: f64, distance: f64, deceleration: f64, hardest: f64) -> f64 {
    let distance = distance.max(0.0);
    if speed < 0.1 && distance < 0.6 {
        // Standing near enough.
        return -0.5;
    }
    if distance <= 0.02 {
        return -hardest.min((speed / 0.15).max(1.0));
    }
    let soft = deceleration * STOP_TIME * STOP_TIME;
    let (allowed, slope) = if distance <= soft {
        (distance / STOP_TIME, 1.0 / STOP_TIME)
    } else {
        let first = deceleration * STOP_TIME;
        let allowed = (first * first + 2.0 * deceleration * (distance - soft)).sqrt();
        (allowed, deceleration / allowed)
    };
    let planned = 1.5 * track(speed, allowed) - speed * slope;
    let needed = speed * speed / (2.0 * distance);
    let firm = if needed > 1.3 * deceleration { -1.1 * needed } else { f64::INFINITY };
    // Late, it brakes as hard as it must, but does not hurry back to the plan.
    let planned = if needed > deceleration { planned.max(-1.25 * needed) } else { planned };
    planned.min(firm).max(-hardest)
}

/// Acceleration (m/s2) behind a leader `gap` (m) ahead that moves at `leader` m/s (negative: towards
/// the ego): the intelligent driver model's interaction, and what physics needs in an emergency.
pub fn follow(speed: f64, gap: f64, leader: f64, top: f64, params: &AutopilotParams) -> f64 {
    let closing = speed - leader;
    if speed < 0.1 && leader.abs() < 0.3 && gap < params.min_gap + 0.8 {
        // Standing behind one that stands.
        return -0.5;
    }
    let gap = gap.max(0.05);
    let (a, b) = (params.max_acceleration, params.comfortable_deceleration);
    let dynamic = speed * params.time_headway + speed * closing / (2.0 * (a * b).sqrt());
    let wish = params.min_gap + dynamic.max(0.0);
    let ratio = wish / gap;
    let free = a * (1.0 - (speed / top.max(0.5)).powi(4)).max(-1.0);
    let model = if ratio >= 1.0 { a * (1.0 - ratio * ratio) } else { free * (1.0 - ratio.powi(4)) };
    let room = (gap - 0.6 * params.min_gap).max(0.1);
    let physical = if closing > 0.0 {
        let steady = closing * closing / (2.0 * room);
        let leader_stop = if leader > 0.0 { leader * leader / (2.0 * 5.0) } else { 0.0 };
        let if_it_brakes = speed * speed / (2.0 * (room + leader_stop));
        let need = if if_it_brakes > 3.5 { steady.max(if_it_brakes) } else { steady };
        if need > b { -need * 1.1 } else { f64::INFINITY }
    } else {
        f64::INFINITY
    };
    // The model over-reacts to a leader that pulls away or cuts in at the same speed.
    let softened = if closing <= 0.3 { model.max(-2.5) } else { model };
    softened.min(physical).max(-params.emergency_deceleration)
}

/// What the limits and curves ahead allow.
pub struct Profile {
    /// Acceleration (m/s2).
    pub acceleration: f64,
    /// Speed wanted here (m/s).
    pub target: f64,
    /// Whether a curve, not a limit, decides.
    pub curve: bool,
}

/// Highest speed (m/s) through a curvature (1/m).
pub fn curve_speed(curvature: f64, params: &AutopilotParams) -> f64 {
    (params.lateral_acceleration / curvature.abs().max(1e-4)).sqrt()
}

/// Mean delay of a decision for a tick of `tick_s` (s), with the pedals' own lag.
pub fn latency(tick_s: f64) -> f64 {
    0.5 * tick_s + 0.1
}

/// How far off its way a curve may lead the ego within a tick (m): the wheels move once a tick.
const DRIFT: f64 = 0.15;

/// The speed limits and curves from `route_s` (m) on, in ticks of `tick_s` (s).
pub fn profile(path: &Path, route_s: f64, speed: f64, tick_s: f64, params: &AutopilotParams) -> Profile {
    let latency = latency(tick_s);
    let here = path.at(route_s);
    let mut result = Profile { acceleration: f64::INFINITY, target: here.limit, curve: false };
    let first = path.index_at(route_s);
    for sample in &path.samples[first..] {
        let distance = (sample.s - route_s - speed * latency).max(0.0);
        let drift = (8.0 * DRIFT / sample.curvature.abs().max(1e-4)).sqrt() / tick_s.max(0.01);
        let bend = curve_speed(sample.curvature, params).min(drift);
        let allowed = bend.min(sample.limit);
        let a = if distance <= 0.5 {
            track(speed, allowed)
        } else {
            slow_down(speed, allowed, distance, params.comfortable_deceleration)
        };
        // In a long tick it would end up slower than any rule requires.
        let a = if speed > allowed { a.max((allowed - speed) / tick_s) } else { a };
        if a < result.acceleration {
            result.acceleration = a;
            result.curve = bend < sample.limit;
        }
        let reachable = (allowed * allowed + 2.0 * params.comfortable_deceleration * distance).sqrt();
        result.target = result.target.min(reachable);
    }
    result
}

/// Turns an acceleration into pedals.
#[derive(Clone, Copy, Debug, Default)]
pub struct Pedals {
    /// What the force model misses (m/s2), learned from the speed.
    correction: f64,
    /// The last acceleration asked for (m/s2) and the speed then (m/s).
    asked: Option<(f64, f64)>,
}

impl Pedals {
    /// Forgets the last request, because another driver used the pedals and the response is not ours.
    pub fn overruled(&mut self) {
        (self.asked, self.correction) = (None, 0.0);
    }

    /// Pedals for `acceleration` (m/s2) at `speed` (m/s) over a tick of `tick_s`; steering is left at 0.
    pub fn press(&mut self, acceleration: f64, speed: f64, tick_s: f64, model: &EgoModel) -> Control {
        if let Some((asked, before)) = self.asked {
            let got = (speed - before) / tick_s;
            if speed > 1.0 && before > 1.0 && asked > -5.0 {
                self.correction = (self.correction + 0.15 * (asked - got)).clamp(-1.0, 1.0);
            }
        }
        if speed < 0.35 && acceleration < 0.1 {
            self.asked = None;
            self.correction = 0.0;
            return Control { throttle: 0.0, steer: 0.0, brake: 0.35, reverse: false };
        }
        let force = acceleration + self.correction + model.resistance(speed);
        let drag = model.engine_drag(speed);
        let (throttle, brake) = if force + drag >= 0.0 {
            (((force + drag) / (model.drive(speed) + drag)).min(1.0), 0.0)
        } else {
            (0.0, ((-force - drag) / model.max_brake).clamp(0.001, 1.0))
        };
        self.asked = (throttle < 1.0 && brake < 1.0).then_some((acceleration, speed));
        Control { throttle, steer: 0.0, brake, reverse: false }
    }
}
