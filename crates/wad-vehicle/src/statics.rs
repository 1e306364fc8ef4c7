//! Fixed bodies beside the road: buildings, poles, kerbs.

use super::outline::convex_pieces;
use rapier3d::prelude::{Rotation, SharedShape, Vector};
use rstar::primitives::{GeomWithData, Rectangle};
use rstar::{AABB, RTree};
use serde::{Deserialize, Serialize};
use sumo_network::geometry::Point;

/// What a fixed body is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StaticKind {
    /// A house or another large body.
    Building,
    /// A lamp, a sign, a tree's trunk.
    Pole,
    /// A wall, a fence, a guard rail.
    Barrier,
    /// Low: wheels climb it, the body passes over it, and it is not a contact.
    Kerb,
}

/// A fixed upright prism.
#[derive(Clone, Debug, PartialEq)]
pub struct StaticBody {
    /// The caller's own number, reported by [`super::Contact::key`].
    pub key: u64,
    /// What a report calls it.
    pub label: String,
    /// What it is.
    pub kind: StaticKind,
    /// Footprint (m): any simple polygon, in either direction. One without area is ignored.
    pub outline: Vec<Point>,
    /// Heights of the underside and the top above the road (m).
    pub bottom: f64,
    /// m above the road.
    pub top: f64,
    /// Height of the road it stands at, world frame (m). Where it is known, the body is left out
    /// while the ego drives on another level; None is there on every level.
    pub elevation: Option<f64>,
}

/// Horizontal run of a kerb's flank (m): a wheel of 0.32 m radius rises over 0.13 m in 0.26 m,
/// and a ray, which has no radius, is given that ramp by the kerb instead.
pub(super) const KERB_RAMP: f64 = 0.25;

/// Obstacles reach from here to there (m), however high they are: a collision is then always pushed
/// out sideways, never up or down.
pub(super) const OBSTACLE_SPAN: (f64, f64) = (-5.0, 10.0);

/// What begins lower than this (m) stands on the ground.
const FOOT: f64 = 0.5;

/// A convex piece of a body, ready for the physics world.
pub(super) struct Piece {
    /// Index into [`Statics::bodies`].
    pub(super) body: usize,
    /// Where its shape's own origin lies (m).
    pub(super) centre: Point,
    pub(super) height: f64,
    pub(super) rotation: Rotation,
    pub(super) shape: SharedShape,
}

/// All fixed bodies, found by place.
#[derive(Default)]
pub(super) struct Statics {
    pub(super) bodies: Vec<StaticBody>,
    pub(super) pieces: Vec<Piece>,
    tree: RTree<GeomWithData<Rectangle<[f64; 2]>, usize>>,
}

impl Statics {
    pub(super) fn new(bodies: Vec<StaticBody>) -> Self {
        let mut pieces = Vec::new();
        let mut boxes = Vec::new();
        for (index, body) in bodies.iter().enumerate() {
            if !(body.top > body.bottom && body.top.is_finite() && body.bottom.is_finite()) {
                continue;
            }
            for outline in convex_pieces(&body.outline) {
                let Some(piece) = piece(index, body, &outline) else { continue };
                let corners: Vec<[f64; 2]> = outline.iter().map(|p| [p.x, p.y]).collect();
                let bounds = AABB::from_points(&corners);
                boxes.push(GeomWithData::new(bounds.into(), pieces.len()));
                pieces.push(piece);
            }
        }
        Self { bodies, pieces, tree: RTree::bulk_load(boxes) }
    }

    /// Indices of the pieces within `radius` (m) of `point`, in order, without the pieces that are known to
    /// be on another level than `elevation` (m).
    pub(super) fn near(&self, point: Point, radius: f64, elevation: Option<f64>) -> Vec<usize> {
        let mut found: Vec<usize> = self
            .tree
            .locate_within_distance([point.x, point.y], radius * radius)
            .map(|piece| piece.data)
            .filter(|&index| same_level(self.bodies[self.pieces[index].body].elevation, elevation))
            .collect();
        found.sort_unstable();
        found
    }
}

/// Levels closer than this (m) are one.
const LEVEL: f64 = 3.0;

/// Whether two heights (m) are on one level; an unknown one is on all.
pub(super) fn same_level(a: Option<f64>, b: Option<f64>) -> bool {
    match (a, b) {
        (Some(a), Some(b)) => (a - b).abs() < LEVEL,
        _ => true,
    }
}

/// A convex, counter-clockwise part of `body` as a physics shape.
fn piece(index: usize, body: &StaticBody, outline: &[Point]) -> Option<Piece> {
    let centre = Point::from(
        outline.iter().map(|p| p.coords).sum::<sumo_network::geometry::Vector>() / outline.len() as f64,
    );
    let kerb = body.kind == StaticKind::Kerb;
    let (bottom, top) = if kerb || body.bottom > FOOT {
        (body.bottom, body.top)
    } else {
        (OBSTACLE_SPAN.0, OBSTACLE_SPAN.1.max(body.top))
    };
    let (half_height, height) = (0.5 * (top - bottom), 0.5 * (top + bottom));
    if !kerb && let Some((length, width, heading)) = as_rectangle(outline) {
        let shape = SharedShape::cuboid(0.5 * length as f32, 0.5 * width as f32, half_height as f32);
        let rotation = Rotation::from_rotation_z(heading as f32);
        return Some(Piece { body: index, centre, height, rotation, shape });
    }
    let base = if kerb { widened(outline, KERB_RAMP) } else { outline.to_vec() };
    let ring = |corners: &[Point], z: f64| -> Vec<Vector> {
        corners
            .iter()
            .map(|p| Vector::new((p.x - centre.x) as f32, (p.y - centre.y) as f32, z as f32))
            .collect()
    };
    let mut corners = ring(&base, -half_height);
    corners.extend(ring(outline, half_height));
    let shape = SharedShape::convex_hull(&corners)?;
    Some(Piece { body: index, centre, height, rotation: Rotation::IDENTITY, shape })
}

/// Length, width and heading of an outline that is a rectangle to within 1 cm.
fn as_rectangle(outline: &[Point]) -> Option<(f64, f64, f64)> {
    let [a, b, c, d] = outline else { return None };
    let (along, across) = (b - a, d - a);
    let skew = along.normalize().dot(&across.normalize()).abs() * across.norm().max(along.norm());
    let closed = (c - (b + across)).norm();
    (skew < 0.01 && closed < 0.01).then(|| (along.norm(), across.norm(), along.y.atan2(along.x)))
}

/// A convex, counter-clockwise outline moved outwards by `by` (m); corners cut to a moderate length.
fn widened(outline: &[Point], by: f64) -> Vec<Point> {
    let n = outline.len();
    (0..n)
        .map(|i| {
            let p = outline[i];
            let before = (p - outline[(i + n - 1) % n]).normalize();
            let after = (outline[(i + 1) % n] - p).normalize();
            let normal = |d: sumo_network::geometry::Vector| sumo_network::geometry::Vector::new(d.y, -d.x);
            let sum = normal(before) + normal(after);
            p + sum * (by / (1.0 + before.dot(&after)).max(0.5))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rectangle(x: f64, y: f64, length: f64, width: f64, heading: f64) -> Vec<Point> {
        let pose = sumo_network::geometry::Pose::new(x, y, 0.0, heading);
        [(0.5, 0.5), (-0.5, 0.5), (-0.5, -0.5), (0.5, -0.5)]
            .iter()
            .map(|(i, j)| pose.to_world(sumo_network::geometry::Vector::new(i * length, j * width)))
            .collect()
    }

    #[test]
    fn a_turned_rectangle_is_known_as_one() {
        let outline = rectangle(1000.0, -2000.0, 8.0, 3.0, 0.7);
        let (length, width, heading) = as_rectangle(&outline).expect("a rectangle");
        assert!((length - 8.0).abs() < 1e-9 && (width - 3.0).abs() < 1e-9);
        assert!((heading - 0.7).sin().abs() < 1e-9);
    }

    #[test]
    fn a_kerbs_base_is_wider_on_every_side() {
        let wide = widened(&rectangle(0.0, 0.0, 4.0, 0.2, 0.0), 0.25);
        let max_x = wide.iter().map(|p| p.x).fold(f64::MIN, f64::max);
        let max_y = wide.iter().map(|p| p.y).fold(f64::MIN, f64::max);
        assert!((max_x - 2.25).abs() < 1e-9 && (max_y - 0.35).abs() < 1e-9, "{max_x} {max_y}");
    }

    #[test]
    fn bodies_without_area_or_height_are_passed_over() {
        let body = |outline: Vec<Point>, top: f64| StaticBody {
            key: 1,
            label: String::new(),
            kind: StaticKind::Building,
            outline,
            bottom: 0.0,
            top,
            elevation: None,
        };
        let statics = Statics::new(vec![
            body(vec![], 3.0),
            body(rectangle(0.0, 0.0, 5.0, 5.0, 0.0), 0.0),
            body(rectangle(0.0, 0.0, 5.0, 5.0, 0.0), f64::NAN),
            body(rectangle(0.0, 0.0, 5.0, 5.0, 0.0), 3.0),
        ]);
        assert_eq!(statics.pieces.len(), 1);
        assert_eq!(statics.near(Point::new(10.0, 0.0), 7.4, None), Vec::<usize>::new());
        assert_eq!(statics.near(Point::new(10.0, 0.0), 7.6, None), vec![0]);
    }
}
