//! `wad-cosim train`: one subcommand per network, one file each.

#[cfg(feature = "learn")]
mod detector;
#[cfg(feature = "learn")]
mod encoder;

use super::Exit;
use clap::Subcommand;

/// Train a network.
#[derive(clap::Args, Debug)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand, Debug)]
enum Command {
    /// Train CenterNet on the camera's pictures of a dataset.
    #[cfg(feature = "learn")]
    Detector(Box<detector::Args>),
    /// Train the encoder-decoder on the transformed images of a dataset.
    #[cfg(feature = "learn")]
    Encoder(Box<encoder::Args>),
}

/// Runs the command.
pub fn run(args: Args) -> anyhow::Result<Exit> {
    match args.command {
        #[cfg(feature = "learn")]
        Command::Detector(args) => detector::run(*args),
        #[cfg(feature = "learn")]
        Command::Encoder(args) => encoder::run(*args),
    }
}
