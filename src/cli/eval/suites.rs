//! `eval tasks`, `eval composite`: drive the episodes of a suite, and say how they ended.

use crate::cli::progress::Bar;
use crate::cli::{Exit, print};
use anyhow::Context;
use serde::Serialize;
use std::collections::BTreeMap;
use std::io::Write;
use std::path::PathBuf;
use std::sync::atomic::Ordering;
use wad_cosim::agent::Agent;
use wad_cosim::camera::{CameraConfig, Preset};
use wad_cosim::env::EnvOptions;
use wad_cosim::eval::{
    self, DriverError, DriverSpec, EpisodeRecord, EvalError, Evaluation, Row, Selection, Suite,
};
use wad_cosim::latent::Encoder;
use wad_cosim::tasks::TaskKind;
use wad_cosim::traffic::TrafficSpec;

/// Options of `eval tasks` and `eval composite`.
#[derive(clap::Args, Debug)]
pub struct Args {
    /// Who drives: wad-t, wad-s, a trained agent's file, autopilot, random, constant[:THROTTLE,STEER,BRAKE]. May be given several times.
    #[arg(long = "agent", value_name = "NAME", default_value = "autopilot")]
    agents: Vec<DriverSpec>,
    /// Only this task; may be given several times.
    #[arg(long = "task", value_name = "NAME")]
    tasks: Vec<TaskKind>,
    /// Only this town; may be given several times.
    #[arg(long = "town", value_name = "CONFIG")]
    towns: Vec<String>,
    /// Only this weather; may be given several times.
    #[arg(long = "weather", value_name = "NAME")]
    weathers: Vec<Preset>,
    /// Other background traffic than the task's own: empty, regular, dense or V,P.
    #[arg(long, value_name = "SPEC")]
    traffic: Vec<TrafficSpec>,
    /// Episodes per task, town and weather.
    #[arg(long, value_name = "N")]
    episodes: Option<u64>,
    /// The evaluation's seed; may be given several times.
    #[arg(long = "seed", value_name = "N")]
    seeds: Vec<u64>,
    /// Environments at a time; each takes a core.
    #[arg(long, value_name = "N", default_value_t = 1)]
    jobs: usize,
    /// Folder for config.json, episodes.jsonl and summary.json.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print one JSON object as the last line of stdout; everything else goes to stderr.
    #[arg(long)]
    json: bool,
}

/// `summary.json`, and the last line of `--json`.
#[derive(Serialize)]
struct Summary {
    suite: Suite,
    episodes: u64,
    planned: u64,
    interrupted: bool,
    rows: Vec<Row>,
    #[serde(skip_serializing_if = "Option::is_none")]
    out: Option<PathBuf>,
}

/// Runs the command.
pub fn run(suite: Suite, args: Args) -> anyhow::Result<Exit> {
    let options = EnvOptions::evaluation();
    let selection = Selection {
        agents: args.agents.clone(),
        tasks: args.tasks.clone(),
        towns: args.towns.clone(),
        weathers: args.weathers.clone(),
        traffic: args.traffic.clone(),
        seeds: args.seeds.clone(),
        episodes: args.episodes,
    };
    let plan = selection.plan(suite);
    let mut file = args.out.as_ref().map(|out| Folder::create(out, &selection, &options)).transpose()?;
    let stop = wad_cosim::interrupt::flag().context("cannot listen for Ctrl-C")?;
    let bar = Bar::new(plan.len() as u64, "episodes");
    let mut shown = 0u64;
    let camera = options.camera;
    let evaluation =
        Evaluation { options, jobs: args.jobs, make_agent: &|name| open(name, &camera), stop: &stop };
    let result = eval::run(&plan, &evaluation, |record| {
        shown += 1;
        bar.show(shown, "");
        if !record.ending.success && record.case.agent == DriverSpec::Autopilot {
            bar.say(&failure(record));
        }
        file.as_mut().map_or(Ok(()), |file| file.add(record))
    });
    bar.clear();
    let records = result.map_err(with_exit)?;
    let interrupted = stop.load(Ordering::Relaxed) && records.len() < plan.len();
    let summary = Summary {
        suite,
        episodes: records.len() as u64,
        planned: plan.len() as u64,
        interrupted,
        rows: eval::rows(&records),
        out: args.out.clone(),
    };
    if let Some(file) = file {
        file.finish(&summary)?;
    }
    let text = table(&summary.rows);
    if args.json {
        eprint!("{text}");
        print(&format!("{}\n", serde_json::to_string(&summary)?))?;
    } else {
        print(&text)?;
    }
    Ok(if interrupted { Exit::Interrupted } else { Exit::Done })
}

type Opened = (Box<dyn Agent>, Box<dyn Encoder>);

/// A trained agent, and the encoder that it sees through.
#[cfg(feature = "learn")]
fn open(name: &str, camera: &CameraConfig) -> Result<Opened, DriverError> {
    Ok(wad_cosim::agent::policy::open(name, None, camera)?)
}

#[cfg(not(feature = "learn"))]
fn open(name: &str, _: &CameraConfig) -> Result<Opened, DriverError> {
    Err(DriverError::Unknown { found: name.to_string() })
}

fn with_exit(error: EvalError) -> anyhow::Error {
    let exit = match &error {
        EvalError::Env(env) if env.is_input() => Exit::Input,
        EvalError::Env(env) if env.is_sumo() => Exit::Sumo,
        EvalError::Driver(DriverError::Unknown { .. } | DriverError::Constant { .. }) => Exit::Input,
        #[cfg(feature = "learn")]
        EvalError::Driver(DriverError::Policy(_)) => Exit::Input,
        EvalError::Driver(DriverError::Env(env)) if env.is_sumo() => Exit::Sumo,
        _ => Exit::Other,
    };
    exit.because(error)
}

fn failure(record: &EpisodeRecord) -> String {
    format!(
        "{} {} {} episode {}: {} after {} ticks, {:.0} of {:.0} m: {} (from {} {:.1})",
        record.case.agent,
        record.case.town,
        record.case.task.kind,
        record.case.episode,
        record.ending.end,
        record.ticks,
        record.driven_m,
        record.route_length_m,
        record.ending.cause,
        record.placement.from.lane,
        record.placement.from.s,
    )
}

/// The run folder.
struct Folder {
    path: PathBuf,
    episodes: std::fs::File,
}

impl Folder {
    fn create(path: &PathBuf, selection: &Selection, options: &EnvOptions) -> anyhow::Result<Self> {
        #[derive(Serialize)]
        struct Config<'a> {
            selection: &'a Selection,
            options: &'a EnvOptions,
        }
        let cannot = || format!("cannot write into {}", path.display());
        std::fs::create_dir_all(path).with_context(cannot)?;
        let config = serde_json::to_string_pretty(&Config { selection, options })?;
        std::fs::write(path.join("config.json"), config).with_context(cannot)?;
        let episodes = std::fs::File::create(path.join("episodes.jsonl")).with_context(cannot)?;
        Ok(Self { path: path.clone(), episodes })
    }

    fn add(&mut self, record: &EpisodeRecord) -> Result<(), EvalError> {
        let path = || self.path.join("episodes.jsonl").display().to_string();
        let line = serde_json::to_string(record)
            .map_err(|error| EvalError::Write { path: path(), source: error.into() })?;
        writeln!(self.episodes, "{line}").map_err(|source| EvalError::Write { path: path(), source })
    }

    fn finish(self, summary: &Summary) -> anyhow::Result<()> {
        let path = self.path.join("summary.json");
        let text = serde_json::to_string_pretty(summary)?;
        std::fs::write(&path, text).with_context(|| format!("cannot write {}", path.display()))
    }
}

/// The rows for people.
fn table(rows: &[Row]) -> String {
    let mut text = format!(
        "{:10} {:7} {:10} {:15} {:>7}  {:>13}  {:>7}  {:>6}  ends\n",
        "agent", "town", "task", "weather", "success", "95 %", "km/h", "return"
    );
    for row in rows {
        let ends: BTreeMap<&str, u64> = row.ends.iter().map(|(end, n)| (end.name(), *n)).collect();
        let ends: Vec<String> = ends.iter().map(|(end, n)| format!("{end} {n}")).collect();
        text += &format!(
            "{:10} {:7} {:10} {:15} {:>3}/{:<3}  {:>5.1}-{:<5.1} %  {:>7.1}  {:>6.0}  {}\n",
            row.agent,
            row.town,
            row.task.name(),
            row.weather.name(),
            row.successes,
            row.episodes,
            100.0 * row.interval.0,
            100.0 * row.interval.1,
            3.6 * row.mean_speed_mps,
            row.mean_return,
            ends.join(", "),
        );
    }
    text
}
