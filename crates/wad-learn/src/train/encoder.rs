//! Trains the encoder-decoder (paper, section "Latent State Extraction").
//!
//! An epoch is one pass over the training images, or `epoch_steps` batches if that is less. Then validation
//! runs, the best network so far is exported, and a checkpoint is written. An interrupted run goes on from
//! its last checkpoint; on the CPU with one thread it gives the same bits as an uninterrupted run (cuDNN's
//! sums differ from run to run), unless a time limit decides about the learning rate.

pub mod heads;
mod terms;

pub use super::run::TrainError;
pub use terms::{EpochRecord, Progress, TrainOptions, Trained, Validation};

use super::images::{self, Choice, Images};
use super::loss;
use super::run::{self, Pass, Training};
use crate::dataset::Dataset;
use crate::optim::Adam;
use heads::Heads;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;
use sumo_network::seeds;
use tch::{Device, Kind, TchError, Tensor};
use wad_see::latent::architecture::{Architecture, Slot};
use wad_see::latent::chance;
use wad_see::latent::encoder::{to_pictures, weights_of};
use wad_see::latent::file::keys;
use wad_see::latent::network::Autoencoder;
use wad_see::perception::TransformedImage;
use wad_see::weights::{Stored, Weights, WeightsError};

/// Most images used for validation, and for standardising the latent.
const VALIDATION_IMAGES: usize = 2000;
const STANDARD_IMAGES: i64 = 4096;
/// Factor of the heads' learning rate over the network's.
const HEADS_RATE: f64 = 10.0;
/// Steps between reads of the loss: each read waits for the device.
const LOOK_EVERY: u64 = 20;

/// A checkpoint's state beside its tensors.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
struct Reached {
    #[serde(flatten)]
    walk: run::Reached<Validation>,
    images: u64,
}

struct Trainer<'a> {
    options: &'a TrainOptions,
    device: Device,
    dataset: Dataset,
    network: Autoencoder,
    adam: Adam,
    /// With `--label-weight`.
    heads: Option<Heads>,
    reached: Reached,
    /// The resident shards, and their images.
    resident: (Vec<usize>, Images),
    validation: Images,
    /// Wall time of earlier calls (s).
    before: f64,
    began: Instant,
}

/// Trains, or continues with `resume`: with the options that the training began with, but for folder, epochs, memory for
/// images and time limit. Ends early when `interrupt` becomes true: the running epoch is then lost. `report` is called
/// every few steps.
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
            resident_gb: options.resident_gb,
            time_limit: options.time_limit,
            ..run::saved(&options.out)?
        };
        run::check_same(&options.out, options, &before)?;
    }
    let trainer = Trainer::start(options, device, resume)?;
    run::write_json(&options.out.join(run::CONFIG), options)?;
    run::walk(trainer, &options.out, interrupt, &mut report)
}

impl<'a> Trainer<'a> {
    fn start(options: &'a TrainOptions, device: Device, resume: bool) -> Result<Self, TrainError> {
        wad_see::torch::one_thread();
        let checkpoint = run::checkpoint(&options.out);
        let dataset = Dataset::open(&options.data, options.partial)?;
        dataset.require_training()?;
        let architecture = Architecture {
            variational: options.beta > 0.0,
            dropout: options.dropout,
            image: dataset.manifest.image,
            ..Architecture::default()
        };
        let saved = if resume { Some(Weights::load(&checkpoint)?) } else { None };
        let (mut network, reached) = if let Some(weights) = &saved {
            let find = |slot: &Slot| weights.get(&slot.name, &slot.shape);
            (Autoencoder::from_named(architecture, device, find)?, run::reached(weights)?)
        } else {
            let mut rng = seeds::rng(options.seed, "weights");
            (Autoencoder::new(architecture, &mut rng, device)?, Reached::default())
        };
        let mut adam = Adam::new(&network.theta, options.learning_rate);
        if let Some(weights) = &saved {
            restore(&mut adam, weights, "adam", &reached)?;
        }
        if options.bfloat16 {
            network.precision = Kind::BFloat16;
        }
        dataset.warn_of_one_shard();
        let (shards, validation) = dataset.split();
        let labelled = options.label_weight > 0.0;
        let frames: usize = validation.iter().map(|&s| dataset.shards[s].2).sum();
        let every = frames.div_ceil(VALIDATION_IMAGES);
        let validation = images::load(&dataset, Choice { shards: &validation, every, labelled }, device)?;
        let heads = if labelled {
            let labels = images::labels(&dataset, &shards, device)?;
            let mut heads = Heads::new(network.architecture.latent, &labels, device)?;
            if let Some(weights) = &saved {
                heads.theta = weights.get("labels.theta", &heads.theta.size())?.f_to_device(device)?;
                restore(&mut heads.adam, weights, "labels.adam", &reached)?;
            }
            Some(heads)
        } else {
            None
        };
        Ok(Self {
            options,
            device,
            dataset,
            network,
            adam,
            heads,
            before: reached.walk.seconds,
            reached,
            resident: (Vec::new(), Images::none(device)?),
            validation,
            began: Instant::now(),
        })
    }

    fn seconds(&self) -> f64 {
        self.before + self.began.elapsed().as_secs_f64()
    }

    fn is_late(&self) -> bool {
        self.options.time_limit.is_some_and(|limit| self.seconds() >= limit)
    }

    /// Loads the images of this epoch's shards: all, or a new random choice if not all fit.
    fn load(&mut self) -> Result<(), TrainError> {
        let (mut shards, _) = self.dataset.split();
        let room = (self.options.resident_gb * 1e9 / TransformedImage::BYTES as f64) as usize;
        let each = shards.iter().map(|&s| self.dataset.shards[s].2);
        let (all, largest) = (each.clone().sum::<usize>(), each.max().unwrap_or(0));
        if largest > room {
            // Thousandths, rounded up: who gives what is asked for has enough.
            let expected = (1e-6 * (largest * TransformedImage::BYTES) as f64).ceil() / 1e3;
            let (path, found) = (self.dataset.folder.clone(), self.options.resident_gb);
            return Err(TrainError::Memory { path, expected, found });
        }
        if all > room {
            let mut rng = seeds::rng(self.options.seed, &format!("shards {}", self.reached.walk.epoch));
            shards.shuffle(&mut rng);
            let mut frames = 0;
            let fits = |&s: &usize| {
                frames += self.dataset.shards[s].2;
                frames <= room
            };
            shards = shards.iter().copied().take_while(fits).collect();
            shards.sort_unstable();
        }
        if self.resident.0 != shards {
            // The old ones are freed first: both together may not fit.
            self.resident = (Vec::new(), Images::none(self.device)?);
            let choice = Choice { shards: &shards, every: 1, labelled: self.heads.is_some() };
            let images = images::load(&self.dataset, choice, self.device)?;
            self.resident = (shards, images);
        }
        Ok(())
    }

    /// Batches per epoch.
    fn steps(&self) -> u64 {
        let images = self.resident.1.count() as usize;
        images.div_ceil(self.options.batch.max(1)).clamp(1, self.options.epoch_steps.max(1)) as u64
    }

    /// The training's progress (0..1), by steps or by time, whichever is further.
    fn done(&self, step_in_epoch: u64, steps: u64) -> f64 {
        let epochs = self.reached.walk.epoch as f64 + step_in_epoch as f64 / steps as f64;
        let by_steps = epochs / self.options.epochs.max(1) as f64;
        let by_time = self.options.time_limit.map_or(0.0, |limit| self.seconds() / limit.max(1e-9));
        by_steps.max(by_time).min(1.0)
    }

    fn learning_rate(&self, done: f64) -> f64 {
        let decay = self.options.decay.clamp(0.0, 1.0);
        let left = if decay > 0.0 { ((1.0 - done) / decay).min(1.0) } else { 1.0 };
        self.options.learning_rate * left.max(0.01)
    }

    fn require_finite(&self, loss: f64) -> Result<(), TrainError> {
        run::require_finite(loss, self.reached.walk.step, &self.options.out)
    }

    /// One Adam step on a batch; the loss, still on the device.
    fn step(&mut self, batch: &Images, rate: f64, rng: &mut ChaCha8Rng) -> Result<Tensor, TrainError> {
        let pictures = to_pictures(&batch.pixels)?;
        let painted = loss::painted(&pictures)?;
        let pictures = if self.options.augment { loss::relight(rng, &pictures, &painted)? } else { pictures };
        let trained = |theta: &Tensor| theta.f_detach()?.f_set_requires_grad(true);
        let theta = trained(&self.network.theta)?;
        let heads = self.heads.as_ref().map(|heads| trained(&heads.theta)).transpose()?;
        let asked = heads.as_ref().zip(batch.labels.as_ref());
        let loss = self.loss(&theta, &pictures, &painted, asked, Some(rng))?.loss;
        let learners: Vec<&Tensor> = std::iter::once(&theta).chain(&heads).collect();
        let mut gradients = Tensor::f_run_backward(&[&loss], &learners, false, false)?.into_iter();
        let Some(mut gradient) = gradients.next() else {
            return Err(TchError::Convert("no gradient".to_string()).into());
        };
        tch::no_grad(|| self.regularize(&mut gradient))?;
        self.adam.learning_rate = rate;
        self.adam.f_step(&mut self.network.theta, &gradient)?;
        if let Some((heads, gradient)) = self.heads.as_mut().zip(gradients.next()) {
            heads.adam.learning_rate = HEADS_RATE * rate;
            heads.adam.f_step(&mut heads.theta, &gradient)?;
        }
        self.reached.walk.step += 1;
        Ok(loss.f_detach()?)
    }

    /// L2 regularization of the weights (not of biases and norms).
    fn regularize(&self, gradient: &mut Tensor) -> Result<(), TchError> {
        let decayed = self.network.decayed();
        let weights = self.network.theta.f_narrow(0, 0, decayed)?;
        let mut part = gradient.f_narrow(0, 0, decayed)?;
        let _ = part.f_add_(&weights.f_mul_scalar(self.options.weight_decay)?)?;
        Ok(())
    }

    /// The loss of the parameters `theta` on some pictures. `asked`: the heads' parameters and the labels.
    fn loss(
        &self,
        theta: &Tensor,
        pictures: &Tensor,
        painted: &Tensor,
        asked: Option<(&Tensor, &Tensor)>,
        mut rng: Option<&mut ChaCha8Rng>,
    ) -> Result<Made, TchError> {
        let views = self.network.views(theta)?;
        let code = self.network.encode(&views, pictures, rng.as_deref_mut())?;
        let size = self.network.architecture.latent;
        let (mean, latent, divergence) = if self.network.architecture.variational {
            let (mean, log_variance) = (code.f_narrow(1, 0, size)?, code.f_narrow(1, size, size)?);
            let log_variance = log_variance.f_clamp(-12.0, 6.0)?;
            let divergence = loss::divergence(&mean, &log_variance)?;
            let latent = if let Some(rng) = rng.as_deref_mut() {
                let noise = chance::normal(rng, &mean.size(), self.device)?;
                mean.f_add(&log_variance.f_mul_scalar(0.5)?.f_exp()?.f_mul(&noise)?)?
            } else {
                mean.shallow_clone()
            };
            (mean, latent, Some(divergence))
        } else {
            (code.shallow_clone(), code, None)
        };
        let pictures_made = self.network.decode_logits(&views, &latent, rng.is_some())?.f_sigmoid()?;
        let weights = loss::pixel_weights(painted, self.options.paint_weight, self.options.small_weight)?;
        let mut loss = loss::reconstruction(&pictures_made, pictures, &weights)?;
        if let Some(divergence) = &divergence {
            let per_pixel = self.options.beta / (3 * 128 * 128) as f64;
            loss = loss.f_add(&divergence.f_mul_scalar(per_pixel)?)?;
        }
        // The exported latent is the mean, so the heads use it too.
        let told = self.heads.as_ref().zip(asked);
        let labels = told.map(|(heads, (theta, labels))| heads.loss(theta, &mean, labels)).transpose()?;
        if let Some(labels) = &labels {
            loss = loss.f_add(&labels.f_mul_scalar(self.options.label_weight)?)?;
        }
        Ok(Made { loss, divergence, labels, pictures: pictures_made })
    }

    /// Mean and deviation of the latent over training images.
    fn latent_statistics(&self) -> Result<(Tensor, Tensor), TchError> {
        let images = &self.resident.1.pixels;
        let every = (images.size()[0] / STANDARD_IMAGES).max(1);
        let views = self.network.views(&self.network.theta)?;
        let mut codes = Vec::new();
        let chosen = images.f_slice(0, 0, images.size()[0], every)?;
        for bytes in chosen.f_split(self.options.batch.max(1) as i64, 0)? {
            let code = self.network.encode(&views, &to_pictures(&bytes)?, None)?;
            codes.push(code.f_narrow(1, 0, self.network.architecture.latent)?);
        }
        let codes = Tensor::f_cat(&codes, 0)?;
        let mean = codes.f_mean_dim([0].as_slice(), false, Kind::Float)?;
        let deviation = codes.f_std_dim([0].as_slice(), false, false)?;
        // A nearly constant number must not be amplified to the others' size.
        let least = 0.05 * deviation.f_mean(Kind::Float)?.f_double_value(&[])?;
        Ok((mean, deviation.f_clamp_min(least.max(1e-4))?))
    }
}

impl Training for Trainer<'_> {
    type Validation = Validation;
    type Record = EpochRecord;
    type Summary = Trained;

    fn is_over(&self) -> bool {
        self.reached.walk.epoch >= self.options.epochs || self.is_late()
    }

    fn pass(
        &mut self,
        interrupt: &AtomicBool,
        report: &mut dyn FnMut(Progress),
    ) -> Result<Option<Pass>, TrainError> {
        self.load()?;
        let began = Instant::now();
        let epoch = self.reached.walk.epoch;
        // Dropout and augmentation of an epoch depend on its number alone.
        let mut rng = seeds::rng(self.options.seed, &format!("epoch {epoch}"));
        let images = self.resident.1.count();
        let mut order: Vec<i64> = (0..images).collect();
        order.shuffle(&mut seeds::rng(self.options.seed, &format!("order {epoch}")));
        let order = Tensor::f_from_slice(&order)?.f_to_device(self.device)?;
        let steps = self.steps();
        let batch = (self.options.batch as i64).clamp(1, images.max(1));
        let mut sum = Tensor::f_zeros([1], (Kind::Double, self.device))?;
        let (mut rate, mut seen, mut taken) = (0.0, 0, 0);
        for step in 0..steps {
            if interrupt.load(Ordering::Relaxed) {
                return Ok(None);
            }
            // At least one step per epoch.
            if step > 0 && self.is_late() {
                break;
            }
            let from = (step as i64 * batch).min(images - batch);
            let picked = self.resident.1.select(&order.f_narrow(0, from, batch)?)?;
            rate = self.learning_rate(self.done(step, steps));
            let loss = self.step(&picked, rate, &mut rng)?;
            sum = sum.f_add(&loss.f_to_kind(Kind::Double)?)?;
            seen += batch as u64;
            taken += 1;
            if (step + 1) % LOOK_EVERY == 0 || step + 1 == steps {
                let loss = loss.f_double_value(&[])?;
                self.require_finite(loss)?;
                report(Progress {
                    epoch,
                    step: self.reached.walk.step,
                    steps: self.reached.walk.step + steps - step - 1
                        + (self.options.epochs - epoch).saturating_sub(1) * steps,
                    loss,
                    validation: None,
                });
            }
        }
        let train_loss = sum.f_double_value(&[0])? / f64::from(taken.max(1));
        self.require_finite(train_loss)?;
        let reached = &self.reached.walk;
        let steps = reached.step + self.options.epochs.saturating_sub(reached.epoch + 1) * steps;
        let seconds = began.elapsed().as_secs_f64();
        Ok(Some(Pass { loss: train_loss, shown: seen, began, seconds, rate, steps }))
    }

    fn validate(&self) -> Result<Validation, TrainError> {
        let mut total = Validation::default();
        let (mut count, mut both, mut any) = (0.0, 0.0, 0.0);
        tch::no_grad(|| -> Result<(), TchError> {
            for batch in self.validation.split(self.options.batch)? {
                let n = batch.count() as f64;
                let pictures = to_pictures(&batch.pixels)?;
                let painted = loss::painted(&pictures)?;
                let asked = self.heads.as_ref().map(|heads| &heads.theta).zip(batch.labels.as_ref());
                let made = self.loss(&self.network.theta, &pictures, &painted, asked, None)?;
                let error = made.pictures.f_sub(&pictures)?.f_square()?;
                let error = error.f_mean_dim([1, 2, 3].as_slice(), false, Kind::Float)?;
                let psnr = error.f_clamp_min(1e-10)?.f_log10()?.f_mul_scalar(-10.0)?;
                let again = loss::painted(&made.pictures)?;
                both += again.f_mul(&painted)?.f_sum(Kind::Double)?.f_double_value(&[])?;
                any += again.f_maximum(&painted)?.f_sum(Kind::Double)?.f_double_value(&[])?;
                let value = |one: Option<Tensor>| one.map_or(Ok(0.0), |one| one.f_double_value(&[]));
                total.loss += n * made.loss.f_double_value(&[])?;
                total.psnr += psnr.f_sum(Kind::Double)?.f_double_value(&[])?;
                total.divergence += n * value(made.divergence)?;
                total.labels += n * value(made.labels)?;
                count += n;
            }
            Ok(())
        })?;
        let count = f64::max(count, 1.0);
        self.require_finite(total.loss / count)?;
        Ok(Validation {
            loss: total.loss / count,
            psnr: total.psnr / count,
            painted_iou: both / f64::max(any, 1.0),
            divergence: total.divergence / count,
            labels: total.labels / count,
        })
    }

    fn export(&self, validation: &Validation) -> Result<(), TrainError> {
        let (mean, deviation) = tch::no_grad(|| self.latent_statistics())?;
        let scores = serde_json::json!({ "validation": validation });
        let metadata = HashMap::from([
            (keys::CONFIG.to_string(), json(self.options)),
            (keys::DATASET.to_string(), json(&self.dataset.manifest)),
            (keys::SCORES.to_string(), json(&scores)),
        ]);
        let weights = weights_of(&self.network, &mean, &deviation, metadata)?;
        Ok(weights.save(&self.options.out.join("encoder.safetensors"))?)
    }

    fn save(&mut self, pass: &Pass) -> Result<(), TrainError> {
        self.reached.images += pass.shown;
        self.reached.walk.seconds += pass.began.elapsed().as_secs_f64();
        let mut tensors = self.network.named()?;
        let mut keep = |name: &str, adam: &mut Adam| {
            let named =
                |(which, moment): (_, &mut Tensor)| (format!("{name}.{which}"), moment.shallow_clone());
            tensors.extend(adam.moments().map(named));
        };
        keep("adam", &mut self.adam);
        if let Some(heads) = &mut self.heads {
            keep("labels.adam", &mut heads.adam);
            tensors.push(("labels.theta".to_string(), heads.theta.shallow_clone()));
        }
        let reached = serde_json::to_string(&self.reached).unwrap_or_default();
        let metadata = HashMap::from([(run::REACHED.to_string(), reached)]);
        let path = run::checkpoint(&self.options.out);
        let tensors = Stored::all(&tensors)?;
        Ok(Weights { path: path.clone(), tensors, metadata }.save(&path)?)
    }

    fn is_better(new: &Validation, best: &Validation) -> bool {
        new.loss < best.loss
    }

    fn reached(&mut self) -> &mut run::Reached<Validation> {
        &mut self.reached.walk
    }

    fn record(&self, pass: &Pass, validation: Validation, best: bool) -> EpochRecord {
        EpochRecord {
            epoch: self.reached.walk.epoch,
            step: self.reached.walk.step,
            images: self.reached.images,
            train_loss: pass.loss,
            validation,
            learning_rate: pass.rate,
            best,
            wall_seconds: self.reached.walk.seconds,
            images_per_second: pass.shown as f64 / pass.began.elapsed().as_secs_f64().max(1e-9),
        }
    }

    fn figures(record: &EpochRecord) -> (u64, Vec<(&'static str, f64)>) {
        let v = record.validation;
        let figures = vec![
            ("losses/train", record.train_loss),
            ("losses/validation", v.loss),
            ("losses/divergence", v.divergence),
            ("losses/labels", v.labels),
            ("charts/psnr", v.psnr),
            ("charts/painted_iou", v.painted_iou),
            ("charts/learning_rate", record.learning_rate),
            ("charts/images_per_second", record.images_per_second),
        ];
        (record.step, figures)
    }

    fn summary(&self, interrupted: bool) -> Trained {
        let (train, _) = self.dataset.split();
        Trained {
            out: self.options.out.clone(),
            encoder: self.options.out.join("encoder.safetensors"),
            epochs: self.reached.walk.epoch,
            steps: self.reached.walk.step,
            best_epoch: self.reached.walk.best_epoch,
            best: self.reached.walk.best.unwrap_or_default(),
            images: train.iter().map(|&s| self.dataset.shards[s].2).sum(),
            validation_images: self.validation.count() as usize,
            wall_seconds: self.reached.walk.seconds,
            images_per_second: self.reached.images as f64 / self.reached.walk.seconds.max(1e-9),
            interrupted,
        }
    }
}

/// The losses on a batch.
struct Made {
    /// All terms, weighted.
    loss: Tensor,
    divergence: Option<Tensor>,
    /// The heads' loss.
    labels: Option<Tensor>,
    pictures: Tensor,
}

/// Restores an optimiser's state from a checkpoint.
fn restore(adam: &mut Adam, weights: &Weights, name: &str, reached: &Reached) -> Result<(), WeightsError> {
    for (which, moment) in adam.moments() {
        let saved = weights.get(&format!("{name}.{which}"), &moment.size())?;
        moment.f_copy_(&saved)?;
    }
    adam.t = reached.walk.step as i64;
    Ok(())
}

fn json(value: &impl Serialize) -> String {
    serde_json::to_string(value).unwrap_or_default()
}

#[cfg(test)]
mod tests;
