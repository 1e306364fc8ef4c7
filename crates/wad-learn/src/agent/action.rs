//! Actions: three numbers, and the [`Control`] that they stand for.

use wad_vehicle::Control;

/// Numbers in an action: steering, acceleration, braking (paper, figure 6).
pub const ACTION_SIZE: usize = 3;

/// Steering -1 to 1 (left positive), throttle 0 to 1, brake 0 to 1: the networks' output, the critics'
/// input and the replay buffer's contents.
pub type Action = [f32; ACTION_SIZE];

/// Smallest and largest value of each number of an action.
pub const LOW: Action = [-1.0, 0.0, 0.0];
/// Largest value of each number of an action.
pub const HIGH: Action = [1.0, 1.0, 1.0];

/// Free travel of the brake pedal.
///
/// A sigmoid never gives 0, and the ego's brake cuts the throttle at the slightest pressure: an agent
/// without free travel could never drive off. Below this value the brake is off.
pub const BRAKE_FREE_TRAVEL: f32 = 0.1;

/// The control of `action`; numbers out of range are clamped, and NaN counts as 0.
pub fn to_control(action: Action) -> Control {
    let within = |i: usize| {
        let value = if action[i].is_nan() { 0.0 } else { action[i] };
        f64::from(value.clamp(LOW[i], HIGH[i]))
    };
    let free = f64::from(BRAKE_FREE_TRAVEL);
    Control {
        steer: within(0),
        throttle: within(1),
        brake: ((within(2) - free) / (1.0 - free)).max(0.0),
        reverse: false,
    }
}

/// The action of `control`: the inverse of [`to_control`], for demonstrations.
pub fn from_control(control: Control) -> Action {
    let brake = control.brake.clamp(0.0, 1.0) as f32;
    let brake = if brake > 0.0 { BRAKE_FREE_TRAVEL + (1.0 - BRAKE_FREE_TRAVEL) * brake } else { 0.0 };
    [control.steer.clamp(-1.0, 1.0) as f32, control.throttle.clamp(0.0, 1.0) as f32, brake]
}

/// The part of an expert's `action` at `speed` (m/s) that is imitated: at rest the wheels may point anywhere,
/// so steering counts fully from walking pace on, and less below it.
pub fn shown(action: Action, speed: f64) -> Action {
    let [steer, throttle, brake] = action;
    [steer * (0.5 * speed).clamp(0.0, 1.0) as f32, throttle, brake]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_resting_foot_does_not_brake() {
        let control = to_control([0.2, 0.6, 0.09]);
        assert_eq!(control.brake, 0.0);
        assert!((control.throttle - 0.6).abs() < 1e-6 && (control.steer - 0.2).abs() < 1e-6);
        assert_eq!(to_control([0.0, 0.0, 1.0]).brake, 1.0);
    }

    #[test]
    fn controls_come_back_from_their_actions() {
        for (steer, throttle, brake) in
            [(-1.0, 0.0, 0.0), (0.25, 1.0, 0.0), (0.0, 0.0, 0.05), (1.0, 0.0, 1.0)]
        {
            let back = to_control(from_control(Control { throttle, steer, brake, reverse: false }));
            for (found, expected) in [(back.steer, steer), (back.throttle, throttle), (back.brake, brake)] {
                assert!((found - expected).abs() < 1e-6, "{back:?}");
            }
        }
    }

    #[test]
    fn standing_wheels_show_nothing() {
        assert_eq!(shown([0.8, 0.3, 0.1], 0.0), [0.0, 0.3, 0.1]);
        assert_eq!(shown([0.8, 0.3, 0.1], -3.0), [0.0, 0.3, 0.1]);
        assert_eq!(shown([0.8, 0.3, 0.1], 1.0), [0.4, 0.3, 0.1]);
        assert_eq!(shown([0.8, 0.3, 0.1], 9.0), [0.8, 0.3, 0.1]);
    }

    #[test]
    fn nothing_out_of_range_reaches_the_ego() {
        let control = to_control([f32::NAN, 7.0, -3.0]);
        assert_eq!((control.steer, control.throttle, control.brake), (0.0, 1.0, 0.0));
    }
}
