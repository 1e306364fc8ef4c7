//! The colour of the ground: asphalt, slabs, lawn, with paint, shadows and puddles on it.
//!
//! Near the camera most of it varies slowly from pixel to pixel. There it is computed at posts, each
//! eighth pixel, and interpolated between them, except the finest grain, paint and road users' shadows.

use super::lanes::{Lane, lanes};
use super::noise::{Tile, Tiles, tiles};
use super::raster::PAD;
use super::row::{Linear, POST, Row, Run, fade, grain};
use super::shadow_map::{Texels, sample};
use super::surface::{GroundNumbers, Kind, Surface};
use super::weather::Weather;

/// Runs shorter than this are not worth posts.
const POSTED: usize = 16;

/// The albedo of paint.
const PAINT: [f32; 3] = [0.72, 0.72, 0.70];

/// What the ground's shading needs to know of the row.
pub struct Ground<'a> {
    /// World x, y (m, wrapped) of the eye; a pixel's are these + depth (base + step x).
    pub eye: [f32; 2],
    pub base: [f32; 2],
    pub step: [f32; 2],
    /// Height of the eye above the ground (m), focal length (pixels).
    pub height: f32,
    pub focal: f32,
    pub shadows: &'a Texels,
    pub weather: &'a Weather,
    pub paint: &'a [u16],
    pub shade: &'a [u16],
    /// The pixels of the row that paint and shadows may touch.
    pub painted: [u32; 2],
    pub shaded: [u32; 2],
    /// How far away (m) the map of shadows ends.
    pub shadow_reach: f32,
    pub numbers: &'a GroundNumbers,
    /// Horizontal and low: shadows and puddles lie on it.
    pub lies: bool,
}

lanes! {
    /// Ground with what lies on it.
    pub fn ground<L>(run: &Run<'_>, ground: &Ground<'_>, row: &mut Row) {
        match run.surface.kind {
            Kind::Asphalt => ground_run::<L, ASPHALT>(run, ground, row),
            Kind::Slabs => ground_run::<L, SLABS>(run, ground, row),
            Kind::Lawn => ground_run::<L, LAWN>(run, ground, row),
            _ => ground_run::<L, ROUGH>(run, ground, row),
        }
        if ground.weather.wetness > 0.0 {
            // The last lanes' shine ends with the run.
            row.mirror[run.x1..run.x1 + PAD].fill(0);
        }
    }
}

const ASPHALT: u8 = 0;
const SLABS: u8 = 1;
const LAWN: u8 = 2;
const ROUGH: u8 = 3;

/// How much the finest grain shows on each.
const GRAIN: [f32; 4] = [0.55, 0.22, 0.9, 0.35];

/// What is the same along a run.
struct Along<'a> {
    s: &'a Surface,
    g: &'a Ground<'a>,
    tiles: &'a Tiles,
    s_at: Linear,
    t_at: Linear,
    /// How much of each size of noise is left at this distance; 0: none.
    fine: f32,
    mid: f32,
    large: f32,
    joint_fade: f32,
    wet: f32,
    fresnel: f32,
    puddle_from: f32,
    shadowed: bool,
}

// Closures would not be compiled for the lanes' instructions: functions that are always inlined instead.

/// The dry, unpainted albedo with `detail`, and the middle and large noise about 0.
#[inline(always)]
fn bare<L: Lane, const KIND: u8>(a: &Along<'_>, at: L, z: L, w: [L; 2], detail: L) -> ([L; 3], L, L) {
    let v = L::splat;
    let (zero, one) = (v(0.0), v(1.0));
    let n_mid = if a.mid > 0.0 { noise(&a.tiles.clouds, w, 8.0, a.mid) } else { zero };
    let n_large = noise(&a.tiles.clouds, w, 0.5, a.large);
    let [red, green, blue] = [v(a.s.albedo[0]), v(a.s.albedo[1]), v(a.s.albedo[2])];
    let (mid, large) = match KIND {
        ASPHALT => (0.22, 0.34),
        SLABS => (0.16, 0.22),
        LAWN => (0.6, 0.35),
        _ => (0.25, 0.3),
    };
    let mut m = detail + n_mid.fma(v(mid), n_large.fma(v(large), one));
    if KIND == ASPHALT {
        if a.mid > 0.0 {
            let cracks = a.tiles.cracks.sample(w[0] * v(5.0), w[1] * v(5.0));
            m = m - cracks * v(a.mid * a.g.numbers.wear * 0.35);
        }
        if a.g.numbers.tracks {
            let t = a.t_at.at(at, z);
            let d = (t.abs() - v(0.82)) * v(3.2);
            let d = d * d;
            let (wheels, oil) = (d.fma(d, one), (t * t).fma(v(12.0), one));
            m = m - v(0.10).fma(oil, v(0.05) * wheels) / (wheels * oil);
        }
    }
    if KIND == LAWN {
        let dry = n_large.fma(v(1.1), n_mid.fma(v(0.5), v(0.30))).unit();
        let (r, b) = (dry.fma(v(0.7), v(0.8)), dry.fma(v(-0.4), v(1.05)));
        return ([red * m * r, green * m, blue * m * b], n_mid, n_large);
    }
    ([red * m, green * m, blue * m], n_mid, n_large)
}

/// What slabs add to the brightness: each has its own, and joints are dark.
#[inline(always)]
fn slabs<L: Lane>(a: &Along<'_>, at: L, z: L) -> L {
    let v = L::splat;
    let (one, half) = (v(1.0), v(0.5));
    let joint = a.g.numbers.slabs;
    let (along, across) = (a.s_at.at(at, z) * v(1.0 / joint[0]), a.t_at.at(at, z) * v(1.0 / joint[1]));
    let (ia, ib) = (along.floor(), across.floor());
    let da = (half - (along - ia - half).abs()) * v(joint[0]);
    let db = (half - (across - ib - half).abs()) * v(joint[1]);
    let line = (one - da.min(db) * v(45.0)).max(v(0.0)) * v(a.joint_fade * 0.35);
    (L::random(ia, ib, 5) - half) * v(0.16 * a.joint_fade) - line
}

/// The albedo of paint, and its share of the surface.
#[inline(always)]
fn paint_of<L: Lane>(a: &Along<'_>, words: &[u16], n_fine: L, n_mid: L) -> ([L; 3], L) {
    let v = L::splat;
    let (cover, _) = L::load_bytes(words);
    // Worn paint lets the asphalt through.
    let wear = (n_fine.fma(v(0.5), n_mid + v(0.1)) * v(4.0)).unit();
    let cover = cover * v(1.0 / 255.0) * (v(1.0) - v(0.30 * a.g.numbers.wear) * wear);
    let grain = n_fine.fma(v(0.15), v(1.0));
    ([v(PAINT[0]) * grain, v(PAINT[1]) * grain, v(PAINT[2]) * grain], cover)
}

/// The albedo when wet, and how much it mirrors (0..255).
#[inline(always)]
fn wetted<L: Lane>(a: &Along<'_>, albedo: [L; 3], w: [L; 2], n_large: L, open: L) -> ([L; 3], L) {
    let v = L::splat;
    let pool = a.tiles.clouds.sample(w[0].fma(v(2.0), v(9.0)), w[1] * v(2.0));
    let pool = pool.fma(v(0.6), n_large.fma(v(0.5), v(0.2 - a.puddle_from)));
    let pool = (pool * v(9.0)).unit();
    let dark = v(1.0) - v(a.wet) * pool.fma(v(0.22), v(0.42));
    let shine = (v(a.wet * a.fresnel) * pool.fma(v(0.55), v(0.42)) * open).unit() * v(255.0);
    ([albedo[0] * dark, albedo[1] * dark, albedo[2] * dark], shine)
}

/// Scene light from albedo, with what shadows of road users leave of sun and sky.
#[inline(always)]
fn lit<L: Lane>(a: &Along<'_>, albedo: [L; 3], z: L, w: [L; 2], sun: L, sky: L) -> [L; 3] {
    let v = L::splat;
    let (one, s) = (v(1.0), a.s);
    let (mut sun, mut sky) = (sun, sky);
    if a.shadowed {
        // The map's shadows fade out at its end.
        let still = (one - z * v(1.0 / a.g.shadow_reach)).max(v(0.0)).min(v(0.12)) * v(1.0 / 0.12);
        let cast = one - (one - sample(a.g.shadows, w[0], w[1])) * still * v(a.g.weather.shadows);
        sun = sun * cast;
        // In the shade of houses part of the sky is hidden too.
        sky = sky * cast.fma(v(0.20), v(0.80));
    }
    [
        albedo[0] * v(s.ambient[0]).fma(sky, v(s.sun[0]) * sun),
        albedo[1] * v(s.ambient[1]).fma(sky, v(s.sun[1]) * sun),
        albedo[2] * v(s.ambient[2]).fma(sky, v(s.sun[2]) * sun),
    ]
}

#[inline(always)]
fn ground_run<L: Lane, const KIND: u8>(run: &Run<'_>, g: &Ground<'_>, row: &mut Row) {
    let (x0, x1) = (run.x0, run.x1);
    let middle = 1.0 / run.iz[(x0 + x1) / 2].max(1e-6);
    // A pixel's length on the ground, seen at a grazing angle.
    let footprint = middle * middle / (g.focal * g.height);
    let across = middle / g.focal;
    let low = 1.0 - (g.height / middle).min(1.0);
    let low = low * low;
    // What is too small to see is not worked out.
    let seen = |share: f32| if share > 0.05 { share } else { 0.0 };
    let a = Along {
        s: run.surface,
        g,
        tiles: tiles(),
        s_at: Linear::of(&run.surface.planes[0], run.y),
        t_at: Linear::of(&run.surface.planes[1], run.y),
        fine: seen(fade(footprint, 0.05)),
        mid: seen(fade(footprint, 0.5)),
        large: fade(footprint, 8.0),
        joint_fade: if KIND == SLABS { fade(footprint.min(across * 4.0), 0.25) } else { 0.0 },
        wet: if g.lies { g.weather.wetness * g.numbers.wetness } else { 0.0 },
        fresnel: 0.03 + 0.75 * low * low,
        puddle_from: 1.02 - 0.52 * g.weather.wetness,
        shadowed: g.shadow_reach > 1.0 && middle < g.shadow_reach,
    };
    let world = [
        Linear { base: g.base[0], step: g.step[0], rest: g.eye[0] },
        Linear { base: g.base[1], step: g.step[1], rest: g.eye[1] },
    ];
    let v = L::splat;
    let one = v(1.0);
    // Posts may stand as far apart (m) as what they carry varies: middle noise, shadows, large noise.
    let apart = across * POST as f32;
    let most = if a.mid > 0.3 {
        0.42
    } else if a.shadowed {
        0.5
    } else {
        1.0
    };
    let posted = x1 - x0 >= POSTED && apart <= most;
    if posted {
        let count = (x1 - x0).div_ceil(POST) + 1;
        // 1 / depth is linear along the run.
        let (first, last) = (run.iz[x0], run.iz[x1 - 1]);
        let slope = (last - first) / (x1 - 1 - x0) as f32;
        let mut k = 0;
        while k < count {
            let step = (v(k as f32) + L::ramp()) * v(POST as f32);
            let at = v(x0 as f32) + step;
            let z = one / step.fma(v(slope), v(first)).max(v(1e-4));
            let w = [world[0].at(at, z), world[1].at(at, z)];
            let (albedo, n_mid, n_large) = bare::<L, KIND>(&a, at, z, w, v(0.0));
            // The light on it, less what water swallows.
            let mut white = [one; 3];
            if a.wet > 0.0 {
                let (wet, shine) = wetted(&a, white, w, n_large, one);
                white = wet;
                shine.store(&mut row.posts[3][k..]);
            }
            let light = lit(&a, white, z, w, one, one);
            for i in 0..3 {
                (albedo[i] * light[i]).store(&mut row.posts[i][k..]);
            }
            if KIND <= SLABS {
                for (light, posts) in light.iter().zip(&mut row.posts[4..]) {
                    light.store(&mut posts[k..]);
                }
                n_mid.store(&mut row.posts[7][k..]);
            }
            k += L::COUNT;
        }
    }
    let mut x = x0;
    while x < x1 {
        let z = one / L::load(&run.iz[x..]);
        let at = v(x as f32) + L::ramp();
        let w = [world[0].at(at, z), world[1].at(at, z)];
        // What is too fine for posts, as a share of the brightness.
        let n_fine = if a.fine > 0.0 { grain(w[0], w[1], 56.0, a.fine) } else { v(0.0) };
        let mut detail = n_fine * v(GRAIN[KIND as usize]);
        if KIND == SLABS && a.joint_fade > 0.02 {
            detail = detail + slabs(&a, at, z);
        }
        // All lanes of a post's pixels go one way, however many there are.
        let k = (x - x0) / POST;
        let from = x0 + k * POST;
        let painted = KIND <= SLABS && touched(g.painted, g.paint, from, 0);
        let shaded = touched(g.shaded, g.shade, from, u16::MAX);
        if posted && !shaded {
            let part = v((x - from) as f32) + L::ramp();
            let mut colour = [one; 3];
            for (colour, posts) in colour.iter_mut().zip(&row.posts) {
                *colour = between(posts, k, part) * (one + detail);
            }
            if painted {
                let n_mid = between(&row.posts[7], k, part);
                let (paint, cover) = paint_of(&a, &g.paint[x..], n_fine, n_mid);
                for i in 0..3 {
                    let light = between(&row.posts[4 + i], k, part);
                    colour[i] = colour[i].mix(paint[i] * light, cover);
                }
            }
            colour[0].store(&mut row.r[x..]);
            colour[1].store(&mut row.g[x..]);
            colour[2].store(&mut row.b[x..]);
            if a.wet > 0.0 {
                between(&row.posts[3], k, part).store_bytes(&mut row.mirror[x..]);
            }
            x += L::COUNT;
            continue;
        }
        let (mut albedo, n_mid, n_large) = bare::<L, KIND>(&a, at, z, w, detail);
        if painted {
            let (paint, cover) = paint_of(&a, &g.paint[x..], n_fine, n_mid);
            for i in 0..3 {
                albedo[i] = albedo[i].mix(paint[i], cover);
            }
        }
        let (mut sun, mut sky) = (one, one);
        if shaded {
            let (low, high) = L::load_bytes(&g.shade[x..]);
            (sun, sky) = (low * v(1.0 / 255.0), high * v(1.0 / 255.0));
        }
        if a.wet > 0.0 {
            let (wet, shine) = wetted(&a, albedo, w, n_large, sky);
            albedo = wet;
            shine.store_bytes(&mut row.mirror[x..]);
        }
        let [red, green, blue] = lit(&a, albedo, z, w, sun, sky);
        red.store(&mut row.r[x..]);
        green.store(&mut row.g[x..]);
        blue.store(&mut row.b[x..]);
        x += L::COUNT;
    }
}

/// Noise about 0 at coordinates times `scale`.
#[inline(always)]
fn noise<L: Lane>(tile: &Tile, w: [L; 2], scale: f32, share: f32) -> L {
    let (x, y) = (w[0] * L::splat(scale), w[1] * L::splat(scale));
    tile.sample(x, y).fma(L::splat(share), L::splat(-0.5 * share))
}

/// `part` pixels beyond post `k`.
#[inline(always)]
fn between<L: Lane>(posts: &[f32], k: usize, part: L) -> L {
    let (a, b) = (posts[k], posts[k + 1]);
    L::splat((b - a) * (1.0 / POST as f32)).fma(part, L::splat(a))
}

/// Whether a post's pixels, from `x` on, hold other words than `plain`; only those in `range` may.
#[inline(always)]
fn touched(range: [u32; 2], words: &[u16], x: usize, plain: u16) -> bool {
    (x + POST) as u32 > range[0] && (x as u32) < range[1] && words[x..x + POST] != [plain; POST]
}
