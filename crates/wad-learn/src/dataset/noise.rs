//! Disturbances of the autopilot's controls, so that the data has off-centre and near-accident views.
//!
//! Now and then a push of about a second: the wheel turned, the throttle held, or both. Between pushes the
//! autopilot recovers, and the recovery is in the data too.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use wad_vehicle::Control;

/// The disturbances of the control.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct NoiseParams {
    /// Mean time between the end of one push and the next (s); 0: no noise.
    pub pause: f64,
    /// Shortest and longest push (s).
    pub duration: [f64; 2],
    /// Least and most steering, as lateral acceleration that it makes (m/s2).
    pub lateral: [f64; 2],
    /// Time after a push that counts as recovery (s).
    pub recovery: f64,
}

impl Default for NoiseParams {
    fn default() -> Self {
        Self { pause: 7.0, duration: [0.5, 1.5], lateral: [0.8, 3.0], recovery: 3.0 }
    }
}

#[derive(Clone, Copy, Debug)]
struct Push {
    left: f64,
    /// Lateral acceleration (m/s2, left positive); 0: no steering.
    lateral: f64,
    throttle: Option<f64>,
}

/// Disturbs one ego's control.
#[derive(Clone, Debug)]
pub struct Disturber {
    params: NoiseParams,
    rng: ChaCha8Rng,
    pause: f64,
    since: f64,
    push: Option<Push>,
}

impl Disturber {
    /// Equal `rng`, equal pushes.
    pub fn new(params: NoiseParams, mut rng: ChaCha8Rng) -> Self {
        let pause = draw_pause(&params, &mut rng);
        Self { params, rng, pause, since: f64::INFINITY, push: None }
    }

    /// Whether a push acts or the ego is still recovering from one.
    pub fn is_disturbed(&self) -> bool {
        self.push.is_some() || self.since < self.params.recovery
    }

    /// The control of the next `tick` (s) with the noise in it. `speed` in m/s; `curvature_per_steer`
    /// is the path's curvature (1/m) at full steering.
    pub fn disturb(&mut self, control: Control, speed: f64, curvature_per_steer: f64, tick: f64) -> Control {
        if self.params.pause <= 0.0 {
            return control;
        }
        let Some(push) = &mut self.push else {
            self.since += tick;
            // A standing car is not pushed: the view would not change.
            if speed > 1.5 {
                self.pause -= tick;
            }
            if self.pause <= 0.0 {
                self.push = Some(draw_push(&self.params, &mut self.rng));
            }
            return control;
        };
        // The same lateral acceleration needs less steering at speed.
        let steer = push.lateral / (speed * speed).max(9.0) / curvature_per_steer;
        let mut out = Control { steer: (control.steer + steer).clamp(-1.0, 1.0), ..control };
        if let Some(throttle) = push.throttle {
            out.throttle = throttle;
            out.brake = 0.0;
        }
        push.left -= tick;
        if push.left <= 0.0 {
            self.push = None;
            self.since = 0.0;
            self.pause = draw_pause(&self.params, &mut self.rng);
        }
        out
    }
}

fn draw_pause(params: &NoiseParams, rng: &mut ChaCha8Rng) -> f64 {
    let u: f64 = rng.random();
    // Exponential, but never zero.
    1.0 - (params.pause - 1.0).max(0.1) * (1.0 - u).max(1e-6).ln()
}

fn draw_push(params: &NoiseParams, rng: &mut ChaCha8Rng) -> Push {
    let between = |rng: &mut ChaCha8Rng, [low, high]: [f64; 2]| low + (high - low) * rng.random::<f64>();
    let kind: f64 = rng.random();
    let left = between(rng, params.duration);
    let side = if rng.random::<bool>() { 1.0 } else { -1.0 };
    let lateral = side * between(rng, params.lateral);
    let throttle = 0.4 + 0.6 * rng.random::<f64>();
    match kind {
        k if k < 0.65 => Push { left, lateral, throttle: None },
        // Towards the obstacle that the autopilot brakes for.
        k if k < 0.85 => Push { left, lateral: 0.0, throttle: Some(throttle) },
        _ => Push { left, lateral, throttle: Some(throttle) },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sumo_network::seeds;

    #[test]
    fn pushes_are_short_and_rest_is_left_alone() {
        let mut noise = Disturber::new(NoiseParams::default(), seeds::rng(3, "noise"));
        let plain = Control { throttle: 0.3, steer: 0.1, brake: 0.0, reverse: false };
        let (mut changed, mut longest, mut run) = (0, 0, 0);
        for _ in 0..6_000 {
            let out = noise.disturb(plain, 10.0, 0.2, 0.167);
            run = if out == plain { 0 } else { run + 1 };
            changed += usize::from(run > 0);
            longest = longest.max(run);
            assert!(out.steer.abs() <= 1.0 && (0.0..=1.0).contains(&out.throttle));
        }
        // 1000 s: about 125 pushes of about 6 ticks.
        assert!((300..1500).contains(&changed), "{changed}");
        assert!(longest <= 10, "{longest}");
    }

    #[test]
    fn no_pause_means_no_noise() {
        let params = NoiseParams { pause: 0.0, ..NoiseParams::default() };
        let mut noise = Disturber::new(params, seeds::rng(3, "noise"));
        let plain = Control { throttle: 0.3, steer: 0.1, brake: 0.0, reverse: false };
        assert!((0..500).all(|_| noise.disturb(plain, 10.0, 0.2, 0.167) == plain));
        assert!(!noise.is_disturbed());
    }
}
