//! `wad-cosim eval encoder`: reconstruction, painted objects and linear probes on unseen frames.

use crate::cli::progress::Bar;
use crate::cli::{Exit, answer, dataset as data};
use clap::ValueHint;
use std::path::PathBuf;
use wad_cosim::dataset::{Dataset, Role};
use wad_cosim::encoder_score::judge::{JudgeError, Judgement, LinearScore, ProbeScore, judge};
use wad_cosim::latent::TchEncoder;

const EXAMPLES: &str = "\
Examples:
  wad-cosim dataset collect --town town5 --frames 2000 --seed 5 --out data/town5 \\
      --weather ClearNoon,CloudyNoon,SoftRainNoon,WetCloudySunset,MidRainyNoon
  wad-cosim eval encoder --data data/town5 --probe-data data/town3
  wad-cosim eval encoder --encoder runs/encoder --data data/town5 --probe-data data/town3 --json";

/// Score an encoder: how much of the transformed image its latent holds.
#[derive(clap::Args, Debug)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// A .safetensors file, a folder of `train encoder`, or a bundled encoder.
    #[arg(long, value_name = "NAME", default_value = "default")]
    encoder: String,
    /// Frames to measure on: a dataset of town5.
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath)]
    data: PathBuf,
    /// Frames to fit the linear probes on: a dataset of town3.
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath)]
    probe_data: PathBuf,
    /// Number of frames to measure on, evenly over the dataset.
    #[arg(long, value_name = "N", default_value_t = 2000)]
    frames: usize,
    /// Number of frames to fit the probes on.
    #[arg(long, value_name = "N", default_value_t = 20_000)]
    probe_frames: usize,
    /// Accept unfinished datasets.
    #[arg(long)]
    partial: bool,
    /// Threads of libtorch.
    #[arg(long, value_name = "N", default_value_t = 1)]
    threads: i32,
    /// Print one JSON object as the last line of stdout; everything else goes to stderr.
    #[arg(long)]
    json: bool,
}

/// The exit code of a scoring error.
pub fn with_exit(error: JudgeError) -> anyhow::Error {
    match error {
        JudgeError::Dataset(error) => data::with_exit(error),
        JudgeError::Latent(error) => Exit::Other.because(error),
    }
}

/// Runs the command.
pub fn run(args: &Args) -> anyhow::Result<Exit> {
    wad_cosim::torch::threads(args.threads);
    let encoder = TchEncoder::find(&args.encoder).map_err(|e| Exit::Input.because(e))?;
    let measured = Dataset::open(&args.data, args.partial).map_err(data::with_exit)?;
    let fitted = Dataset::open(&args.probe_data, args.partial).map_err(data::with_exit)?;
    fitted.require_training().map_err(data::with_exit)?;
    if measured.manifest.role == Role::Training {
        crate::cli::note(format_args!(
            "note: {} is of the training town: these frames may be trained on",
            args.data.display()
        ));
    }
    let total = args.frames.min(measured.frames()) + args.probe_frames.min(fitted.frames());
    let bar = Bar::new(total as u64, "frames");
    let counts = (args.frames.max(1), args.probe_frames.max(1));
    let result = judge(&encoder, &measured, &fitted, counts, |done| bar.show(done as u64, ""));
    bar.clear();
    let judgement = result.map_err(with_exit)?;
    let text = text(&judgement);
    answer(&text, args.json, &judgement)?;
    Ok(Exit::Done)
}

fn text(j: &Judgement) -> String {
    let probe = |name: &str, p: &ProbeScore| {
        let auc = p.auc.map_or("  -  ".to_string(), |auc| format!("{auc:.3}"));
        format!(
            "  {name:34} AUC {auc}  ({} of the fitted, {} of the measured)\n",
            p.fitted_positives, p.measured_positives
        )
    };
    let linear = |name: &str, unit: &str, s: &LinearScore| {
        let number = |x: Option<f64>| x.map_or("  -  ".to_string(), |x| format!("{x:.3}"));
        format!(
            "  {name:34} R2  {}, median error {} {unit}  ({} fitted, {} measured)\n",
            number(s.r2),
            number(s.median_error),
            s.fitted,
            s.measured
        )
    };
    let kept = |name: &str, share: f64, n: u64| format!("  {name:34} {:.1} % of {n}\n", 100.0 * share);
    let weathers: Vec<String> = j.psnr_by_weather.iter().map(|(w, db)| format!("{w} {db:.1}")).collect();
    format!(
        "encoder {} on {} frames of {}\n  PSNR {:.2} dB, SSIM {:.3}, blue IoU {:.3}; {:.2} ms CPU an image\n  PSNR by weather: {}\n\
         painted objects kept (blue IoU 0.5):\n{}{}{}\
         linear probes, fitted on {} frames of {}:\n{}{}{}{}{}{}{}{}{}\
         the same from the picture itself, by cells of paint:\n{}{}{}{}",
        j.encoder,
        j.frames,
        j.town,
        j.psnr_db,
        j.ssim,
        j.blue_iou,
        j.encode_ms,
        weathers.join(", "),
        kept("6x6 pixels or more", j.kept_large, j.objects.large.objects),
        kept("3x3 to 6x6", j.kept_small, j.objects.small.objects),
        kept("smaller", j.kept_tiny, j.objects.tiny.objects),
        j.probe_frames,
        j.probe_town,
        probe("vehicle in the lane within 20 m", &j.lead),
        probe("pedestrian in the lane within 15 m", &j.pedestrian),
        probe("red light", &j.red),
        linear("lateral offset in the lane", "m", &j.lateral),
        linear("heading error", "rad", &j.heading),
        linear("gap within 20 m", "m", &j.gap),
        probe("vehicle, where the route is straight", &j.lead_straight),
        linear("middle of the painted boundaries", "m", &j.middle),
        linear("their slope", "", &j.slope),
        probe("vehicle in the lane within 20 m", &j.lead_of_picture),
        probe("pedestrian in the lane within 15 m", &j.pedestrian_of_picture),
        linear("middle of the painted boundaries", "m", &j.middle_of_picture),
        linear("their slope", "", &j.slope_of_picture),
    )
}
