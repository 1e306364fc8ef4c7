//! One immutable picture of the traffic round the ego per tick.

use crate::geometry::Pose;
use crate::network::{LaneId, SignalIndex};
use std::sync::Arc;

/// A road user's kind, by SUMO's vehicle class and shape.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ActorKind {
    /// A passenger car.
    Car,
    /// A delivery van.
    Van,
    /// A lorry.
    Truck,
    /// A bus or coach.
    Bus,
    /// A motorcycle or moped, with its rider.
    Motorcycle,
    /// A bicycle with its rider.
    Bicycle,
    /// A person on foot.
    Pedestrian,
    /// No road user: a barrier or a cone that stands in a lane.
    Object,
}

/// What SUMO says of a vehicle type, asked once.
#[derive(Clone, Debug)]
pub struct ActorType {
    /// SUMO's vehicle-type id.
    pub id: String,
    /// By class and shape.
    pub kind: ActorKind,
    /// m.
    pub length: f64,
    /// m.
    pub width: f64,
    /// m.
    pub height: f64,
    /// Gap that it keeps when it stands behind another (m).
    pub min_gap: f64,
}

/// SUMO's vehicle signals (a bit set).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct VehicleSignals(pub u32);

impl VehicleSignals {
    /// Blinks on the right.
    pub const BLINKER_RIGHT: u32 = 1;
    /// Blinks on the left.
    pub const BLINKER_LEFT: u32 = 2;
    /// Brakes.
    pub const BRAKE_LIGHT: u32 = 8;
    /// Whether all of `bits` are on.
    pub fn has(self, bits: u32) -> bool {
        self.0 & bits == bits
    }
}

/// A background vehicle or pedestrian.
#[derive(Clone, Debug)]
pub struct Actor {
    /// SUMO's id.
    pub id: Arc<str>,
    /// Stable small number for this id over the run.
    pub key: u64,
    /// Its type.
    pub actor_type: Arc<ActorType>,
    /// Centre of the footprint.
    pub pose: Pose,
    /// m/s along the heading: the way since the last tick over its length.
    pub speed: f64,
    /// Blinkers and brake lights.
    pub signals: VehicleSignals,
    /// Lane (crossing or walkingarea for pedestrians there), where SUMO maps it to one.
    pub lane: Option<LaneId>,
    /// SUMO lane_position of a vehicle's front bumper (m); 0 for pedestrians.
    pub lane_position: f64,
}

/// State of one signal head.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SignalState {
    /// Stop.
    Red,
    /// Green follows.
    RedYellow,
    /// Red follows.
    Yellow,
    /// Green without right of way (`g`).
    GreenMinor,
    /// Green with right of way (`G`).
    GreenMajor,
    /// Right turn on red after a stop (`s`).
    StopThenGo,
    /// Blinking or off: the junction's rules hold.
    Off,
}

impl SignalState {
    /// From a character of SUMO's state string.
    pub fn from_sumo(c: u8) -> Self {
        match c {
            b'r' => Self::Red,
            b'u' => Self::RedYellow,
            b'y' | b'Y' => Self::Yellow,
            b'g' => Self::GreenMinor,
            b'G' => Self::GreenMajor,
            b's' => Self::StopThenGo,
            _ => Self::Off,
        }
    }

    /// Red, or red with yellow: passing is forbidden.
    pub fn is_red(self) -> bool {
        matches!(self, Self::Red | Self::RedYellow)
    }

    /// Whether it requires to stop: red, red with yellow, or yellow.
    pub fn stops(self) -> bool {
        self.is_red() || self == Self::Yellow
    }
}

/// Everything within sight of the ego after a tick.
#[derive(Clone, Debug, Default)]
pub struct WorldState {
    /// Ticks since the run began.
    pub tick: u64,
    /// SUMO's simulation time (s).
    pub time: f64,
    /// Vehicles near the ego without the ego, ordered by id.
    pub vehicles: Vec<Actor>,
    /// Pedestrians near the ego, ordered by id.
    pub pedestrians: Vec<Actor>,
    /// State strings by [`crate::network::TrafficLightId`]; None where out of sight.
    pub traffic_lights: Vec<Option<Arc<str>>>,
}

impl WorldState {
    /// The state of a signal head, None where its traffic light is out of sight.
    pub fn signal(&self, signal: SignalIndex) -> Option<SignalState> {
        let state = self.traffic_lights.get(signal.traffic_light.index())?.as_ref()?;
        state.as_bytes().get(signal.index).map(|&c| SignalState::from_sumo(c))
    }
}
