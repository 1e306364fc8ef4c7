//! The transformed image (paper, "Detection Module", figure 3): the camera's picture at 128 x 128 with
//! road users blue, lane boundaries green, and a red light red.
//!
//! 1. The picture is brought to 128 x 128, each pixel the mean of what falls together (area average), so
//!    weather and road stay.
//! 2. Lane boundaries: green lines, 1.6 pixels broad, edges blended by coverage.
//! 3. Boxes of detected cars, motorcycles, bicycles, persons, buses, trucks and benches: filled blue. A box
//!    thinner than 2 pixels is widened to 2 about its middle, so that at least one pixel is wholly blue;
//!    edges are blended by coverage, which is what painting first and averaging then gives. Boxes of
//!    traffic lights are not painted: blue says "do not hit".
//! 4. The ego at the intersection with its light red: the upper 10 rows are red.

use super::{
    Detection, GroundPlane, ImageKind, LaneEstimate, PerceptionError, TRANSFORMED_SIZE, TransformedImage,
};
use wad_camera::Frame;
use wad_camera::model::ObjectClass;

/// Colour of road users, which the ego must not hit.
pub const BLUE: [u8; 3] = [0, 0, 255];
/// Lane boundaries.
pub const GREEN: [u8; 3] = [0, 255, 0];
/// The light at the intersection is red.
pub const RED: [u8; 3] = [255, 0, 0];
/// Rows of the red mark, from the top.
pub const RED_ROWS: usize = 10;

/// Breadth of a boundary, and least side of a box (pixels of the transformed image).
const LINE: f32 = 1.6;
const LEAST_SIDE: f32 = 2.0;

const SIDE: usize = TRANSFORMED_SIZE;

/// Whether boxes of a class are painted.
pub fn is_obstacle(class: ObjectClass) -> bool {
    class != ObjectClass::TrafficLight
}

/// Makes transformed images; keeps its buffers.
#[derive(Debug, Default)]
pub struct Painter {
    /// [`ImageKind::Plain`]: only the first step.
    pub kind: ImageKind,
    sums: Vec<u32>,
}

impl Painter {
    /// Paints `frame` with what was found in it into `image`.
    ///
    /// # Errors
    /// The frame has no picture, or one smaller than the transformed image.
    pub fn paint(
        &mut self,
        frame: &Frame,
        ground: &GroundPlane,
        detections: &[Detection],
        lanes: &LaneEstimate,
        light_red: bool,
        image: &mut TransformedImage,
    ) -> Result<(), PerceptionError> {
        if frame.width < SIDE || frame.height < SIDE || frame.rgb.len() != 3 * frame.width * frame.height {
            return Err(PerceptionError::Size {
                expected: (SIDE, SIDE),
                found: (frame.width, frame.height),
                hint: "this is the least; render the picture (RGB) with 128x128 pixels or more".to_string(),
            });
        }
        self.shrink(frame, image.bytes_mut());
        if self.kind == ImageKind::Plain {
            return Ok(());
        }
        let scale = [SIDE as f32 / frame.width as f32, SIDE as f32 / frame.height as f32];
        let pixels = image.bytes_mut();
        for boundary in [&lanes.left, &lanes.right].into_iter().flatten() {
            let points = boundary.pixels(ground);
            for pair in points.windows(2) {
                stroke(pixels, [0, 1].map(|i| pair[i]).map(|p| [p[0] * scale[0], p[1] * scale[1]]));
            }
        }
        for detection in detections.iter().filter(|d| is_obstacle(d.class)) {
            let [l, t, r, b] = detection.bounds;
            fill(pixels, [l * scale[0], t * scale[1], r * scale[0], b * scale[1]]);
        }
        if light_red {
            for pixel in pixels[..3 * SIDE * RED_ROWS].chunks_exact_mut(3) {
                pixel.copy_from_slice(&RED);
            }
        }
        Ok(())
    }

    /// Area average to 128 x 128.
    fn shrink(&mut self, frame: &Frame, out: &mut [u8]) {
        let (width, height) = (frame.width, frame.height);
        if width.is_multiple_of(SIDE) && height.is_multiple_of(SIDE) {
            let (by_x, by_y) = (width / SIDE, height / SIDE);
            match by_x {
                1 => self.shrink_whole::<1>(frame, by_y, out),
                2 => self.shrink_whole::<2>(frame, by_y, out),
                4 => self.shrink_whole::<4>(frame, by_y, out),
                _ => shrink_any(frame, out),
            }
        } else {
            shrink_any(frame, out);
        }
    }

    /// Whole numbers of pixels fall together.
    fn shrink_whole<const X: usize>(&mut self, frame: &Frame, by_y: usize, out: &mut [u8]) {
        let stride = 3 * frame.width;
        let half = (X * by_y / 2) as u32;
        for (y, out) in out.chunks_exact_mut(3 * SIDE).enumerate() {
            self.sums.clear();
            self.sums.resize(stride, 0);
            for row in frame.rgb[y * by_y * stride..][..by_y * stride].chunks_exact(stride) {
                for (sum, value) in self.sums.iter_mut().zip(row) {
                    *sum += u32::from(*value);
                }
            }
            let count = (X * by_y) as u32;
            for (out, block) in out.chunks_exact_mut(3).zip(self.sums.chunks_exact(3 * X)) {
                for (c, out) in out.iter_mut().enumerate() {
                    let sum: u32 = (0..X).map(|i| block[3 * i + c]).sum();
                    *out = ((sum + half) / count) as u8;
                }
            }
        }
    }
}

/// Any size: pixels count by the share that falls in.
fn shrink_any(frame: &Frame, out: &mut [u8]) {
    let shares = |from: usize| -> Vec<Vec<(usize, f32)>> {
        let step = from as f32 / SIDE as f32;
        (0..SIDE)
            .map(|i| {
                let (low, high) = (i as f32 * step, (i + 1) as f32 * step);
                (low as usize..(high.ceil() as usize).min(from))
                    .map(|k| (k, ((k + 1) as f32).min(high) - (k as f32).max(low)))
                    .filter(|(_, share)| *share > 0.0)
                    .collect()
            })
            .collect()
    };
    let (columns, rows) = (shares(frame.width), shares(frame.height));
    for (y, row) in rows.iter().enumerate() {
        for (x, column) in columns.iter().enumerate() {
            let (mut sum, mut weight) = ([0.0_f32; 3], 0.0);
            for &(yy, wy) in row {
                for &(xx, wx) in column {
                    let at = 3 * (yy * frame.width + xx);
                    for (sum, value) in sum.iter_mut().zip(&frame.rgb[at..at + 3]) {
                        *sum += wx * wy * f32::from(*value);
                    }
                    weight += wx * wy;
                }
            }
            for (c, sum) in sum.into_iter().enumerate() {
                out[3 * (y * SIDE + x) + c] = (sum / weight + 0.5) as u8;
            }
        }
    }
}

/// Blends a colour over a pixel by coverage 0..1.
fn blend(pixels: &mut [u8], x: usize, y: usize, colour: [u8; 3], cover: f32) {
    let at = 3 * (y * SIDE + x);
    for (old, new) in pixels[at..at + 3].iter_mut().zip(colour) {
        let mixed = f32::from(*old) + cover * (f32::from(new) - f32::from(*old));
        *old = (mixed + 0.5) as u8;
    }
}

/// A filled blue box: left, top, right, bottom in pixels of the transformed image.
fn fill(pixels: &mut [u8], [l, t, r, b]: [f32; 4]) {
    let side = SIDE as f32;
    let widen = |low: f32, high: f32| {
        let middle = 0.5 * (low + high);
        let half = (0.5 * (high - low)).max(0.5 * LEAST_SIDE);
        ((middle - half).max(0.0), (middle + half).min(side))
    };
    let ((l, r), (t, b)) = (widen(l, r), widen(t, b));
    if !(l < r && t < b) {
        return;
    }
    let cover = |k: usize, low: f32, high: f32| ((k + 1) as f32).min(high) - (k as f32).max(low);
    for y in t as usize..(b.ceil() as usize).min(SIDE) {
        for x in l as usize..(r.ceil() as usize).min(SIDE) {
            blend(pixels, x, y, BLUE, (cover(x, l, r) * cover(y, t, b)).clamp(0.0, 1.0));
        }
    }
}

/// A green line between two points of the transformed image.
fn stroke(pixels: &mut [u8], [p, q]: [[f32; 2]; 2]) {
    let (dx, dy) = (q[0] - p[0], q[1] - p[1]);
    let length = dx.hypot(dy);
    if length < 1e-3 || !length.is_finite() {
        return;
    }
    let reach = 0.5 * LINE + 0.5;
    let range = |a: f32, b: f32| {
        let low = (a.min(b) - reach).clamp(0.0, SIDE as f32) as usize;
        (low, ((a.max(b) + reach).clamp(0.0, SIDE as f32).ceil() as usize).min(SIDE))
    };
    let ((x0, x1), (y0, y1)) = (range(p[0], q[0]), range(p[1], q[1]));
    for y in y0..y1 {
        for x in x0..x1 {
            let (rx, ry) = (x as f32 + 0.5 - p[0], y as f32 + 0.5 - p[1]);
            let along = ((rx * dx + ry * dy) / length).clamp(0.0, length);
            let off = (rx - along * dx / length).hypot(ry - along * dy / length);
            let cover = (reach - off).clamp(0.0, 1.0);
            if cover > 0.0 {
                blend(pixels, x, y, GREEN, cover);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perception::LaneBoundary;
    use wad_camera::CameraConfig;

    fn grey(width: usize, height: usize) -> Frame {
        Frame { width, height, rgb: vec![100; 3 * width * height], ..Frame::default() }
    }

    fn paint(frame: &Frame, found: &[Detection], lanes: &LaneEstimate, red: bool) -> TransformedImage {
        let ground = GroundPlane::new(&CameraConfig::sized(frame.width, frame.height));
        let mut image = TransformedImage::default();
        Painter::default().paint(frame, &ground, found, lanes, red, &mut image).unwrap();
        image
    }

    fn boxed(class: ObjectClass, bounds: [f32; 4]) -> Detection {
        Detection { class, bounds, score: 1.0 }
    }

    fn pixel(image: &TransformedImage, x: usize, y: usize) -> [u8; 3] {
        let at = 3 * (y * SIDE + x);
        [image.bytes()[at], image.bytes()[at + 1], image.bytes()[at + 2]]
    }

    fn count(image: &TransformedImage, colour: [u8; 3]) -> usize {
        image.bytes().chunks_exact(3).filter(|p| *p == colour).count()
    }

    #[test]
    fn shrinking_is_the_mean_of_what_falls_together() {
        let mut frame = grey(512, 512);
        for (i, value) in frame.rgb.iter_mut().enumerate() {
            *value = (i * 37 % 251) as u8;
        }
        let image = paint(&frame, &[], &LaneEstimate::default(), false);
        for (x, y) in [(0, 0), (17, 90), (127, 127)] {
            for c in 0..3 {
                let block = (0..16).map(|k| frame.rgb[3 * ((4 * y + k / 4) * 512 + 4 * x + k % 4) + c]);
                let mean = block.map(f32::from).sum::<f32>() / 16.0;
                assert!((f32::from(pixel(&image, x, y)[c]) - mean).abs() <= 0.51);
            }
        }
        // The same by shares, for sizes that do not divide.
        let mut by_shares = vec![0; TransformedImage::BYTES];
        shrink_any(&frame, &mut by_shares);
        assert!(by_shares.iter().zip(image.bytes()).all(|(a, b)| a.abs_diff(*b) <= 1));
        assert_eq!(pixel(&paint(&grey(300, 200), &[], &LaneEstimate::default(), false), 64, 64), [100; 3]);
    }

    #[test]
    fn boxes_are_blue_and_far_ones_keep_a_wholly_blue_pixel() {
        let near = boxed(ObjectClass::Car, [200.0, 240.0, 260.0, 300.0]);
        let image = paint(&grey(512, 512), &[near], &LaneEstimate::default(), false);
        assert_eq!(count(&image, BLUE), 15 * 15);
        for class in [ObjectClass::Person, ObjectClass::Bench, ObjectClass::Bus, ObjectClass::Bicycle] {
            let far = boxed(class, [301.0, 255.0, 303.0, 259.0]);
            let image = paint(&grey(512, 512), &[far], &LaneEstimate::default(), false);
            assert!((1..=4).contains(&count(&image, BLUE)), "{class:?}");
        }
        let lamp = boxed(ObjectClass::TrafficLight, [300.0, 100.0, 340.0, 180.0]);
        assert_eq!(count(&paint(&grey(512, 512), &[lamp], &LaneEstimate::default(), false), BLUE), 0);
        // Over the border.
        let beside = boxed(ObjectClass::Truck, [-40.0, 200.0, 8.0, 600.0]);
        assert_eq!(count(&paint(&grey(512, 512), &[beside], &LaneEstimate::default(), false), BLUE), 2 * 78);
    }

    #[test]
    fn lanes_are_green_and_lie_under_boxes() {
        let line = LaneBoundary { offset: 1.5, slope: 0.0, bend: 0.0, reach: [3.0, 20.0] };
        let lanes = LaneEstimate { left: Some(line), right: None };
        let image = paint(&grey(512, 512), &[], &lanes, false);
        let ground = GroundPlane::new(&CameraConfig::default());
        for x in [4.0, 8.0, 15.0] {
            let [px, py] = ground.pixel([x, 1.5]).unwrap();
            let [r, g, b] = pixel(&image, (px / 4.0) as usize, (py / 4.0) as usize);
            assert!(g > 190 && r < 60 && b < 60, "{:?} at {x} m", [r, g, b]);
        }
        let [px, py] = ground.pixel([8.0, 1.5]).unwrap();
        let over = boxed(ObjectClass::Car, [px - 30.0, py - 30.0, px + 30.0, py + 30.0]);
        let image = paint(&grey(512, 512), &[over], &lanes, false);
        assert_eq!(pixel(&image, (px / 4.0) as usize, (py / 4.0) as usize), BLUE);
    }

    #[test]
    fn a_red_light_is_a_red_band_and_nothing_else() {
        let image = paint(&grey(512, 512), &[], &LaneEstimate::default(), true);
        assert_eq!(count(&image, RED), SIDE * RED_ROWS);
        assert_eq!(pixel(&image, 60, RED_ROWS), [100; 3]);
    }

    #[test]
    fn a_plain_picture_has_nothing_painted() {
        let near = boxed(ObjectClass::Car, [200.0, 240.0, 260.0, 300.0]);
        let ground = GroundPlane::new(&CameraConfig::default());
        let mut image = TransformedImage::default();
        let mut painter = Painter { kind: ImageKind::Plain, ..Painter::default() };
        let lanes = LaneEstimate::default();
        painter.paint(&grey(512, 512), &ground, &[near], &lanes, true, &mut image).unwrap();
        assert!(image.bytes().iter().all(|byte| *byte == 100));
    }

    #[test]
    fn a_picture_too_small_or_missing_is_an_error_that_names_the_size() {
        let ground = GroundPlane::new(&CameraConfig::sized(100, 100));
        let mut image = TransformedImage::default();
        let lanes = LaneEstimate::default();
        let mut paint = |frame: &Frame| {
            Painter::default().paint(frame, &ground, &[], &lanes, false, &mut image).unwrap_err().to_string()
        };
        assert!(paint(&grey(100, 100)).contains("(100, 100)"));
        assert!(paint(&Frame { width: 512, height: 512, ..Frame::default() }).contains("RGB"));
    }
}
