//! The co-simulation: SUMO's traffic, egos in lock-step with it, the criteria that judge an ego, and the
//! autopilot.
//!
//! | module | what it is |
//! |---|---|
//! | [`session`] | one tick for any number of egos; nothing else steps the simulation |
//! | [`bridge`] | one SUMO, one network, and the egos in it |
//! | [`traffic`] | the background population |
//! | [`autopilot`] | the rule-based expert |
//! | [`criteria`], [`end`] | the events of a tick; the end of an episode |
//! | [`assets`] | a town, read and built once |
//! | [`tasks`], [`scenario`], [`destination`] | driving tasks and their places; situations drawn in netedit; routes |
//! | [`replay`], [`telemetry`] | recorded drives |
//! | [`sumo_config`], [`nets`] | reads `.sumocfg` files; builds, imports, enriches and checks nets |
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
mod suggest;
pub mod sumo_config;
pub mod tasks;
pub mod telemetry;
pub mod traffic;

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
