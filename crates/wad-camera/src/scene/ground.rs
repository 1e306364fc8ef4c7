//! The use and the height of the ground, as a raster of half-metre cells.

use super::polygon::{cleaned, turn};
use std::collections::HashMap;
use sumo_network::geometry::{Point, Vector, polygon_contains};
use sumo_network::network::{EdgeKind, Network};

/// Width of a cell (m).
const CELL: f64 = 0.5;
/// Cells along the side of a block.
const BLOCK: i32 = 64;

/// What a cell holds (bits).
pub(super) mod uses {
    /// A lane of any kind, a junction, a crossing, a walkingarea.
    pub const WAY: u16 = 1;
    pub const BUILDING: u16 = 2;
    /// Something that stands there.
    pub const OBJECT: u16 = 4;
    pub const WATER: u16 = 8;
    pub const PARK: u16 = 16;
    pub const PAVED: u16 = 32;
    /// Sidewalks and walkingareas that lie a kerb higher than the road.
    pub const RAISED: u16 = 64;
    pub const CROSSING: u16 = 128;
    /// The middle of lanes that vehicles use, inside junctions too.
    pub const DRIVEN: u16 = 256;
}

/// Which cells are in use.
#[derive(Default)]
pub(super) struct Ground {
    blocks: HashMap<(i32, i32), Box<[u16]>>,
}

impl Ground {
    /// All ways of a network.
    pub fn of_ways(network: &Network) -> Self {
        let mut ground = Self::default();
        for lane in &network.lanes {
            let points = lane.shape.points();
            if network.edge(lane.edge).kind == EdgeKind::WalkingArea {
                let outline: Vec<Point> = points.iter().map(|p| p.xy()).collect();
                ground.fill(&outline, uses::WAY);
                continue;
            }
            for pair in points.windows(2) {
                ground.fill_strip(pair[0].xy(), pair[1].xy(), 0.5 * lane.width, uses::WAY);
            }
        }
        for junction in &network.junctions {
            ground.fill(&junction.shape, uses::WAY);
        }
        for crossing in &network.crossings {
            ground.fill(&crossing.outline, uses::WAY);
        }
        ground
    }

    /// Marks a straight strip and a little beyond its ends.
    pub fn fill_strip(&mut self, a: Point, b: Point, half: f64, bits: u16) {
        let d = b - a;
        let length = d.norm();
        if length > 1e-6 && length < 1e6 {
            let (along, across) = (d * (0.3 / length), Vector::new(-d.y, d.x) * (half / length));
            let (a, b) = (a - along, b + along);
            self.fill(&[a - across, b - across, b + across, a + across], bits);
        }
    }

    /// Marks every cell that a polygon touches, about.
    pub fn fill(&mut self, outline: &[Point], bits: u16) {
        let outline = cleaned(outline);
        if outline.is_empty() {
            return;
        }
        let n = outline.len();
        // The border, so that slivers count too.
        for i in 0..n {
            let (a, b) = (outline[i], outline[(i + 1) % n]);
            let steps = ((b - a).norm() / (0.5 * CELL)).ceil().min(1e5) as usize;
            for k in 0..=steps {
                let p = a + (b - a) * (k as f64 / steps.max(1) as f64);
                *self.cell(p.x, p.y) |= bits;
            }
        }
        let (lo, hi) =
            outline.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), p| (lo.min(p.y), hi.max(p.y)));
        let mut row = (lo / CELL).floor();
        while row * CELL <= hi {
            let y = (row + 0.5) * CELL;
            let mut cuts: Vec<f64> = (0..n)
                .filter_map(|i| {
                    let (a, b) = (outline[i], outline[(i + 1) % n]);
                    ((a.y > y) != (b.y > y)).then(|| a.x + (y - a.y) / (b.y - a.y) * (b.x - a.x))
                })
                .collect();
            cuts.sort_by(f64::total_cmp);
            for pair in cuts.chunks_exact(2) {
                let mut x = (pair[0] / CELL).floor() * CELL + 0.5 * CELL;
                while x <= pair[1] {
                    *self.cell(x, y) |= bits;
                    x += CELL;
                }
            }
            row += 1.0;
        }
    }

    fn key(x: f64, y: f64) -> ((i32, i32), usize) {
        let (cx, cy) = ((x / CELL).floor() as i32, (y / CELL).floor() as i32);
        let block = (cx.div_euclid(BLOCK), cy.div_euclid(BLOCK));
        (block, (cy.rem_euclid(BLOCK) * BLOCK + cx.rem_euclid(BLOCK)) as usize)
    }

    fn cell(&mut self, x: f64, y: f64) -> &mut u16 {
        let (block, index) = Self::key(x, y);
        &mut self.blocks.entry(block).or_insert_with(|| vec![0; (BLOCK * BLOCK) as usize].into())[index]
    }

    /// What the cell under a point holds.
    pub fn at(&self, p: Point) -> u16 {
        let (block, index) = Self::key(p.x, p.y);
        self.blocks.get(&block).map_or(0, |cells| cells[index])
    }

    /// Whether a disc is free of `bits`.
    pub fn disc_free(&self, centre: Point, radius: f64, bits: u16) -> bool {
        let steps = (radius / CELL).ceil() as i32 + 1;
        for i in -steps..=steps {
            for j in -steps..=steps {
                let d = Vector::new(f64::from(i), f64::from(j)) * CELL;
                if d.norm() <= radius + 0.71 * CELL && self.at(centre + d) & bits != 0 {
                    return false;
                }
            }
        }
        true
    }

    /// Whether a convex, counter-clockwise polygon is free of `bits`.
    pub fn convex_free(&self, outline: &[Point], bits: u16) -> bool {
        let n = outline.len();
        let lo = outline.iter().fold(outline[0], |a, p| Point::new(a.x.min(p.x), a.y.min(p.y)));
        let hi = outline.iter().fold(outline[0], |a, p| Point::new(a.x.max(p.x), a.y.max(p.y)));
        let mut y = lo.y - 0.25;
        while y <= hi.y + 0.25 {
            let mut x = lo.x - 0.25;
            while x <= hi.x + 0.25 {
                let p = Point::new(x, y);
                let near = |i: usize| {
                    let (a, b) = (outline[i], outline[(i + 1) % n]);
                    turn(a, b, p) >= -0.3 * (b - a).norm()
                };
                if self.at(p) & bits != 0 && (0..n).all(near) {
                    return false;
                }
                x += 0.45;
            }
            y += 0.45;
        }
        true
    }

    /// How many cells well inside a polygon hold `bits`.
    pub fn inner_count(&self, outline: &[Point], bits: u16) -> usize {
        let n = outline.len();
        let (mut lo, mut hi) =
            (Point::new(f64::INFINITY, f64::INFINITY), Point::new(f64::NEG_INFINITY, f64::NEG_INFINITY));
        for p in outline {
            lo = Point::new(lo.x.min(p.x), lo.y.min(p.y));
            hi = Point::new(hi.x.max(p.x), hi.y.max(p.y));
        }
        let mut count = 0;
        let mut y = (lo.y / CELL).floor() * CELL + 0.5 * CELL;
        while y <= hi.y {
            let mut x = (lo.x / CELL).floor() * CELL + 0.5 * CELL;
            while x <= hi.x {
                let p = Point::new(x, y);
                if self.at(p) & bits != 0 && polygon_contains(outline, p) {
                    let clear = (0..n).all(|i| {
                        let (a, b) = (outline[i], outline[(i + 1) % n]);
                        let t = ((p - a).dot(&(b - a)) / (b - a).norm_squared()).clamp(0.0, 1.0);
                        (p - (a + (b - a) * t)).norm() > 0.4
                    });
                    count += usize::from(clear);
                }
                x += CELL;
            }
            y += CELL;
        }
        count
    }

    /// Whether any polygon's inside and border are free of `bits`.
    pub fn polygon_free(&self, outline: &[Point], bits: u16) -> bool {
        let mut probe = Self::default();
        probe.fill(outline, 1);
        probe.blocks.iter().all(|(block, cells)| {
            let Some(own) = self.blocks.get(block) else { return true };
            cells.iter().zip(own.iter()).all(|(&wanted, &held)| wanted == 0 || held & bits == 0)
        })
    }
}

/// Height of the terrain (m): 0 everywhere in a flat net, else a grid through the lanes.
pub(super) struct Terrain {
    heights: HashMap<(i32, i32), f64>,
    pub low: f64,
    pub flat: bool,
}

/// Width of the terrain's grid (m).
pub(super) const TERRAIN_CELL: f64 = 16.0;

impl Terrain {
    pub fn of(network: &Network) -> Self {
        let points = || network.lanes.iter().flat_map(|l| l.shape.points()).filter(|p| p.z.is_finite());
        let low = points().map(|p| p.z).fold(f64::INFINITY, f64::min);
        let high = points().map(|p| p.z).fold(f64::NEG_INFINITY, f64::max);
        let low = if low.is_finite() { low } else { 0.0 };
        let flat = high - low < 0.05 || !high.is_finite();
        let mut heights: HashMap<(i32, i32), f64> = HashMap::new();
        if !flat {
            for lane in &network.lanes {
                for pair in lane.shape.points().windows(2) {
                    let steps = ((pair[1] - pair[0]).norm() / 8.0).ceil().clamp(1.0, 1e4) as usize;
                    for k in 0..=steps {
                        let p = pair[0] + (pair[1] - pair[0]) * (k as f64 / steps as f64);
                        let (i, j) =
                            ((p.x / TERRAIN_CELL).floor() as i32, (p.y / TERRAIN_CELL).floor() as i32);
                        for node in [(i, j), (i + 1, j), (i, j + 1), (i + 1, j + 1)] {
                            let h = heights.entry(node).or_insert(f64::INFINITY);
                            *h = h.min(p.z);
                        }
                    }
                }
            }
            Self::spread(&mut heights, 8);
        }
        Self { heights, low, flat }
    }

    /// Carries heights outwards by `rings` cells, each the mean of its known neighbours.
    fn spread(heights: &mut HashMap<(i32, i32), f64>, rings: usize) {
        for _ in 0..rings {
            let mut next: std::collections::BTreeMap<(i32, i32), (f64, f64)> = Default::default();
            let mut known: Vec<(&(i32, i32), &f64)> = heights.iter().collect();
            known.sort_by_key(|(k, _)| **k);
            for (&(i, j), &h) in known {
                for node in [(i - 1, j), (i + 1, j), (i, j - 1), (i, j + 1)] {
                    if !heights.contains_key(&node) {
                        let (sum, n) = next.entry(node).or_default();
                        *sum += h;
                        *n += 1.0;
                    }
                }
            }
            heights.extend(next.into_iter().map(|(node, (sum, n))| (node, sum / n)));
        }
    }

    /// Height of a grid node (m), where the grid reaches.
    pub fn node(&self, i: i32, j: i32) -> Option<f64> {
        self.heights.get(&(i, j)).copied()
    }

    /// The cells of the grid that have four nodes, in a fixed order.
    pub fn cells(&self) -> Vec<(i32, i32)> {
        let mut cells: Vec<(i32, i32)> = self
            .heights
            .keys()
            .copied()
            .filter(|&(i, j)| {
                [(i + 1, j), (i, j + 1), (i + 1, j + 1)].iter().all(|n| self.heights.contains_key(n))
            })
            .collect();
        cells.sort_unstable();
        cells
    }

    /// Height at a point (m).
    pub fn at(&self, p: Point) -> f64 {
        if self.flat {
            return self.low;
        }
        let (x, y) = (p.x / TERRAIN_CELL, p.y / TERRAIN_CELL);
        let (i, j) = (x.floor() as i32, y.floor() as i32);
        let (u, v) = (x - f64::from(i), y - f64::from(j));
        let node = |i, j| self.node(i, j).unwrap_or(self.low);
        let lower = node(i, j) * (1.0 - u) + node(i + 1, j) * u;
        let upper = node(i, j + 1) * (1.0 - u) + node(i + 1, j + 1) * u;
        lower * (1.0 - v) + upper * v
    }
}
