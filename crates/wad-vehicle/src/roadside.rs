//! The fixed bodies of a town, from its network and its polygons.

use super::statics::{KERB_RAMP, StaticBody, StaticKind};
use sumo_network::geometry::{Point, Pose, Vector};
use sumo_network::network::{Edge, EdgeKind, Lane, LaneId, Network, Polygon, VehicleClass};

/// Tops above the road (m).
const BUILDING_HEIGHT: f64 = 9.0;
const POLE_HEIGHT: f64 = 5.0;
const KERB_HEIGHT: f64 = 0.13;
/// Widths (m) of a pole, and of a kerb's top.
const POLE_WIDTH: f64 = 0.16;
const KERB_WIDTH: f64 = 0.2;
/// A pole's distance from the edge of the lanes (m), at least.
const POLE_OFFSET: f64 = 0.5;
/// How far a pole may be moved away from other lanes (m).
const POLE_SEARCH: f64 = 3.0;
/// Longest piece of a kerb (m).
const KERB_PIECE: f64 = 25.0;

/// Buildings (filled polygons whose type begins with `building`), a pole beside the stop line of
/// every signalled approach, and kerbs along the sidewalks' road side. Keys count from 0 in that order.
///
/// Poles stand off every lane of motor traffic; one that finds no such place is left out.
pub fn from_network(network: &Network, polygons: &[Polygon]) -> Vec<StaticBody> {
    let mut bodies: Vec<StaticBody> = polygons
        .iter()
        .filter(|polygon| polygon.fill && polygon.kind.starts_with("building"))
        .map(|polygon| StaticBody {
            key: 0,
            label: polygon.id.clone(),
            kind: StaticKind::Building,
            outline: polygon.shape.clone(),
            bottom: 0.0,
            top: BUILDING_HEIGHT,
            elevation: None,
        })
        .collect();
    let roads = || network.edges.iter().filter(|edge| edge.kind == EdgeKind::Normal);
    bodies.extend(roads().filter_map(|edge| pole(network, edge)));
    bodies.extend(roads().flat_map(|edge| kerbs(network, edge)));
    for (key, body) in (0u64..).zip(&mut bodies) {
        body.key = key;
    }
    bodies
}

fn is_motor_lane(lane: &Lane) -> bool {
    [VehicleClass::Passenger, VehicleClass::Bus, VehicleClass::Delivery, VehicleClass::Truck]
        .iter()
        .any(|&class| lane.permissions.allows(class))
}

fn is_sidewalk(lane: &Lane) -> bool {
    lane.permissions.allows(VehicleClass::Pedestrian) && !is_motor_lane(lane)
}

/// +1 where the lanes' outer side is on the left, -1 where it is on the right.
fn outer_side(network: &Network) -> f64 {
    if network.left_hand { 1.0 } else { -1.0 }
}

/// A rectangle round `pose`, counter-clockwise.
fn rectangle(pose: &Pose, length: f64, width: f64) -> Vec<Point> {
    [(0.5, 0.5), (-0.5, 0.5), (-0.5, -0.5), (0.5, -0.5)]
        .iter()
        .map(|(along, across)| pose.to_world(Vector::new(along * length, across * width)))
        .collect()
}

/// The pole of a signalled approach.
fn pole(network: &Network, edge: &Edge) -> Option<StaticBody> {
    let signalled =
        |&id: &LaneId| network.lane(id).outgoing.iter().any(|&link| network.link(link).signal.is_some());
    if !edge.lanes.iter().any(signalled) {
        return None;
    }
    let outermost = edge.lanes.iter().map(|&id| network.lane(id)).find(|lane| !is_sidewalk(lane))?;
    let stop_line = outermost.shape.at(outermost.shape.length());
    let z = stop_line.position.z;
    let outwards = |offset: f64| stop_line.to_world(Vector::new(0.0, outer_side(network) * offset));
    let mut offset = 0.5 * outermost.width + POLE_OFFSET;
    let limit = offset + POLE_SEARCH;
    while !is_off_the_road(network, outwards(offset), z) {
        offset += 0.25;
        if offset > limit {
            return None;
        }
    }
    let at = outwards(offset);
    Some(StaticBody {
        key: 0,
        label: format!("signal pole of edge {}", edge.id),
        kind: StaticKind::Pole,
        outline: rectangle(&Pose::new(at.x, at.y, z, stop_line.heading), POLE_WIDTH, POLE_WIDTH),
        bottom: 0.0,
        top: POLE_HEIGHT,
        elevation: Some(z),
    })
}

/// No lane of motor traffic within 0.3 m of a pole here.
fn is_off_the_road(network: &Network, at: Point, z: f64) -> bool {
    network.lanes_near(at, Some(z), 8.0).iter().all(|near| {
        let lane = network.lane(near.lane);
        !is_motor_lane(lane) || near.distance > 0.5 * lane.width + 0.3
    })
}

/// The kerbs between an edge's sidewalks and the lanes beside them. A kerb's ramp begins at the lanes'
/// edge, so that nothing of it lies on the road.
fn kerbs(network: &Network, edge: &Edge) -> Vec<StaticBody> {
    let mut bodies = Vec::new();
    for pair in edge.lanes.windows(2) {
        let (outer, inner) = (network.lane(pair[0]), network.lane(pair[1]));
        let towards_road = match (is_sidewalk(outer), is_sidewalk(inner)) {
            (true, false) => -outer_side(network),
            (false, true) => outer_side(network),
            _ => continue,
        };
        let sidewalk = if is_sidewalk(outer) { outer } else { inner };
        let offset = towards_road * (0.5 * sidewalk.width - KERB_RAMP - 0.5 * KERB_WIDTH).max(0.0);
        for corners in sidewalk.shape.points().windows(2) {
            let along = corners[1].xy() - corners[0].xy();
            let pieces = (along.norm() / KERB_PIECE).ceil().max(1.0);
            let heading = along.y.atan2(along.x);
            for i in 0..pieces as usize {
                let share = (i as f64 + 0.5) / pieces;
                let middle = corners[0] + (corners[1] - corners[0]) * share;
                let centre = Pose { position: middle, heading }.to_world(Vector::new(0.0, offset));
                let pose = Pose::new(centre.x, centre.y, middle.z, heading);
                bodies.push(StaticBody {
                    key: 0,
                    label: format!("kerb of lane {}", sidewalk.id),
                    kind: StaticKind::Kerb,
                    outline: rectangle(&pose, along.norm() / pieces, KERB_WIDTH),
                    bottom: 0.0,
                    top: KERB_HEIGHT,
                    elevation: Some(middle.z),
                });
            }
        }
    }
    bodies
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    /// One road of 100 m with a sidewalk (lane 0) and two lanes, and the same back, ending at a signal.
    fn network(left_hand: bool) -> Network {
        let lane = |id: &str, index: usize, y: f64, disallow: &str| {
            format!(
                r#"<lane id="{id}_{index}" index="{index}" {disallow} speed="13.89" length="100.00" width="3.00" shape="0.00,{y:.2} 100.00,{y:.2}"/>"#
            )
        };
        let side = if left_hand { 1.0 } else { -1.0 };
        let xml = format!(
            r#"<net version="1.20" {hand} junctionCornerDetail="5">
            <location netOffset="0.00,0.00" convBoundary="0.00,-10.00,210.00,10.00" origBoundary="0,0,1,1" projParameter="!"/>
            <edge id=":B_0" function="internal"><lane id=":B_0_0" index="0" disallow="pedestrian" speed="13.89" length="10.00" shape="100.00,{y2:.2} 110.00,{y2:.2}"/></edge>
            <edge id="a" from="A" to="B" priority="1">{walk}{outer}{inner}</edge>
            <edge id="b" from="B" to="C" priority="1"><lane id="b_0" index="0" disallow="pedestrian" speed="13.89" length="100.00" shape="110.00,{y2:.2} 210.00,{y2:.2}"/></edge>
            <tlLogic id="B" type="static" programID="0" offset="0"><phase duration="30" state="G"/></tlLogic>
            <junction id="A" type="dead_end" x="0" y="0" incLanes="" intLanes="" shape="0.00,-5.00 0.00,5.00"/>
            <junction id="B" type="traffic_light" x="105" y="0" incLanes="a_0 a_1 a_2" intLanes=":B_0_0" shape="100.00,-10.00 110.00,-10.00 110.00,0.00 100.00,0.00">
              <request index="0" response="0" foes="0" cont="0"/></junction>
            <junction id="C" type="dead_end" x="210" y="0" incLanes="b_0" intLanes="" shape="210.00,-5.00 210.00,5.00"/>
            <connection from="a" to="b" fromLane="2" toLane="0" via=":B_0_0" tl="B" linkIndex="0" dir="s" state="o"/>
            <connection from=":B_0" to="b" fromLane="0" toLane="0" dir="s" state="M"/>
            </net>"#,
            hand = if left_hand { r#"lefthand="true""# } else { "" },
            walk = lane("a", 0, side * 7.5, r#"allow="pedestrian""#),
            outer = lane("a", 1, side * 4.5, r#"disallow="pedestrian""#),
            inner = lane("a", 2, side * 1.5, r#"disallow="pedestrian""#),
            y2 = side * 1.5,
        );
        Network::from_xml(Path::new("test.net.xml"), &xml).expect("a network")
    }

    fn bounds(outline: &[Point]) -> [f64; 4] {
        outline.iter().fold([f64::MAX, f64::MIN, f64::MAX, f64::MIN], |b, p| {
            [b[0].min(p.x), b[1].max(p.x), b[2].min(p.y), b[3].max(p.y)]
        })
    }

    #[test]
    fn kerbs_lie_on_the_sidewalk_along_the_road() {
        for (left_hand, side) in [(false, -1.0), (true, 1.0)] {
            let bodies = from_network(&network(left_hand), &[]);
            let kerbs: Vec<_> = bodies.iter().filter(|b| b.kind == StaticKind::Kerb).collect();
            assert_eq!(kerbs.len(), 4);
            let mut length = 0.0;
            for kerb in kerbs {
                let [x0, x1, y0, y1] = bounds(&kerb.outline);
                length += x1 - x0;
                let nearest = if left_hand { y0 } else { -y1 };
                assert!((nearest - 6.0 - KERB_RAMP).abs() < 1e-9, "{nearest}");
                assert!(side * y0 > 0.0);
            }
            assert!((length - 100.0).abs() < 1e-6);
        }
    }

    #[test]
    fn the_pole_stands_beside_the_stop_line_off_the_lanes() {
        for (left_hand, side) in [(false, -1.0), (true, 1.0)] {
            let bodies = from_network(&network(left_hand), &[]);
            let poles: Vec<_> = bodies.iter().filter(|b| b.kind == StaticKind::Pole).collect();
            assert_eq!(poles.len(), 1);
            let [x0, x1, y0, y1] = bounds(&poles[0].outline);
            assert!((0.5 * (x0 + x1) - 100.0).abs() < 1e-9);
            assert!((0.5 * (y0 + y1) - side * 6.5).abs() < 1e-9, "{y0} {y1}");
        }
    }

    #[test]
    fn only_filled_buildings_become_bodies_and_keys_count_up() {
        let polygon = |id: &str, kind: &str, fill: bool| Polygon {
            id: id.to_owned(),
            kind: kind.to_owned(),
            colour: [0; 4],
            layer: 0.0,
            fill,
            height: None,
            shape: vec![Point::new(0.0, 20.0), Point::new(9.0, 20.0), Point::new(9.0, 30.0)],
        };
        let polygons = [
            polygon("park", "park", true),
            polygon("house", "building.residential", true),
            polygon("line", "building", false),
        ];
        let bodies = from_network(&network(false), &polygons);
        let buildings: Vec<_> = bodies.iter().filter(|b| b.kind == StaticKind::Building).collect();
        assert_eq!(buildings.len(), 1);
        assert_eq!(buildings[0].label, "house");
        assert!(bodies.iter().enumerate().all(|(i, body)| body.key == i as u64));
    }
}
