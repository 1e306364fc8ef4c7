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
use crate::vehicle::EgoState;
use nalgebra::{Matrix3, Vector3};

/// Steps of the preview.
const STEPS: usize = 14;
/// Their length (s).
const DT: f64 = 0.15;
/// m/s2.
const GRAVITY: f64 = 9.81;
/// Below this speed (m/s) the plan is made as if at this speed: at rest nothing can be steered.
const SLOWEST: f64 = 1.5;

/// What errors and wheel movements cost.
const LATERAL_COST: f64 = 1.0;
const DIRECTION_COST: f64 = 4.0;

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
