//! `wad-cosim report latents`: the paper's figure 5.

use crate::cli::eval::encoder::with_exit;
use crate::cli::{Exit, dataset as data, print};
use anyhow::Context;
use clap::ValueHint;
use std::path::PathBuf;
use wad_cosim::camera::Picture;
use wad_cosim::dataset::Dataset;
use wad_cosim::encoder_score::judge::pairs;
use wad_cosim::latent::TchEncoder;
use wad_cosim::perception::{TRANSFORMED_SIZE, TransformedImage};

/// Draw transformed images above their reconstructions (the paper's figure 5).
#[derive(clap::Args, Debug)]
#[command(after_help = "Example:\n  wad-cosim report latents --data data/town5 --out latents.png")]
pub struct Args {
    /// A .safetensors file, a folder of `train encoder`, or a bundled encoder.
    #[arg(long, value_name = "NAME", default_value = "default")]
    encoder: String,
    /// The dataset; its frames are taken evenly.
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath)]
    data: PathBuf,
    /// Pairs in a row, and rows of pairs.
    #[arg(long, value_name = "N", default_value_t = 8)]
    columns: usize,
    #[arg(long, value_name = "N", default_value_t = 2)]
    rows: usize,
    /// PNG file to write.
    #[arg(long, value_name = "FILE", default_value = "latents.png", value_hint = ValueHint::FilePath)]
    out: PathBuf,
    /// Accept an unfinished dataset.
    #[arg(long)]
    partial: bool,
}

/// Pixels between pictures, and between rows of pairs.
const GAP: usize = 4;
const ROW_GAP: usize = 12;

/// Runs the command.
pub fn run(args: &Args) -> anyhow::Result<Exit> {
    let encoder = TchEncoder::find(&args.encoder).map_err(|e| Exit::Input.because(e))?;
    let dataset = Dataset::open(&args.data, args.partial).map_err(data::with_exit)?;
    let (columns, rows) = (args.columns.max(1), args.rows.max(1));
    let pairs = pairs(&encoder, &dataset, columns * rows).map_err(with_exit)?;
    let side = TRANSFORMED_SIZE;
    let height = 2 * side + GAP;
    let mut page = Picture::new(columns * (side + GAP) - GAP, rows * (height + ROW_GAP) - ROW_GAP);
    page.rgb.fill(255);
    let picture =
        |image: &TransformedImage| Picture { width: side, height: side, rgb: image.bytes().to_vec() };
    for (n, (wanted, made)) in pairs.iter().take(columns * rows).enumerate() {
        let (x, y) = (n % columns * (side + GAP), n / columns * (height + ROW_GAP));
        page.paste(&picture(wanted), x, y);
        page.paste(&picture(made), x, y + side + GAP);
    }
    page.save(&args.out)
        .map_err(|e| Exit::Other.because(e))
        .with_context(|| format!("cannot write the picture {}", args.out.display()))?;
    print(&format!("{}\n", args.out.display()))?;
    Ok(Exit::Done)
}
