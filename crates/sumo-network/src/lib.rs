//! SUMO road networks in Rust: geometry, `.net.xml`, routes, and the traffic on them.

pub mod geometry;
pub mod network;
pub mod seeds;
pub mod world;

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
