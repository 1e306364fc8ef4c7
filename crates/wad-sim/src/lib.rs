//! The co-simulation: SUMO's traffic, egos in lock-step with it, and what judges and drives them.
//!
//! | module | what it is |
//! |---|---|
//! | [`session`] | one tick for any number of egos: the only place where a tick happens |
//! | [`bridge`] | one SUMO, one network, egos put into it and read back |
//! | [`traffic`] | the background population |
//! | [`autopilot`] | the rule-based expert |
//! | [`criteria`], [`end`] | what happened in a tick; what ends an episode |
//! | [`assets`] | a town, read and built once |
//! | [`tasks`], [`scenario`], [`destination`] | what is to be driven, and where |
//! | [`replay`], [`telemetry`] | recorded drives |
//! | [`sumo_config`], [`nets`] | `.sumocfg` files; nets built, imported, enriched |
//! | [`bundled`] | towns, scenarios and weights that travel with the program |
//! | [`cores`], [`cpu_time`], [`stats`], [`program`] | processors, processor time, medians, the version |

pub mod assets;
pub mod autopilot;
pub mod bridge;
pub mod bundled;
pub mod cores;
pub mod cpu_time;
pub mod criteria;
pub mod destination;
pub mod end;
pub mod nets;
pub mod program;
pub mod replay;
pub mod scenario;
pub mod session;
pub mod stats;
pub mod sumo_config;
pub mod tasks;
pub mod telemetry;
pub mod traffic;

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
