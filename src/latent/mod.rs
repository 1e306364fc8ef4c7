//! The encoder-decoder that turns the transformed image into 200 numbers (paper, figure 4).

mod pooled;

pub use pooled::PooledEncoder;

use crate::perception::TransformedImage;

/// Why there is no latent.
#[derive(Debug, thiserror::Error)]
pub enum LatentError {
    #[error("encoder: {0}")]
    Encoder(String),
}

/// Turns transformed images into latents.
pub trait Encoder: Send {
    /// Identifies the weights; agents belong to one encoder.
    fn hash(&self) -> &str;

    /// The latent of one image, [`crate::observation::LATENT_SIZE`] numbers, into `latent`.
    ///
    /// # Errors
    /// The network fails.
    fn encode(&mut self, image: &TransformedImage, latent: &mut Vec<f32>) -> Result<(), LatentError>;
}
