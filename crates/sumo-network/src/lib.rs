//! SUMO road networks in Rust: geometry, `.net.xml` files, routes, and the state of traffic and signals.

pub mod geometry;
pub mod network;
pub mod seeds;
pub mod signal_ahead;
pub mod world;

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
