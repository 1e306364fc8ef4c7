//! Step-by-step learning: the tasks in order, when to move on, and how often to go back.

use super::{TaskKind, TaskSpec};
use crate::traffic::TrafficSpec;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::fmt;
use std::path::{Path, PathBuf};
use wad_camera::Preset;

/// Why a curriculum cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum CurriculumError {
    /// The file cannot be read.
    #[error("cannot read the curriculum {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// The file is not a curriculum.
    #[error("{} is not a curriculum: {problem}; scenarios/curriculum.json is an example", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        problem: String,
    },
    /// A value is out of range.
    #[error("{}: {problem}", path.display())]
    Value {
        /// The file.
        path: PathBuf,
        /// Which value, and what was expected.
        problem: String,
    },
}

/// One stage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stage {
    /// The task of its episodes.
    pub task: TaskKind,
    /// The next stage comes when this share (0..1) of the last `window` episodes of this stage was
    /// successful.
    pub threshold: f64,
    /// Number of episodes over which the success rate is taken.
    pub window: usize,
    /// Environment steps after which the next stage comes in any case; None: never.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub most_steps: Option<u64>,
    /// Background traffic; None: the task's own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub traffic: Option<TrafficSpec>,
}

impl Stage {
    /// Its task in its traffic.
    pub fn spec(&self) -> TaskSpec {
        TaskSpec { traffic: self.traffic, ..TaskSpec::new(self.task) }
    }
}

impl fmt::Display for Stage {
    /// Its task, and the traffic if it is not the task's own: `composite, dense traffic`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.task)?;
        self.traffic.as_ref().map_or(Ok(()), |traffic| write!(f, ", {traffic} traffic"))
    }
}

/// A curriculum, as in `scenarios/curriculum.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Curriculum {
    /// A CONFIG, e.g. `town3`.
    pub town: String,
    /// One of them is drawn per episode.
    pub weathers: Vec<Preset>,
    /// Share (0..1) of episodes that go back to an earlier stage's task, drawn evenly.
    pub replay: f64,
    /// The stages, easiest first.
    pub stages: Vec<Stage>,
}

impl Curriculum {
    /// Reads a curriculum.
    ///
    /// # Errors
    /// The file cannot be read, has an unknown or a missing field, or a value out of range.
    pub fn load(path: &Path) -> Result<Self, CurriculumError> {
        let text = std::fs::read_to_string(path)
            .map_err(|source| CurriculumError::Read { path: path.to_path_buf(), source })?;
        Self::parse(path, &text)
    }

    /// The curriculum of a JSON text; `path` is what errors call it.
    ///
    /// # Errors
    /// As [`Curriculum::load`].
    pub fn parse(path: &Path, text: &str) -> Result<Self, CurriculumError> {
        let path = || path.to_path_buf();
        let curriculum: Self = serde_json::from_str(text)
            .map_err(|error| CurriculumError::Malformed { path: path(), problem: error.to_string() })?;
        match curriculum.problem() {
            Some(problem) => Err(CurriculumError::Value { path: path(), problem }),
            None => Ok(curriculum),
        }
    }

    /// The first value out of range, if there is one, and what was expected.
    pub fn problem(&self) -> Option<String> {
        if self.stages.is_empty() {
            return Some("expected one stage or more in `stages`, found none".to_string());
        }
        if self.weathers.is_empty() {
            return Some("expected one weather or more in `weathers`, found none".to_string());
        }
        if !(0.0..1.0).contains(&self.replay) {
            return Some(format!("expected `replay` from 0 to below 1, found {}", self.replay));
        }
        self.stages.iter().enumerate().find_map(|(i, stage)| {
            let at = format!("stage {i} ({})", stage.task);
            if !(0.0..=1.0).contains(&stage.threshold) {
                Some(format!("{at}: expected `threshold` from 0 to 1, found {}", stage.threshold))
            } else if stage.window == 0 {
                Some(format!("{at}: expected `window` of 1 or more, found 0"))
            } else {
                None
            }
        })
    }
}

/// How a stage was left.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Passed {
    /// Its index.
    pub stage: usize,
    /// Its threshold was reached; false: its steps were spent.
    pub threshold: bool,
    /// Environment steps spent in it.
    pub steps: u64,
    /// Share of its last episodes that were successful (0..1).
    pub rate: f64,
}

/// Training's progress in a curriculum; saved with checkpoints.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Progress {
    /// Index of the stage.
    pub stage: usize,
    /// Environment steps spent in it.
    pub steps: u64,
    /// Success of the last episodes of the stage, oldest first.
    pub recent: VecDeque<bool>,
    /// The last stage's threshold has been passed too.
    pub done: bool,
}

impl Progress {
    /// The next episode's stage, this one or an earlier one, and its task in one of the weathers.
    pub fn draw(&self, curriculum: &Curriculum, rng: &mut ChaCha8Rng) -> (usize, TaskSpec) {
        let current = self.stage.min(curriculum.stages.len().saturating_sub(1));
        let back = current > 0 && rng.random_range(0.0..1.0) < curriculum.replay;
        let index = if back { rng.random_range(0..current) } else { current };
        let weather = curriculum.weathers[rng.random_range(0..curriculum.weathers.len())];
        (index, curriculum.stages[index].spec().in_weather(weather))
    }

    /// Notes an episode of the stage `drawn`, of `steps` environment steps. Says how the stage was passed where this
    /// episode brings the next one (or, in the last one, passes the last threshold).
    pub fn note(
        &mut self,
        curriculum: &Curriculum,
        drawn: usize,
        steps: u64,
        success: bool,
    ) -> Option<Passed> {
        let stage = curriculum.stages.get(self.stage)?;
        self.steps += steps;
        if drawn == self.stage {
            self.recent.push_back(success);
            while self.recent.len() > stage.window {
                self.recent.pop_front();
            }
        }
        let (steps, rate) = (self.steps, self.success_rate());
        let threshold = self.recent.len() == stage.window && rate >= stage.threshold;
        let spent = stage.most_steps.is_some_and(|most| self.steps >= most);
        let passed = Passed { stage: self.stage, threshold, steps, rate };
        if self.stage + 1 == curriculum.stages.len() {
            let first = threshold && !self.done;
            self.done |= threshold;
            return first.then_some(passed);
        }
        if threshold || spent {
            *self = Self { stage: self.stage + 1, ..Self::default() };
            return Some(passed);
        }
        None
    }

    /// Share of the last episodes of the stage that were successful; 0 before the first.
    pub fn success_rate(&self) -> f64 {
        let successes = self.recent.iter().filter(|success| **success).count();
        successes as f64 / self.recent.len().max(1) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sumo_network::seeds;

    const SHIPPED: &str = include_str!("../../../../scenarios/curriculum.json");

    fn parse(text: &str) -> Result<Curriculum, CurriculumError> {
        Curriculum::parse(Path::new("c.json"), text)
    }

    #[test]
    fn the_shipped_one_has_the_papers_tasks_in_order() {
        let curriculum = parse(SHIPPED).unwrap();
        let tasks: Vec<TaskKind> = curriculum.stages.iter().map(|stage| stage.task).collect();
        assert_eq!(tasks[..5], TaskKind::FIVE);
        assert_eq!(tasks[5], TaskKind::Composite);
        assert_eq!(curriculum.town, "town3");
    }

    #[test]
    fn an_unknown_field_or_value_is_an_error_that_names_it() {
        for (from, to, expected) in [
            ("\"replay\"", "\"repaly\"", "repaly"),
            ("\"window\": 20, \"most_steps\": 60000", "\"window\": 20, \"most_step\": 1", "most_step"),
            ("0.3", "1.5", "1.5"),
            ("\"one_turn\"", "\"two_turns\"", "two_turns"),
            ("\"window\": 50", "\"window\": 0", "window"),
            ("\"ClearNoon\", ", "\"Fog\", ", "Fog"),
        ] {
            let error = parse(&SHIPPED.replacen(from, to, 1)).unwrap_err().to_string();
            assert!(error.contains(expected) && error.contains("c.json"), "{error}");
        }
    }

    #[test]
    fn stages_follow_on_success_and_at_the_latest_when_their_steps_are_spent() {
        let curriculum = parse(SHIPPED).unwrap();
        let mut progress = Progress::default();
        for _ in 0..19 {
            assert!(progress.note(&curriculum, 0, 100, true).is_none());
        }
        let passed = progress.note(&curriculum, 0, 100, true);
        assert_eq!(passed, Some(Passed { stage: 0, threshold: true, steps: 2000, rate: 1.0 }));
        assert_eq!((progress.stage, progress.steps), (1, 0));
        // A replay's success says nothing about this stage.
        for _ in 0..40 {
            assert!(progress.note(&curriculum, 0, 100, true).is_none());
        }
        let most = curriculum.stages[1].most_steps.unwrap();
        let spent = progress.note(&curriculum, 1, most, false).unwrap();
        assert_eq!((spent.stage, spent.threshold), (1, false));
        assert_eq!(progress.stage, 2);
        let mut last = Progress { stage: 5, ..Progress::default() };
        let passed = (0..60).filter(|_| last.note(&curriculum, 5, 1000, true).is_some()).count();
        assert_eq!((passed, last.stage, last.done), (1, 5, true));
    }

    #[test]
    fn a_replay_of_the_same_task_in_other_traffic_says_nothing_about_a_stage() {
        let curriculum = parse(include_str!("../../../../scenarios/curriculum_dense.json")).unwrap();
        let mut progress = Progress { stage: 6, ..Progress::default() };
        let mut rng = seeds::rng(3, "curriculum");
        for _ in 0..200 {
            let (stage, task) = progress.draw(&curriculum, &mut rng);
            assert_eq!(task.traffic, curriculum.stages[stage].traffic);
            let passed = progress.note(&curriculum, stage, 1000, stage < 6);
            assert!(passed.is_none(), "passed by replays: {passed:?}");
        }
        assert_eq!((progress.recent.len(), progress.success_rate()), (50, 0.0));
    }

    #[test]
    fn a_stage_is_called_by_its_task_and_by_the_traffic_that_is_not_the_tasks_own() {
        let mut stage = parse(SHIPPED).unwrap().stages[5].clone();
        assert_eq!(stage.to_string(), "composite");
        stage.traffic = Some(TrafficSpec::Dense);
        assert_eq!(stage.to_string(), "composite, dense traffic");
    }

    #[test]
    fn replays_go_to_earlier_stages_alone() {
        let curriculum = parse(SHIPPED).unwrap();
        let mut rng = seeds::rng(3, "curriculum");
        let progress = Progress { stage: 2, ..Progress::default() };
        let tasks: Vec<TaskKind> = (0..400).map(|_| progress.draw(&curriculum, &mut rng).1.kind).collect();
        let count = |kind: TaskKind| tasks.iter().filter(|task| **task == kind).count();
        assert!((80..160).contains(&(count(TaskKind::Straight) + count(TaskKind::OneTurn))));
        assert_eq!(count(TaskKind::Obstacle) + count(TaskKind::Cross) + count(TaskKind::Composite), 0);
        let first = Progress::default();
        assert!((0..50).all(|_| first.draw(&curriculum, &mut rng).1.kind == TaskKind::Straight));
    }
}
