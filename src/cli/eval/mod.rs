//! `wad-cosim eval`: one file per thing that is judged.

mod detector;
mod sight;

use super::Exit;
use anyhow::Context;
use clap::Subcommand;

/// Judge a part of the system by the ground truth.
#[derive(clap::Args, Debug)]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// How well a detector finds what the camera shows.
    Detector(detector::Args),
    /// Lane boundaries: precision, recall and lateral error against the painted ones, by weather.
    Lanes(sight::Args),
    /// The vehicle in front: gap and closing speed against the true ones, by distance.
    Lead(sight::Args),
}

/// Runs the command.
pub fn run(args: Args) -> anyhow::Result<Exit> {
    match args.what {
        What::Detector(args) => detector::run(args),
        What::Lanes(args) => runtime()?.block_on(sight::lanes(args)),
        What::Lead(args) => runtime()?.block_on(sight::lead(args)),
    }
}

fn runtime() -> anyhow::Result<tokio::runtime::Runtime> {
    tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .context("cannot start the asynchronous runtime")
}
