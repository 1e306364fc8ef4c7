//! Trees and bushes of a few kinds.

use super::materials::Materials;
use super::shape::{Shaper, V3, add, bounds_of, scaled};
use crate::camera::model::{Level, Library, MaterialId, Model, ModelId, Rgb, srgb};
use crate::seeds;

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

/// Small leaves of odd directions over a ball, to break up its outline.
fn leaves(s: &mut Shaper, centre: V3, radii: V3, count: u64, size: f32, seed: u64, material: MaterialId) {
    for i in 0..count {
        let n = |k: u64| noise(seed, 7919 + i * 16 + k);
        let z = 2.0 * n(0) - 0.85;
        let z = z.clamp(-0.95, 1.0);
        let (sin, cos) = (n(1) * std::f32::consts::TAU).sin_cos();
        let r = (1.0 - z * z).sqrt();
        let out = [r * cos, r * sin, z];
        let reach = 0.84 + 0.2 * n(2);
        let at =
            add(centre, [out[0] * radii[0] * reach, out[1] * radii[1] * reach, out[2] * radii[2] * reach]);
        let jitter = |k: u64| [n(k) - 0.5, n(k + 1) - 0.5, n(k + 2) - 0.5];
        let corners = [3, 6, 9].map(|k| add(at, scaled(jitter(k), 2.0 * size)));
        let ids = corners.map(|c| s.point_uv(c, [c[0] + 0.6 * c[1], c[2]]));
        s.tri(ids[0], ids[1], ids[2], material);
    }
}

fn levels(build: impl Fn(&mut Shaper, usize)) -> Vec<Level> {
    (0..3)
        .map(|level| {
            let mut s = Shaper::new(80.0);
            build(&mut s, level);
            Level { mesh: s.finish(), min_pixels: PIXELS[level] }
        })
        .collect()
}

fn plant(library: &mut Library, name: &str, levels: Vec<Level>) -> ModelId {
    let bounds = bounds_of([&levels[0].mesh]);
    library.model(Model { name: name.to_string(), levels, bounds, casts_shadow: true, ..Model::default() })
}

fn trunk(s: &mut Shaper, m: &Materials, height: f32, radius: f32, level: usize) {
    let sides = [8, 5, 3][level];
    s.tube(
        &[([0.0; 3], 1.25 * radius), ([0.0, 0.0, 0.4], radius), ([0.02, 0.0, height], 0.7 * radius)],
        sides,
        false,
        m.bark,
    );
    if level == 0 {
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
    lump(
        s,
        add(centre, [0.0, 0.0, 0.15 * rise]),
        [0.72 * spread, 0.72 * spread, 0.82 * rise],
        detail,
        seed,
        leaf,
    );
    for i in 0..count {
        let turn = (i as f32 + noise(seed, i as u64)) / count as f32 * std::f32::consts::TAU;
        let (sin, cos) = turn.sin_cos();
        let out = 0.5 * spread;
        let up = rise * (noise(seed, 40 + i as u64) - 0.55) * 0.9;
        let size = 0.45 + 0.16 * noise(seed, 80 + i as u64);
        let radii = [size * spread, size * spread, size * rise * 1.05];
        let at = add(centre, [out * cos, out * sin, up]);
        lump(s, at, radii, detail, seed + i as u64, leaf);
        let cards = [44, 7][level];
        leaves(s, at, radii, cards, [0.26, 0.5][level], seed + 31 * i as u64, leaf);
    }
}

impl Plants {
    pub fn new(library: &mut Library, m: &Materials) -> Self {
        let kinds = [(2.5, 2.3, 5.2, 0.17, 3.4), (3.2, 2.6, 6.4, 0.23, 4.2), (2.0, 2.4, 4.9, 0.13, 3.0)];
        let broad = kinds
            .into_iter()
            .enumerate()
            .map(|(i, (spread, rise, middle, radius, height))| {
                let levels = levels(|s, level| {
                    trunk(s, m, height, radius, level);
                    crown(s, (spread, rise, middle), level, 11 + 97 * i as u64, m.foliage);
                });
                plant(library, "broad tree", levels)
            })
            .collect();
        let slim = levels(|s, level| {
            trunk(s, m, 2.2, 0.15, level);
            let sides = [(9, 9), (5, 6), (3, 5)][level];
            lump(s, [0.0, 0.0, 6.0], [1.15, 1.15, 4.6], sides, 5, m.foliage);
            if level < 2 {
                leaves(
                    s,
                    [0.0, 0.0, 6.0],
                    [1.15, 1.15, 4.6],
                    [90, 20][level],
                    [0.28, 0.5][level],
                    6,
                    m.foliage,
                );
            }
        });
        let conifer = levels(|s, level| {
            trunk(s, m, 1.4, 0.16, level);
            let tiers = [5, 3, 1][level];
            let sides = [11, 7, 5][level];
            for tier in 0..tiers {
                let t = tier as f32 / tiers as f32;
                let (low, high) =
                    (1.0 + 6.6 * t, 1.0 + 6.6 * t + 7.4 / tiers as f32 + if tiers > 1 { 1.0 } else { 0.0 });
                let radius = 2.1 * (1.0 - 0.82 * t);
                let start = s.len();
                s.tube(
                    &[
                        ([0.0, 0.0, low], radius),
                        ([0.0, 0.0, 0.5 * (low + high)], 0.5 * radius),
                        ([0.0, 0.0, high], 0.04),
                    ],
                    sides,
                    false,
                    m.conifer,
                );
                s.displace(start, |p| {
                    let k = noise(
                        17 + tier as u64,
                        (p[0] * 40.0) as i64 as u64 ^ ((p[1] * 40.0) as i64 as u64).rotate_left(20),
                    );
                    [p[0] * (0.85 + 0.3 * k), p[1] * (0.85 + 0.3 * k), p[2] - 0.25 * k]
                });
            }
            if level == 0 {
                leaves(s, [0.0, 0.0, 3.0], [1.6, 1.6, 2.6], 60, 0.3, 9, m.conifer);
            }
        });
        let bush = levels(|s, level| {
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
        let hedge = levels(|s, level| {
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
