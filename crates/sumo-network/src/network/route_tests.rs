//! Routes over the hand-made net.

use super::testing::{net, parsed, place, text};
use super::*;
use proptest::prelude::*;

const CAR: VehicleClass = VehicleClass::Passenger;

fn go(network: &Network, from: (&str, f64), to: (&str, f64)) -> Result<Route, RouteError> {
    network.route(place(network, from.0, from.1), place(network, to.0, to.1), CAR)
}

fn options(route: &Route) -> Vec<RoadOption> {
    route.sections.iter().map(|s| s.option).collect()
}

#[test]
fn a_turn_is_announced_before_its_stop_line() {
    use RoadOption::{LaneFollow, Left};
    let network = net();
    let route = go(&network, ("ab_1", 20.0), ("bl_0", 30.0)).unwrap();
    assert_eq!(options(&route), [LaneFollow, Left, Left, LaneFollow]);
    let link = route.links[0];
    assert!((link.stop_s - 270.0).abs() < 0.5, "{}", link.stop_s);
    assert!((route.sections[1].s_start - (link.stop_s - 15.0)).abs() < 1e-9);
    assert_eq!(route.at(link.stop_s - 14.0).option, Left);
    assert_eq!(route.at(link.stop_s - 16.0).option, LaneFollow);
    assert_eq!(route.at(link.end_s + 1.0).option, LaneFollow);
    assert_eq!(route.next_link(100.0).unwrap().link, link.link);
    assert!(route.next_link(link.stop_s + 0.1).is_none());
    assert!(route.link_at(link.stop_s - 0.1).is_none());
    assert_eq!(route.link_at(link.stop_s + 1.0).unwrap().link, link.link);
    // The edge before holds until the junction is left.
    assert_eq!([0.0, link.stop_s + 1.0, link.end_s + 0.1].map(|s| route.edge_index_at(s)), [0, 0, 1]);
    // Without internal lanes the way over the junction is a curve of its own.
    let tightest = (0..route.length() as usize).map(|s| route.at(s as f64).curvature).fold(0.0, f64::max);
    assert!((0.05..0.22).contains(&tightest), "{tightest}");
}

#[test]
fn on_a_fast_road_a_turn_is_announced_early_enough_to_brake_for_it() {
    let fast = text("")
        .replace(r#"<lane id="ab_1" index="1" speed="10""#, r#"<lane id="ab_1" index="1" speed="25""#);
    let network = parsed(&fast).unwrap();
    let route = go(&network, ("ab_1", 20.0), ("bl_0", 30.0)).unwrap();
    let stop = route.links[0].stop_s;
    // (25 m/s)^2 less (13.89 m/s)^2 by twice 3 m/s2, and 15 m.
    assert!((stop - route.sections[1].s_start - 87.0).abs() < 0.1, "{}", route.sections[1].s_start);
    assert_eq!(route.at(stop - 86.0).option, RoadOption::Left);
    assert_eq!(route.at(stop - 88.0).option, RoadOption::LaneFollow);
}

#[test]
fn a_road_without_a_choice_is_followed() {
    let network = net();
    let route = go(&network, ("bc_0", 100.0), ("ab_0", 100.0)).unwrap();
    assert!(options(&route).iter().all(|o| *o == RoadOption::LaneFollow), "{:?}", options(&route));
    assert_eq!(route.edges.len(), 3);
    // Straight on where one could also turn left; the right turn is for buses.
    let straight = go(&network, ("ab_0", 100.0), ("bc_0", 100.0)).unwrap();
    assert_eq!(straight.at(straight.links[0].stop_s - 1.0).option, RoadOption::Straight);
}

#[test]
fn a_lane_change_is_long_gentle_and_done_well_before_the_stop_line() {
    let network = net();
    let route = go(&network, ("ab_0", 20.0), ("bl_0", 30.0)).unwrap();
    let change = route.sections.iter().find(|s| s.option == RoadOption::ChangeLaneLeft).unwrap();
    assert!(change.s_end - change.s_start >= 29.0, "3 s at 10 m/s");
    assert!(route.links[0].stop_s - change.s_end > 20.0);
    assert_eq!(network.lane(change.lane).id, "ab_1");
    assert_eq!(network.lane(change.from_lane.unwrap()).id, "ab_0");
    for s in (change.s_start as usize + 2)..(change.s_end as usize) {
        assert!(route.at(s as f64).curvature.abs() < 0.03);
        // Both lanes' centres and what lies between are in the corridor.
        let y = route.at(s as f64).pose.position.y;
        for (centre, outside) in [(-4.8, -1.0), (-1.6, 1.0)] {
            assert!(route.corridor_offset(s as f64, centre - y) < 0.1);
            assert!((route.corridor_offset(s as f64, centre + outside - y) - 1.0).abs() < 0.1);
        }
    }
    assert_eq!(route.corridor_offset(change.s_end + 5.0, -0.7), 0.7);
}

#[test]
fn a_change_that_is_forbidden_is_not_made() {
    let network = parsed(&text("changeLeft=\"bus\"")).unwrap();
    let error = go(&network, ("ab_0", 20.0), ("bl_0", 30.0)).unwrap_err();
    assert!(matches!(error, RouteError::Unreachable { .. }));
    let bus = network.route(place(&network, "ab_0", 20.0), place(&network, "bl_0", 30.0), VehicleClass::Bus);
    assert!(bus.is_ok());
}

#[test]
fn too_close_to_the_stop_line_the_route_goes_round() {
    let network = net();
    let route = go(&network, ("ab_0", 285.0), ("bl_0", 30.0)).unwrap();
    let names: Vec<&str> = route.edges.iter().map(|&e| network.edge(e).id.as_str()).collect();
    assert_eq!(names, ["ab", "bc", "ca", "ab", "bl"]);
}

#[test]
fn a_destination_behind_is_reached_by_going_round() {
    let network = net();
    let ahead = go(&network, ("ab_0", 20.0), ("ab_0", 60.0)).unwrap();
    assert!((ahead.length() - 40.0).abs() < 1e-6 && ahead.edges.len() == 1);
    let behind = go(&network, ("ab_0", 60.0), ("ab_0", 20.0)).unwrap();
    assert_eq!(behind.edges.len(), 4);
    assert_eq!(behind.edge_index_at(behind.length()), 3);
    assert!(behind.length() > 1000.0);
}

#[test]
fn what_cannot_be_driven_says_why() {
    let network = net();
    let error = go(&network, ("bl_0", 20.0), ("ab_0", 20.0)).unwrap_err().to_string();
    assert!(error.contains("`bl`") && error.contains("`ab`") && error.contains("passenger"), "{error}");
    assert!(matches!(go(&network, ("ab_0", 0.0), ("br_0", 5.0)), Err(RouteError::NotForClass { .. })));
    for s in [-5.0, 300.0, f64::NAN, f64::INFINITY] {
        assert!(matches!(go(&network, ("ab_0", s), ("bc_0", 5.0)), Err(RouteError::OffLane { .. })));
    }
    let huge = text("").replace("310,-4.8 600,-4.8", "310,-4.8 9e8,-4.8");
    let huge = go(&parsed(&huge).unwrap(), ("ab_0", 0.0), ("bc_0", 8e8));
    assert!(matches!(huge, Err(RouteError::TooLong { .. })), "{huge:?}");
}

#[test]
fn an_extended_route_keeps_what_was_driven() {
    let network = net();
    let mut route = go(&network, ("ab_0", 20.0), ("bc_0", 100.0)).unwrap();
    let before = route.clone();
    network.extend_route(&mut route, place(&network, "ab_0", 200.0)).unwrap();
    assert!(route.length() > before.length() + 1000.0);
    for s in 0..=before.length() as usize {
        let (old, new) = (before.at(s as f64), route.at(s as f64));
        assert!((old.pose.xy() - new.pose.xy()).norm() < 0.01, "at {s}");
        assert_eq!(old.lane, new.lane);
    }
    assert_eq!(route.edges[..2], before.edges[..]);
    let kept = route.clone();
    let dead_end = place(&network, "br_0", 1.0);
    assert!(network.extend_route(&mut route, dead_end).is_err());
    assert_eq!(route.length(), kept.length());
}

#[test]
fn a_route_without_what_was_passed_keeps_its_line() {
    let network = net();
    let mut route = go(&network, ("ab_0", 20.0), ("bc_0", 100.0)).unwrap();
    let first = route.length();
    network.extend_route(&mut route, place(&network, "ab_0", 200.0)).unwrap();
    let (same, s) = network.drop_passed(&route, 200.0);
    assert_eq!((same.length(), s), (route.length(), 200.0), "the lane that it is on has not ended");
    // The first lane has ended; the first destination lies ahead.
    let at = first - 40.0;
    let (shorter, s) = network.drop_passed(&route, at);
    let dropped = at - s;
    assert!((270.0..at - super::route::KEPT_BEHIND).contains(&dropped), "{dropped} of {at}");
    assert!((route.length() - dropped - shorter.length()).abs() < 1e-6);
    assert_eq!(shorter.destinations, route.destinations);
    assert_eq!(shorter.edges, route.edges[1..]);
    for ahead in 0..(route.length() - at) as usize {
        let (old, new) = (route.at(at + ahead as f64), shorter.at(s + ahead as f64));
        assert!((old.pose.xy() - new.pose.xy()).norm() < 0.01, "{ahead} m ahead");
        assert_eq!((old.lane, old.option), (new.lane, new.option));
    }
    // Behind the first destination that one is forgotten, and the route can be led on.
    let (mut later, s) = network.drop_passed(&route, first + 400.0);
    assert_eq!(later.destinations, [route.to]);
    assert!(s < first + 400.0 - dropped);
    network.extend_route(&mut later, place(&network, "bc_0", 100.0)).unwrap();
    assert_eq!(later.destinations.len(), 2);
}

#[test]
fn a_route_may_begin_inside_a_junction() {
    let inner = text("")
        .replace("<edge id=\"ab\"", "<edge id=\":B_0\" function=\"internal\"><lane id=\":B_0_0\" index=\"0\" speed=\"8\" length=\"20\" shape=\"290,-4.8 310,-4.8\"/></edge><edge id=\"ab\"")
        .replacen("toLane=\"0\" tl=\"light\"", "toLane=\"0\" via=\":B_0_0\" tl=\"light\"", 1);
    let network = parsed(&inner).unwrap();
    let route = go(&network, (":B_0_0", 5.0), ("bc_0", 50.0)).unwrap();
    assert!((route.length() - 65.0).abs() < 0.1);
    let names: Vec<&str> = route.edges.iter().map(|&e| network.edge(e).id.as_str()).collect();
    assert_eq!(names, ["ab", "bc"]);
    assert_eq!((route.edge_index_at(3.0), route.edge_index_at(30.0)), (0, 1));
    let link = route.link_at(3.0).unwrap();
    assert!((link.stop_s + 5.0).abs() < 0.1 && (link.end_s - 15.0).abs() < 0.1);
    assert_eq!(route.at(3.0).speed_limit, 8.0);
    assert!(matches!(go(&network, ("ab_0", 5.0), (":B_0_0", 5.0)), Err(RouteError::NotARoad { .. })));
}

proptest! {
    #[test]
    fn any_place_on_a_route_projects_onto_itself(s in 0.0..1.0, back in 0.0..30.0, ahead in 0.0..30.0) {
        let network = net();
        let route = go(&network, ("ab_0", 20.0), ("ab_0", 10.0)).unwrap();
        let s = s * route.length();
        let found = route.project_near(route.at(s).pose.xy(), s, back, ahead);
        prop_assert!((found.s - s).abs() < 1e-6 && found.d.abs() < 1e-6);
    }
}
