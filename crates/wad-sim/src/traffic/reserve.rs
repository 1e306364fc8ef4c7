//! Edges lately seen empty: places where a replacement gets onto the road at once.
//!
//! Queries the vehicle counts of up to three edges per tick, and only while there are few fresh answers.

use std::collections::VecDeque;
use sumo_network::network::{EdgeId, Network};
use sumo_traci::{Batch, Replies, Ticket, edge};

/// An answer older than this (s) is out of date.
const FRESH: f64 = 2.0;
/// Number of fresh answers that is enough.
const ENOUGH: usize = 6;
/// Questions in one tick at the most.
const PER_TICK: usize = 3;
/// An edge that was used is not used again for this time (s).
const REST: f64 = 4.0;

#[derive(Debug)]
pub(super) struct Reserve {
    /// Edges with the time (s) at which they were empty, oldest first.
    empty: VecDeque<(EdgeId, f64)>,
    asked: Vec<(EdgeId, f64, Ticket<i32>)>,
    /// By edge: when it was last used (s).
    used: Vec<f64>,
}

impl Reserve {
    pub fn new(edges: usize) -> Self {
        Self { empty: VecDeque::new(), asked: Vec::new(), used: vec![f64::NEG_INFINITY; edges] }
    }

    /// Takes in the answer that came with the step that ended at `time` (s).
    pub fn read(&mut self, replies: &Replies, time: f64) {
        while self.empty.front().is_some_and(|&(_, seen)| time - seen > FRESH) {
            self.empty.pop_front();
        }
        for (edge, seen, ticket) in self.asked.drain(..) {
            if replies.get(ticket).is_ok_and(|count| count == 0) {
                self.empty.retain(|&(e, _)| e != edge);
                self.empty.push_back((edge, seen));
            }
        }
    }

    /// Whether to query another edge.
    pub fn wants_more(&self) -> bool {
        self.empty.len() + self.asked.len() < ENOUGH && self.asked.len() < PER_TICK
    }

    /// Asks about an edge at `time` (s).
    pub fn ask(&mut self, network: &Network, edge: EdgeId, time: f64, batch: &mut Batch) {
        let ticket = batch.get(edge::LAST_STEP_VEHICLE_NUMBER, &network.edge(edge).id);
        self.asked.push((edge, time, ticket));
    }

    /// Edges seen empty, the last seen first, with the time (s).
    pub fn fresh(&self, time: f64) -> Vec<(EdgeId, f64)> {
        let usable = |&&(edge, seen): &&(EdgeId, f64)| time - seen <= FRESH && !self.is_used(edge, time);
        self.empty.iter().rev().filter(usable).copied().collect()
    }

    /// Notes that a vehicle was added on an edge.
    pub fn used(&mut self, edge: EdgeId, time: f64) {
        self.used[edge.index()] = time;
    }

    /// Whether a vehicle was added there recently.
    pub fn is_used(&self, edge: EdgeId, time: f64) -> bool {
        time - self.used[edge.index()] < REST
    }
}
