//! An encoder training's options, progress and metrics.

use crate::train::run;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Options of an encoder's training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrainOptions {
    /// The dataset's folder.
    pub data: PathBuf,
    /// The training's folder.
    pub out: PathBuf,
    /// Epochs in total.
    pub epochs: u64,
    /// Images per step.
    pub batch: usize,
    /// Most batches per epoch.
    pub epoch_steps: usize,
    /// Adam's learning rate; the paper's is 1e-4.
    pub learning_rate: f64,
    /// Last share of the training, over which the learning rate falls to 0.
    pub decay: f64,
    /// L2 regularization: Adam's weight decay.
    pub weight_decay: f64,
    /// Share of channels dropped after the second and the fifth layer.
    pub dropout: f64,
    /// Weight of a variational encoder's KL divergence, per pixel's square error; 0: not variational.
    pub beta: f64,
    /// Additional weight of painted pixels.
    pub paint_weight: f64,
    /// Additional weight of small painted objects.
    pub small_weight: f64,
    /// Weight of the linear heads that predict the probes' labels from the latent; 0: none.
    #[serde(default)]
    pub label_weight: f64,
    /// Convolutions in bfloat16; parameters and optimiser stay in single precision.
    #[serde(default)]
    pub bfloat16: bool,
    /// Augment the light of the training images.
    pub augment: bool,
    /// The seed of everything random.
    pub seed: u64,
    /// Accept an unfinished dataset.
    pub partial: bool,
    /// Memory for resident images (GB); if there are more, they take turns, epoch by epoch.
    pub resident_gb: f64,
    /// Time limit of the training (s); the last epoch is cut short.
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

/// The result of a validation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Validation {
    /// The training's loss.
    pub loss: f64,
    /// PSNR, mean over images (dB).
    pub psnr: f64,
    /// Painted pixels: intersection over union of image and reconstruction, over all images.
    pub painted_iou: f64,
    /// KL divergence of a variational encoder; 0 of others.
    pub divergence: f64,
    /// The heads' loss on the labels; 0 without heads.
    #[serde(default)]
    pub labels: f64,
}

/// A line of `metrics.jsonl`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct EpochRecord {
    /// The epoch, from 1.
    pub epoch: u64,
    /// Steps so far.
    pub step: u64,
    /// Training images so far.
    pub images: u64,
    /// Mean loss over the epoch.
    pub train_loss: f64,
    /// Validation after the epoch.
    pub validation: Validation,
    /// The learning rate of the epoch's last step.
    pub learning_rate: f64,
    /// It is the best so far.
    pub best: bool,
    /// Wall time so far (s).
    pub wall_seconds: f64,
    /// Images per second of training.
    pub images_per_second: f64,
}

/// The result of a training; `summary.json`.
#[derive(Clone, Debug, Serialize)]
pub struct Trained {
    /// The training's folder.
    pub out: PathBuf,
    /// The best network's file.
    pub encoder: PathBuf,
    /// Epochs trained.
    pub epochs: u64,
    /// Steps trained.
    pub steps: u64,
    /// The epoch of the best network.
    pub best_epoch: u64,
    /// The best network's validation.
    pub best: Validation,
    /// Training images.
    pub images: usize,
    /// Validation images.
    pub validation_images: usize,
    /// Wall time (s).
    pub wall_seconds: f64,
    /// Images per second of training.
    pub images_per_second: f64,
    /// The user interrupted.
    pub interrupted: bool,
}

/// The training's progress.
pub type Progress = run::Progress<Validation>;
