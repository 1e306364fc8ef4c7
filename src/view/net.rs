//! The street map that the page draws: sent once to each viewer.

use crate::geometry::{Point, Polyline};
use crate::network::{EdgeKind, LaneId, Network, Polygon, VehicleClass};
use serde_json::{Value, json};

/// The network and the polygons as JSON: coordinates in m, world frame, to the decimetre.
///
/// `lanes`: `[kind, width, x, y, x, y, ...]` with kind 0 road, 1 inside a junction, 2 for people on foot,
/// 3 other; `junctions`, `crossings`, `areas`: outlines (areas with their kind); `heads`: signal heads as
/// `[traffic light, index, x, y, heading, width]` at their stop lines; `bounds`: x and y from, to.
pub fn street_map(network: &Network, polygons: &[Polygon]) -> String {
    let lanes: Vec<Value> =
        (0..network.lanes.len()).filter_map(|i| lane(network, LaneId(i as u32))).collect();
    let outline = |points: &[Point]| flat(points.iter().copied());
    let junctions: Vec<Value> =
        network.junctions.iter().filter(|j| j.shape.len() > 2).map(|j| outline(&j.shape)).collect();
    let crossings: Vec<Value> = network.crossings.iter().map(|c| outline(&c.outline)).collect();
    let areas: Vec<Value> = polygons
        .iter()
        .filter(|p| p.fill && p.shape.len() > 2)
        .map(|p| json!([p.kind, outline(&p.shape)]))
        .collect();
    let (low, high) = network.bounds;
    let map = json!({
        "lanes": lanes,
        "junctions": junctions,
        "crossings": crossings,
        "areas": areas,
        "heads": heads(network),
        "lights": network.traffic_lights.len(),
        "bounds": [low.x, low.y, high.x, high.y],
    });
    map.to_string()
}

fn lane(network: &Network, id: LaneId) -> Option<Value> {
    let lane = network.lane(id);
    let drivable = lane.permissions.allows(VehicleClass::Passenger);
    let kind = match network.edge(lane.edge).kind {
        EdgeKind::Normal if drivable => 0,
        EdgeKind::Internal if drivable => 1,
        EdgeKind::Normal if lane.permissions.allows(VehicleClass::Pedestrian) => 2,
        EdgeKind::Normal => 3,
        _ => return None,
    };
    let mut values = vec![json!(kind), json!(lane.width)];
    values.extend(coordinates(lane.shape.points().iter().map(|p| p.xy())));
    Some(Value::Array(values))
}

/// One signal head per lane and light: links of a lane that share a colour are drawn as one by the page.
fn heads(network: &Network) -> Vec<Value> {
    let head = |link: &crate::network::Link| {
        let signal = link.signal?;
        let from = network.lane(link.from);
        let end = from.shape.at(from.shape.length());
        let at = end.xy();
        Some(json!([
            signal.traffic_light.index(),
            signal.index,
            tenth(at.x),
            tenth(at.y),
            (end.heading * 1000.0).round() / 1000.0,
            from.width
        ]))
    };
    network.links.iter().filter_map(head).collect()
}

/// A polyline up to `end` (m) as `[x, y, x, y, ...]`, a point about every `step` m.
pub fn line(line: &Polyline, end: f64, step: f64) -> Value {
    let count = (end / step).ceil().max(1.0) as usize;
    let at = |i: usize| line.at(end * i as f64 / count as f64).xy();
    flat((0..=count).map(at))
}

fn flat(points: impl Iterator<Item = Point>) -> Value {
    Value::Array(coordinates(points).collect())
}

fn coordinates(points: impl Iterator<Item = Point>) -> impl Iterator<Item = Value> {
    points.flat_map(|p| [json!(tenth(p.x)), json!(tenth(p.y))])
}

/// To the decimetre: half the bytes.
pub fn tenth(value: f64) -> f64 {
    (value * 10.0).round() / 10.0
}
