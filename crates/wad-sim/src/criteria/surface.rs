//! Which part of the road the wheels stand on.

use super::Situation;
use sumo_network::geometry::{Point, Vector, polygon_contains};
use sumo_network::network::{EdgeKind, JunctionId, Lane, Network, VehicleClass};

/// Slack for the tyre's own width and for the file's rounding (m).
const TOLERANCE: f64 = 0.15;

/// How far from a point lanes are searched (m): the largest junction's centre is still near
/// one of its lanes.
const REACH: f64 = 8.0;

/// Whether one of the ego's wheels stands on a sidewalk or off the road surface.
pub fn wheel_off_road(now: &Situation<'_>) -> bool {
    let pose = &now.after.state.pose;
    let (x, y) = (0.5 * now.wheelbase, 0.5 * now.track);
    // Nearly always all wheels stand on the lane that the route is on, and nothing need be searched.
    let lane = now.network.lane(now.route.section_at(now.after.s).lane);
    [(x, y), (x, -y), (-x, y), (-x, -y)].into_iter().any(|(x, y)| {
        let wheel = pose.to_world(Vector::new(x, y));
        !is_on(lane, lane.shape.project(wheel).distance) && !on_road(now.network, wheel, pose.position.z)
    })
}

/// Whether a point stands on a lane whose centre line is `distance` (m) away.
fn is_on(lane: &Lane, distance: f64) -> bool {
    distance <= 0.5 * lane.width + TOLERANCE
}

/// Whether a point lies on the surface that vehicles may use: a lane open to motor vehicles or
/// bicycles, or the inside of a junction without its walkingareas.
pub fn on_road(network: &Network, point: Point, z: f64) -> bool {
    let near = network.lanes_near(point, Some(z), REACH);
    let mut junctions: Vec<JunctionId> = Vec::new();
    for hit in &near {
        let lane = network.lane(hit.lane);
        let edge = network.edge(lane.edge);
        let road = matches!(edge.kind, EdgeKind::Normal | EdgeKind::Internal)
            && [VehicleClass::Passenger, VehicleClass::Bus, VehicleClass::Motorcycle, VehicleClass::Bicycle]
                .iter()
                .any(|class| lane.permissions.allows(*class));
        if road && is_on(lane, hit.distance) {
            return true;
        }
        for junction in [edge.junction, edge.from, edge.to].into_iter().flatten() {
            if !junctions.contains(&junction) {
                junctions.push(junction);
            }
        }
    }
    junctions.iter().any(|&id| {
        let junction = network.junction(id);
        polygon_contains(&junction.shape, point)
            && !junction.walkingareas.iter().any(|&area| {
                let outline: Vec<Point> = network.lane(area).shape.points().iter().map(|p| p.xy()).collect();
                polygon_contains(&outline, point)
            })
    })
}
