//! Traffic signs: which of a town's are to be seen in a picture, and the limit that those passed have set.

use serde::{Deserialize, Serialize};
use sumo_network::geometry::{Point, Pose, Vector, wrap_angle};
use wad_camera::model::{PlacedSign, Sign};
use wad_camera::{Frame, View};

/// A sign in a picture: a label.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SignTruth {
    /// What it says.
    pub sign: Sign,
    /// The box of its plate (left, top, right, bottom; pixels).
    pub bounds: [f32; 4],
    /// From the camera, along its axis (m).
    pub distance: f32,
    /// It is large and plain enough, and faces the camera enough, to be read.
    pub is_plain: bool,
}

/// A plate as high as this is a sign in a picture, and is to be read (pixels).
const LEAST: f32 = 4.0;
const READ: f32 = 7.0;
/// Plates that are turned away further than this are not to be seen, or not to be read (rad).
const SEEN_TURN: f64 = 1.2;
const READ_TURN: f64 = 0.6;

impl SignTruth {
    /// How far a place in the picture is from its middle, across or down (pixels).
    pub fn away(&self, [x, y]: [f32; 2]) -> f32 {
        let [l, t, r, b] = self.bounds;
        (x - 0.5 * (l + r)).abs().max((y - 0.5 * (t + b)).abs())
    }

    /// Those of a town's `signs` that a frame with depth shows from `view`.
    pub fn find(signs: &[PlacedSign], view: &View, frame: &Frame) -> Vec<Self> {
        let mut found = Vec::new();
        for one in signs {
            let turn = wrap_angle(one.pose.heading - view.heading).abs();
            let Some(([u, v], distance)) = view.pixel(&one.pose.position).filter(|_| turn < SEEN_TURN) else {
                continue;
            };
            let radius = view.focal * one.sign.radius() / distance;
            let (w, h) = (frame.width as f32, frame.height as f32);
            if 2.0 * radius < LEAST || !(0.0..w).contains(&u) || !(0.0..h).contains(&v) {
                continue;
            }
            // Its middle and four points half-way to its rim.
            let shown = [(0.0, 0.0), (0.5, 0.0), (-0.5, 0.0), (0.0, 0.5), (0.0, -0.5)].into_iter().filter(
                |(x, y)| {
                    let (x, y) = (u + x * radius, v + y * radius);
                    let is_inside = (0.0..w).contains(&x) && (0.0..h).contains(&y);
                    let at = || frame.depth.get(y as usize * frame.width + x as usize);
                    is_inside && at().is_some_and(|depth| (depth - distance).abs() < 0.5 + 0.01 * distance)
                },
            );
            let shown = shown.count();
            if shown > 0 {
                let is_plain = shown >= 4 && 2.0 * radius >= READ && turn < READ_TURN;
                let bounds = [u - radius, v - radius, u + radius, v + radius];
                found.push(Self { sign: one.sign, bounds, distance, is_plain });
            }
        }
        found
    }
}

/// A sign that a network read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SeenSign {
    /// What it says.
    pub sign: Sign,
    /// Its middle: x ahead, y left of the ego's centre (m).
    pub at: [f32; 2],
    /// The same in the picture (pixels).
    pub pixel: [f32; 2],
    /// Its plate's radius in the picture (pixels).
    pub radius: f32,
    /// 0 to 1.
    pub certainty: f32,
}

/// From this certainty on one picture is enough.
const SURE_AT_ONCE: f32 = 0.6;

impl SeenSign {
    /// Sure enough to count by this picture alone: lamps and leaves are taken for signs, but seldom surely.
    pub fn is_sure(&self) -> bool {
        self.certainty >= SURE_AT_ONCE
    }
}

/// The limit before the first sign (km/h): the general one within towns in most of Europe.
pub const IN_TOWNS: u32 = 50;

/// The speed limit that signs have set, from tick to tick: that of the last one which the ego has passed.
#[derive(Clone, Debug, Default)]
pub struct SeenLimit {
    tracks: Vec<Track>,
    /// Where the ego was when it last counted what it saw.
    looked: Option<Point>,
    /// km/h.
    in_force: Option<u32>,
}

/// A sign from tick to tick.
#[derive(Clone, Debug)]
struct Track {
    /// By the ego's own motion, in the frame of its pose (m).
    at: Point,
    weight: f64,
    /// The ego's heading when it was last seen (rad).
    heading: f64,
    votes: [f32; Sign::KINDS],
}

/// Places of a sign in two pictures lie within this, and this share of its distance (m).
const SAME: (f64, f64) = (2.0, 0.2);
/// From this far on (m) digits grow too small: what is read counts less, by the square of the distance.
const CLEAR: f64 = 10.0;
/// The ego moves at least this far between pictures that count (m).
const STEP: f64 = 0.5;
/// How sure all pictures together must be of a sign that sets a limit.
const SURE: f32 = 1.4;
/// A sign that sets the ego's limit is passed at most this far to the side (m), without a turn (rad).
const ASIDE: f64 = 9.0;
const TURN: f64 = 0.6;
/// A sign is passed where it is less than this ahead (m): there it has left the picture.
const PASSED: f64 = 2.0;

impl SeenLimit {
    /// Forgets everything.
    pub fn reset(&mut self) {
        *self = Self::default();
    }

    /// The limit that a sign has set (km/h) with the ego at `pose`, by its own count of its way, after what this picture
    /// shows; None before the first sign.
    pub fn update(&mut self, seen: &[SeenSign], pose: &Pose) -> Option<u32> {
        // Who stands sees the same again and again.
        let moved = self.looked.is_none_or(|at| (pose.xy() - at).norm() >= STEP);
        if moved {
            self.looked = Some(pose.xy());
        }
        for sign in seen.iter().filter(|_| moved) {
            let [x, y] = sign.at.map(f64::from);
            let at = pose.to_world(Vector::new(x, y));
            let near = SAME.0 + SAME.1 * x;
            let weight = f64::from(sign.certainty) / (x * x).max(1.0);
            let distances = self.tracks.iter().map(|track| (track.at - at).norm()).enumerate();
            let nearest = distances.filter(|(_, away)| *away < near).min_by(|a, b| a.1.total_cmp(&b.1));
            let number = nearest.map_or(self.tracks.len(), |(number, _)| number);
            if number == self.tracks.len() {
                self.tracks.push(Track { at, weight: 0.0, heading: pose.heading, votes: [0.0; Sign::KINDS] });
            }
            let track = &mut self.tracks[number];
            track.weight += weight;
            track.at += (at - track.at) * (weight / track.weight);
            track.heading = pose.heading;
            // Digits are two pixels high at 25 m.
            let read = (CLEAR / x.max(1.0)).powi(2).min(1.0) as f32;
            track.votes[sign.sign.index()] += sign.certainty * read;
        }
        let mut passed: Option<u32> = None;
        self.tracks.retain(|track| {
            let place = pose.to_local(track.at);
            if place.x > PASSED {
                return place.norm() < 60.0;
            }
            let is_his = place.y.abs() < ASIDE && wrap_angle(track.heading - pose.heading).abs() < TURN;
            let all: f32 = track.votes.iter().sum();
            let best = (0..Sign::KINDS).max_by(|&a, &b| track.votes[a].total_cmp(&track.votes[b]));
            if let (true, Some(Sign::Limit(kmh))) = (is_his && all >= SURE, best.map(Sign::of)) {
                passed = Some(kmh);
            }
            false
        });
        self.in_force = passed.or(self.in_force);
        self.in_force
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perception::testing::Road;
    use sumo_network::network::Shapes;
    use wad_camera::scene::Look;
    use wad_camera::{Camera, CameraConfig, Outputs, Preset, Town, Weather};

    #[test]
    fn every_sign_has_a_number() {
        for index in 0..Sign::KINDS {
            assert_eq!(Sign::of(index).index(), index);
        }
    }

    #[test]
    fn a_sign_in_view_is_a_label_and_a_hidden_one_is_none() {
        let road = Road::new("rGG");
        let look = Look { many_signs: true, ..Look::of(1) };
        let town = Town::new(&road.network, &Shapes::default(), look);
        let signs = &town.scene().signs;
        assert!(signs.len() > Town::new(&road.network, &Shapes::default(), Look::of(1)).scene().signs.len());
        let config = CameraConfig::default();
        let mut camera = Camera::new(config).unwrap();
        let outputs = Outputs { depth: true, ..Outputs::RGB };
        let mut read = 0;
        for sign in signs {
            let at = sign.pose.to_world(Vector::new(-12.0, 3.0));
            let pose = Pose::new(at.x, at.y, 0.0, sign.pose.heading);
            let weather = Weather::from(Preset::ClearNoon);
            let frame = camera.render(town.scene(), town.actors(), &pose, &weather, outputs);
            let view = View::new(&config, &pose);
            let near = |found: &&SignTruth| (found.distance - 11.3).abs() < 0.1 && found.sign == sign.sign;
            let found = SignTruth::find(signs, &view, frame);
            let label = found.iter().find(near);
            if let Some(label) = label {
                read += usize::from(label.is_plain);
                let wide = label.bounds[2] - label.bounds[0];
                assert!((12.0..26.0).contains(&wide), "{wide}");
            }
            let wall = Frame { depth: vec![5.0; frame.depth.len()], ..frame.clone() };
            assert!(!SignTruth::find(signs, &view, &wall).iter().any(|found| near(&found)));
            let behind = View::new(&config, &Pose { heading: pose.heading + 3.0, ..pose });
            assert!(!SignTruth::find(signs, &behind, frame).iter().any(|found| near(&found)));
        }
        // Trees and the like hide some.
        assert!(2 * read > signs.len(), "{read} of {}", signs.len());
    }

    #[test]
    fn the_limit_is_that_of_the_last_sign_that_was_passed() {
        let mut limit = SeenLimit::default();
        // A sign at x, y (m) as an ego at (s, 0) sees it.
        let seen = |sign, [x, y]: [f32; 2], s: f64, certainty| {
            let at = [x - s as f32, y];
            vec![SeenSign { sign, at, pixel: [0.0; 2], radius: 0.0, certainty }]
        };
        let at = |s: f64, heading: f64| Pose::new(s, 0.0, 0.0, heading);
        let drive = |limit: &mut SeenLimit, sign, x: f32, certainty| {
            for s in 0..20 {
                let s = f64::from(s);
                limit.update(
                    &seen(sign, [x, -3.0], s + f64::from(x) - 25.0, certainty),
                    &at(s + f64::from(x) - 25.0, 0.0),
                );
            }
            limit.update(&[], &at(f64::from(x), 0.0))
        };
        assert_eq!(
            limit.update(&seen(Sign::Limit(50), [20.0, -3.0], 0.0, 0.9), &at(0.0, 0.0)),
            None,
            "not passed"
        );
        assert_eq!(limit.update(&[], &at(19.0, 0.0)), None, "one picture is not enough");
        assert_eq!(drive(&mut limit, Sign::Limit(50), 60.0, 0.9), Some(50));
        // Other signs leave it, and so do those of a road that the ego turns away from.
        assert_eq!(drive(&mut limit, Sign::Stop, 120.0, 0.9), Some(50));
        for s in 0..10 {
            limit.update(
                &seen(Sign::Limit(30), [220.0, -3.0], 200.0 + f64::from(s), 0.9),
                &at(200.0 + f64::from(s), 0.0),
            );
        }
        assert_eq!(limit.update(&[], &at(210.0, 1.6)), Some(50));
        assert_eq!(limit.update(&[], &at(219.0, 1.6)), Some(50));
        assert_eq!(drive(&mut limit, Sign::Limit(30), 300.0, 0.9), Some(30));
    }
}
