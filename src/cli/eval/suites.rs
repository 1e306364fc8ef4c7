//! `eval SUITE`: drives the episodes of a suite and reports how they ended.

use crate::cli::agents;
use crate::cli::progress::Bar;
use crate::cli::{Exit, print};
use clap::ValueHint;
use serde::Serialize;
use std::path::PathBuf;
use wad_cosim::agent::external::Limits;
use wad_cosim::camera::Preset;
use wad_cosim::env::EnvOptions;
use wad_cosim::eval::{
    self, DriverError, DriverSpec, EpisodeRecord, EvalError, Evaluation, Fault, Keep, Order, Outcome,
    Selection, Shard, StoreError, Suite, Summary,
};
use wad_cosim::folder_lock::LockError;
use wad_cosim::traffic::TrafficSpec;

const EXAMPLES: &str = "\
Examples:
  wad-cosim eval nocrash --agent wad-t --jobs 2 --out runs/nocrash     750 episodes in three towns
  wad-cosim eval nocrash --condition development --traffic dense --episodes 5  a part of it, under the autopilot
  wad-cosim eval nocrash --out runs/nocrash --agent wad-t --resume     goes on where it stopped
  wad-cosim eval nocrash --agent 'exec:python3 scripts/example_agent.py'  your own model
  wad-cosim eval nocrash --shard 1/2 --out a  (elsewhere: --shard 2/2 --out b), then eval merge a b --out all
  wad-cosim eval composite --agent wad-t --egos 10                     ten of it in each SUMO, among each other
  wad-cosim report runs/nocrash                                        tables, figures, maps

Exit codes: 0 done; 2 usage or input; 3 SUMO failed; 4 interrupted, results kept; 1 anything else.";

/// Options of `eval SUITE`.
#[derive(clap::Args, Debug)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// The driver: wad-t, wad-s, wad-t-reward, wad-s-reward (learned from reward alone), a trained agent's file, autopilot,
    /// random, constant[:THROTTLE,STEER,BRAKE], exec:COMMAND. May be given several times.
    #[arg(long = "agent", value_name = "NAME", default_value = "autopilot")]
    agents: Vec<DriverSpec>,
    /// Only this condition of the suite: training, development or test; may be given several times.
    #[arg(long = "condition", value_name = "NAME", value_parser = condition)]
    conditions: Vec<String>,
    /// Only this task of the suite; may be given several times.
    #[arg(long = "task", value_name = "NAME")]
    tasks: Vec<String>,
    /// Only this town, or a net of your own (CONFIG); may be given several times.
    #[arg(long = "town", value_name = "CONFIG", value_hint = ValueHint::FilePath)]
    towns: Vec<String>,
    /// Weather instead of the suite's; may be given several times.
    #[arg(long = "weather", value_name = "NAME")]
    weathers: Vec<Preset>,
    /// Take the weathers in turn, episode by episode, instead of driving all episodes in each of them.
    #[arg(long)]
    weathers_in_turn: bool,
    /// Only the suite's tasks with this traffic, or, if there are none, this traffic instead of the tasks'
    /// own: empty, regular, dense or V,P; may be given several times.
    #[arg(long, value_name = "SPEC")]
    traffic: Vec<TrafficSpec>,
    /// Episodes per task, town and weather (per task and town with --weathers-in-turn).
    #[arg(long, value_name = "N")]
    episodes: Option<u64>,
    /// The evaluation's seed; may be given several times.
    #[arg(long = "seed", value_name = "N")]
    seeds: Vec<u64>,
    /// Route file for a town without one (make it with `eval routes`).
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    routes: Option<PathBuf>,
    #[arg(long, help = format!("The detector: {}", wad_cosim::perception::DETECTORS), default_value = wad_cosim::perception::DEFAULT_DETECTOR, value_name = "NAME")]
    detector: String,
    /// Cameras in place of the door mirrors look back before a change of lane; without them nobody sees who is beside the ego.
    #[arg(long)]
    mirrors: bool,
    /// SUMOs in parallel; each takes a core.
    #[arg(long, value_name = "N", default_value_t = 1)]
    jobs: usize,
    /// Egos in each SUMO: they drive episodes of the same task, town and traffic at the same time, see each other and hit each other;
    /// fewer where places lie too near. The tables then tell collisions between egos apart.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(1..=1000))]
    egos: usize,
    /// Drive only the K-th of N parts of the suite; `eval merge` joins them.
    #[arg(long, value_name = "K/N", requires = "out")]
    shard: Option<Shard>,
    /// Folder for the results: config.json, episodes.jsonl, summary.json, and recordings in episodes/.
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath)]
    out: Option<PathBuf>,
    /// Continue the evaluation in --out.
    #[arg(long, requires = "out")]
    resume: bool,
    /// Episodes to keep for `replay` in --out: none, failures or all.
    #[arg(long, value_name = "WHICH", default_value = "failures", requires_ifs = [("failures", "out"), ("all", "out")])]
    keep: Keep,
    /// Time limit for each answer of an external agent.
    #[arg(long, value_name = "SECONDS", default_value_t = 10.0, value_parser = crate::cli::seconds)]
    agent_timeout: f64,
    /// Print one JSON object as the last line of stdout; everything else goes to stderr.
    #[arg(long)]
    json: bool,
}

impl Args {
    /// Every value once, with a warning about repeated ones.
    fn each_once(mut self) -> Self {
        once("--agent", &mut self.agents, DriverSpec::to_string);
        once("--condition", &mut self.conditions, String::clone);
        once("--task", &mut self.tasks, String::clone);
        once("--town", &mut self.towns, String::clone);
        once("--weather", &mut self.weathers, |weather| weather.name().to_string());
        once("--traffic", &mut self.traffic, TrafficSpec::to_string);
        once("--seed", &mut self.seeds, u64::to_string);
        self
    }
}

fn condition(text: &str) -> Result<String, std::convert::Infallible> {
    Ok(eval::condition_name(text))
}

/// Removes repeated values of `flag`, because their episodes would be the same ones again.
fn once<T: PartialEq>(flag: &str, given: &mut Vec<T>, name: impl Fn(&T) -> String) {
    let mut left: Vec<T> = Vec::new();
    for value in given.drain(..) {
        if left.contains(&value) {
            crate::cli::note(format_args!(
                "warning: {flag} {} is given more than once; its episodes are driven and counted once",
                name(&value)
            ));
        } else {
            left.push(value);
        }
    }
    *given = left;
}

/// The last line of `--json`.
#[derive(Serialize)]
struct Answer<'a> {
    #[serde(flatten)]
    summary: &'a Summary,
    interrupted: bool,
    /// Of this call.
    driven: u64,
    wall_seconds: f64,
    episodes_per_hour: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    out: Option<&'a PathBuf>,
}

/// Runs the command.
pub fn run(suite: &str, args: Args) -> anyhow::Result<Exit> {
    let suite = Suite::find(suite).map_err(|e| Exit::Input.because(e))?;
    let args = args.each_once();
    let selection = selection(&suite, &args);
    let options = EnvOptions {
        termination: suite.termination,
        detector: args.detector.clone(),
        mirrors: args.mirrors,
        ..EnvOptions::evaluation()
    };
    let limits = Limits::answer_within(args.agent_timeout).ok_or_else(|| {
        let given = args.agent_timeout;
        Exit::Input.because(anyhow::anyhow!("--agent-timeout: expected seconds above 0, found {given}"))
    })?;
    let make_agent = agents::maker(options.camera, limits);
    let stop = crate::cli::interrupt()?.flag();
    let order = Order {
        suite,
        selection,
        shard: args.shard,
        out: args.out.clone(),
        resume: args.resume,
        evaluation: Evaluation {
            options,
            jobs: args.jobs,
            egos: args.egos,
            make_agent: &make_agent,
            keep: if args.out.is_some() { args.keep } else { Keep::None },
            build: env!("WAD_COSIM_VERSION"),
            stop: &stop,
        },
    };
    let mut bar = None;
    let result = eval::evaluate(order, |progress| {
        let bar = bar.get_or_insert_with(|| Bar::new(progress.planned, "episodes"));
        if let Some(record) = progress.record {
            if !record.ending.success {
                tracing::info!("{}", failure(record));
            }
            if record.fault == Some(Fault::Agent) {
                bar.say(&failure(record));
            }
        }
        bar.show(progress.done, "");
    });
    if let Some(bar) = &mut bar {
        bar.clear();
    }
    let Outcome { summary, driven, wall_seconds, interrupted } = result.map_err(with_exit)?;
    let per_hour = if driven == 0 { 0.0 } else { driven as f64 * 3600.0 / wall_seconds };
    if driven > 0 {
        crate::cli::note(format_args!("{driven} episodes in {wall_seconds:.0} s, {per_hour:.0} an hour"));
    }
    let answer = Answer {
        summary: &summary,
        interrupted,
        driven,
        wall_seconds,
        episodes_per_hour: per_hour,
        out: args.out.as_ref(),
    };
    report(&summary, args.json.then(|| serde_json::to_string(&answer)).transpose()?)?;
    Ok(if interrupted { Exit::Interrupted } else { Exit::Done })
}

/// Prints the table, and with --json `json` as the last line.
pub fn report(summary: &Summary, json: Option<String>) -> anyhow::Result<()> {
    let text = table(summary);
    match json {
        Some(json) => {
            crate::cli::note(text.trim_end());
            print(&format!("{json}\n"))
        }
        None => print(&text),
    }
}

fn selection(suite: &Suite, args: &Args) -> Selection {
    let selection = Selection {
        agents: args.agents.clone(),
        tasks: args.tasks.clone(),
        conditions: args.conditions.clone(),
        towns: args.towns.clone(),
        weathers: args.weathers.clone(),
        weathers_in_turn: args.weathers_in_turn,
        traffic: Vec::new(),
        seeds: args.seeds.clone(),
        episodes: args.episodes,
        routes: args.routes.clone(),
    };
    selection.in_traffic(suite, &args.traffic)
}

/// The error with its exit code.
pub fn with_exit(error: EvalError) -> anyhow::Error {
    let exit = match &error {
        EvalError::Env(env) => Exit::of_env(env),
        EvalError::Assets(assets) => Exit::of_assets(assets),
        EvalError::Sumo(_) => Exit::Sumo,
        EvalError::Suite(_) | EvalError::Detector(_) => Exit::Input,
        EvalError::Driver(
            DriverError::Unknown { .. } | DriverError::Constant { .. } | DriverError::Manual,
        ) => Exit::Input,
        EvalError::Store(StoreError::File { .. } | StoreError::Lock(LockError::Make { .. })) => Exit::Other,
        EvalError::Store(_) => Exit::Input,
        EvalError::Driver(DriverError::Policy(_) | DriverError::Encoder(_)) => Exit::Input,
        _ => Exit::Other,
    };
    exit.because(error)
}

fn failure(record: &EpisodeRecord) -> String {
    format!(
        "{} {} {} {} episode {}: {} after {} ticks, {:.0} of {:.0} m: {} (from {} {:.1})",
        record.case.agent,
        record.case.town,
        record.case.task,
        record.case.spec.weather.name(),
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

/// The totals as text.
fn table(summary: &Summary) -> String {
    let named = |total: &eval::Total| {
        let traffic = total.traffic.to_string();
        [&*eval::report::short(&total.agent), &total.condition, &total.town, &total.task, &traffic]
            .map(str::to_string)
    };
    let names: Vec<[String; 5]> = summary.totals.iter().map(named).collect();
    // As wide as the longest name, so that columns stay columns.
    let mut widths = [10, 9, 7, 18, 7];
    for (column, width) in widths.iter_mut().enumerate() {
        let longest = names.iter().map(|row| row[column].chars().count()).max();
        *width = longest.unwrap_or(0).max(*width);
    }
    let row = |cells: [&str; 5]| {
        let cells = cells.iter().zip(widths).map(|(cell, width)| format!("{cell:width$} "));
        cells.collect::<String>()
    };
    let mut text = row(["agent", "condition", "town", "task", "traffic"]);
    text += &format!("{:>9}  {:>14}  {:>5}  {:>6}  ends\n", "success", "95 %", "km/h", "return");
    for (total, names) in summary.totals.iter().zip(&names) {
        let score = &total.score;
        let ends: Vec<String> = score.ends.iter().map(|(end, n)| format!("{end} {n}")).collect();
        text += &row(names.each_ref().map(String::as_str));
        text += &format!(
            "{:>4}/{:<4}  {:>5.1}-{:<5.1} %  {:>5.1}  {:>6}  {}{}\n",
            score.successes,
            score.episodes,
            100.0 * score.interval.0,
            100.0 * score.interval.1,
            3.6 * score.mean_speed_mps,
            score.mean_return.map_or("-".to_string(), |mean| format!("{mean:.0}")),
            ends.join(", "),
            if score.lost > 0 { format!("; lost with SUMO: {}", score.lost) } else { String::new() },
        );
    }
    if summary.episodes < summary.planned {
        text += &format!("{} of {} episodes\n", summary.episodes, summary.planned);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_names_keep_the_columns() {
        let total = |task: &str, town: &str| eval::Total {
            agent: "autopilot".to_string(),
            condition: "new".to_string(),
            town: town.to_string(),
            task: task.to_string(),
            traffic: Default::default(),
            score: eval::Score::of(&[]),
        };
        let totals = vec![total("short", "town3"), total("a task with a very long name", "my_own_long_town")];
        let summary = Summary { suite: String::new(), episodes: 0, planned: 0, totals, rows: Vec::new() };
        let text = table(&summary);
        let places: Vec<_> = text.lines().skip(1).map(|line| line.find("   0/0")).collect();
        assert!(places[0].is_some() && places[0] == places[1], "{text}");
    }
}
