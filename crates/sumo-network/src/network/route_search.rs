//! The cheapest way from one lane position to another, by travel time.
//!
//! The search runs over the lanes at which edges are entered. From each, the lanes of its edge that
//! can be changed to in the room there is lead on over their links.

use super::centre_line::Piece;
use super::*;
use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// What a turn-around costs (s): taken only where nothing else leads there.
const TURN_AROUND_COST: f64 = 600.0;
/// What a lane change costs (s), and what one costs more that gets no room (s).
const CHANGE_COST: f64 = 2.0;
const TIGHT_CHANGE_COST: f64 = 10.0;
/// A destination is ahead on the same lane from here on (m).
const AHEAD: f64 = 1.0;

/// How far changes may be squeezed.
#[derive(Clone, Copy, PartialEq)]
enum Room {
    /// Shortest change that is comfortable in town.
    Comfortable,
    /// Shortest change that a car can follow at walking pace.
    Tight,
}

/// Where the changes on a stretch lie.
struct Changes {
    /// Free way before the first (m).
    lead: f64,
    /// Length of each (m).
    length: f64,
    /// Free way between two (m).
    gap: f64,
    /// What they cost (s).
    cost: f64,
}

/// Room for `count` changes in `room` (m) of road with this speed limit (m/s); None where there is too little.
fn fit(room: f64, count: usize, speed: f64, mode: Room) -> Option<Changes> {
    if count == 0 {
        return Some(Changes { lead: 0.0, length: 0.0, gap: 0.0, cost: 0.0 });
    }
    let n = count as f64;
    let wished = (3.0 * speed).max(25.0);
    let (lead, gap, tail) = (10.0, 5.0, 20.0);
    let total = lead + tail + n * wished + (n - 1.0) * gap;
    let cost = |length: f64| n * (CHANGE_COST + TIGHT_CHANGE_COST * (1.0 - length / wished));
    // Where room is short all shrink alike, but the free way keeps two fifths of it.
    let free = total - n * wished;
    let squeezed = free.min((free * room / total).max(0.4 * room));
    let length = wished.min((room - squeezed) / n);
    let shortest = 12.0;
    if length >= shortest {
        let squeeze = squeezed / free;
        return Some(Changes { lead: lead * squeeze, length, gap: gap * squeeze, cost: cost(length) });
    }
    let shortest = if mode == Room::Tight { 9.0 } else { shortest };
    let (lead, gap, tail) = (1.0, 1.0, 2.0);
    let length = ((room - lead - tail - (n - 1.0) * gap) / n).min(shortest.max(12.0));
    (length >= shortest).then(|| Changes { lead, length, gap, cost: cost(length) })
}

/// How the search came to enter a lane.
#[derive(Clone, Copy)]
struct Step {
    /// The lane at which the edge before was entered; None from the start.
    before: Option<LaneId>,
    /// The lane by which it was left.
    exit: LaneId,
    link: LinkId,
}

/// A place in the queue: an edge entered at a lane, or the destination reached from there.
#[derive(Clone, Copy)]
struct Queued {
    cost: f64,
    lane: Option<LaneId>,
    goal: bool,
}

impl PartialEq for Queued {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}
impl Eq for Queued {}
impl PartialOrd for Queued {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}
impl Ord for Queued {
    /// The cheapest is the greatest, so that the heap gives it first; ties by lane.
    fn cmp(&self, other: &Self) -> Ordering {
        (other.cost.total_cmp(&self.cost)).then(other.goal.cmp(&self.goal)).then(other.lane.cmp(&self.lane))
    }
}

struct Search<'a> {
    network: &'a Network,
    class: VehicleClass,
    from: LanePosition,
    to: LanePosition,
    mode: Room,
    /// Cheapest cost (s) of entering each lane, and how.
    cost: Vec<f64>,
    step: Vec<Option<Step>>,
    queue: BinaryHeap<Queued>,
}

/// The pieces of the cheapest route.
pub(super) fn search(
    network: &Network,
    from: LanePosition,
    to: LanePosition,
    class: VehicleClass,
) -> Result<Vec<Piece>, RouteError> {
    let from = check(network, from, class)?;
    let to = check(network, to, class)?;
    let kind = |lane: LaneId| network.edge(network.lane(lane).edge).kind;
    if kind(to.lane) != EdgeKind::Normal {
        return Err(RouteError::NotARoad { lane: network.lane(to.lane).id.clone() });
    }
    let first_link = match kind(from.lane) {
        EdgeKind::Normal => None,
        EdgeKind::Internal => {
            let link = network.lane(from.lane).incoming.first().copied();
            Some(link.ok_or_else(|| RouteError::NotARoad { lane: network.lane(from.lane).id.clone() })?)
        }
        _ => return Err(RouteError::NotARoad { lane: network.lane(from.lane).id.clone() }),
    };
    for mode in [Room::Comfortable, Room::Tight] {
        let lanes = network.lanes.len();
        let mut search = Search {
            network,
            class,
            from,
            to,
            mode,
            cost: vec![f64::INFINITY; lanes],
            step: vec![None; lanes],
            queue: BinaryHeap::new(),
        };
        if let Some(pieces) = search.run(first_link) {
            return Ok(pieces);
        }
    }
    let edge = |lane: LaneId| network.edge(network.lane(lane).edge).id.clone();
    Err(RouteError::Unreachable { from: edge(from.lane), to: edge(to.lane), class })
}

/// The position, if it is on its lane and the class may be there.
fn check(network: &Network, place: LanePosition, class: VehicleClass) -> Result<LanePosition, RouteError> {
    let lane = network.lane(place.lane);
    let length = lane.shape.length();
    if !(-0.5..=length + 0.5).contains(&place.s) {
        return Err(RouteError::OffLane { lane: lane.id.clone(), s: place.s, length });
    }
    if !lane.permissions.allows(class) {
        return Err(RouteError::NotForClass { lane: lane.id.clone(), class });
    }
    Ok(LanePosition { lane: place.lane, s: place.s.clamp(0.0, length) })
}

impl Search<'_> {
    fn run(&mut self, first_link: Option<LinkId>) -> Option<Vec<Piece>> {
        match first_link {
            Some(link) => {
                let to = self.network.link(link).to;
                self.cost[to.index()] = 0.0;
                self.queue.push(Queued { cost: 0.0, lane: Some(to), goal: false });
            }
            None => self.expand(None, 0.0),
        }
        while let Some(next) = self.queue.pop() {
            match next {
                Queued { lane, goal: true, .. } => return Some(self.pieces(lane, first_link)),
                Queued { lane: Some(lane), cost, .. } if cost <= self.cost[lane.index()] => {
                    self.expand(Some(lane), cost);
                }
                _ => {}
            }
        }
        None
    }

    /// Lane and arc length (m) at which the edge of `entry` is entered.
    fn entry(&self, entry: Option<LaneId>) -> LanePosition {
        entry.map_or(self.from, |lane| LanePosition { lane, s: 0.0 })
    }

    fn speed(&self, lane: &Lane) -> f64 {
        lane.speed_limit.min(self.class.max_speed()).max(0.1)
    }

    /// Arc length (m) of the destination in terms of another lane of its edge.
    fn goal_on(&self, lane: LaneId) -> f64 {
        let own = self.network.lane(self.to.lane).shape.length();
        if lane == self.to.lane || own <= 0.0 {
            self.to.s
        } else {
            self.to.s / own * self.network.lane(lane).shape.length()
        }
    }

    fn expand(&mut self, entry: Option<LaneId>, cost: f64) {
        let network = self.network;
        let place = self.entry(entry);
        let lane = network.lane(place.lane);
        let edge = network.edge(lane.edge);
        let speed = self.speed(lane);
        let length = lane.shape.length();
        let goal_edge = network.lane(self.to.lane).edge == lane.edge;
        for up in [true, false] {
            for count in usize::from(!up).. {
                let index = if up { lane.index.checked_add(count) } else { lane.index.checked_sub(count) };
                let Some(&exit_id) = index.and_then(|i| edge.lanes.get(i)) else { break };
                let exit = network.lane(exit_id);
                if count > 0 && !self.may_change(edge, exit.index, up) {
                    break;
                }
                if goal_edge && exit_id == self.to.lane {
                    let way = self.goal_on(place.lane) - place.s;
                    // On an edge that is entered, every place is ahead; on the first edge, only the places after the start.
                    if (entry.is_some() || way >= AHEAD)
                        && let Some(changes) = fit(way, count, speed, self.mode)
                    {
                        let cost = cost + way / speed + changes.cost;
                        self.queue.push(Queued { cost, lane: entry, goal: true });
                    }
                }
                let way = length - place.s;
                let Some(changes) = fit(way, count, speed, self.mode) else { break };
                let cost = cost + way / speed + changes.cost;
                for &link_id in &exit.outgoing {
                    self.cross(entry, exit_id, link_id, cost);
                }
            }
        }
    }

    /// Whether the class may change to lane `index` of the edge from its neighbour below (`up`) or above.
    fn may_change(&self, edge: &Edge, index: usize, up: bool) -> bool {
        let lane = |i: usize| edge.lanes.get(i).map(|&l| self.network.lane(l));
        let (before, after) = if up { (index.checked_sub(1), index) } else { (Some(index + 1), index) };
        let (Some(before), Some(after)) = (before.and_then(lane), lane(after)) else { return false };
        let permission = if up { before.change_up } else { before.change_down };
        permission.allows(self.class)
            && after.permissions.allows(self.class)
            && !before.shape.is_degenerate()
            && !after.shape.is_degenerate()
    }

    fn cross(&mut self, entry: Option<LaneId>, exit: LaneId, link_id: LinkId, cost: f64) {
        let network = self.network;
        let link = network.link(link_id);
        let open = |lane: LaneId| network.lane(lane).permissions.allows(self.class);
        if !open(link.to) || !link.via.iter().all(|&l| open(l)) {
            return;
        }
        let mut cost = cost;
        for &via in &link.via {
            let lane = network.lane(via);
            cost += lane.shape.length() / self.speed(lane);
        }
        if link.direction == LinkDirection::TurnAround {
            cost += TURN_AROUND_COST;
        }
        if cost < self.cost[link.to.index()] {
            self.cost[link.to.index()] = cost;
            self.step[link.to.index()] = Some(Step { before: entry, exit, link: link_id });
            self.queue.push(Queued { cost, lane: Some(link.to), goal: false });
        }
    }

    /// The way to the destination, which was found from the edge entered at `last`.
    fn pieces(&self, last: Option<LaneId>, first_link: Option<LinkId>) -> Vec<Piece> {
        let mut steps = Vec::new();
        let mut at = last;
        while let Some(step) = at.and_then(|lane| self.step[lane.index()]) {
            steps.push(step);
            at = step.before;
        }
        steps.reverse();
        let mut pieces = Vec::new();
        let mut entry = self.from;
        if let Some(link) = first_link {
            let via = self.network.link(link).via.iter().position(|&l| l == self.from.lane).unwrap_or(0);
            pieces.push(Piece::Link { link, via, s: self.from.s });
            entry = LanePosition { lane: self.network.link(link).to, s: 0.0 };
        }
        for step in steps {
            let end = self.network.lane(entry.lane).shape.length();
            self.drive(&mut pieces, entry, step.exit, end);
            pieces.push(Piece::Link { link: step.link, via: 0, s: 0.0 });
            entry = LanePosition { lane: self.network.link(step.link).to, s: 0.0 };
        }
        let end = self.goal_on(entry.lane);
        self.drive(&mut pieces, entry, self.to.lane, end);
        if let Some(Piece::Lane { lane, to, .. }) = pieces.last_mut()
            && *lane == self.to.lane
        {
            *to = self.to.s;
        }
        pieces
    }

    /// From `entry` along its edge to `exit`, up to arc length `end` (m) of the entry lane.
    fn drive(&self, pieces: &mut Vec<Piece>, entry: LanePosition, exit: LaneId, end: f64) {
        let network = self.network;
        let first = network.lane(entry.lane);
        let target = network.lane(exit);
        let count = target.index.abs_diff(first.index);
        let mut here = entry;
        if let Some(changes) = fit(end - entry.s, count, self.speed(first), self.mode) {
            let lanes = &network.edge(first.edge).lanes;
            for i in 0..count {
                let index =
                    if target.index > first.index { first.index + i + 1 } else { first.index - i - 1 };
                let start = entry.s + changes.lead + i as f64 * (changes.length + changes.gap);
                let (a, b) = (here.lane, lanes[index]);
                let from = (
                    beside(network, entry.lane, start, a),
                    beside(network, entry.lane, start + changes.length, a),
                );
                let to = (
                    beside(network, entry.lane, start, b),
                    beside(network, entry.lane, start + changes.length, b),
                );
                if from.0 > here.s {
                    pieces.push(Piece::Lane { lane: a, from: here.s, to: from.0 });
                }
                pieces.push(Piece::Change { from_lane: a, from, to_lane: b, to });
                here = LanePosition { lane: b, s: to.1 };
            }
        }
        let end = if here.lane == entry.lane {
            end
        } else if count > 0 && end >= first.shape.length() {
            network.lane(here.lane).shape.length()
        } else {
            beside(network, entry.lane, end, here.lane)
        };
        pieces.push(Piece::Lane { lane: here.lane, from: here.s, to: end.max(here.s) });
    }
}

/// Arc length (m) on `other` beside arc length `s` (m) on `lane`, both lanes of one edge.
fn beside(network: &Network, lane: LaneId, s: f64, other: LaneId) -> f64 {
    if lane == other {
        return s;
    }
    let (own, other) = (&network.lane(lane).shape, &network.lane(other).shape);
    let guess = s * other.length() / own.length().max(1e-6);
    other.project_within(own.at(s).xy(), guess - 15.0, guess + 15.0).s
}
