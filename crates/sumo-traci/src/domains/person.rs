//! Persons: pedestrians and passengers.

use super::vehicle::{DrivingDistance, MoveToXy};
use super::{RemoveReason, Stage};
use crate::codec::{Decode, DecodeError, Reader};
use crate::types::{Color, Position2D, Position3D, RoadPosition};
use crate::{Batch, Query, Ticket, Variable};

domain!(
    /// The person domain.
    Person, "person", 0xae
);

variables! { Person:
    /// m/s.
    SPEED: f64 = 0x40;
    /// Front of the body (m).
    POSITION: Position2D = 0x42;
    /// With height.
    POSITION_3D: Position3D = 0x39;
    /// Degrees clockwise from north.
    ANGLE: f64 = 0x43;
    /// Degrees.
    SLOPE: f64 = 0x36;
    /// Edge, crossing or walkingarea.
    ROAD_ID: String = 0x50;
    LANE_ID: String = 0x51;
    /// From the lane's begin (m).
    LANE_POSITION: f64 = 0x56;
    /// Vehicle type id.
    TYPE: String = 0x4f;
    COLOR: Color = 0x45;
    /// s standing.
    WAITING_TIME: f64 = 0x7a;
    /// Next edge, crossings and walkingareas too; empty at the end of the walk.
    NEXT_EDGE: String = 0xc1;
    STAGES_REMAINING: i32 = 0xc2;
    /// Vehicle it rides in; empty on foot.
    VEHICLE: String = 0xc3;
    /// m.
    LENGTH: f64 = 0x44;
    /// m.
    WIDTH: f64 = 0x4d;
    /// m.
    HEIGHT: f64 = 0xbc;
    /// kg.
    MASS: f64 = 0xc8;
    /// m.
    MIN_GAP: f64 = 0x4c;
    /// m/s.
    MAX_SPEED: f64 = 0x41;
    SPEED_FACTOR: f64 = 0x5e;
    IMPATIENCE: f64 = 0x26;
    /// s.
    BOARDING_DURATION: f64 = 0x2f;
    VEHICLE_CLASS: String = 0x49;
    SHAPE_CLASS: String = 0x4b;
    EMISSION_CLASS: String = 0x4a;
}

setters! { Person:
    /// m/s; -1 gives the speed back to SUMO.
    SET_SPEED: f64 = 0x40;
    SET_TYPE: String = 0x4f;
    SET_COLOR: Color = 0x45;
    SET_LENGTH: f64 = 0x44;
    SET_WIDTH: f64 = 0x4d;
    SET_HEIGHT: f64 = 0xbc;
    SET_MIN_GAP: f64 = 0x4c;
    SET_MAX_SPEED: f64 = 0x41;
    SET_SPEED_FACTOR: f64 = 0x5e;
    SET_IMPATIENCE: f64 = 0x26;
    SET_BOARDING_DURATION: f64 = 0x2f;
    /// 0 ends the current stage.
    REMOVE_STAGE: i32 = 0xc5;
}

/// A stage of the plan: 0 is the current one, 1 the next.
pub const fn stage(index: i32) -> Query<Person, Stage, i32> {
    Variable::new(0xc0, "stage").with(index)
}

/// Edges of a stage: 0 is the current one.
pub const fn edges(stage: i32) -> Query<Person, Vec<String>, i32> {
    Variable::new(0x54, "edges").with(stage)
}

/// Walking distance (m) to a place on the network.
pub const fn walking_distance(to: &RoadPosition) -> Query<Person, f64, (&RoadPosition, DrivingDistance)> {
    Variable::new(0x83, "walking_distance").with((to, DrivingDistance))
}

/// A ride that persons have requested.
#[derive(Clone, Debug, PartialEq)]
pub struct TaxiReservation {
    /// The reservation's own id.
    pub id: String,
    /// Ids of the passengers.
    pub persons: Vec<String>,
    /// Persons of one group share a vehicle.
    pub group: String,
    /// Edge where the ride begins.
    pub from_edge: String,
    /// Edge where it ends.
    pub to_edge: String,
    /// m.
    pub depart_position: f64,
    /// m.
    pub arrival_position: f64,
    /// s.
    pub depart: f64,
    /// s.
    pub reservation_time: f64,
    /// Bit set: 1 new, 2 known before, 4 assigned, 8 picked up.
    pub state: i32,
}

impl Decode for Vec<TaxiReservation> {
    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let n = reader.compound()?;
        let reservation = |_| {
            reader.compound_of(10)?;
            Ok(TaxiReservation {
                id: reader.string()?.to_owned(),
                persons: Vec::decode(reader)?,
                group: reader.string()?.to_owned(),
                from_edge: reader.string()?.to_owned(),
                to_edge: reader.string()?.to_owned(),
                depart_position: reader.double()?,
                arrival_position: reader.double()?,
                depart: reader.double()?,
                reservation_time: reader.double()?,
                state: reader.integer()?,
            })
        };
        (0..n).map(reservation).collect()
    }
}

/// Reservations: 0 all, 1 new ones, or other states' bits (ask with id "").
pub const fn taxi_reservations(states: i32) -> Query<Person, Vec<TaxiReservation>, i32> {
    Variable::new(0xc6, "taxi_reservations").with(states)
}

/// A new person. It needs a stage before the next step.
#[derive(Clone, Copy, Debug)]
pub struct Add<'a> {
    /// Edge where it begins.
    pub edge: &'a str,
    /// On the edge (m).
    pub position: f64,
    /// s of simulation time; -3 is now.
    pub depart: f64,
    /// Vehicle-type id.
    pub person_type: &'a str,
}

impl Default for Add<'_> {
    fn default() -> Self {
        Self { edge: "", position: 0.0, depart: -3.0, person_type: "DEFAULT_PEDTYPE" }
    }
}

/// A walk.
#[derive(Clone, Copy, Debug)]
pub struct WalkingStage<'a> {
    /// Edges to walk along; the first is the person's own.
    pub edges: &'a [&'a str],
    /// On the last edge (m).
    pub arrival_position: f64,
    /// s; -1 for as long as it takes.
    pub duration: f64,
    /// m/s; -1 for the type's own.
    pub speed: f64,
    /// Bus stop to walk to, or "".
    pub stop: &'a str,
}

impl Default for WalkingStage<'_> {
    fn default() -> Self {
        Self { edges: &[], arrival_position: 0.0, duration: -1.0, speed: -1.0, stop: "" }
    }
}

/// Adds a person.
pub fn add(batch: &mut Batch, id: &str, add: &Add<'_>) -> Ticket<()> {
    let argument = (add.person_type, add.edge, add.depart, add.position);
    batch.set_raw(Person, 0x80, "add", id, argument)
}

/// Appends a walk to the plan.
pub fn append_walking_stage(batch: &mut Batch, id: &str, walk: &WalkingStage<'_>) -> Ticket<()> {
    let WalkingStage { edges, arrival_position, duration, speed, stop } = *walk;
    let argument = (2, edges, arrival_position, duration, speed, stop);
    batch.set_raw(Person, 0xc4, "append_walking_stage", id, argument)
}

/// Appends waiting for `duration` (s), at bus stop `stop` or where the person is ("").
pub fn append_waiting_stage(
    batch: &mut Batch,
    id: &str,
    duration: f64,
    description: &str,
    stop: &str,
) -> Ticket<()> {
    batch.set_raw(Person, 0xc4, "append_waiting_stage", id, (1, duration, description, stop))
}

/// Appends a ride to `to_edge` on one of `lines` (line or vehicle ids, "ANY"), leaving at bus stop `stop` ("" for none).
pub fn append_driving_stage(
    batch: &mut Batch,
    id: &str,
    to_edge: &str,
    lines: &str,
    stop: &str,
) -> Ticket<()> {
    batch.set_raw(Person, 0xc4, "append_driving_stage", id, (3, to_edge, lines, stop))
}

/// Appends any stage.
pub fn append_stage(batch: &mut Batch, id: &str, stage: &Stage) -> Ticket<()> {
    batch.set_raw(Person, 0xc4, "append_stage", id, stage)
}

/// Puts another stage in the place of number `index` (0 is the current one).
pub fn replace_stage(batch: &mut Batch, id: &str, index: i32, stage: &Stage) -> Ticket<()> {
    batch.set_raw(Person, 0xcd, "replace_stage", id, (index, stage))
}

/// Finds the fastest way again.
pub fn reroute_travel_time(batch: &mut Batch, id: &str) -> Ticket<()> {
    batch.set_raw(Person, 0x90, "reroute_travel_time", id, ())
}

/// Takes a person out.
pub fn remove(batch: &mut Batch, id: &str, reason: RemoveReason) -> Ticket<()> {
    batch.set_raw(Person, 0x81, "remove", id, reason as i8)
}

/// Puts a person at `position` (m) on a lane, `lateral` (m) from its centre.
pub fn move_to(batch: &mut Batch, id: &str, lane: &str, position: f64, lateral: f64) -> Ticket<()> {
    batch.set_raw(Person, 0x5c, "move_to", id, (lane, position, lateral))
}

/// Puts a person at an exact place; the lane index has no meaning here.
pub fn move_to_xy(batch: &mut Batch, id: &str, to: &MoveToXy<'_>) -> Ticket<()> {
    let MoveToXy { edge, x, y, angle_deg, keep_route, match_threshold, .. } = *to;
    let argument = (edge, x, y, angle_deg, keep_route, match_threshold);
    batch.set_raw(Person, 0xb4, "move_to_xy", id, argument)
}
