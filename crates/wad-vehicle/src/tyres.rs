//! The force between one tyre and the ground.
//!
//! rapier's vehicle controller counts longitudinal slip half in its grip limit and ignores
//! the brake under engine force, so it only carries the springs here, and this is the tyre:
//! linear in the slip angle, solved implicitly (no jitter at rest, whatever the sub-step),
//! and cut to the friction circle.

/// One tyre at its contact in one sub-step; all in the ground's plane at that point.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tyre {
    /// Wheel load (N).
    pub(super) load: f64,
    /// Velocity of the contact point along the wheel's rolling direction and to its left (m/s).
    pub(super) rolling: f64,
    pub(super) sliding: f64,
    /// Engine force at this wheel (N).
    pub(super) drive_force: f64,
    /// Largest force of brake and resistance at this wheel, against the motion (N).
    pub(super) resistance: f64,
    /// Cornering stiffness (N/rad).
    pub(super) cornering_stiffness: f64,
    /// The body's mass as felt at this wheel along and across its rolling direction (kg).
    pub(super) mass_along: f64,
    pub(super) mass_across: f64,
    /// Grip: largest force as a share of the load.
    pub(super) grip: f64,
    /// Largest sideways force as a share of that.
    pub(super) cornering_grip: f64,
}

impl Tyre {
    /// Force on the vehicle along the rolling direction and to its left (N).
    pub(super) fn force(&self, dt: f64) -> [f64; 2] {
        let limit = self.grip * self.load;
        if limit <= 0.0 {
            return [0.0, 0.0];
        }
        let drive = self.drive_force.clamp(-limit, limit);
        // Resistance never turns the motion round: it takes at most what is left after the drive.
        let to_rest = -(self.rolling + drive * dt / self.mass_along) * self.mass_along / dt;
        let along = drive + to_rest.clamp(-self.resistance, self.resistance);
        let along = along.clamp(-limit, limit);
        // F = -C vy / |vx| with vy at the sub-step's end: at rest it takes the whole sliding.
        let across = -self.cornering_stiffness * self.sliding
            / (self.rolling.abs() + self.cornering_stiffness * dt / self.mass_across);
        let most_across = limit * self.cornering_grip;
        let across = across.clamp(-most_across, most_across);
        let size = along.hypot(across);
        let scale = if size > limit { limit / size } else { 1.0 };
        [along * scale, across * scale]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TYRE: Tyre = Tyre {
        load: 3700.0,
        rolling: 0.0,
        sliding: 0.0,
        drive_force: 0.0,
        resistance: 0.0,
        cornering_stiffness: 40_000.0,
        mass_along: 330.0,
        mass_across: 220.0,
        grip: 0.95,
        cornering_grip: 1.0,
    };

    #[test]
    fn the_friction_circle_holds_for_braking_and_cornering_together() {
        let tyre = Tyre { rolling: 10.0, sliding: 3.0, resistance: 9000.0, ..TYRE };
        let [along, across] = tyre.force(1.0 / 60.0);
        assert!(along < 0.0 && across < 0.0);
        assert!((along.hypot(across) - 0.95 * 3700.0).abs() < 1e-6);
    }

    #[test]
    fn a_brake_never_turns_the_motion_round() {
        for rolling in [-0.5, -1e-6, 0.0, 1e-6, 0.5] {
            let tyre = Tyre { rolling, resistance: 1e9, ..TYRE };
            let after = rolling + tyre.force(1.0 / 60.0)[0] / 60.0 / TYRE.mass_along;
            assert!(after * rolling >= -1e-12, "{rolling} became {after}");
        }
    }

    #[test]
    fn a_wheel_in_the_air_has_no_force() {
        let tyre = Tyre { load: 0.0, rolling: 10.0, sliding: 3.0, drive_force: 1000.0, ..TYRE };
        assert_eq!(tyre.force(1.0 / 60.0), [0.0, 0.0]);
    }

    #[test]
    fn sliding_is_never_overcorrected() {
        for rolling in [0.0, 0.1, 1.0, 10.0] {
            let tyre = Tyre { rolling, sliding: 0.2, ..TYRE };
            let after = 0.2 + tyre.force(1.0 / 60.0)[1] / 60.0 / TYRE.mass_across;
            assert!((0.0..0.2).contains(&after), "at {rolling} m/s {after}");
        }
    }
}
