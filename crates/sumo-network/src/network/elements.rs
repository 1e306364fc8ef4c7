//! What a network consists of: edges, lanes, links, crossings, junctions, traffic lights, and their ids.

use super::permissions::Permissions;
use super::programs::SignalProgram;
use crate::geometry::{Point, Polyline};

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
index_type!(/// An edge of [`Network::edges`](super::Network::edges).
    EdgeId);
index_type!(/// A lane of [`Network::lanes`](super::Network::lanes).
    LaneId);
index_type!(/// A junction of [`Network::junctions`](super::Network::junctions).
    JunctionId);
index_type!(/// A link of [`Network::links`](super::Network::links).
    LinkId);
index_type!(/// A crossing of [`Network::crossings`](super::Network::crossings).
    CrossingId);
index_type!(/// A signal program of [`Network::traffic_lights`](super::Network::traffic_lights).
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
    /// What it is for.
    pub kind: EdgeKind,
    /// None for internal edges, crossings and walkingareas.
    pub from: Option<JunctionId>,
    /// Junction at its end.
    pub to: Option<JunctionId>,
    /// The junction that an internal edge, crossing or walkingarea lies in.
    pub junction: Option<JunctionId>,
    /// SUMO's priority: it decides the right of way where edges meet.
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
    /// The edge that it belongs to.
    pub edge: EdgeId,
    /// 0 is the outermost lane.
    pub index: usize,
    /// m/s.
    pub speed_limit: f64,
    /// SUMO's lane length (m): lane_position counts in it; may differ from `shape.length()`.
    pub length: f64,
    /// m; 3.2 if the file has none.
    pub width: f64,
    /// The classes that may drive (or walk) on it.
    pub permissions: Permissions,
    /// Classes that may change from here to the lane with the next higher index (SUMO's `changeLeft`).
    pub change_up: Permissions,
    /// Classes that may change from here to the lane with the next lower index (SUMO's `changeRight`).
    pub change_down: Permissions,
    /// Centre line (m); for a walkingarea its outline.
    pub shape: Polyline,
    /// Links that leave this lane.
    pub outgoing: Vec<LinkId>,
    /// Links that enter this lane (for internal lanes: the link whose `via` holds it).
    pub incoming: Vec<LinkId>,
}

/// Which way a link turns (SUMO's `dir`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LinkDirection {
    /// On over the junction.
    Straight,
    /// Back on the same road.
    TurnAround,
    /// To the left.
    Left,
    /// To the right.
    Right,
    /// Half left.
    PartLeft,
    /// Half right.
    PartRight,
    /// SUMO names none.
    Invalid,
}

/// A signal head: one character of a traffic light's state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SignalIndex {
    /// The traffic light.
    pub traffic_light: TrafficLightId,
    /// Position in the state string.
    pub index: usize,
}

/// A way over a junction from one lane to another (SUMO's connection between normal edges).
#[derive(Clone, Debug)]
pub struct Link {
    /// Lane that it leaves.
    pub from: LaneId,
    /// Lane that it enters.
    pub to: LaneId,
    /// Internal lanes on the way, in order; empty in nets without internal lanes.
    pub via: Vec<LaneId>,
    /// Which way it turns.
    pub direction: LinkDirection,
    /// SUMO's `state`: `M` major, `m` minor, `=` equal, `s` stop, `o` uncontrolled by a signal that is off, ...
    pub state: char,
    /// The signal that controls it.
    pub signal: Option<SignalIndex>,
    /// The junction that it lies in.
    pub junction: JunctionId,
    /// Index in the junction's request matrix, where it has one.
    pub request_index: Option<usize>,
    /// Links that this one must let pass (the request's `response`).
    pub must_yield_to: Vec<LinkId>,
    /// Links whose paths cross or join this one's (the request's `foes`).
    pub foes: Vec<LinkId>,
    /// Crossings that this link's path cuts across.
    pub crossings: Vec<CrossingId>,
    /// Crossings whose pedestrians have the right of way.
    pub yields_to_crossings: Vec<CrossingId>,
}

/// A pedestrian crossing.
#[derive(Clone, Debug)]
pub struct Crossing {
    /// Its one lane, shape = centre line from kerb to kerb.
    pub lane: LaneId,
    /// Its edge, of kind [`EdgeKind::Crossing`].
    pub edge: EdgeId,
    /// The junction that it belongs to.
    pub junction: JunctionId,
    /// The edges it lies over.
    pub crossed_edges: Vec<EdgeId>,
    /// Outline polygon (m): the file's `outlineShape`, or made from shape and width.
    pub outline: Vec<Point>,
    /// The signal for pedestrians.
    pub signal: Option<SignalIndex>,
    /// Pedestrians have priority over vehicles.
    pub priority: bool,
}

/// A junction (SUMO's, internal ones left out).
#[derive(Clone, Debug)]
pub struct Junction {
    /// SUMO's id.
    pub id: String,
    /// SUMO's type: `priority`, `traffic_light`, `right_before_left`, ...
    pub kind: String,
    /// Its centre (m).
    pub position: Point,
    /// Outline polygon (m).
    pub shape: Vec<Point>,
    /// Normal edges that end here.
    pub incoming_edges: Vec<EdgeId>,
    /// Normal edges that begin here.
    pub outgoing_edges: Vec<EdgeId>,
    /// Crossings over its arms.
    pub crossings: Vec<CrossingId>,
    /// Walkingarea lanes (shape = polygon).
    pub walkingareas: Vec<LaneId>,
}

/// A traffic light (tlLogic id) and what it controls.
#[derive(Clone, Debug)]
pub struct TrafficLight {
    /// SUMO's id of the tlLogic.
    pub id: String,
    /// Number of characters in its state.
    pub signals: usize,
    /// The net's programs for it. A run may bring others.
    pub programs: Vec<SignalProgram>,
    /// Links controlled by it.
    pub links: Vec<LinkId>,
    /// Crossings controlled by it.
    pub crossings: Vec<CrossingId>,
    /// Centre of what it controls (m), and the radius around it that holds all stop lines (m).
    pub position: Point,
    /// Radius (m), see `position`.
    pub radius: f64,
}

/// A place on a lane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LanePosition {
    /// The lane.
    pub lane: LaneId,
    /// Arc length along the lane's shape (m).
    pub s: f64,
}

/// A lane near a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NearLane {
    /// The lane.
    pub lane: LaneId,
    /// Arc length along the lane's shape (m).
    pub s: f64,
    /// Lateral offset (m, left positive).
    pub d: f64,
    /// Horizontal distance from the point to the centre line (m).
    pub distance: f64,
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
