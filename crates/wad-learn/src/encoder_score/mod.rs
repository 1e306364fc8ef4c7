//! Scores of an encoder: reconstructions, painted objects that they keep, and linear probes on the latent.

#[cfg(feature = "learn")]
pub mod judge;
pub mod probe;
pub mod score;
pub mod told;
