//! Broken and bare nets: they still render.

use super::places::{KINDS, Place};
use crate::{Outputs, Preset, model::SemanticTag};
use std::path::Path;
use sumo_network::geometry::Pose;
use sumo_network::network::{Network, Shapes};

/// From where, in which net, with what polygons.
fn pictures(net: &str, polygons: &str, poses: &[Pose]) -> Vec<crate::Frame> {
    let path = Path::new("odd.net.xml");
    let network = Network::from_xml(path, net).unwrap();
    let text = format!("<additional>{polygons}</additional>");
    let shapes = Shapes::from_xml(Path::new("odd.poly.xml"), &text, &network).unwrap();
    let mut place = Place::of(network, &shapes);
    place.put(
        &KINDS
            .iter()
            .enumerate()
            .map(|(k, _)| (k, Pose::new(20.0 + 8.0 * k as f64, 0.5, 0.0, 0.3)))
            .collect::<Vec<_>>(),
    );
    let mut frames = Vec::new();
    for pose in poses {
        for preset in [Preset::ClearNoon, Preset::HardRainSunset] {
            let frame = place.shoot(160, pose, preset);
            assert_eq!(frame.rgb.len(), 3 * 160 * 160);
            assert!(frame.depth.iter().all(|z| *z > 0.0), "{preset} at {pose:?}");
            frames.push(frame);
        }
    }
    frames
}

fn poses() -> Vec<Pose> {
    let mut poses = Vec::new();
    for (x, y, heading) in [(0.0, 0.0, 0.0), (30.0, 1.0, 0.2), (95.0, 0.0, 3.1), (100.0, 40.0, -1.5)] {
        poses.push(Pose::new(x, y, 0.0, heading));
    }
    poses
}

const ROAD: &str = r#"<net><junction id="a" type="dead_end" x="0" y="0" shape="0,-2 0,2"/><junction id="b" type="dead_end" x="200" y="0" shape="200,-2 200,2"/>
    <edge id="e" from="a" to="b"><lane id="e_0" index="0" speed="13.9" length="200" shape="0,0 200,0"/></edge></net>"#;

#[test]
fn a_net_without_polygons_signals_and_sidewalks_renders() {
    let frames = pictures(ROAD, "", &poses());
    let road = frames[0].semantic.iter().filter(|&&tag| tag == SemanticTag::Road as u8).count();
    assert!(road > 1000, "{road} pixels of road");
}

#[test]
fn lanes_without_length_and_spikes_render() {
    let net = r#"<net><junction id="a" type="priority" x="0" y="0" shape="-5,-5 5,5 5,-5 -5,5"/><junction id="b" type="priority" x="100" y="0" shape="100,0 100,0"/>
        <junction id="c" type="dead_end" x="100" y="80"/>
        <edge id="e" from="a" to="b"><lane id="e_0" index="0" speed="13.9" length="100" shape="5,0 95,0 20,0.01 95,-1"/></edge>
        <edge id="f" from="b" to="a"><lane id="f_0" index="0" speed="13.9" length="100" shape="95,3 95,3 94.99,3 50,3 50,60 50,3 5,3"/></edge>
        <edge id="z" from="b" to="c"><lane id="z_0" index="0" speed="13.9" length="0.1" shape="100,0 100,0"/><lane id="z_1" index="1" speed="13.9" length="0.1" width="0.01" shape="100,0 100,0.05"/></edge></net>"#;
    pictures(net, "", &poses());
}

#[test]
fn polygons_that_cross_themselves_render() {
    let polygons = r#"<poly id="b" type="building" fill="1" shape="20,20 40,40 40,20 20,40"><param key="height" value="1e9"/></poly>
        <poly id="f" type="building" fill="1" shape="60,10 60,10 60,10"/>
        <poly id="l" type="building" fill="1" shape="60,10 90,10 60,10.001 90,10.002"/>
        <poly id="s" type="park" fill="1" shape="0,30 50,30 0,30"/><poly id="w" type="water" fill="1" shape="-40,-40 40,-4 -40,-4 40,-40"/>
        <poly id="n" type="building" fill="1" shape="0,-30 30,-30 30,-60 0,-60"><param key="height" value="-4"/></poly>"#;
    pictures(ROAD, polygons, &poses());
}

#[test]
fn hills_render_with_sun_on_the_road_and_paint_on_it() {
    // 12 m up and down again, two lanes each way.
    let lane = |edge: &str, index: u32, y: f64, turned: bool| {
        let mut points: Vec<String> = (0..=40)
            .map(|k| {
                let x = 5.0 * f64::from(k);
                format!("{x:.1},{y:.1},{:.2}", 100.0 + 12.0 * (x / 200.0 * std::f64::consts::PI).sin())
            })
            .collect();
        if turned {
            points.reverse();
        }
        let shape = points.join(" ");
        format!(r#"<lane id="{edge}_{index}" index="{index}" speed="13.9" length="201" shape="{shape}"/>"#)
    };
    let net = format!(
        r#"<net><junction id="a" type="dead_end" x="0" y="0" shape="0,-7,100 0,7,100"/><junction id="b" type="dead_end" x="200" y="0" shape="200,-7,100 200,7,100"/>
        <edge id="e" from="a" to="b">{}{}</edge><edge id="f" from="b" to="a">{}{}</edge></net>"#,
        lane("e", 0, -4.8, false),
        lane("e", 1, -1.6, false),
        lane("f", 0, 4.8, true),
        lane("f", 1, 1.6, true)
    );
    // Where there are buildings, none are grown beside the road, to shade it.
    let building = |k: u32| {
        let x = 20 * k;
        let shape = format!("{x},400 {},400 {},410 {x},410", x + 10, x + 10);
        format!(r#"<poly id="far{k}" type="building" fill="1" shape="{shape}"/>"#)
    };
    let far: String = (0..9).map(building).collect();
    let height = |x: f64| 100.0 + 12.0 * (x / 200.0 * std::f64::consts::PI).sin();
    for x in [12.0, 55.0, 100.0, 150.0] {
        let frames = pictures(&net, &far, &[Pose::new(x, -4.8, height(x), 0.0)]);
        let frame = &frames[0];
        let mut light = Vec::new();
        let mut paint = 0;
        for (i, &tag) in frame.semantic.iter().enumerate().skip(160 * 100) {
            match tag {
                t if t == SemanticTag::Road as u8 => light.push(frame.rgb[3 * i]),
                t if t == SemanticTag::RoadLine as u8 => paint += 1,
                _ => {}
            }
        }
        light.sort_unstable();
        assert!(light.len() > 1500, "{x}: {} pixels of road", light.len());
        // In the shade it would be below 70.
        assert!(light[light.len() / 2] > 85, "{x}: the road is dark ({})", light[light.len() / 2]);
        assert!(paint > 60, "{x}: {paint} pixels of paint");
    }
}

#[test]
fn odd_sizes_render() {
    let network = Network::from_xml(Path::new("odd.net.xml"), ROAD).unwrap();
    let place = Place::of(network, &Shapes::default());
    for (width, height) in [(1, 1), (1, 300), (300, 1), (7, 5), (513, 3), (8192, 2)] {
        let mut camera = crate::Camera::new(crate::CameraConfig::sized(width, height)).unwrap();
        let (scene, actors) = (place.town.scene(), place.town.actors());
        let weather = Preset::HardRainSunset.into();
        let frame = camera.render(scene, actors, &Pose::new(30.0, 0.0, 0.0, 0.0), &weather, Outputs::ALL);
        assert_eq!((frame.rgb.len(), frame.depth.len()), (3 * width * height, width * height));
    }
}
