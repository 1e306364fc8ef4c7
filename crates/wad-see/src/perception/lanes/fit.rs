//! From pieces of lines on the ground to the ego lane's two boundaries.
//!
//! All boundaries of a road share slope and bend, so each choice of the two sorts the pieces by the
//! offset at which they meet the ego's side; the choice with the highest peaks in the histogram of offsets
//! wins. The peaks next to the ego on either side are its lane's boundaries. Least squares over the stripes'
//! pixels give the parameters.

use super::{LaneBoundary, Pieces};

/// Bends that are tried (1/m).
const BENDS: [f32; 11] = [0.0, 0.004, -0.004, 0.01, -0.01, 0.02, -0.02, 0.035, -0.035, 0.055, -0.055];
/// Pieces steeper than this to the ego (tangent) are not part of a boundary.
const STEEPEST: f32 = 0.6;
/// Piles: their breadth (m), and how far to the sides they reach (m).
const BIN: f32 = 0.1;
const ASIDE: f32 = 4.0;
const BINS: usize = (2.0 * ASIDE / BIN) as usize;
/// What a pile needs to be a line: metres of pieces, and metres of road that they cover.
const LEAST_PILE: f32 = 2.0;
const LEAST_COVER: f32 = 2.0;
/// Where the lane's boundaries may be beside the ego (m), and how broad a lane is.
const NEAREST: f32 = 0.25;
const FARTHEST: f32 = 3.4;
const BREADTH: [f32; 2] = [2.2, 4.8];

/// A piece prepared for voting.
struct Piece {
    from: [f32; 2],
    to: [f32; 2],
    /// Tangent of its direction.
    slope: f32,
    weight: f32,
}

impl Piece {
    fn middle(&self) -> [f32; 2] {
        [0.5 * (self.from[0] + self.to[0]), 0.5 * (self.from[1] + self.to[1])]
    }
}

/// Shared shape of all lines.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Course {
    pub slope: f32,
    pub bend: f32,
}

impl Course {
    fn offset_of(&self, [x, y]: [f32; 2]) -> f32 {
        y - x * (self.slope + 0.5 * x * self.bend)
    }
}

/// Finds boundaries; keeps its buffers.
#[derive(Debug, Default)]
pub struct Fitter {
    piles: Vec<f32>,
}

impl Fitter {
    /// Left and right boundary. `expected` is the course that the last tick leads to expect.
    pub fn fit(&mut self, pieces: &Pieces, expected: Option<Course>, near: f32) -> [Option<LaneBoundary>; 2] {
        let prepared: Vec<Piece> = pieces.segments.iter().filter_map(prepare).collect();
        let Some(course) = self.course(&prepared, expected) else { return [None; 2] };
        self.pile_up(&prepared, course);
        let [left, right] = self.sides(&prepared, course);
        refine(pieces, course, [left, right], near)
    }

    /// The course that piles the pieces up highest.
    fn course(&mut self, pieces: &[Piece], expected: Option<Course>) -> Option<Course> {
        let mut longest: Vec<&Piece> = pieces.iter().collect();
        longest.sort_by(|a, b| b.weight.total_cmp(&a.weight));
        let mut best: Option<(f32, Course)> = None;
        let mut consider = |fitter: &mut Self, course: Course, favour: f32| {
            let score = fitter.pile_up(pieces, course) * favour;
            if best.is_none_or(|(highest, _)| score > highest) {
                best = Some((score, course));
            }
        };
        if let Some(course) = expected {
            consider(self, course, 1.15);
        }
        for bend in BENDS {
            let favour = 1.0 - 4.0 * bend.abs();
            for piece in longest.iter().take(14) {
                let slope = piece.slope - bend * piece.middle()[0];
                if slope.abs() <= STEEPEST {
                    consider(self, Course { slope, bend }, favour);
                }
            }
        }
        best.filter(|(score, _)| *score > LEAST_PILE).map(|(_, course)| course)
    }

    /// Sorts the pieces into piles by offset; the sum of the piles' squares.
    fn pile_up(&mut self, pieces: &[Piece], course: Course) -> f32 {
        self.piles.clear();
        self.piles.resize(BINS + 1, 0.0);
        for piece in pieces {
            let tangent = course.slope + course.bend * piece.middle()[0];
            if (piece.slope - tangent).abs() > 0.12 {
                continue;
            }
            for point in [piece.from, piece.middle(), piece.to] {
                let at = (course.offset_of(point) + ASIDE) / BIN;
                if at >= 0.0 && at < (BINS - 1) as f32 {
                    let (bin, share) = (at as usize, at.fract());
                    let third = piece.weight / 3.0;
                    self.piles[bin] += third * (1.0 - share);
                    self.piles[bin + 1] += third * share;
                }
            }
        }
        self.piles.iter().map(|pile| pile * pile).sum::<f32>().sqrt()
    }

    /// Offsets of the piles next to the ego on the left and on the right.
    fn sides(&self, pieces: &[Piece], course: Course) -> [Option<f32>; 2] {
        let mut peaks: Vec<f32> = Vec::new();
        for bin in 1..BINS {
            let [a, b, c] = [self.piles[bin - 1], self.piles[bin], self.piles[bin + 1]];
            // A line with its neighbours' share.
            if b >= a && b > c && a + b + c >= LEAST_PILE {
                let offset = (bin as f32 + (c - a) / (a + b + c)) * BIN - ASIDE;
                if cover(pieces, course, offset) >= LEAST_COVER {
                    peaks.push(offset);
                }
            }
        }
        let within = |offset: f32| (NEAREST..FARTHEST).contains(&offset);
        let lefts: Vec<f32> = peaks.iter().copied().filter(|o| within(*o)).collect();
        let rights: Vec<f32> = peaks.iter().rev().copied().filter(|o| within(-*o)).collect();
        let (left, right) = (lefts.first().copied(), rights.first().copied());
        match (left, right) {
            (Some(l), Some(r)) if !(BREADTH[0]..BREADTH[1]).contains(&(l - r)) => {
                // Not both are this lane's: look further out for one, nearest first, else drop the weaker.
                let pairs = lefts.iter().flat_map(|l| rights.iter().map(move |r| (*l, *r)));
                let fitting = pairs.filter(|(l, r)| (BREADTH[0]..BREADTH[1]).contains(&(l - r)));
                match fitting.min_by(|a, b| (a.0 - a.1).total_cmp(&(b.0 - b.1))) {
                    Some((l, r)) => [Some(l), Some(r)],
                    None if self.height(l) >= self.height(r) => [Some(l), None],
                    None => [None, Some(r)],
                }
            }
            both => [both.0, both.1],
        }
    }

    fn height(&self, offset: f32) -> f32 {
        let bin = (((offset + ASIDE) / BIN).round() as usize).clamp(1, BINS - 1);
        self.piles[bin - 1..=bin + 1].iter().sum()
    }
}

fn prepare(&[from, to]: &[[f32; 2]; 2]) -> Option<Piece> {
    let (dx, dy) = (to[0] - from[0], to[1] - from[1]);
    let length = dx.hypot(dy);
    if length < 0.6 || dx <= 0.0 || dy.abs() > STEEPEST * dx {
        return None;
    }
    Some(Piece { from, to, slope: dy / dx, weight: length.min(6.0) })
}

/// Metres of road that the pieces of a line cover.
fn cover(pieces: &[Piece], course: Course, offset: f32) -> f32 {
    let mut spans: Vec<(f32, f32)> = pieces
        .iter()
        .filter(|piece| (course.offset_of(piece.middle()) - offset).abs() < 1.5 * BIN)
        .map(|piece| (piece.from[0], piece.to[0]))
        .collect();
    spans.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (mut covered, mut end) = (0.0, f32::MIN);
    for (from, to) in spans {
        if to > end {
            covered += to - from.max(end);
            end = to;
        }
    }
    covered
}

/// Least squares over the stripes' pixels near the two lines: offsets of their own, slope and bend shared.
fn refine(pieces: &Pieces, course: Course, sides: [Option<f32>; 2], near: f32) -> [Option<LaneBoundary>; 2] {
    let mut found = [None; 2];
    if sides == [None; 2] {
        return found;
    }
    let mut numbers = [sides[0].unwrap_or(0.0), sides[1].unwrap_or(0.0), course.slope, course.bend];
    let mut reach = [f32::MIN; 2];
    for pass in 0..3 {
        let band = [0.3, 0.2, 0.15][pass];
        let mut normal = [[0.0_f64; 4]; 4];
        let mut rhs = [0.0_f64; 4];
        reach = [f32::MIN; 2];
        for &[x, y] in &pieces.stripes {
            let now = Course { slope: numbers[2], bend: numbers[3] };
            let offset = now.offset_of([x, y]);
            for side in 0..2 {
                if sides[side].is_none() || (offset - numbers[side]).abs() > band {
                    continue;
                }
                reach[side] = reach[side].max(x);
                // Far rows show more metres each, and are less sure.
                let weight = f64::from(1.0 / (1.0 + 0.01 * x * x) * x * x);
                let mut row = [0.0, 0.0, f64::from(x), f64::from(0.5 * x * x)];
                row[side] = 1.0;
                for i in 0..4 {
                    rhs[i] += weight * row[i] * f64::from(y);
                    for j in 0..4 {
                        normal[i][j] += weight * row[i] * row[j];
                    }
                }
            }
        }
        // Held to what the voting says where the pixels say little.
        let hold = [1.0, 1.0, 200.0, 2.0e4];
        for i in 0..4 {
            normal[i][i] += hold[i];
            rhs[i] += hold[i] * f64::from(numbers[i]);
        }
        let Some(solved) =
            nalgebra::Matrix4::from(normal).transpose().lu().solve(&nalgebra::Vector4::from(rhs))
        else {
            break;
        };
        for i in 0..4 {
            numbers[i] = solved[i] as f32;
        }
    }
    for side in 0..2 {
        if sides[side].is_some() && reach[side] > near {
            found[side] = Some(LaneBoundary {
                offset: numbers[side],
                slope: numbers[2],
                bend: numbers[3],
                reach: [near.min(3.0), reach[side]],
            });
        }
    }
    found
}
