//! `wad-cosim bench train`: driving and learning together.

use super::train::agent::{InputChoice, default_collectors, maker, with_exit};
use super::{Exit, print};
use anyhow::Context;
use clap::ValueEnum;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;
use wad_cosim::agent::learner::Algorithm;
use wad_cosim::agent::policy::find_encoder;
use wad_cosim::bench::peak_memory_mb;
use wad_cosim::camera::Preset;
use wad_cosim::tasks::{Curriculum, Stage, TaskKind};
use wad_cosim::train::agent::{Limits, TrainConfig, Trained, train};

const EXAMPLES: &str = "\
Examples:
  wad-cosim bench train
  wad-cosim bench train --task straight --collectors 2 --seconds 60 --json
  wad-cosim bench train --task straight --inputs raw --update-ratio 0.5
  wad-cosim bench train --device cuda --collectors 14

Milliseconds are per environment step and summed over collectors, so that they say what a step costs,
not how long it takes; update is per update.";

/// Measure driving alone, and driving and learning together, as in `train agent`.
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
    /// Seconds of driving alone to measure, and of driving and learning.
    #[arg(long, default_value_t = 30.0)]
    seconds: f64,
    /// Environments in parallel [default: as `train agent`].
    #[arg(long, value_name = "N")]
    collectors: Option<usize>,
    /// Egos of each collector, all in its one SUMO.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=200))]
    egos: u32,
    /// Updates per environment step, while learning.
    #[arg(long, value_name = "R", default_value_t = 0.5)]
    update_ratio: f64,
    /// Transitions per update.
    #[arg(long, value_name = "N", default_value_t = 128)]
    batch: usize,
    /// The networks' inputs; raw draws nothing.
    #[arg(long, value_enum, default_value_t = InputChoice::Both)]
    inputs: InputChoice,
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
    let device = args.device.open(true)?;
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
    config.egos = args.egos;
    config.batch_size = args.batch;
    config.learning_starts = WARM_UP.max(args.batch as u64);
    config.validation.every = 0;
    config.checkpoint_every = u64::MAX;
    config.steps = u64::MAX;
    args.inputs.choose(&mut config);
    let collectors = args.collectors.unwrap_or_else(default_collectors).max(1);
    let with = |update_ratio: f64| TrainConfig { update_ratio, ..config.clone() };
    let Some(alone) = measure(args, with(0.0), collectors, device)? else { return Ok(Exit::Interrupted) };
    let Some(both) = measure(args, with(args.update_ratio), collectors, device)? else {
        return Ok(Exit::Interrupted);
    };
    report(args, collectors, &alone, &both)?;
    Ok(Exit::Done)
}

/// Drives, and learns by the configuration's ratio; None where the user interrupted.
fn measure(
    args: &Args,
    config: TrainConfig,
    collectors: usize,
    device: tch::Device,
) -> anyhow::Result<Option<Trained>> {
    let scratch = tempfile::tempdir().context("cannot make a temporary folder")?;
    let out = scratch.path().join("run");
    let limits = Limits { time: None, collectors, device, out, record: None };
    let maker = maker(&args.encoder, &args.config)?;
    let over = AtomicBool::new(false);
    let interrupt = crate::cli::interrupt()?.flag();
    let mut since: Option<Instant> = None;
    let trained = train(&config, &limits, false, &over, &maker, |progress| {
        let warm = if config.update_ratio > 0.0 {
            progress.updates > 0
        } else {
            progress.steps >= config.learning_starts
        };
        if warm && since.get_or_insert_with(Instant::now).elapsed().as_secs_f64() >= args.seconds {
            over.store(true, Ordering::Relaxed);
        }
        if interrupt.load(Ordering::Relaxed) {
            over.store(true, Ordering::Relaxed);
        }
    })
    .map_err(with_exit)?;
    Ok((!interrupt.load(Ordering::Relaxed)).then_some(trained))
}

fn report(args: &Args, collectors: usize, alone: &Trained, both: &Trained) -> anyhow::Result<()> {
    let memory = peak_memory_mb();
    let mut text = format!(
        "{} on {}, inputs {}, {collectors} collectors, {} egos each: {:.1} environment steps/s without learning, {:.1} with \
         {:.1} updates/s; peak memory {:.0} MB\n{:>12} {:>10} {:>10}\n",
        both.algorithm,
        args.task,
        name(args.inputs),
        args.egos,
        alone.env_steps_per_s,
        both.env_steps_per_s,
        both.updates_per_s,
        memory.unwrap_or(0.0),
        "ms per step",
        "alone",
        "learning"
    );
    for (name, milliseconds) in &both.stages {
        let before = alone.stages.get(name).copied().unwrap_or_default();
        text.push_str(&format!("{name:>12} {before:10.3} {milliseconds:10.3}\n"));
    }
    if !args.json {
        return print(&text);
    }
    super::note(text.trim_end());
    let json = serde_json::json!({
        "algorithm": both.algorithm,
        "task": args.task,
        "town": args.config,
        "inputs": name(args.inputs),
        "collectors": collectors,
        "egos": args.egos,
        "update_ratio": args.update_ratio,
        "batch": args.batch,
        "device": name(args.device),
        "env_steps": both.steps,
        "env_steps_per_s": both.env_steps_per_s,
        "updates_per_s": both.updates_per_s,
        "stages": both.stages,
        "alone": { "env_steps_per_s": alone.env_steps_per_s, "stages": alone.stages },
        "peak_memory_mb": memory,
        "seed": args.seed,
    });
    print(&format!("{json}\n"))
}

/// What the command line calls a choice.
fn name(choice: impl ValueEnum) -> String {
    choice.to_possible_value().map_or(String::new(), |value| value.get_name().to_string())
}
