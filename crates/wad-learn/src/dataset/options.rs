//! Options of collecting.

use super::noise::NoiseParams;
use super::recorded::RecordedRun;
use std::path::{Path, PathBuf};
use std::time::Duration;
use wad_camera::Preset;
use wad_camera::model::ObjectClass;
use wad_camera::variety::Varied;
use wad_see::perception::ImageKind;

/// Options of collecting a dataset.
#[derive(Clone, Debug)]
pub struct CollectOptions {
    /// The town, as for `run`.
    pub town: String,
    /// Recorded runs to drive again; none: the autopilot drives in `town`.
    pub runs: Vec<RecordedRun>,
    /// Frames to collect.
    pub frames: usize,
    /// The dataset's folder.
    pub out: PathBuf,
    /// Frames to a segment, which is a shard.
    pub per_segment: usize,
    /// The seed of everything random.
    pub seed: u64,
    /// The weathers, in turn.
    pub weathers: Vec<Preset>,
    /// Keep the camera's pictures.
    pub camera: bool,
    /// The image for the encoder.
    pub image: ImageKind,
    /// Simulation time between frames (s); more while the ego stands.
    pub every: f64,
    /// Keep only frames that show an object of one of these classes; empty: all frames.
    pub showing: Vec<ObjectClass>,
    /// The camera looks from a place close behind whoever is next in the ego's lane, of what is to be shown; other frames
    /// are left out.
    pub near: bool,
    /// Signals show lamps drawn at random in pictures and labels, lane by lane; traffic obeys the real ones.
    pub random_signals: bool,
    /// What is drawn anew for each segment.
    pub vary: Vec<Varied>,
    /// Disturbances of the autopilot's controls.
    pub noise: NoiseParams,
    /// SUMOs in parallel.
    pub jobs: usize,
    /// Stop after this wall time; the dataset then counts as complete.
    pub time_limit: Option<Duration>,
}

/// The training weathers of all networks (spec.md "Conditions").
pub const TRAINING_WEATHERS: [Preset; 3] = [Preset::ClearNoon, Preset::CloudyNoon, Preset::SoftRainNoon];

impl CollectOptions {
    /// The defaults of `wad-cosim dataset collect`.
    pub fn new(town: &str, frames: usize, out: &Path) -> Self {
        Self {
            town: town.to_string(),
            runs: Vec::new(),
            frames,
            out: out.to_path_buf(),
            // At least twenty segments, so that all conditions and a validation share are included.
            per_segment: (frames / 20).clamp(10, 500),
            seed: 0,
            weathers: TRAINING_WEATHERS.to_vec(),
            camera: false,
            image: ImageKind::Transformed,
            every: 0.5,
            showing: Vec::new(),
            near: false,
            random_signals: false,
            vary: Vec::new(),
            noise: NoiseParams::default(),
            jobs: 1,
            time_limit: None,
        }
    }

    /// Whether vehicles, and people, are to be shown.
    pub(super) fn shows(&self) -> [bool; 2] {
        let any =
            |is_person: bool| self.showing.iter().any(|class| (*class == ObjectClass::Person) == is_person);
        [false, true].map(|is_person| self.showing.is_empty() || any(is_person))
    }
}
