//! A dataset's folder: the manifest, the shards, and reading them back.

use super::error::DatasetError;
use super::options::CollectOptions;
use super::plan::Segment;
use super::record::FrameRecord;
use super::shard::ShardReader;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use wad_camera::model::ObjectClass;
use wad_camera::variety::Varied;
use wad_camera::{CameraConfig, Preset};
use wad_see::perception::coco::class_name;
use wad_see::perception::{ImageKind, TransformedImage};
use wad_sim::telemetry;

/// Version of manifest and shards. Other versions are refused.
pub const FORMAT_VERSION: u64 = 1;

const MANIFEST: &str = "dataset.json";

/// What a dataset may be used for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// Any other town: for training.
    Training,
    /// A town for development or testing: for measurements only.
    Test,
}

/// The towns that must not be trained on.
const NOT_TRAINED_ON: [&str; 2] = ["town5", "town7"];

impl Role {
    /// Test data for town5 and town7, training data for every other town.
    pub fn of(town: &str) -> Self {
        if NOT_TRAINED_ON.contains(&town) { Self::Test } else { Self::Training }
    }
}

/// The state of collecting.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// Running, or interrupted.
    Collecting,
    /// Complete, or stopped by the time limit.
    Complete,
}

/// `dataset.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// Version of the format.
    pub version: u64,
    /// The state of collecting.
    pub state: State,
    /// Whether it may be used for training.
    pub role: Role,
    /// The town's name.
    pub town: String,
    /// Frames of the plan; of recorded runs an upper limit until they are collected.
    pub frames_wanted: usize,
    /// Frames in complete shards when collecting last ended; 0 before.
    pub frames: usize,
    /// Frames to a segment.
    pub per_segment: usize,
    /// The seed of everything random.
    pub seed: u64,
    /// The weathers, in turn.
    pub weathers: Vec<Preset>,
    /// [`CameraConfig::hash`].
    pub camera: String,
    /// The detector whose boxes are painted.
    pub detector: String,
    /// The image for the encoder.
    #[serde(default)]
    pub image: ImageKind,
    /// Simulation time between frames (s); None in datasets that were collected before this was kept.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub every: Option<f64>,
    /// Mean time between disturbances (s), 0: none; None in datasets that were collected before this was kept.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub noise_pause: Option<f64>,
    /// Whether the camera's pictures are kept.
    pub keeps_camera: bool,
    /// The version of the program that collected it.
    pub program: String,
    /// Recorded runs that its frames come from; none: drives of the autopilot.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub runs: Vec<PathBuf>,
    /// Every frame shows an object of one of these classes; empty: all frames were kept.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub showing: Vec<ObjectClass>,
    /// Every frame is of a place close behind somebody.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub near: bool,
    /// Signals show lamps drawn at random.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub random_signals: bool,
    /// What is drawn anew for each shard.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub vary: Vec<Varied>,
}

impl Manifest {
    pub(super) fn new(options: &CollectOptions, town: &str) -> Self {
        Self {
            version: FORMAT_VERSION,
            state: State::Collecting,
            role: Role::of(town),
            town: town.to_string(),
            frames_wanted: options.frames,
            frames: 0,
            per_segment: options.per_segment,
            seed: options.seed,
            weathers: options.weathers.clone(),
            camera: CameraConfig::default().hash(),
            detector: "truth".to_string(),
            image: options.image,
            every: Some(options.every),
            noise_pause: Some(options.noise.pause),
            keeps_camera: options.camera,
            program: wad_sim::program::version().to_string(),
            runs: options.runs.iter().map(|run| run.folder.clone()).collect(),
            showing: options.showing.clone(),
            near: options.near,
            random_signals: options.random_signals,
            vary: options.vary.clone(),
        }
    }

    /// The manifest of `folder`; None where the folder has none.
    ///
    /// # Errors
    /// It cannot be read, or has another version.
    pub fn load(folder: &Path) -> Result<Option<Self>, DatasetError> {
        let path = folder.join(MANIFEST);
        let text = match std::fs::read(&path) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(DatasetError::io("read", path)(error)),
        };
        let torn = |e: serde_json::Error| DatasetError::Torn { path: path.clone(), why: e.to_string() };
        let value: serde_json::Value = serde_json::from_slice(&text).map_err(torn)?;
        let found = value.get("version").and_then(serde_json::Value::as_u64).unwrap_or(0);
        if found != FORMAT_VERSION {
            return Err(DatasetError::Version { path, found, expected: FORMAT_VERSION });
        }
        serde_json::from_value(value).map(Some).map_err(torn)
    }

    pub(super) fn save(&self, folder: &Path) -> Result<(), DatasetError> {
        let path = folder.join(MANIFEST);
        telemetry::write_json(&path, self).map_err(|e| DatasetError::io("write", e.path)(e.source))
    }

    /// Refuses to continue in a folder with another dataset. More frames than before continue it.
    pub(super) fn check_same(&self, asked: &Self, folder: &Path) -> Result<(), DatasetError> {
        let seconds = |kept: Option<f64>, asked: Option<f64>| kept.or(asked).unwrap_or_default().to_string();
        let text = |m: &Self| {
            [
                ("the town", m.town.clone()),
                ("the seed", m.seed.to_string()),
                ("frames per shard", m.per_segment.to_string()),
                ("the number of frames", m.frames_wanted.max(asked.frames_wanted).to_string()),
                ("the seconds between frames", seconds(m.every, asked.every)),
                ("the seconds between disturbances", seconds(m.noise_pause, asked.noise_pause)),
                ("the weathers", m.weathers.iter().map(|w| w.name()).collect::<Vec<_>>().join(",")),
                (
                    "the recorded runs",
                    m.runs.iter().map(|r| r.display().to_string()).collect::<Vec<_>>().join(","),
                ),
                ("the classes shown", m.showing.iter().map(|c| class_name(*c)).collect::<Vec<_>>().join(",")),
                ("whether all frames are near", m.near.to_string()),
                ("whether signals are random", m.random_signals.to_string()),
                ("what varies", m.vary.iter().map(|v| v.name()).collect::<Vec<_>>().join(",")),
                ("the camera", m.camera.clone()),
                ("the image for the encoder", m.image.name().to_string()),
                ("whether camera pictures are kept", m.keeps_camera.to_string()),
            ]
        };
        for ((what, found), (_, asked)) in text(self).into_iter().zip(text(asked)) {
            if found != asked {
                return Err(DatasetError::Differs { path: folder.to_path_buf(), what, found, asked });
            }
        }
        Ok(())
    }
}

/// The path of a segment's shard.
pub(super) fn shard_path(folder: &Path, segment: &Segment) -> PathBuf {
    folder.join(format!("shard-{:05}.wads", segment.index))
}

/// A dataset open for reading.
#[derive(Clone, Debug)]
pub struct Dataset {
    /// The contents of `dataset.json`.
    pub manifest: Manifest,
    /// The dataset's folder.
    pub folder: PathBuf,
    /// Whole shards in order, with the frames in each.
    pub shards: Vec<(PathBuf, Segment, usize)>,
    /// Torn shards, left out, with the cause.
    pub torn: Vec<String>,
}

/// One shard in this many is for validation.
const VALIDATION_EVERY: usize = 10;

impl Dataset {
    /// Opens a dataset without its torn shards. Without `partial` an unfinished dataset
    /// is refused.
    ///
    /// # Errors
    /// The folder is not a dataset, or it is unfinished, empty, of another version or of another camera.
    pub fn open(folder: &Path, partial: bool) -> Result<Self, DatasetError> {
        let path = folder.to_path_buf();
        let manifest =
            Manifest::load(folder)?.ok_or_else(|| DatasetError::NotADataset { path: path.clone() })?;
        let expected = CameraConfig::default().hash();
        if manifest.camera != expected {
            return Err(DatasetError::Camera { path, found: manifest.camera, expected });
        }
        let (mut shards, mut torn) = (Vec::new(), Vec::new());
        let entries = std::fs::read_dir(folder).map_err(DatasetError::io("read", folder))?;
        let mut files: Vec<PathBuf> = entries
            .filter_map(|entry| Some(entry.ok()?.path()))
            .filter(|path| path.extension().is_some_and(|e| e == "wads"))
            .collect();
        files.sort();
        for file in files {
            match ShardReader::open(&file) {
                Ok(reader) => shards.push((file, reader.header().segment, reader.frames())),
                Err(error @ DatasetError::Torn { .. }) => torn.push(error.to_string()),
                Err(error) => return Err(error),
            }
        }
        let dataset = Self { manifest, folder: path.clone(), shards, torn };
        let found = dataset.frames();
        if dataset.manifest.state != State::Complete && !partial {
            let wanted = dataset.manifest.frames_wanted;
            return Err(DatasetError::HalfWritten { path, found, wanted });
        }
        if found == 0 {
            return Err(DatasetError::Empty { path, hint: "; collect it again" });
        }
        for torn in &dataset.torn {
            tracing::warn!("{torn}; left out");
        }
        Ok(dataset)
    }

    /// Checks that it may be trained on.
    ///
    /// # Errors
    /// It is test data.
    pub fn require_training(&self) -> Result<(), DatasetError> {
        match self.manifest.role {
            Role::Training => Ok(()),
            Role::Test => {
                Err(DatasetError::TestData { path: self.folder.clone(), town: self.manifest.town.clone() })
            }
        }
    }

    /// Warns where nothing can be kept for validation.
    pub fn warn_of_one_shard(&self) {
        if self.shards.len() == 1 {
            tracing::warn!(
                "{}: all its frames are in one shard; it is trained on and serves for validation too, so the scores are \
                 of frames that were trained on. Collect with a smaller --per-shard.",
                self.folder.display()
            );
        }
    }

    /// Frames in the whole shards.
    pub fn frames(&self) -> usize {
        self.shards.iter().map(|(_, _, frames)| frames).sum()
    }

    /// Indices of shards for training and for validation: one in ten is for validation, at least one. A shard
    /// that is alone serves for both.
    pub fn split(&self) -> (Vec<usize>, Vec<usize>) {
        let count = self.shards.len();
        if count == 1 {
            return (vec![0], vec![0]);
        }
        let validation = |i: usize| {
            if count < VALIDATION_EVERY {
                i + 1 == count
            } else {
                i % VALIDATION_EVERY == VALIDATION_EVERY - 1
            }
        };
        (0..count).partition(|&i| !validation(i))
    }

    /// A reader of the shard at this index.
    ///
    /// # Errors
    /// The shard was removed or damaged since the dataset was opened.
    pub fn reader(&self, shard: usize) -> Result<ShardReader, DatasetError> {
        let (path, _, _) = self
            .shards
            .get(shard)
            .ok_or_else(|| DatasetError::Empty { path: self.folder.clone(), hint: " in that shard" })?;
        ShardReader::open(path)
    }

    /// What `next` reads of the shard at this index, frame by frame. A damaged frame ends its shard with a warning.
    ///
    /// # Errors
    /// The shard cannot be opened.
    pub fn read<T>(
        &self,
        shard: usize,
        mut next: impl FnMut(&mut ShardReader) -> Result<Option<T>, DatasetError>,
    ) -> Result<impl Iterator<Item = T>, DatasetError> {
        let mut reader = self.reader(shard)?;
        Ok(std::iter::from_fn(move || {
            next(&mut reader).unwrap_or_else(|error| {
                tracing::warn!("{error}; the rest of the shard is left out");
                None
            })
        }))
    }

    /// The transformed images of a shard, one after the other, in `bytes` (emptied first). A damaged
    /// frame ends its shard with a warning.
    ///
    /// # Errors
    /// The shard cannot be opened.
    pub fn images(&self, shard: usize, bytes: &mut Vec<u8>) -> Result<usize, DatasetError> {
        self.fill(shard, bytes, |reader, image| reader.next_image(image))
    }

    /// The same, and passes each image's record to `take`.
    ///
    /// # Errors
    /// The shard cannot be opened.
    pub fn images_with_records(
        &self,
        shard: usize,
        bytes: &mut Vec<u8>,
        mut take: impl FnMut(FrameRecord),
    ) -> Result<usize, DatasetError> {
        self.fill(shard, bytes, |reader, image| {
            let Some(frame) = reader.next_frame()? else { return Ok(false) };
            image.copy_from_slice(frame.transformed.bytes());
            take(frame.record);
            Ok(true)
        })
    }

    /// Fills `bytes` image by image with what `next` reads, until it says false or fails.
    fn fill(
        &self,
        shard: usize,
        bytes: &mut Vec<u8>,
        mut next: impl FnMut(&mut ShardReader, &mut [u8]) -> Result<bool, DatasetError>,
    ) -> Result<usize, DatasetError> {
        bytes.clear();
        let images = self.read(shard, |reader| {
            let at = bytes.len();
            bytes.resize(at + TransformedImage::BYTES, 0);
            let read = next(reader, &mut bytes[at..]);
            if !matches!(read, Ok(true)) {
                bytes.truncate(at);
            }
            Ok(read?.then_some(()))
        })?;
        Ok(images.count())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::testing::{Picture, write};

    fn data(folder: &Path, town: &str) {
        write(folder, town, &[3, 3, 2], Preset::ClearNoon, |n| Picture {
            red: false,
            object: [10 + n, 50, 8, 8],
        });
    }

    #[test]
    fn images_are_those_of_the_frames() {
        let folder = tempfile::tempdir().unwrap();
        data(folder.path(), "town3");
        let dataset = Dataset::open(folder.path(), false).unwrap();
        assert_eq!((dataset.frames(), dataset.split()), (8, (vec![0, 1], vec![2])));
        dataset.require_training().unwrap();
        let mut bytes = Vec::new();
        assert_eq!(dataset.images(1, &mut bytes).unwrap(), 3);
        let mut reader = dataset.reader(1).unwrap();
        for image in bytes.chunks(TransformedImage::BYTES) {
            assert_eq!(reader.next_frame().unwrap().unwrap().transformed.bytes(), image);
        }
    }

    #[test]
    fn one_shard_is_trained_on_and_validates() {
        let folder = tempfile::tempdir().unwrap();
        write(folder.path(), "town3", &[3], Preset::ClearNoon, |n| Picture {
            red: false,
            object: [10 + n, 50, 8, 8],
        });
        let dataset = Dataset::open(folder.path(), false).unwrap();
        assert_eq!(dataset.split(), (vec![0], vec![0]));
    }

    #[test]
    fn a_torn_shard_loses_only_itself() {
        let folder = tempfile::tempdir().unwrap();
        data(folder.path(), "town3");
        let last = folder.path().join("shard-00002.wads");
        let bytes = std::fs::read(&last).unwrap();
        std::fs::write(&last, &bytes[..bytes.len() / 2]).unwrap();
        let dataset = Dataset::open(folder.path(), false).unwrap();
        assert_eq!((dataset.frames(), dataset.torn.len()), (6, 1));
        assert!(dataset.torn[0].contains("shard-00002"), "{:?}", dataset.torn);
    }

    #[test]
    fn another_pace_or_fewer_frames_are_another_dataset() {
        let asked = |frames, every, pause| {
            let mut options = CollectOptions::new("town3", frames, Path::new("data"));
            (options.per_segment, options.every, options.noise.pause) = (10, every, pause);
            Manifest::new(&options, "town3")
        };
        let found = asked(100, 0.5, 7.0);
        let differs =
            |asked: &Manifest| found.check_same(asked, Path::new("data")).err().map(|e| e.to_string());
        for (asked, what) in [
            (asked(100, 1.0, 7.0), "expected the seconds between frames 1, found 0.5"),
            (asked(100, 0.5, 0.0), "expected the seconds between disturbances 0, found 7"),
            (asked(90, 0.5, 7.0), "expected the number of frames 90, found 100"),
        ] {
            let error = differs(&asked).unwrap();
            assert!(error.contains(what), "{error}");
        }
        assert_eq!([100, 200].map(|frames| differs(&asked(frames, 0.5, 7.0))), [None, None]);
        // It was not kept before.
        let old = Manifest { every: None, noise_pause: None, ..found.clone() };
        old.check_same(&asked(100, 1.0, 0.0), Path::new("data")).unwrap();
    }

    #[test]
    fn folders_that_are_no_good_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path();
        let error = |partial| Dataset::open(path, partial).unwrap_err().to_string();
        assert!(error(false).contains("not a dataset"), "{}", error(false));
        assert_eq!(["town3", "town5", "town7"].map(Role::of), [Role::Training, Role::Test, Role::Test]);
        data(path, "town5");
        let dataset = Dataset::open(path, false).unwrap();
        assert!(matches!(dataset.require_training(), Err(DatasetError::TestData { .. })));
        let mut manifest = dataset.manifest.clone();
        (manifest.state, manifest.frames_wanted) = (State::Collecting, 100);
        manifest.save(path).unwrap();
        assert!(error(false).contains("8 of 100"), "{}", error(false));
        assert_eq!(Dataset::open(path, true).unwrap().frames(), 8);
        (manifest.state, manifest.camera) = (State::Complete, "other".to_string());
        manifest.save(path).unwrap();
        assert!(error(false).contains("camera other"), "{}", error(false));
        manifest.version = 9;
        manifest.save(path).unwrap();
        assert!(error(false).contains("format 9"), "{}", error(false));
    }
}
