//! The learner's loop.

mod messages;
mod recorded;
mod report;
#[cfg(test)]
mod tests;
mod validation;

use super::checkpoint::{Best, Checkpoints, RngState, State};
use super::collector::{Message, Shared, collect, lock};
use super::config::TrainConfig;
use super::log::RunLog;
use super::schedule::{ActorCopy, Schedule};
use super::{Limits, Maker, Progress, TrainError, Trained};
use crate::agent::batch::{Batches, InputScale, Inputs, Metrics, Scale};
use crate::agent::learner::Learner;
use crate::agent::policy::{Policy, PolicyCard};
use crate::agent::replay_buffer::{ReplayBuffer, Sampled};
use crate::env::Stages;
use crate::folder_lock::FolderLock;
use crate::train::run::CONFIG;
use rand_chacha::ChaCha8Rng;
use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, sync_channel};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use sumo_network::seeds;
use validation::Validation;

/// Updates that are sampled and moved to the device together.
const TOGETHER: usize = 8;
/// Backlog of updates at which the learner stops receiving from collectors.
const SLACK: u64 = 64;
/// Updates between two copies of the actor for the collectors.
const PUBLISH: u64 = 64;
/// Time between two lines of metrics.
const FIGURES: Duration = Duration::from_secs(5);
/// Observations used to measure the inputs' scale.
const MEASURED: usize = 20_000;

/// Trains, or continues with `resume`. Ends at the limits, at `interrupt`, or on an error; the state
/// is saved in each case, once something was driven.
///
/// # Errors
/// Bad configuration, SUMO, the disk, or learning that diverges.
pub fn train(
    config: &TrainConfig,
    limits: &Limits,
    resume: bool,
    interrupt: &AtomicBool,
    maker: &Maker,
    mut progress: impl FnMut(Progress<'_>),
) -> Result<Trained, TrainError> {
    if let Some(problem) = config.problem().or_else(|| limits.problem(config)) {
        return Err(TrainError::Config(problem));
    }
    wad_see::perception::check(&config.env.detector)?;
    if let Some(folder) = &limits.record {
        let failed = |source| TrainError::Write { path: folder.clone(), source };
        std::fs::create_dir_all(folder).map_err(failed)?;
    }
    let _lock = FolderLock::take(&limits.out)?;
    let mut learning = Learning::begin(config, limits, resume)?;
    if !resume && !config.recorded.is_empty() {
        learning.recall(interrupt, (maker.encoder)()?, &mut progress)?;
    }
    let shared = learning.shared();
    if resume && learning.steps >= config.steps {
        let news = format!("the {} steps are done; a larger --steps goes on", config.steps);
        learning.show(&shared, Some(news), &mut progress);
    }
    let collectors = limits.collectors.max(1);
    let result = std::thread::scope(|scope| {
        let (out, messages) = sync_channel(2 * collectors);
        let mut result = Ok(());
        for index in 0..collectors {
            let (out, shared) = (out.clone(), &shared);
            let started = std::thread::Builder::new()
                .name(format!("collector {index}"))
                .spawn_scoped(scope, move || {
                    collect(index, config, shared, maker, limits.record.as_deref(), &out)
                });
            if let Err(error) = started {
                result = Err(TrainError::Thread(error));
            }
        }
        drop(out);
        let result = result.and_then(|()| learning.run(&messages, &shared, interrupt, &mut progress));
        shared.stop.store(true, Ordering::Relaxed);
        // Closing the channel ends collectors that wait to send.
        drop(messages);
        result
    });
    learning.finish(&shared, result)
}

/// The trained agent of `--init`.
fn begin_with(config: &TrainConfig, name: &str) -> Result<Policy, TrainError> {
    let (policy, path) = Policy::find(name)?;
    policy.check(&path, &config.encoder_hash, &config.env.camera.hash())?;
    let (agent, asked) = (policy.card.algorithm.agent_name(), config.algorithm.agent_name());
    if agent != asked {
        return Err(TrainError::Config(format!(
            "expected a {asked} to start with, found a {agent} in `{}`; choose one of the same algorithm",
            path.display()
        )));
    }
    if policy.card.inputs != config.inputs {
        return Err(TrainError::Config(format!(
            "expected an agent with the inputs {:?} to start with, found {:?} in `{}`; train with the same inputs",
            config.inputs,
            policy.card.inputs,
            path.display()
        )));
    }
    Ok(policy)
}

struct Learning<'a> {
    config: &'a TrainConfig,
    limits: &'a Limits,
    learner: Learner,
    buffer: ReplayBuffer,
    scale: Option<(InputScale, Scale)>,
    rng: ChaCha8Rng,
    sampled: Sampled,
    metrics: Metrics,
    log: RunLog,
    checkpoints: Checkpoints,
    /// Steps of behaviour cloning so far.
    cloned: u64,
    /// Environment steps of the agent, of the autopilot, and of the recorded episodes.
    steps: u64,
    demonstrated: u64,
    recorded: u64,
    version: u64,
    published_at: u64,
    best: Option<Best>,
    validated_at: u64,
    saved_at: u64,
    /// The actor that the training begins with was trained before or is cloned, and is still to be validated.
    begins_trained: bool,
    validation: Option<Validation>,
    /// The schedule of the resumed checkpoint.
    resumed: Option<super::schedule::ScheduleState>,
    returns: VecDeque<f64>,
    before_seconds: f64,
    began: Instant,
    figures_at: Instant,
    shown_at: Option<Instant>,
    rate: Rate,
    interrupted: bool,
}

/// Counts for the speed, from the first update on.
#[derive(Default)]
struct Rate {
    began: Option<Instant>,
    steps: u64,
    updates: u64,
    learning: f64,
    /// Since the last metrics.
    last: (u64, u64),
    env: Stages,
    actor: f64,
    waiting: f64,
    paused: f64,
}

impl<'a> Learning<'a> {
    fn begin(config: &'a TrainConfig, limits: &'a Limits, resume: bool) -> Result<Self, TrainError> {
        let out = &limits.out;
        let init = config.init.as_deref().filter(|_| !resume);
        let init = init.map(|name| begin_with(config, name)).transpose()?;
        std::fs::create_dir_all(out).map_err(|source| TrainError::Write { path: out.clone(), source })?;
        if out.join(CONFIG).exists() && !resume {
            return Err(TrainError::Taken { path: out.clone() });
        }
        let mut learner = Learner::new(&config.algorithm, config.dims(), config.seed, limits.device);
        let mut checkpoints = Checkpoints::new(out);
        let new_buffer = || Ok(ReplayBuffer::new(config.dims(), config.buffer)?);
        let (state, buffer) = if resume {
            let (state, buffer) = checkpoints.restore(&mut learner, new_buffer)?;
            (Some(state), buffer)
        } else {
            (None, new_buffer()?)
        };
        // Checkpoints of older versions do not say what was in the logs.
        let logged = state.as_ref().map_or([0; 2], |state| state.logged.unwrap_or([u64::MAX; 2]));
        let resumed = state.as_ref().map(|state| state.steps);
        let mut rng = seeds::rng(config.seed, "learner");
        let mut learning = Self {
            log: RunLog::open(out, logged, resumed)?,
            config,
            limits,
            learner,
            buffer,
            scale: None,
            sampled: Sampled::default(),
            metrics: Metrics::default(),
            checkpoints,
            cloned: 0,
            steps: 0,
            demonstrated: 0,
            recorded: 0,
            version: 0,
            published_at: 0,
            best: None,
            validated_at: 0,
            saved_at: 0,
            begins_trained: config.validation.every > 0 && (config.init.is_some() || config.cloning > 0),
            validation: None,
            resumed: None,
            returns: VecDeque::new(),
            before_seconds: 0.0,
            began: Instant::now(),
            figures_at: Instant::now(),
            shown_at: None,
            rate: Rate::default(),
            interrupted: false,
            rng: rng.clone(),
        };
        if let Some(state) = state {
            // The checkpoint was checked, including its generator.
            rng = state.rng.generator().unwrap_or(rng);
            learning.rng = rng;
            learning.steps = state.steps;
            learning.saved_at = state.steps;
            learning.demonstrated = state.schedule.demonstrated;
            learning.recorded = state.recorded;
            learning.cloned = state.cloned;
            learning.scale = state.scale.map(|scale| {
                let tensors = scale.tensors(limits.device);
                (scale, tensors)
            });
            learning.best = state.best;
            learning.validated_at = state.validated_at;
            learning.begins_trained = state.begins_trained;
            learning.before_seconds = state.wall_seconds;
            learning.published_at = learning.learner.updates();
            learning.resumed = Some(state.schedule);
        } else if let Some(policy) = init {
            learning.learner.set_actor(&policy.values)?;
            let tensors = policy.scale.tensors(limits.device);
            learning.scale = Some((policy.scale, tensors));
        }
        Ok(learning)
    }

    /// What it shares with collectors, at its beginning.
    fn shared(&mut self) -> Shared {
        Shared {
            stop: AtomicBool::new(false),
            version: AtomicU64::new(0),
            actor: Mutex::new(Arc::new(self.copy())),
            schedule: Mutex::new(Schedule::new(self.config, self.resumed.take(), self.steps)),
        }
    }

    /// Steps in the buffer that the agent did not drive.
    fn demonstrations(&self) -> u64 {
        self.recorded + self.demonstrated
    }

    fn copy(&self) -> ActorCopy {
        ActorCopy {
            version: self.version,
            values: self.learner.actor_values(),
            scale: self
                .scale
                .as_ref()
                .map_or_else(|| InputScale::identity(self.config.dims()), |(scale, _)| scale.clone()),
        }
    }

    /// Updates due by now.
    fn due(&self) -> u64 {
        let c = self.config;
        let start = if c.is_warm() { 0 } else { c.learning_starts };
        c.pretrain + (c.update_ratio * self.steps.saturating_sub(start) as f64) as u64
    }

    fn ready(&self) -> bool {
        let c = self.config;
        if c.is_warm() { self.demonstrated >= c.demonstrations } else { self.steps >= c.learning_starts }
    }

    fn run(
        &mut self,
        messages: &Receiver<Message>,
        shared: &Shared,
        interrupt: &AtomicBool,
        progress: &mut impl FnMut(Progress<'_>),
    ) -> Result<(), TrainError> {
        loop {
            if interrupt.load(Ordering::Relaxed) {
                self.interrupted = true;
                return Ok(());
            }
            if self.limits.time.is_some_and(|limit| self.began.elapsed() >= limit) {
                return Ok(());
            }
            if self.ready() && self.learner.updates() == 0 && self.cloned < self.config.cloning {
                // Collectors wait meanwhile, rather than drive with an untrained actor.
                self.clone_expert(shared)?;
                self.now_and_then(shared, progress)?;
                continue;
            }
            // Validated before it learns: the others show what learning added.
            if self.cloned >= self.config.cloning && std::mem::take(&mut self.begins_trained) {
                self.start_validation(shared);
            }
            let over = self.steps >= self.config.steps;
            let behind = if self.ready() { self.due().saturating_sub(self.learner.updates()) } else { 0 };
            if over && behind == 0 && self.validation.is_none() {
                // The end is validated too, unless it was just now.
                if self.config.validation.every == 0 || self.validated_at == self.steps {
                    return Ok(());
                }
                self.start_validation(shared);
            }
            if self.config.update_ratio == 0.0 && self.ready() {
                self.begin_rate(Instant::now());
            }
            if behind > 0 {
                self.learn(shared, behind.min(TOGETHER as u64) as usize)?;
            }
            if behind < SLACK {
                self.listen(messages, shared, behind == 0, progress)?;
            }
            self.now_and_then(shared, progress)?;
        }
    }

    fn learn(&mut self, shared: &Shared, updates: usize) -> Result<(), TrainError> {
        let clock = Instant::now();
        self.begin_rate(clock);
        let batches = self.sample(updates);
        for i in 0..updates {
            self.learner.update(&batches.get(i), &mut self.metrics);
        }
        if self.learner.updates() >= self.published_at + PUBLISH {
            self.publish(shared)?;
        }
        self.rate.learning += clock.elapsed().as_secs_f64();
        Ok(())
    }

    /// A few steps of behaviour cloning, at a rate that falls linearly to a tenth.
    fn clone_expert(&mut self, shared: &Shared) -> Result<(), TrainError> {
        let batches = self.sample(TOGETHER);
        for i in 0..TOGETHER {
            let done = self.cloned as f64 / self.config.cloning as f64;
            let rate = self.config.cloning_rate * (1.0 - 0.9 * done.min(1.0));
            self.learner.clone_expert(&batches.get(i), rate);
            self.cloned += 1;
        }
        if self.cloned.is_multiple_of(PUBLISH) || self.cloned >= self.config.cloning {
            self.publish(shared)?;
        }
        Ok(())
    }

    fn begin_rate(&mut self, clock: Instant) {
        if self.rate.began.is_none() {
            let (steps, updates) = (self.steps, self.learner.updates());
            self.rate =
                Rate { began: Some(clock), steps, updates, last: (steps, updates), ..Rate::default() };
            self.figures_at = clock;
        }
    }

    /// Batches of experience; the first call measures the inputs' scale.
    fn sample(&mut self, updates: usize) -> Batches {
        let config = self.config;
        let (_, scale) = self.scale.get_or_insert_with(|| {
            let scale = if config.inputs == Inputs::Vector {
                // The surroundings are scaled by definition.
                InputScale::identity(config.dims())
            } else {
                let (mean, deviation) = self.buffer.moments(MEASURED);
                InputScale::measured(&mean, &deviation, config.dims(), config.latent_gain)
            };
            let tensors = scale.tensors(self.limits.device);
            (scale, tensors)
        });
        self.buffer.sample(&mut self.rng, config.sampling(), updates, &mut self.sampled);
        let batches = Batches::upload(&self.sampled, config.dims(), scale, self.limits.device);
        if config.latent_mixing > 0.0 {
            batches.mix_latents(config.dims(), config.latent_mixing, &mut self.rng);
        }
        batches
    }

    /// Publishes the newest actor for collectors.
    fn publish(&mut self, shared: &Shared) -> Result<(), TrainError> {
        self.published_at = self.learner.updates();
        self.version += 1;
        let copy = self.copy();
        if copy.values.iter().any(|x| !x.is_finite()) {
            return Err(self.diverged("a parameter of the actor"));
        }
        *lock(&shared.actor) = Arc::new(copy);
        shared.version.store(self.version, Ordering::Release);
        Ok(())
    }

    fn diverged(&self, what: &str) -> TrainError {
        TrainError::Diverged {
            steps: self.steps,
            what: what.to_string(),
            kept: if self.saved_at > 0 {
                format!(
                    "the checkpoint of step {} is kept; begin a new training with --init {} and smaller \
                     learning rates",
                    self.saved_at,
                    self.limits.out.join("last.safetensors").display()
                )
            } else {
                "there was no checkpoint yet; begin again with smaller learning rates".to_string()
            },
        }
    }

    fn now_and_then(
        &mut self,
        shared: &Shared,
        progress: &mut impl FnMut(Progress<'_>),
    ) -> Result<(), TrainError> {
        if self.shown_at.is_none_or(|at| at.elapsed() > Duration::from_millis(200)) {
            self.shown_at = Some(Instant::now());
            self.show(shared, None, progress);
        }
        if self.rate.began.is_none() {
            return Ok(());
        }
        if self.figures_at.elapsed() > FIGURES {
            self.figures()?;
        }
        if self.steps >= self.saved_at + self.config.checkpoint_every {
            self.save(shared)?;
        }
        let every = self.config.validation.every;
        if every > 0 && self.validation.is_none() && self.steps >= self.validated_at + every {
            self.start_validation(shared);
        }
        Ok(())
    }

    /// The actor that is kept, without scores.
    fn policy(&self) -> Policy {
        let c = self.config;
        let card = PolicyCard {
            algorithm: c.algorithm.clone(),
            dims: c.dims(),
            inputs: c.inputs,
            encoder_hash: c.encoder_hash.clone(),
            camera_hash: c.env.camera.hash(),
            raw_meaning: wad_see::observation::RAW_MEANING,
            detector: c.env.detector.clone(),
            steps: self.steps,
            updates: self.learner.updates(),
            seed: c.seed,
            demonstrations: self.demonstrations(),
            scores: serde_json::Value::Null,
            config: serde_json::to_value(c).unwrap_or_default(),
        };
        let scale = self.scale.as_ref().map(|(scale, _)| scale.clone());
        let scale = scale.unwrap_or_else(|| InputScale::identity(c.dims()));
        Policy::new(card, scale, &self.learner.kept_actor_values())
    }

    /// Wall time of all calls of this training (h).
    fn hours(&self) -> f64 {
        (self.before_seconds + self.began.elapsed().as_secs_f64()) / 3600.0
    }

    fn save(&mut self, shared: &Shared) -> Result<(), TrainError> {
        let tensors = self.learner.tensors();
        if let Some((name, _)) = tensors.iter().find(|(_, t)| t.isfinite().all().int64_value(&[]) == 0) {
            let what = format!("a number of `{name}`");
            return Err(self.diverged(&what));
        }
        let clock = Instant::now();
        let state = State {
            steps: self.steps,
            updates: 0,
            raw_meaning: 0,
            adam_steps: Vec::new(),
            rng: RngState::of(&self.rng),
            schedule: lock(&shared.schedule).state.clone(),
            scale: self.scale.as_ref().map(|(scale, _)| scale.clone()),
            best: self.best,
            validated_at: self.validated_at,
            recorded: self.recorded,
            cloned: self.cloned,
            begins_trained: self.begins_trained,
            logged: Some(self.log.lengths()?),
            wall_seconds: 3600.0 * self.hours(),
            replay: Default::default(),
            learner_bytes: 0,
            learner_crc: 0,
        };
        self.checkpoints.save(state, &mut self.learner, &self.buffer, self.config)?;
        self.saved_at = self.steps;
        self.policy().save(&self.limits.out.join("last.safetensors"))?;
        self.rate.paused += clock.elapsed().as_secs_f64();
        Ok(())
    }
}
