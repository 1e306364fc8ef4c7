//! From the subscriptions that come with a step to each ego's [`WorldState`].
//!
//! What an ego sees is fetched in one of two ways ([`Fetch`]); both bring the same road users.

use nalgebra::Point3;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;
use sumo_network::geometry::{Point, Pose};
use sumo_network::network::Network;
use sumo_network::world::{Actor, ActorKind, ActorType, VehicleSignals, WorldState};
use sumo_traci::{Batch, TcpClient, person, vehicle, vehicle_type};

/// Ticks after which an actor that is out of sight is forgotten.
const FORGET_AFTER: u64 = 2000;

/// Prefix of the types of objects that are vehicles in SUMO.
const OBJECTS: &str = "wad_object";

/// How the road users in sight are fetched with each step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Fetch {
    /// The cheaper one for the number of egos and the size of the population at the egos' arrival.
    #[default]
    Auto,
    /// SUMO searches round each ego: the cost grows with the egos and what is near them.
    Around,
    /// SUMO sends all that moves, once; each ego's sight is searched here: the cost grows with the population.
    Once,
}

/// With this many road users per ego or fewer, [`Fetch::Once`] is cheaper (docs/fleet.md).
const ONCE_UP_TO: usize = 8;

impl Fetch {
    /// The way to fetch for `egos` egos in a population of `users`.
    pub fn resolve(self, egos: usize, users: usize) -> Self {
        match self {
            Self::Auto if egos > 1 && users <= ONCE_UP_TO * egos => Self::Once,
            Self::Auto => Self::Around,
            chosen => chosen,
        }
    }
}

/// A radius that reaches across every net (m).
const EVERYWHERE: f64 = 1e7;

/// Remembers ids and types of the actors seen, so that a tick copies numbers only.
///
/// It only subscribes to values that cannot be computed here, since each value costs SUMO about a
/// microsecond: types are queried once per actor, lane positions come from the lane's shape, and
/// speeds from the way since the last tick.
#[derive(Debug, Default)]
pub struct ActorCatalog {
    types: BTreeMap<String, Arc<ActorType>>,
    /// By [`Domain`], then by id: a vehicle and a person may share one. Only looked up: the order does not matter.
    seen: [HashMap<Arc<str>, Seen>; 2],
    next_key: u64,
    tick: u64,
    everyone: Everyone,
}

/// All that moves after a step, ordered by the front bumper's x.
#[derive(Debug, Default)]
struct Everyone {
    users: Vec<(Point, Domain, Actor)>,
}

impl Everyone {
    /// Vehicles and pedestrians within `sight` (m) of `place`, without the ego `id`, each ordered by id.
    fn in_sight(&self, id: &str, place: Point, sight: f64, world: &mut WorldState) {
        let first = self.users.partition_point(|(front, ..)| front.x < place.x - sight);
        let near = self.users[first..].iter().take_while(|(front, ..)| front.x <= place.x + sight);
        for (front, domain, actor) in near {
            let itself = *domain == Domain::Vehicle && &*actor.id == id;
            if (front - place).norm() <= sight && !itself {
                list(world, *domain).push(actor.clone());
            }
        }
    }
}

#[derive(Debug)]
struct Seen {
    key: u64,
    actor_type: Arc<ActorType>,
    last_tick: u64,
    /// Front bumper (m) and speed (m/s) at that tick.
    position: Point3<f64>,
    speed: f64,
}

/// No road user gains speed faster (m/s2), but that who walks has its speed at once (m/s).
const MOST_GAIN: f64 = 10.0;
const AT_ONCE: f64 = 2.0;

/// The mean speed over a tick (s) in which an actor came `moved` m further, after `last` m/s. SUMO puts some elsewhere at once:
/// pedestrians who turn round at a corner (1 to 27 m), vehicles that it takes out of a jam. They were not so fast, and must
/// not go on so, through whoever stands there.
fn speed(moved: f64, last: f64, tick: f64) -> f64 {
    (moved / tick).min((last + MOST_GAIN * tick).max(AT_ONCE))
}

/// Where SUMO keeps an actor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Domain {
    Vehicle,
    Person,
}

/// What a context subscription says of one actor.
struct Observed<'a> {
    domain: Domain,
    id: &'a str,
    /// Front bumper (m).
    position: Point3<f64>,
    degrees: f64,
    signals: u32,
    lane: &'a str,
}

/// Subscribes to what the ego `id` needs with each step: what is within `sight` (m) of it, or all that moves.
pub fn subscribe(batch: &mut Batch, id: &str, sight: f64, fetch: Fetch) {
    let sight = if fetch == Fetch::Once { EVERYWHERE } else { sight };
    batch.subscribe_context(
        vehicle::Vehicle,
        id,
        vehicle::Vehicle,
        sight,
        &[vehicle::POSITION_3D.id(), vehicle::ANGLE.id(), vehicle::SIGNALS.id(), vehicle::LANE_ID.id()],
    );
    batch.subscribe_context(
        vehicle::Vehicle,
        id,
        person::Person,
        sight,
        &[person::POSITION_3D.id(), person::ANGLE.id(), person::LANE_ID.id()],
    );
}

impl ActorCatalog {
    /// Begins a new tick.
    pub fn next_tick(&mut self) {
        self.tick += 1;
        if self.tick.is_multiple_of(FORGET_AFTER) {
            let oldest = self.tick - FORGET_AFTER;
            for seen in &mut self.seen {
                seen.retain(|_, seen| seen.last_tick > oldest);
            }
        }
    }

    /// Reads all that moves after a tick of `tick` s, for [`ActorCatalog::observe`]; `id` is the ego that is
    /// subscribed to it.
    pub async fn observe_all(
        &mut self,
        client: &mut TcpClient,
        network: &Network,
        replies: &sumo_traci::Replies,
        id: &str,
        tick: f64,
    ) -> Result<(), sumo_traci::Error> {
        let mut users = std::mem::take(&mut self.everyone.users);
        users.clear();
        let observed = read(replies, id, None)?;
        self.read(client, network, &observed, tick, |front, domain, actor| {
            users.push((front, domain, actor))
        })
        .await?;
        users.sort_unstable_by(|a, b| a.0.x.total_cmp(&b.0.x).then_with(|| a.2.id.cmp(&b.2.id)));
        self.everyone.users = users;
        Ok(())
    }

    /// Vehicles (without the ego itself) and pedestrians within `sight` (m) of the ego `id`, whose front bumper is
    /// at `place`, each ordered by id: from the last [`ActorCatalog::observe_all`].
    pub fn observe(&self, id: &str, place: Point, sight: f64, world: &mut WorldState) {
        forget(world);
        self.everyone.in_sight(id, place, sight, world);
        order(world);
    }

    /// The same from the ego's own subscription, after a tick of `tick` s.
    pub async fn observe_around(
        &mut self,
        client: &mut TcpClient,
        network: &Network,
        replies: &sumo_traci::Replies,
        id: &str,
        tick: f64,
        world: &mut WorldState,
    ) -> Result<(), sumo_traci::Error> {
        forget(world);
        let observed = read(replies, id, Some(id))?;
        self.read(client, network, &observed, tick, |_, domain, actor| list(world, domain).push(actor))
            .await?;
        order(world);
        Ok(())
    }

    /// Completes what a subscription brought. New ones are queried, which costs a message.
    async fn read(
        &mut self,
        client: &mut TcpClient,
        network: &Network,
        observed: &[Observed<'_>],
        tick: f64,
        mut found: impl FnMut(Point, Domain, Actor),
    ) -> Result<(), sumo_traci::Error> {
        let new: Vec<&Observed<'_>> = observed.iter().filter(|actor| !self.knows(actor)).collect();
        if !new.is_empty() {
            self.ask(client, &new).await?;
        }
        for observed in observed {
            if let Some(actor) = self.actor(observed, network, tick) {
                found(observed.position.xy(), observed.domain, actor);
            }
        }
        Ok(())
    }

    /// Whether an actor was seen a tick ago (or in this one, by another ego), so that its speed is known.
    fn knows(&self, actor: &Observed<'_>) -> bool {
        let seen = self.seen[actor.domain as usize].get(actor.id);
        seen.is_some_and(|seen| seen.last_tick + 1 >= self.tick)
    }

    /// None for one that left in this very step: it could not be asked about.
    fn actor(&mut self, observed: &Observed<'_>, network: &Network, tick: f64) -> Option<Actor> {
        let known = &mut self.seen[observed.domain as usize];
        let id = Arc::clone(known.get_key_value(observed.id)?.0);
        let seen = known.get_mut(observed.id)?;
        if seen.last_tick + 1 == self.tick {
            seen.speed = speed((observed.position - seen.position).norm(), seen.speed, tick);
        }
        (seen.last_tick, seen.position) = (self.tick, observed.position);
        let lane = network.lane_by_id(observed.lane);
        let lane_position = match (observed.domain, lane) {
            (Domain::Vehicle, Some(lane)) => {
                let lane = network.lane(lane);
                lane.lane_position(lane.shape.project(observed.position.xy()).s)
            }
            _ => 0.0,
        };
        Some(Actor {
            id,
            key: seen.key,
            pose: Pose::from_sumo(observed.position, observed.degrees, seen.actor_type.length),
            actor_type: Arc::clone(&seen.actor_type),
            speed: seen.speed,
            signals: VehicleSignals(observed.signals),
            lane,
            lane_position,
        })
    }

    /// Learns types and speeds of actors that come into sight, and the measures of new types.
    async fn ask(
        &mut self,
        client: &mut TcpClient,
        actors: &[&Observed<'_>],
    ) -> Result<(), sumo_traci::Error> {
        let mut batch = Batch::new();
        let tickets: Vec<_> = actors
            .iter()
            .map(|actor| match actor.domain {
                Domain::Vehicle => (batch.get(vehicle::TYPE, actor.id), batch.get(vehicle::SPEED, actor.id)),
                Domain::Person => (batch.get(person::TYPE, actor.id), batch.get(person::SPEED, actor.id)),
            })
            .collect();
        let replies = client.send(&batch).await?;
        let mut answers = Vec::with_capacity(actors.len());
        for (actor, (actor_type, speed)) in actors.iter().zip(tickets) {
            // It may have arrived in the step itself: then there is nothing to know of it.
            if let (Ok(actor_type), Ok(speed)) = (replies.get_ref(actor_type), replies.get(speed)) {
                answers.push((actor, actor_type, speed));
            }
        }
        let mut new: Vec<&str> =
            answers.iter().map(|answer| answer.1).filter(|t| !self.types.contains_key(*t)).collect();
        new.sort_unstable();
        new.dedup();
        if !new.is_empty() {
            self.ask_types(client, &new).await?;
        }
        for (actor, type_id, speed) in answers {
            let Some(actor_type) = self.types.get(type_id) else { continue };
            let known = &mut self.seen[actor.domain as usize];
            let key = known.get(actor.id).map_or(self.next_key + 1, |seen| seen.key);
            self.next_key = self.next_key.max(key);
            let seen = Seen {
                key,
                actor_type: Arc::clone(actor_type),
                last_tick: self.tick,
                position: actor.position,
                speed,
            };
            known.insert(Arc::from(actor.id), seen);
        }
        Ok(())
    }

    async fn ask_types(&mut self, client: &mut TcpClient, names: &[&str]) -> Result<(), sumo_traci::Error> {
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
                kind: if name.starts_with(OBJECTS) {
                    ActorKind::Object
                } else {
                    kind_of(replies.get_ref(class)?, replies.get_ref(shape)?)
                },
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

/// The road users of one kind in `world`.
fn list(world: &mut WorldState, domain: Domain) -> &mut Vec<Actor> {
    match domain {
        Domain::Vehicle => &mut world.vehicles,
        Domain::Person => &mut world.pedestrians,
    }
}

fn forget(world: &mut WorldState) {
    world.vehicles.clear();
    world.pedestrians.clear();
}

fn order(world: &mut WorldState) {
    world.vehicles.sort_unstable_by(|a, b| a.id.cmp(&b.id));
    world.pedestrians.sort_unstable_by(|a, b| a.id.cmp(&b.id));
}

/// The actors that the subscriptions of ego `id` brought with a step, without the vehicle `but`.
fn read<'a>(
    replies: &'a sumo_traci::Replies,
    id: &str,
    but: Option<&str>,
) -> Result<Vec<Observed<'a>>, sumo_traci::Error> {
    let mut actors = Vec::new();
    let results = replies.subscriptions();
    for object in results.context(vehicle::Vehicle, id, vehicle::Vehicle).filter(|o| but != Some(o.id())) {
        let position = object.value(vehicle::POSITION_3D)?;
        actors.push(Observed {
            domain: Domain::Vehicle,
            id: object.id(),
            position: Point3::new(position.x, position.y, position.z),
            degrees: object.value(vehicle::ANGLE)?,
            signals: object.value(vehicle::SIGNALS)? as u32,
            lane: object.str(vehicle::LANE_ID)?,
        });
    }
    for object in results.context(vehicle::Vehicle, id, person::Person) {
        let position = object.value(person::POSITION_3D)?;
        actors.push(Observed {
            domain: Domain::Person,
            id: object.id(),
            position: Point3::new(position.x, position.y, position.z),
            degrees: object.value(person::ANGLE)?,
            signals: 0,
            lane: object.str(person::LANE_ID)?,
        });
    }
    // Not in the network yet, or not any more: SUMO's "no value".
    actors.retain(|actor| actor.position.x.is_finite() && actor.position.x > -1e9);
    Ok(actors)
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
    fn who_is_put_elsewhere_was_not_that_fast() {
        let tick = 0.167;
        // As before: driving, standing, beginning to walk, braking hard.
        for (moved, last) in [(2.3, 13.9), (0.0, 0.0), (0.25, 0.0), (0.5, 13.9)] {
            assert_eq!(speed(moved, last, tick), moved / tick);
        }
        // Round a corner at once, and on at a walk.
        let jumped = speed(13.3, 0.6, tick);
        assert!(jumped < 2.5, "{jumped}");
        assert!((speed(0.23, jumped, tick) - 0.23 / tick).abs() < 1e-9);
    }

    #[test]
    fn class_wins_over_shape() {
        assert_eq!(kind_of("passenger", "passenger/sedan"), ActorKind::Car);
        assert_eq!(kind_of("passenger", "delivery"), ActorKind::Van);
        assert_eq!(kind_of("delivery", "passenger"), ActorKind::Van);
        assert_eq!(kind_of("bus", ""), ActorKind::Bus);
    }
}
