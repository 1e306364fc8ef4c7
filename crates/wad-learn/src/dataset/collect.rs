//! Collects a dataset: segments in parallel, each by one thread with its own SUMO.

use super::drive::SegmentDrive;
use super::error::DatasetError;
use super::folder::{FORMAT_VERSION, Manifest, State, shard_path};
use super::image_codec::CameraCodec;
use super::options::CollectOptions;
use super::plan::{Segment, plan};
use super::record::FrameRecord;
use super::recorded::{RecordedRun, RunDrive};
use super::shard::{ShardHeader, ShardReader, ShardWriter};
use crate::folder_lock::FolderLock;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use wad_camera::CameraConfig;
use wad_camera::model::ObjectClass;
use wad_sim::assets::Assets;
use wad_sim::bundled;
use wad_sim::cores::Cores;
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
    header: ShardHeader,
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
    let began = Instant::now();
    let config = match options.runs.first() {
        Some(run) => run.options.bridge.config.clone(),
        None => bundled::resolve(&options.town)?,
    };
    let file = config.file_name().map(|f| f.to_string_lossy().into_owned()).unwrap_or_default();
    let town = file.split('.').next().unwrap_or("net").to_string();
    if let Some(other) = options.runs.iter().map(RecordedRun::town).find(|other| *other != town) {
        return Err(DatasetError::Towns { first: town, other });
    }
    let _lock = FolderLock::take(&options.out)?;
    let mut manifest = Manifest::new(options, &town);
    if let Some(found) = Manifest::load(&options.out)? {
        found.check_same(&manifest, &options.out)?;
    }
    manifest.save(&options.out)?;
    let dense = TrafficSpec::Dense.counts(&town).unwrap_or_default();
    let segments = if options.runs.is_empty() {
        plan(options.frames, options.per_segment, &options.weathers, dense, options.seed)
    } else {
        RecordedRun::segments(&options.runs, &options.weathers, options.every)
    };
    let (missing, frames_before) = missing_segments(&options.out, &segments)?;
    let shared = Shared {
        options,
        assets: Assets::open(&config, false)?,
        header: ShardHeader {
            version: FORMAT_VERSION,
            segment: segments.first().copied().unwrap_or_else(|| plan(1, 1, &[], dense, 0)[0]),
            camera: CameraConfig::default().hash(),
            camera_codec: options.camera.then(CameraCodec::best),
        },
        missing,
        next: AtomicUsize::new(0),
        frames: AtomicUsize::new(frames_before),
        failed: AtomicBool::new(false),
        error: Mutex::new(None),
        interrupt,
        deadline: options.time_limit.map(|limit| began + limit),
    };
    let wanted = segments.iter().map(|segment| segment.frames).sum();
    std::thread::scope(|scope| {
        let jobs = options.jobs.clamp(1, shared.missing.len().max(1));
        let workers: Vec<_> = (0..jobs)
            .map(|job| {
                scope.spawn({
                    let shared = &shared;
                    move || work(shared, job)
                })
            })
            .collect();
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
    let (missing, frames) = missing_segments(&options.out, &segments)?;
    manifest.frames = frames;
    if !interrupted {
        manifest.state = State::Complete;
        if missing.is_empty() {
            // A run's frames are known at its end only.
            manifest.frames_wanted = frames;
        }
        manifest.save(&options.out)?;
    }
    let bytes = segments
        .iter()
        .filter_map(|segment| Some(std::fs::metadata(shard_path(&options.out, segment)).ok()?.len()))
        .sum();
    let wall_seconds = began.elapsed().as_secs_f64();
    report(Progress { frames, wanted });
    Ok(Collected {
        out: options.out.clone(),
        town,
        frames,
        frames_before,
        shards: segments.len() - missing.len(),
        bytes,
        wall_seconds,
        frames_per_second: (frames - frames_before.min(frames)) as f64 / wall_seconds.max(1e-9),
        complete: missing.is_empty(),
        interrupted,
    })
}

/// Segments without a complete shard, and the number of frames in complete shards. A torn shard is missing.
fn missing_segments(folder: &Path, segments: &[Segment]) -> Result<(Vec<Segment>, usize), DatasetError> {
    let (mut missing, mut frames) = (Vec::new(), 0);
    for segment in segments {
        match ShardReader::open(&shard_path(folder, segment)) {
            Ok(reader) => frames += reader.frames(),
            Err(error @ DatasetError::Version { .. }) => return Err(error),
            Err(_) => missing.push(*segment),
        }
    }
    Ok((missing, frames))
}

/// One thread: takes segment after segment.
fn work(shared: &Shared<'_>, job: usize) {
    // Side by side on the cores rather than where the scheduler first put them: bridge and SUMO stay there.
    if let Some(core) = Cores::nth(job) {
        core.confine(0);
    }
    let runtime = match tokio::runtime::Builder::new_current_thread().enable_all().build() {
        Ok(runtime) => runtime,
        Err(source) => {
            return shared.fail(DatasetError::System { what: "start the asynchronous runtime", source });
        }
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
    let header = ShardHeader { segment, ..shared.header.clone() };
    let mut shard = ShardWriter::create(&shard_path(&options.out, &segment), &header)?;
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
        if options.showing.is_empty() || shows(&frame.record, &options.showing) {
            shard.add(&frame)?;
            shared.frames.fetch_add(1, Ordering::Relaxed);
        }
    }
    shard.finish()?;
    drive.finish().await;
    Ok(())
}

/// Lowest box that a frame is kept for (pixels).
const SHOWN: u32 = 16;

/// Whether an object of one of these classes is in sight.
fn shows(record: &FrameRecord, classes: &[ObjectClass]) -> bool {
    record.boxes.iter().any(|b| classes.contains(&b.class) && b.visible[3] - b.visible[1] >= SHOWN)
}

async fn collect_run(
    shared: &Shared<'_>,
    run: &RecordedRun,
    segment: Segment,
    mut shard: ShardWriter,
    scratch: &Path,
) -> Result<(), DatasetError> {
    let options = shared.options;
    let mut drive = RunDrive::start(run, segment, options.every, options.camera, scratch).await?;
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
