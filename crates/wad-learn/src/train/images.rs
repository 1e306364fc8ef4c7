//! Transformed images of a dataset, resident on a device as bytes, and their labels.

use super::encoder::heads::{self, LABELS};
use crate::dataset::{Dataset, DatasetError, ShardReader};
use crate::encoder_score::told::Told;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc;
use tch::{Device, Kind, TchError, Tensor};
use wad_see::latent::encoder::images_tensor;
use wad_see::perception::{TRANSFORMED_SIZE, TransformedImage};

/// Why images cannot be loaded.
#[derive(Debug, thiserror::Error)]
pub enum ImagesError {
    /// A dataset cannot be read.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// libtorch fails, e.g. for lack of memory.
    #[error("libtorch: {0}; if memory is short, give --resident-gb less")]
    Torch(#[from] TchError),
}

/// Most threads that decode.
const DECODERS: usize = 16;

/// Images of some shards on a device.
#[derive(Debug)]
pub struct Images {
    /// (n, 128, 128, 3), bytes.
    pub pixels: Tensor,
    /// (n, [`LABELS`]), if requested.
    pub labels: Option<Tensor>,
}

impl Images {
    /// An empty set.
    ///
    /// # Errors
    /// torch fails.
    pub fn none(device: Device) -> Result<Self, TchError> {
        Ok(Self { pixels: Tensor::f_empty([0], (Kind::Uint8, device))?, labels: None })
    }

    /// The number of images.
    pub fn count(&self) -> i64 {
        self.pixels.size()[0]
    }

    /// The images at the indices `chosen`.
    ///
    /// # Errors
    /// torch fails.
    pub fn select(&self, chosen: &Tensor) -> Result<Self, TchError> {
        let labels = self.labels.as_ref().map(|labels| labels.f_index_select(0, chosen)).transpose()?;
        Ok(Self { pixels: self.pixels.f_index_select(0, chosen)?, labels })
    }

    /// All in order, at most `most` at a time.
    ///
    /// # Errors
    /// torch fails.
    pub fn split(&self, most: usize) -> Result<Vec<Self>, TchError> {
        let most = most.max(1) as i64;
        let part = |from: i64| -> Result<Self, TchError> {
            let count = most.min(self.count() - from);
            let labels = self.labels.as_ref().map(|labels| labels.f_narrow(0, from, count)).transpose()?;
            Ok(Self { pixels: self.pixels.f_narrow(0, from, count)?, labels })
        };
        (0..self.count()).step_by(most as usize).map(part).collect()
    }
}

/// The images to load.
#[derive(Clone, Copy, Debug)]
pub struct Choice<'a> {
    /// Indices of the shards to load.
    pub shards: &'a [usize],
    /// Load one of this many images.
    pub every: usize,
    /// Load labels too.
    pub labelled: bool,
}

/// Images of the given shards on `device`.
///
/// # Errors
/// A shard cannot be read, or memory is short.
pub fn load(dataset: &Dataset, choice: Choice<'_>, device: Device) -> Result<Images, ImagesError> {
    let Choice { shards, every, labelled } = choice;
    let every = every.max(1);
    let kept = |frames: usize| frames.div_ceil(every);
    let total: usize = shards.iter().map(|&s| kept(dataset.shards[s].2)).sum();
    let side = TRANSFORMED_SIZE as i64;
    let pixels = Tensor::f_empty([total as i64, side, side, 3], (Kind::Uint8, device))?;
    let mut labels: Vec<f32> = Vec::new();
    let threads = std::thread::available_parallelism().map_or(1, |n| n.get()).min(DECODERS);
    let next = AtomicUsize::new(0);
    let (sender, receiver) = mpsc::sync_channel(2 * threads);
    let filled = std::thread::scope(|scope| -> Result<i64, ImagesError> {
        for _ in 0..threads {
            let (sender, next) = (sender.clone(), &next);
            scope.spawn(move || {
                while let Some(&shard) = shards.get(next.fetch_add(1, Ordering::Relaxed)) {
                    let (mut bytes, mut labels) = (Vec::new(), Vec::new());
                    let read = if labelled {
                        dataset.images_with_records(shard, &mut bytes, |record| {
                            labels.push(heads::labels(&Told::of(&record)));
                        })
                    } else {
                        dataset.images(shard, &mut bytes)
                    };
                    let read = read.map(|_| (shard, bytes, labels));
                    // The receiver is gone: an error ended the loading.
                    if sender.send(read).is_err() {
                        return;
                    }
                }
            });
        }
        drop(sender);
        // Put where the shard's number says, so that the threads' order does not matter.
        let mut at = 0;
        let mut waiting = std::collections::BTreeMap::new();
        let mut due = 0;
        for read in receiver {
            let (shard, mut bytes, mut told) = read?;
            if every > 1 {
                let images = bytes.chunks_exact(TransformedImage::BYTES).step_by(every);
                bytes = images.flatten().copied().collect();
                told = told.into_iter().step_by(every).collect();
            }
            waiting.insert(shards.iter().position(|&s| s == shard).unwrap_or(0), (bytes, told));
            while let Some((bytes, told)) = waiting.remove(&due) {
                due += 1;
                labels.extend(told.iter().flatten());
                let count = bytes.len() / TransformedImage::BYTES;
                if count > 0 {
                    let tensor = images_tensor(&bytes, count)?;
                    pixels.f_narrow(0, at, count as i64)?.f_copy_(&tensor)?;
                    at += count as i64;
                }
            }
        }
        Ok(at)
    })?;
    let labels = if labelled { Some(rows(&labels, device)?) } else { None };
    Ok(Images { pixels: pixels.f_narrow(0, 0, filled)?, labels })
}

/// Labels frame by frame (n, [`LABELS`]); n may be 0.
fn rows(labels: &[f32], device: Device) -> Result<Tensor, TchError> {
    let (count, each) = ((labels.len() / LABELS) as i64, LABELS as i64);
    Tensor::f_from_slice(labels)?.f_view([count, each])?.f_to_device(device)
}

/// Labels (n, [`LABELS`]) of all frames of some shards, on `device`.
///
/// # Errors
/// A shard cannot be read, or memory is short.
pub fn labels(dataset: &Dataset, shards: &[usize], device: Device) -> Result<Tensor, ImagesError> {
    let mut labels: Vec<f32> = Vec::new();
    for &shard in shards {
        for record in dataset.read(shard, ShardReader::next_record)? {
            labels.extend(heads::labels(&Told::of(&record)));
        }
    }
    Ok(rows(&labels, device)?)
}
