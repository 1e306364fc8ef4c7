//! What the bridge costs, as a ratio to SUMO alone in the same run.
//!
//! For each population the same stretch of the same simulation is timed twice, in turns:
//! *bridge*: pose in, step, the whole [`crate::world::WorldState`] within 100 m decoded (physics and
//! autopilot are timed apart); *SUMO alone*: a plain `sumo` without TraCI that loads the state saved
//! where the stretch begins, a run over the stretch less a run over its first ticks, so that start-up
//! and loading cancel out.

use crate::cpu_time;
use crate::drive::{Drive, DriveError, DriveOptions};
use crate::traci::process::{InstallError, SumoInstall};
use crate::traffic::{Counts, TrafficSpec};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// What to measure.
#[derive(Clone, Debug)]
pub struct BridgeBench {
    /// The run that is measured; its traffic and folder are replaced per row.
    pub base: DriveOptions,
    /// Populations: vehicles and pedestrians.
    pub populations: Vec<(usize, usize)>,
    /// Ticks before the stretch, and in it.
    pub warm_up: u64,
    pub ticks: u64,
    /// Times that each stretch is measured; the median counts.
    pub repeat: usize,
    /// Folder for scratch files.
    pub scratch: PathBuf,
}

/// One population's figures: medians per tick (ms).
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct BridgeRow {
    pub vehicles: usize,
    pub pedestrians: usize,
    pub sumo_alone_ms: f64,
    pub bridge_ms: f64,
    /// Median of the ratios of the turns, not ratio of the medians.
    pub ratio: f64,
    /// The same in CPU time, which other load on the machine hardly touches: SUMO's and ours together
    /// against SUMO's alone.
    pub sumo_alone_cpu_ms: f64,
    pub bridge_cpu_ms: f64,
    pub cpu_ratio: f64,
    pub physics_ms: f64,
    pub autopilot_ms: f64,
    /// Actors within sight of the ego, on average.
    pub actors_in_sight: f64,
    pub ticks: u64,
    pub repeat: usize,
}

/// Why a measurement failed.
#[derive(Debug, thiserror::Error)]
pub enum BenchError {
    #[error(transparent)]
    Drive(#[from] DriveError),
    #[error(transparent)]
    Install(#[from] InstallError),
    #[error("plain SUMO failed in the comparison: {0}")]
    Alone(String),
}

/// A shorter stretch of SUMO alone is lengthened (s).
const SHORTEST_ALONE: f64 = 0.05;

/// Ticks of the short run that is subtracted.
const HEAD: u64 = 10;

impl BridgeBench {
    /// Measures one population. `progress` hears of each turn.
    ///
    /// # Errors
    /// SUMO fails.
    pub async fn row(
        &self,
        vehicles: usize,
        pedestrians: usize,
        progress: &mut dyn FnMut(usize),
    ) -> Result<BridgeRow, BenchError> {
        let mut turns = Vec::new();
        for turn in 0..self.repeat.max(1) {
            let folder = self.scratch.join(format!("{vehicles}-{pedestrians}-{turn}"));
            turns.push(self.turn(vehicles, pedestrians, &folder).await?);
            progress(turn + 1);
        }
        let median_of = |figure: &dyn Fn(&Turn) -> f64| median(turns.iter().map(figure).collect());
        Ok(BridgeRow {
            vehicles,
            pedestrians,
            sumo_alone_ms: median_of(&|t| t.alone),
            bridge_ms: median_of(&|t| t.bridge),
            ratio: median_of(&|t| t.bridge / t.alone),
            sumo_alone_cpu_ms: median_of(&|t| t.alone_cpu),
            bridge_cpu_ms: median_of(&|t| t.bridge_cpu),
            cpu_ratio: median_of(&|t| t.bridge_cpu / t.alone_cpu),
            physics_ms: median_of(&|t| t.physics),
            autopilot_ms: median_of(&|t| t.autopilot),
            actors_in_sight: median_of(&|t| t.actors),
            ticks: self.ticks,
            repeat: turns.len(),
        })
    }

    async fn turn(&self, vehicles: usize, pedestrians: usize, folder: &Path) -> Result<Turn, BenchError> {
        let mut options = self.base.clone();
        options.out = folder.to_path_buf();
        options.bridge.output_dir = folder.join("sumo");
        options.bridge.traffic = TrafficSpec::Counts(Counts { vehicles, pedestrians });
        let mut drive = Drive::start(options).await?;
        for _ in 0..self.warm_up {
            drive.tick().await?;
        }
        let state = folder.join("state.xml.gz");
        drive.save_state(&state).await?;
        let begin = drive.bridge().time();
        let sumo_cpu =
            |drive: &Drive| drive.bridge().sumo_pid().and_then(cpu_time::of_process).unwrap_or(f64::NAN);
        let (before, cpu_before) = (drive.timings(), sumo_cpu(&drive));
        let mut actors = 0;
        for _ in 0..self.ticks {
            drive.tick().await?;
            let world = drive.ego().world();
            actors += world.vehicles.len() + world.pedestrians.len();
        }
        let (after, cpu_after) = (drive.timings(), sumo_cpu(&drive));
        let tick = drive.bridge().tick();
        drive.finish("survived", false).await?;
        let install = SumoInstall::find()?;
        let config = folder.join("sumo/sumo.sumocfg");
        let time = |ticks: u64| alone(&install, &config, &state, begin + tick * ticks as f64);
        let (head, mut whole) = (time(HEAD)?, time(HEAD + self.ticks)?);
        let mut alone_ticks = self.ticks;
        if whole.0 - head.0 < SHORTEST_ALONE {
            // Too short to tell from the start-up's own scatter.
            alone_ticks = 50 * self.ticks;
            whole = time(HEAD + alone_ticks)?;
        }
        let per_alone_tick = |seconds: f64| (1000.0 * seconds / alone_ticks as f64).max(1e-6);
        let per_tick = |seconds: f64| 1000.0 * seconds / self.ticks as f64;
        Ok(Turn {
            alone: per_alone_tick(whole.0 - head.0),
            bridge: per_tick(after.bridge - before.bridge),
            alone_cpu: per_alone_tick(whole.1 - head.1),
            bridge_cpu: per_tick(after.bridge_cpu - before.bridge_cpu + cpu_after - cpu_before),
            physics: per_tick(after.physics - before.physics),
            autopilot: per_tick(after.agent - before.agent),
            actors: actors as f64 / self.ticks as f64,
        })
    }
}

/// Milliseconds per tick of one turn.
struct Turn {
    alone: f64,
    bridge: f64,
    alone_cpu: f64,
    bridge_cpu: f64,
    physics: f64,
    autopilot: f64,
    actors: f64,
}

/// Wall and CPU seconds that plain SUMO takes from the saved state until `end` (s).
fn alone(install: &SumoInstall, config: &Path, state: &Path, end: f64) -> Result<(f64, f64), BenchError> {
    let cpu = || cpu_time::of_ended_children().unwrap_or(f64::NAN);
    let (began, cpu_before) = (Instant::now(), cpu());
    let output = install
        .command("sumo")
        .arg("-c")
        .arg(config)
        .arg("--load-state")
        .arg(state)
        .args(["--end", &format!("{end:.3}"), "--no-warnings", "true"])
        .output()
        .map_err(|e| BenchError::Alone(e.to_string()))?;
    if !output.status.success() {
        return Err(BenchError::Alone(String::from_utf8_lossy(&output.stderr).trim().to_string()));
    }
    Ok((began.elapsed().as_secs_f64(), cpu() - cpu_before))
}

/// The middle value.
pub fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    match values.len() {
        0 => f64::NAN,
        n if n % 2 == 1 => values[n / 2],
        n => 0.5 * (values[n / 2 - 1] + values[n / 2]),
    }
}
