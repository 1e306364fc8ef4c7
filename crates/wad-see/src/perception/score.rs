//! Scores detectors against the camera's ground truth (docs/detector.md).
//!
//! Two scores over the same frames. The *realism score* measures how much of our pictures a detector
//! trained elsewhere finds: recall at a score of 0.3 in groups of classes, since a van is a car to one
//! and a truck to another. *Average precision* is COCO's, class by class, for any detector.
//!
//! A hit overlaps the box of an object's visible pixels by an IoU of 0.5 or more. Objects with less than
//! [`LEAST_VISIBLE`] visible, or lower than the wanted height, count neither as misses nor as false alarms:
//! detections that lie in their box by half or more do not count.

use super::coco::{CLASSES, VEHICLES, class_index, class_name};
use super::metrics::{Fate, Found, Scored, Truth, average_precision, coco_ious, fates, mean};
use super::{Detection, LeastScore};
use serde::Serialize;
use std::collections::BTreeMap;
use wad_camera::model::ObjectClass;
use wad_camera::{Frame, ObjectTruth, Preset};

/// Least visible share of an object that counts.
pub const LEAST_VISIBLE: f32 = 0.3;
/// Score from which a detection counts.
pub const BELIEVED: f32 = 0.3;
/// Lowest box of the range that selects weights in training (pixels).
pub const TALL: f32 = 24.0;
/// Lowest box of the range that is reported apart (pixels).
pub const SMALL: f32 = 12.0;

/// Classes that count as one in the realism score.
pub struct Group {
    /// Its name in reports.
    pub name: &'static str,
    /// The classes that it has.
    pub classes: &'static [ObjectClass],
    /// Lowest box that counts (pixels).
    pub height: f32,
    /// Least recall wanted, if any.
    pub goal: Option<f64>,
}

/// The groups of the realism score.
pub const GROUPS: [Group; 5] = [
    Group { name: "car, bus, truck", classes: &VEHICLES, height: 32.0, goal: Some(0.5) },
    Group { name: "person", classes: &[ObjectClass::Person], height: 40.0, goal: Some(0.3) },
    Group {
        name: "motorcycle, bicycle",
        classes: &[ObjectClass::Motorcycle, ObjectClass::Bicycle],
        height: 40.0,
        goal: None,
    },
    Group { name: "traffic light", classes: &[ObjectClass::TrafficLight], height: 24.0, goal: None },
    Group { name: "bench", classes: &[ObjectClass::Bench], height: 24.0, goal: None },
];
/// Their indices.
const VEHICLE: usize = 0;
const PERSON: usize = 1;
/// False alarms per frame that are too many.
pub const FALSE_ALARM_GOAL: f64 = 1.0;

/// One frame to score.
pub struct View {
    /// The weather of the frame.
    pub weather: Preset,
    /// The camera's ground truth.
    pub objects: Vec<ObjectTruth>,
    /// The detections.
    pub found: Vec<Detection>,
}

/// Visible share of an object, 0 to 1: its visible pixels by the pixels that its kind fills of its whole box
/// (left, top, right, bottom).
fn visible_share(class: ObjectClass, visible_pixels: u32, [l, t, r, b]: [f32; 4]) -> f32 {
    let fill = match class {
        ObjectClass::Car | ObjectClass::Bus | ObjectClass::Truck => 0.7,
        ObjectClass::TrafficLight => 0.6,
        ObjectClass::Person | ObjectClass::Motorcycle | ObjectClass::Bicycle | ObjectClass::Bench => 0.4,
    };
    (visible_pixels as f32 / (fill * (r - l) * (b - t)).max(1.0)).min(1.0)
}

fn has_rider(class: ObjectClass) -> bool {
    matches!(class, ObjectClass::Motorcycle | ObjectClass::Bicycle)
}

/// An object to score a detector by, its label the index of its class: the box of its visible pixels (left, top, right,
/// bottom), or where too few are visible the box of the whole object, which is ignored.
pub fn truth(class: ObjectClass, visible_pixels: u32, visible: [u32; 4], full: [f32; 4]) -> Truth {
    let ignored = visible_share(class, visible_pixels, full) < LEAST_VISIBLE;
    let bounds = if ignored { full } else { visible.map(|v| v as f32) };
    Truth { label: class_index(class), bounds, ignored }
}

fn of_frame(object: &ObjectTruth) -> Truth {
    truth(object.class, object.visible_pixels, object.visible_box, object.full_box)
}

impl View {
    /// The frame's ground truth beside what a detector found in it.
    pub fn new(weather: Preset, frame: &Frame, found: &[Detection]) -> Self {
        Self { weather, objects: frame.objects.clone(), found: found.to_vec() }
    }

    /// For average precision: labels are indices of [`CLASSES`].
    pub fn by_class(&self) -> Scored {
        let found = |d: &Detection| Found { label: class_index(d.class), detection: *d };
        Scored {
            truths: self.objects.iter().map(of_frame).collect(),
            found: self.found.iter().map(found).collect(),
        }
    }

    /// For the realism score: labels are indices of [`GROUPS`]; only detections with a score of [`BELIEVED`]
    /// or more, and only objects as high as their group wants.
    pub fn by_group(&self) -> Scored {
        let mut scored = self.grouped(LeastScore::Fixed(BELIEVED));
        for truth in &mut scored.truths {
            truth.ignored |= truth.bounds[3] - truth.bounds[1] < GROUPS[truth.label].height;
        }
        scored
    }

    /// Labels are indices of [`GROUPS`]. A rider is part of the motorcycle or bicycle here and a person to COCO: people
    /// found on one do not count.
    fn grouped(&self, least: LeastScore) -> Scored {
        let group = |class| GROUPS.iter().position(|g| g.classes.contains(&class)).unwrap_or(0);
        let mut truths: Vec<Truth> = Vec::with_capacity(self.objects.len());
        for object in &self.objects {
            let one = Truth { label: group(object.class), ..of_frame(object) };
            truths.push(one);
            if has_rider(object.class) {
                truths.push(Truth { label: PERSON, ignored: true, ..one });
            }
        }
        let counts = |d: &&Detection| least.keeps(d, None);
        let found = self.found.iter().filter(counts);
        Scored { truths, found: found.map(|d| Found { label: group(d.class), detection: *d }).collect() }
    }
}

/// The realism score of some frames.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Realism {
    /// Number of frames.
    pub frames: usize,
    /// By the names of [`GROUPS`].
    pub groups: BTreeMap<&'static str, GroupScore>,
    /// By true class; any class of its group counts as found.
    pub classes: BTreeMap<&'static str, ClassScore>,
    /// False alarms of all groups per frame.
    pub false_alarms_per_frame: f64,
}

/// One group's part in it.
#[derive(Clone, Debug, Default, Serialize)]
pub struct GroupScore {
    /// Objects that count.
    pub truths: usize,
    /// Objects that were found.
    pub hits: usize,
    /// None without truths.
    pub recall: Option<f64>,
    /// Detections without an object.
    pub false_alarms: usize,
}

/// How many of one class's objects were found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct ClassScore {
    /// Objects that count.
    pub truths: usize,
    /// Objects that were found.
    pub hits: usize,
}

/// The realism score of these frames.
pub fn realism<'a>(views: impl IntoIterator<Item = &'a View>) -> Realism {
    let mut score = Realism::default();
    for group in &GROUPS {
        score.groups.insert(group.name, GroupScore::default());
    }
    let mut false_alarms = 0;
    for view in views {
        score.frames += 1;
        let scored = view.by_group();
        // Low truths are ignored already; detections of any height can be wrong.
        let fates = fates(&scored, 0.5, |_| true);
        // A cycle is two truths, the second of them its rider.
        let classes = view.objects.iter().flat_map(|object| {
            let count = if has_rider(object.class) { 2 } else { 1 };
            std::iter::repeat_n(class_name(object.class), count)
        });
        let classes: Vec<&'static str> = classes.collect();
        for (truth, class) in scored.truths.iter().zip(&classes).filter(|(t, _)| !t.ignored) {
            score.groups.entry(GROUPS[truth.label].name).or_default().truths += 1;
            score.classes.entry(class).or_default().truths += 1;
        }
        for (found, fate) in scored.found.iter().zip(fates) {
            let group = score.groups.entry(GROUPS[found.label].name).or_default();
            match fate {
                Fate::Hit(truth) => {
                    group.hits += 1;
                    score.classes.entry(classes[truth]).or_default().hits += 1;
                }
                Fate::False => {
                    group.false_alarms += 1;
                    false_alarms += 1;
                }
                Fate::Ignored => {}
            }
        }
    }
    for group in score.groups.values_mut() {
        group.recall = (group.truths > 0).then(|| group.hits as f64 / group.truths as f64);
    }
    score.false_alarms_per_frame = f64::from(false_alarms) / score.frames.max(1) as f64;
    score
}

/// Bounds of the heights that are told apart (pixels).
const HEIGHTS: [f32; 5] = [8.0, 16.0, 24.0, 40.0, f32::INFINITY];
/// Overlap from which a vehicle or somebody is found, for driving: the lower edge says how far away.
const FOUND_IOU: f32 = 0.4;

/// What of one group is found by height, and how many detections of that height are where nothing is, from some scores on.
#[derive(Clone, Debug, Serialize)]
pub struct BySureness {
    /// The group's name.
    pub group: &'static str,
    /// Lowest height (pixels).
    pub low: f32,
    /// The height (pixels) below which all are; None: any.
    pub high: Option<f32>,
    /// Objects that count.
    pub truths: usize,
    /// From each of [`sureness`]'s least scores on.
    pub from: Vec<Sureness>,
}

/// A part of it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Sureness {
    /// The least score; None: [`LeastScore::Usual`] by height, without its rule of free road.
    pub least: Option<f32>,
    /// Share of the objects that are found; None without any.
    pub recall: Option<f64>,
    /// Detections a frame where nothing is.
    pub false_alarms_per_frame: f64,
}

/// Vehicles and people by height, from several scores on ("How sure is sure enough" in docs/detector.md): those of which
/// detections with `kept` or more leave none out.
pub fn sureness(views: &[View], kept: f32) -> Vec<BySureness> {
    let lowest = |least: &Option<f32>| least.unwrap_or(LeastScore::Usual.of(f32::INFINITY));
    let least = [Some(0.2), Some(0.3), Some(0.4), None].into_iter().filter(|least| lowest(least) >= kept);
    let grouped = |least| -> Vec<Scored> { views.iter().map(|view| view.grouped(least)).collect() };
    let all = grouped(LeastScore::Fixed(kept));
    let from = |least: Option<f32>| (least, grouped(least.map_or(LeastScore::Usual, LeastScore::Fixed)));
    let scored: Vec<_> = least.map(from).collect();
    let row = |label: usize, low: f32, high: f32| {
        let is_in = |height: f32| (low..high).contains(&height);
        let is_one = |t: &&Truth| t.label == label && !t.ignored && is_in(t.bounds[3] - t.bounds[1]);
        let truths = all.iter().map(|view| view.truths.iter().filter(is_one).count()).sum();
        let from = |(least, views): &(Option<f32>, Vec<Scored>)| {
            let (mut hits, mut wrong) = (0_usize, 0_usize);
            for view in views {
                for (found, fate) in view.found.iter().zip(fates(view, FOUND_IOU, is_in)) {
                    hits += usize::from(found.label == label && matches!(fate, Fate::Hit(_)));
                    wrong += usize::from(found.label == label && fate == Fate::False);
                }
            }
            let recall = (truths > 0).then(|| hits as f64 / truths as f64);
            let false_alarms_per_frame = wrong as f64 / views.len().max(1) as f64;
            Sureness { least: *least, recall, false_alarms_per_frame }
        };
        let high = high.is_finite().then_some(high);
        BySureness { group: GROUPS[label].name, low, high, truths, from: scored.iter().map(from).collect() }
    };
    let bands = |label| HEIGHTS.windows(2).map(move |w| (label, w[0], w[1]));
    [VEHICLE, PERSON].into_iter().flat_map(bands).map(|(label, low, high)| row(label, low, high)).collect()
}

/// Average precision of one class, or the mean of all.
#[derive(Clone, Debug, Serialize)]
pub struct Precision {
    /// The class's name, or `all`.
    pub class: &'static str,
    /// Objects at least [`TALL`] high, visible enough.
    pub truths: usize,
    /// Average precision at an IoU of 0.5; None without truths.
    pub ap50: Option<f64>,
    /// Mean average precision over IoUs of 0.5 to 0.95; None without truths.
    pub ap: Option<f64>,
    /// Objects from [`SMALL`] to [`TALL`] high.
    pub truths_small: usize,
    /// Their average precision at an IoU of 0.5; None without truths.
    pub ap50_small: Option<f64>,
}

/// Class by class, and last the mean over classes, called `all`.
pub fn precision(views: &[&View]) -> Vec<Precision> {
    let scored: Vec<Scored> = views.iter().map(|v| v.by_class()).collect();
    let tall = |height: f32| height >= TALL;
    let small = |height: f32| (SMALL..TALL).contains(&height);
    let count = |label: usize, counts: &dyn Fn(f32) -> bool| {
        let judged = |t: &&Truth| t.label == label && !t.ignored && counts(t.bounds[3] - t.bounds[1]);
        scored.iter().map(|s| s.truths.iter().filter(judged).count()).sum::<usize>()
    };
    let mut rows: Vec<Precision> = CLASSES
        .iter()
        .enumerate()
        .map(|(label, &class)| Precision {
            class: class_name(class),
            truths: count(label, &tall),
            ap50: average_precision(&scored, label, 0.5, tall),
            ap: mean(coco_ious().map(|iou| average_precision(&scored, label, iou, tall))),
            truths_small: count(label, &small),
            ap50_small: average_precision(&scored, label, 0.5, small),
        })
        .collect();
    rows.push(Precision {
        class: "all",
        truths: rows.iter().map(|r| r.truths).sum(),
        ap50: mean(rows.iter().map(|r| r.ap50)),
        ap: mean(rows.iter().map(|r| r.ap)),
        truths_small: rows.iter().map(|r| r.truths_small).sum(),
        ap50_small: mean(rows.iter().map(|r| r.ap50_small)),
    });
    rows
}

#[cfg(test)]
mod tests {
    use super::*;
    use sumo_network::geometry::Pose;
    use wad_camera::model::Box3;

    fn object(class: ObjectClass, at: [u32; 4]) -> ObjectTruth {
        let full_box = at.map(|v| v as f32);
        let area = (at[2] - at[0]) * (at[3] - at[1]);
        let bounds = Box3 { pose: Pose::new(0.0, 0.0, 0.0, 0.0), size: [1.0; 3] };
        ObjectTruth { class, id: 1, visible_pixels: area / 2, visible_box: at, full_box, bounds, depth: 9.0 }
    }

    fn seen(class: ObjectClass, at: [f32; 4], score: f32) -> Detection {
        Detection { class, bounds: at, score }
    }

    #[test]
    fn a_van_called_a_truck_is_a_hit_and_a_rider_is_no_false_alarm() {
        let view = View {
            weather: Preset::ClearNoon,
            objects: vec![
                object(ObjectClass::Car, [0, 0, 60, 40]),
                object(ObjectClass::Bicycle, [100, 0, 130, 60]),
                object(ObjectClass::Car, [200, 0, 220, 12]), // low
                object(ObjectClass::Car, [300, 0, 360, 40]), // missed
            ],
            found: vec![
                seen(ObjectClass::Truck, [0.0, 0.0, 60.0, 40.0], 0.5),
                seen(ObjectClass::Person, [102.0, 0.0, 128.0, 50.0], 0.9),
                seen(ObjectClass::Car, [200.0, 0.0, 220.0, 12.0], 0.4),
                seen(ObjectClass::Car, [400.0, 0.0, 420.0, 12.0], 0.4),
                seen(ObjectClass::Car, [440.0, 0.0, 460.0, 12.0], 0.2), // not believed
            ],
        };
        let score = realism([&view]);
        let cars = &score.groups["car, bus, truck"];
        assert_eq!((cars.truths, cars.hits, cars.false_alarms), (2, 1, 1));
        assert_eq!(score.classes["car"], ClassScore { truths: 2, hits: 1 });
        assert_eq!(score.classes["bicycle"], ClassScore { truths: 1, hits: 0 });
        assert_eq!(score.classes.len(), 2);
        assert_eq!(score.groups["person"].false_alarms, 0);
        assert_eq!(score.false_alarms_per_frame, 1.0);
        // By class the truck is wrong, and the two cars 24 px or more are missed.
        let rows = precision(&[&view]);
        assert_eq!((rows[0].truths, rows[0].ap50), (2, Some(0.0)));
        assert_eq!((rows[0].truths_small, rows[0].ap50_small), (1, Some(1.0)));
    }

    #[test]
    fn what_is_found_by_height_from_a_score_on() {
        let view = View {
            weather: Preset::ClearNoon,
            objects: vec![
                object(ObjectClass::Car, [0, 0, 60, 50]),
                object(ObjectClass::Car, [100, 0, 160, 50]),
                object(ObjectClass::Car, [200, 0, 230, 20]),
            ],
            found: vec![
                seen(ObjectClass::Truck, [0.0, 0.0, 60.0, 40.0], 0.35),
                seen(ObjectClass::Car, [100.0, 0.0, 160.0, 25.0], 0.9),
                seen(ObjectClass::Car, [200.0, 0.0, 230.0, 20.0], 0.35),
                seen(ObjectClass::Car, [300.0, 0.0, 360.0, 50.0], 0.3),
            ],
        };
        let rows = sureness(std::slice::from_ref(&view), 0.2);
        let row = |low: f32| {
            let row = rows.iter().find(|row| row.group == "car, bus, truck" && row.low == low).unwrap();
            (
                row.truths,
                row.from.iter().map(|s| (s.recall.unwrap(), s.false_alarms_per_frame)).collect::<Vec<_>>(),
            )
        };
        // Half of the second car is enough. What agents drive by: 0.3 for the large ones, 0.36 for one of 20 px.
        assert_eq!(row(40.0), (2, vec![(1.0, 1.0), (1.0, 1.0), (0.5, 0.0), (1.0, 1.0)]));
        assert_eq!(row(16.0), (1, vec![(1.0, 0.0), (1.0, 0.0), (0.0, 0.0), (0.0, 0.0)]));
        assert!(rows.iter().filter(|row| row.group == "person").all(|row| row.truths == 0));
        let left = sureness(&[view], 0.35);
        assert!(left.iter().all(|row| row.from.iter().map(|s| s.least).eq([Some(0.4)])));
    }

    #[test]
    fn what_is_hidden_is_not_judged() {
        let mut hidden = object(ObjectClass::Person, [0, 0, 40, 100]);
        hidden.visible_pixels = 300;
        hidden.visible_box = [0, 0, 10, 60];
        let found = vec![seen(ObjectClass::Person, [0.0, 0.0, 40.0, 100.0], 0.9)];
        let view = View { weather: Preset::ClearNoon, objects: vec![hidden], found };
        let score = realism([&view]);
        assert_eq!(score.groups["person"].truths, 0);
        assert_eq!(score.false_alarms_per_frame, 0.0);
    }
}
