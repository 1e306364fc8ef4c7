//! The background vehicles: where they start, when they are checked, and when they are replaced.

use super::Options;
use super::draw::between;
use super::events::StepEvents;
use super::fleet::{FLEET, Model, draw_colour, draw_model};
use super::places::{Occupancy, Place, distance, point_on, start_speed};
use super::reserve::Reserve;
use super::roads::Roads;
use super::slots::{Member, Slots};
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;
use sumo_network::geometry::{Point, Pose};
use sumo_network::network::{EdgeId, LaneId, Network, VehicleClass};
use sumo_traci::{Batch, Color, Position2D, RemoveReason, Replies, Ticket, route, vehicle};

/// With less than this left (m) a trip is extended, or the vehicle replaced.
const TRIP_END: f64 = 250.0;
/// Every vehicle is checked at least this often (s), to find stuck vehicles.
const LOOK_EVERY: f64 = 30.0;
/// Highest speed (m/s) at which a vehicle comes to the end of its trip.
const FASTEST: f64 = 30.0;
/// A vehicle this much beyond the sight distance (m) may come into sight before the next check.
const SIGHT_MARGIN: f64 = 40.0;
/// Edges drawn per tick to query.
const SCANS: usize = 6;
/// Random places tried for a replacement.
const DRAWS: usize = 64;

/// A vehicle's trip.
#[derive(Debug)]
struct Trip {
    model: usize,
    /// The whole trip since departure; SUMO's route index counts in it.
    edges: Vec<EdgeId>,
}

/// Getters in flight about one vehicle.
#[derive(Debug)]
struct Look {
    slot: usize,
    serial: u64,
    route_index: Ticket<i32>,
    road: Ticket<String>,
    lane_position: Ticket<f64>,
    waiting: Ticket<f64>,
    position: Ticket<Position2D>,
}

/// A longer route in flight: should SUMO refuse it, the trip is still the old one.
#[derive(Debug)]
struct Extension {
    slot: usize,
    serial: u64,
    before: usize,
    ticket: Ticket<()>,
}

/// The egos and the road users near them in this tick.
#[derive(Clone, Copy)]
pub(super) struct Scene<'a> {
    /// s of simulation time.
    pub time: f64,
    pub egos: &'a [Pose],
    pub near: &'a [Point],
}

#[derive(Debug)]
pub(super) struct Vehicles {
    network: Arc<Network>,
    options: Options,
    rng: ChaCha8Rng,
    /// One per class that the fleet has; indexed by `model_roads`.
    roads: Vec<Roads>,
    /// By model: the roads of its class, None where the net has none.
    model_roads: Vec<Option<usize>>,
    slots: Slots<Trip>,
    looks: Vec<Look>,
    extensions: Vec<Extension>,
    reserve: Reserve,
    /// By edge: whether its one-edge route was defined.
    routes: Vec<bool>,
}

impl Vehicles {
    pub fn new(network: Arc<Network>, options: Options, rng: ChaCha8Rng) -> Self {
        let mut roads: Vec<Roads> = Vec::new();
        let mut classes: Vec<(VehicleClass, Option<usize>)> = Vec::new();
        let mut model_roads = Vec::new();
        for model in FLEET {
            let known = classes.iter().find(|c| c.0 == model.class).copied();
            let (_, index) = known.unwrap_or_else(|| {
                let of_class = Roads::new(&network, model.class);
                let index = (!of_class.starts.is_empty()).then_some(roads.len());
                if index.is_some() {
                    roads.push(of_class);
                }
                classes.push((model.class, index));
                (model.class, index)
            });
            model_roads.push(index);
        }
        let edges = network.edges.len();
        Self {
            network,
            options,
            rng,
            roads,
            model_roads,
            slots: Slots::default(),
            looks: Vec::new(),
            extensions: Vec::new(),
            reserve: Reserve::new(edges),
            routes: vec![false; edges],
        }
    }

    /// How many were in the network after the last step.
    pub fn alive(&self) -> usize {
        self.slots.alive()
    }

    pub fn owns(&self, id: &str) -> bool {
        self.slots.find(id).is_some()
    }

    /// Puts `count` vehicles on the roads; returns how many found a place.
    pub fn populate(&mut self, count: usize, egos: &[Pose], batch: &mut Batch) -> usize {
        let network = Arc::clone(&self.network);
        let mut occupancy = Occupancy::new(&network);
        let avoid = self.options.avoid;
        let allowed = |point| avoid.allows_at_start(egos, point);
        let mut placed: Vec<(usize, LaneId, f64)> = Vec::new();
        for _ in 0..count {
            let Some(model) = self.draw_model() else { break };
            // Where no bus fits any more, the smallest car may.
            let found = [model, 0].into_iter().find_map(|model| {
                let roads = &self.roads[self.model_roads[model]?];
                let length = FLEET[model].length;
                let (start, front) = occupancy.take(&mut self.rng, &network, roads, length, allowed)?;
                Some((model, start.lane, front))
            });
            let Some(found) = found else { break };
            placed.push(found);
        }
        for &(model, lane, front) in &placed {
            let slot = self.slots.add();
            let place = occupancy.place(&network, lane, front);
            self.insert(slot, model, place, batch);
            // Spread the first looks, so that later ones are spread too.
            let first = between(&mut self.rng, 1.0, LOOK_EVERY);
            if let Some(serial) = self.slots.get(slot).map(|member| member.serial) {
                self.slots.schedule.at(first, slot, serial);
            }
        }
        placed.len()
    }

    /// Keeps `count` vehicles from now on: the last ones go, or new ones come with the next updates.
    pub fn resize(&mut self, count: usize, batch: &mut Batch) {
        self.slots.resize(count, |id| remove(id, batch));
    }

    /// How many that were in the network were taken out since the last call.
    pub fn taken_out(&mut self) -> usize {
        std::mem::take(&mut self.slots.taken_out)
    }

    /// Takes a vehicle out, to come back elsewhere.
    pub fn evict(&mut self, id: &str, batch: &mut Batch) {
        if let Some(slot) = self.slots.find(id) {
            self.slots.evict(slot, |id| remove(id, batch));
        }
    }

    /// Follows one step: see [`super::Population::update`].
    pub fn update(
        &mut self,
        events: &StepEvents<'_>,
        replies: &Replies,
        scene: Scene<'_>,
        batch: &mut Batch,
    ) {
        self.slots.follow(&events.departed, &events.arrived, |member| {
            // SUMO found no room for it: try elsewhere.
            let (id, time) = (&member.id, scene.time);
            tracing::debug!(id, time, "no room for a background vehicle: trying elsewhere");
            remove(id, batch);
        });
        self.read_extensions(replies, scene.time);
        self.read_looks(replies, scene, batch);
        self.reserve.read(replies, scene.time);
        for slot in std::mem::take(&mut self.slots.vacant) {
            if !self.replace(slot, scene, batch) {
                self.slots.vacant.push(slot);
            }
        }
        while let Some((slot, serial)) = self.slots.schedule.due(scene.time) {
            self.look(slot, serial, batch);
        }
        if !self.slots.is_empty() {
            self.scan(scene, batch);
        }
    }

    fn draw_model(&mut self) -> Option<usize> {
        let possible = &self.model_roads;
        draw_model(&mut self.rng, |i| possible[i].is_some())
    }

    /// Adds a vehicle of `model` at `place` with a trip of its own.
    fn insert(&mut self, slot: usize, model: usize, place: Place, batch: &mut Batch) {
        let Some(roads) = self.model_roads[model] else { return };
        let network = &self.network;
        let lane = network.lane(place.lane);
        let (shortest, longest) = self.options.trip_length;
        let wanted = between(&mut self.rng, shortest, longest).max(2.0 * TRIP_END);
        let edges = self.roads[roads].trip(&mut self.rng, lane.edge, place.lane, wanted);
        self.slots.fill(slot, "wad_v", Trip { model, edges });
        let Some(Member { id, about: Trip { edges, .. }, .. }) = self.slots.get(slot) else { return };
        let spec: &Model = &FLEET[model];

        let edge_id = network.edge(lane.edge).id.as_str();
        let route_id = format!("wad_{edge_id}");
        if !std::mem::replace(&mut self.routes[lane.edge.index()], true) {
            route::add(batch, &route_id, &[edge_id]);
        }
        let factor = spec.speed_factor.draw(&mut self.rng);
        // A cyclist's wanted speed is below most limits, and varies by the same factor.
        let limit = (lane.speed_limit.min(spec.class.max_speed()) * factor).min(spec.max_speed);
        let speed = start_speed(limit, place.free, spec.min_gap, spec.decel);
        let add = vehicle::Add {
            route: &route_id,
            vehicle_type: spec.id,
            depart_lane: &lane.index.to_string(),
            // Rounded down: never beyond the place.
            depart_pos: &format!("{:.2}", (place.front * 100.0).floor() / 100.0),
            depart_speed: &format!("{speed:.2}"),
            ..vehicle::Add::default()
        };
        vehicle::add(batch, id, &add);
        let names: Vec<&str> = edges.iter().map(|&e| network.edge(e).id.as_str()).collect();
        vehicle::set_route(batch, id, &names);
        batch.set(vehicle::SET_SPEED_FACTOR, id, factor);
        let [r, g, b] = draw_colour(&mut self.rng, spec);
        batch.set(vehicle::SET_COLOR, id, Color::rgb(r, g, b));
    }

    /// Fills a slot out of the ego's sight; false where no place was found.
    fn replace(&mut self, slot: usize, scene: Scene<'_>, batch: &mut Batch) -> bool {
        let Some(model) = self.draw_model() else { return false };
        let reserved = self.find_reserved(model, scene);
        let Some(place) = reserved.or_else(|| self.find_any(model, scene)) else { return false };
        self.reserve.used(self.network.lane(place.lane).edge, scene.time);
        self.insert(slot, model, place, batch);
        if let Some(serial) = self.slots.get(slot).map(|member| member.serial) {
            self.slots.schedule.at(scene.time + 5.0, slot, serial);
        }
        true
    }

    /// A place out of sight on an edge just seen empty: SUMO takes a vehicle there at once.
    fn find_reserved(&mut self, model: usize, scene: Scene<'_>) -> Option<Place> {
        let network = &self.network;
        let avoid = self.options.avoid;
        let roads = &self.roads[self.model_roads[model]?];
        let spec = &FLEET[model];
        // First on edges that no vehicle can have entered since; then at the far end of the others.
        let fresh = self.reserve.fresh(scene.time);
        for (edge, seen, far_end) in
            fresh.iter().map(|f| (f.0, f.1, false)).chain(fresh.iter().map(|f| (f.0, f.1, true)))
        {
            let lanes = roads.starts.iter().filter(|s| s.edge == edge);
            let Some(start) = lanes.max_by_key(|s| s.lane) else { continue };
            let limit = network.lane(start.lane).speed_limit * 1.2;
            // Room for vehicles that entered since the edge was checked, plus SUMO's gap of one second.
            let from = spec.length + limit * (scene.time - seen + 0.4) + limit + 3.0;
            if (from > start.last && !far_end) || start.last < spec.length {
                continue;
            }
            let from = from.min(start.last);
            let front = between(&mut self.rng, from, (start.last - 35.0).max(from));
            let point = point_on(network, start.lane, front);
            let rear = point_on(network, start.lane, front - spec.length);
            let hidden = [point, rear].iter().all(|&p| !avoid.in_sight(scene.egos, p));
            if hidden && avoid.clear_of(scene.near, point) {
                return Some(Place {
                    lane: start.lane,
                    front,
                    free: network.lane(start.lane).length - front,
                });
            }
        }
        None
    }

    /// A random place out of sight, or as far from the ego as the town has one. SUMO may find it
    /// taken.
    fn find_any(&mut self, model: usize, scene: Scene<'_>) -> Option<Place> {
        let network = &self.network;
        let avoid = self.options.avoid;
        let roads = &self.roads[self.model_roads[model]?];
        let length = FLEET[model].length;
        let mut furthest: Option<(f64, Place)> = None;
        for _ in 0..DRAWS {
            let (start, front) = roads.draw_start(&mut self.rng, length)?;
            if front < length || self.reserve.is_used(start.edge, scene.time) {
                continue;
            }
            let point = point_on(network, start.lane, front);
            let place = Place { lane: start.lane, front, free: network.lane(start.lane).length - front };
            if !avoid.clear_of(scene.near, point) {
                continue;
            }
            let distance = distance(scene.egos, point);
            if distance >= avoid.sight + length {
                return Some(place);
            }
            if furthest.as_ref().is_none_or(|(best, _)| distance > *best) && distance >= avoid.start {
                furthest = Some((distance, place));
            }
        }
        furthest.map(|(_, place)| place)
    }

    /// Asks about a vehicle.
    fn look(&mut self, slot: usize, serial: u64, batch: &mut Batch) {
        let Some(member) = self.slots.with_serial(slot, serial).filter(|member| member.departed) else {
            return;
        };
        let id = &member.id;
        self.looks.push(Look {
            slot,
            serial,
            route_index: batch.get(vehicle::ROUTE_INDEX, id),
            road: batch.get(vehicle::ROAD_ID, id),
            lane_position: batch.get(vehicle::LANE_POSITION, id),
            waiting: batch.get(vehicle::WAITING_TIME, id),
            position: batch.get(vehicle::POSITION, id),
        });
    }

    fn read_looks(&mut self, replies: &Replies, scene: Scene<'_>, batch: &mut Batch) {
        for look in std::mem::take(&mut self.looks) {
            let &Look { slot, serial, .. } = &look;
            if self.slots.with_serial(slot, serial).is_none() {
                continue;
            }
            let next = match self.judge(&look, replies, scene) {
                Verdict::LookAgain(after) => after,
                Verdict::Extend(index) => {
                    self.extend(slot, index, batch);
                    5.0
                }
                Verdict::Replace => {
                    self.slots.evict(slot, |id| remove(id, batch));
                    continue;
                }
            };
            self.slots.schedule.at(scene.time + next, slot, serial);
        }
    }

    fn judge(&self, look: &Look, replies: &Replies, scene: Scene<'_>) -> Verdict {
        let Some(member) = self.slots.get(look.slot) else { return Verdict::LookAgain(1.0) };
        let Trip { model, edges } = &member.about;
        let (Ok(index), Ok(road), Ok(lane_position), Ok(waiting), Ok(position)) = (
            replies.get(look.route_index),
            replies.get_ref(look.road),
            replies.get(look.lane_position),
            replies.get(look.waiting),
            replies.get(look.position),
        ) else {
            return Verdict::LookAgain(1.0);
        };
        let here = Point::new(position.x, position.y);
        let avoid = self.options.avoid;
        let near_ego = distance(scene.egos, here) < avoid.sight + SIGHT_MARGIN;
        if waiting > self.options.stuck_after && !near_ego {
            tracing::info!(id = member.id, waiting, "stuck background vehicle is replaced");
            return Verdict::Replace;
        }
        let Some(roads) = self.model_roads[*model].map(|i| &self.roads[i]) else {
            return Verdict::LookAgain(LOOK_EVERY);
        };
        let index = usize::try_from(index).unwrap_or(0);
        let ahead = edges.get(index + 1..).unwrap_or(&[]);
        let left: f64 = ahead.iter().map(|&e| roads.length(e)).sum();
        if left > TRIP_END {
            let fastest = FLEET[*model].max_speed.min(FASTEST);
            return Verdict::LookAgain(((left - TRIP_END) / fastest).clamp(1.0, LOOK_EVERY));
        }
        let ends_in_sight = edges.last().is_some_and(|&edge| {
            let end = network_end(&self.network, edge);
            distance(scene.egos, end) < avoid.sight + SIGHT_MARGIN
        });
        if !near_ego && !ends_in_sight {
            return Verdict::Replace;
        }
        let Some(&current) = edges.get(index) else { return Verdict::LookAgain(1.0) };
        // SUMO requires the new route to begin on the vehicle's edge at the time of the command.
        let leaves = !ahead.is_empty() && lane_position + 0.5 * FASTEST > roads.length(current);
        if road != self.network.edge(current).id || (leaves && waiting <= 0.0) {
            return Verdict::LookAgain(0.5);
        }
        Verdict::Extend(index)
    }

    /// Appends random destinations to a vehicle's trip; it is now on its edge number `index`.
    fn extend(&mut self, slot: usize, index: usize, batch: &mut Batch) {
        let Some(Member { id, serial, about, .. }) = self.slots.get_mut(slot) else { return };
        let Some(roads) = self.model_roads[about.model] else { return };
        let before = about.edges.len();
        let (shortest, longest) = self.options.trip_length;
        let wanted = between(&mut self.rng, shortest, longest).max(2.0 * TRIP_END);
        self.roads[roads].extend(&mut self.rng, &mut about.edges, wanted);
        if about.edges.len() == before {
            return;
        }
        let names: Vec<&str> =
            about.edges[index..].iter().map(|&e| self.network.edge(e).id.as_str()).collect();
        let ticket = vehicle::set_route(batch, id, &names);
        self.extensions.push(Extension { slot, serial: *serial, before, ticket });
    }

    fn read_extensions(&mut self, replies: &Replies, time: f64) {
        for extension in std::mem::take(&mut self.extensions) {
            let Err(error) = replies.get(extension.ticket) else { continue };
            let member = self.slots.get_mut(extension.slot).filter(|m| m.serial == extension.serial);
            if let Some(member) = member {
                tracing::debug!(%error, "longer trip refused");
                member.about.edges.truncate(extension.before);
                self.slots.schedule.at(time + 0.5, extension.slot, extension.serial);
            }
        }
    }

    /// Asks about a few edges, so that there is a place when one is needed.
    fn scan(&mut self, scene: Scene<'_>, batch: &mut Batch) {
        let Some(roads) = self.model_roads.iter().flatten().next().map(|&i| &self.roads[i]) else { return };
        for _ in 0..SCANS {
            if !self.reserve.wants_more() {
                break;
            }
            // Weighted by length: on a short edge there is no room ahead of vehicles that enter it.
            let Some((start, _)) = roads.draw_start(&mut self.rng, 0.0) else { return };
            let middle = point_on(&self.network, start.lane, 0.5 * start.last);
            if !self.options.avoid.in_sight(scene.egos, middle)
                && !self.reserve.is_used(start.edge, scene.time)
            {
                self.reserve.ask(&self.network, start.edge, scene.time, batch);
            }
        }
    }
}

fn remove(id: &str, batch: &mut Batch) {
    vehicle::remove(batch, id, RemoveReason::Vaporized);
}

/// What to do with a vehicle that was checked.
enum Verdict {
    /// Nothing yet: check again after this time (s).
    LookAgain(f64),
    /// A longer trip, from the edge with this number in its trip.
    Extend(usize),
    /// Out with it, and another one in.
    Replace,
}

/// Where an edge ends.
fn network_end(network: &Network, edge: EdgeId) -> Point {
    let lane = network.edge(edge).lanes.first();
    lane.map_or(Point::origin(), |&lane| point_on(network, lane, network.lane(lane).length))
}
