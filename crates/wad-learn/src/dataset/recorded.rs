//! A recorded run as data: it is driven again from its `config.json`, with the controls of its telemetry,
//! and the ego's frames are kept. It works for any driver, because the telemetry has every control.

use super::error::DatasetError;
use super::eye::{Eye, Moment};
use super::options::CollectOptions;
use super::plan::{Segment, due};
use super::record::Frame;
use crate::drive::{Drive, DriveOptions};
use std::path::{Path, PathBuf};
use wad_camera::Preset;
use wad_sim::telemetry::TickRecord;

/// Time before the first frame (s): at a run's begin nothing moves yet.
const WARM_UP: f64 = 2.0;
/// Largest distance between the recorded ego and the ego driven again (m). It is exact to the bit under the
/// autopilot; a control read back from text may differ in its last digit.
const DRIFT: f64 = 0.1;

/// A run folder, read back.
#[derive(Clone, Debug)]
pub struct RecordedRun {
    /// The run's folder.
    pub folder: PathBuf,
    /// The options of the run, from `config.json`.
    pub options: DriveOptions,
    ticks: Vec<TickRecord>,
}

impl RecordedRun {
    /// Reads `config.json` and `telemetry.jsonl` of a run's folder. A line that was cut off ends the run.
    ///
    /// # Errors
    /// The folder is not a run's, or the run used --attach.
    pub fn open(folder: &Path) -> Result<Self, DatasetError> {
        let not = |why: String| DatasetError::NotARun { path: folder.to_path_buf(), why };
        let read =
            |name: &str| std::fs::read_to_string(folder.join(name)).map_err(|e| not(format!("{name}: {e}")));
        let options: DriveOptions =
            serde_json::from_str(&read("config.json")?).map_err(|e| not(format!("config.json: {e}")))?;
        if options.bridge.attach.is_some() {
            return Err(not(
                "it was driven with --attach in a foreign SUMO, so it cannot be driven again".to_string()
            ));
        }
        if options.egos > 1 {
            let egos = options.egos;
            return Err(not(format!("it has {egos} egos, and only the drive of one can be driven again")));
        }
        let text = read("telemetry.jsonl")?;
        let lines: Vec<&str> = text.lines().collect();
        let mut ticks = Vec::with_capacity(lines.len());
        for (n, line) in lines.iter().enumerate() {
            match serde_json::from_str(line) {
                Ok(tick) => ticks.push(tick),
                Err(_) if n + 1 == lines.len() => break,
                Err(error) => return Err(not(format!("telemetry.jsonl, line {}: {error}", n + 1))),
            }
        }
        if ticks.is_empty() {
            return Err(not("its telemetry holds no ticks".to_string()));
        }
        Ok(Self { folder: folder.to_path_buf(), options, ticks })
    }

    /// The town's name, from the config's.
    pub fn town(&self) -> String {
        let file = self.options.bridge.config.file_name().unwrap_or_default().to_string_lossy();
        file.split('.').next().unwrap_or("net").to_string()
    }

    /// Simulation time from its first tick to its last (s).
    fn seconds(&self) -> f64 {
        self.ticks.last().map_or(0.0, |last| last.time) - self.ticks.first().map_or(0.0, |first| first.time)
    }

    /// Segments for these runs in each of these weathers, with the weathers of a run side by side. The
    /// number of frames is an upper limit.
    pub fn segments(runs: &[Self], weathers: &[Preset], every: f64) -> Vec<Segment> {
        let of = |run: &Self| (run.seconds() / every) as usize + 1;
        let all = runs.iter().flat_map(|run| weathers.iter().map(move |&weather| (run, weather)));
        let segment = |(index, (run, weather)): (usize, (&Self, Preset))| Segment {
            index,
            seed: run.options.bridge.seed,
            weather,
            traffic: run.options.bridge.traffic.counts(&run.town()).unwrap_or_default(),
            frames: of(run),
        };
        all.enumerate().map(segment).collect()
    }
}

/// A run driven again.
pub struct RunDrive<'a> {
    run: &'a RecordedRun,
    drive: Drive,
    eye: Eye,
    every: f64,
    next: usize,
    since_frame: f64,
    standing: f64,
    respawns: u64,
}

impl<'a> RunDrive<'a> {
    /// Starts SUMO as the run did.
    ///
    /// # Errors
    /// Its config is missing, or SUMO fails.
    pub async fn start(
        run: &'a RecordedRun,
        segment: Segment,
        how: &CollectOptions,
        scratch: &Path,
    ) -> Result<Self, DatasetError> {
        let mut options = run.options.clone();
        options.out = scratch.join("run");
        options.bridge.output_dir = scratch.join("sumo");
        options.bridge.gui = false;
        let drive = Drive::start(options).await?;
        let assets = drive.assets();
        let eye = Eye::new(assets.network(), assets.town(), segment, how)?;
        Ok(Self { run, drive, eye, every: how.every, next: 0, since_frame: 0.0, standing: 0.0, respawns: 0 })
    }

    /// Drives until the next frame is due; None at the run's end.
    ///
    /// # Errors
    /// SUMO fails, or the ego is not where it was recorded.
    pub async fn next_frame(&mut self) -> Result<Option<Frame>, DatasetError> {
        let begin = self.run.ticks.first().map_or(0.0, |first| first.time);
        while let Some(recorded) = self.run.ticks.get(self.next) {
            self.next += 1;
            for &wish in &recorded.wishes {
                self.drive.grant(wish).await?;
            }
            self.drive.tick_with(Some(recorded.control)).await?;
            self.eye.follow(self.drive.ego());
            let state = self.drive.ego().state();
            let moved = self.drive.respawns();
            if moved != self.respawns {
                self.respawns = moved;
                self.eye.reset();
            } else {
                // Telemetry has the ego before it was moved to another place.
                let off = (state.pose.xy() - recorded.ego.pose.xy()).norm();
                if off > DRIFT {
                    let path = self.run.folder.clone();
                    return Err(DatasetError::Drifted { path, tick: recorded.tick, off });
                }
            }
            let tick = self.drive.bridge().tick();
            self.since_frame += tick;
            self.standing = if state.speed.abs() < 0.3 { self.standing + tick } else { 0.0 };
            if recorded.time - begin < WARM_UP || self.since_frame < due(self.standing, self.every) - 1e-6 {
                continue;
            }
            let moment = Moment {
                time: self.drive.bridge().time(),
                since: self.since_frame,
                control: recorded.control,
                disturbed: false,
            };
            self.since_frame = 0.0;
            let network = self.drive.bridge().network().clone();
            return Ok(Some(self.eye.record(&network, self.drive.ego(), moment)?));
        }
        Ok(None)
    }

    /// Ends SUMO.
    pub async fn finish(self) {
        if let Err(error) = self.drive.finish(false).await {
            tracing::warn!("the run's second drive did not end properly: {error}");
        }
    }
}
