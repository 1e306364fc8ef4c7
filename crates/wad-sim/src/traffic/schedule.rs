//! When to check which member: a queue of due times, so that a quiet tick sends SUMO no query.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Due times of members, each known by its slot and its serial number.
#[derive(Debug, Default)]
pub(super) struct Schedule {
    queue: BinaryHeap<Reverse<(u64, usize, u64)>>,
}

impl Schedule {
    /// Looks at the member in `slot` with number `serial` at `time` (s).
    pub fn at(&mut self, time: f64, slot: usize, serial: u64) {
        self.queue.push(Reverse(((time.max(0.0) * 1000.0) as u64, slot, serial)));
    }

    /// The next slot and serial due at `time` (s), in the order of their times.
    pub fn due(&mut self, time: f64) -> Option<(usize, u64)> {
        let &Reverse((at, slot, serial)) = self.queue.peek()?;
        if at as f64 > time * 1000.0 {
            return None;
        }
        self.queue.pop();
        Some((slot, serial))
    }
}
