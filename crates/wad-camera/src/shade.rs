//! The colour of every visible pixel: runs of one triangle along a row, by the surface's kind.

use super::lanes::{Lane, lanes};
use super::noise::{Tile, Tiles, tiles};
use super::row::{Linear, Row, Run, fade, grain};
use super::surface::{FacadeNumbers, Kind};
use super::weather::Weather;

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
        let [red, green, blue] = &run.surface.planes;
        let planes = [Linear::of(red, run.y), Linear::of(green, run.y), Linear::of(blue, run.y)];
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

// Closures would not be compiled for the lanes' instructions: functions that are always inlined instead.

/// Noise about 0 at coordinates times `scale`.
#[inline(always)]
fn noise<L: Lane>(tile: &Tile, x: L, y: L, scale: f32, share: f32) -> L {
    tile.sample(x * L::splat(scale), y * L::splat(scale)).fma(L::splat(share), L::splat(-0.5 * share))
}

fn flag(on: bool) -> f32 {
    f32::from(u8::from(on))
}

/// What the shading of walls and leaves needs.
pub struct Wall<'a> {
    /// 1 / focal length (pixels).
    pub per_focal: f32,
    pub weather: &'a Weather,
    pub facade: &'a FacadeNumbers,
}

lanes! {
    /// Leaves, bricks, plates: textured by s and t.
    pub fn pattern<L>(run: &Run<'_>, wall: &Wall<'_>, row: &mut Row) {
        let s = run.surface;
        let tiles = tiles();
        let across = 1.0 / run.iz[(run.x0 + run.x1) / 2].max(1e-6) * wall.per_focal;
        let (fine, mid) = (fade(across, 0.035), fade(across, 0.22));
        let (s_at, t_at) = (Linear::of(&s.planes[0], run.y), Linear::of(&s.planes[1], run.y));
        let mut colour = s.albedo;
        for (i, colour) in colour.iter_mut().enumerate() {
            *colour *= s.ambient[i] + s.sun[i];
        }
        let v = L::splat;
        let (zero, one, half) = (v(0.0), v(1.0), v(0.5));
        let mut x = run.x0;
        while x < run.x1 {
            let at = v(x as f32) + L::ramp();
            let z = one / L::load(&run.iz[x..]);
            let (a, b) = (s_at.at(at, z), t_at.at(at, z));
            let (m, warm) = match s.kind {
                Kind::Leaves => {
                    let (n_fine, n_mid) = (grain(a, b, 22.0, fine), noise(&tiles.clouds, a, b, 14.0, mid));
                    ((v(0.92) + n_mid * v(1.7) + n_fine).max(v(0.18)), n_mid * half)
                }
                Kind::Plate => {
                    let mark = v(0.42).less(L::random(a * v(9.0), zero, 2));
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
                    let (n_fine, n_mid) = (grain(a, b, 22.0, fine), noise(&tiles.clouds, a, b, 14.0, mid));
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
    let size_v = depth(middle) * wall.per_focal;
    let size_u = along.max(size_v).min(f.bay * 4.0);
    let blur = ((size_u * f.per_bay - 0.35) * 3.0).max((size_v * f.per_storey - 0.35) * 3.0).clamp(0.0, 1.0);
    let (fine, mid) = (fade(size_u, 0.05), fade(size_u, 0.6));
    let (per_u, per_v) = (1.0 / size_u, 1.0 / size_v);
    let mean = f.glazed;
    let (mut lit, mut glass, mut lamp) = ([0.0; 3], [0.0; 3], [1.05, 0.72, 0.36]);
    for i in 0..3 {
        lit[i] = s.ambient[i] + s.sun[i];
        glass[i] = 0.018 + 0.126 * w.horizon[i] + 0.067 * w.zenith[i];
        lamp[i] *= w.lamp_gain;
    }
    let lamp_share = if w.lamps { f.lit_share } else { 0.0 };
    let v = L::splat;
    let (zero, one, half) = (v(0.0), v(1.0), v(0.5));
    let (is_shop, is_blank) = (v(flag(f.shops)), v(flag(f.blank)));
    let (has_doors, windowed) = (v(flag(f.door_every > 0.0)), v(flag(mean > 0.0)));
    let every = f.door_every.max(1.0);
    let mut x = x0;
    while x < x1 {
        let at = v(x as f32) + L::ramp();
        let z = one / L::load(&run.iz[x..]);
        let (a, b) = (s_at.at(at, z), t_at.at(at, z));
        let (bay, storey) = ((a * v(f.per_bay)).floor(), (b * v(f.per_storey)).floor());
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
            m = m + grain(a, b, 30.0, 0.16 * fine);
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
        let reflect = v(0.55) + v(0.75) * h + v(0.25 * f.per_storey) * high;
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

/// Scene light to display value 0..255 as [`super::simd::tone`], in the low bits of a float.
#[inline(always)]
fn tone<L: Lane>(x: L) -> L {
    let s = x.max(L::splat(0.0)).min(L::splat(1.6)).root();
    let rest = s.fma(s.fma(L::splat(-0.2693 * 255.0), L::splat(0.0565 * 255.0)), L::splat(1.15 * 255.0));
    s.fma(rest, L::splat(super::simd::MAGIC))
}

lanes! {
    /// Haze and the display's curve over some pixels of a row; where nothing is, `out` keeps its sky.
    /// All are padded.
    pub fn finish<L>(row: &Row, iz: &[f32], haze: &[Vec<f32>; 3], fog: f32, span: (usize, usize), out: &mut [u32]) {
        let v = L::splat;
        let (f1, f2, f3) = (v(fog), v(0.5 * fog * fog), v(fog * fog * fog * 0.166_667));
        // Cut to one length, in whole lanes.
        let (from, end) = (span.0, span.0 + (span.1 - span.0).next_multiple_of(L::COUNT));
        let lines = [iz, &row.r, &row.g, &row.b, &haze[0], &haze[1], &haze[2]];
        let [iz, red, green, blue, h0, h1, h2] = lines.map(|line| line[from..end].chunks_exact(L::COUNT));
        let pixels = out[from..end].chunks_exact_mut(L::COUNT);
        for (((((((iz, red), green), blue), h0), h1), h2), pixels) in
            iz.zip(red).zip(green).zip(blue).zip(h0).zip(h1).zip(h2).zip(pixels)
        {
            let iz = L::load(iz);
            // What comes through: 1 / e^t by a few terms of its series, t = fog x depth.
            let i = iz.max(v(1e-9));
            let cube = i * i * i;
            let clear = cube / (cube + i.fma(f1.fma(i, f2), f3));
            let r = tone(L::load(h0).mix(L::load(red), clear));
            let g = tone(L::load(h1).mix(L::load(green), clear));
            let b = tone(L::load(h2).mix(L::load(blue), clear));
            L::pack(r, g, b, pixels, iz.less(v(1e-9)));
        }
    }
}
