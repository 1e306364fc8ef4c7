//! `wad-cosim eval`: one file per subject.

mod detector;
#[cfg(feature = "learn")]
pub mod encoder;
mod merge;
mod routes;
mod sight;
mod suites;

use super::{Common, Exit, runtime};
use clap::{Parser, Subcommand};

const EXAMPLES: &str = "\
In a suite's place may also stand a scenario (docs/scenarios.md) or a suite of your own, a JSON file (docs/evaluate.md).
Both have the options of the suites: see `wad-cosim eval nocrash --help`.

Examples:
  wad-cosim eval nocrash --agent wad-t --jobs 2 --out runs/nocrash  750 episodes in three towns
  wad-cosim eval accident_ahead --agent wad-t                       a scenario: one that ships, or a folder
  wad-cosim eval mine.json --agent wad-t                            your own suite
  wad-cosim eval detector --detector eyes                           a part of the system";

/// Drive the episodes of a suite, or score a part of the system against the ground truth.
#[derive(clap::Args, Debug)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// The paper's five tasks in every condition: success rates (table 1).
    Tasks(Box<suites::Args>),
    /// The composite task: 70 vehicles, 100 pedestrians, random routes (figure 8).
    Composite(Box<suites::Args>),
    /// CARLA's CoRL2017 benchmark: straight, one turn, navigation, navigation in traffic (table 2).
    Corl2017(Box<suites::Args>),
    /// NoCrash: empty, regular and dense traffic; a collision ends an episode (table 3).
    Nocrash(Box<suites::Args>),
    /// 4000 ticks in traffic: distance, time alive, speed, infractions per kilometre (table 4).
    Infractions(Box<suites::Args>),
    /// Join the results of several shards.
    Merge(merge::Args),
    /// Make the fixed routes that suites need, for your own net.
    Routes(routes::Args),
    /// Score a detector: recall, false alarms, average precision.
    Detector(detector::Args),
    /// Score a detector as `eval detector` does, and what it sees of the ego's lane and light.
    #[command(after_help = detector::EYES_EXAMPLES)]
    Eyes(detector::Args),
    /// Score lane detection: precision, recall and lateral error, by weather.
    Lanes(sight::Lanes),
    /// Score the estimates of who is in front and who will cross the path: gap and closing speed, by distance.
    Lead(sight::Lead),
    /// Score an encoder: how much of the transformed image its latent holds.
    #[cfg(feature = "learn")]
    Encoder(encoder::Args),
    /// A scenario (docs/scenarios.md) or your own suite (a JSON file), with the options of the other suites.
    #[command(external_subcommand)]
    File(Vec<String>),
}

/// Drive the episodes of a scenario, or of a suite from a JSON file.
#[derive(Parser)]
#[command(name = "wad-cosim eval FILE", bin_name = "wad-cosim eval FILE")]
struct OfFile {
    #[command(flatten)]
    common: Common,
    #[command(flatten)]
    args: suites::Args,
}

impl Args {
    /// The options of all commands among the words behind a suite's file; none where those words have mistakes, which
    /// `run` tells.
    pub fn behind_file(&self) -> Common {
        match &self.what {
            What::File(words) => OfFile::try_parse_from(words).map(|of| of.common).unwrap_or_default(),
            _ => Common::default(),
        }
    }
}

/// Runs the command.
pub fn run(args: Args) -> anyhow::Result<Exit> {
    match args.what {
        What::Tasks(args) => suites::run("tasks", *args),
        What::Composite(args) => suites::run("composite", *args),
        What::Corl2017(args) => suites::run("corl2017", *args),
        What::Nocrash(args) => suites::run("nocrash", *args),
        What::Infractions(args) => suites::run("infractions", *args),
        What::Merge(args) => merge::run(&args),
        What::Routes(args) => routes::run(&args),
        What::Detector(args) => detector::run(args, detector::Scored::Objects),
        What::Eyes(args) => detector::run(args, detector::Scored::Road),
        What::Lanes(args) => runtime()?.block_on(sight::lanes(args)),
        What::Lead(args) => runtime()?.block_on(sight::lead(args)),
        #[cfg(feature = "learn")]
        What::Encoder(args) => encoder::run(&args),
        What::File(words) => {
            let suite = words.first().cloned().unwrap_or_default();
            // A wrong suite is reported before wrong options.
            wad_cosim::eval::Suite::find(&suite).map_err(|e| Exit::Input.because(e))?;
            let args = OfFile::try_parse_from(&words).unwrap_or_else(|error| error.exit());
            suites::run(&suite, args.args)
        }
    }
}
