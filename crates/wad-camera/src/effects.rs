//! Effects on the shaded picture: mirroring wet ground, smooth edges, glowing lamps, rain in the air and
//! on the glass.

use super::gather::Seen;
use super::lanes::lanes;
use super::model::{Channel, Library};
use super::raster::{PAD, Visibility};
use super::simd::{hash, mix_packed, multiversion, unit};
use super::surface::Surface;
use super::view::View;
use std::sync::OnceLock;

multiversion! {
    /// Wet ground shows what stands behind it, upside down: each column is mirrored at the foot of what
    /// stands on the ground. Row `y` of pixels whose rows are `pitch` apart; `foot` holds that place
    /// by column, and is kept from row to row, from the horizon's on.
    pub fn mirror(pixels: &mut [u32], share: &[u8], y: usize, pitch: usize, foot: &mut [i32]) {
        const AT_ONCE: usize = 8;
        let width = foot.len();
        let (above, rest) = pixels.split_at_mut(y * pitch);
        let wobble = (hash(y as u32 >> 1) & 3) as i32;
        let blocks = rest[..width].chunks_mut(AT_ONCE).zip(share[..width].chunks(AT_ONCE)).zip(foot.chunks_mut(AT_ONCE));
        for (block, ((pixels, share), foot)) in blocks.enumerate() {
            if share.iter().all(|&s| s == 0) {
                foot.fill(y as i32);
                continue;
            }
            let (mut first, mut second) = ([0; AT_ONCE], [0; AT_ONCE]);
            for (((first, second), foot), &s) in first.iter_mut().zip(&mut second).zip(foot.iter_mut()).zip(share) {
                *foot = if s == 0 { y as i32 } else { *foot };
                let depth = y as i32 - *foot;
                // Rough water smears upward.
                *first = (*foot - depth - wobble).max(0) * pitch as i32;
                *second = (*foot - depth - depth / 4 - 3).max(0) * pitch as i32;
            }
            let (mut a, mut b) = ([0; AT_ONCE], [0; AT_ONCE]);
            for i in 0..pixels.len() {
                let x = (block * AT_ONCE + i) as i32;
                a[i] = above.get((first[i] + x) as usize).copied().unwrap_or(pixels[i]);
                b[i] = above.get((second[i] + x) as usize).copied().unwrap_or(pixels[i]);
            }
            for (((pixel, &s), a), b) in pixels.iter_mut().zip(share).zip(a).zip(b) {
                *pixel = mix_packed(*pixel, mix_packed(a, b, 112), u32::from(s));
            }
        }
    }
}

/// A row of the picture and of the visibility buffer; padded.
pub struct Seam<'a> {
    pub pixels: &'a mut [u32],
    pub ids: &'a [u32],
    pub iz: &'a [f32],
}

/// Places in a row, in the order found.
#[derive(Default)]
pub struct Places {
    at: Vec<u32>,
    count: usize,
}

impl Places {
    /// Empty, with room for a row's outlines.
    fn clear(&mut self, width: usize) {
        self.at.resize(width + 2 * PAD, 0);
        self.count = 0;
    }
    /// The outlines found.
    pub fn found(&self) -> &[u32] {
        &self.at[..self.count]
    }
}

/// Smooths the outlines in row `y` and between it and the row below: the share of a pixel that the
/// nearer surface covers follows from its edge. `borders` is scratch.
pub fn smooth_edges(
    own: Seam<'_>,
    below: Seam<'_>,
    (y, width): (usize, usize),
    outline: &Outline<'_>,
    borders: &mut [Places; 2],
) {
    let [beside, beneath] = borders;
    find_borders([own.ids, below.ids], [&*own.pixels, &*below.pixels], width, beside, beneath);
    let middle = y as f32 + 0.5;
    for x in beside.found().iter().map(|&x| x as usize) {
        let (a, b) = ((own.ids[x], own.iz[x]), (own.ids[x + 1], own.iz[x + 1]));
        if let Some(cut) = outline.cut(a, b, 0, (x as f32 + 0.5, middle))
            && let [first, second] = &mut own.pixels[x..x + 2]
        {
            blend(first, second, cut - (x as f32 + 1.0));
        }
    }
    for x in beneath.found().iter().map(|&x| x as usize) {
        let (a, b) = ((own.ids[x], own.iz[x]), (below.ids[x], below.iz[x]));
        if let Some(cut) = outline.cut(a, b, 1, (x as f32 + 0.5, middle)) {
            blend(&mut own.pixels[x], &mut below.pixels[x], cut - (y as f32 + 1.0));
        }
    }
}

lanes! {
    /// Where the runs of equal ids in a row end, the last one at `width`. Padded.
    pub fn find_runs<L>(ids: &[u32], width: usize, ends: &mut Places) {
        ends.clear(width);
        let mut count = 0;
        let mut x = 0;
        while x + 1 < width {
            let within = u32::MAX >> (32 - (width - 1 - x).min(8));
            count = L::places(L::differ(&ids[x..], &ids[x + 1..]) & within, x + 1, &mut ends.at, count);
            x += L::COUNT;
        }
        ends.at[count] = width as u32;
        ends.count = count + 1;
    }
}

lanes! {
    /// The pixels of a row that show another face than their right neighbours and than those of the row
    /// below, in another colour. Padded.
    fn find_borders<L>(ids: [&[u32]; 2], colours: [&[u32]; 2], width: usize, beside: &mut Places, beneath: &mut Places) {
        let ([ids, ids_below], [colours, colours_below]) = (ids, colours);
        beside.clear(width);
        beneath.clear(width);
        let (mut across, mut down) = (0, 0);
        let mut x = 0;
        while x < width {
            let (right, under) = (L::differ(&ids[x..], &ids[x + 1..]), L::differ(&ids[x..], &ids_below[x..]));
            if right | under != 0 {
                let own = (&ids[x..], &colours[x..]);
                let within = 0xff_u32 >> 8_usize.saturating_sub(width - x);
                let found = L::borders(own, (&ids[x + 1..], &colours[x + 1..])) & within >> u32::from(width - x <= 8);
                across = L::places(found, x, &mut beside.at, across);
                let found = L::borders(own, (&ids_below[x..], &colours_below[x..])) & within;
                down = L::places(found, x, &mut beneath.at, down);
            }
            x += L::COUNT;
        }
        (beside.count, beneath.count) = (across, down);
    }
}

/// The border between two neighbours really lies `shift` beyond the middle between them.
#[inline(always)]
fn blend(first: &mut u32, second: &mut u32, shift: f32) {
    // Only the loser changes. Which one it is is hard to predict, so both are computed.
    let t = (shift.abs().min(0.5) * 256.0) as u32;
    let (gains_first, gains_second) = if shift > 0.0 { (0, t) } else { (t, 0) };
    let (a, b) = (*first, *second);
    *first = mix_packed(a, b, gains_first);
    *second = mix_packed(b, a, gains_second);
}

/// The looks of what is seen, and by face their index + 1.
pub struct Outline<'a> {
    pub looks: &'a [u32],
    pub surfaces: &'a [Surface],
    /// By look: equal for faces of one material of one thing.
    pub groups: &'a [[u32; 2]],
}

impl Outline<'_> {
    /// The look of a face's id; None where nothing is.
    #[inline(always)]
    fn look(&self, id: u32) -> Option<usize> {
        let look = *self.looks.get((id as usize).checked_sub(1)?)?;
        (look as usize).checked_sub(1)
    }

    /// Where the edge of the nearer of two neighbours crosses the line from one centre to the next,
    /// along `axis`; None where their border is no outline.
    #[inline]
    fn cut(&self, a: (u32, f32), b: (u32, f32), axis: usize, (x, y): (f32, f32)) -> Option<f32> {
        let (near, far) = if a.1 >= b.1 { (a, b) } else { (b, a) };
        let look = self.look(near.0)?;
        if near.1 < far.1 * 1.04
            && let Some(other) = self.look(far.0)
            && self.groups[look] == self.groups[other]
        {
            return None;
        }
        crossing(self.surfaces[look].outline.as_ref()?, axis, (x, y))
    }
}

/// Where an edge of an outline crosses the pixel's length from `x`, `y` along `axis`. All four are computed
/// at once, because a branch is hard to predict.
#[inline(always)]
fn crossing(corners: &[[f32; 4]; 2], axis: usize, (x, y): (f32, f32)) -> Option<f32> {
    let next = |v: &[f32; 4]| [v[1], v[2], v[3], v[0]];
    let (along, across) = (&corners[axis], &corners[1 - axis]);
    let (along_next, across_next) = (next(along), next(across));
    let (from, level) = if axis == 0 { (x, y) } else { (y, x) };
    let (mut cuts, mut fits) = ([0.0_f32; 4], [false; 4]);
    for i in 0..4 {
        let (da, dc) = (along_next[i] - along[i], across_next[i] - across[i]);
        let t = (level - across[i]) / dc;
        let cut = along[i] + da * t;
        // Only edges that run rather across the line; the others are met along the other axis. Half a
        // pixel beyond the ends: the corner of an outline belongs to one of its edges.
        let reach = ((level - across[i]) - 0.5 * dc).abs() <= 0.5 * dc.abs() + 0.5;
        cuts[i] = cut;
        fits[i] = (dc.abs() >= da.abs()) & reach & (cut >= from) & (cut <= from + 1.0);
    }
    let first = u32::from_le_bytes(fits.map(u8::from)).trailing_zeros() / 8;
    cuts.get(first as usize).copied()
}

/// Lamps that shine spread a glow over the picture's bytes.
pub fn glow(
    rgb: &mut [u8],
    seen: &[Seen<'_>],
    library: &Library,
    view: &View,
    visibility: &Visibility,
    gain: f32,
) {
    for thing in seen {
        let model = &library.models[thing.instance.model.0 as usize];
        for (centre, channel) in &model.glows {
            if !thing.lamps.has(*channel) {
                continue;
            }
            let (sin, cos) = thing.instance.pose.heading.sin_cos();
            let [x, y, z]: [f64; 3] = std::array::from_fn(|i| f64::from(centre[i] * thing.instance.scale[i]));
            let offset = nalgebra::Vector3::new(cos * x - sin * y, sin * x + cos * y, z);
            let Some((at, depth)) = view.pixel(&(thing.instance.pose.position + offset)) else { continue };
            if depth > 120.0 || at[0] < 0.0 || at[1] < 0.0 {
                continue;
            }
            let (px, py) = (at[0] as usize, at[1] as usize);
            if px >= view.width || py >= view.height {
                continue;
            }
            // Something nearer hides it: the body that it is mounted on counts too.
            if visibility.iz[py * visibility.stride + px] * (depth - 0.35) > 1.0 {
                continue;
            }
            // Lamps shine away from what they are on; street lamps all round.
            let ahead = match channel {
                Channel::StreetLamp => 1.0,
                _ => {
                    let eye = view.eye - (thing.instance.pose.position + offset);
                    let along = (eye.x * cos + eye.y * sin) / eye.xy().norm().max(0.1);
                    (along as f32 * centre[0].signum()).max(0.0).sqrt()
                }
            };
            if ahead <= 0.0 {
                continue;
            }
            let (colour, size) = match channel {
                Channel::Brake | Channel::Tail | Channel::SignalRed => ([255.0, 40.0, 20.0], 0.30),
                Channel::BlinkLeft | Channel::BlinkRight | Channel::SignalYellow => {
                    ([255.0, 150.0, 20.0], 0.30)
                }
                Channel::SignalGreen => ([40.0, 255.0, 130.0], 0.30),
                Channel::Head => ([255.0, 244.0, 220.0], 0.55),
                _ => ([255.0, 214.0, 150.0], 0.7),
            };
            let radius = (view.focal * size / depth).min(0.12 * view.height as f32).max(1.5);
            add_glow(rgb, view, at, radius, colour, 0.55 * gain * ahead);
        }
    }
}

fn add_glow(rgb: &mut [u8], view: &View, at: [f32; 2], radius: f32, colour: [f32; 3], strength: f32) {
    let range = |v: f32, limit: usize| {
        ((v - radius).max(0.0) as usize, ((v + radius + 1.0).max(0.0) as usize).min(limit))
    };
    let ((x0, x1), (y0, y1)) = (range(at[0], view.width), range(at[1], view.height));
    for y in y0..y1 {
        for x in x0..x1 {
            let (dx, dy) = (x as f32 + 0.5 - at[0], y as f32 + 0.5 - at[1]);
            let t = 1.0 - (dx * dx + dy * dy) / (radius * radius);
            if t > 0.0 {
                let share = t * t * strength;
                let at = 3 * (y * view.width + x);
                for (byte, &add) in rgb[at..at + 3].iter_mut().zip(&colour) {
                    let old = f32::from(*byte);
                    // Screen: never beyond white.
                    *byte = (old + (255.0 - old) * add / 255.0 * share) as u8;
                }
            }
        }
    }
}

const TILE: usize = 256;

/// Falling rain: brightness (0..255) of streaks, repeating.
fn streaks() -> &'static [u8; TILE * TILE] {
    static STREAKS: OnceLock<Box<[u8; TILE * TILE]>> = OnceLock::new();
    STREAKS.get_or_init(|| {
        let mut tile = Box::new([0_u8; TILE * TILE]);
        for n in 0..420_u32 {
            let (x, y) = (unit(n * 3) * TILE as f32, (unit(n * 3 + 1) * TILE as f32) as usize);
            let length = 8.0 + 26.0 * unit(n * 3 + 2);
            let bright = 40.0 + 120.0 * unit(n + 77_000);
            for k in 0..length as usize {
                let t = k as f32 / length;
                let at = ((x + 0.12 * k as f32) as usize % TILE, (y + k) % TILE);
                let value = (bright * 4.0 * t * (1.0 - t)) as u8;
                let texel = &mut tile[at.1 * TILE + at.0];
                *texel = (*texel).max(value);
            }
        }
        tile
    })
}

/// The rain of a moment between the things and the camera.
pub struct Rain {
    offset: [usize; 2],
    strength: u32,
    colour: u32,
    streaks: &'static [u8; TILE * TILE],
}

impl Rain {
    /// Rain of an `amount` (0..1) at a time (s), in a packed colour.
    pub fn new(amount: f32, time: f64, colour: u32) -> Self {
        let moment = hash((time * 1000.0) as i64 as u32) as usize;
        let strength = (60.0 + 120.0 * amount) as u32;
        Self { offset: [moment & 255, moment >> 8 & 255], strength, colour, streaks: streaks() }
    }
}

multiversion! {
    /// The picture's row `y` behind the rain.
    pub fn fall(row: &[u32], y: usize, rain: &Rain, out: &mut [u32]) {
        let line = &rain.streaks[((y + rain.offset[1]) & (TILE - 1)) * TILE..][..TILE];
        let (mut row, mut out, mut from) = (row, out, rain.offset[0] & (TILE - 1));
        while !row.is_empty() {
            let count = row.len().min(TILE - from);
            let (part, rest) = row.split_at(count);
            let (into, further) = out.split_at_mut(count);
            for ((out, pixel), &streak) in into.iter_mut().zip(part).zip(&line[from..]) {
                *out = mix_packed(*pixel, rain.colour, (u32::from(streak) * rain.strength) >> 8);
            }
            (row, out, from) = (rest, further, 0);
        }
    }
}

/// Drops on the camera's glass, in the picture's bytes.
pub fn drops(rgb: &mut [u8], view: &View, amount: f32, time: f64) {
    let width = view.width;
    // Each drop stays for a while, then the wiper takes it.
    let scale = width as f32 / 512.0;
    let count = (4.0 + 26.0 * amount) as u32;
    let mut under = Vec::new();
    for n in 0..count {
        let life = 1.2 + 2.0 * f64::from(unit(n + 5));
        let epoch = (time / life + f64::from(unit(n + 9))) as i64 as u32;
        let seed = hash(n * 7919 + epoch * 104_729);
        let (cx, cy) = (unit(seed) * width as f32, unit(seed ^ 1) * view.height as f32);
        let radius = (1.6 + 5.0 * unit(seed ^ 2) * unit(seed ^ 3)) * scale;
        drop(rgb, view, cx, cy, radius, &mut under);
    }
}

/// A drop shows the scene upside down, with a dark rim.
fn drop(rgb: &mut [u8], view: &View, cx: f32, cy: f32, radius: f32, under: &mut Vec<(usize, u32)>) {
    under.clear();
    let packed = |at: usize| u32::from_le_bytes([rgb[3 * at], rgb[3 * at + 1], rgb[3 * at + 2], 0]);
    let (w, h) = (view.width as f32, view.height as f32);
    let (x0, x1) = ((cx - radius).max(0.0) as usize, (cx + radius + 1.0).min(w) as usize);
    let (y0, y1) = ((cy - 1.25 * radius).max(0.0) as usize, (cy + 1.25 * radius + 1.0).min(h) as usize);
    for y in y0..y1 {
        for x in x0..x1 {
            let (dx, dy) = ((x as f32 + 0.5 - cx) / radius, (y as f32 + 0.5 - cy) / (1.25 * radius));
            let d = dx * dx + dy * dy;
            if d >= 1.0 {
                continue;
            }
            let sx = (cx - dx * radius * 6.0).clamp(0.0, w - 1.0) as usize;
            let sy = (cy - dy * radius * 8.0).clamp(0.0, h - 1.0) as usize;
            let at = y * view.width + x;
            let shown = mix_packed(packed(sy * view.width + sx), 0x0020_2020, (d * d * 90.0) as u32);
            let t = ((1.0 - d) * 3.0).min(1.0);
            under.push((at, mix_packed(packed(at), shown, (t * 170.0) as u32)));
        }
    }
    for &(at, colour) in under.iter() {
        rgb[3 * at..3 * at + 3].copy_from_slice(&colour.to_le_bytes()[..3]);
    }
}

multiversion! {
    /// Packed pixels into bytes, three for each.
    pub fn unpack(pixels: &[u32], out: &mut [u8]) {
        let (fours, rest) = pixels.as_chunks::<4>();
        let (twelves, tail) = out.as_chunks_mut::<12>();
        for (bytes, &[a, b, c, d]) in twelves.iter_mut().zip(fours) {
            let words = [a | b << 24, b >> 8 | c << 16, c >> 16 | d << 8];
            for (bytes, word) in bytes.as_chunks_mut::<4>().0.iter_mut().zip(words) {
                *bytes = word.to_le_bytes();
            }
        }
        for (bytes, pixel) in tail.chunks_exact_mut(3).zip(rest) {
            bytes.copy_from_slice(&pixel.to_le_bytes()[..3]);
        }
    }
}
