//! The reward's constants.

use serde::{Deserialize, Serialize};

/// Constants of the reward. Rewards are per tick of 167 ms unless they say once.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RewardParams {
    /// Once, for standing too long for no reason. Default 20.
    pub timeout: f64,
    /// Once, for a collision; more by its impulse, up to `collision_hard` at `collision_impulse` (N s).
    /// Default 25 + 25 at 10,000 N s, a wall at 24 km/h.
    pub collision: f64,
    pub collision_hard: f64,
    pub collision_impulse: f64,
    /// In the lane's middle. Default 0.2.
    pub lane: f64,
    /// Half the breadth that is rewarded (m). Default 0.9.
    pub lane_threshold: f64,
    /// Cost per metre beyond, and the most of it. Default 1, 10.
    pub lane_outside: f64,
    pub lane_most: f64,
    /// Once, for leaving lane or road for good. Default 25.
    pub lane_exit: f64,
    /// At the wanted speed. Default 0.7.
    pub speed: f64,
    /// Cost of standing for no reason. Default 0.4.
    pub idle: f64,
    /// Cost per m/s above the wanted speed, and the most of it. Default 0.35, 1.5.
    pub excess: f64,
    pub excess_most: f64,
    /// For standing where one must. Default 0.45.
    pub stopped: f64,
    /// Below this the ego stands, and another does (m/s). Default 0.3, 0.8.
    pub standing: f64,
    pub standing_other: f64,
    /// Standing within this of a stop line or a standing vehicle is right (m). Default 8.
    pub stop_zone: f64,
    /// Where to stop before a vehicle and before a line (m). Default 3, 1.
    pub gap: f64,
    pub line_gap: f64,
    /// Time kept to a moving vehicle (s). Default 1.
    pub headway: f64,
    /// Braking that the wanted speed expects (m/s2). Default 2.
    pub braking: f64,
    /// Wanted speeds below count as this one (m/s). Default 1.
    pub least_wanted: f64,
    /// Yellow binds where this is enough to stop (m/s2). Default 3, as in spec.md.
    pub yellow_braking: f64,
    /// Comfort in bends: across, and when slowing down for them (m/s2). Default 2.2, 1.5.
    pub lateral: f64,
    pub curve_braking: f64,
    /// Cost of steering beside what the bend needs, and of its change, per full lock. Default 0.2, 0.5.
    pub steer: f64,
    pub steer_change: f64,
    /// Cost per m/s2 of acceleration beyond `comfortable` (m/s2). Default 0.05, 2.5.
    pub jolt: f64,
    pub comfortable: f64,
    /// Cost per m/s2 by which the acceleration changes in a tick, beyond `jerk_free`. Default 0.03, 0.8.
    pub jerk: f64,
    pub jerk_free: f64,
    /// The most that all discomfort costs. Default 0.5.
    pub smoothness_most: f64,
    /// Once, for running a red light, and per m/s. Default 25, 1.
    pub red: f64,
    pub red_speed: f64,
    /// While standing at red; per m/s when too fast to stop. Default 0.15, 0.03.
    pub red_stopped: f64,
    pub red_approach: f64,
    /// How far before the line one is at the intersection (m). Default 20, as in spec.md.
    pub intersection: f64,
    /// For being there. Default 0.02.
    pub steps: f64,
}

impl Default for RewardParams {
    fn default() -> Self {
        Self {
            timeout: 20.0,
            collision: 25.0,
            collision_hard: 25.0,
            collision_impulse: 10_000.0,
            lane: 0.2,
            lane_threshold: 0.9,
            lane_outside: 1.0,
            lane_most: 10.0,
            lane_exit: 25.0,
            speed: 0.7,
            idle: 0.4,
            excess: 0.35,
            excess_most: 1.5,
            stopped: 0.45,
            standing: 0.3,
            standing_other: 0.8,
            stop_zone: 8.0,
            gap: 3.0,
            line_gap: 1.0,
            headway: 1.0,
            braking: 2.0,
            least_wanted: 1.0,
            yellow_braking: 3.0,
            lateral: 2.2,
            curve_braking: 1.5,
            steer: 0.2,
            steer_change: 0.5,
            jolt: 0.05,
            comfortable: 2.5,
            jerk: 0.03,
            jerk_free: 0.8,
            smoothness_most: 0.5,
            red: 25.0,
            red_speed: 1.0,
            red_stopped: 0.15,
            red_approach: 0.03,
            intersection: 20.0,
            steps: 0.02,
        }
    }
}
