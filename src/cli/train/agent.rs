//! `wad-cosim train agent`.

use super::encoder::Device;
use crate::cli::progress::Bar;
use crate::cli::{Exit, agents, answer, dataset};
use anyhow::{Context, anyhow};
use clap::{ValueEnum, ValueHint};
use std::path::{Path, PathBuf};
use wad_cosim::agent::batch::Inputs;
use wad_cosim::agent::imitation::Imitation;
use wad_cosim::agent::learner::Algorithm;
use wad_cosim::agent::networks::CriticEnd;
use wad_cosim::agent::policy::{PolicyError, find_encoder};
use wad_cosim::agent::sac::SacParams;
use wad_cosim::agent::td3::Td3Params;
use wad_cosim::env::Assets;
use wad_cosim::eyes::EyesError;
use wad_cosim::folder_lock::LockError;
use wad_cosim::tasks::Curriculum;
use wad_cosim::train::agent::{Limits, Maker, Progress, TrainConfig, TrainError, Trained, train};
use wad_cosim::train::run::saved;

const EXAMPLES: &str = "\
Examples:
  wad-cosim train agent --algo td3 --out runs/wad_t
  wad-cosim train agent --algo sac --out runs/wad_s --steps 500000 --seed 2
  wad-cosim train agent --algo td3 --out runs/shown --demonstrations 30000 --pretrain 10000 --bc-weight 2
  wad-cosim train agent --out runs/wad_t --resume --steps 1000000
  wad-cosim train agent --algo td3 --out runs/gpu --device cuda --collectors 14 --max-minutes 9

The best actor by validation is DIR/best.safetensors, the newest DIR/last.safetensors; figures are in
DIR/train.jsonl, DIR/validation.jsonl and for TensorBoard; checkpoints hold the replay buffer.";

/// Options that a training keeps in its config.json.
const SETTINGS: [&str; 37] = [
    "curriculum",
    "seed",
    "encoder",
    "detector",
    "update_ratio",
    "batch",
    "buffer",
    "learning_starts",
    "demonstrations",
    "clone",
    "init",
    "critics_first",
    "actor_average",
    "clone_rate",
    "pretrain",
    "recorded",
    "bc_weight",
    "bc_updates",
    "bc_floor",
    "bc_filter",
    "critic",
    "critic_range",
    "critic_learning_rate",
    "learning_rate",
    "gamma",
    "n_step",
    "alpha",
    "noise",
    "inputs",
    "egos",
    "latent_gain",
    "other_days",
    "latent_mixing",
    "validate_every",
    "validation_episodes",
    "checkpoint_every",
    "set",
];

/// Train a driving agent: WAD-T (TD3) or WAD-S (SAC).
#[derive(clap::Args, Debug)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// The algorithm: td3 (WAD-T) or sac (WAD-S).
    #[arg(long, value_enum, required_unless_present = "resume")]
    algo: Option<Algo>,
    /// Folder for actors, checkpoints and figures.
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath)]
    out: PathBuf,
    /// Continue the training in --out with its configuration; only --steps, --max-minutes, --collectors,
    /// --record and --device may be given too.
    #[arg(long, conflicts_with_all = SETTINGS)]
    resume: bool,
    /// The tasks in order [default: the bundled curriculum].
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    curriculum: Option<PathBuf>,
    /// Environment steps of the agent, in total [default: 400000; with --resume: as many as before].
    #[arg(long, value_name = "N")]
    steps: Option<u64>,
    /// Stop after this wall time, with a checkpoint.
    #[arg(long, value_name = "MINUTES")]
    max_minutes: Option<f64>,
    /// Environments in parallel, each with its own SUMO [default: the number of cores, minus two on large
    /// machines].
    #[arg(long, value_name = "N")]
    collectors: Option<usize>,
    /// Device of the updates; driving always uses the CPU.
    #[arg(long, value_enum, default_value_t = Device::Cpu)]
    device: Device,
    /// Seed of everything random.
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// The encoder: a file, a folder, a bundled one's name, or `pooled` (coarse averages, untrained)
    /// [default: --init's, or `default`].
    #[arg(long, value_name = "NAME")]
    encoder: Option<String>,
    /// The detector [default: truth; with --inputs raw or vector: outlines, which draws nothing; with --inputs camera: eyes].
    #[arg(long, value_name = "NAME")]
    detector: Option<String>,
    /// Updates per environment step.
    #[arg(long, value_name = "R", default_value_t = 1.0)]
    update_ratio: f64,
    /// Transitions per update.
    #[arg(long, value_name = "N", default_value_t = 128)]
    batch: usize,
    /// Transitions in the replay buffer (505 MB per million).
    #[arg(long, value_name = "N", default_value_t = 1_000_000)]
    buffer: usize,
    /// Environment steps before the first update.
    #[arg(long, value_name = "N", default_value_t = 5_000)]
    learning_starts: u64,
    /// Environment steps of demonstrations: the autopilot drives first and fills the replay buffer.
    #[arg(long, value_name = "N", default_value_t = 0)]
    demonstrations: u64,
    /// Steps of behaviour cloning on the demonstrations before all other updates; trains only the actor.
    #[arg(long, value_name = "N", default_value_t = 0)]
    clone: u64,
    /// Start with this trained agent's actor (wad-t, wad-s or a file) instead of a new one; the scale of its
    /// inputs is kept.
    #[arg(long, value_name = "NAME|FILE")]
    init: Option<String>,
    /// Updates in which the critics learn and the actor waits [default: 5000 with --init and no demonstrations, else
    /// 0].
    #[arg(long, value_name = "N")]
    critics_first: Option<u64>,
    /// Updates over which the actor that is validated and written is averaged (beyond the paper); 0: the newest actor.
    #[arg(long, value_name = "N", default_value_t = 0)]
    actor_average: u64,
    /// Adam's initial learning rate for --clone; it falls linearly to a tenth.
    #[arg(long, value_name = "X", default_value_t = 1e-3)]
    clone_rate: f64,
    /// Updates on the demonstrations before the agent drives.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pretrain: u64,
    /// Keep every episode in DIR, with its images unless --inputs is raw, for --recorded.
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath)]
    record: Option<PathBuf>,
    /// Fill the replay buffer with the episodes in DIR first, encoded with this encoder; may be given
    /// several times.
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath)]
    recorded: Vec<PathBuf>,
    /// Weight of imitating the autopilot's action (beyond the paper); 0: no imitation.
    #[arg(long, value_name = "W", default_value_t = 0.0)]
    bc_weight: f64,
    /// Updates over which imitation fades.
    #[arg(long, value_name = "N", default_value_t = 200_000)]
    bc_updates: u64,
    /// Share of imitation's weight that remains after the fade.
    #[arg(long, value_name = "SHARE", default_value_t = 0.0)]
    bc_floor: f64,
    /// Imitate only where the critic prefers the autopilot's action.
    #[arg(long)]
    bc_filter: bool,
    /// td3: the critics' last layer: the paper's sigmoid, or linear.
    #[arg(long, value_enum, default_value_t = Critic::Sigmoid)]
    critic: Critic,
    /// td3: the returns at the sigmoid's 0 and 1.
    #[arg(long, value_name = "LOW,HIGH", default_value = "-60,100", allow_hyphen_values = true, value_parser = bounds)]
    critic_range: (f64, f64),
    /// td3: Adam's learning rate for the critics; with the paper's 3e-3 they do not hold.
    #[arg(long, value_name = "X", default_value_t = 3e-4)]
    critic_learning_rate: f64,
    /// Adam's learning rate for the actor (sac: for all networks).
    #[arg(long, value_name = "X", default_value_t = 3e-4)]
    learning_rate: f64,
    /// Discount per tick of a sixth of a second.
    #[arg(long, value_name = "X", default_value_t = 0.98)]
    gamma: f64,
    /// Rewards summed before the critic's estimate is used (n-step return).
    #[arg(long, value_name = "N", default_value_t = 3)]
    n_step: usize,
    /// sac: a fixed temperature, in scaled reward per nat [default: adjusted, so that the entropy keeps to its
    /// target].
    #[arg(long, value_name = "X")]
    alpha: Option<f64>,
    /// Exploration noise: a factor on its standard deviations.
    #[arg(long, value_name = "X", default_value_t = 1.0)]
    noise: f64,
    /// The networks' inputs (ablation).
    #[arg(long, value_enum, default_value_t = InputChoice::Both)]
    inputs: InputChoice,
    /// Egos of each collector, all in its one SUMO: they share its cost, and meet each other.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=200))]
    egos: u32,
    /// Standard deviation to which the latent is scaled: with 1 its 200 numbers drown the raw states at first,
    /// and the actor is stuck at full lock [default: 0.02; with --inputs latent: 1].
    #[arg(long, value_name = "X")]
    latent_gain: Option<f64>,
    /// Share of the images changed to other days: other light, tints, haze, wet roads, rain; never in
    /// validation.
    #[arg(long, value_name = "SHARE", default_value_t = 0.0)]
    other_days: f64,
    /// Add to each latent up to this share of the difference between two others of the batch, so that the
    /// agent relies less on the look of a day.
    #[arg(long, value_name = "SHARE", default_value_t = 0.0)]
    latent_mixing: f64,
    /// Environment steps between validations; 0: never.
    #[arg(long, value_name = "N", default_value_t = 50_000)]
    validate_every: u64,
    /// Validation episodes of each task.
    #[arg(long, value_name = "N", default_value_t = 4)]
    validation_episodes: usize,
    /// Environment steps between checkpoints.
    #[arg(long, value_name = "N", default_value_t = 25_000)]
    checkpoint_every: u64,
    /// Set anything in config.json, e.g. env.reward.lane=0 or curriculum.replay=0.5; may be given several times.
    #[arg(long, value_name = "PATH=VALUE")]
    set: Vec<String>,
    /// Print the result as one JSON line on stdout.
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Algo {
    Td3,
    Sac,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Critic {
    Sigmoid,
    Linear,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum InputChoice {
    /// Latent and raw states.
    Both,
    /// The same from the camera, the route and the ego's own motion alone; the detector is `eyes`.
    Camera,
    /// The latent alone.
    Latent,
    /// The raw states alone; by default nothing is drawn.
    Raw,
    /// The surroundings as numbers from the world itself, and the raw states; nothing is drawn.
    Vector,
}

impl InputChoice {
    /// Sets the networks' inputs, and the detector that they need.
    pub fn choose(self, config: &mut TrainConfig) {
        config.set_inputs(match self {
            Self::Both => Inputs::Both,
            Self::Camera => Inputs::Camera,
            Self::Latent => Inputs::Latent,
            Self::Raw => Inputs::Raw,
            Self::Vector => Inputs::Vector,
        });
        let detector = match self {
            Self::Raw | Self::Vector => "outlines",
            Self::Camera => "eyes",
            Self::Both | Self::Latent => "truth",
        };
        config.env.detector = detector.to_string();
    }
}

fn bounds(text: &str) -> Result<(f64, f64), String> {
    let wrong = || format!("`{text}` is not LOW,HIGH, e.g. -60,100");
    let (low, high) = text.split_once(',').ok_or_else(wrong)?;
    let (low, high): (f64, f64) =
        (low.trim().parse().map_err(|_| wrong())?, high.trim().parse().map_err(|_| wrong())?);
    if low.is_finite() && high.is_finite() && low < high { Ok((low, high)) } else { Err(wrong()) }
}

/// Runs the command.
pub fn run(args: Args) -> anyhow::Result<Exit> {
    let device = args.device.open(true)?;
    let config = if args.resume { saved_config(&args)? } else { config(&args)? };
    let limits = Limits {
        time: dataset::minutes(args.max_minutes)?,
        collectors: args.collectors.unwrap_or_else(default_collectors).max(1),
        device,
        out: args.out.clone(),
        record: args.record.clone(),
    };
    let maker = maker(&config.encoder, &config.curriculum.town)?;
    let interrupt = crate::cli::interrupt()?.flag();
    let bar = Bar::new(config.steps, "steps");
    let result = train(&config, &limits, args.resume, &interrupt, &maker, |progress| show(&bar, &progress));
    bar.clear();
    let trained = result.map_err(with_exit)?;
    report(&trained, args.json)?;
    Ok(if trained.interrupted { Exit::Interrupted } else { Exit::Done })
}

/// All cores of a small machine; on a large one, two are left to the learner and the system.
pub fn default_collectors() -> usize {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    if cores > 4 { cores - 2 } else { cores }
}

/// Makes environments in `town` with the encoder called `name`.
pub fn maker(name: &str, town: &str) -> anyhow::Result<Maker> {
    let assets = Assets::load(town).map_err(|e| with_exit(TrainError::Env(e.into())))?;
    let name = name.to_string();
    Ok(Maker {
        assets,
        encoder: Box::new(move || find_encoder(&name).map_err(|e| EyesError::from(e).into())),
    })
}

/// The bundled curriculum.
const CURRICULUM: &str = include_str!("../../../scenarios/curriculum.json");

/// The curriculum of a file, or the bundled one.
pub fn curriculum(file: Option<&Path>) -> anyhow::Result<Curriculum> {
    let loaded = match file {
        Some(path) => Curriculum::load(path),
        None => Curriculum::parse(Path::new("scenarios/curriculum.json"), CURRICULUM),
    };
    loaded.map_err(|e| Exit::Input.because(e))
}

fn config(args: &Args) -> anyhow::Result<TrainConfig> {
    let Some(algo) = args.algo else {
        return Err(Exit::Input.because(anyhow!("--algo: expected td3 or sac")));
    };
    let imitation = Imitation {
        weight: args.bc_weight,
        updates: args.bc_updates,
        floor: args.bc_floor,
        filter: args.bc_filter,
    };
    let alone = args.init.is_some() && args.demonstrations == 0 && args.recorded.is_empty();
    let critics_first = args.critics_first.unwrap_or(if alone { 5000 } else { 0 });
    let algorithm = match algo {
        Algo::Td3 => Algorithm::Td3(Td3Params {
            gamma: args.gamma,
            actor_learning_rate: args.learning_rate,
            critic_learning_rate: args.critic_learning_rate,
            critic_end: match args.critic {
                Critic::Linear => CriticEnd::Linear,
                Critic::Sigmoid => CriticEnd::Sigmoid { low: args.critic_range.0, high: args.critic_range.1 },
            },
            critics_first,
            actor_average: args.actor_average,
            imitation,
            ..Td3Params::default()
        }),
        Algo::Sac => Algorithm::Sac(SacParams {
            gamma: args.gamma,
            learning_rate: args.learning_rate,
            alpha: args.alpha.unwrap_or(SacParams::default().alpha),
            autotune: args.alpha.is_none(),
            critics_first,
            actor_average: args.actor_average,
            imitation,
            ..SacParams::default()
        }),
    };
    let curriculum = curriculum(args.curriculum.as_deref())?;
    let encoder = agents::sees_through(args.encoder.as_deref(), args.init.as_deref());
    let hash = find_encoder(&encoder).map_err(|e| Exit::Input.because(e))?.hash().to_string();
    let mut config = TrainConfig::new(algorithm, curriculum, &encoder, &hash);
    config.seed = args.seed;
    config.egos = args.egos;
    config.other_days = args.other_days;
    config.latent_mixing = args.latent_mixing;
    config.update_ratio = args.update_ratio;
    config.batch_size = args.batch;
    config.buffer = args.buffer;
    config.n_step = args.n_step;
    config.learning_starts = args.learning_starts;
    config.demonstrations = args.demonstrations;
    config.init.clone_from(&args.init);
    config.cloning = args.clone;
    config.cloning_rate = args.clone_rate;
    config.pretrain = args.pretrain;
    config.recorded.clone_from(&args.recorded);
    config.validation.every = args.validate_every;
    config.validation.episodes = args.validation_episodes;
    config.checkpoint_every = args.checkpoint_every.max(1);
    config.steps = args.steps.unwrap_or(config.steps);
    for noise in &mut config.exploration.exploration_noise {
        *noise *= args.noise;
    }
    args.inputs.choose(&mut config);
    config.latent_gain = args.latent_gain.unwrap_or(config.latent_gain);
    if let Some(detector) = &args.detector {
        config.env.detector.clone_from(detector);
    }
    config.env.told_expert = wad_cosim::perception::sees_the_road(&config.env.detector);
    with_settings(config, &args.set)
}

/// The configuration with the values of `--set`.
fn with_settings(config: TrainConfig, settings: &[String]) -> anyhow::Result<TrainConfig> {
    if settings.is_empty() {
        return Ok(config);
    }
    let mut tree = serde_json::to_value(&config).context("the configuration as JSON")?;
    for setting in settings {
        let (path, value) = setting.split_once('=').ok_or_else(|| {
            Exit::Input
                .because(anyhow!("--set: expected PATH=VALUE, e.g. env.reward.lane=0, found `{setting}`"))
        })?;
        let pointer = format!("/{}", path.replace('.', "/"));
        let Some(place) = tree.pointer_mut(&pointer) else {
            let known = path.rsplit_once('.').map_or(String::new(), |(above, _)| above.replace('.', "/"));
            let above = if known.is_empty() { Some(&tree) } else { tree.pointer(&format!("/{known}")) };
            let names: Vec<&str> = above
                .and_then(|v| v.as_object())
                .map_or(Vec::new(), |o| o.keys().map(String::as_str).collect());
            return Err(Exit::Input.because(anyhow!(
                "--set {setting}: config.json has no `{path}`; there is {}",
                names.join(", ")
            )));
        };
        // What is no JSON is a name.
        *place = serde_json::from_str(value).unwrap_or_else(|_| serde_json::Value::from(value));
    }
    serde_json::from_value(tree)
        .map_err(|e| Exit::Input.because(anyhow!("--set {}: {e}", settings.join(" --set "))))
}

/// The configuration of the training that --resume continues.
fn saved_config(args: &Args) -> anyhow::Result<TrainConfig> {
    let mut config: TrainConfig = saved(&args.out).map_err(super::with_exit)?;
    config.steps = args.steps.unwrap_or(config.steps);
    let name = |algo: Algo| if algo == Algo::Td3 { "wad-t" } else { "wad-s" };
    if let Some(algo) = args.algo
        && name(algo) != config.algorithm.agent_name()
    {
        return Err(Exit::Input.because(anyhow!(
            "`{}` trains {}, and --algo asks for {}; leave --algo out, or name another folder",
            args.out.display(),
            config.algorithm.agent_name(),
            name(algo)
        )));
    }
    // A bundled encoder may have been renamed since.
    if let Some(name) = wad_cosim::latent::bundled_with(&config.encoder_hash) {
        config.encoder = name;
    }
    let found = find_encoder(&config.encoder).map_err(|e| Exit::Input.because(e))?.hash().to_string();
    if found != config.encoder_hash {
        return Err(Exit::Input.because(anyhow!(
            "the training in `{}` uses the encoder {} (`{}`), which is {found} now; restore that encoder, or \
             start a new training",
            args.out.display(),
            config.encoder_hash,
            config.encoder
        )));
    }
    Ok(config)
}

fn show(bar: &Bar, p: &Progress<'_>) {
    if let Some(news) = &p.news {
        bar.say(news);
    }
    let doing = if p.validating {
        "validating".to_string()
    } else if p.steps == 0 && p.demonstrated > 0 {
        format!("{} demonstrated", p.demonstrated)
    } else {
        format!("{}, {:.0} % of the last", p.task, 100.0 * p.success_rate)
    };
    let message = format!(
        "{} updates, stage {}/{}: {doing}, return {:.0}",
        p.updates,
        p.stage + 1,
        p.stages,
        p.mean_return
    );
    bar.show(p.steps, &message);
}

/// The exit code of a training's error.
pub fn with_exit(error: TrainError) -> anyhow::Error {
    let exit = match &error {
        TrainError::Env(env) => Exit::of_env(env),
        TrainError::Policy(PolicyError::File { what: "write", .. }) => Exit::Other,
        TrainError::Buffer(_)
        | TrainError::Policy(_)
        | TrainError::Detector(_)
        | TrainError::Config(_)
        | TrainError::Lock(LockError::Busy { .. })
        | TrainError::ConfigFile { .. }
        | TrainError::Read { .. }
        | TrainError::Taken { .. }
        | TrainError::NoCheckpoint { .. } => Exit::Input,
        _ => Exit::Other,
    };
    exit.because(error)
}

fn report(t: &Trained, json: bool) -> anyhow::Result<()> {
    let best = t.best.map_or("no validation yet".to_string(), |best| {
        format!(
            "best at step {}: {:.0} % of the validation, mean return {:.0}",
            best.steps,
            100.0 * best.success_rate,
            best.mean_return
        )
    });
    let text = format!(
        "{}: {} steps, {} updates{} in {:.0} s ({:.0} s in all); {:.1} steps/s and {:.1} updates/s while learning\n\
         stage {} ({}){}; {best}\nresults in {}\n{}",
        t.algorithm,
        t.steps,
        t.updates,
        if t.demonstrated > 0 { format!(", {} steps demonstrated", t.demonstrated) } else { String::new() },
        t.wall_seconds,
        t.total_seconds,
        t.env_steps_per_s,
        t.updates_per_s,
        t.stage + 1,
        t.stage_task,
        if t.curriculum_done { ", the curriculum is complete" } else { "" },
        t.out.display(),
        match (t.interrupted, t.steps + t.demonstrated > 0) {
            (false, _) => "",
            (true, true) => "interrupted; --resume continues from here\n",
            (true, false) => "interrupted before the first checkpoint; the same command begins again\n",
        },
    );
    answer(&text, json, t)
}
