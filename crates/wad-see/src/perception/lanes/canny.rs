//! Canny's edges. The result equals OpenCV 4's `Canny` with an aperture of 3 and the L1 gradient, pixel by pixel;
//! a test holds it to that.

/// Finds edges; keeps its buffers.
#[derive(Debug, Default)]
pub struct Canny {
    /// Gradients of a pixel: to the right, and down.
    gradients: Vec<[i16; 2]>,
    /// Their length |right| + |down|, with a border of zeros of one pixel.
    lengths: Vec<i16>,
    /// [`NONE`], [`WEAK`] or [`STRONG`], with the same border.
    marks: Vec<u8>,
    /// Three rows of the picture summed, and their difference, with the outermost pixels repeated.
    sums: Vec<i16>,
    differences: Vec<i16>,
    /// Strong pixels whose neighbours are still to be looked at.
    open: Vec<usize>,
}

const NONE: u8 = 0;
const WEAK: u8 = 1;
const STRONG: u8 = 255;
/// Tangent of 22.5 degrees, times 2^15.
const TANGENT: i32 = 13_573;

impl Canny {
    /// The edges of a grey picture: 255 on an edge, 0 elsewhere. An edge's pixels have a gradient above `weak`
    /// and hang together with one above `strong`.
    pub fn find(&mut self, grey: &[u8], width: usize, [weak, strong]: [i16; 2], edges: &mut Vec<u8>) {
        edges.clear();
        edges.resize(grey.len(), 0);
        let height = grey.len() / width.max(1);
        if height == 0 {
            return;
        }
        self.find_gradients(grey, width, height);
        self.thin(width, height, [weak, strong]);
        let stride = width + 2;
        while let Some(at) = self.open.pop() {
            for row in [at - stride, at, at + stride] {
                for beside in row - 1..=row + 1 {
                    if self.marks[beside] == WEAK {
                        self.marks[beside] = STRONG;
                        self.open.push(beside);
                    }
                }
            }
        }
        for (edges, marks) in edges.chunks_exact_mut(width).zip(self.marks[stride..].chunks_exact(stride)) {
            for (edge, mark) in edges.iter_mut().zip(&marks[1..]) {
                *edge = if *mark == STRONG { STRONG } else { 0 };
            }
        }
    }

    /// Sobel's 3 x 3 kernels.
    fn find_gradients(&mut self, grey: &[u8], width: usize, height: usize) {
        let stride = width + 2;
        self.gradients.clear();
        self.gradients.resize(width * height, [0; 2]);
        self.lengths.clear();
        self.lengths.resize(stride * (height + 2), 0);
        self.sums.resize(stride, 0);
        self.differences.resize(stride, 0);
        let row = |y: usize| &grey[y * width..][..width];
        for y in 0..height {
            let rows = row(y.saturating_sub(1)).iter().zip(row(y)).zip(row((y + 1).min(height - 1)));
            let both = self.sums[1..].iter_mut().zip(&mut self.differences[1..]);
            for ((sum, difference), ((above, here), below)) in both.zip(rows) {
                let (above, here, below) = (i16::from(*above), i16::from(*here), i16::from(*below));
                *sum = above + 2 * here + below;
                *difference = below - above;
            }
            for line in [&mut self.sums, &mut self.differences] {
                (line[0], line[width + 1]) = (line[1], line[width]);
            }
            let gradients = &mut self.gradients[y * width..][..width];
            let lengths = &mut self.lengths[(y + 1) * stride + 1..][..width];
            let pairs = self.sums.windows(3).zip(self.differences.windows(3));
            for ((gradient, length), (s, d)) in gradients.iter_mut().zip(lengths).zip(pairs) {
                *gradient = [s[2] - s[0], d[0] + 2 * d[1] + d[2]];
                *length = gradient[0].abs() + gradient[1].abs();
            }
        }
    }

    /// Marks the pixels that are no shorter than their two neighbours across the edge.
    fn thin(&mut self, width: usize, height: usize, [weak, strong]: [i16; 2]) {
        let stride = width + 2;
        self.marks.clear();
        self.marks.resize(stride * (height + 2), NONE);
        self.open.clear();
        for y in 0..height {
            for x in 0..width {
                let at = (y + 1) * stride + x + 1;
                let length = self.lengths[at];
                if length <= weak {
                    continue;
                }
                let [right, down] = self.gradients[y * width + x];
                let (across, along) = (i32::from(right.abs()), i32::from(down.abs()) << 15);
                let least = across * TANGENT;
                let is_top = if along < least {
                    length > self.lengths[at - 1] && length >= self.lengths[at + 1]
                } else if along > least + (across << 16) {
                    length > self.lengths[at - stride] && length >= self.lengths[at + stride]
                } else {
                    let (before, after) = match (right < 0) != (down < 0) {
                        true => (at - stride + 1, at + stride - 1),
                        false => (at - stride - 1, at + stride + 1),
                    };
                    length > self.lengths[before] && length > self.lengths[after]
                };
                if is_top {
                    self.marks[at] = if length > strong { STRONG } else { WEAK };
                    if length > strong {
                        self.open.push(at);
                    }
                }
            }
        }
    }
}
