//! The town cut into chunks: everything built goes to the tile that it lies in.

use super::look::Look;
use super::polygon::clipped;
use crate::model::{CHUNK_SIZE, Chunk, Instance, Library, MaterialId, Mesh, Paint, Triangle, Vertex};
use crate::shape::{V3, bounds_of};
use nalgebra::Point3;
use std::collections::BTreeMap;
use sumo_network::geometry::{Point, Vector};
use sumo_network::seeds;

/// How far a chunk's levels are used (m): all of it, without small things, the bare town.
const REACH: [f32; 3] = [70.0, 190.0, f32::INFINITY];

/// Which levels something is part of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Levels {
    All,
    /// Only near by.
    Near,
    /// Near and in the middle.
    Middle,
    /// In the middle and far away.
    NotNear,
}

impl Levels {
    fn range(self) -> std::ops::Range<usize> {
        match self {
            Self::All => 0..3,
            Self::Near => 0..1,
            Self::Middle => 0..2,
            Self::NotNear => 1..3,
        }
    }
}

#[derive(Default)]
struct Tile {
    meshes: [Mesh; 3],
    paint: Vec<Paint>,
    instances: Vec<Instance>,
}

/// Collects the town by tile. Coordinates are the world's (m).
pub(super) struct Tiles {
    tiles: BTreeMap<(i32, i32), Tile>,
    look: Look,
}

/// A corner of a surface: place and texture coordinates.
#[derive(Clone, Copy, Debug)]
pub(super) struct Corner {
    pub at: Point3<f64>,
    pub uv: [f64; 2],
}

fn tile_of(x: f64, y: f64) -> (i32, i32) {
    ((x / CHUNK_SIZE).floor() as i32, (y / CHUNK_SIZE).floor() as i32)
}

fn origin(tile: (i32, i32)) -> Point3<f64> {
    Point3::new(f64::from(tile.0) * CHUNK_SIZE, f64::from(tile.1) * CHUNK_SIZE, 0.0)
}

fn local(p: Point3<f64>, origin: Point3<f64>) -> V3 {
    let d = p - origin;
    [d.x as f32, d.y as f32, d.z as f32]
}

impl Tile {
    /// Raises what is in the tile's frame (m).
    fn lift(&mut self, up: f32) {
        for vertex in self.meshes.iter_mut().flat_map(|mesh| &mut mesh.vertices) {
            vertex.position[2] += up;
        }
        self.paint.iter_mut().flat_map(|p| &mut p.corners).for_each(|c| c[2] += up);
    }
}

/// How strong paint at a place still is; None: it is gone.
fn worn(look: Look, strength: f32, at: [f64; 2]) -> Option<f32> {
    if look.paint >= 1.0 {
        return Some(strength);
    }
    let key = at.map(|v| (v * 10.0).round() as i64 as u64);
    let dice = seeds::derive(look.seed ^ key[0].rotate_left(32) ^ key[1], "worn");
    let unit = |shift: u32| (dice >> shift & 0xffff) as f32 / 65_536.0;
    let lost = 1.0 - look.paint;
    (unit(0) >= lost).then(|| strength * (1.0 - 0.6 * lost * unit(16)))
}

impl Tiles {
    /// None yet.
    pub fn new(look: Look) -> Self {
        Self { tiles: BTreeMap::new(), look }
    }

    /// Whether paint is worn away in places.
    pub fn is_worn(&self) -> bool {
        self.look.paint < 1.0
    }

    fn tile(&mut self, x: f64, y: f64) -> (&mut Tile, Point3<f64>) {
        let key = tile_of(x, y);
        (self.tiles.entry(key).or_default(), origin(key))
    }

    /// A flat convex piece of three or more corners, counter-clockwise seen from outside.
    pub fn face(&mut self, corners: &[Corner], material: MaterialId, levels: Levels) {
        let n = corners.len() as f64;
        let (x, y) = corners.iter().fold((0.0, 0.0), |(x, y), c| (x + c.at.x, y + c.at.y));
        if corners.len() < 3 || !(x.is_finite() && y.is_finite()) {
            return;
        }
        let (tile, origin) = self.tile(x / n, y / n);
        let (a, b, c) = (corners[0].at, corners[1].at, corners[corners.len() - 1].at);
        let normal = (b - a).cross(&(c - a));
        if normal.norm() < 1e-9 {
            return;
        }
        let normal = normal.normalize();
        let normal = [normal.x as f32, normal.y as f32, normal.z as f32];
        for mesh in &mut tile.meshes[levels.range()] {
            let first = mesh.vertices.len() as u32;
            mesh.vertices.extend(corners.iter().map(|c| Vertex {
                position: local(c.at, origin),
                normal,
                uv: [c.uv[0] as f32, c.uv[1] as f32],
                bone: 0,
            }));
            for k in 1..corners.len() as u32 - 1 {
                mesh.triangles.push(Triangle { corners: [first, first + k, first + k + 1], material });
            }
        }
    }

    /// A quad with uv in metres: along the first edge and up the last.
    pub fn wall(
        &mut self,
        corners: [Point3<f64>; 4],
        uv: [[f64; 2]; 4],
        material: MaterialId,
        levels: Levels,
    ) {
        let corners: [Corner; 4] = std::array::from_fn(|i| Corner { at: corners[i], uv: uv[i] });
        self.face(&corners, material, levels);
    }

    /// A horizontal triangle at heights given by `z`, cut along the tiles.
    pub fn floor(&mut self, t: [Point; 3], z: &dyn Fn(Point) -> f64, material: MaterialId, levels: Levels) {
        let lo = t.iter().fold(t[0], |a, p| Point::new(a.x.min(p.x), a.y.min(p.y)));
        let hi = t.iter().fold(t[0], |a, p| Point::new(a.x.max(p.x), a.y.max(p.y)));
        let (first, last) = (tile_of(lo.x, lo.y), tile_of(hi.x, hi.y));
        for i in first.0..=last.0 {
            for j in first.1..=last.1 {
                let o = origin((i, j)).xy();
                let piece = if first == last {
                    t.to_vec()
                } else {
                    clipped(&t, o, o + Vector::new(CHUNK_SIZE, CHUNK_SIZE))
                };
                let corners: Vec<Corner> = piece
                    .iter()
                    .map(|p| Corner { at: Point3::new(p.x, p.y, z(*p)), uv: [p.x, p.y] })
                    .collect();
                self.face(&corners, material, levels);
            }
        }
    }

    /// A ready mesh at a place.
    pub fn mesh(&mut self, at: Point3<f64>, mesh: &Mesh, levels: Levels) {
        let (tile, origin) = self.tile(at.x, at.y);
        let shift = local(at, origin);
        for target in &mut tile.meshes[levels.range()] {
            let first = target.vertices.len() as u32;
            target.vertices.extend(
                mesh.vertices
                    .iter()
                    .map(|v| Vertex { position: std::array::from_fn(|i| v.position[i] + shift[i]), ..*v }),
            );
            target.triangles.extend(
                mesh.triangles.iter().map(|t| Triangle { corners: t.corners.map(|c| c + first), ..*t }),
            );
        }
    }

    /// White paint on the ground, counter-clockwise from above: sides 0-1 and 2-3, front end 1-2, rear end 3-0.
    pub fn paint(&mut self, corners: [Point3<f64>; 4], strength: f32, ends: [bool; 2]) {
        let x = corners.iter().map(|c| c.x).sum::<f64>() / 4.0;
        let y = corners.iter().map(|c| c.y).sum::<f64>() / 4.0;
        if !(x.is_finite() && y.is_finite()) {
            return;
        }
        let Some(strength) = worn(self.look, strength, [x, y]) else { return };
        let (tile, origin) = self.tile(x, y);
        tile.paint.push(Paint {
            corners: corners.map(|c| local(c, origin)),
            strength,
            front_end: ends[0],
            rear_end: ends[1],
        });
    }

    /// A model put somewhere for good.
    pub fn instance(&mut self, instance: Instance) {
        let p = instance.pose.position;
        self.tile(p.x, p.y).0.instances.push(instance);
    }

    /// The chunks, in a fixed order; `ground` is the ground's height at a place (m), where a chunk's
    /// origin is.
    pub fn finish(self, library: &Library, ground: &dyn Fn(Point) -> f64) -> Vec<Chunk> {
        self.tiles
            .into_iter()
            .map(|(key, mut tile)| {
                let flat = origin(key);
                let middle = flat.xy() + Vector::new(0.5 * CHUNK_SIZE, 0.5 * CHUNK_SIZE);
                let origin = Point3::new(flat.x, flat.y, ground(middle));
                tile.lift(-(origin.z as f32));
                let mut bounds = bounds_of([&tile.meshes[0], &tile.meshes[2]]);
                let empty = tile.meshes.iter().all(|m| m.vertices.is_empty());
                if empty {
                    bounds = [[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]];
                }
                let mut include = |p: V3| {
                    for (axis, &c) in p.iter().enumerate() {
                        bounds[0][axis] = bounds[0][axis].min(c);
                        bounds[1][axis] = bounds[1][axis].max(c);
                    }
                };
                tile.paint.iter().flat_map(|p| p.corners).for_each(&mut include);
                for instance in &tile.instances {
                    let model = &library.models[usize::from(instance.model.0)];
                    let at = local(instance.pose.position, origin);
                    let reach = (0..2)
                        .map(|axis| {
                            model.bounds[0][axis].abs().max(model.bounds[1][axis].abs())
                                * instance.scale[axis]
                        })
                        .fold(0.0, f32::hypot);
                    let [low, high] = [0, 1].map(|i: usize| model.bounds[i][2] * instance.scale[2]);
                    include([at[0] - reach, at[1] - reach, at[2] + low]);
                    include([at[0] + reach, at[1] + reach, at[2] + high]);
                }
                if bounds[0][0] > bounds[1][0] {
                    bounds = [[0.0; 3]; 2];
                }
                Chunk {
                    origin,
                    bounds,
                    levels: REACH.into_iter().zip(tile.meshes).collect(),
                    paint: tile.paint,
                    instances: tile.instances,
                }
            })
            .collect()
    }
}
