//! SUMO road networks in Rust: geometry, `.net.xml`, routes, and the traffic on them.

pub mod geometry;
pub mod network;
pub mod seeds;
pub mod world;
