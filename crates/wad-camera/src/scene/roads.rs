//! Carriageways, kerbs, sidewalks, junctions.

use super::ground::{Ground, Terrain, uses};
use super::materials::Materials;
use super::polygon::{cleaned, triangulate};
use super::tiles::{Corner, Levels, Tiles};
use crate::model::{CHUNK_SIZE, MaterialId};
use nalgebra::{Point3, Vector3};
use sumo_network::geometry::{Point, Polyline, Vector};
use sumo_network::network::{EdgeKind, Junction, Lane, Network, VehicleClass};

/// Height of a kerb and breadth of its stone (m).
pub(super) const KERB: f64 = 0.12;
const KERB_STONE: f64 = 0.15;
/// How far below a road's surface its sides reach (m).
const SKIRT: f64 = 0.25;
/// How far ramps at crossings reach into the road (m).
const RAMP: f64 = 0.35;
/// Junctions lie this much below lanes (m), which overlap them a little.
const JUNCTION_BELOW: f64 = 0.005;

/// What a lane is built as.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Surface {
    Road,
    Sidewalk,
    Rails,
    /// Nothing: closed to all, waterways, cable cars.
    Nothing,
}

/// SUMO's classes that run on rails: tram, rail_urban, rail, rail_electric, rail_fast, subway.
const RAIL: u64 = 0b1_1111 << 16 | 1 << 26;

pub(super) fn surface(lane: &Lane) -> Surface {
    let p = lane.permissions;
    let driven = VehicleClass::EVERY.iter().any(|&c| c != VehicleClass::Pedestrian && p.allows(c));
    if driven {
        Surface::Road
    } else if p.allows(VehicleClass::Pedestrian) {
        Surface::Sidewalk
    } else if p.0 & RAIL != 0 {
        Surface::Rails
    } else {
        Surface::Nothing
    }
}

/// A place along a line, and the way to its left there.
#[derive(Clone, Copy, Debug)]
pub(super) struct Station {
    pub at: Point3<f64>,
    /// To the left; longer than 1 at corners, so that parallel lines stay parallel.
    pub left: Vector,
    /// Distance along the line (m).
    pub s: f64,
}

impl Station {
    /// The point `d` (m) to the left and `up` (m) above.
    pub fn off(&self, d: f64, up: f64) -> Point3<f64> {
        self.at + Vector3::new(self.left.x * d, self.left.y * d, up)
    }
}

/// Stations at a line's corners and, between them, at most `step` (m) apart.
pub(super) fn stations(line: &Polyline, step: f64) -> Vec<Station> {
    let points = line.points();
    if line.is_degenerate() || line.length() > 1e6 {
        return Vec::new();
    }
    let normal = |i: usize| {
        let d = (points[i + 1] - points[i]).xy().normalize();
        Vector::new(-d.y, d.x)
    };
    let last = points.len() - 1;
    let corner = |i: usize| {
        let (before, after) = (normal(i.saturating_sub(1)), normal(i.min(last - 1)));
        let sum = before + after;
        // A mitre, cut off where the line turns back sharply.
        let scale = sum.norm_squared();
        if scale > 0.4 { sum * (2.0 / scale) } else { after }
    };
    let mut made = Vec::new();
    for i in 0..last {
        let (from, to) = (line.arc_lengths()[i], line.arc_lengths()[i + 1]);
        let pieces = ((to - from) / step).ceil().clamp(1.0, 1e5) as usize;
        let (a, b) = (corner(i), corner(i + 1));
        for k in 0..pieces {
            let t = k as f64 / pieces as f64;
            let left = if k == 0 { a } else { normal(i) };
            made.push(Station {
                at: points[i] + (points[i + 1] - points[i]) * t,
                left,
                s: from + (to - from) * t,
            });
        }
        if i + 1 == last {
            made.push(Station { at: points[last], left: b, s: line.length() });
        }
    }
    made
}

/// A horizontal band along stations from `right` to `left` of the line (m).
fn band(
    tiles: &mut Tiles,
    line: &[Station],
    (right, left): (f64, f64),
    up: f64,
    material: MaterialId,
    levels: Levels,
) {
    for pair in line.windows(2) {
        let c = |s: &Station, d: f64| Corner { at: s.off(d, up), uv: [s.s, d] };
        tiles.face(
            &[c(&pair[0], right), c(&pair[1], right), c(&pair[1], left), c(&pair[0], left)],
            material,
            levels,
        );
    }
}

/// An upright band along stations at `d` (m left), from `low` to `high`; it faces left where `to_left`.
pub(super) fn face(
    tiles: &mut Tiles,
    line: &[Station],
    d: f64,
    (low, high): (f64, f64),
    to_left: bool,
    material: MaterialId,
    levels: Levels,
) {
    for pair in line.windows(2) {
        let c = |s: &Station, up: f64| Corner { at: s.off(d, up), uv: [s.s, up] };
        let (a, b) = if to_left { (&pair[1], &pair[0]) } else { (&pair[0], &pair[1]) };
        tiles.face(&[c(a, low), c(b, low), c(b, high), c(a, high)], material, levels);
    }
}

/// Marks sidewalks, crossings and the middle of driven lanes, for [`build`].
pub(super) fn mark(network: &Network, ground: &mut Ground) {
    for lane in &network.lanes {
        let points = lane.shape.points();
        let kind = network.edge(lane.edge).kind;
        let (bits, half) = match (kind, surface(lane)) {
            (EdgeKind::Normal, Surface::Sidewalk) => (uses::RAISED, 0.5 * lane.width - 0.3),
            (EdgeKind::Normal | EdgeKind::Internal, Surface::Road) => (uses::DRIVEN, 0.28 * lane.width),
            _ => continue,
        };
        for pair in points.windows(2) {
            ground.fill_strip(pair[0].xy(), pair[1].xy(), half.max(0.1), bits);
        }
    }
    for crossing in &network.crossings {
        ground.fill(&crossing.outline, uses::CROSSING);
    }
    for junction in &network.junctions {
        for &id in &junction.walkingareas {
            let outline = outline(network.lane(id));
            if ground.inner_count(&outline, uses::DRIVEN) < 4 {
                ground.fill(&outline, uses::RAISED);
            }
        }
    }
}

fn outline(lane: &Lane) -> Vec<Point> {
    cleaned(&lane.shape.points().iter().map(|p| p.xy()).collect::<Vec<_>>())
}

/// Builds every lane, junction and walkingarea.
pub(super) fn build(network: &Network, ground: &Ground, terrain: &Terrain, m: &Materials, tiles: &mut Tiles) {
    // Outermost lanes have their outer side on the right, or on the left where traffic keeps left.
    let inward = if network.left_hand { -1.0 } else { 1.0 };
    for (number, edge) in network.edges.iter().enumerate() {
        if edge.kind != EdgeKind::Normal {
            continue;
        }
        let has_road = edge.lanes.iter().any(|&l| surface(network.lane(l)) == Surface::Road);
        let asphalt = if number % 5 == 3 { m.worn } else { m.asphalt };
        for &id in &edge.lanes {
            let lane = network.lane(id);
            let half = 0.5 * lane.width;
            let line = stations(&lane.shape, 0.5 * CHUNK_SIZE);
            match surface(lane) {
                Surface::Road => {
                    let margin = half + 0.02;
                    band(tiles, &line, (-margin, margin), 0.0, asphalt, Levels::All);
                    joints(tiles, &line, half, m);
                    if !terrain.flat {
                        for to_left in [true, false] {
                            let d = if to_left { half } else { -half };
                            face(tiles, &line, d, (-1.2, 0.0), to_left, m.soil, Levels::All);
                        }
                    }
                }
                Surface::Sidewalk if has_road => {
                    sidewalk(tiles, &line, half, inward, m);
                }
                Surface::Sidewalk => {
                    band(tiles, &line, (-half, half), 0.03, m.path, Levels::All);
                }
                Surface::Rails => rails(tiles, &line, half, m),
                Surface::Nothing => {}
            }
        }
    }
    for junction in &network.junctions {
        let height = JunctionHeight::of(network, junction);
        for t in triangulate(&junction.shape) {
            tiles.floor(t, &|p| height.surface(p), m.junction, Levels::All);
        }
        for &id in &junction.walkingareas {
            walkingarea(network.lane(id), ground, &height, m, tiles);
        }
    }
}

/// Asphalt under both ends of a lane: junctions' outlines do not always meet them.
fn joints(tiles: &mut Tiles, line: &[Station], half: f64, m: &Materials) {
    for (i, forward) in [(0, -1.0), (line.len().saturating_sub(1), 1.0)] {
        let Some(end) = line.get(i) else { continue };
        let along = Vector::new(end.left.y, -end.left.x) * (0.9 * forward);
        let shifted =
            |by: f64| Station { at: end.at + Vector3::new(along.x * by, along.y * by, 0.0), ..*end };
        let mut strip = [shifted(-0.3), shifted(1.0)];
        if forward < 0.0 {
            strip.reverse();
        }
        band(tiles, &strip, (-half, half), -2.0 * JUNCTION_BELOW, m.junction, Levels::All);
    }
}

fn sidewalk(tiles: &mut Tiles, line: &[Station], half: f64, inward: f64, m: &Materials) {
    let (road, outer) = (inward * half, -inward * half);
    let stone = road - inward * KERB_STONE;
    let span = |a: f64, b: f64| (a.min(b), a.max(b));
    face(tiles, line, road, (0.0, KERB), inward > 0.0, m.kerb, Levels::All);
    band(tiles, line, span(stone, road), KERB, m.kerb, Levels::Near);
    band(tiles, line, span(outer, stone), KERB, m.paving, Levels::Near);
    band(tiles, line, span(outer, road), KERB, m.paving, Levels::NotNear);
    face(tiles, line, outer, (-SKIRT, KERB), inward < 0.0, m.kerb, Levels::Middle);
}

fn rails(tiles: &mut Tiles, line: &[Station], half: f64, m: &Materials) {
    band(tiles, line, (-half, half), 0.02, m.soil, Levels::All);
    for d in [-0.72, 0.72] {
        band(tiles, line, (d - 0.04, d + 0.04), 0.12, m.guard_rail, Levels::Middle);
        face(tiles, line, d + 0.04, (0.0, 0.12), true, m.iron, Levels::Middle);
        face(tiles, line, d - 0.04, (0.0, 0.12), false, m.iron, Levels::Middle);
    }
}

/// A walkingarea: a raised slab with a kerb where it meets the road.
fn walkingarea(lane: &Lane, ground: &Ground, height: &JunctionHeight, m: &Materials, tiles: &mut Tiles) {
    let outline = outline(lane);
    if outline.is_empty() {
        return;
    }
    let raised = ground.inner_count(&outline, uses::DRIVEN) < 4;
    let up = if raised { KERB } else { 0.012 };
    for t in triangulate(&outline) {
        tiles.floor(t, &|p| height.at(p) + up, m.slabs, Levels::All);
    }
    if !raised {
        return;
    }
    for (i, &a) in outline.iter().enumerate() {
        let b = outline[(i + 1) % outline.len()];
        let d = b - a;
        let length = d.norm();
        // Counter-clockwise: outside is to the right.
        let outward = Vector::new(d.y, -d.x) / length;
        let beyond = ground.at(a + d * 0.5 + outward * 0.45);
        if beyond & uses::RAISED != 0 {
            continue;
        }
        let p = |q: Point, up: f64| Point3::new(q.x, q.y, height.at(q) + up);
        tiles.wall(
            [p(a, -SKIRT.min(0.02)), p(b, -SKIRT.min(0.02)), p(b, KERB), p(a, KERB)],
            [[0.0, 0.0], [length, 0.0], [length, KERB], [0.0, KERB]],
            m.kerb,
            Levels::All,
        );
        if beyond & uses::CROSSING != 0 && length > 0.8 {
            // Down to the crossing by a ramp, with no kerb to step over.
            let foot = outward * RAMP;
            tiles.wall(
                [p(a + foot, 0.012), p(b + foot, 0.012), p(b, KERB), p(a, KERB)],
                [[0.0, 0.0], [length, 0.0], [length, RAMP], [0.0, RAMP]],
                m.slabs,
                Levels::All,
            );
        } else if beyond & uses::WAY != 0 && length > 0.1 {
            // The kerb's stone.
            let inner = outward * -KERB_STONE;
            let top = KERB + 0.004;
            tiles.wall(
                [p(a, top), p(b, top), p(b + inner, top), p(a + inner, top)],
                [[0.0, 0.0], [length, 0.0], [length, KERB_STONE], [0.0, KERB_STONE]],
                m.kerb,
                Levels::Near,
            );
        }
    }
}

/// Height over a junction: the plane through the lanes that end there, so that any triangulation of its
/// outline and the paint on it lie on one surface.
pub(super) struct JunctionHeight {
    middle: Point,
    /// Height in the middle (m), slopes along x and y.
    plane: [f64; 3],
}

impl JunctionHeight {
    pub fn of(network: &Network, junction: &Junction) -> Self {
        let lanes = |edges: &[sumo_network::network::EdgeId]| -> Vec<&Lane> {
            edges.iter().flat_map(|&e| &network.edge(e).lanes).map(|&l| network.lane(l)).collect()
        };
        let coming = lanes(&junction.incoming_edges).into_iter().filter_map(|l| l.shape.points().last());
        let going = lanes(&junction.outgoing_edges);
        let going = going.iter().filter_map(|l| l.shape.points().first());
        let ends: Vec<Point3<f64>> =
            coming.chain(going).copied().filter(|p| p.coords.iter().all(|c| c.is_finite())).collect();
        let mean = |of: &dyn Fn(&Point3<f64>) -> f64| ends.iter().map(of).sum::<f64>() / ends.len() as f64;
        if ends.is_empty() {
            return Self { middle: junction.position, plane: [0.0; 3] };
        }
        let middle = Point::new(mean(&|p| p.x), mean(&|p| p.y));
        let z = mean(&|p| p.z);
        // Least squares; a square metre more on the diagonal where all ends lie in a line.
        let product =
            |a: &dyn Fn(&Point3<f64>) -> f64, b: &dyn Fn(&Point3<f64>) -> f64| mean(&|p| a(p) * b(p));
        let (x, y, up) =
            (&|p: &Point3<f64>| p.x - middle.x, &|p: &Point3<f64>| p.y - middle.y, &|p: &Point3<f64>| {
                p.z - z
            });
        let (xx, xy, yy) = (product(x, x) + 1.0, product(x, y), product(y, y) + 1.0);
        let (xz, yz) = (product(x, up), product(y, up));
        let area = (xx * yy - xy * xy).max(1e-9);
        let slope = |v: f64| v.clamp(-0.3, 0.3);
        Self { middle, plane: [z, slope((xz * yy - yz * xy) / area), slope((yz * xx - xz * xy) / area)] }
    }

    /// m.
    pub fn at(&self, p: Point) -> f64 {
        let [z, along_x, along_y] = self.plane;
        z + along_x * (p.x - self.middle.x) + along_y * (p.y - self.middle.y)
    }

    /// Of the junction's asphalt (m).
    pub fn surface(&self, p: Point) -> f64 {
        self.at(p) - JUNCTION_BELOW
    }
}

/// The terrain of a net that is not flat, below its roads.
pub(super) fn terrain(terrain: &Terrain, m: &Materials, tiles: &mut Tiles) {
    use super::ground::TERRAIN_CELL;
    let below = 0.35;
    for (i, j) in terrain.cells() {
        let corner = |i: i32, j: i32| {
            let (x, y) = (f64::from(i) * TERRAIN_CELL, f64::from(j) * TERRAIN_CELL);
            let z = terrain.node(i, j).unwrap_or(terrain.low) - below;
            Corner { at: Point3::new(x, y, z), uv: [x, y] }
        };
        let [a, b, c, d] = [corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)];
        tiles.face(&[a, b, c], m.grass, Levels::All);
        tiles.face(&[a, c, d], m.grass, Levels::All);
    }
}
