//! A training's learning curve, read back from its folder.

use super::{TrainConfig, TrainError};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Training episodes over which a curve is averaged.
const WINDOW: usize = 40;

/// A stage of the curriculum that was left.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct StagePassed {
    /// Its number, from 0.
    pub stage: usize,
    /// Its threshold was reached; false: its steps were spent.
    pub threshold: bool,
    /// Environment steps of the training by then.
    pub step: u64,
    /// Wall time of the training by then (h).
    pub hours: f64,
}

/// The course of a training, from its `config.json` and `train.jsonl`.
#[derive(Clone, Debug)]
pub struct Curve {
    /// Agent, inputs, and how it learns, e.g. "wad-t, raw, reward only".
    pub name: String,
    /// Its seed.
    pub seed: u64,
    /// The configuration without seed and length: equal for trainings that differ in nothing else.
    pub made: serde_json::Value,
    /// The curriculum's tasks, in order, with the traffic where it is not the task's own.
    pub tasks: Vec<String>,
    /// The stages that were passed, in order.
    pub passed: Vec<StagePassed>,
    /// Environment steps of the agent.
    pub steps: u64,
    /// Wall time (h).
    pub hours: f64,
    /// Of each episode that the agent drove: step, success (0 or 1), return.
    episodes: Vec<(f64, f64, f64)>,
}

/// What of the lines of `train.jsonl` is needed.
#[derive(Deserialize)]
struct LogLine {
    global_step: u64,
    by: Option<String>,
    success: Option<bool>,
    #[serde(rename = "charts/episodic_return")]
    episodic_return: Option<f64>,
    #[serde(rename = "charts/hours")]
    hours: Option<f64>,
    passed: Option<StagePassed>,
}

impl Curve {
    /// The curve of the training in `run`.
    ///
    /// # Errors
    /// A file is missing or is not a training's, or the agent has driven no episode yet.
    pub fn load(run: &Path) -> Result<Self, TrainError> {
        let read = |name: &str| {
            let path = run.join(name);
            let text = std::fs::read_to_string(&path);
            text.map_err(|source| TrainError::Read { path: path.clone(), source }).map(|text| (path, text))
        };
        let (path, text) = read("config.json")?;
        let malformed = |e: serde_json::Error| TrainError::ConfigFile { path, why: e.to_string() };
        let config: TrainConfig = serde_json::from_str(&text).map_err(malformed)?;
        let mut made = serde_json::to_value(&config).unwrap_or_default();
        if let Some(made) = made.as_object_mut() {
            made.remove("seed");
            made.remove("steps");
        }
        let inputs = serde_json::to_value(config.inputs).unwrap_or_default();
        let how = if config.is_warm() || config.init.is_some() || config.asks() {
            "with demonstrations"
        } else {
            "reward only"
        };
        let agent = config.algorithm.agent_name();
        let mut curve = Self {
            name: format!("{agent}, {}, {how}", inputs.as_str().unwrap_or_default()),
            seed: config.seed,
            made,
            tasks: config.curriculum.stages.iter().map(ToString::to_string).collect(),
            passed: Vec::new(),
            steps: 0,
            hours: 0.0,
            episodes: Vec::new(),
        };
        let (path, text) = read("train.jsonl")?;
        // The last line of a training that was cut off is not whole.
        for line in text.lines().filter_map(|line| serde_json::from_str::<LogLine>(line).ok()) {
            curve.steps = curve.steps.max(line.global_step);
            curve.hours = curve.hours.max(line.hours.unwrap_or_default());
            curve.passed.extend(line.passed);
            if let (Some("agent"), Some(success), Some(sum)) =
                (line.by.as_deref(), line.success, line.episodic_return)
            {
                curve.episodes.push((line.global_step as f64, f64::from(u8::from(success)), sum));
            }
        }
        if curve.episodes.is_empty() {
            let none = "it holds no episode that the agent drove";
            let source = std::io::Error::new(std::io::ErrorKind::InvalidData, none);
            return Err(TrainError::Read { path, source });
        }
        Ok(curve)
    }

    /// Environment step, and share of the last episodes that succeeded (0..1).
    pub fn success(&self) -> Vec<(f64, f64)> {
        self.means(|episode| episode.1)
    }

    /// Environment step, and mean return of the last episodes.
    pub fn returns(&self) -> Vec<(f64, f64)> {
        self.means(|episode| episode.2)
    }

    /// Environment step, and number of stages passed.
    pub fn stages(&self) -> Vec<(f64, f64)> {
        let mut points = vec![(0.0, 0.0)];
        for (count, pass) in self.passed.iter().enumerate() {
            points.extend([(pass.step as f64, count as f64), (pass.step as f64, count as f64 + 1.0)]);
        }
        points.push((self.steps as f64, self.passed.len() as f64));
        points
    }

    fn means(&self, value: impl Fn(&(f64, f64, f64)) -> f64) -> Vec<(f64, f64)> {
        let from = (WINDOW / 4).min(self.episodes.len()) - 1;
        (from..self.episodes.len())
            .map(|last| {
                let window = &self.episodes[(last + 1).saturating_sub(WINDOW)..=last];
                (self.episodes[last].0, window.iter().map(&value).sum::<f64>() / window.len() as f64)
            })
            .collect()
    }
}
