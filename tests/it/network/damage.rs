//! Damaged nets: an error or a network, never a panic.

use super::nets::{Nets, Random};
use proptest::prelude::*;
use wad_cosim::geometry::Point;
use wad_cosim::network::*;

/// A net's text with bytes changed, parts cut out or doubled, or its end cut off.
fn damaged(text: &str, cuts: &[(u8, usize, usize, u8)]) -> String {
    let mut bytes = text.as_bytes().to_vec();
    for &(kind, at, length, byte) in cuts {
        let at = at % bytes.len().max(1);
        let end = (at + length % 60).min(bytes.len());
        match kind % 5 {
            0 => bytes.truncate(at),
            1 => drop(bytes.drain(at..end)),
            2 => {
                let part = bytes[at..end].to_vec();
                bytes.splice(at..at, part);
            }
            3 => bytes[at..end].reverse(),
            _ => bytes[at] = byte,
        }
        if bytes.is_empty() {
            break;
        }
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

#[test]
fn no_damage_to_a_net_makes_the_reader_panic() {
    let nets = Nets::new();
    let arguments = [
        "--grid",
        "--grid.number",
        "2",
        "-L",
        "2",
        "--default.speed",
        "13.89",
        "--sidewalks.guess",
        "--crossings.guess",
        "-j",
        "traffic_light",
    ];
    let (path, _) = nets.make("netgenerate", &arguments);
    let text = std::fs::read_to_string(&path).unwrap();
    let cut = (any::<u8>(), any::<usize>(), any::<usize>(), any::<u8>());
    let config = ProptestConfig { cases: 1500, failure_persistence: None, ..ProptestConfig::default() };
    let mut runner = proptest::test_runner::TestRunner::new(config);
    let loaded = std::cell::Cell::new(0);
    runner
        .run(&proptest::collection::vec(cut, 1..6), |cuts| {
            match Network::from_xml(&path, &damaged(&text, &cuts)) {
                Ok(network) => {
                    loaded.set(loaded.get() + 1);
                    exercise(&network);
                }
                Err(error) => prop_assert!(error.to_string().contains(".net.xml")),
            }
            Ok(())
        })
        .unwrap();
    assert!(loaded.get() > 100, "some damage goes unnoticed: {}", loaded.get());
}

/// Uses all there is of a network that may be nonsense.
fn exercise(network: &Network) {
    network.lanes_near(Point::new(50.0, 50.0), Some(0.0), 100.0);
    let lanes = network.largest_component(VehicleClass::Passenger);
    let mut random = Random(1);
    for _ in 0..if lanes.is_empty() { 0 } else { 5 } {
        let (from, to) = (random.place(network, &lanes), random.place(network, &lanes));
        if let Ok(route) = network.route(from, to, VehicleClass::Passenger) {
            assert!(route.at(0.5 * route.length()).pose.position.x.is_finite());
        }
    }
    for &edge in network.sidewalk_edges().iter().take(3) {
        network.walk_route(edge, network.sidewalk_edges()[0]);
    }
}
