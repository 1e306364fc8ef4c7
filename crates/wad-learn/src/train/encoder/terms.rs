//! An encoder training's options, progress and metrics.

use crate::train::run;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// How to train.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrainOptions {
    pub data: PathBuf,
    pub out: PathBuf,
    pub epochs: u64,
    pub batch: usize,
    /// Most batches to an epoch.
    pub epoch_steps: usize,
    /// Adam's; the paper's is 1e-4.
    pub learning_rate: f64,
    /// Over this last share of the training the learning rate falls to 0.
    pub decay: f64,
    /// L2 regularization: Adam's weight decay.
    pub weight_decay: f64,
    pub dropout: f64,
    /// Weight of the divergence of a variational encoder, per pixel's square error; 0: not variational.
    pub beta: f64,
    /// How much more painted pixels count, and how much more of that small objects.
    pub paint_weight: f64,
    pub small_weight: f64,
    /// Weight of the linear heads that predict the probes' labels from the latent; 0: none.
    #[serde(default)]
    pub label_weight: f64,
    /// Convolutions in bfloat16; parameters and optimiser stay in single precision.
    #[serde(default)]
    pub bfloat16: bool,
    /// Vary the light of the training images.
    pub augment: bool,
    pub seed: u64,
    /// Use a dataset that was not collected to its end.
    pub partial: bool,
    /// Images that may be resident (GB); more take turns, epoch by epoch.
    pub resident_gb: f64,
    /// Ends the training, with its last epoch cut short (s).
    pub time_limit: Option<f64>,
}

impl TrainOptions {
    /// The defaults of `wad-cosim train encoder`.
    pub fn new(data: &Path, out: &Path) -> Self {
        Self {
            data: data.to_path_buf(),
            out: out.to_path_buf(),
            epochs: 50,
            batch: 128,
            epoch_steps: 600,
            learning_rate: 1e-4,
            decay: 0.3,
            weight_decay: 1e-5,
            dropout: 0.1,
            beta: 0.0,
            paint_weight: 4.0,
            small_weight: 4.0,
            label_weight: 0.03,
            bfloat16: false,
            augment: true,
            seed: 0,
            partial: false,
            resident_gb: 6.0,
            time_limit: None,
        }
    }
}

/// What validation says.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Validation {
    /// The training's loss.
    pub loss: f64,
    /// Mean over images (dB).
    pub psnr: f64,
    /// Of painted pixels: intersection over union of wanted and made, over all images.
    pub painted_iou: f64,
    pub divergence: f64,
    /// The heads' loss on the labels; 0 without heads.
    #[serde(default)]
    pub labels: f64,
}

/// A line of `metrics.jsonl`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct EpochRecord {
    pub epoch: u64,
    pub step: u64,
    pub images: u64,
    pub train_loss: f64,
    pub validation: Validation,
    pub learning_rate: f64,
    pub best: bool,
    pub wall_seconds: f64,
    pub images_per_second: f64,
}

/// What a training came to; `summary.json`.
#[derive(Clone, Debug, Serialize)]
pub struct Trained {
    pub out: PathBuf,
    /// The best network's file.
    pub encoder: PathBuf,
    pub epochs: u64,
    pub steps: u64,
    pub best_epoch: u64,
    pub best: Validation,
    pub images: usize,
    pub validation_images: usize,
    pub wall_seconds: f64,
    pub images_per_second: f64,
    pub interrupted: bool,
}

/// How far it is.
pub type Progress = run::Progress<Validation>;
