//! `wad-cosim train detector`.

use super::encoder::Device;
use super::{ended, show, with_exit};
use crate::cli::progress::Bar;
use crate::cli::{Exit, answer, dataset};
use clap::{ValueEnum, ValueHint};
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;
use wad_cosim::dataset::{self as frames, CollectOptions, collect};
use wad_cosim::perception::centernet::{self, Sees};
use wad_cosim::train::detector::{Progress, TrainOptions, Trained, train};
use wad_cosim::train::run::saved;

const EXAMPLES: &str = "\
Examples:
  wad-cosim train detector --collect 8000 --out runs/detector
  wad-cosim dataset collect --frames 8000 --every 1.5 --camera --out data/detector
  wad-cosim dataset collect --frames 3000 --showing bus,truck,bicycle,motorcycle,bench --camera --out data/rare
  wad-cosim train detector --data data/detector --data data/rare --out runs/detector --epochs 12
  wad-cosim train detector --out runs/detector --epochs 20 --resume
  wad-cosim train detector --data data/detector --init centernet --out runs/better --learning-rate 5e-4
  wad-cosim train detector --data data/detector --init centernet --epochs 0 --out runs/ranges
  wad-cosim train detector --data data/detector --out runs/paper --backbone resnet50_v2 --device cuda
  wad-cosim eval detector --detector centernet:runs/detector/detector.safetensors

The best network by validation is DIR/detector.safetensors; losses are in DIR/metrics.jsonl and for TensorBoard.";

/// Examples of `train eyes`.
pub const EYES_EXAMPLES: &str = "\
Examples:
  wad-cosim dataset collect --frames 8000 --every 1.5 --camera --vary all --out data/road
  wad-cosim train eyes --data data/road --init centernet --batch 8 --out runs/eyes
  wad-cosim train eyes --out runs/eyes --epochs 20 --resume
  wad-cosim eval eyes --detector eyes:runs/eyes/detector.safetensors

The best network by validation is DIR/detector.safetensors; losses are in DIR/metrics.jsonl and for TensorBoard.";

/// Train CenterNet on the camera's pictures of a dataset.
#[derive(clap::Args, Debug)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// The feature extractor; `train eyes` has light alone [default: light].
    #[arg(long, value_enum)]
    backbone: Option<Backbone>,
    /// The dataset's folder (`wad-cosim dataset collect --camera`); if given several times, all are mixed.
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath, required_unless_present_any = ["collect", "resume"])]
    data: Vec<PathBuf>,
    /// Collect this many frames of town3 first, into --data, or into data in --out.
    #[arg(long, value_name = "N")]
    collect: Option<usize>,
    /// Folder for weights, checkpoint and losses.
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath)]
    out: PathBuf,
    /// Start with these weights instead of new ones: centernet or eyes (the bundled ones), or
    /// centernet:FILE or eyes:FILE.
    #[arg(long, value_name = "NAME")]
    init: Option<String>,
    /// Only this head learns, and all else stays as it is in --init; for `train eyes`.
    #[arg(long, value_enum, requires = "init")]
    only: Option<Part>,
    /// Epochs over the training frames; 0: nothing is learned, but the weights of --init get new ranges for 8 bits
    /// [default: 12].
    #[arg(long, value_name = "N")]
    epochs: Option<u64>,
    /// Pictures per step [default: 16].
    #[arg(long, value_name = "N")]
    batch: Option<usize>,
    /// Most steps per epoch; validation follows each epoch [default: 400].
    #[arg(long, value_name = "N")]
    epoch_steps: Option<usize>,
    /// Width and height of the crops that most steps use; 0: whole pictures only [default: 320x320; `train eyes`: 0,
    /// because crops do not say where the ego's lane is].
    #[arg(long, value_name = "WxH", value_parser = window)]
    window: Option<(usize, usize)>,
    /// Compute in bfloat16: twice as fast on processors that have it, very slow on others.
    #[arg(long)]
    bfloat16: bool,
    /// Device to train on.
    #[arg(long, value_enum, default_value_t = Device::Cpu)]
    device: Device,
    /// AdamW's highest learning rate [default: 0.0015].
    #[arg(long, value_name = "X")]
    learning_rate: Option<f64>,
    /// AdamW's weight decay [default: 0.001].
    #[arg(long, value_name = "X")]
    weight_decay: Option<f64>,
    /// Do not augment weather, light and colours of the training pictures.
    #[arg(long)]
    no_augment: bool,
    /// Seed of everything random [default: 0].
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Threads of libtorch on the CPU.
    #[arg(long, value_name = "N", default_value_t = 1)]
    threads: i32,
    /// Threads that load pictures [default: 1].
    #[arg(long, value_name = "N")]
    workers: Option<usize>,
    /// Most frames used for validation [default: 300].
    #[arg(long, value_name = "N")]
    validation_frames: Option<usize>,
    /// Continue the training in --out with its options; only --epochs, --max-minutes, --device, --threads and
    /// --workers may be others.
    #[arg(long)]
    resume: bool,
    /// Accept an unfinished dataset.
    #[arg(long)]
    partial: bool,
    /// Stop after this wall time, that before a --resume included.
    #[arg(long, value_name = "MINUTES")]
    max_minutes: Option<f64>,
    /// Print the result as one JSON line on stdout.
    #[arg(long)]
    json: bool,
}

/// `320x320`, or 0.
fn window(text: &str) -> Result<(usize, usize), String> {
    if text == "0" {
        return Ok((0, 0));
    }
    let (width, height) = text.split_once('x').ok_or("expected WIDTHxHEIGHT or 0")?;
    let side = |text: &str, most: usize| match text.parse::<usize>() {
        Ok(side) if side > 0 && side.is_multiple_of(32) && side <= most => Ok(side),
        _ => Err(format!("expected a multiple of 32 up to {most}, found `{text}`")),
    };
    Ok((side(width, 512)?, side(height, 320)?))
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Part {
    /// Signs; plates are copied into every picture.
    Signs,
    /// What is road.
    Area,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Backbone {
    /// Plain convolutions, 0.9 million parameters; real time on one core.
    Light,
    /// The paper's network.
    #[value(name = "resnet50_v2")]
    Resnet50V2,
}

/// Runs the command.
pub fn run(args: Args, sees: Sees) -> anyhow::Result<Exit> {
    wad_cosim::torch::threads(args.threads);
    // Each batch has more or fewer plates of signs.
    let device = args.device.open(false)?;
    let options = options(&args, sees)?;
    let interrupt = crate::cli::interrupt()?.flag();
    if let Some(count) = args.collect
        && !collected(count, &options.data, options.seed, &interrupt)?
    {
        return Ok(Exit::Interrupted);
    }
    let bar = Bar::new(0, "steps");
    let result = train(&options, device, args.resume, &interrupt, |progress| show(&bar, progress, words));
    bar.clear();
    let trained = result.map_err(with_exit)?;
    answer(&report(&trained), args.json, &trained)?;
    Ok(if trained.interrupted { Exit::Interrupted } else { Exit::Done })
}

fn options(args: &Args, sees: Sees) -> anyhow::Result<TrainOptions> {
    let base = if args.resume {
        saved(&args.out).map_err(with_exit)?
    } else {
        let new = TrainOptions::new(centernet::Backbone::Light, &args.out.join("data"), &args.out);
        TrainOptions { window: new.window.filter(|_| sees == Sees::Objects), ..new }
    };
    let (data, more) = match args.data.split_first() {
        Some((data, more)) => (data.clone(), more.to_vec()),
        None => (base.data, base.more),
    };
    let options = TrainOptions {
        backbone: args.backbone.map_or(base.backbone, |backbone| match backbone {
            Backbone::Light => centernet::Backbone::Light,
            Backbone::Resnet50V2 => centernet::Backbone::Resnet50V2,
        }),
        sees,
        data,
        more,
        out: args.out.clone(),
        init: args.init.clone().or(base.init),
        only: args.only.map_or(base.only, |part| match part {
            Part::Signs => Some(centernet::Part::Signs),
            Part::Area => Some(centernet::Part::Area),
        }),
        epochs: args.epochs.unwrap_or(base.epochs),
        batch: args.batch.unwrap_or(base.batch),
        epoch_steps: args.epoch_steps.unwrap_or(base.epoch_steps).max(1),
        learning_rate: args.learning_rate.unwrap_or(base.learning_rate),
        weight_decay: args.weight_decay.unwrap_or(base.weight_decay),
        window: args.window.map_or(base.window, |window| Some(window).filter(|window| *window != (0, 0))),
        bfloat16: args.bfloat16 || base.bfloat16,
        vary: base.vary && !args.no_augment,
        seed: args.seed.unwrap_or(base.seed),
        partial: args.partial || base.partial,
        workers: args.workers.unwrap_or(base.workers).max(1),
        validation_frames: args.validation_frames.unwrap_or(base.validation_frames).max(1),
        time_limit: dataset::minutes(args.max_minutes)?
            .map_or(base.time_limit, |limit| Some(limit.as_secs_f64())),
    };
    let sane = (options.epochs > 0 || options.init.is_some())
        && options.batch > 0
        && options.learning_rate > 0.0
        && options.learning_rate.is_finite()
        && options.weight_decay >= 0.0
        && args.collect != Some(0);
    if !sane {
        return Err(Exit::Input.because(anyhow::anyhow!(
            "--epochs (without --init), --batch, --learning-rate and --collect must be more than 0, --weight-decay 0 or more"
        )));
    }
    if !sees.backbones().contains(&options.backbone) {
        return Err(Exit::Input.because(anyhow::anyhow!(
            "--backbone {}: expected light, since the heads of `train eyes` fit no other; leave the option out, or use \
             `train detector`",
            options.backbone.name()
        )));
    }
    if options.only.is_some() && (sees != Sees::Road || options.window.is_some()) {
        return Err(Exit::Input.because(anyhow::anyhow!(
            "--only is for `train eyes` on whole pictures (--window 0): no other network has these heads"
        )));
    }
    Ok(options)
}

/// Whether the frames are there.
fn collected(
    count: usize,
    data: &std::path::Path,
    seed: u64,
    interrupt: &AtomicBool,
) -> anyhow::Result<bool> {
    let mut options = CollectOptions::new("town3", count, data);
    options.seed = seed;
    options.camera = true;
    options.every = 1.5;
    options.per_segment = (count / 50).clamp(10, 200);
    let bar = Bar::new(count as u64, "frames");
    let result = collect(&options, interrupt, |frames::Progress { frames, .. }| bar.show(frames as u64, ""));
    bar.clear();
    let collected = result.map_err(dataset::with_exit)?;
    crate::cli::note(format_args!("{}: {} frames", collected.out.display(), collected.frames));
    Ok(!collected.interrupted)
}

/// The progress line.
fn words(p: &Progress) -> String {
    let loss = p.loss;
    match p.validation {
        Some(v) => {
            let road = v.road.map_or_else(String::new, |road| {
                let share = |v: Option<f64>| v.map_or("-".to_string(), |v| format!("{v:.3}"));
                let (found, right) = (share(road.boundaries_found), share(road.lights_right));
                format!(", boundaries found {found}, lights right {right}")
            });
            format!("loss {loss:.3}, mAP@0.5 {:.3}, of boxes 12 to 24 px {:.3}{road}", v.map50, v.map50_small)
        }
        None => format!("loss {loss:.3}"),
    }
}

fn report(t: &Trained) -> String {
    let text = format!(
        "{}: {} epochs, {} steps on {} frames in {:.0} s\n\
         best after epoch {}: mAP@0.5 {:.3} of boxes 24 px high or more, {:.3} of 12 to 24 px, on {} frames\n",
        t.detector.display(),
        t.epochs,
        t.steps,
        t.frames,
        t.wall_seconds,
        t.best_epoch,
        t.best.map50,
        t.best.map50_small,
        t.validation_frames,
    );
    ended(text, t.epochs, t.interrupted)
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        args: Args,
    }

    fn asked(out: &str, words: &[&str]) -> TrainOptions {
        let line = Line::parse_from([&["eyes", "--out", out][..], words].concat());
        options(&line.args, Sees::Road).unwrap()
    }

    #[test]
    fn eyes_have_no_other_backbone_than_light() {
        let line = ["train", "--out", "out", "--data", "data", "--backbone", "resnet50_v2"];
        let args = Line::parse_from(line).args;
        assert!(options(&args, Sees::Objects).is_ok());
        let error = options(&args, Sees::Road).unwrap_err().to_string();
        assert!(error.contains("--backbone resnet50_v2: expected light"), "{error}");
    }

    #[test]
    fn a_resumed_training_keeps_what_is_not_given() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().to_str().unwrap();
        let first = [
            &["--data", "data/detector", "--data", "data/rare", "--init", "eyes", "--only", "signs"][..],
            &["--batch", "8", "--learning-rate", "5e-4", "--seed", "3", "--bfloat16", "--no-augment"],
            &["--workers", "2", "--max-minutes", "5"],
        ];
        let first = asked(out, &first.concat());
        std::fs::write(folder.path().join("config.json"), serde_json::to_vec(&first).unwrap()).unwrap();
        assert_eq!(asked(out, &["--resume"]), first);
        let longer = asked(out, &["--resume", "--epochs", "20", "--max-minutes", "9"]);
        assert_eq!(longer, TrainOptions { epochs: 20, time_limit: Some(540.0), ..first });
    }
}
