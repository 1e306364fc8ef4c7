//! Junctions.

use crate::types::{Position2D, Position3D};

domain!(
    /// The junction domain.
    Junction, "junction", 0xa9
);

variables! { Junction:
    POSITION: Position2D = 0x42;
    POSITION_3D: Position3D = 0x39;
    /// The outline.
    SHAPE: Vec<Position2D> = 0x4e;
    INCOMING_EDGES: Vec<String> = 0x7b;
    OUTGOING_EDGES: Vec<String> = 0x7c;
}
