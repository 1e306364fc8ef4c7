//! `wad-cosim train encoder`.

use super::{ended, show, with_exit};
use crate::cli::progress::Bar;
use crate::cli::{Exit, answer, dataset};
use clap::{ValueEnum, ValueHint};
use std::path::PathBuf;
use wad_cosim::train::encoder::{Progress, TrainOptions, Trained, train};
use wad_cosim::train::run::saved;

const EXAMPLES: &str = "\
Examples:
  wad-cosim dataset collect --frames 20000 --out data/town3 --jobs 2
  wad-cosim train encoder --data data/town3 --out runs/encoder --epochs 30
  wad-cosim train encoder --out runs/encoder --epochs 60 --resume
  wad-cosim train encoder --data data/town3 --out runs/fast --bfloat16 --batch 64 --learning-rate 1e-3 --epochs 8
  wad-cosim train encoder --data data/town3 --out runs/gpu --device cuda --batch 256 --max-minutes 8

The best network by validation is DIR/encoder.safetensors; losses are in DIR/metrics.jsonl and for TensorBoard.";

/// Train the encoder-decoder on the transformed images of a dataset.
#[derive(clap::Args, Debug)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// The dataset's folder (`wad-cosim dataset collect`).
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath, required_unless_present = "resume")]
    data: Option<PathBuf>,
    /// Folder for weights, checkpoint and losses.
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath)]
    out: PathBuf,
    /// Epochs over the training images [default: 50].
    #[arg(long, value_name = "N")]
    epochs: Option<u64>,
    /// Images per step [default: 128].
    #[arg(long, value_name = "N")]
    batch: Option<usize>,
    /// Most steps per epoch; validation follows each epoch [default: 600].
    #[arg(long, value_name = "N")]
    epoch_steps: Option<usize>,
    /// Device to train on.
    #[arg(long, value_enum, default_value_t = Device::Cpu)]
    device: Device,
    /// Adam's learning rate; the paper's is 1e-4 [default: 0.0001].
    #[arg(long, value_name = "X")]
    learning_rate: Option<f64>,
    /// Last share of the training, over which the learning rate falls to 0 [default: 0.3].
    #[arg(long, value_name = "SHARE")]
    decay: Option<f64>,
    /// L2 regularization [default: 0.00001].
    #[arg(long, value_name = "X")]
    weight_decay: Option<f64>,
    /// Share of channels dropped after the second and the fifth layer [default: 0.1].
    #[arg(long, value_name = "SHARE")]
    dropout: Option<f64>,
    /// Weight of a variational encoder's KL divergence; 0: not variational [default: 0].
    #[arg(long, value_name = "B")]
    beta: Option<f64>,
    /// Extra weight of painted pixels (blue, green, red) in the loss [default: 4].
    #[arg(long, value_name = "W")]
    paint_weight: Option<f64>,
    /// Extra weight of small painted objects, on top of --paint-weight [default: 4].
    #[arg(long, value_name = "W")]
    small_weight: Option<f64>,
    /// Train the latent on the probes' labels too (vehicle and pedestrian in the lane, red light, gap, lane
    /// boundaries), with this weight beside the picture's error; 0: off [default: 0.03].
    #[arg(long, value_name = "W")]
    label_weight: Option<f64>,
    /// Compute convolutions in bfloat16: twice as fast on processors that have it.
    #[arg(long)]
    bfloat16: bool,
    /// Do not augment the light of the training images.
    #[arg(long)]
    no_augment: bool,
    /// Seed of everything random [default: 0].
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Threads of libtorch on the CPU.
    #[arg(long, value_name = "N", default_value_t = 1)]
    threads: i32,
    /// Memory for images (GB), for one shard or more; if there are more, they take turns [default: 6 on the CPU, 40 on a
    /// GPU].
    #[arg(long, value_name = "GB")]
    resident_gb: Option<f64>,
    /// Continue the training in --out with its options; only --epochs, --max-minutes, --device, --threads and
    /// --resident-gb may be others.
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

#[derive(Clone, Copy, Debug, PartialEq, ValueEnum)]
pub enum Device {
    Cpu,
    Cuda,
}

impl Device {
    /// libtorch's device. `shapes_repeat`: cuDNN tries all its algorithms for each new shape of tensors and keeps the
    /// fastest.
    ///
    /// # Errors
    /// This machine or this libtorch has no GPU.
    pub fn open(self, shapes_repeat: bool) -> anyhow::Result<tch::Device> {
        match self {
            Self::Cpu => Ok(tch::Device::Cpu),
            Self::Cuda if tch::Cuda::is_available() => {
                tch::Cuda::cudnn_set_benchmark(shapes_repeat);
                Ok(tch::Device::Cuda(0))
            }
            Self::Cuda => Err(Exit::Input.because(anyhow::anyhow!(
                "--device cuda: libtorch finds no GPU here; use --device cpu, or a libtorch built for CUDA on a \
                 machine with one"
            ))),
        }
    }
}

/// Runs the command.
pub fn run(args: Args) -> anyhow::Result<Exit> {
    wad_cosim::torch::threads(args.threads);
    let device = args.device.open(true)?;
    let options = options(&args)?;
    let interrupt = crate::cli::interrupt()?.flag();
    let bar = Bar::new(0, "steps");
    let result = train(&options, device, args.resume, &interrupt, |progress| show(&bar, progress, words));
    bar.clear();
    let trained = result.map_err(with_exit)?;
    answer(&report(&trained), args.json, &trained)?;
    Ok(if trained.interrupted { Exit::Interrupted } else { Exit::Done })
}

fn options(args: &Args) -> anyhow::Result<TrainOptions> {
    let base = if args.resume {
        saved(&args.out).map_err(with_exit)?
    } else {
        let new = TrainOptions::new(&args.data.clone().unwrap_or_default(), &args.out);
        TrainOptions { resident_gb: if args.device == Device::Cuda { 40.0 } else { new.resident_gb }, ..new }
    };
    let options = TrainOptions {
        data: args.data.clone().unwrap_or(base.data),
        out: args.out.clone(),
        epochs: args.epochs.unwrap_or(base.epochs),
        batch: args.batch.unwrap_or(base.batch),
        epoch_steps: args.epoch_steps.unwrap_or(base.epoch_steps).max(1),
        learning_rate: args.learning_rate.unwrap_or(base.learning_rate),
        decay: args.decay.unwrap_or(base.decay),
        weight_decay: args.weight_decay.unwrap_or(base.weight_decay),
        dropout: args.dropout.unwrap_or(base.dropout),
        beta: args.beta.unwrap_or(base.beta),
        paint_weight: args.paint_weight.unwrap_or(base.paint_weight),
        small_weight: args.small_weight.unwrap_or(base.small_weight),
        label_weight: args.label_weight.unwrap_or(base.label_weight),
        bfloat16: args.bfloat16 || base.bfloat16,
        augment: base.augment && !args.no_augment,
        seed: args.seed.unwrap_or(base.seed),
        partial: args.partial || base.partial,
        resident_gb: args.resident_gb.unwrap_or(base.resident_gb),
        time_limit: dataset::minutes(args.max_minutes)?
            .map_or(base.time_limit, |limit| Some(limit.as_secs_f64())),
    };
    let sane = options.epochs > 0
        && options.batch > 0
        && options.learning_rate > 0.0
        && (0.0..1.0).contains(&options.dropout)
        && [
            options.beta,
            options.paint_weight,
            options.small_weight,
            options.label_weight,
            options.weight_decay,
            options.decay,
        ]
        .iter()
        .all(|x| x.is_finite() && *x >= 0.0);
    if !sane {
        return Err(Exit::Input.because(anyhow::anyhow!(
            "--epochs, --batch and --learning-rate must be more than 0, --dropout below 1, the other numbers \
             0 or more"
        )));
    }
    Ok(options)
}

/// The progress line.
fn words(p: &Progress) -> String {
    match p.validation {
        Some(v) => {
            format!("validation loss {:.5}, PSNR {:.2} dB, painted IoU {:.3}", v.loss, v.psnr, v.painted_iou)
        }
        None => format!("loss {:.5}", p.loss),
    }
}

fn report(t: &Trained) -> String {
    let text = format!(
        "{}: {} epochs, {} steps on {} images in {:.0} s ({:.0} images/s)\n\
         best after epoch {}: validation loss {:.5}, PSNR {:.2} dB, painted IoU {:.3} on {} images\n",
        t.encoder.display(),
        t.epochs,
        t.steps,
        t.images,
        t.wall_seconds,
        t.images_per_second,
        t.best_epoch,
        t.best.loss,
        t.best.psnr,
        t.best.painted_iou,
        t.validation_images,
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
        options(&Line::parse_from([&["encoder", "--out", out][..], words].concat()).args).unwrap()
    }

    #[test]
    fn a_resumed_training_keeps_what_is_not_given() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().to_str().unwrap();
        let first = [
            &["--data", "data/town3", "--batch", "64", "--learning-rate", "1e-3", "--decay", "0.5"][..],
            &["--dropout", "0", "--weight-decay", "0", "--bfloat16", "--no-augment", "--device", "cuda"],
        ];
        let first = asked(out, &first.concat());
        std::fs::write(folder.path().join("config.json"), serde_json::to_vec(&first).unwrap()).unwrap();
        assert_eq!(asked(out, &["--resume"]), first);
        let longer = asked(out, &["--resume", "--epochs", "60", "--resident-gb", "2"]);
        assert_eq!(longer, TrainOptions { epochs: 60, resident_gb: 2.0, ..first });
    }
}
