//! Training: the encoder-decoder, and the driving agents.

#[cfg(feature = "learn")]
pub mod agent;
#[cfg(feature = "learn")]
pub mod detector;
#[cfg(feature = "learn")]
pub mod detector_data;
#[cfg(feature = "learn")]
pub mod encoder;
#[cfg(feature = "learn")]
pub mod images;
#[cfg(feature = "learn")]
mod loss;
#[cfg(feature = "learn")]
pub mod run;
pub mod tensorboard;
#[cfg(feature = "learn")]
mod weathering;
