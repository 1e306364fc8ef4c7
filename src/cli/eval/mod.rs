//! `wad-cosim eval`: one file per thing that is judged.

mod detector;
#[cfg(feature = "learn")]
mod encoder;
mod sight;
mod suites;

use super::Exit;
use anyhow::Context;
use clap::Subcommand;
use wad_cosim::eval::Suite;

/// Drive the episodes of a suite, or judge a part of the system by the ground truth.
#[derive(clap::Args, Debug)]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// The paper's five tasks, in both towns and all weathers: how many episodes end well.
    Tasks(Box<suites::Args>),
    /// The composite task: 70 vehicles, 100 pedestrians, random routes.
    Composite(Box<suites::Args>),
    /// How well a detector finds what the camera shows.
    Detector(detector::Args),
    /// Lane boundaries: precision, recall and lateral error against the painted ones, by weather.
    Lanes(sight::Args),
    /// The vehicle in front: gap and closing speed against the true ones, by distance.
    Lead(sight::Args),
    /// How much of the transformed image the latent holds.
    #[cfg(feature = "learn")]
    Encoder(encoder::Args),
}

/// Runs the command.
pub fn run(args: Args) -> anyhow::Result<Exit> {
    match args.what {
        What::Tasks(args) => suites::run(Suite::Tasks, *args),
        What::Composite(args) => suites::run(Suite::Composite, *args),
        What::Detector(args) => detector::run(args),
        What::Lanes(args) => runtime()?.block_on(sight::lanes(args)),
        What::Lead(args) => runtime()?.block_on(sight::lead(args)),
        #[cfg(feature = "learn")]
        What::Encoder(args) => encoder::run(&args),
    }
}

fn runtime() -> anyhow::Result<tokio::runtime::Runtime> {
    tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .context("cannot start the asynchronous runtime")
}
