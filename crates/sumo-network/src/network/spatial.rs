//! Which lanes are near a point: an R-tree over the lanes' segments.

use super::elements::{Edge, EdgeKind, Lane, LaneId, NearLane};
use crate::geometry::Point;
use rstar::RTree;
use rstar::primitives::{GeomWithData, Line};

/// A lane further above or below than this is on another level (m).
const LEVEL: f64 = 3.0;

/// A segment of a lane: which lane, and which of its segments.
type Segment = GeomWithData<Line<[f64; 2]>, (LaneId, u32)>;

/// The segments of all lanes' centre lines; walkingareas have none.
#[derive(Clone, Debug, Default)]
pub(super) struct LaneTree(RTree<Segment>);

impl LaneTree {
    pub fn new(edges: &[Edge], lanes: &[Lane]) -> Self {
        let mut segments = Vec::new();
        for (index, lane) in lanes.iter().enumerate() {
            if edges[lane.edge.index()].kind == EdgeKind::WalkingArea {
                continue;
            }
            for (i, pair) in lane.shape.points().windows(2).enumerate() {
                let line = Line::new([pair[0].x, pair[0].y], [pair[1].x, pair[1].y]);
                segments.push(Segment::new(line, (LaneId(index as u32), i as u32)));
            }
        }
        Self(RTree::bulk_load(segments))
    }

    /// Lanes within `radius` (m) of `point`: see [`super::Network::lanes_near`].
    pub fn near(&self, lanes: &[Lane], point: Point, z: Option<f64>, radius: f64) -> Vec<NearLane> {
        let mut near: Vec<NearLane> = Vec::new();
        if !(point.x.is_finite() && point.y.is_finite() && radius >= 0.0) {
            return near;
        }
        for segment in self.0.locate_within_distance([point.x, point.y], radius * radius) {
            let (id, index) = segment.data;
            let shape = &lanes[id.index()].shape;
            let index = index as usize;
            let (a, b) = (shape.points()[index], shape.points()[index + 1]);
            let ab = b.xy() - a.xy();
            let t = ((point - a.xy()).dot(&ab) / ab.norm_squared()).clamp(0.0, 1.0);
            if z.is_some_and(|z| (a.z + (b.z - a.z) * t - z).abs() > LEVEL) {
                continue;
            }
            let distance = (point - (a.xy() + ab * t)).norm();
            let s = shape.arc_lengths()[index] + t * ab.norm();
            let d = distance.copysign(ab.perp(&(point - a.xy())));
            near.push(NearLane { lane: id, s, d, distance });
        }
        near.sort_by(|a, b| {
            a.lane.cmp(&b.lane).then(a.distance.total_cmp(&b.distance)).then(a.s.total_cmp(&b.s))
        });
        near.dedup_by_key(|n| n.lane);
        near.sort_by(|a, b| a.distance.total_cmp(&b.distance).then(a.lane.cmp(&b.lane)));
        near
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::net;
    use crate::geometry::Point;

    #[test]
    fn lanes_come_nearest_first_with_their_side() {
        let network = net();
        let near = network.lanes_near(Point::new(100.0, -2.0), None, 3.0);
        let names: Vec<&str> = near.iter().map(|n| network.lane(n.lane).id.as_str()).collect();
        assert_eq!(names, ["ab_1", "ab_0"]);
        assert!((near[0].s - 100.0).abs() < 1e-9 && (near[0].d + 0.4).abs() < 1e-9);
        assert!((near[1].d - 2.8).abs() < 1e-9);
        assert_eq!(network.lanes_near(Point::new(100.0, -2.0), None, 1.0).len(), 1);
        assert!(network.lanes_near(Point::new(100.0, -2.0), Some(4.0), 3.0).is_empty());
        assert!(network.lanes_near(Point::new(f64::NAN, 0.0), None, 3.0).is_empty());
    }
}
