//! Evaluation: suites of episodes driven in parallel, and what came of them.
//!
//! ```text
//! Suite + Selection --plan--> cases --run (jobs in parallel)--> EpisodeRecords --rows--> tables
//! ```
//!
//! A [`Case`] is one episode to be; it and the environment's options give the same episode wherever and
//! whenever it is driven. An [`EpisodeRecord`] is one line of `episodes.jsonl`.

mod driver;
mod record;
mod rows;
mod runner;
mod suite;

pub use driver::{Driver, DriverError, DriverSpec};
pub use record::EpisodeRecord;
pub use rows::{Row, rows, wilson};
pub use runner::{EvalError, Evaluation, run};
pub use suite::{Case, Selection, Suite, SuiteError};
