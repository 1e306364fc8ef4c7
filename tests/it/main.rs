//! The integration tests: one binary, so that the heavy libraries are linked once.
//! Each module talks to a real SUMO.

#[cfg(all(feature = "learn", feature = "vision"))]
mod agents;
mod architecture;
mod autopilot;
mod bridge;
#[cfg(feature = "vision")]
mod camera;
mod close_signals;
mod crates;
mod dataset;
mod doctor;
#[cfg(feature = "vision")]
mod env;
mod eval;
#[cfg(all(feature = "learn", feature = "vision"))]
mod eyes;
mod fleet;
mod fuzz;
mod json;
mod licences;
#[cfg(feature = "vision")]
mod mirrors;
mod netedit;
mod nets;
mod network;
mod program;
mod run;
mod scenario;
#[cfg(feature = "vision")]
mod session;
mod traci;
mod traffic;
mod view;
#[cfg(feature = "vision")]
mod watch;
