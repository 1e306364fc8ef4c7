//! The colour of every visible pixel: runs of one triangle along a row, by the surface's kind.

use super::noise::tiles;
use super::shadow_map::{Texels, sample};
use super::simd::{floor, multiversion, pack, tone, unit};
use super::surface::{FacadeNumbers, Kind, Surface};
use super::weather::Weather;

/// One row of the picture while it is shaded: scene light, and how much it mirrors.
#[derive(Default)]
pub struct Row {
    pub r: Vec<f32>,
    pub g: Vec<f32>,
    pub b: Vec<f32>,
    /// Share (0..255) of what a wet ground mirrors.
    pub mirror: Vec<u8>,
}

impl Row {
    /// Makes room for a row of `width` pixels.
    pub fn resize(&mut self, width: usize) {
        for line in [&mut self.r, &mut self.g, &mut self.b] {
            line.resize(width, 0.0);
        }
        self.mirror.clear();
        self.mirror.resize(width, 0);
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
    /// How far away (m) the map of shadows ends.
    pub shadow_reach: f32,
    /// Material: joints of slabs (m), wear, wetness.
    pub slabs: [f32; 2],
    pub wear: f32,
    pub tracks: bool,
    pub wetness: f32,
}

/// A run of pixels of one surface.
pub struct Run<'a> {
    pub surface: &'a Surface,
    pub x0: usize,
    pub x1: usize,
    /// Row's centre.
    pub y: f32,
    /// 1 / depth of the row.
    pub iz: &'a [f32],
}

const PAINTS: [[f32; 3]; 5] =
    [[0.72, 0.72, 0.70], [0.72, 0.46, 0.07], [0.45, 0.08, 0.06], [0.08, 0.16, 0.42], [0.035, 0.035, 0.037]];

/// 1 near, falling to 0 as a pixel's footprint grows past `size` (m).
fn fade(footprint: f32, size: f32) -> f32 {
    let t = footprint / size;
    1.0 / (1.0 + t * t * t)
}

multiversion! {
    /// Flat and smooth colours.
    pub fn smooth(run: &Run<'_>, row: &mut Row) {
        let s = run.surface;
        let (x0, x1) = (run.x0, run.x1);
        let lines = [&mut row.r, &mut row.g, &mut row.b];
        if s.kind == Kind::Flat || x1 - x0 == 1 && s.planes[0][3].abs() > 50.0 {
            for (line, value) in lines.into_iter().zip(s.albedo) {
                line[x0..x1].fill(value);
            }
            return;
        }
        for (line, p) in lines.into_iter().zip(&s.planes) {
            let base = p[1] * run.y + p[2] + p[0] * 0.5;
            for (x, (value, iz)) in line[x0..x1].iter_mut().zip(&run.iz[x0..x1]).enumerate() {
                let c = (base + p[0] * (x0 + x) as f32) / iz + p[3];
                *value = c.max(0.0).min(4.0);
            }
        }
    }
}

multiversion! {
    /// Horizontal ground with what lies on it.
    pub fn ground(run: &Run<'_>, ground: &Ground<'_>, row: &mut Row) {
        match run.surface.kind {
            Kind::Asphalt => ground_run::<0>(run, ground, row),
            Kind::Slabs => ground_run::<1>(run, ground, row),
            Kind::Lawn => ground_run::<2>(run, ground, row),
            _ => ground_run::<3>(run, ground, row),
        }
    }
}

#[inline(always)]
fn ground_run<const KIND: u8>(run: &Run<'_>, g: &Ground<'_>, row: &mut Row) {
    let s = run.surface;
    let tiles = tiles();
    let (x0, x1) = (run.x0, run.x1);
    let middle = 1.0 / run.iz[(x0 + x1) / 2].max(1e-6);
    // A pixel's length on the ground, seen at a grazing angle.
    let footprint = middle * middle / (g.focal * g.height.max(0.2));
    let across = middle / g.focal;
    let (fine, mid, large) = (fade(footprint, 0.05), fade(footprint, 0.5), fade(footprint, 8.0));
    let grazing = (g.height / middle).min(1.0);
    let fresnel = 0.03 + 0.75 * (1.0 - grazing).powi(4);
    let wet = g.weather.wetness * g.wetness;
    let puddle_from = 1.02 - 0.52 * g.weather.wetness;
    let reach = 1.0 / g.shadow_reach;
    let shadow_strength = g.weather.shadows;
    let joint = [g.slabs[0].max(0.05), g.slabs[1].max(0.05)];
    let joint_fade = fade(footprint.min(across * 4.0), 0.25);
    let (sx, tx) = (s.planes[0], s.planes[1]);
    let s_base = sx[1] * run.y + sx[2] + sx[0] * 0.5;
    let t_base = tx[1] * run.y + tx[2] + tx[0] * 0.5;
    let len = x1 - x0;
    let iz = &run.iz[x0..x1];
    let (paint, shade) = (&g.paint[x0..x1][..len], &g.shade[x0..x1][..len]);
    let (r, gr, b, mirror) = (
        &mut row.r[x0..x1][..len],
        &mut row.g[x0..x1][..len],
        &mut row.b[x0..x1][..len],
        &mut row.mirror[x0..x1][..len],
    );
    for i in 0..len {
        let xf = (x0 + i) as f32;
        let z = 1.0 / iz[i];
        let wx = g.eye[0] + z * (g.base[0] + g.step[0] * xf);
        let wy = g.eye[1] + z * (g.base[1] + g.step[1] * xf);
        // Three sizes of noise about 0.
        let n_fine = (tiles.grain.at(wx * 56.0, wy * 56.0) - 0.5) * fine;
        let n_mid = (tiles.clouds.at(wx * 8.0, wy * 8.0) - 0.5) * mid;
        let n_large = (tiles.clouds.at(wx * 0.5 + 3.0, wy * 0.5) - 0.5) * large;
        let mut albedo = s.albedo;
        if KIND == 0 {
            let crack = tiles.cracks.at(wx * 5.0, wy * 5.0) * mid * g.wear * 0.35;
            let mut m = 1.0 + n_fine * 0.55 + n_mid * 0.22 + n_large * 0.34 - crack;
            if g.tracks {
                let t = z * (t_base + tx[0] * xf) + tx[3];
                let d = (t.abs() - 0.82) * 3.2;
                m -= 0.10 / (1.0 + d * d * d * d) - 0.05 / (1.0 + t * t * 12.0);
            }
            albedo = [albedo[0] * m, albedo[1] * m, albedo[2] * m];
        } else if KIND == 1 {
            let u = (z * (s_base + sx[0] * xf) + sx[3]) / joint[0];
            let v = (z * (t_base + tx[0] * xf) + tx[3]) / joint[1];
            let (iu, iv) = (floor(u), floor(v));
            let du = (0.5 - (u - iu - 0.5).abs()) * joint[0];
            let dv = (0.5 - (v - iv - 0.5).abs()) * joint[1];
            let near = du.min(dv);
            let line = (1.0 - near * 45.0).max(0.0) * joint_fade * 0.35;
            let slab = (tiles.grain.at(iu * 7.0 + 0.5, iv * 11.0 + 0.5) - 0.5) * 0.16 * joint_fade;
            let m = 1.0 + n_fine * 0.22 + n_mid * 0.16 + n_large * 0.22 + slab - line;
            albedo = [albedo[0] * m, albedo[1] * m, albedo[2] * m];
        } else if KIND == 2 {
            let m = 1.0 + n_fine * 0.9 + n_mid * 0.6 + n_large * 0.35;
            let dry = (0.30 + n_large * 1.1 + n_mid * 0.5).max(0.0).min(1.0);
            albedo = [albedo[0] * m * (0.8 + 0.7 * dry), albedo[1] * m, albedo[2] * m * (1.05 - 0.4 * dry)];
        } else {
            let m = 1.0 + n_fine * 0.35 + n_mid * 0.25 + n_large * 0.3;
            albedo = [albedo[0] * m, albedo[1] * m, albedo[2] * m];
        }
        let word = paint[i];
        if KIND == 0 || KIND == 1 {
            // Worn paint lets the asphalt through.
            let worn = 1.0 - 0.30 * g.wear * ((n_mid + 0.5 * n_fine + 0.1) * 4.0).max(0.0).min(1.0);
            let cover = (word & 0xff) as f32 * (1.0 / 255.0) * worn;
            let paint = PAINTS[((word >> 8) as usize).min(4)];
            let m = 1.0 + n_fine * 0.15;
            albedo = [
                albedo[0] + (paint[0] * m - albedo[0]) * cover,
                albedo[1] + (paint[1] * m - albedo[1]) * cover,
                albedo[2] + (paint[2] * m - albedo[2]) * cover,
            ];
        }
        let marks = shade[i];
        let (sun_left, sky_left) = ((marks & 0xff) as f32 * (1.0 / 255.0), (marks >> 8) as f32 * (1.0 / 255.0));
        let still = (1.0 - z * reach).max(0.0).min(0.12) * (1.0 / 0.12);
        let cast = 1.0 - (1.0 - sample(g.shadows, wx, wy)) * still * shadow_strength;
        let sun = sun_left * cast;
        // In the shade of houses part of the sky is hidden too.
        let sky = sky_left * (0.80 + 0.20 * cast);
        let pool = ((tiles.clouds.at(wx * 2.0 + 9.0, wy * 2.0) * 0.6 + n_large * 0.5 + 0.2 - puddle_from) * 9.0)
            .max(0.0)
            .min(1.0);
        let dark = 1.0 - wet * (0.42 + 0.22 * pool);
        let shine = wet * fresnel * (0.42 + 0.55 * pool) * sky_left;
        mirror[i] = (shine * 255.0) as u8;
        r[i] = albedo[0] * dark * (s.ambient[0] * sky + s.sun[0] * sun);
        gr[i] = albedo[1] * dark * (s.ambient[1] * sky + s.sun[1] * sun);
        b[i] = albedo[2] * dark * (s.ambient[2] * sky + s.sun[2] * sun);
    }
}

/// What the shading of walls and leaves needs.
pub struct Wall<'a> {
    pub focal: f32,
    pub weather: &'a Weather,
    pub facade: &'a FacadeNumbers,
}

multiversion! {
    /// Leaves, bricks, plates: textured by s and t.
    pub fn pattern(run: &Run<'_>, wall: &Wall<'_>, row: &mut Row) {
        let s = run.surface;
        let tiles = tiles();
        let (x0, x1) = (run.x0, run.x1);
        let across = 1.0 / run.iz[(x0 + x1) / 2].max(1e-6) / wall.focal;
        let (fine, mid) = (fade(across, 0.035), fade(across, 0.22));
        let (sx, tx) = (s.planes[0], s.planes[1]);
        let s_base = sx[1] * run.y + sx[2] + sx[0] * 0.5;
        let t_base = tx[1] * run.y + tx[2] + tx[0] * 0.5;
        let lit: [f32; 3] = std::array::from_fn(|i| s.ambient[i] + s.sun[i]);
        let leaves = s.kind == Kind::Leaves;
        let plate = s.kind == Kind::Plate;
        for x in x0..x1 {
            let z = 1.0 / run.iz[x];
            let u = z * (s_base + sx[0] * x as f32) + sx[3];
            let v = z * (t_base + tx[0] * x as f32) + tx[3];
            let n_fine = (tiles.grain.at(u * 22.0, v * 22.0) - 0.5) * fine;
            let n_mid = (tiles.clouds.at(u * 14.0, v * 14.0) - 0.5) * mid;
            let (mut m, mut warm) = (1.0, 0.0);
            if leaves {
                m = (0.92 + n_mid * 1.7 + n_fine * 1.0).max(0.18);
                warm = n_mid * 0.5;
            } else if plate {
                let mark = tiles.grain.at(u * 9.0, 40.5) > 0.42;
                let within = (v > 0.2) & (v < 0.8) & (u > 0.06) & (u < 0.94);
                m = if mark & within { 0.35 } else { 1.0 };
            } else {
                let rows = v * 12.0;
                let shift = 0.5 * (floor(rows) - 2.0 * floor(floor(rows) * 0.5));
                let bricks = u * 4.0 + shift;
                let joint = ((rows - floor(rows)) < 0.14) | ((bricks - floor(bricks)) < 0.06);
                m = 1.0 + n_fine * 0.35 + n_mid * 0.25 + if joint { 0.35 * fine } else { 0.0 };
            }
            row.r[x] = s.albedo[0] * lit[0] * m * (1.0 + warm);
            row.g[x] = s.albedo[1] * lit[1] * m;
            row.b[x] = s.albedo[2] * lit[2] * m * (1.0 - warm);
        }
    }
}

/// Share of a pixel `size` wide at distance `d` from the middle that lies within a band `width` wide.
#[inline(always)]
fn band(d: f32, width: f32, size: f32) -> f32 {
    ((0.5 * width - d.abs()) / size + 0.5).max(0.0).min(1.0)
}

multiversion! {
    /// A wall with windows.
    pub fn facade(run: &Run<'_>, wall: &Wall<'_>, row: &mut Row) {
        let (s, f, w) = (run.surface, wall.facade, wall.weather);
        let tiles = tiles();
        let (x0, x1) = (run.x0, run.x1);
        let (sx, tx) = (s.planes[0], s.planes[1]);
        let middle = (x0 + x1) / 2;
        let z = 1.0 / run.iz[middle].max(1e-6);
        let s_base = sx[1] * run.y + sx[2] + sx[0] * 0.5;
        let t_base = tx[1] * run.y + tx[2] + tx[0] * 0.5;
        // How much of the wall a pixel spans: along it more than its width where it runs away.
        let next = 1.0 / run.iz[(middle + 1).min(x1 - 1)].max(1e-6);
        let u0 = z * (s_base + sx[0] * middle as f32) + sx[3];
        let u1 = next * (s_base + sx[0] * (middle + 1).min(x1 - 1) as f32) + sx[3];
        let size_v = z / wall.focal;
        let size_u = (u1 - u0).abs().max(size_v).min(f.bay * 4.0);
        let blur = ((size_u / f.bay - 0.35) * 3.0).max(((size_v / f.storey - 0.35) * 3.0).max(0.0)).min(1.0);
        let (fine, mid) = (fade(size_u, 0.05), fade(size_u, 0.6));
        let has_windows = f.window[0] > 0.0 && f.window[1] > 0.0;
        let mean = if has_windows { f.window[0] * f.window[1] / (f.bay * f.storey) } else { 0.0 };
        let lit: [f32; 3] = std::array::from_fn(|i| s.ambient[i] + s.sun[i]);
        let sky: [f32; 3] =
            std::array::from_fn(|i| 0.30 * w.horizon[i] + 0.16 * w.zenith[i]);
        let glass_base: [f32; 3] = std::array::from_fn(|i| 0.018 + 0.42 * sky[i]);
        let lamp_share = if w.lamps { f.lit_share } else { 0.0 };
        let lamp = [1.05 * w.lamp_gain, 0.72 * w.lamp_gain, 0.36 * w.lamp_gain];
        for x in x0..x1 {
            let z = 1.0 / run.iz[x];
            let xf = x as f32;
            let u = z * (s_base + sx[0] * xf) + sx[3];
            let v = z * (t_base + tx[0] * xf) + tx[3];
            let (bay, storey) = (floor(u / f.bay), floor(v / f.storey));
            let ground_floor = storey < 0.5;
            let (du, v_in) = (u - (bay + 0.5) * f.bay, v - storey * f.storey);
            // The opening: a window, a shop window or a door.
            let every = f.door_every.max(1.0);
            let door = ground_floor & (f.door_every > 0.0) & (bay - every * floor(bay / every) < 0.5);
            let shop = ground_floor & f.shops;
            let blank = ground_floor & f.blank;
            let width = if shop { f.bay - 0.5 } else if door { 1.15 } else { f.window[0] };
            let (low, high) = if shop {
                (0.45, f.storey - 0.9)
            } else if door {
                (0.0, 2.2)
            } else {
                (f.sill, f.sill + f.window[1])
            };
            let on = if blank | !(has_windows | shop | door) { 0.0 } else { 1.0 };
            let dv = v_in - 0.5 * (low + high);
            let opening = band(du, width, size_u) * band(dv, high - low, size_v) * on;
            let pane = band(du, width - 0.16, size_u) * band(dv, high - low - 0.16, size_v) * on;
            let post = band(du, 0.07, size_u) * (if shop | door { 0.0 } else { 1.0 });
            let pane = pane * (1.0 - post);
            let spread = if ground_floor { 0.0 } else { blur };
            let opening = opening + (mean - opening) * spread;
            let pane = pane + (mean * 0.8 - pane) * spread;
            let seed = f.seed ^ ((bay as i32 as u32) << 8) ^ ((storey as i32 as u32) << 20);
            let (h, h2) = (unit(seed), unit(seed ^ 0x55aa));
            // Wall with streaks, bricks and floor lines.
            let n_mid = (tiles.clouds.at(u * 4.0, v * 1.5) - 0.5) * mid;
            let n_fine = (tiles.grain.at(u * 30.0, v * 30.0) - 0.5) * fine;
            let line = band(v_in - 0.06, 0.12, size_v) * (if ground_floor { 0.0 } else { 0.22 });
            let fascia = if shop { band(v_in - f.storey + 0.48, 0.62, size_v) } else { 0.0 };
            let foot = band(v - 0.15, 0.5, size_v) * 0.25;
            let course = v * 13.0;
            let joint = if f.bricks & ((course - floor(course)) < 0.18) { 0.18 * fine } else { 0.0 };
            let m = 1.0 + n_mid * 0.22 + n_fine * 0.16 + joint - line - foot;
            // Under a sill and an eave it is darker.
            let above = band(dv + 0.5 * (high - low) + 0.12, 0.24, size_v) * band(du, width + 0.1, size_u) * on;
            let m = m * (1.0 - 0.18 * above * (1.0 - spread));
            let curtain = if h2 < 0.35 { 0.30 * lit[1] } else { 0.0 };
            let inside = if (h < lamp_share) & !door { 1.0 } else { 0.0 };
            let glow = 0.35 + 0.65 * h2;
            let reflect = 0.55 + 0.75 * h + 0.25 * (v_in / f.storey);
            let door_pane = if door { 0.25 } else { 1.0 };
            let shade = |wall: f32, trim: f32, lit: f32, glass: f32, lamp: f32| {
                let wall = wall * m * lit;
                let wall = wall + (trim * lit - wall) * fascia;
                let frame = wall + (trim * lit - wall) * opening;
                let behind = glass * reflect + curtain + lamp * glow * inside;
                frame + (behind - frame) * pane * door_pane
            };
            row.r[x] = shade(s.albedo[0], f.trim[0], lit[0], glass_base[0], lamp[0]);
            row.g[x] = shade(s.albedo[1], f.trim[1], lit[1], glass_base[1], lamp[1]);
            row.b[x] = shade(s.albedo[2], f.trim[2], lit[2], glass_base[2], lamp[2]);
        }
    }
}

multiversion! {
    /// Haze and the display's curve over a row; pixels where nothing is keep `out`'s sky.
    pub fn finish(row: &Row, iz: &[f32], haze: &[Vec<f32>; 3], fog: f32, out: &mut [u32]) {
        let n = out.len();
        let (r, g, b, iz) = (&row.r[..n], &row.g[..n], &row.b[..n], &iz[..n]);
        let (hr, hg, hb) = (&haze[0][..n], &haze[1][..n], &haze[2][..n]);
        for x in 0..n {
            let empty = iz[x] == 0.0;
            let t = fog / if empty { 1.0 } else { iz[x] };
            let clear = 1.0 / (1.0 + t * (1.0 + t * (0.5 + t * 0.166_667)));
            let c = pack(
                tone(hr[x] + (r[x] - hr[x]) * clear),
                tone(hg[x] + (g[x] - hg[x]) * clear),
                tone(hb[x] + (b[x] - hb[x]) * clear),
            );
            out[x] = if empty { out[x] } else { c };
        }
    }
}
