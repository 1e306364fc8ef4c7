//! Drives the episodes of a plan, several at a time.

use super::kept::{self, Kept, Packed};
use super::record::Fault;
use super::tally::Tally;
use super::{Case, Driver, DriverError, DriverSpec, EpisodeRecord, Made, RecordingFolder};
use crate::env::{Assets, End, Ending, Env, EnvError, EnvOptions, ObservationMode};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::str::FromStr;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, mpsc};
use wad_see::latent::{Encoder, PooledEncoder};
use wad_sim::assets::AssetsError;
use wad_sim::replay::{Moment, Recorder};
use wad_vehicle::Control;

/// Why an evaluation stopped.
#[derive(Debug, thiserror::Error)]
pub enum EvalError {
    /// An environment cannot be made or go on.
    #[error(transparent)]
    Env(#[from] EnvError),
    /// A town cannot be read.
    #[error(transparent)]
    Assets(#[from] AssetsError),
    /// The suite has no such part.
    #[error(transparent)]
    Suite(#[from] super::SuiteError),
    /// SUMO is missing.
    #[error(transparent)]
    Sumo(#[from] sumo_traci::process::InstallError),
    /// A driver cannot be made.
    #[error(transparent)]
    Driver(#[from] DriverError),
    /// Results cannot be stored.
    #[error(transparent)]
    Store(#[from] super::StoreError),
    /// An episode of another plan.
    #[error("the episode {name} is not in this evaluation's plan")]
    Unplanned {
        /// Its name.
        name: String,
    },
    /// This machine would drive the evaluation otherwise than the one that keeps its results.
    #[error(
        "this machine would drive the evaluation otherwise than the one that keeps its results: {}; install the same \
         build, SUMO, towns and weights on both", differences.join("; ")
    )]
    Elsewhere {
        /// What differs: expected there, found here.
        differences: Vec<String>,
    },
    /// A kept episode cannot be written.
    #[error(transparent)]
    Kept(#[from] kept::KeptError),
}

/// Makes a trained or external agent; called on the thread that drives.
pub type MakeAgent<'a> = dyn Fn(&DriverSpec) -> Result<Made, DriverError> + Sync + 'a;

/// The episodes to keep for `replay`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Keep {
    /// No episode.
    None,
    /// Episodes without success.
    #[default]
    Failures,
    /// Every episode.
    All,
}

impl FromStr for Keep {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "none" => Ok(Self::None),
            "failures" => Ok(Self::Failures),
            "all" => Ok(Self::All),
            _ => Err(format!("expected none, failures or all, found `{text}`")),
        }
    }
}

/// Options of driving a plan.
pub struct Evaluation<'a> {
    /// The environment's options.
    pub options: EnvOptions,
    /// Environments in parallel.
    pub jobs: usize,
    /// Makes trained and external agents.
    pub make_agent: &'a MakeAgent<'a>,
    /// The episodes to record.
    pub keep: Keep,
    /// The program's version, for kept episodes.
    pub build: &'a str,
    /// Set it to stop after the running episodes.
    pub stop: &'a AtomicBool,
}

/// An episode that was driven.
#[derive(Clone, Debug, PartialEq)]
pub struct Driven {
    /// Its result.
    pub record: EpisodeRecord,
    /// Its recording, if it is one to keep.
    pub recording: Option<Packed>,
}

/// Drives the episodes of `plan` in `towns`. `done` gets each one when it ends, in any order.
///
/// # Errors
/// A town, a task or an agent cannot be opened, or `done` fails. Finished episodes stay with `done`.
pub fn run(
    plan: &[Case],
    towns: &BTreeMap<String, Arc<Assets>>,
    evaluation: &Evaluation<'_>,
    mut done: impl FnMut(Driven) -> Result<(), EvalError>,
) -> Result<(), EvalError> {
    let next = AtomicUsize::new(0);
    let failed = AtomicBool::new(false);
    let (sender, receiver) = mpsc::channel();
    std::thread::scope(|scope| {
        for _ in 0..evaluation.jobs.clamp(1, plan.len().max(1)) {
            let sender = sender.clone();
            let (next, failed) = (&next, &failed);
            scope.spawn(move || {
                let mut worker = Worker::default();
                loop {
                    let stopped = evaluation.stop.load(Ordering::Relaxed) || failed.load(Ordering::Relaxed);
                    let index = next.fetch_add(1, Ordering::Relaxed);
                    let Some(case) = plan.get(index).filter(|_| !stopped) else { break };
                    let town = towns.get(&case.town).ok_or_else(|| EnvError::NoEpisode.into());
                    let driven = town.and_then(|town| worker.drive(evaluation, case, town));
                    failed.fetch_or(driven.is_err(), Ordering::Relaxed);
                    if sender.send(driven).is_err() {
                        break;
                    }
                }
            });
        }
        drop(sender);
        let mut result = Ok(());
        for driven in receiver {
            let outcome = driven.and_then(&mut done);
            failed.fetch_or(outcome.is_err(), Ordering::Relaxed);
            // The first error is returned; episodes that other jobs finished meanwhile are kept.
            if result.is_ok() {
                result = outcome;
            }
        }
        result
    })
}

/// One thread's environment and driver, kept while town and agent stay.
#[derive(Default)]
pub struct Worker {
    current: Option<(String, DriverSpec, Env, Driver)>,
}

impl Worker {
    /// Drives one episode of `evaluation` in its town `assets`; once more if SUMO dies.
    ///
    /// # Errors
    /// The environment, the task or the agent cannot be opened.
    pub fn drive(
        &mut self,
        evaluation: &Evaluation<'_>,
        case: &Case,
        assets: &Arc<Assets>,
    ) -> Result<Driven, EvalError> {
        let fits = |(town, agent, ..): &(String, DriverSpec, Env, Driver)| {
            (town, agent) == (&case.town, &case.agent)
        };
        if !self.current.as_ref().is_some_and(fits) {
            // The old environment's SUMO ends before the new one starts.
            self.current = None;
            let (env, driver) = make(assets, &evaluation.options, &case.agent, evaluation.make_agent)?;
            self.current = Some((case.town.clone(), case.agent.clone(), env, driver));
        }
        let Some((_, _, env, driver)) = &mut self.current else { return Err(EnvError::NoEpisode.into()) };
        let keeps = evaluation.keep != Keep::None;
        let (mut record, mut recorder) = drive(env, driver, case, keeps)?;
        if record.fault == Some(Fault::Simulator) {
            let cause = &record.ending.cause;
            tracing::warn!("`{}` episode {} is driven again: {cause}", case.task, case.episode);
            (record, recorder) = drive(env, driver, case, keeps)?;
        }
        let wanted = evaluation.keep == Keep::All || !record.ending.success;
        let mut recording = None;
        if let Some(recorder) = recorder.filter(|_| wanted) {
            record.recording = Some(RecordingFolder::of(case));
            let kept = Kept {
                build: evaluation.build.to_string(),
                net: env.assets().net_hash().to_string(),
                options: env.options().clone(),
                episode: record.clone(),
            };
            recording = Some(kept.pack(&recorder)?);
        }
        Ok(Driven { record, recording })
    }
}

/// An environment, and the driver for it.
pub(super) fn make(
    assets: &Arc<Assets>,
    options: &EnvOptions,
    spec: &DriverSpec,
    make_agent: &MakeAgent<'_>,
) -> Result<(Env, Driver), EvalError> {
    let mut options = options.clone();
    let mut encoder: Box<dyn Encoder> = Box::new(PooledEncoder);
    if *spec == DriverSpec::Manual {
        return Err(DriverError::Manual.into());
    }
    let driver = match Driver::blind(spec) {
        Some(driver) => driver,
        None => {
            let made = make_agent(spec)?;
            encoder = made.encoder;
            options.observation = made.agent.observes();
            Driver::Agent(made.agent)
        }
    };
    if !spec.looks() {
        options.observation = ObservationMode::Blind;
    }
    Ok((Env::new(Arc::clone(assets), options, encoder)?, driver))
}

/// Drives one episode, and records it if it may be kept.
fn drive(
    env: &mut Env,
    driver: &mut Driver,
    case: &Case,
    keeps: bool,
) -> Result<(EpisodeRecord, Option<Recorder>), EvalError> {
    let seed = case.episode_seed();
    env.reset(&case.spec, seed)?;
    driver.reset(seed);
    let mut recorder = keeps.then(|| Recorder::new(&kept::header(env, case)));
    record(recorder.as_mut(), env, 0, Control::default(), &[]);
    let mut tally = Tally::at(env.ego().map(|ego| ego.state().pose.xy()));
    let tick_s = env.tick().as_secs_f64();
    let (mut ticks, mut route_length, mut driven) =
        (0, env.ego().map_or(0.0, |ego| ego.route().length()), 0.0);
    let (ending, fault) = loop {
        let act = match driver.act(env.eyes()) {
            Ok(act) => act,
            Err(error) => {
                let ending = Ending { end: End::Error, cause: error.to_string(), success: false };
                break (ending, Some(Fault::Agent));
            }
        };
        let step = env.act(act)?;
        let control = step.control;
        let lost = step.info.ending.as_ref().is_some_and(|ending| ending.end == End::Error);
        if !lost {
            tally.add(&step, env.ego(), control.steer);
            record(recorder.as_mut(), env, step.info.tick, control, &step.info.events);
        }
        (ticks, route_length, driven) = (step.info.tick, step.info.route_length, step.info.driven);
        if let Some(ending) = step.info.ending {
            break (ending, lost.then_some(Fault::Simulator));
        }
    };
    let n = ticks.max(1) as f64;
    let Some(placement) = env.placement().cloned() else { return Err(EnvError::NoEpisode.into()) };
    let record = EpisodeRecord {
        case: case.clone(),
        episode_seed: seed,
        placement,
        ending,
        fault,
        ticks,
        tick_s,
        route_length_m: route_length,
        driven_m: driven,
        distance_m: tally.distance,
        mean_speed_mps: tally.speed / n,
        top_speed_mps: tally.top_speed,
        rms_acceleration: (tally.acceleration / n).sqrt(),
        rms_steer_change: (tally.steer_change / n).sqrt(),
        episodic_return: tally.terms.total(),
        terms: tally.terms,
        vehicles_mean: tally.vehicles / n,
        pedestrians_mean: tally.pedestrians / n,
        events: tally.events,
        speeds: tally.speeds,
        gaps: tally.gaps,
        end_at: tally.last.map_or([0.0; 2], |at| [at.x, at.y]),
        recording: None,
    };
    Ok((record, recorder))
}

/// Adds the current state of `env`.
fn record(
    recorder: Option<&mut Recorder>,
    env: &Env,
    tick: u64,
    control: Control,
    events: &[wad_sim::criteria::Event],
) {
    if let Some(recorder) = recorder {
        kept::with_moment(env, tick, control, events, |moment: &Moment<'_>| recorder.add(moment));
    }
}
