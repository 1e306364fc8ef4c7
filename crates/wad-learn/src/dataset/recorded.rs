//! A recorded run as the source of data: its options and its telemetry.

use super::error::DatasetError;
use super::plan::{Segment, seed_of};
use crate::drive::DriveOptions;
use std::path::{Path, PathBuf};
use sumo_traci::process::SumoInstall;
use wad_camera::Preset;
use wad_sim::assets::AssetsError;
use wad_sim::sumo_config::{OptionSchema, SumoConfig};
use wad_sim::telemetry::TickRecord;

/// A run folder, read back.
#[derive(Clone, Debug)]
pub struct RecordedRun {
    /// The run's folder.
    pub folder: PathBuf,
    /// The options of the run, from `config.json`.
    pub options: DriveOptions,
    /// Its ticks, in order.
    pub(super) ticks: Vec<TickRecord>,
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

    /// The name of its net: a scenario's town.
    ///
    /// # Errors
    /// SUMO is not installed, or the config cannot be read.
    pub fn town(&self) -> Result<String, AssetsError> {
        let schema = OptionSchema::cached(&SumoInstall::find()?, false)?;
        Ok(SumoConfig::load(&self.options.bridge.config, &schema)?.town())
    }

    /// Simulation time from its first tick to its last (s).
    fn seconds(&self) -> f64 {
        self.ticks.last().map_or(0.0, |last| last.time) - self.ticks.first().map_or(0.0, |first| first.time)
    }

    /// Segments for these runs of `town` in each of these weathers, with the weathers of a run side by side. The
    /// number of frames is an upper limit.
    pub fn segments(runs: &[Self], town: &str, weathers: &[Preset], every: f64, seed: u64) -> Vec<Segment> {
        let of = |run: &Self| (run.seconds() / every) as usize + 1;
        let all = runs.iter().flat_map(|run| weathers.iter().map(move |&weather| (run, weather)));
        let segment = |(index, (run, weather)): (usize, (&Self, Preset))| Segment {
            index,
            seed: seed_of(seed, index),
            weather,
            traffic: run.options.bridge.traffic.counts(town).unwrap_or_default(),
            frames: of(run),
        };
        all.enumerate().map(segment).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wad_sim::bundled;
    use wad_sim::traffic::{Counts, TrafficSpec};

    fn run() -> RecordedRun {
        let config = bundled::resolve("obstacle").unwrap();
        let options = DriveOptions::passing(config, 5, TrafficSpec::Dense, Path::new("scratch"));
        RecordedRun { folder: PathBuf::from("run"), options, ticks: Vec::new() }
    }

    #[test]
    fn the_town_of_a_scenario_is_its_net() {
        assert_eq!(run().town().unwrap(), "town5");
    }

    #[test]
    fn each_segment_of_a_run_has_a_seed_of_its_own_from_the_seed_asked_for() {
        let weathers = [Preset::ClearNoon, Preset::CloudyNoon];
        let segments = |seed| RecordedRun::segments(&[run()], "town5", &weathers, 0.5, seed);
        let seeds: Vec<u64> = [1, 2].into_iter().flat_map(segments).map(|one| one.seed).collect();
        assert!((0..4).all(|i| !seeds[..i].contains(&seeds[i])), "{seeds:?}");
        assert_eq!(segments(1)[0].traffic, Counts::new(70, 150));
    }
}
