//! Edges: roads between two junctions.

use crate::{Batch, Query, Ticket, Variable};

domain!(
    /// The edge domain.
    Edge, "edge", 0xaa
);

variables! { Edge:
    LANE_NUMBER: i32 = 0x52;
    /// Street name.
    STREET_NAME: String = 0x1b;
    FROM_JUNCTION: String = 0x7b;
    TO_JUNCTION: String = 0x7c;
    /// The rail edge in the other direction; empty for roads.
    BIDI_EDGE: String = 0x7f;
    /// s; estimated from the mean speed.
    TRAVEL_TIME: f64 = 0x5a;
    /// Sum over its vehicles (s).
    WAITING_TIME: f64 = 0x7a;
    /// mg/s, as all emissions but noise.
    CO2_EMISSION: f64 = 0x60;
    CO_EMISSION: f64 = 0x61;
    HC_EMISSION: f64 = 0x62;
    PMX_EMISSION: f64 = 0x63;
    NOX_EMISSION: f64 = 0x64;
    FUEL_CONSUMPTION: f64 = 0x65;
    /// dB.
    NOISE_EMISSION: f64 = 0x66;
    /// Wh/s.
    ELECTRICITY_CONSUMPTION: f64 = 0x71;
    /// m/s; the speed limit if the edge is empty.
    LAST_STEP_MEAN_SPEED: f64 = 0x11;
    /// Percent.
    LAST_STEP_OCCUPANCY: f64 = 0x13;
    /// Mean vehicle length (m).
    LAST_STEP_LENGTH: f64 = 0x15;
    LAST_STEP_VEHICLE_NUMBER: i32 = 0x10;
    LAST_STEP_HALTING_NUMBER: i32 = 0x14;
    LAST_STEP_VEHICLE_IDS: Vec<String> = 0x12;
    LAST_STEP_PERSON_IDS: Vec<String> = 0x1a;
    /// Vehicles that wait to be put on this edge.
    PENDING_VEHICLES: Vec<String> = 0x94;
    FRICTION: f64 = 0x3d;
}

setters! { Edge:
    /// m/s.
    SET_MAX_SPEED: f64 = 0x41;
    SET_FRICTION: f64 = 0x3d;
    /// Vehicle classes.
    SET_ALLOWED: Vec<String> = 0x34;
    /// Vehicle classes.
    SET_DISALLOWED: Vec<String> = 0x35;
}

/// Degrees clockwise from north at `position` (m; -1073741824 for the mean).
pub const fn angle(position: f64) -> Query<Edge, f64, f64> {
    Variable::new(0x43, "angle").with(position)
}

/// Travel time (s) that all vehicles assume at `time` (s); negative where none was set.
pub const fn adapted_travel_time(time: f64) -> Query<Edge, f64, f64> {
    Variable::new(0x58, "adapted_travel_time").with(time)
}

/// Effort that all vehicles assume at `time` (s); negative where none was set.
pub const fn effort(time: f64) -> Query<Edge, f64, f64> {
    Variable::new(0x59, "effort").with(time)
}

/// Travel time (s) that all vehicles are to assume between `begin` and `end` (s).
pub fn adapt_travel_time(batch: &mut Batch, id: &str, time: f64, begin: f64, end: f64) -> Ticket<()> {
    batch.set_raw(Edge, 0x58, "adapted_travel_time", id, (begin, end, time))
}

/// Effort that all vehicles are to assume between `begin` and `end` (s).
pub fn set_effort(batch: &mut Batch, id: &str, effort: f64, begin: f64, end: f64) -> Ticket<()> {
    batch.set_raw(Edge, 0x59, "effort", id, (begin, end, effort))
}
