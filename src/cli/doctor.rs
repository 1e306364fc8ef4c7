//! `doctor`: what this machine has, and what to do about what is missing.

use super::{Exit, print};

#[derive(clap::Args)]
pub struct Args {
    /// Print one JSON object instead of the table.
    #[arg(long)]
    json: bool,
}

/// Print the findings.
pub fn run(args: Args) -> anyhow::Result<Exit> {
    let _ = args.json;
    print(concat!("wad-cosim ", env!("WAD_COSIM_VERSION"), "\n"))?;
    Ok(Exit::Done)
}
