//! Roads that stand above the ground: what carries them, and what keeps houses and trees away.

use super::ground::{Ground, Terrain, uses};
use super::materials::Materials;
use super::polygon::triangulate;
use super::roads::{JunctionHeight, KERB, Station, Surface, face, stations, surface};
use super::tiles::{Corner, Levels, Tiles};
use crate::shape::Shaper;
use nalgebra::Point3;
use sumo_network::geometry::Vector;
use sumo_network::network::{EdgeKind, Lane, Network};

/// A road this much above the terrain (m) is a bridge. On a slope more, since the terrain is the lowest road nearby.
const HIGH: f64 = 3.0;
/// How far away that lowest road may be (m).
const REACH: f64 = 24.0;
/// Depth of the deck below the road's surface (m).
const DECK: f64 = 0.9;
/// Ground beside a bridge that is kept free (m).
const ROOM: f64 = 5.0;
/// Distance between piers along a road, and the radius of a pier (m).
const SPAN: f64 = 26.0;
const PIER: f64 = 0.7;
/// From a pier to the edge of a road below (m).
const BESIDE: f64 = 1.2;

/// Whether a road stands above the ground between two of its points.
pub(super) fn carries(terrain: &Terrain, a: Point3<f64>, b: Point3<f64>) -> bool {
    if terrain.flat {
        return false;
    }
    let slope = (b.z - a.z).abs() / (b - a).xy().norm().max(0.1);
    let high = |p: Point3<f64>| p.z - terrain.at(p.xy()) > HIGH + REACH * slope;
    high(a) && high(b)
}

/// The stretches of a lane that stand above the ground.
fn stretches(terrain: &Terrain, lane: &Lane) -> Vec<[Station; 2]> {
    let line = stations(&lane.shape, 6.0);
    let pairs = line.windows(2).map(|pair| [pair[0], pair[1]]);
    pairs.filter(|[a, b]| carries(terrain, a.at, b.at)).collect()
}

fn built(lane: &Lane) -> bool {
    matches!(surface(lane), Surface::Road | Surface::Sidewalk)
}

/// Keeps the ground below bridges and beside them free.
pub(super) fn clear(network: &Network, terrain: &Terrain, ground: &mut Ground) {
    if terrain.flat {
        return;
    }
    for lane in network.lanes.iter().filter(|lane| built(lane)) {
        for [a, b] in stretches(terrain, lane) {
            ground.fill_strip(a.at.xy(), b.at.xy(), 0.5 * lane.width + ROOM, uses::OBJECT);
        }
    }
}

/// Builds decks and piers.
pub(super) fn build(network: &Network, terrain: &Terrain, m: &Materials, tiles: &mut Tiles) {
    if terrain.flat {
        return;
    }
    for edge in network.edges.iter().filter(|edge| edge.kind == EdgeKind::Normal) {
        let lanes: Vec<&Lane> =
            edge.lanes.iter().map(|&lane| network.lane(lane)).filter(|lane| built(lane)).collect();
        for lane in &lanes {
            let top = if surface(lane) == Surface::Sidewalk { KERB } else { 0.0 };
            deck(terrain, lane, top, m, tiles);
        }
        piers(network, terrain, &lanes, m, tiles);
    }
    for junction in &network.junctions {
        let height = JunctionHeight::of(network, junction);
        let n = junction.shape.len();
        let at = |i: usize, up: f64| {
            let p = junction.shape[i % n];
            Point3::new(p.x, p.y, height.at(p) + up)
        };
        if n < 3 || !(0..n).all(|i| carries(terrain, at(i, 0.0), at(i + 1, 0.0))) {
            continue;
        }
        for [a, b, c] in triangulate(&junction.shape) {
            tiles.floor([a, c, b], &|p| height.at(p) - DECK, m.kerb, Levels::All);
        }
        for i in 0..n {
            let side = [at(i, -DECK), at(i + 1, -DECK), at(i + 1, 0.0), at(i, 0.0)];
            let mut corners = side.map(|at| Corner { at, uv: [at.x + at.y, at.z] });
            tiles.face(&corners, m.kerb, Levels::All);
            corners.reverse();
            tiles.face(&corners, m.kerb, Levels::All);
        }
    }
}

/// The underside and both sides of a lane's deck.
fn deck(terrain: &Terrain, lane: &Lane, top: f64, m: &Materials, tiles: &mut Tiles) {
    let half = 0.5 * lane.width;
    for pair in stretches(terrain, lane) {
        let [a, b] = &pair;
        let c = |s: &Station, d: f64| Corner { at: s.off(d, -DECK), uv: [s.s, d] };
        tiles.face(&[c(a, half), c(b, half), c(b, -half), c(a, -half)], m.kerb, Levels::All);
        for to_left in [true, false] {
            let d = if to_left { half } else { -half };
            face(tiles, &pair, d, (-DECK, top), to_left, m.kerb, Levels::All);
        }
    }
}

/// Piers under an edge, beside the roads below.
fn piers(network: &Network, terrain: &Terrain, lanes: &[&Lane], m: &Materials, tiles: &mut Tiles) {
    let Some(&lane) = lanes.get(lanes.len() / 2) else { return };
    let length = lane.shape.length();
    if !length.is_finite() || length > 1e5 {
        return;
    }
    let count = (length / SPAN).ceil().max(1.0) as usize;
    for k in 0..count {
        let middle = (k as f64 + 0.5) * length / count as f64;
        let free = [0.0, 4.0, -4.0, 8.0, -8.0].iter().map(|shift| middle + shift).find(|&s| {
            let (a, b) = (lane.shape.at(s - 1.0).position, lane.shape.at(s + 1.0).position);
            (1.0..length - 1.0).contains(&s) && carries(terrain, a, b) && stands_free(network, lane, s)
        });
        let Some(s) = free else { continue };
        let pose = lane.shape.at(s);
        let foot = terrain.at(pose.xy());
        let top = (pose.position.z - foot - DECK) as f32;
        // From the edge's one side to its other.
        let across = |other: &&Lane, side: f64| {
            let p = other.shape.project(pose.xy());
            let border = other.shape.at(p.s).to_world(Vector::new(0.0, side * 0.5 * other.width));
            pose.to_local(border).y as f32
        };
        let right = lanes.iter().map(|lane| across(lane, -1.0)).fold(f32::INFINITY, f32::min);
        let left = lanes.iter().map(|lane| across(lane, 1.0)).fold(f32::NEG_INFINITY, f32::max);
        let mut s = Shaper::new(20.0);
        s.place(pose.heading as f32, [0.0; 3]);
        let radius = PIER as f32;
        s.tube(&[([0.0, 0.0, -0.6], radius), ([0.0, 0.0, top - 0.8], radius)], 12, false, m.kerb);
        s.cuboid([-radius, right + 0.3, top - 0.9], [radius, left - 0.3, top + 0.02], true, m.kerb);
        let mesh = s.finish();
        tiles.mesh(Point3::new(pose.position.x, pose.position.y, foot), &mesh, Levels::All);
    }
}

/// Whether no road of another level is where a pier would stand.
fn stands_free(network: &Network, lane: &Lane, s: f64) -> bool {
    let at = lane.shape.at(s).position;
    network.lanes_near(at.xy(), None, 12.0).iter().all(|near| {
        let other = network.lane(near.lane);
        let same_level = (other.shape.at(near.s).position.z - at.z).abs() < HIGH;
        same_level || near.distance > 0.5 * other.width + PIER + BESIDE
    })
}
