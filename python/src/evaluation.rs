//! Benchmarks: the same plan, seeds and records as the command line's `eval`, with a driver of Python's.

use crate::errors::{Error, Failure, InputError};
use crate::held::{Held, json, parse};
use numpy::{PyArray1, PyReadonlyArray1};
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use serde::Deserialize;
use std::collections::HashSet;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use wad_cosim::agent::action::{Action, to_control};
use wad_cosim::agent::actor::PlainActor;
use wad_cosim::agent::external::Limits;
use wad_cosim::agent::params::{Algorithm, InputScale, Inputs};
use wad_cosim::agent::policy::{Policy, PolicyCard, find_encoder};
use wad_cosim::agent::{Agent, AgentError};
use wad_cosim::assets::Assets;
use wad_cosim::camera::CameraConfig;
use wad_cosim::env::{EnvError, EnvOptions, ObservationMode};
use wad_cosim::eval::{
    self, Case, Driven, DriverError, DriverSpec, EvalError, Evaluation, Keep, Made, Manifest, Order, Packed,
    Results, Selection, StoreError, Suite, Towns, report,
};
use wad_cosim::eyes::EyesError;
use wad_cosim::folder_lock::LockError;
use wad_cosim::observation::{self, Observation};
use wad_cosim::traffic::TrafficSpec;
use wad_cosim::vehicle::Control;

/// A trained agent that drives with numbers of Python's.
#[pyclass(frozen)]
pub struct LoadedAgent {
    policy: Policy,
    path: PathBuf,
    actor: PlainActor,
    #[pyo3(get)]
    observation: &'static str,
    /// The encoder that made the latents of its training.
    #[pyo3(get)]
    encoder: String,
}

#[pymethods]
impl LoadedAgent {
    /// The agent of a file, or a bundled one.
    #[new]
    fn new(name: &str) -> PyResult<Self> {
        let fail = |error: String| Failure::Input(error);
        let (policy, path) = Policy::find(name).map_err(|e| fail(e.to_string()))?;
        let camera = CameraConfig::default().hash();
        // Its encoder is checked where it is used.
        policy.check(&path, &policy.card.encoder_hash, &camera).map_err(|e| fail(e.to_string()))?;
        let observation = match policy.card.inputs.observation() {
            ObservationMode::RawOnly => "raw",
            ObservationMode::Vector => "vector",
            _ => "latent",
        };
        let actor = policy.actor().map_err(|e| fail(e.to_string()))?;
        Ok(Self { actor, observation, encoder: policy.encoder(), policy, path })
    }

    /// Refuses an encoder whose latents are not those of its training.
    fn check_encoder(&self, name: &str) -> PyResult<()> {
        if !self.policy.card.inputs.observation().encodes() {
            return Ok(());
        }
        let encoder = find_encoder(name).map_err(|e| Failure::Input(e.to_string()))?;
        let camera = CameraConfig::default().hash();
        let checked = self.policy.check(&self.path, encoder.hash(), &camera);
        Ok(checked.map_err(|e| Failure::Input(e.to_string()))?)
    }

    /// Steering, throttle and brake for an observation. An agent that drives by the latent alone gets that part of it.
    fn act(&self, observation: PyReadonlyArray1<'_, f32>) -> PyResult<Action> {
        let mut numbers: Vec<f32> = observation.as_array().iter().copied().collect();
        let dims = self.actor.dims();
        let expected = dims.observation() as usize;
        if dims.raw == 0 && numbers.len() == expected + observation::RAW_SIZE {
            numbers.truncate(expected);
        }
        if numbers.len() != expected {
            let found = numbers.len();
            return Err(InputError::new_err(format!(
                "an observation of {found} numbers: expected {expected}"
            )));
        }
        Ok(self.actor.act(&numbers))
    }
}

/// What Python says of an agent that it trained, in JSON.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Trained {
    /// What it gets.
    inputs: Inputs,
    detector: String,
    encoder: String,
    /// With its constants; those that are not given have their defaults.
    algorithm: Algorithm,
    /// Of its inputs. None: as they are.
    scale: Option<InputScale>,
    steps: u64,
    updates: u64,
    seed: u64,
    scores: serde_json::Value,
    config: serde_json::Map<String, serde_json::Value>,
}

/// Writes WAD-T's or WAD-S' actor as the file of a trained agent: `values` are its parameters, layer by layer, weights [inputs, outputs]
/// row by row before biases; `layers` are the layers' (inputs, outputs).
#[pyfunction]
pub fn save_agent(
    path: PathBuf,
    trained: &str,
    layers: Vec<(usize, usize)>,
    values: PyReadonlyArray1<'_, f32>,
) -> PyResult<()> {
    let trained: Trained = parse(trained)?;
    let encoder = find_encoder(&trained.encoder).map_err(|e| Failure::Input(e.to_string()))?;
    let dims = trained.inputs.dims();
    let algorithm = trained.algorithm;
    let expected = PlainActor::layers(&algorithm, dims);
    if layers != expected {
        return Err(InputError::new_err(format!(
            "layers of (inputs, outputs) {layers:?}: expected {expected:?}"
        )));
    }
    let mut config = trained.config;
    // Whoever opens the file looks for the encoder under this name.
    config.insert("encoder".to_string(), trained.encoder.into());
    let card = PolicyCard {
        algorithm,
        dims,
        inputs: trained.inputs,
        encoder_hash: encoder.hash().to_string(),
        camera_hash: CameraConfig::default().hash(),
        raw_meaning: observation::RAW_MEANING,
        detector: trained.detector,
        steps: trained.steps,
        updates: trained.updates,
        seed: trained.seed,
        demonstrations: 0,
        scores: trained.scores,
        config: config.into(),
    };
    let values: Vec<f32> = values.as_array().iter().copied().collect();
    let scale = trained.scale.unwrap_or_else(|| InputScale::identity(dims));
    let policy = Policy::new(card, scale, &values);
    policy.check_form().map_err(Failure::Input)?;
    Ok(policy.save(&path).map_err(|e| Failure::Input(e.to_string()))?)
}

/// An evaluation as Python describes it, in JSON.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Wanted {
    suite: String,
    selection: Selection,
    traffic: Vec<TrafficSpec>,
    /// What a driver of Python's gets.
    observation: ObservationMode,
    detector: String,
    mirrors: bool,
    encoder: String,
    /// Seconds for each answer of an external agent.
    agent_timeout: f64,
    jobs: usize,
    out: Option<PathBuf>,
    resume: bool,
    keep: Keep,
}

/// Why Python stops an evaluation: an exception of its driver.
type Raised = Arc<Mutex<Option<PyErr>>>;

/// Held by the thread that calls Python's driver.
type Turn = Arc<Mutex<()>>;

/// A driver of Python's.
struct PythonAgent {
    name: String,
    /// Takes an observation (and None, a seed, at an episode's begin), and gives an action.
    act: Arc<Py<PyAny>>,
    /// What it gets.
    mode: ObservationMode,
    turn: Turn,
    raised: Raised,
    stop: Arc<AtomicBool>,
}

impl PythonAgent {
    /// Calls `act` when no other thread does. Python's lock comes after that: `act` may let go of it.
    fn call<T>(&self, call: impl FnOnce(Python<'_>) -> T) -> T {
        let _turn = self.turn.lock().unwrap_or_else(PoisonError::into_inner);
        Python::attach(call)
    }

    fn fail(&self, py: Python<'_>, error: PyErr) -> AgentError {
        self.stop.store(true, Ordering::Relaxed);
        let why = error.value(py).to_string();
        self.raised.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
        AgentError::Failed { name: self.name.clone(), why }
    }
}

impl Agent for PythonAgent {
    fn name(&self) -> &str {
        &self.name
    }

    fn observes(&self) -> ObservationMode {
        self.mode
    }

    fn reset(&mut self, seed: u64) {
        self.call(|py| {
            if let Err(error) = self.act.call1(py, (py.None(), seed)) {
                self.fail(py, error);
            }
        });
    }

    fn act(&mut self, observation: &Observation) -> Result<Control, AgentError> {
        self.call(|py| {
            let raw = self.mode == ObservationMode::RawOnly;
            let numbers = if raw { observation.raw.to_vec() } else { observation.concat() };
            let numbers = PyArray1::from_vec(py, numbers);
            let action = self.act.call1(py, (numbers, 0)).and_then(|action| action.extract::<Action>(py));
            action.map(to_control).map_err(|error| self.fail(py, error))
        })
    }
}

fn failure(error: EvalError) -> Failure {
    let text = error.to_string();
    match error {
        EvalError::Env(error) => error.into(),
        EvalError::Assets(error) => error.into(),
        EvalError::Sumo(_) => Failure::Sumo(text),
        EvalError::Store(StoreError::File { .. } | StoreError::Lock(LockError::Make { .. })) => {
            Failure::Other(text)
        }
        EvalError::Suite(_)
        | EvalError::Detector(_)
        | EvalError::Store(_)
        | EvalError::Driver(_)
        | EvalError::Elsewhere { .. } => Failure::Input(text),
        _ => Failure::Other(text),
    }
}

/// Makes an evaluation's drivers: `act` is Python's, if it is one.
struct Drivers {
    act: Option<Arc<Py<PyAny>>>,
    /// What a driver of Python's gets, and the encoder of it.
    mode: ObservationMode,
    encoder: String,
    /// Of external agents.
    limits: Limits,
    turn: Turn,
    raised: Raised,
    stop: Arc<AtomicBool>,
}

impl Drivers {
    fn new(
        act: Option<Py<PyAny>>,
        mode: ObservationMode,
        encoder: &str,
        agent_timeout: f64,
    ) -> Result<Self, Failure> {
        let limits = Limits::answer_within(agent_timeout).ok_or_else(|| {
            Failure::Input(format!("agent_timeout={agent_timeout}: expected seconds above 0"))
        })?;
        Ok(Self {
            act: act.map(Arc::new),
            mode,
            encoder: encoder.to_string(),
            limits,
            turn: Turn::default(),
            raised: Raised::default(),
            stop: Arc::new(AtomicBool::new(false)),
        })
    }

    fn of(wanted: &Wanted, act: Option<Py<PyAny>>) -> Result<Self, Failure> {
        Self::new(act, wanted.observation, &wanted.encoder, wanted.agent_timeout)
    }

    fn make(&self, spec: &DriverSpec) -> Result<Made, DriverError> {
        let Some(act) = &self.act else {
            return Made::open(spec, None, &CameraConfig::default(), self.limits);
        };
        let agent = PythonAgent {
            name: spec.to_string(),
            act: Arc::clone(act),
            mode: self.mode,
            turn: Arc::clone(&self.turn),
            raised: Arc::clone(&self.raised),
            stop: Arc::clone(&self.stop),
        };
        let encoder = if self.mode.encodes() { &self.encoder } else { "pooled" };
        let encoder = find_encoder(encoder).map_err(EyesError::from)?;
        let id = format!("of Python, {spec}, encoder {}", encoder.hash());
        Ok(Made { agent: Box::new(agent), encoder, id })
    }

    /// The exception of Python's driver, if it raised one.
    fn raised(&self) -> Option<PyErr> {
        self.stop.store(false, Ordering::Relaxed);
        self.raised.lock().unwrap_or_else(PoisonError::into_inner).take()
    }

    fn raise(&self, error: PyErr) {
        self.stop.store(true, Ordering::Relaxed);
        self.raised.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
    }
}

impl Wanted {
    /// Calls `then` with the evaluation.
    fn with_order<T>(
        self,
        drivers: &Drivers,
        then: impl FnOnce(Order<'_>) -> Result<T, EvalError>,
    ) -> Result<T, Failure> {
        let suite = Suite::find(&self.suite).map_err(|e| Failure::Input(e.to_string()))?;
        let options = EnvOptions {
            termination: suite.termination,
            detector: self.detector,
            mirrors: self.mirrors,
            observation: self.observation,
            ..EnvOptions::evaluation()
        };
        let order = Order {
            selection: self.selection.in_traffic(&suite, &self.traffic),
            suite,
            shard: None,
            resume: self.resume,
            evaluation: Evaluation {
                options,
                jobs: self.jobs,
                egos: 1,
                make_agent: &|spec| drivers.make(spec),
                keep: if self.out.is_some() { self.keep } else { Keep::None },
                build: wad_cosim::program::version(),
                stop: &drivers.stop,
            },
            out: self.out,
        };
        then(order).map_err(failure)
    }
}

/// Drives an evaluation; `act` is Python's driver, if it is one, and `watch` is called after each episode with the episodes done
/// and planned. Returns summary.json's text. Ctrl-C ends it after the running episodes, which are kept.
#[pyfunction]
pub fn evaluate(
    py: Python<'_>,
    wanted: &str,
    act: Option<Py<PyAny>>,
    watch: Option<Py<PyAny>>,
) -> PyResult<String> {
    let wanted = parse::<Wanted>(wanted)?;
    let drivers = Arc::new(Drivers::of(&wanted, act)?);
    let thread = {
        let drivers = Arc::clone(&drivers);
        let spawned = std::thread::Builder::new().name("evaluation".to_string());
        spawned.spawn(move || drive(wanted, watch, &drivers))
    };
    let thread = thread.map_err(|e| Error::new_err(format!("cannot start a thread: {e}")))?;
    let mut interrupted = None;
    while !thread.is_finished() {
        py.detach(|| std::thread::sleep(Duration::from_millis(20)));
        if let Err(signal) = py.check_signals() {
            drivers.stop.store(true, Ordering::Relaxed);
            interrupted = Some(signal);
        }
    }
    let result = thread.join().unwrap_or_else(|_| Err(Failure::Other("the evaluation failed".to_string())));
    match interrupted.or(drivers.raised()) {
        Some(error) => Err(error),
        None => Ok(result?),
    }
}

fn drive(wanted: Wanted, watch: Option<Py<PyAny>>, drivers: &Drivers) -> Result<String, Failure> {
    let outcome = wanted.with_order(drivers, |order| {
        eval::evaluate(order, |progress| {
            if let Some(watch) = &watch {
                Python::attach(|py| {
                    if let Err(error) = watch.call1(py, (progress.done, progress.planned)) {
                        drivers.raise(error);
                    }
                });
            }
        })
    })?;
    json(&outcome.summary)
}

/// An evaluation's folder with its plan, for episodes that are driven elsewhere. It holds the folder's lock.
#[pyclass(frozen)]
pub struct Ledger(Held<eval::Ledger>);

#[pymethods]
impl Ledger {
    /// Opens the folder; `act` is Python's driver, if it is one.
    #[new]
    fn new(py: Python<'_>, wanted: &str, act: Option<Py<PyAny>>) -> PyResult<Self> {
        let wanted = parse::<Wanted>(wanted)?;
        let drivers = Drivers::of(&wanted, act)?;
        let opened = py.detach(|| wanted.with_order(&drivers, |order| eval::Ledger::open(&order)));
        Ok(Self(Held::new("the evaluation", opened?.0)))
    }

    /// What the results are made by, in JSON: a [`Worker`] drives by it.
    #[getter]
    fn manifest(&self) -> PyResult<String> {
        Ok(self.0.with(|ledger| json(ledger.manifest()))?)
    }

    /// Episodes of the plan.
    #[getter]
    fn planned(&self) -> PyResult<u64> {
        Ok(self.0.with(|ledger| Ok(ledger.planned()))?)
    }

    /// Episodes with a result.
    #[getter]
    fn done(&self) -> PyResult<u64> {
        Ok(self.0.with(|ledger| Ok(ledger.done()))?)
    }

    /// The episodes without a result, each in JSON.
    fn left(&self) -> PyResult<Vec<String>> {
        Ok(self.0.with(|ledger| ledger.left().concat().iter().map(json).collect())?)
    }

    /// Takes what a [`Worker`] drove. False: the episode has a result already.
    fn add(&self, py: Python<'_>, line: &[u8], recording: Option<(Vec<u8>, Vec<u8>)>) -> PyResult<bool> {
        let record = serde_json::from_slice(line).map_err(|e| Failure::Other(e.to_string()))?;
        let recording = recording.map(|(episode, states)| Packed { episode, states });
        Ok(py.detach(|| self.0.with(|ledger| ledger.add(Driven { record, recording }).map_err(failure)))?)
    }

    /// Writes the table, gives summary.json's text, and frees the folder.
    fn finish(&self) -> PyResult<String> {
        Ok(json(&self.0.finish()?.finish().map_err(failure)?)?)
    }
}

/// Drives episodes of a [`Ledger`], wherever that is. Town and driver stay while they are the same.
#[pyclass(frozen)]
pub struct Worker {
    manifest: Manifest,
    keep: Keep,
    drivers: Drivers,
    warm: Mutex<Warm>,
}

/// What stays between episodes.
#[derive(Default)]
struct Warm {
    worker: eval::Worker,
    towns: Towns,
    /// Towns and drivers that are those of the manifest.
    checked: HashSet<(String, String)>,
}

#[pymethods]
impl Worker {
    /// For the evaluation of `manifest`; `act` is Python's driver, if it is one, and an external one has `agent_timeout` seconds for each answer.
    #[new]
    fn new(
        manifest: &str,
        encoder: &str,
        keep: &str,
        agent_timeout: f64,
        act: Option<Py<PyAny>>,
    ) -> PyResult<Self> {
        let input = |e: serde_json::Error| Failure::Input(format!("the evaluation's manifest: {e}"));
        let manifest: Manifest = serde_json::from_str(manifest).map_err(input)?;
        let keep = keep.parse().map_err(Failure::Input)?;
        let drivers = Drivers::new(act, manifest.options.observation, encoder, agent_timeout)?;
        Ok(Self { manifest, keep, drivers, warm: Mutex::default() })
    }

    /// Drives an episode: its line in episodes.jsonl, and the recording's files if it is one to keep.
    fn drive<'py>(&self, py: Python<'py>, case: &str) -> PyResult<Packet<'py>> {
        let input = |e: serde_json::Error| Failure::Input(format!("an episode's case: {e}"));
        let case: Case = serde_json::from_str(case).map_err(input)?;
        let driven = py.detach(|| self.drive_case(&case).map_err(failure));
        if let Some(error) = self.drivers.raised() {
            return Err(error);
        }
        let Driven { record, recording } = driven?;
        let bytes = |bytes: &[u8]| PyBytes::new(py, bytes);
        let recording = recording.map(|packed| (bytes(&packed.episode), bytes(&packed.states)));
        Ok((bytes(json(&record)?.as_bytes()), recording))
    }
}

/// A line, and the files of a recording.
type Packet<'py> = (Bound<'py, PyBytes>, Option<(Bound<'py, PyBytes>, Bound<'py, PyBytes>)>);

impl Worker {
    fn drive_case(&self, case: &Case) -> Result<Driven, EvalError> {
        let mut warm = self.warm.lock().unwrap_or_else(PoisonError::into_inner);
        let Warm { worker, towns, checked } = &mut *warm;
        let evaluation = Evaluation {
            options: self.manifest.options.clone(),
            jobs: 1,
            egos: 1,
            make_agent: &|spec| self.drivers.make(spec),
            keep: self.keep,
            build: wad_cosim::program::version(),
            stop: &self.drivers.stop,
        };
        let town = match towns.get(&case.town) {
            Some(town) => Arc::clone(town),
            None => Assets::load(&case.town)?,
        };
        towns.insert(case.town.clone(), Arc::clone(&town));
        let pair = (case.town.clone(), case.agent.to_string());
        if !checked.contains(&pair) {
            self.manifest.require_here(&evaluation, &case.agent, &case.town, &town)?;
            checked.insert(pair);
        }
        let mut driven = worker.drive(&evaluation, std::slice::from_ref(case), &town)?;
        driven.pop().ok_or_else(|| EnvError::NoEpisode.into())
    }
}

/// The tables of evaluations' folders as Markdown; agents of a pool (its name, and they) share a line.
#[pyfunction]
pub fn report_of(
    py: Python<'_>,
    folders: Vec<PathBuf>,
    pools: Vec<(String, Vec<String>)>,
) -> PyResult<String> {
    let pools: Vec<report::Pool> =
        pools.into_iter().map(|(name, agents)| report::Pool { name, agents }).collect();
    let text = py.detach(|| {
        let results: Result<Vec<_>, _> = folders.iter().map(|folder| Results::open(folder)).collect();
        let report =
            report::Report::gather(results.map_err(|e| e.to_string())?, &pools).map_err(|e| e.to_string())?;
        let mut text = report::markdown(report::overview(&report).as_slice());
        for section in &report.sections {
            text += &format!("## {}\n\n", section.suite.title);
            text += &report::markdown(&report::tables(section));
        }
        Ok::<_, String>(text)
    });
    Ok(text.map_err(Failure::Input)?)
}
