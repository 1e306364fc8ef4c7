//! Collecting a dataset whose segments are driven elsewhere.

use crate::errors::Failure;
use crate::held::{Held, json, parse};
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use serde::Deserialize;
use std::path::PathBuf;
use std::sync::{Arc, OnceLock};
use wad_cosim::assets::{Assets, AssetsError};
use wad_cosim::camera::Preset;
use wad_cosim::dataset::{self, CollectOptions, DatasetError, Segment};

/// A dataset as Python describes it, in JSON.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Wanted {
    town: String,
    frames: usize,
    out: PathBuf,
    /// Frames to a shard; None: a twentieth of all, at most 500.
    per_shard: Option<usize>,
    seed: u64,
    /// Empty: those of training.
    weathers: Vec<Preset>,
    camera: bool,
    /// Simulation time between frames (s).
    every: f64,
    /// Mean time between disturbances (s); None: the default, 0: none.
    noise_pause: Option<f64>,
}

impl Wanted {
    fn options(text: &str) -> Result<CollectOptions, Failure> {
        let wanted: Self = parse(text)?;
        let mut options = CollectOptions::new(&wanted.town, wanted.frames, &wanted.out);
        options.per_segment = wanted.per_shard.unwrap_or(options.per_segment);
        options.seed = wanted.seed;
        options.camera = wanted.camera;
        options.every = wanted.every;
        options.noise.pause = wanted.noise_pause.unwrap_or(options.noise.pause);
        if !wanted.weathers.is_empty() {
            options.weathers = wanted.weathers;
        }
        let positive = options.frames > 0 && options.per_segment > 0 && options.every > 0.0;
        if !positive || options.noise.pause.is_nan() || options.noise.pause < 0.0 {
            let text = "frames, per_shard and every: expected more than 0; noise_pause: expected 0 or more";
            return Err(Failure::Input(text.to_string()));
        }
        Ok(options)
    }
}

fn failure(error: DatasetError) -> Failure {
    let text = error.to_string();
    match error {
        _ if error.is_input() => Failure::Input(text),
        _ if error.is_sumo() => Failure::Sumo(text),
        _ => Failure::Other(text),
    }
}

/// What frames of a town depend on beside the options.
fn identity(assets: &Assets) -> String {
    let (build, net, files) = (wad_cosim::program::version(), assets.net_hash(), assets.files_hash());
    format!("build {build}, net {net}, files {files}")
}

/// A dataset's folder with its plan. It holds the folder's lock.
#[pyclass(frozen)]
pub struct Collection(Held<dataset::Collection>);

impl Collection {
    fn with<T>(
        &self,
        then: impl FnOnce(&dataset::Collection) -> Result<T, DatasetError>,
    ) -> Result<T, Failure> {
        self.0.with(|collection| then(collection).map_err(failure))
    }
}

#[pymethods]
impl Collection {
    /// Opens the folder.
    #[new]
    fn new(py: Python<'_>, wanted: &str) -> PyResult<Self> {
        let options = Wanted::options(wanted)?;
        let opened = py.detach(|| dataset::Collection::open(&options).map_err(failure));
        Ok(Self(Held::new("the collection", opened?)))
    }

    /// What a [`Collector`] must find where it is.
    #[getter]
    fn identity(&self) -> PyResult<String> {
        Ok(self.with(|collection| Ok(identity(collection.assets())))?)
    }

    /// Frames of the whole plan.
    #[getter]
    fn wanted(&self) -> PyResult<usize> {
        Ok(self.with(|collection| Ok(collection.wanted()))?)
    }

    /// The segments without a shard, each in JSON, and the frames in shards.
    fn missing(&self) -> PyResult<(Vec<String>, usize)> {
        let (segments, frames) = self.with(dataset::Collection::missing)?;
        Ok((segments.iter().map(json).collect::<Result<_, _>>()?, frames))
    }

    /// Takes what a [`Collector`] drove. False: the shard is there already.
    fn put(&self, py: Python<'_>, segment: &str, shard: &[u8]) -> PyResult<bool> {
        let segment: Segment = parse(segment)?;
        Ok(py.detach(|| self.with(|collection| collection.put(&segment, shard)))?)
    }

    /// Writes the manifest, says in JSON what is there, and frees the folder.
    fn finish(&self, interrupted: bool) -> PyResult<String> {
        Ok(json(&self.0.finish()?.finish(interrupted).map_err(failure)?)?)
    }
}

/// Drives segments of a [`Collection`], wherever that is. The town stays.
#[pyclass(frozen)]
pub struct Collector {
    options: CollectOptions,
    expected: String,
    town: OnceLock<Arc<Assets>>,
}

#[pymethods]
impl Collector {
    /// For the dataset `wanted`; `expected` is its [`Collection::identity`].
    #[new]
    fn new(wanted: &str, expected: String) -> PyResult<Self> {
        Ok(Self { options: Wanted::options(wanted)?, expected, town: OnceLock::new() })
    }

    /// Drives a segment: the bytes of its shard.
    fn drive<'py>(&self, py: Python<'py>, segment: &str) -> PyResult<Bound<'py, PyBytes>> {
        let segment: Segment = parse(segment)?;
        let shard = py.detach(|| {
            let assets = self.town()?;
            dataset::drive_segment(&self.options, &assets, segment).map_err(failure)
        });
        Ok(PyBytes::new(py, &shard?))
    }
}

impl Collector {
    fn town(&self) -> Result<Arc<Assets>, Failure> {
        if let Some(assets) = self.town.get() {
            return Ok(Arc::clone(assets));
        }
        let config = wad_cosim::bundled::resolve(&self.options.town).map_err(AssetsError::from)?;
        let assets = Assets::open(&config, false)?;
        let (expected, found) = (&self.expected, identity(&assets));
        if *expected != found {
            return Err(Failure::Input(format!(
                "this machine would collect other frames: expected {expected}, found {found}; install the same build and town"
            )));
        }
        Ok(Arc::clone(self.town.get_or_init(|| assets)))
    }
}
