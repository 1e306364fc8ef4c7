//! Drives a recorded run again, with the controls of its telemetry, and keeps the ego's frames. It works for any
//! driver, because the telemetry has every control.

use super::error::DatasetError;
use super::eye::{Eye, Moment};
use super::options::CollectOptions;
use super::plan::{Segment, due};
use super::record::Frame;
use super::recorded::RecordedRun;
use crate::drive::Drive;
use std::path::Path;

/// Time before the first frame (s): at a run's begin nothing moves yet.
const WARM_UP: f64 = 2.0;
/// Largest distance between the recorded ego and the ego driven again (m). It is exact to the bit under the
/// autopilot; a control read back from text may differ in its last digit.
const DRIFT: f64 = 0.1;

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
        let eye = Eye::new(assets, segment, how)?;
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
            let tick = self.drive.bridge().tick();
            self.since_frame += tick;
            let moved = self.drive.respawns();
            if moved != self.respawns {
                self.respawns = moved;
                // The world around a new place is known after the next tick.
                self.since_frame = 0.0;
                self.eye.reset();
            } else {
                // Telemetry has the ego before it was moved to another place.
                let off = (state.pose.xy() - recorded.ego.pose.xy()).norm();
                if off > DRIFT {
                    let path = self.run.folder.clone();
                    return Err(DatasetError::Drifted { path, tick: recorded.tick, off });
                }
            }
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
