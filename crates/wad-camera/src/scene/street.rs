//! Things along the streets: lamps, trees, hedges, benches, bins, bus stops, parked cars, signs, rails.

use super::bridges;
use super::furniture::{BENCH, Furniture, SIGN};
use super::ground::{Ground, Terrain, uses};
use super::look::Look;
use super::markings::opposite;
use super::materials::Materials;
use super::roads::{Station, Surface, stations, surface};
use super::tiles::{Levels, Tiles};
use super::trees::{Plants, leaf_colour};
use crate::actors::Cast;
use crate::model::{Box3, Instance, LIMITS, ModelId, Object, ObjectClass, PlacedSign, STATIC_IDS, Sign};
use crate::shape::Shaper;
use nalgebra::Point3;
use std::f64::consts::FRAC_PI_2;
use sumo_network::geometry::{Point, Pose, Vector, direction};
use sumo_network::network::{Edge, EdgeId, EdgeKind, Lane, Network};
use sumo_network::seeds;

/// Numbers that a seed gives one after another.
#[derive(Clone, Debug)]
pub(super) struct Dice(u64);

impl Dice {
    pub fn new(seed: u64, part: &str) -> Self {
        Self(seeds::derive(seed, part))
    }
    pub fn next(&mut self) -> u64 {
        self.0 = seeds::derive(self.0, "next");
        self.0
    }
    /// 0..1.
    pub fn unit(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1_u64 << 53) as f64
    }
    pub fn between(&mut self, a: f64, b: f64) -> f64 {
        a + (b - a) * self.unit()
    }
    pub fn chance(&mut self, p: f64) -> bool {
        self.unit() < p
    }
}

/// A town being furnished.
pub(super) struct Site<'a> {
    pub network: &'a Network,
    pub ground: Ground,
    pub terrain: &'a Terrain,
    pub tiles: Tiles,
    pub materials: &'a Materials,
    pub furniture: &'a Furniture,
    pub plants: &'a Plants,
    pub cast: &'a Cast,
    pub dice: Dice,
    pub look: Look,
    pub statics: u32,
    pub signs: Vec<PlacedSign>,
}

const TAKEN: u16 = uses::WAY | uses::BUILDING | uses::OBJECT | uses::WATER;

impl Site<'_> {
    /// -1 where lanes' outer side is on the right, 1 where it is on the left.
    pub fn outer(&self) -> f64 {
        if self.network.left_hand { 1.0 } else { -1.0 }
    }

    /// The next instance id of static objects.
    pub fn static_id(&mut self) -> u32 {
        self.statics += 1;
        STATIC_IDS + self.statics - 1
    }

    /// Puts a model at a free place of `radius` (m); the way it looks is `heading`.
    pub fn put(&mut self, model: ModelId, at: Point, heading: f64, radius: f64) -> Option<Instance> {
        if !self.ground.disc_free(at, radius, TAKEN) {
            return None;
        }
        self.ground.fill_strip(at, at + Vector::new(0.01, 0.0), radius.max(0.3), uses::OBJECT);
        Some(Instance::new(model, Pose::new(at.x, at.y, self.terrain.at(at), heading)))
    }

    /// A tree of some kind, larger or smaller.
    pub fn tree(&mut self, model: ModelId, at: Point, size: f64) -> bool {
        let heading = self.dice.between(0.0, std::f64::consts::TAU);
        // Crowns do not grow into houses.
        if !self.ground.disc_free(at, 1.3 * size, uses::BUILDING) {
            return false;
        }
        // Conifers' branches begin at breast height.
        if model == self.plants.conifer && !self.ground.disc_free(at, 2.7 * size, uses::WAY) {
            return false;
        }
        let Some(mut tree) = self.put(model, at, heading, 0.35) else { return false };
        let wide = size * self.dice.between(0.9, 1.12);
        tree.scale = [wide as f32, wide as f32, (size * self.dice.between(0.92, 1.15)) as f32];
        let shade = self.dice.between(0.8, 1.15) as f32;
        tree.tints[0] = leaf_colour(self.dice.next()).map(|c| c * shade);
        self.tiles.instance(tree);
        true
    }

    /// A bench that looks along `heading`.
    pub fn bench(&mut self, at: Point, heading: f64) {
        let pose = Pose::new(at.x, at.y, self.terrain.at(at), heading);
        let corners = [(-0.35, -0.95), (0.35, -0.95), (0.35, 0.95), (-0.35, 0.95)]
            .map(|(x, y)| pose.to_world(Vector::new(x, y)));
        if self.ground.convex_free(&corners, TAKEN) {
            self.bench_at(at, heading);
        }
    }

    /// The same at an author's place, without checking the ground.
    pub fn bench_at(&mut self, at: Point, heading: f64) {
        let pose = Pose::new(at.x, at.y, self.terrain.at(at), heading);
        let corners = [(-0.35, -0.95), (0.35, -0.95), (0.35, 0.95), (-0.35, 0.95)]
            .map(|(x, y)| pose.to_world(Vector::new(x, y)));
        self.ground.fill(&corners, uses::OBJECT);
        let mut bench = Instance::new(self.furniture.bench, pose);
        let id = self.static_id();
        let bounds = Box3 { pose: bench.pose, size: BENCH };
        bench.object = Some(Object { class: ObjectClass::Bench, id, bounds });
        self.tiles.instance(bench);
    }

    /// A parked car with its centre at `pose`, where there is room.
    pub fn park(&mut self, pose: Pose) -> bool {
        let key = self.dice.next();
        let (mut car, size) = self.cast.parked(pose, key);
        let (l, w) = (0.5 * size[0] + 0.15, 0.5 * size[1] + 0.1);
        let corners = [(-l, -w), (l, -w), (l, w), (-l, w)].map(|(x, y)| pose.to_world(Vector::new(x, y)));
        if !self.ground.convex_free(&corners, TAKEN) {
            return false;
        }
        self.ground.fill(&corners, uses::OBJECT);
        let id = self.static_id();
        car.object = Some(Object { class: ObjectClass::Car, id, bounds: Box3 { pose, size } });
        self.tiles.instance(car);
        true
    }
}

/// One side of a street: its border line and the way out from it.
struct Side<'a> {
    lane: &'a Lane,
    /// 1: the border is left of the lane, -1: right.
    side: f64,
    sidewalk: bool,
}

impl Side<'_> {
    /// The place `out` (m) beyond the border at `s`, and the heading back to the road.
    fn place(&self, s: f64, out: f64) -> (Point, f64) {
        let pose = self.lane.shape.at(s);
        let at = pose.to_world(Vector::new(0.0, self.side * (0.5 * self.lane.width + out)));
        (at, pose.heading - self.side * FRAC_PI_2)
    }
}

/// Between signs, where there are many (m).
const APART: f64 = 7.0;

/// Signs at every road; before anything else, so that they find their places.
pub(super) fn signs(site: &mut Site<'_>) {
    let network = site.network;
    let outer = site.outer();
    let mut dice = Dice::new(site.look.seed, "signs");
    for (number, edge) in network.edges.iter().enumerate() {
        let Some((border, road)) = carriageway(network, edge) else { continue };
        let length = border.shape.length();
        let side = Side { lane: border, side: outer, sidewalk: false };
        let put = |site: &mut Site<'_>, model: ModelId, s: f64| {
            [0.45, 0.8, 1.2].into_iter().find_map(|out| {
                let (at, _) = side.place(s, out);
                let placed = site.put(model, at, side.lane.shape.at(s).heading, 0.1)?;
                let pose = placed.pose;
                site.tiles.instance(placed);
                Some(pose)
            })
        };
        let say = |site: &mut Site<'_>, sign: Sign, s: f64| {
            if let Some(mut pose) = put(site, site.furniture.signs[sign.index()], s) {
                pose.position.z += f64::from(SIGN);
                site.signs.push(PlacedSign { sign, pose });
            }
        };
        // Where the limit differs from that of a road which leads here, and now and then otherwise.
        let changed = edge.from.is_some_and(|from| {
            network.junction(from).incoming_edges.iter().any(|&e| {
                carriageway(network, network.edge(e))
                    .is_some_and(|(_, r)| (r.speed_limit - road.speed_limit).abs() > 1.0)
            })
        });
        if length > 40.0 && (changed || number % 4 == 0) {
            say(site, Sign::limit((road.speed_limit * 3.6).round() as u32), 14.0);
        }
        let links: Vec<_> = road.outgoing.iter().map(|&l| network.link(l)).collect();
        let signalled = links.iter().any(|l| l.signal.is_some());
        if length > 12.0 && !signalled {
            let yields = links.iter().any(|l| !l.must_yield_to.is_empty());
            if links.iter().any(|l| l.state == 's') {
                say(site, Sign::Stop, length - 1.2);
            } else if yields && links.iter().any(|l| l.state == 'm') {
                say(site, Sign::GiveWay, length - 1.2);
            } else if links.iter().any(|l| l.state == 'M') && number % 3 == 0 {
                put(site, site.furniture.priority, length - 14.0);
            }
            let id = EdgeId(number as u32);
            let crossed =
                network.crossings.iter().any(|c| c.signal.is_none() && c.crossed_edges.contains(&id));
            if crossed && edge.to.is_some_and(|to| !network.junction(to).crossings.is_empty()) {
                put(site, site.furniture.crossing, length - 2.4);
            }
        }
        if site.look.many_signs {
            for s in (1..).map(|n| APART * f64::from(n)).take_while(|s| *s < length - 8.0) {
                // So that 0 gives way, as in the towns that the bundled eyes have learned from.
                let drawn = dice.next() as usize % Sign::KINDS;
                let sign = Sign::of((drawn + LIMITS.len()) % Sign::KINDS);
                say(site, sign, s + dice.between(-2.0, 2.0));
            }
        }
    }
}

/// The outermost lane of an edge and its outermost driven lane, for roads that are long enough to have a side.
fn carriageway<'a>(network: &'a Network, edge: &Edge) -> Option<(&'a Lane, &'a Lane)> {
    if edge.kind != EdgeKind::Normal {
        return None;
    }
    let road = edge.lanes.iter().map(|&l| network.lane(l)).find(|l| surface(l) == Surface::Road)?;
    let border = network.lane(*edge.lanes.first()?);
    (border.shape.length() > 4.0 && border.shape.length() < 1e5).then_some((border, road))
}

/// Furnishes both sides of every road.
pub(super) fn build(site: &mut Site<'_>) {
    let network = site.network;
    let outer = site.outer();
    for (number, edge) in network.edges.iter().enumerate() {
        let id = EdgeId(number as u32);
        let Some((border, road)) = carriageway(network, edge) else { continue };
        let fast = road.speed_limit > 18.0;
        let sidewalk = surface(border) == Surface::Sidewalk;
        let lanes = edge.lanes.len();
        furnish(site, &Side { lane: border, side: outer, sidewalk }, fast, lanes, number as u64);
        match opposite(network, id) {
            None => {
                if let Some(inner) = edge.lanes.last().map(|&l| network.lane(l)) {
                    let side = Side { lane: inner, side: -outer, sidewalk: false };
                    furnish(site, &side, fast, lanes, number as u64 | 1 << 40);
                }
            }
            Some((other, gap)) if gap > 1.2 && id < other => {
                if let Some(inner) = edge.lanes.last().map(|&l| network.lane(l)) {
                    median(site, inner, -outer, gap);
                }
            }
            _ => {}
        }
    }
}

/// A green strip between opposite directions with a kerb on its near side, bushes and low trees.
fn median(site: &mut Site<'_>, lane: &Lane, side: f64, gap: f64) {
    let length = lane.shape.length();
    let mut s = 6.0;
    while s < length - 8.0 {
        let view = Side { lane, side, sidewalk: false };
        let (at, heading) = view.place(s, 0.5 * gap);
        if gap > 3.0 && site.dice.chance(0.4) {
            let kind = site.plants.broad[2];
            site.tree(kind, at, 0.8);
        } else if let Some(mut bush) = site.put(site.plants.bush, at, heading, 0.42 * gap) {
            let size = (0.35 * gap).clamp(0.3, 0.9) as f32;
            bush.scale = [size, size, 0.9];
            bush.tints[0] = leaf_colour(site.dice.next());
            site.tiles.instance(bush);
        }
        s += site.dice.between(5.0, 9.0);
    }
}

fn furnish(site: &mut Site<'_>, side: &Side<'_>, fast: bool, lanes: usize, key: u64) {
    let length = side.lane.shape.length();
    // Streets differ: leafy, hedged, with cars parked, bare.
    let character = seeds::derive(key, "street");
    let Look { parked, trees, .. } = site.look;
    let leafy = ((character % 10) as f32) < 6.0 * trees;
    let hedged = character >> 8 & 3 == 0;
    let parked = ((character >> 12 & 3) as f32) >= 4.0 - 3.0 * parked;
    // Crowns of large trees reach over the road.
    let grown = f64::from(trees.max(1.0)).sqrt();
    if fast && !side.sidewalk {
        rail(site, side, &GUARD);
    }
    rail(site, side, &PARAPET);
    lamps(site, side, lanes);
    if side.sidewalk && !fast && length > 70.0 {
        bus_stop(site, side);
    }
    if parked && !fast && length > 30.0 {
        parked_cars(site, side);
    }
    let kind = match character >> 16 & 7 {
        0 => site.plants.slim,
        n => site.plants.broad[n as usize % site.plants.broad.len()],
    };
    let mut s = site.dice.between(3.0, 9.0);
    while s < length - 3.0 {
        let (at, heading) = side.place(s, if fast { site.dice.between(3.0, 9.0) } else { 1.25 });
        let what = site.dice.unit();
        if fast && what < f64::from(0.7 * trees.min(1.0)) {
            let model = if site.dice.chance(0.35) { site.plants.conifer } else { kind };
            let size = site.dice.between(0.8, 1.3);
            site.tree(model, at, size);
        } else if leafy && what < 0.72 {
            let size = site.dice.between(0.85, 1.1) * grown;
            site.tree(kind, at, size);
        } else if what > 0.97 && side.sidewalk {
            let (at, heading) = side.place(s, 0.75);
            site.bench(at, heading);
        } else if what > 0.92 && side.sidewalk {
            let (at, _) = side.place(s, 0.5);
            if let Some(bin) = site.put(site.furniture.bin, at, heading, 0.2) {
                site.tiles.instance(bin);
            }
        } else if hedged {
            hedge(site, side, s);
        } else if what < 0.85 {
            let (at, _) = side.place(s, 1.5);
            if let Some(mut bush) = site.put(site.plants.bush, at, heading + 1.0, 1.05) {
                bush.scale = [0.9, 0.9, site.dice.between(0.7, 1.3) as f32];
                bush.tints[0] = leaf_colour(site.dice.next());
                site.tiles.instance(bush);
            }
        }
        s += if leafy { site.dice.between(7.0, 13.0) } else { site.dice.between(10.0, 22.0) };
        // Behind the first row, away from streets with houses, more trees.
        if site.dice.chance(f64::from(0.3 * trees)) {
            let out = site.dice.between(6.0, 16.0);
            let (at, _) = side.place(s, out);
            if site.ground.disc_free(at, 1.6, uses::BUILDING) {
                let model = if site.dice.chance(0.25) { site.plants.conifer } else { site.plants.broad[0] };
                let size = site.dice.between(0.8, 1.3);
                site.tree(model, at, size);
            }
        }
    }
}

fn lamps(site: &mut Site<'_>, side: &Side<'_>, lanes: usize) {
    let length = side.lane.shape.length();
    let step = if lanes > 3 { 28.0 } else { 34.0 };
    let count = (length / step).round().max(1.0);
    if length < 14.0 {
        return;
    }
    for i in 0..count as usize {
        let s = length * (i as f64 + 0.5) / count;
        let (at, heading) = side.place(s, 0.42);
        if let Some(lamp) = site.put(site.furniture.lamp, at, heading, 0.12) {
            site.tiles.instance(lamp);
        }
    }
}

fn bus_stop(site: &mut Site<'_>, side: &Side<'_>) {
    if !site.dice.chance(0.3) {
        return;
    }
    let s = site.dice.between(0.4, 0.7) * side.lane.shape.length();
    let (at, heading) = side.place(s, 1.25);
    let Some(shelter) = site.put(site.furniture.shelter, at, heading, 0.5) else { return };
    let corners = [(-0.75, -2.05), (0.75, -2.05), (0.75, 2.05), (-0.75, 2.05)]
        .map(|(x, y)| shelter.pose.to_world(Vector::new(x, y)));
    if site.ground.convex_free(&corners, uses::WAY | uses::BUILDING) {
        site.ground.fill(&corners, uses::OBJECT);
        site.tiles.instance(shelter);
    }
}

/// A strip of asphalt beyond the border with cars along it.
fn parked_cars(site: &mut Site<'_>, side: &Side<'_>) {
    let length = side.lane.shape.length();
    let (slot, depth, clear) = (6.2, 2.2, 0.25);
    let mut s = site.dice.between(8.0, 16.0);
    while s + slot < length - 9.0 {
        let middle = s + 0.5 * slot;
        let (at, to_road) = side.place(middle, clear + 0.5 * depth);
        let heading = side.lane.shape.at(middle).heading;
        let pose = Pose::new(at.x, at.y, side.lane.shape.at(middle).position.z, heading);
        let (l, w) = (0.5 * slot, 0.5 * depth);
        let corners = [(-l, -w), (l, -w), (l, w), (-l, w)].map(|(x, y)| pose.to_world(Vector::new(x, y)));
        let inward = direction(to_road);
        let free = site.ground.convex_free(&corners.map(|c| c - inward * 0.1), TAKEN & !uses::WAY)
            && site.ground.disc_free(at, 0.8, uses::WAY);
        if free
            && site.dice.chance((0.62 * f64::from(site.look.parked)).min(0.95))
            && site.park(Pose { heading, ..pose })
        {
            // The bay reaches to the border.
            for t in [[0, 1, 2], [0, 2, 3]] {
                let z = site.terrain.at(at) - 0.012;
                site.tiles.floor(t.map(|i: usize| corners[i]), &|_| z, site.materials.parking, Levels::All);
            }
            s += slot;
        } else {
            s += 3.0;
        }
    }
}

fn hedge(site: &mut Site<'_>, side: &Side<'_>, s: f64) {
    let pieces = 3 + (site.dice.next() % 5) as usize;
    let places: Vec<(Point, f64)> = (0..pieces).map(|i| side.place(s + i as f64 * 0.98, 1.1)).collect();
    if !places.iter().all(|(at, _)| site.ground.disc_free(*at, 0.75, TAKEN)) {
        return;
    }
    for (at, heading) in places {
        let pose = Pose::new(at.x, at.y, site.terrain.at(at), heading + FRAC_PI_2);
        let mut piece = Instance::new(site.plants.hedge, pose);
        piece.scale = [1.02, 1.0, 1.0];
        site.tiles.instance(piece);
        site.ground.fill_strip(at, at + Vector::new(0.01, 0.0), 0.4, uses::OBJECT);
    }
}

/// A rail along a road.
struct Rail {
    /// On a bridge only; else only where the ground is free.
    bridge: bool,
    /// From the road's border to it (m).
    out: f64,
    /// Greatest distance between posts (m).
    posts: f64,
    /// Its bars, from and to (m above the road); posts end in the highest one.
    bars: &'static [[f32; 2]],
}

/// Beside fast roads.
const GUARD: Rail = Rail { bridge: false, out: 0.75, posts: 4.0, bars: &[[0.48, 0.78]] };
/// Along bridges: a metre above the sidewalk.
const PARAPET: Rail =
    Rail { bridge: true, out: 0.12, posts: 2.0, bars: &[[0.28, 0.34], [0.68, 0.74], [1.08, 1.18]] };
/// A bridge reaches this far beyond the water (m).
const BANK: f64 = 2.5;

/// Puts up a rail wherever it belongs on a side of a road.
fn rail(site: &mut Site<'_>, side: &Side<'_>, rail: &Rail) {
    let line = stations(&side.lane.shape, rail.posts);
    let d = side.side * (0.5 * side.lane.width + rail.out);
    for pair in line.windows(2) {
        let (a, b) = (pair[0].off(d, 0.0), pair[1].off(d, 0.0));
        let middle = a.xy() + (b - a).xy() * 0.5;
        let free = |p: Point| site.ground.disc_free(p, 0.15, TAKEN);
        let over_water = |station: &Station| {
            let beyond = station.off(d + side.side * 0.5, 0.0).xy();
            !site.ground.disc_free(station.at.xy(), BANK, uses::WATER)
                && site.ground.at(beyond) & uses::WAY == 0
        };
        // Also where the road stands above the ground, but not between its own lanes.
        let above = || {
            let beyond = pair[0].off(d + side.side * 0.5, 0.0);
            let beside = site.network.lanes_near(beyond.xy(), Some(beyond.z), 6.0);
            bridges::carries(site.terrain, pair[0].at, pair[1].at)
                && beside.iter().all(|near| near.distance > 0.5 * site.network.lane(near.lane).width)
        };
        let placed = match rail.bridge {
            true => pair.iter().all(over_water) || above(),
            false => free(a.xy()) && free(middle) && free(b.xy()),
        };
        if !placed {
            continue;
        }
        let mut s = Shaper::new(20.0);
        let along = (b - a).xy();
        let length = along.norm() as f32;
        s.place(along.y.atan2(along.x) as f32, [0.0; 3]);
        for [low, high] in rail.bars {
            s.cuboid([-0.03, -0.03, *low], [length + 0.03, 0.03, *high], true, site.materials.guard_rail);
        }
        let top = rail.bars.iter().map(|bar| bar[1]).fold(0.0, f32::max) - 0.04;
        s.cuboid([-0.05, -0.05, -0.1], [0.05, 0.05, top], false, site.materials.guard_rail);
        let mesh = s.finish();
        site.tiles.mesh(a, &mesh, Levels::Middle);
        site.ground.fill_strip(a.xy(), b.xy(), 0.2, uses::OBJECT);
    }
}

/// Rows of bays with cars on a car park.
pub(super) fn car_park(site: &mut Site<'_>, outline: &[Point]) {
    let n = outline.len();
    let longest = (0..n).max_by(|&i, &k| {
        let l = |i: usize| (outline[(i + 1) % n] - outline[i]).norm();
        l(i).total_cmp(&l(k))
    });
    let Some(first) = longest else { return };
    let (a, b) = (outline[first], outline[(first + 1) % n]);
    let d = b - a;
    let frame = Pose::new(a.x, a.y, 0.0, d.y.atan2(d.x));
    let far = outline
        .iter()
        .map(|p| frame.to_local(*p))
        .fold((0.0_f64, 0.0_f64), |m, p| (m.0.max(p.x), m.1.max(p.y)));
    let (bay, deep, aisle) = (2.55, 5.0, 6.2);
    let mut y = 0.6;
    let mut row = 0;
    while y + deep < far.1 && row < 40 {
        let mut x = 0.8;
        while x + bay < far.0.min(300.0) {
            let corners = [(x, y), (x + bay, y), (x + bay, y + deep), (x, y + deep)]
                .map(|(x, y)| frame.to_world(Vector::new(x, y)));
            let inside = corners.iter().all(|&c| sumo_network::geometry::polygon_contains(outline, c));
            if inside && site.ground.convex_free(&corners, uses::WAY | uses::BUILDING | uses::OBJECT) {
                let z = site.terrain.at(a) - 0.01;
                let line = |x: f64| {
                    [(x - 0.05, y), (x + 0.05, y), (x + 0.05, y + deep), (x - 0.05, y + deep)].map(
                        |(x, y)| {
                            let p = frame.to_world(Vector::new(x, y));
                            Point3::new(p.x, p.y, z)
                        },
                    )
                };
                for x in [x, x + bay] {
                    let [p, q, r, s] = line(x);
                    site.tiles.paint([q, r, s, p], 0.6, [true, true]);
                }
                if site.dice.chance(0.6) {
                    let centre = frame.to_world(Vector::new(x + 0.5 * bay, y + 0.5 * deep));
                    let turn = if site.dice.chance(0.5) { FRAC_PI_2 } else { -FRAC_PI_2 };
                    site.park(Pose::new(centre.x, centre.y, z, frame.heading + turn));
                }
            }
            x += bay;
        }
        // Two rows back to back, then an aisle.
        y += if row % 2 == 0 { deep + aisle } else { deep + 0.1 };
        row += 1;
    }
}
