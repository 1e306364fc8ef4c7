//! The stages of perception as pictures for display.

use super::coco::class_name;
use super::paint::{BLUE, GREEN, RED, is_obstacle};
use super::{Detection, DrivableArea, GroundPlane, Percept, TRANSFORMED_SIZE, TransformedImage, colour};
use wad_camera::model::ObjectClass;
use wad_camera::{Frame, Picture};

/// The camera's picture with the detections' boxes.
pub fn detections(frame: &Frame, found: &[Detection]) -> Picture {
    let mut picture = Picture::rgb(frame);
    draw_boxes(&mut picture, found);
    picture
}

fn draw_boxes(picture: &mut Picture, found: &[Detection]) {
    for detection in found {
        let [l, t, r, b] = detection.bounds.map(|v| v.max(0.0).round() as usize);
        let colour = if is_obstacle(detection.class) { BLUE } else { [255, 220, 40] };
        let (right, bottom) = (r.max(l + 1) - 1, b.max(t + 1) - 1);
        picture.outline([l, t, right, bottom], colour);
        if right > l + 3 && bottom > t + 3 {
            let light = if detection.class == ObjectClass::Person { [255, 90, 160] } else { [120, 190, 255] };
            picture.outline([l + 1, t + 1, right - 1, bottom - 1], light);
        }
    }
}

/// The camera's picture with the lane boundaries and what is road, and a red border where the light here is red.
pub fn lanes(frame: &Frame, percept: &Percept, ground: &GroundPlane) -> Picture {
    let mut picture = Picture::rgb(frame);
    draw_road(&mut picture, percept, ground);
    if percept.light_red {
        for inset in 0..4 {
            let (right, bottom) = (picture.width - 1 - inset, picture.height - 1 - inset);
            picture.outline([inset, inset, right, bottom], RED);
        }
    }
    picture
}

/// The camera's picture with all that was seen in it: boxes with their class and certainty (percent), the lane's
/// boundaries, what is road, what light is ahead, with the distance of its stop line, and signs.
pub fn seen(frame: &Frame, percept: &Percept, ground: &GroundPlane) -> Picture {
    let mut picture = Picture::rgb(frame);
    draw_road(&mut picture, percept, ground);
    draw_boxes(&mut picture, &percept.detections);
    for detection in &percept.detections {
        let [l, t, ..] = detection.bounds.map(|v| v.max(0.0) as usize);
        let words = format!("{} {:.0}", class_name(detection.class), 100.0 * detection.score);
        picture.label(&words, l, t.saturating_sub(9), 1);
    }
    label_light(&mut picture, percept);
    label_signs(&mut picture, percept);
    picture
}

/// Road is tinted.
fn tint_area(picture: &mut Picture, percept: &Percept) {
    const TINT: [u8; 3] = [150, 60, 220];
    for [left, top, right, bottom] in percept.area.iter().flat_map(DrivableArea::stretches) {
        for line in picture.rgb.chunks_exact_mut(3 * picture.width).take(bottom).skip(top) {
            for pixel in line.as_chunks_mut::<3>().0.iter_mut().take(right).skip(left) {
                *pixel = std::array::from_fn(|k| ((3 * u16::from(pixel[k]) + u16::from(TINT[k])) / 4) as u8);
            }
        }
    }
}

fn label_signs(picture: &mut Picture, percept: &Percept) {
    for sign in percept.signs.iter().filter(|sign| sign.is_sure()) {
        let [x, y] = sign.pixel.map(|v| v.max(0.0) as usize);
        let words = format!("{} {:.0}", sign.sign, 100.0 * sign.certainty);
        picture.label(&words, x, y.saturating_sub(20), 1);
    }
    if let Some(limit) = percept.limit {
        picture.label(&format!("limit {limit}"), 8, 28, 2);
    }
}

fn label_light(picture: &mut Picture, percept: &Percept) {
    let light = match percept.light {
        None => "no light".to_string(),
        Some(light) => {
            let lamp = colour(light.state).map_or("off", |lamp| ["red", "yellow", "green"][lamp]);
            format!("{lamp} {:.0} m", light.distance)
        }
    };
    picture.label(&light, 8, 8, 2);
}

fn draw_road(picture: &mut Picture, percept: &Percept, ground: &GroundPlane) {
    tint_area(picture, percept);
    for boundary in [&percept.lanes.left, &percept.lanes.right].into_iter().flatten() {
        let points = boundary.pixels(ground);
        for pair in points.windows(2) {
            let ([x, y], [to_x, to_y]) = (pair[0], pair[1]);
            let steps = (to_x - x).abs().max((to_y - y).abs()).min(4096.0).ceil().max(1.0) as usize;
            for step in 0..=steps {
                let t = step as f32 / steps as f32;
                let (px, py) = (x + t * (to_x - x), y + t * (to_y - y));
                for (dx, dy) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)] {
                    if px + dx >= 0.0 && py + dy >= 0.0 {
                        picture.set((px + dx) as usize, (py + dy) as usize, GREEN);
                    }
                }
            }
        }
    }
}

/// A transformed image (or a reconstruction of one) at its own size.
pub fn transformed(image: &TransformedImage) -> Picture {
    Picture { width: TRANSFORMED_SIZE, height: TRANSFORMED_SIZE, rgb: image.bytes().to_vec() }
}

/// What was seen in a [mirror](super::mirrors), for display.
#[derive(Clone, Debug)]
pub struct MirrorView {
    /// Whether it is the left one.
    pub left: bool,
    /// As a driver sees it, left and right swapped, with the detections' boxes.
    pub picture: Picture,
}

impl MirrorView {
    /// Puts it where a driver looks for it: at the foot of the picture from behind the windscreen, a third as wide, on its side.
    pub fn put_on(&self, front: &mut Picture) {
        let side = front.width / 3;
        let x = if self.left { 1 } else { front.width - side - 1 };
        front.inset(&self.picture.scaled(side, side), x, front.height - side - 1);
    }
}

/// Camera, what was seen in its picture (boxes, boundaries, light, signs, what is road) and in a mirror, transformed image and, where there is one,
/// reconstruction, side by side, `side` pixels each.
pub fn strip(
    frame: &Frame,
    percept: &Percept,
    ground: &GroundPlane,
    mirror: Option<&MirrorView>,
    reconstruction: Option<&TransformedImage>,
    side: usize,
) -> Picture {
    let mut seen = lanes(frame, percept, ground);
    draw_boxes(&mut seen, &percept.detections);
    label_light(&mut seen, percept);
    label_signs(&mut seen, percept);
    if let Some(mirror) = mirror {
        mirror.put_on(&mut seen);
    }
    let mut pictures = vec![Picture::rgb(frame), seen, transformed(&percept.transformed)];
    pictures.extend(reconstruction.map(transformed));
    let mut strip = Picture::new(side * pictures.len(), side);
    for (n, picture) in pictures.iter().enumerate() {
        strip.paste(&picture.scaled(side, side), n * side, 0);
    }
    strip
}
