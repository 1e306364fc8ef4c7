//! The smooth line of a route, made from the lanes' polylines.
//!
//! The polylines are joined (lane changes as a quintic blend from centre to centre), sampled finely
//! and smoothed with a cubic B-spline kernel, which rounds SUMO's coarse corners without adding
//! wiggles. Where the line is still tighter than a car can steer it is relaxed further, but never
//! further from the lanes than a set distance.

use super::smooth::{curvature, filtered, kernel, relax};
use super::{LaneId, LinkDirection, LinkId, Network};
use crate::geometry::{Polyline, wrap_angle};
use nalgebra::Point3;

/// A stretch of a route as the search found it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Piece {
    /// Along a lane, between arc lengths (m).
    Lane { lane: LaneId, from: f64, to: f64 },
    /// From one lane to its neighbour, between arc lengths (m) on each.
    Change { from_lane: LaneId, from: (f64, f64), to_lane: LaneId, to: (f64, f64) },
    /// Over a junction, from arc length `s` (m) of internal lane number `via` on.
    Link { link: LinkId, via: usize, s: f64 },
}

impl Piece {
    /// Its length (m) on the lanes.
    pub fn length(&self, network: &Network) -> f64 {
        match *self {
            Self::Lane { from, to, .. } | Self::Change { from: (from, to), .. } => to - from,
            Self::Link { link, .. } => network.link_length(link),
        }
    }
}

/// Distance between fine samples, and how many make one sample of the result.
const FINE: f64 = 0.25;
const STRIDE: usize = 4;
/// Width of one of the four boxes whose convolution is the kernel (m); its reach is twice that.
const BOX: f64 = 1.5;
/// How far the lanes before and behind the route shape its ends (m).
const MARGIN: f64 = 6.0;

/// One sample of the smooth line.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sample {
    pub heading: f64,
    pub curvature: f64,
    /// The corridor's borders beside the line (m, left positive): lane centres in a lane change, else 0.
    pub corridor: (f64, f64),
}

/// The smooth line and what goes with it.
pub(super) struct CentreLine {
    pub line: Polyline,
    pub samples: Vec<Sample>,
    /// Where each piece begins on the line (m).
    pub starts: Vec<f64>,
}

/// Points with the arc length at each, as they are joined.
#[derive(Default)]
struct Joined {
    points: Vec<Point3<f64>>,
    length: f64,
}

impl Joined {
    fn push(&mut self, point: Point3<f64>) {
        if let Some(last) = self.points.last() {
            let step = (point.xy() - last.xy()).norm();
            if step <= 1e-3 {
                return;
            }
            self.length += step;
        }
        self.points.push(point);
    }

    /// Adds the part of `shape` between arc lengths.
    fn part(&mut self, shape: &Polyline, from: f64, to: f64) {
        let (Some(first), true) = (shape.points().first(), to >= from) else { return };
        if shape.is_degenerate() {
            return self.push(*first);
        }
        self.push(shape.at(from).position);
        let lengths = shape.arc_lengths();
        let inner = lengths.partition_point(|&l| l <= from)..lengths.partition_point(|&l| l < to);
        if inner.start < inner.end {
            shape.points()[inner].iter().for_each(|p| self.push(*p));
        }
        self.push(shape.at(to).position);
    }

    /// A curve over a junction without internal lanes, from `a` (heading) to `b` (heading).
    fn curve(&mut self, a: (Point3<f64>, f64), b: (Point3<f64>, f64)) {
        let distance = (b.0.xy() - a.0.xy()).norm();
        let turn = 0.5 * wrap_angle(b.1 - a.1).abs();
        // Bezier handles that give a circular arc for this turn.
        let handle =
            if turn < 1e-3 { distance / 3.0 } else { distance * 2.0 / 3.0 * (0.5 * turn).tan() / turn.sin() };
        let handle = handle.min(distance);
        let along = |p: Point3<f64>, heading: f64, by: f64| {
            Point3::new(p.x + by * heading.cos(), p.y + by * heading.sin(), p.z)
        };
        let (c, d) = (along(a.0, a.1, handle), along(b.0, b.1, -handle));
        let steps = (distance / 0.5).ceil().max(1.0);
        for i in 0..=steps as usize {
            let t = i as f64 / steps;
            let u = 1.0 - t;
            let p = a.0.coords * (u * u * u)
                + c.coords * (3.0 * u * u * t)
                + d.coords * (3.0 * u * t * t)
                + b.0.coords * (t * t * t);
            self.push(p.into());
        }
    }
}

/// Smooth blend from 0 to 1 with flat ends (quintic).
fn blend(t: f64) -> f64 {
    let t = t.clamp(0.0, 1.0);
    t * t * t * (10.0 + t * (6.0 * t - 15.0))
}

/// A lane change on the joined line: its ends (m) and its signed width (m, left positive).
struct Shift {
    from: f64,
    to: f64,
    width: f64,
}

/// Makes the line of a route's pieces.
pub(super) fn centre_line(network: &Network, pieces: &[Piece]) -> CentreLine {
    let mut joined = Joined::default();
    // The lane behind the route's begin, so that its first metres are shaped as they are in any route.
    if let Some(&Piece::Lane { lane, from, .. }) = pieces.first() {
        joined.part(&network.lane(lane).shape, (from - MARGIN).max(0.0), from);
    }
    let lead = joined.length;
    let mut starts = Vec::with_capacity(pieces.len());
    let mut shifts = Vec::new();
    for piece in pieces {
        starts.push(joined.length);
        match *piece {
            Piece::Lane { lane, from, to } => joined.part(&network.lane(lane).shape, from, to),
            Piece::Change { from_lane, from, to_lane, to } => {
                shifts.push(change(&mut joined, network, (from_lane, from), (to_lane, to)));
            }
            Piece::Link { link, via, s } => over_junction(&mut joined, network, link, via, s),
        }
    }
    let end = joined.length;
    if let Some(&Piece::Lane { lane, to, .. }) = pieces.last() {
        let shape = &network.lane(lane).shape;
        joined.part(shape, to, (to + MARGIN).min(shape.length()));
    }
    let base = Polyline::new(joined.points);
    let fine = smooth(&base, lead, end);
    sample(&fine, lead, end, &starts, &shifts)
}

fn change(joined: &mut Joined, network: &Network, a: (LaneId, (f64, f64)), b: (LaneId, (f64, f64))) -> Shift {
    let (shape_a, shape_b) = (&network.lane(a.0).shape, &network.lane(b.0).shape);
    let from = joined.length;
    let steps = (((a.1.1 - a.1.0) / 0.5).ceil()).max(1.0);
    let mut width = 0.0;
    for i in 0..=steps as usize {
        let t = i as f64 / steps;
        let p = shape_a.at(a.1.0 + t * (a.1.1 - a.1.0));
        let guess = b.1.0 + t * (b.1.1 - b.1.0);
        let s = shape_b.project_within(p.xy(), (guess - 5.0).max(b.1.0), (guess + 5.0).min(b.1.1)).s;
        let q = shape_b.at(s);
        joined.push(p.position + (q.position - p.position) * blend(t));
        if i == steps as usize / 2 {
            width = p.to_local(q.xy()).y;
        }
    }
    Shift { from, to: joined.length, width }
}

fn over_junction(joined: &mut Joined, network: &Network, link: LinkId, via: usize, s: f64) {
    let link = network.link(link);
    // The polyline of a turn-around has far too few points for its tight arc.
    if link.via.is_empty() || (via == 0 && s == 0.0 && link.direction == LinkDirection::TurnAround) {
        let (from, to) = (&network.lane(link.from).shape, &network.lane(link.to).shape);
        let (a, b) = (from.at(from.length()), to.at(0.0));
        return joined.curve((a.position, a.heading), (b.position, b.heading));
    }
    for (i, &lane) in link.via.iter().enumerate().skip(via) {
        let shape = &network.lane(lane).shape;
        joined.part(shape, if i == via { s } else { 0.0 }, shape.length());
    }
}

/// Fine samples of the smoothed line: number `i` belongs to `(i - behind) * FINE + lead` of the base.
struct Fine {
    points: Vec<Point3<f64>>,
    behind: usize,
}

fn smooth(base: &Polyline, lead: f64, end: f64) -> Fine {
    let kernel = kernel(BOX, FINE);
    let behind = (MARGIN / FINE) as usize;
    let inside = ((end - lead) / FINE).ceil() as usize + 1;
    let at = |u: f64| {
        let pose = base.at(u);
        // Beyond its ends the line goes on straight.
        let beyond = if u < 0.0 { u } else { (u - base.length()).max(0.0) };
        pose.advanced(beyond).position
    };
    let raw: Vec<Point3<f64>> =
        (0..inside + 2 * behind).map(|i| at(lead + (i as f64 - behind as f64) * FINE)).collect();
    let mut points: Vec<Point3<f64>> = (0..raw.len()).map(|i| filtered(&raw, i, &kernel)).collect();
    relax(&mut points, &raw, FINE);
    Fine { points, behind }
}

fn sample(fine: &Fine, lead: f64, end: f64, starts: &[f64], shifts: &[Shift]) -> CentreLine {
    let points = &fine.points;
    let length = (end - lead).max(0.0);
    // Every STRIDE-th fine sample, and the end.
    let mut kept: Vec<(f64, Point3<f64>, f64, f64)> = Vec::new();
    let whole = (length / (FINE * STRIDE as f64)).floor() as usize;
    let state = |u: f64| {
        let x = u / FINE;
        let i = (x.floor() as usize + fine.behind).min(points.len() - 3);
        let t = (x - x.floor()).clamp(0.0, 1.0);
        let heading = |i: usize| {
            let v = points[i + 1].xy() - points[i - 1].xy();
            v.y.atan2(v.x)
        };
        let (h0, h1) = (heading(i), heading(i + 1));
        let k = curvature(points, i) * (1.0 - t) + curvature(points, i + 1) * t;
        let k = k.clamp(-1.0, 1.0);
        (u, points[i] + (points[i + 1] - points[i]) * t, wrap_angle(h0 + t * wrap_angle(h1 - h0)), k)
    };
    for i in 0..=whole {
        kept.push(state(i as f64 * FINE * STRIDE as f64));
    }
    let last = kept.last().map_or(0.0, |k| k.0);
    if length - last > 1e-3 {
        if length - last < 0.1 && kept.len() > 1 {
            kept.pop();
        }
        kept.push(state(length));
    }
    // The polyline merges neighbours that fall together; so must the samples.
    kept.dedup_by(|b, a| (b.1.xy() - a.1.xy()).norm() <= 1e-3);
    let line = Polyline::new(kept.iter().map(|k| k.1));
    let lengths = line.arc_lengths();
    let on_line = |u: f64| {
        let after = kept.partition_point(|k| k.0 <= u);
        match (after.checked_sub(1), kept.get(after)) {
            (Some(i), Some(next)) => {
                let t = (u - kept[i].0) / (next.0 - kept[i].0);
                lengths[i] + t * (lengths[after] - lengths[i])
            }
            (None, _) => 0.0,
            (_, None) => line.length(),
        }
    };
    let starts = starts.iter().map(|&u| on_line(u - lead)).collect();
    let mut shift = shifts.iter().peekable();
    let samples = kept
        .iter()
        .map(|&(u, _, heading, curvature)| {
            while shift.peek().is_some_and(|s| s.to <= u + lead) {
                shift.next();
            }
            let corridor = match shift.peek() {
                Some(s) if s.from < u + lead => {
                    let done = blend((u + lead - s.from) / (s.to - s.from));
                    let (left, right) = (-s.width * done, s.width * (1.0 - done));
                    (left.min(right), left.max(right))
                }
                _ => (0.0, 0.0),
            };
            Sample { heading, curvature, corridor }
        })
        .collect();
    CentreLine { line, samples, starts }
}
