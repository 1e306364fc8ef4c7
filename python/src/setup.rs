//! What an environment is made of, as Python hands it over.

use crate::episode::Episodes;
use crate::errors::Failure;
use pyo3::prelude::*;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError, Weak};
use wad_cosim::agent::policy::find_encoder;
use wad_cosim::assets::Assets;
use wad_cosim::camera::{CameraConfig, Preset};
use wad_cosim::env::{EnvOptions, ObservationMode};
use wad_cosim::eval::Suite;
use wad_cosim::eval::routes::{RouteError, Routes};
use wad_cosim::latent::Encoder;
use wad_cosim::observation::{LATENT_SIZE, RAW_SIZE};
use wad_cosim::perception::TRANSFORMED_SIZE;
use wad_cosim::seeds;
use wad_cosim::tasks::{Placement, TaskKind, TaskSpec};
use wad_cosim::traci::process::SumoInstall;
use wad_cosim::traffic::TrafficSpec;

/// Numbers of [`Part::Vector`]: the surroundings, then the raw states.
pub const VECTOR_SIZE: usize = ObservationMode::Vector.latent_size() + RAW_SIZE;

/// Numbers of [`Part::Latent`]: the latent, then the raw states.
pub const LATENT_AND_RAW_SIZE: usize = LATENT_SIZE + RAW_SIZE;

/// A part of an observation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Part {
    /// The raw states, scaled.
    Raw,
    /// What is round the ego, from the world itself, and the raw states.
    Vector,
    /// The latent, and the raw states.
    Latent,
    /// The front camera's picture.
    Image,
    /// The transformed image.
    Transformed,
}

impl Part {
    /// Its name in Python.
    pub fn name(self) -> &'static str {
        match self {
            Self::Raw => "raw",
            Self::Vector => "vector",
            Self::Latent => "latent",
            Self::Image => "image",
            Self::Transformed => "transformed",
        }
    }

    /// Whether it is made of bytes, not of 32-bit numbers.
    pub fn is_bytes(self) -> bool {
        matches!(self, Self::Image | Self::Transformed)
    }

    /// The shape of its array, with this camera.
    pub fn shape(self, camera: &CameraConfig) -> Vec<usize> {
        match self {
            Self::Raw => vec![RAW_SIZE],
            Self::Vector => vec![VECTOR_SIZE],
            Self::Latent => vec![LATENT_AND_RAW_SIZE],
            Self::Image => vec![camera.height, camera.width, 3],
            Self::Transformed => vec![TRANSFORMED_SIZE, TRANSFORMED_SIZE, 3],
        }
    }

    /// Whether lanes are found and the transformed image is painted for it.
    fn encodes(self) -> bool {
        matches!(self, Self::Latent | Self::Transformed)
    }
}

/// An environment as Python describes it, in JSON.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Setup {
    /// CONFIG.
    pub town: String,
    /// None: the scenario's.
    pub task: Option<TaskKind>,
    /// None: the task's or the scenario's own.
    pub traffic: Option<TrafficSpec>,
    /// Drawn from the episode's seed; empty: the scenario's, or ClearNoon.
    pub weathers: Vec<Preset>,
    /// None: the task's or the scenario's own.
    pub tick_limit: Option<u64>,
    /// The route never ends.
    pub endless: bool,
    /// The set of the town's routes that places are taken from; None: they are drawn.
    pub routes: Option<String>,
    /// The environment's options.
    pub options: EnvOptions,
    /// Makes the latent.
    pub encoder: String,
    /// The parts to compute.
    pub observation: Vec<Part>,
    /// Pictures are asked for: the camera follows.
    pub render: bool,
    /// SUMO's own window.
    pub gui: bool,
    /// The MCAP file that the drives go into; of several environments each has its own, [`Setup::recording`].
    pub record: Option<PathBuf>,
    /// Egos in one SUMO.
    pub egos: usize,
}

impl Setup {
    /// Reads what Python wrote.
    pub fn parse(text: &str) -> Result<Self, Failure> {
        let mut setup: Self = crate::held::parse(text)?;
        setup.options.gui = setup.gui;
        let encodes = setup.observation.iter().any(|part| part.encodes());
        setup.options.observation = match (setup.observation.contains(&Part::Vector), encodes) {
            (true, true) => {
                let text = "observation: `vector` knows the world and does not look; it goes with raw and image only";
                return Err(Failure::Input(text.to_string()));
            }
            (true, false) => ObservationMode::Vector,
            (false, true) => ObservationMode::LatentAndRaw,
            (false, false) => ObservationMode::RawOnly,
        };
        if setup.egos == 0 {
            return Err(Failure::Input("egos=0: expected 1 or more".to_string()));
        }
        let draws = setup.draws();
        if setup.egos > 1 && (draws || setup.routes.is_some()) {
            let text =
                "egos: several egos in one SUMO have neither pictures nor a benchmark's routes; use egos=1";
            return Err(Failure::Input(text.to_string()));
        }
        Ok(setup)
    }

    /// Whether pictures are drawn beside what the environment itself sees.
    pub fn draws(&self) -> bool {
        self.render || self.record.is_some() || self.observation.contains(&Part::Image)
    }

    /// The file of the drives of environment `index` of `count`: `drive.mcap` of one, `drive-0.mcap` and so on of several.
    pub fn recording(&self, index: usize, count: usize) -> Option<PathBuf> {
        let path = self.record.as_ref()?;
        if count == 1 {
            return Some(path.clone());
        }
        let mut name = path.file_stem().unwrap_or_default().to_os_string();
        name.push(format!("-{index}"));
        if let Some(ending) = path.extension() {
            name.push(".");
            name.push(ending);
        }
        Some(path.with_file_name(name))
    }

    /// A new encoder; one without weights where no latent is asked for.
    pub fn encoder(&self) -> Result<Box<dyn Encoder>, Failure> {
        let name = if self.observation.contains(&Part::Latent) { &self.encoder } else { "pooled" };
        find_encoder(name).map_err(|e| Failure::Input(e.to_string()))
    }
}

/// The episodes of an environment.
pub struct Tasks {
    /// The town.
    pub assets: Arc<Assets>,
    spec: TaskSpec,
    weathers: Vec<Preset>,
    routes: Vec<Placement>,
}

impl Tasks {
    /// Reads the town, which environments share.
    pub fn open(setup: &Setup) -> Result<Self, Failure> {
        let assets = town(&setup.town)?;
        let (mut spec, mut weathers) = match (setup.task, assets.scenario()) {
            (Some(kind), _) => (TaskSpec::new(kind), vec![Preset::ClearNoon]),
            (None, Some(scenario)) => {
                (scenario.task_spec(setup.options.tick_ms / 1000.0), vec![scenario.weather])
            }
            (None, None) => {
                let kinds: Vec<_> = TaskKind::ALL.iter().map(|kind| kind.name()).collect();
                return Err(Failure::Input(format!(
                    "`{}` is no scenario, so it has no task of its own: give task=, one of {}",
                    setup.town,
                    kinds.join(", ")
                )));
            }
        };
        spec.traffic = setup.traffic.or(spec.traffic);
        spec.tick_limit = setup.tick_limit.or(spec.tick_limit);
        spec.endless = setup.endless;
        if !setup.weathers.is_empty() {
            weathers.clone_from(&setup.weathers);
        }
        let input = |error: RouteError| Failure::Input(error.to_string());
        let routes = match &setup.routes {
            Some(set) => {
                let (routes, path) = Routes::find(&setup.town, &assets, None).map_err(input)?;
                routes.set(set, &path).map_err(input)?.to_vec()
            }
            None => Vec::new(),
        };
        Ok(Self { assets, spec, weathers, routes })
    }

    /// The episode of `seed`: its weather, and its route, unless that of number `route` is asked for.
    pub fn episode(&self, seed: u64, route: Option<usize>) -> Result<TaskSpec, Failure> {
        let drawn = |what: &str, n: usize| seeds::derive(seed, what) as usize % n.max(1);
        let weather = self.weathers[drawn("weather", self.weathers.len())];
        let route = match route {
            Some(route) if route < self.routes.len() => Some(route),
            Some(route) => {
                let n = self.routes.len();
                let text = match n {
                    0 => {
                        format!("route {route}: this environment draws its places, it has no list of routes")
                    }
                    _ => format!("route {route}: expected 0 to {}", n - 1),
                };
                return Err(Failure::Input(text));
            }
            None if self.routes.is_empty() => None,
            None => Some(drawn("route", self.routes.len())),
        };
        let placement = route.map(|route| self.routes[route].clone());
        Ok(TaskSpec { placement, ..self.spec.clone().in_weather(weather) })
    }
}

/// The town of a CONFIG, read once while an environment uses it.
fn town(config: &str) -> Result<Arc<Assets>, Failure> {
    static OPEN: Mutex<BTreeMap<String, Weak<Assets>>> = Mutex::new(BTreeMap::new());
    let mut open = OPEN.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(assets) = open.get(config).and_then(Weak::upgrade) {
        return Ok(assets);
    }
    let assets = Assets::load(config)?;
    open.retain(|_, assets| assets.strong_count() > 0);
    open.insert(config.to_string(), Arc::downgrade(&assets));
    Ok(assets)
}

/// Names of what travels with the package: towns, scenarios, tasks, weathers.
#[pyfunction]
pub fn names() -> BTreeMap<&'static str, Vec<String>> {
    let texts = |names: Vec<&str>| names.into_iter().map(String::from).collect::<Vec<_>>();
    BTreeMap::from([
        ("towns", wad_cosim::bundled::towns()),
        ("scenarios", wad_cosim::bundled::scenarios()),
        ("tasks", texts(TaskKind::ALL.iter().map(|kind| kind.name()).collect())),
        ("weathers", texts(Preset::ALL.iter().map(|weather| weather.name()).collect())),
    ])
}

/// The bundled suites, in JSON.
#[pyfunction]
pub fn suites() -> Result<String, PyErr> {
    let found: Result<Vec<Suite>, _> =
        wad_cosim::eval::names().iter().map(|name| Suite::find(name)).collect();
    let found = found.map_err(|e| Failure::Other(e.to_string()))?;
    Ok(serde_json::to_string(&found).map_err(|e| Failure::Other(e.to_string()))?)
}

/// The seconds of each of at most `steps` steps of the expert's drive through the episode of `seed`, without Python between
/// them: the measure for `python -m wad_cosim.bench`.
#[pyfunction]
pub fn bench(py: Python<'_>, setup: &str, seed: u64, steps: usize) -> PyResult<Vec<f64>> {
    let setup = Setup::parse(setup)?;
    let measured = py.detach(|| {
        let mut episodes = Episodes::new(Arc::new(Tasks::open(&setup)?), &setup, setup.record.as_deref())?;
        episodes.reset(seed, None)?;
        let mut seconds = Vec::with_capacity(steps);
        while seconds.len() < steps {
            let action = episodes.expert()?;
            let begin = std::time::Instant::now();
            let (_, news) = episodes.step(action)?;
            seconds.push(begin.elapsed().as_secs_f64());
            if news.ending.is_some() {
                break;
            }
        }
        episodes.close()?;
        Ok::<_, Failure>(seconds)
    });
    Ok(measured?)
}

/// Names the home folder of the SUMO that came with the package.
#[pyfunction]
pub fn use_sumo(home: PathBuf) {
    SumoInstall::set_own(home);
}

/// Names the folder of the OpenVINO libraries that came with a package.
#[pyfunction]
pub fn use_openvino(folder: PathBuf) {
    wad_cosim::inference::set_own(folder);
}
