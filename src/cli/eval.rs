//! `wad-cosim eval`: how good things are, against what the simulator knows.

use super::{Exit, eval_sight};
use anyhow::Context;

/// Measure how good perception is, against what the simulator knows.
#[derive(clap::Args, Debug)]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(clap::Subcommand, Debug)]
enum What {
    /// Lane boundaries: precision, recall and lateral error against the painted ones, by weather.
    Lanes(eval_sight::Args),
    /// The vehicle in front: gap and closing speed against the true ones, by distance.
    Lead(eval_sight::Args),
}

/// Runs the command.
pub fn run(args: Args) -> anyhow::Result<Exit> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .context("cannot start the asynchronous runtime")?;
    match args.what {
        What::Lanes(args) => runtime.block_on(eval_sight::lanes(args)),
        What::Lead(args) => runtime.block_on(eval_sight::lead(args)),
    }
}
