//! COCO's eighty classes as our eight, and the suppression of boxes found twice.

use super::Detection;
use wad_camera::model::ObjectClass;

/// The classes in the order of our networks' outputs.
pub const CLASSES: [ObjectClass; 8] = [
    ObjectClass::Car,
    ObjectClass::Motorcycle,
    ObjectClass::Bicycle,
    ObjectClass::Person,
    ObjectClass::Bus,
    ObjectClass::Truck,
    ObjectClass::TrafficLight,
    ObjectClass::Bench,
];

/// A class as tables and files call it.
pub fn class_name(class: ObjectClass) -> &'static str {
    match class {
        ObjectClass::Car => "car",
        ObjectClass::Motorcycle => "motorcycle",
        ObjectClass::Bicycle => "bicycle",
        ObjectClass::Person => "person",
        ObjectClass::Bus => "bus",
        ObjectClass::Truck => "truck",
        ObjectClass::TrafficLight => "traffic light",
        ObjectClass::Bench => "bench",
    }
}

/// Index of a class in [`CLASSES`].
pub fn class_index(class: ObjectClass) -> usize {
    CLASSES.iter().position(|&c| c == class).unwrap_or(0)
}

/// The class of output channel `channel` of a network with `channels` classes: COCO's 80 in its
/// order, or our eight in ours. None for a class that is not ours.
pub fn class_of(channel: usize, channels: usize) -> Option<ObjectClass> {
    use ObjectClass::{Bench, Bicycle, Bus, Car, Motorcycle, Person, TrafficLight, Truck};
    match channels {
        8 => CLASSES.get(channel).copied(),
        80 => match channel {
            0 => Some(Person),
            1 => Some(Bicycle),
            2 => Some(Car),
            3 => Some(Motorcycle),
            5 => Some(Bus),
            7 => Some(Truck),
            9 => Some(TrafficLight),
            13 => Some(Bench),
            _ => None,
        },
        _ => None,
    }
}

/// Keeps the best of the boxes of one class that overlap by more than `iou`; sorts best first.
pub fn suppress(found: &mut Vec<Detection>, iou: f32) {
    found.sort_by(|a, b| b.score.total_cmp(&a.score));
    let mut kept: Vec<Detection> = Vec::with_capacity(found.len());
    for candidate in found.drain(..) {
        if kept.iter().all(|k| k.class != candidate.class || k.iou(&candidate.bounds) <= iou) {
            kept.push(candidate);
        }
    }
    *found = kept;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_better_of_two_overlapping_boxes_of_a_class_stays() {
        let at = |class, left: f32, score| Detection { class, bounds: [left, 0.0, left + 10.0, 10.0], score };
        let mut found = vec![
            at(ObjectClass::Car, 0.0, 0.5),
            at(ObjectClass::Car, 1.0, 0.9),
            at(ObjectClass::Bus, 1.0, 0.4),
            at(ObjectClass::Car, 9.0, 0.3),
        ];
        suppress(&mut found, 0.5);
        let scores: Vec<f32> = found.iter().map(|d| d.score).collect();
        assert_eq!(scores, [0.9, 0.4, 0.3]);
    }

    #[test]
    fn channels_of_both_kinds_of_network_find_their_class() {
        assert_eq!(class_of(9, 80), Some(ObjectClass::TrafficLight));
        assert_eq!(class_of(4, 80), None);
        for (n, class) in CLASSES.into_iter().enumerate() {
            assert_eq!(class_of(n, 8), Some(class));
            assert_eq!(class_index(class), n);
        }
    }
}
