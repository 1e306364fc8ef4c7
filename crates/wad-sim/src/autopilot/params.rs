//! The autopilot's parameters, and its model of the vehicle that it drives.

use serde::{Deserialize, Serialize};
use wad_vehicle::{EgoParams, GRAVITY};

/// The driven vehicle as the autopilot sees it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct EgoModel {
    /// Bumper to bumper (m). Default 4.7.
    pub length: f64,
    /// Without mirrors (m). Default 1.85.
    pub width: f64,
    /// m. Default 2.7.
    pub wheelbase: f64,
    /// Rear axle to the footprint's centre (m). Default 1.35.
    pub rear_axle_to_centre: f64,
    /// Front wheels' angle at `steer = 1` (rad). Default 0.6.
    pub max_steer: f64,
    /// How fast the front wheels turn (rad/s). Default 0.8.
    pub steer_rate: f64,
    /// Brake force over mass at `brake = 1`, before grip caps it (m/s2). Default 11.
    pub max_brake: f64,
    /// Acceleration at `throttle = 1` from rest, as grip or gearbox cap it (m/s2). Default 3.7.
    pub max_drive: f64,
    /// Engine power over mass (W/kg): `throttle = 1` gives at most this over the speed. Default 60.
    pub power_per_mass: f64,
    /// Deceleration without pedals, at rest (m/s2): rolling resistance. Default 0.12.
    pub rolling: f64,
    /// Deceleration by the engine at a released throttle, fading below 3 m/s (m/s2). Default 0.23.
    pub engine_braking: f64,
    /// Cornering stiffness of the front axle as a share of its wheel load (1/rad). Default 10.
    pub cornering_front: f64,
    /// The same of the rear axle (1/rad). Default 12.
    pub cornering_rear: f64,
    /// Air drag over mass (1/m): deceleration per speed squared. Default 0.00027.
    pub drag: f64,
}

impl Default for EgoModel {
    fn default() -> Self {
        Self {
            length: 4.7,
            width: 1.85,
            wheelbase: 2.7,
            rear_axle_to_centre: 1.35,
            max_steer: 0.6,
            steer_rate: 0.8,
            max_brake: 11.0,
            max_drive: 3.7,
            power_per_mass: 60.0,
            rolling: 0.12,
            engine_braking: 0.23,
            cornering_front: 10.0,
            cornering_rear: 12.0,
            drag: 0.00027,
        }
    }
}

impl From<&EgoParams> for EgoModel {
    fn from(p: &EgoParams) -> Self {
        Self {
            length: p.length,
            width: p.width,
            wheelbase: p.wheelbase,
            rear_axle_to_centre: 0.5 * p.wheelbase,
            max_steer: p.max_steer_angle,
            steer_rate: p.steer_rate,
            max_brake: p.max_brake_force / p.mass,
            max_drive: p.max_drive_force / p.mass,
            power_per_mass: p.drive_power / p.mass,
            rolling: p.rolling_resistance * GRAVITY,
            engine_braking: p.engine_braking / p.mass,
            cornering_front: p.cornering_stiffness_front,
            cornering_rear: p.cornering_stiffness_rear,
            drag: p.air_drag / p.mass,
        }
    }
}

impl EgoModel {
    /// Resistance of air and tyres over mass at `speed` m/s (m/s2, >= 0).
    pub fn resistance(&self, speed: f64) -> f64 {
        if speed.abs() < 0.05 { 0.0 } else { self.rolling + self.drag * speed * speed }
    }
    /// Engine drag at a released throttle over mass at `speed` m/s (m/s2, >= 0).
    pub fn engine_drag(&self, speed: f64) -> f64 {
        self.engine_braking * (speed.abs() / 3.0).min(1.0)
    }
    /// Largest drive acceleration at `speed` m/s, before resistance (m/s2).
    pub fn drive(&self, speed: f64) -> f64 {
        self.max_drive.min(self.power_per_mass / speed.max(1.0))
    }
}

/// How the autopilot drives. Every distance is between footprints unless it says otherwise.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct AutopilotParams {
    /// Share of the speed limit that it drives at. Default 1.
    pub speed_factor: f64,
    /// Largest acceleration asked for (m/s2). Default 2.
    pub max_acceleration: f64,
    /// Deceleration that it plans with (m/s2). Default 2.2.
    pub comfortable_deceleration: f64,
    /// Hardest braking (m/s2). Default 8.
    pub emergency_deceleration: f64,
    /// Lateral acceleration in curves (m/s2). Default 2.3.
    pub lateral_acceleration: f64,
    /// Largest speed over the gap in front at which following starts to be a matter of time (s). Default 1.3.
    pub time_headway: f64,
    /// Gap to a standing leader (m). Default 2.
    pub min_gap: f64,
    /// Sideways room kept to others (m). Default 0.35.
    pub side_margin: f64,
    /// Where the front bumper stops before a stop line (m). Default 1.5.
    pub stop_margin: f64,
    /// Deceleration up to which a yellow light is obeyed (m/s2). Default 3.
    pub yellow_deceleration: f64,
    /// Shortest yellow to be expected (s). Default 3.
    pub yellow_time: f64,
    /// Distance at which a light whose state is out of sight counts as red (m). Default 60.
    pub unknown_light_distance: f64,
    /// Time that the ego must have left a crossing path before another with right of way comes (s). Default 2.
    pub crossing_gap: f64,
    /// Time between the ego and a vehicle with right of way behind it after a merge (s). Default 2.2.
    pub merge_gap: f64,
    /// Time after another has cleared the path at which the ego may be there (s). Default 0.5.
    pub clear_gap: f64,
    /// Waiting after which gaps begin to shrink (s). Default 5.
    pub patience: f64,
    /// Waiting after which the smallest gaps are taken, and a deadlock of standing vehicles is broken (s). Default 12.
    pub patience_end: f64,
    /// What is left of the gaps then. Default 0.5.
    pub impatient_share: f64,
    /// Waiting after which a lane change is forced with care (s). Default 20.
    pub lane_change_patience: f64,
    /// How far ahead a pedestrian's walk is foreseen (s). Default 3; twice that on a crossing.
    pub pedestrian_horizon: f64,
    /// Gap to a pedestrian's path where there is no crossing (m). Default 2.
    pub pedestrian_gap: f64,
    /// Sideways room to a moving pedestrian (m). Default 0.6.
    pub pedestrian_margin: f64,
    /// How far ahead other road users count (m). Default 100.
    pub sight: f64,
}

impl Default for AutopilotParams {
    fn default() -> Self {
        Self {
            speed_factor: 1.0,
            max_acceleration: 2.0,
            comfortable_deceleration: 2.2,
            emergency_deceleration: 8.0,
            lateral_acceleration: 2.3,
            time_headway: 1.3,
            min_gap: 2.0,
            side_margin: 0.35,
            stop_margin: 1.5,
            yellow_deceleration: 3.0,
            yellow_time: 3.0,
            unknown_light_distance: 60.0,
            crossing_gap: 2.0,
            merge_gap: 2.2,
            clear_gap: 0.5,
            patience: 5.0,
            patience_end: 12.0,
            impatient_share: 0.5,
            lane_change_patience: 20.0,
            pedestrian_horizon: 3.0,
            pedestrian_gap: 2.0,
            pedestrian_margin: 0.6,
            sight: 100.0,
        }
    }
}
