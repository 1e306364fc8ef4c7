//! The meaning of detectors' output tensors, found by their shapes.
//!
//! | head | tensors (batch 1) | how it is read |
//! |---|---|---|
//! | CenterNet, four sides | C x h x w and 4 x h x w | peaks of the heatmap; left, top, right, bottom from the peak (px) |
//! | CenterNet, size and offset | C x h x w and twice 2 x h x w | the paper's (Zhou et al. 2019), in cells |
//! | YOLO | (4 + C) x n or n x (4 + C), or with objectness n x (5 + C) | centre x, y, width, height (px), scores |
//! | YOLO, suppressed | n x 6 | left, top, right, bottom (px), score, class |
//!
//! C is 80 (COCO) or 8 (ours). Nothing here needs OpenCV.

use super::Detection;
use super::coco::{class_of, suppress};

/// An output of a network: shape without the batch, values in C order.
#[derive(Clone, Debug)]
pub struct Tensor<'a> {
    /// The output's name in the file.
    pub name: &'a str,
    /// The sizes of its dimensions.
    pub shape: &'a [usize],
    /// The numbers.
    pub values: &'a [f32],
}

/// How a network's outputs are read; the numbers are indices of outputs.
#[derive(Clone, Debug, PartialEq)]
pub enum Head {
    /// Side distances in pixels of the network's input.
    Sides {
        /// Output with the classes' heat maps.
        heat: usize,
        /// Output with the distances of the four sides.
        sides: usize,
        /// Number of classes.
        classes: usize,
    },
    /// Offsets and sizes in cells.
    SizeOffset {
        /// Output with the classes' heat maps.
        heat: usize,
        /// Output with widths and heights.
        size: usize,
        /// Output with the places within the cells.
        offset: usize,
        /// Number of classes.
        classes: usize,
    },
    /// One row per candidate, or one column where `transposed`.
    Rows {
        /// Output with the candidates.
        rows: usize,
        /// Number of classes.
        classes: usize,
        /// A candidate has a score of its own before its classes'.
        objectness: bool,
        /// The candidates are columns.
        transposed: bool,
    },
    /// Finished rows: box, score, class.
    Finished,
}

/// Boxes of one class that overlap by more are one object.
const SUPPRESSION_IOU: f32 = 0.5;
/// Numbers of classes that are recognised.
const CLASS_COUNTS: [usize; 2] = [80, 8];

/// The head that outputs of these names and shapes (without the batch) belong to.
///
/// # Errors
/// What was expected and what was found.
pub fn recognise(outputs: &[(&str, &[usize])]) -> Result<Head, String> {
    let maps: Vec<usize> = (0..outputs.len()).filter(|&i| outputs[i].1.len() == 3).collect();
    let heats: Vec<usize> =
        maps.iter().copied().filter(|&i| CLASS_COUNTS.contains(&outputs[i].1[0])).collect();
    if let [heat] = heats[..] {
        let like = |channels: usize| -> Vec<usize> {
            let fits = |i: &usize| outputs[*i].1[0] == channels && outputs[*i].1[1..] == outputs[heat].1[1..];
            maps.iter().copied().filter(fits).collect()
        };
        let classes = outputs[heat].1[0];
        if let [sides] = like(4)[..] {
            return Ok(Head::Sides { heat, sides, classes });
        }
        if let [a, b] = like(2)[..] {
            let says = |i: usize, words: &[&str]| {
                let name = outputs[i].0.to_ascii_lowercase();
                words.iter().any(|w| name.contains(w))
            };
            // The usual order is heatmap, size, offset.
            let swapped = says(a, &["off", "reg"]) || says(b, &["wh", "size"]);
            let (size, offset) = if swapped { (b, a) } else { (a, b) };
            return Ok(Head::SizeOffset { heat, size, offset, classes });
        }
    }
    if let &[(_, &[first, second])] = outputs {
        if second == 6 && first != 84 {
            return Ok(Head::Finished);
        }
        let (long, short) = (first.max(second), first.min(second));
        for classes in CLASS_COUNTS {
            for objectness in [false, true] {
                if short == 4 + usize::from(objectness) + classes && long > short {
                    return Ok(Head::Rows { rows: long, classes, objectness, transposed: first == short });
                }
            }
        }
    }
    let found: Vec<String> = outputs.iter().map(|(name, shape)| format!("{name} {shape:?}")).collect();
    Err(format!(
        "its outputs are not a detector's. Expected (without the batch, C = 80 or 8 classes): CenterNet's \
         [C, h, w] with [4, h, w] or twice [2, h, w]; or YOLO's [4 + C, n], [n, 4 + C], [n, 5 + C] or [n, 6]. \
         Found: {}",
        if found.is_empty() { "none".to_string() } else { found.join(", ") }
    ))
}

/// The detections with a score of `min_score` or more, best first, in pixels of the network's input, which
/// is `width` pixels wide.
pub fn decode(head: &Head, outputs: &[Tensor<'_>], width: usize, min_score: f32) -> Vec<Detection> {
    let mut found = Vec::new();
    match *head {
        Head::Sides { heat, sides, classes } => {
            let (plane, side) = (cells(&outputs[heat]), outputs[sides].values);
            let stride = width as f32 / outputs[heat].shape[2] as f32;
            peaks(&outputs[heat], classes, min_score, |class, score, [x, y], cell| {
                let (x, y) = (x as f32 * stride, y as f32 * stride);
                let [l, t, r, b] = [0, 1, 2, 3].map(|k| side[k * plane + cell]);
                found.push(Detection { class, score, bounds: [x - l, y - t, x + r, y + b] });
            });
        }
        Head::SizeOffset { heat, size, offset, classes } => {
            let (plane, sizes, offsets) =
                (cells(&outputs[heat]), outputs[size].values, outputs[offset].values);
            let stride = width as f32 / outputs[heat].shape[2] as f32;
            peaks(&outputs[heat], classes, min_score, |class, score, [x, y], cell| {
                let centre = [x as f32 + offsets[cell], y as f32 + offsets[plane + cell]];
                let [w, h] = [0.5 * sizes[cell], 0.5 * sizes[plane + cell]];
                let bounds = [centre[0] - w, centre[1] - h, centre[0] + w, centre[1] + h];
                found.push(Detection { class, score, bounds: bounds.map(|v| v * stride) });
            });
        }
        Head::Rows { rows, classes, objectness, transposed } => {
            let skip = 4 + usize::from(objectness);
            let row_length = skip + classes;
            let values = outputs[0].values;
            let at =
                |row: usize, k: usize| values[if transposed { k * rows + row } else { row * row_length + k }];
            for row in 0..rows {
                let sure = if objectness { at(row, 4) } else { 1.0 };
                let best = (0..classes).max_by(|&a, &b| at(row, skip + a).total_cmp(&at(row, skip + b)));
                let Some(class) = best.and_then(|b| class_of(b, classes)) else { continue };
                let score = sure * best.map_or(0.0, |b| at(row, skip + b));
                if score >= min_score {
                    let [x, y, w, h] = [0, 1, 2, 3].map(|k| at(row, k));
                    let bounds = [x - 0.5 * w, y - 0.5 * h, x + 0.5 * w, y + 0.5 * h];
                    found.push(Detection { class, score, bounds });
                }
            }
        }
        Head::Finished => {
            for row in outputs[0].values.chunks_exact(6).filter(|row| row[4] >= min_score) {
                if let Some(class) = class_of(row[5].max(0.0) as usize, 80) {
                    let bounds = [row[0], row[1], row[2], row[3]];
                    found.push(Detection { class, score: row[4], bounds });
                }
            }
        }
    }
    found.retain(|d| d.score.is_finite() && d.bounds.iter().all(|v| v.is_finite()));
    suppress(&mut found, SUPPRESSION_IOU);
    found
}

/// A box's side that is nearer to the picture's side than this share of the box's width is where the picture cuts the object.
/// `eyes` put the sides of the vehicles that are cut there to a pixel in 58 %, to this in 96 % (of 98 in a drive through town3; of
/// 37 that end within 60 pixels of it, 5 seem cut). Who is passed would be in the ego's path, by the breadth that is not seen.
const AT_SIDE: f32 = 0.1;

/// Cuts the boxes at the borders of a picture of this width and height (pixels), and leaves out what is outside.
pub fn clip(found: &mut Vec<Detection>, [width, height]: [f32; 2]) {
    for detection in found.iter_mut() {
        let [l, t, r, b] = detection.bounds;
        let near = AT_SIDE * (r - l);
        let left = if l < near { 0.0 } else { l };
        let right = if r > width - near { width } else { r };
        detection.bounds = [left, t.max(0.0), right, b.min(height)];
    }
    found.retain(|d| d.size().iter().all(|&side| side > 0.0));
}

fn cells(map: &Tensor<'_>) -> usize {
    map.shape[1] * map.shape[2]
}

/// Calls `take` with (class, score, [x, y], cell) for each cell that none of its eight neighbours exceeds.
fn peaks(
    heat: &Tensor<'_>,
    classes: usize,
    min_score: f32,
    mut take: impl FnMut(wad_camera::model::ObjectClass, f32, [usize; 2], usize),
) {
    let (height, width) = (heat.shape[1], heat.shape[2]);
    for channel in 0..classes {
        let Some(class) = class_of(channel, classes) else { continue };
        let plane = &heat.values[channel * height * width..][..height * width];
        for (cell, &score) in plane.iter().enumerate().filter(|(_, score)| **score >= min_score) {
            let (x, y) = (cell % width, cell / width);
            let mut around = (y.saturating_sub(1)..(y + 2).min(height))
                .flat_map(|yy| (x.saturating_sub(1)..(x + 2).min(width)).map(move |xx| yy * width + xx));
            if around.all(|other| plane[other] <= score) {
                take(class, score, [x, y], cell);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wad_camera::model::ObjectClass;

    #[test]
    fn heads_are_told_by_shape() {
        let sides = recognise(&[("a", &[80, 128, 128]), ("b", &[4, 128, 128])]).unwrap();
        assert_eq!(sides, Head::Sides { heat: 0, sides: 1, classes: 80 });
        let named = recognise(&[("reg", &[2, 96, 96]), ("hm", &[8, 96, 96]), ("wh", &[2, 96, 96])]).unwrap();
        assert_eq!(named, Head::SizeOffset { heat: 1, size: 2, offset: 0, classes: 8 });
        let yolo8 = Head::Rows { rows: 8400, classes: 80, objectness: false, transposed: true };
        assert_eq!(recognise(&[("o", &[84, 8400])]).unwrap(), yolo8);
        let yolo5 = Head::Rows { rows: 25200, classes: 80, objectness: true, transposed: false };
        assert_eq!(recognise(&[("o", &[25200, 85])]).unwrap(), yolo5);
        assert_eq!(recognise(&[("o", &[300, 6])]).unwrap(), Head::Finished);
    }

    #[test]
    fn a_classifier_is_no_detector_and_the_error_names_its_output() {
        for shapes in [vec![("prob", &[1000_usize][..])], vec![], vec![("a", &[80, 9, 9]), ("b", &[4, 8, 8])]]
        {
            let error = recognise(&shapes).unwrap_err();
            assert!(
                shapes.iter().all(|(name, _)| error.contains(name)) && error.contains("[n, 6]"),
                "{error}"
            );
        }
    }

    #[test]
    fn a_peak_becomes_one_box() {
        let mut heat = vec![0.0; 80 * 16];
        heat[2 * 16 + 5] = 0.8; // car, x = 1, y = 1
        heat[2 * 16 + 6] = 0.6; // its slope
        heat[4 * 16 + 15] = 0.9; // an aeroplane
        let mut sides = vec![0.0; 4 * 16];
        for (k, distance) in [4.0, 3.0, 20.0, 10.0].into_iter().enumerate() {
            sides[k * 16 + 5] = distance;
        }
        let outputs = [
            Tensor { name: "heat", shape: &[80, 4, 4], values: &heat },
            Tensor { name: "sides", shape: &[4, 4, 4], values: &sides },
        ];
        let head = Head::Sides { heat: 0, sides: 1, classes: 80 };
        let found = decode(&head, &outputs, 32, 0.3);
        assert_eq!(
            found,
            [Detection { class: ObjectClass::Car, bounds: [4.0, 5.0, 28.0, 18.0], score: 0.8 }]
        );
    }

    #[test]
    fn yolo_rows_and_columns_give_the_same_boxes() {
        let mut rows = vec![0.0; 3 * 85];
        for (row, (class, sure)) in [(0, 0.9), (7, 0.5), (60, 0.9)].into_iter().enumerate() {
            let at = row * 85;
            rows[at..at + 5].copy_from_slice(&[50.0 + 100.0 * row as f32, 40.0, 20.0, 30.0, sure]);
            rows[at + 5 + class] = 0.8;
        }
        let one = Tensor { name: "o", shape: &[3, 85], values: &rows };
        let head = Head::Rows { rows: 3, classes: 80, objectness: true, transposed: false };
        let found = decode(&head, &[one], 512, 0.3);
        assert_eq!(found.len(), 2);
        assert_eq!(found[0].class, ObjectClass::Person);
        assert_eq!(found[0].bounds, [40.0, 25.0, 60.0, 55.0]);
        assert!((found[1].score - 0.4).abs() < 1e-6 && found[1].class == ObjectClass::Truck);

        let columns: Vec<f32> = (0..85 * 3).map(|i| rows[i % 3 * 85 + i / 3]).collect();
        let other = Tensor { name: "o", shape: &[85, 3], values: &columns };
        let head = Head::Rows { rows: 3, classes: 80, objectness: true, transposed: true };
        assert_eq!(decode(&head, &[other], 512, 0.3), found);
    }

    #[test]
    fn a_box_that_ends_beside_the_pictures_side_ends_there() {
        let at = |bounds| Detection { class: ObjectClass::Car, bounds, score: 0.5 };
        let cut = |bounds| {
            let mut found = vec![at(bounds)];
            clip(&mut found, [512.0, 512.0]);
            found.first().map(|d| d.bounds)
        };
        assert_eq!(cut([9.0, 200.0, 109.0, 300.0]), Some([0.0, 200.0, 109.0, 300.0]));
        assert_eq!(cut([11.0, 200.0, 111.0, 300.0]), Some([11.0, 200.0, 111.0, 300.0]));
        assert_eq!(cut([403.0, -5.0, 503.0, 600.0]), Some([403.0, 0.0, 512.0, 512.0]));
        assert_eq!(cut([-30.0, 200.0, 520.0, 300.0]), Some([0.0, 200.0, 512.0, 300.0]));
        assert_eq!(cut([-30.0, 200.0, -2.0, 300.0]), None);
        assert_eq!(cut([520.0, 200.0, 560.0, 300.0]), None);
    }
}
