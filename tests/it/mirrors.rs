//! Cameras in place of the door mirrors, in a bundled town.

use super::program::{json, stderr, wad};
use std::sync::Arc;
use wad_cosim::assets::Assets;
use wad_cosim::camera::{CameraConfig, Outputs, Preset};
use wad_cosim::criteria::EgoOnRoute;
use wad_cosim::env::EnvOptions;
use wad_cosim::eyes::Eyes;
use wad_cosim::geometry::{Vector, direction};
use wad_cosim::network::{LaneId, LanePosition, LinkDirection, Network, RoadOption, Route, VehicleClass};
use wad_cosim::observation::LeadState;
use wad_cosim::perception::paint::BLUE;
use wad_cosim::perception::{self, EgoFacts, LeastScore};
use wad_cosim::vehicle::EgoState;
use wad_cosim::world::{Actor, ActorKind, ActorType, VehicleSignals, WorldState};

const LENGTH: f64 = 4.7;
const SPEED: f64 = 10.0;
const TICK: f64 = 0.167;

/// A route over a junction that changes lanes behind it, to the side of `option`, and where it begins to (m).
fn changing(network: &Network, option: RoadOption) -> (Route, f64) {
    let end = |lane| network.lane(lane).shape.length() - 5.0;
    let edge = |lane| network.lane(lane).edge;
    let ways = network.links.iter().filter(|link| link.direction == LinkDirection::Straight);
    let routes = ways.filter(|link| end(link.from) > 60.0).flat_map(|link| {
        // Beside it, one goes the same way.
        let comes_along = move |lane: LaneId| {
            let mut ways = network.lane(lane).incoming.iter().map(|&way| network.link(way));
            ways.any(|way| way.direction == LinkDirection::Straight && edge(way.from) == edge(link.from))
        };
        let lanes = &network.edge(edge(link.to)).lanes;
        let others = lanes.iter().filter(move |lane| **lane != link.to && comes_along(**lane));
        others.filter_map(|&to| {
            let from = LanePosition { lane: link.from, s: end(link.from) - 50.0 };
            let to = LanePosition { lane: to, s: end(to) };
            network.route(from, to, VehicleClass::Passenger).ok()
        })
    });
    let mut begins = routes.filter_map(|route| {
        let change = route.sections.iter().find(|section| section.from_lane.is_some())?;
        let s = change.s_start;
        (change.option == option && s > 40.0 && s < 120.0).then_some((route, s))
    });
    begins.next().expect("a road with two lanes")
}

/// The ego's facts at `s` (m).
fn facts<'a>(
    network: &'a Network,
    route: &'a Route,
    s: f64,
    signals: &'a [Option<Arc<str>>],
) -> EgoFacts<'a> {
    let pose = route.at(s).pose;
    let state = EgoState {
        pose,
        roll: 0.0,
        pitch: 0.0,
        velocity: direction(pose.heading) * SPEED,
        speed: SPEED,
        lateral_speed: 0.0,
        yaw_rate: 0.0,
        acceleration: 0.0,
        steer_angle: 0.0,
    };
    let on_route = EgoOnRoute { state, s, d: 0.0, front_s: s + 0.5 * LENGTH };
    EgoFacts { network, route, on_route, length: LENGTH, signals, tick: TICK }
}

/// The eyes after eight ticks beside a car that is `back` (m) behind it on
/// the lane to the side `left` (m).
fn looked(assets: &Assets, mirrors: bool, (route, start): &(Route, f64), car: Option<[f64; 2]>) -> Eyes {
    let detector = perception::detector("truth", LeastScore::Usual).unwrap();
    let eyes = Eyes::new(assets.town(), CameraConfig::default(), detector).unwrap();
    let mut eyes = eyes.with_mirrors(mirrors).unwrap().with_outputs(Outputs::RGB);
    eyes.reset(Preset::ClearNoon, 1);
    let network = assets.network();
    let signals = vec![None; network.traffic_lights.len()];
    for tick in 0..8_u32 {
        let facts = facts(network, route, start - 25.0 + SPEED * TICK * f64::from(tick), &signals);
        let mut world =
            WorldState { tick: u64::from(tick), traffic_lights: signals.clone(), ..WorldState::default() };
        if let Some([back, left]) = car {
            let ego = facts.on_route.state.pose;
            let mut pose = ego;
            let at = ego.to_world(Vector::new(-back, left));
            (pose.position.x, pose.position.y) = (at.x, at.y);
            let actor_type = ActorType {
                id: "car".into(),
                kind: ActorKind::Car,
                length: 4.5,
                width: 1.8,
                height: 1.5,
                min_gap: 2.5,
            };
            world.vehicles.push(Actor {
                id: Arc::from("beside"),
                key: 1,
                actor_type: Arc::new(actor_type),
                pose,
                speed: SPEED,
                signals: VehicleSignals(0),
                lane: None,
                lane_position: 0.0,
            });
        }
        eyes.follow(&world);
        eyes.look(&facts).unwrap();
    }
    eyes
}

/// Who keeps the ego back, and who is in front in the raw states.
fn told(eyes: &Eyes) -> [Option<LeadState>; 2] {
    [eyes.percept().unwrap().beside, eyes.raw().lead]
}

#[test]
fn who_is_beside_the_ego_before_a_change_of_lane_is_seen_in_the_mirror_alone() {
    let assets = Assets::load("town5").unwrap();
    for (option, left) in [(RoadOption::ChangeLaneLeft, 3.3), (RoadOption::ChangeLaneRight, -3.3)] {
        let (way, beside) = (changing(assets.network(), option), Some([5.0, left]));
        let eyes = looked(&assets, true, &way, beside);
        let mirror = eyes.mirror().expect("what a film shows");
        assert_eq!(mirror.left, left > 0.0, "{option:?}");
        let is_boxed = mirror.picture.rgb.chunks_exact(3).any(|pixel| pixel == BLUE);
        assert!(is_boxed, "{option:?}: who is beside has a box");
        let [kept, lead] = told(&eyes);
        let kept = kept.unwrap_or_else(|| panic!("{option:?}: nobody is seen"));
        assert!((5.0..30.0).contains(&kept.gap) && kept.closing_speed == SPEED, "{option:?}: {kept:?}");
        assert_eq!(lead, Some(kept), "{option:?}: it counts as the vehicle in front");
        let blind = looked(&assets, false, &way, beside);
        assert!(told(&blind) == [None, None] && blind.mirror().is_none(), "{option:?}: without mirrors");
        assert_eq!(told(&looked(&assets, true, &way, None)), [None, None], "{option:?}: nobody is there");
        let other = looked(&assets, true, &way, Some([5.0, -left]));
        assert_eq!(told(&other), [None, None], "{option:?}: on the other side");
    }
}

#[test]
fn an_evaluation_with_mirrors_says_so_and_goes_on_with_them_only() {
    let folder = tempfile::tempdir().unwrap();
    let (suite, out) = (folder.path().join("small.json"), folder.path().join("out"));
    let text = r#"{"name": "small", "title": "Small", "episodes": 1,
        "conditions": [{"name": "wet", "town": "town3", "weathers": ["WetNoon"]}],
        "tasks": [{"name": "busy", "kind": "composite", "traffic": "6,6", "tick_limit": 20}]}"#;
    std::fs::write(&suite, text).unwrap();
    let eval = |more: &[&str]| {
        let mut command = wad(&["eval"]);
        command.arg(&suite).args(["--agent", "wad-t", "--detector", "truth", "--json", "--out"]).arg(&out);
        command.args(more).output().unwrap()
    };
    let first = eval(&["--mirrors"]);
    assert!(first.status.success(), "{}", stderr(&first));
    assert_eq!(json(&first)["episodes"], 1);
    let config = std::fs::read_to_string(out.join("config.json")).unwrap();
    assert!(config.contains(r#""mirrors": true"#), "{config}");
    // A training's --set knows what config.json names.
    let plain = serde_json::to_value(EnvOptions::training()).unwrap();
    assert_eq!(plain["mirrors"], false, "{plain}");
    let other = eval(&["--resume"]);
    assert_eq!(other.status.code(), Some(2), "{}", stderr(&other));
    assert!(stderr(&other).contains("mirrors"), "{}", stderr(&other));
}
