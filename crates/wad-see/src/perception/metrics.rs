//! Detection metrics: matching, recall, and COCO's average precision.
//!
//! Matching is COCO's: per picture and label, the detections in falling order of their score each take
//! the unmatched truth that they overlap most, if the IoU reaches the threshold. Average precision is COCO's
//! too: precision made monotonous and read at 101 recalls (0, 0.01 .. 1). Sizes are heights of boxes in pixels, not
//! COCO's areas: a person and a car equally far away then fall into the same range.

use super::Detection;

/// A true box, or a region where detections do not count.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Truth {
    /// What must agree between truth and detection: a class, or a group of classes.
    pub label: usize,
    /// Left, top, right, bottom (pixels).
    pub bounds: [f32; 4],
    /// Neither a miss nor a false alarm: detections that lie in it by half or more do not count.
    pub ignored: bool,
}

/// A detection and the label that it is matched by.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Found {
    /// A class, or a group of classes; see [`Truth::label`].
    pub label: usize,
    /// The detection.
    pub detection: Detection,
}

/// One picture's truths and detections.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Scored {
    /// The true boxes and ignored regions.
    pub truths: Vec<Truth>,
    /// The detections.
    pub found: Vec<Found>,
}

/// How a detection is counted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fate {
    /// It found this truth (index).
    Hit(usize),
    /// It does not count.
    Ignored,
    /// There is nothing there, or it was found already.
    False,
}

/// Largest number of detections of a picture that count, as in COCO.
const MOST_DETECTIONS: usize = 100;

/// The fates of `scored.found`, in its order. `counts` says whether a box of this height (pixels) is
/// in the wanted range; truths outside it are ignored, and detections outside it never false.
pub fn fates(scored: &Scored, iou: f32, counts: impl Fn(f32) -> bool) -> Vec<Fate> {
    let height = |b: &[f32; 4]| b[3] - b[1];
    let mut order: Vec<usize> = (0..scored.found.len()).collect();
    let score = |&i: &usize| scored.found[i].detection.score;
    order.sort_by(|a, b| score(b).total_cmp(&score(a)));
    let mut fates = vec![Fate::Ignored; scored.found.len()];
    let mut is_taken = vec![false; scored.truths.len()];
    for &i in order.iter().take(MOST_DETECTIONS) {
        let Found { label, detection } = &scored.found[i];
        let (mut best, mut best_iou) = (None, iou);
        let mut is_ignored = !counts(height(&detection.bounds));
        for (t, truth) in scored.truths.iter().enumerate().filter(|(_, t)| t.label == *label) {
            if truth.ignored || !counts(height(&truth.bounds)) {
                is_ignored |= share_inside(&detection.bounds, &truth.bounds) >= 0.5
                    || detection.iou(&truth.bounds) >= iou;
            } else if !is_taken[t] && detection.iou(&truth.bounds) >= best_iou {
                (best, best_iou) = (Some(t), detection.iou(&truth.bounds));
            }
        }
        fates[i] = match best {
            Some(t) => {
                is_taken[t] = true;
                Fate::Hit(t)
            }
            None if is_ignored => Fate::Ignored,
            None => Fate::False,
        };
    }
    fates
}

/// Share of `inner`'s area inside `outer`, 0 to 1.
fn share_inside(inner: &[f32; 4], outer: &[f32; 4]) -> f32 {
    let side = |k: usize| (inner[k + 2].min(outer[k + 2]) - inner[k].max(outer[k])).max(0.0);
    let area = (inner[2] - inner[0]) * (inner[3] - inner[1]);
    if area > 0.0 { side(0) * side(1) / area } else { 0.0 }
}

/// Average precision of one label over pictures; None if there is no truth.
pub fn average_precision<'a>(
    pictures: impl IntoIterator<Item = &'a Scored>,
    label: usize,
    iou: f32,
    counts: impl Fn(f32) -> bool,
) -> Option<f64> {
    let mut truths = 0_usize;
    let mut judged: Vec<(f32, bool)> = Vec::new();
    for picture in pictures {
        let one = Scored {
            truths: picture.truths.iter().filter(|t| t.label == label).copied().collect(),
            found: picture.found.iter().filter(|f| f.label == label).copied().collect(),
        };
        truths += one.truths.iter().filter(|t| !t.ignored && counts(t.bounds[3] - t.bounds[1])).count();
        for (found, fate) in one.found.iter().zip(fates(&one, iou, &counts)) {
            if fate != Fate::Ignored {
                judged.push((found.detection.score, matches!(fate, Fate::Hit(_))));
            }
        }
    }
    if truths == 0 {
        return None;
    }
    judged.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut hits = 0_usize;
    let mut curve: Vec<(f64, f64)> = Vec::with_capacity(judged.len());
    for (n, (_, is_hit)) in judged.iter().enumerate() {
        hits += usize::from(*is_hit);
        curve.push((hits as f64 / truths as f64, hits as f64 / (n + 1) as f64));
    }
    let mut best = 0.0_f64;
    for (_, precision) in curve.iter_mut().rev() {
        best = best.max(*precision);
        *precision = best;
    }
    let sum: f64 = (0..=100)
        .map(|k| {
            let at = curve.partition_point(|(recall, _)| *recall < f64::from(k) / 100.0 - 1e-9);
            curve.get(at).map_or(0.0, |(_, precision)| *precision)
        })
        .sum();
    Some(sum / 101.0)
}

/// COCO's ten thresholds of the IoU, 0.5 to 0.95.
pub fn coco_ious() -> impl Iterator<Item = f32> {
    (0..10).map(|k| 0.5 + 0.05 * k as f32)
}

/// The mean of what there is; None of nothing.
pub fn mean(values: impl IntoIterator<Item = Option<f64>>) -> Option<f64> {
    let (sum, count) = values.into_iter().flatten().fold((0.0, 0_usize), |(s, n), v| (s + v, n + 1));
    (count > 0).then(|| sum / count as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use wad_camera::model::ObjectClass;

    fn truth(left: f32, size: f32) -> Truth {
        Truth { label: 0, bounds: [left, 0.0, left + size, size], ignored: false }
    }

    fn found(left: f32, size: f32, score: f32) -> Found {
        let bounds = [left, 0.0, left + size, size];
        Found { label: 0, detection: Detection { class: ObjectClass::Car, bounds, score } }
    }

    fn all(_: f32) -> bool {
        true
    }

    #[test]
    fn three_hits_and_a_false_alarm_between_them() {
        // Scores .9 hit, .8 false, .7 hit, .6 hit of four truths: precision 1, 1/2, 2/3, 3/4 at recalls
        // 1/4, 1/4, 1/2, 3/4. Made monotonous: 1 up to 1/4 (26 recalls), 3/4 up to 3/4 (50), then 0 (25).
        let picture = Scored {
            truths: vec![truth(0.0, 10.0), truth(100.0, 10.0), truth(200.0, 10.0), truth(300.0, 10.0)],
            found: vec![
                found(0.0, 10.0, 0.9),
                found(50.0, 10.0, 0.8),
                found(101.0, 10.0, 0.7),
                found(200.0, 10.0, 0.6),
            ],
        };
        let ap = average_precision([&picture], 0, 0.5, all).unwrap();
        assert!((ap - (26.0 + 50.0 * 0.75) / 101.0).abs() < 1e-12, "{ap}");
        // At an IoU of 0.9 the shifted box (90 of 110 px) misses: hits at ranks 1 and 4, recall 1/2.
        let ap = average_precision([&picture], 0, 0.9, all).unwrap();
        assert!((ap - (26.0 + 25.0 * 0.5) / 101.0).abs() < 1e-12, "{ap}");
    }

    #[test]
    fn a_truth_is_found_once_and_by_the_surest() {
        let picture = Scored {
            truths: vec![truth(0.0, 10.0)],
            found: vec![found(1.0, 10.0, 0.5), found(2.0, 10.0, 0.9)],
        };
        assert_eq!(fates(&picture, 0.5, all), [Fate::False, Fate::Hit(0)]);
        // The false alarm comes after full recall: it costs nothing.
        assert_eq!(average_precision([&picture], 0, 0.5, all), Some(1.0));
    }

    #[test]
    fn the_order_over_pictures_is_by_score() {
        // The false alarm of the second picture is surer than the hit of the first: precision 1/2.
        let one = Scored { truths: vec![truth(0.0, 10.0)], found: vec![found(0.0, 10.0, 0.5)] };
        let two = Scored { truths: vec![], found: vec![found(0.0, 10.0, 0.6)] };
        assert_eq!(average_precision([&one, &two], 0, 0.5, all), Some(0.5));
    }

    #[test]
    fn what_is_ignored_counts_neither_way() {
        let hidden = Truth { ignored: true, ..truth(0.0, 40.0) };
        let picture = Scored {
            truths: vec![hidden, truth(100.0, 10.0)],
            found: vec![found(5.0, 10.0, 0.9), found(100.0, 10.0, 0.8)],
        };
        assert_eq!(fates(&picture, 0.5, all), [Fate::Ignored, Fate::Hit(1)]);
        assert_eq!(average_precision([&picture], 0, 0.5, all), Some(1.0));
        assert_eq!(average_precision([&picture], 1, 0.5, all), None);
    }

    #[test]
    fn a_range_of_heights_takes_truths_and_detections_out() {
        let picture = Scored {
            truths: vec![truth(0.0, 30.0), truth(100.0, 14.0)],
            found: vec![found(0.0, 30.0, 0.9), found(100.0, 14.0, 0.8), found(200.0, 14.0, 0.7)],
        };
        let tall = fates(&picture, 0.5, |height| height >= 24.0);
        assert_eq!(tall, [Fate::Hit(0), Fate::Ignored, Fate::Ignored]);
        let small = fates(&picture, 0.5, |height| height < 24.0);
        assert_eq!(small, [Fate::Ignored, Fate::Hit(1), Fate::False]);
    }

    #[test]
    fn means_leave_out_what_is_not_there() {
        assert_eq!(mean([Some(0.5), None, Some(1.0)]), Some(0.75));
        assert_eq!(mean([None]), None);
        assert_eq!(coco_ious().count(), 10);
    }
}
