//! `eval routes`: fixed routes for a net; the autopilot finishes each in the empty town.

use super::suites::with_exit;
use crate::cli::progress::Bar;
use crate::cli::{Exit, answer};
use clap::ValueHint;
use std::collections::BTreeMap;
use std::io::ErrorKind;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use wad_cosim::env::{Assets, EnvError};
use wad_cosim::eval::routes::{self, RouteError, Routes, Search};
use wad_cosim::tasks::TaskKind;

/// Options of `eval routes`.
#[derive(clap::Args, Debug)]
#[command(after_help = "Example:\n  wad-cosim eval routes my.net.xml --set navigation --jobs 2")]
pub struct Args {
    /// A .sumocfg, a .net.xml(.gz), a folder with one .sumocfg, or a bundled town.
    #[arg(value_hint = ValueHint::FilePath)]
    config: String,
    /// Only routes for this kind of task; may be given several times. The file's other sets stay.
    #[arg(long = "set", value_name = "KIND")]
    sets: Vec<TaskKind>,
    /// Routes per set.
    #[arg(long, value_name = "N", default_value_t = 25)]
    count: usize,
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// Sets in parallel; each takes a core.
    #[arg(long, value_name = "N", default_value_t = 1)]
    jobs: usize,
    /// File to write [default: NAME.routes.json beside the net; `eval` finds it there].
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    out: Option<PathBuf>,
    /// Print one JSON object as the last line of stdout; everything else goes to stderr.
    #[arg(long)]
    json: bool,
}

enum News {
    /// One was driven: did it hold?
    Tried(bool),
    Set(TaskKind, Result<Search, EnvError>),
}

/// Runs the command.
pub fn run(args: &Args) -> anyhow::Result<Exit> {
    let assets = Assets::load(&args.config).map_err(|e| with_exit(e.into()))?;
    let out = args.out.clone().unwrap_or_else(|| Routes::beside(&assets));
    let none_yet = || Routes {
        town: assets.name().to_string(),
        net: assets.net_hash().to_string(),
        sets: BTreeMap::new(),
        missing: BTreeMap::new(),
    };
    let mut routes = match Routes::find(&args.config, &assets, Some(&out)) {
        Ok((routes, _)) => routes,
        Err(RouteError::File { source, .. }) if source.kind() == ErrorKind::NotFound => none_yet(),
        Err(RouteError::OtherNet { .. }) => none_yet(),
        Err(error) => return Err(Exit::Input.because(error)),
    };
    let kinds = if args.sets.is_empty() { Routes::SETS.to_vec() } else { args.sets.clone() };
    let bar = Bar::new((kinds.len() * args.count) as u64, "routes");
    let (interrupt, failed) = (crate::cli::interrupt()?.flag(), AtomicBool::new(false));
    let stopped = || interrupt.load(Ordering::Relaxed) || failed.load(Ordering::Relaxed);
    let (sender, receiver) = mpsc::channel();
    let next = std::sync::Mutex::new(kinds.iter().copied());
    let mut made = 0;
    let result = std::thread::scope(|scope| {
        for _ in 0..args.jobs.clamp(1, kinds.len().max(1)) {
            let (sender, next, assets, stopped) = (sender.clone(), &next, &assets, &stopped);
            scope.spawn(move || {
                while !stopped() {
                    let Ok(Some(kind)) = next.lock().map(|mut kinds| kinds.next()) else { break };
                    // The receiver stays until the last sender has gone.
                    let search = routes::find(assets, kind, args.count, args.seed, stopped, |_, holds| {
                        let _ = sender.send(News::Tried(holds));
                    });
                    let _ = sender.send(News::Set(kind, search));
                }
            });
        }
        drop(sender);
        let mut result = Ok(());
        let (mut found, mut tried) = (0, 0);
        for news in receiver {
            match news {
                News::Tried(holds) => {
                    tried += 1;
                    found += u64::from(holds);
                    bar.show(found, &format!("of {tried} tried"));
                }
                News::Set(kind, search) => {
                    let kept = search.map_err(|e| with_exit(e.into())).and_then(|search| {
                        let set = kind.name().to_string();
                        match search {
                            Search::Found(found) => {
                                bar.say(&format!("{kind}: {} routes", found.len()));
                                routes.missing.remove(&set);
                                routes.sets.insert(set, found);
                            }
                            Search::None(why) => {
                                bar.say(&format!("{kind}: none: {why}"));
                                routes.sets.remove(&set);
                                routes.missing.insert(set, why);
                            }
                            Search::Stopped => return Ok(()),
                        }
                        made += 1;
                        // At once, so that nothing that comes later loses it.
                        routes.save(&out).map_err(|e| Exit::Other.because(e))
                    });
                    failed.fetch_or(kept.is_err(), Ordering::Relaxed);
                    // The first error is returned; sets that other jobs finish meanwhile are kept.
                    if result.is_ok() {
                        result = kept;
                    }
                }
            }
        }
        result
    });
    bar.clear();
    result?;
    let interrupted = made < kinds.len();
    if interrupted {
        crate::cli::note(format_args!("interrupted: {made} of {} sets were made", kinds.len()));
    }
    let counts: BTreeMap<&String, usize> =
        routes.sets.iter().map(|(set, routes)| (set, routes.len())).collect();
    let value = serde_json::json!({
        "out": out,
        "routes": counts,
        "missing": routes.missing,
        "interrupted": interrupted,
    });
    answer(&format!("{}\n", out.display()), args.json, &value)?;
    Ok(if interrupted { Exit::Interrupted } else { Exit::Done })
}
