//! Steering: a linear-quadratic preview of the path over the next two seconds.
//!
//! State: lateral error of the footprint's centre (m, left positive), heading error (rad) and
//! u = tan(front wheel angle). In u the kinematic bicycle is linear:
//! `e' = v (psi + r u / L)`, `psi' = v u / L - v kappa`, with r the rear axle's distance to the centre;
//! r and L are corrected for tyre slip.
//! The path's heading change over each step is known, so the wheels begin to turn before the curve does.
//! In long ticks the plan only carries on what a first wheel angle, tried out on the model, begins.

use super::params::EgoModel;
use super::path::Path;
use nalgebra::{Matrix3, Vector3};
use std::f64::consts::FRAC_PI_2;
use sumo_network::geometry::{Pose, direction, wrap_angle};
use wad_vehicle::{EgoState, GRAVITY};

/// Steps of the preview.
const STEPS: usize = 14;
/// Their length (s).
const DT: f64 = 0.15;
/// Below this speed (m/s) the plan is made as if at this speed: at rest nothing can be steered.
const SLOWEST: f64 = 1.5;

/// Ticks longer than this (s) are steered by trying wheel angles out on a model of the vehicle: over so
/// long a time the plan's small angles and free wheels no longer hold.
pub const LONG_TICK: f64 = 0.25;
/// Wheel angles that are tried for this tick and the next, how often the grid closes in, and the steps of
/// [`DT`] after those ticks.
const GRID: usize = 7;
const ROUNDS: usize = 4;
const BEYOND: usize = 14;
/// Sideways acceleration beyond which nothing is tried (m/s2).
const HARDEST: f64 = 3.0;
/// Step of the model (s).
const MODEL_DT: f64 = 0.05;

/// What errors and wheel movements cost.
const LATERAL_COST: f64 = 1.0;
const DIRECTION_COST: f64 = 7.0;

/// Front wheels' angle (rad, left positive) to ask for over a tick of `tick_s` (s), in which the ego is to
/// accelerate by `acceleration` (m/s2).
pub fn wheel_angle(
    path: &Path,
    route_s: f64,
    ego: &EgoState,
    model: &EgoModel,
    acceleration: f64,
    tick_s: f64,
) -> f64 {
    let now = Bicycle { pose: ego.pose, wheel: ego.steer_angle, index: path.index_at(route_s) };
    let speed = ego.speed.max(0.0);
    if tick_s <= LONG_TICK {
        return planned(path, &now, model, speed, DT);
    }
    let mean = (speed + 0.5 * acceleration * tick_s).max(0.5);
    let later = (speed + acceleration * tick_s).max(1.0);
    // The wheel in this tick and in the next: a grid that closes in on the best pair.
    let widest = |v: f64| (model.wheelbase * HARDEST / (v * v)).atan().min(model.max_steer);
    let (most, most_later) = (widest(mean), widest(later));
    let mut best = (f64::INFINITY, 0.0, 0.0);
    let mut span = (most, most_later);
    for _ in 0..ROUNDS {
        let middle = (best.1, best.2);
        for i in 0..GRID {
            let x = 2.0 * i as f64 / (GRID - 1) as f64 - 1.0;
            let wheel = (middle.0 + x * span.0).clamp(-most, most);
            let mut car = now;
            let begun = car.drive(path, model, wheel, mean, tick_s);
            for k in 0..GRID {
                let x = 2.0 * k as f64 / (GRID - 1) as f64 - 1.0;
                let next = (middle.1 + x * span.1).clamp(-most_later, most_later);
                let mut car = car;
                let mut cost = begun + car.drive(path, model, next, later, tick_s);
                // What follows as the plan would have it.
                for _ in 0..BEYOND {
                    if cost >= best.0 {
                        break;
                    }
                    let plan = planned(path, &car, model, later, DT);
                    cost += car.drive(path, model, plan, later, DT);
                }
                if cost < best.0 {
                    best = (cost, wheel, next);
                }
            }
        }
        span = (0.4 * span.0, 0.4 * span.1);
    }
    best.1
}

/// The ego on its path as the model has it.
#[derive(Clone, Copy)]
struct Bicycle {
    pose: Pose,
    /// Front wheels' angle (rad).
    wheel: f64,
    /// The path's sample near by.
    index: usize,
}

impl Bicycle {
    /// Drives for `duration` (s) at `speed` (m/s) with the wheels turning towards `wheel` (rad); what the
    /// errors on the way cost.
    fn drive(&mut self, path: &Path, model: &EgoModel, wheel: f64, speed: f64, duration: f64) -> f64 {
        let steps = (duration / MODEL_DT).ceil().max(1.0);
        let dt = duration / steps;
        let arm = model.rear_axle_to_centre / model.wheelbase;
        let slip = speed * speed / (model.wheelbase * GRAVITY);
        let wheelbase =
            model.wheelbase * (1.0 + slip * (1.0 / model.cornering_front - 1.0 / model.cornering_rear));
        let mut cost = 0.0;
        for _ in 0..steps as usize {
            let most = model.steer_rate * dt;
            self.wheel += (wheel - self.wheel).clamp(-most, most);
            let u = self.wheel.tan();
            let heading = self.pose.heading + 0.5 * speed * u / wheelbase * dt;
            let side = (arm - slip / model.cornering_rear) * u;
            let way = direction(heading) + direction(heading + FRAC_PI_2) * side;
            let at = self.pose.xy() + way * (speed * dt);
            let heading = self.pose.heading + speed * u / wheelbase * dt;
            self.pose = Pose::new(at.x, at.y, self.pose.position.z, heading);
            let here = path.locate(at, self.index);
            self.index = here.index;
            let turned = wrap_angle(heading - path.heading_at(here.s));
            cost += dt * (here.d * here.d + 3.0 * turned * turned);
        }
        cost
    }
}

/// Front wheels' angle (rad) of the linear-quadratic plan with steps of `dt` (s).
fn planned(path: &Path, ego: &Bicycle, model: &EgoModel, speed: f64, dt: f64) -> f64 {
    let speed = speed.max(SLOWEST);
    let here = path.locate(ego.pose.xy(), ego.index);
    let psi = wrap_angle(ego.pose.heading - path.heading_at(here.s)).clamp(-0.9, 0.9);
    let error = Vector3::new(here.d.clamp(-2.0, 2.0), psi, ego.wheel.tan());

    // Tyre slip: the rear axle slides outwards, the car turns a little less than its wheels.
    let slip = speed * speed / (model.wheelbase * GRAVITY);
    let arm = model.rear_axle_to_centre / model.wheelbase - slip / model.cornering_rear;
    let wheelbase =
        model.wheelbase * (1.0 + slip * (1.0 / model.cornering_front - 1.0 / model.cornering_rear));
    let step = speed * dt;
    // x+ = A x + B w + c, w = change of u in the step, at work through half of it.
    let along_u = step * arm + 0.5 * step * step / wheelbase;
    let a = Matrix3::new(1.0, step, along_u, 0.0, 1.0, step / wheelbase, 0.0, 0.0, 1.0);
    let b = Vector3::new(0.5 * along_u, 0.5 * step / wheelbase, 1.0);
    // The direction of travel of the centre is psi + arm u; its error counts per metre.
    let direction = Vector3::new(0.0, 1.0, arm);
    let lateral = Vector3::new(1.0, 0.0, 0.0);
    let q = lateral * lateral.transpose() * LATERAL_COST
        + direction * direction.transpose() * (DIRECTION_COST * (speed * DT).clamp(0.25, 4.0));
    // Wheel movements cost more the faster it goes.
    let r = 0.4 + 0.08 * speed * speed;

    let mut value = q * 3.0;
    let mut slope = Vector3::zeros();
    let mut first = 0.0;
    for k in (0..STEPS).rev() {
        let s = here.s + k as f64 * step;
        let turn = wrap_angle(path.heading_at(s + step) - path.heading_at(s));
        let c = Vector3::new(-0.5 * step * turn, -turn, 0.0);
        let pb = value * b;
        let gain = r + b.dot(&pb);
        let row = (pb.transpose() * a) / gain;
        let offset = (pb.dot(&c) + b.dot(&slope)) / gain;
        if k == 0 {
            first = -(row * error)[0] - offset;
        }
        let closed = a - b * row;
        let pushed = c - b * offset;
        slope = closed.transpose() * (value * pushed + slope) + row.transpose() * (r * offset);
        value = q + closed.transpose() * value * closed + row.transpose() * row * r;
        value = (value + value.transpose()) * 0.5;
    }
    (error.z + first).atan().clamp(-model.max_steer, model.max_steer)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::autopilot::params::AutopilotParams;
    use crate::autopilot::speed::{Pedals, profile};
    use sumo_network::geometry::Point;
    use wad_vehicle::{EgoParams, EgoVehicle};

    /// A path of straight and circular pieces: (length m, curvature 1/m), with a speed limit (m/s).
    fn path_of(pieces: &[(f64, f64)], limit: f64) -> Path {
        let (mut point, mut heading) = (Point::origin(), 0.0);
        let mut points = vec![(0.0, point, 0.0, limit)];
        for &(length, curvature) in pieces {
            for _ in 0..length.round() as usize {
                let middle: f64 = heading + 0.5 * curvature;
                let chord = if curvature == 0.0 { 1.0 } else { (0.5 * curvature).sin() / (0.5 * curvature) };
                point += direction(middle) * chord;
                heading += curvature;
                points.push((points.len() as f64, point, 0.0, limit));
            }
        }
        let mut path = Path::default();
        path.set(points.into_iter(), &EgoModel::default());
        path
    }

    /// Drives along the path with the real vehicle: largest lateral error (m), largest lateral acceleration
    /// (m/s2), sign changes of the steering rate above 0.02 per tick, and the end's distance.
    fn drive(path: &Path, start_speed: f64, tick_s: f64) -> (f64, f64, usize, f64) {
        let params = EgoParams::default();
        let model = EgoModel::from(&params);
        let mut ego = EgoVehicle::new(params, Pose::new(3.0, 0.0, 0.0, 0.0), start_speed);
        let mut pedals = Pedals::default();
        let (mut s, mut worst, mut sideways, mut turns) = (3.0, 0.0_f64, 0.0_f64, 0);
        let (mut last_steer, mut last_change) = (0.0, 0.0);
        for _ in 0..1200 {
            let state = ego.state();
            let here = path.locate(state.pose.xy(), path.index_at(s));
            s = here.s;
            if s > path.end() - 4.0 {
                break;
            }
            worst = worst.max(here.d.abs());
            sideways = sideways.max((state.yaw_rate * state.speed).abs());
            let goal = profile(path, s, state.speed, tick_s, &AutopilotParams::default());
            let acceleration = goal.acceleration.clamp(-5.0, 2.0);
            let mut control = pedals.press(acceleration, state.speed, tick_s, &model);
            control.steer = wheel_angle(path, s, &state, &model, acceleration, tick_s) / model.max_steer;
            let change: f64 = control.steer - last_steer;
            if change.abs() > 0.02 && change * last_change < 0.0 {
                turns += 1;
            }
            if change.abs() > 0.02 {
                last_change = change;
            }
            last_steer = control.steer;
            ego.tick(control, tick_s, &[]);
        }
        (worst, sideways, turns, s)
    }

    #[test]
    fn an_ordinary_turn_is_not_cut() {
        for tick_s in [0.05, 0.1, 0.167, 0.2] {
            for sign in [1.0, -1.0] {
                let path = path_of(&[(40.0, 0.0), (16.0, sign / 10.0), (40.0, 0.0)], 13.9);
                let (worst, sideways, _, s) = drive(&path, 10.0, tick_s);
                println!("turn {tick_s}: {worst:.3} m, {sideways:.2} m/s2");
                assert!(s > 90.0, "stuck at {s}");
                assert!(worst < 0.3, "tick {tick_s}, sign {sign}: off by {worst}");
                assert!(sideways < 3.2, "tick {tick_s}: {sideways} m/s2 sideways");
            }
        }
    }

    #[test]
    fn the_tightest_turn_stays_in_its_lane() {
        for tick_s in [0.05, 0.167, 0.2] {
            for sign in [1.0, -1.0] {
                let path = path_of(&[(30.0, 0.0), (9.0, sign / 6.0), (30.0, 0.0)], 13.9);
                let (worst, _, _, s) = drive(&path, 8.0, tick_s);
                println!("tight {tick_s}: {worst:.3} m");
                assert!(s > 60.0, "stuck at {s}");
                assert!(worst < 0.8, "tick {tick_s}, sign {sign}: off by {worst}");
            }
        }
    }

    #[test]
    fn long_ticks_do_not_swing_it_off_the_road() {
        for tick_s in [0.3, 0.5, 0.75, 1.0] {
            for (radius, most) in [(30.0, 0.3), (10.0, 0.3), (6.0, 0.4)] {
                for sign in [1.0, -1.0] {
                    let turn = 0.5 * std::f64::consts::PI * radius;
                    let path = path_of(&[(40.0, 0.0), (turn, sign / radius), (80.0, 0.0)], 13.9);
                    let (worst, sideways, _, s) = drive(&path, 8.0, tick_s);
                    println!("tick {tick_s}, radius {radius}: {worst:.3} m, {sideways:.2} m/s2");
                    assert!(s > 110.0 + turn, "stuck at {s}");
                    assert!(worst < most, "tick {tick_s}, radius {radius}, sign {sign}: off by {worst}");
                }
            }
        }
    }

    #[test]
    fn long_ticks_find_back_to_the_path() {
        for tick_s in [0.5, 1.0] {
            let mut path = path_of(&[(300.0, 0.0)], 13.9);
            for sample in &mut path.samples {
                sample.point.y += if sample.s < 60.0 { 0.0 } else { 3.0 };
            }
            let params = EgoParams::default();
            let model = EgoModel::from(&params);
            let mut ego = EgoVehicle::new(params, Pose::new(62.0, 0.0, 0.0, 0.0), 8.0);
            let (mut most, mut last) = (f64::NEG_INFINITY, f64::NEG_INFINITY);
            for _ in 0..(16.0 / tick_s) as usize {
                let state = ego.state();
                let s = state.pose.xy().x;
                last = path.locate(state.pose.xy(), path.index_at(s)).d;
                most = most.max(last);
                let steer = wheel_angle(&path, s, &state, &model, 0.0, tick_s) / model.max_steer;
                ego.tick(
                    wad_vehicle::Control { throttle: 0.1, steer, brake: 0.0, reverse: false },
                    tick_s,
                    &[],
                );
            }
            assert!(most < 0.7, "tick {tick_s}: overshot by {most}");
            assert!(last.abs() < 0.1, "tick {tick_s}: still off by {last}");
        }
    }

    #[test]
    fn it_does_not_weave_at_speed() {
        let path = path_of(&[(200.0, 0.0), (150.0, 1.0 / 300.0), (150.0, -1.0 / 300.0), (300.0, 0.0)], 25.0);
        let (worst, _, turns, s) = drive(&path, 24.0, 0.167);
        println!("fast: {worst:.3} m, {turns} reversals");
        assert!(s > 790.0, "stuck at {s}");
        assert!(worst < 0.3, "off by {worst}");
        assert!(turns < 6, "{turns} reversals of the wheel");
    }

    #[test]
    fn an_offset_of_a_lane_is_closed_without_overshoot() {
        let mut path = path_of(&[(300.0, 0.0)], 13.9);
        for sample in &mut path.samples {
            sample.point.y += if sample.s < 60.0 { 0.0 } else { 1.5 };
        }
        let params = EgoParams::default();
        let model = EgoModel::from(&params);
        let mut ego = EgoVehicle::new(params, Pose::new(62.0, 0.0, 0.0, 0.0), 13.0);
        let mut most = f64::NEG_INFINITY;
        for _ in 0..60 {
            let state = ego.state();
            let s = state.pose.xy().x;
            let here = path.locate(state.pose.xy(), path.index_at(s));
            most = most.max(here.d);
            let steer = wheel_angle(&path, s, &state, &model, 0.0, 0.167) / model.max_steer;
            ego.tick(wad_vehicle::Control { throttle: 0.1, steer, brake: 0.0, reverse: false }, 0.167, &[]);
        }
        assert!(most < 0.15, "overshot by {most}");
    }
}
