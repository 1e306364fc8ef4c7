//! The thread of one environment, and what it shares with the thread that asks.

use crate::episode::{Egos, Episodes, News, Numbers, Row};
use crate::errors::Failure;
use crate::setup::{Part, Setup, Tasks};
use pyo3::prelude::*;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::{Receiver, Sender};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use wad_cosim::agent::action::Action;

/// Environments after an episode's end, by Gymnasium's names.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Autoreset {
    /// The step after the end begins the next episode.
    NextStep,
    /// The step that ends an episode begins the next.
    SameStep,
    /// The user resets.
    Disabled,
}

/// What an environment is asked to do.
#[derive(Clone, Debug)]
pub enum Job {
    /// Begin the episode of this seed, on the route of that number.
    Reset(u64, Option<usize>),
    /// Drive a tick; an episode that begins by itself has this seed.
    Step(Action, u64),
    /// Drive a tick of each ego in one SUMO.
    StepAll(Vec<Action>),
    /// The expert's action.
    Expert,
    /// A picture for people.
    Picture,
}

/// What an environment answers beside its rows of the arrays.
#[derive(Debug, Default)]
pub struct Answer {
    /// Why the job was not done.
    pub failure: Option<Failure>,
    /// The tick's events and ending.
    pub news: News,
    /// An episode began by itself: the seed given was used.
    pub began: bool,
    /// Of [`Job::Expert`].
    pub action: Action,
    /// Of [`Job::Picture`].
    pub picture: Vec<u8>,
    /// SUMO's process.
    pub sumo: Option<u32>,
}

/// One of Python's arrays, a row for each environment.
#[derive(Clone, Copy)]
pub struct Rows<T> {
    first: *mut T,
    row: usize,
}

// SAFETY: every environment's thread touches its own row only, see [`Rows::row`].
unsafe impl<T: Send> Send for Rows<T> {}
// SAFETY: as above.
unsafe impl<T: Send> Sync for Rows<T> {}

impl<T> Rows<T> {
    /// An array whose first element is at `first` with `row` elements for each environment. It must live and stay
    /// where it is for as long as rows are taken.
    pub fn new(first: *mut T, row: usize) -> Self {
        Self { first, row }
    }

    /// The row of the environment `index`.
    ///
    /// # Safety
    /// The array has that row, and until the slice is dropped nobody else uses it.
    unsafe fn row<'a>(self, index: usize) -> &'a mut [T] {
        // SAFETY: the caller's.
        unsafe { std::slice::from_raw_parts_mut(self.first.add(index * self.row), self.row) }
    }
}

/// The arrays of a part of the observation: of now, and of an episode that ended in this step.
#[derive(Clone, Copy)]
pub enum Array {
    /// 32-bit numbers.
    Numbers(Part, Rows<f32>),
    /// Bytes.
    Bytes(Part, Rows<u8>),
}

/// The arrays that a thread writes after a tick.
pub struct Arrays {
    /// By part.
    pub parts: Vec<Array>,
    /// [`Numbers`].
    pub numbers: Rows<f64>,
}

impl Arrays {
    fn write(&self, index: usize, write: impl Fn(Part, Row<'_>), numbers: &Numbers) {
        for array in &self.parts {
            // SAFETY: the arrays have a row for each environment. Python waits while a job is done, and
            // does not read the arrays after an interrupted one before it has waited for it.
            unsafe {
                match *array {
                    Array::Numbers(part, rows) => write(part, Row::Numbers(rows.row(index))),
                    Array::Bytes(part, rows) => write(part, Row::Bytes(rows.row(index))),
                }
            }
        }
        // SAFETY: as above.
        unsafe { self.numbers.row(index) }.copy_from_slice(numbers);
    }
}

/// What the environments of one [`crate::environments::Environments`] share.
pub struct Shared {
    /// Where observations go.
    pub now: Arrays,
    /// Where the last observations of ended episodes go ([`Autoreset::SameStep`]).
    pub last: Option<Arrays>,
    /// After an episode's end.
    pub autoreset: Autoreset,
    /// By environment.
    pub answers: Vec<Mutex<Answer>>,
    /// Python's arrays: they live as long as a thread may write to them.
    _owners: Vec<Py<PyAny>>,
    running: Mutex<usize>,
    done: Condvar,
}

/// A panic elsewhere leaves nothing half-written that is read.
pub fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Shared {
    /// For `count` environments.
    pub fn new(
        now: Arrays,
        last: Option<Arrays>,
        autoreset: Autoreset,
        count: usize,
        owners: Vec<Py<PyAny>>,
    ) -> Self {
        let answers = (0..count).map(|_| Mutex::default()).collect();
        Self { now, last, autoreset, answers, _owners: owners, running: Mutex::new(0), done: Condvar::new() }
    }

    /// Counts `jobs` that are about to be sent.
    pub fn begin(&self, jobs: usize) {
        *lock(&self.running) += jobs;
    }

    /// Waits until no job runs; false: after `limit` some still do.
    pub fn wait(&self, limit: Duration) -> bool {
        let running = lock(&self.running);
        let waited = self.done.wait_timeout_while(running, limit, |running| *running > 0);
        *waited.unwrap_or_else(PoisonError::into_inner).0 == 0
    }

    /// A job ends.
    pub fn end(&self) {
        let mut running = lock(&self.running);
        *running -= 1;
        if *running == 0 {
            self.done.notify_all();
        }
    }
}

/// Starts the thread of the environment `index`, or of the egos in one SUMO whose first it is; the first answer says whether it could be made.
pub fn spawn(
    index: usize,
    tasks: Arc<Tasks>,
    setup: Arc<Setup>,
    shared: Arc<Shared>,
) -> std::io::Result<(Sender<Job>, std::thread::JoinHandle<()>)> {
    let (sender, jobs) = std::sync::mpsc::channel();
    shared.begin(1);
    let counted = Arc::clone(&shared);
    let thread = std::thread::Builder::new().name(format!("environment {index}")).spawn(move || {
        if setup.egos > 1 {
            serve_egos(index, &shared, &tasks, &setup, &jobs);
        } else {
            Worker { index, shared, over: true, waits: true }.work(&tasks, &setup, &jobs);
        }
    });
    if thread.is_err() {
        counted.end();
    }
    Ok((sender, thread?))
}

struct Worker {
    index: usize,
    shared: Arc<Shared>,
    /// The episode has ended.
    over: bool,
    /// It was never reset, or its last reset failed.
    waits: bool,
}

impl Worker {
    fn work(mut self, tasks: &Arc<Tasks>, setup: &Setup, jobs: &Receiver<Job>) {
        let mut episodes = None;
        let made = guarded(|| {
            episodes = Some(Episodes::new(Arc::clone(tasks), setup)?);
            Ok(Answer::default())
        });
        self.answer(made);
        for job in jobs {
            let answer = match &mut episodes {
                Some(episodes) => guarded(|| self.job(episodes, job)),
                None => Err(Failure::Other("the environment could not be made".to_string())),
            };
            self.answer(answer);
        }
        // Nobody waits for an answer any more: what a recording lacks is said where Python shows it.
        if let Some(Err(error)) = episodes.map(Episodes::close) {
            eprintln!("wad_cosim: {}", error.text());
        }
    }

    fn answer(&mut self, answer: Result<Answer, Failure>) {
        if answer.is_err() {
            self.waits = true;
        }
        let answer = answer.unwrap_or_else(|failure| Answer { failure: Some(failure), ..Answer::default() });
        *lock(&self.shared.answers[self.index]) = answer;
        self.shared.end();
    }

    fn job(&mut self, episodes: &mut Episodes, job: Job) -> Result<Answer, Failure> {
        let mut answer = Answer::default();
        match job {
            Job::Reset(seed, route) => self.reset(episodes, seed, route)?,
            Job::Step(..) | Job::StepAll(_) | Job::Expert | Job::Picture if self.waits => {
                return Err(Failure::Other("no episode is running: call reset first".to_string()));
            }
            Job::Step(action, seed) => answer = self.step(episodes, action, seed)?,
            Job::Expert => answer.action = episodes.expert()?,
            Job::Picture => answer.picture = episodes.picture()?.to_vec(),
            Job::StepAll(_) => return Err(Failure::Other("several egos need egos=".to_string())),
        }
        answer.sumo = episodes.sumo();
        Ok(answer)
    }

    fn reset(&mut self, episodes: &mut Episodes, seed: u64, route: Option<usize>) -> Result<(), Failure> {
        let numbers = episodes.reset(seed, route)?;
        (self.over, self.waits) = (false, false);
        self.shared.now.write(self.index, |part, row| episodes.write(part, row), &numbers);
        Ok(())
    }

    fn step(&mut self, episodes: &mut Episodes, action: Action, seed: u64) -> Result<Answer, Failure> {
        let mut answer = Answer::default();
        if self.over {
            if self.shared.autoreset != Autoreset::NextStep {
                return Err(Failure::Other("the episode has ended: call reset first".to_string()));
            }
            self.reset(episodes, seed, None)?;
            answer.began = true;
            return Ok(answer);
        }
        let (numbers, news) = episodes.step(action)?;
        self.over = news.ending.is_some();
        answer.news = news;
        let index = self.index;
        match &self.shared.last {
            Some(last) if self.over && self.shared.autoreset == Autoreset::SameStep => {
                last.write(index, |part, row| episodes.write(part, row), &numbers);
                self.reset(episodes, seed, None)?;
                answer.began = true;
                // SAFETY: this thread's own row, as in `Arrays::write`.
                let row = unsafe { self.shared.now.numbers.row(index) };
                row[..3].copy_from_slice(&numbers[..3]);
            }
            _ => self.shared.now.write(index, |part, row| episodes.write(part, row), &numbers),
        }
        Ok(answer)
    }
}

/// Serves the egos in one SUMO, whose rows begin with `first`.
fn serve_egos(first: usize, shared: &Shared, tasks: &Tasks, setup: &Setup, jobs: &Receiver<Job>) {
    let answer = |ego: usize, answer: Result<Answer, Failure>| {
        let answer = answer.unwrap_or_else(|failure| Answer { failure: Some(failure), ..Answer::default() });
        *lock(&shared.answers[first + ego]) = answer;
    };
    let mut egos = None;
    let made = guarded(|| {
        egos = Some(Egos::new(tasks, setup, shared.autoreset == Autoreset::NextStep)?);
        Ok(Answer::default())
    });
    answer(0, made);
    shared.end();
    let mut waits = true;
    for job in jobs {
        let done = guarded(|| {
            let Some(egos) = &mut egos else {
                return Err(Failure::Other("the egos could not be made".to_string()));
            };
            let told: Vec<(Numbers, News, bool)> = match job {
                Job::Reset(seed, _) => {
                    egos.reset(seed)?.into_iter().map(|(numbers, news)| (numbers, news, false)).collect()
                }
                Job::StepAll(_) if waits => {
                    return Err(Failure::Other("no episode is running: call reset first".to_string()));
                }
                Job::StepAll(actions) => egos.step(&actions)?,
                _ => return Err(Failure::Input("several egos in one SUMO have none of this".to_string())),
            };
            waits = false;
            for (ego, (numbers, news, began)) in told.into_iter().enumerate() {
                shared.now.write(first + ego, |part, row| egos.write(ego, part, row), &numbers);
                answer(ego, Ok(Answer { news, began, sumo: egos.sumo(), ..Answer::default() }));
            }
            Ok(Answer::default())
        });
        if done.is_err() {
            waits = true;
            answer(0, done);
        }
        shared.end();
    }
    if let Some(egos) = egos {
        egos.close();
    }
}

/// A panic becomes an exception: nobody would answer otherwise.
fn guarded(job: impl FnOnce() -> Result<Answer, Failure>) -> Result<Answer, Failure> {
    catch_unwind(AssertUnwindSafe(job)).unwrap_or_else(|panic| {
        let text = panic.downcast_ref::<String>().map(String::as_str);
        let text = text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("no reason given");
        Err(Failure::Other(format!("the simulator failed: {text}; please report it")))
    })
}
