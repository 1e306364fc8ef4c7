//! Benchmarks: the same plan, seeds and records as the command line's `eval`, with a driver of Python's.

use crate::errors::{Error, Failure, InputError};
use numpy::{PyArray1, PyReadonlyArray1};
use pyo3::prelude::*;
use serde::Deserialize;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use wad_cosim::agent::action::{Action, to_control};
use wad_cosim::agent::actor::PlainActor;
use wad_cosim::agent::params::{Algorithm, InputScale, Inputs, Td3Params};
use wad_cosim::agent::policy::{Policy, PolicyCard, find_encoder};
use wad_cosim::agent::{Agent, AgentError};
use wad_cosim::camera::CameraConfig;
use wad_cosim::env::{EnvOptions, ObservationMode};
use wad_cosim::eval::{self, EvalError, Evaluation, Keep, Made, Order, Results, Selection, Suite, report};
use wad_cosim::eyes::EyesError;
use wad_cosim::observation::{self, Observation};
use wad_cosim::traffic::TrafficSpec;
use wad_cosim::vehicle::Control;

/// A trained agent that drives with numbers of Python's.
#[pyclass(frozen)]
pub struct LoadedAgent {
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
        policy.check(&path, &policy.card.encoder_hash, &camera).map_err(|e| fail(e.to_string()))?;
        let observation = match policy.card.inputs.observation() {
            ObservationMode::RawOnly => "raw",
            ObservationMode::Vector => "vector",
            _ => "latent",
        };
        let actor = policy.actor().map_err(|e| fail(e.to_string()))?;
        Ok(Self { actor, observation, encoder: policy.encoder() })
    }

    /// Steering, throttle and brake for an observation.
    fn act(&self, observation: PyReadonlyArray1<'_, f32>) -> PyResult<Action> {
        let numbers: Vec<f32> = observation.as_array().iter().copied().collect();
        let expected = self.actor.dims().observation() as usize;
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
    /// TD3's constants; those that are not given have their defaults.
    params: Td3Params,
    steps: u64,
    updates: u64,
    seed: u64,
    scores: serde_json::Value,
    config: serde_json::Map<String, serde_json::Value>,
}

/// Writes WAD-T's actor as the file of a trained agent: `values` are its parameters, layer by layer, weights [inputs, outputs]
/// row by row before biases; `layers` are the layers' (inputs, outputs).
#[pyfunction]
pub fn save_agent(
    path: PathBuf,
    trained: &str,
    layers: Vec<(usize, usize)>,
    values: PyReadonlyArray1<'_, f32>,
) -> PyResult<()> {
    let trained: Trained = serde_json::from_str(trained).map_err(|e| Failure::Input(e.to_string()))?;
    let encoder = find_encoder(&trained.encoder).map_err(|e| Failure::Input(e.to_string()))?;
    let dims = trained.inputs.dims();
    let algorithm = Algorithm::Td3(trained.params);
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
    let policy = Policy::new(card, InputScale::identity(dims), &values);
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
    encoder: String,
    jobs: usize,
    out: Option<PathBuf>,
    resume: bool,
    keep: Keep,
}

/// Why Python stops an evaluation: an exception of its driver.
type Raised = Arc<Mutex<Option<PyErr>>>;

/// A driver of Python's.
struct PythonAgent {
    name: String,
    /// Takes an observation (and None, a seed, at an episode's begin), and gives an action.
    act: Arc<Py<PyAny>>,
    /// What it gets.
    mode: ObservationMode,
    raised: Raised,
    stop: Arc<AtomicBool>,
}

impl PythonAgent {
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
        Python::attach(|py| {
            if let Err(error) = self.act.call1(py, (py.None(), seed)) {
                self.fail(py, error);
            }
        });
    }

    fn act(&mut self, observation: &Observation) -> Result<Control, AgentError> {
        Python::attach(|py| {
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
        EvalError::Suite(_) | EvalError::Store(_) | EvalError::Driver(_) => Failure::Input(text),
        _ => Failure::Other(text),
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
    let wanted: Wanted = serde_json::from_str(wanted).map_err(|e| Failure::Input(e.to_string()))?;
    let stop = Arc::new(AtomicBool::new(false));
    let raised = Raised::default();
    let thread = {
        let (stop, raised) = (Arc::clone(&stop), Arc::clone(&raised));
        let spawned = std::thread::Builder::new().name("evaluation".to_string());
        spawned.spawn(move || drive(wanted, act.map(Arc::new), watch, &stop, &raised))
    };
    let thread = thread.map_err(|e| Error::new_err(format!("cannot start a thread: {e}")))?;
    let mut interrupted = None;
    while !thread.is_finished() {
        py.detach(|| std::thread::sleep(Duration::from_millis(20)));
        if let Err(signal) = py.check_signals() {
            stop.store(true, Ordering::Relaxed);
            interrupted = Some(signal);
        }
    }
    let result = thread.join().unwrap_or_else(|_| Err(Failure::Other("the evaluation failed".to_string())));
    let raised = raised.lock().unwrap_or_else(PoisonError::into_inner).take();
    match interrupted.or(raised) {
        Some(error) => Err(error),
        None => Ok(result?),
    }
}

fn drive(
    wanted: Wanted,
    act: Option<Arc<Py<PyAny>>>,
    watch: Option<Py<PyAny>>,
    stop: &Arc<AtomicBool>,
    raised: &Raised,
) -> Result<String, Failure> {
    let suite = Suite::find(&wanted.suite).map_err(|e| Failure::Input(e.to_string()))?;
    let selection = wanted.selection.in_traffic(&suite, &wanted.traffic);
    let options = EnvOptions {
        termination: suite.termination,
        detector: wanted.detector,
        observation: wanted.observation,
        ..EnvOptions::evaluation()
    };
    let (mode, camera, encoder) = (options.observation, options.camera, wanted.encoder);
    let make_agent = |spec: &eval::DriverSpec| {
        let Some(act) = &act else { return Made::trained(&spec.to_string(), None, &camera) };
        let (act, raised, stop) = (Arc::clone(act), Arc::clone(raised), Arc::clone(stop));
        let agent = PythonAgent { name: spec.to_string(), act, mode, raised, stop };
        let encoder =
            find_encoder(if mode.encodes() { &encoder } else { "pooled" }).map_err(EyesError::from)?;
        let id = format!("of Python, {spec}, encoder {}", encoder.hash());
        Ok(Made { agent: Box::new(agent), encoder, id })
    };
    let order = Order {
        suite,
        selection,
        shard: None,
        out: wanted.out.clone(),
        resume: wanted.resume,
        evaluation: Evaluation {
            options,
            jobs: wanted.jobs,
            make_agent: &make_agent,
            keep: wanted.out.map(|out| (out, wanted.keep)),
            build: wad_cosim::program::version(),
            stop,
        },
    };
    let outcome = eval::evaluate(order, |progress| {
        if let Some(watch) = &watch {
            Python::attach(|py| {
                if let Err(error) = watch.call1(py, (progress.done, progress.planned)) {
                    stop.store(true, Ordering::Relaxed);
                    raised.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
                }
            });
        }
    });
    let outcome = outcome.map_err(failure)?;
    serde_json::to_string(&outcome.summary).map_err(|e| Failure::Other(e.to_string()))
}

/// The tables of evaluations' folders as Markdown.
#[pyfunction]
pub fn report_of(py: Python<'_>, folders: Vec<PathBuf>) -> PyResult<String> {
    let text = py.detach(|| {
        let results: Result<Vec<_>, _> = folders.iter().map(|folder| Results::open(folder)).collect();
        let report =
            report::Report::gather(results.map_err(|e| e.to_string())?).map_err(|e| e.to_string())?;
        let mut text = String::new();
        for section in &report.sections {
            text += &format!("## {}\n\n", section.suite.title);
            text += &report::markdown(&report::tables(section));
        }
        Ok::<_, String>(text)
    });
    Ok(text.map_err(Failure::Input)?)
}
