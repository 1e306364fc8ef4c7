//! Polygons.

use crate::types::{Color, Position2D};
use crate::{Batch, Ticket};

domain!(
    /// The polygon domain.
    Polygon, "polygon", 0xa8
);

variables! { Polygon:
    TYPE: String = 0x4f;
    SHAPE: Vec<Position2D> = 0x4e;
    COLOR: Color = 0x45;
    FILL: bool = 0x55;
    /// m.
    LINE_WIDTH: f64 = 0x4d;
}

setters! { Polygon:
    SET_TYPE: String = 0x4f;
    SET_SHAPE: Vec<Position2D> = 0x4e;
    SET_COLOR: Color = 0x45;
    SET_FILL: bool = 0x55;
    SET_LINE_WIDTH: f64 = 0x4d;
}

/// A new polygon.
#[derive(Clone, Copy, Debug)]
pub struct Add<'a> {
    /// SUMO's `type`: any text.
    pub kind: &'a str,
    /// Colour of the line or area.
    pub color: Color,
    /// An area, not a line.
    pub fill: bool,
    /// Higher layers are drawn over lower ones.
    pub layer: i32,
    /// Corners (m).
    pub shape: &'a [Position2D],
    /// m.
    pub line_width: f64,
}

impl Default for Add<'_> {
    fn default() -> Self {
        Self {
            kind: "",
            color: Color::rgb(255, 255, 255),
            fill: false,
            layer: 0,
            shape: &[],
            line_width: 1.0,
        }
    }
}

/// Adds a polygon.
pub fn add(batch: &mut Batch, id: &str, add: &Add<'_>) -> Ticket<()> {
    let Add { kind, color, fill, layer, shape, line_width } = *add;
    batch.set_raw(Polygon, 0x80, "add", id, (kind, color, u8::from(fill), layer, shape, line_width))
}

/// Takes a polygon away.
pub fn remove(batch: &mut Batch, id: &str, layer: i32) -> Ticket<()> {
    batch.set_raw(Polygon, 0x81, "remove", id, layer)
}

/// Lets a polygon follow an object and fade; times in s from now, alpha 0..255.
pub fn add_dynamics(
    batch: &mut Batch,
    id: &str,
    tracked_object: &str,
    times: &[f64],
    alphas: &[f64],
    looped: bool,
    rotate: bool,
) -> Ticket<()> {
    let argument = (tracked_object, times, alphas, u8::from(looped), u8::from(rotate));
    batch.set_raw(Polygon, 0x5c, "add_dynamics", id, argument)
}
