//! The autopilot in live SUMO traffic.
//!
//! By itself it drives through the empty town5. `LIVE_DEMAND=FOLDER` (with `v.SEED.xml` and `p.SEED.xml`),
//! `LIVE_SEEDS=1,2`, `LIVE_TOWN` and `LIVE_TRACE=TICK` turn it into a bench for tuning in traffic.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use wad_cosim::autopilot::{Autopilot, AutopilotParams, EgoModel, Reason};
use wad_cosim::geometry::{Pose, wrap_angle};
use wad_cosim::network::{LaneId, LanePosition, Network, Route, VehicleClass};
use wad_cosim::traci::vehicle::MoveToXy;
use wad_cosim::traci::*;
use wad_cosim::vehicle::{EgoParams, EgoState, EgoVehicle, MovingBody, PartnerKind};
use wad_cosim::world::{Actor, ActorKind, ActorType, VehicleSignals, WorldState};

const TICK: f64 = 0.167;

/// What came of a drive.
#[derive(Debug, Default)]
struct Score {
    ticks: u64,
    distance: f64,
    /// Ticks and metres while nothing held it.
    free_ticks: u64,
    free_distance: f64,
    red_lights_run: usize,
    /// Contacts, by whether the ego moved at more than 0.5 m/s.
    hits_moving: Vec<String>,
    hits_standing: Vec<String>,
    longest_stand: f64,
    hard_brakes: usize,
    worst_off: f64,
    arrivals: usize,
    held_by: BTreeMap<String, u64>,
}

struct Rng(u64);
impl Rng {
    fn below(&mut self, n: usize) -> usize {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        ((self.0 >> 33) as usize) % n
    }
}

/// A long route of several legs from a place on it.
fn long_route(network: &Network, rng: &mut Rng, from: LanePosition) -> Route {
    let lanes: Vec<LaneId> = network
        .drivable_lanes(VehicleClass::Passenger)
        .iter()
        .copied()
        .filter(|&l| network.lane(l).length > 60.0)
        .collect();
    let mut pick = || lanes[rng.below(lanes.len())];
    let mut route = loop {
        let to = pick();
        let to = LanePosition { lane: to, s: 40.0 };
        if let Ok(route) = network.route(from, to, VehicleClass::Passenger)
            && route.length() > 200.0
        {
            break route;
        }
    };
    while route.length() < 4000.0 {
        let to = LanePosition { lane: pick(), s: 40.0 };
        let _ = network.extend_route(&mut route, to);
    }
    route
}

async fn drive(seed: u64, ticks: u64, additional: &[PathBuf]) -> Score {
    let town = std::env::var("LIVE_TOWN").unwrap_or("town5".into());
    let net_path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("sumo_nets/{town}/{town}.net.xml"));
    let types = Path::new(env!("CARGO_MANIFEST_DIR")).join("sumo_nets/vtypes.add.xml");
    let network = Network::load(&net_path).unwrap();
    let trace = std::env::var("LIVE_TRACE").ok();
    let mut options = LaunchOptions::net(&net_path)
        .option("time-to-teleport", -1)
        .option("lanechange.duration", 2)
        .option("collision.action", "warn")
        .option("collision.check-junctions", true)
        .option("collision.mingap-factor", 0)
        .option("no-warnings", true)
        .option("ignore-route-errors", true)
        .option("additional-files", types.display());
    if !additional.is_empty() {
        let list: Vec<String> = additional.iter().map(|p| p.display().to_string()).collect();
        options = options.option("route-files", list.join(","));
    }
    options.seed = Some(seed as i64);
    options.step_length = Some(TICK);
    let (mut sumo, mut client) = SumoProcess::launch(&options).await.unwrap();
    // Let the town fill.
    for _ in 0..360 {
        client.step().await.unwrap();
    }

    let mut rng = Rng(seed.wrapping_mul(977) + 5);
    let lanes = network.drivable_lanes(VehicleClass::Passenger).to_vec();
    let start = loop {
        let lane = lanes[rng.below(lanes.len())];
        if network.lane(lane).length > 80.0 {
            break LanePosition { lane, s: 30.0 };
        }
    };
    let mut route = long_route(&network, &mut rng, start);
    let mut sumo_index = 0;
    let params = EgoParams::default();
    let model = EgoModel::from(&params);
    let mut ego = EgoVehicle::new(params, route.at(0.0).pose, 0.0);
    let mut pilot = Autopilot::new(AutopilotParams::default(), model);

    let edge_names = |route: &Route, from: usize| -> Vec<String> {
        let to = (from + 12).min(route.edges.len());
        route.edges[from..to].iter().map(|&e| network.edge(e).id.clone()).collect()
    };
    let mut batch = Batch::new();
    let names = edge_names(&route, 0);
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    route::add(&mut batch, "ego0", &names);
    let position = format!("{:.2}", 30.0 + 0.5 * model.length);
    let lane = network.lane(start.lane).index.to_string();
    vehicle::add(
        &mut batch,
        "ego",
        &vehicle::Add {
            route: "ego0",
            vehicle_type: "car.saloon",
            depart_lane: &lane,
            depart_pos: &position,
            ..Default::default()
        },
    );
    let vehicle_variables = [
        vehicle::POSITION_3D.id(),
        vehicle::ANGLE.id(),
        vehicle::SPEED.id(),
        vehicle::ACCELERATION.id(),
        vehicle::SIGNALS.id(),
        vehicle::LANE_ID.id(),
        vehicle::LANE_POSITION.id(),
        vehicle::LENGTH.id(),
        vehicle::WIDTH.id(),
    ];
    let person_variables = [
        person::POSITION_3D.id(),
        person::ANGLE.id(),
        person::SPEED.id(),
        person::LANE_ID.id(),
        person::LENGTH.id(),
        person::WIDTH.id(),
    ];
    for light in &network.traffic_lights {
        batch.subscribe(traffic_light::TrafficLight, &light.id, &[traffic_light::STATE.id()]);
    }
    batch.step();
    client.send(&batch).await.unwrap().check().unwrap();
    let mut batch = Batch::new();
    batch.subscribe_context(vehicle::Vehicle, "ego", vehicle::Vehicle, 100.0, &vehicle_variables);
    batch.subscribe_context(vehicle::Vehicle, "ego", person::Person, 100.0, &person_variables);
    client.send(&batch).await.unwrap().check().unwrap();

    let mut score = Score::default();
    let mut route_s = 0.0;
    let mut keys: BTreeMap<String, u64> = BTreeMap::new();
    let mut bodies: Vec<MovingBody> = Vec::new();
    let mut control = wad_cosim::vehicle::Control { brake: 0.3, ..Default::default() };
    let mut signals = 0;
    let mut standing = 0.0;
    let mut hit_at: BTreeMap<u64, u64> = BTreeMap::new();
    let mut last: Option<wad_cosim::autopilot::Decision> = None;
    for tick in 0..ticks {
        let before: EgoState = ego.state();
        let contacts = ego.tick(control, TICK, &bodies);
        let state = ego.state();
        for contact in contacts {
            let again = hit_at.insert(contact.key, tick).is_some_and(|t| tick - t < 12);
            if again || contact.impulse < 200.0 {
                continue;
            }
            let who = keys.iter().find(|e| *e.1 == contact.key).map_or("?", |e| e.0);
            let other = bodies.iter().find(|b| b.key == contact.key).unwrap();
            let text = format!(
                "tick {tick} {who} impulse {:.0} at {:.1},{:.1} ego {:.1} m/s ({:.1},{:.1}) other {:.1} m/s turned {:.0} deg, {:?}",
                contact.impulse,
                contact.point.x,
                contact.point.y,
                before.speed,
                before.pose.position.x,
                before.pose.position.y,
                other.speed,
                wrap_angle(other.pose.heading - before.pose.heading).to_degrees(),
                last.map(|d| d.reason)
            );
            if before.speed > 0.5 { score.hits_moving.push(text) } else { score.hits_standing.push(text) }
        }
        let mut batch = Batch::new();
        let (front, angle_deg) = state.pose.to_sumo(model.length);
        vehicle::move_to_xy(
            &mut batch,
            "ego",
            &MoveToXy { x: front.x, y: front.y, angle_deg, keep_route: 3, ..Default::default() },
        );
        batch.set(vehicle::SET_SIGNALS, "ego", signals);
        batch.step();
        let replies = client.send(&batch).await.unwrap();
        replies.check().unwrap();
        let subscriptions = replies.subscriptions();

        let mut world = WorldState { tick, time: tick as f64 * TICK, ..WorldState::default() };
        let mut key = |id: &str| {
            let next = keys.len() as u64;
            *keys.entry(id.to_owned()).or_insert(next)
        };
        for v in subscriptions.context(vehicle::Vehicle, "ego", vehicle::Vehicle) {
            if v.id() == "ego" {
                continue;
            }
            let p = v.value(vehicle::POSITION_3D).unwrap();
            let length = v.value(vehicle::LENGTH).unwrap();
            let shape = ActorType {
                id: String::new(),
                kind: ActorKind::Car,
                length,
                width: v.value(vehicle::WIDTH).unwrap(),
                height: 1.5,
                min_gap: 2.5,
            };
            world.vehicles.push(Actor {
                id: v.id().into(),
                key: key(v.id()),
                actor_type: Arc::new(shape),
                pose: Pose::from_sumo([p.x, p.y, p.z].into(), v.value(vehicle::ANGLE).unwrap(), length),
                speed: v.value(vehicle::SPEED).unwrap(),
                signals: VehicleSignals(v.value(vehicle::SIGNALS).unwrap() as u32),
                lane: network.lane_by_id(v.str(vehicle::LANE_ID).unwrap()),
                lane_position: v.value(vehicle::LANE_POSITION).unwrap(),
            });
        }
        for v in subscriptions.context(vehicle::Vehicle, "ego", person::Person) {
            let p = v.value(person::POSITION_3D).unwrap();
            let length = v.value(person::LENGTH).unwrap();
            let shape = ActorType {
                id: String::new(),
                kind: ActorKind::Pedestrian,
                length,
                width: v.value(person::WIDTH).unwrap(),
                height: 1.7,
                min_gap: 0.3,
            };
            world.pedestrians.push(Actor {
                id: v.id().into(),
                key: key(v.id()),
                actor_type: Arc::new(shape),
                pose: Pose::from_sumo([p.x, p.y, p.z].into(), v.value(person::ANGLE).unwrap(), length),
                speed: v.value(person::SPEED).unwrap(),
                signals: VehicleSignals(0),
                lane: network.lane_by_id(v.str(person::LANE_ID).unwrap()),
                lane_position: 0.0,
            });
        }
        world.vehicles.sort_by(|a, b| a.id.cmp(&b.id));
        world.pedestrians.sort_by(|a, b| a.id.cmp(&b.id));
        world.traffic_lights = network
            .traffic_lights
            .iter()
            .map(|l| {
                if (l.position - state.pose.xy()).norm() > 110.0 {
                    return None;
                }
                let light = subscriptions.object(traffic_light::TrafficLight, &l.id)?;
                Some(light.str(traffic_light::STATE).ok()?.into())
            })
            .collect();

        let on = route.project_near(state.pose.xy(), route_s, 3.0, 8.0);
        let (old_front, front_s) = (route_s + 0.5 * model.length, on.s + 0.5 * model.length);
        score.distance += (on.s - route_s).max(0.0);
        route_s = on.s;
        for link in &route.links {
            if old_front < link.stop_s && front_s >= link.stop_s {
                let signal = network.link(link.link).signal.and_then(|s| world.signal(s));
                if signal.is_some_and(|s| s.is_red()) {
                    score.red_lights_run += 1;
                }
            }
        }
        score.worst_off = score.worst_off.max(route.corridor_offset(on.s, on.d));
        if state.acceleration < -5.0 {
            score.hard_brakes += 1;
        }
        if route.length() - route_s < 150.0 {
            score.arrivals += 1;
            let to = loop {
                let lane = lanes[rng.below(lanes.len())];
                let to = LanePosition { lane, s: 20.0 };
                let mut longer = route.clone();
                if network.extend_route(&mut longer, to).is_ok() && longer.length() > route.length() + 300.0 {
                    break longer;
                }
            };
            route = to;
        }
        let edge = route.edge_index_at(route_s);
        if edge >= sumo_index + 6 && route.link_at(route_s).is_none() {
            sumo_index = edge;
            let names = edge_names(&route, edge);
            let names: Vec<&str> = names.iter().map(String::as_str).collect();
            let mut batch = Batch::new();
            vehicle::set_route(&mut batch, "ego", &names);
            let _ = client.send(&batch).await.unwrap();
        }
        let decision = pilot.control(&network, &route, route_s, &state, &world, TICK);
        if let Some(from) = &trace {
            let from: u64 = from.parse().unwrap_or(0);
            let short = matches!(decision.reason, Reason::Crossing { .. } | Reason::Pedestrian { .. });
            if from == 8888 && tick % 30 == 0
                || from == 9999 && (state.acceleration < -4.5 || short && tick % 6 == 0)
                || tick >= from && tick < from + 60
            {
                println!(
                    "{tick} s {route_s:.1} v {:.2} a {:.2} d {:.2} at {:.1},{:.1} {:?} light {:?} leader {:?}",
                    state.speed,
                    decision.acceleration,
                    on.d,
                    state.pose.position.x,
                    state.pose.position.y,
                    decision.reason,
                    decision.light,
                    decision.leader
                );
                if tick == 900 {
                    for v in &world.vehicles {
                        let local = state.pose.to_local(v.pose.xy());
                        if local.norm() < 22.0 {
                            println!(
                                "   {} at {:.1},{:.1} v {:.2} turned {:.0} lane {:?} pos {:.1} signals {:?} len {:.1}",
                                v.id,
                                local.x,
                                local.y,
                                v.speed,
                                (v.pose.heading - state.pose.heading).to_degrees(),
                                v.lane.map(|l| network.lane(l).id.clone()),
                                v.lane_position,
                                v.signals,
                                v.actor_type.length
                            );
                        }
                    }
                    let mut batch = Batch::new();
                    let road = batch.get(vehicle::LANE_ID, "ego");
                    let route = batch.get(vehicle::ROUTE, "ego");
                    let index = batch.get(vehicle::ROUTE_INDEX, "ego");
                    let r = client.send(&batch).await.unwrap();
                    println!("ego on {:?} {:?} {:?}", r.get(road), r.get(route), r.get(index));
                }
                for p in &world.pedestrians {
                    let local = state.pose.to_local(p.pose.xy());
                    if short && local.x > 0.0 && local.x < 15.0 && local.y.abs() < 9.0 {
                        println!(
                            "      {} at {:.1},{:.1} v {:.2} turned {:.0} lane {:?}",
                            p.id,
                            local.x,
                            local.y,
                            p.speed,
                            (p.pose.heading - state.pose.heading).to_degrees(),
                            p.lane.map(|l| network.lane(l).id.clone())
                        );
                    }
                }
            }
        }
        last = Some(decision);
        control = decision.control;
        signals = i32::from(decision.blinker_right)
            | i32::from(decision.blinker_left) << 1
            | i32::from(decision.brake_light) << 3;
        score.ticks += 1;
        if decision.held {
            let name = format!("{:?}", decision.reason);
            let name = name.split([' ', '{']).next().unwrap_or("").to_owned();
            *score.held_by.entry(name).or_default() += 1;
        } else {
            score.free_ticks += 1;
            score.free_distance += state.speed * TICK;
        }
        let by_light = matches!(decision.reason, Reason::RedLight { .. });
        standing = if state.speed < 0.1 && !by_light { standing + TICK } else { 0.0 };
        if standing > score.longest_stand {
            score.longest_stand = standing;
            if standing > 60.0 && ((standing / TICK) as u64).is_multiple_of(120) {
                println!(
                    "seed {seed} tick {tick}: standing {standing:.0} s at {:.1},{:.1}: {:?}",
                    state.pose.position.x, state.pose.position.y, decision.reason
                );
            }
        }
        bodies = world
            .vehicles
            .iter()
            .chain(&world.pedestrians)
            .map(|a| MovingBody {
                key: a.key,
                kind: if a.actor_type.kind == ActorKind::Pedestrian {
                    PartnerKind::Pedestrian
                } else {
                    PartnerKind::Vehicle
                },
                pose: a.pose,
                speed: a.speed,
                acceleration: 0.0,
                turn_rate: 0.0,
                length: a.actor_type.length,
                width: a.actor_type.width,
                height: a.actor_type.height,
            })
            .collect();
    }
    client.close().await.unwrap();
    sumo.wait_at_most(std::time::Duration::from_secs(10)).await;
    score
}

#[tokio::test]
async fn the_autopilot_lives_in_town5() {
    let folder = std::env::var("LIVE_DEMAND").unwrap_or_default();
    let seeds: Vec<u64> =
        std::env::var("LIVE_SEEDS").unwrap_or("1".into()).split(',').filter_map(|s| s.parse().ok()).collect();
    for seed in seeds {
        let demand = |kind: &str| PathBuf::from(format!("{folder}/{kind}.{seed}.xml"));
        let files = if folder.is_empty() { vec![] } else { vec![demand("v"), demand("p")] };
        let score = drive(seed, 1200, &files).await;
        println!(
            "seed {seed}: {:.0} m, {:.1} m/s when free ({} of {} ticks), {:#?}",
            score.distance,
            score.free_distance / (score.free_ticks.max(1) as f64 * TICK),
            score.free_ticks,
            score.ticks,
            score
        );
        assert_eq!(score.red_lights_run, 0);
        assert!(score.hits_moving.is_empty(), "{:#?}", score.hits_moving);
        assert!(score.worst_off < 0.5 && score.free_distance > 4.0 * score.free_ticks as f64 * TICK);
    }
}
