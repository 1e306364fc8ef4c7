//! Parks, squares, water, car parks from a net's polygons; roundabouts' islands; hills at the horizon.

use super::ground::uses;
use super::markings::{innermost, opposite};
use super::polygon::{area, cleaned, triangulate};
use super::street::{Site, car_park};
use super::tiles::{Levels, Tiles};
use crate::model::MaterialId;
use crate::shape::{Shaper, V3};
use nalgebra::Point3;
use std::f64::consts::TAU;
use sumo_network::geometry::{Point, Vector, polygon_contains, wrap_angle};
use sumo_network::network::{EdgeId, EdgeKind, Network, PointOfInterest, Polygon};

/// What an area's ground is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Use {
    Park,
    Forest,
    Plaza,
    Parking,
    Water,
}

fn use_of(polygon: &Polygon) -> Option<Use> {
    let kind = polygon.kind.to_ascii_lowercase();
    let any = |words: &[&str]| words.iter().any(|w| kind.contains(w));
    if any(&["building"]) {
        None
    } else if any(&["forest", "wood"]) {
        Some(Use::Forest)
    } else if any(&["park.", "leisure", "grass", "green", "garden", "meadow", "natural", "cemetery"])
        || kind == "park"
    {
        Some(Use::Park)
    } else if any(&["parking"]) {
        Some(Use::Parking)
    } else if any(&["plaza", "square", "pedestrian"]) {
        Some(Use::Plaza)
    } else if any(&["water", "river", "lake"]) {
        Some(Use::Water)
    } else {
        None
    }
}

/// Lays out the polygons' areas, lowest layer first. Plants come later, by [`plant`].
pub(super) fn lay(site: &mut Site<'_>, polygons: &[Polygon]) {
    let mut order: Vec<(usize, &Polygon, Use)> =
        polygons.iter().enumerate().filter_map(|(i, p)| Some((i, p, use_of(p)?))).collect();
    order.sort_by(|a, b| a.1.layer.total_cmp(&b.1.layer).then(a.0.cmp(&b.0)));
    let count = order.len().max(1) as f64;
    for (rank, (_, polygon, kind)) in order.into_iter().enumerate() {
        let outline = cleaned(&polygon.shape);
        let m = site.materials;
        let (material, bits) = match kind {
            Use::Park => (m.lawn, uses::PARK),
            Use::Forest => (m.grass, uses::PARK),
            Use::Plaza => (m.plaza, uses::PAVED),
            Use::Parking => (m.parking, uses::PAVED),
            Use::Water => (m.water, uses::WATER),
        };
        // Below every road, above the ground.
        let lift = -0.035 + 0.022 * rank as f64 / count;
        let terrain = site.terrain;
        for t in triangulate(&outline) {
            site.tiles.floor(t, &|p| terrain.at(p) + lift, material, Levels::All);
        }
        site.ground.fill(&outline, bits);
    }
}

/// Benches where points of type `bench` lie; they look at the nearest road.
pub(super) fn benches(site: &mut Site<'_>, points: &[PointOfInterest]) {
    for point in points.iter().filter(|point| point.kind == "bench") {
        let near = site.network.lanes_near(point.position, None, 30.0);
        let road = near.iter().find(|n| {
            site.network.lane(n.lane).permissions.allows(sumo_network::network::VehicleClass::Passenger)
        });
        let heading = road.map_or(0.0, |n| {
            let to = site.network.lane(n.lane).shape.at(n.s).xy() - point.position;
            to.y.atan2(to.x)
        });
        site.bench_at(point.position, heading);
    }
}

/// Trees and benches in parks, cars on car parks.
pub(super) fn plant(site: &mut Site<'_>, polygons: &[Polygon]) {
    for polygon in polygons {
        let outline = cleaned(&polygon.shape);
        let Some(kind) = use_of(polygon) else { continue };
        if outline.is_empty() {
            continue;
        }
        let size = area(&outline);
        if kind == Use::Parking {
            car_park(site, &outline);
            continue;
        }
        let per_tree = match kind {
            Use::Park => 150.0,
            Use::Forest => 60.0,
            Use::Plaza => 400.0,
            _ => continue,
        };
        let (lo, hi) = outline.iter().fold((outline[0], outline[0]), |(lo, hi), p| {
            (Point::new(lo.x.min(p.x), lo.y.min(p.y)), Point::new(hi.x.max(p.x), hi.y.max(p.y)))
        });
        let box_area = (hi.x - lo.x) * (hi.y - lo.y);
        let tries = (box_area / per_tree).min(4000.0) as usize;
        for i in 0..tries {
            let at = Point::new(site.dice.between(lo.x, hi.x), site.dice.between(lo.y, hi.y));
            if !polygon_contains(&outline, at) || !site.ground.disc_free(at, 1.0, uses::WAY | uses::BUILDING)
            {
                continue;
            }
            if i % 17 == 3 && size > 300.0 && kind != Use::Forest {
                let heading = site.dice.between(-3.0, 3.0);
                site.bench(at, heading);
                continue;
            }
            let plants = site.plants;
            let model = match site.dice.next() % 10 {
                0 => plants.slim,
                1 | 2 => plants.conifer,
                n => plants.broad[n as usize % plants.broad.len()],
            };
            let scale = site.dice.between(0.75, 1.35);
            site.tree(model, at, scale);
        }
    }
}

/// The inner border of a ring of one-way roads from `first`, if there is one: a roundabout's island.
fn ring(network: &Network, first: EdgeId) -> Option<(Vec<EdgeId>, Vec<Point>)> {
    let inward = if network.left_hand { -1.0 } else { 1.0 };
    let mut edges = vec![first];
    let mut border = Vec::new();
    let mut turned = 0.0;
    let mut length = 0.0;
    loop {
        let id = *edges.last()?;
        if opposite(network, id).is_some() {
            return None;
        }
        let lane = network.lane(innermost(network, id)?);
        let steps = (lane.shape.length() / 2.0).ceil().clamp(1.0, 200.0) as usize;
        for k in 0..=steps {
            let pose = lane.shape.at(lane.shape.length() * k as f64 / steps as f64);
            border.push(pose.to_world(Vector::new(0.0, inward * 0.5 * lane.width)));
        }
        let start = lane.shape.at(0.0).heading;
        let end = lane.shape.at(lane.shape.length()).heading;
        turned += wrap_angle(end - start);
        length += lane.shape.length();
        if length > 350.0 || edges.len() > 12 {
            return None;
        }
        // The way on that stays closest to the island.
        let (turn, next) = lane
            .outgoing
            .iter()
            .map(|&l| network.lane(network.link(l).to))
            .filter(|to| network.edge(to.edge).kind == EdgeKind::Normal)
            .map(|to| (wrap_angle(to.shape.at(0.0).heading - end), to.edge))
            .filter(|(turn, _)| turn.abs() < 1.9)
            .max_by(|a, b| (inward * a.0).total_cmp(&(inward * b.0)))?;
        turned += turn;
        if next == first {
            return (inward * turned > 0.8 * TAU && inward * turned < 1.2 * TAU).then_some((edges, border));
        }
        if edges.contains(&next) {
            return None;
        }
        edges.push(next);
    }
}

/// Kerbed, planted islands in roundabouts.
pub(super) fn islands(site: &mut Site<'_>) {
    let network = site.network;
    let mut done = vec![false; network.edges.len()];
    for number in 0..network.edges.len() {
        let id = EdgeId(number as u32);
        if done[number]
            || network.edges[number].kind != EdgeKind::Normal
            || network.edges[number].from.is_none()
        {
            continue;
        }
        let Some((edges, border)) = ring(network, id) else { continue };
        edges.iter().for_each(|e| done[e.index()] = true);
        let outline = cleaned(&border);
        let n = outline.len();
        if area(&outline) < 6.0 {
            continue;
        }
        let middle = Point::from(outline.iter().fold(Vector::zeros(), |s, p| s + p.coords) / n as f64);
        let z = network.lane(network.edges[number].lanes[0]).shape.at(0.0).position.z;
        // Rings from the border inwards: share of the way to the middle, height.
        let inset = |p: Point, by: f64| p + (middle - p) * (by / (middle - p).norm().max(0.5)).min(1.0);
        let radius = outline.iter().map(|p| (p - middle).norm()).fold(f64::INFINITY, f64::min);
        let rings = [
            (0.25, -0.02),
            (0.25, 0.14),
            (0.45, 0.14),
            (0.55, 0.20),
            (0.45 * radius, 0.75),
            (0.8 * radius, 1.0),
        ];
        let m = site.materials;
        for (k, pair) in rings.windows(2).enumerate() {
            let material = if k < 2 { m.kerb } else { m.lawn };
            for i in 0..n {
                let (a, b) = (outline[i], outline[(i + 1) % n]);
                let p = |q: Point, (by, up): (f64, f64)| {
                    let q = inset(q, by);
                    Point3::new(q.x, q.y, z + up)
                };
                let uv = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
                let corners = [p(a, pair[0]), p(b, pair[0]), p(b, pair[1]), p(a, pair[1])];
                site.tiles.wall(corners, uv, material, Levels::All);
            }
        }
        let top: Vec<Point> = outline.iter().map(|&p| inset(p, 0.8 * radius)).collect();
        for t in triangulate(&top) {
            site.tiles.floor(t, &|_| z + 1.0, m.lawn, Levels::All);
        }
        let count = ((radius * radius) / 14.0).clamp(3.0, 24.0) as usize;
        for i in 0..count {
            let turn = i as f64 * 2.4;
            let r = radius * 0.62 * (i as f64 / count as f64).sqrt();
            let at = middle + Vector::new(turn.cos(), turn.sin()) * r;
            let model = match i {
                0 if radius > 6.0 => site.plants.conifer,
                n if radius > 9.0 && n % 3 == 1 => site.plants.broad[n % site.plants.broad.len()],
                _ => site.plants.bush,
            };
            if let Some(mut plant) = site.put(model, at, turn, 0.3) {
                plant.pose.position.z = z + if r < 0.2 * radius { 0.95 } else { 0.7 };
                plant.tints[0] = super::trees::leaf_colour(site.dice.next());
                site.tiles.instance(plant);
            }
        }
        // A park there has no room for more.
        site.ground.fill(&outline, uses::OBJECT);
    }
}

/// Hills and far towers round the town, so that the horizon is not empty.
pub(super) fn horizon(
    network: &Network,
    low: f64,
    materials: (&[MaterialId; 2], MaterialId),
    seed: u64,
    tiles: &mut Tiles,
) {
    let (hills, towers) = materials;
    let (lo, hi) = network.bounds;
    let middle = lo + (hi - lo) * 0.5;
    let reach = (0.5 * (hi - lo).norm()).clamp(100.0, 20_000.0);
    if !reach.is_finite() {
        return;
    }
    let phase = (seed % 628) as f64 / 100.0;
    for (layer, (&material, (out, rise))) in hills.iter().zip([(260.0, 26.0), (620.0, 74.0)]).enumerate() {
        let radius = reach + out;
        let count = ((TAU * radius / 45.0) as usize).clamp(48, 600);
        let height = |i: usize| {
            let a = (i % count) as f64 / count as f64 * TAU;
            let wave = (3.0 * a + phase).sin()
                + 0.6 * (7.0 * a + 2.0 * phase).sin()
                + 0.35 * (17.0 * a + layer as f64).sin();
            let rough = 0.25 * (41.0 * a + phase).sin() + 0.2 * (73.0 * a).sin();
            low + rise * (0.62 + 0.28 * wave + 0.16 * rough).max(0.12)
        };
        let at = |i: usize, r: f64| {
            let a = (i % count) as f64 / count as f64 * TAU;
            middle + Vector::new(a.cos(), a.sin()) * r
        };
        for i in 0..count {
            let (a, b) = (at(i, radius), at(i + 1, radius));
            let (c, d) = (at(i + 1, radius + 1.6 * rise), at(i, radius + 1.6 * rise));
            let p = |q: Point, z: f64| Point3::new(q.x, q.y, z);
            let uv = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
            // Seen from inside.
            tiles.wall(
                [p(b, low - 2.0), p(a, low - 2.0), p(d, height(i)), p(c, height(i + 1))],
                uv,
                material,
                Levels::All,
            );
        }
    }
    // A few towers in groups.
    for i in 0..36_u64 {
        let key = sumo_network::seeds::derive(seed ^ i, "skyline");
        let group = (key >> 8) % 5;
        let a = group as f64 * 1.31 + phase + ((key >> 16) % 100) as f64 * 0.0035;
        let r = reach + 330.0 + ((key >> 24) % 160) as f64;
        let at = middle + Vector::new(a.cos(), a.sin()) * r;
        let (w, h) = (7.0 + (key >> 32 & 7) as f32, 22.0 + ((key >> 40) % 46) as f32);
        let mut s = Shaper::new(20.0);
        let corner: V3 = [-w, -w, -3.0];
        s.place(a as f32, [0.0; 3]);
        s.cuboid(corner, [w, w, h], false, towers);
        let mesh = s.finish();
        tiles.mesh(Point3::new(at.x, at.y, low), &mesh, Levels::All);
    }
}
