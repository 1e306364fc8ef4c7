//! A whole evaluation: from a suite and a selection to a folder of results and their table.

use super::{
    Case, EpisodeRecord, EvalError, Evaluation, Fault, Manifest, Selection, Shard, Store, Suite, Summary,
    in_order, run,
};
use crate::env::Assets;
use std::collections::BTreeMap;
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

/// Drives what `order` says, and keeps the results in its folder. `watch` hears of every episode, first of none.
///
/// # Errors
/// A part of it cannot be opened, driven or stored. Finished episodes stay in the folder.
pub fn evaluate(order: Order<'_>, mut watch: impl FnMut(Progress<'_>)) -> Result<Outcome, EvalError> {
    let Order { suite, selection, shard, out, resume, evaluation } = order;
    let (plan, towns) = plan(&suite, &selection)?;
    let mine = plan.iter().enumerate().filter(|(i, _)| shard.is_none_or(|s| s.has(*i)));
    let mine: Vec<_> = mine.map(|(_, case)| case.clone()).collect();
    let looking = selection.agents.iter().filter(|agent| agent.looks());
    let agents = looking.map(|agent| Ok((agent.to_string(), (evaluation.make_agent)(agent)?.id)));
    let agents = agents.collect::<Result<_, EvalError>>()?;
    let hashes = |hash: fn(&Assets) -> &str| -> BTreeMap<String, String> {
        towns.iter().map(|(town, assets)| (town.clone(), hash(assets).to_string())).collect()
    };
    let (major, minor, patch) = SumoInstall::find()?.version()?;
    let manifest = Manifest {
        build: evaluation.build.to_string(),
        sumo: format!("{major}.{minor}.{patch}"),
        suite: suite.clone(),
        selection,
        options: evaluation.options.clone(),
        agents,
        nets: hashes(Assets::net_hash),
        towns: hashes(Assets::files_hash),
        detector: wad_see::perception::weights_hash(&evaluation.options.detector),
        shard,
    };
    let (mut store, mut episodes) =
        match out.as_ref().map(|out| Store::open(out, &manifest, resume)).transpose()? {
            Some((store, episodes)) => (Some(store), episodes),
            None => (None, Vec::new()),
        };
    // Episodes in which SUMO died do not count for the agent, and are driven again.
    episodes.retain(|episode| episode.fault != Some(Fault::Simulator));
    let left: Vec<_> = (mine.iter().zip(in_order(&mine, &episodes)))
        .filter(|(_, done)| done.is_none())
        .map(|(case, _)| case.clone())
        .collect();
    let planned = mine.len() as u64;
    let before = (mine.len() - left.len()) as u64;
    watch(Progress { planned, done: before, record: None });
    let began = Instant::now();
    let mut driven = 0;
    run(&left, &towns, &evaluation, |record| {
        driven += 1;
        if let Some(store) = &mut store {
            store.add(&record)?;
        }
        watch(Progress { planned, done: before + driven, record: Some(&record) });
        episodes.push(record);
        Ok(())
    })?;
    let wall_seconds = began.elapsed().as_secs_f64();
    let done: Vec<EpisodeRecord> = in_order(&mine, &episodes).into_iter().flatten().cloned().collect();
    let interrupted = evaluation.stop.load(Ordering::Relaxed) && done.len() < mine.len();
    let summary = Summary::of(&suite.name, mine.len(), &done);
    if let Some(store) = store {
        store.finish(&summary)?;
    }
    Ok(Outcome { summary, driven, wall_seconds, interrupted })
}
