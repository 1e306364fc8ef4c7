//! Noise that explores a road at six decisions a second.
//!
//! White noise does not: each tick's push is undone by the next, the brake's noise alone keeps the car
//! standing, and steering shakes without ever leaving the lane's middle. All noise here is a first-order
//! autoregressive process, n' = rho n + sqrt(1 - rho^2) w with w standard normal: it stays standard
//! normal, and it keeps going one way for about 1 / (1 - rho) ticks.

use super::action::{ACTION_SIZE, Action, HIGH, LOW};
use rand::{Rng, RngExt};
use serde::{Deserialize, Serialize};
use sumo_network::seeds::normal;
use wad_see::observation::{LEAD_NEARNESS, LIGHT_NEARNESS, RawState, nearness};

/// Noise on the actions during training.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExplorationParams {
    /// Standard deviation of the noise on steering, throttle and brake (action units).
    pub exploration_noise: [f64; ACTION_SIZE],
    /// rho of the noise: 0 white, towards 1 slower. 0.8 lasts about five ticks, 0.8 s.
    pub correlation: f64,
    /// Each episode draws its own share of the noise, uniformly from 0 to 1; this share of the episodes
    /// is driven without noise.
    pub quiet_episodes: f64,
    /// Chance per tick that the demonstrating autopilot's throttle slips for about a second close to a stop
    /// line or a vehicle (less often while it stands there). Without slips, demonstrations never show how
    /// to stop there in time.
    #[serde(default)]
    pub lapses: f64,
    /// Actions before learning starts: means of steering, throttle and brake.
    /// The brake is off most of the time, and now and then on for a second.
    pub start_mean: [f64; ACTION_SIZE],
    /// Standard deviations of the actions before learning starts.
    pub start_deviation: [f64; ACTION_SIZE],
}

impl Default for ExplorationParams {
    fn default() -> Self {
        Self {
            exploration_noise: [0.08, 0.15, 0.10],
            correlation: 0.8,
            quiet_episodes: 0.2,
            lapses: 0.2,
            start_mean: [0.0, 0.45, -0.35],
            start_deviation: [0.08, 0.25, 0.4],
        }
    }
}

/// From this distance on lapses happen (m).
const NEAR: f64 = 6.0;
/// Behind a vehicle lapses happen from this distance on (m), and this much less often: a follower is always
/// near.
const NEAR_VEHICLE: f64 = 15.0;
const FOLLOWING: f64 = 0.3;

/// One episode's noise.
#[derive(Clone, Debug)]
pub struct Exploration {
    params: ExplorationParams,
    /// Share of the noise in this episode, 0 to 1.
    share: f64,
    /// Standard normal, correlated over time.
    state: [f64; ACTION_SIZE],
    /// Remaining ticks of a lapse, and its throttle.
    lapse: (u32, f32),
}

impl Exploration {
    /// Draws the noise of an episode.
    pub fn new(params: ExplorationParams, rng: &mut impl Rng) -> Self {
        let share = if rng.random::<f64>() < params.quiet_episodes { 0.0 } else { rng.random::<f64>() };
        Self { params, share, state: std::array::from_fn(|_| normal(rng)), lapse: (0, 0.0) }
    }

    /// Advances the noise by a tick; returns standard normal numbers, for actors that sample with them.
    pub fn advance(&mut self, rng: &mut impl Rng) -> [f32; ACTION_SIZE] {
        let rho = self.params.correlation;
        for n in &mut self.state {
            *n = rho * *n + (1.0 - rho * rho).sqrt() * normal(rng);
        }
        self.state.map(|n| n as f32)
    }

    /// The actor's `action` with this tick's noise, within its range.
    pub fn disturb(&self, action: Action) -> Action {
        std::array::from_fn(|i| {
            let noise = self.share * self.params.exploration_noise[i] * self.state[i];
            (action[i] + noise as f32).clamp(LOW[i], HIGH[i])
        })
    }

    /// A demonstrator's `action` with this tick's noise, and with lapses where `raw` (of the observation)
    /// says that it has to stop.
    pub fn slip(&mut self, action: Action, raw: &[f32], rng: &mut impl Rng) -> Action {
        let [steer, throttle, brake] = self.disturb(action);
        if self.lapse.0 > 0 {
            self.lapse.0 -= 1;
            return [steer, self.lapse.1, 0.0];
        }
        let near = |index: usize, distance: f64| {
            raw.get(index).is_some_and(|near| f64::from(*near) > nearness(distance))
        };
        // Most of the time before a line is spent standing.
        let often = if RawState::speed_of(raw) < 0.3 { 0.15 } else { 1.0 };
        let place = if near(LEAD_NEARNESS, NEAR) || near(LIGHT_NEARNESS, NEAR) {
            1.0
        } else if near(LEAD_NEARNESS, NEAR_VEHICLE) {
            FOLLOWING
        } else {
            0.0
        };
        if rng.random::<f64>() < self.params.lapses * often * place {
            self.lapse = (rng.random_range(2..7), rng.random_range(0.2..0.9));
        }
        [steer, throttle, brake]
    }

    /// An action before learning starts: gently forward.
    pub fn start_action(&self) -> Action {
        std::array::from_fn(|i| {
            let value = self.params.start_mean[i] + self.params.start_deviation[i] * self.state[i];
            (value as f32).clamp(LOW[i], HIGH[i])
        })
    }
}

/// Fills `out` with standard normal numbers, two at a time.
pub fn normals(rng: &mut impl Rng, out: &mut [f32]) {
    for pair in out.chunks_mut(2) {
        let radius = (-2.0 * (1.0 - rng.random::<f32>()).ln()).sqrt();
        let (sin, cos) = (std::f32::consts::TAU * rng.random::<f32>()).sin_cos();
        pair[0] = radius * cos;
        if let Some(second) = pair.get_mut(1) {
            *second = radius * sin;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::action::to_control;
    use super::*;
    use sumo_network::seeds;

    #[test]
    fn noise_is_standard_normal_and_lasts() {
        let mut rng = seeds::rng(1, "exploration");
        let mut noise = Exploration::new(ExplorationParams::default(), &mut rng);
        let series: Vec<f64> = (0..50_000).map(|_| f64::from(noise.advance(&mut rng)[0])).collect();
        let mean = series.iter().sum::<f64>() / series.len() as f64;
        let variance = series.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / series.len() as f64;
        let lag = series.windows(2).map(|w| w[0] * w[1]).sum::<f64>() / series.len() as f64;
        assert!(mean.abs() < 0.05 && (variance - 1.0).abs() < 0.05, "{mean} {variance}");
        assert!((lag / variance - 0.8).abs() < 0.02, "correlation {lag}");
    }

    #[test]
    fn the_foot_slips_only_close_to_what_must_be_stopped_for() {
        let mut rng = seeds::rng(4, "exploration");
        let params = ExplorationParams { quiet_episodes: 1.0, ..ExplorationParams::default() };
        let mut noise = Exploration::new(params, &mut rng);
        let standing = [0.0, 0.0, 0.5];
        let mut slips =
            |raw: &[f32]| (0..5_000).filter(|_| noise.slip(standing, raw, &mut rng)[2] == 0.0).count();
        let mut raw = [0.0; wad_see::observation::RAW_SIZE];
        assert_eq!(slips(&raw), 0);
        raw[LIGHT_NEARNESS] = 0.97;
        let found = slips(&raw);
        assert!((300..1500).contains(&found), "{found} of 5000 ticks");
    }

    #[test]
    fn the_start_moves_the_car() {
        let mut rng = seeds::rng(2, "exploration");
        let (mut driving, mut braking) = (0, 0);
        for _ in 0..50 {
            let mut noise = Exploration::new(ExplorationParams::default(), &mut rng);
            for _ in 0..100 {
                noise.advance(&mut rng);
                let control = to_control(noise.start_action());
                driving += usize::from(control.brake == 0.0 && control.throttle > 0.2);
                braking += usize::from(control.brake > 0.0);
            }
        }
        assert!(driving > 3_000, "{driving} of 5000 ticks press the throttle with the brake off");
        assert!((200..1_200).contains(&braking), "{braking} of 5000 ticks brake");
    }

    #[test]
    fn many_normals_have_the_normals_moments() {
        let mut out = vec![0.0; 100_001];
        normals(&mut seeds::rng(3, "normals"), &mut out);
        let n = out.len() as f32;
        let mean = out.iter().sum::<f32>() / n;
        let fourth = out.iter().map(|x| x.powi(4)).sum::<f32>() / n;
        assert!(mean.abs() < 0.02 && (fourth - 3.0).abs() < 0.15, "{mean} {fourth}");
        assert!(out.iter().all(|x| x.is_finite()));
    }
}
