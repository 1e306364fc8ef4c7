//! Renders a street of a SUMO network with a parked car on it, and says what is in the picture.
//!
//!     cargo run --release --example picture -- town.net.xml picture.png

use std::error::Error;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use sumo_network::network::{Network, Shapes, VehicleClass};
use sumo_network::world::{Actor, ActorKind, ActorType, VehicleSignals, WorldState};
use wad_camera::scene::Look;
use wad_camera::{Camera, CameraConfig, Outputs, Picture, Preset, Town};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    let [net, picture] = arguments.as_slice() else {
        return Err("usage: picture NET.net.xml PICTURE.png".into());
    };
    let network = Network::load(net)?;
    // Houses and parks, where a town.poly.xml lies beside the net.
    let polygons = polygons(net);
    let shapes = if polygons.is_file() { Shapes::load(&polygons, &network)? } else { Shapes::default() };
    let mut town = Town::new(&network, &shapes, Look::of(1));

    // The middle of the longest lane, and a car 15 m ahead.
    let lanes = network.require_drivable(VehicleClass::Passenger)?;
    let lane = lanes.iter().map(|&lane| network.lane(lane));
    let lane = lane.max_by(|a, b| a.shape.length().total_cmp(&b.shape.length())).ok_or("no lane")?;
    let ego = lane.shape.at(0.5 * lane.shape.length());
    let hatchback = ActorType {
        id: "car.hatchback".to_owned(),
        kind: ActorKind::Car,
        length: 4.2,
        width: 1.8,
        height: 1.5,
        min_gap: 2.0,
    };
    let car = Actor {
        id: "parked".into(),
        key: 1,
        actor_type: Arc::new(hatchback),
        pose: ego.advanced(15.0),
        speed: 0.0,
        signals: VehicleSignals(VehicleSignals::BRAKE_LIGHT),
        lane: None,
        lane_position: 0.0,
    };
    town.follow(&WorldState { vehicles: vec![car], ..WorldState::default() }, None);

    let mut camera = Camera::new(CameraConfig::default())?;
    let weather = Preset::ClearSunset.into();
    let frame = camera.render(town.scene(), town.actors(), &ego, &weather, Outputs::ALL);
    Picture::rgb(frame).save(picture)?;
    println!("{}: {} x {} pixels, from lane {}", picture.display(), frame.width, frame.height, lane.id);
    for object in &frame.objects {
        let [left, top, right, bottom] = object.visible_box;
        println!("{:?} {:.1} m ahead: {left},{top} to {right},{bottom}", object.class, object.depth);
    }
    Ok(())
}

/// `town.poly.xml` for `town.net.xml`.
fn polygons(net: &Path) -> PathBuf {
    let name = net.file_name().unwrap_or_default().to_string_lossy();
    net.with_file_name(format!("{}.poly.xml", name.split(".net.xml").next().unwrap_or_default()))
}
