//! Makes pictures of the training weathers look like other days: haze, other light, rain, glass.
//!
//! The detector may be trained in three weathers only and is then driven in eleven others. Nothing here
//! comes from the renderer: haze uses a flat ground and the boxes' depths, everything else only pixels.
//! Boxes stay where they are.

use crate::dataset::BoxRecord;
use rand::RngExt;

/// A window of the camera's picture.
#[derive(Clone, Copy, Debug)]
pub struct View<'a> {
    /// Pixels.
    pub left: usize,
    pub top: usize,
    pub width: usize,
    /// Facts about the whole picture.
    pub objects: &'a [BoxRecord],
}

/// Share of the pictures that get each change; a picture without any keeps its weather.
const HAZE: f64 = 0.35;
const SHADE: f64 = 0.35;
const RAIN: f64 = 0.35;
const DROPS: f64 = 0.25;
const BLUR: f64 = 0.15;
const LIGHT: f64 = 0.9;
const WARM: f64 = 0.35;

/// Changes a window's RGB bytes, row by row from its upper left corner.
pub fn weather(rgb: &mut [u8], view: View, rng: &mut impl RngExt) {
    let mut is_to = |share: f64| rng.random::<f64>() < share;
    let [haze_it, shade_it, rain_it, drop_it, blur_it, light_it] =
        [HAZE, SHADE, RAIN, DROPS, BLUR, LIGHT].map(&mut is_to);
    if haze_it {
        haze(rgb, view, rng);
    }
    if rain_it {
        streaks(rgb, view.width, rng);
    }
    if drop_it {
        drops(rgb, view.width, rng);
    }
    if shade_it {
        shade(rgb, view.width, rng);
    }
    if blur_it {
        blur(rgb, view.width);
    }
    if light_it {
        light(rgb, rng);
    }
}

/// Row of the horizon and the focal length (pixels), and the camera's height (m): the default camera's.
const HORIZON: f32 = 256.0;
const FOCAL: f32 = 256.0;
const UP: f32 = 1.4;
/// Distance of everything above the horizon (m).
const FAR: f32 = 90.0;
/// Most light that haze takes per metre: a visual range of 200 m.
const THICKEST: f32 = 0.014;

/// Haze by the depth of a flat ground; objects have the depth of their boxes.
fn haze(rgb: &mut [u8], view: View, rng: &mut impl RngExt) {
    let grey = rng.random_range(60.0_f32..215.0);
    let colour: [u32; 3] = std::array::from_fn(|_| (grey * rng.random_range(0.9_f32..1.1)).min(255.0) as u32);
    let per_metre = THICKEST * rng.random_range(0.1_f32..1.0).powi(2);
    // Of 256.
    let left_at = |depth: f32| (256.0 * (-per_metre * depth).exp()) as u32;
    let mut left = vec![0_u32; view.width];
    for (y, row) in rgb.chunks_exact_mut(3 * view.width).enumerate() {
        let below = (view.top + y) as f32 + 0.5 - HORIZON;
        let depth = if below > 0.0 { (UP * FOCAL / below).min(FAR) } else { FAR };
        left.fill(left_at(depth));
        let at = (view.top + y) as u32;
        for object in view.objects.iter().filter(|o| (o.visible[1]..o.visible[3]).contains(&at)) {
            if object.depth < depth {
                let within = |x: u32| (x as usize).saturating_sub(view.left).min(view.width);
                left[within(object.visible[0])..within(object.visible[2])].fill(left_at(object.depth));
            }
        }
        for (pixel, &left) in row.as_chunks_mut::<3>().0.iter_mut().zip(&left) {
            for (value, colour) in pixel.iter_mut().zip(colour) {
                *value = ((u32::from(*value) * left + colour * (256 - left)) >> 8) as u8;
            }
        }
    }
}

/// Bright strokes, nearly upright.
fn streaks(rgb: &mut [u8], width: usize, rng: &mut impl RngExt) {
    let height = rgb.len() / (3 * width).max(1);
    let per_pixel = rng.random_range(0.0005_f32..0.007);
    let (slant, strength) = (rng.random_range(-0.25_f32..0.25), rng.random_range(0.1_f32..0.5));
    let colour = rng.random_range(120_u32..230);
    for _ in 0..(per_pixel * (width * height) as f32) as usize {
        let (x, y) = (rng.random_range(0.0..width as f32), rng.random_range(0..height));
        let length = rng.random_range(6..34_usize);
        let strength = strength * rng.random_range(0.25..1.0);
        for step in 0..length.min(height - y) {
            let t = step as f32 / length as f32;
            let x = (x + slant * step as f32) as isize;
            let Some(x) = usize::try_from(x).ok().filter(|x| *x < width) else { break };
            let share = (256.0 * strength * 4.0 * t * (1.0 - t)) as u32;
            for value in &mut rgb[3 * ((y + step) * width + x)..][..3] {
                *value = ((u32::from(*value) * (256 - share) + colour * share) >> 8) as u8;
            }
        }
    }
}

/// Drops on the glass: small discs that show what is around them upside down.
fn drops(rgb: &mut [u8], width: usize, rng: &mut impl RngExt) {
    let height = rgb.len() / (3 * width).max(1);
    let dry = rgb.to_vec();
    let side = |at: f32, side: usize| (at.max(0.0) as usize).min(side.saturating_sub(1));
    for _ in 0..rng.random_range(2..22_u32) {
        let (cx, cy) = (rng.random_range(0.0..width as f32), rng.random_range(0.0..height as f32));
        let radius = rng.random_range(1.5_f32..4.0) * rng.random_range(0.8_f32..1.7);
        let wide = rng.random_range(4.0_f32..9.0);
        for y in side(cy - radius, height)..=side(cy + radius, height) {
            for x in side(cx - radius, width)..=side(cx + radius, width) {
                let (dx, dy) = (x as f32 + 0.5 - cx, y as f32 + 0.5 - cy);
                let edge = 1.0 - (dx * dx + dy * dy) / (radius * radius);
                if edge <= 0.0 {
                    continue;
                }
                let from = 3 * (side(cy - wide * dy, height) * width + side(cx - wide * dx, width));
                let share = (180.0 * (3.0 * edge).min(1.0)) as u32;
                for c in 0..3 {
                    let value = &mut rgb[3 * (y * width + x) + c];
                    *value =
                        ((u32::from(*value) * (256 - share) + u32::from(dry[from + c]) * share) >> 8) as u8;
                }
            }
        }
    }
}

/// Brightness that falls along some direction: a low sun, a building's shadow, glare.
fn shade(rgb: &mut [u8], width: usize, rng: &mut impl RngExt) {
    let height = rgb.len() / (3 * width).max(1);
    let (one, other) = (rng.random_range(0.45_f32..1.25), rng.random_range(0.45_f32..1.25));
    let turn = rng.random_range(0.0..std::f32::consts::TAU);
    let (across, down) = (turn.cos() / width as f32, turn.sin() / height.max(1) as f32);
    for (y, row) in rgb.chunks_exact_mut(3 * width).enumerate() {
        for (x, pixel) in row.as_chunks_mut::<3>().0.iter_mut().enumerate() {
            let t = 0.5 + across * (x as f32 - 0.5 * width as f32) + down * (y as f32 - 0.5 * height as f32);
            let factor = (256.0 * (one + (other - one) * t.clamp(0.0, 1.0))) as u32;
            for value in pixel {
                *value = ((u32::from(*value) * factor) >> 8).min(255) as u8;
            }
        }
    }
}

/// Each pixel half itself and half its neighbours across, then the same down.
fn blur(rgb: &mut [u8], width: usize) {
    let mean = |a: u8, b: u8, c: u8| ((u32::from(a) + 2 * u32::from(b) + u32::from(c) + 2) / 4) as u8;
    for row in rgb.chunks_exact_mut(3 * width) {
        let sharp = row.to_vec();
        for at in 3..row.len().saturating_sub(3) {
            row[at] = mean(sharp[at - 3], sharp[at], sharp[at + 3]);
        }
    }
    let (sharp, stride) = (rgb.to_vec(), 3 * width);
    for at in stride..rgb.len().saturating_sub(stride) {
        rgb[at] = mean(sharp[at - stride], sharp[at], sharp[at + stride]);
    }
}

/// The fixed point of contrast changes.
const MIDDLE: f32 = 0.45;
/// The most that noise changes a byte by.
const NOISE: f32 = 12.0;

/// Gamma, gain and tint, contrast, colourfulness, noise; some as warm and dark as an evening. A table per
/// colour, since a picture has many pixels and a byte few values.
fn light(rgb: &mut [u8], rng: &mut impl RngExt) {
    let gamma = rng.random_range(-0.45_f32..0.5).exp();
    let (gain, contrast) = (rng.random_range(0.6_f32..1.25), rng.random_range(0.5_f32..1.2));
    // How much of an evening's red it has.
    let warm = if rng.random::<f64>() < WARM { rng.random::<f32>() } else { 0.0 };
    let tint = [1.0 + 0.15 * warm, 1.0 - 0.12 * warm, 1.0 - 0.4 * warm];
    let tables: [[f32; 256]; 3] = std::array::from_fn(|c| {
        let gain = gain * tint[c] * rng.random_range(0.88..1.12);
        std::array::from_fn(|v| {
            let value = (v as f32 / 255.0 - MIDDLE) * contrast + MIDDLE;
            255.0 * gain * value.clamp(0.0, 1.0).powf(gamma)
        })
    });
    let colours = rng.random_range(0.4_f32..1.15);
    let noise = rng.random_range(0.0_f32..NOISE) / 128.0;
    for pixel in rgb.as_chunks_mut::<3>().0 {
        let dice = rng.random::<u32>().to_le_bytes();
        let lit: [f32; 3] = std::array::from_fn(|c| tables[c][usize::from(pixel[c])]);
        let grey = 0.3 * lit[0] + 0.59 * lit[1] + 0.11 * lit[2];
        for c in 0..3 {
            let off = noise * (f32::from(dice[c]) - 127.5);
            pixel[c] = (grey + colours * (lit[c] - grey) + off + 0.5) as u8;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sumo_network::seeds;
    use wad_camera::model::ObjectClass;

    const VIEW: View = View { left: 64, top: 200, width: 96, objects: &[] };

    const HEIGHT: usize = 128;

    fn grey() -> Vec<u8> {
        vec![40; VIEW.width * HEIGHT * 3]
    }

    #[test]
    fn haze_hides_the_far_road_and_hardly_a_near_object() {
        let near = BoxRecord {
            class: ObjectClass::Car,
            id: 1,
            visible: [100, 210, 130, 290],
            full: [100.0, 210.0, 130.0, 290.0],
            pixels: 1,
            depth: 4.0,
        };
        let mut rgb = grey();
        let view = View { objects: &[near], ..VIEW };
        haze(&mut rgb, view, &mut seeds::rng(4, "haze"));
        let at = |x: usize, y: usize| rgb[3 * ((y - view.top) * view.width + x - view.left)].abs_diff(40);
        // Rows 326 and 262 look at 5 m and 55 m of road; columns 100 to 130 at the object.
        assert!(at(70, 262) > 2 * at(70, 326).max(1), "{} {}", at(70, 262), at(70, 326));
        assert!(at(110, 262) < at(70, 262) / 2 && at(99, 262) == at(130, 262));
    }

    #[test]
    fn rain_brightens_some_pixels_and_drops_need_something_to_show() {
        let mut rgb = grey();
        streaks(&mut rgb, VIEW.width, &mut seeds::rng(1, "rain"));
        let wet = rgb.iter().filter(|v| **v > 40).count();
        assert!(wet > 50 && wet < rgb.len() / 2 && rgb.iter().all(|v| *v >= 39), "{wet}");
        let mut plain = grey();
        drops(&mut plain, VIEW.width, &mut seeds::rng(2, "drops"));
        assert_eq!(plain, grey());
        let mut half: Vec<u8> = grey();
        half[VIEW.width * HEIGHT * 3 / 2..].fill(200);
        let before = half.clone();
        drops(&mut half, VIEW.width, &mut seeds::rng(2, "drops"));
        assert_ne!(half, before);
    }

    #[test]
    fn an_evening_is_red_and_each_draw_another() {
        let mut rng = seeds::rng(7, "light");
        let (mut red, mut kinds) = (0, std::collections::HashSet::new());
        for _ in 0..200 {
            let mut rgb = vec![128; 3 * 64];
            weather(&mut rgb, View { width: 8, ..VIEW }, &mut rng);
            let sum = |c: usize| rgb.iter().skip(c).step_by(3).map(|v| u32::from(*v)).sum::<u32>();
            red += usize::from(sum(0) as f32 > 1.25 * sum(2) as f32);
            kinds.insert(rgb);
        }
        assert!((10..120).contains(&red), "{red}");
        assert!(kinds.len() > 150, "{}", kinds.len());
    }

    #[test]
    fn varied_pictures_keep_their_order_of_light() {
        let mut rng = seeds::rng(3, "vary");
        let mut means = Vec::new();
        for _ in 0..20 {
            let mut rgb: Vec<u8> = [40, 40, 40].repeat(500);
            rgb.extend([200, 200, 200].repeat(500));
            light(&mut rgb, &mut rng);
            let mean = |part: &[u8]| part.iter().map(|&v| f64::from(v)).sum::<f64>() / part.len() as f64;
            let (dark, bright) = (mean(&rgb[..1500]), mean(&rgb[1500..]));
            assert!(bright > dark + 12.0, "{dark} and {bright}");
            means.push(bright);
        }
        let spread = means.iter().copied().fold(0.0, f64::max) - means.iter().copied().fold(255.0, f64::min);
        assert!(spread > 50.0, "{spread}");
    }
}
