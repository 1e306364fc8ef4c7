//! Training: the encoder-decoder, and the driving agents.

pub mod agent;
pub mod detector;
pub mod detector_data;
pub mod encoder;
pub mod images;
mod loss;
pub mod run;
pub mod tensorboard;
mod weathering;
