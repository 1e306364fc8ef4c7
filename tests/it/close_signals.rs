//! Two signals so close that no car can wait between (SMARTS' minicity has them 1.4 m apart): what is drawn, what is
//! told, where the autopilot waits and what counts as a reason to stand agree.

use crate::network::nets::Nets;
use std::path::PathBuf;
use wad_cosim::assets::Assets;
use wad_cosim::bridge::BridgeOptions;
use wad_cosim::criteria::{CriteriaParams, Event};
use wad_cosim::network::*;
use wad_cosim::perception::{EgoFacts, LightAhead};
use wad_cosim::session::{Act, Seat, Session};
use wad_cosim::signal_ahead::SignalAhead;
use wad_cosim::vehicle::EgoParams;
use wad_cosim::world::SignalState;

/// A road over two junctions with lights `p` and `q`, 1.4 m between them. The second's program begins `offset` s later.
fn net(nets: &Nets, offset: &str) -> (PathBuf, Network) {
    let nodes = [("a", -100, 0), ("b", 120, 0), ("pn", 0, 80), ("ps", 0, -80)];
    let node = |(id, x, y): (&str, i32, i32)| format!("<node id=\"{id}\" x=\"{x}\" y=\"{y}\"/>");
    let light = |id: &str, x: f64| format!("<node id=\"{id}\" x=\"{x}\" y=\"0\" type=\"traffic_light\"/>");
    let far = ["qn\" x=\"12.6\" y=\"80", "qs\" x=\"12.6\" y=\"-80"].map(|n| format!("<node id=\"{n}\"/>"));
    let text = nodes.map(node).concat() + &light("p", 0.0) + &light("q", 12.6) + &far.concat();
    nets.write("two.nod.xml", &format!("<nodes>{text}</nodes>"));
    let ways = ["a p", "p q", "q b", "pn p", "p ps", "qn q", "q qs"].map(|way| {
        let (from, to) = way.split_once(' ').unwrap();
        format!("<edge id=\"{from}{to}\" from=\"{from}\" to=\"{to}\"/>")
    });
    nets.write("two.edg.xml", &format!("<edges>{}</edges>", ways.concat()));
    let (path, _) = nets.make("netconvert", &["-n", "two.nod.xml", "-e", "two.edg.xml"]);
    let text = std::fs::read_to_string(&path).unwrap();
    let (before, after) = text.split_once(r#"<tlLogic id="q""#).unwrap();
    let after = after.replacen(r#"offset="0""#, &format!(r#"offset="{offset}""#), 1);
    std::fs::write(&path, format!(r#"{before}<tlLogic id="q"{after}"#)).unwrap();
    let network = Network::load(&path).unwrap();
    (path, network)
}

fn lane(network: &Network, edge: &str) -> LaneId {
    network.edge(network.edge_by_id(edge).unwrap()).lanes[0]
}

/// The way over both.
fn route(network: &Network) -> Route {
    let at = |edge: &str, s| LanePosition { lane: lane(network, edge), s };
    network.route(at("ap", 10.0), at("qb", 80.0), VehicleClass::Passenger).unwrap()
}

#[test]
fn signals_without_room_between_are_drawn_both_and_the_one_that_stops_is_told() {
    let nets = Nets::new();
    let (_, network) = net(&nets, "0");
    let lane = |edge: &str| lane(&network, edge);
    assert!((network.lane(lane("pq")).length - 1.4).abs() < 0.2, "{}", network.lane(lane("pq")).length);

    let town =
        wad_cosim::camera::Town::new(&network, &Shapes::default(), wad_cosim::camera::scene::Look::of(1));
    let shown = |id: &str, beyond: f64| {
        let light = network.traffic_light_by_id(id).unwrap();
        let (from, to) = if id == "p" { ("ap", "pq") } else { ("pq", "qb") };
        let link = network.links.iter().find(|l| l.from == lane(from) && l.to == lane(to)).unwrap();
        assert_eq!(link.signal.unwrap().traffic_light, light);
        let end = network.lane(lane("ap")).shape.at(network.lane(lane("ap")).shape.length());
        let heads = town.scene().chunks.iter().flat_map(|chunk| &chunk.instances);
        heads.filter(|i| i.signal == link.signal && end.to_local(i.pose.xy()).x > beyond).count()
    };
    assert!(shown("p", -20.0) >= 2 && shown("q", -20.0) >= 2, "both have heads");
    assert_eq!(shown("p", 5.0), 0, "no head of the first stands behind the second's");

    let told = |network: &Network, front_s: f64, first: SignalState, second: SignalState| {
        let p = network.traffic_light_by_id("p").unwrap();
        let ahead = SignalAhead::find(network, &route(network), front_s, |signal| {
            Some(if signal.traffic_light == p { first } else { second })
        });
        let ahead = ahead.unwrap();
        (ahead.state, ahead.signal.traffic_light == p, ahead.stop_s)
    };
    let way = route(&network);
    let (first, second) = (way.links[0].stop_s, way.links[1].stop_s);
    let (green, red) = (SignalState::GreenMajor, SignalState::Red);
    assert_eq!(told(&network, 0.0, green, red), (red, false, first), "it waits before both");
    assert_eq!(told(&network, first + 1.0, green, red), (red, false, second), "it is between them already");
    assert_eq!(told(&network, 0.0, red, red), (red, true, first));
    assert_eq!(told(&network, 0.0, green, green), (green, true, first));
    // Where both are never green together, one that waits before both would wait for ever.
    let (_, never) = net(&nets, "45");
    assert_eq!(told(&never, 0.0, green, red), (red, false, second));
}

/// What became of a drive over both under the autopilot.
#[derive(Debug, Default)]
struct Drive {
    /// Places of the front bumper where it stood, from the first stop line on (m).
    stood: Vec<f64>,
    /// How long it stood while the first light was green (s).
    stood_at_green: f64,
    /// From the first stop line to the second (m).
    between: f64,
    arrived: bool,
}

fn drive(offset: &str) -> Drive {
    let nets = Nets::new();
    let (path, _) = net(&nets, offset);
    let assets = Assets::load(path.to_str().unwrap()).unwrap();
    let network = assets.network();
    let way = route(network);
    let (first, second) = (way.links[0].stop_s, way.links[1].stop_s);
    let signal = network.link(way.links[0].link).signal.unwrap();
    // A stand without a reason is told after 5 s.
    let criteria = CriteriaParams { blocked_after: 5.0, ..CriteriaParams::default() };
    let length = EgoParams::default().length;
    let mut report = Drive { between: second - first, ..Drive::default() };
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let mut seat =
            Seat::new(&assets, "ego", EgoParams::default(), Default::default(), criteria, way.clone());
        seat.place(way.clone(), 5.0, (0.0, 0.0));
        let options = BridgeOptions::new(assets.config(), nets.path("sumo"));
        let mut session = Session::start(&assets, &options, vec![seat]).await.unwrap();
        for _ in 0..1200 {
            let tick = session.step_one(Act::Expert).await.unwrap();
            let world = session.ego(0).previous_world();
            let facts = EgoFacts {
                network,
                route: &way,
                on_route: tick.before,
                length,
                signals: &world.traffic_lights,
                tick: 0.167,
            };
            let told = LightAhead::find(&facts).map(|light| (light.state, light.distance));
            // The autopilot keeps a line for half a metre more.
            let same = match (tick.decision.unwrap().light, told) {
                (Some(by), Some(told)) => by.0 == told.0 && (by.1 - told.1).abs() < 1e-6,
                (by, told) => by.is_none() && told.is_none(),
            };
            if told.is_some_and(|(_, distance)| distance < 40.0) && !same {
                assert!((0.0..0.5).contains(&(tick.before.front_s - first)), "{told:?}: {tick:?}");
            }
            let place = tick.after.front_s - first;
            if tick.after.state.speed < 0.1 && place > -10.0 {
                report.stood.push(place);
                let green = world.signal(signal).is_some_and(|state| !state.stops());
                report.stood_at_green += if green { 0.167 } else { 0.0 };
            }
            let fine = |event: &Event| matches!(event, Event::Arrival);
            assert!(tick.events.iter().all(fine), "{:?} at {place}", tick.events);
            report.arrived |= !tick.events.is_empty();
            if report.arrived {
                break;
            }
        }
        session.close().await.unwrap();
    });
    report
}

#[test]
fn the_autopilot_waits_before_both_of_two_close_lines() {
    // The second turns green this much later than the first: it is red while the first is green.
    let report = drive("20");
    assert!(report.arrived, "{report:?}");
    assert!(report.stood_at_green > 3.0, "it stands for the second: {report:?}");
    assert!(report.stood.iter().all(|&place| place < 0.0), "never in the first junction: {report:?}");
    assert!(report.stood.iter().all(|&place| place > -3.0), "at the line: {report:?}");
}

#[test]
fn close_lines_that_are_never_green_together_are_passed_one_after_the_other() {
    let report = drive("45");
    assert!(report.arrived, "{report:?}");
    let between = |place: &&f64| (0.0..report.between).contains(*place);
    assert!(report.stood.iter().filter(between).count() > 0, "it waits between them: {report:?}");
}
