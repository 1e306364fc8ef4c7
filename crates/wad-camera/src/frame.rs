//! What comes out of a camera.

use super::model::{Box3, ObjectClass};

/// What a frame is to hold beside the picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Outputs {
    /// [`Frame::rgb`].
    pub rgb: bool,
    /// [`Frame::depth`].
    pub depth: bool,
    /// [`Frame::semantic`].
    pub semantic: bool,
    /// [`Frame::instance`].
    pub instance: bool,
    /// [`Frame::objects`].
    pub boxes: bool,
}

impl Outputs {
    /// The picture alone.
    pub const RGB: Self = Self { rgb: true, depth: false, semantic: false, instance: false, boxes: false };
    /// Everything.
    pub const ALL: Self = Self { rgb: true, depth: true, semantic: true, instance: true, boxes: true };
}

/// An object of the eight classes that at least one pixel shows.
#[derive(Clone, Debug, PartialEq)]
pub struct ObjectTruth {
    /// What it is.
    pub class: ObjectClass,
    /// As in [`Frame::instance`].
    pub id: u32,
    /// Pixels that show it.
    pub visible_pixels: u32,
    /// The pixels that show it: left, top, right, bottom; right and bottom are exclusive.
    pub visible_box: [u32; 4],
    /// All of it, hidden parts too, cut at the picture's borders (pixels).
    pub full_box: [f32; 4],
    /// In space, world frame.
    pub bounds: Box3,
    /// Depth of its middle (m).
    pub depth: f32,
}

/// A frame. Rows run from the top, pixels from the left, without padding. What was not asked for is empty.
#[derive(Clone, Debug, Default)]
pub struct Frame {
    /// Pixels.
    pub width: usize,
    /// Pixels.
    pub height: usize,
    /// sRGB bytes: red, green, blue.
    pub rgb: Vec<u8>,
    /// m along the optical axis; infinite where the sky is.
    pub depth: Vec<f32>,
    /// [`super::model::SemanticTag`] numbers.
    pub semantic: Vec<u8>,
    /// Instance ids; 0 where no object of the eight classes is.
    pub instance: Vec<u32>,
    /// By id.
    pub objects: Vec<ObjectTruth>,
}
