//! What of a picture is road.

use serde::{Deserialize, Serialize};
use wad_camera::Frame;
use wad_camera::model::SemanticTag;

/// Pixels of the picture per cell.
pub const CELL: usize = 8;
/// Columns and rows of cells: the rows begin at the horizon, [`HORIZON`].
pub const COLUMNS: usize = 64;
/// See [`COLUMNS`].
pub const ROWS: usize = 20;
/// The picture's row of the horizon.
pub const HORIZON: usize = 256;

/// The drivable area (as in BDD100K, Yu et al. 2020): what of the camera's picture is road for vehicles and free of what stands on it.
/// 20 rows of cells from the horizon down, each 64 cells of 8x8 pixels; bit 0 of a row is its leftmost cell.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct DrivableArea(pub [u64; ROWS]);

impl DrivableArea {
    /// By `is_road` of each cell, row by row.
    pub fn new(mut is_road: impl FnMut(usize, usize) -> bool) -> Self {
        let row = |row| (0..COLUMNS).map(|column| u64::from(is_road(row, column)) << column).sum();
        Self(std::array::from_fn(row))
    }

    /// The truth: cells of which at least half the pixels are road or its paint. None where the frame has no semantics, or another
    /// size than 512x512.
    pub fn of(frame: &Frame) -> Option<Self> {
        let (width, height) = (COLUMNS * CELL, 2 * HORIZON);
        if (frame.width, frame.height, frame.semantic.len()) != (width, height, width * height) {
            return None;
        }
        let is_road = |tag: &&u8| [SemanticTag::Road as u8, SemanticTag::RoadLine as u8].contains(tag);
        let road = |row: usize, column: usize| {
            let rows = (0..CELL).map(|y| (HORIZON + row * CELL + y) * width + column * CELL);
            rows.map(|start| frame.semantic[start..][..CELL].iter().filter(is_road).count()).sum::<usize>()
        };
        Some(Self::new(|row, column| 2 * road(row, column) >= CELL * CELL))
    }

    /// Whether a cell is road.
    pub fn has(&self, row: usize, column: usize) -> bool {
        self.0[row] >> column & 1 == 1
    }

    /// The stretches of road, row by row: left, top, right, bottom (pixels; right and bottom exclusive).
    pub fn stretches(&self) -> impl Iterator<Item = [usize; 4]> {
        self.0.iter().enumerate().flat_map(|(row, cells)| {
            let top = HORIZON + row * CELL;
            let mut column = 0;
            std::iter::from_fn(move || {
                // Bits from this column on; then the first that is road, and how many follow it.
                let rest = cells.checked_shr(column).filter(|rest| *rest != 0)?;
                let left = column + rest.trailing_zeros();
                column = left + (cells >> left).trailing_ones();
                let [left, right] = [left, column].map(|side| side as usize * CELL);
                Some([left, top, right, top + CELL])
            })
        })
    }

    /// The share of road in the middle of a box (left, top, right, bottom, pixels) below the horizon: three fifths of its breadth,
    /// cells whose middle lies there. 0 where there are none.
    pub fn share_within(&self, [left, top, right, bottom]: [f32; 4]) -> f32 {
        let middle = |cell: usize| (cell as f32 + 0.5) * CELL as f32;
        let side = 0.2 * (right - left);
        let within = Self::new(|row, column| {
            (top..bottom).contains(&(HORIZON as f32 + middle(row)))
                && (left + side..right - side).contains(&middle(column))
        });
        let ((road, _), (all, _)) = (self.overlap(&within), within.overlap(&within));
        road as f32 / all.max(1) as f32
    }

    /// Of the cells that are road in either, how many are in both.
    pub fn overlap(&self, other: &Self) -> (usize, usize) {
        let count = |join: fn(u64, u64) -> u64| {
            self.0.iter().zip(other.0).map(|(a, b)| join(*a, b).count_ones() as usize).sum()
        };
        (count(|a, b| a & b), count(|a, b| a | b))
    }

    /// The same in a mirror.
    #[must_use]
    pub fn mirrored(&self) -> Self {
        Self(self.0.map(u64::reverse_bits))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_box_is_looked_at_in_its_middle_below_the_horizon() {
        // Road right of column 32 and below row 10.
        let area = DrivableArea::new(|row, column| row >= 10 && column >= 32);
        let [horizon, cell] = [HORIZON as f32, CELL as f32];
        let share = |columns: [f32; 2], rows: [f32; 2]| {
            area.share_within([
                columns[0] * cell,
                horizon + rows[0] * cell,
                columns[1] * cell,
                horizon + rows[1] * cell,
            ])
        };
        assert_eq!(share([40.0, 50.0], [12.0, 18.0]), 1.0);
        assert_eq!(share([40.0, 50.0], [2.0, 18.0]), 0.5);
        assert_eq!(share([27.0, 37.0], [12.0, 18.0]), 0.5);
        // Its outer fifths do not count, nor what is above the horizon.
        assert_eq!(share([30.0, 40.0], [12.0, 18.0]), 1.0);
        assert_eq!(share([40.0, 50.0], [-20.0, 20.0]), 0.5);
        assert_eq!(share([40.0, 50.0], [-20.0, -10.0]), 0.0);
    }

    #[test]
    fn a_cell_is_road_if_half_of_its_pixels_are() {
        let (width, height) = (512, 512);
        let mut frame = Frame {
            width,
            height,
            semantic: vec![SemanticTag::Terrain as u8; width * height],
            ..Frame::default()
        };
        for (y, x, tag) in [(256, 0, SemanticTag::Road), (264, 16, SemanticTag::RoadLine)] {
            // Four of a cell's eight rows, then one pixel less.
            for (row, long) in [(0, 8), (1, 8), (2, 8), (3, if y == 256 { 8 } else { 7 })] {
                frame.semantic[(y + row) * width + x..][..long].fill(tag as u8);
            }
        }
        let area = DrivableArea::of(&frame).unwrap();
        assert_eq!(area, DrivableArea::new(|row, column| (row, column) == (0, 0)));
        assert!(area.has(0, 0) && !area.has(1, 2));
        assert_eq!(area.mirrored(), DrivableArea::new(|row, column| (row, column) == (0, 63)));
        frame.semantic.clear();
        assert_eq!(DrivableArea::of(&frame), None);
    }

    #[test]
    fn stretches_are_all_of_the_road_and_nothing_else() {
        let area = DrivableArea::new(|row, column| match row {
            0 => column < 3 || column == 63,
            7 => (10..20).contains(&column),
            19 => true,
            _ => false,
        });
        let found: Vec<[usize; 4]> = area.stretches().collect();
        let rows = [[0, 256, 24, 264], [504, 256, 512, 264], [80, 312, 160, 320], [0, 408, 512, 416]];
        assert_eq!(found, rows);
        assert_eq!(DrivableArea::default().stretches().count(), 0);
    }

    #[test]
    fn overlap_counts_cells_in_both_and_in_either() {
        let [a, b] = [3, 5].map(|end| DrivableArea::new(|row, column| row == 2 && column < end));
        assert_eq!((a.overlap(&b), b.overlap(&a)), ((3, 5), (3, 5)));
    }
}
