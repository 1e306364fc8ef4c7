//! Where the vehicles of one class may go, and their random trips.

use super::draw::between;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::cmp::Reverse;
use std::collections::BinaryHeap;
use sumo_network::network::{EdgeId, EdgeKind, LaneId, LinkDirection, Network, VehicleClass};

/// Longest leg of a trip (m): it keeps the search small on nets of any size.
const LEG_MIN: f64 = 400.0;
const LEG_MAX: f64 = 1200.0;
/// Cost of a U-turn in the choice of a way (s).
const TURN_AROUND_COST: f64 = 90.0;
/// Bicycles keep off roads faster than this (m/s) while other ways are open to them.
const BICYCLE_ROAD_LIMIT: f64 = 17.0;
/// The shortest edge on which a vehicle is put (m), and the distance kept from its stop line (m).
pub(super) const SHORTEST_EDGE: f64 = 15.0;
pub(super) const STOP_LINE_GAP: f64 = 8.0;

/// A road that can follow another.
#[derive(Clone, Copy, Debug)]
struct Successor {
    edge: EdgeId,
    /// The lane that leads there.
    from: LaneId,
    turn_around: bool,
}

/// A lane on which vehicles of the class are put.
#[derive(Clone, Copy, Debug)]
pub(super) struct StartLane {
    pub lane: LaneId,
    pub edge: EdgeId,
    /// The furthest place for a front bumper (m, SUMO lane_position).
    pub last: f64,
}

/// The roads of one vehicle class.
#[derive(Debug)]
pub(super) struct Roads {
    /// By edge: what can follow it.
    successors: Vec<Vec<Successor>>,
    /// By edge: length (m) and time to drive it (s).
    length: Vec<f64>,
    time: Vec<f64>,
    /// Lanes to start on, in file order.
    pub starts: Vec<StartLane>,
    /// Running sum of their usable lengths (m), for a draw by length.
    usable: Vec<f64>,
    scratch: Scratch,
}

/// The buffers of a search, kept from one to the next.
#[derive(Debug, Default)]
struct Scratch {
    round: u32,
    /// By edge: the round in which the rest is valid.
    seen: Vec<u32>,
    cost: Vec<f64>,
    distance: Vec<f64>,
    before: Vec<Option<EdgeId>>,
    done: Vec<bool>,
    queue: BinaryHeap<Reverse<(u64, EdgeId)>>,
    settled: Vec<EdgeId>,
}

impl Roads {
    /// The roads of `class`. Where the net's roads fall apart into islands or hold dead ends, only
    /// the largest part in which every road can be reached from every other is used.
    pub fn new(network: &Network, class: VehicleClass) -> Self {
        let slow = |edge: EdgeId| {
            network.edge(edge).lanes.iter().all(|&l| network.lane(l).speed_limit <= BICYCLE_ROAD_LIMIT)
        };
        if class == VehicleClass::Bicycle {
            let quiet = Self::within(network, class, slow);
            let length: f64 = quiet.usable.last().copied().unwrap_or(0.0);
            if length > 1000.0 {
                return quiet;
            }
        }
        Self::within(network, class, |_| true)
    }

    fn within(network: &Network, class: VehicleClass, admitted: impl Fn(EdgeId) -> bool) -> Self {
        let count = network.edges.len();
        let open = |lane: LaneId| {
            let lane = network.lane(lane);
            lane.permissions.allows(class)
                && network.edge(lane.edge).kind == EdgeKind::Normal
                && admitted(lane.edge)
        };
        let mut successors: Vec<Vec<Successor>> = vec![Vec::new(); count];
        for link in &network.links {
            if open(link.from) && open(link.to) {
                successors[network.lane(link.from).edge.index()].push(Successor {
                    edge: network.lane(link.to).edge,
                    from: link.from,
                    turn_around: link.direction == LinkDirection::TurnAround,
                });
            }
        }
        let (mut length, mut time) = (vec![0.0; count], vec![0.0; count]);
        for (i, edge) in network.edges.iter().enumerate() {
            if let Some(&lane) = edge.lanes.iter().find(|&&l| open(l)) {
                let lane = network.lane(lane);
                length[i] = lane.length;
                time[i] = lane.length / lane.speed_limit.max(1.0) + 3.0;
            }
        }
        let core = largest_component(&successors);
        let has_core = core.iter().any(|&c| c);
        if has_core {
            for (i, list) in successors.iter_mut().enumerate() {
                list.retain(|s| core[i] && core[s.edge.index()]);
            }
        }
        let mut starts = Vec::new();
        for (i, lane) in network.lanes.iter().enumerate() {
            let id = LaneId(i as u32);
            let leads_on = successors[lane.edge.index()].iter().any(|s| s.from == id);
            if open(id) && lane.length >= SHORTEST_EDGE && (leads_on || !has_core) {
                starts.push(StartLane { lane: id, edge: lane.edge, last: lane.length - STOP_LINE_GAP });
            }
        }
        if class == VehicleClass::Bicycle {
            // On the outermost lane that leads on, so that they need not cross the traffic first.
            let mut taken = None;
            starts.retain(|s| taken.replace(s.edge) != Some(s.edge));
        }
        let mut sum = 0.0;
        let usable = starts
            .iter()
            .map(|s| {
                sum += s.last;
                sum
            })
            .collect();
        let scratch = Scratch {
            seen: vec![0; count],
            cost: vec![0.0; count],
            distance: vec![0.0; count],
            before: vec![None; count],
            done: vec![false; count],
            ..Scratch::default()
        };
        Self { successors, length, time, starts, usable, scratch }
    }

    /// A lane drawn by its usable length, and a place for the front bumper on it (m, SUMO
    /// lane_position) that leaves `length` (m) behind it on the lane where the lane is long enough.
    pub fn draw_start(&self, rng: &mut ChaCha8Rng, length: f64) -> Option<(StartLane, f64)> {
        let total = *self.usable.last()?;
        let at = rng.random::<f64>() * total;
        let start = *self.starts.get(self.usable.partition_point(|&sum| sum <= at))?;
        Some((start, between(rng, (length + 1.0).min(start.last), start.last)))
    }

    /// Length of an edge for this class (m); 0 where it may not drive.
    pub fn length(&self, edge: EdgeId) -> f64 {
        self.length[edge.index()]
    }

    /// Edges in order from `lane`'s own for a trip of `wanted` metres or more beyond it: legs to
    /// random destinations. Shorter only where the roads end.
    pub fn trip(&mut self, rng: &mut ChaCha8Rng, edge: EdgeId, lane: LaneId, wanted: f64) -> Vec<EdgeId> {
        let mut edges = vec![edge];
        let driven = self.leg(rng, &mut edges, Some(lane));
        if driven > 0.0 {
            self.extend(rng, &mut edges, wanted - driven);
        }
        edges
    }

    /// Appends legs to random destinations until `wanted` metres are added or the roads end.
    pub fn extend(&mut self, rng: &mut ChaCha8Rng, edges: &mut Vec<EdgeId>, wanted: f64) {
        let mut driven = 0.0;
        while driven < wanted {
            let leg = self.leg(rng, edges, None);
            if leg <= 0.0 {
                break;
            }
            driven += leg;
        }
    }

    /// Appends the quickest way from the last of `edges` to a random edge 400 to 1200 m off (the
    /// furthest one where all are nearer); returns its length (m). `first` restricts the first
    /// turn to those that lane leads to.
    fn leg(&mut self, rng: &mut ChaCha8Rng, edges: &mut Vec<EdgeId>, first: Option<LaneId>) -> f64 {
        let Some(&origin) = edges.last() else { return 0.0 };
        let s = &mut self.scratch;
        s.round = s.round.wrapping_add(1);
        s.queue.clear();
        s.settled.clear();
        let reach = between(rng, LEG_MIN, LEG_MAX);
        let relax = |s: &mut Scratch, next: &Successor, from: Option<EdgeId>, cost: f64, distance: f64| {
            let i = next.edge.index();
            let turn = if next.turn_around { TURN_AROUND_COST } else { 0.0 };
            let cost = cost + self.time[i] + turn;
            let fresh = s.seen[i] != s.round;
            if fresh || (!s.done[i] && cost < s.cost[i]) {
                s.seen[i] = s.round;
                s.done[i] = false;
                s.cost[i] = cost;
                s.distance[i] = distance + self.length[i];
                s.before[i] = from;
                // Costs are finite and not negative: their bits are ordered as they are.
                s.queue.push(Reverse((cost.to_bits(), next.edge)));
            }
        };
        for next in &self.successors[origin.index()] {
            if first.is_none_or(|lane| lane == next.from) {
                relax(s, next, None, 0.0, 0.0);
            }
        }
        while let Some(Reverse((cost, edge))) = s.queue.pop() {
            let i = edge.index();
            if s.done[i] || cost != s.cost[i].to_bits() {
                continue;
            }
            s.done[i] = true;
            s.settled.push(edge);
            let (cost, distance) = (s.cost[i], s.distance[i]);
            if distance < reach && edge != origin {
                for next in &self.successors[i] {
                    relax(s, next, Some(edge), cost, distance);
                }
            }
        }
        let s = &self.scratch;
        let far = |e: &&EdgeId| s.distance[e.index()] >= 0.6 * reach && **e != origin;
        let candidates = s.settled.iter().filter(far).count();
        let chosen = if candidates > 0 {
            s.settled.iter().filter(far).nth(rng.random_range(0..candidates)).copied()
        } else {
            s.settled.iter().copied().max_by(|a, b| s.distance[a.index()].total_cmp(&s.distance[b.index()]))
        };
        let Some(goal) = chosen else { return 0.0 };
        let at = edges.len();
        let mut edge = Some(goal);
        while let Some(e) = edge {
            edges.push(e);
            edge = s.before[e.index()];
        }
        edges[at..].reverse();
        s.distance[goal.index()]
    }
}

/// The largest strongly connected component with at least two edges in it, as a mask; nothing
/// where there is none (Tarjan's algorithm without recursion).
fn largest_component(successors: &[Vec<Successor>]) -> Vec<bool> {
    let count = successors.len();
    const NEW: u32 = u32::MAX;
    let (mut order, mut low) = (vec![NEW; count], vec![0u32; count]);
    let mut on_stack = vec![false; count];
    let (mut stack, mut calls) = (Vec::new(), Vec::new());
    let mut next = 0;
    let mut best: Vec<usize> = Vec::new();
    for root in 0..count {
        if order[root] != NEW || successors[root].is_empty() {
            continue;
        }
        calls.push((root, 0));
        while let Some((v, child)) = calls.pop() {
            if child == 0 {
                order[v] = next;
                low[v] = next;
                next += 1;
                stack.push(v);
                on_stack[v] = true;
            } else {
                let w = successors[v][child - 1].edge.index();
                low[v] = low[v].min(low[w]);
            }
            let mut descend = None;
            for (i, s) in successors[v].iter().enumerate().skip(child) {
                let w = s.edge.index();
                if order[w] == NEW {
                    descend = Some((i, w));
                    break;
                } else if on_stack[w] {
                    low[v] = low[v].min(order[w]);
                }
            }
            if let Some((i, w)) = descend {
                calls.push((v, i + 1));
                calls.push((w, 0));
                continue;
            }
            if low[v] == order[v] {
                let at = stack.iter().rposition(|&w| w == v).unwrap_or(0);
                let component = stack.split_off(at);
                for &w in &component {
                    on_stack[w] = false;
                }
                if component.len() > best.len().max(1) {
                    best = component;
                }
            }
        }
    }
    let mut mask = vec![false; count];
    for v in best {
        mask[v] = true;
    }
    mask
}
