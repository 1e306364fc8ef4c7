//! Drives the episodes of a plan: several SUMOs at a time, one or several egos in each.

use super::kept::{self, Kept, Packed};
use super::record::Fault;
use super::tally::Tally;
use super::{Case, Driver, DriverError, DriverSpec, EpisodeRecord, Made, RecordingFolder};
use crate::env::{Assets, End, Ending, EnvError, EnvOptions, Fleet, FleetStep, Info, ObservationMode};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::str::FromStr;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, mpsc};
use wad_see::latent::{Encoder, PooledEncoder};
use wad_see::perception::{Perception, PerceptionError};
use wad_sim::assets::AssetsError;
use wad_sim::bridge::Ego;
use wad_sim::replay::{Moment, Recorder};
use wad_sim::session::Act;
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
    /// There is no such detector.
    #[error(transparent)]
    Detector(#[from] PerceptionError),
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
    /// SUMOs in parallel.
    pub jobs: usize,
    /// Egos in each, which drive episodes of the same task, town and traffic and see each other.
    pub egos: usize,
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

/// Drives the groups of `plan` in `towns`, each in one SUMO. `done` gets the episodes of each when it ends, in any order.
///
/// # Errors
/// A town, a task or an agent cannot be opened, or `done` fails. Finished episodes stay with `done`.
pub fn run(
    plan: &[Vec<Case>],
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
                    let Some(group) = plan.get(index).filter(|_| !stopped) else { break };
                    let town = group.first().and_then(|case| towns.get(&case.town));
                    let town = town.ok_or_else(|| EnvError::NoEpisode.into());
                    let driven = town.and_then(|town| worker.drive(evaluation, group, town));
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
            let outcome = driven.and_then(|driven| driven.into_iter().try_for_each(&mut done));
            failed.fetch_or(outcome.is_err(), Ordering::Relaxed);
            // The first error is returned; episodes that other jobs finished meanwhile are kept.
            if result.is_ok() {
                result = outcome;
            }
        }
        result
    })
}

/// One thread's fleet and its drivers, kept while town, agent and number of egos stay.
#[derive(Default)]
pub struct Worker {
    current: Option<(String, DriverSpec, Fleet, Vec<Driver>)>,
}

impl Worker {
    /// Drives a group's episodes in their town `assets`, all in one SUMO as far as there is room for them; once more if SUMO dies.
    ///
    /// # Errors
    /// The environment, the task or the agent cannot be opened.
    pub fn drive(
        &mut self,
        evaluation: &Evaluation<'_>,
        group: &[Case],
        assets: &Arc<Assets>,
    ) -> Result<Vec<Driven>, EvalError> {
        match self.drive_together(evaluation, group, assets) {
            Err(EvalError::Env(EnvError::Full { fit, .. })) if (1..group.len()).contains(&fit) => {
                let (these, others) = group.split_at(fit);
                tracing::debug!(
                    "`{}`: {} egos have no room beside {fit} others",
                    these[0].task,
                    others.len()
                );
                let mut driven = self.drive(evaluation, these, assets)?;
                driven.extend(self.drive(evaluation, others, assets)?);
                Ok(driven)
            }
            driven => driven,
        }
    }

    fn drive_together(
        &mut self,
        evaluation: &Evaluation<'_>,
        group: &[Case],
        assets: &Arc<Assets>,
    ) -> Result<Vec<Driven>, EvalError> {
        let Some(first) = group.first() else { return Ok(Vec::new()) };
        let fits = |(town, agent, fleet, _): &(String, DriverSpec, Fleet, Vec<Driver>)| {
            (town, agent, fleet.egos()) == (&first.town, &first.agent, group.len())
        };
        if !self.current.as_ref().is_some_and(fits) {
            // The old SUMO ends before the new one starts.
            self.current = None;
            let (options, make_agent) = (&evaluation.options, evaluation.make_agent);
            let (fleet, drivers) = make(assets, options, &first.agent, group.len(), make_agent)?;
            self.current = Some((first.town.clone(), first.agent.clone(), fleet, drivers));
        }
        let Some((_, _, fleet, drivers)) = &mut self.current else { return Err(EnvError::NoEpisode.into()) };
        let keeps = evaluation.keep != Keep::None;
        let mut runs = drive(fleet, drivers, group, keeps)?;
        let lost = runs.iter().find(|(record, _)| record.fault == Some(Fault::Simulator));
        if let Some((record, _)) = lost {
            let (case, cause) = (&record.case, &record.ending.cause);
            tracing::warn!("`{}` episode {} is driven again: {cause}", case.task, case.episode);
            runs = drive(fleet, drivers, group, keeps)?;
        }
        let together = if group.len() > 1 { group.to_vec() } else { Vec::new() };
        let pack = |(mut record, recorder): (EpisodeRecord, Option<Recorder>)| {
            let wanted = evaluation.keep == Keep::All || !record.ending.success;
            let mut recording = None;
            if let Some(recorder) = recorder.filter(|_| wanted) {
                record.recording = Some(RecordingFolder::of(&record.case));
                let kept = Kept {
                    build: evaluation.build.to_string(),
                    net: fleet.assets().net_hash().to_string(),
                    options: fleet.options().clone(),
                    group: together.clone(),
                    episode: record.clone(),
                };
                recording = Some(kept.pack(&recorder)?);
            }
            Ok(Driven { record, recording })
        };
        runs.into_iter().map(pack).collect()
    }
}

/// A fleet of egos that do not return, and their drivers.
pub(super) fn make(
    assets: &Arc<Assets>,
    options: &EnvOptions,
    spec: &DriverSpec,
    egos: usize,
    make_agent: &MakeAgent<'_>,
) -> Result<(Fleet, Vec<Driver>), EvalError> {
    let mut options = options.clone();
    if *spec == DriverSpec::Manual {
        return Err(DriverError::Manual.into());
    }
    let (mut encoders, mut drivers) = (Vec::with_capacity(egos), Vec::with_capacity(egos));
    for _ in 0..egos {
        let mut encoder: Box<dyn Encoder> = Box::new(PooledEncoder);
        drivers.push(match Driver::blind(spec) {
            Some(driver) => driver,
            None => {
                let made = make_agent(spec)?;
                encoder = made.encoder;
                options.observation = made.agent.observes();
                Driver::Agent(made.agent)
            }
        });
        encoders.push(encoder);
    }
    if !spec.looks() {
        options.observation = ObservationMode::Blind;
    }
    let mut fleet = Fleet::new(Arc::clone(assets), options, encoders)?;
    fleet.set_returning(false);
    Ok((fleet, drivers))
}

/// An episode that is being driven.
struct Run {
    recorder: Option<Recorder>,
    tally: Tally,
    ticks: u64,
    route_length: f64,
    driven: f64,
    /// How it ended, and by which fault.
    ended: Option<(Ending, Option<Fault>)>,
}

impl Run {
    /// At its begin, recorded if it may be kept.
    fn begin(fleet: &Fleet, ego: usize, case: &Case, keeps: bool) -> Self {
        let recorder = keeps
            .then(|| Recorder::new(&kept::header(fleet, ego, case), Arc::clone(fleet.assets().network())));
        let ego = fleet.ego(ego);
        let mut run = Self {
            recorder,
            tally: Tally::at(ego.map(|ego| ego.state().pose.xy())),
            ticks: 0,
            route_length: ego.map_or(0.0, |ego| ego.route().length()),
            driven: 0.0,
            ended: None,
        };
        run.record(ego, Control::default(), &[]);
        run
    }

    /// Adds a tick.
    fn add(&mut self, ego: Option<&Ego>, control: Control, info: &Info) {
        (self.ticks, self.route_length, self.driven) = (info.tick, info.route_length, info.driven);
        let lost = info.ending.as_ref().is_some_and(|ending| ending.end == End::Error);
        if !lost {
            self.tally.add(info, ego, control.steer);
            self.record(ego, control, &info.events);
        }
        if let Some(ending) = &info.ending {
            self.ended = Some((ending.clone(), lost.then_some(Fault::Simulator)));
        }
    }

    /// Adds the ego's current state.
    fn record(&mut self, ego: Option<&Ego>, control: Control, events: &[wad_sim::criteria::Event]) {
        if let Some(recorder) = &mut self.recorder {
            kept::with_moment(ego, self.ticks, control, events, |moment: &Moment<'_>| recorder.add(moment));
        }
    }
}

/// Begins a group's episodes.
pub(super) fn begin(fleet: &mut Fleet, drivers: &mut [Driver], group: &[Case]) -> Result<(), EnvError> {
    let starts: Vec<_> = group.iter().map(|case| (case.spec.clone(), case.episode_seed())).collect();
    fleet.reset_each(&starts)?;
    for (driver, (_, seed)) in drivers.iter_mut().zip(&starts) {
        driver.reset(*seed);
    }
    Ok(())
}

/// Drives a group's episodes; each gives what it did, and its recording if it may be kept.
fn drive(
    fleet: &mut Fleet,
    drivers: &mut [Driver],
    group: &[Case],
    keeps: bool,
) -> Result<Vec<(EpisodeRecord, Option<Recorder>)>, EvalError> {
    begin(fleet, drivers, group)?;
    let mut runs: Vec<Run> =
        group.iter().enumerate().map(|(ego, case)| Run::begin(fleet, ego, case, keeps)).collect();
    let mut acts = vec![Act::Stay; group.len()];
    loop {
        for (ego, run) in runs.iter_mut().enumerate() {
            acts[ego] = Act::Stay;
            if run.ended.is_some() {
                continue;
            }
            match drivers[ego].act(fleet.eyes(ego)) {
                Ok(act) => acts[ego] = act,
                Err(error) => {
                    let ending = Ending { end: End::Error, cause: error.to_string(), success: false };
                    run.ended = Some((ending, Some(Fault::Agent)));
                    fleet.give_up(ego);
                }
            }
        }
        if runs.iter().all(|run| run.ended.is_some()) {
            break;
        }
        fleet.step(&acts)?;
        let FleetStep { controls, infos, .. } = fleet.last();
        for (ego, run) in runs.iter_mut().enumerate().filter(|(_, run)| run.ended.is_none()) {
            run.add(fleet.ego(ego), controls[ego], &infos[ego]);
        }
    }
    let tick_s = fleet.tick().as_secs_f64();
    let record = |(ego, run): (usize, Run)| {
        let Run { recorder, tally, ticks, route_length, driven, ended } = run;
        let (Some(placement), Some((ending, fault))) = (fleet.placement(ego).cloned(), ended) else {
            return Err(EnvError::NoEpisode.into());
        };
        let n = ticks.max(1) as f64;
        let record = EpisodeRecord {
            case: group[ego].clone(),
            episode_seed: group[ego].episode_seed(),
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
            light: fleet.eyes(ego).perception().and_then(Perception::light_counts),
            limit: fleet.eyes(ego).perception().and_then(Perception::limit_counts),
            end_at: tally.last.map_or([0.0; 2], |at| [at.x, at.y]),
            recording: None,
        };
        Ok((record, recorder))
    };
    runs.into_iter().enumerate().map(record).collect()
}
