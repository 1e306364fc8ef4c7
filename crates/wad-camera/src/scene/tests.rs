use super::*;
use crate::model::{Chunk, Instance, ObjectClass, Paint, STATIC_IDS, SemanticTag};
use crate::shape::V3;
use crate::tests::towns;
use nalgebra::Point3;
use std::collections::BTreeSet;
use std::path::Path;
use sumo_network::geometry::{Point, direction, polygon_contains};
use sumo_network::network::{EdgeKind, Network};

fn town(name: &str) -> (Network, Shapes) {
    let net = towns::net(name);
    let network = Network::load(&net).unwrap();
    let polygons = net.with_file_name(format!("{name}.poly.xml"));
    let shapes =
        if polygons.is_file() { Shapes::load(&polygons, &network).unwrap() } else { Shapes::default() };
    (network, shapes)
}

/// FNV over every number of a scene.
fn hash(scene: &Scene) -> u64 {
    let mut h = 0xcbf2_9ce4_8422_2325_u64;
    let mut add = |bits: u64| h = (h ^ bits).wrapping_mul(0x0100_0000_01b3);
    for chunk in &scene.chunks {
        for (_, mesh) in &chunk.levels {
            for v in &mesh.vertices {
                v.position.iter().chain(&v.normal).chain(&v.uv).for_each(|c| add(c.to_bits().into()));
            }
            mesh.triangles.iter().for_each(|t| add(u64::from(t.corners[2]) << 16 | u64::from(t.material.0)));
        }
        chunk.paint.iter().flat_map(|p| p.corners.iter().flatten()).for_each(|c| add(c.to_bits().into()));
        for i in &chunk.instances {
            add(i.pose.position.x.to_bits() ^ i.pose.heading.to_bits());
            add(u64::from(i.model.0) ^ u64::from(i.tints[0][0].to_bits()));
        }
    }
    scene.library.materials.iter().for_each(|m| add(m.albedo[0].to_bits().into()));
    h
}

/// How far inside a lane or crossing a point is (m); 0 or less beside all of them.
fn intrusion(network: &Network, p: Point3<f64>) -> f64 {
    let near = network.lanes_near(p.xy(), Some(p.z), 8.0);
    let lanes = near.iter().map(|n| 0.5 * network.lane(n.lane).width - n.distance).fold(f64::MIN, f64::max);
    let on_crossing = network.crossings.iter().any(|c| polygon_contains(&c.outline, p.xy()));
    lanes.max(if on_crossing { 1.0 } else { f64::MIN })
}

fn stands(tag: SemanticTag) -> bool {
    use SemanticTag as Tag;
    matches!(
        tag,
        Tag::Building
            | Tag::Pole
            | Tag::Vegetation
            | Tag::TrafficLight
            | Tag::TrafficSign
            | Tag::GuardRail
            | Tag::Static
            | Tag::Car
            | Tag::Wall
    )
}

/// Every place (world, m) where something stands between `low` and `high` over its chunk's ground.
fn standing_points(scene: &Scene, low: f32, high: f32) -> Vec<(Point3<f64>, &str)> {
    let mut points = Vec::new();
    let mut sample = |corners: [Point3<f64>; 3], what| {
        for (a, b) in [(0, 1), (1, 2), (2, 0)] {
            let (a, b) = (corners[a], corners[b]);
            let steps = ((b - a).norm() / 0.8).ceil().max(1.0);
            for k in 0..steps as usize {
                points.push((a + (b - a) * (k as f64 / steps), what));
            }
        }
    };
    for chunk in &scene.chunks {
        let mesh = &chunk.levels[0].1;
        for t in &mesh.triangles {
            let material = &scene.library.materials[t.material.0 as usize];
            if stands(material.tag) {
                sample(
                    t.corners.map(|i| {
                        let p = mesh.vertices[i as usize].position;
                        chunk.origin + nalgebra::Vector3::new(p[0], p[1], p[2]).cast()
                    }),
                    material.name.as_str(),
                );
            }
        }
        for instance in &chunk.instances {
            let model = &scene.library.models[usize::from(instance.model.0)];
            let mesh = &model.levels[0].mesh;
            for t in &mesh.triangles {
                sample(
                    t.corners.map(|i| {
                        let p = mesh.vertices[i as usize].position;
                        let s: [f64; 3] = std::array::from_fn(|k| f64::from(p[k] * instance.scale[k]));
                        let at = instance.pose.to_world(nalgebra::Vector2::new(s[0], s[1]));
                        Point3::new(at.x, at.y, instance.pose.position.z + s[2])
                    }),
                    model.name.as_str(),
                );
            }
        }
    }
    points.retain(|(p, _)| p.z > f64::from(low) && p.z < f64::from(high));
    points
}

#[test]
fn nothing_stands_on_a_lane_or_crossing_of_any_bundled_town() {
    for name in towns::names() {
        let (network, shapes) = town(&name);
        let (scene, _) = build(&network, &shapes, Look::of(1));
        let points = standing_points(&scene, 0.2, 2.0);
        assert!(points.len() > 100_000, "{name}: only {} points stand", points.len());
        let worst = points
            .iter()
            .map(|(p, what)| (intrusion(&network, Point3::new(p.x, p.y, 0.0)), p, what))
            .max_by(|a, b| a.0.total_cmp(&b.0))
            .unwrap();
        assert!(
            worst.0 < 0.05,
            "{name}: {} {:.2} m inside a lane or crossing at {:?}",
            worst.2,
            worst.0,
            worst.1
        );
    }
}

#[test]
fn houses_on_a_slope_do_not_float() {
    let (network, shapes) = town("town7");
    let terrain = ground::Terrain::of(&network);
    assert!(!terrain.flat);
    let (scene, _) = build(&network, &shapes, Look::of(1));
    let mut lowest = std::collections::BTreeMap::new();
    for chunk in &scene.chunks {
        let mesh = &chunk.levels[0].1;
        for t in &mesh.triangles {
            if scene.library.materials[t.material.0 as usize].tag != SemanticTag::Building {
                continue;
            }
            for i in t.corners {
                let p = mesh.vertices[i as usize].position.map(f64::from);
                let key = [chunk.origin.x + p[0], chunk.origin.y + p[1]].map(|c| (c * 4.0).round() as i64);
                let low = lowest.entry(key).or_insert(f64::INFINITY);
                *low = low.min(chunk.origin.z + p[2]);
            }
        }
    }
    let mut corners = 0;
    for polygon in shapes.polygons.iter().filter(|p| p.kind.starts_with("building")) {
        for p in &polygon.shape {
            let key = [p.x, p.y].map(|c| (c * 4.0).round() as i64);
            let Some(low) = lowest.get(&key) else { continue };
            assert!(*low <= terrain.at(*p), "{}: {:.2} m over the ground", polygon.id, low - terrain.at(*p));
            corners += 1;
        }
    }
    assert!(corners > 1000, "{corners}");
}

#[test]
fn bridges_have_rails_over_the_water_and_nowhere_else() {
    let (network, shapes) = town("town7");
    let river = shapes.polygons.iter().find(|p| p.kind == "water").unwrap();
    let (scene, _) = build(&network, &shapes, Look::of(1));
    let mut posts = [0, 0];
    for (p, _) in standing_points(&scene, 1.0, 1.25).iter().filter(|(_, what)| *what == "guard rail") {
        let near = (0..8).any(|k| {
            let out = direction(f64::from(k) * std::f64::consts::FRAC_PI_4) * 6.0;
            polygon_contains(&river.shape, p.xy() + out)
        });
        assert!(near, "a rail at {p:?}");
        // Bridge Avenue lies in the west, Stone Bridge in the east.
        posts[usize::from(p.x > 300.0)] += 1;
    }
    assert!(posts.iter().all(|&n| n > 100), "{posts:?}");
    let (network, shapes) = town("town3");
    let (scene, _) = build(&network, &shapes, Look::of(1));
    let rails = standing_points(&scene, 1.0, 1.25).iter().filter(|(_, what)| *what == "guard rail").count();
    assert_eq!(rails, 0, "no road of town3 crosses its river");
}

/// A road over another: at both ends on the ground, in the middle 9 m above it.
const OVERPASS: &str = r#"<net><junction id="a" type="dead_end" x="0" y="-300"/><junction id="b" type="dead_end" x="0" y="300"/>
    <junction id="c" type="dead_end" x="-300" y="0"/><junction id="d" type="dead_end" x="300" y="0"/>
    <edge id="over" from="a" to="b"><lane id="over_0" index="0" allow="pedestrian" width="2" speed="2.8" length="600" shape="2.6,-300,0 2.6,-100,9 2.6,100,9 2.6,300,0"/>
    <lane id="over_1" index="1" disallow="pedestrian" speed="13.9" length="600" shape="0,-300,0 0,-100,9 0,100,9 0,300,0"/></edge>
    <edge id="under" from="c" to="d"><lane id="under_0" index="0" speed="13.9" length="600" shape="-300,0,0 300,0,0"/></edge>
    <edge id="by" from="c" to="d"><lane id="by_0" index="0" speed="13.9" length="600" shape="-300,-60,0 300,-60,0"/></edge></net>"#;

#[test]
fn a_road_above_another_is_a_bridge_with_rails_and_piers() {
    let network = Network::from_xml(Path::new("over.net.xml"), OVERPASS).unwrap();
    let (scene, _) = build(&network, &Shapes::default(), Look::of(1));
    // Over the road below there are rails on both sides, a metre above the deck.
    let rails = standing_points(&scene, f32::MIN, f32::MAX);
    for side in [-1.0, 1.0] {
        let there = |(p, what): &&(Point3<f64>, &str)| {
            *what == "guard rail" && p.y.abs() < 10.0 && p.x * side > 1.0 && (9.5..10.5).contains(&p.z)
        };
        assert!(rails.iter().any(|point| there(&point)), "side {side}");
    }
    // What carries it stands on the ground, beside the road below.
    let mut piers = 0;
    for chunk in &scene.chunks {
        let mesh = &chunk.levels[0].1;
        for vertex in &mesh.vertices {
            let p = chunk.origin.cast::<f32>() + nalgebra::Vector3::from(vertex.position);
            // A pier's upper end, below the deck.
            if p.x.abs() < 1.0 && p.y.abs() < 90.0 && (7.0..7.6).contains(&p.z) {
                piers += 1;
                assert!(p.y.abs() > 1.6 + 1.0, "a pier on the road at {p:?}");
            }
        }
    }
    assert!(piers > 0, "nothing carries it");
    // And nothing stands under it that would reach it.
    for (p, what) in standing_points(&scene, 3.0, 30.0) {
        let under = p.y.abs() < 12.0 && p.x.abs() < 4.0;
        assert!(!under || what == "guard rail", "{what} at {p:?}");
    }
}

#[test]
fn equal_seeds_give_equal_towns() {
    let (network, shapes) = town("town5");
    let one = hash(&build(&network, &shapes, Look::of(7)).0);
    assert_eq!(one, hash(&build(&network, &shapes, Look::of(7)).0));
    assert_ne!(one, hash(&build(&network, &shapes, Look::of(8)).0));
}

#[test]
fn looks_have_less_paint_other_trees_and_no_parked_cars() {
    let (network, shapes) = town("town3");
    let usual = Look::of(0);
    let all = |look: Look| build(&network, &shapes, look).0;
    let paint = |scene: &Scene| -> f32 {
        let area = |p: &Paint| {
            let [a, b, c, _] = p.corners;
            let length = |a: V3, b: V3| ((a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2)).sqrt();
            length(a, b) * length(b, c) * p.strength
        };
        scene.chunks.iter().flat_map(|chunk| &chunk.paint).map(area).sum()
    };
    let parked = |scene: &Scene| {
        let car = |i: &&Instance| i.object.as_ref().is_some_and(|o| o.class == ObjectClass::Car);
        scene.chunks.iter().flat_map(|chunk| &chunk.instances).filter(car).count()
    };
    let placed = |scene: &Scene| scene.chunks.iter().map(|chunk| chunk.instances.len()).sum::<usize>();
    let known = all(usual);
    let worn = all(Look { paint: 0.3, ..usual });
    assert!((0.1..0.5).contains(&(paint(&worn) / paint(&known))), "{} {}", paint(&worn), paint(&known));
    assert_eq!((parked(&worn), placed(&worn)), (parked(&known), placed(&known)));
    assert_eq!(paint(&all(Look { paint: 0.0, ..usual })), 0.0);
    // Those of car parks stay.
    let (none, many) = (all(Look { parked: 0.0, ..usual }), all(Look { parked: 1.5, ..usual }));
    assert!(parked(&none) < parked(&known) && parked(&known) < parked(&many));
    let (bare, leafy) = (all(Look { trees: 0.0, ..usual }), all(Look { trees: 2.0, ..usual }));
    assert!(placed(&bare) < placed(&known) && placed(&known) < placed(&leafy));
}

#[test]
fn levels_get_smaller_and_bounds_hold_what_is_in_them() {
    for name in towns::names() {
        let (network, shapes) = town(&name);
        let (scene, _) = build(&network, &shapes, Look::of(1));
        let baked: Vec<usize> =
            (0..3).map(|l| scene.chunks.iter().map(|c| c.levels[l].1.triangles.len()).sum()).collect();
        println!("{name}: {baked:?} triangles");
        assert!(baked[1] * 10 < baked[0] * 9 && baked[2] * 10 < baked[1] * 9, "{name} {baked:?}");
        for chunk in &scene.chunks {
            assert!(chunk.levels.windows(2).all(|w| w[0].0 < w[1].0));
            assert!(chunk.levels.last().is_some_and(|l| l.0.is_infinite()));
            assert!(all_within(chunk), "chunk at {:?}", chunk.origin);
        }
    }
}

fn all_within(chunk: &Chunk) -> bool {
    let [lo, hi] = chunk.bounds;
    let inside = |p: &[f32; 3]| (0..3).all(|i| p[i] >= lo[i] - 1e-3 && p[i] <= hi[i] + 1e-3);
    chunk.levels.iter().flat_map(|(_, m)| &m.vertices).all(|v| inside(&v.position))
        && chunk.paint.iter().flat_map(|p| &p.corners).all(inside)
}

#[test]
fn every_traffic_light_has_heads_that_face_its_traffic() {
    for name in towns::names() {
        let (network, shapes) = town(&name);
        let (scene, _) = build(&network, &shapes, Look::of(1));
        let heads: Vec<_> =
            scene.chunks.iter().flat_map(|c| &c.instances).filter(|i| i.signal.is_some()).collect();
        let mut seen = BTreeSet::new();
        for head in &heads {
            let signal = head.signal.unwrap();
            let light = network.traffic_light(signal.traffic_light);
            assert!(signal.index < light.signals);
            seen.insert(signal.traffic_light);
            let Some(link) = light.links.iter().map(|&l| network.link(l)).find(|l| l.signal == Some(signal))
            else {
                continue;
            };
            // Over or beside the end of its approach, or beyond the junction, and seen by those who come.
            let lane = network.lane(link.from);
            let end = lane.shape.at(lane.shape.length());
            assert!((end.xy() - head.pose.xy()).norm() < 80.0);
            assert!(direction(end.heading).dot(&direction(head.pose.heading)) > 0.8, "{name} {signal:?}");
        }
        assert_eq!(seen.len(), network.traffic_lights.len(), "{name}");
    }
}

#[test]
fn who_waits_at_the_line_sees_a_head_ahead() {
    for name in towns::names() {
        let (network, shapes) = town(&name);
        let (scene, _) = build(&network, &shapes, Look::of(1));
        let heads: Vec<_> =
            scene.chunks.iter().flat_map(|c| &c.instances).filter(|i| i.signal.is_some()).collect();
        for link in network.links.iter().filter(|l| l.signal.is_some()) {
            let lane = network.lane(link.from);
            let end = lane.shape.at(lane.shape.length());
            let light = link.signal.map(|s| s.traffic_light);
            let seen = heads.iter().any(|head| {
                let local = end.to_local(head.pose.xy());
                let ours = head.signal.map(|s| s.traffic_light) == light;
                ours && local.x > 6.0
                    && local.x < 75.0
                    && local.y.abs() < 0.9 * local.x
                    && direction(end.heading).dot(&direction(head.pose.heading)) > 0.9
            });
            assert!(seen, "{name}: nothing ahead of {}", lane.id);
        }
    }
}

#[test]
fn static_objects_have_unique_ids_and_lie_in_the_town() {
    let (network, shapes) = town("town3");
    let (scene, _) = build(&network, &shapes, Look::of(1));
    let mut ids = BTreeSet::new();
    for object in scene.chunks.iter().flat_map(|c| &c.instances).filter_map(|i| i.object) {
        assert!(object.id >= STATIC_IDS && ids.insert(object.id));
        assert!(object.bounds.size.iter().all(|&s| s > 0.1));
    }
    assert!(ids.len() > 200);
}

#[test]
fn paint_lies_on_the_road_and_can_be_seen() {
    let (network, shapes) = town("town5");
    let (scene, _) = build(&network, &shapes, Look::of(1));
    let mut off = 0;
    let mut flat = 0;
    let mut all = 0;
    for chunk in &scene.chunks {
        for paint in &chunk.paint {
            let c = &paint.corners;
            let twice = |a: usize, b: usize| c[a][0] * c[b][1] - c[b][0] * c[a][1];
            let whole = twice(0, 1) + twice(1, 2) + twice(2, 3) + twice(3, 0);
            let first_three = twice(0, 1) + twice(1, 2) + twice(2, 0);
            flat += usize::from(whole.abs() > 0.04 && (whole < 0.0 || first_three < 0.002));
            let sum = paint.corners.iter().fold([0.0; 2], |s, c| [s[0] + c[0] / 4.0, s[1] + c[1] / 4.0]);
            let p = Point::new(chunk.origin.x + f64::from(sum[0]), chunk.origin.y + f64::from(sum[1]));
            let on = network
                .lanes_near(p, None, 4.0)
                .iter()
                .any(|n| n.distance < 0.5 * network.lane(n.lane).width + 0.4);
            let parking =
                shapes.polygons.iter().any(|q| q.kind == "parking" && polygon_contains(&q.shape, p));
            all += 1;
            off += usize::from(!on && !parking);
        }
    }
    assert!(all > 3000 && off == 0, "{off} of {all} are off the road");
    assert_eq!(flat, 0, "of {all} show their back or begin with three corners on a line");
}

/// Nets that nobody draws on purpose.
const ODD: [&str; 4] = [
    // Lanes without length, a spike, a junction that crosses itself, one without a shape.
    r#"<net><junction id="a" type="priority" x="0" y="0" shape="-5,-5 5,5 5,-5 -5,5"/><junction id="b" type="priority" x="100" y="0" shape="100,0 100,0"/>
    <junction id="c" type="dead_end" x="100" y="80"/>
    <edge id="e" from="a" to="b"><lane id="e_0" index="0" speed="13.9" length="100" shape="5,0 95,0 20,0.01 95,-1"/></edge>
    <edge id="z" from="b" to="c"><lane id="z_0" index="0" speed="13.9" length="0.1" shape="100,0 100,0"/><lane id="z_1" index="1" speed="13.9" length="0.1" width="0.01" shape="100,0 100,0.05"/></edge></net>"#,
    // Elevation, traffic on the left.
    r#"<net lefthand="true"><junction id="a" type="priority" x="0" y="0" shape="-5,-5 5,-5 5,5 -5,5"/><junction id="b" type="priority" x="200" y="0" shape="195,-5,30 205,-5,30 205,5,30 195,5,30"/>
    <edge id="ab" from="a" to="b"><lane id="ab_0" index="0" allow="pedestrian" width="2" speed="2.8" length="190" shape="5,4.6,0 100,4.6,18 195,4.6,30"/><lane id="ab_1" index="1" disallow="pedestrian" speed="13.9" length="190" shape="5,2,0 100,2,18 195,2,30"/></edge>
    <edge id="ba" from="b" to="a"><lane id="ba_0" index="0" speed="13.9" length="190" shape="195,-2,30 100,-2,18 5,-2,0"/></edge></net>"#,
    // Far away, and huge.
    r#"<net><junction id="a" type="priority" x="0" y="0"/><junction id="b" type="priority" x="90000" y="900000"/>
    <edge id="ab" from="a" to="b"><lane id="ab_0" index="0" speed="40" length="904000" width="100" shape="0,0 90000,900000"/></edge></net>"#,
    // Only rails and water.
    r#"<net><junction id="a" type="priority" x="0" y="0"/><junction id="b" type="priority" x="90" y="0"/>
    <edge id="r" from="a" to="b"><lane id="r_0" index="0" allow="tram" speed="14" length="90" shape="0,0 90,0"/></edge>
    <edge id="w" from="b" to="a"><lane id="w_0" index="0" allow="ship" speed="4" length="90" shape="90,9 0,9"/></edge></net>"#,
];

#[test]
fn odd_nets_build_and_everything_is_finite() {
    for (i, text) in ODD.iter().enumerate() {
        let path = Path::new("odd.net.xml");
        let network = Network::from_xml(path, text).unwrap();
        let shapes = Shapes::from_xml(
            path,
            r#"<additional><poly id="b" type="building" fill="1" shape="20,20 40,40 40,20 20,40"><param key="height" value="1e9"/></poly>
            <poly id="s" type="park" fill="1" shape="0,30 50,30 0,30"/><poly id="p" type="parking" fill="1" shape="50,30 90,30 90,70 50,70"/>
            <poly id="x" type="building" fill="1" shape="0,-5 60,-5 60,5 0,5"/></additional>"#,
            &network,
        )
        .unwrap();
        let (scene, _) = build(&network, &shapes, Look::of(3));
        for chunk in &scene.chunks {
            for (_, mesh) in &chunk.levels {
                assert!(mesh.vertices.iter().all(|v| v.position.iter().all(|c| c.is_finite())), "net {i}");
            }
        }
    }
}

#[test]
fn a_left_hand_net_has_its_kerb_towards_the_road() {
    let network = Network::from_xml(Path::new("left.net.xml"), ODD[1]).unwrap();
    assert!(network.left_hand);
    let (scene, _) = build(&network, &Shapes::default(), Look::of(1));
    let kerb = scene.library.materials.iter().position(|m| m.name == "kerb").unwrap();
    // The face towards the road looks south, to the driven lane at y = 2.
    let mut faces = 0;
    for chunk in &scene.chunks {
        let mesh = &chunk.levels[2].1;
        for t in mesh.triangles.iter().filter(|t| t.material.0 as usize == kerb) {
            let v = &mesh.vertices[t.corners[0] as usize];
            assert!(v.normal[1] < -0.9, "{v:?}");
            assert!((f64::from(v.position[1]) + chunk.origin.y - 3.6).abs() < 0.05);
            faces += 1;
        }
    }
    assert!(faces >= 10);
}

#[test]
fn nets_without_polygons_get_houses_beside_their_roads() {
    let (network, _) = town("town5");
    let (scene, _) = build(&network, &Shapes::default(), Look::of(1));
    let walls = scene
        .chunks
        .iter()
        .flat_map(|c| &c.levels[0].1.triangles)
        .filter(|t| scene.library.materials[t.material.0 as usize].tag == SemanticTag::Building)
        .count();
    assert!(walls > 1000, "{walls}");
    let worst = standing_points(&scene, 0.2, 2.0)
        .iter()
        .map(|(p, _)| intrusion(&network, Point3::new(p.x, p.y, 0.0)))
        .fold(f64::MIN, f64::max);
    assert!(worst < 0.05, "{worst:.2} m inside a lane");
}

#[test]
fn the_games_of_sumo_build() {
    let home = sumo_traci::SumoInstall::find().unwrap().home().to_path_buf();
    let mut built = 0;
    for folder in std::fs::read_dir(home.join("tools/game")).unwrap().flatten().map(|f| f.path()) {
        for file in std::fs::read_dir(&folder).into_iter().flatten().flatten().map(|f| f.path()) {
            let name = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
            if !(name.ends_with(".net.xml") || name.ends_with(".net.xml.gz")) {
                continue;
            }
            let network = Network::load(&file).unwrap();
            let lanes =
                network.lanes.iter().filter(|l| network.edge(l.edge).kind == EdgeKind::Normal).count();
            let (scene, _) = build(&network, &Shapes::default(), Look::of(1));
            assert!(!scene.chunks.is_empty(), "{name} with {lanes} lanes");
            built += 1;
        }
    }
    assert!(built >= 10, "only {built} nets found");
}
