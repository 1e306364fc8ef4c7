//! A route as the ego drives it: a smooth centre line with lateral coordinates (s, d),
//! road options, speed limits and the links it crosses.

use super::centre_line::{CentreLine, Piece, Sample, centre_line};
use super::route_search::search;
use super::{EdgeId, LaneId, LanePosition, LinkDirection, LinkId, Network, VehicleClass};
use crate::geometry::{Point, Polyline, Pose, Projection, wrap_angle};
use serde::{Deserialize, Serialize};

/// The road option of a link holds from here before its stop line on (m), where no one may drive faster than
/// [`TOWN_SPEED`].
pub const APPROACH: f64 = 15.0;
/// 50 km/h (m/s).
const TOWN_SPEED: f64 = 13.89;
/// Where one may drive faster, the option comes early enough to brake to that with this (m/s2).
const BRAKING: f64 = 3.0;

/// So much of the way behind is kept where the rest is dropped (m): more than a vehicle with its trailer.
pub const KEPT_BEHIND: f64 = 30.0;

/// The longest route that is built (m).
const LONGEST: f64 = 500_000.0;

/// The driver's instruction at a waypoint (CARLA's RoadOption).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum RoadOption {
    /// Along the lane, or over a junction without a choice.
    LaneFollow,
    /// A left turn.
    Left,
    /// A right turn.
    Right,
    /// Straight on where one could turn.
    Straight,
    /// To the lane on the left.
    ChangeLaneLeft,
    /// To the lane on the right.
    ChangeLaneRight,
}

/// A stretch of the route on one lane, over one link, or changing from one lane to the next.
#[derive(Clone, Debug)]
pub struct RouteSection {
    /// Where it begins and ends on the route (m).
    pub s_start: f64,
    /// Where it ends (m).
    pub s_end: f64,
    /// The lane at its end; for a link the first internal lane (or the link's `to` lane without internal lanes).
    pub lane: LaneId,
    /// The lane left behind, in a lane change.
    pub from_lane: Option<LaneId>,
    /// The link, inside a junction.
    pub link: Option<LinkId>,
    /// What to do on it.
    pub option: RoadOption,
    /// m/s.
    pub speed_limit: f64,
    /// Lane width (m).
    pub width: f64,
}

/// A link on the route.
#[derive(Clone, Copy, Debug)]
pub struct RouteLink {
    /// The link.
    pub link: LinkId,
    /// Where its stop line lies on the route (m); negative where the route begins inside the junction.
    pub stop_s: f64,
    /// Where the junction is left (m).
    pub end_s: f64,
}

/// The route's centre line at one place.
#[derive(Clone, Copy, Debug)]
pub struct RoutePoint {
    /// On the centre line, heading along it.
    pub pose: Pose,
    /// 1/m, left positive; cut off at 1.
    pub curvature: f64,
    /// m/s.
    pub speed_limit: f64,
    /// Lane width (m).
    pub width: f64,
    /// What to do here.
    pub option: RoadOption,
    /// The lane here.
    pub lane: LaneId,
}

/// A route between two lane positions.
#[derive(Clone, Debug)]
pub struct Route {
    /// Normal edges in order, as SUMO's routes have them. The first is the edge that the route begins on, or,
    /// inside a junction, the one that led into it.
    pub edges: Vec<EdgeId>,
    /// They follow each other without a gap from 0 to the route's length.
    pub sections: Vec<RouteSection>,
    /// Links in the order of the way.
    pub links: Vec<RouteLink>,
    /// The smooth centre line, sampled about every metre.
    pub centre_line: Polyline,
    /// Where the route begins on the net.
    pub from: LanePosition,
    /// Where it ends on the net.
    pub to: LanePosition,
    /// Where it was led to, one after the other: its first destination and those that it was lengthened to. The last is `to`.
    pub destinations: Vec<LanePosition>,
    /// The vehicle class that it is for.
    pub class: VehicleClass,
    /// Where each of `destinations` lies (m).
    destination_s: Vec<f64>,
    /// Where each of `edges` is entered (m).
    edge_starts: Vec<f64>,
    samples: Vec<Sample>,
    pieces: Vec<Piece>,
    /// Where each of `pieces` begins (m).
    piece_starts: Vec<f64>,
}

/// Why there is no route.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RouteError {
    /// No way leads there.
    #[error(
        "no route from edge `{from}` to edge `{to}` for class {class}: no connections lead there; choose edges of the same connected part of the net, or another vehicle class"
    )]
    Unreachable {
        /// Edge of the start.
        from: String,
        /// Edge of the destination.
        to: String,
        /// The vehicle class.
        class: VehicleClass,
    },
    /// The class may not use the lane.
    #[error("lane `{lane}` is not open to class {class}; choose one that is")]
    NotForClass {
        /// The lane.
        lane: String,
        /// The vehicle class.
        class: VehicleClass,
    },
    /// The position lies beyond the lane's ends.
    #[error(
        "position {s:.2} m is off lane `{lane}`, which is {length:.2} m long; choose one from 0 to its length"
    )]
    OffLane {
        /// The lane.
        lane: String,
        /// The given position (m).
        s: f64,
        /// The lane's length (m).
        length: f64,
    },
    /// The route is too long.
    #[error(
        "the route is {kilometres:.0} km long, more than the {} km that are supported; choose a nearer destination",
        LONGEST / 1000.0
    )]
    TooLong {
        /// The route's length (km).
        kilometres: f64,
    },
    /// A crossing or walkingarea, or, as a destination, a lane inside a junction.
    #[error("lane `{lane}` is not part of a road; choose a lane of a normal edge")]
    NotARoad {
        /// The lane.
        lane: String,
    },
}

impl Network {
    /// The cheapest route (by travel time) from one lane position to another for a vehicle class.
    ///
    /// It may begin inside a junction. A destination behind the start on the same lane is reached by
    /// going round. Turn-arounds are used only where nothing else leads there.
    ///
    /// # Errors
    /// A position is off its lane, on no road, on a lane closed to the class, or out of reach.
    pub fn route(
        &self,
        from: LanePosition,
        to: LanePosition,
        class: VehicleClass,
    ) -> Result<Route, RouteError> {
        Route::new(self, search(self, from, to, class)?, from, to, class)
    }

    /// Lengthens a route to a further destination. The existing part keeps its `s`, except the last few
    /// metres, where the smooth line bends towards the new part.
    ///
    /// # Errors
    /// As [`Network::route`]; the route is then left as it was.
    pub fn extend_route(&self, route: &mut Route, to: LanePosition) -> Result<(), RouteError> {
        let mut more = search(self, route.to, to, route.class)?.into_iter();
        let mut pieces = route.pieces.clone();
        if let Some(first) = more.next() {
            match (pieces.last_mut(), first) {
                (Some(Piece::Lane { lane, to, .. }), Piece::Lane { lane: next, to: end, .. })
                    if *lane == next =>
                {
                    *to = end;
                }
                _ => pieces.push(first),
            }
        }
        pieces.extend(more);
        let mut longer = Route::new(self, pieces, route.from, to, route.class)?;
        longer.destinations.splice(..0, std::mem::take(&mut route.destinations));
        longer.destination_s.splice(..0, std::mem::take(&mut route.destination_s));
        *route = longer;
        Ok(())
    }

    /// The route without the lanes that end more than 30 m (`KEPT_BEHIND`) before `s` (m), and where `s` is on it. What is
    /// left keeps its line, except the first few metres.
    pub fn drop_passed(&self, route: &Route, s: f64) -> (Route, f64) {
        let begins = |(piece, start): (&Piece, &f64)| match *piece {
            Piece::Lane { lane, from, .. } if *start <= s - KEPT_BEHIND => {
                Some(LanePosition { lane, s: from })
            }
            _ => None,
        };
        let pieces = route.pieces.iter().zip(&route.piece_starts);
        let last = pieces.enumerate().filter_map(|(i, at)| Some((i, begins(at)?))).next_back();
        let shorter = last.filter(|(first, _)| *first > 0).and_then(|(first, from)| {
            Route::new(self, route.pieces[first..].to_vec(), from, route.to, route.class).ok()
        });
        let Some(mut shorter) = shorter else { return (route.clone(), s) };
        let dropped = route.length() - shorter.length();
        let ahead = route.destination_s.partition_point(|&at| at < dropped);
        shorter.destinations = route.destinations[ahead..].to_vec();
        shorter.destination_s = route.destination_s[ahead..].iter().map(|at| at - dropped).collect();
        (shorter, s - dropped)
    }

    /// The road option over a link: a turn where the driver has a choice, else lane following.
    pub fn road_option(&self, link: LinkId, class: VehicleClass) -> RoadOption {
        let link = self.link(link);
        let edge = self.edge(self.lane(link.from).edge);
        let ways = edge.lanes.iter().flat_map(|&l| &self.lane(l).outgoing).map(|&l| self.link(l));
        let choice = ways
            .filter(|l| l.direction != LinkDirection::TurnAround && self.lane(l.to).permissions.allows(class))
            .any(|l| self.lane(l.to).edge != self.lane(link.to).edge);
        match self.turns_left(link.direction) {
            _ if !choice => RoadOption::LaneFollow,
            Some(true) => RoadOption::Left,
            Some(false) => RoadOption::Right,
            None => RoadOption::Straight,
        }
    }

    /// Whether a link with this direction turns to the left (false: to the right); None if it does not turn. Who turns
    /// around crosses the opposite lanes.
    pub fn turns_left(&self, direction: LinkDirection) -> Option<bool> {
        match direction {
            LinkDirection::Left | LinkDirection::PartLeft => Some(true),
            LinkDirection::Right | LinkDirection::PartRight => Some(false),
            LinkDirection::TurnAround => Some(!self.left_hand),
            LinkDirection::Straight | LinkDirection::Invalid => None,
        }
    }
}

impl Route {
    fn new(
        network: &Network,
        pieces: Vec<Piece>,
        from: LanePosition,
        to: LanePosition,
        class: VehicleClass,
    ) -> Result<Self, RouteError> {
        let length: f64 = pieces.iter().map(|p| p.length(network)).sum();
        if length > LONGEST {
            return Err(RouteError::TooLong { kilometres: length / 1000.0 });
        }
        let CentreLine { line, samples, starts } = centre_line(network, &pieces);
        let mut route = Self {
            edges: Vec::new(),
            sections: Vec::new(),
            links: Vec::new(),
            centre_line: line,
            from,
            to,
            destinations: vec![to],
            destination_s: Vec::new(),
            class,
            edge_starts: Vec::new(),
            samples,
            pieces: Vec::new(),
            piece_starts: Vec::new(),
        };
        let end = route.length();
        route.destination_s.push(end);
        for (i, piece) in pieces.iter().enumerate() {
            let s_end = starts.get(i + 1).copied().unwrap_or(end);
            route.add(network, *piece, starts[i], s_end);
        }
        (route.pieces, route.piece_starts) = (pieces, starts);
        Ok(route)
    }

    fn add(&mut self, network: &Network, piece: Piece, s_start: f64, s_end: f64) {
        let mut section = |lane: LaneId, from_lane, link, option| {
            let on = network.lane(lane);
            let (speed_limit, width) = (on.speed_limit, on.width);
            self.sections.push(RouteSection {
                s_start,
                s_end,
                lane,
                from_lane,
                link,
                option,
                speed_limit,
                width,
            });
        };
        match piece {
            Piece::Lane { lane, .. } => {
                section(lane, None, None, RoadOption::LaneFollow);
                self.enter(network.lane(lane).edge, s_start);
            }
            Piece::Change { from_lane, to_lane, .. } => {
                let up = network.lane(to_lane).index > network.lane(from_lane).index;
                let option = match up != network.left_hand {
                    true => RoadOption::ChangeLaneLeft,
                    false => RoadOption::ChangeLaneRight,
                };
                section(to_lane, Some(from_lane), None, option);
                self.enter(network.lane(to_lane).edge, s_start);
            }
            Piece::Link { link, via, s } => {
                let option = network.road_option(link, self.class);
                let on = network.link(link);
                section(on.via.get(via).copied().unwrap_or(on.to), None, Some(link), option);
                let covered: f64 =
                    on.via.iter().take(via).map(|&l| network.lane(l).shape.length()).sum::<f64>() + s;
                self.links.push(RouteLink { link, stop_s: s_start - covered, end_s: s_end });
                if self.edges.is_empty() {
                    self.enter(network.lane(on.from).edge, s_start);
                }
                self.approach(option, s_start);
                // The edge behind the junction counts as entered again, even if it is the same one.
                self.edges.push(network.lane(on.to).edge);
                self.edge_starts.push(s_end);
            }
        }
    }

    fn enter(&mut self, edge: EdgeId, s: f64) {
        if self.edges.last() != Some(&edge) {
            self.edges.push(edge);
            self.edge_starts.push(s);
        }
    }

    /// Announces the option of a link whose stop line is at `stop`, and whose section was just added.
    fn approach(&mut self, option: RoadOption, stop: f64) {
        let Some(before) = self.sections.len().checked_sub(2) else { return };
        let section = &mut self.sections[before];
        let lane_follow = section.link.is_none() && section.option == RoadOption::LaneFollow;
        if option == RoadOption::LaneFollow || !lane_follow {
            return;
        }
        let limit = section.speed_limit.max(TOWN_SPEED);
        let begin = stop - APPROACH - (limit * limit - TOWN_SPEED * TOWN_SPEED) / (2.0 * BRAKING);
        if section.s_start >= begin {
            section.option = option;
        } else {
            let approach = RouteSection { s_start: begin, option, ..section.clone() };
            section.s_end = begin;
            self.sections.insert(before + 1, approach);
        }
    }

    /// Total length (m).
    pub fn length(&self) -> f64 {
        self.centre_line.length()
    }

    /// Where `point` falls on the route, searched within `back` and `ahead` (m) of `hint`.
    pub fn project_near(&self, point: Point, hint: f64, back: f64, ahead: f64) -> Projection {
        let end = self.length();
        self.centre_line.project_within(point, (hint - back).clamp(0.0, end), (hint + ahead).clamp(0.0, end))
    }

    /// The sample before `s` (m), and how far `s` is on the way to the next (0..1).
    fn sample_at(&self, s: f64) -> Option<(&Sample, &Sample, f64)> {
        let i = self.centre_line.segment_at(s);
        let lengths = self.centre_line.arc_lengths();
        let first = self.samples.get(i)?;
        let (Some(second), Some(to)) = (self.samples.get(i + 1), lengths.get(i + 1)) else {
            return Some((first, first, 0.0));
        };
        Some((first, second, ((s - lengths[i]) / (to - lengths[i])).clamp(0.0, 1.0)))
    }

    /// Everything about the centre line at `s` (m).
    pub fn at(&self, s: f64) -> RoutePoint {
        let mut pose = self.centre_line.at(s);
        let mut curvature = 0.0;
        if let Some((a, b, t)) = self.sample_at(s) {
            pose.heading = wrap_angle(a.heading + t * wrap_angle(b.heading - a.heading));
            curvature = a.curvature + t * (b.curvature - a.curvature);
        }
        let section = self.section_at(s);
        RoutePoint {
            pose,
            curvature,
            speed_limit: section.speed_limit,
            width: section.width,
            option: section.option,
            lane: section.lane,
        }
    }

    /// The section that holds `s` (m).
    pub fn section_at(&self, s: f64) -> &RouteSection {
        let after = self.sections.partition_point(|section| section.s_start <= s);
        &self.sections[after.saturating_sub(1)]
    }

    /// The first link whose stop line is at or beyond `s` (m).
    pub fn next_link(&self, s: f64) -> Option<&RouteLink> {
        self.links.get(self.links.partition_point(|link| link.stop_s < s))
    }

    /// The link whose junction holds `s` (m).
    pub fn link_at(&self, s: f64) -> Option<&RouteLink> {
        let after = self.links.partition_point(|link| link.stop_s <= s);
        self.links.get(after.checked_sub(1)?).filter(|link| s < link.end_s)
    }

    /// Which of `edges` holds `s` (m): inside a junction the one that led into it.
    pub fn edge_index_at(&self, s: f64) -> usize {
        self.edge_starts.partition_point(|&start| start <= s).saturating_sub(1)
    }

    /// Lateral distance (m, >= 0) of `d` outside the corridor of the route at `s`: the distance to the
    /// lane's centre, or, in a lane change, 0 between the two lanes' centres and the distance to the
    /// nearer one outside.
    pub fn corridor_offset(&self, s: f64, d: f64) -> f64 {
        let Some((a, b, t)) = self.sample_at(s) else { return d.abs() };
        let low = a.corridor.0 + t * (b.corridor.0 - a.corridor.0);
        let high = a.corridor.1 + t * (b.corridor.1 - a.corridor.1);
        (low - d).max(d - high).max(0.0)
    }
}
