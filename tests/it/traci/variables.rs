//! Getters of every domain.

use super::{Town, furnish, send};
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
    furnish(&mut client).await;
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
    lane::set_change_permissions(&mut batch, "C1C2_1", &["bus"], 1);
    let permissions = batch.get_with(lane::change_permissions(1), "C1C2_1");
    let lane_foes = batch.get_with(lane::foes("B1C1_1"), "A1B1_1");
    let blocking = batch.get_with(traffic_light::blocking_vehicles(0), "B1");
    let waiting = batch.get_with(traffic_light::waiting_persons(0), "B1");
    let point = batch.get_with(simulation::to_2d(&place), "");
    let point_3d = batch.get_with(simulation::to_3d(&place), "");
    let road = batch.get_with(simulation::to_road(Position2D { x: 220.0, y: 145.0 }, "passenger"), "");
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
    // Round B1C1, whose travel time was set to 55 s above.
    assert_eq!(replies.get(route).unwrap().edges, ["A1B1", "B1B0", "B0C0", "C0C1", "C1C2"]);
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
