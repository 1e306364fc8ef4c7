//! Plays a scenario in SUMO: adds its obstacles, and starts its events as the ego comes near.

use super::Scenario;
use super::actors::{Held, PREFIX, Stage};
use super::things::{Closure, Kind, Leader, Thing, Trigger, pedestrian_edge};
use crate::bridge::{self, Scene};
use crate::traffic::{Model, Walker};
use std::sync::Arc;
use sumo_network::geometry::{Point, Vector, direction, heading_to_sumo};
use sumo_network::network::{LanePosition, Network};
use sumo_traci::{Batch, person, traffic_light, vehicle};

/// Plays one scenario in one SUMO.
pub struct Director {
    scenario: Arc<Scenario>,
    stage: Stage,
    held: Vec<Held>,
    acts: Vec<Act>,
}

/// An event that is yet to come or under way.
enum Act {
    /// A person: waits at `from`, walks `way` (m) along `heading`, stands again.
    Walk {
        id: String,
        from: Point,
        heading: f64,
        speed: f64,
        way: f64,
        trigger: Trigger,
        began: Option<f64>,
    },
    Brake {
        id: String,
        at: Thing,
        deceleration: f64,
        duration: f64,
        phase: Braking,
    },
    SignalOff {
        light: String,
        trigger: Trigger,
        at: Point,
    },
    Close {
        id: String,
        closure: Closure,
        trigger: Trigger,
        at: Point,
    },
    Over,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Braking {
    Coming,
    /// m/s.
    Slowing(f64),
    /// Until then (s).
    Standing(f64),
}

/// For a person who never moves.
const NEVER: Trigger = Trigger { distance: Some(-1.0), time: None };
/// As long as SUMO keeps a person waiting (s).
const LONG: f64 = 1e6;
/// SUMO's own speed mode, to which a vehicle goes back.
const USUAL: i32 = 31;
/// How far beyond its point a vehicle still begins to brake (m), and how far beside it.
const PASSED: (f64, f64) = (40.0, 6.0);

impl Director {
    /// A director for one run of `scenario`.
    pub fn new(scenario: Arc<Scenario>) -> Self {
        Self { scenario, stage: Stage::default(), held: Vec::new(), acts: Vec::new() }
    }

    fn person(
        &mut self,
        scene: &Scene<'_>,
        thing: &Thing,
        walker: &Walker,
        batch: &mut Batch,
    ) -> Option<String> {
        let (edge, position) = pedestrian_edge(scene.network, thing.point)?;
        let id = format!("{PREFIX}{}", thing.id);
        let add = person::Add { edge, position, person_type: walker.id, ..person::Add::default() };
        person::add(batch, &id, &add);
        person::append_waiting_stage(batch, &id, LONG, "scenario", "");
        Some(id)
    }

    /// The rear vehicle stands a little askew, the front one is turned half across the lane.
    fn accident(&mut self, network: &Network, thing: &Thing, models: [&'static Model; 2], batch: &mut Batch) {
        let [first, second] = models;
        let lane = LanePosition { lane: thing.lane, s: thing.s };
        let beyond = LanePosition { s: thing.s + first.length + 0.8, ..lane };
        let a = self.stage.park(network, &format!("{}_1", thing.id), first, lane, batch);
        let b = self.stage.park(network, &format!("{}_2", thing.id), second, beyond, batch);
        let shape = &network.lane(thing.lane).shape;
        let placed = |model: &Model, at: f64, left: f64, turn: f64| {
            let mut pose = shape.at((at + 0.5 * model.length).min(shape.length()));
            let place = pose.to_world(Vector::new(0.0, left));
            (pose.position.x, pose.position.y) = (place.x, place.y);
            pose.heading += turn;
            pose
        };
        let pose = placed(first, thing.s, 0.25, 0.12);
        self.held.push(Held { id: a, pose, length: first.length, hazard: true });
        // As far across as leaves the next lane free.
        let room = network.lane(thing.lane).width - 0.9 * second.width;
        let turn = (room / second.length).clamp(0.08, 0.42);
        let pose = placed(second, thing.s + first.length + 0.4, -0.2, -turn);
        self.held.push(Held { id: b, pose, length: second.length, hazard: true });
    }

    /// A vehicle on the ego's own way, ahead of it.
    fn leader(&mut self, scene: &Scene<'_>, id: &str, model: &Model, gap: f64, batch: &mut Batch) -> String {
        let (ego, network) = (scene.ego, scene.network);
        let route = ego.route();
        let rear = ego.on_route().s + 0.5 * ego.params().length + gap;
        // SUMO's vehicles depart from roads: beyond a junction in which the gap ends.
        let rear = route.link_at(rear).map_or(rear, |link| link.end_s);
        let at = route.at(rear);
        let lane = network.lane(at.lane);
        let edges = &route.edges[route.edge_index_at(rear)..];
        let edges: Vec<&str> = edges.iter().map(|e| network.edge(*e).id.as_str()).collect();
        let route_id = self.stage.route(&edges, batch);
        let id = format!("{PREFIX}{id}");
        let s = lane.shape.project(at.pose.xy()).s + model.length;
        let add = vehicle::Add {
            route: &route_id,
            vehicle_type: model.id,
            depart_lane: &lane.index.to_string(),
            depart_pos: &format!("{:.2}", lane.lane_position(s).clamp(0.1, (lane.length - 0.1).max(0.1))),
            depart_speed: "0",
            ..vehicle::Add::default()
        };
        vehicle::add(batch, &id, &add);
        // It keeps its lane: the ego is to stay behind it.
        batch.set(vehicle::SET_LANE_CHANGE_MODE, &id, 0);
        id
    }
}

impl bridge::Director for Director {
    fn begin(&mut self, scene: &Scene<'_>, batch: &mut Batch) {
        let scenario = Arc::clone(&self.scenario);
        let network = scene.network;
        for thing in &scenario.things {
            let at = LanePosition { lane: thing.lane, s: thing.s };
            match &thing.kind {
                Kind::Bench => {}
                Kind::Vehicle(model) => {
                    self.stage.park(network, &thing.id, model, at, batch);
                }
                Kind::Object { shape, width } => {
                    let id = self.stage.object(network, &thing.id, (*shape, *width), at, batch);
                    let mut pose = thing.pose;
                    (pose.position.x, pose.position.y) = (thing.point.x, thing.point.y);
                    self.held.push(Held { id, pose, length: shape.sizes().0, hazard: false });
                }
                Kind::RoadWorks(closures) => {
                    for closure in closures {
                        self.stage.close(network, &thing.id, closure, batch);
                    }
                }
                Kind::Person(walker) => {
                    let Some(id) = self.person(scene, thing, walker, batch) else { continue };
                    // Faces the traffic.
                    let heading = thing.pose.heading + std::f64::consts::PI;
                    let (from, trigger) = (thing.point, NEVER);
                    self.acts.push(Act::Walk {
                        id,
                        from,
                        heading,
                        speed: 0.0,
                        way: 0.0,
                        trigger,
                        began: None,
                    });
                }
                Kind::Pedestrian { walker, speed, way, trigger } => {
                    let Some(id) = self.person(scene, thing, walker, batch) else { continue };
                    let across = if thing.d > 0.0 { -1.0 } else { 1.0 };
                    let heading = thing.pose.heading + across * std::f64::consts::FRAC_PI_2;
                    let (from, speed, way, trigger) = (thing.point, *speed, *way, *trigger);
                    self.acts.push(Act::Walk { id, from, heading, speed, way, trigger, began: None });
                }
                Kind::Brake { leader, deceleration, duration } => {
                    let id = match leader {
                        Leader::Drawn(id) => id.clone(),
                        Leader::Ahead { model, gap } => self.leader(scene, &thing.id, model, *gap, batch),
                    };
                    let (at, phase) = (thing.clone(), Braking::Coming);
                    let (deceleration, duration) = (*deceleration, *duration);
                    self.acts.push(Act::Brake { id, at, deceleration, duration, phase });
                }
                Kind::Accident(models) => self.accident(network, thing, *models, batch),
                Kind::SignalOff { light, trigger } => {
                    let (light, trigger, at) = (light.clone(), *trigger, thing.point);
                    self.acts.push(Act::SignalOff { light, trigger, at });
                }
                Kind::LaneClosed { closure, trigger } => {
                    let (id, closure, trigger, at) = (thing.id.clone(), *closure, *trigger, thing.point);
                    self.acts.push(Act::Close { id, closure, trigger, at });
                }
            }
        }
    }

    fn direct(&mut self, scene: &Scene<'_>, batch: &mut Batch) {
        for held in &self.held {
            held.hold(batch);
        }
        let Self { acts, stage, .. } = self;
        for act in acts {
            act.play(scene, stage, batch);
        }
    }
}

impl Trigger {
    fn holds(&self, scene: &Scene<'_>, at: Point) -> bool {
        let near = |distance: f64| (scene.ego.state().pose.xy() - at).norm() <= distance;
        match (self.distance, self.time) {
            (None, None) => true,
            (distance, time) => distance.is_some_and(near) || time.is_some_and(|time| scene.time >= time),
        }
    }
}

impl Act {
    fn play(&mut self, scene: &Scene<'_>, stage: &mut Stage, batch: &mut Batch) {
        match self {
            Self::Walk { id, from, heading, speed, way, trigger, began } => {
                if began.is_none() && trigger.holds(scene, *from) {
                    tracing::info!("{id} steps out");
                    *began = Some(scene.time);
                }
                let gone = began.map_or(0.0, |began| (*speed * (scene.time - began)).min(*way));
                let at = *from + direction(*heading) * gone;
                // Any lane at that place: traffic brakes for persons on its lane.
                let to = vehicle::MoveToXy {
                    x: at.x,
                    y: at.y,
                    angle_deg: heading_to_sumo(*heading),
                    keep_route: 6,
                    ..Default::default()
                };
                person::move_to_xy(batch, id, &to);
            }
            Self::Brake { id, at, deceleration, duration, phase } => {
                match *phase {
                    Braking::Coming => {
                        let Some(actor) = scene.ego.world().vehicles.iter().find(|a| &*a.id == id) else {
                            return;
                        };
                        let front = actor.pose.advanced(0.5 * actor.actor_type.length).xy();
                        let local = at.pose.to_local(front);
                        let passes = (-actor.speed * scene.tick..PASSED.0).contains(&local.x);
                        if !passes || local.y.abs() > PASSED.1 {
                            return;
                        }
                        tracing::info!("{id} brakes");
                        // No checks: it brakes harder than its type would.
                        batch.set(vehicle::SET_SPEED_MODE, id, 0);
                        *phase = Braking::Slowing(actor.speed);
                    }
                    Braking::Slowing(speed) if speed <= 0.0 => {
                        *phase = Braking::Standing(scene.time + *duration)
                    }
                    Braking::Slowing(_) => {}
                    Braking::Standing(until) if scene.time >= until => {
                        batch.set(vehicle::SET_SPEED_MODE, id, USUAL);
                        batch.set(vehicle::SET_SPEED, id, -1.0);
                        *self = Self::Over;
                        return;
                    }
                    Braking::Standing(_) => {}
                }
                if let Braking::Slowing(speed) = phase {
                    *speed = (*speed - *deceleration * scene.tick).max(0.0);
                    batch.set(vehicle::SET_SPEED, id, *speed);
                }
            }
            Self::SignalOff { light, trigger, at } if trigger.holds(scene, *at) => {
                // SUMO's own program of a light that is off: the junction's rules hold.
                batch.set(traffic_light::SET_PROGRAM, light, "off");
                *self = Self::Over;
            }
            Self::Close { id, closure, trigger, at } if trigger.holds(scene, *at) => {
                stage.close(scene.network, id, closure, batch);
                *self = Self::Over;
            }
            Self::SignalOff { .. } | Self::Close { .. } | Self::Over => {}
        }
    }
}
