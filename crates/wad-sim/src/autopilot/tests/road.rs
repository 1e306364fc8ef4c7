//! On the open road: speed, leaders, cut-ins, lane changes.

use super::drive::*;
use crate::autopilot::{Autopilot, AutopilotParams, EgoModel, Reason};
use sumo_network::network::Route;
use sumo_network::world::WorldState;
use wad_vehicle::{EgoParams, EgoVehicle};

#[test]
fn a_free_road_is_driven_at_the_limit_and_in_comfort() {
    let network = net();
    for tick_s in [0.05, 0.1, 0.167, 0.2] {
        let mut setup = Setup::new(&network, ("WC_1", 5.0), ("EF_1", 150.0), 0.0);
        setup.tick_s = tick_s;
        let report = setup.run();
        assert!(report.seconds < 50.0, "{report:?}");
        assert!(report.off < 0.3 && report.over_limit < 0.5 && report.hardest > -3.0, "{report:?}");
    }
}

#[test]
fn turns_are_driven_in_their_lane() {
    let network = net();
    for (from, to) in [("NC_1", "CW_1"), ("NC_1", "CE_2"), ("SC_1", "CE_1")] {
        let mut setup = Setup::new(&network, (from, 60.0), (to, 100.0), 8.0);
        setup.light = Box::new(|_| Some(SIDE_GREEN));
        let report = setup.run();
        assert!(report.seconds < 40.0, "{from} {to}: {report:?}");
        assert!(report.off < 0.4, "{from} {to}: {report:?}");
    }
}

/// A leader that drives 12 m/s, `ahead` m before the ego, and brakes from `from` s on.
fn braking_leader(ahead: f64, from: f64, deceleration: f64, to: f64) -> Script<'static> {
    Box::new(move |network, t, _| {
        let braking = (t - from).clamp(0.0, (12.0 - to) / deceleration);
        let speed = 12.0 - deceleration * braking;
        let x = 5.0 + ahead + 12.0 * t.min(from) + 12.0 * braking - 0.5 * deceleration * braking * braking
            + (t - from - braking).max(0.0) * to;
        car(network, 1, &["WC_1", ":C_11_0", "CE_1", ":E_6_0", "EF_1"], x, speed)
    })
}

#[test]
fn a_leader_that_brakes_hard_is_not_hit() {
    let network = net();
    for deceleration in [2.0, 4.5, 7.0] {
        for ahead in [20.0, 25.0, 40.0] {
            let mut setup = Setup::new(&network, ("WC_1", 5.0), ("EF_1", 150.0), 12.0);
            setup.vehicles.push(braking_leader(ahead, 4.0, deceleration, 0.0));
            setup.seconds = 30.0;
            let report = setup.run();
            assert_eq!(report.contacts, 0, "{report:?}");
            assert!(report.nearest > 1.0, "{deceleration} {ahead}: {report:?}");
            assert!(report.speed < 0.1, "{report:?}");
            assert!(deceleration > 3.0 || report.hardest > -4.0, "{deceleration} {ahead}: {report:?}");
        }
    }
}

#[test]
fn it_closes_up_behind_a_standing_vehicle() {
    let network = net();
    let mut setup = Setup::new(&network, ("WC_1", 5.0), ("EF_1", 150.0), 13.0);
    setup.vehicles.push(Box::new(|network, _, _| car(network, 1, &["WC_1"], 150.0, 0.0)));
    setup.seconds = 30.0;
    let report = setup.run();
    assert!(report.nearest > 1.3 && report.nearest < 3.0, "{report:?}");
    assert!(report.hardest > -3.5, "{report:?}");
}

#[test]
fn a_vehicle_that_cuts_in_is_let_in() {
    let network = net();
    for ahead in [7.0, 9.0, 14.0] {
        let mut setup = Setup::new(&network, ("WC_1", 5.0), ("EF_1", 150.0), 12.0);
        setup.vehicles.push(Box::new(move |network, t, _| {
            let x = 5.0 + 2.4 + 4.6 + ahead + 9.0 * t;
            let mut other = car(network, 1, &["WC_2", ":C_11_1", "CE_2", ":E_6_1", "EF_2"], x, 9.0)?;
            // Two seconds for 3.2 m to the right.
            other.pose.position.y -= 3.2 * ((t - 1.0) / 2.0).clamp(0.0, 1.0);
            Some(other)
        }));
        setup.seconds = 12.0;
        let report = setup.run();
        assert_eq!(report.contacts, 0, "{ahead}: {report:?}");
        assert!(report.nearest > 0.5, "{ahead}: {report:?}");
    }
}

#[test]
fn a_vehicle_in_the_next_lane_is_no_leader() {
    let network = net();
    let mut setup = Setup::new(&network, ("WC_1", 5.0), ("EF_1", 150.0), 12.0);
    setup.vehicles.push(Box::new(|network, _, _| car(network, 1, &["WC_2"], 80.0, 0.0)));
    setup.vehicles.push(Box::new(|network, _, _| car(network, 2, &["EC_2"], 80.0, 0.0)));
    let report = setup.run();
    assert!(report.hardest > -3.0 && report.stood < 1.0, "{report:?}");
}

#[test]
fn a_lane_change_waits_for_a_gap() {
    let network = net();
    // Abreast of the ego, at its speed whatever that is, until 12 s.
    for shift in [-6.0, -2.0, 0.0, 3.0] {
        let mut setup = Setup::new(&network, ("WC_1", 5.0), ("CE_2", 100.0), 10.0);
        let mut x = 5.0 + 2.3 + shift;
        setup.vehicles.push(Box::new(move |network, t, ego| {
            let speed = if t < 6.0 { ego.speed.max(0.0) } else { 13.0 };
            x += speed * 0.167;
            // It is gone before the ego slows down for the end of its route.
            if x > 250.0 {
                return None;
            }
            car(network, 1, &["WC_2", ":C_11_1", "CE_2", ":E_6_1", "EF_2"], x, speed)
        }));
        let report = setup.run();
        assert_eq!(report.contacts, 0, "{shift}: {report:?}");
        assert!(report.nearest > 0.4, "{shift}: {report:?}");
        assert!(report.seconds < 45.0, "{shift}: {report:?}");
    }
}

/// The old route's change once led the ego off the new route.
#[test]
fn a_lane_change_is_over_with_its_route() {
    let network = net();
    let [old, new] = ["CE_2", "CE_1"].map(|to| route(&network, ("WC_1", 5.0), (to, 100.0)));
    let change = old.sections.iter().find(|section| section.from_lane.is_some()).unwrap();
    let s = (change.s_start - 5.0).max(0.0);
    let state = EgoVehicle::new(EgoParams::default(), old.at(s).pose, 8.0).state();
    let mut pilot = Autopilot::new(AutopilotParams::default(), EgoModel::from(&EgoParams::default()));
    let blinks = |pilot: &mut Autopilot, way: &Route| {
        pilot.control(&network, way, s, &state, &WorldState::default(), 0.167).blinker_left
    };
    assert!(blinks(&mut pilot, &old));
    pilot.route_changed();
    assert!(!blinks(&mut pilot, &new));
}

#[test]
fn a_full_lane_does_not_block_it_for_ever() {
    let network = net();
    let mut setup = Setup::new(&network, ("WC_1", 5.0), ("CE_2", 100.0), 10.0);
    // A queue stands on the target lane for 25 s, then moves off with 2.5 m + 1 s between.
    for k in 0..12u64 {
        setup.vehicles.push(Box::new(move |network, t, _| {
            let start = 15.0 + 1.2 * (12 - k) as f64;
            let moving = (t - start).max(0.0);
            let x = 100.0
                + 7.2 * k as f64
                + if moving < 5.0 { moving * moving } else { 25.0 + 10.0 * (moving - 5.0) };
            let speed = (2.0 * moving).min(10.0);
            car(network, k, &["WC_2", ":C_11_1", "CE_2", ":E_6_1", "EF_2"], x, speed)
        }));
    }
    setup.seconds = 90.0;
    let report = setup.run();
    assert_eq!(report.contacts, 0, "{report:?}");
    assert!(report.seconds < 80.0, "{report:?}");
    assert!(report.off < 1.75, "left its corridor: {report:?}");
}

#[test]
fn equal_input_gives_equal_driving() {
    let network = net();
    let drive = || {
        let mut setup = Setup::new(&network, ("WC_1", 5.0), ("EF_1", 150.0), 12.0);
        setup.vehicles.push(braking_leader(25.0, 4.0, 3.0, 4.0));
        let report = setup.run();
        (report.s.to_bits(), report.nearest.to_bits(), report.last.map(|d| d.control.steer.to_bits()))
    };
    assert_eq!(drive(), drive());
}

#[test]
fn the_route_ends_at_rest() {
    let network = net();
    let mut setup = Setup::new(&network, ("EF_1", 5.0), ("EF_1", 120.0), 12.0);
    setup.seconds = 40.0;
    setup.before_end = 0.0;
    let report = setup.run();
    // The route is 115 m long; it counts as arrived within 5 m of its end.
    assert!(report.s > 110.0 && report.speed < 0.1, "{report:?}");
    assert!(matches!(report.last.map(|d| d.reason), Some(Reason::RouteEnd { .. })), "{report:?}");
}
