//! From pedals and steering wheel to forces and wheel angles.

use super::{Control, EgoParams};

/// What engine, brakes and steering give at the moment. They follow the control with a lag.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Actuators {
    /// 0..1.
    throttle: f64,
    /// 0..1.
    brake: f64,
    /// Angle of the bicycle model's front wheel (rad, left positive).
    pub(super) steer_angle: f64,
    /// The gear that is engaged.
    reverse: bool,
}

/// Slowest speed forward (m/s) at which reverse gear does not engage yet.
const GEAR_CHANGE: f64 = 0.5;

/// Fastest speed backwards (m/s).
const REVERSE_TOP: f64 = 6.0;

/// What the wheels are asked for in one sub-step.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Demand {
    /// Force at the front axle, forward (N); negative in reverse gear.
    pub(super) drive_force: f64,
    /// Force of all brakes, against the motion (N).
    pub(super) brake_force: f64,
    /// Drag of engine and tyres, against the motion (N).
    pub(super) resistance: f64,
    /// Angles of the front left and front right wheel (rad, left positive).
    pub(super) wheel_angles: [f64; 2],
}

impl Actuators {
    /// Moves the actuators towards `control` for `dt` (s) at a longitudinal `speed` (m/s).
    pub(super) fn advance(&mut self, params: &EgoParams, control: &Control, speed: f64, dt: f64) -> Demand {
        let braking = control.brake > 0.0;
        if !control.reverse || speed < GEAR_CHANGE {
            self.reverse = control.reverse;
        }
        // Brake wins over throttle, at once: no engine force is left under a pressed brake, nor in the other gear.
        if braking || self.reverse != control.reverse {
            self.throttle = 0.0;
        } else {
            self.throttle = follow(self.throttle, control.throttle, params.engine_lag, dt);
        }
        self.brake = follow(self.brake, control.brake, params.brake_lag, dt);
        let target = control.steer * params.max_steer_angle;
        let step = params.steer_rate * dt;
        self.steer_angle += (target - self.steer_angle).clamp(-step, step);

        let forward = self.throttle * full_throttle_force(params, speed);
        let drive_force =
            if self.reverse { -forward * (1.0 + speed / REVERSE_TOP).clamp(0.0, 1.0) } else { forward };
        let engine_drag = params.engine_braking * (1.0 - self.throttle) * (speed.abs() / 3.0).min(1.0);
        Demand {
            drive_force,
            brake_force: self.brake * params.max_brake_force,
            resistance: engine_drag + params.rolling_resistance * params.mass * super::GRAVITY,
            wheel_angles: ackermann(params, self.steer_angle),
        }
    }
}

/// Driving force at a full throttle (N): one gear's limit, then constant power.
pub(super) fn full_throttle_force(params: &EgoParams, speed: f64) -> f64 {
    (params.drive_power / speed.abs().max(0.1)).min(params.max_drive_force)
}

/// Angles of the left and right front wheel that make both roll round one centre (rad).
pub(super) fn ackermann(params: &EgoParams, angle: f64) -> [f64; 2] {
    if angle.abs() < 1e-9 {
        return [angle; 2];
    }
    let radius = params.wheelbase / angle.tan();
    let half = 0.5 * params.track;
    [(params.wheelbase / (radius - half)).atan(), (params.wheelbase / (radius + half)).atan()]
}

/// A first-order lag, exact for any step; ends on the target instead of creeping for ever.
fn follow(value: f64, target: f64, time_constant: f64, dt: f64) -> f64 {
    if time_constant <= 0.0 {
        return target;
    }
    let next = target + (value - target) * (-dt / time_constant).exp();
    if (next - target).abs() < 1e-4 { target } else { next }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_inner_wheel_steers_more() {
        let params = EgoParams::default();
        let [left, right] = ackermann(&params, 0.3);
        assert!(left > 0.3 && right < 0.3 && right > 0.0);
        let [mirrored_left, mirrored_right] = ackermann(&params, -0.3);
        assert_eq!((left, right), (-mirrored_right, -mirrored_left));
    }

    #[test]
    fn drive_force_never_gives_more_than_the_engines_power() {
        let params = EgoParams::default();
        for speed in [0.0, 1.0, 10.0, 20.0, 50.0] {
            let force = full_throttle_force(&params, speed);
            assert!(force * speed <= params.drive_power * (1.0 + 1e-12));
            assert!(force <= params.max_drive_force);
        }
    }

    #[test]
    fn steering_is_limited_in_rate_and_ends_on_the_target() {
        let params = EgoParams::default();
        let mut actuators = Actuators::default();
        let control = Control { steer: 1.0, ..Control::default() };
        actuators.advance(&params, &control, 0.0, 0.1);
        assert!((actuators.steer_angle - 0.1 * params.steer_rate).abs() < 1e-12);
        for _ in 0..20 {
            actuators.advance(&params, &control, 0.0, 0.1);
        }
        assert_eq!(actuators.steer_angle, params.max_steer_angle);
    }
}
