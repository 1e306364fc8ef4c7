//! The routes of a net that suit each task, found once per net.

use super::{TaskError, TaskKind};
use crate::destination::EGO_CLASS;
use sumo_network::geometry::wrap_angle;
use sumo_network::network::{EdgeKind, LaneId, LinkDirection, LinkId, Network};

/// Lengths of the tasks' routes (m).
pub const TASK_LENGTH: f64 = 400.0;
pub const CROSS_LENGTH: f64 = 500.0;
/// Room kept behind the start and before the end of a lane at the goal (m), and before the first stop line.
pub const START_MARGIN: f64 = 8.0;
pub const END_MARGIN: f64 = 12.0;
pub const STOP_MARGIN: f64 = 15.0;
/// A straight way's heading stays within this of its first (rad).
const STRAIGHT: f64 = 0.26;
/// Most ways searched: more are not needed.
const MOST_WAYS: usize = 4000;
/// A junction with this many incoming roads is a cross intersection.
const ARMS: usize = 4;

/// Lanes that follow each other over links, without a lane change.
#[derive(Clone, Debug)]
pub struct Way {
    pub lanes: Vec<LaneId>,
    pub links: Vec<LinkId>,
    /// From the first lane's begin to the last one's end (m).
    pub length: f64,
    first: f64,
    last: f64,
}

impl Way {
    /// Where a route of `length` (m) may begin on the first lane so that it ends on the last one.
    pub fn starts(&self, length: f64) -> Option<(f64, f64)> {
        let low = START_MARGIN.max(self.length - self.last + START_MARGIN - length);
        let stop = if self.links.is_empty() { END_MARGIN } else { STOP_MARGIN };
        let high = (self.first - stop).min(self.length - END_MARGIN - length);
        (low < high).then_some((low, high))
    }

    /// Where on the last lane a route of `length` (m) from `start` ends.
    pub fn end(&self, start: f64, length: f64) -> f64 {
        start + length - (self.length - self.last)
    }
}

/// The conditions on a route.
#[derive(Clone, Copy)]
struct Wish {
    task: TaskKind,
    length: f64,
    turns: usize,
    /// Heading keeps within [`STRAIGHT`].
    straight: bool,
    /// It passes a signalled junction of four arms.
    cross: bool,
}

fn wish(task: TaskKind) -> Option<Wish> {
    let wish = Wish { task, length: TASK_LENGTH, turns: 0, straight: false, cross: false };
    match task {
        TaskKind::Straight => Some(Wish { straight: true, ..wish }),
        TaskKind::OneTurn => Some(Wish { turns: 1, ..wish }),
        TaskKind::Cross => Some(Wish { length: CROSS_LENGTH, turns: 1, cross: true, ..wish }),
        _ => None,
    }
}

/// The search for ways.
struct Search<'a> {
    network: &'a Network,
    wish: Wish,
    ring: Vec<bool>,
    found: Vec<Way>,
    /// The longest way that met everything but its length (m).
    longest: f64,
    /// Ways of full length that pass no such junction, or turn too rarely or in the wrong place.
    wrong_signals: usize,
    wrong_turns: usize,
    lanes: Vec<LaneId>,
    links: Vec<LinkId>,
}

/// All ways for one of the tasks that are ways ([`TaskKind::Straight`], [`TaskKind::OneTurn`],
/// [`TaskKind::Cross`]), in file order.
///
/// # Errors
/// There is none; says which condition fails.
pub fn ways(network: &Network, task: TaskKind) -> Result<Vec<Way>, TaskError> {
    let Some(wish) = wish(task) else { return Ok(Vec::new()) };
    let mut ring = vec![false; network.edges.len()];
    network.roundabouts.iter().flatten().for_each(|edge| ring[edge.index()] = true);
    let mut search = Search {
        network,
        wish,
        ring,
        found: Vec::new(),
        longest: 0.0,
        wrong_signals: 0,
        wrong_turns: 0,
        lanes: Vec::new(),
        links: Vec::new(),
    };
    for &lane in network.drivable_lanes(EGO_CLASS) {
        if search.found.len() < MOST_WAYS {
            search.from(lane);
        }
    }
    if search.found.is_empty() {
        return Err(TaskError::NoPlace { task, condition: search.why() });
    }
    Ok(search.found)
}

impl Search<'_> {
    fn from(&mut self, lane: LaneId) {
        let edge = self.network.lane(lane).edge;
        if self.network.edge(edge).kind != EdgeKind::Normal || self.ring[edge.index()] {
            return;
        }
        let length = self.network.lane(lane).shape.length();
        if length < START_MARGIN + STOP_MARGIN {
            return;
        }
        let heading = self.network.lane(lane).shape.at(0.0).heading;
        (self.lanes, self.links) = (vec![lane], Vec::new());
        self.extend(length, heading, 0);
    }

    /// The way so far is `length` (m) long, began with `heading` (rad) and turned `turns` times.
    fn extend(&mut self, length: f64, heading: f64, turns: usize) {
        let Some(&lane) = self.lanes.last() else { return };
        let shape = &self.network.lane(lane).shape;
        if self.wish.straight {
            let off = |s: f64| wrap_angle(shape.at(s).heading - heading).abs();
            let steps = (shape.length() / 10.0).ceil().max(1.0);
            if (0..=steps as usize).any(|i| off(shape.length() * i as f64 / steps) > STRAIGHT) {
                return;
            }
        }
        self.offer(length, turns);
        let first = self.lanes.first().map_or(0.0, |&l| self.network.lane(l).shape.length());
        // From its latest start it is long enough already.
        if length - (first - STOP_MARGIN) > self.wish.length || self.found.len() >= MOST_WAYS {
            return;
        }
        for &id in &self.network.lane(lane).outgoing {
            let link = self.network.link(id);
            let to = self.network.lane(link.to);
            let turn = matches!(link.direction, LinkDirection::Left | LinkDirection::Right);
            let open = to.permissions.allows(EGO_CLASS)
                && link.via.iter().all(|&l| self.network.lane(l).permissions.allows(EGO_CLASS));
            if !open
                || matches!(link.direction, LinkDirection::TurnAround | LinkDirection::Invalid)
                || self.ring[to.edge.index()]
                || self.lanes.iter().any(|&l| self.network.lane(l).edge == to.edge)
                || turns + usize::from(turn) > self.wish.turns
            {
                continue;
            }
            self.lanes.push(link.to);
            self.links.push(id);
            let more = self.network.link_length(id) + to.shape.length();
            self.extend(length + more, heading, turns + usize::from(turn));
            self.lanes.pop();
            self.links.pop();
        }
    }

    fn offer(&mut self, length: f64, turns: usize) {
        let length_of = |lane: Option<&LaneId>| lane.map_or(0.0, |&l| self.network.lane(l).shape.length());
        let way = Way {
            lanes: self.lanes.clone(),
            links: self.links.clone(),
            length,
            first: length_of(self.lanes.first()),
            last: length_of(self.lanes.last()),
        };
        let Some((low, high)) = way.starts(self.wish.length) else {
            if turns == self.wish.turns || self.wish.cross {
                self.longest = self.longest.max(length - START_MARGIN - END_MARGIN);
            }
            return;
        };
        let turns_right = self.wish.cross || turns == self.wish.turns;
        let signals_right = !self.wish.cross || self.crosses(&way);
        if !turns_right {
            self.wrong_turns += 1;
        } else if !signals_right {
            self.wrong_signals += 1;
        } else if self.wish.cross || turns == 0 || self.turn_is_midway(&way, low, high) {
            self.found.push(way);
        } else {
            self.wrong_turns += 1;
        }
    }

    /// Whether it passes a signalled junction of four arms.
    fn crosses(&self, way: &Way) -> bool {
        way.links.iter().any(|&id| {
            let link = self.network.link(id);
            link.signal.is_some() && arms(self.network, link.junction) >= ARMS
        })
    }

    /// Whether the turn comes between a fifth and four fifths of the route.
    fn turn_is_midway(&self, way: &Way, low: f64, high: f64) -> bool {
        let start = 0.5 * (low + high);
        let mut s = -start;
        for (i, &lane) in way.lanes.iter().enumerate() {
            s += self.network.lane(lane).shape.length();
            let Some(&id) = way.links.get(i) else { break };
            let link = self.network.link(id);
            if matches!(link.direction, LinkDirection::Left | LinkDirection::Right) {
                return (0.2..0.8).contains(&(s / self.wish.length));
            }
            s += self.network.link_length(id);
        }
        false
    }

    fn why(&self) -> String {
        let Wish { task, length, turns, cross, .. } = self.wish;
        let kind = match task {
            TaskKind::Straight => "straight way without a lane change or a turn",
            TaskKind::OneTurn => "way without a lane change that turns once",
            _ => "way without a lane change that turns at most once",
        };
        if cross && self.wrong_signals > 0 {
            return format!(
                "no signalled junction with {ARMS} or more incoming roads lies on any {kind} of {length:.0} m"
            );
        }
        let mut text =
            format!("it needs a {kind} of {length:.0} m, and the longest is {:.0} m", self.longest);
        if self.wrong_turns > 0 {
            text += &format!(
                "; ways that are long enough do not turn {turns} time(s) between a fifth and four fifths of it"
            );
        }
        text
    }
}

/// Roads for cars that lead into a junction.
fn arms(network: &Network, junction: sumo_network::network::JunctionId) -> usize {
    let open = |&&edge: &&sumo_network::network::EdgeId| {
        network.edge(edge).lanes.iter().any(|&l| network.lane(l).permissions.allows(EGO_CLASS))
            && network.edge(edge).kind == EdgeKind::Normal
    };
    network.junction(junction).incoming_edges.iter().filter(open).count()
}

/// An arm's entry into a roundabout, and the arm to leave by.
#[derive(Clone, Debug)]
pub struct Passage {
    /// Lanes of the first arm that lead in, and lanes of the third that lead out.
    pub entries: Vec<LaneId>,
    pub exits: Vec<LaneId>,
    /// Edges of the ring between them.
    pub ring: Vec<sumo_network::network::EdgeId>,
}

/// Every way in by an arm (the first) and out by the third, counted in the direction of travel.
///
/// # Errors
/// No roundabout has three arms.
pub fn passages(network: &Network) -> Result<Vec<Passage>, TaskError> {
    let no = |condition: &str| TaskError::NoPlace { task: TaskKind::Roundabout, condition: condition.into() };
    if network.roundabouts.is_empty() {
        return Err(no("the net has no roundabout (netconvert writes a <roundabout> for each it knows)"));
    }
    let mut found = Vec::new();
    for ring in &network.roundabouts {
        let inside = |lane: LaneId| ring.contains(&network.lane(lane).edge);
        let open = |lane: LaneId| network.lane(lane).permissions.allows(EGO_CLASS);
        let entering: Vec<_> =
            network.links.iter().filter(|l| !inside(l.from) && inside(l.to) && open(l.from)).collect();
        let mut arms: Vec<_> = entering.iter().map(|l| network.lane(l.from).edge).collect();
        arms.dedup();
        for arm in arms {
            let ways_in: Vec<_> =
                entering.iter().filter(|l| network.lane(l.from).edge == arm).copied().collect();
            let Some(first) = ways_in.first() else { continue };
            let mut edge = network.lane(first.to).edge;
            let mut passed = Vec::new();
            let mut arms_passed = 0;
            for _ in 0..ring.len() {
                passed.push(edge);
                let lanes = &network.edge(edge).lanes;
                let links =
                    || lanes.iter().flat_map(|&l| &network.lane(l).outgoing).map(|&l| network.link(l));
                let mut exits: Vec<LaneId> =
                    links().map(|l| l.to).filter(|&l| !inside(l) && open(l)).collect();
                exits.dedup();
                arms_passed += usize::from(!exits.is_empty());
                if arms_passed == 2 {
                    let mut entries: Vec<LaneId> = ways_in.iter().map(|l| l.from).collect();
                    entries.dedup();
                    found.push(Passage { entries, exits, ring: passed });
                    break;
                }
                let Some(next) = links().find(|l| inside(l.to)) else { break };
                edge = network.lane(next.to).edge;
            }
        }
    }
    if found.is_empty() {
        Err(no("no roundabout has an arm to enter by and a third to leave by"))
    } else {
        Ok(found)
    }
}
