//! The road network as SUMO's `.net.xml` describes it: edges, lanes, junctions, links,
//! crossings, walkingareas and signals, with nearest-lane queries and routes.
//!
//! Everything is stored in flat vectors and referred to by small ids, in file order,
//! so that iteration is deterministic.

mod build;
mod centre_line;
mod elements;
mod error;
mod parse;
mod pedestrian;
mod permissions;
mod polygons;
mod programs;
mod reach;
mod requests;
mod route;
mod route_search;
#[cfg(test)]
mod route_tests;
mod smooth;
mod source;
mod spatial;
#[doc(hidden)]
pub mod testing;
mod xml;

pub use elements::{
    Crossing, CrossingId, Edge, EdgeId, EdgeKind, Junction, JunctionId, Lane, LaneId, LanePosition, Link,
    LinkDirection, LinkId, NearLane, SignalIndex, TrafficLight, TrafficLightId,
};
pub use error::NetworkError;
pub use permissions::{Permissions, VehicleClass};
pub use polygons::{PointOfInterest, Polygon, Shapes};
pub use programs::SignalProgram;
pub use route::{RoadOption, Route, RouteError, RouteLink, RoutePoint, RouteSection};
pub use xml::{read_bytes, read_text};

use crate::geometry::{Point, Polyline};
use pedestrian::PedestrianNetwork;
use spatial::LaneTree;
use std::collections::HashMap;

/// The whole network.
#[derive(Clone, Debug)]
pub struct Network {
    /// By [`EdgeId`].
    pub edges: Vec<Edge>,
    /// By [`LaneId`].
    pub lanes: Vec<Lane>,
    /// By [`JunctionId`].
    pub junctions: Vec<Junction>,
    /// By [`LinkId`].
    pub links: Vec<Link>,
    /// By [`CrossingId`].
    pub crossings: Vec<Crossing>,
    /// By [`TrafficLightId`].
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

impl Network {
    /// The same network with the lanes of these ids closed to all classes.
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
    /// The edge with this id.
    pub fn edge(&self, id: EdgeId) -> &Edge {
        &self.edges[id.index()]
    }
    /// The lane with this id.
    pub fn lane(&self, id: LaneId) -> &Lane {
        &self.lanes[id.index()]
    }
    /// The link with this id.
    pub fn link(&self, id: LinkId) -> &Link {
        &self.links[id.index()]
    }
    /// The junction with this id.
    pub fn junction(&self, id: JunctionId) -> &Junction {
        &self.junctions[id.index()]
    }
    /// The crossing with this id.
    pub fn crossing(&self, id: CrossingId) -> &Crossing {
        &self.crossings[id.index()]
    }
    /// The traffic light with this id.
    pub fn traffic_light(&self, id: TrafficLightId) -> &TrafficLight {
        &self.traffic_lights[id.index()]
    }

    /// Lanes whose centre line passes within `radius` (m) of `point`, nearest first: roads, paths,
    /// internal lanes and crossings, but no walkingareas (they have no centre line).
    /// `z` (m), where given, leaves out lanes more than 3 m above or below.
    pub fn lanes_near(&self, point: Point, z: Option<f64>, radius: f64) -> Vec<NearLane> {
        self.tree.near(&self.lanes, point, z, radius)
    }

    /// Whether the net has sidewalks and walkingareas, so that SUMO's pedestrians can walk everywhere.
    pub fn has_pedestrian_network(&self) -> bool {
        self.walks.is_complete()
    }

    /// Normal edges open to pedestrians of the largest part in which each is within a walk of each
    /// other, in file order.
    pub fn sidewalk_edges(&self) -> &[EdgeId] {
        self.walks.largest()
    }

    /// Whether one can walk from the begin of `edge` straight to `next`, by walkingareas and crossings of one junction, and
    /// from its end.
    pub fn walks_on(&self, edge: EdgeId, next: EdgeId) -> [bool; 2] {
        self.walks.walks_on(edge, next)
    }

    /// The shortest walk from one edge to another: normal edges, each joined to the next by
    /// walkingareas and crossings of one junction, as SUMO's `appendWalkingStage` takes them. None
    /// where no walk leads there. Sidewalks are walked in both directions.
    pub fn walk_route(&self, from: EdgeId, to: EdgeId) -> Option<Vec<EdgeId>> {
        self.walks.route(&self.edges, &self.lanes, from, to)
    }
}
