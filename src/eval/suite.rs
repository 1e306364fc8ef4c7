//! What is evaluated: suites as data.

use super::DriverSpec;
use crate::camera::Preset;
use crate::seeds;
use crate::tasks::{TaskKind, TaskSpec};
use crate::traffic::TrafficSpec;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// A set of tasks with its conditions (spec.md "Ends", "Conditions").
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Suite {
    /// The paper's five tasks (table 1).
    Tasks,
    /// 70 vehicles and 100 pedestrians (figure 8).
    Composite,
}

/// A suite that does not exist.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("no suite is called `{found}`: expected tasks or composite")]
pub struct SuiteError {
    pub found: String,
}

impl Suite {
    /// As on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Tasks => "tasks",
            Self::Composite => "composite",
        }
    }

    /// Its tasks, in order.
    pub fn tasks(self) -> &'static [TaskKind] {
        match self {
            Self::Tasks => &TaskKind::FIVE,
            Self::Composite => &[TaskKind::Composite],
        }
    }

    /// Its towns: training, then new.
    pub fn towns(self) -> [&'static str; 2] {
        ["town3", "town5"]
    }

    /// Its weathers: the training ones, then the new ones.
    pub fn weathers(self) -> &'static [Preset] {
        match self {
            Self::Tasks | Self::Composite => &[
                Preset::ClearNoon,
                Preset::CloudyNoon,
                Preset::SoftRainNoon,
                Preset::WetCloudySunset,
                Preset::MidRainyNoon,
            ],
        }
    }

    /// Episodes per task, town and weather.
    pub fn episodes(self) -> u64 {
        match self {
            Self::Tasks => 25,
            Self::Composite => 20,
        }
    }
}

impl fmt::Display for Suite {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Suite {
    type Err = SuiteError;

    fn from_str(text: &str) -> Result<Self, SuiteError> {
        [Self::Tasks, Self::Composite]
            .into_iter()
            .find(|suite| suite.name() == text)
            .ok_or_else(|| SuiteError { found: text.to_string() })
    }
}

/// Which part of a suite is driven; what is empty or None is the suite's own.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Selection {
    pub agents: Vec<DriverSpec>,
    pub tasks: Vec<TaskKind>,
    pub towns: Vec<String>,
    pub weathers: Vec<Preset>,
    pub traffic: Vec<TrafficSpec>,
    pub seeds: Vec<u64>,
    pub episodes: Option<u64>,
}

/// One episode to be driven.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Case {
    pub suite: Suite,
    pub agent: DriverSpec,
    pub town: String,
    pub task: TaskSpec,
    /// The evaluation's seed, and the number of the episode in its row.
    pub seed: u64,
    pub episode: u64,
}

impl Case {
    /// The seed of the episode itself. It does not hang on agent or weather: all drive the same places.
    pub fn episode_seed(&self) -> u64 {
        seeds::derive(self.seed, &format!("{} {} {} {}", self.suite, self.town, self.task.kind, self.episode))
    }
}

impl Selection {
    /// The episodes, town by town so that an environment serves many.
    pub fn plan(&self, suite: Suite) -> Vec<Case> {
        fn or<T: Clone>(given: &[T], own: impl FnOnce() -> Vec<T>) -> Vec<T> {
            if given.is_empty() { own() } else { given.to_vec() }
        }
        let towns = or(&self.towns, || suite.towns().map(String::from).to_vec());
        let tasks = or(&self.tasks, || suite.tasks().to_vec());
        let weathers = or(&self.weathers, || suite.weathers().to_vec());
        let traffic: Vec<Option<TrafficSpec>> =
            or(&self.traffic.iter().copied().map(Some).collect::<Vec<_>>(), || vec![None]);
        let seeds = or(&self.seeds, || vec![0]);
        let agents = or(&self.agents, || vec![DriverSpec::Autopilot]);
        let mut plan = Vec::new();
        for agent in &agents {
            for town in &towns {
                for &kind in &tasks {
                    for &weather in &weathers {
                        for &traffic in &traffic {
                            for &seed in &seeds {
                                plan.extend((0..self.episodes.unwrap_or(suite.episodes())).map(|episode| {
                                    Case {
                                        suite,
                                        agent: agent.clone(),
                                        town: town.clone(),
                                        task: TaskSpec { traffic, ..TaskSpec::new(kind) }.in_weather(weather),
                                        seed,
                                        episode,
                                    }
                                }));
                            }
                        }
                    }
                }
            }
        }
        plan
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_suite_is_all_of_its_conditions_unless_told_otherwise() {
        let whole = Selection::default().plan(Suite::Tasks);
        assert_eq!(whole.len(), 5 * 2 * 5 * 25);
        let some = Selection {
            tasks: vec![TaskKind::Cross],
            towns: vec!["town5".into()],
            weathers: vec![Preset::MidRainyNoon],
            seeds: vec![1, 2],
            episodes: Some(3),
            ..Selection::default()
        };
        let plan = some.plan(Suite::Tasks);
        assert_eq!(plan.len(), 6);
        let mut seeds: Vec<u64> = plan.iter().map(Case::episode_seed).collect();
        seeds.sort_unstable();
        seeds.dedup();
        assert_eq!(seeds.len(), 6);
    }

    #[test]
    fn agents_and_weathers_drive_the_same_places() {
        let plan = Selection { episodes: Some(1), ..Selection::default() }.plan(Suite::Composite);
        let seeds: Vec<u64> = plan.iter().map(Case::episode_seed).collect();
        assert_eq!(seeds[..5], [seeds[0]; 5]);
        assert_ne!(seeds[0], seeds[5], "another town");
    }
}
