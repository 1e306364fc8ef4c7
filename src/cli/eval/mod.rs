//! `wad-cosim eval`: one file per thing that is judged.

mod detector;
#[cfg(feature = "learn")]
mod encoder;

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
    /// How much of the transformed image the latent holds.
    #[cfg(feature = "learn")]
    Encoder(encoder::Args),
}

/// Runs the command.
pub fn run(args: Args) -> anyhow::Result<Exit> {
    match args.what {
        What::Detector(args) => detector::run(args),
        #[cfg(feature = "learn")]
        What::Encoder(args) => encoder::run(&args),
    }
}
