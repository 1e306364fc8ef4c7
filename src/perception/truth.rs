//! The detector that asks the renderer: boxes of what is visible.

use super::{Detection, Detector, PerceptionError};
use crate::camera::{CameraConfig, Frame, ObjectTruth, Outputs};

/// Boxes of the renderer's ground truth.
#[derive(Debug, Default)]
pub struct TruthDetector {}

/// Objects that show fewer pixels than this in a picture of 512 x 512 are nobody's to see.
const LEAST_PIXELS: f32 = 12.0;

impl TruthDetector {
    /// Without faults.
    pub fn new() -> Self {
        Self::default()
    }
}

/// Whether enough of an object is visible.
fn is_visible(object: &ObjectTruth, camera: &CameraConfig) -> bool {
    let scale = (camera.width * camera.height) as f32 / (512.0 * 512.0);
    object.visible_pixels as f32 >= (LEAST_PIXELS * scale).max(2.0)
}

impl Detector for TruthDetector {
    fn name(&self) -> &str {
        "truth"
    }

    fn needs(&self) -> Outputs {
        Outputs { boxes: true, ..Outputs::RGB }
    }

    fn detect(
        &mut self,
        frame: &Frame,
        camera: &CameraConfig,
        found: &mut Vec<Detection>,
    ) -> Result<(), PerceptionError> {
        found.clear();
        found.extend(frame.objects.iter().filter(|object| is_visible(object, camera)).map(|object| {
            Detection { class: object.class, bounds: object.visible_box.map(|v| v as f32), score: 1.0 }
        }));
        Ok(())
    }
}
