//! Batches of camera pictures and targets for CenterNet, prepared by worker threads.

use super::weathering::{self, View};
use crate::dataset::{
    BoxRecord, CameraPlace, Dataset, DatasetError, FrameRecord, ShardReader, decode_camera,
};
use rand::RngExt;
use rand::seq::SliceRandom;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use sumo_network::seeds;
use tch::{Device, Kind, TchError, Tensor};
use wad_camera::CameraConfig;
use wad_camera::model::{ObjectClass, Sign};
use wad_see::perception::centernet::decode::decode_signs;
use wad_see::perception::centernet::reader::{self, PLATE};
use wad_see::perception::centernet::road_targets::{RoadTargets, UNKNOWN};
use wad_see::perception::centernet::targets::{Centre, Wanted, Window, encode, shares};
use wad_see::perception::centernet::{Backbone, Part, kind::STRIDE, loss::Target};
use wad_see::perception::coco::class_index;
use wad_see::perception::metrics::{Scored, Truth};
use wad_see::perception::{GroundPlane, RoadWanted, SignTruth, score};

/// Lowest box that is trained on (pixels): lower ones count neither as object nor as background.
const LEAST_HEIGHT: f32 = 8.0;
/// A class in a smaller share of the frames than this is repeated (Gupta et al. 2019, "LVIS":
/// repeat factor sampling), but no frame more often than the second number.
const COMMON: f64 = 0.25;
const MOST_REPEATS: f64 = 4.0;
/// How often a frame without objects is used per epoch.
const EMPTY: f64 = 0.25;

/// The side of a camera picture (pixels).
pub const SIDE: usize = 512;

/// A frame: the place of its picture, and its objects.
#[derive(Clone, Debug)]
pub struct Sample {
    picture: Picture,
    objects: Vec<BoxRecord>,
    /// None where the dataset does not say.
    road: Option<RoadWanted>,
}

/// Pictures are read from their shard each time: the system's file cache holds what fits into memory.
#[derive(Clone, Debug)]
enum Picture {
    Shard(CameraPlace),
    #[cfg(test)]
    Bytes(Vec<u8>),
}

impl Sample {
    /// The picture's RGB bytes.
    ///
    /// # Errors
    /// It is damaged, or has another size than the camera's.
    pub fn rgb(&self) -> Result<Vec<u8>, DatasetError> {
        match &self.picture {
            Picture::Shard(place) => decode_camera(place.codec(), &place.read()?, SIDE, SIDE),
            #[cfg(test)]
            Picture::Bytes(png) => decode_camera(crate::dataset::CameraCodec::Png, png, SIDE, SIDE),
        }
    }

    /// The network's training targets.
    fn wanted(&self) -> impl Iterator<Item = Wanted> {
        self.objects.iter().map(truth).map(|Truth { label, bounds, ignored }| {
            let ignored = ignored || bounds[3] - bounds[1] < LEAST_HEIGHT;
            Wanted { class: label, bounds, ignored }
        })
    }

    /// What is true of its road; None where the dataset does not say.
    pub fn road(&self) -> Option<&RoadWanted> {
        self.road.as_ref()
    }

    /// Whether signs are in it that are to be read.
    fn has_signs(&self) -> bool {
        plain(self.road.as_ref()).next().is_some()
    }

    /// The ground truth to score a detector by; its detections are to be added.
    pub fn truths(&self) -> Scored {
        Scored { truths: self.objects.iter().map(truth).collect(), found: Vec::new() }
    }
}

/// The signs that are to be read.
fn plain(road: Option<&RoadWanted>) -> impl Iterator<Item = &SignTruth> {
    road.into_iter().flat_map(|road| &road.signs).flatten().filter(|sign| sign.is_plain)
}

fn truth(object: &BoxRecord) -> Truth {
    score::truth(object.class, object.pixels, object.visible, object.full)
}

/// The frames of these shards, at most `most`, spread evenly. A damaged frame ends its shard with a warning.
///
/// # Errors
/// A shard cannot be opened, or the dataset keeps no camera pictures.
pub fn samples(dataset: &Dataset, shards: &[usize], most: usize) -> Result<Vec<Sample>, DatasetError> {
    if !dataset.manifest.keeps_camera {
        return Err(DatasetError::Empty {
            path: dataset.folder.clone(),
            hint: " with camera pictures; collect it with --camera",
        });
    }
    let all: usize = shards.iter().map(|&s| dataset.shards[s].2).sum();
    let every = all.div_ceil(most.max(1)).max(1);
    let (mut found, mut seen) = (Vec::new(), 0_usize);
    for &shard in shards {
        for (record, place) in dataset.read(shard, ShardReader::next_place)? {
            if seen.is_multiple_of(every) {
                let road = road(&record);
                found.push(Sample { picture: Picture::Shard(place), objects: record.boxes, road });
            }
            seen += 1;
        }
    }
    Ok(found)
}

/// What the road's heads are to say of a frame.
fn road(record: &FrameRecord) -> Option<RoadWanted> {
    let road = record.road.as_ref()?;
    let objects = record.boxes.iter().map(|one| (one.id, one.visible.map(|v| v as f32), truth(one).ignored));
    Some(road.wanted(objects, record.light))
}

/// The classes of objects, and signs as one more.
const SHOWN: usize = 9;

/// How often each sample is used per epoch; where only one head learns, none of which nobody knows what it is to say.
fn repeats(samples: &[Sample], only: Option<Part>) -> Vec<f64> {
    let present = |sample: &Sample| {
        let mut classes = [false; SHOWN];
        classes[SHOWN - 1] = sample.has_signs();
        for wanted in sample.wanted().filter(|w| !w.ignored) {
            classes[wanted.class] = true;
        }
        classes
    };
    let present: Vec<[bool; SHOWN]> = samples.iter().map(present).collect();
    let share =
        |class: usize| present.iter().filter(|p| p[class]).count() as f64 / samples.len().max(1) as f64;
    // Traffic lights are in nearly every frame, so they do not raise a frame's rate.
    let light = class_index(ObjectClass::TrafficLight);
    let factors: Vec<f64> =
        (0..SHOWN).map(|c| (COMMON / share(c).max(1e-9)).sqrt().clamp(1.0, MOST_REPEATS)).collect();
    let counts = |class: usize| if only == Some(Part::Signs) { class == SHOWN - 1 } else { class != light };
    let times = |(p, sample): (&[bool; SHOWN], &Sample)| {
        let best = (0..SHOWN).filter(|&c| p[c] && counts(c)).map(|c| factors[c]).fold(0.0, f64::max);
        let is_known = |part| match (part, &sample.road) {
            (_, None) => false,
            (Part::Signs, Some(road)) => road.signs.is_some(),
            (Part::Area, Some(road)) => road.area.is_some(),
        };
        match only {
            Some(part) if !is_known(part) => 0.0,
            Some(Part::Area) => 1.0,
            _ if best == 0.0 => EMPTY,
            _ => best,
        }
    };
    present.iter().zip(samples).map(times).collect()
}

/// The samples of an epoch, shuffled.
fn order(repeats: &[f64], seed: u64, epoch: u64) -> Vec<usize> {
    let mut rng = seeds::rng(seed, &format!("detector epoch {epoch}"));
    let mut order = Vec::new();
    for (index, &times) in repeats.iter().enumerate() {
        let count = times as usize + usize::from(rng.random::<f64>() < times.fract());
        order.extend((0..count).map(|_| index));
    }
    order.shuffle(&mut rng);
    order
}

/// The windows of an epoch's steps, largest last.
///
/// Most steps use small windows round objects: a third of the work of whole pictures, and hardly any
/// empty road. The last steps use whole pictures, fewer at a time, so that batch norm ends with the
/// statistics of whole pictures.
#[derive(Clone, Copy, Debug)]
pub struct Show<'a> {
    /// The feature extractor.
    pub backbone: Backbone,
    /// Pictures per step with small windows.
    pub batch: usize,
    /// Width and height of the small windows; None: whole pictures only.
    pub window: Option<(usize, usize)>,
    /// Augment weather, light and colours.
    pub vary: bool,
    /// Nothing but this head learns. For signs: frames with signs that are to be read, and a quarter of the others.
    pub only: Option<Part>,
    /// Signs that are copied into whole pictures; for training nothing but signs, since they hide what is there.
    pub plates: &'a [Plate],
}

/// Share of an epoch's steps that use whole pictures.
const WHOLE: f64 = 0.25;
/// Share of small windows that lie anywhere, not round an object.
const ANYWHERE: f64 = 0.2;
/// Small windows cut from a picture once it is decoded, which costs a tenth as much as a training step.
const WINDOWS: usize = 2;

impl Show<'_> {
    /// Windows per picked sample, for windows of this size.
    fn per_sample(&self, size: (usize, usize)) -> usize {
        if size.1 < self.whole().height { WINDOWS } else { 1 }
    }

    fn whole(&self) -> Window {
        Window::whole(self.backbone, (SIDE, SIDE))
    }

    /// Size of the windows in a step, and pictures per step.
    fn step(&self, step: usize, steps: usize) -> ((usize, usize), usize) {
        let whole = self.whole();
        match self.window {
            Some((w, h)) if (step as f64) < (1.0 - WHOLE) * steps as f64 => ((w, h), self.batch),
            Some((w, h)) => {
                let fewer = self.batch * w * h / (whole.width * whole.height);
                ((whole.width, whole.height), fewer.clamp(2.min(self.batch), self.batch))
            }
            None => ((whole.width, whole.height), self.batch),
        }
    }

    /// A window of this size: round one of the objects (width-wise evenly, so that it is seen near the
    /// borders too), or anywhere.
    fn place(&self, (width, height): (usize, usize), wanted: &[Wanted], rng: &mut impl RngExt) -> Window {
        let whole = self.whole();
        let taught: Vec<&Wanted> = wanted.iter().filter(|w| !w.ignored).collect();
        let target = (!taught.is_empty() && rng.random::<f64>() >= ANYWHERE)
            .then(|| taught[rng.random_range(0..taught.len())].bounds);
        let mut along = |low: f32, high: f32, side: usize, first: usize, all: usize| {
            let most = all - side;
            let start = match target {
                Some(_) => 0.5 * (low + high) - first as f32 - side as f32 * rng.random_range(0.1..0.9),
                None => rng.random::<f32>() * most as f32,
            };
            first + (start.max(0.0) as usize).min(most)
        };
        let [l, t, r, b] = target.unwrap_or_default();
        let left = along(l, r, width, whole.left, whole.width);
        let top = along(t, b, height, whole.top, whole.height);
        Window { left, top, width, height }
    }
}

/// A batch on the CPU.
#[derive(Debug)]
pub struct Batch {
    count: usize,
    /// Width and height of each window.
    size: (usize, usize),
    /// count x height x width x 3.
    pixels: Vec<u8>,
    /// count x 8 x h x w.
    heat: Vec<f32>,
    /// The objects' centres, and in which picture each is.
    centres: Vec<(usize, Centre)>,
    /// For whole pictures.
    road: Option<RoadTargets>,
    /// Of whole pictures: the signs in each, and the plates (3 x 24 x 24) of those that are to be read with what they say.
    signs: Vec<Vec<SignTruth>>,
    plates: (Vec<f32>, Vec<i64>),
}

impl Batch {
    /// `count` windows of the picked samples, mirrored at random, their weather varied.
    fn new(
        show: &Show<'_>,
        samples: &[Sample],
        (picked, count): (&[usize], usize),
        size: (usize, usize),
        rng: &mut impl RngExt,
    ) -> Result<Self, DatasetError> {
        let (width, height) = size;
        let (bytes, shape) = (width * height * 3, (width / STRIDE, height / STRIDE));
        let cells = shape.0 * shape.1 * 8;
        let mut batch = Self {
            count,
            size,
            pixels: Vec::with_capacity(count * bytes),
            heat: vec![0.0; count * cells],
            centres: Vec::new(),
            road: None,
            signs: Vec::new(),
            plates: Default::default(),
        };
        let cuts_rows = height < show.whole().height;
        let is_whole = (width, height) == (SIDE, show.whole().height);
        let mut roads = Vec::with_capacity(count);
        let mut rgb = Vec::new();
        let mut decoded = None;
        for n in 0..count {
            let index = picked[n / show.per_sample(size)];
            if decoded != Some(index) {
                (rgb, decoded) = (samples[index].rgb()?, Some(index));
            }
            let wanted: Vec<Wanted> = samples[index].wanted().collect();
            let window = show.place(size, &wanted, rng);
            let start = batch.pixels.len();
            for y in window.top..window.top + height {
                batch.pixels.extend(&rgb[(y * SIDE + window.left) * 3..][..width * 3]);
            }
            let mut road = samples[index].road.clone().filter(|_| is_whole);
            let signs = road.as_mut().and_then(|road| road.signs.as_mut());
            if let Some(signs) = signs.filter(|_| !show.plates.is_empty()) {
                copied_signs::copy(show.plates, &mut batch.pixels[start..], window.top, signs, rng);
            }
            if show.vary {
                let Window { left, top, .. } = window;
                let view = View { left, top, width, objects: &samples[index].objects };
                weathering::weather(&mut batch.pixels[start..], view, rng);
            }
            // In a mirror nobody can read.
            let mirrored = rng.random::<bool>() && plain(road.as_ref()).next().is_none();
            if mirrored {
                for row in batch.pixels[start..].chunks_exact_mut(3 * width) {
                    row.as_chunks_mut::<3>().0.reverse();
                }
            }
            let shown = wanted.iter().filter_map(|one| window.view(one, cuts_rows)).map(|mut one| {
                if mirrored {
                    let [l, t, r, b] = one.bounds;
                    one.bounds = [width as f32 - r, t, width as f32 - l, b];
                }
                one
            });
            let shown: Vec<Wanted> = shown.collect();
            let centres = encode(&shown, shape, &mut batch.heat[n * cells..][..cells], shares);
            batch.centres.extend(centres.into_iter().map(|one| (n, one)));
            roads.push(road.map(|road| if mirrored { road.mirrored(width as f32) } else { road }));
        }
        if is_whole {
            let ground = GroundPlane::new(&CameraConfig::default());
            let targets = batch.road.insert(RoadTargets::default());
            roads.iter().for_each(|road| targets.add(road.as_ref(), &ground));
            for (road, picture) in roads.iter().zip(batch.pixels.chunks_exact(bytes)) {
                batch.signs.push(road.iter().flat_map(|road| road.signs.iter().flatten().copied()).collect());
                for sign in plain(road.as_ref()) {
                    batch.plates.0.extend(plate_of(sign, picture, show.whole().top, rng));
                    batch.plates.1.push(sign.sign.index() as i64);
                }
            }
        }
        Ok(batch)
    }

    /// Pictures in the batch.
    pub fn count(&self) -> usize {
        self.count
    }

    /// The road's targets, of whole pictures.
    pub fn road(&self) -> Option<&RoadTargets> {
        self.road.as_ref()
    }

    /// The plates of signs (n, 3, 24, 24), and what they say (n; [`UNKNOWN`] in plates that fill up), with what the head
    /// for signs (n, 14, h, w) found where none is; None where there are none.
    ///
    /// # Errors
    /// torch fails.
    pub fn plates(&self, found: &Tensor, device: Device) -> Result<Option<(Tensor, Vec<i64>)>, TchError> {
        let (mut plates, mut said) = self.plates.clone();
        let ground = GroundPlane::new(&CameraConfig::default());
        let found = found.f_detach()?.f_to_device(Device::Cpu)?.f_contiguous()?;
        let mut map = vec![0.0; found.numel() / self.count.max(1)];
        let top = Backbone::Light.rows(SIDE).0;
        let pictures = self.pixels.chunks_exact(self.pixels.len() / self.count.max(1));
        for (n, (picture, signs)) in pictures.zip(&self.signs).enumerate() {
            let one = found.f_get(n as i64)?;
            one.f_copy_data(&mut map, one.numel())?;
            for sign in decode_signs(&map, &ground).into_iter().flatten() {
                let [x, y] = sign.pixel;
                let is_near = |truth: &SignTruth| {
                    truth.away(sign.pixel) < NEAR + 0.5 * (truth.bounds[2] - truth.bounds[0])
                };
                if !signs.iter().any(is_near) {
                    plates.extend(reader::plate(picture, SIDE, [x, y - top as f32], sign.radius));
                    said.push(Sign::KINDS as i64);
                }
            }
        }
        if said.is_empty() {
            return Ok(None);
        }
        if device.is_cuda() {
            said.resize(said.len().next_multiple_of(FILLED_UP), UNKNOWN);
            plates.resize(said.len() * 3 * PLATE * PLATE, 0.0);
        }
        let side = PLATE as i64;
        let plates = Tensor::f_from_slice(&plates)?.f_view([-1, 3, side, side])?.f_to_device(device)?;
        Ok(Some((plates, said)))
    }

    /// Pictures (n, 3, height, width) from 0 to 1, and their targets.
    ///
    /// # Errors
    /// torch fails.
    pub fn load(&self, device: Device) -> Result<(Tensor, Target), TchError> {
        let n = self.count as i64;
        let (width, height) = (self.size.0 as i64, self.size.1 as i64);
        let pixels = Tensor::f_from_data_size(&self.pixels, &[n, height, width, 3], Kind::Uint8)?;
        let x = pixels.f_to_device(device)?.f_to_kind(Kind::Float)?.f_mul_scalar(1.0 / 255.0)?;
        // The permuted view keeps the channels innermost, which is faster for convolutions on the CPU.
        let x = x.f_permute([0, 3, 1, 2])?;
        let (h, w) = (height / STRIDE as i64, width / STRIDE as i64);
        let heat = Tensor::f_from_slice(&self.heat)?.f_view([n, 8, h, w])?;
        Ok((x, Target::new(heat, &self.centres, device)?))
    }
}

/// On a GPU plates are filled up to a multiple of this, for cuDNN plans anew for each new shape.
const FILLED_UP: usize = 128;

/// What is found this far beyond a sign's plate may be meant for it (pixels).
const NEAR: f32 = 6.0;
/// How far a sign is found from where it is (pixels), and how far from as large as it is (its share).
const FOUND: (f32, f32) = (2.2, 0.12);

/// The picture of a sign's plate as one who found it sees it, in a picture that begins with row `top` of the camera's.
fn plate_of(sign: &SignTruth, picture: &[u8], top: usize, rng: &mut impl RngExt) -> Vec<f32> {
    let [l, t, r, b] = sign.bounds;
    let mut off = |most: f32| rng.random_range(-most..=most);
    let middle = [0.5 * (l + r) + off(FOUND.0), 0.5 * (t + b) - top as f32 + off(FOUND.0)];
    reader::plate(picture, SIDE, middle, 0.5 * (r - l) * (1.0 + off(FOUND.1)))
}

/// Makes the batches of an epoch on `workers` threads and passes each to `take`, in an order that does not
/// depend on their number. `take` says whether to go on.
///
/// # Errors
/// A picture is damaged, or `take` fails.
pub fn epoch<E: From<DatasetError>>(
    show: Show<'_>,
    samples: &[Sample],
    steps: usize,
    (seed, epoch): (u64, u64),
    workers: usize,
    mut take: impl FnMut(Batch) -> Result<bool, E>,
) -> Result<(), E> {
    let order = order(&repeats(samples, show.only), seed, epoch);
    if order.is_empty() {
        return Ok(());
    }
    let mut picks = Vec::with_capacity(steps);
    let mut next = order.iter().copied().cycle();
    for step in 0..steps {
        let (size, count) = show.step(step, steps);
        let samples = count.div_ceil(show.per_sample(size));
        picks.push((size, count, next.by_ref().take(samples).collect::<Vec<usize>>()));
    }
    let workers = workers.clamp(1, picks.len().max(1));
    std::thread::scope(|scope| {
        let mut queues: Vec<Receiver<Result<Batch, DatasetError>>> = Vec::new();
        for worker in 0..workers {
            let (send, receive): (SyncSender<_>, _) = sync_channel(2);
            queues.push(receive);
            let (picks, show) = (&picks, &show);
            scope.spawn(move || {
                for (n, (size, count, picked)) in picks.iter().enumerate().skip(worker).step_by(workers) {
                    let mut rng = seeds::rng(seed, &format!("detector epoch {epoch} step {n}"));
                    if send.send(Batch::new(show, samples, (picked, *count), *size, &mut rng)).is_err() {
                        return; // the receiver is gone
                    }
                }
            });
        }
        for n in 0..picks.len() {
            let Ok(batch) = queues[n % workers].recv() else { break };
            if !take(batch?)? {
                break;
            }
        }
        drop(queues);
        Ok(())
    })
}

/// Steps of one epoch over these samples, at most `most`; 0 where none of them is shown. `only` as in [`Show`].
pub fn steps(samples: &[Sample], only: Option<Part>, batch: usize, most: usize) -> usize {
    let shown: f64 = repeats(samples, only).iter().sum();
    (shown as usize / batch.max(1)).max(usize::from(shown > 0.0)).min(most)
}

mod copied_signs;
pub use copied_signs::{Plate, plates};

#[cfg(test)]
mod tests;
