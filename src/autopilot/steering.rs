//! Steering: a linear-quadratic preview of the path over the next two seconds.
//!
//! State: lateral error of the footprint's centre (m, left positive), heading error (rad) and
//! u = tan(front wheel angle). In u the kinematic bicycle is linear:
//! `e' = v (psi + r u / L)`, `psi' = v u / L - v kappa`, with r the rear axle's distance to the centre;
//! r and L are corrected for tyre slip.
//! The path's heading change over each step is known, so the wheels begin to turn before the curve does.

use super::params::EgoModel;
use super::path::Path;
use crate::geometry::wrap_angle;
use crate::vehicle::{EgoState, GRAVITY};
use nalgebra::{Matrix3, Vector3};

/// Steps of the preview.
const STEPS: usize = 14;
/// Their length (s).
const DT: f64 = 0.15;
/// Below this speed (m/s) the plan is made as if at this speed: at rest nothing can be steered.
const SLOWEST: f64 = 1.5;

/// What errors and wheel movements cost.
const LATERAL_COST: f64 = 1.0;
const DIRECTION_COST: f64 = 7.0;

/// Front wheels' angle (rad, left positive) to ask for.
pub fn wheel_angle(path: &Path, route_s: f64, ego: &EgoState, model: &EgoModel, speed: f64) -> f64 {
    let speed = speed.max(SLOWEST);
    let here = path.locate(ego.pose.xy(), path.index_at(route_s));
    let psi = wrap_angle(ego.pose.heading - path.heading_at(here.s)).clamp(-0.9, 0.9);
    let error = Vector3::new(here.d.clamp(-2.0, 2.0), psi, ego.steer_angle.tan());

    // Tyre slip: the rear axle slides outwards, the car turns a little less than its wheels.
    let slip = speed * speed / (model.wheelbase * GRAVITY);
    let arm = model.rear_axle_to_centre / model.wheelbase - slip / model.cornering_rear;
    let wheelbase =
        model.wheelbase * (1.0 + slip * (1.0 / model.cornering_front - 1.0 / model.cornering_rear));
    let step = speed * DT;
    // x+ = A x + B w + c, w = change of u in the step, at work through half of it.
    let along_u = step * arm + 0.5 * step * step / wheelbase;
    let a = Matrix3::new(1.0, step, along_u, 0.0, 1.0, step / wheelbase, 0.0, 0.0, 1.0);
    let b = Vector3::new(0.5 * along_u, 0.5 * step / wheelbase, 1.0);
    // The direction of travel of the centre is psi + arm u; its error counts per metre.
    let direction = Vector3::new(0.0, 1.0, arm);
    let lateral = Vector3::new(1.0, 0.0, 0.0);
    let q = lateral * lateral.transpose() * LATERAL_COST
        + direction * direction.transpose() * (DIRECTION_COST * (speed * 0.15).clamp(0.25, 4.0));
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
    use crate::geometry::{Point, Pose, direction};
    use crate::vehicle::{EgoParams, EgoVehicle};

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
            let goal = profile(path, s, state.speed, 0.18, &AutopilotParams::default());
            let mut control = pedals.press(goal.acceleration.clamp(-5.0, 2.0), state.speed, tick_s, &model);
            control.steer = wheel_angle(path, s, &state, &model, state.speed) / model.max_steer;
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
            let steer = wheel_angle(&path, s, &state, &model, state.speed) / model.max_steer;
            ego.tick(crate::vehicle::Control { throttle: 0.1, steer, brake: 0.0 }, 0.167, &[]);
        }
        assert!(most < 0.15, "overshot by {most}");
    }
}
