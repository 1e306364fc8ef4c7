//! The vehicle in front: the nearest detected road user in the ego's path, its gap by ground-plane
//! projection, its speed by a filter over the ticks. Nothing here comes from SUMO.

pub use super::facts::SIGHT;
use super::road_users::RoadUsers;
use super::{Detection, EgoFacts, GroundPlane};
use crate::observation::LeadState;
use sumo_network::geometry::{Point, direction};
use wad_camera::model::ObjectClass;

/// Half the breadth of the way that must be free (m): the ego's half and a hand's breadth.
pub const HALF_WAY: f64 = 1.2;
/// The same for people, who stand on kerbs as near to the path as that and wait: their boxes reach farther than their bodies.
const HALF_WAY_PAST_PEOPLE: f64 = 1.0;
/// Places further than this from the route (m) are beside another part of it.
const BEND: f64 = 4.5;
/// Ticks without a detection until the vehicle in front is dropped.
const COAST: u32 = 2;

/// A detection on the ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// Index in the detections.
    pub detection: usize,
    /// Class of the detection.
    pub class: ObjectClass,
    /// Along the route from the ego's front bumper to its nearest point (m).
    pub gap: f64,
    /// The nearest point straight ahead of the ego's centre (m).
    pub ahead: f64,
}

/// What the objects of a class are like from behind (m).
struct Build {
    width: f32,
    /// How far the wheels or feet are behind the nearest point, the bumper's.
    overhang: f32,
    /// Height of the lower edge of what hangs over.
    clearance: f32,
    /// How far back the flank reaches that a box may show.
    flank: f32,
}

impl Build {
    fn of(class: ObjectClass) -> Self {
        let (width, overhang, clearance, flank) = match class {
            ObjectClass::Car => (1.8, 0.85, 0.3, 4.5),
            ObjectClass::Truck => (2.5, 1.5, 0.9, 10.0),
            ObjectClass::Bus => (2.5, 1.9, 0.3, 10.0),
            ObjectClass::Motorcycle | ObjectClass::Bicycle => (0.7, 0.35, 0.3, 1.8),
            ObjectClass::Person => (0.5, 0.15, 0.3, 0.3),
            ObjectClass::Bench | ObjectClass::TrafficLight => (1.5, 0.0, 0.0, 0.5),
        };
        Self { width, overhang, clearance, flank }
    }

    /// How far the lowest point that is seen is behind the nearest: near by, what hangs over hides the wheels. `near` is
    /// the former's place on the ground (m ahead).
    fn behind(&self, ground: &GroundPlane, near: f32) -> f32 {
        self.overhang.min(ground.hides(near, self.clearance))
    }
}

/// The nearest detection in the ego's path.
pub fn nearest(detections: &[Detection], ground: &GroundPlane, facts: &EgoFacts<'_>) -> Option<Candidate> {
    let candidates = detections.iter().enumerate();
    let found = candidates.filter_map(|(index, detection)| locate(index, detection, ground, facts));
    found.min_by(|a, b| a.gap.total_cmp(&b.gap))
}

/// Where a detection is, if it is in the ego's path.
fn locate(
    index: usize,
    detection: &Detection,
    ground: &GroundPlane,
    facts: &EgoFacts<'_>,
) -> Option<Candidate> {
    let class = detection.class;
    if matches!(class, ObjectClass::TrafficLight) {
        return None;
    }
    let [left, _, right, bottom] = detection.bounds;
    let [near, y_left] = ground.point([left, bottom])?;
    let [_, y_right] = ground.point([right, bottom])?;
    let build = Build::of(class);
    let behind = build.behind(ground, near);
    if f64::from(near) > SIGHT + facts.length {
        return None;
    }
    // Its place on the route: the middle and both ends of its visible width.
    let state = &facts.on_route.state;
    let reach = f64::from(near) + 10.0;
    let offset = |x: f32, y: f32| {
        let place = state.pose.to_world(Point::new(f64::from(x), f64::from(y)).coords);
        facts.route.project_near(place, facts.on_route.s, 0.0, reach)
    };
    // A vehicle beside the path shows its flank too: no more than its class's breadth counts, from the
    // side that is away from the path.
    let middle = offset(near, 0.5 * (y_left + y_right));
    let half = 0.5 * (y_left - y_right).abs().min(build.width);
    let (a, b) = (offset(near, y_left), offset(near, y_right));
    let on_left = a.d.abs() > b.d.abs();
    let (outer, inner_column) = if on_left { (a.d, right) } else { (b.d, left) };
    let inner = outer - f64::from(2.0 * half).copysign(outer);
    let half_way = if class == ObjectClass::Person { HALF_WAY_PAST_PEOPLE } else { HALF_WAY };
    let reaches = |d: f64| d.signum() != outer.signum() || d.abs() < half_way;
    // One that pulls out shows more than its breadth too. The box's side towards the path is seen on a ray: if that is
    // in the path as far as the flank can reach, so is the vehicle.
    let pulls_out = || {
        let [eye, _] = ground.ahead(inner_column, 0.0);
        [0.0, 0.5, 1.0].iter().all(|share| {
            let [x, y] = ground.ahead(inner_column, near - eye + share * build.flank);
            let on = offset(x, y);
            // Beyond a turn of the route the other side means nothing.
            reaches(on.d) && on.d.abs() < BEND && on.distance - on.d.abs() < 0.1
        })
    };
    // Whose outer side the picture's border cuts has no breadth to count: one that is passed would be in the path.
    let [left_is_cut, right_is_cut, _] = ground.cuts(detection.bounds);
    let is_cut = if on_left { left_is_cut } else { right_is_cut };
    let spans = a.d.signum() != b.d.signum() && (a.d - b.d).abs() < 2.0 * BEND;
    let within = spans || !is_cut && (reaches(inner) || middle.d.abs() < half_way) || pulls_out();
    let gap = (middle.s - facts.on_route.front_s - f64::from(behind)).max(0.0);
    let ahead = f64::from(near - behind);
    (within && gap <= SIGHT).then_some(Candidate { detection: index, class, gap, ahead })
}

/// Follows the vehicle in front over the ticks.
#[derive(Clone, Debug, Default)]
pub struct LeadTracker {
    track: Option<Track>,
}

/// A Kalman filter over gap and the other's speed.
#[derive(Clone, Copy, Debug)]
struct Track {
    /// The road user's number, if it is followed.
    user: Option<u64>,
    gap: f64,
    /// Along the path (m/s).
    speed: f64,
    /// Covariance: gap, both, speed.
    p: [f64; 3],
    missed: u32,
}

/// Standard deviation of others' acceleration (m/s2).
const ACCELERATION: f64 = 2.0;
/// Error of a projected gap that does not come from the pixels (m), and of a box's lower edge (rows).
const GAP_NOISE: f64 = 0.25;
const ROW_NOISE: f64 = 0.5;
/// Standard deviation of a new vehicle's speed (m/s).
const SPEED_DOUBT: f64 = 4.0;
/// How fast who rides a bicycle is taken to be at first, at most (m/s): walking legs are taken for one at times, and at the
/// speed of an ego that drives faster nobody would brake for them.
const CYCLES: f64 = 4.0;

impl LeadTracker {
    /// Forgets.
    pub fn reset(&mut self) {
        self.track = None;
    }

    /// One tick later: what is in front, given the nearest detection in the path. Of whom `users` follow they know who it is,
    /// and how fast.
    pub fn update(
        &mut self,
        seen: Option<&Candidate>,
        users: &RoadUsers,
        ground: &GroundPlane,
        facts: &EgoFacts<'_>,
    ) -> Option<LeadState> {
        let ego_speed = facts.on_route.state.speed;
        if let Some(track) = &mut self.track {
            track.predict(ego_speed, facts.tick);
        }
        match (seen, &mut self.track) {
            (Some(seen), track) => {
                let row = f64::from(ground.metres_per_row(seen.ahead as f32));
                let noise = GAP_NOISE.hypot(ROW_NOISE * row);
                let user = users.of(seen.detection);
                let id = user.map(|user| user.id);
                match track {
                    Some(old) if id.is_some() && old.user == id || old.expects(seen.gap, noise) => {
                        old.user = id;
                        old.correct(seen.gap, noise);
                    }
                    _ => {
                        let mut new = Track { user: id, ..Track::new(seen, noise, ego_speed) };
                        if let Some(user) = user {
                            let there = facts.route.at(facts.on_route.front_s + seen.gap).pose;
                            new.believe(user.along(direction(there.heading)));
                        }
                        *track = Some(new);
                    }
                }
            }
            (None, Some(track)) => {
                track.missed += 1;
                if track.missed > COAST {
                    self.track = None;
                }
            }
            (None, None) => {}
        }
        self.track.map(|track| LeadState {
            gap: track.gap.clamp(0.0, SIGHT),
            closing_speed: ego_speed - track.speed,
        })
    }
}

impl Track {
    fn new(seen: &Candidate, noise: f64, ego_speed: f64) -> Self {
        // Persons hardly move along the path; of vehicles the ego's own speed is the best guess.
        let (speed, doubt) = match seen.class {
            ObjectClass::Person | ObjectClass::Bench => (0.0, 1.0),
            ObjectClass::Bicycle => (ego_speed.min(CYCLES), SPEED_DOUBT),
            _ => (ego_speed, SPEED_DOUBT),
        };
        Self { user: None, gap: seen.gap, speed, p: [noise * noise, 0.0, doubt * doubt], missed: 0 }
    }

    /// Takes a speed (m/s) of this standard deviation into account; to be called while gap and speed are independent.
    fn believe(&mut self, (speed, doubt): (f64, f64)) {
        let known = self.p[2];
        let gain = known / (known + doubt * doubt);
        self.speed += gain * (speed - self.speed);
        self.p[2] = (1.0 - gain) * known;
    }

    fn predict(&mut self, ego_speed: f64, tick: f64) {
        self.gap += (self.speed - ego_speed) * tick;
        let [gap, both, speed] = self.p;
        let q = ACCELERATION * ACCELERATION;
        self.p = [
            gap + 2.0 * tick * both + tick * tick * speed + 0.25 * tick.powi(4) * q,
            both + tick * speed + 0.5 * tick.powi(3) * q,
            speed + tick * tick * q,
        ];
    }

    /// Whether a gap can be this vehicle's.
    fn expects(&self, gap: f64, noise: f64) -> bool {
        (gap - self.gap).abs() < 3.0 * (self.p[0] + noise * noise).sqrt() + 0.5
    }

    fn correct(&mut self, gap: f64, noise: f64) {
        let [pg, pb, ps] = self.p;
        let total = pg + noise * noise;
        let (kg, ks) = (pg / total, pb / total);
        let off = gap - self.gap;
        self.gap += kg * off;
        self.speed += ks * off;
        self.p = [(1.0 - kg) * pg, (1.0 - kg) * pb, ps - ks * pb];
        self.missed = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perception::testing::{LENGTH, Road, seen, user};
    use crate::perception::{Detector, TruthDetector};
    use std::sync::Arc;
    use sumo_network::network::Shapes;
    use sumo_network::world::{ActorKind, ActorType, WorldState};
    use wad_camera::scene::Look;
    use wad_camera::{Camera, CameraConfig, Outputs, Preset, Town, Weather};

    /// How far a car's rear wheels are behind its bumper (m).
    const WHEELS: f64 = 0.85;

    fn gap(found: &[Detection], s: f64, d: f64, turn: f64) -> Option<f64> {
        let road = Road::new("GGG");
        let ground = GroundPlane::new(&CameraConfig::default());
        nearest(found, &ground, &road.facts(s, d, turn, 8.0)).map(|candidate| candidate.gap)
    }

    #[test]
    fn the_nearest_in_the_path_counts() {
        let car = seen(ObjectClass::Car, 20.0, 0.1, 1.8, 1.5);
        let person = seen(ObjectClass::Person, 12.0, -0.4, 0.5, 1.7);
        let far = gap(&[car], 60.0, 0.0, 0.0).unwrap();
        assert!((far - (20.0 - 0.5 * LENGTH - WHEELS)).abs() < 0.1, "{far}");
        let near = gap(&[car, person], 60.0, 0.0, 0.0).unwrap();
        assert!((near - (12.0 - 0.5 * LENGTH - 0.15)).abs() < 0.1, "{near}");
        assert!(gap(&[seen(ObjectClass::Car, 70.0, 0.0, 1.8, 1.5)], 60.0, 0.0, 0.0).is_none(), "too far");
    }

    #[test]
    fn gaps_to_what_the_camera_draws_are_right() {
        let road = Road::new("GGG");
        let config = CameraConfig::default();
        let ground = GroundPlane::new(&config);
        let mut town = Town::new(&road.network, &Shapes::default(), Look::of(1));
        let mut camera = Camera::new(config).unwrap();
        let facts = road.facts(60.0, 0.0, 0.0, 0.0);
        for (kind, id, [length, width, height]) in [
            (ActorKind::Car, "car.hatchback", [4.19, 1.80, 1.47]),
            (ActorKind::Car, "car.saloon.long", [5.36, 1.90, 1.45]),
            (ActorKind::Car, "car.suv", [4.86, 1.94, 1.72]),
            (ActorKind::Van, "van.delivery", [5.92, 1.99, 2.56]),
            (ActorKind::Truck, "truck.box", [7.2, 2.4, 3.1]),
            (ActorKind::Bus, "bus.city", [10.27, 2.5, 3.1]),
            (ActorKind::Motorcycle, "motorcycle.sport", [2.03, 0.8, 1.55]),
            (ActorKind::Bicycle, "bicycle.city", [1.84, 0.6, 1.75]),
            (ActorKind::Pedestrian, "person", [0.3, 0.5, 1.75]),
        ] {
            for true_gap in [1.0, 2.5, 5.0, 8.0, 12.0, 18.0] {
                // Farther away a bicycle shows too few pixels, and its rider's feet are above the ground.
                if kind == ActorKind::Bicycle && true_gap > 5.0 {
                    continue;
                }
                let pose = road.route.at(facts.on_route.front_s + true_gap + 0.5 * length).pose;
                let mut other = user(pose, 0.0, kind);
                let shape = ActorType { id: id.to_string(), kind, length, width, height, min_gap: 2.5 };
                other.actor_type = Arc::new(shape);
                let mut world = WorldState::default();
                let of_kind =
                    if kind == ActorKind::Pedestrian { &mut world.pedestrians } else { &mut world.vehicles };
                of_kind.push(other);
                town.follow(&world, None);
                let outputs = Outputs { boxes: true, ..Outputs::RGB };
                let (weather, pose) = (Weather::from(Preset::ClearNoon), &facts.on_route.state.pose);
                let frame = camera.render(town.scene(), town.actors(), pose, &weather, outputs);
                let mut found = Vec::new();
                TruthDetector::new().detect(frame, &config, &mut found).unwrap();
                let told = nearest(&found, &ground, &facts).unwrap();
                let off = told.gap - true_gap;
                let row = f64::from(ground.metres_per_row(told.ahead as f32));
                assert!(off.abs() < 0.35 + row, "{id} {true_gap} m in front: {off} m, a row is {row} m");
            }
        }
    }

    #[test]
    fn those_beside_the_path_do_not() {
        for (y, breadth) in [(3.3, 1.8), (-3.3, 1.8), (2.6, 3.0)] {
            assert!(gap(&[seen(ObjectClass::Car, 15.0, y, breadth, 1.5)], 60.0, 0.0, 0.0).is_none(), "{y}");
        }
        let lamp = seen(ObjectClass::TrafficLight, 15.0, 0.0, 0.5, 3.0);
        assert!(gap(&[lamp], 60.0, 0.0, 0.0).is_none());
        // Straight ahead of an ego that is turned away from its route: off the path.
        assert!(gap(&[seen(ObjectClass::Car, 25.0, 0.0, 1.8, 1.5)], 60.0, 0.0, 0.2).is_none());
        // And on the path, though to the right of the picture's middle.
        assert!(gap(&[seen(ObjectClass::Car, 25.0, -5.0, 1.8, 1.5)], 60.0, 0.0, 0.2).is_some());
        // People may stand nearer than others.
        for (class, within) in [(ObjectClass::Person, false), (ObjectClass::Bicycle, true)] {
            assert_eq!(
                gap(&[seen(class, 6.0, 1.35, 0.5, 1.7)], 60.0, 0.0, 0.0).is_some(),
                within,
                "{class:?}"
            );
            assert!(gap(&[seen(class, 6.0, 1.15, 0.5, 1.7)], 60.0, 0.0, 0.0).is_some(), "{class:?}");
        }
        // Half of it in the way.
        assert!(gap(&[seen(ObjectClass::Car, 15.0, 1.8, 1.8, 1.5)], 60.0, 0.0, 0.0).is_some());
    }

    #[test]
    fn who_pulls_out_is_in_the_path_and_a_flank_beside_it_is_not() {
        // The box of a car that stands askew, its near corner in the path and its tail at the kerb.
        let askew = seen(ObjectClass::Car, 12.0, -1.5, 4.0, 1.5);
        assert!(gap(&[askew], 60.0, 0.0, 0.0).is_some());
        // One in the next lane: its box reaches from the far end of its flank to its back.
        let ground = GroundPlane::new(&CameraConfig::default());
        for near in [4.0_f32, 8.0, 16.0, 30.0] {
            let [l, _] = ground.pixel([near + 4.5, -2.4]).unwrap();
            let [r, b] = ground.pixel([near, -4.2]).unwrap();
            let beside =
                Detection { class: ObjectClass::Car, bounds: [l, b - 400.0 / near, r, b], score: 1.0 };
            assert!(gap(&[beside], 60.0, 0.0, 0.0).is_none(), "{near}");
        }
        // One that the ego passes: the picture's borders cut all of it but its far end.
        let passed = |inner: f32| Detection {
            class: ObjectClass::Car,
            bounds: [0.0, 247.0, inner, 512.0],
            score: 1.0,
        };
        assert!(gap(&[passed(81.0)], 60.0, 0.0, 0.0).is_none());
        assert!(gap(&[passed(250.0)], 60.0, 0.0, 0.0).is_some(), "its corner is in front of the ego");
        assert!(gap(&[passed(512.0)], 60.0, 0.0, 0.0).is_some(), "it fills the picture");
    }

    #[test]
    fn the_closing_speed_is_learnt_within_a_second_and_a_half() {
        let (road, ground) = (Road::new("GGG"), GroundPlane::new(&CameraConfig::default()));
        let mut tracker = LeadTracker::default();
        let (mut true_gap, closing) = (25.0, 4.0);
        let mut state = None;
        for tick in 0..9 {
            let near = (true_gap + 0.5 * LENGTH + WHEELS) as f32;
            let found = [seen(ObjectClass::Car, near, 0.0, 1.8, 1.5)];
            let facts = road.facts(60.0 + f64::from(tick), 0.0, 0.0, 8.0);
            let candidate = nearest(&found, &ground, &facts);
            state = tracker.update(candidate.as_ref(), &RoadUsers::default(), &ground, &facts);
            true_gap -= closing * facts.tick;
        }
        let state = state.unwrap();
        assert!((state.closing_speed - closing).abs() < 0.7, "{state:?}");
        assert!((state.gap - (true_gap + closing * 0.167)).abs() < 0.4, "{state:?}, {true_gap}");
    }

    #[test]
    fn a_missed_detection_is_bridged_for_two_ticks_only() {
        let (road, ground) = (Road::new("GGG"), GroundPlane::new(&CameraConfig::default()));
        let facts = road.facts(60.0, 0.0, 0.0, 0.0);
        let found = [seen(ObjectClass::Car, 15.0, 0.0, 1.8, 1.5)];
        let candidate = nearest(&found, &ground, &facts);
        let mut tracker = LeadTracker::default();
        tracker.update(candidate.as_ref(), &RoadUsers::default(), &ground, &facts);
        let bridged: Vec<bool> =
            (0..4).map(|_| tracker.update(None, &RoadUsers::default(), &ground, &facts).is_some()).collect();
        assert_eq!(bridged, [true, true, false, false]);
        tracker.update(candidate.as_ref(), &RoadUsers::default(), &ground, &facts);
        tracker.reset();
        assert_eq!(tracker.update(None, &RoadUsers::default(), &ground, &facts), None);
    }

    #[test]
    fn another_vehicle_in_front_is_not_taken_for_a_jump_of_the_old_one() {
        let (road, ground) = (Road::new("GGG"), GroundPlane::new(&CameraConfig::default()));
        let facts = road.facts(60.0, 0.0, 0.0, 8.0);
        let mut tracker = LeadTracker::default();
        let mut look = |near: f32| {
            let found = [seen(ObjectClass::Car, near, 0.0, 1.8, 1.5)];
            tracker
                .update(nearest(&found, &ground, &facts).as_ref(), &RoadUsers::default(), &ground, &facts)
                .unwrap()
        };
        look(30.0);
        look(30.0);
        let cut_in = look(12.0);
        assert!(
            (cut_in.gap - (12.0 - 0.5 * LENGTH - WHEELS)).abs() < 0.2 && cut_in.closing_speed.abs() < 1.0,
            "{cut_in:?}"
        );
    }

    #[test]
    fn who_was_followed_before_it_is_in_front_is_known_to_be_slow() {
        let (road, ground) = (Road::new("GGG"), GroundPlane::new(&CameraConfig::default()));
        let mut tracker = LeadTracker::default();
        let mut users = RoadUsers::default();
        // It stands beside the path, and the ego comes: it is in front from one tick to the next.
        let mut closing = Vec::new();
        for tick in 0..10_u8 {
            let driven = 8.0 * 0.167 * f32::from(tick);
            let facts = road.facts(60.0 + f64::from(driven), 0.0, 0.0, 8.0);
            let y = if tick < 8 { 3.5 } else { 1.5 };
            let found = [seen(ObjectClass::Car, 30.0 - driven, y, 1.8, 1.5)];
            users.update(&found, &ground, &facts.on_route.state.pose, facts.tick);
            let state = tracker.update(nearest(&found, &ground, &facts).as_ref(), &users, &ground, &facts);
            closing.push(state.map(|state| state.closing_speed));
        }
        assert!(closing[..8].iter().all(Option::is_none), "{closing:?}");
        assert!(closing[8].is_some_and(|closing| closing > 6.0), "{closing:?}");
    }

    #[test]
    fn who_is_new_drives_as_fast_as_the_ego_a_bicycle_no_faster_than_they_do() {
        let (road, ground) = (Road::new("GGG"), GroundPlane::new(&CameraConfig::default()));
        let closing = |class, speed: f64| {
            let facts = road.facts(60.0, 0.0, 0.0, speed);
            let found = [seen(class, 15.0, 0.0, 0.6, 1.5)];
            let candidate = nearest(&found, &ground, &facts);
            LeadTracker::default()
                .update(candidate.as_ref(), &RoadUsers::default(), &ground, &facts)
                .unwrap()
                .closing_speed
        };
        let at_12 = [ObjectClass::Car, ObjectClass::Motorcycle, ObjectClass::Bicycle, ObjectClass::Person];
        assert_eq!(at_12.map(|class| closing(class, 12.0)), [0.0, 0.0, 8.0, 12.0]);
        assert_eq!(closing(ObjectClass::Bicycle, 3.0), 0.0);
    }
}
