//! The ego on an empty plane, against theory.

use super::*;
use std::f64::consts::PI;
use sumo_network::geometry::{Pose, direction};

const TICK: f64 = 0.167;
const COAST: Control = Control { throttle: 0.0, steer: 0.0, brake: 0.0, reverse: false };
const FULL_THROTTLE: Control = Control { throttle: 1.0, ..COAST };
const FULL_BRAKE: Control = Control { brake: 1.0, ..COAST };

fn ego(speed: f64) -> EgoVehicle {
    EgoVehicle::new(EgoParams::default(), Pose::new(0.0, 0.0, 0.0, 0.0), speed)
}

/// All numbers of a state, for comparison bit by bit.
fn bits(state: &EgoState) -> [u64; 13] {
    [
        state.pose.position.x,
        state.pose.position.y,
        state.pose.position.z,
        state.pose.heading,
        state.roll,
        state.pitch,
        state.velocity.x,
        state.velocity.y,
        state.speed,
        state.lateral_speed,
        state.yaw_rate,
        state.acceleration,
        state.steer_angle,
    ]
    .map(f64::to_bits)
}

/// A drive that uses everything: throttle, brake, both directions.
fn varied(i: usize) -> Control {
    let t = i as f64;
    Control {
        throttle: (0.3 * t).sin().max(0.0),
        steer: 0.6 * (0.17 * t).sin(),
        brake: if i % 23 > 19 { 0.4 } else { 0.0 },
        reverse: false,
    }
}

#[test]
fn zero_to_hundred_takes_as_long_as_a_mid_size_saloon() {
    let mut ego = ego(0.0);
    let mut time = 0.0;
    while ego.state().speed < 100.0 / 3.6 {
        ego.tick(FULL_THROTTLE, 0.02, &[]);
        time += 0.02;
        assert!(time < 20.0);
    }
    println!("0-100 km/h: {time:.2} s");
    assert!((8.5..10.5).contains(&time), "{time} s");
}

#[test]
fn top_speed_is_where_power_meets_drag() {
    let params = EgoParams::default();
    let mut ego = ego(50.0);
    for _ in 0..1200 {
        ego.tick(FULL_THROTTLE, TICK, &[]);
    }
    let v = ego.state().speed;
    let resistance = params.air_drag * v * v + params.rolling_resistance * params.mass * GRAVITY;
    assert!((params.drive_power / v / resistance - 1.0).abs() < 0.02, "{v} m/s");
}

#[test]
fn stopping_distance_is_limited_by_grip() {
    let params = EgoParams::default();
    for kmh in [30.0, 50.0, 100.0] {
        let speed = kmh / 3.6;
        let mut ego = ego(speed);
        for _ in 0..300 {
            ego.tick(FULL_BRAKE, 0.05, &[]);
        }
        let way = ego.state().pose.position.x;
        let theory = speed * speed / (2.0 * params.tyre_grip * GRAVITY);
        println!("{kmh} km/h to rest: {way:.2} m, v2/(2 mu g) {theory:.2} m");
        assert!(way > 0.97 * theory, "better than grip allows: {way} m");
        assert!(way < 1.02 * theory + speed * params.brake_lag, "{way} m against {theory} m");
        assert!(ego.state().speed.abs() < 1e-3);
        if kmh == 50.0 {
            assert!((10.5..13.0).contains(&way), "{way} m");
        }
    }
}

#[test]
fn low_speed_turning_circle_is_the_bicycle_models() {
    let params = EgoParams::default();
    for steer in [1.0, -1.0, 0.4] {
        let mut ego = ego(2.0);
        let (mut low, mut high) = (f64::MAX, f64::MIN);
        for i in 0..1600 {
            let throttle = if ego.state().speed < 2.0 { 0.2 } else { 0.0 };
            ego.tick(Control { throttle, steer, brake: 0.0, reverse: false }, 0.05, &[]);
            if i > 100 {
                low = low.min(ego.state().pose.position.y);
                high = high.max(ego.state().pose.position.y);
            }
        }
        let radius = 0.5 * (high - low);
        let rear = params.wheelbase / (steer.abs() * params.max_steer_angle).tan();
        let theory = rear.hypot(0.5 * params.wheelbase);
        println!("steer {steer}: radius {radius:.3} m, bicycle model {theory:.3} m");
        assert!((radius / theory - 1.0).abs() < 0.03, "{radius} m against {theory} m");
        assert_eq!(ego.state().yaw_rate > 0.0, steer > 0.0, "left is positive");
    }
    let kerb_to_kerb = 2.0 * params.turning_radius();
    println!("kerb to kerb {kerb_to_kerb:.2} m");
    assert!((10.5..11.5).contains(&kerb_to_kerb));
}

#[test]
fn lateral_acceleration_is_bounded_by_grip_and_the_ego_does_not_spin() {
    let params = EgoParams::default();
    for speed in [8.0, 14.0, 20.0, 30.0] {
        for control in
            [0.2, 0.5, 1.0].map(|steer| Control { throttle: 0.3, steer, brake: 0.0, reverse: false })
        {
            let mut ego = ego(speed);
            let mut most: f64 = 0.0;
            for _ in 0..240 {
                let before = ego.state();
                ego.tick(control, 1.0 / 60.0, &[]);
                let after = ego.state();
                most = most.max((after.velocity - before.velocity).norm() * 60.0);
                let slip = after.lateral_speed.atan2(after.speed);
                assert!(slip.abs() < 0.6, "at {speed} m/s, steer {}: slip {slip} rad", control.steer);
            }
            let limit = params.tyre_grip * GRAVITY + params.air_drag * speed * speed / params.mass;
            // Wheel loads swing about the weight while the body rolls.
            assert!(most < 1.12 * limit, "at {speed} m/s, steer {}: {most} m/s2", control.steer);
        }
    }
}

#[test]
fn steady_cornering_beyond_the_limit_runs_wide_at_the_grip_limit() {
    let params = EgoParams::default();
    let mut ego = ego(20.0);
    let mut mean = 0.0;
    for i in 0..180 {
        let before = ego.state().velocity;
        let throttle = if ego.state().speed < 20.0 { 0.3 } else { 0.0 };
        ego.tick(Control { throttle, steer: 0.4, brake: 0.0, reverse: false }, 1.0 / 60.0, &[]);
        if i >= 120 {
            let turned = before.perp(&ego.state().velocity) / before.norm();
            mean += turned; // 60 changes of velocity over one second
        }
    }
    let wanted = 400.0 * (0.4 * params.max_steer_angle).tan() / params.wheelbase;
    assert!(wanted > 2.0 * GRAVITY);
    let mu_g = params.tyre_grip * GRAVITY;
    assert!((0.75 * mu_g..1.02 * mu_g).contains(&mean), "{mean} m/s2, limit {mu_g}");
}

#[test]
fn no_drift_at_rest_in_ten_minutes() {
    for (pose, brake) in [
        (Pose::new(0.0, 0.0, 0.0, 0.0), 0.0),
        (Pose::new(5321.7, -3210.3, 0.0, 2.3), 0.0),
        (Pose::new(-1234.5, 987.6, 0.0, -0.7), 1.0),
    ] {
        let mut ego = EgoVehicle::new(EgoParams::default(), pose, 0.0);
        let control = Control { brake, steer: 0.5, ..COAST };
        for _ in 0..3600 {
            ego.tick(control, TICK, &[]);
        }
        let drift = (ego.state().pose.xy() - pose.xy()).norm();
        assert!(drift < 0.01, "{drift} m from {pose:?}");
        assert!((ego.state().pose.heading - pose.heading).abs() < 1e-3);
    }
}

#[test]
fn left_and_right_are_mirrored() {
    let (mut left, mut right) = (ego(10.0), ego(10.0));
    for i in 0..120 {
        let control = varied(i);
        left.tick(control, 0.1, &[]);
        right.tick(Control { steer: -control.steer, ..control }, 0.1, &[]);
        let (l, r) = (left.state(), right.state());
        assert!((l.pose.position.x - r.pose.position.x).abs() < 0.01, "tick {i}: {l:?} {r:?}");
        assert!((l.pose.position.y + r.pose.position.y).abs() < 0.01, "tick {i}: {l:?} {r:?}");
        assert!((l.yaw_rate + r.yaw_rate).abs() < 1e-3 && (l.roll + r.roll).abs() < 1e-3);
    }
    assert!(left.state().pose.heading.abs() > 0.1);
}

#[test]
fn every_heading_drives_alike() {
    let run = |heading: f64| {
        let mut ego = EgoVehicle::new(EgoParams::default(), Pose::new(0.0, 0.0, 0.0, heading), 10.0);
        for i in 0..60 {
            ego.tick(varied(i), 0.1, &[]);
        }
        Pose::new(0.0, 0.0, 0.0, heading).to_local(ego.state().pose.xy())
    };
    let reference = run(0.0);
    for heading in [0.5 * PI, PI, -2.0] {
        assert!((run(heading) - reference).norm() < 0.02, "heading {heading}");
    }
}

#[test]
fn coasting_never_gains_speed() {
    for (speed, steer) in [(30.0, 0.0), (15.0, 0.3), (6.0, 1.0), (0.5, -1.0)] {
        let mut ego = ego(speed);
        let mut before = ego.state().velocity.norm();
        for _ in 0..600 {
            ego.tick(Control { steer, ..COAST }, 0.05, &[]);
            let now = ego.state().velocity.norm();
            assert!(now <= before + 2e-3, "{before} m/s became {now} from {speed}, steer {steer}");
            before = now;
        }
        assert!(before < 0.9 * speed);
    }
}

#[test]
fn a_straight_line_stays_straight() {
    let mut ego = ego(0.0);
    for _ in 0..360 {
        ego.tick(FULL_THROTTLE, TICK, &[]);
    }
    let state = ego.state();
    assert!(state.pose.position.x > 1500.0);
    assert!(state.pose.position.y.abs() < 0.05, "{} m off", state.pose.position.y);
    assert!(state.pose.heading.abs() < 1e-4);
}

#[test]
fn the_origin_moves_without_a_jump() {
    let mut ego = EgoVehicle::new(EgoParams::default(), Pose::new(1e4, -1e4, 0.0, 0.8), 20.0);
    for _ in 0..300 {
        let before = ego.state();
        ego.tick(Control { throttle: 0.1, ..COAST }, 0.1, &[]);
        let moved = ego.state().pose.xy() - before.pose.xy();
        let mean = 0.05 * (before.velocity + ego.state().velocity);
        assert!((moved - mean).norm() < 1e-3, "{moved:?} against {mean:?}");
        assert!(ego.state().pitch.abs() < 0.01);
    }
}

#[test]
fn brake_wins_over_throttle_and_holds_at_rest() {
    let both = Control { throttle: 1.0, brake: 1.0, steer: 0.0, reverse: false };
    let (mut braked, mut both_pressed) = (ego(15.0), ego(15.0));
    for _ in 0..30 {
        braked.tick(FULL_BRAKE, TICK, &[]);
        both_pressed.tick(both, TICK, &[]);
    }
    assert_eq!(bits(&braked.state()), bits(&both_pressed.state()));
    let at = both_pressed.state().pose.xy();
    for _ in 0..100 {
        both_pressed.tick(both, TICK, &[]);
    }
    assert!((both_pressed.state().pose.xy() - at).norm() < 1e-3);
    assert!(both_pressed.state().speed.abs() < 1e-3);
}

#[test]
fn the_same_input_gives_the_same_bits_also_after_a_respawn() {
    let pose = Pose::new(812.3, -94.1, 0.0, 1.9);
    let run = |ego: &mut EgoVehicle| -> Vec<[u64; 13]> {
        (0..200)
            .map(|i| {
                ego.tick(varied(i), TICK, &[]);
                bits(&ego.state())
            })
            .collect()
    };
    let mut ego = EgoVehicle::new(EgoParams::default(), pose, 5.0);
    let first = run(&mut ego);
    assert_eq!(first, run(&mut EgoVehicle::new(EgoParams::default(), pose, 5.0)));
    ego.respawn(pose, 5.0);
    assert_eq!(first, run(&mut ego));
}

#[test]
fn tick_lengths_agree() {
    let run = |tick: f64| {
        let mut ego = ego(10.0);
        for _ in 0..(6.0 / tick).round() as usize {
            ego.tick(Control { throttle: 0.4, steer: 0.08, brake: 0.0, reverse: false }, tick, &[]);
        }
        ego.state()
    };
    let reference = run(0.05);
    for tick in [0.1, 1.0 / 6.0, 0.25, 1.0, 2.0] {
        let state = run(tick);
        let apart = (state.pose.xy() - reference.pose.xy()).norm();
        assert!(apart < 0.05, "{tick} s ticks end {apart} m away");
        assert!((state.speed - reference.speed).abs() < 0.01);
    }
}

#[test]
fn control_out_of_range_is_clamped_and_nan_is_nothing() {
    let run = |control: Control| {
        let mut ego = ego(10.0);
        for _ in 0..10 {
            ego.tick(control, TICK, &[]);
        }
        bits(&ego.state())
    };
    let nan = Control { throttle: f64::NAN, steer: f64::NAN, brake: f64::NAN, reverse: false };
    assert_eq!(run(nan), run(COAST));
    let most = Control { throttle: f64::INFINITY, steer: 1e300, brake: -3.0, reverse: false };
    assert_eq!(run(most), run(Control { throttle: 1.0, steer: 1.0, brake: 0.0, reverse: false }));
}

#[test]
fn a_duration_that_is_none_does_nothing() {
    let mut ego = ego(10.0);
    let before = bits(&ego.state());
    for duration in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(ego.tick(FULL_THROTTLE, duration, &[]).is_empty());
        assert_eq!(bits(&ego.state()), before);
    }
}

#[test]
fn a_start_that_is_not_a_number_is_taken_as_zero() {
    let pose = Pose::new(f64::NAN, 1.0, 0.0, f64::INFINITY);
    let mut ego = EgoVehicle::new(EgoParams::default(), pose, f64::NAN);
    ego.tick(COAST, TICK, &[]);
    assert!(ego.state().pose.position.x.abs() < 1e-6 && ego.state().speed.abs() < 1e-6);
}

#[test]
fn acceleration_and_velocities_fit_together() {
    let mut ego = EgoVehicle::new(EgoParams::default(), Pose::new(0.0, 0.0, 0.0, 2.0), 5.0);
    for i in 0..100 {
        let before = ego.state();
        ego.tick(varied(i), TICK, &[]);
        let after = ego.state();
        assert!((after.acceleration - (after.speed - before.speed) / TICK).abs() < 1e-9);
        let ahead = direction(after.pose.heading);
        let left = sumo_network::geometry::Vector::new(-ahead.y, ahead.x);
        assert!((ahead * after.speed + left * after.lateral_speed - after.velocity).norm() < 1e-9);
        assert!(after.steer_angle.abs() <= EgoParams::default().max_steer_angle);
    }
}

#[test]
fn reverse_gear_drives_backwards_once_the_ego_stands() {
    let mut ego = ego(5.0);
    let back = Control { throttle: 1.0, reverse: true, ..COAST };
    ego.tick(back, 0.1, &[]);
    assert!(ego.state().speed > 4.0, "no gear box changes at 5 m/s");
    while ego.state().speed > 0.2 {
        ego.tick(Control { brake: 0.6, reverse: true, ..COAST }, 0.1, &[]);
    }
    for _ in 0..100 {
        ego.tick(Control { steer: 0.4, ..back }, 0.1, &[]);
    }
    let state = ego.state();
    assert!((-6.1..-4.0).contains(&state.speed), "{}", state.speed);
    // To the left and backwards: the tail swings to the left, the heading turns to the right.
    assert!(state.yaw_rate < -0.05, "{}", state.yaw_rate);
    for _ in 0..100 {
        ego.tick(Control { throttle: 0.5, ..COAST }, 0.1, &[]);
    }
    assert!(ego.state().speed > 3.0);
}

/// Drives 20 s beside another vehicle whose centre is so far (m) to the left; None: alone.
fn drive_beside(distance: Option<f64>) -> Vec<EgoState> {
    let mut ego = ego(8.0);
    let mut tick = |i| {
        let EgoState { pose, speed, yaw_rate, .. } = ego.state();
        let neighbour = distance.map(|distance| MovingBody {
            key: 1,
            kind: PartnerKind::Vehicle,
            pose: {
                let at = pose.to_world(sumo_network::geometry::Vector::new(0.0, distance));
                Pose::new(at.x, at.y, 0.0, pose.heading)
            },
            speed,
            acceleration: 0.0,
            turn_rate: yaw_rate,
            length: 4.5,
            width: 1.8,
            height: 1.5,
        });
        let bodies: Vec<MovingBody> = neighbour.into_iter().collect();
        assert!(ego.tick(varied(i), 0.1, &bodies).is_empty(), "touched in tick {i}");
        ego.state()
    };
    (0..200).map(&mut tick).collect()
}

#[test]
fn a_neighbour_out_of_touch_changes_nothing() {
    let alone = drive_beside(None);
    for (a, b) in alone.iter().zip(drive_beside(Some(4.0))) {
        assert_eq!(bits(a), bits(&b));
    }
    // So near that the physics world steps in full; single precision adds up to a centimetre over 20 s.
    let near = drive_beside(Some(2.25));
    assert!(alone.iter().zip(&near).any(|(a, b)| bits(a) != bits(b)));
    for (a, b) in alone.iter().zip(&near) {
        let apart = (a.pose.xy() - b.pose.xy()).norm();
        assert!(apart < 0.03, "{apart} m apart");
        assert!((a.speed - b.speed).abs() < 0.01 && (a.pitch - b.pitch).abs() < 1e-3, "{a:?} {b:?}");
    }
}
