//! Points of interest.

use crate::types::{Color, Position2D};
use crate::{Batch, Ticket};

domain!(
    /// The point-of-interest domain.
    Poi, "poi", 0xa7
);

variables! { Poi:
    TYPE: String = 0x4f;
    POSITION: Position2D = 0x42;
    COLOR: Color = 0x45;
    /// m.
    WIDTH: f64 = 0x4d;
    /// m.
    HEIGHT: f64 = 0xbc;
    /// Degrees.
    ANGLE: f64 = 0x43;
    IMAGE_FILE: String = 0x93;
}

setters! { Poi:
    SET_TYPE: String = 0x4f;
    SET_POSITION: Position2D = 0x42;
    SET_COLOR: Color = 0x45;
    SET_WIDTH: f64 = 0x4d;
    SET_HEIGHT: f64 = 0xbc;
    SET_ANGLE: f64 = 0x43;
    SET_IMAGE_FILE: String = 0x93;
}

/// A new point of interest.
#[derive(Clone, Copy, Debug)]
pub struct Add<'a> {
    /// SUMO's `type`: any text.
    pub kind: &'a str,
    /// Fill colour.
    pub color: Color,
    /// Higher layers are drawn over lower ones.
    pub layer: i32,
    /// Centre (m).
    pub position: Position2D,
    /// Picture to draw in its place; "" for none.
    pub image_file: &'a str,
    /// m.
    pub width: f64,
    /// m.
    pub height: f64,
    /// Degrees.
    pub angle_deg: f64,
    /// Name of a symbol that SUMO has; "" for none.
    pub icon: &'a str,
}

impl Default for Add<'_> {
    fn default() -> Self {
        Self {
            kind: "",
            color: Color::rgb(255, 0, 0),
            layer: 0,
            position: Position2D::default(),
            image_file: "",
            width: 1.0,
            height: 1.0,
            angle_deg: 0.0,
            icon: "",
        }
    }
}

/// Adds a point of interest.
pub fn add(batch: &mut Batch, id: &str, add: &Add<'_>) -> Ticket<()> {
    let Add { kind, color, layer, position, image_file, width, height, angle_deg, icon } = *add;
    let argument = (kind, color, layer, position, image_file, width, height, angle_deg, icon);
    batch.set_raw(Poi, 0x80, "add", id, argument)
}

/// Takes a point of interest away.
pub fn remove(batch: &mut Batch, id: &str, layer: i32) -> Ticket<()> {
    batch.set_raw(Poi, 0x81, "remove", id, layer)
}

/// Circles it in the GUI: `size` in m, fading from `alpha` (1..255) over `duration` (s).
pub fn highlight(
    batch: &mut Batch,
    id: &str,
    color: Color,
    size: f64,
    alpha: u8,
    duration: f64,
) -> Ticket<()> {
    batch.set_raw(Poi, 0x6c, "highlight", id, (color, size, alpha, duration, 0u8))
}
