//! Trains CenterNet on the camera's pictures (Zhou et al. 2019; losses and targets in
//! [`wad_see::perception::centernet`]).
//!
//! An epoch uses each frame about once, frames with rare classes more often, frames without objects less
//! often. After it comes validation, on shards that were not trained on: COCO's mAP@0.5 of boxes 24 px high or more
//! and of those 12 to 24 px high, and what is seen of the road. The network with the best mean of these so far is
//! exported in half precision, and a checkpoint written.

use super::detector_data::{Plate, SIDE, Sample, Show, epoch, plates, samples, steps};
pub use super::run::TrainError;
use super::run::{self, Pass, Training};
use crate::dataset::{Dataset, DatasetError};
use crate::optim::AdamW;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;
use sumo_network::seeds;
use tch::{Device, Kind, Tensor};
use wad_see::perception::centernet::loss::loss;
use wad_see::perception::centernet::road_targets::{part_loss, reading_loss, road_loss};
use wad_see::perception::centernet::{Backbone, CenterNet, CenterNetDetector, Part, Sees, Watcher};
use wad_see::perception::coco::{class_index, class_name};
use wad_see::perception::metrics::{Found, Scored, average_precision, mean};
use wad_see::perception::score::{SMALL, TALL};
use wad_see::perception::sight_score::{RoadReport, RoadScore};
use wad_see::perception::{Detector, LeastScore, centernet_weights};
use wad_see::weights::{Stored, Weights, WeightsError};

/// Options of a detector's training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrainOptions {
    /// The feature extractor.
    pub backbone: Backbone,
    /// What the network is to see.
    #[serde(default)]
    pub sees: Sees,
    /// The dataset's folder.
    pub data: PathBuf,
    /// More datasets, mixed with it.
    #[serde(default)]
    pub more: Vec<PathBuf>,
    /// The training's folder.
    pub out: PathBuf,
    /// Initial weights by detector name (centernet, centernet:FILE); None: new ones.
    #[serde(default)]
    pub init: Option<String>,
    /// Nothing but this head learns.
    #[serde(default)]
    pub only: Option<Part>,
    /// Epochs in total; with 0 the network of `init` stays as it is, and gets ranges.
    pub epochs: u64,
    /// Pictures per step.
    pub batch: usize,
    /// Most batches per epoch.
    pub epoch_steps: usize,
    /// AdamW's highest learning rate; it rises over the first steps and falls to 0 as half a cosine.
    pub learning_rate: f64,
    /// AdamW's weight decay.
    pub weight_decay: f64,
    /// Width and height of the crops that most steps use (pixels); None: whole pictures only.
    pub window: Option<(usize, usize)>,
    /// Compute the backbone in bfloat16; weights and optimiser stay in single precision.
    pub bfloat16: bool,
    /// Augment weather, light and colours.
    pub vary: bool,
    /// The seed of everything random.
    pub seed: u64,
    /// Accept an unfinished dataset.
    pub partial: bool,
    /// Threads that make batches.
    pub workers: usize,
    /// Most frames used for validation.
    pub validation_frames: usize,
    /// Time limit of the training (s).
    pub time_limit: Option<f64>,
}

impl TrainOptions {
    /// The defaults of `wad-cosim train detector`.
    pub fn new(backbone: Backbone, data: &Path, out: &Path) -> Self {
        Self {
            backbone,
            sees: Sees::Objects,
            data: data.to_path_buf(),
            more: Vec::new(),
            out: out.to_path_buf(),
            init: None,
            only: None,
            epochs: 12,
            batch: 16,
            epoch_steps: 400,
            learning_rate: 1.5e-3,
            weight_decay: 1e-3,
            window: Some((320, 320)),
            bfloat16: false,
            vary: true,
            seed: 0,
            partial: false,
            workers: 1,
            validation_frames: 300,
            time_limit: None,
        }
    }

    fn datasets(&self) -> Result<Vec<Dataset>, DatasetError> {
        let folders = std::iter::once(&self.data).chain(&self.more);
        folders.map(|folder| Dataset::open(folder, self.partial)).collect()
    }
}

/// The result of a validation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Validation {
    /// mAP@0.5 of boxes 24 px high or more.
    pub map50: f64,
    /// mAP@0.5 of boxes 12 to 24 px high.
    pub map50_small: f64,
    /// Lane and light; None for networks that see objects only.
    #[serde(default)]
    pub road: Option<RoadReport>,
}

impl Validation {
    /// Which network is better: the mean of both mAPs, boundaries found, lights right, signs right and the area's IoU.
    fn score(&self) -> f64 {
        let mut parts = vec![self.map50, self.map50_small];
        if let Some(road) = &self.road {
            let RoadReport { boundaries_found, lights_right, signs_right, area_iou, .. } = road;
            parts.extend([boundaries_found, lights_right, signs_right, area_iou].into_iter().flatten());
        }
        parts.iter().sum::<f64>() / parts.len() as f64
    }
}

/// A line of `metrics.jsonl`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct EpochRecord {
    /// The epoch, from 1.
    pub epoch: u64,
    /// Steps so far.
    pub step: u64,
    /// Mean loss over the epoch.
    pub loss: f64,
    /// Validation after the epoch.
    pub validation: Validation,
    /// It is the best so far.
    pub best: bool,
    /// Wall time so far (s).
    pub wall_seconds: f64,
    /// Pictures per second of training.
    pub images_per_second: f64,
}

/// The result of a training; `summary.json`.
#[derive(Clone, Debug, Serialize)]
pub struct Trained {
    /// The training's folder.
    pub out: PathBuf,
    /// The best network's file.
    pub detector: PathBuf,
    /// Epochs trained.
    pub epochs: u64,
    /// Steps trained.
    pub steps: u64,
    /// The epoch of the best network.
    pub best_epoch: u64,
    /// The best network's validation.
    pub best: Validation,
    /// Training frames.
    pub frames: usize,
    /// Validation frames.
    pub validation_frames: usize,
    /// Wall time (s).
    pub wall_seconds: f64,
    /// The user interrupted.
    pub interrupted: bool,
}

/// The training's progress.
pub type Progress = run::Progress<Validation>;

/// Steps over which the learning rate rises.
const WARM_UP: f64 = 100.0;
/// Longest gradient.
const LONGEST: f64 = 10.0;
/// Steps between reports.
const REPORT_EVERY: u64 = 10;
/// The best network in the training's folder.
const FILE: &str = "detector.safetensors";
/// The data that weights were trained on, in their metadata.
const MADE_OF: &str = "made_of";
/// Pictures by which ranges are found.
const WATCHED: usize = 200;
/// Lowest score that counts in validation.
const LEAST_SCORE: LeastScore = LeastScore::Fixed(0.05);

/// The progress in a checkpoint.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
struct Reached {
    #[serde(flatten)]
    walk: run::Reached<Validation>,
    optimiser_steps: i32,
    /// Number of validation frames of the best score: other frames give other scores.
    #[serde(default)]
    validation_frames: usize,
}

struct Trainer<'a> {
    options: &'a TrainOptions,
    device: Device,
    network: CenterNet,
    adam: AdamW,
    reached: Reached,
    training: Vec<Sample>,
    /// Of signs in them, where nothing but signs is learned.
    plates: Vec<Plate>,
    /// Batches per epoch.
    epoch_steps: u64,
    validation: Vec<Sample>,
    /// For the metadata of the weights.
    made_of: String,
    began: Instant,
}

/// Trains, or continues with `resume`: with the options that the training began with, but for folder, epochs, workers and
/// time limit. Ends early when `interrupt` becomes true: the running epoch is then lost. `report` is called every few
/// steps.
///
/// # Errors
/// Bad data, other options, no memory, a full disk, or a loss that is not a number. The last checkpoint is kept.
pub fn train(
    options: &TrainOptions,
    device: Device,
    resume: bool,
    interrupt: &AtomicBool,
    mut report: impl FnMut(Progress),
) -> Result<Trained, TrainError> {
    let _lock = run::claim(&options.out, resume)?;
    if resume {
        let before = TrainOptions {
            out: options.out.clone(),
            epochs: options.epochs,
            workers: options.workers,
            time_limit: options.time_limit,
            ..run::saved(&options.out)?
        };
        run::check_same(&options.out, options, &before)?;
    }
    let mut trainer = Trainer::start(options, device, resume)?;
    run::write_json(&options.out.join(run::CONFIG), options)?;
    let kept = options.init.as_ref().filter(|_| options.epochs == 0 && !resume);
    if let Some(name) = kept {
        let (weights, known) = centernet_weights(name)?;
        if known != options.sees {
            return Err(TrainError::Weights(WeightsError::Mismatch {
                path: weights.path,
                found: format!("network {}", known.network()),
                expected: format!("network {}, as nothing is learned", options.sees.network()),
            }));
        }
        weights.save(&options.out.join(FILE))?;
        trainer.reached.walk.best = Some(trainer.validate()?);
    }
    let trained = run::walk(trainer, &options.out, interrupt, &mut report)?;
    if !trained.interrupted && options.backbone == Backbone::Light {
        find_ranges(options, &trained.detector)?;
    }
    Ok(trained)
}

/// Adds to a detector's file what it needs to run in 8 bits: the ranges of its numbers, by training pictures as they
/// are.
fn find_ranges(options: &TrainOptions, file: &Path) -> Result<(), TrainError> {
    if let Err(why) = wad_see::inference::available() {
        tracing::warn!("the detector is without ranges for 8 bits, so it will run on libtorch: {why}");
        return Ok(());
    }
    let weights = Weights::load(file)?;
    let mut watcher = Watcher::new(&weights, options.sees)?;
    let datasets = options.datasets()?;
    for dataset in &datasets {
        for sample in samples(dataset, &dataset.split().0, WATCHED.div_ceil(datasets.len()))? {
            watcher.show(&sample.rgb()?)?;
        }
    }
    let before = options.init.as_ref().filter(|_| options.only.is_some());
    let before = before.map(|name| centernet_weights(name)).transpose()?;
    let before = before.as_ref().map(|(weights, _)| weights).zip(options.only);
    Ok(watcher.finish(weights, before)?.save(file)?)
}

impl<'a> Trainer<'a> {
    fn start(options: &'a TrainOptions, device: Device, resume: bool) -> Result<Self, TrainError> {
        wad_see::torch::one_thread();
        let checkpoint = run::checkpoint(&options.out);
        let datasets = options.datasets()?;
        datasets.iter().try_for_each(Dataset::require_training)?;
        let (mut training, mut validation) = (Vec::new(), Vec::new());
        for dataset in &datasets {
            dataset.warn_of_one_shard();
            let (train, validate) = dataset.split();
            training.extend(samples(dataset, &train, usize::MAX)?);
            let share = options.validation_frames.div_ceil(datasets.len());
            validation.extend(samples(dataset, &validate, share)?);
        }
        let epoch_steps = steps(&training, options.only, options.batch, options.epoch_steps) as u64;
        if epoch_steps == 0 {
            let hint = match options.only {
                Some(Part::Signs) => " that say which signs they show, for --only signs; collect it again",
                Some(Part::Area) => " that say what is road, for --only area; collect it again",
                None => " to train on; collect it again",
            };
            return Err(DatasetError::Empty { path: options.data.clone(), hint }.into());
        }
        tch::manual_seed(seeds::derive(options.seed, "weights") as i64);
        let begin = match &options.init {
            _ if resume => Some((Weights::load(&checkpoint)?, options.sees)),
            Some(name) => Some(centernet_weights(name)?),
            None => None,
        };
        let mut network = match &begin {
            Some((weights, known)) => CenterNet::begun_with(weights, *known, options.sees, device)?,
            None => CenterNet::new(options.backbone, options.sees, device)?,
        };
        if network.backbone != options.backbone {
            return Err(TrainError::Weights(WeightsError::Mismatch {
                path: begin.map(|(weights, _)| weights.path).unwrap_or_default(),
                found: format!("backbone {}", network.backbone.name()),
                expected: format!("backbone {}", options.backbone.name()),
            }));
        }
        if let Some(part) = options.only {
            network.learn_only(part);
        }
        let mut adam = AdamW::new(&network.store, options.weight_decay)?;
        let mut reached = Reached::default();
        if let Some((weights, _)) = begin.as_ref().filter(|_| resume) {
            reached = run::reached(weights)?;
            adam.restore(reached.optimiser_steps, |name, shape| weights.get(name, shape))?;
        }
        if reached.validation_frames != validation.len() {
            (reached.validation_frames, reached.walk.best) = (validation.len(), None);
        }
        let said = |dataset: &Dataset| {
            let m = &dataset.manifest;
            let weathers: Vec<&str> = m.weathers.iter().map(|w| w.name()).collect();
            let showing: Vec<&str> = m.showing.iter().map(|c| class_name(*c)).collect();
            let only =
                if showing.is_empty() { String::new() } else { format!(" with {}", showing.join(", ")) };
            format!(
                "{} frames{only} of {} in {}, seed {}",
                dataset.frames(),
                m.town,
                weathers.join(", "),
                m.seed
            )
        };
        let made_of = datasets.iter().map(said).collect::<Vec<_>>().join("; and ");
        let before = begin.as_ref().and_then(|(weights, _)| weights.metadata.get(MADE_OF));
        let made_of = match (before, options.only) {
            (Some(before), _) if resume => before.clone(),
            (Some(before), Some(part)) => format!("{before}; the head for {} alone: {made_of}", part.name()),
            _ => made_of,
        };
        let plates = if options.only == Some(Part::Signs) { plates(&training)? } else { Vec::new() };
        let began = Instant::now();
        Ok(Self {
            options,
            device,
            network,
            adam,
            reached,
            training,
            plates,
            epoch_steps,
            validation,
            made_of,
            began,
        })
    }

    fn seconds(&self) -> f64 {
        self.reached.walk.seconds + self.began.elapsed().as_secs_f64()
    }

    /// Steps in all.
    fn steps(&self) -> u64 {
        self.options.epochs * self.epoch_steps
    }

    /// How much of the training is over, by steps or by time: 0 to 1.
    fn done_share(&self) -> f64 {
        let by_time = self.options.time_limit.map_or(0.0, |limit| self.seconds() / limit.max(1.0));
        (self.reached.walk.step as f64 / self.steps().max(1) as f64).max(by_time).min(1.0)
    }

    fn rate(&self) -> f64 {
        let rise = ((self.reached.walk.step + 1) as f64 / WARM_UP).min(1.0);
        let fall = 0.5 * (1.0 + (std::f64::consts::PI * self.done_share()).cos());
        self.options.learning_rate * rise * fall.max(0.01)
    }
}

impl Training for Trainer<'_> {
    type Validation = Validation;
    type Record = EpochRecord;
    type Summary = Trained;

    fn is_over(&self) -> bool {
        self.reached.walk.epoch >= self.options.epochs || self.done_share() >= 1.0
    }

    fn pass(
        &mut self,
        interrupt: &AtomicBool,
        report: &mut dyn FnMut(Progress),
    ) -> Result<Option<Pass>, TrainError> {
        let options = self.options;
        let number = self.reached.walk.epoch;
        let began = Instant::now();
        let steps = self.steps();
        let (samples, plates) = (std::mem::take(&mut self.training), std::mem::take(&mut self.plates));
        let (mut sum, mut looks, mut interrupted, mut shown) = (0.0, 0_u64, false, 0_u64);
        let result = epoch(
            Show {
                backbone: options.backbone,
                batch: options.batch,
                window: options.window,
                vary: options.vary,
                only: options.only,
                plates: &plates,
            },
            &samples,
            self.epoch_steps as usize,
            (options.seed, number),
            options.workers,
            |batch| -> Result<bool, TrainError> {
                if interrupt.load(Ordering::Relaxed) {
                    interrupted = true;
                    return Ok(false);
                }
                let (pictures, target) = batch.load(self.device)?;
                let precision = if options.bfloat16 { Kind::BFloat16 } else { Kind::Float };
                let pictures = pictures.f_to_kind(precision)?;
                let answer = self.network.forward(&pictures, true)?;
                let mut total = match (&answer.road, batch.road(), options.only) {
                    (Some(answer), Some(targets), Some(part)) => {
                        part_loss(part, answer, targets, self.device)?
                    }
                    (Some(road), Some(targets), None) => {
                        loss(&answer, &target)?.total()?.f_add(&road_loss(road, targets, self.device)?)?
                    }
                    _ => loss(&answer, &target)?.total()?,
                };
                let learns_signs = options.only.is_none_or(|part| part == Part::Signs);
                if let Some(road) = answer.road.as_ref().filter(|_| learns_signs)
                    && let Some((plates, said)) = batch.plates(&road.signs, self.device)?
                    && let Some(answer) = self.network.read_signs(&plates)?
                {
                    total = total.f_add(&reading_loss(&answer, &said, self.device)?)?;
                }
                let rate = self.rate();
                let is_good = self.adam.step(&total, rate, LONGEST)?;
                let (value, step) = (total.f_double_value(&[])?, self.reached.walk.step);
                // A gradient that is not finite counts like such a loss.
                run::require_finite(if is_good { value } else { f64::NAN }, step, &options.out)?;
                sum += value;
                looks += 1;
                if step.is_multiple_of(REPORT_EVERY) {
                    report(Progress { epoch: number, step, steps, loss: value, validation: None });
                }
                shown += batch.count() as u64;
                self.reached.walk.step += 1;
                Ok(self.options.time_limit.is_none_or(|limit| self.seconds() < limit))
            },
        );
        (self.training, self.plates) = (samples, plates);
        result?;
        if interrupted {
            return Ok(None);
        }
        let (loss, seconds) = (sum / looks.max(1) as f64, began.elapsed().as_secs_f64());
        Ok(Some(Pass { loss, shown, began, seconds, rate: self.rate(), steps }))
    }

    /// The network as exported: in half precision, batch norms folded.
    fn validate(&self) -> Result<Validation, TrainError> {
        let copy = CenterNet::from_weights(&self.network.weights(&[])?, self.options.sees, self.device)?;
        let mut detector = CenterNetDetector::new("validation".into(), copy, self.device, LEAST_SCORE)?;
        let mut scored: Vec<Scored> = Vec::with_capacity(self.validation.len());
        let mut road = RoadScore::default();
        for sample in &self.validation {
            let mut one = sample.truths();
            let found = detector.detect_rgb(&sample.rgb()?, SIDE, SIDE)?;
            one.found =
                found.into_iter().map(|d| Found { label: class_index(d.class), detection: d }).collect();
            scored.push(one);
            if let (Some(wanted), Some(seen)) = (sample.road(), detector.seen()) {
                road.add(wanted, seen);
            }
        }
        let map = |counts: &dyn Fn(f32) -> bool| {
            mean((0..8).map(|class| average_precision(&scored, class, 0.5, counts))).unwrap_or(0.0)
        };
        Ok(Validation {
            map50: map(&|h| h >= TALL),
            map50_small: map(&|h| (SMALL..TALL).contains(&h)),
            road: (self.options.sees == Sees::Road).then(|| road.report()),
        })
    }

    fn export(&self, validation: &Validation) -> Result<(), TrainError> {
        let score = serde_json::to_string(validation).unwrap_or_default();
        let weights = self.network.weights(&[
            (MADE_OF, self.made_of.clone()),
            ("epochs", self.reached.walk.epoch.to_string()),
            ("validation", score),
            ("program", wad_sim::program::version().to_string()),
        ])?;
        Ok(weights.save(&self.options.out.join(FILE))?)
    }

    fn save(&mut self, _: &Pass) -> Result<(), TrainError> {
        let mut reached = Reached { optimiser_steps: self.adam.steps(), ..self.reached.clone() };
        reached.walk.seconds = self.seconds();
        let mut metadata = self.network.weights(&[(MADE_OF, self.made_of.clone())])?.metadata;
        metadata.insert(run::REACHED.to_string(), serde_json::to_string(&reached).unwrap_or_default());
        let mut tensors: Vec<(String, Tensor)> = Vec::new();
        for (name, tensor) in self.network.store.variables() {
            tensors.push((name, tensor.f_detach()?.f_to_kind(Kind::Float)?));
        }
        tensors.extend(self.adam.tensors());
        let path = run::checkpoint(&self.options.out);
        let tensors = Stored::all(&tensors)?;
        Ok(Weights { path: path.clone(), tensors, metadata }.save(&path)?)
    }

    fn is_better(new: &Validation, best: &Validation) -> bool {
        new.score() >= best.score()
    }

    fn reached(&mut self) -> &mut run::Reached<Validation> {
        &mut self.reached.walk
    }

    fn record(&self, pass: &Pass, validation: Validation, best: bool) -> EpochRecord {
        EpochRecord {
            epoch: self.reached.walk.epoch,
            step: self.reached.walk.step,
            loss: pass.loss,
            validation,
            best,
            wall_seconds: self.seconds(),
            images_per_second: pass.shown as f64 / pass.seconds.max(1e-9),
        }
    }

    fn figures(record: &EpochRecord) -> (u64, Vec<(&'static str, f64)>) {
        let mut figures = vec![
            ("losses/train", record.loss),
            ("charts/map50", record.validation.map50),
            ("charts/map50_small", record.validation.map50_small),
            ("charts/images_per_second", record.images_per_second),
        ];
        if let Some(road) = &record.validation.road {
            figures.extend(road.boundaries_found.map(|v| ("charts/boundaries_found", v)));
            figures.extend(road.lights_right.map(|v| ("charts/lights_right", v)));
            figures.extend(road.signs_right.map(|v| ("charts/signs_right", v)));
            figures.extend(road.area_iou.map(|v| ("charts/area_iou", v)));
        }
        (record.step, figures)
    }

    fn summary(&self, interrupted: bool) -> Trained {
        Trained {
            out: self.options.out.clone(),
            detector: self.options.out.join(FILE),
            epochs: self.reached.walk.epoch,
            steps: self.reached.walk.step,
            best_epoch: self.reached.walk.best_epoch,
            best: self.reached.walk.best.unwrap_or_default(),
            frames: self.training.len(),
            validation_frames: self.validation.len(),
            wall_seconds: self.seconds(),
            interrupted,
        }
    }
}

#[cfg(test)]
mod overfit;
#[cfg(test)]
mod tests;
