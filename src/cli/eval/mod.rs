//! `wad-cosim eval`: one file per thing that is judged.

mod detector;
#[cfg(feature = "learn")]
mod encoder;
mod merge;
mod routes;
mod sight;
mod suites;

use super::{Exit, runtime};
use clap::{Parser, Subcommand};

/// Drive the episodes of a suite, or judge a part of the system by the ground truth.
#[derive(clap::Args, Debug)]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// The paper's five tasks in both conditions: how many episodes end well (table 1).
    Tasks(Box<suites::Args>),
    /// The composite task: 70 vehicles, 100 pedestrians, random routes (figure 8).
    Composite(Box<suites::Args>),
    /// CARLA's benchmark: straight, one turn, navigation, navigation among others (table 2).
    Corl2017(Box<suites::Args>),
    /// NoCrash: empty, regular and dense traffic; a collision ends an episode (table 3).
    Nocrash(Box<suites::Args>),
    /// 4000 ticks in traffic: distance, time alive, speed, infractions per kilometre (table 4).
    Infractions(Box<suites::Args>),
    /// Results of several shards as one.
    Merge(merge::Args),
    /// Fixed routes for a net of your own, as suites need them.
    Routes(routes::Args),
    /// How well a detector finds what the camera shows.
    Detector(detector::Args),
    /// Lane boundaries: precision, recall and lateral error against the painted ones, by weather.
    Lanes(sight::Args),
    /// The vehicle in front: gap and closing speed against the true ones, by distance.
    Lead(sight::Args),
    /// How much of the transformed image the latent holds.
    #[cfg(feature = "learn")]
    Encoder(encoder::Args),
    /// A scenario (docs/scenarios.md), or a suite of your own: a JSON file. With the options of the others.
    #[command(external_subcommand)]
    File(Vec<String>),
}

/// The options of a suite that is a file.
#[derive(Parser)]
#[command(name = "wad-cosim eval SUITE.json")]
struct OfFile {
    #[command(flatten)]
    args: suites::Args,
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
        What::Detector(args) => detector::run(args),
        What::Lanes(args) => runtime()?.block_on(sight::lanes(args)),
        What::Lead(args) => runtime()?.block_on(sight::lead(args)),
        #[cfg(feature = "learn")]
        What::Encoder(args) => encoder::run(&args),
        What::File(words) => {
            let suite = words.first().cloned().unwrap_or_default();
            // A suite that is none is the greater mistake than its options.
            wad_cosim::eval::Suite::find(&suite).map_err(|e| Exit::Input.because(e))?;
            let args = OfFile::try_parse_from(&words).unwrap_or_else(|error| error.exit());
            suites::run(&suite, args.args)
        }
    }
}
