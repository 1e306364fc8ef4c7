//! What stands in the ego's way in the obstacle task.

use super::EnvError;
use crate::bridge::{Bridge, Ego, OBSTACLE};
use crate::geometry::Pose;
use crate::tasks::{ObstacleKind, ObstaclePlacement};
use crate::traci::{RemoveReason, route, vehicle};
use crate::traffic::{FLEET, WALKERS};
use crate::vehicle::PartnerKind;
use crate::world::{Actor, ActorKind, ActorType, VehicleSignals};
use std::sync::Arc;

impl ObstacleKind {
    fn actor(self) -> ActorKind {
        match self {
            Self::Car => ActorKind::Car,
            Self::Truck => ActorKind::Truck,
            Self::Bus => ActorKind::Bus,
            Self::Motorcycle => ActorKind::Motorcycle,
            Self::Bicycle => ActorKind::Bicycle,
            Self::Person => ActorKind::Pedestrian,
        }
    }
}

/// Puts it there with the next step: vehicles into SUMO, whose traffic then queues behind them; a person
/// into the ego's world alone, since SUMO's persons do not stand in lanes.
pub fn put(bridge: &mut Bridge, ego: &mut Ego, wanted: &ObstaclePlacement) -> Result<(), EnvError> {
    let network = Arc::clone(bridge.network());
    let place = wanted.at.on(&network)?;
    let lane = network.lane(place.lane);
    let fits = |model: &&crate::traffic::Model| {
        model.kind == wanted.kind.actor() && lane.permissions.allows(model.class)
    };
    if wanted.kind == ObstacleKind::Person {
        ego.set_extras(vec![person(lane.shape.at(place.s))]);
        return Ok(());
    }
    // Where no bus may be, a car may.
    let Some(model) = FLEET.iter().find(fits).or(FLEET.first()) else { return Ok(()) };
    let edge = network.edge(lane.edge).id.as_str();
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
    vehicle::add(batch, OBSTACLE, &add);
    batch.set(vehicle::SET_SPEED_MODE, OBSTACLE, 0);
    batch.set(vehicle::SET_LANE_CHANGE_MODE, OBSTACLE, 0);
    batch.set(vehicle::SET_SPEED, OBSTACLE, 0.0);
    Ok(())
}

/// Takes it away with the next step.
pub fn take_away(bridge: &mut Bridge, ego: &mut Ego) {
    ego.set_extras(Vec::new());
    // A person was never in SUMO: it refuses, and nothing is lost.
    vehicle::remove(bridge.next_batch(), OBSTACLE, RemoveReason::Vaporized);
}

/// A person who stands at `place`, turned to whoever comes.
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
