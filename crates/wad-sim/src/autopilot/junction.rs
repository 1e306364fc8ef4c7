//! The junctions on the route: where the ego's path meets the paths of other links and crossings.
//! Pure geometry, computed once per link of the route.

use super::params::EgoModel;
use sumo_network::geometry::{Point, Vector, direction, polygon_contains};
use sumo_network::network::{CrossingId, LaneId, LinkDirection, LinkId, Network, Route, RouteLink};

/// Spacing of the samples along both paths (m).
const STEP: f64 = 0.75;
/// How far upstream others are searched (m).
const UPSTREAM: f64 = 130.0;
/// Half the width of a foe (m) and the air between (m).
const FOE_HALF_WIDTH: f64 = 1.0;
const AIR: f64 = 0.3;

/// A lane from which a foe link is reached.
#[derive(Clone, Copy, Debug)]
pub struct Approach {
    pub lane: LaneId,
    /// From the lane's end to the foe link's stop line (m).
    pub beyond: f64,
    /// Whether the foe link is the only way on.
    pub certain: bool,
}

/// An internal lane, its distance from the link's stop line and its length (m).
pub type InnerLane = (LaneId, f64, f64);

/// Another link whose path meets the ego's.
#[derive(Clone, Debug)]
pub struct Conflict {
    pub link: LinkId,
    /// The other goes first by the junction's rules.
    pub must_yield: bool,
    /// Both end on the same lane.
    pub merge: bool,
    /// Where the ego's front enters and its rear must have left (m on the route).
    pub enter_s: f64,
    pub leave_s: f64,
    /// The same on the foe's path, from its stop line (m).
    pub foe_enter: f64,
    pub foe_leave: f64,
    /// Internal lanes of the foe link with their distance from its stop line and their length (m).
    pub inside: Vec<InnerLane>,
    pub approaches: Vec<Approach>,
    /// Speed at which the foe link is driven over the junction (m/s).
    pub foe_speed: f64,
    /// How the foe link turns.
    pub direction: LinkDirection,
}

/// A crossing over the ego's path.
#[derive(Clone, Debug)]
pub struct CrossingZone {
    pub crossing: CrossingId,
    /// Where it lies on the route (m).
    pub from_s: f64,
    pub to_s: f64,
    /// Pedestrians have priority over this link.
    pub yields: bool,
}

/// A link of the route with everything that meets it.
#[derive(Clone, Debug)]
pub struct LinkPlan {
    pub link: LinkId,
    pub stop_s: f64,
    pub end_s: f64,
    /// Where vehicles wait inside the junction (m on the route), where it has such a place.
    pub wait_s: Option<f64>,
    pub conflicts: Vec<Conflict>,
    pub crossings: Vec<CrossingZone>,
    /// Where the junction and the crossing after it have been left (m).
    pub clear_s: f64,
}

impl LinkPlan {
    /// Whether this is the plan of `link`.
    pub fn is_for(&self, link: &RouteLink) -> bool {
        self.link == link.link && self.stop_s == link.stop_s && self.end_s == link.end_s
    }

    /// Works out the plan of `link` on `route`.
    pub fn new(network: &Network, route: &Route, link: &RouteLink, ego: &EgoModel) -> Self {
        let own = network.link(link.link);
        let ours = samples(route, link.stop_s, link.end_s + 10.0);
        let crossings: Vec<CrossingZone> = own
            .crossings
            .iter()
            .filter_map(|&id| {
                let (from_s, to_s) = over(&ours, &network.crossing(id).outline, 0.5 * ego.width + 0.2)?;
                Some(CrossingZone {
                    crossing: id,
                    from_s,
                    to_s,
                    yields: own.yields_to_crossings.contains(&id),
                })
            })
            .collect();
        let clear_s = crossings.iter().map(|c| c.to_s).fold(link.end_s, f64::max);
        let wait_s = match own.via.as_slice() {
            // Without a signal it waits at the line: in SUMO the first vehicle inside goes first, so others
            // would wait for the waiting ego.
            [first, _, ..] if own.signal.is_some() => {
                let s = link.stop_s + network.lane(*first).shape.length();
                (s > link.stop_s + 1.0 && s < link.end_s).then_some(s)
            }
            _ => None,
        };
        let inner: Vec<(f64, Point)> = ours.iter().copied().filter(|p| p.0 <= link.end_s + 0.5).collect();
        let mut conflicts: Vec<Conflict> = own
            .foes
            .iter()
            .filter(|&&foe| network.link(foe).from != own.from)
            .filter_map(|&foe| meet(network, &inner, foe, own.to, own.must_yield_to.contains(&foe), ego))
            .collect();
        conflicts.sort_by(|a, b| a.enter_s.total_cmp(&b.enter_s).then(a.link.cmp(&b.link)));
        Self {
            link: link.link,
            stop_s: link.stop_s,
            end_s: link.end_s,
            wait_s,
            conflicts,
            crossings,
            clear_s,
        }
    }
}

fn samples(route: &Route, from: f64, to: f64) -> Vec<(f64, Point)> {
    let to = to.min(route.length());
    let n = ((to - from) / STEP).ceil().max(1.0) as usize;
    (0..=n)
        .map(|i| {
            let s = from + (to - from) * i as f64 / n as f64;
            (s, route.at(s).pose.xy())
        })
        .collect()
}

/// The path of a link over its junction, from its stop line, and its internal lanes.
fn foe_path(network: &Network, foe: LinkId) -> (Vec<(f64, Point)>, Vec<InnerLane>) {
    let link = network.link(foe);
    let mut path = Vec::new();
    let mut inside = Vec::new();
    let mut begin = 0.0;
    for &via in &link.via {
        let shape = &network.lane(via).shape;
        let length = shape.length();
        inside.push((via, begin, length));
        let n = (length / STEP).ceil().max(1.0) as usize;
        for i in 0..=n {
            let s = length * i as f64 / n as f64;
            path.push((begin + s, shape.at(s).xy()));
        }
        begin += length;
    }
    if link.via.is_empty() {
        let (from, to) = (&network.lane(link.from).shape, &network.lane(link.to).shape);
        let (a, b) = (from.at(from.length()).xy(), to.at(0.0).xy());
        let length = (b - a).norm();
        let n = (length / STEP).ceil().max(1.0) as usize;
        for i in 0..=n {
            let t = i as f64 / n as f64;
            path.push((length * t, a + (b - a) * t));
        }
    }
    (path, inside)
}

fn meet(
    network: &Network,
    ours: &[(f64, Point)],
    foe: LinkId,
    to: LaneId,
    must_yield: bool,
    ego: &EgoModel,
) -> Option<Conflict> {
    let (path, inside) = foe_path(network, foe);
    let reach = 0.5 * ego.width + FOE_HALF_WIDTH + AIR;
    let (mut enter_s, mut leave_s) = (f64::INFINITY, f64::NEG_INFINITY);
    let (mut foe_enter, mut foe_leave) = (f64::INFINITY, f64::NEG_INFINITY);
    for &(f, theirs) in &path {
        for &(s, point) in ours {
            if (point - theirs).norm_squared() < reach * reach {
                enter_s = enter_s.min(s);
                leave_s = leave_s.max(s);
                foe_enter = foe_enter.min(f);
                foe_leave = foe_leave.max(f);
            }
        }
    }
    let link = network.link(foe);
    enter_s.is_finite().then(|| Conflict {
        link: foe,
        must_yield,
        merge: link.to == to,
        enter_s,
        leave_s,
        foe_enter,
        foe_leave,
        inside,
        approaches: approaches(network, foe),
        foe_speed: link.via.iter().map(|&l| network.lane(l).speed_limit).fold(14.0, f64::min),
        direction: link.direction,
    })
}

/// The lanes from which `foe` is reached within [`UPSTREAM`] metres.
fn approaches(network: &Network, foe: LinkId) -> Vec<Approach> {
    let from = network.link(foe).from;
    let mut found =
        vec![Approach { lane: from, beyond: 0.0, certain: network.lane(from).outgoing.len() == 1 }];
    let mut next = 0;
    while next < found.len() && found.len() < 64 {
        let Approach { lane, beyond, certain } = found[next];
        next += 1;
        let begin = beyond + network.lane(lane).length;
        if begin > UPSTREAM {
            continue;
        }
        for &incoming in &network.lane(lane).incoming {
            let link = network.link(incoming);
            if link.to != lane {
                continue;
            }
            let mut beyond = begin;
            for &via in link.via.iter().rev() {
                if found.iter().all(|a| a.lane != via) {
                    found.push(Approach { lane: via, beyond, certain });
                }
                beyond += network.lane(via).length;
            }
            if found.iter().all(|a| a.lane != link.from) {
                let only = network.lane(link.from).outgoing.len() == 1;
                found.push(Approach { lane: link.from, beyond, certain: certain && only });
            }
        }
    }
    found.retain(|a| a.beyond <= UPSTREAM);
    found
}

/// Where the swept samples lie over the polygon: first and last s (m).
fn over(ours: &[(f64, Point)], polygon: &[Point], half_width: f64) -> Option<(f64, f64)> {
    let mut range: Option<(f64, f64)> = None;
    for i in 0..ours.len() {
        let (a, b) = (ours[i.saturating_sub(1)].1, ours[(i + 1).min(ours.len() - 1)].1);
        let heading = (b - a).y.atan2((b - a).x);
        let forward = direction(heading);
        let left = Vector::new(-forward.y, forward.x);
        let (s, point) = ours[i];
        if [-half_width, 0.0, half_width].iter().any(|&d| polygon_contains(polygon, point + left * d)) {
            range = Some(range.map_or((s, s), |(lo, _)| (lo, s)));
        }
    }
    range.map(|(lo, hi)| (lo - 0.5 * STEP, hi + 0.5 * STEP))
}
