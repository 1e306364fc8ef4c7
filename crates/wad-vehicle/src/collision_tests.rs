//! The ego among other road users, walls and kerbs.

use super::*;
use proptest::prelude::*;
use std::f64::consts::FRAC_PI_2;
use sumo_network::geometry::{Point, Pose, Vector};

const COAST: Control = Control { throttle: 0.0, steer: 0.0, brake: 0.0, reverse: false };
const FULL_THROTTLE: Control = Control { throttle: 1.0, ..COAST };

fn ego(speed: f64) -> EgoVehicle {
    EgoVehicle::new(EgoParams::default(), Pose::new(0.0, 0.0, 0.0, 0.0), speed)
}

fn car(key: u64, x: f64, y: f64, heading: f64, speed: f64) -> MovingBody {
    let pose = Pose::new(x, y, 0.0, heading);
    let (acceleration, turn_rate) = (0.0, 0.0);
    MovingBody {
        key,
        kind: PartnerKind::Vehicle,
        pose,
        speed,
        acceleration,
        turn_rate,
        length: 4.5,
        width: 1.8,
        height: 1.5,
    }
}

fn pedestrian(key: u64, x: f64, y: f64, heading: f64, speed: f64) -> MovingBody {
    MovingBody {
        kind: PartnerKind::Pedestrian,
        length: 0.4,
        width: 0.5,
        height: 1.75,
        ..car(key, x, y, heading, speed)
    }
}

fn block(key: u64, kind: StaticKind, centre: (f64, f64), size: (f64, f64), top: f64) -> StaticBody {
    let (x, y) = centre;
    let outline = [(0.5, 0.5), (-0.5, 0.5), (-0.5, -0.5), (0.5, -0.5)]
        .iter()
        .map(|(i, j)| Point::new(x + i * size.0, y + j * size.1))
        .collect();
    StaticBody { key, label: format!("block {key}"), kind, outline, bottom: 0.0, top, elevation: None }
}

fn wall_at(x: f64) -> StaticBody {
    block(7, StaticKind::Building, (x + 5.0, 0.0), (10.0, 600.0), 8.0)
}

fn kerb_at(x: f64) -> StaticBody {
    block(9, StaticKind::Kerb, (x, 0.0), (0.2, 60.0), 0.13)
}

/// Kinetic energy of the horizontal motion and the turn (J).
fn energy(ego: &EgoVehicle) -> f64 {
    let (state, params) = (ego.state(), ego.params());
    // About the centre of mass, which is ahead of the footprint's centre.
    let across = state.lateral_speed + state.yaw_rate * params.mass_offset();
    let motion = state.speed * state.speed + across * across;
    0.5 * (params.mass * motion + params.inertia()[2] * state.yaw_rate * state.yaw_rate)
}

/// Ticks of 0.1 s, the bodies keeping their velocity; all contacts.
fn run(ego: &mut EgoVehicle, control: Control, bodies: &mut [MovingBody], ticks: usize) -> Vec<Contact> {
    let mut contacts = Vec::new();
    for _ in 0..ticks {
        contacts.extend(ego.tick(control, 0.1, bodies));
        for body in bodies.iter_mut() {
            body.pose = body.pose.advanced(0.1 * body.speed);
        }
    }
    contacts
}

fn impulse_of(contacts: &[Contact]) -> f64 {
    contacts.iter().map(|c| c.impulse).sum()
}

#[test]
fn a_standing_car_takes_all_momentum() {
    let mut ego = ego(10.0);
    let mass = ego.params().mass;
    let contacts = run(&mut ego, COAST, &mut [car(3, 12.0, 0.0, 0.0, 0.0)], 30);
    let impulse = impulse_of(&contacts);
    println!("10 m/s into a standing car: {impulse:.0} N s, m v = {:.0} N s", mass * 10.0);
    assert!(contacts.iter().all(|c| (c.kind, c.key) == (PartnerKind::Vehicle, 3)));
    assert!((0.9 * mass * 10.0..1.1 * mass * 10.0).contains(&impulse), "{impulse} N s");
    assert!((contacts[0].point - Vector::new(2.35, 0.0)).norm() < 0.15, "{:?}", contacts[0].point);
    assert!(ego.state().speed < 0.01 && ego.state().speed > -1.0);
    assert!(ego.state().pose.position.x + 2.35 < 12.0 - 2.25 + 0.05, "stands inside the car");
}

#[test]
fn a_car_ahead_at_the_same_speed_is_not_touched() {
    let mut ego = ego(10.0);
    let contacts = run(&mut ego, COAST, &mut [car(3, 5.0, 0.0, 0.0, 10.0)], 20);
    assert!(contacts.is_empty(), "{contacts:?}");
}

#[test]
fn passing_close_is_no_contact() {
    let mut ego = ego(15.0);
    let statics = vec![block(1, StaticKind::Building, (30.0, -4.0), (40.0, 6.0), 5.0)];
    ego.set_statics(statics);
    // 7.5 cm to the wall on the right, 17.5 cm to the oncoming car on the left.
    let contacts = run(&mut ego, COAST, &mut [car(3, 40.0, 2.0, std::f64::consts::PI, 12.0)], 40);
    assert!(contacts.is_empty(), "{contacts:?}");
    assert!(ego.state().pose.position.y.abs() < 0.01);
}

#[test]
fn a_rear_end_pushes_the_ego_no_faster_than_the_other_drives() {
    let mut ego = ego(0.0);
    let mass = ego.params().mass;
    let mut others = [car(4, -10.0, 0.0, 0.0, 8.0)];
    let mut first = None;
    for _ in 0..40 {
        let contacts = run(&mut ego, COAST, &mut others, 1);
        first = first.or(contacts.first().copied());
        assert!(ego.state().velocity.norm() < 8.0 + 0.05, "{}", ego.state().speed);
    }
    let first = first.expect("a contact");
    assert!((0.9 * mass * 8.0..1.15 * mass * 8.0).contains(&first.impulse), "{}", first.impulse);
    assert!(first.point.x < -2.3);
}

/// It was once taken to keep its speed through the tick.
#[test]
fn an_ego_that_brakes_in_a_long_tick_is_hit_from_behind() {
    let mut ego = ego(15.0);
    // A metre behind the ego, as fast.
    let contacts = ego.tick(Control { brake: 1.0, ..COAST }, 1.0, &[car(4, -5.6, 0.0, 0.0, 15.0)]);
    assert!(contacts.iter().any(|c| c.key == 4 && c.point.x < -2.0), "{contacts:?}");
}

#[test]
fn a_side_hit_is_reported_on_that_side() {
    let mut ego = ego(0.0);
    let contacts = run(&mut ego, COAST, &mut [car(4, 0.5, -12.0, FRAC_PI_2, 7.0)], 20);
    assert!(contacts[0].point.y < -0.9, "{:?}", contacts[0]);
    assert!((8000.0..13_000.0).contains(&contacts[0].impulse), "{}", contacts[0].impulse);
    assert!(ego.state().velocity.norm() < 7.05);
    assert!(ego.state().roll.abs() < 0.3);
}

#[test]
fn a_pedestrian_costs_the_ego_little_speed_and_is_hit_once() {
    let mut ego = ego(10.0);
    let contacts = run(&mut ego, COAST, &mut [pedestrian(5, 10.0, 0.4, FRAC_PI_2, 0.0)], 20);
    let hits: Vec<_> = contacts.iter().filter(|contact| contact.impulse > 0.0).collect();
    assert_eq!(hits.len(), 1, "{contacts:?}");
    let hit = hits[0];
    println!("10 m/s into a pedestrian: {:.0} N s", hit.impulse);
    assert_eq!((hit.kind, hit.key), (PartnerKind::Pedestrian, 5));
    let reduced = 1500.0 * 75.0 / 1575.0;
    assert!((hit.impulse / (reduced * 9.7) - 1.0).abs() < 0.05, "{}", hit.impulse);
    assert!((hit.point - Vector::new(2.35, 0.4)).norm() < 0.05, "{:?}", hit.point);
    assert!((8.0..9.3).contains(&ego.state().speed), "{}", ego.state().speed);
}

#[test]
fn a_pedestrian_who_walks_into_a_standing_ego_is_a_light_touch() {
    let mut ego = ego(0.0);
    let contacts = run(&mut ego, COAST, &mut [pedestrian(5, 0.0, -3.0, FRAC_PI_2, 1.4)], 30);
    assert!((80.0..120.0).contains(&contacts[0].impulse), "{}", contacts[0].impulse);
    assert!(contacts[0].point.y < -0.9);
    assert!(contacts[1..].iter().all(|contact| contact.impulse == 0.0), "{contacts:?}");
}

/// Nothing was said of them after the touch, so that the next touch of theirs counted as another collision.
#[test]
fn a_pedestrian_who_leans_on_the_ego_touches_it_all_along() {
    let mut ego = ego(0.0);
    let mut walker = [pedestrian(5, 0.0, -1.2, FRAC_PI_2, 2.0)];
    assert!(impulse_of(&run(&mut ego, COAST, &mut walker, 1)) > 0.0);
    walker[0].speed = 0.0;
    let contacts = run(&mut ego, COAST, &mut walker, 30);
    assert!(contacts.len() == 30 && impulse_of(&contacts) == 0.0, "{contacts:?}");
}

#[test]
fn a_pedestrian_walking_away_ahead_of_the_bumper_is_not_hit() {
    let mut ego = ego(0.0);
    let contacts = run(&mut ego, COAST, &mut [pedestrian(5, 2.45, 0.0, 0.0, 1.4)], 10);
    assert!(contacts.is_empty());
}

#[test]
fn a_wall_stops_the_ego_and_holds_it_at_full_throttle() {
    let mut ego = ego(15.0);
    ego.set_statics(vec![wall_at(15.0)]);
    let contacts = run(&mut ego, COAST, &mut [], 12);
    assert!(contacts.iter().all(|c| (c.kind, c.key) == (PartnerKind::Static, 7)));
    let impulse = impulse_of(&contacts);
    assert!((0.9 * 1500.0 * 14.5..1.15 * 1500.0 * 15.0).contains(&impulse), "{impulse} N s");
    run(&mut ego, FULL_THROTTLE, &mut [], 20);
    let at = ego.state().pose.position;
    run(&mut ego, FULL_THROTTLE, &mut [], 100);
    let after = ego.state().pose.position;
    assert!((after - at).norm() < 0.1, "crept {} m", (after - at).norm());
    assert!((after.x + 2.35 - 15.0).abs() < 0.1, "bumper at {} m", after.x + 2.35);
}

#[test]
fn nothing_is_tunnelled_through_at_motorway_speed() {
    for thickness in [0.3, 1.0, 10.0] {
        let mut ego = ego(40.0);
        let wall = block(7, StaticKind::Barrier, (30.0, 0.0), (thickness, 60.0), 1.0);
        ego.set_statics(vec![wall]);
        run(&mut ego, COAST, &mut [], 50);
        assert!(ego.state().pose.position.x < 30.0, "{thickness} m wall: {:?}", ego.state().pose);
        assert!(ego.state().speed.abs() < 2.0);
    }
}

#[test]
fn a_pole_stops_the_ego_where_it_was_hit() {
    let mut ego = ego(12.0);
    ego.set_statics(vec![block(2, StaticKind::Pole, (20.0, 0.6), (0.2, 0.2), 6.0)]);
    let contacts = run(&mut ego, COAST, &mut [], 40);
    assert!((contacts[0].point - Vector::new(2.35, 0.6)).norm() < 0.3, "{:?}", contacts[0].point);
    assert!(ego.state().pose.position.x < 18.0);
}

#[test]
fn a_scrape_along_a_wall_is_reported_and_slows() {
    let mut ego = ego(15.0);
    ego.set_statics(vec![block(8, StaticKind::Building, (60.0, 4.5), (120.0, 6.0), 5.0)]);
    let control = Control { steer: 0.06, ..COAST };
    let contacts = run(&mut ego, control, &mut [], 40);
    assert!(contacts.len() > 5, "{} contacts", contacts.len());
    assert!(contacts.iter().all(|c| c.key == 8 && c.point.y > 0.85), "{contacts:?}");
    assert!((3.0..13.5).contains(&ego.state().speed), "{}", ego.state().speed);
    assert!(ego.state().pose.position.y < 0.7);
}

#[test]
fn a_kerb_slows_and_jolts_but_is_passed_and_is_no_contact() {
    let (mut plain, mut kerbed) = (ego(6.0), ego(6.0));
    kerbed.set_statics(vec![kerb_at(6.0)]);
    let mut jolt: f64 = 0.0;
    for _ in 0..30 {
        assert!(kerbed.tick(COAST, 0.1, &[]).is_empty());
        plain.tick(COAST, 0.1, &[]);
        jolt = jolt.max(kerbed.state().pitch.abs());
    }
    let (plain, kerbed) = (plain.state(), kerbed.state());
    println!("over a 13 cm kerb from 6 m/s: {:.2} m/s instead of {:.2} m/s", kerbed.speed, plain.speed);
    assert!(kerbed.pose.position.x > 10.0, "stuck at {}", kerbed.pose.position.x);
    assert!(kerbed.speed < plain.speed - 0.3);
    assert!(jolt > 0.02, "pitched {jolt} rad");
    assert!(kerbed.pose.position.y.abs() < 0.05, "pushed aside by {} m", kerbed.pose.position.y);
}

#[test]
fn a_kerb_is_climbed_from_rest_with_throttle_but_not_by_rolling() {
    let mut slow = ego(1.0);
    slow.set_statics(vec![kerb_at(2.5)]);
    run(&mut slow, COAST, &mut [], 80);
    assert!(slow.state().pose.position.x < 2.0, "{}", slow.state().pose.position.x);
    run(&mut slow, Control { throttle: 0.8, ..COAST }, &mut [], 40);
    assert!(slow.state().pose.position.x > 5.0, "{}", slow.state().pose.position.x);
}

#[test]
fn an_ego_pressed_against_a_wall_is_neither_shot_away_nor_pushed_through() {
    let mut ego = ego(0.0);
    ego.set_statics(vec![wall_at(4.0)]);
    let mut others = [car(4, -12.0, 0.3, 0.0, 8.0)];
    for _ in 0..40 {
        for contact in run(&mut ego, COAST, &mut others, 1) {
            assert!(contact.impulse < 3.0 * 1500.0 * 8.0, "{contact:?}");
        }
        assert!(ego.state().velocity.norm() < 8.1);
        assert!(ego.state().pose.position.x + 2.35 < 4.6, "{:?}", ego.state().pose);
    }
    assert!(ego.state().velocity.norm() < 1.5);
    // The other has gone through and is gone; the ego can drive on.
    assert!(others[0].pose.position.x > 10.0);
    ego.respawn(Pose::new(-20.0, 0.0, 0.0, std::f64::consts::PI), 0.0);
    run(&mut ego, FULL_THROTTLE, &mut [], 30);
    assert!(ego.state().speed > 5.0);
}

#[test]
fn a_body_that_was_let_through_collides_again_once_apart() {
    let mut ego = ego(0.0);
    ego.set_statics(vec![wall_at(3.0)]);
    let mut others = [car(4, -12.0, 0.0, 0.0, 8.0)];
    run(&mut ego, COAST, &mut others, 40);
    others[0] = car(4, ego.state().pose.position.x - 8.0, 0.0, 0.0, 0.0);
    run(&mut ego, COAST, &mut others, 2);
    others[0].speed = 3.0;
    let contacts = run(&mut ego, COAST, &mut others, 15);
    assert!(contacts.iter().any(|c| c.kind == PartnerKind::Vehicle && c.impulse > 1000.0), "{contacts:?}");
}

#[test]
fn a_car_that_appears_inside_the_ego_eases_it_out() {
    let mut ego = ego(0.0);
    let mut others = [car(4, 1.5, 0.5, 0.4, 0.0)];
    for _ in 0..60 {
        run(&mut ego, COAST, &mut others, 1);
        assert!(ego.state().velocity.norm() < 0.5, "{}", ego.state().velocity.norm());
    }
    assert!(ego.state().pose.position.coords.norm() > 0.5);
    assert!(ego.state().roll.abs() < 0.05);
}

#[test]
fn far_away_statics_are_there_when_the_ego_arrives() {
    let mut ego = ego(20.0);
    let mut bodies: Vec<StaticBody> =
        (0..3000u64).map(|i| block(100 + i, StaticKind::Kerb, (i as f64, 6.0), (1.0, 0.2), 0.13)).collect();
    bodies.push(block(7, StaticKind::Building, (705.0, 0.0), (10.0, 20.0), 8.0));
    ego.set_statics(bodies);
    let mut contacts = Vec::new();
    for _ in 0..600 {
        contacts.extend(ego.tick(Control { throttle: 0.3, ..COAST }, 0.1, &[]));
        assert!(ego.simulated_colliders() < 150, "{} colliders", ego.simulated_colliders());
    }
    assert!(contacts.iter().all(|c| c.key == 7) && !contacts.is_empty());
    assert!((ego.state().pose.position.x + 2.35 - 700.0).abs() < 0.5, "{:?}", ego.state().pose);
}

#[test]
fn other_levels_are_passed_under() {
    let bridge_kerb = StaticBody { elevation: Some(6.0), ..kerb_at(8.0) };
    let pier =
        StaticBody { elevation: Some(6.0), ..block(2, StaticKind::Pole, (12.0, 0.0), (0.3, 0.3), 6.0) };
    let mut above = car(1, 16.0, 0.0, FRAC_PI_2, 0.0);
    above.pose.position.z = 6.0;
    for (elevation, free) in [(Some(0.2), true), (Some(5.0), false), (None, false)] {
        let mut ego = ego(8.0);
        ego.set_statics(vec![bridge_kerb.clone(), pier.clone()]);
        ego.set_elevation(elevation);
        let contacts = run(&mut ego, COAST, &mut [above], 30);
        assert_eq!(contacts.is_empty(), free, "{elevation:?}: {contacts:?}");
        assert_eq!(ego.state().pose.position.x > 15.0, free);
        assert_eq!(ego.state().pose.position.z, elevation.unwrap_or(0.0));
    }
}

#[test]
fn an_l_shaped_building_has_room_in_its_corner() {
    let corner = [(10.0, -20.0), (30.0, -20.0), (30.0, 20.0), (20.0, 20.0), (20.0, -2.0), (10.0, -2.0)];
    let outline = corner.iter().map(|&(x, y)| Point::new(x, y)).collect();
    let mut ego = ego(8.0);
    let label = "l".to_owned();
    let kind = StaticKind::Building;
    ego.set_statics(vec![StaticBody {
        key: 1,
        label,
        kind,
        outline,
        bottom: 0.0,
        top: 9.0,
        elevation: None,
    }]);
    let contacts = run(&mut ego, COAST, &mut [], 40);
    assert!(!contacts.is_empty());
    assert!((ego.state().pose.position.x + 2.35 - 20.0).abs() < 1.0, "{:?}", ego.state().pose);
}

#[test]
fn crashes_repeat_bit_for_bit_also_after_a_respawn() {
    let drive = |ego: &mut EgoVehicle| -> Vec<u64> {
        let mut others =
            [car(1, 25.0, 0.8, 0.0, 2.0), car(2, 30.0, -6.0, 2.0, 4.0), pedestrian(3, 18.0, 0.0, 1.5, 0.5)];
        let mut numbers = Vec::new();
        for _ in 0..60 {
            let contacts =
                run(ego, Control { throttle: 0.6, steer: 0.02, brake: 0.0, reverse: false }, &mut others, 1);
            numbers.extend(contacts.iter().flat_map(|c| [c.key, c.impulse.to_bits(), c.point.x.to_bits()]));
            let state = ego.state();
            numbers.extend([state.pose.position.x, state.pose.position.y, state.roll].map(f64::to_bits));
        }
        numbers
    };
    let statics = || vec![kerb_at(9.0), block(7, StaticKind::Building, (50.0, 0.0), (4.0, 60.0), 6.0)];
    let mut ego = ego(12.0);
    ego.set_statics(statics());
    let first = drive(&mut ego);
    ego.respawn(Pose::new(0.0, 0.0, 0.0, 0.0), 12.0);
    assert_eq!(first, drive(&mut ego));
}

#[test]
fn unusable_bodies_are_passed_over() {
    let mut ego = ego(5.0);
    let mut bodies = [car(1, 3.0, 0.0, 0.0, f64::NAN), car(2, f64::INFINITY, 0.0, 0.0, 1.0)];
    let mut flat = car(3, 3.0, 0.0, 0.0, 0.0);
    flat.length = 0.0;
    assert!(run(&mut ego, COAST, &mut bodies, 5).is_empty());
    assert!(run(&mut ego, COAST, &mut [flat], 5).is_empty());
    assert!(ego.state().speed > 4.0);
}

#[test]
fn an_ego_on_its_roof_is_back_on_its_wheels_soon() {
    let mut ego = ego(0.0);
    ego.overturn();
    ego.tick(COAST, 0.1, &[]);
    assert!(ego.state().roll.abs() > 1.0, "{}", ego.state().roll);
    run(&mut ego, COAST, &mut [], 15);
    assert!(ego.state().roll.abs() < 0.05);
    run(&mut ego, FULL_THROTTLE, &mut [], 20);
    assert!(ego.state().speed > 3.0);
}

fn body() -> impl Strategy<Value = MovingBody> {
    (0..40u64, -15.0..30.0f64, -8.0..8.0f64, -3.2..3.2f64, 0.0..15.0f64, 0..3usize).prop_map(
        |(key, x, y, heading, speed, kind)| match kind {
            0 => pedestrian(key, x, y, heading, 0.1 * speed),
            1 => MovingBody { length: 12.0, width: 2.5, height: 3.2, ..car(key, x, y, heading, speed) },
            _ => car(key, x, y, heading, speed),
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(100))]

    #[test]
    fn no_crash_makes_the_ego_fly_spin_or_vanish(
        speed in 0.0..35.0f64,
        throttle in 0.0..1.0f64,
        steer in -1.0..1.0f64,
        mut bodies in prop::collection::vec(body(), 0..6),
        pole in (5.0..30.0f64, -3.0..3.0f64),
    ) {
        let mut ego = ego(speed);
        ego.set_statics(vec![
            wall_at(45.0),
            block(8, StaticKind::Building, (0.0, 14.0), (100.0, 6.0), 5.0),
            block(2, StaticKind::Pole, pole, (0.3, 0.3), 6.0),
            kerb_at(20.0),
        ]);
        let mut fastest: f64 = speed;
        for body in &bodies {
            fastest = fastest.max(body.speed);
        }
        for _ in 0..50 {
            run(&mut ego, Control { throttle, steer, brake: 0.0, reverse: false }, &mut bodies, 1);
            let state = ego.state();
            prop_assert!(state.velocity.norm() < fastest + 0.5 + 6.0 * 5.0 * throttle, "{:?}", state);
            prop_assert!(state.roll.abs() < 1.6 && state.pitch.abs() < 1.2, "{:?}", state);
            prop_assert!(state.yaw_rate.abs() < 6.0, "{:?}", state);
            prop_assert!(state.pose.position.x < 48.0, "through the wall: {:?}", state);
        }
        bodies.clear();
        run(&mut ego, Control { brake: 1.0, ..COAST }, &mut bodies, 60);
        let state = ego.state();
        prop_assert!(state.roll.abs() < 0.3 && state.pitch.abs() < 0.3, "not on its wheels: {:?}", state);
        prop_assert!(state.velocity.norm() < 0.1, "still moving: {:?}", state);
    }

    #[test]
    fn standing_bodies_never_add_energy(
        speed in 1.0..25.0f64,
        steer in -1.0..1.0f64,
        mut bodies in prop::collection::vec(body(), 0..6),
        pole in (6.0..30.0f64, -3.0..3.0f64),
        kerb in 4.0..12.0f64,
    ) {
        for body in &mut bodies {
            body.speed = 0.0;
            body.pose.position.x += 20.0; // None inside the ego at the start.
        }
        let mut ego = ego(speed);
        ego.set_statics(vec![wall_at(45.0), block(2, StaticKind::Pole, pole, (0.3, 0.3), 6.0), kerb_at(kerb)]);
        let first = energy(&ego);
        let mut before = first;
        for _ in 0..60 {
            run(&mut ego, Control { steer, ..COAST }, &mut bodies, 1);
            let now = energy(&ego);
            // The springs of a body that leans or stands on a kerb give back some of what they hold.
            prop_assert!(now <= before * 1.002 + 250.0, "{before} J became {now} J: {:?}", ego.state());
            prop_assert!(now <= first * 1.002, "{first} J at first became {now} J: {:?}", ego.state());
            before = now;
        }
    }
}
