//! Cameras in place of door mirrors: before a change of lane they look back along the vehicle's side, and who is beside it or
//! close behind on the other lane counts as a vehicle that stands where the ego has to wait.
//!
//! The paper has one camera, which looks ahead. Who drives beside the ego is in no picture of it, so an agent that changes
//! lanes where its route says so drives into them. Nothing here comes from SUMO except the map and the ego's route.

use super::lead::SIGHT;
use super::road_users::{Kind, RoadUser, RoadUsers};
use super::{Detection, Detector, EgoFacts, GroundPlane, PerceptionError};
use crate::observation::LeadState;
use sumo_network::geometry::{Point, Pose, Vector, direction};
use sumo_network::network::{Lane, RoadOption, RouteSection};
use sumo_network::seeds;
use wad_camera::{CameraConfig, Frame, Mount};
use wad_sim::autopilot::lane_change::{BEGUN, room};

/// Where the mirrors are: ahead of the ego's centre and beside it (m), and how far from straight ahead they look (rad).
const AHEAD: f64 = 0.9;
const ASIDE: f64 = 0.95;
const BACK: f64 = 145.0 * std::f64::consts::PI / 180.0;
/// Above the ground (m).
const UP: f64 = 1.0;
/// From so long (s) and so far (m) before that place on somebody is looked for.
const NOTICE: f64 = 3.0;
const ROOM: f64 = 7.0;
/// Others count within this distance along the route (m).
const NEAR: f64 = 40.0;
/// Looks before a velocity counts; until then somebody is taken to be as fast as the ego.
const BELIEVED: u32 = 3;
/// Who has stood for so long (s) for others goes.
const PATIENCE: f64 = 15.0;

/// A change of lane that is due.
#[derive(Clone, Copy, Debug)]
struct Change<'a> {
    section: &'a RouteSection,
    /// The lane that it leads to.
    target: &'a Lane,
    /// From the ego's centre to the place where it has to wait (m).
    way: f64,
}

impl<'a> Change<'a> {
    fn due(facts: &EgoFacts<'a>) -> Option<Self> {
        let (s, speed) = (facts.on_route.s, facts.on_route.state.speed.max(0.0));
        let sections = &facts.route.sections;
        let ahead = &sections[sections.partition_point(|at| at.s_end <= s)..];
        let changes = ahead.iter().filter(|at| at.from_lane.is_some() && at.s_end > at.s_start);
        let mut ways = changes.map(|at| (at, at.s_start + BEGUN * (at.s_end - at.s_start) - s));
        let (section, way) = ways.find(|(_, way)| *way > 0.0)?;
        let target = facts.network.lane(section.lane);
        (way < (NOTICE * speed + ROOM).min(SIGHT)).then_some(Self { section, target, way })
    }

    /// The lane that it leads to, and before that those of the ego's own road that lead there.
    fn lanes(&self, facts: &EgoFacts<'a>) -> impl Iterator<Item = &'a Lane> {
        let (network, route) = (facts.network, facts.route);
        let links = self.target.incoming.iter().map(|&link| network.link(link));
        let along = links.filter(|link| route.edges.contains(&network.lane(link.from).edge));
        let before = along.flat_map(|link| link.via.iter().copied().chain([link.from]));
        std::iter::once(self.target).chain(before.map(|lane| network.lane(lane)))
    }

    /// Whether somebody at `place` (m) with this velocity (m/s), half as long and broad as told (m), leaves no room for it.
    fn is_barred_by(&self, place: Vector, velocity: Vector, half: [f64; 2], facts: &EgoFacts<'a>) -> bool {
        let (s, speed, place) = (facts.on_route.s, facts.on_route.state.speed, Point::from(place));
        let on = facts.route.project_near(place, s, NEAR, NEAR);
        if (on.s - s).abs() > NEAR - 1.0 || (on.distance - on.d.abs()).abs() > 0.1 {
            return false;
        }
        let is_on = |lane: &Lane| lane.shape.project(place).distance < 0.5 * lane.width + half[1] - 0.2;
        if !self.lanes(facts).any(is_on) {
            return false;
        }
        let along = velocity.dot(&direction(facts.route.at(on.s).pose.heading));
        let apart = (on.s - s).abs() - half[0] - 0.5 * facts.length;
        // As much as the autopilot leaves.
        apart < room(on.s > s, along, speed, 1.0)
    }
}

/// Where the mirror is that looks to the lane to which a change is due, as a camera's vehicle; None if no change is due.
pub fn pose(facts: &EgoFacts<'_>) -> Option<Pose> {
    let side = match Change::due(facts)?.section.option {
        RoadOption::ChangeLaneRight => -1.0,
        _ => 1.0,
    };
    let ego = &facts.on_route.state.pose;
    let at = ego.to_world(Vector::new(AHEAD, side * ASIDE));
    Some(Pose::new(at.x, at.y, ego.position.z, ego.heading + side * BACK))
}

/// The camera of a mirror beside the front camera `front`.
pub fn camera(front: &CameraConfig) -> CameraConfig {
    CameraConfig { mount: Mount { forward: 0.0, left: 0.0, up: UP, yaw: 0.0, pitch: 0.0 }, ..*front }
}

/// Follows who is seen in the mirrors.
pub struct Mirrors {
    camera: CameraConfig,
    ground: GroundPlane,
    /// None: the front camera's serves.
    detector: Option<Box<dyn Detector>>,
    detections: Vec<Detection>,
    users: RoadUsers,
    /// How long the ego has stood for others (s).
    stood: f64,
}

impl Mirrors {
    /// Beside the front camera `front`, with a detector of their own where that one's remembers what it saw.
    pub fn new(front: &CameraConfig, detector: Option<Box<dyn Detector>>) -> Self {
        let camera = camera(front);
        let ground = GroundPlane::new(&camera);
        Self { camera, ground, detector, detections: Vec::new(), users: RoadUsers::default(), stood: 0.0 }
    }

    /// Begins an episode: forgets everything, draws the detector's faults from `seed`.
    pub fn reset(&mut self, seed: u64) {
        if let Some(detector) = &mut self.detector {
            detector.reset(seeds::derive(seed, "mirrors"));
        }
        self.forget();
    }

    fn forget(&mut self) {
        self.users.reset();
        self.stood = 0.0;
    }

    /// Who is in the mirror's `frame`, taken from `pose`; `front` is the front camera's detector.
    ///
    /// # Errors
    /// The detector fails.
    pub fn look(
        &mut self,
        front: &mut dyn Detector,
        frame: &Frame,
        pose: &Pose,
        tick: f64,
    ) -> Result<(), PerceptionError> {
        let detector: &mut dyn Detector = match &mut self.detector {
            Some(own) => own.as_mut(),
            None => front,
        };
        detector.detect(frame, &self.camera, &mut self.detections)?;
        self.users.update(&self.detections, &self.ground, pose, tick);
        Ok(())
    }

    /// What the detector found in the last frame.
    pub fn detections(&self) -> &[Detection] {
        &self.detections
    }

    /// Who keeps the ego from the change of lane that is due, seen in the mirror or, among `others`, ahead: as a vehicle that
    /// stands where the ego has to wait.
    pub fn keeps_back(&mut self, others: &RoadUsers, facts: &EgoFacts<'_>) -> Option<LeadState> {
        let Some(change) = Change::due(facts) else {
            self.forget();
            return None;
        };
        let ego = &facts.on_route.state;
        let bars = |user: &RoadUser| {
            let velocity =
                if user.seen < BELIEVED { direction(ego.pose.heading) * ego.speed } else { user.velocity };
            user.kind != Kind::Person && change.is_barred_by(user.place, velocity, user.kind.half(), facts)
        };
        let barred = self.stood < PATIENCE && self.users.iter().chain(others.iter()).any(bars);
        if barred && ego.speed < 0.5 {
            self.stood += facts.tick;
        }
        barred.then_some(LeadState { gap: change.way, closing_speed: ego.speed })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perception::testing::Road;
    use sumo_network::geometry::wrap_angle;
    use wad_camera::model::ObjectClass;

    /// A road on which the route changes from the right lane to the left one, and where the ego has to wait (m).
    fn changing() -> (Road, f64) {
        let road = Road::of(sumo_network::network::testing::net(), "ab_0", "bl_0", "GGG");
        let at = road.route.sections.iter().find(|at| at.from_lane.is_some()).unwrap();
        let wait = at.s_start + BEGUN * (at.s_end - at.s_start);
        (road, wait)
    }

    #[test]
    fn the_mirror_looks_back_on_the_side_that_the_route_changes_to_and_only_before_that() {
        let (road, wait) = changing();
        let facts = road.facts(wait - 8.0, 0.0, 0.0, 10.0);
        let (ego, mirror) = (facts.on_route.state.pose, pose(&facts).unwrap());
        assert!((ego.to_local(mirror.xy()) - Vector::new(AHEAD, ASIDE)).norm() < 1e-6, "{mirror:?}");
        assert!((wrap_angle(mirror.heading - ego.heading) - BACK).abs() < 1e-6, "{mirror:?}");
        assert!(pose(&road.facts(wait + 1.0, 0.0, 0.0, 10.0)).is_none(), "it has begun");
        assert!(pose(&road.facts(wait - 8.0, 0.0, 0.0, 0.1)).is_none(), "there is time");
    }

    /// The mirror's box of a car at `there` (m, in the frame of the mirror).
    fn car(ground: &GroundPlane, there: Vector) -> Detection {
        let edge = |side: f32| ground.pixel([there.x as f32, there.y as f32 + side]).unwrap();
        let ([left, bottom], [right, _]) = (edge(0.9), edge(-0.9));
        Detection { class: ObjectClass::Car, bounds: [left, bottom - 100.0, right, bottom], score: 1.0 }
    }

    /// What the ego is told, `way` (m) before it has to wait, at 10 m/s, after twelve looks at a car `x` m ahead of it and `y` m
    /// to the left that is `closing` (m/s) faster.
    fn told(way: f64, [x, y]: [f64; 2], closing: f64) -> Option<LeadState> {
        let (road, wait) = changing();
        let front = CameraConfig::default();
        let mut mirrors = Mirrors::new(&front, None);
        let mut last = None;
        for look in (0..12).rev() {
            let before = f64::from(look) * 0.167;
            let facts = road.facts(wait - way - 10.0 * before, 0.0, 0.0, 10.0);
            let (ego, mirror) = (facts.on_route.state.pose, pose(&facts).unwrap());
            let there = mirror.to_local(ego.to_world(Vector::new(x - closing * before, y)));
            let one = car(&mirrors.ground, there);
            mirrors.users.update(&[one], &mirrors.ground, &mirror, facts.tick);
            last = mirrors.keeps_back(&RoadUsers::default(), &facts);
        }
        last
    }

    #[test]
    fn who_is_beside_or_comes_up_on_the_other_lane_keeps_the_ego_back() {
        let beside = told(8.0, [-4.0, 3.2], 0.0).unwrap();
        assert!((beside.gap - 8.0).abs() < 1e-6 && beside.closing_speed == 10.0, "{beside:?}");
        assert!(told(8.0, [-14.0, 3.2], 5.0).is_some(), "it is faster");
        assert!(told(8.0, [-14.0, 3.2], -2.0).is_none(), "it falls behind");
        assert!(told(8.0, [-14.0, 8.0], 5.0).is_none(), "it is on no lane of the change");
        assert!(told(8.0, [-14.0, 0.0], 5.0).is_none(), "it follows on the ego's own lane");
    }

    #[test]
    fn who_has_waited_long_goes() {
        let (road, wait) = changing();
        let mut mirrors = Mirrors::new(&CameraConfig::default(), None);
        let facts = road.facts(wait - 2.0, 0.0, 0.0, 0.0);
        let mirror = pose(&facts).unwrap();
        let there = mirror.to_local(facts.on_route.state.pose.to_world(Vector::new(-4.0, 3.2)));
        let one = car(&mirrors.ground, there);
        let mut ticks = 0;
        while ticks < 200 {
            mirrors.users.update(std::slice::from_ref(&one), &mirrors.ground, &mirror, facts.tick);
            if mirrors.keeps_back(&RoadUsers::default(), &facts).is_none() {
                break;
            }
            ticks += 1;
        }
        assert_eq!(ticks, (PATIENCE / facts.tick).ceil() as u32);
    }
}
