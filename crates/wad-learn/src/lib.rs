//! Learning to drive: the environment, agents, data sets, training and evaluation.
//!
//! | module | what it is |
//! |---|---|
//! | [`env`](mod@env) | session, eyes, reward and termination as `reset` and `step` |
//! | [`reward`] | the paper's six reward terms |
//! | [`agent`] | agents that learn to drive (TD3, SAC), and agents of other programs |
//! | [`driver`] | who drives, by name |
//! | [`drive`] | `run`: from destination to destination, with telemetry |
//! | [`dataset`] | frames of the autopilot's drives, collected and read back |
//! | `train` | training of encoder, detector and agents |
//! | [`eval`] | suites of episodes, driven in parallel |
//! | [`encoder_score`] | how good an encoder is |
//! | [`tour`] | a drive from view to view |

pub mod agent;
pub mod dataset;
pub mod drive;
pub mod driver;
pub mod encoder_score;
pub mod env;
pub mod eval;
#[cfg(feature = "learn")]
pub mod optim;
pub mod reward;
pub mod tour;
#[cfg(feature = "learn")]
pub mod train;

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
