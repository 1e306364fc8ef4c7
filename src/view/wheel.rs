//! Manual controls: turns on-off keys into smooth steering and pedals.

use crate::vehicle::Control;

/// The wanted controls, from keys, gamepad or touch.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wanted {
    /// -1..1, left positive.
    pub steer: f64,
    /// 0..1.
    pub throttle: f64,
    pub brake: f64,
    /// Reverse gear.
    pub reverse: bool,
    /// From a stick or pedal that is smooth itself.
    pub analog: bool,
}

/// How fast the controls follow keys (1/s): the wheel away from the middle and back to it, the pedals
/// down and up.
const STEER: (f64, f64) = (1.6, 3.2);
const THROTTLE: (f64, f64) = (2.0, 5.0);
const BRAKE: (f64, f64) = (3.5, 8.0);
/// The same for sticks.
const ANALOG: f64 = 8.0;
/// At this speed (m/s) keys turn the wheel half as far as when standing: full lock at speed is a spin.
const HALF_LOCK: f64 = 8.0;
/// The share of full lock that keys always reach.
const LEAST_LOCK: f64 = 0.12;

/// The controls as they are.
#[derive(Clone, Copy, Debug, Default)]
pub struct Wheel {
    now: Control,
}

impl Wheel {
    /// Begins with another driver's last control.
    pub fn taken_from(control: Control) -> Self {
        Self { now: control }
    }

    /// The control for the next `dt` s at `speed` (m/s).
    pub fn follow(&mut self, wanted: &Wanted, speed: f64, dt: f64) -> Control {
        let now = &mut self.now;
        let (turn, back) = if wanted.analog { (ANALOG, ANALOG) } else { STEER };
        let lock = (1.0 / (1.0 + (speed / HALF_LOCK).max(0.0).powi(2))).max(LEAST_LOCK);
        let steer = wanted.steer.clamp(-1.0, 1.0) * lock;
        let returns = steer.abs() < now.steer.abs() || steer * now.steer < 0.0;
        now.steer = approach(now.steer, steer, if returns { back } else { turn } * dt);
        let pedal = |now: f64, wanted: f64, (down, up): (f64, f64)| {
            let wanted_now = wanted.clamp(0.0, 1.0);
            let rate = if wanted_now > now { down } else { up };
            approach(now, wanted_now, if wanted.is_finite() { rate } else { 0.0 } * dt)
        };
        let rates = |keys| if wanted.analog { (ANALOG, ANALOG) } else { keys };
        now.throttle = pedal(now.throttle, wanted.throttle, rates(THROTTLE));
        now.brake = pedal(now.brake, wanted.brake, rates(BRAKE));
        now.reverse = wanted.reverse;
        *now
    }
}

fn approach(now: f64, wanted: f64, step: f64) -> f64 {
    now + (wanted - now).clamp(-step, step)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_move_the_controls_as_hands_and_feet_do() {
        let mut wheel = Wheel::default();
        let left = Wanted { steer: 1.0, throttle: 1.0, ..Wanted::default() };
        let first = wheel.follow(&left, 0.0, 0.167);
        assert!(first.steer > 0.2 && first.steer < 0.4 && first.throttle > 0.3 && first.throttle < 0.4);
        for _ in 0..20 {
            wheel.follow(&left, 0.0, 0.167);
        }
        assert_eq!((wheel.now.steer, wheel.now.throttle), (1.0, 1.0));
        let fast = (0..20).fold(Control::default(), |_, _| wheel.follow(&left, 16.0, 0.167));
        assert!(fast.steer > 0.1 && fast.steer < 0.3, "{}", fast.steer);
        let free = (0..4).fold(Control::default(), |_, _| wheel.follow(&Wanted::default(), 16.0, 0.167));
        assert_eq!((free.steer, free.throttle, free.brake), (0.0, 0.0, 0.0));
    }

    #[test]
    fn a_stick_is_followed_at_once_and_nothing_leaves_its_range() {
        let mut wheel = Wheel::default();
        let wild = Wanted { steer: -7.0, throttle: 9.0, brake: -3.0, analog: true, reverse: true };
        let control = wheel.follow(&wild, 0.0, 0.167);
        assert_eq!((control.steer, control.throttle, control.brake), (-1.0, 1.0, 0.0));
        assert!(control.reverse);
    }
}
