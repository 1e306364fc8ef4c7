//! The frozen encoder as agents use it.

use super::packed::{Packed, Scratch};
use super::{Encoder, LatentError, file};
use crate::perception::{ImageKind, TransformedImage};
use crate::weights::{Weights, WeightsError};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError, Weak};
use wad_camera::CameraConfig;

/// A trained encoder without libtorch. All those of the same weights share them: another one costs its buffers.
#[derive(Debug)]
pub struct PlainEncoder {
    packed: Arc<Packed>,
    scratch: Scratch,
    hash: String,
    image: ImageKind,
}

impl PlainEncoder {
    /// The encoder that `name` means: a file, a folder with `encoder.safetensors`, or a bundled one's name
    /// (`default`).
    ///
    /// # Errors
    /// There is none of that name, or the file does not fit this program.
    pub fn find(name: &str) -> Result<Self, LatentError> {
        Ok(Self::of(&file::find(name)?)?)
    }

    /// An encoder from weights.
    ///
    /// # Errors
    /// They are of another network or of another camera, or not in half precision.
    pub fn of(weights: &Weights) -> Result<Self, WeightsError> {
        static USED: Mutex<BTreeMap<String, Weak<Packed>>> = Mutex::new(BTreeMap::new());
        let (architecture, hash) = file::check(weights)?;
        let mut used = USED.lock().unwrap_or_else(PoisonError::into_inner);
        let packed = match used.get(&hash).and_then(Weak::upgrade) {
            Some(packed) => packed,
            None => {
                let unfit = || WeightsError::Format {
                    path: weights.path.clone(),
                    why: "the encoder's weights are not in half precision".to_string(),
                };
                let packed = Arc::new(Packed::new(weights, &architecture)?.ok_or_else(unfit)?);
                used.retain(|_, packed| packed.strong_count() > 0);
                used.insert(hash.clone(), Arc::downgrade(&packed));
                packed
            }
        };
        Ok(Self { packed, scratch: Scratch::default(), hash, image: architecture.image })
    }
}

impl Encoder for PlainEncoder {
    fn hash(&self) -> &str {
        &self.hash
    }

    fn image_kind(&self) -> ImageKind {
        self.image
    }

    fn camera(&self) -> Option<CameraConfig> {
        Some(CameraConfig::default())
    }

    fn encode(&mut self, image: &TransformedImage, latent: &mut Vec<f32>) -> Result<(), LatentError> {
        self.packed.encode(image, &mut self.scratch, latent);
        Ok(())
    }
}
