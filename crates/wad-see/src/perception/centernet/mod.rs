//! CenterNet: heatmap, size and offset of eight classes over two backbones; with the road's heads, `eyes`.

pub mod decode;
mod detector;
pub mod graph;
pub mod kind;
#[cfg(feature = "learn")]
mod layer;
#[cfg(feature = "learn")]
pub mod light;
#[cfg(feature = "learn")]
pub mod loss;
#[cfg(feature = "learn")]
pub mod network;
pub mod reader;
#[cfg(feature = "learn")]
pub mod resnet;
#[cfg(feature = "learn")]
pub mod road;
#[cfg(feature = "learn")]
pub mod road_targets;
#[cfg(feature = "learn")]
pub mod targets;
#[cfg(all(test, feature = "learn"))]
mod tests;

pub use detector::{CenterNetDetector, Watcher, engine};
pub use kind::{Backbone, Part, Sees};
#[cfg(feature = "learn")]
pub use network::{Answer, CenterNet};
