//! Walks of pedestrians: from sidewalk to sidewalk over walkingareas and crossings.

use super::elements::{Edge, EdgeId, EdgeKind, Lane};
use super::parse::RawConnection;
use super::permissions::VehicleClass;
use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap};

/// Cost of crossing a junction, besides the way along the edges (m).
const JUNCTION: f64 = 10.0;

/// The walkable edges as an undirected graph. Its nodes are what hangs together at a junction:
/// walkingareas, the crossings between them, and the ends of the sidewalks that lead there.
#[derive(Clone, Debug, Default)]
pub(super) struct PedestrianNetwork {
    /// For each edge of the network the nodes at its begin and end; None without a sidewalk.
    ends: Vec<Option<[usize; 2]>>,
    /// For each node the edges that end there, with the end (0 begin, 1 end).
    at_node: HashMap<usize, Vec<(EdgeId, usize)>>,
    /// The edges of the largest connected part.
    largest: Vec<EdgeId>,
    walkingareas: bool,
}

/// Sets that grow together.
struct Sets(Vec<usize>);

impl Sets {
    fn find(&mut self, mut i: usize) -> usize {
        while self.0[i] != i {
            self.0[i] = self.0[self.0[i]];
            i = self.0[i];
        }
        i
    }

    fn join(&mut self, a: usize, b: usize) {
        let (a, b) = (self.find(a), self.find(b));
        self.0[a.max(b)] = a.min(b);
    }
}

/// A whole number that orders lengths (mm).
fn millimetres(length: f64) -> u64 {
    (length * 1000.0) as u64
}

impl PedestrianNetwork {
    pub fn new(
        edges: &[Edge],
        lanes: &[Lane],
        ids: &HashMap<String, EdgeId>,
        connections: &[RawConnection],
    ) -> Self {
        let walkable = |edge: EdgeId, lane: usize| {
            let lane = edges[edge.index()].lanes.get(lane);
            lane.is_some_and(|&l| lanes[l.index()].permissions.allows(VehicleClass::Pedestrian))
        };
        // Set 2e is the begin of edge e and 2e + 1 its end; inner edges have both in one.
        let mut sets = Sets((0..2 * edges.len()).collect());
        let node = |edge: EdgeId, end: usize| 2 * edge.index() + end;
        for (i, edge) in edges.iter().enumerate() {
            if edge.kind != EdgeKind::Normal {
                sets.join(2 * i, 2 * i + 1);
            }
        }
        for connection in connections {
            let (Some(&a), Some(&b)) = (ids.get(&connection.from), ids.get(&connection.to)) else {
                continue;
            };
            let foot = |edge: EdgeId| {
                matches!(
                    edges[edge.index()].kind,
                    EdgeKind::Normal | EdgeKind::Crossing | EdgeKind::WalkingArea
                )
            };
            let open = walkable(a, connection.from_lane) && walkable(b, connection.to_lane);
            if open && foot(a) && foot(b) {
                sets.join(node(a, 1), node(b, 0));
            }
        }
        let mut walks =
            Self { walkingareas: edges.iter().any(|e| e.kind == EdgeKind::WalkingArea), ..Self::default() };
        let mut parts = Sets((0..2 * edges.len()).collect());
        for (i, edge) in edges.iter().enumerate() {
            let id = EdgeId(i as u32);
            let open = edge.kind == EdgeKind::Normal && (0..edge.lanes.len()).any(|lane| walkable(id, lane));
            let ends = open.then(|| [sets.find(2 * i), sets.find(2 * i + 1)]);
            if let Some(ends) = ends {
                parts.join(ends[0], ends[1]);
                for (end, node) in ends.into_iter().enumerate() {
                    walks.at_node.entry(node).or_default().push((id, end));
                }
            }
            walks.ends.push(ends);
        }
        let mut sizes: HashMap<usize, usize> = HashMap::new();
        for ends in walks.ends.iter().flatten() {
            *sizes.entry(parts.find(ends[0])).or_default() += 1;
        }
        let largest =
            sizes.into_iter().max_by_key(|&(part, size)| (size, Reverse(part))).map(|(part, _)| part);
        for (i, ends) in walks.ends.iter().enumerate() {
            if ends.is_some_and(|e| Some(parts.find(e[0])) == largest) {
                walks.largest.push(EdgeId(i as u32));
            }
        }
        walks
    }

    /// Whether there are walkingareas and somewhere to walk: see [`super::Network::has_pedestrian_network`].
    pub fn is_complete(&self) -> bool {
        self.walkingareas && !self.largest.is_empty()
    }

    /// The edges of the largest connected part, in file order.
    pub fn largest(&self) -> &[EdgeId] {
        &self.largest
    }

    /// Whether one can walk from the begin of `edge` straight to `next`, and from its end: see
    /// [`super::Network::walks_on`].
    pub fn walks_on(&self, edge: EdgeId, next: EdgeId) -> [bool; 2] {
        let ends = |edge: EdgeId| self.ends.get(edge.index()).copied().flatten();
        let (Some(from), Some(to)) = (ends(edge), ends(next)) else { return [false; 2] };
        from.map(|node| to.contains(&node))
    }

    /// The shortest walk: see [`super::Network::walk_route`].
    pub fn route(&self, edges: &[Edge], lanes: &[Lane], from: EdgeId, to: EdgeId) -> Option<Vec<EdgeId>> {
        let ends = |edge: EdgeId| self.ends.get(edge.index()).copied().flatten();
        let length = |edge: EdgeId| {
            let lane = edges[edge.index()].lanes.first().map(|&l| &lanes[l.index()]);
            millimetres(lane.map_or(0.0, |l| l.shape.length()) + JUNCTION)
        };
        ends(from)?;
        ends(to)?;
        if from == to {
            return Some(vec![from]);
        }
        // A state is an edge and the end that it is walked towards: 2e or 2e + 1.
        let mut cost = vec![u64::MAX; 2 * edges.len()];
        let mut before = vec![usize::MAX; 2 * edges.len()];
        let mut queue = BinaryHeap::new();
        for state in [2 * from.index(), 2 * from.index() + 1] {
            cost[state] = 0;
            queue.push(Reverse((0, state)));
        }
        while let Some(Reverse((spent, state))) = queue.pop() {
            if spent > cost[state] {
                continue;
            }
            let edge = EdgeId((state / 2) as u32);
            if edge == to {
                let mut route = vec![edge];
                let mut at = before[state];
                while at != usize::MAX {
                    route.push(EdgeId((at / 2) as u32));
                    at = before[at];
                }
                route.reverse();
                return Some(route);
            }
            let node = ends(edge)?[state % 2];
            for &(next, end) in self.at_node.get(&node).map_or(&[][..], Vec::as_slice) {
                // In at one end, on to the other.
                let next_state = 2 * next.index() + (1 - end);
                let next_cost = spent + length(next);
                if next != edge && next_cost < cost[next_state] {
                    cost[next_state] = next_cost;
                    before[next_state] = state;
                    queue.push(Reverse((next_cost, next_state)));
                }
            }
        }
        None
    }
}
