//! Detectors by name: what `--detector` takes.

use super::{Detector, Faults, PerceptionError, TruthDetector};

/// The forms that [`detector`] knows, for help texts.
pub const DETECTORS: &str = "truth (the renderer's boxes), truth:faulty (with a real detector's faults), \
     onnx:FILE (any COCO detector in ONNX; onnx alone: what scripts/fetch-detector fetched)";

/// A detection with a lower score is none, unless a measurement asks for all of them.
pub const MIN_SCORE: f32 = 0.3;

/// The detector called `name`; detections with a score below `min_score` (0 to 1) are dropped.
///
/// # Errors
/// No such name, its file or weights cannot be used, or this program was built without what it needs.
pub fn detector(name: &str, min_score: f32) -> Result<Box<dyn Detector>, PerceptionError> {
    let unknown = || PerceptionError::Detector {
        name: name.to_string(),
        why: format!("no detector has this name. Known: {DETECTORS}"),
    };
    let (kind, file) = name.split_once(':').map_or((name, None), |(kind, file)| (kind, Some(file)));
    match kind {
        "truth" if file.is_none() => Ok(Box::new(TruthDetector::new())),
        "truth" if file == Some("faulty") => Ok(Box::new(TruthDetector::with_faults(Faults::HONEST))),
        "onnx" => onnx(name, file, min_score),
        _ => Err(unknown()),
    }
}

#[cfg(feature = "vision")]
fn onnx(name: &str, file: Option<&str>, min_score: f32) -> Result<Box<dyn Detector>, PerceptionError> {
    use super::OnnxDetector;
    let path =
        file.filter(|f| !f.is_empty()).map(Into::into).or_else(OnnxDetector::default_path).ok_or_else(
            || PerceptionError::Detector {
                name: name.to_string(),
                why: "HOME is not set, so there is no cache to look in: name a file, onnx:FILE".to_string(),
            },
        )?;
    Ok(Box::new(OnnxDetector::load(&path, min_score)?))
}

#[cfg(not(feature = "vision"))]
fn onnx(name: &str, _: Option<&str>, _: f32) -> Result<Box<dyn Detector>, PerceptionError> {
    Err(PerceptionError::Detector {
        name: name.to_string(),
        why: "this program was built without OpenCV: build it with the cargo feature `vision`".to_string(),
    })
}
