//! Environments as Python's object.

use crate::episode::NUMBERS;
use crate::errors::{Error, Failure, InputError};
use crate::info;
use crate::setup::{Part, Setup, Tasks};
use crate::worker::{self, Array, Arrays, Autoreset, Driver, Job, Rows, Shared, lock};
use numpy::{PyArray1, PyArrayDyn, PyArrayMethods, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};
use std::sync::mpsc::Sender;
use std::sync::{Arc, Mutex, TryLockError};
use std::thread::JoinHandle;
use std::time::Duration;
use wad_cosim::agent::action::{ACTION_SIZE, Action};
use wad_cosim::cores::Visit;

/// How often a waiting thread lets Python look for signals.
const SIGNALS: Duration = Duration::from_millis(50);

/// Environments that are driven together, each on a thread of its own but for the first one's ticks, which Python's thread
/// drives. All methods release Python's lock while they wait or drive.
#[pyclass(frozen)]
pub struct Environments {
    /// None: closed.
    open: Mutex<Option<Open>>,
    count: usize,
    /// In each SUMO.
    egos: usize,
    /// The parts of one observation, and their shapes.
    parts: Vec<(Part, Vec<usize>)>,
    picture: [usize; 3],
    /// The process that has the threads.
    process: u32,
}

struct Open {
    /// By SUMO.
    drivers: Vec<Arc<Mutex<Option<Driver>>>>,
    jobs: Vec<Sender<Job>>,
    threads: Vec<JoinHandle<()>>,
    shared: Arc<Shared>,
}

impl Drop for Open {
    fn drop(&mut self) {
        // The threads see that nobody asks any more, and end their SUMOs.
        self.jobs.clear();
    }
}

/// See [`Environments::step_one`].
type OneStep<'py> = (Bound<'py, PyDict>, f64, bool, bool, Bound<'py, PyDict>);

#[pymethods]
impl Environments {
    /// `count` environments of a setup in JSON; arrays by part; `numbers` of shape (count, len(NUMBERS)). `last`:
    /// the same arrays for the last observations of ended episodes, with autoreset "same_step".
    #[new]
    fn new(
        py: Python<'_>,
        count: usize,
        setup: &str,
        now: &Bound<'_, PyDict>,
        last: Option<&Bound<'_, PyDict>>,
        autoreset: &str,
    ) -> PyResult<Self> {
        let setup = Arc::new(Setup::parse(setup)?);
        if count == 0 || !count.is_multiple_of(setup.egos) {
            let egos = setup.egos;
            let text =
                format!("{count} environments: expected a multiple of egos={egos}, the egos of each SUMO");
            return Err(InputError::new_err(text));
        }
        let autoreset = match autoreset {
            "next_step" => Autoreset::NextStep,
            "same_step" => Autoreset::SameStep,
            "disabled" => Autoreset::Disabled,
            other => return Err(InputError::new_err(format!("autoreset `{other}`"))),
        };
        if setup.egos > 1 && autoreset == Autoreset::SameStep {
            let text =
                "several egos in one SUMO begin their next episodes with a step: NEXT_STEP or DISABLED";
            return Err(InputError::new_err(text));
        }
        let mut owners = Vec::new();
        let now = arrays(now, &setup, count, &mut owners)?;
        let last = last.map(|last| arrays(last, &setup, count, &mut owners)).transpose()?;
        let camera = setup.options.camera;
        let parts = setup.observation.iter().map(|part| (*part, part.shape(&camera))).collect();
        let tasks = py.detach(|| Tasks::open(&setup)).map(Arc::new)?;
        let shared = Arc::new(Shared::new(now, last, autoreset, count, owners));
        let egos = setup.egos;
        let mut open = Open { drivers: Vec::new(), jobs: Vec::new(), threads: Vec::new(), shared };
        for index in (0..count).step_by(egos) {
            let (tasks, setup, shared) = (Arc::clone(&tasks), Arc::clone(&setup), Arc::clone(&open.shared));
            let driver = Arc::default();
            let (sender, thread) = worker::spawn(index, tasks, setup, shared, Arc::clone(&driver))
                .map_err(|e| Error::new_err(format!("cannot start a thread for an environment: {e}")))?;
            open.drivers.push(driver);
            open.jobs.push(sender);
            open.threads.push(thread);
        }
        open.wait(py)?;
        open.failed()?;
        let picture = [camera.height, camera.width, 3];
        Ok(Self { open: Mutex::new(Some(open)), count, egos, parts, picture, process: std::process::id() })
    }

    /// Begins episodes: `seeds` has a seed for each environment that is to begin, None for the others.
    #[pyo3(signature = (seeds, route=None))]
    fn reset(&self, py: Python<'_>, seeds: Vec<Option<u64>>, route: Option<usize>) -> PyResult<()> {
        self.with(|open| {
            self.fits(seeds.len())?;
            if self.egos > 1 && seeds.iter().any(Option::is_none) {
                return Err(InputError::new_err(
                    "several egos in one SUMO are reset together: no reset_mask",
                ));
            }
            if let (true, Some(route)) = (self.egos > 1, route) {
                return Err(InputError::new_err(format!(
                    "route {route}: several egos in one SUMO draw their places; use egos=1"
                )));
            }
            let jobs = seeds.iter().step_by(self.egos).map(|seed| seed.map(|seed| Job::Reset(seed, route)));
            open.run(py, jobs)
        })
    }

    /// Drives a tick of every environment. Environments whose episode begins by itself use `seeds`. Returns
    /// what is not in the arrays, of the environments that have any: (index, began, events, ending).
    fn step<'py>(
        &self,
        py: Python<'py>,
        actions: PyReadonlyArray2<'py, f32>,
        seeds: Vec<u64>,
    ) -> PyResult<Bound<'py, PyList>> {
        self.with(|open| {
            self.fits(seeds.len())?;
            let rows = self.rows(&actions)?;
            if self.egos > 1 {
                open.run(py, rows.chunks(self.egos).map(|rows| Some(Job::StepAll(rows.to_vec()))))?;
            } else {
                let jobs = rows.iter().zip(&seeds).map(|(action, seed)| Some(Job::Step(*action, *seed)));
                open.run(py, jobs)?;
            }
            open.news(py)
        })
    }

    /// Drives a tick of the only environment. Returns what Gymnasium's `step` does: the observation's parts by name, in arrays
    /// of their own, the reward, whether the episode is terminated and whether truncated, and `info`.
    fn step_one<'py>(&self, py: Python<'py>, action: PyReadonlyArray2<'py, f32>) -> PyResult<OneStep<'py>> {
        self.with(|open| {
            if self.count != 1 || open.shared.autoreset != Autoreset::Disabled {
                return Err(InputError::new_err("step_one is for one environment without autoreset"));
            }
            let rows = self.rows(&action)?;
            let (observation, parts) = self.fresh(py)?;
            let mut numbers = [0.0; NUMBERS.len()];
            let into = Arrays { parts, numbers: Rows::new(numbers.as_mut_ptr(), NUMBERS.len()) };
            open.step_one(py, rows[0], &into)?;
            let info = info::of(py, &numbers)?;
            info::add_news(py, &info, &lock(&open.shared.answers[0]).news)?;
            let [reward, terminated, truncated, ..] = numbers;
            Ok((observation, reward, terminated != 0.0, truncated != 0.0, info))
        })
    }

    /// The expert's actions for this tick.
    fn expert(&self, py: Python<'_>) -> PyResult<Vec<Action>> {
        self.with(|open| {
            open.run(py, (0..self.count / self.egos).map(|_| Some(Job::Expert)))?;
            Ok(open.shared.answers.iter().map(|answer| lock(answer).action).collect())
        })
    }

    /// The front camera's picture of an environment: (height, width, 3), RGB.
    fn picture<'py>(&self, py: Python<'py>, index: usize) -> PyResult<Bound<'py, PyAny>> {
        self.with(|open| {
            let jobs = (0..self.count / self.egos).map(|i| (i == index).then_some(Job::Picture));
            open.run(py, jobs)?;
            let Some(answer) = open.shared.answers.get(index) else {
                return Err(InputError::new_err(format!("environment {index} of {}", self.count)));
            };
            let picture = std::mem::take(&mut lock(answer).picture);
            Ok(PyArray1::from_vec(py, picture).reshape(self.picture)?.into_any())
        })
    }

    /// Ids of the SUMO processes.
    fn sumos(&self) -> PyResult<Vec<Option<u32>>> {
        self.with(|open| Ok(open.shared.answers.iter().map(|answer| lock(answer).sumo).collect()))
    }

    /// Ends the SUMOs. A closed object stays closed; closing it again does nothing.
    fn close(&self, py: Python<'_>) -> PyResult<()> {
        if self.process != std::process::id() {
            return Ok(());
        }
        let open = self.taken()?.take();
        let Some(mut open) = open else { return Ok(()) };
        open.jobs.clear();
        let threads = std::mem::take(&mut open.threads);
        while threads.iter().any(|thread| !thread.is_finished()) {
            py.detach(|| std::thread::sleep(Duration::from_millis(1)));
            py.check_signals()?;
        }
        Ok(())
    }

    /// Whether it was closed.
    #[getter]
    fn closed(&self) -> PyResult<bool> {
        Ok(self.taken()?.is_none())
    }
}

impl Environments {
    fn taken(&self) -> PyResult<std::sync::MutexGuard<'_, Option<Open>>> {
        match self.open.try_lock() {
            Ok(open) => Ok(open),
            Err(TryLockError::Poisoned(poisoned)) => Ok(poisoned.into_inner()),
            Err(TryLockError::WouldBlock) => {
                Err(Error::new_err("another thread uses this environment: give each thread its own"))
            }
        }
    }

    fn with<T>(&self, act: impl FnOnce(&mut Open) -> PyResult<T>) -> PyResult<T> {
        if self.process != std::process::id() {
            return Err(Error::new_err(
                "this environment belongs to another process: a fork copies neither its threads nor its SUMO. Make \
                 it in the process that uses it",
            ));
        }
        match self.taken()?.as_mut() {
            Some(open) => act(open),
            None => Err(Error::new_err("this environment is closed: make another")),
        }
    }

    /// The actions, checked.
    fn rows(&self, actions: &PyReadonlyArray2<'_, f32>) -> PyResult<Vec<Action>> {
        let shape = actions.shape();
        if shape != [self.count, ACTION_SIZE] {
            let expected = (self.count, ACTION_SIZE);
            return Err(InputError::new_err(format!("actions of shape {shape:?}: expected {expected:?}")));
        }
        let actions = actions.as_array();
        if actions.iter().any(|number| !number.is_finite()) {
            return Err(InputError::new_err(format!("an action is not finite: {actions}")));
        }
        Ok(actions.rows().into_iter().map(|row| [row[0], row[1], row[2]]).collect())
    }

    /// New arrays for an observation, by the names of its parts, and the same for a thread that writes.
    fn fresh<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyDict>, Vec<Array>)> {
        let observation = PyDict::new(py);
        let mut parts = Vec::with_capacity(self.parts.len());
        for (part, shape) in &self.parts {
            parts.push(if part.is_bytes() {
                let array = PyArrayDyn::<u8>::zeros(py, shape.as_slice(), false);
                observation.set_item(part.name(), &array)?;
                Array::Bytes(*part, Rows::new(array.data(), array.len()))
            } else {
                let array = PyArrayDyn::<f32>::zeros(py, shape.as_slice(), false);
                observation.set_item(part.name(), &array)?;
                Array::Numbers(*part, Rows::new(array.data(), array.len()))
            });
        }
        Ok((observation, parts))
    }

    fn fits(&self, found: usize) -> PyResult<()> {
        if found == self.count {
            return Ok(());
        }
        Err(InputError::new_err(format!("{found} seeds for {} environments", self.count)))
    }
}

impl Drop for Environments {
    fn drop(&mut self) {
        if self.process != std::process::id()
            && let Ok(open) = self.open.get_mut()
        {
            // The threads are those of the process that forked.
            std::mem::forget(open.take());
        }
    }
}

impl Open {
    /// Waits until no job runs; a signal's exception ends the waiting, and the jobs go on.
    fn wait(&self, py: Python<'_>) -> PyResult<()> {
        while !self.shared.is_idle() && !py.detach(|| self.shared.wait(SIGNALS)) {
            py.check_signals()?;
        }
        Ok(())
    }

    /// Nothing is answered any more.
    fn clear(&self) {
        for answer in &self.shared.answers {
            let mut answer = lock(answer);
            (answer.failure, answer.began, answer.news) = (None, false, Default::default());
        }
    }

    /// Drives a tick of the first environment on Python's thread, and writes what it leads to into arrays of the caller's.
    fn step_one(&self, py: Python<'_>, action: Action, into: &Arrays) -> PyResult<()> {
        // For a call that was interrupted.
        self.wait(py)?;
        self.clear();
        py.detach(|| {
            let _visit = Visit::begin();
            if let Some(driver) = lock(&self.drivers[0]).as_mut() {
                driver.drive_into(Job::Step(action, 0), into);
            }
        });
        self.told()
    }

    /// A signal that was heard meanwhile, or the first failure.
    fn told(&self) -> PyResult<()> {
        match self.shared.signal() {
            Some(signal) => Err(signal),
            None => self.failed(),
        }
    }

    /// Sends each environment its job, and waits for the answers.
    fn run(&self, py: Python<'_>, jobs: impl Iterator<Item = Option<Job>>) -> PyResult<()> {
        // For a call that was interrupted.
        self.wait(py)?;
        self.clear();
        let mut own = None;
        for (index, job) in jobs.enumerate() {
            match job {
                Some(job) if index == 0 && !self.is_long(&job) => own = Some(job),
                Some(job) => self.send(index, job)?,
                None => {}
            }
        }
        if let Some(job) = own {
            let left = py.detach(|| {
                let _visit = Visit::begin();
                lock(&self.drivers[0]).as_mut().and_then(|driver| driver.drive(job))
            });
            if let Some(job) = left {
                self.send(0, job)?;
            }
        }
        self.wait(py)?;
        self.told()
    }

    /// Whether the first SUMO's thread has to do it.
    fn is_long(&self, job: &Job) -> bool {
        lock(&self.drivers[0]).as_ref().is_none_or(|driver| driver.is_long(job))
    }

    /// To a SUMO's thread.
    fn send(&self, index: usize, job: Job) -> PyResult<()> {
        self.shared.begin(1);
        self.jobs[index].send(job).map_err(|_| {
            self.shared.end();
            Error::new_err("the thread of an environment has ended")
        })
    }

    /// The first failure.
    fn failed(&self) -> PyResult<()> {
        let found: Option<Failure> =
            self.shared.answers.iter().find_map(|answer| lock(answer).failure.clone());
        found.map_or(Ok(()), |failure| Err(failure.into()))
    }

    /// What is not in the arrays.
    fn news<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyList>> {
        let list = PyList::empty(py);
        for (index, answer) in self.shared.answers.iter().enumerate() {
            let answer = lock(answer);
            let news = &answer.news;
            if !answer.began && news.events.is_empty() && news.ending.is_none() {
                continue;
            }
            let events = info::json(py, &news.events)?;
            let ending = news.ending.as_ref().map(|e| (e.end.name(), e.cause.as_str(), e.success));
            list.append((index, answer.began, events, ending))?;
        }
        Ok(list)
    }
}

/// Python's arrays, checked.
fn arrays(
    found: &Bound<'_, PyDict>,
    setup: &Setup,
    count: usize,
    owners: &mut Vec<Py<PyAny>>,
) -> PyResult<Arrays> {
    let mut parts = Vec::new();
    for part in &setup.observation {
        let row = part.shape(&setup.options.camera).iter().product();
        parts.push(if part.is_bytes() {
            Array::Bytes(*part, rows(found, part.name(), count, row, owners)?)
        } else {
            Array::Numbers(*part, rows(found, part.name(), count, row, owners)?)
        });
    }
    Ok(Arrays { parts, numbers: rows(found, "numbers", count, NUMBERS.len(), owners)? })
}

fn rows<T: numpy::Element>(
    found: &Bound<'_, PyDict>,
    name: &str,
    count: usize,
    row: usize,
    owners: &mut Vec<Py<PyAny>>,
) -> PyResult<Rows<T>> {
    let missing = || InputError::new_err(format!("the array `{name}` is missing"));
    let array = found.get_item(name)?.ok_or_else(missing)?;
    let array = array.cast_into::<PyArrayDyn<T>>().map_err(PyErr::from)?;
    if !array.is_c_contiguous() || array.len() != count * row || array.shape().first() != Some(&count) {
        let shape = array.shape();
        return Err(InputError::new_err(format!("the array `{name}` has the shape {shape:?}")));
    }
    // Refuses an array that may not be written.
    let first = array.try_readwrite()?.as_slice_mut()?.as_mut_ptr();
    owners.push(array.into_any().unbind());
    Ok(Rows::new(first, row))
}
