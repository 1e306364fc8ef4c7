//! Frames of the camera as training data: transformed images with boxes, light, raw states and labels.
//!
//! ```text
//! plan: segments (town, weather, traffic, seed) --drive (autopilot + noise)--> records --shard--> folder
//! folder: dataset.json (what it is), shard-00000.wads .. (one finished file per segment)
//! ```
//!
//! A segment is one SUMO run and one shard; it depends on the seed and its number alone, so collecting
//! goes on where it stopped, and any number of jobs gives the same data. A segment can also be a recorded
//! run, driven again.

mod collect;
mod drive;
mod error;
mod eye;
mod folder;
pub(crate) mod image_codec;
mod noise;
mod options;
mod plan;
mod record;
mod recorded;
mod run_drive;
mod shard;
#[cfg(test)]
pub mod testing;

pub use collect::{Collected, Collection, Progress, collect, drive_segment};
pub use error::DatasetError;
pub use folder::{Dataset, FORMAT_VERSION, Manifest, Role, State};
pub use image_codec::{CameraCodec, decode_camera, decode_png, encode_png};
pub use noise::{Disturber, NoiseParams};
pub use options::{CollectOptions, TRAINING_WEATHERS};
pub use plan::{Segment, plan};
pub use record::{BoxRecord, Frame, FrameRecord, Labels};
pub use recorded::RecordedRun;
pub use shard::{CameraPlace, ShardHeader, ShardReader, ShardWriter};
