//! A collector: one thread, one environment with its own SUMO, one copy of the actor.

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
use crate::env::{End, Env, EnvError, Stages, WorldMode};
use crate::reward::RewardTerms;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::SyncSender;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;
use wad_see::observation::Observation;

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
    };
    let mut failures = 0;
    let mut retry: Option<Job> = None;
    while !shared.stop.load(Ordering::Relaxed) {
        let job = retry.take().unwrap_or_else(|| lock(&shared.schedule).next(config));
        match collector.drive(&job) {
            // SUMO died during the episode.
            Ok(report) if report.ending.end == End::Error => {
                failures += 1;
                if failures >= PATIENCE {
                    let why = format!(
                        "SUMO died {failures} times in a row; the last time: {}",
                        report.ending.cause
                    );
                    let _ = out.send(Message::Failed(super::TrainError::Broken(why)));
                    return;
                }
                retry = matches!(job.purpose, Purpose::Validate(_)).then_some(job);
            }
            Ok(report) => {
                failures = 0;
                if out.send(Message::Episode(Box::new(report))).is_err() {
                    return;
                }
            }
            Err(Stop::Over) => return,
            Err(Stop::Broken(why)) => {
                let _ = out.send(Message::Failed(super::TrainError::Broken(why)));
                return;
            }
            Err(Stop::Env(error)) => {
                failures += 1;
                let hopeless = error.is_input() && !matches!(error, EnvError::Crowded { .. });
                if hopeless || failures >= PATIENCE {
                    let _ = out.send(Message::Failed(error.into()));
                    return;
                }
                tracing::warn!("collector {index}: an episode of `{}` is lost: {error}", job.task.kind);
                collector.env = None;
                collector.fresh = None;
                // Every validation has the same episodes.
                retry = matches!(job.purpose, Purpose::Validate(_)).then_some(job);
            }
        }
        collector.tell_times();
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
}

impl Collector<'_> {
    fn drive(&mut self, job: &Job) -> Result<Report, Stop> {
        let validating = matches!(job.purpose, Purpose::Validate(_));
        let slot = if validating { &mut self.fresh } else { &mut self.env };
        let mut env = match slot.take() {
            Some(env) => env,
            None => {
                self.told = if validating { self.told } else { Stages::default() };
                let mut options = self.config.env.clone();
                if validating {
                    options.world = WorldMode::Fresh;
                }
                let other_days = if validating { 0.0 } else { self.config.other_days };
                let rng = sumo_network::seeds::rng(job.seed, "other days");
                let encoder = OtherDays::before((self.maker.encoder)()?, other_days, rng);
                (self.maker.env)(options, encoder)?
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

    fn episode(&mut self, env: &mut Env, job: &Job) -> Result<Report, Stop> {
        let mut rng = ChaCha8Rng::seed_from_u64(sumo_network::seeds::derive(job.seed, "exploration"));
        let mut noise = Exploration::new(self.config.exploration, &mut rng);
        let begin = |observation: Vec<f32>| Segment { observations: vec![observation], ..Segment::default() };
        let first = env.reset(&job.task, job.seed)?;
        let validating = matches!(job.purpose, Purpose::Validate(_));
        let mut recording = self.record.filter(|_| !validating).map(|folder| (folder, Recording::default()));
        observe(&mut recording, env, &first)?;
        let dims = self.config.dims();
        let mut segment = begin(finite(dims.of(&first))?);
        let (mut episodic_return, mut steps, mut terms) = (0.0, 0, RewardTerms::default());
        loop {
            if self.shared.stop.load(Ordering::Relaxed) {
                return Err(Stop::Over);
            }
            let autopilot = matches!(job.purpose, Purpose::Demonstrate { .. });
            let speed = env.speed();
            let asks = autopilot || !validating && (recording.is_some() || self.config.asks());
            let shown = if asks { Some(action::from_control(env.expert()?)) } else { None };
            let action = match (&job.purpose, shown) {
                (Purpose::Demonstrate { noisy: true }, Some(shown)) => {
                    noise.advance(&mut rng);
                    noise.slip(shown, &env.raw().vector(), &mut rng)
                }
                (Purpose::Demonstrate { .. }, shown) => shown.unwrap_or_default(),
                (purpose, _) => self.act(purpose, &segment, &mut noise, &mut rng)?,
            };
            let step = env.step(action::to_control(action))?;
            if let Some(ending) = step.info.ending.as_ref().filter(|ending| ending.end == End::Error) {
                // The unfinished transition is dropped; all before it are kept.
                tracing::info!("the rest of an episode is lost: {}", ending.cause);
                segment.truncated = true;
                // A recording needs its own end.
                self.send(segment, &job.purpose)?;
                return Ok(report(job, &step.info, steps, episodic_return, terms, env));
            }
            steps += 1;
            episodic_return += step.reward;
            terms.add(&step.info.reward);
            observe(&mut recording, env, &step.observation)?;
            if let Some((_, recording)) = &mut recording {
                recording.act(action, shown, step.reward as f32);
            }
            segment.actions.push(action);
            segment.shown.push(shown.map(|a| action::shown(a, speed)));
            segment.rewards.push(step.reward as f32);
            segment.observations.push(finite(dims.of(&step.observation))?);
            segment.terminated = step.terminated;
            segment.truncated = step.truncated;
            let over = step.terminated || step.truncated;
            if over || segment.len() == SEGMENT {
                let last = segment.observations.last().cloned().unwrap_or_default();
                self.send(std::mem::replace(&mut segment, begin(last)), &job.purpose)?;
            }
            if over {
                if let Some((folder, recording)) = recording {
                    self.keep(folder, &recording, job, &step.info, step.terminated)?;
                }
                return Ok(report(job, &step.info, steps, episodic_return, terms, env));
            }
        }
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
        info: &crate::env::Info,
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
        if matches!(purpose, Purpose::Validate(_)) || segment.is_empty() {
            return Ok(());
        }
        let clock = Instant::now();
        let autopilot = matches!(purpose, Purpose::Demonstrate { .. });
        let sent = self.out.send(Message::Segment { segment, autopilot }).map_err(|_| Stop::Over);
        self.times.waiting += clock.elapsed().as_secs_f64();
        sent
    }

    fn tell_times(&mut self) {
        if let Some(env) = &self.env {
            let now = env.stages();
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

fn report(
    job: &Job,
    info: &crate::env::Info,
    steps: u64,
    episodic_return: f64,
    terms: RewardTerms,
    env: &Env,
) -> Report {
    let unknown = || crate::env::Ending { end: End::Error, cause: "unknown".to_string(), success: false };
    Report {
        purpose: job.purpose.clone(),
        task: job.task.clone(),
        ending: info.ending.clone().unwrap_or_else(unknown),
        steps,
        episodic_return,
        terms,
        mean_speed: info.driven / (info.tick.max(1) as f64 * env.tick().as_secs_f64()),
        distance: info.driven,
    }
}

/// Adds the observation to the recording, if there is one.
fn observe(
    recording: &mut Option<(&Path, Recording)>,
    env: &Env,
    observation: &Observation,
) -> Result<(), Stop> {
    if let (Some((_, recording)), Some(image)) = (recording, env.image()) {
        recording.observe(image, &observation.raw).map_err(|e| Stop::Broken(e.to_string()))?;
    }
    Ok(())
}

/// An observation that is not finite would spoil the networks for good.
fn finite(observation: Vec<f32>) -> Result<Vec<f32>, Stop> {
    match observation.iter().position(|x| !x.is_finite()) {
        None => Ok(observation),
        Some(at) => Err(Stop::Broken(format!(
            "number {at} of an observation (0-199 latent, 200-214 raw) is {}; see the encoder and perception",
            observation[at]
        ))),
    }
}
