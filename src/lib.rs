//! wad-cosim: a co-simulation bridge to SUMO traffic.

pub mod autopilot;
pub mod geometry;
pub mod network;
pub mod traci;
pub mod traffic;
pub mod vehicle;
pub mod world;
