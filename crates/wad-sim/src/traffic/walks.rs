//! Where pedestrians start, and their random walks.

use super::draw::between;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use sumo_network::network::{EdgeId, LaneId, Network, VehicleClass};

/// On sidewalks shorter than this (m) no walk starts or ends.
const SHORTEST: f64 = 8.0;
/// Destinations drawn for one walk at the most.
const DRAWS: usize = 4;

/// A walk along edges.
#[derive(Clone, Debug)]
pub(super) struct Walk {
    /// Normal edges in order, as SUMO wants them.
    pub edges: Vec<EdgeId>,
    /// Where it ends on the last edge (m, SUMO lane_position).
    pub to: f64,
    /// At least so long (m): ways over junctions are left out.
    pub length: f64,
}

/// The sidewalks of the network's largest part that hangs together.
#[derive(Debug)]
pub(super) struct Walks {
    /// Edges to start and end on, with the running sum of their lengths (m).
    starts: Vec<EdgeId>,
    sums: Vec<f64>,
}

impl Walks {
    /// The sidewalks of a net; none where SUMO's pedestrians could not walk from road to road.
    pub fn new(network: &Network) -> Self {
        let mut walks = Self { starts: Vec::new(), sums: Vec::new() };
        if !network.has_pedestrian_network() {
            return walks;
        }
        let mut sum = 0.0;
        for &edge in network.sidewalk_edges() {
            let length = length(network, edge);
            if length >= SHORTEST {
                sum += length;
                walks.starts.push(edge);
                walks.sums.push(sum);
            }
        }
        walks
    }

    /// Whether there is no sidewalk to walk on.
    pub fn is_empty(&self) -> bool {
        self.starts.is_empty()
    }

    /// A place drawn evenly over all sidewalks: edge and position (m, SUMO lane_position).
    pub fn draw_start(&self, rng: &mut ChaCha8Rng, network: &Network) -> Option<(EdgeId, f64)> {
        let total = *self.sums.last()?;
        let at = rng.random::<f64>() * total;
        let edge = *self.starts.get(self.sums.partition_point(|&sum| sum <= at))?;
        Some((edge, between(rng, 1.0, length(network, edge) - 1.0)))
    }

    /// A walk from `from` (m, SUMO lane_position) on `edge` towards a random destination, cut off
    /// where it is `wanted` metres long. It may leave its first edge at either end, so it has to be
    /// a stage of its own in SUMO: within a stage a person never turns round.
    pub fn walk(
        &self,
        rng: &mut ChaCha8Rng,
        network: &Network,
        edge: EdgeId,
        from: f64,
        wanted: f64,
    ) -> Option<Walk> {
        let mut edges = vec![edge];
        for _ in 0..DRAWS {
            let (goal, _) = self.draw_start(rng, network)?;
            if goal != edge
                && let Some(route) = network.walk_route(edge, goal)
                && !leaves_at_a_wrong_end(network, &route)
            {
                edges = route;
                break;
            }
        }
        while edges.len() > 2 && length_over(network, &edges[..edges.len() - 1], from) >= wanted {
            edges.pop();
        }
        let &last = edges.last()?;
        let before = length_over(network, &edges, from);
        let whole = length(network, last);
        let part = between(rng, 0.3, 0.9) * whole;
        let (to, length) = match edges.len() {
            // Nowhere to go: to the further end of the one sidewalk.
            1 if from > 0.5 * whole => (1.0, from - 1.0),
            1 => ((whole - 1.0).max(0.0), whole - 1.0 - from),
            n => match ways_in(network, edges[n - 2], last) {
                (true, true) => (part, before + part.min(whole - part)),
                (true, false) => (part, before + part),
                _ => (whole - part, before + part),
            },
        };
        Some(Walk { edges, to, length: length.max(0.0) })
    }
}

/// The sidewalk lane of an edge.
pub(super) fn sidewalk(network: &Network, edge: EdgeId) -> Option<LaneId> {
    let walkable = |&&l: &&LaneId| network.lane(l).permissions.allows(VehicleClass::Pedestrian);
    network.edge(edge).lanes.iter().find(walkable).copied()
}

fn length(network: &Network, edge: EdgeId) -> f64 {
    sidewalk(network, edge).map_or(0.0, |lane| network.lane(lane).length)
}

/// Whether SUMO may leave the first of `edges` at an end where no way leads on, and then quits ("Disconnected walk"): it goes by
/// the junctions that the second edge touches, not by crossings, and two sides of one street touch the same ones.
fn leaves_at_a_wrong_end(network: &Network, edges: &[EdgeId]) -> bool {
    let &[first, second, ..] = edges else { return false };
    let (begin, end) = ways_in(network, second, first);
    [begin, end] != network.walks_on(first, second)
}

/// Whether a walk from `before` may come onto `edge` at its begin, and at its end.
fn ways_in(network: &Network, before: EdgeId, edge: EdgeId) -> (bool, bool) {
    let (before, edge) = (network.edge(before), network.edge(edge));
    let touches = |junction| before.from == junction || before.to == junction;
    (touches(edge.from), touches(edge.to))
}

/// Length (m) of a walk from `from` (m) on the first of `edges` to where it comes onto the last one;
/// the lesser one where it may go either way round.
fn length_over(network: &Network, edges: &[EdgeId], from: f64) -> f64 {
    let Some((&first, rest)) = edges.split_first() else { return 0.0 };
    let Some(&second) = rest.first() else { return 0.0 };
    let start = match ways_in(network, second, first) {
        (true, false) => from,
        (false, true) => length(network, first) - from,
        _ => from.min(length(network, first) - from),
    };
    start + rest[..rest.len() - 1].iter().map(|&e| length(network, e)).sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use std::path::Path;

    #[test]
    fn no_walk_leaves_its_first_sidewalk_where_no_way_leads_on() {
        let file = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../sumo_nets/town7/town7.net.xml"));
        let network = Network::from_xml(file, &std::fs::read_to_string(file).unwrap()).unwrap();
        let edge = |id: &str| network.edge_by_id(id).unwrap();
        // Two sides of one street, with a crossing at one of its ends.
        let (here, there) = (edge("east-press"), edge("press-east"));
        assert_eq!(network.walks_on(here, there), [false, true]);
        let over = network.walk_route(here, there).unwrap();
        assert!(over.len() == 2 && leaves_at_a_wrong_end(&network, &over));
        let (walks, mut rng) = (Walks::new(&network), ChaCha8Rng::seed_from_u64(1));
        let mut far = 0;
        for _ in 0..3000 {
            let (edge, at) = walks.draw_start(&mut rng, &network).unwrap();
            let walk = walks.walk(&mut rng, &network, edge, at, 300.0).unwrap();
            assert!(!leaves_at_a_wrong_end(&network, &walk.edges));
            far += usize::from(walk.edges.len() > 1);
        }
        assert!(far > 2900, "{far}");
    }
}
