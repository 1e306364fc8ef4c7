//! A whole evaluation: from a suite and a selection to a folder of results and their table.

use super::plan::groups;
use super::store::key;
use super::{
    Case, Driven, DriverSpec, EpisodeRecord, EvalError, Evaluation, Fault, Manifest, Selection, Shard, Store,
    Suite, Summary, run,
};
use crate::env::Assets;
use std::collections::{BTreeMap, HashMap};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Instant;
use sumo_traci::process::SumoInstall;

/// What to evaluate, and where its results go.
pub struct Order<'a> {
    /// The suite.
    pub suite: Suite,
    /// The part of it.
    pub selection: Selection,
    /// The part of that; None: all of it.
    pub shard: Option<Shard>,
    /// The results' folder.
    pub out: Option<PathBuf>,
    /// Go on with the results in `out`.
    pub resume: bool,
    /// How episodes are driven.
    pub evaluation: Evaluation<'a>,
}

/// Where an evaluation is.
#[derive(Clone, Copy, Debug)]
pub struct Progress<'a> {
    /// Episodes that are to be driven, by this call or before.
    pub planned: u64,
    /// Episodes that are driven.
    pub done: u64,
    /// The one that was driven just now.
    pub record: Option<&'a EpisodeRecord>,
}

/// The end of an evaluation.
#[derive(Debug)]
pub struct Outcome {
    /// The table.
    pub summary: Summary,
    /// Episodes driven by this call.
    pub driven: u64,
    /// Of this call (s).
    pub wall_seconds: f64,
    /// It was stopped before its end.
    pub interrupted: bool,
}

/// Towns by name.
pub type Towns = BTreeMap<String, Arc<Assets>>;

/// The selected episodes, and their towns.
///
/// # Errors
/// A town cannot be read, or the suite has no such part.
pub fn plan(suite: &Suite, selection: &Selection) -> Result<(Vec<Case>, Towns), EvalError> {
    let mut towns = Towns::new();
    for town in selection.towns(suite)? {
        let assets = Assets::load(&town)?;
        towns.insert(town, assets);
    }
    let plan = selection.routes(suite, &towns).and_then(|routes| selection.plan(suite, &routes))?;
    Ok((plan, towns))
}

/// An evaluation's plan and its results, wherever they are driven: what is left, and each episode once.
pub struct Ledger {
    manifest: Manifest,
    plan: Vec<Case>,
    /// How many of these each group has, in the plan's order.
    sizes: Vec<usize>,
    /// Places in the plan, by case.
    places: HashMap<String, usize>,
    /// The results, in the plan's order.
    done: Vec<Option<EpisodeRecord>>,
    store: Option<Store>,
}

impl Ledger {
    /// Opens the folder of `order` and takes its lock; gives the plan's towns too.
    ///
    /// # Errors
    /// A town or an agent cannot be opened, there is no such detector, or the folder holds other results or is in use.
    pub fn open(order: &Order<'_>) -> Result<(Self, Towns), EvalError> {
        let Order { suite, selection, shard, out, resume, evaluation } = order;
        wad_see::perception::check(&evaluation.options.detector)?;
        let (plan, towns) = plan(suite, selection)?;
        let groups = groups(plan, evaluation.egos, *shard);
        let plan = groups.concat();
        let named = Manifest {
            build: String::new(),
            sumo: String::new(),
            suite: suite.clone(),
            selection: selection.clone(),
            options: evaluation.options.clone(),
            egos: evaluation.egos,
            agents: BTreeMap::new(),
            nets: BTreeMap::new(),
            towns: BTreeMap::new(),
            detector: None,
            shard: *shard,
        };
        let manifest = named.here(evaluation, &selection.agents, &towns)?;
        let (store, episodes) =
            match out.as_ref().map(|out| Store::open(out, &manifest, *resume)).transpose()? {
                Some((store, episodes)) => (Some(store), episodes),
                None => (None, Vec::new()),
            };
        let places = plan.iter().enumerate().map(|(place, case)| (key(case), place)).collect();
        let done = vec![None; plan.len()];
        let sizes = groups.iter().map(Vec::len).collect();
        let mut ledger = Self { manifest, plan, sizes, places, done, store };
        // Episodes in which SUMO died do not count for the agent, and are driven again.
        for episode in episodes.into_iter().filter(|episode| episode.fault != Some(Fault::Simulator)) {
            if let Some(&place) = ledger.places.get(&key(&episode.case)) {
                ledger.done[place] = Some(episode);
            }
        }
        Ok((ledger, towns))
    }

    /// What the results are made by.
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// Episodes of the plan.
    pub fn planned(&self) -> u64 {
        self.plan.len() as u64
    }

    /// Episodes with a result.
    pub fn done(&self) -> u64 {
        self.done.iter().flatten().count() as u64
    }

    /// The groups of which an episode has no result, whole, in the plan's order: a group drives in one SUMO.
    pub fn left(&self) -> Vec<Vec<Case>> {
        let mut from = 0;
        let mut left = Vec::new();
        for size in &self.sizes {
            let range = from..from + size;
            from = range.end;
            if self.done[range.clone()].iter().any(Option::is_none) {
                left.push(self.plan[range].to_vec());
            }
        }
        left
    }

    /// Takes an episode: its recording is written, then its line. False: it has a result already, and nothing is written.
    ///
    /// # Errors
    /// It is not in the plan, or cannot be written.
    pub fn add(&mut self, driven: Driven) -> Result<bool, EvalError> {
        let Driven { record, recording } = driven;
        let Some(done) = self.places.get(&key(&record.case)).and_then(|&place| self.done.get_mut(place))
        else {
            return Err(EvalError::Unplanned { name: record.case.name() });
        };
        if done.is_some() {
            return Ok(false);
        }
        if let Some(store) = &mut self.store {
            if let (Some(folder), Some(files)) = (&record.recording, &recording) {
                store.keep(folder, files)?;
            }
            store.add(&record)?;
        }
        *done = Some(record);
        Ok(true)
    }

    /// Writes the table of what is done, in the plan's order.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn finish(self) -> Result<Summary, EvalError> {
        let planned = self.plan.len();
        let done: Vec<EpisodeRecord> = self.done.into_iter().flatten().collect();
        let summary = Summary::of(&self.manifest.suite.name, planned, &done);
        if let Some(store) = self.store {
            store.finish(&summary)?;
        }
        Ok(summary)
    }
}

impl Manifest {
    /// The same evaluation with the build, SUMO, detector, `agents` and `towns` of this machine.
    fn here(
        &self,
        evaluation: &Evaluation<'_>,
        agents: &[DriverSpec],
        towns: &Towns,
    ) -> Result<Self, EvalError> {
        let looking = agents.iter().filter(|agent| agent.looks());
        let ids = looking.map(|agent| Ok((agent.to_string(), (evaluation.make_agent)(agent)?.id)));
        let hashes = |hash: fn(&Assets) -> &str| -> BTreeMap<String, String> {
            towns.iter().map(|(town, assets)| (town.clone(), hash(assets).to_string())).collect()
        };
        let (major, minor, patch) = SumoInstall::find()?.version()?;
        Ok(Self {
            build: evaluation.build.to_string(),
            sumo: format!("{major}.{minor}.{patch}"),
            agents: ids.collect::<Result<_, EvalError>>()?,
            nets: hashes(Assets::net_hash),
            towns: hashes(Assets::files_hash),
            detector: wad_see::perception::weights_hash(&self.options.detector),
            ..self.clone()
        })
    }

    /// Checks that this machine drives `agent` in the town `name` as the machine did that wrote this manifest.
    ///
    /// # Errors
    /// Build, SUMO, detector, agent or town differ.
    pub fn require_here(
        &self,
        evaluation: &Evaluation<'_>,
        agent: &DriverSpec,
        name: &str,
        assets: &Arc<Assets>,
    ) -> Result<(), EvalError> {
        let towns = Towns::from([(name.to_string(), Arc::clone(assets))]);
        let here = self.here(evaluation, std::slice::from_ref(agent), &towns)?;
        let mut there = self.clone();
        there.agents.retain(|agent, _| here.agents.contains_key(agent));
        there.nets.retain(|town, _| town == name);
        there.towns.retain(|town, _| town == name);
        let differences = there.differences(&here, true);
        if differences.is_empty() { Ok(()) } else { Err(EvalError::Elsewhere { differences }) }
    }
}

/// Drives what `order` says, and keeps the results in its folder. `watch` hears of every episode, first of none.
///
/// # Errors
/// A part of it cannot be opened, driven or stored. Finished episodes stay in the folder.
pub fn evaluate(order: Order<'_>, mut watch: impl FnMut(Progress<'_>)) -> Result<Outcome, EvalError> {
    let (mut ledger, towns) = Ledger::open(&order)?;
    let (planned, before) = (ledger.planned(), ledger.done());
    watch(Progress { planned, done: before, record: None });
    let began = Instant::now();
    let mut driven = 0;
    run(&ledger.left(), &towns, &order.evaluation, |episode| {
        let record = episode.record.clone();
        // One of a group may be done already.
        driven += u64::from(ledger.add(episode)?);
        watch(Progress { planned, done: before + driven, record: Some(&record) });
        Ok(())
    })?;
    let wall_seconds = began.elapsed().as_secs_f64();
    let interrupted = order.evaluation.stop.load(Ordering::Relaxed) && ledger.done() < planned;
    Ok(Outcome { summary: ledger.finish()?, driven, wall_seconds, interrupted })
}
