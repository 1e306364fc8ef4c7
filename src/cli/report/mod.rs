//! `wad-cosim report`: pictures and tables of what was made; one file each.

#[cfg(feature = "learn")]
mod latents;
mod plot;
mod reward;

use super::Exit;
use clap::Subcommand;

/// Make pictures and tables of what was trained and measured.
#[derive(clap::Args, Debug)]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Transformed images above, their reconstructions below (the paper's figure 5).
    #[cfg(feature = "learn")]
    Latents(latents::Args),
    /// The reward's terms over what they depend on (docs/reward.md).
    Reward(reward::Args),
}

/// Runs the command.
pub fn run(args: Args) -> anyhow::Result<Exit> {
    match args.what {
        #[cfg(feature = "learn")]
        What::Latents(args) => latents::run(&args),
        What::Reward(args) => reward::run(&args),
    }
}
