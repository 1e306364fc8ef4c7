//! Which part of the road the wheels stand on.

use super::Situation;
use sumo_network::geometry::{Point, Vector, polygon_contains};
use sumo_network::network::{EdgeKind, JunctionId, Network, VehicleClass};

/// Slack for the tyre's own width and for the file's rounding (m).
const TOLERANCE: f64 = 0.15;

/// How far from a point lanes are searched (m): the largest junction's centre is still near
/// one of its lanes.
const REACH: f64 = 8.0;

/// Whether one of the ego's wheels stands on a sidewalk or off the road surface.
pub fn wheel_off_road(now: &Situation<'_>) -> bool {
    let pose = &now.after.state.pose;
    let (x, y) = (0.5 * now.wheelbase, 0.5 * now.track);
    [(x, y), (x, -y), (-x, y), (-x, -y)]
        .into_iter()
        .any(|(x, y)| !on_road(now.network, pose.to_world(Vector::new(x, y)), pose.position.z))
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
        if road && hit.distance <= 0.5 * lane.width + TOLERANCE {
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
