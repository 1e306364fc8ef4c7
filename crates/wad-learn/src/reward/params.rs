//! The reward's constants.

use serde::{Deserialize, Serialize};

/// Constants of the reward. Rewards are per tick of 167 ms unless they say once.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RewardParams {
    /// Cost of standing too long without a reason, once. Default 20.
    pub timeout: f64,
    /// Cost of a collision, once; the impulse adds up to `collision_hard` at `collision_impulse`.
    /// Default 25.
    pub collision: f64,
    /// The most that the impulse adds to `collision`. Default 25.
    pub collision_hard: f64,
    /// The impulse with the full addition (N s). Default 10,000, a wall at 24 km/h.
    pub collision_impulse: f64,
    /// Reward in the lane's middle at the wanted speed. Default 0.2.
    pub lane: f64,
    /// Half the width of the rewarded strip (m). Default 0.9.
    pub lane_threshold: f64,
    /// Cost per metre outside that strip. Default 1.
    pub lane_outside: f64,
    /// Largest cost of being off the lane's middle. Default 10.
    pub lane_most: f64,
    /// Cost of an episode's end outside lane or road, once. Default 25.
    pub lane_exit: f64,
    /// Reward at the wanted speed. Default 1.
    pub speed: f64,
    /// Cost of standing without a reason. Default 1.
    pub idle: f64,
    /// Cost per m/s above the wanted speed. Default 0.35.
    pub excess: f64,
    /// Largest cost of excess speed. Default 1.5.
    pub excess_most: f64,
    /// Reward of necessary standing. Default 0.45.
    pub stopped: f64,
    /// Below this speed the ego counts as standing (m/s). Default 0.3.
    pub standing: f64,
    /// Below this speed another road user counts as standing (m/s). Default 0.8.
    pub standing_other: f64,
    /// Distance to a stop line or a standing vehicle within which standing is right (m). Default 8.
    pub stop_zone: f64,
    /// Gap to a vehicle at which to stop (m). Default 3.
    pub gap: f64,
    /// Distance from a stop line at which to stop (m). Default 1.
    pub line_gap: f64,
    /// Time headway to a moving vehicle (s). Default 1.
    pub headway: f64,
    /// Braking assumed by the wanted speed (m/s2). Default 2.
    pub braking: f64,
    /// Least wanted speed (m/s); lower ones count as this. Default 1.
    pub least_wanted: f64,
    /// A yellow light counts as red if this braking is enough to stop (m/s2). Default 3, as in spec.md.
    pub yellow_braking: f64,
    /// Comfortable lateral acceleration in bends (m/s2). Default 2.2.
    pub lateral: f64,
    /// Comfortable braking before bends (m/s2). Default 1.5.
    pub curve_braking: f64,
    /// Cost of steering other than the bend needs, per full lock. Default 0.05.
    pub steer: f64,
    /// Cost of the steering's change in a tick, per full lock. Default 0.1.
    pub steer_change: f64,
    /// Cost per m/s2 of acceleration beyond `comfortable`. Default 0.05.
    pub jolt: f64,
    /// Acceleration without cost (m/s2). Default 2.5.
    pub comfortable: f64,
    /// Cost per m/s2 of the acceleration's change in a tick, beyond `jerk_free`. Default 0.03.
    pub jerk: f64,
    /// Change of acceleration per tick without cost (m/s2). Default 0.8.
    pub jerk_free: f64,
    /// Largest cost of all discomfort together. Default 0.1.
    pub smoothness_most: f64,
    /// Cost of running a red light, once. Default 25.
    pub red: f64,
    /// Additional cost of running a red light per m/s, once. Default 1.
    pub red_speed: f64,
    /// Reward of standing at a red light. Default 0.15.
    pub red_stopped: f64,
    /// Cost per m/s of approaching a red light too fast to stop. Default 0.03.
    pub red_approach: f64,
    /// Distance to the stop line that counts as at the intersection (m). Default 20, as in spec.md.
    pub intersection: f64,
    /// Reward of every tick. Default 0.02.
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
            speed: 1.0,
            idle: 1.0,
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
            steer: 0.05,
            steer_change: 0.1,
            jolt: 0.05,
            comfortable: 2.5,
            jerk: 0.03,
            jerk_free: 0.8,
            smoothness_most: 0.1,
            red: 25.0,
            red_speed: 1.0,
            red_stopped: 0.15,
            red_approach: 0.03,
            intersection: 20.0,
            steps: 0.02,
        }
    }
}
