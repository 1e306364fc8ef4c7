//! Drives the episodes of a plan, several at a time.

use super::{Case, Driver, DriverError, DriverSpec, EpisodeRecord};
use crate::agent::Agent;
use crate::env::{Assets, End, Env, EnvError, EnvOptions, ObservationMode, Step};
use crate::latent::{Encoder, PooledEncoder};
use crate::reward::RewardTerms;
use crate::seeds;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, mpsc};

/// Why an evaluation stopped.
#[derive(Debug, thiserror::Error)]
pub enum EvalError {
    #[error(transparent)]
    Env(#[from] EnvError),
    #[error(transparent)]
    Driver(#[from] DriverError),
    #[error("cannot write {path}: {source}")]
    Write { path: String, source: std::io::Error },
}

/// Makes an agent by name with the encoder that it belongs to; called on the thread that drives.
pub type MakeAgent<'a> = dyn Fn(&str) -> Result<(Box<dyn Agent>, Box<dyn Encoder>), DriverError> + Sync + 'a;

/// How to drive a plan.
pub struct Evaluation<'a> {
    pub options: EnvOptions,
    /// Environments at a time.
    pub jobs: usize,
    pub make_agent: &'a MakeAgent<'a>,
    /// Set from outside to stop after the episodes under way.
    pub stop: &'a AtomicBool,
}

/// Drives the episodes of `plan`. `done` gets each one's record in the plan's order, as soon as those
/// before it are there too. Returns the records; fewer than the plan has when it was stopped.
///
/// # Errors
/// A town, a task or an agent cannot be had, or `done` fails. What is done already stays with `done`.
pub fn run(
    plan: &[Case],
    evaluation: &Evaluation<'_>,
    mut done: impl FnMut(&EpisodeRecord) -> Result<(), EvalError>,
) -> Result<Vec<EpisodeRecord>, EvalError> {
    let mut towns: BTreeMap<&str, Arc<Assets>> = BTreeMap::new();
    for case in plan {
        if !towns.contains_key(case.town.as_str()) {
            towns.insert(&case.town, Assets::load(&case.town)?);
        }
    }
    let next = AtomicUsize::new(0);
    let failed = AtomicBool::new(false);
    let (sender, receiver) = mpsc::channel();
    let mut records = Vec::with_capacity(plan.len());
    std::thread::scope(|scope| {
        for _ in 0..evaluation.jobs.clamp(1, plan.len().max(1)) {
            let sender = sender.clone();
            let (towns, next, failed) = (&towns, &next, &failed);
            scope.spawn(move || {
                let mut worker = Worker { evaluation, towns, current: None };
                loop {
                    let index = next.fetch_add(1, Ordering::Relaxed);
                    let stopped = evaluation.stop.load(Ordering::Relaxed) || failed.load(Ordering::Relaxed);
                    let Some(case) = plan.get(index).filter(|_| !stopped) else { break };
                    let record = worker.drive(case);
                    failed.fetch_or(record.is_err(), Ordering::Relaxed);
                    if sender.send((index, record)).is_err() {
                        break;
                    }
                }
            });
        }
        drop(sender);
        let mut early: BTreeMap<usize, EpisodeRecord> = BTreeMap::new();
        let mut result = Ok(());
        for (index, record) in receiver {
            match record {
                Ok(record) => {
                    early.insert(index, record);
                }
                Err(error) if result.is_ok() => result = Err(error),
                Err(_) => {}
            }
            while let (Ok(()), Some(record)) = (&result, early.remove(&records.len())) {
                result = done(&record);
                failed.fetch_or(result.is_err(), Ordering::Relaxed);
                records.push(record);
            }
        }
        result
    })?;
    Ok(records)
}

/// One thread's environment and driver, kept while town and agent stay.
struct Worker<'a> {
    evaluation: &'a Evaluation<'a>,
    towns: &'a BTreeMap<&'a str, Arc<Assets>>,
    current: Option<(String, DriverSpec, Env, Driver)>,
}

impl Worker<'_> {
    fn drive(&mut self, case: &Case) -> Result<EpisodeRecord, EvalError> {
        let fits = |(town, agent, ..): &(String, DriverSpec, Env, Driver)| {
            (town, agent) == (&case.town, &case.agent)
        };
        if !self.current.as_ref().is_some_and(fits) {
            // The old environment's SUMO goes before the new one's comes.
            self.current = None;
            let (env, driver) = self.make(case)?;
            self.current = Some((case.town.clone(), case.agent.clone(), env, driver));
        }
        let Some((_, _, env, driver)) = &mut self.current else { return Err(EnvError::NoEpisode.into()) };
        let record = drive(env, driver, case)?;
        if record.ending.end != End::Error {
            return Ok(record);
        }
        tracing::warn!(
            "`{}` episode {} is driven again: {}",
            case.task.kind,
            case.episode,
            record.ending.cause
        );
        drive(env, driver, case)
    }

    fn make(&self, case: &Case) -> Result<(Env, Driver), EvalError> {
        let Some(assets) = self.towns.get(case.town.as_str()) else { return Err(EnvError::NoEpisode.into()) };
        let mut options = self.evaluation.options.clone();
        let mut encoder: Box<dyn Encoder> = Box::new(PooledEncoder);
        let driver = match &case.agent {
            DriverSpec::Autopilot => Driver::Autopilot,
            DriverSpec::Random => Driver::Random(Box::new(seeds::rng(0, "driver"))),
            DriverSpec::Constant(control) => Driver::Constant(*control),
            DriverSpec::Agent(name) => {
                let (agent, its) = (self.evaluation.make_agent)(name)?;
                encoder = its;
                Driver::Agent(agent)
            }
        };
        if !case.agent.looks() {
            options.observation = ObservationMode::Blind;
        }
        Ok((Env::new(Arc::clone(assets), options, encoder)?, driver))
    }
}

/// One episode.
fn drive(env: &mut Env, driver: &mut Driver, case: &Case) -> Result<EpisodeRecord, EvalError> {
    let seed = case.episode_seed();
    let mut observation = env.reset(&case.task, seed)?;
    driver.reset(seed);
    let mut sums = Sums::default();
    loop {
        let control = driver.act(env, &observation)?;
        let step = env.step(control)?;
        sums.add(&step, control.steer);
        if let (Some(ending), Some(placement)) = (&step.info.ending, env.placement()) {
            let n = step.info.tick.max(1) as f64;
            return Ok(EpisodeRecord {
                case: case.clone(),
                episode_seed: seed,
                placement: placement.clone(),
                ending: ending.clone(),
                ticks: step.info.tick,
                route_length_m: step.info.route_length,
                driven_m: step.info.driven,
                mean_speed_mps: sums.speed / n,
                rms_acceleration: (sums.acceleration / n).sqrt(),
                rms_steer_change: (sums.steer_change / n).sqrt(),
                episodic_return: sums.terms.total(),
                terms: sums.terms,
                vehicles_mean: sums.vehicles / n,
                pedestrians_mean: sums.pedestrians / n,
            });
        }
        observation = step.observation;
    }
}

#[derive(Default)]
struct Sums {
    speed: f64,
    acceleration: f64,
    steer: f64,
    steer_change: f64,
    terms: RewardTerms,
    vehicles: f64,
    pedestrians: f64,
}

impl Sums {
    fn add(&mut self, step: &Step, steer: f64) {
        let ego = &step.info.ego;
        self.speed += ego.speed.max(0.0);
        self.acceleration += ego.acceleration.powi(2);
        self.steer_change += (steer - self.steer).powi(2);
        self.steer = steer;
        self.terms.add(&step.info.reward);
        self.vehicles += step.info.traffic.0 as f64;
        self.pedestrians += step.info.traffic.1 as f64;
    }
}
