//! Buildings: walls with facades, cornices, roofs; from a net's polygons, or grown beside its roads.

use super::ground::{Ground, Terrain, uses};
use super::materials::{House, Materials, facade};
use super::polygon::{area, cleaned, triangulate};
use super::roads::{Surface, surface};
use super::tiles::{Levels, Tiles};
use crate::model::{Library, Material, MaterialId, SemanticTag, Texture, Wall};
use nalgebra::Point3;
use sumo_network::geometry::{Point, Vector, direction};
use sumo_network::network::{EdgeKind, Network, Polygon};
use sumo_network::seeds;

/// Buildings stand this far in the ground (m).
const BASE: f64 = -0.4;

struct Builder<'a> {
    tiles: &'a mut Tiles,
    library: &'a mut Library,
    materials: &'a Materials,
}

/// A point at a height.
fn lift(p: Point, z: f64) -> Point3<f64> {
    Point3::new(p.x, p.y, z)
}

fn kind_of(polygon: &Polygon) -> Option<House> {
    let kind = polygon.kind.to_ascii_lowercase();
    let has = |word: &str| kind.contains(word);
    if !(has("building") || has("house") || has("apartments")) {
        return None;
    }
    Some(if has("church") || has("cathedral") || has("chapel") {
        House::Church
    } else if has("industrial") || has("warehouse") || has("garage") {
        House::Industrial
    } else if has("commercial")
        || has("retail")
        || has("office")
        || has("hotel")
        || has("school")
        || has("civic")
    {
        House::Commercial
    } else {
        House::Residential
    })
}

/// The lowest ground under a building (m): on a slope it stands in the ground, not over it.
fn foot(outline: &[Point], terrain: &Terrain) -> f64 {
    outline.iter().map(|&p| terrain.at(p)).fold(f64::INFINITY, f64::min)
}

/// Builds every building polygon that keeps off the ways; returns how many stand.
pub(super) fn from_polygons(
    polygons: &[Polygon],
    ground: &mut Ground,
    terrain: &Terrain,
    (tiles, library, materials): (&mut Tiles, &mut Library, &Materials),
    seed: u64,
) -> usize {
    let mut builder = Builder { tiles, library, materials };
    let mut built = 0;
    for (number, polygon) in polygons.iter().enumerate() {
        let Some(kind) = kind_of(polygon) else { continue };
        let outline = cleaned(&polygon.shape);
        let size = area(&outline);
        if !(8.0..250_000.0).contains(&size) || !ground.polygon_free(&outline, uses::WAY) {
            continue;
        }
        let key = seeds::derive(seed ^ (number as u64) << 8, "building");
        let usual = match kind {
            House::Residential => 6.0 + (key % 4) as f64 * 3.0,
            House::Commercial => 7.0 + (key % 6) as f64 * 3.5,
            House::Industrial => 7.0 + (key % 3) as f64 * 1.5,
            House::Church => 18.0,
        };
        let height = polygon.height.unwrap_or(usual).clamp(2.2, 300.0);
        ground.fill(&outline, uses::BUILDING);
        builder.building(&outline, foot(&outline, terrain), height, kind, key);
        built += 1;
    }
    built
}

/// Grows buildings along the roads of a net that has none.
pub(super) fn grow(
    network: &Network,
    ground: &mut Ground,
    terrain: &Terrain,
    (tiles, library, materials): (&mut Tiles, &mut Library, &Materials),
    seed: u64,
) {
    let mut builder = Builder { tiles, library, materials };
    let taken = uses::WAY | uses::BUILDING | uses::WATER;
    for (number, edge) in network.edges.iter().enumerate() {
        if edge.kind != EdgeKind::Normal {
            continue;
        }
        let Some(lane) = edge.lanes.first().map(|&l| network.lane(l)) else { continue };
        let drives = edge.lanes.iter().any(|&l| surface(network.lane(l)) == Surface::Road);
        let speed = edge.lanes.iter().map(|&l| network.lane(l).speed_limit).fold(0.0, f64::max);
        if !drives || speed > 24.0 || lane.shape.length() > 1e5 {
            continue;
        }
        let outer = if network.left_hand { 1.0 } else { -1.0 };
        let mut s = 4.0;
        let mut step = 0_u64;
        while s < lane.shape.length() - 6.0 {
            let key = seeds::derive(seed ^ (number as u64) << 20 ^ step, "lot");
            step += 1;
            let unit = |shift: u32| (key >> shift & 1023) as f64 / 1023.0;
            let pose = lane.shape.at(s);
            // Districts change over some hundred metres.
            let district =
                ((pose.position.x / 170.0).sin() + (pose.position.y / 210.0).cos() + unit(50)) / 3.0;
            let (kind, width, depth, setback, height) = if speed > 12.0 && district > 0.45 {
                (House::Commercial, 16.0 + 14.0 * unit(0), 13.0 + 6.0 * unit(10), 2.5, 10.0 + 18.0 * unit(20))
            } else if district < -0.42 {
                (House::Industrial, 22.0 + 16.0 * unit(0), 18.0, 7.0, 6.5 + 3.0 * unit(20))
            } else {
                (
                    House::Residential,
                    9.0 + 9.0 * unit(0),
                    9.0 + 3.0 * unit(10),
                    4.0 + 4.0 * unit(30),
                    5.6 + 8.0 * unit(20),
                )
            };
            let gap = if unit(40) < 0.2 { 14.0 } else { 2.5 + 4.0 * unit(40) };
            let along = direction(pose.heading);
            let away = Vector::new(-along.y, along.x) * outer;
            let near = pose.xy() + away * (0.5 * lane.width + setback);
            let (a, b) = (near, near + along * width);
            let lot = cleaned(&[a, b, b + away * depth, a + away * depth]);
            if lot.len() == 4 && ground.convex_free(&lot, taken) {
                ground.fill(&lot, uses::BUILDING);
                builder.building(&lot, foot(&lot, terrain), height, kind, key);
                s += width + gap;
            } else {
                s += 5.0;
            }
        }
    }
}

impl Builder<'_> {
    fn building(&mut self, outline: &[Point], ground: f64, height: f64, kind: House, key: u64) {
        let (facade, colour) = facade(kind, height, (key >> 16) as u32);
        let glossy = facade.wall == Wall::Glass;
        let wall = self.library.material(Material {
            name: format!("{kind:?} facade"),
            albedo: colour,
            texture: Texture::Facade(facade),
            tag: SemanticTag::Building,
            gloss: if glossy { 0.5 } else { 0.0 },
            wetness: 0.2,
            ..Material::default()
        });
        let plain = self.library.material(Material {
            name: "gable".to_string(),
            albedo: colour,
            texture: if facade.wall == Wall::Brick { Texture::Brick } else { Texture::Concrete },
            tag: SemanticTag::Building,
            wetness: 0.2,
            ..Material::default()
        });
        let (low, top) = (ground, ground + height);
        let n = outline.len();
        let trim = self.materials.trims[(key >> 9) as usize % self.materials.trims.len()];
        for i in 0..n {
            let (a, b) = (outline[i], outline[(i + 1) % n]);
            let length = (b - a).norm();
            // Whole bays fill a wall.
            let bays = (length / f64::from(facade.bay)).round();
            let u = if bays >= 1.0 { bays * f64::from(facade.bay) } else { 0.0 };
            let v = if length < 1.2 { 0.0 } else { height };
            // The storeys' grid begins at the ground; below it the wall goes on.
            if u > 0.0 && v > 0.0 {
                self.tiles.wall(
                    [lift(a, low), lift(b, low), lift(b, top), lift(a, top)],
                    [[0.0, 0.0], [u, 0.0], [u, v], [0.0, v]],
                    wall,
                    Levels::All,
                );
            } else {
                self.tiles.wall(
                    [lift(a, low), lift(b, low), lift(b, top), lift(a, top)],
                    [[0.0, 0.0], [length, 0.0], [length, height], [0.0, height]],
                    plain,
                    Levels::All,
                );
            }
            self.tiles.wall(
                [lift(a, low + BASE), lift(b, low + BASE), lift(b, low), lift(a, low)],
                [[0.0, 0.0], [length, 0.0], [length, -BASE], [0.0, -BASE]],
                plain,
                Levels::Middle,
            );
        }
        let pitched = n == 4 && matches!(kind, House::Residential) && height < 16.0;
        let barn = n == 4 && kind == House::Industrial && key >> 5 & 1 == 0;
        if pitched || barn {
            self.ridge(
                outline,
                top,
                if barn { 0.16 } else { 0.34 + 0.12 * ((key >> 30) % 3) as f64 },
                plain,
                key,
            );
        } else if kind == House::Church {
            self.church(outline, low, top, plain, key);
        } else {
            for t in triangulate(outline) {
                self.tiles.floor(t, &|_| top, self.materials.flat_roof, Levels::All);
            }
            self.cornice(outline, top, trim, glossy);
            if height > 9.0 && n >= 4 {
                self.rooftop(outline, top, key);
            }
        }
        if kind == House::Residential && height > 8.0 && key >> 3 & 3 == 0 {
            self.balconies(outline, ground, &facade, height);
        }
    }

    /// A band round the top that stands out a little.
    fn cornice(&mut self, outline: &[Point], top: f64, material: MaterialId, slim: bool) {
        let (out, high) = if slim { (0.06, 0.5) } else { (0.22, 0.42) };
        let n = outline.len();
        let corner = |i: usize| {
            let (p, q, r) = (outline[(i + n - 1) % n], outline[i], outline[(i + 1) % n]);
            let normal = |d: Vector| Vector::new(d.y, -d.x) / d.norm().max(1e-6);
            let sum = normal(q - p) + normal(r - q);
            let scale = sum.norm_squared();
            q + if scale > 0.3 { sum * (2.0 * out / scale) } else { Vector::zeros() }
        };
        for i in 0..n {
            let (a, b) = (outline[i], outline[(i + 1) % n]);
            let (oa, ob) = (corner(i), corner((i + 1) % n));
            let uv = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
            let (lo, hi) = (top - high + 0.1, top + 0.1);
            self.tiles.wall(
                [lift(oa, lo), lift(ob, lo), lift(ob, hi), lift(oa, hi)],
                uv,
                material,
                Levels::Middle,
            );
            self.tiles.wall(
                [lift(a, lo), lift(b, lo), lift(ob, lo), lift(oa, lo)],
                uv,
                material,
                Levels::Near,
            );
            self.tiles.wall(
                [lift(oa, hi), lift(ob, hi), lift(b, hi), lift(a, hi)],
                uv,
                material,
                Levels::Near,
            );
        }
    }

    /// A roof with a ridge along the longer side of four corners.
    fn ridge(&mut self, outline: &[Point], top: f64, slope: f64, gable: MaterialId, key: u64) {
        let first = (outline[1] - outline[0]).norm() + (outline[3] - outline[2]).norm();
        let second = (outline[2] - outline[1]).norm() + (outline[0] - outline[3]).norm();
        let start = usize::from(second > first);
        let [a, b, c, d] = [0, 1, 2, 3].map(|i| outline[(start + i) % 4]);
        let span = 0.5 * first.min(second);
        let rise = (0.5 * span * slope * 2.0).min(6.0);
        let (mut r1, mut r0) = (b + (c - b) * 0.5, d + (a - d) * 0.5);
        let hipped = key >> 12 & 3 == 0;
        let ridge = r1 - r0;
        if hipped {
            let inset = ridge * (0.5 * span / ridge.norm().max(1e-6)).min(0.42);
            (r0, r1) = (r0 + inset, r1 - inset);
        } else {
            let over = ridge * (0.35 / ridge.norm().max(1e-6));
            (r0, r1) = (r0 - over, r1 + over);
        }
        // Eaves stand out and so hang lower.
        let out = |p: Point, q: Point| {
            let across = p - q;
            across * (0.45 / across.norm().max(1e-6))
        };
        let drop = 0.45 * rise / (0.5 * span).max(0.5);
        let tiles_of = &self.materials.roofs;
        let roof = tiles_of[(key >> 20) as usize % tiles_of.len()];
        let along = if hipped { Vector::zeros() } else { ridge * (0.35 / ridge.norm().max(1e-6)) };
        let (ea, eb) = (a + out(a, d) - along, b + out(b, c) + along);
        let (ec, ed) = (c + out(c, b) + along, d + out(d, a) - along);
        let (low, high) = (top - drop, top + rise);
        let uv = [[0.0, 0.0], [ridge.norm(), 0.0], [ridge.norm(), span], [0.0, span]];
        self.tiles.wall(
            [lift(ea, low), lift(eb, low), lift(r1, high), lift(r0, high)],
            uv,
            roof,
            Levels::All,
        );
        self.tiles.wall(
            [lift(ec, low), lift(ed, low), lift(r0, high), lift(r1, high)],
            uv,
            roof,
            Levels::All,
        );
        // Undersides of the eaves.
        self.tiles.wall(
            [lift(eb, low), lift(ea, low), lift(a, top - 0.02), lift(b, top - 0.02)],
            uv,
            gable,
            Levels::Near,
        );
        self.tiles.wall(
            [lift(ed, low), lift(ec, low), lift(c, top - 0.02), lift(d, top - 0.02)],
            uv,
            gable,
            Levels::Near,
        );
        let (g1, g0) = (b + (c - b) * 0.5, d + (a - d) * 0.5);
        if hipped {
            let end = [[0.0, 0.0], [span, 0.0], [0.5 * span, span], [0.5 * span, span]];
            self.tiles.wall(
                [lift(eb, low), lift(ec, low), lift(r1, high), lift(r1, high)],
                end,
                roof,
                Levels::All,
            );
            self.tiles.wall(
                [lift(ed, low), lift(ea, low), lift(r0, high), lift(r0, high)],
                end,
                roof,
                Levels::All,
            );
        } else {
            for (p, q, peak) in [(b, c, g1), (d, a, g0)] {
                let w = (q - p).norm();
                self.tiles.wall(
                    [lift(p, top), lift(q, top), lift(peak, high - 0.05), lift(peak, high - 0.05)],
                    [[0.0, 0.0], [w, 0.0], [0.5 * w, rise], [0.5 * w, rise]],
                    gable,
                    Levels::All,
                );
            }
        }
        if key >> 14 & 3 != 3 {
            let at = r0 + (r1 - r0) * (0.25 + 0.5 * ((key >> 32) % 100) as f64 / 100.0);
            self.block(at, 0.35, high - 0.8, high + 0.9, self.materials.brick, Levels::Middle);
        }
    }

    /// An upright block on a square of half width `half` (m).
    fn block(&mut self, at: Point, half: f64, low: f64, high: f64, material: MaterialId, levels: Levels) {
        let p =
            [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(x, y)| at + Vector::new(x, y) * half);
        for i in 0..4 {
            let (a, b) = (p[i], p[(i + 1) % 4]);
            let (w, h) = (2.0 * half, high - low);
            let uv = [[0.0, 0.0], [w, 0.0], [w, h], [0.0, h]];
            self.tiles.wall([lift(a, low), lift(b, low), lift(b, high), lift(a, high)], uv, material, levels);
        }
        let uv = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
        self.tiles.wall(p.map(|q| lift(q, high)), uv, material, levels);
    }

    /// Stair heads and machines on a flat roof.
    fn rooftop(&mut self, outline: &[Point], top: f64, key: u64) {
        let n = outline.len() as f64;
        let middle = Point::from(outline.iter().fold(Vector::zeros(), |s, p| s + p.coords) / n);
        for i in 0..(key >> 40 & 3) {
            let corner = outline[(key >> (42 + 3 * i)) as usize % outline.len()];
            let at = middle + (corner - middle) * 0.35;
            let size = 0.9 + (key >> (44 + i) & 7) as f64 * 0.15;
            if sumo_network::geometry::polygon_contains(outline, at) {
                self.block(at, size, top, top + 0.8 + size, self.materials.concrete_roof(), Levels::Middle);
            }
        }
    }

    /// A steep roof over the nave and a tower in the middle with a spire.
    fn church(&mut self, outline: &[Point], low: f64, top: f64, wall: MaterialId, key: u64) {
        let n = outline.len();
        let middle = Point::from(outline.iter().fold(Vector::zeros(), |s, p| s + p.coords) / n as f64);
        let roof = self.materials.roofs[3 + (key % 3) as usize];
        let peak = top + 9.0;
        let uv = [[0.0, 0.0], [4.0, 0.0], [2.0, 9.0], [2.0, 9.0]];
        for i in 0..n {
            let (a, b) = (outline[i], outline[(i + 1) % n]);
            self.tiles.wall(
                [lift(a, top), lift(b, top), lift(middle, peak), lift(middle, peak)],
                uv,
                roof,
                Levels::All,
            );
        }
        let half = 3.2;
        self.block(middle, half, low, peak + 7.0, wall, Levels::All);
        let p = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
            .map(|(x, y)| middle + Vector::new(x, y) * (half + 0.2));
        for i in 0..4 {
            let tip = lift(middle, peak + 21.0);
            let (a, b) = (lift(p[i], peak + 7.0), lift(p[(i + 1) % 4], peak + 7.0));
            self.tiles.wall([a, b, tip, tip], uv, roof, Levels::All);
        }
    }

    /// Balconies with railings on the upper storeys of the longest wall and the one opposite.
    fn balconies(&mut self, outline: &[Point], ground: f64, facade: &crate::model::Facade, height: f64) {
        let n = outline.len();
        let longest = (0..n).max_by(|&i, &k| {
            let l = |i: usize| (outline[(i + 1) % n] - outline[i]).norm();
            l(i).total_cmp(&l(k))
        });
        let Some(first) = longest else { return };
        let storeys = (height / f64::from(facade.storey)).round() as usize;
        for i in [first, (first + n / 2) % n] {
            let (a, b) = (outline[i], outline[(i + 1) % n]);
            let d = b - a;
            let length = d.norm();
            let bays = (length / f64::from(facade.bay)).round() as usize;
            if bays < 2 {
                continue;
            }
            let (along, out) = (d / length, Vector::new(d.y, -d.x) / length * 1.1);
            let bay = length / bays as f64;
            for bay_number in (1..bays).step_by(3).take(4) {
                let p = a + along * (bay * (bay_number as f64 + 0.08));
                let q = p + along * (bay * 0.84);
                for storey in 1..storeys.min(6) {
                    let z = ground + storey as f64 * f64::from(facade.storey) - 0.02;
                    let trim = self.materials.trims[0];
                    let uv = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
                    let (po, qo) = (p + out, q + out);
                    let t = |s: &mut Self, c: [Point3<f64>; 4], m| s.tiles.wall(c, uv, m, Levels::Near);
                    t(
                        self,
                        [lift(p, z - 0.16), lift(q, z - 0.16), lift(qo, z - 0.16), lift(po, z - 0.16)],
                        trim,
                    );
                    t(
                        self,
                        [lift(po, z - 0.16), lift(qo, z - 0.16), lift(qo, z + 0.02), lift(po, z + 0.02)],
                        trim,
                    );
                    let rail = self.materials.balcony();
                    t(
                        self,
                        [lift(po, z + 0.02), lift(qo, z + 0.02), lift(qo, z + 0.95), lift(po, z + 0.95)],
                        rail,
                    );
                    t(
                        self,
                        [lift(p, z - 0.16), lift(po, z - 0.16), lift(po, z + 0.95), lift(p, z + 0.95)],
                        rail,
                    );
                    t(
                        self,
                        [lift(qo, z - 0.16), lift(q, z - 0.16), lift(q, z + 0.95), lift(qo, z + 0.95)],
                        rail,
                    );
                }
            }
        }
    }
}
