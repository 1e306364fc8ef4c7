//! Vehicle types, of persons too.

use crate::types::Color;
use crate::{Batch, Ticket};

domain!(
    /// The vehicle type domain.
    VehicleType, "vehicletype", 0xa5
);

variables! { VehicleType:
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
    /// Factor on the number of vehicles of this type.
    SCALE: f64 = 0x8e;
    VEHICLE_CLASS: String = 0x49;
    EMISSION_CLASS: String = 0x4a;
    SHAPE_CLASS: String = 0x4b;
    LATERAL_ALIGNMENT: String = 0xb9;
    PERSON_CAPACITY: i32 = 0x38;
    COLOR: Color = 0x45;
}

setters! { VehicleType:
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
    SET_SPEED_DEVIATION: f64 = 0x5f;
    SET_TIME_HEADWAY: f64 = 0x48;
    SET_IMPERFECTION: f64 = 0x5d;
    SET_IMPATIENCE: f64 = 0x26;
    SET_BOARDING_DURATION: f64 = 0x2f;
    SET_ACTION_STEP_LENGTH: f64 = 0x7d;
    SET_SCALE: f64 = 0x8e;
    SET_VEHICLE_CLASS: String = 0x49;
    SET_EMISSION_CLASS: String = 0x4a;
    SET_SHAPE_CLASS: String = 0x4b;
    SET_LATERAL_ALIGNMENT: String = 0xb9;
    SET_COLOR: Color = 0x45;
    /// Makes a copy of the type under this id.
    COPY: String = 0x88;
}

/// Makes a copy of type `id` called `new_id`.
pub fn copy(batch: &mut Batch, id: &str, new_id: &str) -> Ticket<()> {
    batch.set(COPY, id, new_id)
}
