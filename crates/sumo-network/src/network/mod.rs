//! The road network as SUMO's `.net.xml` describes it: edges, lanes, junctions, links,
//! crossings, walkingareas and signals, with nearest-lane queries and routes.
//!
//! Everything is stored in flat vectors and referred to by small ids, in file order,
//! so that iteration is deterministic.

mod build;
mod centre_line;
mod error;
mod parse;
mod pedestrian;
mod permissions;
mod polygons;
mod reach;
mod requests;
mod route;
mod route_search;
#[cfg(test)]
mod route_tests;
mod smooth;
mod spatial;
#[doc(hidden)]
pub mod testing;
mod xml;

pub use error::NetworkError;
pub use permissions::{Permissions, VehicleClass};
pub use polygons::{PointOfInterest, Polygon, Shapes};
pub use route::{RoadOption, Route, RouteError, RouteLink, RoutePoint, RouteSection};

use crate::geometry::{Point, Polyline, Vector};
use pedestrian::PedestrianNetwork;
use spatial::LaneTree;
use std::collections::HashMap;
use std::path::Path;

macro_rules! index_type {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
        pub struct $name(pub u32);
        impl $name {
            /// The position in the network's vector of these.
            pub fn index(self) -> usize {
                self.0 as usize
            }
        }
    };
}
index_type!(/// An edge of [`Network::edges`].
    EdgeId);
index_type!(/// A lane of [`Network::lanes`].
    LaneId);
index_type!(/// A junction of [`Network::junctions`].
    JunctionId);
index_type!(/// A link of [`Network::links`].
    LinkId);
index_type!(/// A crossing of [`Network::crossings`].
    CrossingId);
index_type!(/// A signal program of [`Network::traffic_lights`].
    TrafficLightId);

/// What an edge is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EdgeKind {
    /// A road (or path) between two junctions.
    Normal,
    /// Lanes inside a junction.
    Internal,
    /// A pedestrian crossing over a junction's arm.
    Crossing,
    /// Where pedestrians walk between sidewalks and crossings.
    WalkingArea,
    /// A macroscopic connector or anything else that is not driven in detail.
    Other,
}

/// A one-way road: a bundle of parallel lanes.
#[derive(Clone, Debug)]
pub struct Edge {
    /// SUMO's id; may begin with `-` or `:`.
    pub id: String,
    pub kind: EdgeKind,
    /// None for internal edges, crossings and walkingareas.
    pub from: Option<JunctionId>,
    pub to: Option<JunctionId>,
    /// The junction that an internal edge, crossing or walkingarea lies in.
    pub junction: Option<JunctionId>,
    pub priority: i32,
    /// SUMO edge type, empty where none was given.
    pub edge_type: String,
    /// Street name, empty where none was given.
    pub name: String,
    /// Lanes by lane_index: 0 is the outermost (rightmost in right-hand networks).
    pub lanes: Vec<LaneId>,
}

/// One lane. `shape` is its centre line (for a walkingarea: its outline).
#[derive(Clone, Debug)]
pub struct Lane {
    /// SUMO's id, e.g. `A0B0_1`.
    pub id: String,
    pub edge: EdgeId,
    /// 0 is the outermost lane.
    pub index: usize,
    /// m/s.
    pub speed_limit: f64,
    /// SUMO's lane length (m): lane_position counts in it; may differ from `shape.length()`.
    pub length: f64,
    /// m; 3.2 where the file says nothing.
    pub width: f64,
    pub permissions: Permissions,
    /// Who may change from here to the lane with the next higher index (SUMO's `changeLeft`).
    pub change_up: Permissions,
    /// Who may change from here to the lane with the next lower index (SUMO's `changeRight`).
    pub change_down: Permissions,
    pub shape: Polyline,
    /// Links that leave this lane.
    pub outgoing: Vec<LinkId>,
    /// Links that enter this lane (for internal lanes: the link whose `via` holds it).
    pub incoming: Vec<LinkId>,
}

/// Which way a link turns (SUMO's `dir`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LinkDirection {
    Straight,
    TurnAround,
    Left,
    Right,
    PartLeft,
    PartRight,
    Invalid,
}

/// A signal head: one character of a traffic light's state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SignalIndex {
    pub traffic_light: TrafficLightId,
    /// Position in the state string.
    pub index: usize,
}

/// A way over a junction from one lane to another (SUMO's connection between normal edges).
#[derive(Clone, Debug)]
pub struct Link {
    pub from: LaneId,
    pub to: LaneId,
    /// Internal lanes on the way, in order; empty in nets without internal lanes.
    pub via: Vec<LaneId>,
    pub direction: LinkDirection,
    /// SUMO's `state`: `M` major, `m` minor, `=` equal, `s` stop, `o` uncontrolled by a signal that is off, ...
    pub state: char,
    pub signal: Option<SignalIndex>,
    pub junction: JunctionId,
    /// Index in the junction's request matrix, where it has one.
    pub request_index: Option<usize>,
    /// Links that this one must let pass (the request's `response`).
    pub must_yield_to: Vec<LinkId>,
    /// Links whose paths cross or join this one's (the request's `foes`).
    pub foes: Vec<LinkId>,
    /// Crossings that this link's path cuts across.
    pub crossings: Vec<CrossingId>,
    /// Crossings among those whose pedestrians go first.
    pub yields_to_crossings: Vec<CrossingId>,
}

/// A pedestrian crossing.
#[derive(Clone, Debug)]
pub struct Crossing {
    /// Its one lane, shape = centre line from kerb to kerb.
    pub lane: LaneId,
    pub edge: EdgeId,
    pub junction: JunctionId,
    /// The edges it lies over.
    pub crossed_edges: Vec<EdgeId>,
    /// Outline polygon (m): the file's `outlineShape`, or made from shape and width.
    pub outline: Vec<Point>,
    pub signal: Option<SignalIndex>,
    /// Pedestrians have priority over vehicles.
    pub priority: bool,
}

/// A junction (SUMO's, internal ones left out).
#[derive(Clone, Debug)]
pub struct Junction {
    pub id: String,
    /// SUMO's type: `priority`, `traffic_light`, `right_before_left`, ...
    pub kind: String,
    pub position: Point,
    /// Outline polygon (m).
    pub shape: Vec<Point>,
    pub incoming_edges: Vec<EdgeId>,
    pub outgoing_edges: Vec<EdgeId>,
    pub crossings: Vec<CrossingId>,
    /// Walkingarea lanes (shape = polygon).
    pub walkingareas: Vec<LaneId>,
}

/// A traffic light (tlLogic id) and what it controls.
#[derive(Clone, Debug)]
pub struct TrafficLight {
    pub id: String,
    /// Number of characters in its state.
    pub signals: usize,
    /// Links controlled by it.
    pub links: Vec<LinkId>,
    /// Crossings controlled by it.
    pub crossings: Vec<CrossingId>,
    /// Centre of what it controls (m), and the radius around it that holds all stop lines (m).
    pub position: Point,
    pub radius: f64,
}

/// A place on a lane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LanePosition {
    pub lane: LaneId,
    /// Arc length along the lane's shape (m).
    pub s: f64,
}

/// A lane near a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NearLane {
    pub lane: LaneId,
    /// Arc length along the lane's shape (m).
    pub s: f64,
    /// Lateral offset (m, left positive).
    pub d: f64,
    /// Horizontal distance from the point to the centre line (m).
    pub distance: f64,
}

/// The whole network.
#[derive(Clone, Debug)]
pub struct Network {
    pub edges: Vec<Edge>,
    pub lanes: Vec<Lane>,
    pub junctions: Vec<Junction>,
    pub links: Vec<Link>,
    pub crossings: Vec<Crossing>,
    pub traffic_lights: Vec<TrafficLight>,
    /// The edges of each roundabout's ring, in file order.
    pub roundabouts: Vec<Vec<EdgeId>>,
    /// True where traffic keeps left.
    pub left_hand: bool,
    /// Corners of the bounding box (m).
    pub bounds: (Point, Point),
    names: Names,
    tree: LaneTree,
    /// By class: the lanes of roads that it may use.
    drivable: Vec<Vec<LaneId>>,
    walks: PedestrianNetwork,
}

/// SUMO's ids.
#[derive(Clone, Debug, Default)]
struct Names {
    edges: HashMap<String, EdgeId>,
    lanes: HashMap<String, LaneId>,
    junctions: HashMap<String, JunctionId>,
    traffic_lights: HashMap<String, TrafficLightId>,
}

impl Lane {
    /// SUMO's lane_position (m) of arc length `s` (m) on the shape.
    pub fn lane_position(&self, s: f64) -> f64 {
        let shape = self.shape.length();
        if shape > 0.0 { s * self.length / shape } else { 0.0 }
    }

    /// Arc length (m) on the shape of SUMO's `lane_position` (m).
    pub fn arc_length(&self, lane_position: f64) -> f64 {
        if self.length > 0.0 { lane_position * self.shape.length() / self.length } else { 0.0 }
    }
}

impl Network {
    /// Reads a `.net.xml` or `.net.xml.gz` file.
    ///
    /// # Errors
    /// When the file cannot be read, is no XML, no network, cut off, or names what it does not have.
    pub fn load(path: &Path) -> Result<Self, NetworkError> {
        Self::from_xml(path, &xml::read_text(path)?)
    }

    /// The network of a `.net.xml` document; `path` is what errors call it.
    ///
    /// # Errors
    /// As [`Network::load`].
    pub fn from_xml(path: &Path, text: &str) -> Result<Self, NetworkError> {
        build::build(parse::parse(path, text)?, &build::Source { path, text })
    }

    /// The same network with lanes of these ids closed to everybody.
    #[must_use]
    pub fn without_lanes(&self, ids: &[String]) -> Self {
        let mut network = self.clone();
        for id in ids.iter().filter_map(|id| self.lane_by_id(id)) {
            network.lanes[id.index()].permissions = Permissions::NONE;
            network.drivable.iter_mut().for_each(|lanes| lanes.retain(|lane| *lane != id));
        }
        network
    }

    /// The edge with SUMO's id `id`.
    pub fn edge_by_id(&self, id: &str) -> Option<EdgeId> {
        self.names.edges.get(id).copied()
    }
    /// The lane with SUMO's id `id`.
    pub fn lane_by_id(&self, id: &str) -> Option<LaneId> {
        self.names.lanes.get(id).copied()
    }
    /// The junction with SUMO's id `id`.
    pub fn junction_by_id(&self, id: &str) -> Option<JunctionId> {
        self.names.junctions.get(id).copied()
    }
    /// The traffic light with SUMO's id `id`.
    pub fn traffic_light_by_id(&self, id: &str) -> Option<TrafficLightId> {
        self.names.traffic_lights.get(id).copied()
    }
    /// The centre line of a link's internal lanes; in nets without them straight from lane to lane.
    pub fn link_path(&self, id: LinkId) -> Polyline {
        let link = self.link(id);
        if link.via.is_empty() {
            let (from, to) = (&self.lane(link.from).shape, &self.lane(link.to).shape);
            return Polyline::new([from.at(from.length()).position, to.at(0.0).position]);
        }
        Polyline::new(link.via.iter().flat_map(|&l| self.lane(l).shape.points().iter().copied()))
    }
    /// How far it is over the junction on a link (m).
    pub fn link_length(&self, id: LinkId) -> f64 {
        let link = self.link(id);
        if link.via.is_empty() {
            return self.link_path(id).length();
        }
        link.via.iter().map(|&l| self.lane(l).shape.length()).sum()
    }
    /// Lanes of normal edges that `class` may use, in file order.
    pub fn drivable_lanes(&self, class: VehicleClass) -> &[LaneId] {
        &self.drivable[class as usize]
    }
    /// The same, or the error that says that there is none.
    ///
    /// # Errors
    /// [`NetworkError::NoDrivableLane`].
    pub fn require_drivable(&self, class: VehicleClass) -> Result<&[LaneId], NetworkError> {
        let lanes = self.drivable_lanes(class);
        if lanes.is_empty() {
            let road = |l: &&Lane| self.edge(l.edge).kind == EdgeKind::Normal;
            let lanes = self.lanes.iter().filter(road).count();
            return Err(NetworkError::NoDrivableLane { class, lanes });
        }
        Ok(lanes)
    }
    pub fn edge(&self, id: EdgeId) -> &Edge {
        &self.edges[id.index()]
    }
    pub fn lane(&self, id: LaneId) -> &Lane {
        &self.lanes[id.index()]
    }
    pub fn link(&self, id: LinkId) -> &Link {
        &self.links[id.index()]
    }
    pub fn junction(&self, id: JunctionId) -> &Junction {
        &self.junctions[id.index()]
    }
    pub fn crossing(&self, id: CrossingId) -> &Crossing {
        &self.crossings[id.index()]
    }
    pub fn traffic_light(&self, id: TrafficLightId) -> &TrafficLight {
        &self.traffic_lights[id.index()]
    }
}
