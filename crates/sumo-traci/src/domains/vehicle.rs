//! Vehicles.

pub use super::vehicle_structs::*;
use super::{INVALID_DOUBLE, RemoveReason};
use crate::types::{Color, Position2D, Position3D, RoadPosition};
use crate::{Batch, Query, Ticket, Variable};

domain!(
    /// The vehicle domain.
    Vehicle, "vehicle", 0xa4
);

variables! { Vehicle:
    /// m/s.
    SPEED: f64 = 0x40;
    /// Sideways (m/s).
    SPEED_LATERAL: f64 = 0x32;
    /// Over the last step (m/s2).
    ACCELERATION: f64 = 0x72;
    /// What SUMO would drive without orders (m/s).
    SPEED_WITHOUT_TRACI: f64 = 0xb1;
    /// Front bumper's centre.
    POSITION: Position2D = 0x42;
    /// Front bumper's centre, with height.
    POSITION_3D: Position3D = 0x39;
    /// Degrees clockwise from north.
    ANGLE: f64 = 0x43;
    /// Degrees.
    SLOPE: f64 = 0x36;
    /// Edge id; internal edges begin with a colon.
    ROAD_ID: String = 0x50;
    /// Lane id.
    LANE_ID: String = 0x51;
    /// Lane on which it also drives while changing lanes.
    SHADOW_LANE_ID: String = 0x9d;
    /// 0 is the rightmost lane.
    LANE_INDEX: i32 = 0x52;
    /// Mesoscopic simulation only.
    SEGMENT_ID: String = 0xa1;
    /// Mesoscopic simulation only.
    SEGMENT_INDEX: i32 = 0xa2;
    /// Of the front bumper, from the lane's begin (m).
    LANE_POSITION: f64 = 0x56;
    /// From the lane's centre, left positive (m).
    LANE_POSITION_LATERAL: f64 = 0xb8;
    /// Vehicle type id.
    TYPE: String = 0x4f;
    ROUTE_ID: String = 0x53;
    /// Index of the current edge in the route; -1 before insertion.
    ROUTE_INDEX: i32 = 0x69;
    /// Edges of the route.
    ROUTE: Vec<String> = 0x54;
    /// False where the route does not connect or may not be driven.
    ROUTE_VALID: bool = 0x92;
    /// Edges that rerouting must pass.
    VIA: Vec<String> = 0xbe;
    /// See SUMO's routing modes.
    ROUTING_MODE: i32 = 0x89;
    COLOR: Color = 0x45;
    /// Bit set: 1 right blinker, 2 left blinker, 8 brake light, and more (see SUMO's vehicle signalling).
    SIGNALS: i32 = 0x5b;
    /// s.
    DEPARTURE: f64 = 0x3a;
    /// s.
    DEPART_DELAY: f64 = 0x3b;
    /// mg/s, as all emissions but noise.
    CO2_EMISSION: f64 = 0x60;
    CO_EMISSION: f64 = 0x61;
    HC_EMISSION: f64 = 0x62;
    PMX_EMISSION: f64 = 0x63;
    NOX_EMISSION: f64 = 0x64;
    /// mg/s.
    FUEL_CONSUMPTION: f64 = 0x65;
    /// dB.
    NOISE_EMISSION: f64 = 0x66;
    /// Wh/s.
    ELECTRICITY_CONSUMPTION: f64 = 0x71;
    PERSON_NUMBER: i32 = 0x67;
    PERSON_IDS: Vec<String> = 0x1a;
    PERSON_CAPACITY: i32 = 0x38;
    /// m/s; of the lane, times the driver's speed factor.
    ALLOWED_SPEED: f64 = 0xb7;
    /// s standing since the last movement.
    WAITING_TIME: f64 = 0x7a;
    /// s standing within SUMO's waiting-time memory.
    ACCUMULATED_WAITING_TIME: f64 = 0x87;
    /// s.
    TIME_LOSS: f64 = 0x8c;
    LANE_CHANGE_MODE: i32 = 0xb6;
    SPEED_MODE: i32 = 0xb3;
    /// Public transport line.
    LINE: String = 0xbd;
    /// s of simulation time.
    LAST_ACTION_TIME: f64 = 0x7f;
    BEST_LANES: Vec<BestLane> = 0xb2;
    NEXT_TLS: Vec<NextTrafficLight> = 0x70;
    NEXT_LINKS: Vec<NextLink> = 0x33;
    /// Bit set: 1 stopped, 2 parking, 4 triggered, 8 container-triggered, 16 at a bus stop, ...
    STOP_STATE: i32 = 0xb5;
    /// s late at the next stop.
    STOP_DELAY: f64 = 0x1f;
    /// s late at arrival at the next stop.
    STOP_ARRIVAL_DELAY: f64 = 0x22;
    /// Since departure (m).
    DISTANCE: f64 = 0x84;
    REFERENCE_DISTANCE: f64 = 0x95;
    /// m; this and the following belong to the vehicle type, and can differ by vehicle.
    LENGTH: f64 = 0x44;
    /// m.
    WIDTH: f64 = 0x4d;
    /// m.
    HEIGHT: f64 = 0xbc;
    /// kg.
    MASS: f64 = 0xc8;
    /// m.
    MIN_GAP: f64 = 0x4c;
    /// m.
    MIN_GAP_LATERAL: f64 = 0xbb;
    /// m/s.
    MAX_SPEED: f64 = 0x41;
    /// m/s.
    MAX_SPEED_LATERAL: f64 = 0xba;
    /// m/s2.
    ACCEL: f64 = 0x46;
    /// m/s2.
    DECEL: f64 = 0x47;
    /// m/s2.
    EMERGENCY_DECEL: f64 = 0x7b;
    /// m/s2.
    APPARENT_DECEL: f64 = 0x7c;
    SPEED_FACTOR: f64 = 0x5e;
    SPEED_DEVIATION: f64 = 0x5f;
    /// Driver's desired time headway (s): SUMO's tau.
    TIME_HEADWAY: f64 = 0x48;
    /// SUMO's sigma, 0..1.
    IMPERFECTION: f64 = 0x5d;
    IMPATIENCE: f64 = 0x26;
    /// s per person.
    BOARDING_DURATION: f64 = 0x2f;
    /// s.
    ACTION_STEP_LENGTH: f64 = 0x7d;
    VEHICLE_CLASS: String = 0x49;
    EMISSION_CLASS: String = 0x4a;
    SHAPE_CLASS: String = 0x4b;
    LATERAL_ALIGNMENT: String = 0xb9;
    /// All vehicles that are loaded (ask with id "").
    LOADED_LIST: Vec<String> = 0x24;
    /// Vehicles being teleported (ask with id "").
    TELEPORTING_LIST: Vec<String> = 0x25;
}

setters! { Vehicle:
    /// m/s; -1 gives the speed back to SUMO.
    SET_SPEED: f64 = 0x40;
    SET_COLOR: Color = 0x45;
    SET_SIGNALS: i32 = 0x5b;
    SET_SPEED_MODE: i32 = 0xb3;
    SET_LANE_CHANGE_MODE: i32 = 0xb6;
    SET_ROUTE_ID: String = 0x53;
    /// Edges; the first must be the vehicle's own.
    SET_ROUTE: Vec<String> = 0x57;
    /// Edge to drive to.
    SET_TARGET: String = 0x31;
    SET_TYPE: String = 0x4f;
    SET_VIA: Vec<String> = 0xbe;
    SET_ROUTING_MODE: i32 = 0x89;
    SET_LINE: String = 0xbd;
    /// m, left positive (sublane model).
    SET_LANE_POSITION_LATERAL: f64 = 0x5c;
    /// m, left positive (sublane model).
    CHANGE_SUBLANE: f64 = 0x15;
    /// Reservation ids.
    DISPATCH_TAXI: Vec<String> = 0x21;
    SET_LENGTH: f64 = 0x44;
    SET_WIDTH: f64 = 0x4d;
    SET_HEIGHT: f64 = 0xbc;
    SET_MASS: f64 = 0xc8;
    SET_MIN_GAP: f64 = 0x4c;
    SET_MIN_GAP_LATERAL: f64 = 0xbb;
    SET_MAX_SPEED: f64 = 0x41;
    SET_MAX_SPEED_LATERAL: f64 = 0xba;
    SET_ACCEL: f64 = 0x46;
    SET_DECEL: f64 = 0x47;
    SET_EMERGENCY_DECEL: f64 = 0x7b;
    SET_APPARENT_DECEL: f64 = 0x7c;
    SET_SPEED_FACTOR: f64 = 0x5e;
    SET_TIME_HEADWAY: f64 = 0x48;
    SET_IMPERFECTION: f64 = 0x5d;
    SET_IMPATIENCE: f64 = 0x26;
    SET_BOARDING_DURATION: f64 = 0x2f;
    SET_ACTION_STEP_LENGTH: f64 = 0x7d;
    SET_VEHICLE_CLASS: String = 0x49;
    SET_EMISSION_CLASS: String = 0x4a;
    SET_SHAPE_CLASS: String = 0x4b;
    SET_LATERAL_ALIGNMENT: String = 0xb9;
}

/// The leader on the route within `distance` (m; 0: the braking distance).
pub const fn leader(distance: f64) -> Query<Vehicle, Option<Leader>, f64> {
    Variable::new(0x68, "leader").with(distance)
}

/// The follower within `distance` (m).
pub const fn follower(distance: f64) -> Query<Vehicle, Option<Leader>, f64> {
    Variable::new(0x78, "follower").with(distance)
}

/// Neighbours on the lanes beside: bit 1 = right, bit 2 = leaders, bit 4 = only vehicles that block a change.
/// Not for subscriptions: SUMO leaves out the types of its items.
pub const fn neighbors(mode: u8) -> Query<Vehicle, Vec<Leader>, u8> {
    Variable::new(0xbf, "neighbors").with(mode)
}

/// Vehicles with conflicting ways at junctions within `distance` (m).
pub const fn junction_foes(distance: f64) -> Query<Vehicle, Vec<JunctionFoe>, f64> {
    Variable::new(0x37, "junction_foes").with(distance)
}

/// The next `limit` stops; 0 gives all to come, a negative number past ones.
pub const fn stops(limit: i32) -> Query<Vehicle, Vec<Stop>, i32> {
    Variable::new(0x74, "stops").with(limit)
}

/// A lane change's state towards `direction` (1 left, -1 right): without and with orders.
pub const fn lane_change_state(direction: i32) -> Query<Vehicle, LaneChangeState, i32> {
    Variable::new(0x13, "lane_change_state").with(direction)
}

/// Driving distance (m) to a place on the network.
pub const fn driving_distance(to: &RoadPosition) -> Query<Vehicle, f64, (&RoadPosition, DrivingDistance)> {
    Variable::new(0x83, "driving_distance").with((to, DrivingDistance))
}

/// Driving distance (m) to the place on the network nearest to a point.
pub const fn driving_distance_2d(to: Position2D) -> Query<Vehicle, f64, (Position2D, DrivingDistance)> {
    Variable::new(0x83, "driving_distance").with((to, DrivingDistance))
}

/// Travel time (s) that this vehicle assumes for `edge` at `time` (s).
pub const fn adapted_travel_time(time: f64, edge: &str) -> Query<Vehicle, f64, (f64, &str)> {
    Variable::new(0x58, "adapted_travel_time").with((time, edge))
}

/// Effort that this vehicle assumes for `edge` at `time` (s).
pub const fn effort(time: f64, edge: &str) -> Query<Vehicle, f64, (f64, &str)> {
    Variable::new(0x59, "effort").with((time, edge))
}

/// Speed (m/s) that keeps a safe gap: own speed, gap (m), leader's speed and largest deceleration (m/s2), leader's id.
pub const fn follow_speed(
    speed: f64,
    gap: f64,
    leader_speed: f64,
    leader_max_decel: f64,
    leader: &str,
) -> Query<Vehicle, f64, (f64, f64, f64, f64, &str)> {
    Variable::new(0x1c, "follow_speed").with((speed, gap, leader_speed, leader_max_decel, leader))
}

/// Gap (m) that is safe at these speeds (m/s) and the leader's largest deceleration (m/s2).
pub const fn secure_gap(
    speed: f64,
    leader_speed: f64,
    leader_max_decel: f64,
    leader: &str,
) -> Query<Vehicle, f64, (f64, f64, f64, &str)> {
    Variable::new(0x1e, "secure_gap").with((speed, leader_speed, leader_max_decel, leader))
}

/// Speed (m/s) that allows stopping within `gap` (m).
pub const fn stop_speed(speed: f64, gap: f64) -> Query<Vehicle, f64, (f64, f64)> {
    Variable::new(0x1d, "stop_speed").with((speed, gap))
}

/// Taxis in a state: -1 all, 0 empty, 1 picking up, 2 occupied, 3 both (ask with id "").
pub const fn taxi_fleet(state: i32) -> Query<Vehicle, Vec<String>, i32> {
    Variable::new(0x20, "taxi_fleet").with(state)
}

/// Adds a vehicle.
pub fn add(batch: &mut Batch, id: &str, add: &Add<'_>) -> Ticket<()> {
    let argument = (
        add.route,
        add.vehicle_type,
        add.depart,
        add.depart_lane,
        add.depart_pos,
        add.depart_speed,
        add.arrival_lane,
        add.arrival_pos,
        add.arrival_speed,
        add.from_taz,
        add.to_taz,
        add.line,
        add.person_capacity,
        add.person_number,
    );
    batch.set_raw(Vehicle, 0x85, "add", id, argument)
}

/// Takes a vehicle out.
pub fn remove(batch: &mut Batch, id: &str, reason: RemoveReason) -> Ticket<()> {
    batch.set_raw(Vehicle, 0x81, "remove", id, reason as i8)
}

/// Puts a vehicle at an exact place in the next step. Speed follows from the displacement.
pub fn move_to_xy(batch: &mut Batch, id: &str, to: &MoveToXy<'_>) -> Ticket<()> {
    let MoveToXy { edge, lane_index, x, y, angle_deg, keep_route, match_threshold } = *to;
    let argument = (edge, lane_index, x, y, angle_deg, keep_route, match_threshold);
    batch.set_raw(Vehicle, 0xb4, "move_to_xy", id, argument)
}

/// Puts a vehicle on a lane at `position` (m); the lane must be of its route. `reason`: 0 automatic, 1 teleport, 2 move.
pub fn move_to(batch: &mut Batch, id: &str, lane: &str, position: f64, reason: i32) -> Ticket<()> {
    batch.set_raw(Vehicle, 0x5c, "move_to", id, (lane, position, reason))
}

/// Changes the rest of the route to these edges; the first must be the vehicle's own edge.
pub fn set_route(batch: &mut Batch, id: &str, edges: &[&str]) -> Ticket<()> {
    batch.set(SET_ROUTE, id, edges)
}

/// Drives to another edge, by the fastest way.
pub fn change_target(batch: &mut Batch, id: &str, edge: &str) -> Ticket<()> {
    batch.set(SET_TARGET, id, edge)
}

/// Goes to a lane (0 is the rightmost) and stays there for `duration` (s).
pub fn change_lane(batch: &mut Batch, id: &str, lane_index: i8, duration: f64) -> Ticket<()> {
    batch.set_raw(Vehicle, 0x13, "change_lane", id, (lane_index, duration))
}

/// Goes `offset` lanes over (left positive) and stays there for `duration` (s).
pub fn change_lane_relative(batch: &mut Batch, id: &str, offset: i8, duration: f64) -> Ticket<()> {
    batch.set_raw(Vehicle, 0x13, "change_lane_relative", id, (offset, duration, 1i8))
}

/// Changes the speed evenly to `speed` (m/s) over `duration` (s).
pub fn slow_down(batch: &mut Batch, id: &str, speed: f64, duration: f64) -> Ticket<()> {
    batch.set_raw(Vehicle, 0x14, "slow_down", id, (speed, duration))
}

/// Accelerates by `acceleration` (m/s2) for `duration` (s).
pub fn set_acceleration(batch: &mut Batch, id: &str, acceleration: f64, duration: f64) -> Ticket<()> {
    batch.set_raw(Vehicle, 0x72, "acceleration", id, (acceleration, duration))
}

/// Sets the speed (m/s) and acceleration (m/s2) that SUMO takes as the last step's.
pub fn set_previous_speed(batch: &mut Batch, id: &str, speed: f64, acceleration: f64) -> Ticket<()> {
    batch.set_raw(Vehicle, 0x3c, "previous_speed", id, (speed, acceleration))
}

/// Adds a stop, or changes or (duration 0) takes away the one there.
pub fn set_stop(batch: &mut Batch, id: &str, stop: &SetStop<'_>) -> Ticket<()> {
    let SetStop { place, position, lane_index, duration, flags, start_position, until } = *stop;
    let argument = (place, position, lane_index, duration, flags as i8, start_position, until);
    batch.set_raw(Vehicle, 0x12, "stop", id, argument)
}

/// Drives on from a stop.
pub fn resume(batch: &mut Batch, id: &str) -> Ticket<()> {
    batch.set_raw(Vehicle, 0x19, "resume", id, ())
}

/// Finds the fastest way again, by travel time.
pub fn reroute_travel_time(batch: &mut Batch, id: &str) -> Ticket<()> {
    batch.set_raw(Vehicle, 0x90, "reroute_travel_time", id, ())
}

/// Finds the way of least effort again.
pub fn reroute_effort(batch: &mut Batch, id: &str) -> Ticket<()> {
    batch.set_raw(Vehicle, 0x91, "reroute_effort", id, ())
}

/// Drives to another parking area.
pub fn reroute_parking(batch: &mut Batch, id: &str, parking_area: &str) -> Ticket<()> {
    batch.set_raw(Vehicle, 0xc2, "reroute_parking", id, (parking_area,))
}

/// Travel time (s) on `edge` between `begin` and `end` (s) that only this vehicle assumes.
pub fn set_adapted_travel_time(
    batch: &mut Batch,
    id: &str,
    edge: &str,
    time: f64,
    begin: f64,
    end: f64,
) -> Ticket<()> {
    batch.set_raw(Vehicle, 0x58, "adapted_travel_time", id, (begin, end, edge, time))
}

/// Effort on `edge` between `begin` and `end` (s) that only this vehicle assumes.
pub fn set_effort(batch: &mut Batch, id: &str, edge: &str, effort: f64, begin: f64, end: f64) -> Ticket<()> {
    batch.set_raw(Vehicle, 0x59, "effort", id, (begin, end, edge, effort))
}

/// Opens a gap to the leader: headway (s), gap (m), for how long (s), how fast (1/s), at most braking (m/s2; -1 any).
pub fn open_gap(
    batch: &mut Batch,
    id: &str,
    time_headway: f64,
    space_headway: f64,
    duration: f64,
    change_rate: f64,
    max_decel: f64,
) -> Ticket<()> {
    let argument = (time_headway, space_headway, duration, change_rate, max_decel);
    batch.set_raw(Vehicle, 0x16, "open_gap", id, argument)
}

/// Ends [`open_gap`].
pub fn deactivate_gap_control(batch: &mut Batch, id: &str) -> Ticket<()> {
    batch.set_raw(Vehicle, 0x16, "open_gap", id, (-1.0, -1.0, -1.0, -1.0, -1.0))
}

/// Circles a vehicle in the GUI; `size` in m, -1 for the vehicle's own.
pub fn highlight(batch: &mut Batch, id: &str, color: Color, size: f64) -> Ticket<()> {
    batch.set_raw(Vehicle, 0x6c, "highlight", id, (color, size))
}

/// Recomputes the best lanes at once.
pub fn update_best_lanes(batch: &mut Batch, id: &str) -> Ticket<()> {
    batch.set_bare(Vehicle, 0x6a, "update_best_lanes", id)
}

/// A [`MoveToXy`]'s angle that SUMO is to choose from the lane.
pub const ANGLE_OF_LANE: f64 = INVALID_DOUBLE;
