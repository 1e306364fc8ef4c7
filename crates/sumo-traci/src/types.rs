//! TraCI's plain value types.

/// A point in the network's plane: x east, y north (m).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Position2D {
    /// East (m).
    pub x: f64,
    /// North (m).
    pub y: f64,
}

/// A point in space: x east, y north, z up (m).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Position3D {
    /// East (m).
    pub x: f64,
    /// North (m).
    pub y: f64,
    /// Up (m).
    pub z: f64,
}

/// Degrees east and north (WGS 84); altitude in m where given.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GeoPosition {
    /// Degrees east.
    pub longitude: f64,
    /// Degrees north.
    pub latitude: f64,
    /// m, where it is given.
    pub altitude: Option<f64>,
}

/// A place on the road network.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RoadPosition {
    /// Edge id.
    pub edge: String,
    /// Distance from the lane's begin (m).
    pub position: f64,
    /// 0 is the rightmost lane.
    pub lane_index: u8,
}

/// Red, green, blue, alpha, 0..255 each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Color {
    /// Red.
    pub r: u8,
    /// Green.
    pub g: u8,
    /// Blue.
    pub b: u8,
    /// Opacity: 255 hides what is below.
    pub a: u8,
}

impl Color {
    /// An opaque colour.
    pub const fn rgb(r: u8, g: u8, b: u8) -> Self {
        Self { r, g, b, a: 255 }
    }
}
