//! What hides road users from each other at the height of eyes: the upright faces of the town, as a grid of
//! the ground seen from above.

use super::mesh::Mesh;
use super::view::{cross, dot, sub};
use nalgebra::Point3;
use std::collections::HashMap;

/// Width of a cell (m).
const CELL: f64 = 0.5;
/// Cells along a block's side.
const BLOCK: i64 = 64;
/// Height above a face's foot at which it is cut (m): what is lower hides no vehicle.
const HEIGHT: f32 = 1.2;
/// Faces that lean more than this from upright (the normal's share that points up) hide nothing.
const LEAN: f32 = 0.3;

/// Cells with a wall in them, by block.
#[derive(Clone, Debug, Default)]
pub struct Walls {
    blocks: HashMap<(i64, i64), Box<[u64; BLOCK as usize]>>,
}

impl Walls {
    /// The upright faces of a town's meshes, each with the origin of its frame (m, world).
    pub fn of<'a>(meshes: impl IntoIterator<Item = (Point3<f64>, &'a Mesh)>) -> Self {
        let mut walls = Self::default();
        for (origin, mesh) in meshes {
            for triangle in &mesh.triangles {
                let corners = triangle.corners.map(|c| mesh.vertices[c as usize].position);
                let normal = cross(sub(corners[1], corners[0]), sub(corners[2], corners[0]));
                if normal[2].abs() > LEAN * dot(normal, normal).sqrt() {
                    continue;
                }
                if let Some([a, b]) = cut(&corners) {
                    let place = |p: [f32; 2]| [origin.x + f64::from(p[0]), origin.y + f64::from(p[1])];
                    walls.line(place(a), place(b));
                }
            }
        }
        walls
    }

    /// Fills the cells of a line from `a` to `b` (m, world).
    fn line(&mut self, a: [f64; 2], b: [f64; 2]) {
        let length = (b[0] - a[0]).hypot(b[1] - a[1]);
        let steps = (length / (0.5 * CELL)).ceil().max(1.0) as usize;
        for step in 0..=steps {
            let share = step as f64 / steps as f64;
            let [x, y] = [0, 1].map(|i| ((a[i] + share * (b[i] - a[i])) / CELL).floor() as i64);
            let rows = self
                .blocks
                .entry((x.div_euclid(BLOCK), y.div_euclid(BLOCK)))
                .or_insert_with(|| Box::new([0; BLOCK as usize]));
            rows[y.rem_euclid(BLOCK) as usize] |= 1 << x.rem_euclid(BLOCK);
        }
    }

    fn holds(&self, x: f64, y: f64) -> bool {
        let [x, y] = [x, y].map(|v| (v / CELL).floor() as i64);
        let block = self.blocks.get(&(x.div_euclid(BLOCK), y.div_euclid(BLOCK)));
        block.is_some_and(|rows| rows[y.rem_euclid(BLOCK) as usize] >> x.rem_euclid(BLOCK) & 1 == 1)
    }

    /// Whether a wall stands between two points (x, y in m, world).
    pub fn between(&self, eye: [f64; 2], place: [f64; 2]) -> bool {
        let [dx, dy] = [place[0] - eye[0], place[1] - eye[1]];
        let steps = (dx.hypot(dy) / CELL).floor().max(1.0);
        (1..steps as usize).any(|step| {
            let share = step as f64 / steps;
            self.holds(eye[0] + share * dx, eye[1] + share * dy)
        })
    }
}

/// Where a triangle crosses the height above its lowest corner at which walls are cut, x and y.
fn cut(corners: &[[f32; 3]; 3]) -> Option<[[f32; 2]; 2]> {
    let height = corners.iter().fold(f32::MAX, |low, c| low.min(c[2])) + HEIGHT;
    let mut ends = (0..3).filter_map(|i| {
        let (a, b) = (corners[i], corners[(i + 1) % 3]);
        ((a[2] < height) != (b[2] < height)).then(|| {
            let share = (height - a[2]) / (b[2] - a[2]);
            [a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])]
        })
    });
    Some([ends.next()?, ends.next()?])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::material::MaterialId;
    use crate::mesh::{Triangle, Vertex};

    fn walls(corners: [[f32; 3]; 4]) -> Walls {
        let vertices = corners.map(|position| Vertex { position, ..Vertex::default() }).to_vec();
        let triangles =
            [[0, 1, 2], [0, 2, 3]].map(|corners| Triangle { corners, material: MaterialId(0) }).to_vec();
        let mesh = Mesh { vertices, triangles, ..Mesh::default() };
        Walls::of([(Point3::new(-100.0, 40.0, 0.0), &mesh)])
    }

    #[test]
    fn a_wall_hides_and_a_kerb_or_a_road_does_not() {
        let quad =
            |low: f32, high: f32| [[0.0, 0.0, low], [10.0, 0.0, low], [10.0, 0.0, high], [0.0, 0.0, high]];
        let wall = walls(quad(0.0, 6.0));
        assert!(wall.between([-95.0, 35.0], [-95.0, 45.0]));
        assert!(wall.between([-99.5, 45.0], [-93.0, 35.0]), "aslant");
        assert!(!wall.between([-105.0, 35.0], [-105.0, 45.0]), "beside it");
        assert!(!wall.between([-95.0, 35.0], [-95.0, 39.0]), "in front of it");
        assert!(!walls(quad(0.0, 0.2)).between([-95.0, 35.0], [-95.0, 45.0]));
        let road = [[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [10.0, 90.0, 3.0], [0.0, 90.0, 3.0]];
        assert!(!walls(road).between([-95.0, 35.0], [-95.0, 90.0]));
    }
}
