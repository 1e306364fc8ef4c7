//! The encoder-decoder that turns the transformed image into 200 numbers (paper, figure 4).

pub mod architecture;
#[cfg(feature = "learn")]
pub mod chance;
#[cfg(feature = "learn")]
pub mod encoder;
pub mod file;
#[cfg(feature = "learn")]
pub mod network;
pub mod packed;
mod plain;
mod pooled;

#[cfg(feature = "learn")]
pub use encoder::TchEncoder;
pub use file::bundled_with;
pub use plain::PlainEncoder;
pub use pooled::PooledEncoder;

use crate::perception::{ImageKind, TransformedImage};
use wad_camera::CameraConfig;

/// Why there is no latent.
#[derive(Debug, thiserror::Error)]
pub enum LatentError {
    /// The network fails, or its input has another shape; says what is wrong.
    #[error("encoder: {0}")]
    Encoder(String),
    /// No such encoder.
    #[error(
        "no encoder `{name}`: expected a .safetensors file, a folder that `train encoder` wrote, or a bundled \
         one ({})",
        if bundled.is_empty() { "this build has none".to_string() } else { bundled.join(", ") }
    )]
    Unknown {
        /// The given name.
        name: String,
        /// The bundled encoders.
        bundled: Vec<String>,
    },
    /// The weights cannot be read, or are of another network.
    #[error(transparent)]
    Weights(#[from] crate::weights::WeightsError),
    /// libtorch fails.
    #[cfg(feature = "learn")]
    #[error("encoder: libtorch: {0}")]
    Torch(#[from] tch::TchError),
}

/// Turns transformed images into latents.
pub trait Encoder: Send {
    /// Hash of the weights; an agent belongs to one encoder.
    fn hash(&self) -> &str;

    /// The image that it was trained on.
    fn image_kind(&self) -> ImageKind {
        ImageKind::Transformed
    }

    /// The camera that its weights belong to; None where it has none.
    fn camera(&self) -> Option<CameraConfig> {
        None
    }

    /// The latent of one image, [`crate::observation::LATENT_SIZE`] numbers, into `latent`.
    ///
    /// # Errors
    /// The network fails.
    fn encode(&mut self, image: &TransformedImage, latent: &mut Vec<f32>) -> Result<(), LatentError>;
}

/// An encoder that can turn a latent back into an image.
pub trait Decoder: Encoder {
    /// Writes the image of `latent` ([`crate::observation::LATENT_SIZE`] numbers) into `image`.
    ///
    /// # Errors
    /// The latent has another length, or the network fails.
    fn decode(&mut self, latent: &[f32], image: &mut TransformedImage) -> Result<(), LatentError>;

    /// Encodes and decodes: the reconstruction of an image.
    ///
    /// # Errors
    /// The network fails.
    fn reconstruct(&mut self, image: &TransformedImage) -> Result<TransformedImage, LatentError> {
        let (mut latent, mut out) = (Vec::new(), TransformedImage::default());
        self.encode(image, &mut latent)?;
        self.decode(&latent, &mut out)?;
        Ok(out)
    }
}
