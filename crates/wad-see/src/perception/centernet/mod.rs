//! CenterNet in tch: heatmap, size and offset of eight classes over two backbones; with the road's heads, `eyes`.

mod detector;
mod layer;
pub mod light;
pub mod loss;
pub mod network;
pub mod resnet;
pub mod road;
pub mod road_targets;
pub mod targets;
#[cfg(test)]
mod tests;

pub use detector::CenterNetDetector;
pub use network::{Answer, Backbone, CenterNet, Sees};
