//! Facts about the ego's driving, tick by tick: collisions, red lights, leaving the lane,
//! blocking, arrival (spec.md "Events"). [`crate::end`] decides what ends an episode.

mod cause;
mod surface;

pub use cause::Cause;

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use sumo_network::geometry::Vector;
use sumo_network::network::{Network, Route};
use sumo_network::signal_ahead::SignalAhead;
use sumo_network::world::WorldState;
use wad_vehicle::{Contact, EgoState, PartnerKind};

/// Thresholds of the events.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct CriteriaParams {
    /// Contacts with vehicles and fixed things below this impulse (N s) do not count as collisions. A
    /// pedestrian who is touched always does. Default 200.
    pub collision_impulse: f64,
    /// The same partner collides again only after this long apart (s). Default 1.
    pub collision_separation: f64,
    /// Largest distance of the ego's centre from the centre of its lane or lane-change corridor (m). Default 1.75.
    pub outside_lane: f64,
    /// Standing this long for no reason is blocking (s). Default 90.
    pub blocked_after: f64,
    /// Below this speed the ego stands (m/s). Default 0.1.
    pub blocked_speed: f64,
    /// This close to its destination the ego has arrived (m). Default 5.
    pub arrival_distance: f64,
}

impl Default for CriteriaParams {
    fn default() -> Self {
        Self {
            collision_impulse: 200.0,
            collision_separation: 1.0,
            outside_lane: 1.75,
            blocked_after: 90.0,
            blocked_speed: 0.1,
            arrival_distance: 5.0,
        }
    }
}

/// Something that happened during a tick.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum Event {
    /// The ego touched a pedestrian, or a vehicle or static body by at least
    /// [`CriteriaParams::collision_impulse`].
    Collision {
        /// Vehicle, pedestrian or static body.
        kind: PartnerKind,
        /// SUMO's id, or the static body's label.
        partner: String,
        /// N s.
        impulse: f64,
        /// Which side caused it.
        cause: Cause,
        /// Where on the ego (m): x forward, y left of its centre.
        point: Vector,
        /// Ego's longitudinal speed before the contact (m/s).
        ego_speed: f64,
        /// The partner's speed (m/s).
        partner_speed: f64,
        /// Why the cause is what it is.
        reason: String,
    },
    /// The front bumper passed a stop line at red.
    RedLight {
        /// SUMO's id of the traffic light.
        traffic_light: String,
        /// m/s.
        speed: f64,
    },
    /// The ego's centre is further from its lane than [`CriteriaParams::outside_lane`].
    OutsideLane {
        /// Lateral distance from the corridor (m).
        offset: f64,
    },
    /// A wheel left the road surface.
    Sidewalk,
    /// The ego stood for [`CriteriaParams::blocked_after`] without a reason.
    VehicleBlocked,
    /// The ego reached its destination.
    Arrival,
}

/// The ego on its route.
#[derive(Clone, Copy, Debug)]
pub struct EgoOnRoute {
    /// Its motion.
    pub state: EgoState,
    /// Route coordinate of its centre along the route (m).
    pub s: f64,
    /// Offset of its centre to the left of the route (m).
    pub d: f64,
    /// Route coordinate of its front bumper (m).
    pub front_s: f64,
}

/// Everything that one check looks at.
pub struct Situation<'a> {
    /// The town's road network.
    pub network: &'a Network,
    /// The ego's route.
    pub route: &'a Route,
    /// The world that the ego saw when it chose its control.
    pub world: &'a WorldState,
    /// The ego at the tick's begin.
    pub before: EgoOnRoute,
    /// The ego at the tick's end.
    pub after: EgoOnRoute,
    /// What the ego touched during the tick.
    pub contacts: &'a [Contact],
    /// Label of a static body by its key.
    pub static_label: &'a dyn Fn(u64) -> String,
    /// The ego's length (m).
    pub length: f64,
    /// The ego's width (m).
    pub width: f64,
    /// Distance of the ego's axles (m).
    pub wheelbase: f64,
    /// Distance of the wheels of one axle (m).
    pub track: f64,
    /// Duration of the tick (s).
    pub tick: f64,
}

/// Finds the events of each tick. An event comes when it begins, but the arrival in every tick at the destination.
#[derive(Clone, Debug, Default)]
pub struct Criteria {
    params: CriteriaParams,
    /// Simulation time (s) since the criteria began.
    clock: f64,
    /// Last time of contact by partner.
    in_contact: BTreeMap<(u8, u64), f64>,
    outside: bool,
    sidewalk: bool,
    standing: f64,
    /// Links whose stop line was passed on the current route, so that rolling back and forth counts once.
    last_red_stop: Option<f64>,
    /// Where the destination lies on the route (m), if the route leads on behind it.
    destination: Option<f64>,
}

impl Criteria {
    /// Criteria with the given thresholds.
    pub fn new(params: CriteriaParams) -> Self {
        Self { params, ..Self::default() }
    }

    /// The thresholds.
    pub fn params(&self) -> &CriteriaParams {
        &self.params
    }

    /// Forgets what belongs to the old route; call when the route changes.
    pub fn route_changed(&mut self) {
        (self.last_red_stop, self.destination) = (None, None);
    }

    /// The route now leads on behind the destination, which lies at `s` (m).
    pub fn route_leads_on(&mut self, s: f64) {
        self.destination = Some(s);
    }

    /// Where the destination lies on the route (m), if the route leads on behind it; else it is the route's end.
    pub fn destination(&self) -> Option<f64> {
        self.destination
    }

    /// Whether the ego is outside its lane now. The event itself comes once, when it leaves the lane.
    pub fn is_outside_lane(&self) -> bool {
        self.outside
    }

    /// The events of one tick.
    pub fn check(&mut self, now: &Situation<'_>) -> Vec<Event> {
        self.clock += now.tick;
        let mut events = Vec::new();
        self.collisions(now, &mut events);
        self.red_light(now, &mut events);
        self.lane(now, &mut events);
        self.blocked(now, &mut events);
        let left = self.destination.unwrap_or(now.route.length()) - now.after.s;
        if left <= self.params.arrival_distance {
            events.push(Event::Arrival);
        }
        events
    }

    fn collisions(&mut self, now: &Situation<'_>, events: &mut Vec<Event>) {
        for contact in now.contacts {
            let partner = (contact.kind as u8, contact.key);
            let apart = self.in_contact.get(&partner).map(|last| self.clock - last);
            let fresh = apart.is_none_or(|apart| apart > self.params.collision_separation + now.tick);
            let least = match contact.kind {
                PartnerKind::Pedestrian => 0.0,
                _ => self.params.collision_impulse,
            };
            if contact.impulse > least {
                if fresh {
                    events.push(cause::collision(now, contact, self.params.outside_lane));
                }
                self.in_contact.insert(partner, self.clock);
            } else if let Some(last) = self.in_contact.get_mut(&partner) {
                *last = self.clock;
            }
        }
        let (clock, separation) = (self.clock, self.params.collision_separation);
        self.in_contact.retain(|_, last| clock - *last <= separation + 1.0);
    }

    fn red_light(&mut self, now: &Situation<'_>, events: &mut Vec<Event>) {
        let links = &now.route.links;
        let next = links.partition_point(|link| link.stop_s < now.before.front_s);
        for link in links[next..].iter().take_while(|link| link.stop_s <= now.after.front_s) {
            let Some(signal) = now.network.link(link.link).signal else { continue };
            let red = now.world.signal(signal).is_some_and(|state| state.is_red());
            if red && self.last_red_stop != Some(link.stop_s) {
                self.last_red_stop = Some(link.stop_s);
                events.push(Event::RedLight {
                    traffic_light: now.network.traffic_light(signal.traffic_light).id.clone(),
                    speed: now.after.state.speed,
                });
            }
        }
    }

    fn lane(&mut self, now: &Situation<'_>, events: &mut Vec<Event>) {
        let offset = now.route.corridor_offset(now.after.s, now.after.d);
        let outside = offset > self.params.outside_lane;
        if outside && !self.outside {
            events.push(Event::OutsideLane { offset });
        }
        self.outside = outside;
        let sidewalk = surface::wheel_off_road(now);
        if sidewalk && !self.sidewalk {
            events.push(Event::Sidewalk);
        }
        self.sidewalk = sidewalk;
    }

    fn blocked(&mut self, now: &Situation<'_>, events: &mut Vec<Event>) {
        if now.after.state.speed.abs() >= self.params.blocked_speed || is_held(now) {
            self.standing = 0.0;
            return;
        }
        self.standing += now.tick;
        if self.standing >= self.params.blocked_after {
            self.standing = 0.0;
            events.push(Event::VehicleBlocked);
        }
    }
}

/// Whether a red light or a road user in the ego's path is a reason to stand.
fn is_held(now: &Situation<'_>) -> bool {
    const LOOK_AHEAD: f64 = 20.0;
    let front_s = now.after.front_s;
    let light = SignalAhead::find(now.network, now.route, front_s - 1.0, |signal| now.world.signal(signal));
    let red = light.is_some_and(|light| light.state.is_red() && light.stop_s - front_s < LOOK_AHEAD);
    let reach = LOOK_AHEAD + now.length;
    red || now.world.vehicles.iter().chain(&now.world.pedestrians).any(|actor| {
        let offset = actor.pose.xy() - now.after.state.pose.xy();
        if offset.norm() > reach {
            return false;
        }
        let at = now.route.project_near(actor.pose.xy(), now.after.s, 0.0, reach);
        let ahead = at.s - now.after.s;
        let half = 0.5 * (actor.actor_type.width + now.width) + 0.5;
        ahead > 0.5 && ahead < reach && at.distance < half.max(0.5 * actor.actor_type.length.min(4.0))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;
    use std::sync::Arc;
    use sumo_network::network::{LanePosition, VehicleClass};
    use sumo_network::world::{Actor, ActorKind, ActorType, VehicleSignals};
    use wad_vehicle::{EgoParams, EgoVehicle};

    /// Causes of the collisions in ticks of 0.2 s, in each of which a walker touches an ego that stands `d` (m) beside its
    /// lane's middle with the next impulse (N s); None: they are apart.
    fn collisions(params: CriteriaParams, d: f64, impulses: &[Option<f64>]) -> Vec<Cause> {
        let text = include_str!("../../../tests/data/cross.net.xml");
        let network = Network::from_xml(Path::new("cross.net.xml"), text).unwrap();
        let at = |lane: &str, s: f64| LanePosition { lane: network.lane_by_id(lane).unwrap(), s };
        let route = network.route(at("WC_1", 5.0), at("EF_1", 100.0), VehicleClass::Passenger).unwrap();
        let ego = EgoParams::default();
        let s = 50.0;
        let state = EgoVehicle::new(ego.clone(), route.at(s).pose, 0.0).state();
        let place = EgoOnRoute { state, s, d, front_s: s + 0.5 * ego.length };
        let actor_type = ActorType {
            id: "walker".to_string(),
            kind: ActorKind::Pedestrian,
            length: 0.4,
            width: 0.5,
            height: 1.7,
            min_gap: 0.25,
        };
        let walker = Actor {
            id: Arc::from("0"),
            key: 1,
            actor_type: Arc::new(actor_type),
            pose: state.pose,
            speed: 1.0,
            signals: VehicleSignals(0),
            lane: None,
            lane_position: 0.0,
        };
        let world = WorldState { pedestrians: vec![walker], ..WorldState::default() };
        let mut criteria = Criteria::new(params);
        let mut causes = Vec::new();
        for impulse in impulses {
            let (kind, point) = (PartnerKind::Pedestrian, Vector::new(0.0, -0.9));
            let contact = impulse.map(|impulse| Contact { kind, key: 1, impulse, point });
            let contacts = contact.as_slice();
            let now = situation((&network, &route, &world), &ego, (place, place), contacts);
            let events = criteria.check(&now);
            causes.extend(events.iter().filter_map(|event| match event {
                Event::Collision { cause, .. } => Some(*cause),
                _ => None,
            }));
        }
        causes
    }

    fn label(key: u64) -> String {
        key.to_string()
    }

    /// A tick of 0.2 s from one place to another.
    fn situation<'a>(
        (network, route, world): (&'a Network, &'a Route, &'a WorldState),
        ego: &EgoParams,
        (before, after): (EgoOnRoute, EgoOnRoute),
        contacts: &'a [Contact],
    ) -> Situation<'a> {
        Situation {
            network,
            route,
            world,
            before,
            after,
            contacts,
            static_label: &label,
            length: ego.length,
            width: ego.width,
            wheelbase: ego.wheelbase,
            track: ego.track,
            tick: 0.2,
        }
    }

    /// Only the first line of a tick was once looked at.
    #[test]
    fn a_red_light_is_run_at_the_second_stop_line_of_a_tick_too() {
        let text = include_str!("../../../tests/data/cross.net.xml");
        let network = Network::from_xml(Path::new("cross.net.xml"), text).unwrap();
        let at = |lane: &str, s: f64| LanePosition { lane: network.lane_by_id(lane).unwrap(), s };
        let route = network.route(at("FE_1", 5.0), at("CW_1", 100.0), VehicleClass::Passenger).unwrap();
        let signal = |link: &sumo_network::network::RouteLink| network.link(link.link).signal;
        let [first, second] = &route.links[..] else { panic!("{:?}", route.links) };
        assert!(signal(first).is_none() && signal(second).is_some());
        let ego = EgoParams::default();
        let place = |front_s: f64| {
            let s = front_s - 0.5 * ego.length;
            let state = EgoVehicle::new(ego.clone(), route.at(s).pose, 10.0).state();
            EgoOnRoute { state, s, d: 0.0, front_s }
        };
        let red = Some(Arc::from("r".repeat(20)));
        let world =
            WorldState { traffic_lights: vec![red; network.traffic_lights.len()], ..WorldState::default() };
        let mut criteria = Criteria::new(CriteriaParams::default());
        let mut red_lights = |from: f64, to: f64| {
            let places = (place(from), place(to));
            let events = criteria.check(&situation((&network, &route, &world), &ego, places, &[]));
            events.iter().filter(|event| matches!(event, Event::RedLight { .. })).count()
        };
        assert_eq!(red_lights(first.stop_s - 1.0, second.stop_s - 1.0), 0, "no light, or not passed");
        assert_eq!(red_lights(first.stop_s - 1.0, second.stop_s + 1.0), 1);
        assert_eq!(red_lights(second.stop_s - 1.0, second.stop_s + 1.0), 0, "it counts once");
    }

    #[test]
    fn one_arrives_at_the_destination_also_where_the_route_leads_on() {
        let text = include_str!("../../../tests/data/cross.net.xml");
        let network = Network::from_xml(Path::new("cross.net.xml"), text).unwrap();
        let at = |lane: &str, s: f64| LanePosition { lane: network.lane_by_id(lane).unwrap(), s };
        let route = network.route(at("WC_1", 5.0), at("EF_1", 100.0), VehicleClass::Passenger).unwrap();
        let (ego, world) = (EgoParams::default(), WorldState::default());
        let arrives = |criteria: &mut Criteria, s: f64| {
            let state = EgoVehicle::new(ego.clone(), route.at(s).pose, 5.0).state();
            let place = EgoOnRoute { state, s, d: 0.0, front_s: s + 0.5 * ego.length };
            let now = situation((&network, &route, &world), &ego, (place, place), &[]);
            criteria.check(&now).contains(&Event::Arrival)
        };
        let mut criteria = Criteria::new(CriteriaParams::default());
        criteria.route_leads_on(50.0);
        assert_eq!([44.0, 46.0].map(|s| arrives(&mut criteria, s)), [false, true]);
        criteria.route_changed();
        let end = route.length();
        assert_eq!([46.0, end - 6.0, end - 4.0].map(|s| arrives(&mut criteria, s)), [false, false, true]);
    }

    #[test]
    fn a_touch_that_lasts_is_one_collision_until_they_were_apart_for_a_second() {
        let touch = [Some(90.0)].into_iter().chain([Some(0.0); 20]);
        let again = |apart: usize| -> usize {
            let ticks: Vec<_> =
                touch.clone().chain(std::iter::repeat_n(None, apart)).chain([Some(50.0)]).collect();
            collisions(CriteriaParams::default(), 0.0, &ticks).len()
        };
        assert_eq!((again(1), again(8)), (1, 2));
        assert!(collisions(CriteriaParams::default(), 0.0, &[Some(0.0)]).is_empty());
    }

    /// It was once judged by 1.75 m, whatever the event's own threshold.
    #[test]
    fn who_was_off_its_lane_is_judged_by_the_events_threshold() {
        let wide = CriteriaParams { outside_lane: 3.0, ..CriteriaParams::default() };
        assert_eq!(collisions(CriteriaParams::default(), 2.0, &[Some(90.0)]), [Cause::Ego]);
        assert_eq!(collisions(wide, 2.0, &[Some(90.0)]), [Cause::Other]);
    }
}
