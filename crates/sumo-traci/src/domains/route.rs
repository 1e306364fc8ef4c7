//! Routes: named lists of edges.

use crate::{Batch, Ticket};

domain!(
    /// The route domain.
    Route, "route", 0xa6
);

variables! { Route:
    EDGES: Vec<String> = 0x54;
}

/// Adds a route.
pub fn add(batch: &mut Batch, id: &str, edges: &[&str]) -> Ticket<()> {
    batch.set_raw(Route, 0x80, "add", id, edges)
}

/// Takes a route away; SUMO keeps it as long as a vehicle uses it.
pub fn remove(batch: &mut Batch, id: &str) -> Ticket<()> {
    batch.set_bare(Route, 0x81, "remove", id)
}
