//! Setters of every domain.

use super::{Town, furnish, send};
use wad_cosim::traci::*;

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
    let (_sumo, mut client) = town.launch().await;
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
}
