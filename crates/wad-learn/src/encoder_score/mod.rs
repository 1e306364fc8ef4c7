//! How good an encoder is: reconstructions, objects that are still there, and what linear probes read off the latent.

#[cfg(feature = "learn")]
pub mod judge;
pub mod probe;
pub mod score;
pub mod told;
