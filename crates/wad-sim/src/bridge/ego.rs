//! The ego vehicle: its physics, its route, what it sees, and its shadow in SUMO.

use crate::criteria::EgoOnRoute;
use std::collections::HashSet;
use sumo_network::geometry::{Point, Pose, Vector};
use sumo_network::network::{EdgeKind, LaneId, Network, Route};
use sumo_network::world::{Actor, ActorKind, VehicleSignals, WorldState};
use sumo_traci::{Batch, Color, CommandError, Replies, Ticket, route, vehicle, vehicle_type};
use wad_vehicle::{Contact, Control, EgoParams, EgoState, EgoVehicle, MovingBody, PartnerKind};

/// Blinkers and brake light that others see.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Lamps {
    /// Left indicator.
    pub blinker_left: bool,
    /// Right indicator.
    pub blinker_right: bool,
    /// Brake lights.
    pub brake: bool,
}

impl Lamps {
    fn to_sumo(self) -> i32 {
        let bit = |on: bool, bits: u32| if on { bits } else { 0 };
        let bits = bit(self.blinker_left, VehicleSignals::BLINKER_LEFT)
            | bit(self.blinker_right, VehicleSignals::BLINKER_RIGHT)
            | bit(self.brake, VehicleSignals::BRAKE_LIGHT);
        bits as i32
    }
}

/// An ego vehicle. Several may share one SUMO.
pub struct Ego {
    /// Its id in SUMO.
    pub id: String,
    pub(super) vehicle: EgoVehicle,
    pub(super) route: Route,
    pub(super) world: WorldState,
    /// The world before the last step.
    pub(super) previous: WorldState,
    /// Road users in its world that SUMO does not know.
    pub(super) extras: Vec<Actor>,
    /// Its centre and front bumper on the route.
    s: f64,
    d: f64,
    front_s: f64,
    lamps: Lamps,
    /// The route has changed since it was last sent to SUMO.
    route_is_news: bool,
    /// It was moved to a place that its route in SUMO does not lead to.
    is_elsewhere: bool,
    /// It has left the road: SUMO is told its place, and no route.
    is_away: bool,
    /// Reports in a row in which SUMO refused the route.
    refusals: u32,
    /// How many of the route's edges SUMO knows.
    told_edges: usize,
    /// Names of the stretches that SUMO has: it forgets none.
    known_routes: HashSet<String>,
}

/// Claims to SUMO's answers to a report.
#[derive(Clone, Copy, Debug)]
pub(super) struct Reported {
    route: Option<Ticket<()>>,
    pose: Ticket<()>,
}

/// Edges of the route that one message sends to SUMO, and how many ahead of the ego SUMO always knows.
const TOLD_EDGES: usize = 5;
const KEPT_EDGES: usize = 3;

/// More refusals of a route in a row than a junction's border explains.
const REFUSALS: u32 = 3;

/// Added to the keys of barriers and cones, which physics takes for fixed bodies.
const OBJECT_KEYS: u64 = 1 << 40;

/// Route projection window behind and, at least, ahead of the last place (m).
const BACK: f64 = 10.0;
const AHEAD: f64 = 30.0;

impl Ego {
    /// An ego at `start` (m) on `route`, standing.
    pub fn new(id: &str, params: EgoParams, route: Route, start: f64) -> Self {
        let pose = route.at(start).pose;
        let flat = Pose::new(pose.position.x, pose.position.y, 0.0, pose.heading);
        let front_s = start + 0.5 * params.length;
        let mut ego = Self {
            id: id.to_string(),
            vehicle: EgoVehicle::new(params, flat, 0.0),
            route,
            world: WorldState::default(),
            previous: WorldState::default(),
            extras: Vec::new(),
            s: start,
            d: 0.0,
            front_s,
            lamps: Lamps::default(),
            route_is_news: true,
            is_elsewhere: false,
            is_away: false,
            refusals: 0,
            told_edges: 0,
            known_routes: HashSet::new(),
        };
        ego.locate(AHEAD);
        ego
    }

    /// Places it elsewhere, standing, on another route.
    pub fn respawn(&mut self, route: Route, start: f64) {
        self.respawn_beside(route, start, 0.0, 0.0);
    }

    /// The same, `left` (m) of the route's line and turned by `turn` (rad, to the left).
    pub fn respawn_beside(&mut self, route: Route, start: f64, left: f64, turn: f64) {
        let pose = route.at(start).pose;
        let place = pose.to_world(Vector::new(0.0, left));
        self.vehicle.respawn(Pose::new(place.x, place.y, 0.0, pose.heading + turn), 0.0);
        self.set_route(route, start);
        (self.is_elsewhere, self.is_away) = (true, false);
    }

    /// Takes it off the road, standing at `place` beyond the net, until it is respawned. SUMO keeps vehicles far from all roads
    /// without lane, and nobody sees them.
    pub fn leave(&mut self, place: Point) {
        self.vehicle.respawn(Pose::new(place.x, place.y, 0.0, 0.0), 0.0);
        self.lamps = Lamps::default();
        (self.is_elsewhere, self.is_away) = (false, true);
    }

    /// Whether it has left the road.
    pub fn is_away(&self) -> bool {
        self.is_away
    }

    /// Forgets everything but its parameters, for another SUMO. Call respawn afterwards.
    pub fn forget(&mut self) {
        (self.world, self.previous) = Default::default();
        self.extras.clear();
        self.lamps = Lamps::default();
        (self.refusals, self.told_edges) = (0, 0);
        self.known_routes.clear();
    }

    /// Adds road users to its world from the next step on that SUMO does not know: SUMO has no persons
    /// who stand in a lane.
    pub fn set_extras(&mut self, extras: Vec<Actor>) {
        self.extras = extras;
    }

    /// Gives it another route, on which it is at `s` (m).
    pub fn set_route(&mut self, route: Route, s: f64) {
        self.route = route;
        self.s = s;
        self.route_is_news = true;
        self.locate(AHEAD);
    }

    /// Its route.
    pub fn route(&self) -> &Route {
        &self.route
    }

    /// The world in its sight after the last tick.
    pub fn world(&self) -> &WorldState {
        &self.world
    }

    /// The world in its sight before the last tick, on which its last control is based.
    pub fn previous_world(&self) -> &WorldState {
        &self.previous
    }

    /// The physics behind it.
    pub fn vehicle(&self) -> &EgoVehicle {
        &self.vehicle
    }

    /// Label of the fixed body with that key, see [`crate::criteria::Situation`].
    pub fn static_label(&self, key: u64) -> String {
        let body = usize::try_from(key).ok().and_then(|index| self.vehicle.statics().get(index));
        match body {
            Some(body) => body.label.clone(),
            None if key >= OBJECT_KEYS => "barrier or cone".to_string(),
            None => key.to_string(),
        }
    }

    /// Its parameters.
    pub fn params(&self) -> &EgoParams {
        self.vehicle.params()
    }

    /// The physics behind it.
    pub fn vehicle_mut(&mut self) -> &mut EgoVehicle {
        &mut self.vehicle
    }

    /// Its motion; the pose's height is the road's.
    pub fn state(&self) -> EgoState {
        self.vehicle.state()
    }

    /// How others see it, with lamps.
    pub fn as_actor(&self) -> Actor {
        crate::replay::Body::of(self.params()).actor(&self.state())
    }

    /// Its motion and its place on the route.
    pub fn on_route(&self) -> EgoOnRoute {
        EgoOnRoute { state: self.state(), s: self.s, d: self.d, front_s: self.front_s }
    }

    /// Sets the lamps that others see from the next tick on.
    pub fn set_lamps(&mut self, lamps: Lamps) {
        self.lamps = lamps;
    }

    /// Physics of one tick of `duration` (s) among the road users it sees.
    pub fn advance(&mut self, control: Control, duration: f64) -> Vec<Contact> {
        let before = (self.previous.tick + 1 == self.world.tick).then_some(&self.previous.vehicles);
        let vehicles = self.world.vehicles.iter().map(|actor| {
            let last = before.and_then(|all| Some(&all[all.binary_search_by(|a| a.id.cmp(&actor.id)).ok()?]));
            going_on(body(actor, PartnerKind::Vehicle), last, duration)
        });
        // Walkers start and stop at once: the last change does not predict the next tick.
        let pedestrians = self.world.pedestrians.iter().map(|actor| body(actor, PartnerKind::Pedestrian));
        let moving: Vec<MovingBody> = vehicles.chain(pedestrians).collect();
        let before = self.vehicle.state().speed;
        let contacts = self.vehicle.tick(control, duration, &moving);
        let fastest = before.max(self.vehicle.state().speed);
        self.locate(AHEAD.max(fastest * duration + BACK));
        contacts
    }

    /// Finds its place on the route, at most `ahead` (m) of the last one.
    fn locate(&mut self, ahead: f64) {
        let pose = self.vehicle.state().pose;
        let centre = self.route.project_near(pose.xy(), self.s, BACK, ahead);
        (self.s, self.d) = (centre.s, centre.d);
        self.vehicle.set_elevation(Some(self.route.at(self.s).pose.position.z));
        let bumper = pose.advanced(0.5 * self.params().length);
        self.front_s = self.route.project_near(bumper.xy(), self.s, 0.0, AHEAD).s;
    }

    /// The lane under its centre on its route.
    pub fn lane(&self) -> LaneId {
        self.route.at(self.s).lane
    }

    /// Appends the commands that add it to SUMO: type, route, vehicle, colour.
    pub(super) fn insert(&mut self, network: &Network, batch: &mut Batch) {
        let params = self.vehicle.params();
        let type_id = format!("{}_type", self.id);
        vehicle_type::copy(batch, "DEFAULT_VEHTYPE", &type_id);
        batch.set(vehicle_type::SET_LENGTH, &type_id, params.length);
        batch.set(vehicle_type::SET_WIDTH, &type_id, params.width);
        batch.set(vehicle_type::SET_HEIGHT, &type_id, params.height);
        batch.set(vehicle_type::SET_MAX_SPEED, &type_id, 60.0);
        // Followers keep a gap that depends on its braking: SUMO's cars brake at 4.5 m/s2, so they expect that.
        batch.set(vehicle_type::SET_APPARENT_DECEL, &type_id, params.hardest_braking());
        let route_id = self.define_route(network, batch);
        vehicle::add(
            batch,
            &self.id,
            &vehicle::Add { route: &route_id, vehicle_type: &type_id, ..vehicle::Add::default() },
        );
        batch.set(vehicle::SET_COLOR, &self.id, Color::rgb(220, 30, 30));
        // All of SUMO's checks off: we compute the motion, SUMO only receives it.
        batch.set(vehicle::SET_SPEED_MODE, &self.id, 0);
        batch.set(vehicle::SET_LANE_CHANGE_MODE, &self.id, 0);
        self.route_is_news = false;
        self.is_elsewhere = false;
    }

    /// Appends its pose and lamps, and its route where that changed, to the next step's message.
    pub(super) fn report(&mut self, network: &Network, batch: &mut Batch) -> Reported {
        // If its route does not lead to its place, SUMO keeps it off the road, invisible to traffic, and
        // refuses every route that does. So it is first put on its edge, which becomes its whole route.
        let elsewhere = std::mem::take(&mut self.is_elsewhere);
        let mut route = None;
        if !elsewhere && !self.is_away && (self.route_is_news || self.needs_more_edges()) {
            let name = self.define_route(network, batch);
            // Not SET_ROUTE: that puts the edges passed so far in front, and the cost of each tick's
            // move_to_xy grows with them.
            route = Some(batch.set(vehicle::SET_ROUTE_ID, &self.id, &name));
            self.route_is_news = false;
        }
        let (edge, lane_index, keep_route) = if elsewhere {
            let lane = network.lane(self.route.at(self.front_s).lane);
            (network.edge(lane.edge).id.as_str(), lane.index as i32, 2)
        } else {
            ("", -1, 3)
        };
        // SUMO keeps them for one step only.
        batch.set(vehicle::SET_SIGNALS, &self.id, self.lamps.to_sumo());
        let (front, angle) = self.vehicle.state().pose.to_sumo(self.params().length);
        let pose = vehicle::move_to_xy(
            batch,
            &self.id,
            &vehicle::MoveToXy {
                edge,
                lane_index,
                x: front.x,
                y: front.y,
                angle_deg: angle,
                keep_route,
                ..Default::default()
            },
        );
        Reported { route, pose }
    }

    /// What SUMO answered to a report.
    ///
    /// # Errors
    /// It does not know the ego any more.
    pub(super) fn confirm(&mut self, reported: Reported, replies: &Replies) -> Result<(), CommandError> {
        match reported.route.map(|route| replies.get(route)) {
            Some(Err(refusal)) => {
                // SUMO sees it on another edge for a tick, at a junction's border: send it again.
                tracing::debug!("{refusal}");
                self.route_is_news = true;
                self.refusals += 1;
                self.is_elsewhere = self.refusals.is_multiple_of(REFUSALS);
            }
            Some(Ok(())) => self.refusals = 0,
            None => {}
        }
        replies.get(reported.pose)
    }

    /// Whether SUMO needs more edges: the ones that it knows end within [`KEPT_EDGES`].
    fn needs_more_edges(&self) -> bool {
        let end = self.route.edges.len();
        self.told_edges < end && self.told_edges < self.route.edge_index_at(self.front_s) + KEPT_EDGES
    }

    /// Defines the next stretch of the route in SUMO, under a name that says its edges, and returns that.
    fn define_route(&mut self, network: &Network, batch: &mut Batch) -> String {
        let edges = self.sumo_edges(network);
        let name = format!("{}_route {}", self.id, edges.join(" "));
        if self.known_routes.insert(name.clone()) {
            let edges: Vec<&str> = edges.iter().map(String::as_str).collect();
            route::add(batch, &name, &edges);
        }
        name
    }

    /// The edges sent to SUMO: the next part of the route, so that others notice the ego at a
    /// junction, which they do only while its route goes on beyond it (eclipse-sumo/sumo issue 6140).
    /// Beyond the route's end one more edge is added for the same reason. No more than that: the
    /// cost of each tick's move_to_xy grows with the route.
    fn sumo_edges(&mut self, network: &Network) -> Vec<String> {
        let from = self.route.edge_index_at(self.front_s).min(self.route.edges.len().saturating_sub(1));
        self.told_edges = self.route.edges.len().min(from + TOLD_EDGES);
        let mut edges = self.route.edges[from..self.told_edges].to_vec();
        if let Some(&last) = edges.last()
            && self.told_edges == self.route.edges.len()
        {
            let beyond =
                network.edge(last).lanes.iter().flat_map(|lane| &network.lane(*lane).outgoing).find(|link| {
                    let to = network.lane(network.link(**link).to);
                    network.edge(to.edge).kind == EdgeKind::Normal
                        && to.permissions.allows(crate::destination::EGO_CLASS)
                });
            if let Some(link) = beyond {
                edges.push(network.lane(network.link(*link).to).edge);
            }
        }
        edges.into_iter().map(|edge| network.edge(edge).id.clone()).collect()
    }
}

fn body(actor: &Actor, kind: PartnerKind) -> MovingBody {
    let stands = actor.actor_type.kind == ActorKind::Object;
    MovingBody {
        // Beyond the keys of what stands by itself.
        key: if stands { actor.key + OBJECT_KEYS } else { actor.key },
        kind: if stands { PartnerKind::Static } else { kind },
        pose: actor.pose,
        speed: actor.speed,
        acceleration: 0.0,
        turn_rate: 0.0,
        length: actor.actor_type.length,
        width: actor.actor_type.width,
        height: actor.actor_type.height,
    }
}

/// What a vehicle can do at most: brake and speed up (m/s2), turn (rad/s).
const HARDEST: [f64; 3] = [9.0, 5.0, 1.5];

/// Goes on gaining or losing speed, and turning, as since the `last` tick, which was as long as this one.
///
/// An actor's speed is its mean over the last tick, so that half a tick's change is added: it then ends
/// where SUMO will have it if nothing changes, however long the tick.
fn going_on(body: MovingBody, last: Option<&Actor>, duration: f64) -> MovingBody {
    let Some(last) = last else { return body };
    let [brake, gain, turn] = HARDEST;
    let acceleration = ((body.speed - last.speed) / duration).clamp(-brake, gain);
    let speed = (body.speed + 0.5 * acceleration * duration).max(0.0);
    // From standing it speeds up, but does not begin to brake.
    let acceleration = if speed == 0.0 { acceleration.max(0.0) } else { acceleration };
    let turned = sumo_network::geometry::wrap_angle(body.pose.heading - last.pose.heading);
    let turn_rate = (turned / duration).clamp(-turn, turn);
    MovingBody { speed, acceleration, turn_rate, ..body }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;
    use std::sync::Arc;
    use sumo_network::network::{LanePosition, VehicleClass};
    use sumo_network::world::{ActorKind, ActorType};

    fn actor(x: f64, heading: f64, speed: f64) -> Actor {
        let actor_type = ActorType {
            id: "car".to_string(),
            kind: ActorKind::Car,
            length: 4.5,
            width: 1.8,
            height: 1.5,
            min_gap: 2.5,
        };
        Actor {
            id: Arc::from("a"),
            key: 1,
            actor_type: Arc::new(actor_type),
            pose: Pose::new(x, 0.0, 0.0, heading),
            speed,
            signals: VehicleSignals(0),
            lane: None,
            lane_position: 0.0,
        }
    }

    /// It was once searched 30 m ahead at most, and then taken for one that left its lane.
    #[test]
    fn an_ego_keeps_its_place_on_the_route_through_a_long_fast_tick() {
        let text = include_str!("../../../../tests/data/cross.net.xml");
        let network = Network::from_xml(Path::new("cross.net.xml"), text).unwrap();
        let at = |lane: &str, s: f64| LanePosition { lane: network.lane_by_id(lane).unwrap(), s };
        let route = network.route(at("WC_1", 5.0), at("EF_1", 100.0), VehicleClass::Passenger).unwrap();
        let start = route.at(0.0).pose;
        let mut ego = Ego::new("ego", EgoParams::default(), route, 0.0);
        ego.vehicle.respawn(start, 45.0);
        ego.advance(Control::default(), 1.0);
        let driven = (ego.state().pose.xy() - start.xy()).norm();
        let at = ego.on_route();
        assert!(driven > 35.0 && (at.s - driven).abs() < 0.5 && at.d.abs() < 0.5, "{driven}: {at:?}");
    }

    /// A car that SUMO brakes (its speed changes at each tick's begin), followed tick by tick.
    #[test]
    fn a_braking_car_is_where_sumo_puts_it_at_the_end_of_a_long_tick() {
        for tick in [0.167, 0.5, 1.0] {
            let (mut x, mut speed) = (0.0, 13.9);
            let mut last = actor(x, 0.0, speed);
            for step in 0..20 {
                speed = (speed - 3.0 * tick).max(0.0_f64);
                x += speed * tick;
                let now = actor(x, 0.0, speed);
                let moving = going_on(body(&now, PartnerKind::Vehicle), Some(&last), tick);
                let next = x + (speed - 3.0 * tick).max(0.0) * tick;
                let end = moving.at(tick).position.x;
                // At a constant speed it would be 3 m/s2 x tick2 too far: 3 m at 1 s.
                let slack = if speed < 6.0 * tick { 1.5 * tick * tick } else { 1e-6 };
                assert!((end - next).abs() <= slack + 1e-6, "{tick} s, step {step}: {end} for {next}");
                let mut before = x;
                for k in 1..=60 {
                    let at = moving.at(tick * f64::from(k) / 60.0).position.x;
                    let most = (moving.speed + 1e-9) * tick / 60.0;
                    assert!(at >= before && at - before <= most + 1e-9, "it moves smoothly, never backward");
                    before = at;
                }
                last = now;
            }
        }
    }

    #[test]
    fn a_turning_car_keeps_turning_through_a_long_tick() {
        let last = actor(0.0, 0.0, 5.0);
        let moving = going_on(body(&actor(5.0, 0.3, 5.0), PartnerKind::Vehicle), Some(&last), 1.0);
        let end = moving.at(1.0);
        assert!((end.heading - 0.6).abs() < 1e-9);
        // On an arc: as long as the way, ahead by the middle heading.
        let way = end.xy() - moving.pose.xy();
        assert!((way.y.atan2(way.x) - 0.45).abs() < 1e-9 && (4.9..5.0).contains(&way.norm()), "{way:?}");
    }

    #[test]
    fn who_is_seen_first_goes_on_at_its_speed() {
        let moving = going_on(body(&actor(0.0, 0.0, 8.0), PartnerKind::Vehicle), None, 1.0);
        assert!((moving.at(1.0).position.x - 8.0).abs() < 1e-9);
    }
}
