//! COCO's eighty classes as our eight, the suppression of boxes found twice, and vehicles that may be of several classes.

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

/// Classes that look alike from behind, and count as one in the realism score.
pub const VEHICLES: [ObjectClass; 3] = [ObjectClass::Car, ObjectClass::Bus, ObjectClass::Truck];

/// Boxes of a car, a bus and a truck that overlap by more than `iou` are guesses at one vehicle. The surest becomes as sure
/// as that it is any of them, 1 - (1 - a)(1 - b): a van close ahead may be a car by 0.35 and a truck by 0.3. The others
/// stay as they are. `found` is sorted best first ([`suppress`]) and stays so.
pub fn join_guesses(found: &mut [Detection], iou: f32) {
    let is_vehicle = |d: &Detection| VEHICLES.contains(&d.class);
    // Of each first guess: its index, and how likely it is none of the others.
    let mut firsts: Vec<(usize, f32)> = Vec::new();
    for (index, one) in found.iter().enumerate().filter(|(_, one)| is_vehicle(one)) {
        let same = |(first, _): &&mut (usize, f32)| {
            found[*first].class != one.class && found[*first].iou(&one.bounds) > iou
        };
        match firsts.iter_mut().find(same) {
            Some((_, none)) => *none *= 1.0 - one.score,
            None => firsts.push((index, 1.0)),
        }
    }
    for (first, none) in firsts.into_iter().filter(|(_, none)| *none < 1.0) {
        found[first].score = 1.0 - (1.0 - found[first].score) * none;
    }
    found.sort_by(|a, b| b.score.total_cmp(&a.score));
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(class: ObjectClass, left: f32, score: f32) -> Detection {
        Detection { class, bounds: [left, 0.0, left + 10.0, 10.0], score }
    }

    #[test]
    fn a_van_that_may_be_a_car_or_a_truck_is_surely_a_vehicle() {
        let mut found = vec![
            at(ObjectClass::Car, 9.0, 0.5),
            at(ObjectClass::Car, 0.0, 0.4),
            at(ObjectClass::Truck, 1.0, 0.3),
            at(ObjectClass::Person, 0.0, 0.2),
            at(ObjectClass::Bus, 0.0, 0.1),
        ];
        join_guesses(&mut found, 0.6);
        let seen: Vec<(ObjectClass, f32)> =
            found.iter().map(|d| (d.class, (1000.0 * d.score).round())).collect();
        // 1 - 0.6 * 0.7 * 0.9; the car beside it is another.
        let [car, truck, bus] = [ObjectClass::Car, ObjectClass::Truck, ObjectClass::Bus];
        let wanted = [(car, 622.0), (car, 500.0), (truck, 300.0), (ObjectClass::Person, 200.0), (bus, 100.0)];
        assert_eq!(seen, wanted);
        assert_eq!(found[0].bounds[0], 0.0);
    }

    #[test]
    fn the_better_of_two_overlapping_boxes_of_a_class_stays() {
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
