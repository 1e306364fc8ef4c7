//! Why a task cannot be driven.

use super::TaskKind;
use sumo_network::network::RouteError;

/// Why there is no such task, or none on this net.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TaskError {
    /// No task has this name.
    #[error("no task is called `{found}`: expected {}", TaskKind::ALL.map(|k| k.name()).join(", "))]
    Unknown {
        /// The given name.
        found: String,
    },
    /// No place on the net meets every condition; says which one fails.
    #[error("the task `{task}` cannot be placed on this net: {condition}")]
    NoPlace {
        /// The task.
        task: TaskKind,
        /// The condition that fails.
        condition: String,
    },
    /// The placement names something that this net lacks.
    #[error("the task's place names {kind} `{id}`, which this net does not have: it belongs to another net")]
    OtherNet {
        /// The kind of element, e.g. lane.
        kind: &'static str,
        /// The id.
        id: String,
    },
    /// No route connects the places.
    #[error("no route for this task's places: {0}")]
    Route(#[from] RouteError),
}
