//! Loads a network, says what is in it, and finds a route from one edge to another.
//!
//!     cargo run --release --example route -- town.net.xml FROM_EDGE TO_EDGE

use std::error::Error;
use std::path::Path;
use sumo_network::network::{EdgeKind, LanePosition, Network, VehicleClass};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [net, from, to] = arguments.as_slice() else {
        return Err("usage: route NET.net.xml FROM_EDGE TO_EDGE".into());
    };
    let network = Network::load(Path::new(net))?;
    let roads = network.edges.iter().filter(|edge| edge.kind == EdgeKind::Normal).count();
    println!(
        "{roads} roads, {} junctions, {} crossings, {} traffic lights",
        network.junctions.len(),
        network.crossings.len(),
        network.traffic_lights.len()
    );

    // The middle of the first lane of an edge that cars may use.
    let class = VehicleClass::Passenger;
    let place = |edge: &str| {
        let id = network.edge_by_id(edge).ok_or(format!("the network has no edge `{edge}`"))?;
        let mut lanes = network.edge(id).lanes.iter();
        let lane = lanes.find(|&&lane| network.lane(lane).permissions.allows(class));
        let &lane = lane.ok_or(format!("edge `{edge}` has no lane for cars"))?;
        Ok::<_, String>(LanePosition { lane, s: 0.5 * network.lane(lane).shape.length() })
    };
    let route = network.route(place(from)?, place(to)?, class)?;

    let edges: Vec<&str> = route.edges.iter().map(|&edge| network.edge(edge).id.as_str()).collect();
    println!("edges: {}", edges.join(" "));
    for link in &route.links {
        let option = network.road_option(link.link, class);
        println!("{:7.1} m: {option:?}", link.stop_s);
    }
    println!("{:7.1} m: arrived", route.length());
    Ok(())
}
