//! The probabilistic Hough transformation (Matas, Galambos, Kittler, 2000). The lines equal those of OpenCV 4's
//! `HoughLinesP` with steps of a pixel and a degree, in the same order; a test holds it to that.

/// Angles, a degree apart.
const ANGLES: usize = 180;
/// Bits behind the point of places on a line.
const SHIFT: u32 = 16;

/// Which lines count.
#[derive(Clone, Copy, Debug)]
pub struct Wanted {
    /// Votes of a line, at least.
    pub votes: i16,
    /// Its extent in x or y, at least (pixels).
    pub length: i32,
    /// Its largest gap (pixels).
    pub gap: i32,
}

/// Finds lines; keeps its buffers.
#[derive(Debug)]
pub struct Hough {
    /// Cosine and sine of the angles.
    turns: Vec<[f32; 2]>,
    /// Votes by angle and distance.
    votes: Vec<i16>,
    /// The edges that are not yet part of a line.
    left: Vec<bool>,
    /// The edges in the order in which they are drawn: x and y.
    drawn: Vec<[i32; 2]>,
}

impl Default for Hough {
    fn default() -> Self {
        let turns = (0..ANGLES).map(|n| {
            let angle = n as f64 * (std::f64::consts::PI / 180.0);
            [angle.cos() as f32, angle.sin() as f32]
        });
        Self { turns: turns.collect(), votes: Vec::new(), left: Vec::new(), drawn: Vec::new() }
    }
}

impl Hough {
    /// The lines in a picture of edges (not 0), from end to end: x, y, x, y (pixels).
    pub fn find(&mut self, edges: &[u8], width: usize, wanted: Wanted, lines: &mut Vec<[i32; 4]>) {
        lines.clear();
        let height = edges.len() / width.max(1);
        let distances = 2 * (width + height) + 1;
        self.votes.clear();
        self.votes.resize(ANGLES * distances, 0);
        self.left.clear();
        self.left.extend(edges.iter().map(|edge| *edge != 0));
        self.drawn.clear();
        let places = self.left.iter().enumerate().filter(|(_, left)| **left);
        self.drawn.extend(places.map(|(at, _)| [(at % width) as i32, (at / width) as i32]));
        let mut draws = Draws(u64::MAX);
        while !self.drawn.is_empty() {
            let place = self.drawn.swap_remove(draws.below(self.drawn.len()));
            if !self.left[place[1] as usize * width + place[0] as usize] {
                continue;
            }
            let (mut most, mut angle) = (wanted.votes - 1, 0);
            for (n, (turn, votes)) in
                self.turns.iter().zip(self.votes.chunks_exact_mut(distances)).enumerate()
            {
                let vote = &mut votes[distance(place, *turn, distances)];
                *vote += 1;
                if *vote > most {
                    (most, angle) = (*vote, n);
                }
            }
            if most < wanted.votes {
                continue;
            }
            lines.extend(self.take_line(place, angle, (width, height), wanted));
        }
    }

    /// Takes the edges on the line through `place`, both ways until a gap is too large; the line if it is long
    /// enough.
    fn take_line(
        &mut self,
        place: [i32; 2],
        angle: usize,
        (width, height): (usize, usize),
        wanted: Wanted,
    ) -> Option<[i32; 4]> {
        let distances = 2 * (width + height) + 1;
        let walk = Walk::new(place, self.turns[angle]);
        let index = |[x, y]: [i32; 2]| {
            let inside = (0..width as i32).contains(&x) && (0..height as i32).contains(&y);
            inside.then(|| y as usize * width + x as usize)
        };
        let ends = [1, -1].map(|way| {
            let (mut end, mut gap) = (place, 0);
            for at in walk.towards(way) {
                let Some(index) = index(at) else { break };
                if self.left[index] {
                    (end, gap) = (at, 0);
                } else {
                    gap += 1;
                    if gap > wanted.gap {
                        break;
                    }
                }
            }
            end
        });
        let [[x0, y0], [x1, y1]] = ends;
        let is_long = (x1 - x0).abs() >= wanted.length || (y1 - y0).abs() >= wanted.length;
        for (way, end) in [1, -1].into_iter().zip(ends) {
            for at in walk.towards(way) {
                let Some(index) = index(at) else { break };
                if std::mem::take(&mut self.left[index]) && is_long {
                    for (turn, votes) in self.turns.iter().zip(self.votes.chunks_exact_mut(distances)) {
                        votes[distance(at, *turn, distances)] -= 1;
                    }
                }
                if at == end {
                    break;
                }
            }
        }
        is_long.then_some([x0, y0, x1, y1])
    }
}

/// The index of a line's distance from the picture's corner.
fn distance([x, y]: [i32; 2], [cos, sin]: [f32; 2], distances: usize) -> usize {
    // To the nearest integer, ties to even: the sum's last bits are the integer.
    const ROUND: f32 = 12_582_912.0;
    let rounded = (x as f32 * cos + y as f32 * sin + ROUND).to_bits() as i32 - ROUND.to_bits() as i32;
    (rounded + (distances as i32 - 1) / 2) as usize
}

/// Pixels along a line: one more in x or in y each time.
struct Walk {
    /// Along x each pixel has its column, and its row in fixed point; else the other way round.
    is_along_x: bool,
    begin: [i32; 2],
    step: [i32; 2],
}

impl Walk {
    fn new([x, y]: [i32; 2], [cos, sin]: [f32; 2]) -> Self {
        let (a, b) = (-sin, cos);
        let slope =
            |part: f32, whole: f32| (part * (1 << SHIFT) as f32 / whole.abs()).round_ties_even() as i32;
        let fixed = |number: i32| (number << SHIFT) + (1 << (SHIFT - 1));
        let sign = |number: f32| if number > 0.0 { 1 } else { -1 };
        if a.abs() > b.abs() {
            Self { is_along_x: true, begin: [x, fixed(y)], step: [sign(a), slope(b, a)] }
        } else {
            Self { is_along_x: false, begin: [fixed(x), y], step: [slope(a, b), sign(b)] }
        }
    }

    fn towards(&self, way: i32) -> impl Iterator<Item = [i32; 2]> {
        let (is_along_x, [x, y], [dx, dy]) = (self.is_along_x, self.begin, self.step);
        (0..).map(move |n| {
            let [x, y] = [x + n * way * dx, y + n * way * dy];
            if is_along_x { [x, y >> SHIFT] } else { [x >> SHIFT, y] }
        })
    }
}

/// OpenCV's random numbers (multiply with carry).
struct Draws(u64);

impl Draws {
    fn below(&mut self, count: usize) -> usize {
        self.0 = (self.0 & 0xffff_ffff) * 4_164_903_690 + (self.0 >> 32);
        (self.0 as u32 as usize) % count
    }
}
