//! The bridge's time per tick, as a ratio to SUMO alone in the same run.
//!
//! For each population a short stretch of the same simulation is timed twice, many times over:
//! *bridge*: pose in, step, the whole [`crate::world::WorldState`] within 100 m decoded (physics and
//! autopilot are timed apart); *SUMO alone*: a second `sumo` that loads the state saved where the
//! stretch begins, and runs to its end on one message.
//!
//! Stretches are short: no road user arrives that would have been replaced, and a machine whose speed
//! drifts is equally fast for both. The two take turns in going first.

use crate::cores::Cores;
use crate::cpu_time;
use crate::drive::{Drive, DriveError, DriveOptions};
use crate::stats::quantile;
use crate::traci::process::{InstallError, LaunchError, SumoInstall, SumoProcess};
use crate::traci::{self, Batch, LaunchOptions, TcpClient, person, simulation, vehicle};
use crate::traffic::{Counts, TrafficSpec};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Options of a measurement of the bridge.
#[derive(Clone, Debug)]
pub struct BridgeBench {
    /// The run to measure; its traffic and folder are replaced per row.
    pub base: DriveOptions,
    /// Populations: vehicles and pedestrians.
    pub populations: Vec<(usize, usize)>,
    /// Ticks before the first stretch, and in each.
    pub warm_up: u64,
    /// Ticks per stretch.
    pub ticks: u64,
    /// Number of stretches, each measured both ways; the median counts.
    pub repeat: usize,
    /// Folder for scratch files.
    pub scratch: PathBuf,
}

/// One population's figures: medians per tick (ms).
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct BridgeRow {
    /// Background vehicles, as configured.
    pub vehicles: usize,
    /// Pedestrians, as configured.
    pub pedestrians: usize,
    /// SUMO alone.
    pub sumo_alone_ms: f64,
    /// With the bridge.
    pub bridge_ms: f64,
    /// Median of the ratios of the stretches, not ratio of the medians.
    pub ratio: f64,
    /// A quarter of the stretches' ratios are below the first, a quarter above the second.
    pub ratio_quartiles: [f64; 2],
    /// The same in CPU time, which other load on the machine hardly touches: SUMO's and ours together
    /// against SUMO's alone.
    pub sumo_alone_cpu_ms: f64,
    /// CPU time with the bridge, SUMO's and ours.
    pub bridge_cpu_ms: f64,
    /// Median of the ratios of CPU time.
    pub cpu_ratio: f64,
    /// The ego's physics.
    pub physics_ms: f64,
    /// The autopilot.
    pub autopilot_ms: f64,
    /// Mean background population of the stretches, the ego left out, on either side.
    pub alone_vehicles: f64,
    /// Mean pedestrians with SUMO alone.
    pub alone_pedestrians: f64,
    /// Mean background vehicles with the bridge.
    pub bridge_vehicles: f64,
    /// Mean pedestrians with the bridge.
    pub bridge_pedestrians: f64,
    /// Actors within sight of the ego, on average.
    pub actors_in_sight: f64,
    /// Size of SUMO's answer to a tick (bytes), on average.
    pub answer_bytes: f64,
    /// Ticks per stretch.
    pub ticks: u64,
    /// Number of stretches.
    pub repeat: usize,
}

/// Why a measurement failed.
#[derive(Debug, thiserror::Error)]
pub enum BenchError {
    /// The drive fails.
    #[error(transparent)]
    Drive(#[from] DriveError),
    /// SUMO is not installed.
    #[error(transparent)]
    Install(#[from] InstallError),
    /// The second SUMO cannot be started.
    #[error("SUMO alone, for the comparison: {0}")]
    Launch(#[from] LaunchError),
    /// The second SUMO fails.
    #[error("SUMO alone, for the comparison: {0}")]
    Alone(#[from] traci::Error),
}

/// Ticks before a stretch that are not timed: caches fill, and a state just loaded settles.
const HEAD: u64 = 10;

impl BridgeBench {
    /// Measures one population. `progress` is called with the number of each stretch.
    ///
    /// # Errors
    /// SUMO fails.
    pub async fn row(
        &self,
        vehicles: usize,
        pedestrians: usize,
        progress: &mut dyn FnMut(usize),
    ) -> Result<BridgeRow, BenchError> {
        let folder = self.scratch.join(format!("{vehicles}-{pedestrians}"));
        let mut options = self.base.clone();
        options.out = folder.clone();
        options.bridge.output_dir = folder.join("sumo");
        options.bridge.traffic = TrafficSpec::Counts(Counts { vehicles, pedestrians });
        let mut drive = Drive::start(options).await?;
        let mut alone = Alone::start(&folder, drive.bridge().tick()).await?;
        for _ in 0..self.warm_up {
            drive.tick().await?;
        }
        let state = folder.join("state.xml");
        let mut pairs = Vec::new();
        for number in 0..self.repeat.max(1) {
            drive.save_state(&state).await?;
            let begin = drive.bridge().time();
            let (with_bridge, without);
            if number % 2 == 0 {
                with_bridge = bridge_stretch(&mut drive, self.ticks).await?;
                without = alone.stretch(&state, begin, self.ticks).await?;
            } else {
                without = alone.stretch(&state, begin, self.ticks).await?;
                with_bridge = bridge_stretch(&mut drive, self.ticks).await?;
            }
            pairs.push((with_bridge, without));
            progress(number + 1);
        }
        alone.client.close().await?;
        drive.finish(false).await?;
        Ok(self.judge(vehicles, pedestrians, &pairs))
    }

    fn judge(&self, vehicles: usize, pedestrians: usize, pairs: &[(Stretch, Stretch)]) -> BridgeRow {
        let all = |figure: &dyn Fn(&Stretch, &Stretch) -> f64| -> Vec<f64> {
            pairs.iter().map(|(bridge, alone)| figure(bridge, alone)).collect()
        };
        let median = |figure: &dyn Fn(&Stretch, &Stretch) -> f64| quantile(all(figure), 0.5);
        let mean = |figure: &dyn Fn(&Stretch, &Stretch) -> f64| {
            all(figure).iter().sum::<f64>() / pairs.len().max(1) as f64
        };
        let ratios = all(&|bridge, alone| bridge.wall / alone.wall);
        BridgeRow {
            vehicles,
            pedestrians,
            sumo_alone_ms: median(&|_, alone| alone.wall),
            bridge_ms: median(&|bridge, _| bridge.wall),
            ratio: quantile(ratios.clone(), 0.5),
            ratio_quartiles: [quantile(ratios.clone(), 0.25), quantile(ratios, 0.75)],
            sumo_alone_cpu_ms: median(&|_, alone| alone.cpu),
            bridge_cpu_ms: median(&|bridge, _| bridge.cpu),
            cpu_ratio: median(&|bridge, alone| bridge.cpu / alone.cpu),
            physics_ms: median(&|bridge, _| bridge.physics),
            autopilot_ms: median(&|bridge, _| bridge.autopilot),
            alone_vehicles: mean(&|_, alone| alone.vehicles),
            alone_pedestrians: mean(&|_, alone| alone.pedestrians),
            bridge_vehicles: mean(&|bridge, _| bridge.vehicles),
            bridge_pedestrians: mean(&|bridge, _| bridge.pedestrians),
            actors_in_sight: mean(&|bridge, _| bridge.actors),
            answer_bytes: mean(&|bridge, _| bridge.bytes),
            ticks: self.ticks,
            repeat: pairs.len(),
        }
    }
}

/// One stretch: milliseconds per tick, and the mean population.
#[derive(Clone, Copy, Debug, Default)]
struct Stretch {
    wall: f64,
    cpu: f64,
    physics: f64,
    autopilot: f64,
    actors: f64,
    bytes: f64,
    vehicles: f64,
    pedestrians: f64,
}

async fn bridge_stretch(drive: &mut Drive, ticks: u64) -> Result<Stretch, BenchError> {
    for _ in 0..HEAD {
        drive.tick().await?;
    }
    let sumo_cpu =
        |drive: &Drive| drive.bridge().sumo_pid().and_then(cpu_time::of_process).unwrap_or(f64::NAN);
    let (before, cpu_before) = (drive.timings(), sumo_cpu(drive));
    let bytes = drive.bridge().answer_bytes();
    let (mut actors, mut vehicles, mut pedestrians) = (0, 0, 0);
    for _ in 0..ticks {
        drive.tick().await?;
        let world = drive.ego().world();
        actors += world.vehicles.len() + world.pedestrians.len();
        vehicles += drive.bridge().counts().0;
        pedestrians += drive.bridge().counts().1;
    }
    let (after, cpu_after) = (drive.timings(), sumo_cpu(drive));
    let per_tick = |seconds: f64| 1000.0 * seconds / ticks as f64;
    let mean = |sum: usize| sum as f64 / ticks as f64;
    Ok(Stretch {
        wall: per_tick(after.bridge - before.bridge),
        cpu: per_tick(after.bridge_cpu - before.bridge_cpu + cpu_after - cpu_before),
        physics: per_tick(after.physics - before.physics),
        autopilot: per_tick(after.agent - before.agent),
        actors: mean(actors),
        bytes: (drive.bridge().answer_bytes() - bytes) as f64 / ticks as f64,
        vehicles: mean(vehicles),
        pedestrians: mean(pedestrians),
    })
}

/// A second SUMO that runs whole stretches without messages in between.
struct Alone {
    process: SumoProcess,
    client: TcpClient,
    /// s.
    tick: f64,
}

impl Alone {
    /// Starts it with the configuration that the bridge in `folder` runs.
    async fn start(folder: &Path, tick: f64) -> Result<Self, BenchError> {
        let options = LaunchOptions {
            log_file: Some(folder.join("alone.log")),
            ..LaunchOptions::config(folder.join("sumo/sumo.sumocfg"))
        };
        let options = options.option("output-prefix", "alone_").option("no-warnings", "true");
        let (process, client) = SumoProcess::launch_with(&SumoInstall::find()?, &options).await?;
        Ok(Self { process, client, tick })
    }

    /// Loads a state saved at `begin` (s) and runs on from there.
    async fn stretch(&mut self, state: &Path, begin: f64, ticks: u64) -> Result<Stretch, BenchError> {
        // On the core that the bridge and its SUMO share: the same neighbours for both.
        if let Some(core) = Cores::current() {
            core.confine(self.process.id());
        }
        self.client.load_state(&state.to_string_lossy()).await?;
        let first = self.run_to(begin + self.tick * HEAD as f64).await?;
        let cpu = || cpu_time::of_process(self.process.id()).unwrap_or(f64::NAN);
        let (clock, cpu_before) = (Instant::now(), cpu());
        let mut batch = Batch::new();
        batch.step_to(begin + self.tick * (HEAD + ticks) as f64);
        self.client.send(&batch).await?.check().map_err(traci::Error::from)?;
        let (wall, cpu) = (clock.elapsed().as_secs_f64(), cpu() - cpu_before);
        let last = self.counts().await?;
        let per_tick = |seconds: f64| 1000.0 * seconds * self.tick / (last.time - first.time);
        Ok(Stretch {
            wall: per_tick(wall),
            cpu: per_tick(cpu),
            vehicles: 0.5 * (first.vehicles + last.vehicles),
            pedestrians: 0.5 * (first.pedestrians + last.pedestrians),
            ..Stretch::default()
        })
    }

    async fn run_to(&mut self, time: f64) -> Result<Moment, BenchError> {
        let mut batch = Batch::new();
        batch.step_to(time);
        self.client.send(&batch).await?.check().map_err(traci::Error::from)?;
        self.counts().await
    }

    async fn counts(&mut self) -> Result<Moment, BenchError> {
        let mut batch = Batch::new();
        let time = batch.get(simulation::TIME, "");
        let vehicles = batch.get(vehicle::ID_LIST, "");
        let pedestrians = batch.get(person::ID_LIST, "");
        let replies = self.client.send(&batch).await?;
        let vehicles = replies.get_ref(vehicles).map_err(traci::Error::from)?;
        let pedestrians = replies.get_ref(pedestrians).map_err(traci::Error::from)?;
        Ok(Moment {
            time: replies.get(time).map_err(traci::Error::from)?,
            vehicles: vehicles.filter(|id| *id != "ego").count() as f64,
            pedestrians: pedestrians.count() as f64,
        })
    }
}

/// A moment of SUMO alone: its clock (s) and population.
struct Moment {
    time: f64,
    vehicles: f64,
    pedestrians: f64,
}

/// Begins [`peak_memory_mb`] anew at the memory of this moment, where the system allows that.
pub fn reset_peak_memory() {
    let _ = std::fs::write("/proc/self/clear_refs", "5");
}

/// This process's peak memory (MB); None if the system does not report it.
pub fn peak_memory_mb() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    Some(line.split_whitespace().nth(1)?.parse::<f64>().ok()? / 1000.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_peak_begins_anew() {
        let large = std::hint::black_box(vec![1_u8; 256_000_000]);
        let before = peak_memory_mb().unwrap();
        drop(large);
        reset_peak_memory();
        let after = peak_memory_mb().unwrap();
        assert!(after < before - 128.0, "{before} MB, then {after} MB");
    }
}
