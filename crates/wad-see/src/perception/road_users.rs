//! Road users on the ground: place and velocity of each detected vehicle and person, by a Kalman filter over the ticks.
//! Nothing here comes from SUMO.

use super::lead::SIGHT;
use super::{Detection, EgoFacts, GroundPlane};
use nalgebra::{Matrix2, Matrix4, Matrix4x2};
use sumo_network::geometry::{Point, Vector, direction};
use wad_camera::model::ObjectClass;

/// Ticks without a detection until a track is dropped.
const COAST: u32 = 3;

/// The kinds of road users that are tracked separately.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Vehicle,
    TwoWheeler,
    Person,
}

impl Kind {
    fn of(class: ObjectClass) -> Option<Self> {
        match class {
            ObjectClass::Car | ObjectClass::Truck | ObjectClass::Bus => Some(Self::Vehicle),
            ObjectClass::Motorcycle | ObjectClass::Bicycle => Some(Self::TwoWheeler),
            ObjectClass::Person => Some(Self::Person),
            ObjectClass::TrafficLight | ObjectClass::Bench => None,
        }
    }
    /// Standard deviations of the acceleration (m/s2) and of a new track's speed (m/s).
    fn doubts(self) -> (f64, f64) {
        match self {
            Self::Vehicle => (2.0, 8.0),
            Self::TwoWheeler => (1.5, 5.0),
            Self::Person => (0.7, 1.5),
        }
    }
    /// Slower ones are taken to stand (m/s).
    pub(super) fn slowest(self) -> f64 {
        match self {
            Self::Vehicle | Self::TwoWheeler => 1.5,
            Self::Person => 0.5,
        }
    }
    /// Half its length and half its breadth (m).
    pub(super) fn half(self) -> [f64; 2] {
        match self {
            Self::Vehicle => [2.2, 0.9],
            Self::TwoWheeler => [0.9, 0.3],
            Self::Person => [0.3, 0.3],
        }
    }
    /// How far (m) a detection may be from where one was expected.
    fn gate(self) -> f64 {
        match self {
            Self::Vehicle => 3.0,
            Self::TwoWheeler => 2.0,
            Self::Person => 1.0,
        }
    }
}

/// A road user on the ground, in the world's frame.
#[derive(Clone, Copy, Debug)]
pub struct RoadUser {
    pub(super) kind: Kind,
    /// m.
    pub place: Vector,
    /// m/s.
    pub velocity: Vector,
    /// Covariance of both.
    pub(super) p: Matrix4<f64>,
    /// Detections of it.
    pub(super) seen: u32,
    missed: u32,
}

/// A detection on the ground, in the world's frame.
struct Sighting {
    kind: Kind,
    place: Vector,
    /// Covariance (m2).
    noise: Matrix2<f64>,
}

/// Follows road users over the ticks.
#[derive(Clone, Debug, Default)]
pub struct RoadUsers {
    users: Vec<RoadUser>,
}

impl RoadUsers {
    /// All that are followed.
    pub fn iter(&self) -> impl Iterator<Item = &RoadUser> {
        self.users.iter()
    }

    /// Forgets.
    pub fn reset(&mut self) {
        self.users.clear();
    }

    /// One tick later.
    pub fn update(&mut self, detections: &[Detection], ground: &GroundPlane, facts: &EgoFacts<'_>) {
        for user in &mut self.users {
            user.predict(facts.tick);
        }
        let mut sightings: Vec<Sighting> =
            detections.iter().filter_map(|detection| sight(detection, ground, facts)).collect();
        for user in &mut self.users {
            let distance = |sighting: &Sighting| (sighting.place - user.place).norm();
            let mine = |sighting: &Sighting| {
                // The nearest of its kind within what both are unsure of.
                let along = sighting.noise.trace().sqrt();
                sighting.kind == user.kind && distance(sighting) < user.kind.gate() + 2.0 * along
            };
            let nearest = (0..sightings.len())
                .filter(|&i| mine(&sightings[i]))
                .min_by(|&a, &b| distance(&sightings[a]).total_cmp(&distance(&sightings[b])));
            match nearest {
                Some(index) => user.correct(&sightings.swap_remove(index)),
                None => user.missed += 1,
            }
        }
        self.users.retain(|user| user.missed <= COAST);
        self.users.extend(sightings.iter().map(RoadUser::new));
    }
}

/// Where a detection stands, unless the picture's border cuts it.
fn sight(detection: &Detection, ground: &GroundPlane, facts: &EgoFacts<'_>) -> Option<Sighting> {
    let kind = Kind::of(detection.class)?;
    if ground.cuts(detection.bounds).contains(&true) {
        return None;
    }
    let [left, _, right, bottom] = detection.bounds;
    let [x, y] = ground.point([0.5 * (left + right), bottom])?;
    if f64::from(x) > SIGHT + facts.length {
        return None;
    }
    let pose = &facts.on_route.state.pose;
    let place = pose.to_world(Point::new(f64::from(x), f64::from(y)).coords).coords;
    // Along the ray a row's height, across it little.
    let far = 0.3 + 0.5 * f64::from(ground.metres_per_row(x));
    let across = 0.2 + 0.01 * f64::from(x);
    let ray = direction(pose.heading + f64::from(y).atan2(f64::from(x)));
    let side = Vector::new(-ray.y, ray.x);
    let noise = ray * ray.transpose() * (far * far) + side * side.transpose() * (across * across);
    Some(Sighting { kind, place, noise })
}

impl RoadUser {
    /// One of whom all is known.
    pub(super) fn known(kind: Kind, place: Vector, velocity: Vector) -> Self {
        Self { kind, place, velocity, p: Matrix4::zeros(), seen: u32::MAX, missed: 0 }
    }

    fn new(sighting: &Sighting) -> Self {
        let (_, doubt) = sighting.kind.doubts();
        let mut p = Matrix4::zeros();
        p.fixed_view_mut::<2, 2>(0, 0).copy_from(&sighting.noise);
        p.fixed_view_mut::<2, 2>(2, 2).copy_from(&(Matrix2::identity() * (doubt * doubt)));
        Self { kind: sighting.kind, place: sighting.place, velocity: Vector::zeros(), p, seen: 1, missed: 0 }
    }

    fn predict(&mut self, tick: f64) {
        self.place += self.velocity * tick;
        let mut a = Matrix4::identity();
        (a[(0, 2)], a[(1, 3)]) = (tick, tick);
        let (acceleration, _) = self.kind.doubts();
        let (place, speed) = (0.5 * tick * tick, tick);
        let push = Matrix4x2::from_column_slice(&[place, 0.0, speed, 0.0, 0.0, place, 0.0, speed]);
        self.p = a * self.p * a.transpose() + push * push.transpose() * (acceleration * acceleration);
    }

    fn correct(&mut self, sighting: &Sighting) {
        let total = self.p.fixed_view::<2, 2>(0, 0).into_owned() + sighting.noise;
        // Both are positive definite, and so is their sum.
        let Some(inverse) = total.try_inverse() else { return };
        let gain: Matrix4x2<f64> = self.p.fixed_view::<4, 2>(0, 0) * inverse;
        let change = gain * (sighting.place - self.place);
        self.place += change.fixed_rows::<2>(0);
        self.velocity += change.fixed_rows::<2>(2);
        self.p -= gain * self.p.fixed_view::<2, 4>(0, 0);
        self.seen += 1;
        self.missed = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perception::testing::{Road, seen};
    use wad_camera::CameraConfig;

    #[test]
    fn nothing_is_kept_after_a_reset() {
        let mut users = RoadUsers::default();
        let (road, ground) = (Road::new("GGG"), GroundPlane::new(&CameraConfig::default()));
        let facts = road.facts(60.0, 0.0, 0.0, 8.0);
        users.update(&[seen(ObjectClass::Car, 20.0, 0.0, 1.8, 1.5)], &ground, &facts);
        assert_eq!(users.iter().count(), 1);
        users.reset();
        assert!(users.iter().next().is_none());
    }
}
