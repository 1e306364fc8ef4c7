//! Shapes from a few numbers: boxes, tubes, balls, lofts; normals are smoothed up to a crease angle.

use crate::model::{MaterialId, Mesh, Triangle, Vertex};

pub(crate) type V3 = [f32; 3];

pub(crate) fn add(a: V3, b: V3) -> V3 {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}
pub(crate) fn sub(a: V3, b: V3) -> V3 {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}
pub(crate) fn scaled(a: V3, s: f32) -> V3 {
    a.map(|c| c * s)
}
pub(crate) fn dot(a: V3, b: V3) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}
pub(crate) fn cross(a: V3, b: V3) -> V3 {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}
/// The unit vector; up where there is no direction.
pub(crate) fn unit(a: V3) -> V3 {
    let length = dot(a, a).sqrt();
    if length > 1e-12 { scaled(a, 1.0 / length) } else { [0.0, 0.0, 1.0] }
}
pub(crate) fn mix(a: V3, b: V3, t: f32) -> V3 {
    std::array::from_fn(|i| a[i] + (b[i] - a[i]) * t)
}

/// A polygon of three or four corners before its normals are known.
struct Face {
    corners: [u32; 3],
    material: MaterialId,
}

/// Collects faces over shared points and turns them into a [`Mesh`].
///
/// Points that one call makes are shared among its own faces only, so shapes never smooth into each other.
pub(crate) struct Shaper {
    points: Vec<V3>,
    uvs: Vec<[f32; 2]>,
    bones: Vec<u8>,
    faces: Vec<Face>,
    /// Bone of the points that follow.
    pub bone: u8,
    /// Turn (rad, about z) and move of the points that follow.
    place: Option<(f32, V3)>,
    /// Cosine of the largest angle between faces that are smoothed into each other.
    crease: f32,
}

impl Shaper {
    /// Nothing yet; faces that meet at less than `crease` (degrees) are smoothed.
    pub fn new(crease: f32) -> Self {
        Self {
            points: Vec::new(),
            uvs: Vec::new(),
            bones: Vec::new(),
            faces: Vec::new(),
            bone: 0,
            place: None,
            crease: crease.to_radians().cos(),
        }
    }

    /// What follows is turned by `heading` (rad) and moved to `at`.
    pub fn place(&mut self, heading: f32, at: V3) {
        self.place = Some((heading, at));
    }

    /// A point that faces can share.
    pub fn point(&mut self, p: V3) -> u32 {
        self.point_uv(p, [0.0; 2])
    }

    /// A point with texture coordinates.
    pub fn point_uv(&mut self, p: V3, uv: [f32; 2]) -> u32 {
        let p = match self.place {
            None => p,
            Some((heading, at)) => {
                let (s, c) = heading.sin_cos();
                add([p[0] * c - p[1] * s, p[0] * s + p[1] * c, p[2]], at)
            }
        };
        self.points.push(p);
        self.uvs.push(uv);
        self.bones.push(self.bone);
        self.points.len() as u32 - 1
    }

    /// A triangle of points, counter-clockwise from outside; slivers are left out.
    pub fn tri(&mut self, a: u32, b: u32, c: u32, material: MaterialId) {
        let [pa, pb, pc] = [a, b, c].map(|i| self.points[i as usize]);
        let n = cross(sub(pb, pa), sub(pc, pa));
        if dot(n, n) > 1e-14 {
            self.faces.push(Face { corners: [a, b, c], material });
        }
    }

    /// Four points, counter-clockwise from outside.
    pub fn quad(&mut self, q: [u32; 4], material: MaterialId) {
        self.tri(q[0], q[1], q[2], material);
        self.tri(q[0], q[2], q[3], material);
    }

    /// A flat face of its own; uv runs over it from 0 to 1 (u from corner 0 to 1).
    pub fn plate(&mut self, corners: [V3; 4], material: MaterialId) {
        self.plate_uv(corners, [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]], material);
    }

    /// A flat face of its own with texture coordinates.
    pub fn plate_uv(&mut self, corners: [V3; 4], uv: [[f32; 2]; 4], material: MaterialId) {
        let q = std::array::from_fn(|i| self.point_uv(corners[i], uv[i]));
        self.quad(q, material);
    }

    /// An upright box from its corners; uv in metres. Its bottom is left out unless `bottom`.
    pub fn cuboid(&mut self, lo: V3, hi: V3, bottom: bool, material: MaterialId) {
        let p = |x: usize, y: usize, z: usize| {
            [
                if x == 0 { lo[0] } else { hi[0] },
                if y == 0 { lo[1] } else { hi[1] },
                if z == 0 { lo[2] } else { hi[2] },
            ]
        };
        let (dx, dy, dz) = (hi[0] - lo[0], hi[1] - lo[1], hi[2] - lo[2]);
        let uv = |u: f32, v: f32| [[0.0, 0.0], [u, 0.0], [u, v], [0.0, v]];
        self.plate_uv([p(0, 0, 0), p(1, 0, 0), p(1, 0, 1), p(0, 0, 1)], uv(dx, dz), material);
        self.plate_uv([p(1, 1, 0), p(0, 1, 0), p(0, 1, 1), p(1, 1, 1)], uv(dx, dz), material);
        self.plate_uv([p(1, 0, 0), p(1, 1, 0), p(1, 1, 1), p(1, 0, 1)], uv(dy, dz), material);
        self.plate_uv([p(0, 1, 0), p(0, 0, 0), p(0, 0, 1), p(0, 1, 1)], uv(dy, dz), material);
        self.plate_uv([p(0, 0, 1), p(1, 0, 1), p(1, 1, 1), p(0, 1, 1)], uv(dx, dy), material);
        if bottom {
            self.plate_uv([p(0, 1, 0), p(1, 1, 0), p(1, 0, 0), p(0, 0, 0)], uv(dx, dy), material);
        }
    }

    /// Rings of equally many points, each ring counter-clockwise seen from where the rings come from
    /// (its normal points on along the loft). `material(ring, segment)` is that of the face behind ring
    /// `ring` and after point `segment`.
    pub fn loft(&mut self, rings: &[Vec<V3>], material: impl Fn(usize, usize) -> Option<MaterialId>) {
        let ids: Vec<Vec<u32>> =
            rings.iter().map(|ring| ring.iter().map(|&p| self.point(p)).collect()).collect();
        for (i, pair) in ids.windows(2).enumerate() {
            let n = pair[0].len();
            for j in 0..n {
                let k = (j + 1) % n;
                if let Some(material) = material(i, j) {
                    self.quad([pair[0][j], pair[0][k], pair[1][k], pair[1][j]], material);
                }
            }
        }
    }

    /// A fan over a ring of points, counter-clockwise from outside.
    pub fn cap(&mut self, ring: &[V3], material: MaterialId) {
        let n = ring.len();
        if n < 3 {
            return;
        }
        let centre = scaled(ring.iter().fold([0.0; 3], |a, &p| add(a, p)), 1.0 / n as f32);
        let c = self.point(centre);
        let ids: Vec<u32> = ring.iter().map(|&p| self.point(p)).collect();
        for j in 0..n {
            self.tri(c, ids[j], ids[(j + 1) % n], material);
        }
    }

    /// A round bar through `stops` (centre, radius), with closed ends where `caps`.
    pub fn tube(&mut self, stops: &[(V3, f32)], sides: usize, caps: bool, material: MaterialId) {
        let stretched: Vec<(V3, f32, f32)> = stops.iter().map(|&(p, r)| (p, r, r)).collect();
        self.oval_tube(&stretched, sides, caps, material);
    }

    /// As [`Self::tube`] with two radii: across the bar to the side, and at right angles to that.
    pub fn oval_tube(&mut self, stops: &[(V3, f32, f32)], sides: usize, caps: bool, material: MaterialId) {
        let (Some(first), Some(last)) = (stops.first(), stops.last()) else { return };
        let along = unit(sub(last.0, first.0));
        // An upright bar's first radius is to the side (y), its second forward (x).
        let helper = if along[1].abs() > 0.9 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
        let b = unit(cross(along, helper));
        let a = unit(cross(b, along));
        let ring = |&(centre, ra, rb): &(V3, f32, f32)| -> Vec<V3> {
            (0..sides)
                .map(|i| {
                    let (s, c) = (i as f32 / sides as f32 * std::f32::consts::TAU).sin_cos();
                    add(centre, add(scaled(a, c * ra), scaled(b, -s * rb)))
                })
                .collect()
        };
        let mut rings: Vec<Vec<V3>> = stops.iter().map(ring).collect();
        // Counter-clockwise round `along`.
        let turn = cross(sub(rings[0][1], rings[0][0]), sub(rings[0][2 % sides], rings[0][1]));
        if dot(turn, along) < 0.0 {
            rings.iter_mut().for_each(|r| r.reverse());
        }
        self.loft(&rings, |_, _| Some(material));
        if caps {
            if let Some(r) = rings.last() {
                self.cap(r, material);
            }
            let mut back = rings.swap_remove(0);
            back.reverse();
            self.cap(&back, material);
        }
    }

    /// A ball with three radii, from pole to pole along z, between the latitudes `from` and `to`
    /// (-1 south pole .. 1 north pole).
    pub fn ball(
        &mut self,
        centre: V3,
        radii: V3,
        (rows, sides): (usize, usize),
        (from, to): (f32, f32),
        material: MaterialId,
    ) {
        let rings: Vec<Vec<V3>> = (0..=rows)
            .map(|row| {
                let latitude = (from + (to - from) * row as f32 / rows as f32) * std::f32::consts::FRAC_PI_2;
                let (sl, cl) = latitude.sin_cos();
                (0..sides)
                    .map(|i| {
                        let (s, c) = (i as f32 / sides as f32 * std::f32::consts::TAU).sin_cos();
                        add(centre, [radii[0] * cl * c, radii[1] * cl * s, radii[2] * sl])
                    })
                    .collect()
            })
            .collect();
        // All points of a pole are one, or its triangles would not smooth.
        let mut ids: Vec<Vec<u32>> = Vec::new();
        for (row, ring) in rings.iter().enumerate() {
            // Continuous over the surface, for leaves.
            let uv = |p: V3| [0.9 * p[0] + 0.6 * p[1], p[2] + 0.35 * p[0] - 0.3 * p[1]];
            let pole = (row == 0 && from <= -1.0) || (row == rows && to >= 1.0);
            if pole {
                let p = self.point_uv(ring[0], uv(ring[0]));
                ids.push(vec![p; sides]);
            } else {
                ids.push(ring.iter().map(|&p| self.point_uv(p, uv(p))).collect());
            }
        }
        for pair in ids.windows(2) {
            for j in 0..sides {
                let k = (j + 1) % sides;
                self.quad([pair[0][j], pair[0][k], pair[1][k], pair[1][j]], material);
            }
        }
    }

    /// Moves every point made since `start` (a count from [`Self::len`]).
    pub fn displace(&mut self, start: usize, by: impl Fn(V3) -> V3) {
        for p in &mut self.points[start..] {
            *p = by(*p);
        }
    }

    /// How many points there are.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// The mesh: a vertex for each point and each direction that it is smoothed to.
    pub fn finish(self) -> Mesh {
        let normal = |f: &Face| {
            let [a, b, c] = f.corners.map(|i| self.points[i as usize]);
            cross(sub(b, a), sub(c, a))
        };
        let normals: Vec<V3> = self.faces.iter().map(normal).collect();
        let mut at_point: Vec<Vec<u32>> = vec![Vec::new(); self.points.len()];
        for (f, face) in self.faces.iter().enumerate() {
            for &c in &face.corners {
                at_point[c as usize].push(f as u32);
            }
        }
        let mut made: Vec<Vec<(V3, u32)>> = vec![Vec::new(); self.points.len()];
        let mut mesh = Mesh::default();
        for (f, face) in self.faces.iter().enumerate() {
            let own = unit(normals[f]);
            let corners = face.corners.map(|corner| {
                let i = corner as usize;
                let sum = at_point[i].iter().fold([0.0; 3], |sum, &other| {
                    let n = normals[other as usize];
                    if dot(unit(n), own) >= self.crease { add(sum, n) } else { sum }
                });
                let n = unit(sum);
                if let Some(&(_, id)) = made[i].iter().find(|(m, _)| dot(*m, n) > 0.9999) {
                    return id;
                }
                let id = mesh.vertices.len() as u32;
                mesh.vertices.push(Vertex {
                    position: self.points[i],
                    normal: n,
                    uv: self.uvs[i],
                    bone: self.bones[i],
                });
                made[i].push((n, id));
                id
            });
            mesh.triangles.push(Triangle { corners, material: face.material });
        }
        mesh
    }
}

/// Corners of the box round meshes; zero where there is nothing.
pub(crate) fn bounds_of<'a>(meshes: impl IntoIterator<Item = &'a Mesh>) -> [V3; 2] {
    let mut bounds = [[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]];
    for v in meshes.into_iter().flat_map(|m| &m.vertices) {
        for (axis, &c) in v.position.iter().enumerate() {
            bounds[0][axis] = bounds[0][axis].min(c);
            bounds[1][axis] = bounds[1][axis].max(c);
        }
    }
    if bounds[0][0] > bounds[1][0] { [[0.0; 3]; 2] } else { bounds }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every edge of a closed surface is used once in each direction, at equal positions.
    fn is_closed(mesh: &Mesh) -> bool {
        let key = |i: u32| mesh.vertices[i as usize].position.map(|c| (c * 1e5).round() as i64);
        let mut edges = std::collections::HashMap::new();
        for t in &mesh.triangles {
            for i in 0..3 {
                let (a, b) = (key(t.corners[i]), key(t.corners[(i + 1) % 3]));
                *edges.entry((a, b)).or_insert(0) += 1;
                *edges.entry((b, a)).or_insert(0) -= 1;
            }
        }
        edges.values().all(|&n| n == 0)
    }

    fn volume(mesh: &Mesh) -> f32 {
        let p = |i: u32| mesh.vertices[i as usize].position;
        mesh.triangles
            .iter()
            .map(|t| dot(p(t.corners[0]), cross(p(t.corners[1]), p(t.corners[2]))) / 6.0)
            .sum()
    }

    #[test]
    fn solids_are_closed_and_face_outwards() {
        let m = MaterialId(0);
        let mut s = Shaper::new(40.0);
        s.cuboid([0.0; 3], [1.0, 2.0, 3.0], true, m);
        let mesh = s.finish();
        assert!(is_closed(&mesh) && (volume(&mesh) - 6.0).abs() < 1e-4);
        for (from, to) in [
            ([0.0, 0.0, 0.0], [0.0, 0.0, 2.0]),
            ([0.0, 0.0, 0.0], [3.0, 1.0, 0.0]),
            ([0.0; 3], [0.0, -2.0, 0.1]),
        ] {
            let mut s = Shaper::new(40.0);
            s.tube(&[(from, 0.5), (to, 0.3)], 12, true, m);
            let mesh = s.finish();
            assert!(is_closed(&mesh) && volume(&mesh) > 0.5, "{from:?} {to:?} {}", volume(&mesh));
        }
        let mut s = Shaper::new(40.0);
        s.ball([1.0, 2.0, 3.0], [1.0; 3], (8, 16), (-1.0, 1.0), m);
        let mesh = s.finish();
        assert!(is_closed(&mesh) && (volume(&mesh) - 4.19).abs() < 0.35);
    }

    #[test]
    fn a_box_keeps_its_creases_and_a_ball_is_smooth() {
        let mut s = Shaper::new(40.0);
        s.cuboid([0.0; 3], [1.0; 3], false, MaterialId(0));
        assert!(s.finish().vertices.iter().all(|v| v.normal.iter().filter(|c| c.abs() > 1e-6).count() == 1));
        let mut s = Shaper::new(60.0);
        s.ball([0.0; 3], [1.0; 3], (8, 16), (-1.0, 1.0), MaterialId(0));
        for v in s.finish().vertices {
            assert!(dot(v.normal, v.position) > 0.97, "{v:?}");
        }
    }
}
