//! The town's chunks by place, so that a frame's cost does not grow with the town.

use std::collections::HashMap;
use std::sync::atomic::{AtomicU64, Ordering};

/// Width of a cell (m).
const CELL: f64 = 64.0;

/// Chunk numbers by cell of a horizontal grid.
#[derive(Clone, Debug, Default)]
pub struct Grid {
    cells: HashMap<(i32, i32), Vec<u32>>,
    stamp: u64,
}

fn cell(x: f64) -> i32 {
    (x / CELL).floor() as i32
}

impl Grid {
    /// The grid of chunks by their middles (m, world), in order.
    pub fn new(middles: impl Iterator<Item = [f64; 2]>) -> Self {
        let mut cells: HashMap<(i32, i32), Vec<u32>> = HashMap::new();
        for (number, [x, y]) in middles.enumerate() {
            // Each chunk stands in one cell, its middle's; queries are widened by half a cell.
            cells.entry((cell(x), cell(y))).or_default().push(number as u32);
        }
        static STAMPS: AtomicU64 = AtomicU64::new(1);
        Self { cells, stamp: STAMPS.fetch_add(1, Ordering::Relaxed) }
    }

    /// Differs from every other grid's of this process: what was derived from one is void for another.
    pub fn stamp(&self) -> u64 {
        self.stamp
    }

    /// Appends the numbers of the chunks within about `radius` (m) of a point, in a fixed order.
    pub fn near(&self, x: f64, y: f64, radius: f64, found: &mut Vec<u32>) {
        let reach = radius + CELL;
        for cx in cell(x - reach)..=cell(x + reach) {
            for cy in cell(y - reach)..=cell(y + reach) {
                if let Some(numbers) = self.cells.get(&(cx, cy)) {
                    found.extend_from_slice(numbers);
                }
            }
        }
    }
}
