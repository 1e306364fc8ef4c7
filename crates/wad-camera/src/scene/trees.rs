//! Trees and bushes of a few kinds.

use super::materials::Materials;
use crate::model::{Level, Library, MaterialId, Mesh, Model, ModelId, Rgb, srgb};
use crate::shape::{Shaper, V3, add, bounds_of, scaled, unit};
use std::f32::consts::TAU;
use sumo_network::seeds;

/// The models of plants.
#[derive(Clone, Debug)]
pub(super) struct Plants {
    /// Broad trees for streets and parks.
    pub broad: Vec<ModelId>,
    pub slim: ModelId,
    pub conifer: ModelId,
    pub bush: ModelId,
    /// A metre of hedge along x.
    pub hedge: ModelId,
}

/// Radius in pixels from which the fine and middle levels are drawn, and anything at all.
const PIXELS: [f32; 3] = [64.0, 20.0, 1.5];

/// Leaf colours (tint 0).
const LEAVES: [[u8; 3]; 8] = [
    [74, 94, 48],
    [64, 86, 42],
    [84, 100, 54],
    [58, 80, 46],
    [80, 98, 52],
    [70, 90, 58],
    [70, 84, 44],
    [78, 92, 44],
];

/// A leaf colour by a number.
pub(super) fn leaf_colour(key: u64) -> Rgb {
    let [r, g, b] = LEAVES[(key % LEAVES.len() as u64) as usize];
    srgb(r, g, b)
}

fn noise(seed: u64, i: u64) -> f32 {
    (seeds::derive(seed.wrapping_mul(1009) ^ i, "leaf") % 10_000) as f32 / 10_000.0
}

/// A lumpy ball of leaves.
fn lump(s: &mut Shaper, centre: V3, radii: V3, detail: (usize, usize), seed: u64, material: MaterialId) {
    let start = s.len();
    s.ball(centre, radii, detail, (-1.0, 1.0), material);
    s.displace(start, |p| {
        let key = p.map(|c| (c * 50.0).round() as i64 as u64);
        let n = noise(seed, key[0] ^ key[1].rotate_left(17) ^ key[2].rotate_left(34));
        add(centre, scaled([p[0] - centre[0], p[1] - centre[1], p[2] - centre[2]], 0.82 + 0.34 * n))
    });
}

/// Twigs of leaves that stand off a ball, to break up its outline.
fn leaves(s: &mut Shaper, centre: V3, radii: V3, count: u64, size: f32, seed: u64, material: MaterialId) {
    for i in 0..count {
        let n = |k: u64| noise(seed, 7919 + i * 16 + k);
        // More above than below.
        let z = (2.0 * n(0) - 0.8).clamp(-0.9, 1.0);
        let (sin, cos) = (n(1) * TAU).sin_cos();
        let r = (1.0 - z * z).sqrt();
        let out = [r * cos, r * sin, z];
        let reach = 0.9 + 0.12 * n(2);
        let at =
            add(centre, [out[0] * radii[0] * reach, out[1] * radii[1] * reach, out[2] * radii[2] * reach]);
        // Two ways along the surface, any turn about the way out.
        let (a, b) = ([-sin, cos, 0.0], [-z * cos, -z * sin, r]);
        let (ts, tc) = (n(3) * TAU).sin_cos();
        let along: V3 = std::array::from_fn(|k| a[k] * tc + b[k] * ts);
        let across: V3 = std::array::from_fn(|k| b[k] * tc - a[k] * ts);
        let (up, flat) = (0.25 + 0.85 * n(4)).sin_cos();
        let long = size * (0.9 + 0.8 * n(5));
        let tip: V3 = std::array::from_fn(|k| at[k] + long * (flat * along[k] + up * out[k]));
        let wide = size * (0.55 + 0.3 * n(6));
        let corners = [add(at, scaled(across, wide)), tip, add(at, scaled(across, -wide))];
        let ids = corners.map(|c| s.point_uv(c, [c[0] + 0.6 * c[1], c[2] + 0.4 * c[1]]));
        s.tri(ids[0], ids[1], ids[2], material);
    }
}

/// Lights leaves as parts of a crown round `centre`, whatever way each hangs.
fn soften(mesh: &mut Mesh, leaf: MaterialId, centre: V3, flatness: f32) {
    let mut soft = vec![false; mesh.vertices.len()];
    for triangle in mesh.triangles.iter().filter(|t| t.material == leaf) {
        triangle.corners.iter().for_each(|&i| soft[i as usize] = true);
    }
    for (vertex, _) in mesh.vertices.iter_mut().zip(soft).filter(|(_, soft)| *soft) {
        let p = vertex.position;
        let out = unit([p[0] - centre[0], p[1] - centre[1], (p[2] - centre[2]) * flatness]);
        if vertex.uv == [0.0; 2] {
            vertex.uv = [p[0] + 0.7 * p[1], p[2] - 0.5 * p[1]];
        }
        vertex.normal = unit(add(scaled(vertex.normal, 0.45), scaled(out, 0.75)));
    }
}

fn levels(leaf: MaterialId, centre: V3, flatness: f32, build: impl Fn(&mut Shaper, usize)) -> Vec<Level> {
    (0..3)
        .map(|level| {
            let mut s = Shaper::new(80.0);
            build(&mut s, level);
            let mut mesh = s.finish();
            soften(&mut mesh, leaf, centre, flatness);
            Level { mesh, min_pixels: PIXELS[level] }
        })
        .collect()
}

fn plant(library: &mut Library, name: &str, levels: Vec<Level>) -> ModelId {
    let bounds = bounds_of([&levels[0].mesh]);
    library.model(Model { name: name.to_string(), levels, bounds, casts_shadow: true, ..Model::default() })
}

fn trunk(s: &mut Shaper, m: &Materials, height: f32, radius: f32, branches: bool, level: usize) {
    let sides = [8, 5, 3][level];
    s.tube(
        &[([0.0; 3], 1.25 * radius), ([0.0, 0.0, 0.4], radius), ([0.02, 0.0, height], 0.7 * radius)],
        sides,
        false,
        m.bark,
    );
    if branches && level == 0 {
        for (i, turn) in [0.4_f32, 2.3, 4.4].into_iter().enumerate() {
            let (sin, cos) = turn.sin_cos();
            let from = [0.0, 0.0, height * (0.72 + 0.08 * i as f32)];
            let to = [1.1 * cos, 1.1 * sin, height + 0.7];
            s.tube(&[(from, 0.45 * radius), (to, 0.25 * radius)], 5, false, m.bark);
        }
    }
}

/// A crown of lumps: `spread` and `rise` are its radii (m), `middle` its height.
fn crown(s: &mut Shaper, (spread, rise, middle): (f32, f32, f32), level: usize, seed: u64, leaf: MaterialId) {
    let centre = [0.0, 0.0, middle];
    if level == 2 {
        lump(s, centre, [spread, spread, rise], (4, 6), seed, leaf);
        return;
    }
    let count = [7, 4][level];
    let detail = [(5, 8), (3, 6)][level];
    let (top, radii) = (add(centre, [0.0, 0.0, 0.15 * rise]), [0.72 * spread, 0.72 * spread, 0.82 * rise]);
    lump(s, top, radii, detail, seed, leaf);
    for i in 0..count {
        let turn = (i as f32 + noise(seed, i as u64)) / count as f32 * TAU;
        let (sin, cos) = turn.sin_cos();
        let out = 0.5 * spread;
        let up = rise * (noise(seed, 40 + i as u64) - 0.55) * 0.9;
        let size = 0.45 + 0.16 * noise(seed, 80 + i as u64);
        let radii = [size * spread, size * spread, size * rise * 1.05];
        let at = add(centre, [out * cos, out * sin, up]);
        lump(s, at, radii, detail, seed + i as u64, leaf);
        let twigs = [54, 8][level];
        leaves(s, at, radii, twigs, [0.22, 0.55][level], seed + 31 * i as u64, leaf);
    }
    if level == 0 {
        leaves(s, top, radii, 60, 0.24, seed + 5, leaf);
    }
}

impl Plants {
    pub fn new(library: &mut Library, m: &Materials) -> Self {
        let kinds = [(2.5, 2.3, 5.2, 0.17, 3.4), (3.2, 2.6, 6.4, 0.23, 4.2), (2.0, 2.4, 4.9, 0.13, 3.0)];
        let broad = kinds
            .into_iter()
            .enumerate()
            .map(|(i, (spread, rise, middle, radius, height))| {
                let levels = levels(m.foliage, [0.0, 0.0, middle - 0.4 * rise], 0.8, |s, level| {
                    trunk(s, m, height, radius, true, level);
                    crown(s, (spread, rise, middle), level, 11 + 97 * i as u64, m.foliage);
                });
                plant(library, "broad tree", levels)
            })
            .collect();
        // A poplar: bulges one over the other.
        let slim = levels(m.foliage, [0.0, 0.0, 5.6], 0.35, |s, level| {
            trunk(s, m, 2.2, 0.15, false, level);
            if level == 2 {
                lump(s, [0.0, 0.0, 6.0], [1.1, 1.1, 4.6], (3, 5), 5, m.foliage);
                return;
            }
            let bulges =
                [(2.6, 0.85, 1.3), (4.2, 1.12, 1.7), (6.1, 1.05, 1.8), (8.0, 0.8, 1.7), (9.6, 0.42, 1.2)];
            let detail = [(5, 8), (3, 5)][level];
            for (i, (z, radius, rise)) in
                bulges.into_iter().enumerate().filter(|(i, _)| level == 0 || i % 2 == 0)
            {
                let i = i as u64;
                let grow = if level == 0 { 1.0 } else { 1.45 };
                let aside = |k: u64| 0.3 * (noise(23, 10 * i + k) - 0.5);
                let at = [aside(0), aside(1), z];
                lump(s, at, [radius, radius, rise * grow], detail, 5 + i, m.foliage);
                let twigs = [62, 8][level];
                leaves(s, at, [radius, radius, rise * grow], twigs, [0.17, 0.45][level], 60 + i, m.foliage);
            }
        });
        // A spruce: skirts of branches, their tips low and ragged.
        let conifer = levels(m.conifer, [0.0, 0.0, 2.0], 0.5, |s, level| {
            trunk(s, m, 1.4, 0.16, false, level);
            let tiers = [8, 4, 1][level];
            let sides = [14, 8, 5][level];
            for tier in 0..tiers {
                let t = tier as f32 / tiers as f32;
                let low = 0.9 + 7.2 * t;
                let high = (low + 8.6 / tiers as f32 + if tiers > 1 { 0.9 } else { 0.0 }).min(9.1);
                let radius = 2.15 * (1.0 - 0.86 * t);
                let start = s.len();
                let rim = ([0.0, 0.0, low], radius);
                let top = ([0.0, 0.0, high], 0.04);
                let under = ([0.0, 0.0, low + 0.3 * radius], 0.25 * radius);
                let stops = [under, rim, top];
                s.tube(if level == 0 { &stops } else { &stops[1..] }, sides, false, m.conifer);
                let turn = 0.7 * tier as f32;
                s.displace(start, |p| {
                    let angle = p[1].atan2(p[0]);
                    let number = (angle / TAU * sides as f32 + sides as f32).round() as u64;
                    let k = noise(17 + tier as u64, number);
                    let edge = (p[2] - low).abs() < 0.01;
                    let (wide, droop) = match (edge, number % 2) {
                        (false, _) => (1.0, 0.0),
                        (true, 0) => (1.02 + 0.18 * k, 0.16 + 0.2 * k),
                        (true, _) => (0.72 + 0.14 * k, 0.0),
                    };
                    let (sin, cos) = turn.sin_cos();
                    let (x, y) = (p[0] * wide, p[1] * wide);
                    [x * cos - y * sin, x * sin + y * cos, p[2] - droop * radius * 0.5]
                });
            }
        });
        let bush = levels(m.foliage, [0.1, 0.1, 0.1], 1.0, |s, level| {
            let detail = [(5, 8), (3, 6), (2, 5)][level];
            lump(s, [0.0, 0.0, 0.45], [0.75, 0.7, 0.6], detail, 3, m.foliage);
            if level < 2 {
                lump(s, [0.45, 0.3, 0.35], [0.5, 0.5, 0.45], detail, 4, m.foliage);
                leaves(
                    s,
                    [0.1, 0.1, 0.45],
                    [0.85, 0.8, 0.6],
                    [50, 12][level],
                    [0.14, 0.25][level],
                    5,
                    m.foliage,
                );
            }
        });
        let hedge = levels(m.hedge, [0.0, 0.0, 0.3], 1.0, |s, level| {
            s.cuboid([-0.5, -0.35, 0.0], [0.5, 0.35, 1.15], false, m.hedge);
            if level == 0 {
                leaves(s, [0.0, 0.0, 0.6], [0.52, 0.4, 0.62], 40, 0.12, 8, m.hedge);
            }
        });
        Self {
            broad,
            slim: plant(library, "slim tree", slim),
            conifer: plant(library, "conifer", conifer),
            bush: plant(library, "bush", bush),
            hedge: plant(library, "hedge", hedge),
        }
    }
}
