//! `wad-cosim bench`: measures speed.

#[cfg(feature = "learn")]
use super::bench_train;
use super::{Exit, bench_camera, bench_fleet, bench_tick, bench_view, print, run};
use anyhow::Context;
use wad_cosim::bench::{BenchError, BridgeBench, BridgeRow};
use wad_cosim::bridge::BridgeOptions;
use wad_cosim::bundled;
use wad_cosim::drive::DriveOptions;

/// Measure speed, as a ratio to SUMO alone in the same run.
#[derive(clap::Args, Debug)]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(clap::Subcommand, Debug)]
enum What {
    /// Measure the bridge against SUMO alone.
    Bridge(BridgeArgs),
    /// Measure the front camera, by weather, size and outputs, on one core.
    Camera(bench_camera::Args),
    /// Measure a tick of the whole loop, by stage.
    Tick(bench_tick::Args),
    /// Measure many egos in one SUMO.
    Fleet(bench_fleet::Args),
    /// Measure how much viewers of the live view slow down the simulation.
    View(bench_view::Args),
    /// Measure driving and learning together, as in `train agent`.
    #[cfg(feature = "learn")]
    Train(bench_train::Args),
}

const EXAMPLES: &str = "\
Examples:
  wad-cosim bench bridge
  wad-cosim bench bridge --populations 70/100 --repeat 80 --json
  wad-cosim bench bridge my.sumocfg --populations 0/0,200/0";

/// Measure the bridge against SUMO alone: pose in, step, everything within 100 m decoded.
#[derive(clap::Args, Debug)]
#[command(after_help = EXAMPLES)]
struct BridgeArgs {
    /// A .sumocfg, a .net.xml(.gz) or a bundled town.
    #[arg(default_value = "town5")]
    config: String,
    /// VEHICLES/PEDESTRIANS, separated by commas.
    #[arg(long, value_delimiter = ',', default_value = "0/0,20/50,70/100,100/250,500/500", value_parser = population)]
    populations: Vec<(usize, usize)>,
    /// Ticks per stretch.
    #[arg(long, default_value_t = 100)]
    ticks: u64,
    /// Stretches per population, each timed with the bridge and alone; the median counts.
    #[arg(long, default_value_t = 40)]
    repeat: usize,
    /// Seed of the traffic.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Print one JSON object as the last line of stdout; everything else goes to stderr.
    #[arg(long)]
    json: bool,
}

fn population(text: &str) -> Result<(usize, usize), String> {
    let wrong = || format!("expected VEHICLES/PEDESTRIANS, e.g. 70/100, found `{text}`");
    let (vehicles, pedestrians) = text.split_once('/').ok_or_else(wrong)?;
    Ok((vehicles.trim().parse().map_err(|_| wrong())?, pedestrians.trim().parse().map_err(|_| wrong())?))
}

/// Runs the command.
pub fn run(args: Args) -> anyhow::Result<Exit> {
    let runtime = crate::cli::runtime()?;
    match args.what {
        What::Bridge(args) => runtime.block_on(bridge(args)),
        What::Camera(args) => runtime.block_on(bench_camera::run(args)),
        What::Tick(args) => runtime.block_on(bench_tick::run(args)),
        What::Fleet(args) => bench_fleet::run(&args),
        What::View(args) => runtime.block_on(bench_view::run(args)),
        #[cfg(feature = "learn")]
        What::Train(args) => bench_train::run(&args),
    }
}

async fn bridge(args: BridgeArgs) -> anyhow::Result<Exit> {
    let config = bundled::resolve(&args.config).map_err(|e| Exit::Input.because(e))?;
    let scratch = tempfile::tempdir().context("cannot make a temporary folder")?;
    let bench = BridgeBench {
        base: DriveOptions::new(
            BridgeOptions { seed: args.seed, ..BridgeOptions::new(config, scratch.path()) },
            scratch.path().to_path_buf(),
        ),
        populations: args.populations.clone(),
        warm_up: 60,
        ticks: args.ticks.max(1),
        repeat: args.repeat,
        scratch: scratch.path().to_path_buf(),
    };
    let mut rows = Vec::new();
    let header = format!(
        "{:>9} {:>12} {:>14} {:>10} {:>6} {:>10} {:>10} {:>11} {:>13} {:>9}",
        "vehicles",
        "pedestrians",
        "sumo alone ms",
        "bridge ms",
        "ratio",
        "quartiles",
        "cpu ratio",
        "physics ms",
        "autopilot ms",
        "in sight"
    );
    let say = |line: &str| super::row(line, args.json);
    say(&header)?;
    for &(vehicles, pedestrians) in &bench.populations {
        let mut progress =
            |turn: usize| tracing::info!("{vehicles}/{pedestrians}: turn {turn} of {}", args.repeat);
        let row = bench.row(vehicles, pedestrians, &mut progress).await.map_err(|error| match error {
            BenchError::Drive(error) => run::with_exit(error),
            other => Exit::Sumo.because(other),
        })?;
        say(&line(&row))?;
        rows.push(row);
    }
    if args.json {
        print(&format!("{}\n", serde_json::json!({ "rows": rows })))?;
    }
    Ok(Exit::Done)
}

fn line(r: &BridgeRow) -> String {
    format!(
        "{:>9} {:>12} {:>14.3} {:>10.3} {:>6.2} {:>10} {:>10.2} {:>11.3} {:>13.3} {:>9.1}",
        r.vehicles,
        r.pedestrians,
        r.sumo_alone_ms,
        r.bridge_ms,
        r.ratio,
        format!("{:.2}-{:.2}", r.ratio_quartiles[0], r.ratio_quartiles[1]),
        r.cpu_ratio,
        r.physics_ms,
        r.autopilot_ms,
        r.actors_in_sight
    )
}
