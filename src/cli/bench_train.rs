//! `wad-cosim bench train`: driving and learning together.

use super::train::agent::{default_collectors, maker, with_exit};
use super::{Exit, print};
use anyhow::Context;
use clap::ValueEnum;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;
use wad_cosim::agent::learner::Algorithm;
use wad_cosim::agent::policy::find_encoder;
use wad_cosim::camera::Preset;
use wad_cosim::tasks::{Curriculum, Stage, TaskKind};
use wad_cosim::train::agent::{Limits, TrainConfig, Trained, train};

const EXAMPLES: &str = "\
Examples:
  wad-cosim bench train
  wad-cosim bench train --task straight --collectors 2 --seconds 60 --json
  wad-cosim bench train --device cuda --collectors 14

Milliseconds are per environment step and summed over collectors, so that they say what a step costs,
not how long it takes; update is per update.";

/// Measure driving and learning together, as in `train agent`: camera, encoder, SUMO and updates.
#[derive(clap::Args, Debug)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// A .sumocfg, a .net.xml(.gz) or a bundled town.
    #[arg(default_value = "town3")]
    config: String,
    /// td3 or sac.
    #[arg(long, value_enum, default_value_t = super::train::agent::Algo::Td3)]
    algo: super::train::agent::Algo,
    /// The task to drive; composite has 70 vehicles and 100 pedestrians.
    #[arg(long, value_name = "TASK", default_value = "composite")]
    task: TaskKind,
    /// Seconds of driving and learning to measure.
    #[arg(long, default_value_t = 30.0)]
    seconds: f64,
    /// Environments in parallel [default: as `train agent`].
    #[arg(long, value_name = "N")]
    collectors: Option<usize>,
    /// Updates per environment step.
    #[arg(long, value_name = "R", default_value_t = 1.0)]
    update_ratio: f64,
    /// The encoder: a file, a folder, a bundled one's name, or `pooled`.
    #[arg(long, value_name = "NAME", default_value = "default")]
    encoder: String,
    /// Device of the updates.
    #[arg(long, value_enum, default_value_t = super::train::Device::Cpu)]
    device: super::train::Device,
    /// Seed of everything random.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Print one JSON object as the last line of stdout; everything else goes to stderr.
    #[arg(long)]
    json: bool,
}

/// Steps that fill the buffer before the measurement.
const WARM_UP: u64 = 1000;

/// Runs the command.
pub fn run(args: &Args) -> anyhow::Result<Exit> {
    let device = args.device.open()?;
    let scratch = tempfile::tempdir().context("cannot make a temporary folder")?;
    let stage =
        Stage { task: args.task, threshold: 1.0, window: usize::MAX, most_steps: None, traffic: None };
    let curriculum = Curriculum {
        town: args.config.clone(),
        weathers: vec![Preset::ClearNoon, Preset::CloudyNoon, Preset::SoftRainNoon],
        replay: 0.0,
        stages: vec![stage],
    };
    let algorithm = match args.algo {
        super::train::agent::Algo::Td3 => Algorithm::Td3(Default::default()),
        super::train::agent::Algo::Sac => Algorithm::Sac(Default::default()),
    };
    let hash = find_encoder(&args.encoder).map_err(|e| Exit::Input.because(e))?.hash().to_string();
    let mut config = TrainConfig::new(algorithm, curriculum, &args.encoder, &hash);
    config.seed = args.seed;
    config.update_ratio = args.update_ratio;
    config.learning_starts = WARM_UP;
    config.validation.every = 0;
    config.checkpoint_every = u64::MAX;
    let limits = Limits {
        steps: u64::MAX,
        time: None,
        collectors: args.collectors.unwrap_or_else(default_collectors).max(1),
        device,
        out: scratch.path().join("run"),
        record: None,
    };
    let maker = maker(&args.encoder, &args.config)?;
    let over = AtomicBool::new(false);
    let interrupt = crate::cli::interrupt()?.flag();
    let mut learning_since: Option<Instant> = None;
    let trained = train(&config, &limits, false, &over, &maker, |progress| {
        if progress.updates > 0 {
            let since = learning_since.get_or_insert_with(Instant::now);
            if since.elapsed().as_secs_f64() >= args.seconds {
                over.store(true, Ordering::Relaxed);
            }
        }
        if interrupt.load(Ordering::Relaxed) {
            over.store(true, Ordering::Relaxed);
        }
    })
    .map_err(with_exit)?;
    report(args, &limits, &trained)?;
    Ok(if interrupt.load(Ordering::Relaxed) { Exit::Interrupted } else { Exit::Done })
}

fn report(args: &Args, limits: &Limits, t: &Trained) -> anyhow::Result<()> {
    let memory = peak_memory_mb();
    let mut text = format!(
        "{} on {}, {} collectors: {:.1} environment steps/s with {:.1} updates/s; peak memory {:.0} MB\n",
        t.algorithm,
        args.task,
        limits.collectors,
        t.env_steps_per_s,
        t.updates_per_s,
        memory.unwrap_or(0.0)
    );
    for (name, milliseconds) in &t.stages {
        text.push_str(&format!("{name:>12} {milliseconds:8.2} ms\n"));
    }
    if !args.json {
        return print(&text);
    }
    eprint!("{text}");
    let json = serde_json::json!({
        "algorithm": t.algorithm,
        "task": args.task,
        "town": args.config,
        "collectors": limits.collectors,
        "update_ratio": args.update_ratio,
        "device": args.device.to_possible_value().map(|v| v.get_name().to_string()),
        "env_steps": t.steps,
        "env_steps_per_s": t.env_steps_per_s,
        "updates_per_s": t.updates_per_s,
        "stages": t.stages,
        "peak_memory_mb": memory,
        "seed": args.seed,
    });
    print(&format!("{json}\n"))
}

/// This process's peak memory (MB); None if the system does not report it.
fn peak_memory_mb() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    Some(line.split_whitespace().nth(1)?.parse::<f64>().ok()? / 1000.0)
}
