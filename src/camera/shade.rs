//! The colour of every visible pixel: runs of one triangle along a row, by the surface's kind.

use super::lanes::{Lane, lanes};
use super::noise::{Tile, Tiles, tiles};
use super::raster::PAD;
use super::shadow_map::{Texels, sample};
use super::surface::{FacadeNumbers, GroundNumbers, Kind, Surface};
use super::weather::Weather;

/// One row of the picture while it is shaded: scene light, and how much it mirrors. Padded: a run's last
/// lanes may write beyond its end, where the next run writes over them.
#[derive(Default)]
pub struct Row {
    pub r: Vec<f32>,
    pub g: Vec<f32>,
    pub b: Vec<f32>,
    /// Share (0..255) of what a wet ground mirrors.
    pub mirror: Vec<u8>,
    /// Slowly varying quantities of a run, at each eighth pixel.
    posts: [Vec<f32>; 5],
}

impl Row {
    /// Makes room for a row of `width` pixels.
    pub fn resize(&mut self, width: usize) {
        for line in [&mut self.r, &mut self.g, &mut self.b] {
            line.resize(width + PAD, 0.0);
        }
        self.mirror.clear();
        self.mirror.resize(width + PAD, 0);
        for posts in &mut self.posts {
            posts.resize(width / POST + 2 * PAD, 0.0);
        }
    }
}

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

/// A run of pixels of one surface.
pub struct Run<'a> {
    pub surface: &'a Surface,
    pub x0: usize,
    pub x1: usize,
    /// Row's centre.
    pub y: f32,
    /// 1 / depth of the row, padded.
    pub iz: &'a [f32],
}

/// Pixels from post to post: what varies slowly is worked out there, and linear between.
const POST: usize = 8;
/// Runs shorter than this are not worth posts.
const POSTED: usize = 24;

const PAINTS: [[f32; 3]; 5] =
    [[0.72, 0.72, 0.70], [0.72, 0.46, 0.07], [0.45, 0.08, 0.06], [0.08, 0.16, 0.42], [0.035, 0.035, 0.037]];

/// 1 near, falling to 0 as a pixel's footprint grows past `size` (m).
fn fade(footprint: f32, size: f32) -> f32 {
    let t = footprint / size;
    1.0 / (1.0 + t * t * t)
}

/// A quantity that is linear over a triangle, in the row of a run: depth (base + step x) + rest.
#[derive(Clone, Copy)]
struct Linear {
    base: f32,
    step: f32,
    rest: f32,
}

impl Linear {
    #[inline(always)]
    fn of(plane: &[f32; 4], y: f32) -> Self {
        Self { base: plane[1] * y + plane[2] + plane[0] * 0.5, step: plane[0], rest: plane[3] }
    }
    #[inline(always)]
    fn at<L: Lane>(&self, x: L, z: L) -> L {
        z.fma(L::splat(self.step).fma(x, L::splat(self.base)), L::splat(self.rest))
    }
    fn one(&self, x: usize, z: f32) -> f32 {
        z * (self.base + self.step * x as f32) + self.rest
    }
}

/// One colour over a run.
pub fn flat(run: &Run<'_>, row: &mut Row) {
    let lines = [&mut row.r, &mut row.g, &mut row.b];
    for (line, value) in lines.into_iter().zip(run.surface.albedo) {
        line[run.x0..run.x1].fill(value);
    }
}

lanes! {
    /// Colours that change linearly over the surface.
    pub fn smooth<L>(run: &Run<'_>, row: &mut Row) {
        let planes = [0, 1, 2].map(|i| Linear::of(&run.surface.planes[i], run.y));
        let mut x = run.x0;
        while x < run.x1 {
            let z = L::splat(1.0) / L::load(&run.iz[x..]);
            let at = L::splat(x as f32) + L::ramp();
            let (zero, most) = (L::splat(0.0), L::splat(4.0));
            planes[0].at(at, z).max(zero).min(most).store(&mut row.r[x..]);
            planes[1].at(at, z).max(zero).min(most).store(&mut row.g[x..]);
            planes[2].at(at, z).max(zero).min(most).store(&mut row.b[x..]);
            x += L::COUNT;
        }
    }
}

lanes! {
    /// Horizontal ground with what lies on it.
    pub fn ground<L>(run: &Run<'_>, ground: &Ground<'_>, row: &mut Row) {
        match run.surface.kind {
            Kind::Asphalt => ground_run::<L, 0>(run, ground, row),
            Kind::Slabs => ground_run::<L, 1>(run, ground, row),
            Kind::Lawn => ground_run::<L, 2>(run, ground, row),
            _ => ground_run::<L, 3>(run, ground, row),
        }
        if ground.weather.wetness > 0.0 {
            // The last lanes' shine ends with the run.
            row.mirror[run.x1..run.x1 + PAD].fill(0);
        }
    }
}

#[inline(always)]
fn ground_run<L: Lane, const KIND: u8>(run: &Run<'_>, g: &Ground<'_>, row: &mut Row) {
    let (s, n) = (run.surface, g.numbers);
    let tiles = tiles();
    let (x0, x1) = (run.x0, run.x1);
    let middle = 1.0 / run.iz[(x0 + x1) / 2].max(1e-6);
    // A pixel's length on the ground, seen at a grazing angle.
    let footprint = middle * middle / (g.focal * g.height);
    let across = middle / g.focal;
    let (fine, mid, large) = (fade(footprint, 0.05), fade(footprint, 0.5), fade(footprint, 8.0));
    let grazing = (g.height / middle).min(1.0);
    let fresnel = 0.03 + 0.75 * (1.0 - grazing).powi(4);
    let wet = if g.lies { g.weather.wetness * n.wetness } else { 0.0 };
    let puddle_from = 1.02 - 0.52 * g.weather.wetness;
    let joint = n.slabs;
    let joint_fade = fade(footprint.min(across * 4.0), 0.25);
    let (s_at, t_at) = (Linear::of(&s.planes[0], run.y), Linear::of(&s.planes[1], run.y));
    let world = [0, 1].map(|i| Linear { base: g.base[i], step: g.step[i], rest: g.eye[i] });
    let v = L::splat;
    let (zero, one, half) = (v(0.0), v(1.0), v(0.5));
    // What is too small to see is not worked out.
    let (with_fine, with_mid) = (fine > 0.05, mid > 0.05);
    let shadowed = g.shadow_reach > 1.0 && middle < g.shadow_reach;
    // Where posts stand less than two texels apart (one of the cracks, which are thin), posts do.
    let apart = if x1 - x0 < POSTED { f32::MAX } else { across * POST as f32 };
    let post =
        [0.5, 8.0, 5.0, 4.0, 2.0].map(|texels| apart * texels <= if texels == 5.0 { 1.0 } else { 2.0 });
    let wanted = [true, with_mid, KIND == 0 && with_mid, shadowed, wet > 0.0];
    let posted: [bool; 5] = std::array::from_fn(|i| post[i] && wanted[i]);
    let posts = &mut row.posts;
    if posted[0] {
        let count = (x1 - x0).div_ceil(POST) + 1;
        // 1 / depth is linear along the run.
        let (first, last) = (run.iz[x0], run.iz[x1 - 1]);
        let slope = (last - first) / (x1 - 1 - x0) as f32;
        let mut k = 0;
        while k < count {
            let step = (v(k as f32) + L::ramp()) * v(POST as f32);
            let at = v(x0 as f32) + step;
            let z = one / (v(first) + v(slope) * step).max(v(1e-4));
            let (wx, wy) = (world[0].at(at, z), world[1].at(at, z));
            noise(&tiles.clouds, wx, wy, 0.5, large).store(&mut posts[0][k..]);
            if posted[1] {
                noise(&tiles.clouds, wx, wy, 8.0, mid).store(&mut posts[1][k..]);
            }
            if posted[2] {
                tiles.cracks.sample(wx * v(5.0), wy * v(5.0)).store(&mut posts[2][k..]);
            }
            if posted[3] {
                sample(g.shadows, wx, wy).store(&mut posts[3][k..]);
            }
            if posted[4] {
                pool(tiles, wx, wy).store(&mut posts[4][k..]);
            }
            k += L::COUNT;
        }
    }
    let mut x = x0;
    while x < x1 {
        let at = v(x as f32) + L::ramp();
        let (k, part) = ((x - x0) / POST, v(((x - x0) % POST) as f32) + L::ramp());
        let z = one / L::load(&run.iz[x..]);
        let (wx, wy) = (world[0].at(at, z), world[1].at(at, z));
        // Three sizes of noise about 0.
        let n_fine = if with_fine { noise(&tiles.grain, wx, wy, 56.0, fine) } else { zero };
        let n_mid = if posted[1] {
            between(&posts[1], k, part)
        } else if with_mid {
            noise(&tiles.clouds, wx, wy, 8.0, mid)
        } else {
            zero
        };
        let n_large =
            if posted[0] { between(&posts[0], k, part) } else { noise(&tiles.clouds, wx, wy, 0.5, large) };
        let mut albedo = [v(s.albedo[0]), v(s.albedo[1]), v(s.albedo[2])];
        if KIND == 0 {
            let mut m = n_fine.fma(v(0.55), n_mid.fma(v(0.22), n_large.fma(v(0.34), one)));
            if with_mid {
                let cracks = if posted[2] {
                    between(&posts[2], k, part)
                } else {
                    tiles.cracks.sample(wx * v(5.0), wy * v(5.0))
                };
                m = m - cracks * v(mid * n.wear * 0.35);
            }
            if n.tracks {
                let t = t_at.at(at, z);
                let d = (t.abs() - v(0.82)) * v(3.2);
                let d = d * d;
                let (wheels, oil) = (one + d * d, one + t * t * v(12.0));
                m = m - (v(0.10) * oil + v(0.05) * wheels) / (wheels * oil);
            }
            albedo = [albedo[0] * m, albedo[1] * m, albedo[2] * m];
        } else if KIND == 1 {
            let mut m = one + n_fine * v(0.22) + n_mid * v(0.16) + n_large * v(0.22);
            if joint_fade > 0.02 {
                let (a, b) = (s_at.at(at, z) * v(1.0 / joint[0]), t_at.at(at, z) * v(1.0 / joint[1]));
                let (ia, ib) = (a.floor(), b.floor());
                let da = (half - (a - ia - half).abs()) * v(joint[0]);
                let db = (half - (b - ib - half).abs()) * v(joint[1]);
                let line = (one - da.min(db) * v(45.0)).max(zero) * v(joint_fade * 0.35);
                m = m + (L::random(ia, ib, 5) - half) * v(0.16 * joint_fade) - line;
            }
            albedo = [albedo[0] * m, albedo[1] * m, albedo[2] * m];
        } else if KIND == 2 {
            let m = one + n_fine * v(0.9) + n_mid * v(0.6) + n_large * v(0.35);
            let dry = (v(0.30) + n_large * v(1.1) + n_mid * v(0.5)).unit();
            let [r, gr, b] = albedo;
            albedo = [r * m * (v(0.8) + v(0.7) * dry), gr * m, b * m * (v(1.05) - v(0.4) * dry)];
        } else {
            let m = one + n_fine * v(0.35) + n_mid * v(0.25) + n_large * v(0.3);
            albedo = [albedo[0] * m, albedo[1] * m, albedo[2] * m];
        }
        if KIND <= 1 && touches(g.painted, x) {
            let (cover, colour) = L::load_bytes(&g.paint[x..]);
            // Worn paint lets the asphalt through.
            let worn = one - v(0.30 * n.wear) * ((n_mid + half * n_fine + v(0.1)) * v(4.0)).unit();
            let cover = cover * v(1.0 / 255.0) * worn;
            let grain = one + n_fine * v(0.15);
            for i in 0..3 {
                let mut paint = v(PAINTS[0][i]);
                for (number, other) in PAINTS.iter().enumerate().skip(1) {
                    paint = L::select(colour.less(v(number as f32 - 0.5)), paint, v(other[i]));
                }
                albedo[i] = albedo[i].mix(paint * grain, cover);
            }
        }
        let (mut sun, mut sky) = (one, one);
        if touches(g.shaded, x) {
            let (low, high) = L::load_bytes(&g.shade[x..]);
            (sun, sky) = (low * v(1.0 / 255.0), high * v(1.0 / 255.0));
        }
        let open = sky;
        if shadowed {
            let still = (one - z * v(1.0 / g.shadow_reach)).max(zero).min(v(0.12)) * v(1.0 / 0.12);
            let lit = if posted[3] { between(&posts[3], k, part) } else { sample(g.shadows, wx, wy) };
            let cast = one - (one - lit) * still * v(g.weather.shadows);
            sun = sun * cast;
            // In the shade of houses part of the sky is hidden too.
            sky = sky * (v(0.80) + v(0.20) * cast);
        }
        if wet > 0.0 {
            let pool = if posted[4] { between(&posts[4], k, part) } else { pool(tiles, wx, wy) };
            let pool = ((pool + n_large * half + v(0.2 - puddle_from)) * v(9.0)).unit();
            let dark = one - v(wet) * (v(0.42) + v(0.22) * pool);
            let shine = v(wet * fresnel) * (v(0.42) + v(0.55) * pool) * open;
            (shine.unit() * v(255.0)).store_bytes(&mut row.mirror[x..]);
            albedo = [albedo[0] * dark, albedo[1] * dark, albedo[2] * dark];
        }
        (albedo[0] * v(s.ambient[0]).fma(sky, v(s.sun[0]) * sun)).store(&mut row.r[x..]);
        (albedo[1] * v(s.ambient[1]).fma(sky, v(s.sun[1]) * sun)).store(&mut row.g[x..]);
        (albedo[2] * v(s.ambient[2]).fma(sky, v(s.sun[2]) * sun)).store(&mut row.b[x..]);
        x += L::COUNT;
    }
}

// Closures would not be compiled for the lanes' instructions: functions that are always inlined instead.

/// Noise about 0 at coordinates times `scale`.
#[inline(always)]
fn noise<L: Lane>(tile: &Tile, x: L, y: L, scale: f32, share: f32) -> L {
    tile.sample(x * L::splat(scale), y * L::splat(scale)).fma(L::splat(share), L::splat(-0.5 * share))
}

/// Where puddles form.
#[inline(always)]
fn pool<L: Lane>(tiles: &Tiles, x: L, y: L) -> L {
    tiles.clouds.sample(x * L::splat(2.0) + L::splat(9.0), y * L::splat(2.0)) * L::splat(0.6)
}

/// `part` pixels beyond post `k`.
#[inline(always)]
fn between<L: Lane>(posts: &[f32], k: usize, part: L) -> L {
    let (a, b) = (posts[k], posts[k + 1]);
    L::splat((b - a) * (1.0 / POST as f32)).fma(part, L::splat(a))
}

/// Whether some pixels from `x` on lie within a range.
#[inline(always)]
fn touches(range: [u32; 2], x: usize) -> bool {
    (x + PAD) as u32 > range[0] && (x as u32) < range[1]
}

fn flag(on: bool) -> f32 {
    f32::from(u8::from(on))
}

/// What the shading of walls and leaves needs.
pub struct Wall<'a> {
    pub focal: f32,
    pub weather: &'a Weather,
    pub facade: &'a FacadeNumbers,
}

lanes! {
    /// Leaves, bricks, plates: textured by s and t.
    pub fn pattern<L>(run: &Run<'_>, wall: &Wall<'_>, row: &mut Row) {
        let s = run.surface;
        let tiles = tiles();
        let across = 1.0 / run.iz[(run.x0 + run.x1) / 2].max(1e-6) / wall.focal;
        let (fine, mid) = (fade(across, 0.035), fade(across, 0.22));
        let (s_at, t_at) = (Linear::of(&s.planes[0], run.y), Linear::of(&s.planes[1], run.y));
        let colour: [f32; 3] = std::array::from_fn(|i| s.albedo[i] * (s.ambient[i] + s.sun[i]));
        let v = L::splat;
        let (zero, one, half) = (v(0.0), v(1.0), v(0.5));
        let mut x = run.x0;
        while x < run.x1 {
            let at = v(x as f32) + L::ramp();
            let z = one / L::load(&run.iz[x..]);
            let (a, b) = (s_at.at(at, z), t_at.at(at, z));
            let (m, warm) = match s.kind {
                Kind::Leaves => {
                    let (n_fine, n_mid) = (noise(&tiles.grain, a, b, 22.0, fine), noise(&tiles.clouds, a, b, 14.0, mid));
                    ((v(0.92) + n_mid * v(1.7) + n_fine).max(v(0.18)), n_mid * half)
                }
                Kind::Plate => {
                    let mark = v(0.42).less(tiles.grain.sample(a * v(9.0), v(40.5)));
                    let within = L::both(
                        (b - half).abs().less(v(0.3)),
                        (a - half).abs().less(v(0.44)),
                    );
                    (L::select(L::both(mark, within), v(0.35), one), zero)
                }
                _ => {
                    let rows = b * v(12.0);
                    let course = rows.floor();
                    let shift = half * (course - v(2.0) * (course * half).floor());
                    let bricks = a * v(4.0) + shift;
                    let joint = L::select((rows - course).less(v(0.14)), one, zero)
                        .max(L::select((bricks - bricks.floor()).less(v(0.06)), one, zero));
                    let (n_fine, n_mid) = (noise(&tiles.grain, a, b, 22.0, fine), noise(&tiles.clouds, a, b, 14.0, mid));
                    (one + n_fine * v(0.35) + n_mid * v(0.25) + joint * v(0.35 * fine), zero)
                }
            };
            (v(colour[0]) * m * (one + warm)).store(&mut row.r[x..]);
            (v(colour[1]) * m).store(&mut row.g[x..]);
            (v(colour[2]) * m * (one - warm)).store(&mut row.b[x..]);
            x += L::COUNT;
        }
    }
}

/// Share of a pixel `1 / scale` wide at distance `d` from the middle that lies within a band.
#[inline(always)]
fn band<L: Lane>(d: L, width: L, scale: f32) -> L {
    (L::splat(0.5) * width - d.abs()).fma(L::splat(scale), L::splat(0.5)).unit()
}

lanes! {
    /// A wall with windows.
    pub fn facade<L>(run: &Run<'_>, wall: &Wall<'_>, row: &mut Row) {
        // The wall's foot has doors, shops and a plinth.
        let t_at = Linear::of(&run.surface.planes[1], run.y);
        let high = |x: usize| t_at.one(x, 1.0 / run.iz[x].max(1e-6));
        if high(run.x0).min(high(run.x1 - 1)) < 1.02 * wall.facade.storey {
            facade_run::<L, true>(run, wall, tiles(), row);
        } else {
            facade_run::<L, false>(run, wall, tiles(), row);
        }
    }
}

#[inline(always)]
fn facade_run<L: Lane, const FOOT: bool>(run: &Run<'_>, wall: &Wall<'_>, tiles: &Tiles, row: &mut Row) {
    let (s, f, w) = (run.surface, wall.facade, wall.weather);
    let (x0, x1) = (run.x0, run.x1);
    let (s_at, t_at) = (Linear::of(&s.planes[0], run.y), Linear::of(&s.planes[1], run.y));
    // How much of the wall a pixel spans: along it more than its width where it runs away.
    let middle = (x0 + x1) / 2;
    let beside = (middle + 1).min(x1 - 1);
    let depth = |x: usize| 1.0 / run.iz[x].max(1e-6);
    let along = (s_at.one(beside, depth(beside)) - s_at.one(middle, depth(middle))).abs();
    let size_v = depth(middle) / wall.focal;
    let size_u = along.max(size_v).min(f.bay * 4.0);
    let blur = ((size_u / f.bay - 0.35) * 3.0).max((size_v / f.storey - 0.35) * 3.0).clamp(0.0, 1.0);
    let (fine, mid) = (fade(size_u, 0.05), fade(size_u, 0.6));
    let (per_u, per_v) = (1.0 / size_u, 1.0 / size_v);
    let has_windows = f.window[0] > 0.0 && f.window[1] > 0.0;
    let mean = if has_windows { f.window[0] * f.window[1] / (f.bay * f.storey) } else { 0.0 };
    let lit: [f32; 3] = std::array::from_fn(|i| s.ambient[i] + s.sun[i]);
    let glass: [f32; 3] = std::array::from_fn(|i| 0.018 + 0.126 * w.horizon[i] + 0.067 * w.zenith[i]);
    let lamp_share = if w.lamps { f.lit_share } else { 0.0 };
    let lamp = [1.05, 0.72, 0.36].map(|c| c * w.lamp_gain);
    let v = L::splat;
    let (zero, one, half) = (v(0.0), v(1.0), v(0.5));
    let (is_shop, is_blank) = (v(flag(f.shops)), v(flag(f.blank)));
    let (has_doors, windowed) = (v(flag(f.door_every > 0.0)), v(flag(has_windows)));
    let every = f.door_every.max(1.0);
    let mut x = x0;
    while x < x1 {
        let at = v(x as f32) + L::ramp();
        let z = one / L::load(&run.iz[x..]);
        let (a, b) = (s_at.at(at, z), t_at.at(at, z));
        let (bay, storey) = ((a * v(1.0 / f.bay)).floor(), (b * v(1.0 / f.storey)).floor());
        let (du, high) = (a - (bay + half) * v(f.bay), b - storey * v(f.storey));
        // 1 on the ground floor, and where a door or a shop is.
        let (mut ground, mut door, mut shop) = (zero, zero, zero);
        // The opening: a window, a shop window or a door.
        let (mut width, mut low, mut top) = (v(f.window[0]), v(f.sill), v(f.sill + f.window[1]));
        let mut on = windowed;
        if FOOT {
            ground = L::select(storey.less(half), one, zero);
            let door_bay = bay - v(every) * (bay * v(1.0 / every) + v(1e-3)).floor();
            door = ground * L::select(door_bay.less(half), has_doors, zero);
            shop = ground * is_shop;
            width = width.mix(v(f.bay - 0.5), shop).mix(v(1.15), door);
            low = low.mix(v(0.45), shop).mix(zero, door);
            top = top.mix(v(f.storey - 0.9), shop).mix(v(2.2), door);
            on = windowed.max(shop).max(door) * (one - ground * is_blank);
        }
        let dv = high - half * (low + top);
        let tall = top - low;
        let opening = band(du, width, per_u) * band(dv, tall, per_v) * on;
        let rim = v(0.16);
        let mut post = band(du, v(0.07), per_u);
        if FOOT {
            post = post * (one - shop.max(door));
        }
        let pane = band(du, width - rim, per_u) * band(dv, tall - rim, per_v) * on * (one - post);
        let spread = if FOOT { v(blur) * (one - ground) } else { v(blur) };
        let opening = opening.mix(v(mean), spread);
        let pane = pane.mix(v(mean * 0.8), spread);
        let h = L::random(bay, storey, f.seed);
        let h2 = h * v(61.0) - (h * v(61.0)).floor();
        // Wall with streaks, courses and floor lines.
        let mut m = one;
        if mid > 0.1 {
            m = (tiles.clouds.sample(a * v(4.0), b * v(1.5)) - half).fma(v(0.22 * mid), m);
        }
        if fine > 0.1 {
            m = (tiles.grain.sample(a * v(30.0), b * v(30.0)) - half).fma(v(0.16 * fine), m);
            if f.bricks {
                let course = b * v(13.0);
                m = m + L::select((course - course.floor()).less(v(0.18)), v(0.18 * fine), zero);
            }
        }
        let floor_line = band(high - v(0.06), v(0.12), per_v) * v(0.22);
        if FOOT {
            m = m - floor_line * (one - ground) - band(b - v(0.15), v(0.5), per_v) * v(0.25);
        } else {
            m = m - floor_line;
        }
        // Under a sill it is darker.
        let under = band(dv + half * tall + v(0.12), v(0.24), per_v) * band(du, width + v(0.1), per_u) * on;
        m = m * (one - v(0.18) * under * (one - spread));
        let fascia = if FOOT { band(high - v(f.storey - 0.48), v(0.62), per_v) * shop } else { zero };
        let curtain = L::select(h2.less(v(0.35)), v(0.30 * lit[1]), zero);
        let mut inside = L::select(h.less(v(lamp_share)), h2.fma(v(0.65), v(0.35)), zero);
        if FOOT {
            inside = inside * (one - door);
        }
        let reflect = v(0.55) + v(0.75) * h + v(0.25 / f.storey) * high;
        let behind_share = if FOOT { pane * (one - v(0.75) * door) } else { pane };
        let mut colour = [zero; 3];
        for i in 0..3 {
            let trim = v(f.trim[i] * lit[i]);
            let mut frame = v(s.albedo[i] * lit[i]) * m;
            if FOOT {
                frame = frame.mix(trim, fascia);
            }
            let frame = frame.mix(trim, opening);
            colour[i] = frame.mix(v(glass[i]) * reflect + curtain + v(lamp[i]) * inside, behind_share);
        }
        colour[0].store(&mut row.r[x..]);
        colour[1].store(&mut row.g[x..]);
        colour[2].store(&mut row.b[x..]);
        x += L::COUNT;
    }
}

/// Scene light to display value 0..1: a soft shoulder, about a square root below it.
#[inline(always)]
fn tone<L: Lane>(x: L) -> L {
    let s = x.max(L::splat(0.0)).min(L::splat(1.6)).root();
    s * s.fma(s.fma(L::splat(-0.2693), L::splat(0.0565)), L::splat(1.15))
}

lanes! {
    /// Haze and the display's curve over some pixels of a row; where nothing is, `out` keeps its sky.
    /// All are padded.
    pub fn finish<L>(row: &Row, iz: &[f32], haze: &[Vec<f32>; 3], fog: f32, span: (usize, usize), out: &mut [u32]) {
        let v = L::splat;
        let (f1, f2, f3) = (v(fog), v(0.5 * fog * fog), v(fog * fog * fog * 0.166_667));
        let mut x = span.0;
        while x < span.1 {
            let iz = L::load(&iz[x..]);
            // What comes through: 1 / e^t by a few terms of its series, t = fog x depth.
            let i = iz.max(v(1e-9));
            let cube = i * i * i;
            let clear = cube / (cube + i.fma(f1.fma(i, f2), f3));
            let r = tone(L::load(&haze[0][x..]).mix(L::load(&row.r[x..]), clear));
            let g = tone(L::load(&haze[1][x..]).mix(L::load(&row.g[x..]), clear));
            let b = tone(L::load(&haze[2][x..]).mix(L::load(&row.b[x..]), clear));
            L::pack(r, g, b, &mut out[x..], iz.less(v(1e-9)));
            x += L::COUNT;
        }
    }
}
