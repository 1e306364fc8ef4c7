//! Transformed images of a dataset, resident on a device as bytes.

use crate::dataset::{Dataset, DatasetError};
use crate::latent::encoder::images_tensor;
use crate::perception::{TRANSFORMED_SIZE, TransformedImage};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc;
use tch::{Device, Kind, TchError, Tensor};

/// Why images cannot be loaded.
#[derive(Debug, thiserror::Error)]
pub enum ImagesError {
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    #[error("libtorch: {0}; if memory is short, give --resident-gb less")]
    Torch(#[from] TchError),
}

/// Threads that decode at once, at most.
const DECODERS: usize = 16;

/// Images (n, 128, 128, 3) of the given shards, as bytes on `device`. `every`: one of so many images.
///
/// # Errors
/// A shard cannot be read, or memory is short.
pub fn load(
    dataset: &Dataset,
    shards: &[usize],
    every: usize,
    device: Device,
) -> Result<Tensor, ImagesError> {
    let every = every.max(1);
    let kept = |frames: usize| frames.div_ceil(every);
    let total: usize = shards.iter().map(|&s| kept(dataset.shards[s].2)).sum();
    let side = TRANSFORMED_SIZE as i64;
    let images = Tensor::f_empty([total as i64, side, side, 3], (Kind::Uint8, device))?;
    let threads = std::thread::available_parallelism().map_or(1, |n| n.get()).min(DECODERS);
    let next = AtomicUsize::new(0);
    let (sender, receiver) = mpsc::sync_channel(2 * threads);
    let filled = std::thread::scope(|scope| -> Result<i64, ImagesError> {
        for _ in 0..threads {
            let (sender, next) = (sender.clone(), &next);
            scope.spawn(move || {
                while let Some(&shard) = shards.get(next.fetch_add(1, Ordering::Relaxed)) {
                    let mut bytes = Vec::new();
                    let read = dataset.images(shard, &mut bytes).map(|_| (shard, bytes));
                    // The receiver went away: an error ended the loading.
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
            let (shard, mut bytes) = read?;
            if every > 1 {
                let images = bytes.chunks_exact(TransformedImage::BYTES).step_by(every);
                bytes = images.flatten().copied().collect();
            }
            waiting.insert(shards.iter().position(|&s| s == shard).unwrap_or(0), bytes);
            while let Some(bytes) = waiting.remove(&due) {
                due += 1;
                let count = bytes.len() / TransformedImage::BYTES;
                if count > 0 {
                    let tensor = images_tensor(&bytes, count)?;
                    images.f_narrow(0, at, count as i64)?.f_copy_(&tensor)?;
                    at += count as i64;
                }
            }
        }
        Ok(at)
    })?;
    Ok(images.f_narrow(0, 0, filled)?)
}
