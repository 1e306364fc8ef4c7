//! Where pedestrians may go, and their random walks.
//!
//! Sidewalks meet at walkingareas; crossings join the walkingareas of a junction. Which sidewalk and
//! which crossing touch which walkingarea is read off the geometry.

use super::draw::between;
use crate::geometry::Point;
use crate::network::{EdgeId, EdgeKind, LaneId, Network, VehicleClass};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// A sidewalk's end, or a crossing's, touches the nearest walkingarea within this distance (m).
const TOUCH: f64 = 3.0;
/// Sidewalks shorter than this (m) are walked through, but nobody starts there.
const SHORTEST_START: f64 = 8.0;

/// A place where sidewalks meet: walkingareas that crossings join.
type Corner = usize;

/// A road's sidewalk.
#[derive(Clone, Copy, Debug)]
struct Sidewalk {
    lane: LaneId,
    length: f64,
    /// Where one can go on at the edge's begin and end.
    corners: [Option<Corner>; 2],
}

/// A walk along edges.
#[derive(Clone, Debug)]
pub(super) struct Walk {
    /// Normal edges in order, as SUMO wants them.
    pub edges: Vec<EdgeId>,
    /// Where it begins and ends on the first and last edge (m, SUMO lane_position).
    pub from: f64,
    pub to: f64,
    /// At least so long (m): ways over junctions are left out.
    pub length: f64,
}

/// All sidewalks.
#[derive(Debug)]
pub(super) struct Walks {
    /// By edge.
    sidewalks: Vec<Option<Sidewalk>>,
    /// By corner: the edges whose sidewalks meet there.
    meeting: Vec<Vec<EdgeId>>,
    /// Edges to start on, with the running sum of their lengths (m).
    starts: Vec<EdgeId>,
    sums: Vec<f64>,
}

impl Walks {
    /// The sidewalks of a net. A net without walkingareas has none that SUMO's pedestrians can use
    /// from road to road.
    pub fn new(network: &Network) -> Self {
        let corner_of = corners(network);
        let corner_near = |junction: Option<crate::network::JunctionId>, point: Point| {
            let areas = &network.junction(junction?).walkingareas;
            nearest_area(network, areas, point).and_then(|area| corner_of[area.index()])
        };
        let mut sidewalks: Vec<Option<Sidewalk>> = vec![None; network.edges.len()];
        let count = corner_of.iter().flatten().max().map_or(0, |&c| c + 1);
        let mut meeting = vec![Vec::new(); count];
        for (i, edge) in network.edges.iter().enumerate() {
            if edge.kind != EdgeKind::Normal {
                continue;
            }
            let walkable = |&&l: &&LaneId| {
                let permissions = network.lane(l).permissions;
                permissions.allows(VehicleClass::Pedestrian) && !permissions.allows(VehicleClass::Passenger)
            };
            let Some(&id) = edge.lanes.iter().find(walkable) else { continue };
            let lane = network.lane(id);
            let points = lane.shape.points();
            let (Some(first), Some(last)) = (points.first(), points.last()) else { continue };
            let corners = [corner_near(edge.from, first.xy()), corner_near(edge.to, last.xy())];
            for corner in corners.into_iter().flatten() {
                meeting[corner].push(EdgeId(i as u32));
            }
            sidewalks[i] = Some(Sidewalk { lane: id, length: lane.length, corners });
        }
        let mut walks = Self { sidewalks, meeting, starts: Vec::new(), sums: Vec::new() };
        let mut sum = 0.0;
        for i in 0..network.edges.len() {
            let edge = EdgeId(i as u32);
            let Some(sidewalk) = walks.sidewalks[i] else { continue };
            let goes_on = (0..2).any(|end| walks.next(network, edge, end).next().is_some());
            if goes_on && sidewalk.length >= SHORTEST_START {
                sum += sidewalk.length;
                walks.starts.push(edge);
                walks.sums.push(sum);
            }
        }
        walks
    }

    /// Whether nobody can walk here.
    pub fn is_empty(&self) -> bool {
        self.starts.is_empty()
    }

    /// The sidewalk lane of an edge.
    pub fn lane(&self, edge: EdgeId) -> Option<LaneId> {
        self.sidewalks[edge.index()].map(|s| s.lane)
    }

    /// A place drawn evenly over all sidewalks: edge and position (m, SUMO lane_position).
    pub fn draw_start(&self, rng: &mut ChaCha8Rng) -> Option<(EdgeId, f64)> {
        let total = *self.sums.last()?;
        let at = rng.random::<f64>() * total;
        let edge = *self.starts.get(self.sums.partition_point(|&sum| sum <= at))?;
        let length = self.sidewalks[edge.index()]?.length;
        Some((edge, between(rng, 1.0, length - 1.0)))
    }

    /// A random walk from `from` (m, SUMO lane_position) on `edge`, `wanted` metres long or a little
    /// longer; it turns back nowhere but where the sidewalks end.
    pub fn walk(
        &self,
        rng: &mut ChaCha8Rng,
        network: &Network,
        edge: EdgeId,
        from: f64,
        wanted: f64,
    ) -> Option<Walk> {
        let first = self.sidewalks[edge.index()]?;
        let mut walk = Walk { edges: vec![edge], from, to: from, length: 0.0 };
        let mut end = rng.random_range(0..2);
        if self.next(network, edge, end).next().is_none() {
            end = 1 - end;
        }
        // Length of what is walked on the edge at hand.
        let mut on_edge = if end == 1 { first.length - from } else { from };
        let mut here = edge;
        loop {
            let ways = self.next(network, here, end).count();
            if ways == 0 || walk.length + on_edge >= wanted {
                break;
            }
            let Some(next) = self.next(network, here, end).nth(rng.random_range(0..ways)) else { break };
            let (Some(now), Some(then)) = (self.sidewalks[here.index()], self.sidewalks[next.index()]) else {
                break;
            };
            walk.length += on_edge;
            on_edge = then.length;
            // It leaves the next edge at the other end than the one where it comes in.
            end = if then.corners[0] == now.corners[end] { 1 } else { 0 };
            walk.edges.push(next);
            here = next;
        }
        let last = self.sidewalks[here.index()]?.length;
        if walk.edges.len() == 1 {
            walk.to = if end == 1 { (last - 1.0).max(from) } else { from.min(1.0) };
            walk.length = (walk.to - from).abs();
        } else {
            let part = between(rng, 0.2, 0.8) * last;
            walk.to = if end == 1 { part } else { last - part };
            walk.length += part;
        }
        Some(walk)
    }

    /// Edges that can follow when `edge` is left at its begin (0) or end (1). An edge between the
    /// same two junctions is none: SUMO could not tell which way round is meant.
    fn next<'a>(
        &'a self,
        network: &'a Network,
        edge: EdgeId,
        end: usize,
    ) -> impl Iterator<Item = EdgeId> + 'a {
        let corner = self.sidewalks[edge.index()].and_then(|s| s.corners[end]);
        let ends = |e: EdgeId| {
            let e = network.edge(e);
            (e.from.min(e.to), e.from.max(e.to))
        };
        let meeting = corner.map_or(&[][..], |c| &self.meeting[c]);
        meeting.iter().copied().filter(move |&other| other != edge && ends(other) != ends(edge))
    }
}

/// By lane: the corner of each walkingarea, counted from 0.
fn corners(network: &Network) -> Vec<Option<Corner>> {
    let mut parent: Vec<usize> = (0..network.lanes.len()).collect();
    fn root(parent: &mut [usize], mut i: usize) -> usize {
        while parent[i] != i {
            parent[i] = parent[parent[i]];
            i = parent[i];
        }
        i
    }
    for crossing in &network.crossings {
        let areas = &network.junction(crossing.junction).walkingareas;
        let points = network.lane(crossing.lane).shape.points();
        let (Some(a), Some(b)) = (points.first(), points.last()) else { continue };
        let ends = [a, b].map(|p| nearest_area(network, areas, p.xy()));
        if let [Some(a), Some(b)] = ends {
            let (a, b) = (root(&mut parent, a.index()), root(&mut parent, b.index()));
            parent[a.max(b)] = a.min(b);
        }
    }
    let mut numbers: Vec<Option<Corner>> = vec![None; network.lanes.len()];
    let mut corner_of = vec![None; network.lanes.len()];
    let mut count = 0;
    for junction in &network.junctions {
        for area in &junction.walkingareas {
            let root = root(&mut parent, area.index());
            let number = *numbers[root].get_or_insert_with(|| {
                count += 1;
                count - 1
            });
            corner_of[area.index()] = Some(number);
        }
    }
    corner_of
}

/// The walkingarea whose outline passes nearest to `point`, or holds it.
fn nearest_area(network: &Network, areas: &[LaneId], point: Point) -> Option<LaneId> {
    let distances = areas.iter().map(|&area| {
        let outline: Vec<Point> = network.lane(area).shape.points().iter().map(|p| p.xy()).collect();
        (distance_to_polygon(&outline, point), area)
    });
    let (distance, area) = distances.min_by(|a, b| a.0.total_cmp(&b.0))?;
    (distance <= TOUCH).then_some(area)
}

/// Distance from a point to a polygon (m), 0 inside.
fn distance_to_polygon(outline: &[Point], point: Point) -> f64 {
    let mut best = f64::INFINITY;
    let mut inside = false;
    for (i, a) in outline.iter().enumerate() {
        let b = outline[(i + 1) % outline.len()];
        let ab = b - a;
        let t = if ab.norm_squared() > 0.0 { (point - a).dot(&ab) / ab.norm_squared() } else { 0.0 };
        best = best.min((point - (a + ab * t.clamp(0.0, 1.0))).norm());
        if (a.y > point.y) != (b.y > point.y)
            && point.x < a.x + (point.y - a.y) / (b.y - a.y) * (b.x - a.x)
        {
            inside = !inside;
        }
    }
    if inside { 0.0 } else { best }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distance_to_a_square() {
        let square = [(0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (0.0, 4.0)].map(|(x, y)| Point::new(x, y));
        assert_eq!(distance_to_polygon(&square, Point::new(2.0, 2.0)), 0.0);
        assert_eq!(distance_to_polygon(&square, Point::new(7.0, 8.0)), 5.0);
        assert_eq!(distance_to_polygon(&square, Point::new(2.0, -1.5)), 1.5);
        assert_eq!(distance_to_polygon(&[], Point::new(2.0, -1.5)), f64::INFINITY);
    }
}
