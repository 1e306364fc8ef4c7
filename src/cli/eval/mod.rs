//! `wad-cosim eval`: one file per thing that is judged.

mod detector;

use super::Exit;
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
}

/// Runs the command.
pub fn run(args: Args) -> anyhow::Result<Exit> {
    match args.what {
        What::Detector(args) => detector::run(args),
    }
}
