//! Scores an encoder on frames that it was not trained on.

use super::probe::{Probe, Regression, auc, explained};
use super::score::{ObjectScore, psnr, ssim};
use super::told::Told;
use crate::dataset::{Dataset, DatasetError, FrameRecord, ShardReader};
use serde::Serialize;
use std::collections::BTreeMap;
use tch::Device;
use wad_camera::{CameraConfig, Preset};
use wad_see::latent::encoder::TchEncoder;
use wad_see::latent::packed::Scratch;
use wad_see::latent::{Encoder, LatentError};
use wad_see::observation::LATENT_SIZE;
use wad_see::perception::{TRANSFORMED_SIZE, TransformedImage};
use wad_sim::cpu_time;
use wad_sim::stats::median;

/// Why an encoder cannot be scored.
#[derive(Debug, thiserror::Error)]
pub enum JudgeError {
    /// A dataset cannot be read.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// The encoder fails.
    #[error(transparent)]
    Latent(#[from] LatentError),
}

impl From<tch::TchError> for JudgeError {
    fn from(error: tch::TchError) -> Self {
        Self::Latent(error.into())
    }
}

/// A linear probe's result.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct ProbeScore {
    /// Area under the ROC curve on the measured frames; None where one kind of frame is missing.
    pub auc: Option<f64>,
    /// Frames with the object among the fitted ones.
    pub fitted_positives: usize,
    /// Frames with the object among the measured ones.
    pub measured_positives: usize,
}

/// The scores of an encoder.
#[derive(Clone, Debug, Serialize)]
pub struct Judgement {
    /// The encoder's hash.
    pub encoder: String,
    /// The town of the measured frames.
    pub town: String,
    /// Number of measured frames.
    pub frames: usize,
    /// Mean PSNR of the reconstructions (dB).
    pub psnr_db: f64,
    /// Mean SSIM of the reconstructions.
    pub ssim: f64,
    /// Mean PSNR by weather (dB).
    pub psnr_by_weather: BTreeMap<&'static str, f64>,
    /// Counts of painted objects and of those that the reconstruction keeps.
    pub objects: ObjectScore,
    /// Share of large painted objects kept.
    pub kept_large: f64,
    /// Share of small painted objects kept.
    pub kept_small: f64,
    /// Share of tiny painted objects kept.
    pub kept_tiny: f64,
    /// Intersection over union of blue pixels.
    pub blue_iou: f64,
    /// CPU time of one image through the encoder, one thread, median (ms).
    pub encode_ms: f64,
    /// Number of frames that the probes are fitted on.
    pub probe_frames: usize,
    /// The town of those frames.
    pub probe_town: String,
    /// A vehicle in the lane within 20 m.
    pub lead: ProbeScore,
    /// A pedestrian in the lane within 15 m.
    pub pedestrian: ProbeScore,
    /// The light painted red.
    pub red: ProbeScore,
    /// The ego's offset from its lane's centre (m), on frames with a painted boundary.
    pub lateral: LinearScore,
    /// Heading of the waypoint ahead minus the ego's (rad), on the same frames.
    pub heading: LinearScore,
    /// Gap to the vehicle in the lane within 20 m (m).
    pub gap: LinearScore,
    /// The probe for the vehicle, measured only where the route goes straight on: where it turns, the picture
    /// does not show which of the roads ahead is the ego's.
    pub lead_straight: ProbeScore,
    /// The same probes on the picture itself: the share of blue in each cell of 8x8 pixels.
    pub lead_of_picture: ProbeScore,
    /// The same probe for a pedestrian in the lane.
    pub pedestrian_of_picture: ProbeScore,
    /// Middle of the two painted boundaries (m, left of the ego), on frames with both.
    pub middle: LinearScore,
    /// Slope of the painted boundaries.
    pub slope: LinearScore,
    /// Their middle from the share of green in each 4x4 pixels.
    pub middle_of_picture: LinearScore,
    /// Their slope from the share of green in each 4x4 pixels.
    pub slope_of_picture: LinearScore,
}

/// A linear regression's result on the measured frames.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct LinearScore {
    /// Share of the variance that it explains; None without frames.
    pub r2: Option<f64>,
    /// Median absolute error, in the quantity's unit.
    pub median_error: Option<f64>,
    /// Frames with the quantity among the fitted ones.
    pub fitted: usize,
    /// Frames with the quantity among the measured ones.
    pub measured: usize,
}

/// Frames encoded at once.
const BATCH: usize = 64;

/// A batch of frames with latents and reconstructions.
struct Batch {
    records: Vec<FrameRecord>,
    latents: Vec<Vec<f32>>,
    images: Vec<TransformedImage>,
    /// Empty where none were wanted.
    reconstructions: Vec<TransformedImage>,
}

/// Frames as probes see them.
#[derive(Default)]
struct Seen {
    latents: Vec<Vec<f32>>,
    told: Vec<Told>,
    /// Shares of blue and of green by cell.
    blue: Vec<Vec<f32>>,
    green: Vec<Vec<f32>>,
}

impl Seen {
    fn add(&mut self, batch: Batch) {
        self.told.extend(batch.records.iter().map(Told::of));
        self.latents.extend(batch.latents);
        let is_blue = |[r, g, b]: [u8; 3]| b > 180 && u16::from(r) + u16::from(g) < 115;
        let is_green = |[r, g, b]: [u8; 3]| g > 150 && u16::from(r) + u16::from(b) < 150;
        self.blue.extend(batch.images.iter().map(|image| shares(image, 8, is_blue)));
        self.green.extend(batch.images.iter().map(|image| shares(image, 4, is_green)));
    }
}

/// The share of matching pixels in each cell, row by row.
fn shares(image: &TransformedImage, cell: usize, is_such: impl Fn([u8; 3]) -> bool) -> Vec<f32> {
    let across = TRANSFORMED_SIZE / cell;
    let mut shares = vec![0.0; across * across];
    for (at, pixel) in image.bytes().as_chunks::<3>().0.iter().enumerate() {
        let (x, y) = (at % TRANSFORMED_SIZE / cell, at / TRANSFORMED_SIZE / cell);
        shares[y * across + x] += f32::from(u8::from(is_such(*pixel))) / (cell * cell) as f32;
    }
    shares
}

/// Standardised like latents: mean 0 and deviation 1 over the first frames. Nearly constant numbers stay
/// small.
fn standardise(known: &mut [Vec<f32>], unseen: &mut [Vec<f32>]) {
    let count = known.len().max(1) as f32;
    for i in 0..known.first().map_or(0, Vec::len) {
        let mean = known.iter().map(|row| row[i]).sum::<f32>() / count;
        let square = known.iter().map(|row| (row[i] - mean).powi(2)).sum::<f32>() / count;
        let factor = 1.0 / (square.sqrt() + 1e-3);
        for row in known.iter_mut().chain(unseen.iter_mut()) {
            row[i] = (row[i] - mean) * factor;
        }
    }
}

/// Fits logistic probes on the first frames and measures them on the others, where `counts` says so.
fn probe(
    (known, unseen): (&[Vec<f32>], &[Vec<f32>]),
    (told, wanted): (&[Told], &[Told]),
    what: fn(&Told) -> bool,
    counts: fn(&Told) -> bool,
) -> ProbeScore {
    let fitted: Vec<bool> = told.iter().map(what).collect();
    let measured: Vec<bool> = wanted.iter().filter(|told| counts(told)).map(what).collect();
    let ranked = Probe::fit(known, &fitted).and_then(|probe| {
        let counted = unseen.iter().zip(wanted).filter(|(_, told)| counts(told));
        let scores: Vec<f64> = counted.map(|(row, _)| probe.score(row)).collect();
        auc(&scores, &measured)
    });
    let count = |labels: &[bool]| labels.iter().filter(|label| **label).count();
    ProbeScore { auc: ranked, fitted_positives: count(&fitted), measured_positives: count(&measured) }
}

/// The same by least squares, of the frames that have the value.
fn regress(
    (known, unseen): (&[Vec<f32>], &[Vec<f32>]),
    (told, wanted): (&[Told], &[Told]),
    what: fn(&Told) -> Option<f64>,
) -> LinearScore {
    let pick = |rows: &[Vec<f32>], told: &[Told]| -> (Vec<Vec<f32>>, Vec<f64>) {
        rows.iter().zip(told).filter_map(|(x, told)| Some((x.clone(), what(told)?))).unzip()
    };
    let ((x, y), (unseen, wanted)) = (pick(known, told), pick(unseen, wanted));
    let made = Regression::fit(&x, &y).map(|line| unseen.iter().map(|x| line.value(x)).collect::<Vec<_>>());
    let errors: Vec<f64> =
        made.iter().flatten().zip(&wanted).map(|(made, wanted)| (made - wanted).abs()).collect();
    LinearScore {
        r2: made.and_then(|made| explained(&made, &wanted)),
        median_error: (!errors.is_empty()).then(|| median(errors)),
        fitted: y.len(),
        measured: wanted.len(),
    }
}

/// Scores `encoder` on `frames` of `measured`, evenly over it; probes are fitted on `fitted`.
///
/// # Errors
/// A dataset cannot be read, or torch fails.
pub fn judge(
    encoder: &TchEncoder,
    measured: &Dataset,
    fitted: &Dataset,
    (frames, probe_frames): (usize, usize),
    mut report: impl FnMut(usize),
) -> Result<Judgement, JudgeError> {
    let camera = CameraConfig::default();
    let (mut psnr_sum, mut ssim_sum, mut objects) = (0.0, 0.0, ObjectScore::default());
    let mut by_weather: BTreeMap<Preset, (f64, f64)> = BTreeMap::new();
    let (mut unseen, mut known) = (Seen::default(), Seen::default());
    each(encoder, measured, frames, true, |batch| {
        let pairs = batch.images.iter().zip(&batch.reconstructions);
        for (record, (wanted, made)) in batch.records.iter().zip(pairs) {
            let db = psnr(wanted, made);
            psnr_sum += db;
            ssim_sum += ssim(wanted, made);
            let sum = by_weather.entry(record.weather).or_default();
            *sum = (sum.0 + db, sum.1 + 1.0);
            objects.add(wanted, made, &record.boxes, (camera.width, camera.height));
        }
        unseen.add(batch);
        report(unseen.told.len());
    })?;
    each(encoder, fitted, probe_frames, false, |batch| {
        known.add(batch);
        report(unseen.told.len() + known.told.len());
    })?;
    standardise(&mut known.blue, &mut unseen.blue);
    standardise(&mut known.green, &mut unseen.green);
    let told = (known.told.as_slice(), unseen.told.as_slice());
    let latents = (known.latents.as_slice(), unseen.latents.as_slice());
    let blue = (known.blue.as_slice(), unseen.blue.as_slice());
    let green = (known.green.as_slice(), unseen.green.as_slice());
    let count = unseen.told.len().max(1) as f64;
    Ok(Judgement {
        encoder: wad_see::latent::Encoder::hash(encoder).to_string(),
        town: measured.manifest.town.clone(),
        frames: unseen.told.len(),
        psnr_db: psnr_sum / count,
        ssim: ssim_sum / count,
        psnr_by_weather: by_weather.into_iter().map(|(w, (sum, n))| (w.name(), sum / n)).collect(),
        objects,
        kept_large: objects.large.share(),
        kept_small: objects.small.share(),
        kept_tiny: objects.tiny.share(),
        blue_iou: objects.blue_iou(),
        encode_ms: encode_ms(encoder)?,
        probe_frames: known.told.len(),
        probe_town: fitted.manifest.town.clone(),
        lead: probe(latents, told, Told::has_lead, |_| true),
        pedestrian: probe(latents, told, Told::has_pedestrian, |_| true),
        red: probe(latents, told, |told| told.labels.red, |_| true),
        lateral: regress(latents, told, |told| told.on_lane.map(|[lateral, _]| lateral)),
        heading: regress(latents, told, |told| told.on_lane.map(|[_, heading]| heading)),
        gap: regress(latents, told, Told::gap),
        lead_straight: probe(latents, told, Told::has_lead, |told| told.straight),
        lead_of_picture: probe(blue, told, Told::has_lead, |_| true),
        pedestrian_of_picture: probe(blue, told, Told::has_pedestrian, |_| true),
        middle: regress(latents, told, Told::middle),
        slope: regress(latents, told, Told::slope),
        middle_of_picture: regress(green, told, Told::middle),
        slope_of_picture: regress(green, told, Told::slope),
    })
}

/// Median CPU time of one image through the encoder (ms).
fn encode_ms(encoder: &TchEncoder) -> Result<f64, JudgeError> {
    let image = TransformedImage::default();
    let (mut scratch, mut latent, mut times) = (Scratch::default(), Vec::new(), Vec::new());
    for _ in 0..100 {
        let before = cpu_time::of_thread();
        encoder.encode_one(&image, &mut scratch, &mut latent)?;
        times.extend(cpu_time::of_thread().zip(before).map(|(after, before)| 1000.0 * (after - before)));
    }
    Ok(median(times))
}

/// Passes `frames` frames of `dataset`, evenly over it, to `take` in batches.
fn each(
    encoder: &TchEncoder,
    dataset: &Dataset,
    frames: usize,
    reconstruct: bool,
    mut take: impl FnMut(Batch),
) -> Result<(), JudgeError> {
    let (made, shown) = (dataset.manifest.image, encoder.image_kind());
    if made != shown {
        return Err(LatentError::Encoder(format!(
            "it was trained on {} images, and those of {} are {}; name another dataset or encoder",
            shown.name(),
            dataset.folder.display(),
            made.name()
        ))
        .into());
    }
    let total = dataset.frames();
    let mut number = 0;
    let mut records = Vec::new();
    let mut images: Vec<TransformedImage> = Vec::new();
    let mut hand_over = |records: &mut Vec<FrameRecord>, images: &mut Vec<TransformedImage>| {
        if images.is_empty() {
            return Ok(());
        }
        let wanted = std::mem::take(images);
        let refs: Vec<&TransformedImage> = wanted.iter().collect();
        let latents = encoder.encode_all(&refs, BATCH)?;
        let made = if reconstruct { decode_all(encoder, &latents)? } else { Vec::new() };
        take(Batch { records: std::mem::take(records), latents, images: wanted, reconstructions: made });
        Ok::<(), JudgeError>(())
    };
    for shard in 0..dataset.shards.len() {
        for frame in dataset.read(shard, ShardReader::next_frame)? {
            // Evenly: frame n is taken when n * frames / total grows.
            let due = frames >= total || (number + 1) * frames / total > number * frames / total;
            number += 1;
            if due {
                records.push(frame.record);
                images.push(frame.transformed);
            }
            if images.len() == BATCH {
                hand_over(&mut records, &mut images)?;
            }
        }
    }
    hand_over(&mut records, &mut images)
}

/// Images of latents.
///
/// # Errors
/// torch fails.
pub fn decode_all(encoder: &TchEncoder, latents: &[Vec<f32>]) -> Result<Vec<TransformedImage>, LatentError> {
    let mut images = Vec::with_capacity(latents.len());
    for latents in latents.chunks(BATCH) {
        let flat: Vec<f32> = latents.iter().flatten().copied().collect();
        let tensor = tch::Tensor::f_from_slice(&flat)?.f_view([-1, LATENT_SIZE as i64])?;
        let made = encoder.decode_tensor(&tensor)?.f_to_device(Device::Cpu)?;
        let mut bytes = vec![0; latents.len() * TransformedImage::BYTES];
        let count = bytes.len();
        made.f_copy_data(&mut bytes, count)?;
        let chunks = bytes.chunks(TransformedImage::BYTES);
        images.extend(chunks.filter_map(|chunk| TransformedImage::from_bytes(chunk.to_vec())));
    }
    Ok(images)
}

/// For the paper's figure 5: `count` transformed images, evenly over a dataset, each with its reconstruction.
///
/// # Errors
/// The dataset cannot be read, or torch fails.
pub fn pairs(
    encoder: &TchEncoder,
    dataset: &Dataset,
    count: usize,
) -> Result<Vec<(TransformedImage, TransformedImage)>, JudgeError> {
    let mut pairs = Vec::new();
    each(encoder, dataset, count, true, |batch| {
        pairs.extend(batch.images.into_iter().zip(batch.reconstructions))
    })?;
    Ok(pairs)
}
