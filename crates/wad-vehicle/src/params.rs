//! The ego's parameters: sizes, masses, engine, brakes, tyres.

use serde::{Deserialize, Serialize};

/// Acceleration of gravity (m/s2).
pub const GRAVITY: f64 = 9.81;

/// The ego's measures. The default is a mid-size saloon with front-wheel drive:
/// 0 to 100 km/h in about 9 s, 50 km/h to rest in about 12 m, a kerb-to-kerb turning
/// circle of about 11 m.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct EgoParams {
    /// Mass with driver (kg). Default 1500. Scales every force that a given motion needs, and the
    /// impulse of a collision.
    pub mass: f64,
    /// Footprint and height (m). Default 4.7 x 1.85 x 1.45. The body that collides.
    pub length: f64,
    /// m.
    pub width: f64,
    /// m.
    pub height: f64,
    /// Height of the body's underside above the ground (m). Default 0.2. Kerbs pass below it.
    pub ground_clearance: f64,
    /// Distance between the axles (m). Default 2.7. Longer means wider turns.
    pub wheelbase: f64,
    /// Distance between the left and right wheels' centres (m). Default 1.58.
    pub track: f64,
    /// Share of the weight on the front axle at rest. Default 0.55.
    pub front_weight_share: f64,
    /// Height of the centre of mass (m). Default 0.52. Higher means more pitch and roll.
    pub mass_height: f64,
    /// Wheel radius (m). Default 0.32.
    pub wheel_radius: f64,

    /// Largest steering angle of the bicycle model (rad). Default 0.60: the outer front wheel then
    /// runs on a circle of 11 m. The inner wheel steers more and the outer less (Ackermann).
    pub max_steer_angle: f64,
    /// Largest rate of that angle (rad/s). Default 0.8: about two turns of the steering wheel a second.
    pub steer_rate: f64,

    /// Largest driving force, as the lowest gear gives it (N). Default 5600.
    pub max_drive_force: f64,
    /// Power at the wheels (W). Default 92 kW: beyond max_drive_force's range, force = power / speed.
    pub drive_power: f64,
    /// Time constant with which the engine follows the pedal (s). Default 0.15.
    pub engine_lag: f64,
    /// Drag of the engine at a released throttle (N). Default 350; fades below 3 m/s.
    pub engine_braking: f64,
    /// Air drag (N per (m/s)2). Default 0.40: 1/2 x 1.2 kg/m3 x cd 0.30 x 2.2 m2.
    pub air_drag: f64,
    /// Rolling resistance as a share of the weight. Default 0.012.
    pub rolling_resistance: f64,
    /// Force of all brakes at a full pedal (N). Default 16500: more than the tyres carry, so that a
    /// full stop is limited by grip. An ideal anti-lock brake shares it by wheel load.
    pub max_brake_force: f64,
    /// Time constant with which the brakes follow the pedal (s). Default 0.12.
    pub brake_lag: f64,

    /// Tyre grip: the largest horizontal force as a share of the wheel load. Default 0.95 (dry asphalt).
    pub tyre_grip: f64,
    /// Share of that grip which the front tyres can use sideways. Default 0.9: too fast into a bend,
    /// the ego runs wide instead of spinning, as a car with stability control does. 1 or more lets it spin.
    pub front_cornering_grip: f64,
    /// Cornering stiffness as a share of the wheel load (1/rad), front and rear. Default 10 and 12:
    /// the front slips a little more, so the saloon understeers.
    pub cornering_stiffness_front: f64,
    /// The same of the rear tyres (1/rad).
    pub cornering_stiffness_rear: f64,

    /// Natural frequency of the body on its springs (Hz). Default 1.6. Softer sags and pitches more.
    pub suspension_frequency: f64,
    /// Damping ratio of the springs. Default 0.4.
    pub suspension_damping: f64,
    /// Unloaded length of a spring (m). Default 0.35. Kerbs must be lower than this.
    pub suspension_length: f64,

    /// Friction between the body and what it scrapes along. Default 0.3.
    pub body_friction: f64,
    /// Mass of a pedestrian (kg). Default 75. Bounds the impulse of hitting one.
    pub pedestrian_mass: f64,
}

impl Default for EgoParams {
    fn default() -> Self {
        Self {
            mass: 1500.0,
            length: 4.7,
            width: 1.85,
            height: 1.45,
            ground_clearance: 0.2,
            wheelbase: 2.7,
            track: 1.58,
            front_weight_share: 0.55,
            mass_height: 0.52,
            wheel_radius: 0.32,
            max_steer_angle: 0.60,
            steer_rate: 0.8,
            max_drive_force: 5600.0,
            drive_power: 92_000.0,
            engine_lag: 0.15,
            engine_braking: 350.0,
            air_drag: 0.40,
            rolling_resistance: 0.012,
            max_brake_force: 16_500.0,
            brake_lag: 0.12,
            tyre_grip: 0.95,
            front_cornering_grip: 0.9,
            cornering_stiffness_front: 10.0,
            cornering_stiffness_rear: 12.0,
            suspension_frequency: 1.6,
            suspension_damping: 0.4,
            suspension_length: 0.35,
            body_friction: 0.3,
            pedestrian_mass: 75.0,
        }
    }
}

/// A vehicle parameter out of range.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error(
    "the ego's {name}: expected {low} to {high}{unit}, found {found}; correct it, or leave it out for {usual}"
)]
pub struct ParamsError {
    /// Which measure.
    pub name: &'static str,
    /// What was asked for, in its own unit.
    pub found: f64,
    /// Smallest that is allowed.
    pub low: f64,
    /// Largest that is allowed.
    pub high: f64,
    unit: &'static str,
    usual: f64,
}

/// A measure: its name, how to read it, least, most, unit.
type Measure = (&'static str, fn(&EgoParams) -> f64, f64, f64, &'static str);

/// What a road vehicle from a child's kart to a heavy lorry can measure.
const MEASURES: [Measure; 29] = [
    ("mass", |p| p.mass, 50.0, 60_000.0, " kg"),
    ("length", |p| p.length, 0.5, 30.0, " m"),
    ("width", |p| p.width, 0.3, 5.0, " m"),
    ("height", |p| p.height, 0.3, 6.0, " m"),
    ("ground_clearance", |p| p.ground_clearance, 0.01, 2.0, " m"),
    ("wheelbase", |p| p.wheelbase, 0.3, 20.0, " m"),
    ("track", |p| p.track, 0.2, 5.0, " m"),
    ("front_weight_share", |p| p.front_weight_share, 0.05, 0.95, ""),
    ("mass_height", |p| p.mass_height, 0.05, 4.0, " m"),
    ("wheel_radius", |p| p.wheel_radius, 0.05, 1.5, " m"),
    ("max_steer_angle", |p| p.max_steer_angle, 0.01, 1.4, " rad"),
    ("steer_rate", |p| p.steer_rate, 0.01, 100.0, " rad/s"),
    ("max_drive_force", |p| p.max_drive_force, 0.0, 1e6, " N"),
    ("drive_power", |p| p.drive_power, 0.0, 1e7, " W"),
    ("engine_lag", |p| p.engine_lag, 0.0, 10.0, " s"),
    ("engine_braking", |p| p.engine_braking, 0.0, 1e5, " N"),
    ("air_drag", |p| p.air_drag, 0.0, 100.0, " N per (m/s)2"),
    ("rolling_resistance", |p| p.rolling_resistance, 0.0, 0.5, ""),
    ("max_brake_force", |p| p.max_brake_force, 0.0, 1e6, " N"),
    ("brake_lag", |p| p.brake_lag, 0.0, 10.0, " s"),
    ("tyre_grip", |p| p.tyre_grip, 0.01, 5.0, ""),
    ("front_cornering_grip", |p| p.front_cornering_grip, 0.05, 5.0, ""),
    ("cornering_stiffness_front", |p| p.cornering_stiffness_front, 0.1, 200.0, " 1/rad"),
    ("cornering_stiffness_rear", |p| p.cornering_stiffness_rear, 0.1, 200.0, " 1/rad"),
    ("suspension_frequency", |p| p.suspension_frequency, 0.5, 20.0, " Hz"),
    ("suspension_damping", |p| p.suspension_damping, 0.0, 5.0, ""),
    ("suspension_length", |p| p.suspension_length, 0.02, 2.0, " m"),
    ("body_friction", |p| p.body_friction, 0.0, 5.0, ""),
    ("pedestrian_mass", |p| p.pedestrian_mass, 1.0, 500.0, " kg"),
];

impl EgoParams {
    /// Whether a vehicle can be made of them.
    ///
    /// # Errors
    /// The first parameter that is not a number or out of the range of road vehicles, or that does not fit
    /// another: axles beyond the body, wheels wider apart than it, springs shorter than their sag.
    pub fn check(&self) -> Result<(), ParamsError> {
        let usual = Self::default();
        let within = |&(name, value, low, high, unit): &Measure| {
            let found = value(self);
            if (low..=high).contains(&found) {
                return Ok(());
            }
            Err(ParamsError { name, found, low, high, unit, usual: value(&usual) })
        };
        MEASURES.iter().try_for_each(within)?;
        within(&("wheelbase", |p| p.wheelbase, 0.3, self.length, " m (its length)"))?;
        within(&("track", |p| p.track, 0.2, self.width, " m (its width)"))?;
        let sag = self.suspension_sag();
        within(&(
            "suspension_length",
            |p| p.suspension_length,
            sag,
            2.0,
            " m (less than the springs give in)",
        ))
    }

    /// The hardest braking (m/s2): what the brakes or, if less, the tyres give.
    pub fn hardest_braking(&self) -> f64 {
        (self.max_brake_force / self.mass).min(self.tyre_grip * GRAVITY)
    }

    /// How far the springs give in at rest (m).
    pub fn suspension_sag(&self) -> f64 {
        GRAVITY / (std::f64::consts::TAU * self.suspension_frequency).powi(2)
    }

    /// Distance of the front axle from the centre of mass (m, forward positive).
    pub fn front_axle(&self) -> f64 {
        self.wheelbase * (1.0 - self.front_weight_share)
    }

    /// Distance of the centre of mass from the footprint's centre (m, forward positive). The axles'
    /// middle is the footprint's centre.
    pub fn mass_offset(&self) -> f64 {
        0.5 * self.wheelbase - self.front_axle()
    }

    /// Moments of inertia about the roll, pitch and yaw axes (kg m2): a box of the body's size with
    /// its mass drawn to the middle, as measured saloons have it.
    pub fn inertia(&self) -> [f64; 3] {
        let box_inertia = |a: f64, b: f64| 0.8 * self.mass * (a * a + b * b) / 12.0;
        [
            box_inertia(self.width, self.height),
            box_inertia(self.length, self.height),
            box_inertia(self.length, self.width),
        ]
    }

    /// Radius of the outer front wheel's circle at the largest steering angle (m).
    pub fn turning_radius(&self) -> f64 {
        let rear = self.wheelbase / self.max_steer_angle.tan();
        (rear + 0.5 * self.track).hypot(self.wheelbase)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn measures_that_no_vehicle_has_are_refused_by_name() {
        assert_eq!(EgoParams::default().check(), Ok(()));
        let usual = EgoParams::default;
        let cases = [
            ("mass", EgoParams { mass: 0.0, ..usual() }),
            ("mass", EgoParams { mass: f64::NAN, ..usual() }),
            ("width", EgoParams { width: -1.0, ..usual() }),
            ("drive_power", EgoParams { drive_power: f64::INFINITY, ..usual() }),
            ("front_weight_share", EgoParams { front_weight_share: 1.0, ..usual() }),
            ("wheelbase", EgoParams { wheelbase: 5.0, ..usual() }),
            ("track", EgoParams { track: 1.9, ..usual() }),
            ("suspension_length", EgoParams { suspension_length: 0.05, ..usual() }),
        ];
        for (name, params) in cases {
            let error = params.check().expect_err(name);
            assert_eq!(error.name, name);
            assert!(error.to_string().contains(name), "{error}");
        }
    }

    #[test]
    fn each_measure_is_looked_at() {
        let json = serde_json::to_value(EgoParams::default()).unwrap();
        let names: Vec<&str> = MEASURES.iter().map(|m| m.0).collect();
        assert_eq!(json.as_object().map(|o| o.len()), Some(names.len()));
        for name in names {
            let mut bad = json.clone();
            bad[name] = serde_json::json!(-1e12);
            let bad: EgoParams = serde_json::from_value(bad).unwrap();
            assert_eq!(bad.check().expect_err(name).name, name);
        }
    }
}
