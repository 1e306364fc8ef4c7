//! Paint: lines between lanes and directions, stop lines, zebra crossings, arrows.

use super::roads::{JunctionHeight, Station, Surface, stations, surface};
use super::tiles::Tiles;
use nalgebra::Point3;
use sumo_network::geometry::{Point, Pose, Vector};
use sumo_network::network::{EdgeId, EdgeKind, LaneId, LinkDirection, Network, VehicleClass};

/// Breadth of a line (m).
const LINE: f64 = 0.12;
/// The middle of a carriageway's border line lies this far inside the lane (m): what shows the lane's
/// border is where the lane ends.
const BORDER_LINE: f64 = 0.07;
/// Borders of opposite directions further apart than this (m) have a median between them.
const ADJACENT: f64 = 1.0;

/// A painter for one line of stations.
struct Painter<'a> {
    tiles: &'a mut Tiles,
    line: Vec<Station>,
    length: f64,
    /// Lines along the lane keep to this stretch of it (m): they end with the stop line.
    reach: (f64, f64),
    strength: f32,
}

impl Painter<'_> {
    /// A stripe `d` (m) left of the line from `from` to `to` along it (m).
    fn stripe(&mut self, d: f64, breadth: f64, from: f64, to: f64) {
        let (from, to) = (from.max(self.reach.0), to.min(self.reach.1));
        if to - from < 0.05 {
            return;
        }
        let inner = |s: f64| s > from + 0.01 && s < to - 0.01;
        let at = |s: f64| -> Station {
            let i = self.line.partition_point(|k| k.s <= s).clamp(1, self.line.len() - 1);
            let (a, b) = (&self.line[i - 1], &self.line[i]);
            let t = ((s - a.s) / (b.s - a.s).max(1e-9)).clamp(0.0, 1.0);
            Station { at: a.at + (b.at - a.at) * t, left: a.left + (b.left - a.left) * t, s }
        };
        let mut line = vec![at(from)];
        line.extend(self.line.iter().filter(|k| inner(k.s)).copied());
        line.push(at(to));
        let (lo, hi) = (d - 0.5 * breadth, d + 0.5 * breadth);
        let last = line.len() - 2;
        for (i, pair) in line.windows(2).enumerate() {
            let q = [pair[0].off(lo, 0.0), pair[1].off(lo, 0.0), pair[1].off(hi, 0.0), pair[0].off(hi, 0.0)];
            self.tiles.paint(q, self.strength, [i == last, i == 0]);
        }
    }

    fn dashes(&mut self, d: f64, dash: f64, gap: f64) {
        let period = dash + gap;
        let count = ((self.length - dash) / period).floor().max(0.0);
        // Centred, so that both ends look alike.
        let mut s = 0.5 * (self.length - count * period - dash);
        // The last one is not cut short to a stump.
        while s + 0.5 * dash < self.reach.1 {
            self.stripe(d, LINE, s, s + dash);
            s += period;
        }
    }
}

/// The leftmost driven lane of an edge (rightmost where traffic keeps left).
pub(super) fn innermost(network: &Network, edge: EdgeId) -> Option<LaneId> {
    network.edge(edge).lanes.iter().rev().copied().find(|&l| surface(network.lane(l)) == Surface::Road)
}

/// The edge of the other direction beside this one, and the gap (m) between their carriageways.
pub(super) fn opposite(network: &Network, edge: EdgeId) -> Option<(EdgeId, f64)> {
    let this = network.edge(edge);
    let (from, to) = (this.from?, this.to?);
    let lane = network.lane(innermost(network, edge)?);
    let middle = lane.shape.at(0.5 * lane.shape.length());
    let mut best: Option<(EdgeId, f64)> = None;
    for &other in &network.junction(to).outgoing_edges {
        if network.edge(other).to != Some(from) || other == edge {
            continue;
        }
        let Some(id) = innermost(network, other) else { continue };
        let theirs = network.lane(id);
        let p = theirs.shape.project(middle.xy());
        let gap = p.distance - 0.5 * (lane.width + theirs.width);
        if best.is_none_or(|(_, g)| gap.abs() < g.abs()) {
            best = Some((other, gap));
        }
    }
    best.filter(|(_, gap)| *gap < 15.0)
}

/// Paints the whole network.
pub(super) fn build(network: &Network, seed: u64, tiles: &mut Tiles) {
    for number in 0..network.edges.len() {
        let id = EdgeId(number as u32);
        if network.edge(id).kind == EdgeKind::Normal {
            edge(network, id, seed, tiles);
        }
    }
    for crossing in &network.crossings {
        let lane = network.lane(crossing.lane);
        let line = stations(&lane.shape, 1e6);
        let length = lane.shape.length();
        if length < 1.0 || line.len() < 2 {
            continue;
        }
        let half = 0.5 * lane.width - 0.25;
        let height = JunctionHeight::of(network, network.junction(crossing.junction));
        let (bar, gap) = (0.5, 0.5);
        let count = ((length - 0.5) / (bar + gap)).floor().max(1.0);
        let mut s = 0.5 * (length - count * (bar + gap) + gap);
        while s + bar < length - 0.1 {
            let a = lane.shape.at(s);
            let b = lane.shape.at(s + bar);
            let p = |pose: &Pose, d: f64| {
                let q = pose.to_world(Vector::new(0.0, d));
                Point3::new(q.x, q.y, height.surface(q))
            };
            // The long sides lie along the traffic.
            let q = [p(&b, -half), p(&b, half), p(&a, half), p(&a, -half)];
            tiles.paint(q, 0.85, [true, true]);
            s += bar + gap;
        }
    }
}

/// The line on the inner side of a lane: its centre, m left of the lane's.
enum Inner {
    Solid(f64),
    Dashes {
        d: f64,
        dash: f64,
        gap: f64,
    },
    /// Between this direction and the other: two lines, or dashes on narrow roads.
    Between {
        middle: f64,
        double: bool,
        other: EdgeId,
    },
}

/// From the middle of a double line to its two (m).
const DOUBLE: f64 = 0.12;

fn inward(network: &Network) -> f64 {
    if network.left_hand { -1.0 } else { 1.0 }
}

fn driven(network: &Network, id: EdgeId) -> Vec<LaneId> {
    network.edge(id).lanes.iter().copied().filter(|&l| surface(network.lane(l)) == Surface::Road).collect()
}

/// Narrow roads have no lines at their borders.
fn is_narrow(network: &Network, driven: &[LaneId]) -> bool {
    driven.last().is_some_and(|&inner| network.lane(inner).width < 2.9)
}

fn inner_line(network: &Network, id: LaneId, driven: &[LaneId]) -> Inner {
    let lane = network.lane(id);
    let (half, inward) = (0.5 * lane.width, inward(network));
    let next = driven.iter().position(|&l| l == id).and_then(|i| driven.get(i + 1)).map(|&l| network.lane(l));
    let Some(next) = next else {
        return match opposite(network, lane.edge) {
            Some((other, gap)) if gap < ADJACENT => Inner::Between {
                middle: inward * (half + 0.5 * gap.max(0.0)),
                double: !is_narrow(network, driven),
                other,
            },
            _ => Inner::Solid(inward * (half - BORDER_LINE)),
        };
    };
    let car = VehicleClass::Passenger;
    let open = lane.change_up.allows(car) || next.change_down.allows(car);
    let cycle_lane = !lane.permissions.allows(car) || !next.permissions.allows(car);
    let d = inward * half;
    match () {
        () if !open || cycle_lane => Inner::Solid(d),
        () if lane.speed_limit > 20.0 => Inner::Dashes { d, dash: 6.0, gap: 12.0 },
        () => Inner::Dashes { d, dash: 3.0, gap: 6.0 },
    }
}

/// The line on the outer side of a lane (m left of its centre): the road's border or the next lane's line.
fn outer_line(network: &Network, id: LaneId, driven: &[LaneId]) -> Option<f64> {
    let half = 0.5 * network.lane(id).width;
    if driven.first() != Some(&id) {
        return Some(-inward(network) * half);
    }
    (!is_narrow(network, driven)).then(|| -inward(network) * (half - BORDER_LINE))
}

/// Where the painted lines next to a lane's centre are: left and right, m left of the lane's centre line;
/// None where there is none, as inside junctions.
pub fn painted_sides(network: &Network, id: LaneId) -> [Option<f64>; 2] {
    let edge = network.lane(id).edge;
    let driven = driven(network, edge);
    if network.edge(edge).kind != EdgeKind::Normal || !driven.contains(&id) {
        return [None; 2];
    }
    let inner = match inner_line(network, id, &driven) {
        Inner::Solid(d) | Inner::Dashes { d, .. } => d,
        Inner::Between { middle, double: false, .. } => middle,
        Inner::Between { middle, double: true, .. } => middle - DOUBLE.copysign(middle),
    };
    let outer = outer_line(network, id, &driven);
    if inner > 0.0 { [Some(inner), outer] } else { [outer, Some(inner)] }
}

fn edge(network: &Network, id: EdgeId, seed: u64, tiles: &mut Tiles) {
    let driven = driven(network, id);
    let Some(&outer) = driven.first() else { return };
    let strength =
        0.6 + 0.35 * ((sumo_network::seeds::derive(seed ^ u64::from(id.0), "paint") % 100) as f32 / 100.0);
    let stops = |lanes: &[LaneId]| lanes.iter().any(|&l| line_at_end(network, l) != EndLine::None);
    let trim = if stops(&driven) { STOP_LINE.1 } else { 0.0 };
    for &lane_id in &driven {
        let lane = network.lane(lane_id);
        // Worn paint is gone piece by piece.
        let line = stations(&lane.shape, if tiles.is_worn() { 3.0 } else { 16.0 });
        if line.len() < 2 || lane.shape.length() < 2.0 {
            continue;
        }
        let length = lane.shape.length();
        let mut painter = Painter { tiles, line, length, reach: (0.0, length - trim), strength };
        if let Some(d) = outer_line(network, lane_id, &driven).filter(|_| lane_id == outer) {
            painter.stripe(d, LINE, 0.0, length);
        }
        match inner_line(network, lane_id, &driven) {
            Inner::Solid(d) => painter.stripe(d, LINE, 0.0, length),
            Inner::Dashes { d, dash, gap } => painter.dashes(d, dash, gap),
            // Painted once for both directions.
            Inner::Between { other, .. } if other < id => {}
            Inner::Between { middle, double, other } => {
                painter.reach.0 = if stops(&network.edge(other).lanes) { STOP_LINE.1 } else { 0.0 };
                if double {
                    painter.stripe(middle - DOUBLE, 0.10, 0.0, length);
                    painter.stripe(middle + DOUBLE, 0.10, 0.0, length);
                } else {
                    painter.dashes(middle, 3.0, 3.0);
                }
            }
        }
        let (right, left) = (lane_id == driven[0], lane_id == driven[driven.len() - 1]);
        let sides = if inward(network) > 0.0 { [right, left] } else { [left, right] };
        ends(network, lane_id, sides, tiles, strength);
    }
}

/// Where stop lines begin and end, before the lane's end (m).
const STOP_LINE: (f64, f64) = (0.85, 0.4);

/// The line across a lane's end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum EndLine {
    None,
    Stop,
    /// A broken one: give way.
    Yield,
}

fn line_at_end(network: &Network, id: LaneId) -> EndLine {
    let lane = network.lane(id);
    if surface(lane) != Surface::Road || lane.shape.length() < 6.0 {
        return EndLine::None;
    }
    let links = || lane.outgoing.iter().map(|&l| network.link(l));
    if links().any(|l| l.signal.is_some() || l.state == 's') {
        EndLine::Stop
    } else if links().any(|l| matches!(l.state, 'm' | 'w')) && links().any(|l| !l.must_yield_to.is_empty()) {
        EndLine::Yield
    } else {
        EndLine::None
    }
}

/// Stop line, give-way line and arrows at a lane's end. `sides`: whether the carriageway ends on the
/// lane's right and on its left.
fn ends(network: &Network, id: LaneId, sides: [bool; 2], tiles: &mut Tiles, strength: f32) {
    let lane = network.lane(id);
    let length = lane.shape.length();
    if lane.outgoing.is_empty() || length < 6.0 {
        return;
    }
    let links: Vec<_> = lane.outgoing.iter().map(|&l| network.link(l)).collect();
    // From line to line; over the seams between lanes.
    let [right, left] = sides.map(|at_border| 0.5 * lane.width + if at_border { -0.15 } else { 0.03 });
    let bar = |tiles: &mut Tiles, from: f64, to: f64, right: f64, left: f64| {
        let (a, b) = (lane.shape.at(from), lane.shape.at(to));
        let p = |pose: &Pose, d: f64| {
            let q = pose.to_world(Vector::new(0.0, d));
            Point3::new(q.x, q.y, pose.position.z)
        };
        // Its sides lie across the lane.
        tiles.paint([p(&b, right), p(&b, left), p(&a, left), p(&a, right)], strength, [true, true]);
    };
    let (from, to) = (length - STOP_LINE.0, length - STOP_LINE.1);
    match line_at_end(network, id) {
        EndLine::Stop => bar(tiles, from, to, -right, left),
        EndLine::Yield => {
            let mut d = -right + 0.1;
            while d + 0.5 <= left {
                bar(tiles, from + 0.1, to, d, d + 0.5);
                d += 0.8;
            }
        }
        EndLine::None => {}
    }
    let edge = network.edge(lane.edge);
    let many = edge.lanes.iter().filter(|&&l| surface(network.lane(l)) == Surface::Road).count() > 1;
    let signalled = links.iter().any(|l| l.signal.is_some());
    let car = lane.permissions.allows(VehicleClass::Passenger);
    if !car || !(many || signalled) || length < 24.0 {
        return;
    }
    let goes = |wanted: &[LinkDirection]| links.iter().any(|l| wanted.contains(&l.direction));
    use LinkDirection as D;
    let ways = [goes(&[D::Left, D::PartLeft]), goes(&[D::Straight]), goes(&[D::Right, D::PartRight])];
    let rows: &[f64] = if length > 60.0 { &[9.0, 30.0] } else { &[9.0] };
    for &back in rows {
        arrow(tiles, &lane.shape.at(length - back - 4.0), ways, strength);
    }
}

/// An arrow of 4 m at `pose` (its tail): left, straight, right.
fn arrow(tiles: &mut Tiles, pose: &Pose, [left, straight, right]: [bool; 3], strength: f32) {
    let mut quad = |corners: [[f64; 2]; 4]| {
        let mut q = corners.map(|[x, y]| pose.to_world(Vector::new(x, y)));
        let area: f64 = (0..4).map(|i| q[i].coords.perp(&q[(i + 1) % 4].coords)).sum();
        if area < 0.0 {
            q.reverse();
            // The first three corners give the plane: a tip, which is two corners, stays behind.
            q.rotate_left(2);
        }
        let z = pose.position.z;
        tiles.paint(q.map(|p: Point| Point3::new(p.x, p.y, z)), strength, [true, true]);
    };
    let shaft = if straight { 2.6 } else { 1.7 };
    if left || straight || right {
        quad([[0.0, -0.075], [shaft, -0.075], [shaft, 0.075], [0.0, 0.075]]);
    }
    if straight {
        quad([[2.6, 0.32], [2.6, -0.32], [4.0, 0.0], [4.0, 0.0]]);
    }
    for (wanted, side) in [(left, 1.0), (right, -1.0)] {
        if wanted {
            let base = if straight { 1.0 } else { 1.55 };
            quad([[base, 0.0], [base + 0.55, side * 0.45], [base + 0.75, side * 0.45], [base + 0.25, 0.0]]);
            quad([
                [base + 0.30, side * 0.42],
                [base + 1.0, side * 0.42],
                [base + 0.65, side * 0.98],
                [base + 0.65, side * 0.98],
            ]);
        }
    }
}
