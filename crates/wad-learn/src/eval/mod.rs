//! Evaluation: benchmarks as commands.
//!
//! ```text
//! Suite + Selection --plan--> Cases --run (jobs in parallel)--> EpisodeRecords --rows--> tables, reports
//! ```
//!
//! A [`Case`] is one planned episode; with the environment's options it gives the same episode wherever and
//! whenever it is driven. An [`EpisodeRecord`] is one line of `episodes.jsonl`. [`kept`] shows failures
//! again.

pub mod kept;
mod manifest;
mod order;
mod plan;
mod record;
pub mod report;
pub mod routes;
mod rows;
mod runner;
mod store;
mod suite;
mod summary;
mod tally;
pub mod verify;

pub use crate::driver::{Driver, DriverError, DriverSpec, Made};
pub use kept::Packed;
pub use manifest::Manifest;
pub use order::{Ledger, Order, Outcome, Progress, Towns, evaluate, plan};
pub use plan::{Case, Selection, Shard};
pub use record::{EpisodeRecord, Fault, RecordingFolder};
pub use rows::{Row, Score, grouped, rows, wilson};
pub use runner::{Driven, EvalError, Evaluation, Keep, MakeAgent, Worker, run};
pub use store::{Results, Store, StoreError, in_order};
pub use suite::{Condition, Suite, SuiteError, SuiteTask, condition_name, names};
pub use summary::{Summary, Total};
pub use tally::{EventCounts, Histogram};
