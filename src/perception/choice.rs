//! Detectors by name, as `--detector` takes them.

use super::{Detector, Faults, PerceptionError, TruthDetector};

/// What `--detector` takes, for help texts.
pub const DETECTORS: &str = "truth (the renderer's boxes) or truth:faulty (with a real detector's faults)";

/// The detector called `name`.
///
/// # Errors
/// There is none of that name, or it cannot be loaded.
pub fn detector(name: &str) -> Result<Box<dyn Detector>, PerceptionError> {
    match name {
        "truth" => Ok(Box::new(TruthDetector::new())),
        "truth:faulty" => Ok(Box::new(TruthDetector::with_faults(Faults::HONEST))),
        _ => Err(PerceptionError::Detector {
            name: name.to_string(),
            why: format!("there is no detector of that name: expected {DETECTORS}"),
        }),
    }
}
