//! Lanes of edges; crossings and walkingareas have one each.

use super::vehicle::NextLink;
use crate::types::Position2D;
use crate::{Batch, Query, Ticket, Variable};

domain!(
    /// The lane domain.
    Lane, "lane", 0xa3
);

/// A way out of a lane, as in [`NextLink`].
pub type LaneLink = NextLink;

variables! { Lane:
    /// m.
    LENGTH: f64 = 0x44;
    /// m.
    WIDTH: f64 = 0x4d;
    /// m/s.
    MAX_SPEED: f64 = 0x41;
    /// The centre line; for a walkingarea its outline.
    SHAPE: Vec<Position2D> = 0x4e;
    EDGE_ID: String = 0x31;
    /// Vehicle classes; empty where all are allowed.
    ALLOWED: Vec<String> = 0x34;
    /// Vehicle classes.
    DISALLOWED: Vec<String> = 0x35;
    LINK_NUMBER: i32 = 0x30;
    LINKS: Vec<LaneLink> = 0x33;
    FRICTION: f64 = 0x3d;
    /// The rail lane in the other direction; empty for roads.
    BIDI_LANE: String = 0x7f;
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
    /// m/s; the speed limit if the lane is empty.
    LAST_STEP_MEAN_SPEED: f64 = 0x11;
    /// 0..1.
    LAST_STEP_OCCUPANCY: f64 = 0x13;
    /// Mean vehicle length (m).
    LAST_STEP_LENGTH: f64 = 0x15;
    LAST_STEP_VEHICLE_NUMBER: i32 = 0x10;
    LAST_STEP_HALTING_NUMBER: i32 = 0x14;
    LAST_STEP_VEHICLE_IDS: Vec<String> = 0x12;
    /// s.
    TRAVEL_TIME: f64 = 0x5a;
    /// Sum over its vehicles (s).
    WAITING_TIME: f64 = 0x7a;
    /// Vehicles that wait to be put on this lane.
    PENDING_VEHICLES: Vec<String> = 0x94;
}

setters! { Lane:
    /// m/s.
    SET_MAX_SPEED: f64 = 0x41;
    /// m.
    SET_LENGTH: f64 = 0x44;
    /// Vehicle classes.
    SET_ALLOWED: Vec<String> = 0x34;
    /// Vehicle classes.
    SET_DISALLOWED: Vec<String> = 0x35;
}

/// Degrees clockwise from north at `position` (m; -1073741824 for the mean).
pub const fn angle(position: f64) -> Query<Lane, f64, f64> {
    Variable::new(0x43, "angle").with(position)
}

/// Lanes whose traffic crosses the way to lane `to` with right of way; "" for any way.
pub const fn foes(to: &str) -> Query<Lane, Vec<String>, &str> {
    Variable::new(0x37, "foes").with(to)
}

/// Vehicle classes that may change to the lane beside: 1 left, -1 right.
pub const fn change_permissions(direction: i8) -> Query<Lane, Vec<String>, i8> {
    Variable::new(0x3c, "change_permissions").with(direction)
}

/// Sets the vehicle classes that may change to the lane beside: 1 left, -1 right.
pub fn set_change_permissions(batch: &mut Batch, id: &str, classes: &[&str], direction: i8) -> Ticket<()> {
    batch.set_raw(Lane, 0x3c, "change_permissions", id, (classes, direction))
}
