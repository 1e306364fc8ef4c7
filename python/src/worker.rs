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
    /// Begin the next episode, of this seed, within the step that ended the last one ([`Autoreset::SameStep`]).
    Next(u64),
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

    /// Copies what a tick led to (reward, terminated, truncated) to another array's row.
    fn copy_outcome(&self, index: usize, to: &Self) {
        // SAFETY: as in `write`; the arrays are two.
        let (from, to) = unsafe { (self.numbers.row(index), to.numbers.row(index)) };
        to[..3].copy_from_slice(&from[..3]);
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
    /// A signal's exception, heard while Python's thread drove.
    signal: Mutex<Option<PyErr>>,
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
        Self {
            now,
            last,
            autoreset,
            answers,
            _owners: owners,
            signal: Mutex::default(),
            running: Mutex::new(0),
            done: Condvar::new(),
        }
    }

    /// Counts `jobs` that are about to be sent.
    pub fn begin(&self, jobs: usize) {
        *lock(&self.running) += jobs;
    }

    /// Whether no job runs.
    pub fn is_idle(&self) -> bool {
        *lock(&self.running) == 0
    }

    /// Waits until no job runs; false: after `limit` some still do.
    pub fn wait(&self, limit: Duration) -> bool {
        let running = lock(&self.running);
        let waited = self.done.wait_timeout_while(running, limit, |running| *running > 0);
        *waited.unwrap_or_else(PoisonError::into_inner).0 == 0
    }

    /// Lets Python look for signals; an exception is kept for [`Shared::signal`].
    fn hears_a_signal(&self) -> bool {
        let heard = Python::attach(|py| py.check_signals().err());
        let is_one = heard.is_some();
        *lock(&self.signal) = heard;
        is_one
    }

    /// The exception of the signal that was heard.
    pub fn signal(&self) -> Option<PyErr> {
        lock(&self.signal).take()
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

/// Starts the thread of the SUMO whose rows begin with `first`; the first answer says whether its environment could be
/// made. `driver` is there once it could.
pub fn spawn(
    first: usize,
    tasks: Arc<Tasks>,
    setup: Arc<Setup>,
    shared: Arc<Shared>,
    driver: Arc<Mutex<Option<Driver>>>,
) -> std::io::Result<(Sender<Job>, std::thread::JoinHandle<()>)> {
    let (sender, jobs) = std::sync::mpsc::channel();
    shared.begin(1);
    let counted = Arc::clone(&shared);
    let thread = std::thread::Builder::new().name(format!("environment {first}")).spawn(move || {
        serve(first, &shared, &tasks, &setup, &jobs, &driver);
    });
    if thread.is_err() {
        counted.end();
    }
    Ok((sender, thread?))
}

fn serve(
    first: usize,
    shared: &Arc<Shared>,
    tasks: &Arc<Tasks>,
    setup: &Setup,
    jobs: &Receiver<Job>,
    driver: &Mutex<Option<Driver>>,
) {
    let made = guarded(|| Driver::new(first, Arc::clone(shared), tasks, setup));
    match made {
        Ok(made) => *lock(driver) = Some(made),
        Err(failure) => lock(&shared.answers[first]).failure = Some(failure),
    }
    shared.end();
    for job in jobs {
        if let Some(driver) = lock(driver).as_mut() {
            let mut left = driver.drive(job);
            while let Some(job) = left {
                left = driver.drive(job);
            }
        }
        shared.end();
    }
    // Nobody waits for an answer any more: what a recording lacks is said where Python shows it.
    if let Some(Err(error)) = lock(driver).take().map(Driver::close) {
        eprintln!("wad_cosim: {}", error.text());
    }
}

/// What drives one SUMO: its thread does what takes long (a SUMO's start), and Python's thread the ticks where it would
/// only wait for them, since waking another core twice costs as much as half a tick.
pub struct Driver {
    first: usize,
    shared: Arc<Shared>,
    seats: Seats,
    /// It was never reset, or its last reset or step failed.
    waits: bool,
}

enum Seats {
    /// An environment.
    One(Box<One>),
    /// Egos in one SUMO.
    Many(Box<Egos>),
}

struct One {
    episodes: Episodes,
    /// The episode has ended.
    over: bool,
}

impl Driver {
    fn new(first: usize, shared: Arc<Shared>, tasks: &Arc<Tasks>, setup: &Setup) -> Result<Self, Failure> {
        // Signals are heard on Python's thread only; its own thread is waited for by one that hears them.
        let own = std::thread::current().id();
        let caller = Arc::clone(&shared);
        let is_given_up = move || std::thread::current().id() != own && caller.hears_a_signal();
        let seats = if setup.egos > 1 {
            let mut egos = Egos::new(Arc::clone(tasks), setup, shared.autoreset == Autoreset::NextStep)?;
            egos.give_up_when(is_given_up);
            Seats::Many(Box::new(egos))
        } else {
            let record = setup.recording(first, shared.answers.len());
            let mut episodes = Episodes::new(Arc::clone(tasks), setup, record.as_deref())?;
            episodes.give_up_when(is_given_up);
            Seats::One(Box::new(One { episodes, over: true }))
        };
        Ok(Self { first, shared, seats, waits: true })
    }

    /// Whether the job takes longer than a tick.
    pub fn is_long(&self, job: &Job) -> bool {
        match (job, &self.seats) {
            (Job::Reset(..) | Job::Next(_), _) => true,
            (Job::Step(..), Seats::One(one)) => one.over && !self.waits,
            (Job::StepAll(_), Seats::Many(egos)) => egos.sumo().is_none() && !self.waits,
            _ => false,
        }
    }

    /// Does a job, writes arrays and answers, and tells what is left to do: after an episode's end the long begin of
    /// the next.
    pub fn drive(&mut self, job: Job) -> Option<Job> {
        let shared = Arc::clone(&self.shared);
        self.drive_into(job, &shared.now)
    }

    /// The same with observations and numbers written to `now`.
    pub fn drive_into(&mut self, job: Job, now: &Arrays) -> Option<Job> {
        let asks = matches!(job, Job::Expert | Job::Picture);
        let done = guarded(|| {
            let place = Place { first: self.first, shared: &self.shared, now };
            if self.waits && !matches!(job, Job::Reset(..)) {
                return Err(Failure::Other("no episode is running: call reset first".to_string()));
            }
            match &mut self.seats {
                Seats::One(one) => one.drive(place, job),
                Seats::Many(egos) => drive_all(egos, place, job).map(|()| None),
            }
        });
        if !asks {
            self.waits = done.is_err();
        }
        done.unwrap_or_else(|failure| {
            lock(&self.shared.answers[self.first]).failure = Some(failure);
            None
        })
    }

    fn close(self) -> Result<(), Failure> {
        match self.seats {
            Seats::One(one) => one.episodes.close(),
            Seats::Many(egos) => {
                egos.close();
                Ok(())
            }
        }
    }
}

/// The rows and answers of one SUMO.
#[derive(Clone, Copy)]
struct Place<'a> {
    first: usize,
    shared: &'a Shared,
    now: &'a Arrays,
}

impl Place<'_> {
    fn answer(&self, ego: usize) -> MutexGuard<'_, Answer> {
        lock(&self.shared.answers[self.first + ego])
    }
}

impl One {
    fn drive(&mut self, place: Place<'_>, job: Job) -> Result<Option<Job>, Failure> {
        let (shared, index) = (place.shared, place.first);
        let mut left = None;
        match job {
            Job::Reset(seed, route) => self.reset(place, seed, route)?,
            Job::Step(_, seed) if self.over => {
                if shared.autoreset != Autoreset::NextStep {
                    return Err(Failure::Other("the episode has ended: call reset first".to_string()));
                }
                self.reset(place, seed, None)?;
                place.answer(0).began = true;
            }
            Job::Step(action, seed) => {
                let (numbers, news) = self.episodes.step(action)?;
                self.over = news.ending.is_some();
                place.answer(0).news = news;
                let arrays = match &shared.last {
                    Some(last) if self.over && shared.autoreset == Autoreset::SameStep => {
                        left = Some(Job::Next(seed));
                        last
                    }
                    _ => place.now,
                };
                arrays.write(index, |part, row| self.episodes.write(part, row), &numbers);
            }
            Job::Next(seed) => {
                self.reset(place, seed, None)?;
                place.answer(0).began = true;
                if let Some(last) = &shared.last {
                    last.copy_outcome(index, place.now);
                }
            }
            // The next step begins an episode, whatever the action.
            Job::Expert if self.over && shared.autoreset == Autoreset::NextStep => {
                place.answer(0).action = Action::default();
            }
            Job::Expert => place.answer(0).action = self.episodes.expert()?,
            Job::Picture => place.answer(0).picture = self.episodes.picture()?.to_vec(),
            Job::StepAll(_) => return Err(Failure::Other("several egos need egos=".to_string())),
        }
        place.answer(0).sumo = self.episodes.sumo();
        Ok(left)
    }

    fn reset(&mut self, place: Place<'_>, seed: u64, route: Option<usize>) -> Result<(), Failure> {
        let numbers = self.episodes.reset(seed, route)?;
        self.over = false;
        place.now.write(place.first, |part, row| self.episodes.write(part, row), &numbers);
        Ok(())
    }
}

fn drive_all(egos: &mut Egos, place: Place<'_>, job: Job) -> Result<(), Failure> {
    let told: Vec<(Numbers, News, bool)> = match job {
        Job::Reset(seed, _) => {
            egos.reset(seed)?.into_iter().map(|(numbers, news)| (numbers, news, false)).collect()
        }
        Job::StepAll(actions) => egos.step(&actions)?,
        _ => return Err(Failure::Input("several egos in one SUMO have none of this".to_string())),
    };
    for (ego, (numbers, news, began)) in told.into_iter().enumerate() {
        let write = |part, row: Row<'_>| egos.write(ego, part, row);
        place.now.write(place.first + ego, write, &numbers);
        let mut answer = place.answer(ego);
        (answer.news, answer.began, answer.sumo) = (news, began, egos.sumo());
    }
    Ok(())
}

/// A panic becomes an exception: nobody would answer otherwise.
fn guarded<T>(job: impl FnOnce() -> Result<T, Failure>) -> Result<T, Failure> {
    catch_unwind(AssertUnwindSafe(job)).unwrap_or_else(|panic| {
        let text = panic.downcast_ref::<String>().map(String::as_str);
        let text = text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("no reason given");
        Err(Failure::Other(format!("the simulator failed: {text}; please report it")))
    })
}
