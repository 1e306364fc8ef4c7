//! Shared by the trainings of encoder and detector: the folder, the loop over epochs, the errors.
//!
//! ```text
//! out: config.json  checkpoint.safetensors (after each epoch)  the best network
//!      metrics.jsonl and TensorBoard's events (a line, figures per epoch)  summary.json (at the end)
//! ```

use super::images::ImagesError;
use super::tensorboard::EventWriter;
use crate::dataset::DatasetError;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::fs::OpenOptions;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::time::Instant;
use tch::TchError;
use wad_see::perception::PerceptionError;
use wad_see::weights::{Weights, WeightsError};
use wad_sim::telemetry;

/// Why training ended without its end.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    #[error(transparent)]
    Images(#[from] ImagesError),
    #[error(transparent)]
    Weights(#[from] WeightsError),
    #[error(transparent)]
    Perception(#[from] PerceptionError),
    #[error("libtorch: {0}")]
    Torch(#[from] TchError),
    #[error("could not write `{}`: {source}; the last checkpoint is kept", path.display())]
    Write { path: PathBuf, source: std::io::Error },
    #[error("`{}` holds a training already; go on with it by --resume, or name another folder with --out", path.display())]
    Taken { path: PathBuf },
    #[error("`{}` holds no training to resume: expected checkpoint.safetensors in it", path.display())]
    NothingToResume { path: PathBuf },
    #[error("the training in `{}` differs in {what}: expected {asked}, found {found}", path.display())]
    Differs { path: PathBuf, what: &'static str, found: String, asked: String },
    #[error(
        "the loss became {loss} at step {step}: training stopped, `{}` is the last good one; a smaller \
         --learning-rate may help",
        checkpoint.display()
    )]
    NotFinite { loss: f64, step: u64, checkpoint: PathBuf },
}

impl TrainError {
    /// For `map_err`: `path` cannot be written.
    pub(super) fn write(path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_path_buf();
        move |source| Self::Write { path, source }
    }

    /// Whether the user's input is wrong, not this machine.
    pub fn is_input(&self) -> bool {
        match self {
            Self::Dataset(_)
            | Self::Perception(PerceptionError::Detector { .. })
            | Self::Images(ImagesError::Dataset(_))
            | Self::Taken { .. }
            | Self::NothingToResume { .. }
            | Self::Differs { .. } => true,
            Self::Weights(error) => !matches!(error, WeightsError::Io { .. } | WeightsError::Torch(_)),
            _ => false,
        }
    }
}

/// How far a training is; `V` is what validation says.
#[derive(Clone, Copy, Debug)]
pub struct Progress<V> {
    pub epoch: u64,
    /// Steps in all so far, and at the end.
    pub step: u64,
    pub steps: u64,
    pub loss: f64,
    /// At the end of an epoch.
    pub validation: Option<V>,
}

/// The checkpoint in a training's folder.
pub(super) fn checkpoint(out: &Path) -> PathBuf {
    out.join("checkpoint.safetensors")
}

/// Whether `out` holds a training, as `resume` wants it, or none.
pub(super) fn check(out: &Path, resume: bool) -> Result<(), TrainError> {
    match (resume, checkpoint(out).is_file()) {
        (true, false) => Err(TrainError::NothingToResume { path: out.to_path_buf() }),
        (false, true) => Err(TrainError::Taken { path: out.to_path_buf() }),
        _ => Ok(()),
    }
}

/// Makes the folder where it is missing, and writes a JSON file of it.
pub(super) fn write_json(path: &Path, value: &impl Serialize) -> Result<(), TrainError> {
    let folder = path.parent().unwrap_or(path);
    std::fs::create_dir_all(folder).map_err(TrainError::write(folder))?;
    telemetry::write_json(path, value).map_err(|e| TrainError::write(path)(e.source))
}

/// Under which a checkpoint's metadata say how far the training came.
pub(super) const REACHED: &str = "reached";

/// How far the training of this checkpoint came.
pub(super) fn reached<T: DeserializeOwned>(weights: &Weights) -> Result<T, TrainError> {
    let text = weights.metadata.get(REACHED).map_or("", String::as_str);
    let format = |e: serde_json::Error| WeightsError::Format {
        path: weights.path.clone(),
        why: format!("it does not say how far the training came ({e})"),
    };
    Ok(serde_json::from_str(text).map_err(format)?)
}

/// Stops the training in `out` where the loss is no number.
pub(super) fn require_finite(loss: f64, step: u64, out: &Path) -> Result<(), TrainError> {
    if loss.is_finite() {
        return Ok(());
    }
    Err(TrainError::NotFinite { loss, step, checkpoint: checkpoint(out) })
}

/// How far a training is: what a checkpoint says beside its tensors.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Reached<V> {
    pub epoch: u64,
    pub step: u64,
    pub best_epoch: u64,
    pub best: Option<V>,
    pub seconds: f64,
}

impl<V> Default for Reached<V> {
    fn default() -> Self {
        Self { epoch: 0, step: 0, best_epoch: 0, best: None, seconds: 0.0 }
    }
}

/// What one walk through the data came to.
pub(super) struct Pass {
    /// Mean loss.
    pub loss: f64,
    /// Pictures that were shown.
    pub shown: u64,
    /// When it began, and how long its steps took (s).
    pub began: Instant,
    pub seconds: f64,
    /// The learning rate of the last step.
    pub rate: f64,
    /// Steps in all at the training's end, as far as is known.
    pub steps: u64,
}

/// A training that walks epoch by epoch. Each ends with validation, the best network exported, and a
/// checkpoint.
pub(super) trait Training {
    type Validation: Copy;
    /// A line of `metrics.jsonl`.
    type Record: Serialize;
    /// `summary.json`.
    type Summary: Serialize;

    /// Whether the wanted epochs or the time are over.
    fn is_over(&self) -> bool;

    /// One walk through the data; None where `interrupt` became true: what was begun is lost.
    fn pass(
        &mut self,
        interrupt: &AtomicBool,
        report: &mut dyn FnMut(Progress<Self::Validation>),
    ) -> Result<Option<Pass>, TrainError>;

    /// How good the network is on what it was not trained on.
    fn validate(&self) -> Result<Self::Validation, TrainError>;

    /// Whether a network that validation finds `new` replaces the best so far.
    fn is_better(new: &Self::Validation, best: &Self::Validation) -> bool;

    /// How far it is.
    fn reached(&mut self) -> &mut Reached<Self::Validation>;

    /// Writes the network, the best so far.
    fn export(&self, validation: &Self::Validation) -> Result<(), TrainError>;

    /// Writes all that is needed to go on after `pass`.
    fn save(&mut self, pass: &Pass) -> Result<(), TrainError>;

    /// The epoch for `metrics.jsonl`.
    fn record(&self, pass: &Pass, validation: Self::Validation, best: bool) -> Self::Record;

    /// An epoch's step and figures for TensorBoard.
    fn figures(record: &Self::Record) -> (u64, Vec<(&'static str, f64)>);

    /// What it came to.
    fn summary(&self, interrupted: bool) -> Self::Summary;
}

/// Walks to the end, or until `interrupt` becomes true; writes metrics, events and summary to `out`.
pub(super) fn walk<T: Training>(
    mut training: T,
    out: &Path,
    interrupt: &AtomicBool,
    report: &mut dyn FnMut(Progress<T::Validation>),
) -> Result<T::Summary, TrainError> {
    let path = out.join("metrics.jsonl");
    let log = OpenOptions::new().create(true).append(true).open(&path);
    let mut log = log.map_err(TrainError::write(&path))?;
    let mut events = EventWriter::create(out).map_err(TrainError::write(out))?;
    let mut interrupted = false;
    while !training.is_over() {
        let epoch = training.reached().epoch;
        let Some(pass) = training.pass(interrupt, report)? else {
            interrupted = true;
            break;
        };
        let validation = training.validate()?;
        let reached = training.reached();
        reached.epoch += 1;
        let best = reached.best.is_none_or(|best| T::is_better(&validation, &best));
        if best {
            (reached.best, reached.best_epoch) = (Some(validation), reached.epoch);
        }
        let step = reached.step;
        if best {
            training.export(&validation)?;
        }
        training.save(&pass)?;
        report(Progress { epoch, step, steps: pass.steps, loss: pass.loss, validation: Some(validation) });
        let record = training.record(&pass, validation, best);
        let mut line = serde_json::to_vec(&record).map_err(|e| TrainError::write(&path)(e.into()))?;
        line.push(b'\n');
        log.write_all(&line).map_err(TrainError::write(&path))?;
        let (step, figures) = T::figures(&record);
        figures
            .into_iter()
            .try_for_each(|(tag, value)| events.scalar(tag, step, value))
            .and_then(|()| events.flush())
            .map_err(TrainError::write(events.path()))?;
    }
    let summary = training.summary(interrupted);
    write_json(&out.join("summary.json"), &summary)?;
    Ok(summary)
}
