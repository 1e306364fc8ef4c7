//! All stages of a tick in order: detect, lanes, light, vehicle in front, transformed image, raw state.

use super::crossing;
use super::facts::EgoFacts;
use super::lead::{self, LeadTracker};
use super::light::{self, LightAhead, SeenLights, StopLight};
use super::mirrors::Mirrors;
use super::paint::Painter;
use super::road_users::RoadUsers;
use super::sight_score::{LightCounts, LimitCounts};
use super::{
    Detection, Detector, DrivableArea, GroundPlane, IN_TOWNS, ImageKind, LaneDetector, LaneEstimate,
    PerceptionError, SeenLimit, SeenSign, TransformedImage,
};
use crate::observation::{LeadState, RawState};
use sumo_network::geometry::Pose;
use wad_camera::{CameraConfig, Frame, Outputs};

/// What was perceived in a tick.
#[derive(Clone, Debug)]
pub struct Percept {
    /// The objects found in the picture.
    pub detections: Vec<Detection>,
    /// The boundaries of the ego's lane.
    pub lanes: LaneEstimate,
    /// The next signal on the route.
    pub light: Option<LightAhead>,
    /// The ego is at the intersection and the light is red: painted.
    pub light_red: bool,
    /// Signs in the picture; none where the detector sees none.
    pub signs: Vec<SeenSign>,
    /// The speed limit that the last sign set, before the first that [within towns](super::IN_TOWNS) (km/h); None
    /// where the detector sees no signs.
    pub limit: Option<u32>,
    /// What is road; None where the detector does not see it.
    pub area: Option<DrivableArea>,
    /// The road user in the ego's path. The nearest of it, `crossing` and `beside` is the raw state's vehicle in
    /// front.
    pub lead: Option<LeadState>,
    /// A vehicle that will be in the ego's path where the ego has to give way.
    pub crossing: Option<LeadState>,
    /// Who keeps the ego from a change of lane, where it has to wait for that; None without [mirrors](super::mirrors).
    pub beside: Option<LeadState>,
    /// The encoder's input.
    pub transformed: TransformedImage,
    /// The raw states, in units.
    pub raw: RawState,
}

/// Perceives, tick by tick.
pub struct Perception {
    detector: Box<dyn Detector>,
    camera: CameraConfig,
    ground: GroundPlane,
    lanes: LaneDetector,
    lead: LeadTracker,
    road_users: RoadUsers,
    mirrors: Option<Mirrors>,
    seen_lights: SeenLights,
    light_counts: LightCounts,
    seen_limit: SeenLimit,
    limit_counts: LimitCounts,
    stop_light: StopLight,
    painter: Painter,
    percept: Percept,
}

impl Perception {
    /// Perception with a detector, for frames of `camera`.
    pub fn new(detector: Box<dyn Detector>, camera: CameraConfig) -> Self {
        Self {
            detector,
            camera,
            ground: GroundPlane::new(&camera),
            lanes: LaneDetector::default(),
            lead: LeadTracker::default(),
            road_users: RoadUsers::default(),
            mirrors: None,
            seen_lights: SeenLights::default(),
            light_counts: LightCounts::default(),
            seen_limit: SeenLimit::default(),
            limit_counts: LimitCounts::default(),
            stop_light: StopLight::default(),
            painter: Painter::default(),
            percept: Percept {
                detections: Vec::new(),
                lanes: LaneEstimate::default(),
                light: None,
                light_red: false,
                signs: Vec::new(),
                limit: None,
                area: None,
                lead: None,
                crossing: None,
                beside: None,
                transformed: TransformedImage::default(),
                raw: RawState::STANDING,
            },
        }
    }

    /// Also looks back where the route changes lanes.
    pub fn look_back(&mut self) {
        self.mirrors = Some(Mirrors::new(&self.camera, self.detector.for_another_camera()));
    }

    /// Makes this image for the encoder.
    pub fn show(&mut self, kind: ImageKind) {
        self.painter.kind = kind;
    }

    /// The image that it makes for the encoder.
    pub fn image_kind(&self) -> ImageKind {
        self.painter.kind
    }

    /// The camera whose frames it takes.
    pub fn camera(&self) -> &CameraConfig {
        &self.camera
    }

    /// The outputs that the camera must render for the detector; lanes and the transformed image need the
    /// picture besides.
    pub fn needs(&self) -> Outputs {
        self.detector.needs()
    }

    /// The detector's name.
    pub fn detector(&self) -> &str {
        self.detector.name()
    }

    /// Begins an episode: forgets everything, draws the detector's faults from `seed`.
    pub fn reset(&mut self, seed: u64) {
        self.detector.reset(seed);
        self.lanes.reset();
        self.lead.reset();
        self.road_users.reset();
        if let Some(mirrors) = &mut self.mirrors {
            mirrors.reset(seed);
        }
        self.seen_lights.reset();
        self.light_counts = LightCounts::default();
        self.seen_limit.reset();
        self.limit_counts = LimitCounts::default();
        self.stop_light.reset();
    }

    /// First stage: the detections in `frame`, which is [`Perception::camera`]'s.
    ///
    /// # Errors
    /// The frame is not the camera's, or the detector fails.
    pub fn detect(&mut self, frame: &Frame) -> Result<(), PerceptionError> {
        let expected = (self.camera.width, self.camera.height);
        let found = (frame.width, frame.height);
        if expected != found {
            let hint = "render with the camera that the perception was made for".to_string();
            return Err(PerceptionError::Size { expected, found, hint });
        }
        self.detector.detect(frame, &self.camera, &mut self.percept.detections)
    }

    /// Before the first stage, where there is a mirror to look into: who is in its `frame`, taken from `pose`.
    ///
    /// # Errors
    /// The detector fails.
    pub fn detect_behind(&mut self, frame: &Frame, pose: &Pose, tick: f64) -> Result<(), PerceptionError> {
        let Some(mirrors) = &mut self.mirrors else { return Ok(()) };
        mirrors.look(&mut *self.detector, frame, pose, tick)
    }

    /// What the detector found in the [mirror](super::mirrors) that was looked into last; nothing where there is none.
    pub fn behind(&self) -> &[Detection] {
        self.mirrors.as_ref().map_or(&[], Mirrors::detections)
    }

    /// Second stage: the lane boundaries.
    pub fn find_lanes(&mut self, frame: &Frame, facts: &EgoFacts<'_>) {
        self.percept.lanes = match self.detector.seen() {
            Some(seen) => seen.lanes,
            None => self.lanes.find(frame, &self.ground, facts),
        };
    }

    /// Third stage: the light, the vehicle in front, the raw state.
    pub fn judge(&mut self, facts: &EgoFacts<'_>) {
        let light = match self.detector.seen() {
            Some(seen) => {
                let speed = facts.on_route.state.speed;
                let there = LightAhead::find(facts);
                let can_be = |distance: f64| light::can_be(facts, distance);
                let believed = self.seen_lights.update(seen.light, speed, facts.tick, can_be);
                tracing::debug!(
                    "light: {:?} seen, {believed:?} believed, {there:?} there, {speed:.2} m/s",
                    seen.light
                );
                self.light_counts.note(facts, there.as_ref(), believed.as_ref());
                self.percept.signs.clear();
                self.percept.signs.extend(seen.signs.iter().flatten());
                let signed = self.seen_limit.update(&self.percept.signs, &facts.on_route.state.pose);
                let limit = signed.unwrap_or(IN_TOWNS);
                tracing::debug!("limit: {:?} seen, {signed:?} by signs", self.percept.signs);
                self.percept.limit = Some(limit);
                self.percept.area = Some(seen.area);
                self.limit_counts.note(facts, limit, signed.is_some());
                believed
            }
            None => LightAhead::find(facts),
        };
        self.percept.light = light;
        self.percept.light_red = light.is_some_and(|light| light.is_red_here());
        let pose = &facts.on_route.state.pose;
        self.road_users.update(&self.percept.detections, &self.ground, pose, facts.tick);
        let nearest = lead::nearest(&self.percept.detections, &self.ground, facts);
        let lead = self.lead.update(nearest.as_ref(), &self.road_users, &self.ground, facts);
        let crossing = crossing::nearest(&self.road_users, facts);
        let beside = self.mirrors.as_mut().and_then(|mirrors| mirrors.keeps_back(&self.road_users, facts));
        (self.percept.lead, self.percept.crossing, self.percept.beside) = (lead, crossing, beside);
        tracing::debug!(
            "in front: {lead:?}, will cross: {crossing:?}, beside: {beside:?}, by {:?}",
            self.percept.detections
        );
        let lead = lead.into_iter().chain(crossing).chain(beside).min_by(|a, b| a.gap.total_cmp(&b.gap));
        let speed = facts.on_route.state.speed;
        let is_seen = self.detector.seen().is_some();
        let stop_light = self.stop_light.update(light.as_ref(), is_seen, speed).filter(|d| *d <= lead::SIGHT);
        let raw = RawState::of(facts.route, &facts.on_route, lead, stop_light);
        let fastest = if is_seen { light::BY_SIGHT } else { f64::INFINITY };
        self.percept.raw = RawState { speed_limit: raw.speed_limit.min(fastest), ..raw };
    }

    /// Last stage: the transformed image.
    ///
    /// # Errors
    /// The frame has no picture.
    pub fn transform(&mut self, frame: &Frame) -> Result<(), PerceptionError> {
        let Percept { detections, lanes, light_red, transformed, .. } = &mut self.percept;
        self.painter.paint(frame, &self.ground, detections, lanes, *light_red, transformed)
    }

    /// The last tick's percept.
    pub fn percept(&self) -> &Percept {
        &self.percept
    }

    /// Ticks of this episode by what was believed of the light; None where the simulator tells it.
    pub fn light_counts(&self) -> Option<LightCounts> {
        self.detector.seen().map(|_| self.light_counts)
    }

    /// The same of the speed limit.
    pub fn limit_counts(&self) -> Option<LimitCounts> {
        self.detector.seen().map(|_| self.limit_counts)
    }

    /// The ground under the camera.
    pub fn ground(&self) -> &GroundPlane {
        &self.ground
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perception::testing::{LENGTH, Road, picture, seen};
    use crate::perception::{LaneBoundary, Seen, SeenLight, TruthDetector, mirrors};
    use sumo_network::network::testing::net;
    use sumo_network::world::SignalState;
    use wad_camera::model::{ObjectClass, Sign};

    /// All stages of a look.
    fn look(one: &mut Perception, frame: &Frame, facts: &EgoFacts<'_>) {
        one.detect(frame).unwrap();
        one.find_lanes(frame, facts);
        one.judge(facts);
        one.transform(frame).unwrap();
    }

    /// Sees a lane and a light, whatever the picture.
    struct Sees(Seen);

    impl Detector for Sees {
        fn name(&self) -> &str {
            "sees"
        }

        fn detect(
            &mut self,
            _: &Frame,
            _: &CameraConfig,
            found: &mut Vec<Detection>,
        ) -> Result<(), PerceptionError> {
            found.clear();
            Ok(())
        }

        fn seen(&self) -> Option<&Seen> {
            Some(&self.0)
        }
    }

    #[test]
    fn what_is_seen_of_lane_and_light_counts_and_the_simulator_does_not() {
        let line = LaneBoundary { offset: 1.5, slope: 0.0, bend: 0.0, reach: [4.0, 20.0] };
        let light = SeenLight { state: SignalState::Red, distance: 12.0, certainty: 0.9 };
        let lanes = LaneEstimate { left: Some(line), right: None };
        let seen = Seen { lanes, light: Some(light), ..Seen::default() };
        let camera = CameraConfig::default();
        let told = |state: &str| {
            let mut perception = Perception::new(Box::new(Sees(seen)), camera);
            let road = Road::new(state);
            let facts = road.facts(road.route.links[0].stop_s - 12.0 - 0.5 * LENGTH, 0.1, 0.0, 0.0);
            // One look is not believed.
            for _ in 0..2 {
                look(&mut perception, &picture(&camera, &[]), &facts);
            }
            let percept = perception.percept();
            (percept.transformed.clone(), percept.lanes, percept.light, percept.raw)
        };
        let green = told("GGG");
        assert_eq!(green, told("rGG"), "the simulator's light is in the percept");
        assert_eq!(green.1, seen.lanes);
        // Less the room before the line.
        assert_eq!(green.2.map(|light| light.distance), Some(6.0));
        assert_eq!(green.3.stop_light, Some(6.0));
    }

    #[test]
    fn who_sees_the_lights_is_told_no_faster_limit_than_he_can_stop_from() {
        let camera = CameraConfig::default();
        let told = |detector: Box<dyn Detector>, limit: f64| {
            let mut road = Road::new("GGG");
            road.route.sections.iter_mut().for_each(|section| section.speed_limit = limit);
            let mut perception = Perception::new(detector, camera);
            perception.judge(&road.facts(30.0, 0.0, 0.0, 10.0));
            perception.percept().raw.speed_limit
        };
        let sees = || Box::new(Sees(Seen::default()));
        assert_eq!((told(sees(), 25.0), told(sees(), 15.0)), (light::BY_SIGHT, 15.0));
        assert_eq!(told(Box::new(TruthDetector::new()), 25.0), 25.0);
    }

    #[test]
    fn a_frame_of_another_camera_is_refused() {
        let mut perception = Perception::new(Box::new(TruthDetector::new()), CameraConfig::default());
        let frame = picture(&CameraConfig::sized(256, 256), &[]);
        let error = perception.detect(&frame).unwrap_err().to_string();
        assert!(error.contains("(512, 512)") && error.contains("(256, 256)"), "{error}");
    }

    /// Sees nothing at its first look, then a vehicle in front, one in the mirror, a red light, and a sign that the ego passes.
    #[derive(Default)]
    struct Script {
        looks: u8,
        seen: Seen,
    }

    impl Detector for Script {
        fn name(&self) -> &str {
            "script"
        }

        fn reset(&mut self, _: u64) {
            self.looks = 0;
        }

        fn detect(
            &mut self,
            _: &Frame,
            camera: &CameraConfig,
            found: &mut Vec<Detection>,
        ) -> Result<(), PerceptionError> {
            found.clear();
            if camera.mount != CameraConfig::default().mount {
                let ground = GroundPlane::new(camera);
                let [[left, bottom], [right, _]] = [1.9, 0.1].map(|y| ground.pixel([5.3, y]).unwrap());
                let bounds = [left, bottom - 100.0, right, bottom];
                found.push(Detection { class: ObjectClass::Car, bounds, score: 1.0 });
                return Ok(());
            }
            self.seen = Seen::default();
            if self.looks > 0 {
                let driven = STEP * f64::from(self.looks);
                found.push(seen(ObjectClass::Car, 15.0, 0.0, 1.8, 1.5));
                let light = SeenLight { state: SignalState::Red, distance: 260.0 - driven, certainty: 0.9 };
                self.seen.light = Some(light);
                let at = [4.5 - driven as f32, -3.0];
                let sign =
                    SeenSign { sign: Sign::Limit(30), at, pixel: [0.0; 2], radius: 0.0, certainty: 0.9 };
                self.seen.signs[0] = Some(sign).filter(|_| self.looks < 4);
            }
            self.looks += 1;
            Ok(())
        }

        fn seen(&self) -> Option<&Seen> {
            Some(&self.seen)
        }
    }

    /// The ego's way from look to look (m).
    const STEP: f64 = 0.6;

    #[test]
    fn an_episode_leaves_nothing_to_the_next() {
        // A change of lane is due, on a road of 50 km/h.
        let mut road = Road::of(net(), "ab_0", "bl_0", "GGG");
        road.network.lanes.iter_mut().for_each(|lane| lane.speed_limit = 50.0 / 3.6);
        let change = road.route.sections.iter().find(|at| at.from_lane.is_some()).unwrap();
        let begin = change.s_start - 4.0;
        let camera = CameraConfig::default();
        let frame = picture(&camera, &[]);
        let mut one = Perception::new(Box::new(Script::default()), camera);
        one.look_back();
        let mut episode = || {
            one.reset(3);
            let mut told = Vec::new();
            for n in 0..6 {
                let facts = road.facts(begin + STEP * f64::from(n), 0.0, 0.0, 3.6);
                if n > 0 {
                    let pose = mirrors::pose(&facts).unwrap();
                    one.detect_behind(&frame, &pose, facts.tick).unwrap();
                }
                look(&mut one, &frame, &facts);
                let counts = (one.light_counts(), one.limit_counts());
                let Percept { detections, light, limit, lead, beside, raw, .. } = one.percept().clone();
                told.push((detections, light, limit, lead, beside, raw, counts));
            }
            told
        };
        let first = episode();
        assert_eq!(first, episode());
        let (detections, light, limit, lead, beside, ..) = &first[0];
        assert!(detections.is_empty() && *limit == Some(IN_TOWNS), "{:?}", first[0]);
        assert_eq!((*light, *lead, *beside), (None, None, None));
        let (_, light, limit, lead, beside, _, (lights, limits)) = &first[5];
        assert!(
            light.is_some() && *limit == Some(30) && lead.is_some() && beside.is_some(),
            "{:?}",
            first[5]
        );
        assert_eq!((lights.map(|all| all.without), limits.map(|all| all.ticks)), (Some(6), Some(6)));
    }

    #[test]
    fn an_episode_leaves_no_lane_and_no_light_to_the_next() {
        let road = Road::new("yGG");
        let stop = road.route.links[0].stop_s;
        let camera = CameraConfig::default();
        let line = |offset| LaneBoundary { offset, slope: 0.02, bend: 0.0, reach: [3.0, 25.0] };
        let frames = [picture(&camera, &[]), picture(&camera, &[1.4, -1.6].map(line))];
        let mut one = Perception::new(Box::new(TruthDetector::new()), camera);
        let mut episode = || {
            one.reset(3);
            let mut told = Vec::new();
            // Too fast to stop, on a road without lines; then slow, and farther away.
            for (n, speed) in [14.0, 2.0, 2.0].into_iter().enumerate() {
                let facts = road.facts(stop - 20.0 - n as f64, 0.1, 0.0, speed);
                look(&mut one, &frames[n.min(1)], &facts);
                told.push((one.percept().lanes, one.percept().raw.stop_light));
            }
            told
        };
        let first = episode();
        assert_eq!(first, episode());
        let [(none, None), .., (lanes, Some(_))] = first[..] else { panic!("{first:?}") };
        assert!(none == LaneEstimate::default() && lanes.left.is_some(), "{first:?}");
    }
}
