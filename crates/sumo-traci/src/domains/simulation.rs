//! The simulation as a whole. Ids are "" here.

use super::{INVALID_DOUBLE, Stage};
use crate::codec::{Decode, DecodeError, Reader};
use crate::types::{GeoPosition, Position2D, Position3D, RoadPosition};
use crate::variable::Argument;
use crate::{Query, Variable};

domain!(
    /// The simulation domain.
    Simulation, "simulation", 0xab
);

variables! { Simulation:
    /// s.
    TIME: f64 = 0x66;
    /// End of the simulation by its configuration (s); -1 where it has none.
    END_TIME: f64 = 0x1d;
    /// ms.
    TIME_STEP: i32 = 0x70;
    /// Length of a step (s).
    DELTA_T: f64 = 0x7b;
    LOADED_NUMBER: i32 = 0x71;
    LOADED_IDS: Vec<String> = 0x72;
    DEPARTED_NUMBER: i32 = 0x73;
    DEPARTED_IDS: Vec<String> = 0x74;
    ARRIVED_NUMBER: i32 = 0x79;
    ARRIVED_IDS: Vec<String> = 0x7a;
    DEPARTED_PERSON_NUMBER: i32 = 0x24;
    DEPARTED_PERSON_IDS: Vec<String> = 0x25;
    ARRIVED_PERSON_NUMBER: i32 = 0x26;
    ARRIVED_PERSON_IDS: Vec<String> = 0x27;
    PARKING_STARTING_NUMBER: i32 = 0x6c;
    PARKING_STARTING_IDS: Vec<String> = 0x6d;
    PARKING_ENDING_NUMBER: i32 = 0x6e;
    PARKING_ENDING_IDS: Vec<String> = 0x6f;
    STOP_STARTING_NUMBER: i32 = 0x68;
    STOP_STARTING_IDS: Vec<String> = 0x69;
    STOP_ENDING_NUMBER: i32 = 0x6a;
    STOP_ENDING_IDS: Vec<String> = 0x6b;
    TELEPORT_STARTING_NUMBER: i32 = 0x75;
    TELEPORT_STARTING_IDS: Vec<String> = 0x76;
    TELEPORT_ENDING_NUMBER: i32 = 0x77;
    TELEPORT_ENDING_IDS: Vec<String> = 0x78;
    COLLIDING_NUMBER: i32 = 0x80;
    COLLIDING_IDS: Vec<String> = 0x81;
    COLLISIONS: Vec<Collision> = 0x23;
    EMERGENCY_STOPPING_NUMBER: i32 = 0x89;
    EMERGENCY_STOPPING_IDS: Vec<String> = 0x8a;
    /// Vehicles and persons that are in the network or still to come.
    MIN_EXPECTED_NUMBER: i32 = 0x7d;
    PENDING_VEHICLES: Vec<String> = 0x94;
    /// Lower left and upper right corner.
    NET_BOUNDARY: Vec<Position2D> = 0x7c;
    /// Factor on the traffic.
    SCALE: f64 = 0x8e;
    BUS_STOP_IDS: Vec<String> = 0x9f;
    /// At the bus stop that the id names.
    BUS_STOP_WAITING_NUMBER: i32 = 0x67;
    /// At the bus stop that the id names.
    BUS_STOP_WAITING_IDS: Vec<String> = 0xef;
    /// Value of the command-line option that the id names.
    OPTION: String = 0x32;
}

setters! { Simulation:
    /// File to save the state to.
    SAVE_STATE: String = 0x95;
    /// File to load the state from.
    LOAD_STATE: String = 0x96;
    SET_SCALE: f64 = 0x8e;
    /// Drops vehicles that wait to be inserted: the vehicles of this route, or all ("").
    CLEAR_PENDING: String = 0x94;
    /// Writes to SUMO's log.
    WRITE_MESSAGE: String = 0x65;
}

/// A collision that lasts.
#[derive(Clone, Debug, PartialEq)]
pub struct Collision {
    /// Id of the vehicle that drove into the other.
    pub collider: String,
    /// Id of the other.
    pub victim: String,
    /// The collider's vehicle type.
    pub collider_type: String,
    /// The victim's vehicle or person type.
    pub victim_type: String,
    /// m/s.
    pub collider_speed: f64,
    /// m/s.
    pub victim_speed: f64,
    /// "collision", "junction", "frontal", "sharing".
    pub kind: String,
    /// Lane where it happened.
    pub lane: String,
    /// On the lane (m).
    pub position: f64,
}

impl Decode for Vec<Collision> {
    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        reader.compound()?;
        let n = reader.typed_count()?;
        let collision = |_| {
            Ok(Collision {
                collider: reader.string()?.to_owned(),
                victim: reader.string()?.to_owned(),
                collider_type: reader.string()?.to_owned(),
                victim_type: reader.string()?.to_owned(),
                collider_speed: reader.double()?,
                victim_speed: reader.double()?,
                kind: reader.string()?.to_owned(),
                lane: reader.string()?.to_owned(),
                position: reader.double()?,
            })
        };
        (0..n).map(collision).collect()
    }
}

const CONVERSION: u8 = 0x82;

/// The point of a place on the network.
pub const fn to_2d(place: &RoadPosition) -> Query<Simulation, Position2D, (&RoadPosition, u8)> {
    Variable::new(CONVERSION, "to_2d").with((place, 0x01))
}

/// The point of a place on the network, with height.
pub const fn to_3d(place: &RoadPosition) -> Query<Simulation, Position3D, (&RoadPosition, u8)> {
    Variable::new(CONVERSION, "to_3d").with((place, 0x03))
}

/// The place on the network nearest to a point, for a vehicle class ("ignoring" for any).
pub const fn to_road(
    point: Position2D,
    vehicle_class: &str,
) -> Query<Simulation, RoadPosition, (Position2D, u8, &str)> {
    Variable::new(CONVERSION, "to_road").with((point, 0x04, vehicle_class))
}

/// Longitude and latitude of a point; the network must be geo-referenced.
pub const fn to_geo(point: Position2D) -> Query<Simulation, GeoPosition, (Position2D, u8)> {
    Variable::new(CONVERSION, "to_geo").with((point, 0x00))
}

/// The point of a longitude and latitude; the network must be geo-referenced.
pub const fn from_geo(point: GeoPosition) -> Query<Simulation, Position2D, (GeoPosition, u8)> {
    Variable::new(CONVERSION, "from_geo").with((point, 0x01))
}

/// How a distance is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum DistanceKind {
    /// In a straight line.
    Air = 0,
    /// Along the roads.
    Driving = 1,
}

/// It travels without a type tag.
impl Argument for DistanceKind {
    fn put(&self, out: &mut Vec<u8>) {
        out.push(*self as u8);
    }
}

/// Distance (m) between two points.
pub const fn distance_2d(
    from: Position2D,
    to: Position2D,
    kind: DistanceKind,
) -> Query<Simulation, f64, (Position2D, Position2D, DistanceKind)> {
    Variable::new(0x83, "distance_2d").with((from, to, kind))
}

/// Distance (m) between two places on the network.
pub const fn distance_road<'a>(
    from: &'a RoadPosition,
    to: &'a RoadPosition,
    kind: DistanceKind,
) -> Query<Simulation, f64, (&'a RoadPosition, &'a RoadPosition, DistanceKind)> {
    Variable::new(0x83, "distance_road").with((from, to, kind))
}

type RouteArguments<'a> = (&'a str, &'a str, &'a str, f64, i32, f64, f64);

/// The fastest route between two edges for a vehicle type ("" for the default one), leaving now.
pub const fn find_route<'a>(
    from: &'a str,
    to: &'a str,
    vehicle_type: &'a str,
) -> Query<Simulation, Stage, RouteArguments<'a>> {
    Variable::new(0x86, "find_route").with((from, to, vehicle_type, -1.0, 0, 0.0, INVALID_DOUBLE))
}

type IntermodalArguments<'a> =
    (&'a str, &'a str, &'a str, f64, i32, f64, f64, f64, f64, f64, &'a str, &'a str, &'a str);

/// The fastest way of a person between two edges with these modes ("" walking, "car", "public", ...), leaving now.
pub const fn find_intermodal_route<'a>(
    from: &'a str,
    to: &'a str,
    modes: &'a str,
) -> Query<Simulation, Vec<Stage>, IntermodalArguments<'a>> {
    Variable::new(0x87, "find_intermodal_route").with((
        from,
        to,
        modes,
        -1.0,
        0,
        -1.0,
        -1.0,
        0.0,
        INVALID_DOUBLE,
        0.0,
        "",
        "",
        "",
    ))
}
