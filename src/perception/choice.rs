//! Detectors by name: what `--detector` takes.

use super::{Detector, Faults, PerceptionError, TruthDetector};

/// The forms that [`detector`] knows, for help texts.
pub const DETECTORS: &str = "truth (the renderer's boxes), truth:faulty (with a real detector's faults), \
     centernet (the one that travels with this program), centernet:FILE (one that train detector wrote), \
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
        "centernet" => centernet(name, file, min_score),
        "onnx" => onnx(name, file, min_score),
        _ => Err(unknown()),
    }
}

/// The bundled CenterNet.
#[cfg(feature = "learn")]
const BUNDLED: &str = "light";

#[cfg(feature = "learn")]
fn centernet(name: &str, file: Option<&str>, min_score: f32) -> Result<Box<dyn Detector>, PerceptionError> {
    use super::centernet::CenterNetDetector;
    use crate::latent::weights::Weights;
    use std::path::Path;
    if let Some(file) = file.filter(|f| !f.is_empty()) {
        return Ok(Box::new(CenterNetDetector::load(Path::new(file), min_score)?));
    }
    let failed = |why: String| PerceptionError::Detector { name: name.to_string(), why };
    let bytes = crate::bundled::detector(BUNDLED).ok_or_else(|| {
        failed(
            "no weights travel with this build: train some with `wad-cosim train detector` and name them, \
             centernet:FILE"
                .to_string(),
        )
    })?;
    let found = Weights::parse(Path::new(BUNDLED), bytes)
        .and_then(|weights| CenterNetDetector::from_weights(name.to_string(), &weights, min_score));
    Ok(Box::new(found.map_err(|e| failed(e.to_string()))?))
}

#[cfg(not(feature = "learn"))]
fn centernet(name: &str, _: Option<&str>, _: f32) -> Result<Box<dyn Detector>, PerceptionError> {
    Err(PerceptionError::Detector {
        name: name.to_string(),
        why: "this program was built without libtorch: build it with the cargo feature `learn`".to_string(),
    })
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
