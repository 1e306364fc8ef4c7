//! Standing obstacles: vehicles, barriers and cones, as vehicles in SUMO, so that its traffic reacts to them.

use super::things::{Closure, ObjectShape};
use crate::destination::EGO_CLASS;
use crate::traffic::Model;
use std::collections::BTreeSet;
use sumo_network::geometry::Pose;
use sumo_network::network::{LaneId, LanePosition, Network};
use sumo_traci::{Batch, Color, lane, route, vehicle, vehicle_type};

/// Begins the ids of everything that a scenario puts into SUMO.
pub const PREFIX: &str = "wad_scene_";

/// Way between the barriers of a closed lane (m).
const BARRIERS: f64 = 8.0;

/// Puts things into SUMO, and remembers what has been defined there: it refuses what it knows already.
#[derive(Debug, Default)]
pub struct Stage {
    routes: BTreeSet<String>,
    types: BTreeSet<String>,
}

impl Stage {
    /// A vehicle of the fleet that stands with its rear at `at`. Returns its id.
    pub fn park(
        &mut self,
        network: &Network,
        id: &str,
        model: &Model,
        at: LanePosition,
        batch: &mut Batch,
    ) -> String {
        self.stand(network, id, model.id, model.length, at, batch)
    }

    /// A barrier or cone of some `width` (m) across the lane at `at`.
    pub fn object(
        &mut self,
        network: &Network,
        id: &str,
        (shape, width): (ObjectShape, f64),
        at: LanePosition,
        batch: &mut Batch,
    ) -> String {
        let (length, height, _) = shape.sizes();
        let type_id = format!("{}_{:.0}", shape.type_id(), 100.0 * width);
        if self.types.insert(type_id.clone()) {
            vehicle_type::copy(batch, "DEFAULT_VEHTYPE", &type_id);
            // Class `ignoring`: it may stand on any lane.
            batch.set(vehicle_type::SET_VEHICLE_CLASS, &type_id, "ignoring");
            batch.set(vehicle_type::SET_LENGTH, &type_id, length);
            batch.set(vehicle_type::SET_WIDTH, &type_id, width);
            batch.set(vehicle_type::SET_HEIGHT, &type_id, height);
            batch.set(vehicle_type::SET_MIN_GAP, &type_id, 0.5);
            batch.set(vehicle_type::SET_COLOR, &type_id, Color::rgb(230, 90, 20));
        }
        self.stand(network, id, &type_id, length, at, batch)
    }

    fn stand(
        &mut self,
        network: &Network,
        id: &str,
        type_id: &str,
        length: f64,
        at: LanePosition,
        batch: &mut Batch,
    ) -> String {
        let (id, lane) = (format!("{PREFIX}{id}"), network.lane(at.lane));
        let edge = network.edge(lane.edge).id.as_str();
        let route = self.route(&[edge], batch);
        let front = lane.lane_position(at.s + length).clamp(0.1, (lane.length - 0.1).max(0.1));
        let add = vehicle::Add {
            route: &route,
            vehicle_type: type_id,
            depart_lane: &lane.index.to_string(),
            depart_pos: &format!("{front:.2}"),
            depart_speed: "0",
            ..vehicle::Add::default()
        };
        vehicle::add(batch, &id, &add);
        batch.set(vehicle::SET_SPEED_MODE, &id, 0);
        batch.set(vehicle::SET_LANE_CHANGE_MODE, &id, 0);
        batch.set(vehicle::SET_SPEED, &id, 0.0);
        id
    }

    /// A route in SUMO along these edges. Returns its id.
    pub fn route(&mut self, edges: &[&str], batch: &mut Batch) -> String {
        let id = format!("{PREFIX}route {}", edges.join(" "));
        if self.routes.insert(id.clone()) {
            route::add(batch, &id, edges);
        }
        id
    }

    /// Closes a lane over a stretch: puts barriers across it, and forbids it to all classes if the road has
    /// another lane for cars.
    pub fn close(&mut self, network: &Network, id: &str, closure: &Closure, batch: &mut Batch) {
        let lane = network.lane(closure.at.lane);
        if has_other_lane(network, closure.at.lane) {
            batch.set(lane::SET_ALLOWED, &lane.id, &["authority"]);
        }
        let width = (lane.width - 0.5).max(0.5);
        let count = (closure.length / BARRIERS).ceil().max(1.0) as usize;
        for i in 0..=count {
            let s = closure.at.s + closure.length * i as f64 / count as f64;
            let at = LanePosition { lane: closure.at.lane, s };
            let id = format!("{id}_{}_{i}", lane.id);
            self.object(network, &id, (ObjectShape::Barrier, width), at, batch);
        }
    }
}

/// Whether the road of a lane has another lane for cars. Otherwise traffic has to wait.
pub fn has_other_lane(network: &Network, lane: LaneId) -> bool {
    let edge = network.edge(network.lane(lane).edge);
    edge.lanes.iter().any(|&other| other != lane && network.lane(other).permissions.allows(EGO_CLASS))
}

/// A vehicle that is held where no lane would have it: askew, or off the middle.
#[derive(Clone, Debug)]
pub struct Held {
    pub id: String,
    /// Its centre.
    pub pose: Pose,
    /// m.
    pub length: f64,
    /// Hazard lights are on.
    pub hazard: bool,
}

impl Held {
    /// Holds it in place; needed with every step.
    pub fn hold(&self, batch: &mut Batch) {
        let (front, angle) = self.pose.to_sumo(self.length);
        let to = vehicle::MoveToXy {
            x: front.x,
            y: front.y,
            angle_deg: angle,
            keep_route: 2,
            ..Default::default()
        };
        vehicle::move_to_xy(batch, &self.id, &to);
        if self.hazard {
            use sumo_network::world::VehicleSignals as S;
            batch.set(vehicle::SET_SIGNALS, &self.id, (S::BLINKER_LEFT | S::BLINKER_RIGHT) as i32);
        }
    }
}
