//! Lights, gaps in cross traffic, full junctions.

use super::drive::*;
use crate::autopilot::{Leader, Reason, Told, ToldLight};

#[test]
fn it_stands_before_the_line_at_red_and_goes_at_green() {
    let network = net();
    for start_speed in [0.0, 8.0, 13.9] {
        let mut setup = Setup::new(&network, ("WC_1", 5.0), ("EF_1", 150.0), start_speed);
        setup.light = Box::new(|_| Some(SIDE_GREEN));
        setup.seconds = 45.0;
        let report = setup.run();
        assert_eq!(report.red_runs, 0, "{report:?}");
        assert!(report.speed < 0.1 && report.to_line > 1.0 && report.to_line < 2.0, "{report:?}");
        assert!(report.hardest > -3.2, "{report:?}");
        assert!(report.last.is_some_and(|d| d.held && d.brake_light), "{report:?}");
    }
    let mut setup = Setup::new(&network, ("WC_1", 5.0), ("EF_1", 150.0), 10.0);
    setup.light = Box::new(|t| Some(if t < 30.0 { SIDE_GREEN } else { MAIN_GREEN }));
    setup.seconds = 90.0;
    let report = setup.run();
    assert!(report.red_runs == 0 && report.seconds < 70.0, "{report:?}");
}

#[test]
fn no_moment_of_yellow_makes_it_run_a_red() {
    let network = net();
    for onset in 0..45 {
        let onset = f64::from(onset) * 0.4;
        let mut setup = Setup::new(&network, ("WC_1", 5.0), ("EF_1", 150.0), 13.5);
        setup.light = Box::new(move |t| {
            Some(match t - onset {
                x if x < 0.0 => MAIN_GREEN,
                x if x < 3.0 => MAIN_YELLOW,
                _ => SIDE_GREEN,
            })
        });
        setup.seconds = 30.0;
        let report = setup.run();
        assert_eq!(report.red_runs, 0, "onset {onset}: {report:?}");
        assert!(report.hardest > -4.5, "onset {onset}: {report:?}");
    }
}

#[test]
fn a_light_out_of_sight_is_not_passed() {
    let network = net();
    let mut setup = Setup::new(&network, ("WC_1", 5.0), ("EF_1", 150.0), 13.5);
    setup.light = Box::new(|_| None);
    setup.seconds = 40.0;
    let report = setup.run();
    assert!(report.speed < 0.1 && report.to_line > 0.3, "{report:?}");
}

fn light(stop: Option<f64>) -> Told {
    Told { light: Some(ToldLight { stop, limit: 13.89 }), lead: None }
}

#[test]
fn it_stands_behind_whom_it_is_told() {
    let network = net();
    let mut setup = Setup::new(&network, ("WC_1", 5.0), ("EF_1", 150.0), 10.0);
    // Somebody stands 20 m before the line, where the autopilot itself sees nobody.
    setup.told = Some(|to_line| {
        let gap_m = to_line - 20.0;
        Told { lead: (gap_m > 0.0).then_some(Leader { gap_m, speed_mps: 0.0 }), light: None }
    });
    setup.seconds = 30.0;
    let report = setup.run();
    assert!(report.speed < 0.1 && report.to_line > 20.5 && report.to_line < 24.0, "{report:?}");
    assert!(matches!(report.last.unwrap().reason, Reason::Leader { .. }), "{report:?}");
}

#[test]
fn it_goes_by_the_light_that_it_is_told() {
    let network = net();
    let mut setup = Setup::new(&network, ("WC_1", 5.0), ("EF_1", 150.0), 10.0);
    // The line seems 4 m nearer than it is, and the light is green.
    setup.told = Some(|to_line| light(Some(to_line - 4.0)));
    setup.seconds = 45.0;
    let report = setup.run();
    assert!(report.speed < 0.1 && report.to_line > 5.0 && report.to_line < 6.0, "{report:?}");
    assert!(matches!(report.last.unwrap().reason, Reason::RedLight { .. }), "{report:?}");

    let mut setup = Setup::new(&network, ("WC_1", 5.0), ("EF_1", 150.0), 10.0);
    setup.light = Box::new(|_| Some(SIDE_GREEN));
    setup.told = Some(|_| light(None));
    let report = setup.run();
    assert!(report.red_runs == 1 && report.seconds < 50.0, "nobody told it of the red light: {report:?}");
}

#[test]
fn it_drives_no_faster_than_the_limit_that_it_is_told() {
    let network = net();
    let mut setup = Setup::new(&network, ("WC_1", 5.0), ("EF_1", 150.0), 10.0);
    setup.told = Some(|_| Told { light: Some(ToldLight { stop: None, limit: 8.0 }), lead: None });
    setup.seconds = 8.0;
    let report = setup.run();
    assert!((report.speed - 8.0).abs() < 0.5, "{report:?}");
    assert!(matches!(report.last.unwrap().reason, Reason::Limit), "{report:?}");
}

/// Oncoming cars every `period` s at 13 m/s, from `first` s on, until 60 s.
fn stream<'a>(
    setup: &mut Setup<'a>,
    lanes: &'static [&'static str],
    first: f64,
    period: f64,
    last: f64,
    from: f64,
) {
    for k in 0..20u32 {
        let start = first + period * f64::from(k);
        if start > last {
            break;
        }
        setup.vehicles.push(Box::new(move |network, t, _| {
            let x = from + 13.0 * (t - start);
            if x < 0.0 {
                None
            } else {
                car(network, u64::from(k) + (first * 1000.0) as u64 * 100, lanes, x, 13.0)
            }
        }));
    }
}

#[test]
fn a_left_turn_lets_oncoming_traffic_pass() {
    let network = net();
    for phase in 0..12 {
        let phase = f64::from(phase) * 0.5;
        let mut setup = Setup::new(&network, ("WC_2", 60.0), ("CN_1", 60.0), 10.0);
        stream(&mut setup, &["EC_2", ":C_4_1", "CW_2"], phase, 6.0, 50.0, 0.0);
        setup.seconds = 100.0;
        let report = setup.run();
        assert_eq!(report.contacts, 0, "{phase}: {report:?}");
        assert!(report.nearest > 0.9, "{phase}: {report:?}");
        assert!(report.seconds < 90.0, "{phase}: {report:?}");
    }
}

#[test]
fn a_side_road_lets_the_main_road_pass() {
    let network = net();
    for to in ["EC_2", "EF_1"] {
        for phase in 0..12 {
            let phase = f64::from(phase) * 0.6;
            let mut setup = Setup::new(&network, ("GE_1", 60.0), (to, 100.0), 8.0);
            stream(&mut setup, &["CE_1", ":E_6_0", "EF_1"], phase, 7.0, 60.0, 20.0);
            stream(&mut setup, &["FE_2", ":E_0_1", "EC_2"], phase + 1.0, 7.0, 60.0, 20.0);
            setup.seconds = 110.0;
            // The script's cars would run into one that slows down for the end of its route.
            setup.before_end = 60.0;
            let report = setup.run();
            assert_eq!(report.contacts, 0, "{to} {phase}: {report:?}");
            assert!(report.nearest > 1.0, "{to} {phase}: {report:?}");
            assert!(report.seconds < 100.0, "{to} {phase}: {report:?}");
        }
    }
}

#[test]
fn one_who_runs_the_red_light_is_not_driven_into() {
    let network = net();
    for phase in 0..10 {
        let phase = f64::from(phase) * 0.4;
        let mut setup = Setup::new(&network, ("SC_1", 60.0), ("CN_1", 60.0), 8.0);
        setup.light = Box::new(|_| Some(SIDE_GREEN));
        setup.vehicles.push(Box::new(move |network, t, _| {
            let x = 115.0 + 7.0 * (t + phase);
            car(network, 1, &["WC_1", ":C_11_0", "CE_1"], x, 7.0)
        }));
        setup.seconds = 40.0;
        let report = setup.run();
        assert_eq!(report.contacts, 0, "{phase}: {report:?}");
    }
}

#[test]
fn a_full_exit_keeps_it_out_of_the_junction() {
    let network = net();
    let mut setup = Setup::new(&network, ("WC_1", 60.0), ("CE_1", 100.0), 12.0);
    setup.vehicles.push(Box::new(|network, t, _| {
        let x = if t < 25.0 { 8.0 } else { 8.0 + 8.0 * (t - 25.0) };
        car(network, 1, &["CE_1", ":E_6_0", "EF_1"], x, if t < 25.0 { 0.0 } else { 8.0 })
    }));
    setup.seconds = 20.0;
    let report = setup.run();
    assert!(report.speed < 0.1 && report.to_line > 0.3 && report.to_line < 2.0, "{report:?}");
    assert!(matches!(report.last.map(|d| d.reason), Some(Reason::JunctionBlocked { .. })), "{report:?}");
}

#[test]
fn a_jam_that_stands_on_the_main_road_does_not_hold_it_for_ever() {
    let network = net();
    // One with right of way stands at its line and never goes.
    let mut setup = Setup::new(&network, ("GE_1", 60.0), ("EC_2", 100.0), 8.0);
    setup.vehicles.push(Box::new(|network, _, _| car(network, 1, &["CE_1"], 130.0, 0.0)));
    setup.seconds = 60.0;
    let report = setup.run();
    assert!(report.seconds < 55.0, "{report:?}");
}

#[test]
fn two_who_wait_for_each_other_in_a_junction_do_not_wait_for_ever() {
    let network = net();
    // As SUMO has it: one with right of way comes, the ego in the junction lets it pass, it sees the ego
    // in the junction and stops for it.
    let lanes = ["CE_2", ":E_6_1"];
    let before = network.lane(network.lane_by_id(lanes[0]).unwrap()).length;
    let mut let_pass = 0;
    for x in [-0.5, 0.5, 1.5] {
        let mut setup = Setup::new(&network, ("GE_1", 60.0), ("EC_2", 60.0), 8.0);
        let (route, line) = (setup.route.clone(), setup.route.links[0].stop_s);
        let mut since = None;
        setup.vehicles.push(Box::new(move |network, t, ego| {
            let front = route.project_near(ego.pose.xy(), line, 40.0, 40.0).s + 2.35;
            if front > line + 1.2 {
                since.get_or_insert(t);
            }
            // From 12 m before its place to there, braking at 3 m/s2.
            let speed = 72.0_f64.sqrt();
            let t = (t - since?).min(speed / 3.0);
            car(network, 1, &lanes, before + x - 12.0 + speed * t - 1.5 * t * t, speed - 3.0 * t)
        }));
        setup.seconds = 60.0;
        let report = setup.run();
        let_pass += usize::from(report.stood > 0.0);
        assert_eq!(report.contacts, 0, "{x}: {report:?}");
        assert!(report.seconds < 35.0 && report.stood < 6.0, "{x}: {report:?}");
    }
    assert!(let_pass > 0, "it never had to wait");
}

#[test]
fn only_what_others_impose_counts_as_held() {
    use crate::autopilot::is_held;
    let (gap, distance) = (3.0, 3.0);
    for held in [
        Reason::Leader { gap, speed: 1.9 },
        Reason::Merge { gap, speed: 1.9 },
        Reason::RedLight { distance },
        Reason::Yield { distance },
        Reason::JunctionBlocked { distance },
        Reason::Pedestrian { distance },
        Reason::Crossing { distance },
    ] {
        assert!(is_held(&held), "{held:?}");
    }
    for free in [
        Reason::Free,
        Reason::Limit,
        Reason::Curve,
        Reason::Leader { gap, speed: 2.1 },
        Reason::Merge { gap, speed: 2.1 },
        Reason::LaneChange { distance },
        Reason::RouteEnd { distance },
        Reason::OffRoute,
    ] {
        assert!(!is_held(&free), "{free:?}");
    }
}
