//! The obstacle of the obstacle task.

use super::EnvError;
use super::slot::FIRST;
use std::sync::Arc;
use sumo_network::geometry::Pose;
use sumo_network::world::{Actor, ActorKind, ActorType, VehicleSignals};
use sumo_traci::{route, vehicle};
use wad_sim::bridge::{Bridge, Ego};
use wad_sim::tasks::{ObstacleKind, ObstaclePlacement};
use wad_sim::traffic::{FLEET, WALKERS};
use wad_vehicle::PartnerKind;

/// SUMO's id of the first ego's obstacle; the others have their ego's behind it.
const OBSTACLE: &str = "obstacle";

fn actor(obstacle: ObstacleKind) -> ActorKind {
    match obstacle {
        ObstacleKind::Car => ActorKind::Car,
        ObstacleKind::Truck => ActorKind::Truck,
        ObstacleKind::Bus => ActorKind::Bus,
        ObstacleKind::Motorcycle => ActorKind::Motorcycle,
        ObstacleKind::Bicycle => ActorKind::Bicycle,
        ObstacleKind::Person => ActorKind::Pedestrian,
    }
}

/// SUMO's id of an ego's obstacle.
fn id(ego: &Ego) -> String {
    if ego.id == FIRST { OBSTACLE.to_string() } else { format!("{OBSTACLE}_{}", ego.id) }
}

/// Places it with the next step: vehicles into SUMO, whose traffic then queues behind them; a person only
/// into the ego's world, since SUMO's persons do not stand in lanes.
pub fn put(bridge: &mut Bridge, ego: &mut Ego, wanted: &ObstaclePlacement) -> Result<(), EnvError> {
    let network = Arc::clone(bridge.network());
    let place = wanted.at.on(&network)?;
    let lane = network.lane(place.lane);
    let fits = |model: &&wad_sim::traffic::Model| {
        model.kind == actor(wanted.kind) && lane.permissions.allows(model.class)
    };
    if wanted.kind == ObstacleKind::Person {
        ego.set_extras(vec![person(lane.shape.at(place.s))]);
        return Ok(());
    }
    // A car, where buses are not allowed.
    let Some(model) = FLEET.iter().find(fits).or(FLEET.first()) else { return Ok(()) };
    let edge = network.edge(lane.edge).id.as_str();
    let id = id(ego);
    bridge.keep(&id);
    let route_id = format!("{OBSTACLE}_{edge}");
    let batch = bridge.next_batch();
    // SUMO refuses a route that it has already; the vehicle then gets that one.
    route::add(batch, &route_id, &[edge]);
    let add = vehicle::Add {
        route: &route_id,
        vehicle_type: model.id,
        depart_lane: &lane.index.to_string(),
        depart_pos: &format!("{:.2}", lane.lane_position(place.s + model.length).min(lane.length - 0.1)),
        depart_speed: "0",
        ..vehicle::Add::default()
    };
    vehicle::add(batch, &id, &add);
    batch.set(vehicle::SET_SPEED_MODE, &id, 0);
    batch.set(vehicle::SET_LANE_CHANGE_MODE, &id, 0);
    batch.set(vehicle::SET_SPEED, &id, 0.0);
    Ok(())
}

/// Removes it with the next step.
pub fn take_away(bridge: &mut Bridge, ego: &mut Ego) {
    ego.set_extras(Vec::new());
    // A person was never in SUMO: it refuses, and nothing is lost.
    bridge.remove(&id(ego));
}

/// A person who stands at `place` and faces the traffic.
fn person(place: Pose) -> Actor {
    let walker = &WALKERS[0];
    let heading = place.heading + std::f64::consts::PI;
    Actor {
        id: Arc::from(OBSTACLE),
        key: u64::MAX - 1 - PartnerKind::Pedestrian as u64,
        actor_type: Arc::new(ActorType {
            id: walker.id.to_string(),
            kind: ActorKind::Pedestrian,
            length: 0.3,
            width: walker.width,
            height: walker.height,
            min_gap: 0.25,
        }),
        pose: Pose::new(place.position.x, place.position.y, place.position.z, heading),
        speed: 0.0,
        signals: VehicleSignals(0),
        lane: None,
        lane_position: 0.0,
    }
}
