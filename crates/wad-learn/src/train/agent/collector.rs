//! A collector: one thread, one environment or fleet with its own SUMO, one copy of the actor.

mod fleet;
mod ongoing;

use super::Maker;
use super::config::TrainConfig;
use super::other_days::OtherDays;
use super::recording::{Header, Recording};
use super::schedule::{ActorCopy, Job, Purpose, Report, Schedule};
use crate::agent::action::{self, Action};
use crate::agent::batch::InputScale;
use crate::agent::exploration::Exploration;
use crate::agent::learner::Actor;
use crate::agent::replay_buffer::{SEGMENT, Segment};
use crate::env::{End, Env, EnvError, Info, Stages, WorldMode};
use ongoing::{Chosen, Ongoing, Passed};
use rand_chacha::ChaCha8Rng;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::SyncSender;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;
use wad_see::latent::Encoder;
use wad_see::observation::RAW_SIZE;

/// State shared by collectors and learner. Locks are held only for an episode's begin or a pointer's copy.
#[derive(Debug)]
pub struct Shared {
    pub stop: AtomicBool,
    /// Version of `actor`, readable without a lock.
    pub version: AtomicU64,
    pub actor: Mutex<Arc<ActorCopy>>,
    pub schedule: Mutex<Schedule>,
}

/// Locks, ignoring poison: the data behind these locks is valid at any time.
pub fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Messages of collectors.
#[derive(Debug)]
pub enum Message {
    Segment {
        segment: Segment,
        autopilot: bool,
    },
    Episode(Box<Report>),
    /// A collector's time by stage since its last message (s).
    Times(Times),
    /// A collector gave up.
    Failed(super::TrainError),
}

/// A collector's time by stage (s).
#[derive(Clone, Copy, Debug, Default)]
pub struct Times {
    /// The environment.
    pub env: Stages,
    /// The actor's network.
    pub actor: f64,
    /// Waiting for the learner to take experience.
    pub waiting: f64,
}

/// Why an episode stopped before its end.
enum Stop {
    /// Training is over.
    Over,
    Env(EnvError),
    Broken(String),
}

impl From<EnvError> for Stop {
    fn from(error: EnvError) -> Self {
        Self::Env(error)
    }
}

/// Failures in a row after which a collector gives up.
const PATIENCE: usize = 5;

/// Drives until training is over.
pub fn collect(
    index: usize,
    config: &TrainConfig,
    shared: &Shared,
    maker: &Maker,
    record: Option<&Path>,
    out: &SyncSender<Message>,
) {
    let mut collector = Collector {
        config,
        shared,
        maker,
        record,
        out,
        env: None,
        fresh: None,
        actor: Actor::new(&config.algorithm, config.dims(), &InputScale::identity(config.dims())),
        version: None,
        times: Times::default(),
        told: Stages::default(),
        retry: None,
        failures: 0,
    };
    while !shared.stop.load(Ordering::Relaxed) {
        let stopped = if config.egos > 1 { collector.fly() } else { collector.drive_next() };
        let error = match stopped {
            Ok(()) => continue,
            Err(Stop::Over) => return,
            Err(Stop::Broken(why)) => super::TrainError::Broken(why),
            Err(Stop::Env(error)) => {
                collector.failures += 1;
                if !error.is_input() && collector.failures < PATIENCE {
                    tracing::warn!("collector {index}: what it drove is lost: {error}");
                    (collector.env, collector.fresh) = (None, None);
                    continue;
                }
                error.into()
            }
        };
        let _ = out.send(Message::Failed(error));
        return;
    }
}

struct Collector<'a> {
    config: &'a TrainConfig,
    shared: &'a Shared,
    maker: &'a Maker,
    /// The folder for recorded episodes.
    record: Option<&'a Path>,
    out: &'a SyncSender<Message>,
    /// Running traffic, for training.
    env: Option<Env>,
    /// Fresh worlds, for validation.
    fresh: Option<Env>,
    actor: Actor,
    /// The version that `actor` is a copy of.
    version: Option<u64>,
    times: Times,
    /// The time that `env` had spent at the last report.
    told: Stages,
    /// A validation whose SUMO died: every validation has the same episodes.
    retry: Option<Job>,
    /// In a row.
    failures: usize,
}

impl Collector<'_> {
    fn next_job(&mut self) -> Job {
        self.retry.take().unwrap_or_else(|| lock(&self.shared.schedule).next(self.config))
    }

    /// Drives the next episode, and reports.
    fn drive_next(&mut self) -> Result<(), Stop> {
        let job = self.next_job();
        self.drive_alone(&job)?;
        let now = self.env.as_ref().map(Env::stages);
        self.tell_times(now);
        Ok(())
    }

    fn drive_alone(&mut self, job: &Job) -> Result<(), Stop> {
        self.retry = job.purpose.validates().then(|| job.clone());
        let report = self.drive(job)?;
        if report.ending.end == End::Error {
            return self.died(&report.ending.cause);
        }
        self.retry = None;
        self.tell(report)
    }

    /// SUMO died during an episode.
    fn died(&mut self, cause: &str) -> Result<(), Stop> {
        self.failures += 1;
        if self.failures < PATIENCE {
            return Ok(());
        }
        Err(Stop::Broken(format!("SUMO died {} times in a row; the last time: {cause}", self.failures)))
    }

    /// Drives an episode in an environment of its own: running traffic, or a fresh world for a validation.
    fn drive(&mut self, job: &Job) -> Result<Report, Stop> {
        let validating = job.purpose.validates();
        let slot = if validating { &mut self.fresh } else { &mut self.env };
        let mut env = match slot.take() {
            Some(env) => env,
            None => {
                self.told = if validating { self.told } else { Stages::default() };
                let mut options = self.config.env.clone();
                if validating {
                    options.world = WorldMode::Fresh;
                }
                Env::new(Arc::clone(&self.maker.assets), options, self.encoder(job)?)?
            }
        };
        let result = self.episode(&mut env, job);
        if validating {
            self.fresh = Some(env);
        } else {
            self.env = Some(env);
            // Its SUMO is not needed until the next validation.
            self.fresh = None;
        }
        result
    }

    fn encoder(&self, job: &Job) -> Result<Box<dyn Encoder>, Stop> {
        let other_days = if job.purpose.validates() { 0.0 } else { self.config.other_days };
        let rng = sumo_network::seeds::rng(job.seed, "other days");
        Ok(OtherDays::before((self.maker.encoder)()?, other_days, rng))
    }

    fn episode(&mut self, env: &mut Env, job: &Job) -> Result<Report, Stop> {
        let first = env.reset(&job.task, job.seed)?;
        let record = self.record.filter(|_| !job.purpose.validates());
        let image = env.image().map(|_| env.eyes().image_kind());
        let mut recording = record.map(|folder| (folder, Recording::of(image)));
        observe(&mut recording, env)?;
        let dims = self.config.dims();
        let mut ongoing = Ongoing::new(job.clone(), self.config, finite(dims.of(&first))?);
        loop {
            if self.shared.stop.load(Ordering::Relaxed) {
                return Err(Stop::Over);
            }
            let before = Chosen::before(env.ego());
            let asks = ongoing.asks(self.config) || recording.is_some();
            let shown = if asks { Some(action::from_control(env.expert()?)) } else { None };
            let action = self.choose(&mut ongoing, shown, &env.raw().vector())?;
            let step = env.step(action::to_control(action))?;
            let lost = step.info.ending.as_ref().is_some_and(|ending| ending.end == End::Error);
            if !lost {
                observe(&mut recording, env)?;
                if let Some((_, recording)) = &mut recording {
                    recording.act(action, shown, step.reward as f32);
                }
            }
            let result = Passed {
                reward: step.reward,
                terminated: step.terminated,
                truncated: step.truncated,
                info: &step.info,
                tick: env.tick(),
            };
            let observation = dims.of(&step.observation);
            let chosen = Chosen { action, shown, ..before };
            if let Some(report) = self.passed(&mut ongoing, chosen, &result, observation)? {
                if let Some((folder, recording)) = recording.filter(|_| !lost) {
                    self.keep(folder, &recording, job, &step.info, step.terminated)?;
                }
                return Ok(report);
            }
        }
    }

    fn tell(&mut self, report: Report) -> Result<(), Stop> {
        self.failures = 0;
        self.out.send(Message::Episode(Box::new(report))).map_err(|_| Stop::Over)
    }

    /// The action of an episode's next tick; `shown` is the expert's, where it was asked.
    fn choose(
        &mut self,
        ongoing: &mut Ongoing,
        shown: Option<Action>,
        raw: &[f32; RAW_SIZE],
    ) -> Result<Action, Stop> {
        let Ongoing { job, rng, noise, segment, .. } = ongoing;
        match (&job.purpose, shown) {
            (Purpose::Demonstrate { noisy: true }, Some(shown)) => {
                noise.advance(rng);
                Ok(noise.slip(shown, raw, rng))
            }
            (Purpose::Demonstrate { .. }, shown) => Ok(shown.unwrap_or_default()),
            (purpose, _) => self.act(purpose, segment, noise, rng),
        }
    }

    /// Takes the result of a tick; the report if the episode is over.
    fn passed(
        &mut self,
        ongoing: &mut Ongoing,
        Chosen { action, shown, speed, place }: Chosen,
        result: &Passed<'_>,
        observation: Vec<f32>,
    ) -> Result<Option<Report>, Stop> {
        let purpose = &ongoing.job.purpose;
        if let Some(ending) = result.info.ending.as_ref().filter(|ending| ending.end == End::Error) {
            // The unfinished transition is dropped; all before it are kept.
            tracing::info!("the rest of an episode is lost: {}", ending.cause);
            let mut segment = std::mem::take(&mut ongoing.segment);
            segment.truncated = true;
            self.send(segment, purpose)?;
            return Ok(Some(ongoing.report(result)));
        }
        ongoing.steps += 1;
        ongoing.episodic_return += result.reward;
        ongoing.discounted_return += ongoing.discount * result.reward;
        ongoing.discount *= self.config.algorithm.gamma();
        if ongoing.start.is_none() {
            ongoing.start = ongoing.segment.observations.first().map(|first| (first.clone(), action));
        }
        ongoing.terms.add(&result.info.reward);
        let segment = &mut ongoing.segment;
        segment.actions.push(action);
        segment.shown.push(shown.map(|a| action::shown(a, speed)));
        segment.places.push(place);
        segment.rewards.push(result.reward as f32);
        segment.observations.push(finite(observation)?);
        segment.terminated = result.terminated;
        segment.truncated = result.truncated;
        let over = result.terminated || result.truncated;
        if over || segment.len() == SEGMENT {
            let last = segment.observations.last().cloned().unwrap_or_default();
            let next =
                Segment { lead: if over { Vec::new() } else { segment.way() }, ..Ongoing::segment(last) };
            let whole = std::mem::replace(segment, next);
            self.send(whole, purpose)?;
        }
        Ok(over.then(|| ongoing.report(result)))
    }

    fn act(
        &mut self,
        purpose: &Purpose,
        segment: &Segment,
        noise: &mut Exploration,
        rng: &mut ChaCha8Rng,
    ) -> Result<Action, Stop> {
        let observation = segment.observations.last().map_or(&[][..], Vec::as_slice);
        let normal = noise.advance(rng);
        let clock = Instant::now();
        let action = match purpose {
            Purpose::Demonstrate { .. } | Purpose::Start => return Ok(noise.start_action()),
            Purpose::Explore => {
                self.follow_actor()?;
                if self.actor.is_stochastic() {
                    self.actor.draw(observation, normal)
                } else {
                    noise.disturb(self.actor.act(observation))
                }
            }
            Purpose::Validate(copy) => {
                self.take(copy)?;
                self.actor.act(observation)
            }
        };
        self.times.actor += clock.elapsed().as_secs_f64();
        Ok(action)
    }

    /// Writes a recorded episode.
    fn keep(
        &self,
        folder: &Path,
        recording: &Recording,
        job: &Job,
        info: &Info,
        terminated: bool,
    ) -> Result<(), Stop> {
        let autopilot = matches!(job.purpose, Purpose::Demonstrate { .. });
        let driver = if autopilot { "autopilot" } else { self.config.algorithm.agent_name() };
        let ending = info.ending.as_ref();
        let header = Header {
            task: job.task.kind,
            seed: job.seed,
            driver: driver.to_string(),
            camera_hash: self.config.env.camera.hash(),
            image: recording.image,
            raw_meaning: wad_see::observation::RAW_MEANING,
            detector: self.config.env.detector.clone(),
            success: ending.is_some_and(|ending| ending.success),
            end: ending.map_or("", |ending| ending.end.name()).to_string(),
            transitions: recording.count(),
            terminated,
        };
        recording.write(folder, &header).map_err(|e| Stop::Broken(e.to_string()))
    }

    /// The newest actor.
    fn follow_actor(&mut self) -> Result<(), Stop> {
        if self.version == Some(self.shared.version.load(Ordering::Acquire)) {
            return Ok(());
        }
        let copy = Arc::clone(&lock(&self.shared.actor));
        self.take(&copy)
    }

    fn take(&mut self, copy: &ActorCopy) -> Result<(), Stop> {
        if self.version != Some(copy.version) {
            self.actor.set(&copy.values).map_err(|e| Stop::Broken(e.to_string()))?;
            self.actor.set_scale(&copy.scale);
            self.version = Some(copy.version);
        }
        Ok(())
    }

    /// Sends experience to the learner, except a validation's.
    fn send(&mut self, segment: Segment, purpose: &Purpose) -> Result<(), Stop> {
        if purpose.validates() || segment.is_empty() {
            return Ok(());
        }
        let clock = Instant::now();
        let autopilot = matches!(purpose, Purpose::Demonstrate { .. });
        let sent = self.out.send(Message::Segment { segment, autopilot }).map_err(|_| Stop::Over);
        self.times.waiting += clock.elapsed().as_secs_f64();
        sent
    }

    fn tell_times(&mut self, now: Option<Stages>) {
        if let Some(now) = now {
            self.times.env = difference(&now, &self.told);
            self.told = now;
            let _ = self.out.send(Message::Times(std::mem::take(&mut self.times)));
        }
    }
}

fn difference(now: &Stages, before: &Stages) -> Stages {
    Stages {
        steps: now.steps - before.steps,
        sumo: now.sumo - before.sumo,
        physics: now.physics - before.physics,
        camera: now.camera - before.camera,
        perception: now.perception - before.perception,
        encoder: now.encoder - before.encoder,
        resets: now.resets - before.resets,
        reset: now.reset - before.reset,
    }
}

/// Adds the last look to the recording, if there is one; its raw states too where the agent gets the latent alone.
fn observe(recording: &mut Option<(&Path, Recording)>, env: &Env) -> Result<(), Stop> {
    let Some((_, recording)) = recording else { return Ok(()) };
    recording.observe(env.image(), env.raw().vector()).map_err(|e| Stop::Broken(e.to_string()))
}

/// An observation that is not finite would spoil the networks for good.
fn finite(observation: Vec<f32>) -> Result<Vec<f32>, Stop> {
    match observation.iter().position(|x| !x.is_finite()) {
        None => Ok(observation),
        Some(at) => Err(Stop::Broken(format!(
            "number {at} of an observation (latent or surroundings first, then the raw states) is {}; see the encoder \
             and perception",
            observation[at]
        ))),
    }
}
