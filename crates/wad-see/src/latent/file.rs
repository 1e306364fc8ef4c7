//! Files of trained encoders.

use super::LatentError;
use super::architecture::Architecture;
use crate::observation::LATENT_SIZE;
use crate::weights::{Weights, WeightsError};
use std::path::{Path, PathBuf};
use wad_camera::CameraConfig;
use wad_sim::bundled;

/// Metadata keys of an encoder's file.
pub mod keys {
    /// The kind of file; always [`super::KIND`].
    pub const KIND: &str = "kind";
    /// JSON of [`super::Architecture`].
    pub const ARCHITECTURE: &str = "architecture";
    /// JSON of what it was trained with.
    pub const CONFIG: &str = "config";
    /// [`wad_camera::CameraConfig::hash`].
    pub const CAMERA: &str = "camera";
    /// JSON of the dataset's manifest.
    pub const DATASET: &str = "dataset";
    /// JSON of what it scored.
    pub const SCORES: &str = "scores";
    /// Content hash of all tensors: the encoder's name to agents.
    pub const HASH: &str = "hash";
}

/// The metadata of an encoder's file.
pub const KIND: &str = "wad-cosim encoder 1";

/// The weights of the encoder that `name` means: a file, a folder with `encoder.safetensors`, or a bundled one's
/// name (`default`).
///
/// # Errors
/// There is none of that name, or the file cannot be read.
pub fn find(name: &str) -> Result<Weights, LatentError> {
    let path = Path::new(name);
    if path.is_dir() {
        return Ok(Weights::load(&path.join("encoder.safetensors"))?);
    }
    if path.is_file() {
        return Ok(Weights::load(path)?);
    }
    let Some(bytes) = bundled::encoder(name) else {
        return Err(LatentError::Unknown { name: name.to_string(), bundled: bundled::encoders() });
    };
    Ok(Weights::parse(&PathBuf::from(format!("bundled encoder {name}")), bytes)?)
}

/// The name of the bundled encoder with these weights ([`super::Encoder::hash`]).
pub fn bundled_with(hash: &str) -> Option<String> {
    bundled::encoders().into_iter().find(|name| {
        let weights = bundled::encoder(name).map(|bytes| Weights::parse(Path::new(name), bytes));
        let said = weights.and_then(Result::ok).and_then(|w| w.metadata.get(keys::HASH).cloned());
        said.as_deref() == Some(hash)
    })
}

/// The architecture and the hash of an encoder's weights.
///
/// # Errors
/// They are of another network or of another camera.
pub fn check(weights: &Weights) -> Result<(Architecture, String), WeightsError> {
    let said = |key: &str| weights.metadata.get(key).cloned().unwrap_or_else(|| "nothing known".into());
    let expect = |key: &str, expected: String| match said(key) {
        found if found == expected => Ok(()),
        found => Err(WeightsError::Mismatch {
            path: weights.path.clone(),
            found: format!("{key} {found}"),
            expected: format!("{key} {expected}"),
        }),
    };
    expect(keys::KIND, KIND.to_string())?;
    expect(keys::CAMERA, CameraConfig::default().hash())?;
    let format = |why: String| WeightsError::Format { path: weights.path.clone(), why };
    let architecture: Architecture = serde_json::from_str(&said(keys::ARCHITECTURE))
        .map_err(|e| format(format!("its architecture cannot be read ({e})")))?;
    if !architecture.is_possible() || architecture.latent != LATENT_SIZE as i64 {
        return Err(format(format!("no network can be made of {architecture:?}")));
    }
    let hash = weights.hash();
    expect(keys::HASH, hash.clone())?;
    Ok((architecture, hash))
}
