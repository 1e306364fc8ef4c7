//! `eval routes`: fixed routes for a net; the autopilot finishes each in the empty town.

use super::suites::with_exit;
use crate::cli::progress::Bar;
use crate::cli::{Exit, print};
use clap::ValueHint;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::mpsc;
use wad_cosim::env::Assets;
use wad_cosim::eval::routes::{self, Routes};
use wad_cosim::tasks::TaskKind;

/// Options of `eval routes`.
#[derive(clap::Args, Debug)]
#[command(after_help = "Example:\n  wad-cosim eval routes my.net.xml --set navigation --jobs 2")]
pub struct Args {
    /// A .sumocfg, a .net.xml(.gz), a folder with one .sumocfg, or a bundled town.
    #[arg(value_hint = ValueHint::FilePath)]
    config: String,
    /// Only routes for this kind of task; may be given several times.
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
    Set(TaskKind, Result<Result<Vec<wad_cosim::tasks::Placement>, String>, wad_cosim::env::EnvError>),
}

/// Runs the command.
pub fn run(args: &Args) -> anyhow::Result<Exit> {
    let assets = Assets::load(&args.config).map_err(|e| with_exit(e.into()))?;
    let out = args.out.clone().unwrap_or_else(|| Routes::beside(&assets));
    let kinds = if args.sets.is_empty() { Routes::SETS.to_vec() } else { args.sets.clone() };
    let bar = Bar::new((kinds.len() * args.count) as u64, "routes");
    let (sender, receiver) = mpsc::channel();
    let next = std::sync::Mutex::new(kinds.iter().copied());
    let (mut sets, mut missing) = (BTreeMap::new(), BTreeMap::new());
    std::thread::scope(|scope| -> anyhow::Result<()> {
        for _ in 0..args.jobs.clamp(1, kinds.len().max(1)) {
            let (sender, next, assets) = (sender.clone(), &next, &assets);
            scope.spawn(move || {
                loop {
                    let Ok(Some(kind)) = next.lock().map(|mut kinds| kinds.next()) else { break };
                    // The receiver is gone if another set has failed.
                    let found = routes::find(assets, kind, args.count, args.seed, |_, holds| {
                        let _ = sender.send(News::Tried(holds));
                    });
                    let _ = sender.send(News::Set(kind, found));
                }
            });
        }
        drop(sender);
        let (mut found, mut tried) = (0, 0);
        for news in receiver {
            match news {
                News::Tried(holds) => {
                    tried += 1;
                    found += u64::from(holds);
                    bar.show(found, &format!("of {tried} tried"));
                }
                News::Set(kind, set) => match set.map_err(|e| with_exit(e.into()))? {
                    Ok(routes) => {
                        bar.say(&format!("{kind}: {} routes", routes.len()));
                        sets.insert(kind.name().to_string(), routes);
                    }
                    Err(why) => {
                        bar.say(&format!("{kind}: none: {why}"));
                        missing.insert(kind.name().to_string(), why);
                    }
                },
            }
        }
        Ok(())
    })?;
    bar.clear();
    let counts: BTreeMap<&String, usize> = sets.iter().map(|(set, routes)| (set, routes.len())).collect();
    let answer = serde_json::json!({ "out": out, "routes": counts, "missing": missing });
    let routes = Routes {
        town: assets.name().to_string(),
        net: assets.net_hash().to_string(),
        sets: sets.clone(),
        missing,
    };
    routes.save(&out).map_err(|e| Exit::Other.because(e))?;
    if args.json {
        print(&format!("{answer}\n"))?
    } else {
        print(&format!("{}\n", out.display()))?
    }
    Ok(Exit::Done)
}
