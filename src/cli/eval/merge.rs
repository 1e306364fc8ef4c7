//! `eval merge`: the results of several shards as one.

use super::suites::{Summary, report, with_exit};
use crate::cli::Exit;
use anyhow::Context;
use clap::ValueHint;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use wad_cosim::env::Assets;
use wad_cosim::eval::{self, EpisodeRecord, Manifest, Results, Store, StoreError};

/// Options of `eval merge`.
#[derive(clap::Args, Debug)]
pub struct Args {
    /// Folders of the same evaluation, each driven with another --shard.
    #[arg(required = true, value_hint = ValueHint::DirPath)]
    runs: Vec<PathBuf>,
    /// Folder for all of them together.
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
        if results.broken > 0 {
            eprintln!(
                "{}: {} half-written line(s) left out; `eval --resume` there drives those episodes again",
                path.display(),
                results.broken
            );
        }
        let manifest = first.get_or_insert_with(|| Manifest { shard: None, ..results.manifest.clone() });
        let differences = manifest.differences(&results.manifest, false);
        if !differences.is_empty() {
            return Err(store_error(StoreError::Mixed { path: path.clone(), differences }));
        }
        runs.push(results);
    }
    let Some(manifest) = first else { return Ok(Exit::Done) };
    let (suite, selection) = (&manifest.suite, &manifest.selection);
    let mut towns = BTreeMap::new();
    for town in selection.towns(suite).map_err(|e| Exit::Input.because(e))? {
        towns.insert(town.clone(), Assets::load(&town).map_err(|e| with_exit(e.into()))?);
    }
    let plan = selection.routes(suite, &towns).and_then(|routes| selection.plan(suite, &routes));
    let plan = plan.map_err(|e| Exit::Input.because(e))?;
    let (mut store, _) = Store::open(&args.out, &manifest, false).map_err(store_error)?;
    for run in &runs {
        for recording in run.episodes.iter().filter_map(|episode| episode.recording.as_ref()) {
            copy_folder(&run.path.join(recording), &args.out.join(recording))
                .with_context(|| format!("cannot copy {recording} of {}", run.path.display()))?;
        }
    }
    let all: Vec<EpisodeRecord> = runs.into_iter().flat_map(|run| run.episodes).collect();
    let done: Vec<EpisodeRecord> = eval::in_order(&plan, &all).into_iter().flatten().cloned().collect();
    for episode in &done {
        store.add(episode).map_err(store_error)?;
    }
    let summary = Summary::of(&suite.name, plan.len(), &done);
    store.finish(&summary).map_err(store_error)?;
    report(&summary, args.json.then(|| serde_json::to_string(&summary)).transpose()?)?;
    Ok(Exit::Done)
}

fn copy_folder(from: &Path, to: &Path) -> std::io::Result<()> {
    std::fs::create_dir_all(to)?;
    for entry in std::fs::read_dir(from)? {
        let entry = entry?;
        std::fs::copy(entry.path(), to.join(entry.file_name()))?;
    }
    Ok(())
}
