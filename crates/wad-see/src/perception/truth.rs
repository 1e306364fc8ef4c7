//! The detectors `truth` and `outlines`: boxes of visible objects, as the renderer drew them or worked out from
//! shapes without drawing, optionally with a real detector's faults.

use super::{Detection, Detector, PerceptionError};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use sumo_network::seeds::{self, normal};
use wad_camera::model::ObjectClass;
use wad_camera::{CameraConfig, Frame, ObjectTruth, Outputs};

/// The faults of a detector. Sizes are in pixels of a picture 512 wide.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Faults {
    /// Share of large objects in plain view that are missed (0..1).
    pub miss: f64,
    /// Half of the objects of this size (square root of the box's area) are missed; 0: size does not matter.
    pub half_size: f64,
    /// Half of the objects of which this share is visible are missed; 0: occlusion does not matter.
    pub half_visible: f64,
    /// How long a miss lasts: 0 is drawn again each tick, 1 lasts for ever.
    pub persistence: f64,
    /// Standard deviation of each side of a box, as a share of the box's size.
    pub jitter: f64,
    /// Least standard deviation of each side of a box (pixels).
    pub least_jitter: f64,
    /// False alarms that begin in a tick, on average. Each lasts two ticks on average.
    pub false_alarms: f64,
}

impl Faults {
    /// No faults.
    pub const NONE: Self = Self {
        miss: 0.0,
        half_size: 0.0,
        half_visible: 0.0,
        persistence: 0.0,
        jitter: 0.0,
        least_jitter: 0.0,
        false_alarms: 0.0,
    };

    /// About the faults of a small network that runs in real time.
    pub const HONEST: Self = Self {
        miss: 0.02,
        half_size: 9.0,
        half_visible: 0.25,
        persistence: 0.8,
        jitter: 0.03,
        least_jitter: 0.4,
        false_alarms: 0.02,
    };
}

impl Default for Faults {
    fn default() -> Self {
        Self::NONE
    }
}

/// Boxes of the renderer's ground truth.
pub struct TruthDetector {
    faults: Faults,
    /// The boxes come from shapes: nothing is drawn.
    outlines: bool,
    rng: ChaCha8Rng,
    /// Each visible object of the last tick: its class, box and luck (a standard normal number).
    luck: Vec<(ObjectClass, [f32; 4], f64)>,
    ghosts: Vec<Detection>,
}

/// Objects with fewer visible pixels than this in a picture of 512 x 512 are never detected.
const LEAST_PIXELS: f32 = 12.0;

impl Default for TruthDetector {
    fn default() -> Self {
        Self::with_faults(Faults::NONE)
    }
}

impl TruthDetector {
    /// A detector without faults.
    pub fn new() -> Self {
        Self::default()
    }

    /// A detector with faults.
    pub fn with_faults(faults: Faults) -> Self {
        Self { faults, outlines: false, rng: seeds::rng(0, "detector"), luck: Vec::new(), ghosts: Vec::new() }
    }

    /// The same with boxes that are worked out from shapes.
    #[must_use]
    pub fn by_outlines(self) -> Self {
        Self { outlines: true, ..self }
    }

    /// The probability that an object is found.
    fn chance(&self, object: &ObjectTruth, scale: f64) -> f64 {
        let f = &self.faults;
        let [l, t, r, b] = object.visible_box.map(f64::from);
        let size = ((r - l) * (b - t)).sqrt() / scale;
        let by_size = if f.half_size > 0.0 { logistic((size / f.half_size).ln() / 0.25) } else { 1.0 };
        let by_sight = if f.half_visible > 0.0 {
            logistic((visible_share(object) - f.half_visible) / 0.06)
        } else {
            1.0
        };
        (1.0 - f.miss) * by_size * by_sight
    }

    /// The luck of an object: like that of the same object a tick ago.
    fn luck_of(
        &mut self,
        class: ObjectClass,
        bounds: [f32; 4],
        before: &[(ObjectClass, [f32; 4], f64)],
    ) -> f64 {
        let new = normal(&mut self.rng);
        let here = Detection { class, bounds, score: 1.0 };
        let same = before.iter().filter(|(old, ..)| *old == class).map(|(_, b, luck)| (here.iou(b), *luck));
        match same.max_by(|a, b| a.0.total_cmp(&b.0)) {
            Some((iou, luck)) if iou > 0.2 => {
                let p = self.faults.persistence.clamp(0.0, 1.0);
                p * luck + (1.0 - p * p).sqrt() * new
            }
            _ => new,
        }
    }

    fn jitter(&mut self, bounds: [f32; 4], camera: &CameraConfig, scale: f64) -> [f32; 4] {
        let [l, t, r, b] = bounds;
        let size = [r - l, b - t];
        let mut out = bounds;
        for (side, value) in out.iter_mut().enumerate() {
            let deviation =
                (self.faults.jitter * f64::from(size[side % 2])).max(self.faults.least_jitter * scale);
            *value += (deviation * normal(&mut self.rng)) as f32;
        }
        let (w, h) = (camera.width as f32, camera.height as f32);
        let [l, t, r, b] = out;
        let (l, r) = (l.min(r - 1.0).clamp(0.0, w - 1.0), r.clamp(1.0, w));
        let (t, b) = (t.min(b - 1.0).clamp(0.0, h - 1.0), b.clamp(1.0, h));
        [l, t, r.max(l + 1.0), b.max(t + 1.0)]
    }

    /// Boxes of what is not there.
    fn haunt(&mut self, camera: &CameraConfig, scale: f64) {
        let rng = &mut self.rng;
        self.ghosts.retain(|_| rng.random::<f64>() < 0.5);
        if rng.random::<f64>() < self.faults.false_alarms {
            let class = match rng.random_range(0..10) {
                0..=3 => ObjectClass::Person,
                4..=7 => ObjectClass::Car,
                8 => ObjectClass::Truck,
                _ => ObjectClass::TrafficLight,
            };
            // Mostly small, most of them near the horizon.
            let size = scale * 8.0 * 8.0_f64.powf(rng.random::<f64>());
            let broad = if class == ObjectClass::Person { 0.4 } else { 1.2 };
            let (w, h) = (camera.width as f64, camera.height as f64);
            let x = rng.random::<f64>() * w;
            let y = 0.5 * h + 0.5 * size * (0.2 + rng.random::<f64>());
            let (half_w, half_h) = (0.5 * broad * size, 0.5 * size);
            let bounds = [(x - half_w).max(0.0), y - half_h, (x + half_w).min(w), (y + half_h).min(h)];
            let bounds = bounds.map(|v| v as f32);
            let score = 0.3 + 0.3 * rng.random::<f32>();
            if bounds[2] - bounds[0] >= 2.0 {
                self.ghosts.push(Detection { class, bounds, score });
            }
        }
    }
}

/// Whether `frame` shows enough of an object.
pub(super) fn is_visible(object: &ObjectTruth, frame: &Frame) -> bool {
    let scale = (frame.width * frame.height) as f32 / (512.0 * 512.0);
    object.visible_pixels as f32 >= (LEAST_PIXELS * scale).max(2.0)
}

/// Share of an object that nothing hides (0..1): its pixels against what its class fills of its box.
fn visible_share(object: &ObjectTruth) -> f64 {
    let [l, t, r, b] = object.full_box.map(f64::from);
    let area = ((r - l) * (b - t)).max(1.0);
    (f64::from(object.visible_pixels) / (f64::from(object.class.fills()) * area)).min(1.0)
}

fn logistic(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}

/// The share of standard normal numbers below `x` (logistic approximation, error below 0.01).
fn normal_share(x: f64) -> f64 {
    logistic(1.702 * x)
}

impl Detector for TruthDetector {
    fn name(&self) -> &str {
        match (self.outlines, self.faults == Faults::NONE) {
            (false, true) => "truth",
            (false, false) => "truth:faulty",
            (true, true) => "outlines",
            (true, false) => "outlines:faulty",
        }
    }

    fn needs(&self) -> Outputs {
        Outputs { boxes: !self.outlines, outlines: self.outlines, ..Outputs::NONE }
    }

    fn reset(&mut self, seed: u64) {
        self.rng = seeds::rng(seed, "detector");
        self.luck.clear();
        self.ghosts.clear();
    }

    fn for_another_camera(&self) -> Option<Box<dyn Detector>> {
        Some(Box::new(Self { outlines: self.outlines, ..Self::with_faults(self.faults) }))
    }

    fn detect(
        &mut self,
        frame: &Frame,
        camera: &CameraConfig,
        found: &mut Vec<Detection>,
    ) -> Result<(), PerceptionError> {
        found.clear();
        let visible = frame.objects.iter().filter(|object| is_visible(object, frame));
        if self.faults == Faults::NONE {
            found.extend(visible.map(|object| Detection {
                class: object.class,
                bounds: object.visible_box.map(|v| v as f32),
                score: 1.0,
            }));
            return Ok(());
        }
        let scale = camera.width as f64 / 512.0;
        let before = std::mem::take(&mut self.luck);
        for object in visible {
            let bounds = object.visible_box.map(|v| v as f32);
            let luck = self.luck_of(object.class, bounds, &before);
            self.luck.push((object.class, bounds, luck));
            let chance = self.chance(object, scale);
            let bounds = self.jitter(bounds, camera, scale);
            if normal_share(luck) < chance {
                let score = (0.3 + 0.7 * chance).min(0.99) as f32;
                found.push(Detection { class: object.class, bounds, score });
            }
        }
        self.haunt(camera, scale);
        found.extend_from_slice(&self.ghosts);
        found.sort_by(|a, b| b.score.total_cmp(&a.score));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perception::Perception;
    use sumo_network::geometry::Pose;
    use wad_camera::model::Box3;

    fn car(id: u32, size: u32, visible: f32) -> ObjectTruth {
        let (x, y) = (20 + 60 * (id % 8), 220 + 60 * (id / 8));
        let full = [x as f32, y as f32, (x + size) as f32, (y + size) as f32];
        let shown = ((size as f32 * visible) as u32).max(1);
        ObjectTruth {
            class: ObjectClass::Car,
            id,
            visible_pixels: (0.75 * (size * shown) as f32) as u32,
            visible_box: [x, y, x + shown, y + size],
            full_box: full,
            bounds: Box3 { pose: Pose::new(0.0, 0.0, 0.0, 0.0), size: [4.5, 1.8, 1.5] },
            depth: 20.0,
        }
    }

    fn share(detector: &mut TruthDetector, object: ObjectTruth, ticks: usize) -> f64 {
        let frame = Frame { width: 512, height: 512, objects: vec![object], ..Frame::default() };
        let (camera, mut found, mut seen) = (CameraConfig::default(), Vec::new(), 0);
        for tick in 0..ticks {
            detector.reset(tick as u64);
            detector.detect(&frame, &camera, &mut found).unwrap();
            seen += usize::from(
                found.iter().any(|d| d.iou(&frame.objects[0].visible_box.map(|v| v as f32)) > 0.3),
            );
        }
        seen as f64 / ticks as f64
    }

    #[test]
    fn without_faults_every_visible_box_is_found_as_it_is() {
        let objects: Vec<_> = (0..6).map(|id| car(id, 8 + 6 * id, 1.0)).collect();
        let frame = Frame { width: 512, height: 512, objects, ..Frame::default() };
        let mut found = Vec::new();
        TruthDetector::new().detect(&frame, &CameraConfig::default(), &mut found).unwrap();
        assert_eq!(found.len(), 6);
        assert!(found.iter().zip(&frame.objects).all(|(d, o)| d.bounds == o.visible_box.map(|v| v as f32)));
    }

    #[test]
    fn what_shows_a_few_pixels_only_is_not_found() {
        let mut speck = car(0, 30, 1.0);
        speck.visible_pixels = 5;
        assert_eq!(share(&mut TruthDetector::new(), speck, 3), 0.0);
    }

    #[test]
    fn small_and_hidden_objects_are_missed_more_often() {
        let mut faulty = TruthDetector::with_faults(Faults::HONEST);
        let large = share(&mut faulty, car(0, 50, 1.0), 400);
        let small = share(&mut faulty, car(0, 9, 1.0), 400);
        let hidden = share(&mut faulty, car(0, 50, 0.2), 400);
        assert!(large > 0.95, "{large}");
        assert!((0.3..0.7).contains(&small), "{small}");
        assert!(hidden < 0.4, "{hidden}");
    }

    #[test]
    fn faults_follow_the_seed_and_misses_last() {
        let frame = Frame {
            width: 512,
            height: 512,
            objects: vec![car(3, 10, 1.0), car(9, 40, 0.4)],
            ..Frame::default()
        };
        let run = |seed: u64| {
            let mut detector = TruthDetector::with_faults(Faults { false_alarms: 0.3, ..Faults::HONEST });
            detector.reset(seed);
            let mut all = Vec::new();
            for _ in 0..60 {
                let mut found = Vec::new();
                detector.detect(&frame, &CameraConfig::default(), &mut found).unwrap();
                all.push(found);
            }
            all
        };
        assert_eq!(run(5), run(5));
        assert_ne!(run(5), run(6));
        let flips = |persistence: f64| {
            let mut detector =
                TruthDetector::with_faults(Faults { persistence, false_alarms: 0.0, ..Faults::HONEST });
            let mut found = Vec::new();
            let mut seen = Vec::new();
            for _ in 0..400 {
                detector.detect(&frame, &CameraConfig::default(), &mut found).unwrap();
                seen.push(found.iter().any(|d| d.bounds[3] < 250.0));
            }
            seen.windows(2).filter(|pair| pair[0] != pair[1]).count()
        };
        assert!(2 * flips(0.95) < flips(0.0), "{} {}", flips(0.95), flips(0.0));
    }

    #[test]
    fn a_mirror_leaves_the_faults_of_the_front_camera_alone() {
        let objects = vec![car(3, 10, 1.0), car(9, 40, 0.4)];
        let frame = Frame { width: 512, height: 512, objects, ..Frame::default() };
        let (camera, pose) = (CameraConfig::default(), Pose::new(0.0, 0.0, 0.0, 0.0));
        let see = |mirror: bool| {
            let faults = Faults { false_alarms: 0.3, ..Faults::HONEST };
            let mut perception = Perception::new(Box::new(TruthDetector::with_faults(faults)), camera);
            perception.look_back();
            perception.reset(5);
            let mut all = Vec::new();
            for _ in 0..60 {
                if mirror {
                    perception.detect_behind(&frame, &pose, 0.167).unwrap();
                }
                perception.detect(&frame).unwrap();
                all.push(perception.percept().detections.clone());
            }
            all
        };
        assert_eq!(see(true), see(false));
    }

    #[test]
    fn false_alarms_come_at_their_rate_and_stay_in_the_picture() {
        let mut detector = TruthDetector::with_faults(Faults { false_alarms: 0.2, ..Faults::HONEST });
        let frame = Frame { width: 512, height: 512, ..Frame::default() };
        let (mut found, mut count) = (Vec::new(), 0);
        for _ in 0..2000 {
            detector.detect(&frame, &CameraConfig::default(), &mut found).unwrap();
            count += found.len();
            for d in &found {
                let [l, t, r, b] = d.bounds;
                assert!(l >= 0.0 && t >= 0.0 && r <= 512.0 && b <= 512.0 && l < r && t < b, "{d:?}");
            }
        }
        // 0.2 begin each tick and last two ticks on average.
        assert!((600..1000).contains(&count), "{count}");
    }
}
