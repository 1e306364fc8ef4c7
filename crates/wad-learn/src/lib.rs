//! Learning to drive: the environment, agents, data sets, training and evaluation.
//!
//! | module | what it is |
//! |---|---|
//! | [`env`](mod@env) | the environment: session, eyes, reward and termination as `reset` and `step` |
//! | [`reward`] | the paper's six reward terms |
//! | [`agent`] | agents that learn to drive (TD3, SAC), and external agents |
//! | [`driver`] | drivers by name |
//! | [`drive`] | `run`: from destination to destination, with telemetry |
//! | [`dataset`] | datasets of camera frames from the autopilot's drives |
//! | `train` | training of encoder, detector and agents |
//! | [`eval`] | suites of episodes, driven in parallel |
//! | [`folder_lock`] | one process at a time writes into a results folder |
//! | [`encoder_score`] | scores of an encoder |
//! | [`tour`] | a drive through a town for pictures |

pub mod agent;
pub mod dataset;
pub mod drive;
pub mod driver;
pub mod encoder_score;
pub mod env;
pub mod eval;
pub mod folder_lock;
mod one;
#[cfg(feature = "learn")]
pub mod optim;
pub mod reward;
pub mod tour;
#[cfg(feature = "learn")]
pub mod train;

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
