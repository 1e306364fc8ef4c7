//! The cost of a tick of the whole loop, by stage.
//!
//! The loop is that of `run` with the front camera: the autopilot decides, the ego's physics moves it,
//! SUMO steps, the reply is decoded, the camera renders a frame, perception processes it.

use crate::camera::{CameraConfig, Outputs, Preset};
use crate::cpu_time;
use crate::drive::{Drive, DriveError, DriveOptions, Status};
use crate::eyes::{Eyes, EyesError};
use crate::latent::Encoder;
use crate::perception::{Detector, EgoFacts};
use crate::stats::{median, quantile};
use serde::Serialize;
use serde::ser::{SerializeMap, Serializer};
use std::collections::BTreeMap;
use std::time::Instant;

/// Wall time of the parts of a tick, in the order in which they first came.
///
/// Serialises as an object: each stage's median (ms). A new part of the loop is a new name.
#[derive(Clone, Debug, Default)]
pub struct Stages(Vec<(&'static str, Vec<f64>)>);

impl Stages {
    /// Adds the time of `stage` in one tick (s).
    pub fn record(&mut self, stage: &'static str, seconds: f64) {
        let ms = seconds * 1000.0;
        match self.0.iter_mut().find(|(name, _)| *name == stage) {
            Some((_, times)) => times.push(ms),
            None => self.0.push((stage, vec![ms])),
        }
    }

    /// Each stage's name and its median (ms), in order.
    pub fn medians(&self) -> impl Iterator<Item = (&'static str, f64)> + '_ {
        self.quantiles(0.5)
    }

    /// Each stage's name and the time (ms) that a share `q` of the ticks stays below, in order: a stage that
    /// is left out in most ticks, as the lanes are where the ego stands, has a median of nothing.
    pub fn quantiles(&self, q: f64) -> impl Iterator<Item = (&'static str, f64)> + '_ {
        self.0.iter().map(move |(name, times)| (*name, quantile(times.clone(), q)))
    }
}

impl Serialize for Stages {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(Some(self.0.len()))?;
        for (name, ms) in self.medians() {
            map.serialize_entry(name, &ms)?;
        }
        map.end()
    }
}

/// Options of a measurement of the whole loop.
pub struct TickBenchOptions {
    /// The drive to measure.
    pub drive: DriveOptions,
    /// The front camera.
    pub camera: CameraConfig,
    /// The camera's weather.
    pub weather: Preset,
    /// The camera's outputs.
    pub outputs: Outputs,
    /// The detector; None: no perception.
    pub detector: Option<Box<dyn Detector>>,
    /// The encoder; None: no latent.
    pub encoder: Option<Box<dyn Encoder>>,
    /// Ticks of warm-up, not measured.
    pub warm_up: u64,
}

/// Why a measurement failed.
#[derive(Debug, thiserror::Error)]
pub enum TickBenchError {
    /// The drive fails.
    #[error(transparent)]
    Drive(#[from] DriveError),
    /// Camera or perception fail.
    #[error(transparent)]
    Eyes(#[from] EyesError),
}

/// A running measurement.
pub struct TickBench {
    drive: Drive,
    eyes: Eyes,
    warm_up: u64,
    done: u64,
    stages: Stages,
    totals: Vec<f64>,
    /// CPU time (s), SUMO's and ours, when the measured ticks began and after the last one.
    cpu: Option<(f64, f64)>,
}

/// Medians over the measured ticks.
#[derive(Clone, Debug, Serialize)]
pub struct TickReport {
    /// Median of each stage (ms).
    pub stages: Stages,
    /// The time (ms) that 95 of 100 ticks stay below, by stage.
    pub stages_p95: BTreeMap<&'static str, f64>,
    /// The whole tick (ms): all stages, criteria and recording.
    pub total_ms: f64,
    /// Mean CPU time of a tick, SUMO's and ours (ms); other load hardly changes it.
    pub cpu_ms: Option<f64>,
    /// Ticks measured.
    pub ticks: u64,
}

impl TickBench {
    /// Starts the drive and builds the town.
    ///
    /// # Errors
    /// The camera's configuration is invalid or not that of the weights, the input is bad, or SUMO fails.
    pub async fn start(options: TickBenchOptions) -> Result<Self, TickBenchError> {
        let seed = options.drive.bridge.seed;
        let drive = Drive::start(options.drive).await?;
        let town = drive.assets().town();
        let mut eyes = match options.detector {
            Some(detector) => Eyes::new(town, options.camera, detector)?,
            None => Eyes::camera(town, options.camera)?,
        }
        .with_outputs(options.outputs);
        if let Some(encoder) = options.encoder {
            eyes = eyes.with_encoder(encoder)?;
        }
        eyes.reset(options.weather, seed);
        Ok(Self {
            drive,
            eyes,
            warm_up: options.warm_up,
            done: 0,
            stages: Stages::default(),
            totals: Vec::new(),
            cpu: None,
        })
    }

    /// Ticks done, including the warm-up.
    pub fn ticks_done(&self) -> u64 {
        self.done
    }

    /// One tick of the loop, measured after the warm-up.
    ///
    /// # Errors
    /// SUMO fails.
    pub async fn tick(&mut self) -> Result<Status, TickBenchError> {
        let measured = self.done >= self.warm_up;
        if measured && self.cpu.is_none() {
            self.cpu = self.cpu_seconds().map(|now| (now, now));
        }
        let before = self.drive.timings();
        let clock = Instant::now();
        let status = self.drive.tick().await?;
        let driven = clock.elapsed();
        let ego = self.drive.ego();
        self.eyes.follow(ego.world());
        let followed = clock.elapsed();
        let bridge = self.drive.bridge();
        self.eyes.look(&EgoFacts::of(bridge.network(), ego, bridge.tick()))?;
        let total = clock.elapsed();
        self.done += 1;
        if measured {
            let after = self.drive.timings();
            let sumo = after.sumo - before.sumo;
            self.stages.record("sumo", sumo);
            self.stages.record("decode", after.bridge - before.bridge - sumo);
            self.stages.record("physics", after.physics - before.physics);
            let times = self.eyes.times();
            self.stages.record("camera", (followed - driven).as_secs_f64() + times.camera);
            if self.eyes.perception().is_some() {
                self.stages.record("detect", times.detect);
                self.stages.record("lanes", times.lanes);
                self.stages.record("judge", times.judge);
                self.stages.record("transform", times.transform);
            }
            if self.eyes.encodes() {
                self.stages.record("encode", times.encode);
            }
            self.stages.record("act", after.agent - before.agent);
            self.totals.push(total.as_secs_f64() * 1000.0);
            let now = self.cpu_seconds();
            self.cpu = self.cpu.zip(now).map(|((began, _), now)| (began, now));
        }
        Ok(status)
    }

    fn cpu_seconds(&self) -> Option<f64> {
        let sumo = self.drive.bridge().sumo_pid().and_then(cpu_time::of_process);
        sumo.zip(cpu_time::of_thread()).map(|(sumo, ours)| sumo + ours)
    }

    /// The results so far; None before the first measured tick.
    pub fn report(&self) -> Option<TickReport> {
        let ticks = self.totals.len() as u64;
        (ticks > 0).then(|| TickReport {
            stages: self.stages.clone(),
            stages_p95: self.stages.quantiles(0.95).collect(),
            total_ms: median(self.totals.clone()),
            cpu_ms: self.cpu.map(|(began, now)| 1000.0 * (now - began) / ticks as f64),
            ticks,
        })
    }

    /// Ends SUMO.
    ///
    /// # Errors
    /// The run folder cannot be written.
    pub async fn finish(self) -> Result<(), TickBenchError> {
        self.drive.finish(false).await?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stages_keep_their_order_and_give_medians_in_milliseconds() {
        let mut stages = Stages::default();
        for seconds in [0.003, 0.001, 0.002] {
            stages.record("sumo", seconds);
            stages.record("decode", 10.0 * seconds);
        }
        stages.record("camera", 0.5);
        let text = serde_json::to_string(&stages).unwrap();
        assert_eq!(text, r#"{"sumo":2.0,"decode":20.0,"camera":500.0}"#);
        assert!(stages.quantiles(0.95).all(|(_, ms)| ms > 2.0));
    }
}
