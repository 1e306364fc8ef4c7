//! Detectors by name: the values of `--detector`.

use super::centernet::{CenterNetDetector, Sees, engine};
use super::{Detector, Faults, LeastScore, PerceptionError, TruthDetector};
use crate::weights::Weights;
use std::path::Path;
use wad_sim::assets::hash;

/// The forms that [`detector`] knows, for help texts.
pub const DETECTORS: &str = "truth (the renderer's boxes), truth:faulty (with a real detector's faults), \
     outlines and outlines:faulty (the same worked out from shapes without drawing, for fast training), \
     centernet (the one that travels with this program), centernet:FILE (one that train detector wrote), \
     eyes (the bundled one that sees lane and light too), eyes:FILE (one that train eyes wrote), \
     onnx:FILE (any COCO detector in ONNX; onnx alone: what scripts/fetch-detector fetched)";

/// What evaluated and watched drives see by, where nobody asks for another: the camera's picture alone.
pub const DEFAULT_DETECTOR: &str = "eyes";

/// The detector called `name`, which gives the detections with the `least` score; the renderer's have 1.
///
/// # Errors
/// The name is unknown, its file or weights cannot be used, or this build lacks a feature that it needs.
pub fn detector(name: &str, least: LeastScore) -> Result<Box<dyn Detector>, PerceptionError> {
    let (kind, file) = kind(name);
    match kind {
        "truth" | "outlines" if matches!(file, None | Some("faulty")) => {
            let faults = if file.is_some() { Faults::HONEST } else { Faults::NONE };
            let truth = TruthDetector::with_faults(faults);
            Ok(Box::new(if kind == "outlines" { truth.by_outlines() } else { truth }))
        }
        "centernet" | "eyes" => centernet(name, least),
        "onnx" => onnx(name, file, least),
        _ => Err(unknown(name)),
    }
}

/// Checks that there is a detector called `name` and that its weights can be read, without making it.
///
/// # Errors
/// The name is unknown, or its file cannot be used.
pub fn check(name: &str) -> Result<(), PerceptionError> {
    match kind(name) {
        ("truth" | "outlines", None | Some("faulty")) | ("onnx", _) => Ok(()),
        ("centernet" | "eyes", _) => centernet_weights(name).map(drop),
        _ => Err(unknown(name)),
    }
}

fn kind(name: &str) -> (&str, Option<&str>) {
    name.split_once(':').map_or((name, None), |(kind, file)| (kind, Some(file)))
}

fn unknown(name: &str) -> PerceptionError {
    failed(name, format!("no detector has this name. Known: {DETECTORS}"))
}

/// Whether the detector called `name` sees lane and light, which others are told.
pub fn sees_the_road(name: &str) -> bool {
    name.split(':').next() == Some("eyes")
}

/// The file of the bundled network that `kind` is alone.
fn bundled(kind: &str) -> &'static str {
    if kind == "eyes" { "eyes" } else { "light" }
}

fn centernet(name: &str, least: LeastScore) -> Result<Box<dyn Detector>, PerceptionError> {
    let (weights, sees) = centernet_weights(name)?;
    let found = CenterNetDetector::from_weights(name.to_string(), &weights, sees, least);
    Ok(Box::new(found.map_err(|e| failed(name, e.to_string()))?))
}

/// The weights that `name`, centernet, centernet:FILE or eyes:FILE, stands for, and what they see.
///
/// # Errors
/// Another name, no such file, or none travel with this build.
pub fn centernet_weights(name: &str) -> Result<(Weights, Sees), PerceptionError> {
    match kind(name) {
        ("centernet", file) => Ok((weights(name, file, bundled("centernet"))?, Sees::Objects)),
        ("eyes", file) => Ok((weights(name, file, bundled("eyes"))?, Sees::Road)),
        _ => Err(failed(name, "expected centernet, centernet:FILE or eyes:FILE".to_string())),
    }
}

fn weights(name: &str, file: Option<&str>, bundled: &str) -> Result<Weights, PerceptionError> {
    let loaded = match file.filter(|file| !file.is_empty()) {
        Some(file) => Weights::load(Path::new(file)),
        None => {
            let none = || {
                let why = "no weights travel with this build: train some with `wad-cosim train detector` (or `train \
                           eyes`) and name them, NAME:FILE";
                failed(name, why.to_string())
            };
            Weights::parse(Path::new(bundled), wad_sim::bundled::detector(bundled).ok_or_else(none)?)
        }
    };
    loaded.map_err(|e| failed(name, e.to_string()))
}

fn failed(name: &str, why: String) -> PerceptionError {
    PerceptionError::Detector { name: name.to_string(), why }
}

#[cfg(feature = "vision")]
fn onnx(name: &str, file: Option<&str>, least: LeastScore) -> Result<Box<dyn Detector>, PerceptionError> {
    use super::OnnxDetector;
    let path =
        file.filter(|f| !f.is_empty()).map(Into::into).or_else(OnnxDetector::default_path).ok_or_else(
            || {
                let why = "HOME is not set, so there is no cache to look in: name a file, onnx:FILE";
                failed(name, why.to_string())
            },
        )?;
    let least = if let LeastScore::Fixed(score) = least { score } else { 0.3 };
    Ok(Box::new(OnnxDetector::load(&path, least)?))
}

#[cfg(not(feature = "vision"))]
fn onnx(name: &str, _: Option<&str>, _: LeastScore) -> Result<Box<dyn Detector>, PerceptionError> {
    let why = "this program was built without OpenCV: build it with the cargo feature `vision`";
    Err(failed(name, why.to_string()))
}

/// Stands for the weights of the detector called `name`, and for what computes them here; None if it has none, or its
/// file cannot be read.
pub fn weights_hash(name: &str) -> Option<String> {
    let (kind, file) = name.split_once(':').map_or((name, ""), |(kind, file)| (kind, file));
    let read = |file: &Path| Some(hash(&std::fs::read(file).ok()?));
    let hash = match (kind, file) {
        ("centernet" | "eyes", "") => wad_sim::bundled::detector(bundled(kind)).map(hash),
        #[cfg(feature = "vision")]
        ("onnx", "") => read(&super::OnnxDetector::default_path()?),
        ("centernet" | "eyes" | "onnx", file) => read(file.as_ref()),
        _ => None,
    }?;
    let engine = centernet_weights(name).ok().and_then(|(weights, sees)| engine(&weights, sees).ok()?);
    Some(engine.map_or(hash.clone(), |engine| format!("{hash}, {engine}")))
}
