//! `wad-cosim report`: pictures and tables; one file each.

#[cfg(feature = "learn")]
mod latents;
#[cfg(feature = "learn")]
mod learning;
mod results;
mod reward;

use super::Exit;
use clap::{Subcommand, ValueHint};
use std::path::PathBuf;
use wad_cosim::eval::report::Pool;

const EXAMPLES: &str = "\
Examples:
  wad-cosim report runs/nocrash                               runs/nocrash/report/index.html, .md, .csv, .tex
  wad-cosim report runs/nocrash runs/corl --out report        several suites on one page
  wad-cosim report runs/* --out report --markdown docs/results.md
  wad-cosim report runs/truth runs/eyes --out report          one suite behind two detectors: a line each
  wad-cosim report runs/seeds --pool wad-t=t1.safetensors,t2.safetensors,t3.safetensors
  wad-cosim report learning runs/t1 runs/t2 --out pictures  learning curves: folders of `train agent`";

/// Make a report of evaluations, or pictures of trainings, of an encoder or of the reward.
#[derive(clap::Args, Debug)]
#[command(after_help = EXAMPLES, args_conflicts_with_subcommands = true)]
pub struct Args {
    #[command(subcommand)]
    what: Option<What>,
    /// Folders that `eval` wrote.
    #[arg(value_name = "RUN", value_hint = ValueHint::DirPath)]
    runs: Vec<PathBuf>,
    /// Folder for the report [default: `report` in the first run's folder].
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath)]
    out: Option<PathBuf>,
    /// Also write the Markdown tables to this file.
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    markdown: Option<PathBuf>,
    /// Agents that share a line of each table, such as trainings with other seeds; may be given several times.
    #[arg(long = "pool", value_name = "NAME=AGENT,AGENT")]
    pools: Vec<Pool>,
    /// Pictures of failures per suite.
    #[arg(long, value_name = "N", default_value_t = 24)]
    thumbnails: usize,
    /// Print one JSON object as the last line of stdout; everything else goes to stderr.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Draw transformed images above their reconstructions (the paper's figure 5).
    #[cfg(feature = "learn")]
    Latents(latents::Args),
    /// Draw learning curves of trainings, with seeds as a band.
    #[cfg(feature = "learn")]
    Learning(learning::Args),
    /// Plot the reward's six terms (docs/reward.md).
    Reward(reward::Args),
}

/// Runs the command.
pub fn run(args: Args) -> anyhow::Result<Exit> {
    match args.what {
        #[cfg(feature = "learn")]
        Some(What::Latents(args)) => latents::run(&args),
        #[cfg(feature = "learn")]
        Some(What::Learning(args)) => learning::run(&args),
        Some(What::Reward(args)) => reward::run(&args),
        None if args.runs.is_empty() => Err(Exit::Input.because(anyhow::anyhow!(
            "nothing to report: give folders that `eval --out` wrote, or `latents`, `learning` or `reward`"
        ))),
        None => results::run(
            &args.runs,
            args.out.as_deref(),
            args.markdown.as_deref(),
            args.thumbnails,
            &args.pools,
            args.json,
        ),
    }
}
