//! Collects a dataset: segments in parallel, each by one thread with its own SUMO.

use super::drive::SegmentDrive;
use super::error::DatasetError;
use super::folder::{FORMAT_VERSION, Manifest, Role, State, shard_path};
use super::image_codec::CameraCodec;
use super::options::{CollectOptions, TRAINING_WEATHERS};
use super::plan::{Segment, plan};
use super::record::{BoxRecord, FrameRecord};
use super::recorded::RecordedRun;
use super::run_drive::RunDrive;
use super::shard::{ShardHeader, ShardReader, ShardWriter};
use crate::folder_lock::FolderLock;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use wad_camera::CameraConfig;
use wad_see::perception::NearGaps;
use wad_sim::assets::Assets;
use wad_sim::bundled;
use wad_sim::traffic::TrafficSpec;

/// The progress of collecting.
#[derive(Clone, Copy, Debug)]
pub struct Progress {
    /// Frames on disk or in work, including earlier calls.
    pub frames: usize,
    /// Frames to collect in total.
    pub wanted: usize,
}

/// The result of collecting.
#[derive(Clone, Debug, Serialize)]
pub struct Collected {
    /// The dataset's folder.
    pub out: PathBuf,
    /// The town's name.
    pub town: String,
    /// Frames in complete shards.
    pub frames: usize,
    /// Frames of earlier calls.
    pub frames_before: usize,
    /// Complete shards.
    pub shards: usize,
    /// Size of the shards (bytes).
    pub bytes: u64,
    /// Wall time of this call (s).
    pub wall_seconds: f64,
    /// New frames per second of wall time.
    pub frames_per_second: f64,
    /// All wanted frames are there.
    pub complete: bool,
    /// The user interrupted.
    pub interrupted: bool,
}

struct Shared<'a> {
    options: &'a CollectOptions,
    assets: Arc<Assets>,
    missing: Vec<Segment>,
    next: AtomicUsize,
    /// Frames so far.
    frames: AtomicUsize,
    failed: AtomicBool,
    error: Mutex<Option<DatasetError>>,
    interrupt: &'a AtomicBool,
    deadline: Option<Instant>,
}

impl Shared<'_> {
    fn is_over(&self) -> bool {
        self.interrupt.load(Ordering::Relaxed)
            || self.failed.load(Ordering::Relaxed)
            || self.deadline.is_some_and(|deadline| Instant::now() >= deadline)
    }

    fn fail(&self, error: DatasetError) {
        self.failed.store(true, Ordering::Relaxed);
        if let Ok(mut slot) = self.error.lock() {
            slot.get_or_insert(error);
        }
    }
}

/// A dataset under collection: its plan, and each shard once, wherever its segment is driven.
pub struct Collection {
    options: CollectOptions,
    town: String,
    assets: Arc<Assets>,
    segments: Vec<Segment>,
    manifest: Manifest,
    frames_before: usize,
    began: Instant,
    _lock: FolderLock,
}

impl Collection {
    /// Opens the folder of `options`, takes its lock, and removes damaged shards.
    ///
    /// # Errors
    /// The folder holds another dataset or is in use, or the town cannot be opened.
    pub fn open(options: &CollectOptions) -> Result<Self, DatasetError> {
        let began = Instant::now();
        let config = match options.runs.first() {
            Some(run) => run.options.bridge.config.clone(),
            None => bundled::resolve(&options.town)?,
        };
        let assets = Assets::open(&config, false)?;
        let town = assets.town_name().to_string();
        for run in &options.runs {
            let other = run.town()?;
            if other != town {
                return Err(DatasetError::Towns { first: town, other });
            }
        }
        let segments = if options.runs.is_empty() {
            let dense = TrafficSpec::Dense.counts(&town).unwrap_or_default();
            plan(options.frames, options.per_segment, &options.weathers, dense, options.seed)
        } else {
            RecordedRun::segments(&options.runs, &town, &options.weathers, options.every, options.seed)
        };
        let mut manifest = Manifest::new(options, &town);
        manifest.frames_wanted = segments.iter().map(|segment| segment.frames).sum();
        let others = options.weathers.iter().any(|weather| !TRAINING_WEATHERS.contains(weather));
        if others && manifest.role == Role::Training {
            tracing::warn!(
                "networks trained on this dataset also know weathers beyond the three of training"
            );
        }
        let lock = FolderLock::take(&options.out)?;
        if let Some(found) = Manifest::load(&options.out)? {
            found.check_same(&manifest, &options.out)?;
        }
        manifest.save(&options.out)?;
        remove_damaged(&options.out, &segments)?;
        let (_, frames_before) = missing_segments(&options.out, &segments)?;
        Ok(Self {
            options: options.clone(),
            town,
            assets,
            segments,
            manifest,
            frames_before,
            began,
            _lock: lock,
        })
    }

    /// The town that is driven in.
    pub fn assets(&self) -> &Arc<Assets> {
        &self.assets
    }

    /// Frames of the whole plan.
    pub fn wanted(&self) -> usize {
        self.segments.iter().map(|segment| segment.frames).sum()
    }

    /// Segments without a complete shard, and the number of frames in complete shards.
    ///
    /// # Errors
    /// A shard has another version.
    pub fn missing(&self) -> Result<(Vec<Segment>, usize), DatasetError> {
        missing_segments(&self.options.out, &self.segments)
    }

    /// Takes the shard that [`drive_segment`] made. False: it is there already, and nothing is written.
    ///
    /// # Errors
    /// It is not the shard of that segment, or cannot be written.
    pub fn put(&self, segment: &Segment, shard: &[u8]) -> Result<bool, DatasetError> {
        if frames_of(&self.options.out, segment)?.is_some() {
            return Ok(false);
        }
        let path = shard_path(&self.options.out, segment);
        let staging = path.with_extension("part");
        let placed = std::fs::write(&staging, shard)
            .and_then(|()| std::fs::File::open(&staging)?.sync_data())
            .map_err(DatasetError::io("write", &staging))
            .and_then(|()| match ShardReader::open(&staging)?.header().segment == *segment {
                true => std::fs::rename(&staging, &path).map_err(DatasetError::io("write", &path)),
                false => {
                    Err(DatasetError::Torn { path: path.clone(), why: "of another segment".to_string() })
                }
            });
        if placed.is_err() {
            let _ = std::fs::remove_file(&staging);
        }
        placed.map(|()| true)
    }

    /// Writes the manifest, and says what is there. `interrupted`: collecting is to go on later.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn finish(mut self, interrupted: bool) -> Result<Collected, DatasetError> {
        let (missing, frames) = self.missing()?;
        let out = &self.options.out;
        self.manifest.frames = frames;
        if !interrupted {
            self.manifest.state = State::Complete;
            if missing.is_empty() {
                // A run's frames are known at its end only.
                self.manifest.frames_wanted = frames;
            }
            self.manifest.save(out)?;
        }
        let size = |segment| Some(std::fs::metadata(shard_path(out, segment)).ok()?.len());
        let wall_seconds = self.began.elapsed().as_secs_f64();
        let before = self.frames_before;
        Ok(Collected {
            out: out.clone(),
            town: self.town,
            frames,
            frames_before: before,
            shards: self.segments.len() - missing.len(),
            bytes: self.segments.iter().filter_map(size).sum(),
            wall_seconds,
            frames_per_second: (frames - before.min(frames)) as f64 / wall_seconds.max(1e-9),
            complete: missing.is_empty(),
            interrupted,
        })
    }
}

/// The header of `segment`'s shard.
fn header(options: &CollectOptions, segment: Segment) -> ShardHeader {
    ShardHeader {
        version: FORMAT_VERSION,
        segment,
        camera: CameraConfig::default().hash(),
        camera_codec: options.camera.then(CameraCodec::best),
    }
}

/// Drives one segment in the town `assets`, and gives the bytes of its shard: the machine that drives it need not be the one
/// that keeps it.
///
/// # Errors
/// SUMO fails, or the disk is full.
pub fn drive_segment(
    options: &CollectOptions,
    assets: &Arc<Assets>,
    segment: Segment,
) -> Result<Vec<u8>, DatasetError> {
    let system = |what| move |source| DatasetError::System { what, source };
    let folder = tempfile::tempdir().map_err(system("make a temporary folder"))?;
    let options = CollectOptions { out: folder.path().to_path_buf(), ..options.clone() };
    let shared = Shared {
        options: &options,
        assets: Arc::clone(assets),
        missing: vec![segment],
        next: AtomicUsize::new(0),
        frames: AtomicUsize::new(0),
        failed: AtomicBool::new(false),
        error: Mutex::new(None),
        interrupt: &AtomicBool::new(false),
        deadline: None,
    };
    runtime()?.block_on(collect_segment(&shared, segment))?;
    let path = shard_path(&options.out, &segment);
    std::fs::read(&path).map_err(DatasetError::io("read", &path))
}

fn runtime() -> Result<tokio::runtime::Runtime, DatasetError> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
    runtime.map_err(|source| DatasetError::System { what: "start the asynchronous runtime", source })
}

/// Collects a dataset, or continues one. Ends early, with finished shards kept, when `interrupt`
/// becomes true or the time is up. `report` is called about ten times a second.
///
/// # Errors
/// The folder holds another dataset, the disk is full, or SUMO fails. Finished shards are kept.
pub fn collect(
    options: &CollectOptions,
    interrupt: &AtomicBool,
    mut report: impl FnMut(Progress),
) -> Result<Collected, DatasetError> {
    let collection = Collection::open(options)?;
    let (missing, frames_before) = collection.missing()?;
    let wanted = collection.wanted();
    let shared = Shared {
        options,
        assets: Arc::clone(collection.assets()),
        missing,
        next: AtomicUsize::new(0),
        frames: AtomicUsize::new(frames_before),
        failed: AtomicBool::new(false),
        error: Mutex::new(None),
        interrupt,
        deadline: options.time_limit.map(|limit| collection.began + limit),
    };
    std::thread::scope(|scope| {
        let jobs = options.jobs.clamp(1, shared.missing.len().max(1));
        let workers: Vec<_> = (0..jobs).map(|_| scope.spawn(|| work(&shared))).collect();
        while workers.iter().any(|worker| !worker.is_finished()) {
            report(Progress { frames: shared.frames.load(Ordering::Relaxed), wanted });
            std::thread::sleep(Duration::from_millis(100));
        }
    });
    let error = shared.error.into_inner().ok().flatten();
    let interrupted = interrupt.load(Ordering::Relaxed);
    if let Some(error) = error.filter(|_| !interrupted) {
        return Err(error);
    }
    let collected = collection.finish(interrupted)?;
    report(Progress { frames: collected.frames, wanted });
    Ok(collected)
}

/// Removes the shards of `segments` that are damaged, so that they are driven again.
fn remove_damaged(folder: &Path, segments: &[Segment]) -> Result<(), DatasetError> {
    for path in segments.iter().map(|segment| shard_path(folder, segment)) {
        let read = ShardReader::open(&path).and_then(ShardReader::verify);
        if let Err(error @ DatasetError::Torn { .. }) = read {
            tracing::warn!("{error}; it is driven again");
            std::fs::remove_file(&path).map_err(DatasetError::io("remove", &path))?;
        }
    }
    Ok(())
}

/// Segments without a complete shard, and the number of frames in complete shards.
fn missing_segments(folder: &Path, segments: &[Segment]) -> Result<(Vec<Segment>, usize), DatasetError> {
    let (mut missing, mut frames) = (Vec::new(), 0);
    for segment in segments {
        match frames_of(folder, segment)? {
            Some(found) => frames += found,
            None => missing.push(*segment),
        }
    }
    Ok((missing, frames))
}

/// Frames in the segment's shard; None where it is missing, torn, or of another segment: a shorter one, say.
fn frames_of(folder: &Path, segment: &Segment) -> Result<Option<usize>, DatasetError> {
    match ShardReader::open(&shard_path(folder, segment)) {
        Ok(reader) => Ok((reader.header().segment == *segment).then(|| reader.frames())),
        Err(error @ DatasetError::Version { .. }) => Err(error),
        Err(_) => Ok(None),
    }
}

/// One thread: takes segment after segment.
fn work(shared: &Shared<'_>) {
    let runtime = match runtime() {
        Ok(runtime) => runtime,
        Err(error) => return shared.fail(error),
    };
    while !shared.is_over() {
        let Some(segment) = shared.missing.get(shared.next.fetch_add(1, Ordering::Relaxed)) else { return };
        if let Err(error) = runtime.block_on(collect_segment(shared, *segment)) {
            return shared.fail(error);
        }
    }
}

async fn collect_segment(shared: &Shared<'_>, segment: Segment) -> Result<(), DatasetError> {
    let options = shared.options;
    let scratch = tempfile::tempdir()
        .map_err(|source| DatasetError::System { what: "make a temporary folder", source })?;
    let path = shard_path(&options.out, &segment);
    let mut shard = ShardWriter::create(&path, &header(options, segment))?;
    if let Some(run) = options.runs.get(segment.index / options.weathers.len().max(1)) {
        return collect_run(shared, run, segment, shard, scratch.path()).await;
    }
    let mut drive = SegmentDrive::start(options, &shared.assets, segment, scratch.path()).await?;
    while shard.frames() < segment.frames {
        if shared.is_over() {
            // What is unfinished goes; the segment is driven again when collecting goes on.
            shared.frames.fetch_sub(shard.frames(), Ordering::Relaxed);
            drive.finish().await;
            return Ok(());
        }
        let frame = drive.next_frame().await?;
        if is_wanted(&frame.record, options) {
            shard.add(&frame)?;
            shared.frames.fetch_add(1, Ordering::Relaxed);
        }
    }
    shard.finish()?;
    drive.finish().await;
    Ok(())
}

/// Lowest box that a frame is kept for (pixels), and widest gap that counts as near (m): bends change one that was drawn.
const SHOWN: u32 = 16;
const NEAR: f64 = NearGaps::RANGE.end + 0.5;

/// Whether an object of a class that is to be shown is in sight, and somebody near where that is wanted.
fn is_wanted(record: &FrameRecord, options: &CollectOptions) -> bool {
    let shows = |b: &BoxRecord| options.showing.contains(&b.class) && b.visible[3] - b.visible[1] >= SHOWN;
    let gaps = [record.labels.lead, record.labels.pedestrian].into_iter().zip(options.shows());
    let mut near = gaps.filter_map(|(gap, counts)| gap.filter(|_| counts));
    (options.showing.is_empty() || record.boxes.iter().any(shows))
        && (!options.near || near.any(|gap| gap <= NEAR))
}

async fn collect_run(
    shared: &Shared<'_>,
    run: &RecordedRun,
    segment: Segment,
    mut shard: ShardWriter,
    scratch: &Path,
) -> Result<(), DatasetError> {
    let options = shared.options;
    let mut drive = RunDrive::start(run, segment, options, scratch).await?;
    while let Some(frame) = drive.next_frame().await? {
        if shared.is_over() {
            shared.frames.fetch_sub(shard.frames(), Ordering::Relaxed);
            drive.finish().await;
            return Ok(());
        }
        shard.add(&frame)?;
        shared.frames.fetch_add(1, Ordering::Relaxed);
    }
    shard.finish()?;
    drive.finish().await;
    Ok(())
}
