//! Getters and setters of every domain.

use super::{Town, send, steps};
use std::time::Duration;
use wad_cosim::traci::*;

/// Asks for each variable in a batch and subscribes to each on its own: type and extent must be right both times.
macro_rules! read_all {
    ($client:expr, $domain:expr, $module:ident, $id:expr, [$($name:ident),* $(,)?]) => {{
        let mut wrong: Vec<String> = Vec::new();
        let mut batch = Batch::new();
        let tickets = ($((batch.get($module::$name, $id), batch.subscribe($domain, $id, &[$module::$name.id()])),)*);
        batch.unsubscribe($domain, $id);
        let replies = $client.send(&batch).await.unwrap();
        #[allow(non_snake_case)]
        let ($($name,)*) = tickets;
        $(
            if let Err(error) = replies.get($name.0) {
                wrong.push(format!("{} {}: {error}", stringify!($module), stringify!($name)));
            }
            match replies.subscribed($name.1) {
                Ok(results) => {
                    let object = results.objects().next().unwrap();
                    if let Err(error) = object.value($module::$name) {
                        wrong.push(format!("subscribed {} {}: {error}", stringify!($module), stringify!($name)));
                    }
                }
                Err(error) => wrong.push(format!("subscribe {} {}: {error}", stringify!($module), stringify!($name))),
            }
        )*
        wrong
    }};
}

#[tokio::test]
async fn every_variable_has_the_type_that_it_says() {
    let town = Town::new();
    let (_sumo, mut client) = town.launch().await;
    let mut batch = Batch::new();
    let walk =
        person::WalkingStage { edges: &["A1B1", "B1C1"], arrival_position: 30.0, ..Default::default() };
    person::add(&mut batch, "walker", &person::Add { edge: "A1B1", position: 10.0, ..Default::default() });
    person::append_walking_stage(&mut batch, "walker", &walk);
    let square = [(0.0, 0.0), (10.0, 0.0), (10.0, 10.0)].map(|(x, y)| Position2D { x, y });
    polygon::add(&mut batch, "park", &polygon::Add { shape: &square, fill: true, ..Default::default() });
    poi::add(&mut batch, "tree", &poi::Add { position: square[1], ..Default::default() });
    send(&mut client, &batch).await;
    steps(&mut client, 4).await;
    let mut wrong = Vec::new();
    wrong.extend(read_all!(
        client,
        vehicle::Vehicle,
        vehicle,
        "first",
        [
            SPEED,
            SPEED_LATERAL,
            ACCELERATION,
            SPEED_WITHOUT_TRACI,
            POSITION,
            POSITION_3D,
            ANGLE,
            SLOPE,
            ROAD_ID,
            LANE_ID,
            SHADOW_LANE_ID,
            LANE_INDEX,
            LANE_POSITION,
            LANE_POSITION_LATERAL,
            TYPE,
            ROUTE_ID,
            ROUTE_INDEX,
            ROUTE,
            ROUTE_VALID,
            VIA,
            ROUTING_MODE,
            COLOR,
            SIGNALS,
            DEPARTURE,
            DEPART_DELAY,
            CO2_EMISSION,
            CO_EMISSION,
            HC_EMISSION,
            PMX_EMISSION,
            NOX_EMISSION,
            FUEL_CONSUMPTION,
            NOISE_EMISSION,
            ELECTRICITY_CONSUMPTION,
            PERSON_NUMBER,
            PERSON_IDS,
            PERSON_CAPACITY,
            ALLOWED_SPEED,
            WAITING_TIME,
            ACCUMULATED_WAITING_TIME,
            TIME_LOSS,
            LANE_CHANGE_MODE,
            SPEED_MODE,
            LINE,
            LAST_ACTION_TIME,
            BEST_LANES,
            NEXT_TLS,
            NEXT_LINKS,
            STOP_STATE,
            STOP_DELAY,
            STOP_ARRIVAL_DELAY,
            DISTANCE,
            REFERENCE_DISTANCE,
            LENGTH,
            WIDTH,
            HEIGHT,
            MASS,
            MIN_GAP,
            MIN_GAP_LATERAL,
            MAX_SPEED,
            MAX_SPEED_LATERAL,
            ACCEL,
            DECEL,
            EMERGENCY_DECEL,
            APPARENT_DECEL,
            SPEED_FACTOR,
            SPEED_DEVIATION,
            TIME_HEADWAY,
            IMPERFECTION,
            IMPATIENCE,
            BOARDING_DURATION,
            ACTION_STEP_LENGTH,
            VEHICLE_CLASS,
            EMISSION_CLASS,
            SHAPE_CLASS,
            LATERAL_ALIGNMENT,
            LOADED_LIST,
            TELEPORTING_LIST
        ]
    ));
    wrong.extend(read_all!(
        client,
        person::Person,
        person,
        "walker",
        [
            SPEED,
            POSITION,
            POSITION_3D,
            ANGLE,
            SLOPE,
            ROAD_ID,
            LANE_ID,
            LANE_POSITION,
            TYPE,
            COLOR,
            WAITING_TIME,
            NEXT_EDGE,
            STAGES_REMAINING,
            VEHICLE,
            LENGTH,
            WIDTH,
            HEIGHT,
            MASS,
            MIN_GAP,
            MAX_SPEED,
            SPEED_FACTOR,
            IMPATIENCE,
            BOARDING_DURATION,
            VEHICLE_CLASS,
            SHAPE_CLASS,
            EMISSION_CLASS
        ]
    ));
    wrong.extend(read_all!(
        client,
        vehicle_type::VehicleType,
        vehicle_type,
        "car",
        [
            LENGTH,
            WIDTH,
            HEIGHT,
            MASS,
            MIN_GAP,
            MIN_GAP_LATERAL,
            MAX_SPEED,
            MAX_SPEED_LATERAL,
            ACCEL,
            DECEL,
            EMERGENCY_DECEL,
            APPARENT_DECEL,
            SPEED_FACTOR,
            SPEED_DEVIATION,
            TIME_HEADWAY,
            IMPERFECTION,
            IMPATIENCE,
            BOARDING_DURATION,
            ACTION_STEP_LENGTH,
            SCALE,
            VEHICLE_CLASS,
            EMISSION_CLASS,
            SHAPE_CLASS,
            LATERAL_ALIGNMENT,
            PERSON_CAPACITY,
            COLOR
        ]
    ));
    wrong.extend(read_all!(client, route::Route, route, "east", [EDGES]));
    wrong.extend(read_all!(
        client,
        edge::Edge,
        edge,
        "A1B1",
        [
            LANE_NUMBER,
            STREET_NAME,
            FROM_JUNCTION,
            TO_JUNCTION,
            BIDI_EDGE,
            TRAVEL_TIME,
            WAITING_TIME,
            CO2_EMISSION,
            CO_EMISSION,
            HC_EMISSION,
            PMX_EMISSION,
            NOX_EMISSION,
            FUEL_CONSUMPTION,
            NOISE_EMISSION,
            ELECTRICITY_CONSUMPTION,
            LAST_STEP_MEAN_SPEED,
            LAST_STEP_OCCUPANCY,
            LAST_STEP_LENGTH,
            LAST_STEP_VEHICLE_NUMBER,
            LAST_STEP_HALTING_NUMBER,
            LAST_STEP_VEHICLE_IDS,
            LAST_STEP_PERSON_IDS,
            PENDING_VEHICLES,
            FRICTION
        ]
    ));
    wrong.extend(read_all!(
        client,
        lane::Lane,
        lane,
        "A1B1_1",
        [
            LENGTH,
            WIDTH,
            MAX_SPEED,
            SHAPE,
            EDGE_ID,
            ALLOWED,
            DISALLOWED,
            LINK_NUMBER,
            LINKS,
            FRICTION,
            BIDI_LANE,
            CO2_EMISSION,
            CO_EMISSION,
            HC_EMISSION,
            PMX_EMISSION,
            NOX_EMISSION,
            FUEL_CONSUMPTION,
            NOISE_EMISSION,
            ELECTRICITY_CONSUMPTION,
            LAST_STEP_MEAN_SPEED,
            LAST_STEP_OCCUPANCY,
            LAST_STEP_LENGTH,
            LAST_STEP_VEHICLE_NUMBER,
            LAST_STEP_HALTING_NUMBER,
            LAST_STEP_VEHICLE_IDS,
            TRAVEL_TIME,
            WAITING_TIME,
            PENDING_VEHICLES
        ]
    ));
    wrong.extend(read_all!(
        client,
        junction::Junction,
        junction,
        "B1",
        [POSITION, POSITION_3D, SHAPE, INCOMING_EDGES, OUTGOING_EDGES]
    ));
    wrong.extend(read_all!(
        client,
        traffic_light::TrafficLight,
        traffic_light,
        "B1",
        [
            STATE,
            PHASE,
            PHASE_DURATION,
            PHASE_NAME,
            PROGRAM,
            NEXT_SWITCH,
            SPENT_DURATION,
            CONTROLLED_LANES,
            CONTROLLED_LINKS,
            CONTROLLED_JUNCTIONS,
            PROGRAMS
        ]
    ));
    wrong.extend(read_all!(
        client,
        polygon::Polygon,
        polygon,
        "park",
        [TYPE, SHAPE, COLOR, FILL, LINE_WIDTH]
    ));
    wrong.extend(read_all!(
        client,
        poi::Poi,
        poi,
        "tree",
        [TYPE, POSITION, COLOR, WIDTH, HEIGHT, ANGLE, IMAGE_FILE]
    ));
    wrong.extend(read_all!(
        client,
        simulation::Simulation,
        simulation,
        "",
        [
            TIME,
            END_TIME,
            TIME_STEP,
            DELTA_T,
            LOADED_NUMBER,
            LOADED_IDS,
            DEPARTED_NUMBER,
            DEPARTED_IDS,
            ARRIVED_NUMBER,
            ARRIVED_IDS,
            DEPARTED_PERSON_NUMBER,
            DEPARTED_PERSON_IDS,
            ARRIVED_PERSON_NUMBER,
            ARRIVED_PERSON_IDS,
            PARKING_STARTING_NUMBER,
            PARKING_STARTING_IDS,
            PARKING_ENDING_NUMBER,
            PARKING_ENDING_IDS,
            STOP_STARTING_NUMBER,
            STOP_STARTING_IDS,
            STOP_ENDING_NUMBER,
            STOP_ENDING_IDS,
            TELEPORT_STARTING_NUMBER,
            TELEPORT_STARTING_IDS,
            TELEPORT_ENDING_NUMBER,
            TELEPORT_ENDING_IDS,
            COLLIDING_NUMBER,
            COLLIDING_IDS,
            COLLISIONS,
            EMERGENCY_STOPPING_NUMBER,
            EMERGENCY_STOPPING_IDS,
            MIN_EXPECTED_NUMBER,
            PENDING_VEHICLES,
            NET_BOUNDARY,
            SCALE,
            BUS_STOP_IDS
        ]
    ));
    assert!(wrong.is_empty(), "{wrong:#?}");
    client.close().await.unwrap();
}

/// Puts a few things in, so that every domain has an object.
async fn furnish(client: &mut TcpClient) {
    let mut batch = Batch::new();
    let walk =
        person::WalkingStage { edges: &["A1B1", "B1C1"], arrival_position: 30.0, ..Default::default() };
    person::add(&mut batch, "walker", &person::Add { edge: "A1B1", position: 10.0, ..Default::default() });
    person::append_walking_stage(&mut batch, "walker", &walk);
    let square = [(0.0, 0.0), (10.0, 0.0), (10.0, 10.0)].map(|(x, y)| Position2D { x, y });
    polygon::add(&mut batch, "park", &polygon::Add { shape: &square, fill: true, ..Default::default() });
    poi::add(&mut batch, "tree", &poi::Add { position: square[1], ..Default::default() });
    send(client, &batch).await;
    steps(client, 4).await;
}

/// Sets and reads back.
macro_rules! round_trip {
    ($batch:expr, $checks:expr, $module:ident, $id:expr, [$($set:ident $get:ident = $value:expr => $expected:expr),* $(,)?]) => {
        $(
            $batch.set($module::$set, $id, $value);
            let ticket = $batch.get($module::$get, $id);
            let expected = $expected;
            $checks.push(Box::new(move |replies: &Replies| {
                let found = replies.get(ticket);
                let name = concat!(stringify!($module), " ", stringify!($set));
                (found.as_ref() != Ok(&expected)).then(|| format!("{name}: {expected:?} set, {found:?} read"))
            }));
        )*
    };
}

type Check = Box<dyn Fn(&Replies) -> Option<String>>;

#[tokio::test]
async fn what_is_set_is_read_back() {
    let town = Town::new();
    let (mut sumo, mut client) = town.launch().await;
    furnish(&mut client).await;
    let red = Color { r: 250, g: 3, b: 4, a: 200 };
    let mut batch = Batch::new();
    let mut checks: Vec<Check> = Vec::new();
    round_trip!(batch, checks, vehicle, "first", [
        SET_COLOR COLOR = red => red,
        SET_SIGNALS SIGNALS = 8 => 8,
        SET_SPEED_MODE SPEED_MODE = 0 => 0,
        SET_LANE_CHANGE_MODE LANE_CHANGE_MODE = 512 => 512,
        SET_LENGTH LENGTH = 6.5 => 6.5,
        SET_WIDTH WIDTH = 2.1 => 2.1,
        SET_HEIGHT HEIGHT = 1.9 => 1.9,
        SET_MASS MASS = 1700.0 => 1700.0,
        SET_MIN_GAP MIN_GAP = 3.5 => 3.5,
        SET_MIN_GAP_LATERAL MIN_GAP_LATERAL = 0.7 => 0.7,
        SET_MAX_SPEED MAX_SPEED = 40.0 => 40.0,
        SET_MAX_SPEED_LATERAL MAX_SPEED_LATERAL = 1.5 => 1.5,
        SET_ACCEL ACCEL = 3.0 => 3.0,
        SET_DECEL DECEL = 5.0 => 5.0,
        SET_EMERGENCY_DECEL EMERGENCY_DECEL = 9.5 => 9.5,
        SET_APPARENT_DECEL APPARENT_DECEL = 5.5 => 5.5,
        SET_SPEED_FACTOR SPEED_FACTOR = 1.25 => 1.25,
        SET_TIME_HEADWAY TIME_HEADWAY = 1.5 => 1.5,
        SET_IMPERFECTION IMPERFECTION = 0.25 => 0.25,
        SET_IMPATIENCE IMPATIENCE = 0.5 => 0.5,
        SET_BOARDING_DURATION BOARDING_DURATION = 3.0 => 3.0,
        SET_ACTION_STEP_LENGTH ACTION_STEP_LENGTH = 1.0 => 1.0,
        SET_VEHICLE_CLASS VEHICLE_CLASS = "taxi" => "taxi".to_owned(),
        SET_EMISSION_CLASS EMISSION_CLASS = "HBEFA3/PC_G_EU4" => "HBEFA3/PC_G_EU4".to_owned(),
        SET_SHAPE_CLASS SHAPE_CLASS = "truck" => "truck".to_owned(),
        SET_LATERAL_ALIGNMENT LATERAL_ALIGNMENT = "left" => "left".to_owned(),
        SET_LINE LINE = "12" => "12".to_owned(),
        SET_ROUTING_MODE ROUTING_MODE = 1 => 1,
        SET_VIA VIA = &["B1C1"] => vec!["B1C1".to_owned()],
        SET_ROUTE ROUTE = &["A1B1", "B1B2"] => vec!["A1B1".to_owned(), "B1B2".to_owned()],
        SET_TYPE TYPE = "DEFAULT_VEHTYPE" => "DEFAULT_VEHTYPE".to_owned(),
    ]);
    round_trip!(batch, checks, person, "walker", [
        SET_COLOR COLOR = red => red,
        SET_LENGTH LENGTH = 0.5 => 0.5,
        SET_WIDTH WIDTH = 0.6 => 0.6,
        SET_HEIGHT HEIGHT = 1.9 => 1.9,
        SET_MIN_GAP MIN_GAP = 0.5 => 0.5,
        SET_SPEED_FACTOR SPEED_FACTOR = 0.5 => 0.5,
    ]);
    round_trip!(batch, checks, vehicle_type, "car", [
        SET_LENGTH LENGTH = 4.0 => 4.0,
        SET_WIDTH WIDTH = 1.7 => 1.7,
        SET_HEIGHT HEIGHT = 1.4 => 1.4,
        SET_MASS MASS = 1600.0 => 1600.0,
        SET_MIN_GAP MIN_GAP = 2.0 => 2.0,
        SET_MIN_GAP_LATERAL MIN_GAP_LATERAL = 0.5 => 0.5,
        SET_MAX_SPEED MAX_SPEED = 50.0 => 50.0,
        SET_MAX_SPEED_LATERAL MAX_SPEED_LATERAL = 2.0 => 2.0,
        SET_ACCEL ACCEL = 2.0 => 2.0,
        SET_DECEL DECEL = 4.0 => 4.0,
        SET_EMERGENCY_DECEL EMERGENCY_DECEL = 8.0 => 8.0,
        SET_APPARENT_DECEL APPARENT_DECEL = 4.5 => 4.5,
        SET_SPEED_FACTOR SPEED_FACTOR = 1.1 => 1.1,
        SET_SPEED_DEVIATION SPEED_DEVIATION = 0.2 => 0.2,
        SET_TIME_HEADWAY TIME_HEADWAY = 1.2 => 1.2,
        SET_IMPERFECTION IMPERFECTION = 0.4 => 0.4,
        SET_IMPATIENCE IMPATIENCE = 0.1 => 0.1,
        SET_BOARDING_DURATION BOARDING_DURATION = 1.0 => 1.0,
        SET_ACTION_STEP_LENGTH ACTION_STEP_LENGTH = 0.5 => 0.5,
        SET_SCALE SCALE = 2.0 => 2.0,
        SET_VEHICLE_CLASS VEHICLE_CLASS = "bus" => "bus".to_owned(),
        SET_EMISSION_CLASS EMISSION_CLASS = "HBEFA3/PC_G_EU4" => "HBEFA3/PC_G_EU4".to_owned(),
        SET_SHAPE_CLASS SHAPE_CLASS = "bus" => "bus".to_owned(),
        SET_LATERAL_ALIGNMENT LATERAL_ALIGNMENT = "right" => "right".to_owned(),
        SET_COLOR COLOR = red => red,
    ]);
    round_trip!(batch, checks, edge, "A1B1", [
        SET_FRICTION FRICTION = 0.5 => 0.5,
    ]);
    round_trip!(batch, checks, lane, "A1B1_1", [
        SET_MAX_SPEED MAX_SPEED = 9.0 => 9.0,
        SET_LENGTH LENGTH = 120.0 => 120.0,
        SET_ALLOWED ALLOWED = &["bus"] => vec!["bus".to_owned()],
    ]);
    let state = "r".repeat(32);
    let shape: Vec<Position2D> =
        (0..300).map(|i| Position2D { x: f64::from(i), y: f64::from(i * i) }).collect();
    round_trip!(batch, checks, polygon, "park", [
        SET_TYPE TYPE = "wood" => "wood".to_owned(),
        SET_SHAPE SHAPE = &shape => shape.clone(),
        SET_COLOR COLOR = red => red,
        SET_FILL FILL = false => false,
        SET_LINE_WIDTH LINE_WIDTH = 2.0 => 2.0,
    ]);
    round_trip!(batch, checks, poi, "tree", [
        SET_TYPE TYPE = "oak" => "oak".to_owned(),
        SET_POSITION POSITION = shape[3] => shape[3],
        SET_COLOR COLOR = red => red,
        SET_WIDTH WIDTH = 3.0 => 3.0,
        SET_HEIGHT HEIGHT = 4.0 => 4.0,
        SET_ANGLE ANGLE = 45.0 => 45.0,
        SET_IMAGE_FILE IMAGE_FILE = "oak.png" => "oak.png".to_owned(),
    ]);
    let light_state = batch.get(traffic_light::STATE, "B1");
    round_trip!(batch, checks, simulation, "", [SET_SCALE SCALE = 2.0 => 2.0]);
    let replies = send(&mut client, &batch).await;
    let wrong: Vec<String> = checks.iter().filter_map(|check| check(&replies)).collect();
    assert!(wrong.is_empty(), "{wrong:#?}");

    let state = state[..replies.get(light_state).unwrap().len()].to_owned();
    batch.clear();
    let mut checks: Vec<Check> = Vec::new();
    round_trip!(batch, checks, traffic_light, "B1", [
        SET_STATE STATE = &state => state.clone(),
        SET_PROGRAM PROGRAM = "0" => "0".to_owned(),
        SET_PHASE PHASE = 1 => 1,
        SET_PHASE_NAME PHASE_NAME = "mine" => "mine".to_owned(),
    ]);
    batch.set(traffic_light::SET_PHASE_DURATION, "B1", 17.0);
    batch.set(edge::SET_MAX_SPEED, "A1B1", 11.0);
    batch.set(edge::SET_DISALLOWED, "C1C2", &["bus"]);
    batch.set(edge::SET_ALLOWED, "C1C2", &["passenger"]);
    batch.set(lane::SET_DISALLOWED, "C1C2_1", &["bus"]);
    batch.set(simulation::WRITE_MESSAGE, "", "hello from the test");
    batch.set(simulation::CLEAR_PENDING, "", "");
    let replies = send(&mut client, &batch).await;
    let wrong: Vec<String> = checks.iter().filter_map(|check| check(&replies)).collect();
    assert!(wrong.is_empty(), "{wrong:#?}");
    assert_eq!(client.get(lane::MAX_SPEED, "A1B1_2").await.unwrap(), 11.0);
    client.close().await.unwrap();
    assert!(sumo.wait_at_most(Duration::from_secs(10)).await.is_some());
    assert!(sumo.log_tail().contains("hello from the test"), "{}", sumo.log_tail());
}

#[tokio::test]
async fn getters_with_parameters() {
    let town = Town::new();
    let (_sumo, mut client) = town.launch().await;
    furnish(&mut client).await;
    let place = RoadPosition { edge: "B1C1".to_owned(), position: 10.0, lane_index: 1 };
    let origin = RoadPosition { edge: "A1B1".to_owned(), position: 0.0, lane_index: 1 };
    let (a, b) = (Position2D { x: 0.0, y: 0.0 }, Position2D { x: 30.0, y: 40.0 });
    let mut batch = Batch::new();
    vehicle::set_parameter(&mut batch, "first", "colour", "blue");
    let parameter = batch.get_with(vehicle::parameter("colour"), "first");
    let with_key = batch.get_with(vehicle::parameter_with_key("colour"), "first");
    let leader = batch.get_with(vehicle::leader(100.0), "second");
    let no_leader = batch.get_with(vehicle::leader(50.0), "first");
    let follower = batch.get_with(vehicle::follower(100.0), "first");
    let neighbors = batch.get_with(vehicle::neighbors(2), "first");
    let foes = batch.get_with(vehicle::junction_foes(200.0), "first");
    vehicle::set_stop(
        &mut batch,
        "first",
        &vehicle::SetStop {
            place: "B1C1",
            position: 50.0,
            lane_index: 1,
            duration: 20.0,
            ..Default::default()
        },
    );
    let stops = batch.get_with(vehicle::stops(0), "first");
    let change = batch.get_with(vehicle::lane_change_state(1), "first");
    let driving = batch.get_with(vehicle::driving_distance(&place), "first");
    let driving_2d = batch.get_with(vehicle::driving_distance_2d(Position2D { x: 200.0, y: 150.0 }), "first");
    vehicle::set_adapted_travel_time(&mut batch, "first", "B1C1", 77.0, 0.0, 500.0);
    vehicle::set_effort(&mut batch, "first", "B1C1", 7.0, 0.0, 500.0);
    let travel = batch.get_with(vehicle::adapted_travel_time(10.0, "B1C1"), "first");
    let effort = batch.get_with(vehicle::effort(10.0, "B1C1"), "first");
    let follow = batch.get_with(vehicle::follow_speed(10.0, 20.0, 5.0, 4.5, "first"), "second");
    let gap = batch.get_with(vehicle::secure_gap(10.0, 5.0, 4.5, "first"), "second");
    let stop_speed = batch.get_with(vehicle::stop_speed(10.0, 20.0), "second");
    let taxis = batch.get_with(vehicle::taxi_fleet(-1), "");
    let stage = batch.get_with(person::stage(0), "walker");
    let edges = batch.get_with(person::edges(0), "walker");
    let reservations = batch.get_with(person::taxi_reservations(0), "");
    edge::adapt_travel_time(&mut batch, "B1C1", 55.0, 0.0, 500.0);
    edge::set_effort(&mut batch, "B1C1", 5.0, 0.0, 500.0);
    let edge_travel = batch.get_with(edge::adapted_travel_time(10.0), "B1C1");
    let edge_effort = batch.get_with(edge::effort(10.0), "B1C1");
    let edge_angle = batch.get_with(edge::angle(5.0), "A1B1");
    let lane_angle = batch.get_with(lane::angle(5.0), "B1B2_1");
    lane::set_change_permissions(&mut batch, "A1B1_1", &["bus"], 1);
    let permissions = batch.get_with(lane::change_permissions(1), "A1B1_1");
    let lane_foes = batch.get_with(lane::foes("B1C1_1"), "A1B1_1");
    let blocking = batch.get_with(traffic_light::blocking_vehicles(0), "B1");
    let waiting = batch.get_with(traffic_light::waiting_persons(0), "B1");
    let point = batch.get_with(simulation::to_2d(&place), "");
    let point_3d = batch.get_with(simulation::to_3d(&place), "");
    let road = batch.get_with(simulation::to_road(Position2D { x: 160.0, y: 145.0 }, "passenger"), "");
    let air = batch.get_with(simulation::distance_2d(a, b, simulation::DistanceKind::Air), "");
    let far =
        batch.get_with(simulation::distance_road(&origin, &place, simulation::DistanceKind::Driving), "");
    let route = batch.get_with(simulation::find_route("A1B1", "C1C2", "car"), "");
    let walk = batch.get_with(simulation::find_intermodal_route("A1B1", "B1C1", ""), "");
    let option = batch.get(simulation::OPTION, "step-length");
    let replies = send(&mut client, &batch).await;

    assert_eq!(replies.get(parameter).unwrap(), "blue");
    let with_key = replies.get(with_key).unwrap();
    assert_eq!((with_key.key.as_str(), with_key.value.as_str()), ("colour", "blue"));
    let leader = replies.get(leader).unwrap().unwrap();
    assert!(leader.id == "first" && leader.gap > 0.0 && leader.gap < 20.0, "{leader:?}");
    assert_eq!(replies.get(no_leader).unwrap(), None);
    assert_eq!(replies.get(follower).unwrap().unwrap().id, "second");
    assert_eq!(replies.get(neighbors).unwrap(), vec![]);
    replies.get(foes).unwrap();
    let stops = replies.get(stops).unwrap();
    assert_eq!((stops.len(), stops[0].lane.as_str(), stops[0].duration), (1, "B1C1_1", 20.0));
    replies.get(change).unwrap();
    let driving = replies.get(driving).unwrap();
    assert!((100.0..200.0).contains(&driving), "{driving}");
    assert!(replies.get(driving_2d).unwrap() > 20.0);
    assert_eq!((replies.get(travel).unwrap(), replies.get(effort).unwrap()), (77.0, 7.0));
    assert!(replies.get(follow).unwrap() > 0.0);
    assert!(replies.get(gap).unwrap() > 0.0);
    assert!(replies.get(stop_speed).unwrap() > 0.0);
    assert_eq!(replies.get(taxis).unwrap(), Vec::<String>::new());
    let stage = replies.get(stage).unwrap();
    assert_eq!((stage.kind, stage.arrival_position), (StageKind::Walking, 30.0));
    assert_eq!(replies.get(edges).unwrap().first().unwrap(), "A1B1");
    assert_eq!(replies.get(reservations).unwrap(), vec![]);
    assert_eq!((replies.get(edge_travel).unwrap(), replies.get(edge_effort).unwrap()), (55.0, 5.0));
    assert_eq!(replies.get(edge_angle).unwrap(), 90.0);
    assert_eq!(replies.get(lane_angle).unwrap().rem_euclid(360.0), 0.0);
    assert_eq!(replies.get(permissions).unwrap(), vec!["bus"]);
    replies.get(lane_foes).unwrap();
    assert_eq!(replies.get(blocking).unwrap(), Vec::<String>::new());
    assert_eq!(replies.get(waiting).unwrap(), 0);
    let (point, point_3d) = (replies.get(point).unwrap(), replies.get(point_3d).unwrap());
    assert_eq!((point.x, point.y, 0.0), (point_3d.x, point_3d.y, point_3d.z));
    assert_eq!(replies.get(road).unwrap().edge, "B1C1");
    assert_eq!(replies.get(air).unwrap(), 50.0);
    assert!((100.0..200.0).contains(&replies.get(far).unwrap()));
    assert_eq!(replies.get(route).unwrap().edges, ["A1B1", "B1C1", "C1C2"]);
    let walk = replies.get(walk).unwrap();
    assert_eq!((walk.len(), walk[0].kind), (1, StageKind::Walking));
    assert_eq!(replies.get(option).unwrap(), "0.5");

    batch.clear();
    vehicle::change_lane(&mut batch, "second", 2, 10.0);
    batch.step();
    send(&mut client, &batch).await;
    batch.clear();
    let right_ahead = batch.get_with(vehicle::neighbors(3), "second");
    let left_behind = batch.get_with(vehicle::neighbors(0), "first");
    let replies = send(&mut client, &batch).await;
    let (ahead, behind) = (replies.get(right_ahead).unwrap(), replies.get(left_behind).unwrap());
    assert_eq!((ahead[0].id.as_str(), ahead.len()), ("first", 1));
    assert_eq!((behind[0].id.as_str(), behind.len()), ("second", 1));
    assert!(ahead[0].gap > 0.0 && ahead[0].gap < 20.0, "{ahead:?}");
}
