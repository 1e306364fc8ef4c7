//! What to collect.

use super::noise::NoiseParams;
use super::recorded::RecordedRun;
use std::path::{Path, PathBuf};
use std::time::Duration;
use wad_camera::Preset;
use wad_camera::model::ObjectClass;

/// What to collect.
#[derive(Clone, Debug)]
pub struct CollectOptions {
    /// A bundled town, or whatever `run` takes.
    pub town: String,
    /// Recorded runs to drive again; none: the autopilot drives in `town`.
    pub runs: Vec<RecordedRun>,
    pub frames: usize,
    pub out: PathBuf,
    /// Frames to a segment, which is a shard.
    pub per_segment: usize,
    pub seed: u64,
    pub weathers: Vec<Preset>,
    /// Keep the camera's pictures too.
    pub camera: bool,
    /// Simulation time between frames (s); more while the ego stands.
    pub every: f64,
    /// Keep only frames that show an object of one of these classes; none: all frames.
    pub showing: Vec<ObjectClass>,
    pub noise: NoiseParams,
    /// SUMOs at once.
    pub jobs: usize,
    /// Stop after this wall time and be content with what there is.
    pub time_limit: Option<Duration>,
}

/// The weathers that everything is trained in (spec.md "Conditions").
pub const TRAINING_WEATHERS: [Preset; 3] = [Preset::ClearNoon, Preset::CloudyNoon, Preset::SoftRainNoon];

impl CollectOptions {
    /// The defaults of `wad-cosim dataset collect`.
    pub fn new(town: &str, frames: usize, out: &Path) -> Self {
        Self {
            town: town.to_string(),
            runs: Vec::new(),
            frames,
            out: out.to_path_buf(),
            // At least twenty segments, so that all conditions and a validation share are in.
            per_segment: (frames / 20).clamp(10, 500),
            seed: 0,
            weathers: TRAINING_WEATHERS.to_vec(),
            camera: false,
            every: 0.5,
            showing: Vec::new(),
            noise: NoiseParams::default(),
            jobs: 1,
            time_limit: None,
        }
    }
}
