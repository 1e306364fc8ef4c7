//! The closed loop: vehicle, route, scripted traffic, and the result.

use crate::autopilot::{Autopilot, AutopilotParams, Decision, EgoModel, Told};
use std::path::Path;
use std::sync::Arc;
use sumo_network::geometry::{Point, Pose, Vector, direction};
use sumo_network::network::{LanePosition, Network, Route, VehicleClass};
use sumo_network::world::{Actor, ActorKind, ActorType, VehicleSignals, WorldState};
use wad_vehicle::{EgoParams, EgoState, EgoVehicle, MovingBody, PartnerKind};

/// An actor's place over time (s); None while it is not there.
pub type Script<'a> = Box<dyn FnMut(&Network, f64, &EgoState) -> Option<Actor> + 'a>;

/// The net of these tests.
pub fn net() -> Network {
    let text = include_str!("../../../../../tests/data/cross.net.xml");
    Network::from_xml(Path::new("cross.net.xml"), text).unwrap()
}

pub fn route(network: &Network, from: (&str, f64), to: (&str, f64)) -> Route {
    let at = |(lane, s): (&str, f64)| LanePosition { lane: network.lane_by_id(lane).unwrap(), s };
    network.route(at(from), at(to), VehicleClass::Passenger).unwrap()
}

fn actor(key: u64, kind: ActorKind, (length, width): (f64, f64), pose: Pose, speed: f64) -> Actor {
    let height = 1.6;
    let shape = ActorType { id: "t".into(), kind, length, width, height, min_gap: 2.5 };
    Actor {
        id: format!("a{key}").into(),
        key,
        actor_type: Arc::new(shape),
        pose,
        speed,
        signals: VehicleSignals(0),
        lane: None,
        lane_position: 0.0,
    }
}

/// A car whose front bumper is `x` m along these lanes, as SUMO would tell it.
pub fn car(network: &Network, key: u64, lanes: &[&str], x: f64, speed: f64) -> Option<Actor> {
    let length = 4.6;
    let mut rest = x;
    let mut behind: Option<Pose> = None;
    for name in lanes {
        let id = network.lane_by_id(name).unwrap();
        let lane = network.lane(id);
        if rest <= lane.length {
            let front = lane.shape.at(lane.arc_length(rest));
            // The heading from rear to front, as SUMO has it on curves.
            let rear = match behind {
                Some(end) if rest < length => end.advanced(rest - length),
                _ => lane.shape.at(lane.arc_length((rest - length).max(0.0))),
            };
            let r = front.xy() - rear.xy();
            let heading = if r.norm() > 1.0 { r.y.atan2(r.x) } else { front.heading };
            let pose = Pose { position: front.position, heading }.advanced(-0.5 * length);
            let mut car = actor(key, ActorKind::Car, (length, 1.8), pose, speed);
            car.lane = Some(id);
            car.lane_position = rest;
            return Some(car);
        }
        rest -= lane.length;
        behind = Some(lane.shape.at(lane.shape.length()));
    }
    None
}

pub fn walker(network: &Network, key: u64, place: Point, velocity: Vector, lane: Option<&str>) -> Actor {
    let heading = velocity.y.atan2(velocity.x);
    let pose = Pose::new(place.x, place.y, 0.0, heading);
    let mut walker = actor(key, ActorKind::Pedestrian, (0.4, 0.5), pose, velocity.norm());
    walker.lane = lane.map(|l| network.lane_by_id(l).unwrap());
    walker
}

/// What happened.
#[derive(Debug, Default)]
pub struct Report {
    pub seconds: f64,
    pub s: f64,
    pub speed: f64,
    /// Smallest distance to another's footprint (m).
    pub nearest: f64,
    /// Hardest braking and strongest acceleration asked for (m/s2).
    pub hardest: f64,
    /// Largest distance from the route's line (m), and speed over the limit (m/s).
    pub off: f64,
    pub over_limit: f64,
    /// Stop lines crossed on red.
    pub red_runs: usize,
    pub contacts: usize,
    pub last: Option<Decision>,
    /// Front bumper to the next stop line at the end (m).
    pub to_line: f64,
    /// Seconds under 0.3 m/s.
    pub stood: f64,
}

pub struct Setup<'a> {
    pub network: &'a Network,
    pub route: Route,
    pub start_speed: f64,
    pub vehicles: Vec<Script<'a>>,
    pub pedestrians: Vec<Script<'a>>,
    /// State of the one traffic light over time.
    pub light: Box<dyn Fn(f64) -> Option<&'static str> + 'a>,
    /// What is told, from the distance to the stop line (m); None: it looks itself.
    pub told: Option<fn(f64) -> Told>,
    pub tick_s: f64,
    pub seconds: f64,
    /// Ends this far before the route's end (m).
    pub before_end: f64,
}

/// All green for the main road, all red otherwise, as the net's own program has them.
pub const MAIN_GREEN: &str = "rrrgGGgrrrgGGgGrGr";
pub const MAIN_YELLOW: &str = "rrryyyyrrryyyyrrrr";
pub const SIDE_GREEN: &str = "gGgrrrrgGgrrrrrGrG";

impl<'a> Setup<'a> {
    pub fn new(network: &'a Network, from: (&str, f64), to: (&str, f64), start_speed: f64) -> Self {
        Self {
            network,
            route: route(network, from, to),
            start_speed,
            vehicles: Vec::new(),
            pedestrians: Vec::new(),
            light: Box::new(|_| Some(MAIN_GREEN)),
            told: None,
            tick_s: 0.167,
            seconds: 60.0,
            before_end: 3.0,
        }
    }

    pub fn run(mut self) -> Report {
        let params = EgoParams::default();
        let model = EgoModel::from(&params);
        let mut pilot = Autopilot::new(AutopilotParams::default(), model);
        let mut ego = EgoVehicle::new(params, self.route.at(0.0).pose, self.start_speed);
        let mut report = Report { nearest: f64::INFINITY, to_line: f64::INFINITY, ..Report::default() };
        let trace = std::env::var("TRACE").is_ok();
        let ticks = (self.seconds / self.tick_s) as u64;
        for tick in 0..ticks {
            let t = tick as f64 * self.tick_s;
            let state = ego.state();
            let mut world = WorldState { tick, time: t, ..WorldState::default() };
            let network = self.network;
            world.vehicles = self.vehicles.iter_mut().filter_map(|v| v(network, t, &state)).collect();
            world.pedestrians = self.pedestrians.iter_mut().filter_map(|v| v(network, t, &state)).collect();
            world.traffic_lights = vec![(self.light)(t).map(Arc::from)];
            let on = self.route.project_near(state.pose.xy(), report.s, 5.0, 10.0);
            let before = report.s + 0.5 * model.length;
            report.s = on.s;
            let front = on.s + 0.5 * model.length;
            for link in &self.route.links {
                let red = self.network.link(link.link).signal.and_then(|s| world.signal(s));
                if before < link.stop_s && front >= link.stop_s && red.is_some_and(|r| r.is_red()) {
                    report.red_runs += 1;
                }
            }
            report.seconds = t;
            report.speed = state.speed;
            report.off = report.off.max(on.distance);
            report.over_limit = report.over_limit.max(state.speed - self.route.at(on.s).speed_limit);
            report.to_line = self.route.next_link(front - 0.5).map_or(f64::INFINITY, |l| l.stop_s - front);
            if state.speed < 0.3 {
                report.stood += self.tick_s;
            }
            for other in world.vehicles.iter().chain(&world.pedestrians) {
                report.nearest = report.nearest.min(distance(&state.pose, &model, other));
            }
            if on.s > self.route.length() - self.before_end {
                break;
            }
            if let Some(told) = self.told {
                pilot.tell(told(report.to_line));
            }
            let decision = pilot.control(self.network, &self.route, on.s, &state, &world, self.tick_s);
            if trace {
                println!(
                    "{t:6.2} s {:6.2} v {:5.2} a {:5.2} d {:5.2} near {:5.2} {:?}",
                    on.s, state.speed, decision.acceleration, on.d, report.nearest, decision.reason
                );
            }
            report.hardest = report.hardest.min(state.acceleration);
            report.last = Some(decision);
            let bodies: Vec<MovingBody> = world.vehicles.iter().chain(&world.pedestrians).map(body).collect();
            report.contacts += ego.tick(decision.control, self.tick_s, &bodies).len();
        }
        report
    }
}

fn body(actor: &Actor) -> MovingBody {
    let kind = match actor.actor_type.kind {
        ActorKind::Pedestrian => PartnerKind::Pedestrian,
        _ => PartnerKind::Vehicle,
    };
    MovingBody {
        key: actor.key,
        kind,
        pose: actor.pose,
        speed: actor.speed,
        acceleration: 0.0,
        turn_rate: 0.0,
        length: actor.actor_type.length,
        width: actor.actor_type.width,
        height: actor.actor_type.height,
    }
}

/// Distance between two footprints, by points 0.2 m apart on both outlines (m).
fn distance(ego: &Pose, model: &EgoModel, other: &Actor) -> f64 {
    if (ego.xy() - other.pose.xy()).norm() > 25.0 {
        return f64::INFINITY;
    }
    let boxes = [
        (ego, (model.length, model.width)),
        (&other.pose, (other.actor_type.length, other.actor_type.width)),
    ];
    let mut nearest = f64::INFINITY;
    for (a, b) in [(boxes[0], boxes[1]), (boxes[1], boxes[0])] {
        for p in outline(a.0, a.1) {
            let local = b.0.to_local(p);
            let dx = (local.x.abs() - 0.5 * b.1.0).max(0.0);
            let dy = (local.y.abs() - 0.5 * b.1.1).max(0.0);
            nearest = f64::min(nearest, dx.hypot(dy));
        }
    }
    nearest
}

fn outline(pose: &Pose, (length, width): (f64, f64)) -> Vec<Point> {
    let forward = direction(pose.heading);
    let left = Vector::new(-forward.y, forward.x);
    let n = (length / 0.2).ceil() as i32;
    let m = (width / 0.2).ceil() as i32;
    let at = |x: f64, y: f64| pose.xy() + forward * x + left * y;
    let mut points = Vec::new();
    for i in 0..=n {
        let x = length * (f64::from(i) / f64::from(n) - 0.5);
        points.extend([at(x, 0.5 * width), at(x, -0.5 * width)]);
    }
    for i in 0..=m {
        let y = width * (f64::from(i) / f64::from(m) - 0.5);
        points.extend([at(0.5 * length, y), at(-0.5 * length, y)]);
    }
    points
}
