//! Triangles over shared vertices, and the faces that are drawn of them: flat convex pieces of three or
//! four corners, which cost less than triangles.

use super::material::{Material, MaterialId, Texture};
use super::view::{cross, dot, sub};

/// A corner of a triangle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Vertex {
    /// m, in the chunk's or the model's frame.
    pub position: [f32; 3],
    /// Unit outward normal.
    pub normal: [f32; 3],
    /// Texture coordinates (m); what they mean is the [`Texture`]'s.
    pub uv: [f32; 2],
    /// Index into [`Model::bones`](super::model::Model::bones); 0 where the model has none, and in chunks.
    pub bone: u8,
}

/// Three corners, counter-clockwise seen from outside, and what they are made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Triangle {
    /// Indices into [`Mesh::vertices`].
    pub corners: [u32; 3],
    /// What it is made of.
    pub material: MaterialId,
}

/// Triangles over shared vertices.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Corners of the triangles.
    pub vertices: Vec<Vertex>,
    /// In any order.
    pub triangles: Vec<Triangle>,
    /// What the renderer draws; made of the triangles by [`Scene::index`].
    pub(super) faces: Faces,
}

/// Three or four corners in one plane, counter-clockwise seen from outside.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Face {
    /// Indices into [`Mesh::vertices`]; a triangle's last one is there twice.
    pub corners: [u32; 4],
    /// Index into the library's materials.
    pub material: u32,
}

/// What of a mesh is needed to find where it shows.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Faces {
    pub list: Vec<Face>,
    /// Place (m) and bone of each vertex.
    pub corners: Vec<([f32; 3], u32)>,
}

impl Faces {
    /// The faces of a mesh's triangles.
    pub fn of(mesh: &Mesh, materials: &[Material]) -> Self {
        let corners = mesh.vertices.iter().map(|v| (v.position, u32::from(v.bone))).collect();
        let mut list = Vec::with_capacity(mesh.triangles.len());
        let mut rest = mesh.triangles.as_slice();
        while let [triangle, further @ ..] = rest {
            let material = triangle.material.0;
            if let Some((next, further)) = further.split_first()
                && let Some(corners) = joined(mesh, triangle, next, materials)
            {
                list.push(Face { corners, material });
                rest = further;
            } else {
                let [a, b, c] = triangle.corners;
                list.push(Face { corners: [a, b, c, c], material });
                rest = further;
            }
        }
        Self { list, corners }
    }
}

/// Off its plane by no more than this (m), and by this share of its size.
const FLAT: (f32, f32) = (2e-4, 1e-5);

/// The corners of two triangles, the first one's to begin with, if they look like one flat convex face.
fn joined(mesh: &Mesh, one: &Triangle, other: &Triangle, materials: &[Material]) -> Option<[u32; 4]> {
    if one.material != other.material {
        return None;
    }
    // The edge of the one that the other has in the opposite direction.
    let (i, k) = (0..9).map(|n| (n / 3, n % 3)).find(|&(i, k)| {
        one.corners[i] == other.corners[(k + 1) % 3] && one.corners[(i + 1) % 3] == other.corners[k]
    })?;
    let corners =
        [one.corners[(i + 1) % 3], one.corners[(i + 2) % 3], one.corners[i], other.corners[(k + 2) % 3]];
    let v = corners.map(|c| mesh.vertices.get(c as usize));
    let [Some(a), Some(b), Some(c), Some(d)] = v else { return None };
    let four = [a, b, c, d];
    if four.iter().any(|v| v.bone != a.bone || dot(v.normal, a.normal) < 0.9999) {
        return None;
    }
    let p = four.map(|v| v.position);
    let normal = cross(sub(p[1], p[0]), sub(p[2], p[0]));
    let size = dot(normal, normal).sqrt();
    let reach = sub(p[3], p[0]);
    let length = dot(reach, reach).sqrt();
    if size < 1e-9 || dot(reach, normal).abs() > size * (FLAT.0 + FLAT.1 * length) {
        return None;
    }
    // Each corner turns the same way, and not by next to nothing.
    let turns = (0..4).all(|n| {
        let (e, f) = (sub(p[(n + 1) % 4], p[n]), sub(p[(n + 2) % 4], p[(n + 1) % 4]));
        dot(cross(e, f), normal) > 1e-3 * size * (dot(e, e) * dot(f, f)).sqrt()
    });
    if !turns || !texture_continues(&materials[one.material.0 as usize], four.map(|v| v.uv), p) {
        return None;
    }
    Some(corners)
}

/// Whether the texture of the first three corners, continued, is right at the fourth.
fn texture_continues(material: &Material, uv: [[f32; 2]; 4], p: [[f32; 3]; 4]) -> bool {
    match material.texture {
        Texture::Plain | Texture::Concrete | Texture::Grass | Texture::Soil | Texture::Roof => return true,
        Texture::Asphalt { tracks: false, .. } => return true,
        _ => {}
    }
    // d - a = s (b - a) + t (c - a), by least squares.
    let (e, f, g) = (sub(p[1], p[0]), sub(p[2], p[0]), sub(p[3], p[0]));
    let (ee, ef, ff) = (dot(e, e), dot(e, f), dot(f, f));
    let (eg, fg) = (dot(e, g), dot(f, g));
    let scale = ee * ff - ef * ef;
    let (s, t) = ((ff * eg - ef * fg) / scale, (ee * fg - ef * eg) / scale);
    (0..2).all(|i| {
        let at = uv[0][i] + s * (uv[1][i] - uv[0][i]) + t * (uv[2][i] - uv[0][i]);
        (at - uv[3][i]).abs() < 2e-3
    })
}
