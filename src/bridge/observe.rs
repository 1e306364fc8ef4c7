//! From the subscriptions that come with a step to a [`WorldState`].

use crate::geometry::Pose;
use crate::network::Network;
use crate::traci::{self, Batch, TcpClient, person, vehicle, vehicle_type};
use crate::world::{Actor, ActorKind, ActorType, VehicleSignals};
use nalgebra::Point3;
use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

/// Ticks after which an actor that is out of sight is forgotten.
const FORGET_AFTER: u64 = 2000;

/// Remembers ids and types of the actors seen, so that a tick copies numbers only.
#[derive(Debug, Default)]
pub struct ActorCatalog {
    types: BTreeMap<String, Arc<ActorType>>,
    // Only looked up, never iterated: its order does not matter.
    seen: HashMap<Arc<str>, Seen>,
    next_key: u64,
    tick: u64,
}

#[derive(Debug)]
struct Seen {
    key: u64,
    actor_type: Arc<ActorType>,
    last_tick: u64,
}

/// What a context subscription says of one actor.
struct Observed<'a> {
    id: &'a str,
    type_id: &'a str,
    position: Point3<f64>,
    degrees: f64,
    speed: f64,
    acceleration: f64,
    signals: u32,
    lane: &'a str,
    lane_position: f64,
}

/// Subscribes the ego `id` to everything within `sight` (m).
pub fn subscribe(batch: &mut Batch, id: &str, sight: f64) {
    batch.subscribe_context(
        vehicle::Vehicle,
        id,
        vehicle::Vehicle,
        sight,
        &[
            vehicle::TYPE.id(),
            vehicle::POSITION_3D.id(),
            vehicle::ANGLE.id(),
            vehicle::SPEED.id(),
            vehicle::ACCELERATION.id(),
            vehicle::SIGNALS.id(),
            vehicle::LANE_ID.id(),
            vehicle::LANE_POSITION.id(),
        ],
    );
    batch.subscribe_context(
        vehicle::Vehicle,
        id,
        person::Person,
        sight,
        &[
            person::TYPE.id(),
            person::POSITION_3D.id(),
            person::ANGLE.id(),
            person::SPEED.id(),
            person::LANE_ID.id(),
            person::LANE_POSITION.id(),
        ],
    );
}

impl ActorCatalog {
    /// Begins a new tick.
    pub fn next_tick(&mut self) {
        self.tick += 1;
        if self.tick.is_multiple_of(FORGET_AFTER) {
            let oldest = self.tick - FORGET_AFTER;
            self.seen.retain(|_, seen| seen.last_tick > oldest);
        }
    }

    /// Vehicles (without the ego `id` itself) and pedestrians round the ego, each ordered by id.
    /// Types not met before are asked for, which costs a message.
    pub async fn observe(
        &mut self,
        client: &mut TcpClient,
        network: &Network,
        replies: &traci::Replies,
        id: &str,
        world: (&mut Vec<Actor>, &mut Vec<Actor>),
    ) -> Result<(), traci::Error> {
        let (vehicles, pedestrians) = world;
        vehicles.clear();
        pedestrians.clear();
        let mut unknown: Vec<&str> = Vec::new();
        let results = replies.subscriptions();
        for object in results.context(vehicle::Vehicle, id, vehicle::Vehicle).filter(|o| o.id() != id) {
            let position = object.value(vehicle::POSITION_3D)?;
            let observed = Observed {
                id: object.id(),
                type_id: object.str(vehicle::TYPE)?,
                position: Point3::new(position.x, position.y, position.z),
                degrees: object.value(vehicle::ANGLE)?,
                speed: object.value(vehicle::SPEED)?,
                acceleration: object.value(vehicle::ACCELERATION)?,
                signals: object.value(vehicle::SIGNALS)? as u32,
                lane: object.str(vehicle::LANE_ID)?,
                lane_position: object.value(vehicle::LANE_POSITION)?,
            };
            self.push(&observed, network, &mut unknown, vehicles);
        }
        for object in results.context(vehicle::Vehicle, id, person::Person) {
            let position = object.value(person::POSITION_3D)?;
            let observed = Observed {
                id: object.id(),
                type_id: object.str(person::TYPE)?,
                position: Point3::new(position.x, position.y, position.z),
                degrees: object.value(person::ANGLE)?,
                speed: object.value(person::SPEED)?,
                acceleration: 0.0,
                signals: 0,
                lane: object.str(person::LANE_ID)?,
                lane_position: object.value(person::LANE_POSITION)?,
            };
            self.push(&observed, network, &mut unknown, pedestrians);
        }
        if !unknown.is_empty() {
            self.ask_types(client, &unknown).await?;
            return Box::pin(self.observe(client, network, replies, id, (vehicles, pedestrians))).await;
        }
        vehicles.sort_unstable_by(|a, b| a.id.cmp(&b.id));
        pedestrians.sort_unstable_by(|a, b| a.id.cmp(&b.id));
        Ok(())
    }

    fn push<'a>(
        &mut self,
        observed: &Observed<'a>,
        network: &Network,
        unknown: &mut Vec<&'a str>,
        actors: &mut Vec<Actor>,
    ) {
        // Not in the network yet, or not any more: SUMO's "no value".
        if observed.position.x < -1e9 || !observed.position.x.is_finite() {
            return;
        }
        let (id, key, actor_type) = match self.seen.get_key_value(observed.id) {
            Some((id, seen)) if seen.actor_type.id == observed.type_id => {
                (Arc::clone(id), seen.key, Arc::clone(&seen.actor_type))
            }
            _ => {
                let Some(actor_type) = self.types.get(observed.type_id) else {
                    if !unknown.contains(&observed.type_id) {
                        unknown.push(observed.type_id);
                    }
                    return;
                };
                self.next_key += 1;
                (Arc::from(observed.id), self.next_key, Arc::clone(actor_type))
            }
        };
        let seen = Seen { key, actor_type: Arc::clone(&actor_type), last_tick: self.tick };
        self.seen.insert(Arc::clone(&id), seen);
        actors.push(Actor {
            id,
            key,
            pose: Pose::from_sumo(observed.position, observed.degrees, actor_type.length),
            actor_type,
            speed: observed.speed,
            acceleration: observed.acceleration,
            signals: VehicleSignals(observed.signals),
            lane: network.lane_by_id(observed.lane),
            lane_position: observed.lane_position,
        });
    }

    async fn ask_types(&mut self, client: &mut TcpClient, names: &[&str]) -> Result<(), traci::Error> {
        let mut batch = Batch::new();
        let tickets: Vec<_> = names
            .iter()
            .map(|name| {
                (
                    batch.get(vehicle_type::VEHICLE_CLASS, name),
                    batch.get(vehicle_type::SHAPE_CLASS, name),
                    [vehicle_type::LENGTH, vehicle_type::WIDTH, vehicle_type::HEIGHT, vehicle_type::MIN_GAP]
                        .map(|variable| batch.get(variable, name)),
                )
            })
            .collect();
        let replies = client.send(&batch).await?;
        for (name, (class, shape, measures)) in names.iter().zip(tickets) {
            let [length, width, height, min_gap] = measures;
            let actor_type = ActorType {
                id: (*name).to_string(),
                kind: kind_of(replies.get_ref(class)?, replies.get_ref(shape)?),
                length: replies.get(length)?,
                width: replies.get(width)?,
                height: replies.get(height)?,
                min_gap: replies.get(min_gap)?,
            };
            self.types.insert(actor_type.id.clone(), Arc::new(actor_type));
        }
        Ok(())
    }
}

/// The kind of a road user, by SUMO's vehicle class, then by its gui shape.
fn kind_of(class: &str, shape: &str) -> ActorKind {
    match class {
        "pedestrian" | "wheelchair" => ActorKind::Pedestrian,
        "bicycle" | "scooter" => ActorKind::Bicycle,
        "motorcycle" | "moped" => ActorKind::Motorcycle,
        "bus" | "coach" | "tram" | "rail_urban" | "rail" | "rail_electric" | "rail_fast" | "subway"
        | "cable_car" => ActorKind::Bus,
        "truck" | "trailer" => ActorKind::Truck,
        "delivery" => ActorKind::Van,
        _ => match shape.split('/').next().unwrap_or_default() {
            "pedestrian" => ActorKind::Pedestrian,
            "bicycle" => ActorKind::Bicycle,
            "motorcycle" | "moped" | "scooter" => ActorKind::Motorcycle,
            "bus" => ActorKind::Bus,
            "truck" | "firebrigade" => ActorKind::Truck,
            "delivery" | "emergency" => ActorKind::Van,
            _ => ActorKind::Car,
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn class_wins_over_shape() {
        assert_eq!(kind_of("passenger", "passenger/sedan"), ActorKind::Car);
        assert_eq!(kind_of("passenger", "delivery"), ActorKind::Van);
        assert_eq!(kind_of("delivery", "passenger"), ActorKind::Van);
        assert_eq!(kind_of("bus", ""), ActorKind::Bus);
    }
}
