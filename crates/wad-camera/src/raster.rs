//! Triangles into a visibility buffer: per pixel the nearest triangle's number and 1 / depth.
//!
//! Scanlines with exact edges: two triangles that share an edge compute it from the same numbers, so
//! that no pixel between them is missed or drawn twice. 1 / depth is linear over the picture.

use super::lanes::{Lane, lanes};
use super::large::Large;
use super::mesh::Face;
use super::simd::{first_centre, multiversion};
use super::view::{NEAR, cross, dot, sub};

/// A vertex of the frame: camera frame (m) and picture (pixels; meaningless behind the camera).
#[derive(Clone, Copy, Debug, Default)]
pub struct CamVertex {
    pub p: [f32; 3],
    pub s: [f32; 2],
}

/// A face that touches at least one pixel centre.
#[derive(Clone, Copy, Debug)]
pub struct Tri {
    /// Index into the frame's items, and into its mesh's faces.
    pub item: u32,
    pub face: u32,
}

/// Width of the padding right of each row: blocks of pixels may run over the border.
pub const PAD: usize = 8;

/// The visibility buffer.
#[derive(Debug, Default)]
pub struct Visibility {
    pub width: usize,
    pub height: usize,
    /// Pixels from row to row.
    pub stride: usize,
    /// 1 / depth (1/m); 0 where nothing was drawn.
    pub iz: Large<f32>,
    /// Index of the triangle + 1; 0 where nothing was drawn. Holds after [`settle`] only.
    pub id: Large<u32>,
    /// Smallest 1 / depth of each tile, as of the last [`Visibility::update_tiles`].
    tiles: Vec<f32>,
    tile_columns: usize,
}

/// Pixels along a tile's side.
const TILE: usize = 16;

impl Visibility {
    /// Empties it for a picture of this size.
    pub fn clear(&mut self, width: usize, height: usize) {
        (self.width, self.height, self.stride) = (width, height, width + PAD);
        let size = self.stride * height;
        self.iz.reset(size, 0.0);
        if self.id.len() != size {
            self.id.reset(size, 0);
        }
        self.tile_columns = width.div_ceil(TILE);
        self.tiles.clear();
        self.tiles.resize(self.tile_columns * height.div_ceil(TILE), 0.0);
    }

    /// Learns what now hides what.
    pub fn update_tiles(&mut self) {
        reduce(&self.iz, self.stride, self.width, self.height, &mut self.tiles, self.tile_columns);
    }

    /// Whether all of a rectangle (pixels) is covered by things nearer than `iz` (1/m).
    pub fn hides(&self, low: [f32; 2], high: [f32; 2], iz: f32) -> bool {
        let clamp = |v: f32, limit: usize| (v.max(0.0) as usize).min(limit - 1) / TILE;
        let (x0, x1) = (clamp(low[0], self.width), clamp(high[0], self.width));
        let (y0, y1) = (clamp(low[1], self.height), clamp(high[1], self.height));
        (y0..=y1).all(|y| self.tiles[y * self.tile_columns..][x0..=x1].iter().all(|&tile| tile > iz))
    }
}

multiversion! {
    fn reduce(iz: &[f32], stride: usize, width: usize, height: usize, tiles: &mut [f32], columns: usize) {
        for (row, tiles) in tiles.chunks_exact_mut(columns).enumerate() {
            let rows = row * TILE..((row + 1) * TILE).min(height);
            for (column, tile) in tiles.iter_mut().enumerate() {
                // Covered before: what has come since is rarely in front of that, and never behind it.
                if *tile > 0.0 {
                    continue;
                }
                let x = column * TILE;
                let mut least = [f32::MAX; TILE];
                for y in rows.clone() {
                    let line = &iz[y * stride + x..y * stride + (x + TILE).min(width)];
                    // One pixel that shows nothing yet is enough.
                    if line[0] == 0.0 {
                        least[0] = 0.0;
                        break;
                    }
                    if let Some(block) = line.first_chunk::<TILE>() {
                        for (least, &z) in least.iter_mut().zip(block) {
                            *least = if z < *least { z } else { *least };
                        }
                    } else {
                        for (least, &z) in least.iter_mut().zip(line) {
                            *least = if z < *least { z } else { *least };
                        }
                    }
                }
                *tile = least.iter().fold(f32::MAX, |least, &z| if z < least { z } else { least });
            }
        }
    }
}

/// How a mesh is to be drawn.
pub struct Draw<'a> {
    pub faces: &'a [Face],
    /// The mesh's vertices in this frame.
    pub vertices: &'a [CamVertex],
    /// Of each material: whether it is seen from both sides.
    pub sheets: &'a [bool],
    pub item: u32,
    pub focal: f32,
    pub centre: [f32; 2],
    /// All vertices are ahead of the near plane.
    pub whole: bool,
}

lanes! {
    /// Draws a mesh; appends the faces that show somewhere.
    pub fn draw<L>(job: &Draw<'_>, out: &mut Visibility, tris: &mut Vec<Tri>) {
        let (w, h) = (out.width as f32, out.height as f32);
        for (number, face) in job.faces.iter().enumerate() {
            let [a, b, c, d] = face.corners.map(|i| &job.vertices[i as usize]);
            let four = face.corners[3] != face.corners[2];
            let ahead = job.whole
                || (a.p[2] >= NEAR && b.p[2] >= NEAR && c.p[2] >= NEAR && d.p[2] >= NEAR);
            let least = |i: usize| min(min(a.s[i], b.s[i]), min(c.s[i], d.s[i]));
            let most = |i: usize| max(max(a.s[i], b.s[i]), max(c.s[i], d.s[i]));
            // By the diagonals; a triangle's last corner is there twice.
            let area = (c.s[0] - a.s[0]) * (d.s[1] - b.s[1]) - (d.s[0] - b.s[0]) * (c.s[1] - a.s[1]);
            if ahead {
                // Seen from behind, beside the picture, or between pixel centres: nothing to do.
                if area >= 0.0 && !job.sheets[face.material as usize] {
                    continue;
                }
                if most(0) < 0.5 || least(0) > w - 0.5 || most(1) < 0.5 || least(1) > h - 0.5 {
                    continue;
                }
                if first_centre(least(1), h) >= first_centre(most(1), h)
                    || first_centre(least(0), w) >= first_centre(most(0), w)
                {
                    continue;
                }
            } else if a.p[2] < NEAR && b.p[2] < NEAR && c.p[2] < NEAR && d.p[2] < NEAR {
                continue;
            }
            let normal = cross(sub(b.p, a.p), sub(c.p, a.p));
            let distance = dot(normal, a.p);
            // The camera's frame is left-handed: front faces have a positive distance.
            if distance <= 0.0 && !job.sheets[face.material as usize] {
                continue;
            }
            if distance.abs() < 1e-12 {
                continue;
            }
            let (far, near) = if ahead {
                let high = 1.0001 / min(min(a.p[2], b.p[2]), min(c.p[2], d.p[2]));
                if out.hides([least(0), least(1)], [most(0), most(1)], high) {
                    continue;
                }
                (0.9999 / max(max(a.p[2], b.p[2]), max(c.p[2], d.p[2])), high)
            } else {
                (0.0, 1.0001 / NEAR)
            };
            let scale = 1.0 / (distance * job.focal);
            let (dx, dy) = (normal[0] * scale, -normal[1] * scale);
            let iz = [dx, dy, normal[2] / distance - dx * job.centre[0] - dy * job.centre[1]];
            let id = tris.len() as u32 + 1;
            let drawn = if !ahead {
                let mut drawn = fan::<L>(job, out, [a, b, c], id, iz, near);
                if four {
                    drawn |= fan::<L>(job, out, [a, c, d], id, iz, near);
                }
                drawn
            } else if four {
                fill_four::<L>(out, [a.s, b.s, c.s, d.s], area < 0.0, id, iz, (far, near))
            } else {
                fill::<L>(out, [a.s, b.s, c.s], id, iz, (far, near))
            };
            if drawn {
                tris.push(Tri { item: job.item, face: number as u32 });
            }
        }
    }
}

/// Draws what of a triangle is ahead of the near plane.
#[inline(always)]
fn fan<L: Lane>(
    job: &Draw<'_>,
    out: &mut Visibility,
    corners: [&CamVertex; 3],
    id: u32,
    iz: [f32; 3],
    near: f32,
) -> bool {
    let (corners, count, low) = clipped(job, corners);
    let mut drawn = false;
    for last in 2..count {
        let corners = [corners[0], corners[last - 1], corners[last]];
        drawn |= fill::<L>(out, corners, id, iz, (low, near));
    }
    drawn
}

// The standard library's look after numbers that are none, which costs.

#[inline(always)]
fn min(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

#[inline(always)]
fn max(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// The part of a triangle that is ahead of the near plane: its corners, how many, and its least
/// 1 / depth.
fn clipped(job: &Draw<'_>, corners: [&CamVertex; 3]) -> ([[f32; 2]; 4], usize, f32) {
    let mut polygon = [[0.0; 2]; 4];
    let mut count = 0;
    let mut far = NEAR;
    for i in 0..3 {
        let (from, to) = (corners[i], corners[(i + 1) % 3]);
        let (from_in, to_in) = (from.p[2] >= NEAR, to.p[2] >= NEAR);
        if from_in {
            polygon[count] = from.s;
            far = far.max(from.p[2]);
            count += 1;
        }
        if from_in != to_in {
            // From the inner to the outer end, so that neighbours find the same point.
            let (inner, outer) = if from_in { (from.p, to.p) } else { (to.p, from.p) };
            let t = (inner[2] - NEAR) / (inner[2] - outer[2]);
            let scale = job.focal / NEAR;
            let at = |i: usize| (inner[i] + (outer[i] - inner[i]) * t) * scale;
            polygon[count] = [job.centre[0] + at(0), job.centre[1] - at(1)];
            count += 1;
        }
    }
    (polygon, count, 0.9999 / far)
}

/// What a face puts into its pixels: its number, its plane of 1 / depth, and the bounds of that.
struct Fill<L> {
    id: u32,
    iz: [f32; 3],
    slope: L,
    low: L,
    high: L,
    /// Of a face no wider than the lanes: where they begin, and the middles of their pixels. A row is then
    /// done at once, without a branch on its length, which is hard to predict.
    narrow: Option<(usize, L)>,
}

impl<L: Lane> Fill<L> {
    #[inline(always)]
    fn new(id: u32, iz: [f32; 3], (low, high): (f32, f32), (left, right): (f32, f32), width: usize) -> Self {
        let narrow = (L::COUNT > 1 && right - left < L::COUNT as f32 - 1.0).then(|| {
            let first = first_centre(left, width as f32);
            (first as usize, L::splat(first as f32 + 0.5) + L::ramp())
        });
        Self { id, iz, slope: L::splat(iz[0]), low: L::splat(low), high: L::splat(high), narrow }
    }

    /// Fills row `y` between two edges (pixels); whether any pixel shows it.
    #[inline(always)]
    fn row(&self, out: &mut Visibility, y: i32, left: f32, right: f32) -> bool {
        let w = out.width as f32;
        if let Some((first, centres)) = self.narrow {
            let at = y as usize * out.stride + first;
            let base = L::splat(self.iz[1] * (y as f32 + 0.5) + self.iz[2] + self.iz[0] * 0.5);
            let z = (base + self.slope * (centres - L::splat(0.5))).max(self.low).min(self.high);
            let (begin, end) = (centres.less(L::splat(left)), centres.less(L::splat(min(right, w))));
            return z.nearer_between(begin, end, &mut out.iz[at..], &mut out.id[at..], self.id);
        }
        let (mut x, x1) = (first_centre(left, w), first_centre(right, w));
        if x >= x1 {
            return false;
        }
        let start = y as usize * out.stride;
        let (depth, ids) = (&mut out.iz[start..start + out.stride], &mut out.id[start..start + out.stride]);
        let base = L::splat(self.iz[1] * (y as f32 + 0.5) + self.iz[2] + self.iz[0] * 0.5);
        let mut drawn = false;
        while x < x1 {
            let z = base + self.slope * (L::splat(x as f32) + L::ramp());
            let at = x as usize;
            drawn |= z.max(self.low).min(self.high).nearer(x1 - x, &mut depth[at..], &mut ids[at..], self.id);
            x += L::COUNT as i32;
        }
        drawn
    }
}

/// An edge of a face, from its upper end.
#[derive(Clone, Copy)]
struct Side {
    from: [f32; 2],
    slope: f32,
}

impl Side {
    #[inline(always)]
    fn new(from: [f32; 2], to: [f32; 2]) -> Self {
        Self { from, slope: (to[0] - from[0]) / (to[1] - from[1]) }
    }
    #[inline(always)]
    fn at(&self, y: f32) -> f32 {
        self.from[0] + (y - self.from[1]) * self.slope
    }
}

/// Draws a triangle of the picture, its 1 / depth within bounds; whether any pixel shows it.
#[inline(always)]
fn fill<L: Lane>(
    out: &mut Visibility,
    corners: [[f32; 2]; 3],
    id: u32,
    iz: [f32; 3],
    bounds: (f32, f32),
) -> bool {
    let [mut a, mut b, mut c] = corners;
    if b[1] < a[1] {
        (a, b) = (b, a);
    }
    if c[1] < b[1] {
        (b, c) = (c, b);
        if b[1] < a[1] {
            (a, b) = (b, a);
        }
    }
    let h = out.height as f32;
    let (top, middle, bottom) = (first_centre(a[1], h), first_centre(b[1], h), first_centre(c[1], h));
    if top >= bottom {
        return false;
    }
    let (left, right) = (min(a[0], min(b[0], c[0])), max(a[0], max(b[0], c[0])));
    let ink = Fill::<L>::new(id, iz, bounds, (left, right), out.width);
    let long = Side::new(a, c);
    let turn = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1]);
    let mut drawn = false;
    for (from, to, p, q) in [(top, middle, a, b), (middle, bottom, b, c)] {
        if from >= to {
            continue;
        }
        let short = Side::new(p, q);
        for y in from..to {
            let yc = y as f32 + 0.5;
            let (x_long, x_short) = (long.at(yc), short.at(yc));
            let (left, right) = if turn < 0.0 { (x_short, x_long) } else { (x_long, x_short) };
            drawn |= ink.row(out, y, left, right);
        }
    }
    drawn
}

/// As [`fill`], for four corners round a convex face; `forward`: the next corner is the left one.
#[inline(always)]
fn fill_four<L: Lane>(
    out: &mut Visibility,
    corners: [[f32; 2]; 4],
    forward: bool,
    id: u32,
    iz: [f32; 3],
    bounds: (f32, f32),
) -> bool {
    let h = out.height as f32;
    let (mut top, mut bottom) = (0, 0);
    for i in 1..4 {
        top = if corners[i][1] < corners[top][1] { i } else { top };
        bottom = if corners[i][1] > corners[bottom][1] { i } else { bottom };
    }
    let (mut y, end) = (first_centre(corners[top][1], h), first_centre(corners[bottom][1], h));
    let [a, b, c, d] = corners.map(|c| c[0]);
    let (left, right) = (min(min(a, b), min(c, d)), max(max(a, b), max(c, d)));
    let ink = Fill::<L>::new(id, iz, bounds, (left, right), out.width);
    // The corners that the left and the right side have come to, the rows to which they go.
    let steps = if forward { [1, 3] } else { [3, 1] };
    let mut sides = [Side { from: corners[top], slope: 0.0 }; 2];
    let (mut at, mut until) = ([top; 2], [y; 2]);
    let mut drawn = false;
    while y < end {
        for i in 0..2 {
            while until[i] <= y {
                let from = corners[at[i]];
                at[i] = (at[i] + steps[i]) & 3;
                sides[i] = Side::new(from, corners[at[i]]);
                until[i] = if at[i] == bottom { end } else { first_centre(corners[at[i]][1], h) };
            }
        }
        let stop = until[0].min(until[1]);
        while y < stop {
            let yc = y as f32 + 0.5;
            drawn |= ink.row(out, y, sides[0].at(yc), sides[1].at(yc));
            y += 1;
        }
    }
    drawn
}

lanes! {
    /// Where nothing was drawn: the ground plane `id`, whose 1 / depth is `iz`, as far as that is above
    /// `far`; elsewhere nothing.
    pub fn settle<L>(out: &mut Visibility, id: u32, iz: [f32; 3], far: f32) {
        for y in 0..out.height {
            let base = iz[1] * (y as f32 + 0.5) + iz[2] + iz[0] * 0.5;
            let (depth, ids) = (&mut out.iz[y * out.stride..][..out.stride], &mut out.id[y * out.stride..][..out.stride]);
            let mut x = 0;
            while x < out.width {
                let z = L::splat(base) + L::splat(iz[0]) * (L::splat(x as f32) + L::ramp());
                z.fill_empty(far, &mut depth[x..], &mut ids[x..], id);
                x += L::COUNT;
            }
        }
    }
}
