//! Road users on the ground: place and velocity of each detected vehicle and person, by a Kalman filter over the ticks.
//! Nothing here comes from SUMO.

use super::{Detection, GroundPlane};
use nalgebra::{Matrix2, Matrix4, Matrix4x2};
use sumo_network::geometry::{Point, Pose, Vector, direction};
use wad_camera::model::ObjectClass;

/// Road users are followed within this distance (m): two who come towards each other at 15 m/s know of each other for 3 s.
const OUTLOOK: f64 = 90.0;
/// Ticks without a detection until a track is dropped: in the picture, and beside it.
const COAST: u32 = 3;
const ASIDE: u32 = 12;
/// Who is faster than this (m/s) rides.
const RIDES: f64 = 3.0;

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
    /// Whether one can be taken for the other.
    fn is_like(self, other: Self) -> bool {
        (self == Self::Vehicle) == (other == Self::Vehicle)
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
    /// Its number, from the first detection on.
    pub id: u64,
    pub(super) kind: Kind,
    /// Detections as a two-wheeler less those as a person.
    rides: i32,
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
    /// Of each detection of the last tick: the number of its road user.
    of: Vec<Option<u64>>,
    next: u64,
}

impl RoadUsers {
    /// All that are followed.
    pub fn iter(&self) -> impl Iterator<Item = &RoadUser> {
        self.users.iter()
    }

    /// Forgets.
    pub fn reset(&mut self) {
        self.users.clear();
        self.of.clear();
    }

    /// The road user whose detection, by its place among those of the last tick, this is; None: it is not followed.
    pub fn of(&self, detection: usize) -> Option<&RoadUser> {
        let id = (*self.of.get(detection)?)?;
        self.users.iter().find(|user| user.id == id)
    }

    /// `tick` s later: `detections` in the picture of a camera over `ground`, whose vehicle is at `pose`.
    pub fn update(&mut self, detections: &[Detection], ground: &GroundPlane, pose: &Pose, tick: f64) {
        for user in &mut self.users {
            user.predict(tick);
        }
        let sightings = detections.iter().enumerate();
        let sightings: Vec<(usize, Sighting)> =
            sightings.filter_map(|(index, one)| Some((index, sight(one, ground, pose)?))).collect();
        let mut pairs = Vec::new();
        for (user, one) in self.users.iter_mut().enumerate() {
            one.missed += 1;
            for (detection, sighting) in &sightings {
                // Within what both are unsure of.
                let distance = (sighting.place - one.place).norm();
                let most = sighting.kind.gate() + 2.0 * sighting.noise.trace().sqrt();
                if one.kind.is_like(sighting.kind) && distance < most {
                    pairs.push((distance, user, *detection, sighting));
                }
            }
        }
        // The nearest find each other first: a track that nobody is seen of would take another's detection.
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
        self.of.clear();
        self.of.resize(detections.len(), None);
        for (_, user, detection, sighting) in pairs {
            let user = &mut self.users[user];
            if user.missed > 0 && self.of[detection].is_none() {
                user.correct(sighting);
                self.of[detection] = Some(user.id);
            }
        }
        self.users.retain(|user| user.missed <= COAST || user.missed <= ASIDE && user.is_aside(ground, pose));
        for (detection, sighting) in &sightings {
            if self.of[*detection].is_none() {
                self.of[*detection] = Some(self.next);
                self.users.push(RoadUser::new(self.next, sighting));
                self.next += 1;
            }
        }
    }
}

/// Where a detection stands. If a side of the picture cuts it, its other end tells, less well; its lower edge has to be seen.
fn sight(detection: &Detection, ground: &GroundPlane, pose: &Pose) -> Option<Sighting> {
    let kind = Kind::of(detection.class)?;
    let [left, _, right, bottom] = detection.bounds;
    let [x, middle] = ground.point([0.5 * (left + right), bottom])?;
    if f64::from(x) > OUTLOOK {
        return None;
    }
    let end = |column: f32| ground.point([column, bottom]).map(|[_, y]| y);
    // It may stand lengthwise or across.
    let [long, broad] = kind.half();
    let (half, either) = (0.5 * (long + broad), 0.5 * (long - broad));
    let (y, unsure) = match ground.cuts(detection.bounds) {
        [false, false, false] => (middle, 0.0),
        [true, false, false] => (end(right)? + half as f32, either),
        [false, true, false] => (end(left)? - half as f32, either),
        _ => return None,
    };
    let place = pose.to_world(Point::new(f64::from(x), f64::from(y)).coords).coords;
    // Along the ray a row's height, across it little.
    let far = 0.3 + f64::from(ground.metres_per_row(x));
    let across = (0.2 + 0.01 * f64::from(x)).hypot(unsure);
    let ray = direction(pose.heading + f64::from(y).atan2(f64::from(x)));
    let side = Vector::new(-ray.y, ray.x);
    let noise = ray * ray.transpose() * (far * far) + side * side.transpose() * (across * across);
    Some(Sighting { kind, place, noise })
}

impl RoadUser {
    fn new(id: u64, sighting: &Sighting) -> Self {
        let (_, doubt) = sighting.kind.doubts();
        let mut p = Matrix4::zeros();
        p.fixed_view_mut::<2, 2>(0, 0).copy_from(&sighting.noise);
        p.fixed_view_mut::<2, 2>(2, 2).copy_from(&(Matrix2::identity() * (doubt * doubt)));
        let (kind, place, velocity) = (sighting.kind, sighting.place, Vector::zeros());
        let mut one = Self { id, kind, rides: 0, place, velocity, p, seen: 1, missed: 0 };
        one.call(kind);
        one
    }

    /// Counts what it was detected as. Who rides is taken for who walks at times, and the other way round: what it was more
    /// often, it is, and nobody walks as fast as some ride.
    fn call(&mut self, kind: Kind) {
        self.rides += match kind {
            Kind::Vehicle => return,
            Kind::TwoWheeler => 1,
            Kind::Person => -1,
        };
        let rides = self.rides > 0 || self.velocity.norm() > RIDES;
        self.kind = if rides { Kind::TwoWheeler } else { Kind::Person };
    }

    /// Its speed along the unit vector `way` (m/s), and the standard deviation of that.
    pub fn along(&self, way: Vector) -> (f64, f64) {
        (self.velocity.dot(&way), deviation(self.p.fixed_view::<2, 2>(2, 2).into_owned(), way))
    }

    /// The standard deviation of its place along the unit vector `way` (m).
    pub(super) fn unsure(&self, way: Vector) -> f64 {
        deviation(self.p.fixed_view::<2, 2>(0, 0).into_owned(), way)
    }

    /// Whether a part of it is beside the picture, where it moves on unseen.
    fn is_aside(&self, ground: &GroundPlane, pose: &Pose) -> bool {
        let at = pose.to_local(Point::from(self.place));
        let [half, _] = self.kind.half();
        [half, -half].iter().any(|side| {
            let column = ground.pixel([at.x as f32, (at.y + side) as f32]).map(|[column, _]| column);
            column.is_none_or(|u| {
                let [left, right, _] = ground.cuts([u, 0.0, u, 0.0]);
                left || right
            })
        })
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
        self.call(sighting.kind);
    }
}

/// The standard deviation along the unit vector `way` of what has this covariance.
fn deviation(covariance: Matrix2<f64>, way: Vector) -> f64 {
    (way.transpose() * covariance * way).x.max(0.0).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perception::testing::{Road, seen};
    use wad_camera::CameraConfig;

    #[test]
    fn a_track_that_nobody_is_seen_of_takes_no_other_s_detection() {
        let (road, ground) = (Road::new("GGG"), GroundPlane::new(&CameraConfig::default()));
        let facts = road.facts(60.0, 0.0, 0.0, 0.0);
        let mut users = RoadUsers::default();
        let car = |x: f32, y: f32| seen(ObjectClass::Car, x, y, 1.8, 1.5);
        users.update(&[car(42.0, -4.0), car(42.0, 3.0)], &ground, &facts.on_route.state.pose, facts.tick);
        for tick in 1..6 {
            users.update(
                &[car(42.0 - 1.5 * tick as f32, 3.0)],
                &ground,
                &facts.on_route.state.pose,
                facts.tick,
            );
        }
        let [user] = users.users[..] else { panic!("{:?}", users.users) };
        assert!(user.velocity.x < -3.0 && user.velocity.y.abs() < 0.5, "{user:?}");
        assert_eq!(users.of(0).map(|user| user.id), Some(1));
    }

    #[test]
    fn who_is_at_the_picture_s_side_is_followed_and_remembered_beside_it() {
        let (road, ground) = (Road::new("GGG"), GroundPlane::new(&CameraConfig::default()));
        let facts = road.facts(60.0, 0.0, 0.0, 0.0);
        let [right, bottom] = ground.pixel([12.0, 8.0]).unwrap();
        let cut = |bounds| {
            sight(
                &Detection { class: ObjectClass::Car, bounds, score: 0.9 },
                &ground,
                &facts.on_route.state.pose,
            )
        };
        let y = |found: Option<Sighting>| {
            found.map(|found| facts.on_route.state.pose.to_local(Point::from(found.place)).y)
        };
        assert!(y(cut([0.0, 200.0, right, bottom])).is_some_and(|y| (y - 9.55).abs() < 0.05));
        assert!(cut([0.0, 200.0, right, 512.0]).is_none(), "its wheels are below the picture");
        let ticks = |detection: Detection| {
            let mut users = RoadUsers::default();
            users.update(&[detection], &ground, &facts.on_route.state.pose, facts.tick);
            (0..30)
                .take_while(|_| {
                    users.update(&[], &ground, &facts.on_route.state.pose, facts.tick);
                    users.iter().next().is_some()
                })
                .count()
        };
        let at_side = Detection { class: ObjectClass::Car, bounds: [0.0, 200.0, right, bottom], score: 0.9 };
        let in_sight = seen(ObjectClass::Car, 20.0, 0.0, 1.8, 1.5);
        assert_eq!([ticks(at_side), ticks(in_sight)], [ASIDE as usize, COAST as usize]);
    }

    #[test]
    fn who_rides_stays_who_it_is_whatever_it_is_taken_for() {
        let (road, ground) = (Road::new("GGG"), GroundPlane::new(&CameraConfig::default()));
        let facts = road.facts(60.0, 0.0, 0.0, 0.0);
        let kinds = |classes: &[ObjectClass], speed: f32| -> Vec<_> {
            let mut users = RoadUsers::default();
            let look = |(tick, &class): (usize, &ObjectClass)| {
                users.update(
                    &[seen(class, 20.0, -6.0 + speed * tick as f32 * 0.167, 0.6, 1.7)],
                    &ground,
                    &facts.on_route.state.pose,
                    facts.tick,
                );
                let [user] = users.users[..] else { panic!("{:?}", users.users) };
                (user.id, user.kind)
            };
            classes.iter().enumerate().map(look).collect()
        };
        use ObjectClass::{Bicycle, Person};
        assert_eq!(kinds(&[Bicycle, Bicycle, Person], 1.3)[2], (0, Kind::TwoWheeler));
        assert_eq!(kinds(&[Person, Person, Bicycle, Person], 1.3)[3], (0, Kind::Person));
        assert_eq!(kinds(&[Person; 12], 5.0)[11], (0, Kind::TwoWheeler), "too fast to walk");
    }

    #[test]
    fn nothing_is_kept_after_a_reset() {
        let mut users = RoadUsers::default();
        let (road, ground) = (Road::new("GGG"), GroundPlane::new(&CameraConfig::default()));
        let facts = road.facts(60.0, 0.0, 0.0, 8.0);
        users.update(
            &[seen(ObjectClass::Car, 20.0, 0.0, 1.8, 1.5)],
            &ground,
            &facts.on_route.state.pose,
            facts.tick,
        );
        assert_eq!(users.iter().count(), 1);
        users.reset();
        assert!(users.iter().next().is_none());
    }
}
