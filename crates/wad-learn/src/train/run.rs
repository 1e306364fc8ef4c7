//! Shared by the trainings of encoder and detector: the folder, the loop over epochs, the errors.
//!
//! ```text
//! out: config.json  checkpoint.safetensors (after each epoch)  the best network
//!      metrics.jsonl and TensorBoard's events (a line, figures per epoch)  summary.json (at the end)
//! ```

use super::images::ImagesError;
use super::tensorboard::EventWriter;
use crate::dataset::DatasetError;
use crate::folder_lock::{FolderLock, LockError};
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

/// Why training failed.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// The folder cannot be locked.
    #[error(transparent)]
    Lock(#[from] LockError),
    /// The dataset cannot be read.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// Images cannot be loaded.
    #[error(transparent)]
    Images(#[from] ImagesError),
    /// Weights cannot be read or written.
    #[error(transparent)]
    Weights(#[from] WeightsError),
    /// A network cannot be made.
    #[error(transparent)]
    Perception(#[from] PerceptionError),
    /// libtorch fails.
    #[error("libtorch: {0}")]
    Torch(#[from] TchError),
    /// A file cannot be written.
    #[error("could not write `{}`: {source}; the last checkpoint is kept", path.display())]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// The folder holds a training already.
    #[error("`{}` holds a training already; continue it with --resume, or name another folder with --out", path.display())]
    Taken {
        /// The file or folder.
        path: PathBuf,
    },
    /// There is no checkpoint to resume from.
    #[error("`{}` holds no training to resume: expected checkpoint.safetensors in it", path.display())]
    NothingToResume {
        /// The file or folder.
        path: PathBuf,
    },
    /// The options of the training to resume cannot be read.
    #[error("nothing to resume: cannot read the options in `{}`: {why}", path.display())]
    ConfigFile {
        /// The file.
        path: PathBuf,
        /// The cause.
        why: String,
    },
    /// The training to resume has another option.
    #[error(
        "expected `{what}` = {found}, as in the config.json of the training in `{}`, found {asked}; leave the \
         option out, or name another folder with --out",
        path.display()
    )]
    Differs {
        /// The file or folder.
        path: PathBuf,
        /// The option.
        what: String,
        /// Its value in the folder.
        found: String,
        /// Its value in the call.
        asked: String,
    },
    /// The memory for images does not hold one shard.
    #[error(
        "--resident-gb: expected {expected} or more, for the largest shard of `{}`, found {found}; give more, or \
         collect with a smaller --per-shard",
        path.display()
    )]
    Memory {
        /// The dataset's folder.
        path: PathBuf,
        /// What the largest shard needs (GB).
        expected: f64,
        /// What it may have (GB).
        found: f64,
    },
    /// The loss is not finite.
    #[error(
        "the loss became {loss} at step {step}: training stopped, `{}` is the last good one; a smaller \
         --learning-rate may help",
        checkpoint.display()
    )]
    NotFinite {
        /// The loss.
        loss: f64,
        /// The step.
        step: u64,
        /// The last checkpoint.
        checkpoint: PathBuf,
    },
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
            Self::Dataset(error) | Self::Images(ImagesError::Dataset(error)) => error.is_input(),
            Self::Lock(LockError::Busy { .. })
            | Self::Perception(PerceptionError::Detector { .. })
            | Self::Taken { .. }
            | Self::NothingToResume { .. }
            | Self::ConfigFile { .. }
            | Self::Differs { .. }
            | Self::Memory { .. } => true,
            Self::Weights(error) => !matches!(error, WeightsError::Io { .. } | WeightsError::Torch(_)),
            _ => false,
        }
    }
}

/// A training's progress; `V` is the result of a validation.
#[derive(Clone, Copy, Debug)]
pub struct Progress<V> {
    /// The epoch, from 0.
    pub epoch: u64,
    /// Steps so far.
    pub step: u64,
    /// Steps at the training's end.
    pub steps: u64,
    /// The loss of the last steps.
    pub loss: f64,
    /// The validation, at the end of an epoch.
    pub validation: Option<V>,
}

/// The options in a training's folder.
pub(super) const CONFIG: &str = "config.json";

/// The checkpoint in a training's folder.
pub(super) fn checkpoint(out: &Path) -> PathBuf {
    out.join("checkpoint.safetensors")
}

/// Locks `out` for a training, or for the one in it if `resume`.
pub(super) fn claim(out: &Path, resume: bool) -> Result<FolderLock, TrainError> {
    // Before the lock makes the folder, and once more: another training may have ended in between.
    check(out, resume)?;
    let lock = FolderLock::take(out)?;
    check(out, resume)?;
    Ok(lock)
}

/// Checks that `out` holds a training if `resume`, else none.
fn check(out: &Path, resume: bool) -> Result<(), TrainError> {
    match (resume, checkpoint(out).is_file()) {
        (true, false) => Err(TrainError::NothingToResume { path: out.to_path_buf() }),
        (false, true) => Err(TrainError::Taken { path: out.to_path_buf() }),
        _ => Ok(()),
    }
}

/// The options of the training in `out`, from its config.json.
///
/// # Errors
/// It cannot be read.
pub fn saved<T: DeserializeOwned>(out: &Path) -> Result<T, TrainError> {
    let path = out.join(CONFIG);
    let text = std::fs::read(&path).map_err(|e| e.to_string());
    let options = text.and_then(|text| serde_json::from_slice(&text).map_err(|e| e.to_string()));
    options.map_err(|why| TrainError::ConfigFile { path, why })
}

/// Checks that the training in `out`, which began with the options `before`, goes on with the same.
pub(super) fn check_same<T: Serialize + PartialEq>(
    out: &Path,
    options: &T,
    before: &T,
) -> Result<(), TrainError> {
    if options == before {
        return Ok(());
    }
    let [asked, found] = [options, before].map(|one| serde_json::to_value(one).unwrap_or_default());
    let mut names = asked.as_object().into_iter().flat_map(serde_json::Map::keys);
    match names.find(|name| asked[*name] != found[*name]) {
        None => Ok(()),
        Some(name) => Err(TrainError::Differs {
            path: out.to_path_buf(),
            what: name.clone(),
            found: found[name].to_string(),
            asked: asked[name].to_string(),
        }),
    }
}

/// Makes the folder if it is missing, and writes a JSON file into it.
pub(super) fn write_json(path: &Path, value: &impl Serialize) -> Result<(), TrainError> {
    let folder = path.parent().unwrap_or(path);
    std::fs::create_dir_all(folder).map_err(TrainError::write(folder))?;
    telemetry::write_json(path, value).map_err(|e| TrainError::write(path)(e.source))
}

/// The key of the progress in a checkpoint's metadata.
pub(super) const REACHED: &str = "reached";

/// The progress in a checkpoint.
pub(super) fn reached<T: DeserializeOwned>(weights: &Weights) -> Result<T, TrainError> {
    let text = weights.metadata.get(REACHED).map_or("", String::as_str);
    let format = |e: serde_json::Error| WeightsError::Format {
        path: weights.path.clone(),
        why: format!("its metadata has no valid progress ({e})"),
    };
    Ok(serde_json::from_str(text).map_err(format)?)
}

/// Fails if the loss is not finite.
pub(super) fn require_finite(loss: f64, step: u64, out: &Path) -> Result<(), TrainError> {
    if loss.is_finite() {
        return Ok(());
    }
    Err(TrainError::NotFinite { loss, step, checkpoint: checkpoint(out) })
}

/// A training's progress in a checkpoint.
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

/// The result of one epoch's steps.
pub(super) struct Pass {
    /// Mean loss.
    pub loss: f64,
    /// Pictures used.
    pub shown: u64,
    /// When it began, and how long its steps took (s).
    pub began: Instant,
    pub seconds: f64,
    /// The learning rate of the last step.
    pub rate: f64,
    /// Expected steps at the training's end.
    pub steps: u64,
}

/// A training in epochs. Each ends with a validation, the export of the best network, and a
/// checkpoint.
pub(super) trait Training {
    type Validation: Copy;
    /// A line of `metrics.jsonl`.
    type Record: Serialize;
    /// `summary.json`.
    type Summary: Serialize;

    /// Whether all epochs are done or the time is up.
    fn is_over(&self) -> bool;

    /// The steps of one epoch; None if `interrupt` became true: the epoch is lost.
    fn pass(
        &mut self,
        interrupt: &AtomicBool,
        report: &mut dyn FnMut(Progress<Self::Validation>),
    ) -> Result<Option<Pass>, TrainError>;

    /// Scores the network on the validation data.
    fn validate(&self) -> Result<Self::Validation, TrainError>;

    /// Whether `new` is better than the best validation so far.
    fn is_better(new: &Self::Validation, best: &Self::Validation) -> bool;

    /// The progress.
    fn reached(&mut self) -> &mut Reached<Self::Validation>;

    /// Exports the best network so far.
    fn export(&self, validation: &Self::Validation) -> Result<(), TrainError>;

    /// Writes the checkpoint after `pass`.
    fn save(&mut self, pass: &Pass) -> Result<(), TrainError>;

    /// The epoch's line of `metrics.jsonl`.
    fn record(&self, pass: &Pass, validation: Self::Validation, best: bool) -> Self::Record;

    /// An epoch's step and metrics for TensorBoard.
    fn figures(record: &Self::Record) -> (u64, Vec<(&'static str, f64)>);

    /// The summary.
    fn summary(&self, interrupted: bool) -> Self::Summary;
}

/// Trains to the end, or until `interrupt` becomes true; writes metrics, events and summary to `out`.
pub(super) fn walk<T: Training>(
    mut training: T,
    out: &Path,
    interrupt: &AtomicBool,
    report: &mut dyn FnMut(Progress<T::Validation>),
) -> Result<T::Summary, TrainError> {
    let path = out.join("metrics.jsonl");
    let log = OpenOptions::new().create(true).append(true).open(&path);
    let mut log = log.map_err(TrainError::write(&path))?;
    let resumed = Some(training.reached().step).filter(|step| *step > 0);
    let mut events = EventWriter::create(out, resumed).map_err(TrainError::write(out))?;
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
