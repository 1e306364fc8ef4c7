//! The ego vehicle: a rapier raycast vehicle, its actuators and its contacts.
//!
//! [`EgoVehicle::tick`] takes a [`Control`] and the road users near by, and gives the [`Contact`]s;
//! [`EgoVehicle::state`] is the resulting motion. Each ego has a physics world of its own.
//! Contacts follow these rules:
//!
//! - A background vehicle is a moving body of infinite mass: hitting a standing one at v costs the
//!   ego its whole momentum, m v; one that hits the ego pushes it along, never faster than itself.
//! - A pedestrian is not an obstacle: both get the plastic impulse between the ego and 75 kg, once per
//!   contact.
//! - A moving body that presses the ego against something else passes through it until they are apart.
//! - Standing bodies never add energy, and no collision lifts, tips or spins the ego beyond bounds.
//! - Wheels climb kerbs, which costs speed and jolts; a kerb is not a contact.

mod actuators;
mod chassis;
mod contacts;
mod ego;
mod outline;
mod params;
mod roadside;
pub mod statics;
mod surroundings;
mod tyres;

#[cfg(test)]
mod collision_tests;
#[cfg(test)]
mod driving_tests;

pub use ego::EgoVehicle;
pub use params::{EgoParams, GRAVITY, ParamsError};
pub use roadside::from_network as statics_from_network;
pub use statics::{StaticBody, StaticKind};

use serde::{Deserialize, Serialize};
use sumo_network::geometry::{Pose, Vector};

/// One tick's control, as CARLA has it. Brake wins over throttle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Control {
    /// 0..1.
    pub throttle: f64,
    /// -1..1, left positive; a fraction of the largest steering angle.
    pub steer: f64,
    /// 0..1.
    pub brake: f64,
    /// Reverse gear: the throttle drives backwards. It is engaged once the ego (nearly) stands. Only people at the wheel use
    /// it; agents and the autopilot never do.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub reverse: bool,
}

/// The ego's motion after a tick.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct EgoState {
    /// Centre of the footprint on the ground, world frame.
    pub pose: Pose,
    /// Roll and pitch of the body (rad): leaning right and nose down are positive.
    pub roll: f64,
    /// Nose down is positive (rad).
    pub pitch: f64,
    /// Velocity (m/s), world frame.
    pub velocity: Vector,
    /// Longitudinal speed (m/s), chassis frame, negative in reverse.
    pub speed: f64,
    /// Lateral speed (m/s), chassis frame, left positive.
    pub lateral_speed: f64,
    /// rad/s, counter-clockwise.
    pub yaw_rate: f64,
    /// Longitudinal acceleration over the last tick (m/s2).
    pub acceleration: f64,
    /// Front wheels' angle (rad, left positive).
    pub steer_angle: f64,
}

/// The other side of a contact.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PartnerKind {
    /// A moving vehicle of any kind.
    Vehicle,
    /// A person on foot.
    Pedestrian,
    /// A fixed body: building, pole, kerb.
    Static,
}

/// Another road user. During the tick it keeps its acceleration and its yaw rate; if it brakes to a stop,
/// it stays there.
#[derive(Clone, Copy, Debug)]
pub struct MovingBody {
    /// The caller's own number for it, stable over ticks.
    pub key: u64,
    /// Vehicle or pedestrian.
    pub kind: PartnerKind,
    /// Centre of the footprint at the tick's begin.
    pub pose: Pose,
    /// Speed along the heading at the tick's begin (m/s).
    pub speed: f64,
    /// Acceleration along the heading at the tick's begin (m/s2).
    pub acceleration: f64,
    /// Yaw rate at the tick's begin (rad/s, left positive).
    pub turn_rate: f64,
    /// Length of the footprint (m).
    pub length: f64,
    /// Width of the footprint (m).
    pub width: f64,
    /// Height (m).
    pub height: f64,
}

impl MovingBody {
    /// Where it is `elapsed` (s) after the tick's begin.
    pub fn at(&self, elapsed: f64) -> Pose {
        let (v, a) = (self.speed, self.acceleration);
        // A braking vehicle stops; it does not go backward.
        let slows = v >= 0.0 && a < 0.0 || v < 0.0 && a > 0.0;
        let moving = if slows { elapsed.min(-v / a) } else { elapsed };
        let way = (v + 0.5 * a * moving) * moving;
        let turn = self.turn_rate * moving;
        // Along the chord of its arc.
        let half = 0.5 * turn;
        let chord = if half.abs() < 1e-6 { way } else { way * half.sin() / half };
        let along = Pose { heading: self.pose.heading + half, ..self.pose };
        Pose { heading: self.pose.heading + turn, ..along.advanced(chord) }
    }

    /// Mean speed (m/s) over the first `duration` (s).
    pub(crate) fn mean_speed(&self, duration: f64) -> f64 {
        let way = (self.at(duration).xy() - self.pose.xy()).norm() / duration.max(1e-9);
        way * self.speed.signum()
    }
}

/// A contact of the ego's body over one tick.
#[derive(Clone, Copy, Debug)]
pub struct Contact {
    /// The other side.
    pub kind: PartnerKind,
    /// [`MovingBody::key`], or the static body's own number.
    pub key: u64,
    /// Sum of the impulses over the tick (N s); 0 while a pedestrian who was hit still touches the ego.
    pub impulse: f64,
    /// Where on the ego: x forward, y left of its centre (m).
    pub point: Vector,
}

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
