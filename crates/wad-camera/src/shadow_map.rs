//! The shadows of the town's buildings, trees and poles on the ground.
//!
//! A map of texels around the camera. It holds the cells that the camera sees now, and sun everywhere
//! else: equal shots read equal shadows, whatever was rendered before. A cell is kept for as long as it
//! stays in view and the sun stands still. Each texel holds its right, upper and diagonal neighbours'
//! values too.

use super::lanes::Lane;
use super::large::Large;
use super::model::{Chunk, Library, Scene, SemanticTag as Tag};
use super::simd::multiversion;
use super::view::View;
use nalgebra::Point3;

/// Texels per metre, along a cell and along the map; the map wraps round.
const DENSITY: f32 = 4.0;
const CELL: usize = 128;
const SIDE: usize = 1024;
const CELLS: i32 = (SIDE / CELL) as i32;
const SLOTS: usize = (CELLS * CELLS) as usize;
const CELL_M: f64 = CELL as f64 / DENSITY as f64;
/// How deep into the picture shadows are drawn (m).
pub const REACH: f32 = 96.0;
/// Cells checked on each side of the camera's: the corners of a wide picture are farther than [`REACH`].
const AROUND: i32 = 5;
/// Longest shadow (m).
const LONGEST: f64 = 80.0;

/// The map.
pub struct ShadowMap {
    texels: Large<u32>,
    owners: Vec<Option<(i32, i32)>>,
    sun: [f32; 3],
    scratch: Vec<u8>,
}

impl Default for ShadowMap {
    fn default() -> Self {
        Self {
            texels: Large::new(SIDE * SIDE, u32::MAX),
            owners: vec![None; SLOTS],
            sun: [0.0; 3],
            scratch: vec![0; (CELL + 4) * (CELL + 4)],
        }
    }
}

impl ShadowMap {
    /// Forgets everything: another scene.
    pub fn forget(&mut self) {
        self.owners.fill(None);
        self.texels.fill(u32::MAX);
    }

    /// Makes the map what the view needs: cells in view hold shadows, the others hold sun.
    pub fn prepare(&mut self, scene: &Scene, view: &View, sun: [f32; 3]) {
        if self.sun != sun {
            self.sun = sun;
            self.forget();
        }
        for (slot, wanted) in cells_in_view(scene, view).into_iter().enumerate() {
            if self.owners[slot] == wanted {
                continue;
            }
            match wanted {
                Some(cell) => self.fill(scene, cell, slot),
                None => self.clear(slot),
            }
            self.owners[slot] = wanted;
        }
    }

    /// Sun in all of a slot.
    fn clear(&mut self, slot: usize) {
        let (left, low) = corner(slot);
        for y in low..low + CELL {
            self.texels[y * SIDE + left..][..CELL].fill(u32::MAX);
        }
    }

    fn fill(&mut self, scene: &Scene, (x, y): (i32, i32), slot: usize) {
        self.scratch.fill(0);
        let corner = [f64::from(x) * CELL_M, f64::from(y) * CELL_M];
        let mut numbers = Vec::new();
        let half = 0.5 * CELL_M;
        scene.grid.near(corner[0] + half, corner[1] + half, half + LONGEST, &mut numbers);
        for number in numbers {
            let chunk = &scene.chunks[number as usize];
            // Can its shadow fall into the cell?
            let height = f64::from(chunk.bounds[1][2] - chunk.bounds[0][2]);
            let throw = self.throw();
            let fits = |i: usize| {
                let at = |k: usize| chunk.origin[i] + f64::from(chunk.bounds[k][i]);
                let shift = f64::from(throw[i]) * height;
                at(0) + shift.min(0.0) < corner[i] + CELL_M + 1.0 && at(1) + shift.max(0.0) > corner[i] - 1.0
            };
            if fits(0) && fits(1) {
                self.cast_chunk(chunk, &scene.library, corner);
            }
        }
        self.store(slot);
    }

    /// How far the shadow of something 1 m high falls (m).
    fn throw(&self) -> [f32; 2] {
        let z = self.sun[2].max(0.1);
        [-self.sun[0] / z, -self.sun[1] / z]
    }

    fn cast_chunk(&mut self, chunk: &Chunk, library: &Library, corner: [f64; 2]) {
        let throw = self.throw();
        // The chunk's origin lies on the ground.
        let base = [(chunk.origin.x - corner[0]) as f32, (chunk.origin.y - corner[1]) as f32, 0.05];
        let land = |p: [f32; 3]| {
            let h = (p[2] + base[2]).max(0.0);
            [(p[0] + base[0] + throw[0] * h) * DENSITY, (p[1] + base[1] + throw[1] * h) * DENSITY]
        };
        if let Some((_, mesh)) = chunk.levels.first() {
            for face in &mesh.triangles {
                let corners = face.corners.map(|i| mesh.vertices[i as usize].position);
                // Ground that rises within the chunk does not shade itself.
                let tag = library.materials[face.material.0 as usize].tag;
                if matches!(tag, Tag::Road | Tag::SideWalk | Tag::Terrain | Tag::Ground | Tag::Water) {
                    continue;
                }
                if corners.iter().any(|p| p[2] + base[2] > 0.6) {
                    triangle(&mut self.scratch, corners.map(land));
                }
            }
        }
        for instance in &chunk.instances {
            let model = &library.models[instance.model.0 as usize];
            let Some(level) = model.levels.get(1).or(model.levels.first()).filter(|_| model.casts_shadow)
            else {
                continue;
            };
            let (sin, cos) = (instance.pose.heading.sin() as f32, instance.pose.heading.cos() as f32);
            let r = instance.pose.position - chunk.origin;
            let at = [r.x as f32, r.y as f32, r.z as f32];
            // Can its own shadow fall into the cell?
            let size = |i: usize| model.bounds[0][i].abs().max(model.bounds[1][i].abs()) * instance.scale[i];
            let (reach, height) = (size(0).hypot(size(1)), size(2) + (at[2] + base[2]).max(0.0));
            let beside = |i: usize| {
                let (middle, shift) = (at[i] + base[i], throw[i] * height);
                middle + reach + shift.max(0.0) < -1.0
                    || middle - reach + shift.min(0.0) > CELL_M as f32 + 1.0
            };
            if beside(0) || beside(1) {
                continue;
            }
            let points: Vec<[f32; 2]> = level
                .mesh
                .vertices
                .iter()
                .map(|v| {
                    let [x, y, z]: [f32; 3] = std::array::from_fn(|i| v.position[i] * instance.scale[i]);
                    land([at[0] + cos * x - sin * y, at[1] + sin * x + cos * y, at[2] + z])
                })
                .collect();
            for face in &level.mesh.triangles {
                triangle(&mut self.scratch, face.corners.map(|i| points[i as usize]));
            }
        }
    }

    /// Softens the scratch and packs it into the map.
    fn store(&mut self, slot: usize) {
        const W: usize = CELL + 4;
        let soft = |x: usize, y: usize| -> u32 {
            // Middle texel (x + 2, y + 2) of the scratch.
            let row = |r: usize| {
                let s = &self.scratch[r * W + x + 1..];
                u32::from(s[0]) + 2 * u32::from(s[1]) + u32::from(s[2])
            };
            255 - (row(y + 1) + 2 * row(y + 2) + row(y + 3)) * 255 / 16
        };
        let (left, low) = corner(slot);
        let mut line: Vec<u32> = (0..=CELL).map(|x| soft(x, 0)).collect();
        for y in 0..CELL {
            let next: Vec<u32> =
                (0..=CELL).map(|x| if y + 1 < W - 3 { soft(x, y + 1) } else { line[x] }).collect();
            for x in 0..CELL {
                self.texels[(low + y) * SIDE + left + x] =
                    line[x] | line[x + 1] << 8 | next[x] << 16 | next[x + 1] << 24;
            }
            line = next;
        }
    }

    /// The texels, for [`sample`].
    pub fn texels(&self) -> &[u32; SIDE * SIDE] {
        (&*self.texels).try_into().unwrap_or(&[u32::MAX; SIDE * SIDE])
    }

    /// Where a world coordinate (m) lies in the map (m), so that single precision suffices.
    pub fn wrap(v: f64) -> f32 {
        v.rem_euclid(f64::from(SIDE as f32 / DENSITY)) as f32
    }

    /// Share of sun at a world point, its height counted from the ground.
    pub fn sun_at(&self, p: &Point3<f64>, height: f64) -> f32 {
        let throw = self.throw();
        let x = Self::wrap(p.x + f64::from(throw[0]) * height);
        let y = Self::wrap(p.y + f64::from(throw[1]) * height);
        sample(self.texels(), x, y)
    }
}

/// By slot of the map the cell that it is to hold. Where two cells in view share a slot the nearer one has it.
fn cells_in_view(scene: &Scene, view: &View) -> [Option<(i32, i32)>; SLOTS] {
    let cell = |v: f64| (v / CELL_M).floor() as i32;
    let (cx, cy) = (cell(view.eye.x), cell(view.eye.y));
    // On hills the plane under everything may be far below the ground in view.
    let plane = scene.ground.map_or(0.0, |g| g.1);
    let grounds = [plane, view.eye.z - 2.0];
    let radius = 0.75 * CELL_M as f32;
    let mut wanted = [None; SLOTS];
    let far = |(x, y): (i32, i32)| (x - cx).pow(2) + (y - cy).pow(2);
    for y in cy - AROUND..=cy + AROUND {
        for x in cx - AROUND..=cx + AROUND {
            let middle = |c: i32| (f64::from(c) + 0.5) * CELL_M;
            let seen = grounds.iter().any(|&ground| {
                let centre = view.point(&Point3::new(middle(x), middle(y), ground));
                centre[2] - radius < REACH && view.sees_ball(centre, radius)
            });
            let slot = &mut wanted[(y.rem_euclid(CELLS) * CELLS + x.rem_euclid(CELLS)) as usize];
            if seen && slot.is_none_or(|other| far((x, y)) < far(other)) {
                *slot = Some((x, y));
            }
        }
    }
    wanted
}

/// The first column and row of a slot (texels).
fn corner(slot: usize) -> (usize, usize) {
    (slot % CELLS as usize * CELL, slot / CELLS as usize * CELL)
}

multiversion! {
    /// Marks a triangle (texels from the cell's corner).
    fn triangle(scratch: &mut [u8], p: [[f32; 2]; 3]) {
        const W: i32 = CELL as i32 + 4;
        let range = |i: usize| {
            let (least, most) = (p[0][i].min(p[1][i]).min(p[2][i]), p[0][i].max(p[1][i]).max(p[2][i]));
            // Scratch begins two texels before the cell.
            ((least + 1.5).ceil().max(0.0) as i32, ((most + 1.5).floor() as i32).min(W - 1))
        };
        let ((x0, x1), (y0, y1)) = (range(0), range(1));
        if x0 > x1 || y0 > y1 {
            return;
        }
        let area = (p[1][0] - p[0][0]) * (p[2][1] - p[0][1]) - (p[2][0] - p[0][0]) * (p[1][1] - p[0][1]);
        let sign = if area < 0.0 { -1.0 } else { 1.0 };
        let edges: [[f32; 3]; 3] = std::array::from_fn(|i| {
            let (a, b) = (p[i], p[(i + 1) % 3]);
            let (dx, dy) = ((b[0] - a[0]) * sign, (b[1] - a[1]) * sign);
            // A sliver thinner than a texel still leaves its mark.
            let slack = 0.3 * (dx.abs() + dy.abs());
            [-dy, dx, dy * a[0] - dx * a[1] + slack]
        });
        let inverse = edges.map(|e| 1.0 / e[0]);
        for y in y0..=y1 {
            let fy = y as f32 - 1.5;
            // Where the row is inside all edges.
            let (mut left, mut right) = (x0 as f32 - 1.5, x1 as f32 - 1.5);
            for (e, inverse) in edges.iter().zip(inverse) {
                let rest = e[1] * fy + e[2];
                if e[0] > 1e-6 {
                    left = left.max(-rest * inverse);
                } else if e[0] < -1e-6 {
                    right = right.min(-rest * inverse);
                } else if rest < 0.0 {
                    right = f32::MIN;
                }
            }
            let (from, to) = ((left + 1.5).ceil() as i32, (right + 1.5).floor() as i32);
            if from <= to {
                scratch[(y * W + from) as usize..=(y * W + to) as usize].fill(1);
            }
        }
    }
}

/// Share of sun at wrapped coordinates (m).
#[inline(always)]
pub fn sample<L: Lane>(texels: &Texels, x: L, y: L) -> L {
    let (density, half) = (L::splat(DENSITY), L::splat(0.5));
    L::texel(texels.as_slice(), SIDE.ilog2(), x * density - half, y * density - half) * L::splat(1.0 / 255.0)
}

/// The type that [`sample`] reads.
pub type Texels = [u32; SIDE * SIDE];
