//! `wad-cosim train encoder`.

use super::{show, with_exit};
use crate::cli::progress::Bar;
use crate::cli::{Exit, answer, dataset};
use clap::{ValueEnum, ValueHint};
use std::path::PathBuf;
use wad_cosim::train::encoder::{Progress, TrainOptions, Trained, train};

const EXAMPLES: &str = "\
Examples:
  wad-cosim dataset collect --frames 20000 --out data/town3 --jobs 2
  wad-cosim train encoder --data data/town3 --out runs/encoder --epochs 30
  wad-cosim train encoder --data data/town3 --out runs/encoder --epochs 60 --resume
  wad-cosim train encoder --data data/town3 --out runs/fast --bfloat16 --batch 64 --learning-rate 1e-3 --epochs 8
  wad-cosim train encoder --data data/town3 --out runs/gpu --device cuda --batch 256 --max-minutes 8

The best network by validation is DIR/encoder.safetensors; losses are in DIR/metrics.jsonl and for TensorBoard.";

/// Train the encoder-decoder on the transformed images of a dataset.
#[derive(clap::Args, Debug)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// The dataset's folder (`wad-cosim dataset collect`).
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath)]
    data: PathBuf,
    /// Folder for weights, checkpoint and losses.
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath)]
    out: PathBuf,
    /// Epochs over the training images.
    #[arg(long, value_name = "N", default_value_t = 50)]
    epochs: u64,
    /// Images per step.
    #[arg(long, value_name = "N", default_value_t = 128)]
    batch: usize,
    /// Most steps per epoch; validation follows each epoch.
    #[arg(long, value_name = "N", default_value_t = 600)]
    epoch_steps: usize,
    /// Device to train on.
    #[arg(long, value_enum, default_value_t = Device::Cpu)]
    device: Device,
    /// Adam's learning rate; the paper's is 1e-4.
    #[arg(long, value_name = "X", default_value_t = 1e-4)]
    learning_rate: f64,
    /// Last share of the training, over which the learning rate falls to 0.
    #[arg(long, value_name = "SHARE", default_value_t = 0.3)]
    decay: f64,
    /// L2 regularization.
    #[arg(long, value_name = "X", default_value_t = 1e-5)]
    weight_decay: f64,
    /// Share of channels dropped after the second and the fifth layer.
    #[arg(long, value_name = "SHARE", default_value_t = 0.1)]
    dropout: f64,
    /// Weight of a variational encoder's KL divergence; 0: not variational.
    #[arg(long, value_name = "B", default_value_t = 0.0)]
    beta: f64,
    /// Extra weight of painted pixels (blue, green, red) in the loss.
    #[arg(long, value_name = "W", default_value_t = 4.0)]
    paint_weight: f64,
    /// Extra weight of small painted objects, on top of --paint-weight.
    #[arg(long, value_name = "W", default_value_t = 4.0)]
    small_weight: f64,
    /// Train the latent on the probes' labels too (vehicle and pedestrian in the lane, red light, gap, lane
    /// boundaries), with this weight beside the picture's error; 0: off.
    #[arg(long, value_name = "W", default_value_t = 0.03)]
    label_weight: f64,
    /// Compute convolutions in bfloat16: twice as fast on processors that have it.
    #[arg(long)]
    bfloat16: bool,
    /// Do not augment the light of the training images.
    #[arg(long)]
    no_augment: bool,
    /// Seed of everything random.
    #[arg(long, default_value_t = 0, value_name = "N")]
    seed: u64,
    /// Threads of libtorch on the CPU.
    #[arg(long, value_name = "N", default_value_t = 1)]
    threads: i32,
    /// Memory for images (GB); if there are more, they take turns [default: 6 on the CPU, 40 on a GPU].
    #[arg(long, value_name = "GB")]
    resident_gb: Option<f64>,
    /// Continue the training in --out.
    #[arg(long)]
    resume: bool,
    /// Accept an unfinished dataset.
    #[arg(long)]
    partial: bool,
    /// Stop after this wall time.
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
    let sane = args.epochs > 0
        && args.batch > 0
        && args.learning_rate > 0.0
        && (0.0..1.0).contains(&args.dropout)
        && [
            args.beta,
            args.paint_weight,
            args.small_weight,
            args.label_weight,
            args.weight_decay,
            args.decay,
        ]
        .iter()
        .all(|x| x.is_finite() && *x >= 0.0);
    if !sane {
        return Err(Exit::Input.because(anyhow::anyhow!(
            "--epochs, --batch and --learning-rate must be more than 0, --dropout below 1, the other numbers \
             0 or more"
        )));
    }
    Ok(TrainOptions {
        epochs: args.epochs,
        batch: args.batch,
        epoch_steps: args.epoch_steps.max(1),
        learning_rate: args.learning_rate,
        decay: args.decay,
        weight_decay: args.weight_decay,
        dropout: args.dropout,
        beta: args.beta,
        paint_weight: args.paint_weight,
        small_weight: args.small_weight,
        label_weight: args.label_weight,
        bfloat16: args.bfloat16,
        augment: !args.no_augment,
        seed: args.seed,
        partial: args.partial,
        resident_gb: args.resident_gb.unwrap_or(if args.device == Device::Cuda { 40.0 } else { 6.0 }),
        time_limit: dataset::minutes(args.max_minutes)?.map(|limit| limit.as_secs_f64()),
        ..TrainOptions::new(&args.data, &args.out)
    })
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
    format!(
        "{}: {} epochs, {} steps on {} images in {:.0} s ({:.0} images/s)\n\
         best after epoch {}: validation loss {:.5}, PSNR {:.2} dB, painted IoU {:.3} on {} images\n{}",
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
        if t.interrupted { "interrupted; --resume continues from the last epoch\n" } else { "" },
    )
}
