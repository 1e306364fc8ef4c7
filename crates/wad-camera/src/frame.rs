//! Frames: the output of a camera.

use super::model::{Box3, ObjectClass};

/// The buffers of a frame.
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
    /// [`Frame::objects`] worked out from the shapes of road users and walls; alone it draws nothing.
    /// `boxes` wins where both are asked for.
    pub outlines: bool,
}

impl Outputs {
    /// Nothing.
    pub const NONE: Self =
        Self { rgb: false, depth: false, semantic: false, instance: false, boxes: false, outlines: false };
    /// The picture alone.
    pub const RGB: Self = Self { rgb: true, ..Self::NONE };
    /// Everything that is drawn.
    pub const ALL: Self =
        Self { rgb: true, depth: true, semantic: true, instance: true, boxes: true, outlines: false };

    /// What either has.
    #[must_use]
    pub fn with(self, other: Self) -> Self {
        Self {
            rgb: self.rgb || other.rgb,
            depth: self.depth || other.depth,
            semantic: self.semantic || other.semantic,
            instance: self.instance || other.instance,
            boxes: self.boxes || other.boxes,
            outlines: self.outlines || other.outlines,
        }
    }

    /// Whether something has to be drawn.
    pub fn draws(self) -> bool {
        self != Self { outlines: self.outlines, ..Self::NONE }
    }
}

/// An object of the eight classes with at least one visible pixel. Where outlines take the place of a picture,
/// its pixels are an estimate.
#[derive(Clone, Debug, PartialEq)]
pub struct ObjectTruth {
    /// What it is.
    pub class: ObjectClass,
    /// As in [`Frame::instance`].
    pub id: u32,
    /// Number of its visible pixels.
    pub visible_pixels: u32,
    /// Box of its visible pixels: left, top, right, bottom; right and bottom are exclusive.
    pub visible_box: [u32; 4],
    /// Box of the whole object, hidden parts too, cut at the picture's borders (pixels).
    pub full_box: [f32; 4],
    /// Its box in space, world frame.
    pub bounds: Box3,
    /// Depth of its middle (m).
    pub depth: f32,
}

/// A frame. Rows run from the top, pixels from the left, without padding. Buffers that were not requested are empty.
#[derive(Clone, Debug, Default)]
pub struct Frame {
    /// Pixels.
    pub width: usize,
    /// Pixels.
    pub height: usize,
    /// sRGB bytes: red, green, blue.
    pub rgb: Vec<u8>,
    /// Depth along the optical axis (m); infinite in the sky.
    pub depth: Vec<f32>,
    /// [`super::model::SemanticTag`] numbers.
    pub semantic: Vec<u8>,
    /// Instance ids; 0 for pixels without an object of the eight classes.
    pub instance: Vec<u32>,
    /// By id.
    pub objects: Vec<ObjectTruth>,
}

impl Frame {
    /// Empties every buffer; the size stays.
    pub(super) fn empty(&mut self) {
        self.rgb.clear();
        self.depth.clear();
        self.semantic.clear();
        self.instance.clear();
        self.objects.clear();
    }
}
