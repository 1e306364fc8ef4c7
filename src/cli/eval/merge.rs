//! `eval merge`: joins the results of several shards.

use super::suites::{report, with_exit};
use crate::cli::Exit;
use clap::ValueHint;
use std::path::{Path, PathBuf};
use wad_cosim::eval::{self, EpisodeRecord, Manifest, Results, Store, StoreError, Summary};

/// Options of `eval merge`.
#[derive(clap::Args, Debug)]
#[command(after_help = "Example:\n  wad-cosim eval merge runs/a runs/b --out runs/all")]
pub struct Args {
    /// Folders of one evaluation, each driven with its own --shard.
    #[arg(required = true, value_hint = ValueHint::DirPath)]
    runs: Vec<PathBuf>,
    /// Folder for the joined results.
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath)]
    out: PathBuf,
    /// Print one JSON object as the last line of stdout; everything else goes to stderr.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(args: &Args) -> anyhow::Result<Exit> {
    let store_error = |e: StoreError| with_exit(e.into());
    let mut runs: Vec<Results> = Vec::new();
    let mut first: Option<Manifest> = None;
    for path in &args.runs {
        let results = Results::open(path).map_err(store_error)?;
        // An episode that one shard lacks may be in another, so this is not reported.
        results.unread().iter().for_each(crate::cli::note);
        let manifest = first.get_or_insert_with(|| Manifest { shard: None, ..results.manifest.clone() });
        let differences = manifest.differences(&results.manifest, false);
        if !differences.is_empty() {
            return Err(store_error(StoreError::Mixed { path: path.clone(), differences }));
        }
        runs.push(results);
    }
    let Some(manifest) = first else { return Ok(Exit::Done) };
    let (suite, selection) = (&manifest.suite, &manifest.selection);
    let (plan, _) = eval::plan(suite, selection).map_err(with_exit)?;
    let found: Vec<_> = runs.iter().map(|run| eval::in_order(&plan, &run.episodes)).collect();
    // If two runs have the same episode, the last run's counts.
    let last = |index: usize| {
        let mut latest = runs.iter().zip(&found).rev();
        latest.find_map(|(run, found)| Some((run.path.as_path(), found[index]?)))
    };
    let merged: Vec<(&Path, &EpisodeRecord)> = (0..plan.len()).filter_map(last).collect();
    let done: Vec<EpisodeRecord> = merged.iter().map(|(_, episode)| (*episode).clone()).collect();
    let summary = Summary::of(&suite.name, plan.len(), &done);
    Store::merge(&args.out, &manifest, &merged, &summary).map_err(store_error)?;
    report(&summary, args.json.then(|| serde_json::to_string(&summary)).transpose()?)?;
    Ok(Exit::Done)
}
