//! A route as the ego drives it: a smooth centre line with lateral coordinates (s, d),
//! road options, speed limits and the links it crosses.

use super::{EdgeId, LaneId, LinkId, Network};
use crate::geometry::{Point, Polyline, Pose, Projection};
use serde::{Deserialize, Serialize};

/// What the driver is to do at a waypoint (CARLA's RoadOption).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum RoadOption {
    LaneFollow,
    Left,
    Right,
    Straight,
    ChangeLaneLeft,
    ChangeLaneRight,
}

/// A stretch of the route on one lane, over one link, or changing from one lane to the next.
#[derive(Clone, Debug)]
pub struct RouteSection {
    /// Where it begins and ends on the route (m).
    pub s_start: f64,
    pub s_end: f64,
    /// The lane at its end; for a link the first internal lane (or the link's `to` lane without internal lanes).
    pub lane: LaneId,
    /// The lane left behind, in a lane change.
    pub from_lane: Option<LaneId>,
    /// The link, inside a junction.
    pub link: Option<LinkId>,
    pub option: RoadOption,
}

/// A link on the route.
#[derive(Clone, Copy, Debug)]
pub struct RouteLink {
    pub link: LinkId,
    /// Where its stop line lies on the route (m).
    pub stop_s: f64,
    /// Where the junction is left (m).
    pub end_s: f64,
}

/// The route's centre line at one place.
#[derive(Clone, Copy, Debug)]
pub struct RoutePoint {
    pub pose: Pose,
    /// 1/m, left positive.
    pub curvature: f64,
    /// m/s.
    pub speed_limit: f64,
    /// Lane width (m).
    pub width: f64,
    pub option: RoadOption,
    pub lane: LaneId,
}

/// A route between two lane positions.
#[derive(Clone, Debug)]
pub struct Route {
    /// Normal edges in order, as SUMO wants them.
    pub edges: Vec<EdgeId>,
    pub sections: Vec<RouteSection>,
    pub links: Vec<RouteLink>,
    /// The smooth centre line, sampled about every metre.
    pub centre_line: Polyline,
}

impl Route {
    /// Total length (m).
    pub fn length(&self) -> f64 {
        self.centre_line.length()
    }
    /// Where `point` falls on the route, searched within `back` and `ahead` (m) of `hint`.
    pub fn project_near(&self, _point: Point, _hint: f64, _back: f64, _ahead: f64) -> Projection {
        todo!()
    }
    /// Everything about the centre line at `s` (m).
    pub fn at(&self, _s: f64) -> RoutePoint {
        todo!()
    }
    /// The section that holds `s` (m).
    pub fn section_at(&self, _s: f64) -> &RouteSection {
        todo!()
    }
    /// The first link whose stop line is at or beyond `s` (m).
    pub fn next_link(&self, _s: f64) -> Option<&RouteLink> {
        todo!()
    }
    /// The link whose junction holds `s` (m).
    pub fn link_at(&self, _s: f64) -> Option<&RouteLink> {
        todo!()
    }
    /// Lateral distance (m, >= 0) of `d` outside the corridor of the route at `s`: 0 within lane
    /// centres of the lane, or, in a lane change, between the two lanes' centres.
    pub fn corridor_offset(&self, _network: &Network, _s: f64, _d: f64) -> f64 {
        todo!()
    }
}

/// Why there is no route.
#[derive(Debug, thiserror::Error)]
pub enum RouteError {
    #[error("{0}")]
    Placeholder(String),
}
