//! Traffic-light heads on poles and mast arms, each showing the state of the links it controls.

use super::furniture::{HEAD, SMALL_HEAD};
use super::ground::uses;
use super::roads::{Surface, surface};
use super::street::Site;
use super::tiles::Levels;
use crate::model::{Box3, Instance, ModelId, Object, ObjectClass};
use crate::shape::Shaper;
use nalgebra::Point3;
use sumo_network::geometry::{Point, Pose, Vector, direction};
use sumo_network::network::{EdgeId, EdgeKind, Lane, LaneId, LinkDirection, Network, SignalIndex};
use sumo_network::signal_ahead::NO_ROOM;

/// Lowest point of heads over a lane, and of heads on poles by it and beyond the junction (m).
pub(super) const CLEARANCE: f64 = 5.2;
const LOW: f64 = 2.5;
const FAR: f64 = 3.3;

/// The signal that a lane's head shows: straight on before right before left.
fn signal_of(network: &Network, lane: &Lane) -> Option<SignalIndex> {
    let rank = |d: LinkDirection| match d {
        LinkDirection::Straight => 0,
        LinkDirection::PartRight | LinkDirection::Right => 1,
        LinkDirection::PartLeft | LinkDirection::Left => 2,
        _ => 3,
    };
    lane.outgoing
        .iter()
        .map(|&l| network.link(l))
        .filter_map(|l| Some((rank(l.direction), l.signal?)))
        .min_by_key(|&(rank, signal)| (rank, signal.index))
        .map(|(_, signal)| signal)
}

/// Puts up every signal of the network.
pub(super) fn build(site: &mut Site<'_>) {
    for number in 0..site.network.edges.len() {
        if site.network.edges[number].kind == EdgeKind::Normal {
            approach(site, EdgeId(number as u32));
        }
    }
    for number in 0..site.network.crossings.len() {
        pedestrians(site, number);
    }
}

fn hang(site: &mut Site<'_>, model: ModelId, signal: SignalIndex, pose: Pose, size: [f64; 3]) {
    let id = site.static_id();
    let mut instance = Instance::new(model, pose);
    instance.signal = Some(signal);
    // The head's middle, a little ahead of the case for its visors.
    let bounds = Box3 { pose, size };
    instance.object = Some(Object { class: ObjectClass::TrafficLight, id, bounds });
    site.tiles.instance(instance);
}

/// A free place for a pole beside an edge: back from `s` along it and outwards from its border.
fn pole_place(site: &Site<'_>, lane: &Lane, s: f64) -> Option<(Pose, Point)> {
    let outer = site.outer();
    for back in [0.0, 0.8, 1.8, 3.2, 5.0, 7.5] {
        for out in [0.45, 0.7, 1.1, 1.7] {
            let pose = lane.shape.at((s - back).clamp(0.0, lane.shape.length()));
            let place = pose.to_world(Vector::new(0.0, outer * (0.5 * lane.width + out)));
            if site.ground.disc_free(place, 0.12, uses::WAY | uses::BUILDING | uses::WATER) {
                return Some((pose, place));
            }
        }
    }
    None
}

fn approach(site: &mut Site<'_>, id: EdgeId) {
    let network = site.network;
    let edge = network.edge(id);
    let signalled: Vec<(LaneId, SignalIndex)> = edge
        .lanes
        .iter()
        .filter(|&&l| surface(network.lane(l)) == Surface::Road)
        .filter_map(|&l| Some((l, signal_of(network, network.lane(l))?)))
        .collect();
    let (Some(&(_, first)), Some(&border)) = (signalled.first(), edge.lanes.first()) else { return };
    let border = network.lane(border);
    let (signal_model, pole) = (site.furniture.signal, site.materials.dark_pole);
    if let Some((_, place)) = pole_place(site, border, border.shape.length() - 0.6) {
        let z = site.terrain.at(place);
        let road_z = border.shape.at(border.shape.length()).position.z;
        // Heads over the lanes, abreast of the pole.
        let mut over: Vec<(Pose, SignalIndex)> = Vec::new();
        for &(lane, signal) in &signalled {
            let shape = &network.lane(lane).shape;
            let p = shape.project(place);
            let mut pose = shape.at(p.s);
            pose.position.z = road_z + CLEARANCE;
            over.push((pose, signal));
        }
        let heading = over[0].0.heading;
        let mut mast = Shaper::new(50.0);
        let top = road_z - z + CLEARANCE + 0.75;
        mast.tube(
            &[([0.0, 0.0, -0.3], 0.13), ([0.0, 0.0, 1.0], 0.12), ([0.0, 0.0, top as f32 + 0.2], 0.085)],
            9,
            true,
            pole,
        );
        if let Some((last, _)) = over.last() {
            let d = last.xy() - place;
            let reach = d + d * (0.25 / d.norm().max(0.1));
            let end = [reach.x as f32, reach.y as f32, top as f32 + 0.25];
            mast.tube(&[([0.0, 0.0, top as f32], 0.075), (end, 0.045)], 7, true, pole);
        }
        let mesh = mast.finish();
        site.tiles.mesh(Point3::new(place.x, place.y, z), &mesh, Levels::All);
        for (pose, signal) in over {
            hang(site, signal_model, signal, pose.advanced(-0.25), HEAD);
        }
        let ahead = direction(heading) * -0.26;
        let low = Pose::new(place.x + ahead.x, place.y + ahead.y, z + LOW, heading);
        hang(site, signal_model, first, low, HEAD);
        site.ground.fill_strip(place, place + Vector::new(0.2, 0.0), 0.2, uses::OBJECT);
    }
    repeater(site, &signalled);
}

/// A head beyond the junction, for vehicles at the line that no longer see the near ones. None where another signal is
/// close behind: a head that is green beyond a red one would be taken for it.
fn repeater(site: &mut Site<'_>, signalled: &[(LaneId, SignalIndex)]) {
    let network = site.network;
    let close = |lane: &LaneId| {
        network.lane(*lane).outgoing.iter().map(|&link| network.link(link)).any(|link| {
            let behind = network.lane(link.to);
            link.signal.is_some() && behind.length < NO_ROOM && signal_of(network, behind).is_some()
        })
    };
    if signalled.iter().any(|(lane, _)| close(lane)) {
        return;
    }
    let straight = |lane: LaneId| {
        let links = network.lane(lane).outgoing.iter().copied();
        links.into_iter().find(|&l| network.link(l).direction == LinkDirection::Straight)
    };
    let found = signalled
        .iter()
        .find_map(|&(lane, signal)| Some((lane, signal, network.link_length(straight(lane)?))));
    let Some((lane, signal, across)) =
        found.or(signalled.first().map(|&(lane, signal)| (lane, signal, 10.0)))
    else {
        return;
    };
    let shape = &network.lane(lane).shape;
    let end = shape.at(shape.length());
    let outer = site.outer();
    // The nearest free place ahead, best on the outer side.
    let place = (0..40).map(|i| across + 1.0 + 1.5 * f64::from(i)).find_map(|ahead| {
        [3.0, 4.0, 5.0, 6.0, 7.0, 8.5, 10.0, 12.0, -4.0, -6.0, -8.0, -10.0, 0.0]
            .into_iter()
            .filter(|side: &f64| side.abs() < 0.6 * ahead)
            .map(|side| end.to_world(Vector::new(ahead, outer * side)))
            .find(|&p| site.ground.disc_free(p, 0.15, uses::WAY | uses::BUILDING | uses::WATER))
    });
    let Some(place) = place.filter(|p| (p - end.xy()).norm() < 75.0) else { return };
    let z = site.terrain.at(place);
    let mut post = Shaper::new(50.0);
    let top = (FAR + HEAD[2] + 0.12) as f32;
    post.tube(&[([0.0, 0.0, -0.3], 0.075), ([0.0, 0.0, top], 0.06)], 8, true, site.materials.dark_pole);
    let mesh = post.finish();
    site.tiles.mesh(Point3::new(place.x, place.y, z), &mesh, Levels::All);
    let ahead = direction(end.heading) * -0.24;
    let pose = Pose::new(place.x + ahead.x, place.y + ahead.y, z + FAR, end.heading);
    hang(site, site.furniture.signal, signal, pose, HEAD);
    site.ground.fill_strip(place, place + Vector::new(0.2, 0.0), 0.2, uses::OBJECT);
}

/// Pedestrians' heads at both ends of a signalled crossing, where there is room beside the sidewalk.
fn pedestrians(site: &mut Site<'_>, number: usize) {
    let network = site.network;
    let crossing = &network.crossings[number];
    let Some(signal) = crossing.signal else { return };
    let shape = &network.lane(crossing.lane).shape;
    if shape.length() < 3.0 {
        return;
    }
    for at_end in [false, true] {
        let (from, end) = if at_end { (0.0, shape.length()) } else { (shape.length(), 0.0) };
        let (from, end) = (shape.at(from).position, shape.at(end).position);
        let along = (end - from).xy().normalize();
        let heading = along.y.atan2(along.x);
        let free = |p: Point| site.ground.disc_free(p, 0.1, uses::WAY | uses::BUILDING | uses::OBJECT);
        let place =
            (0..60).map(|i| (1.2 + 0.35 * f64::from(i / 6), f64::from(i % 6))).find_map(|(r, turn)| {
                let side = if turn as i32 % 2 == 0 { 1.0 } else { -1.0 };
                let angle = heading + side * (turn * 0.5).floor() * 0.5;
                let p = end.xy() + direction(angle) * r;
                free(p).then_some(p)
            });
        let Some(place) = place else { continue };
        let z = site.terrain.at(place);
        let mut post = Shaper::new(50.0);
        post.tube(&[([0.0, 0.0, -0.3], 0.055), ([0.0, 0.0, 2.95], 0.05)], 7, true, site.materials.dark_pole);
        let mesh = post.finish();
        site.tiles.mesh(Point3::new(place.x, place.y, z), &mesh, Levels::Middle);
        let ahead = direction(heading) * -0.2;
        let pose = Pose::new(place.x + ahead.x, place.y + ahead.y, z + 2.25, heading);
        let model = site.furniture.pedestrian_signal;
        hang(site, model, signal, pose, SMALL_HEAD);
        site.ground.fill_strip(place, place + Vector::new(0.2, 0.0), 0.2, uses::OBJECT);
    }
}
