//! Suites as data: tasks, towns, weathers, and the events that end an episode (spec.md "Ends",
//! "Conditions"). A suite is a JSON file; the paper's are bundled.

use super::routes::RouteError;
use crate::env::Termination;
use serde::{Deserialize, Deserializer, Serialize};
use std::path::{Path, PathBuf};
use wad_camera::Preset;
use wad_sim::bridge::DEFAULT_TICK_MS;
use wad_sim::bundled;
use wad_sim::scenario::{Scenario, ScenarioError};
use wad_sim::tasks::TaskKind;
use wad_sim::traffic::TrafficSpec;

/// A benchmark.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Suite {
    /// Its name on the command line and in results.
    pub name: String,
    /// Its title in reports.
    pub title: String,
    /// Its source, e.g. a table of the paper.
    #[serde(default)]
    pub source: String,
    /// Towns with weathers.
    pub conditions: Vec<Condition>,
    /// The tasks.
    pub tasks: Vec<SuiteTask>,
    /// False: each task is driven in each of a condition's weathers. True: its episodes take them in turn.
    #[serde(default)]
    pub weathers_in_turn: bool,
    /// The events that end an episode; default: the paper's hard termination.
    #[serde(default)]
    pub termination: Termination,
    /// Episodes per task, town and weather (per task and town if weathers come in turn).
    pub episodes: u64,
}

/// A town in some weathers, e.g. `training`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Condition {
    /// The condition's name.
    #[serde(deserialize_with = "condition")]
    pub name: String,
    /// A CONFIG.
    pub town: String,
    /// Its weathers.
    pub weathers: Vec<Preset>,
}

/// The condition that `name` means: `new`, as older results call `development`, is read as that.
pub fn condition_name(name: &str) -> String {
    if name == "new" { "development".to_string() } else { name.to_string() }
}

/// Reads the name of a condition.
pub(super) fn condition<'de, D: Deserializer<'de>>(from: D) -> Result<String, D::Error> {
    Ok(condition_name(&String::deserialize(from)?))
}

/// Reads names of conditions.
pub(super) fn conditions<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<String>, D::Error> {
    Ok(Vec::<String>::deserialize(from)?.iter().map(|name| condition_name(name)).collect())
}

/// One row of a suite's table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SuiteTask {
    /// The task's name in tables.
    pub name: String,
    /// The kind of task: criterion of success and time limit.
    pub kind: TaskKind,
    /// The set of the town's route file with its places, used in order; None: places are drawn
    /// from the episode's seed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub routes: Option<String>,
    /// None: the kind's own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub traffic: Option<TrafficSpec>,
    /// None: the kind's own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tick_limit: Option<u64>,
    /// The route never ends.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub endless: bool,
}

/// Most episodes of a plan; more are taken for a typing error.
pub(super) const MOST_EPISODES: u64 = 1_000_000;

/// Episodes of a scenario: start, traffic and the detector's faults differ by their seeds.
const SCENARIO_EPISODES: u64 = 5;

/// Why a suite or a part of it cannot be evaluated.
#[derive(Debug, thiserror::Error)]
pub enum SuiteError {
    /// No suite has this name.
    #[error("no suite is called `{found}`: expected {}, a JSON file like those (docs/evaluate.md), or a scenario (docs/scenarios.md)", names().join(", "))]
    Unknown {
        /// The name.
        found: String,
    },
    /// The suite's file cannot be read.
    #[error("cannot read the suite {}: {source}", path.display())]
    Read {
        /// The file or folder.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// The file is not a suite.
    #[error("{} is not a suite: {why}; docs/evaluate.md shows one", path.display())]
    Format {
        /// The file or folder.
        path: PathBuf,
        /// The cause.
        why: String,
    },
    /// The suite lacks a condition or task.
    #[error("the suite {suite} has no {what} `{found}`: expected {}", expected.join(", "))]
    NotIn {
        /// The suite.
        suite: String,
        /// `condition` or `task`.
        what: &'static str,
        /// The unknown name.
        found: String,
        /// The names that it has.
        expected: Vec<String>,
    },
    /// A shard's text is invalid.
    #[error("shard `{found}`: expected K/N with K from 1 to N, e.g. 1/4")]
    Shard {
        /// The text.
        found: String,
    },
    /// Too many episodes.
    #[error(
        "{found} episodes: expected at most {MOST_EPISODES} in all; see `episodes` in the suite, or --episodes"
    )]
    TooMany {
        /// Their number.
        found: u64,
    },
    /// The routes cannot be read.
    #[error(transparent)]
    Routes(#[from] RouteError),
    /// The scenario cannot be read.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
}

const SHIPPED: [&str; 5] = [
    include_str!("suites/tasks.json"),
    include_str!("suites/composite.json"),
    include_str!("suites/corl2017.json"),
    include_str!("suites/nocrash.json"),
    include_str!("suites/infractions.json"),
];

/// Names of the bundled suites.
pub fn names() -> Vec<String> {
    SHIPPED.iter().filter_map(|text| Some(serde_json::from_str::<Suite>(text).ok()?.name)).collect()
}

impl Suite {
    /// The suite called `name`: a bundled one, or a JSON file.
    ///
    /// # Errors
    /// There is no such suite, or the file is not one.
    pub fn find(name: &str) -> Result<Self, SuiteError> {
        let path = Path::new(name);
        if path.is_file() || path.extension().is_some_and(|e| e == "json") {
            let text = std::fs::read_to_string(path)
                .map_err(|source| SuiteError::Read { path: path.to_path_buf(), source })?;
            return Self::parse(&text).map_err(|why| SuiteError::Format { path: path.to_path_buf(), why });
        }
        let shipped = SHIPPED.iter().filter_map(|text| Self::parse(text).ok()).find(|s| s.name == name);
        match shipped {
            Some(suite) => Ok(suite),
            None => Self::of_scenario(name)?.ok_or_else(|| SuiteError::Unknown { found: name.to_string() }),
        }
    }

    /// The suite of one scenario, if `name` is one: its one task, in its weather.
    fn of_scenario(name: &str) -> Result<Option<Self>, SuiteError> {
        let Ok(config) = bundled::resolve(name) else { return Ok(None) };
        if config.extension().is_none_or(|e| e != "sumocfg") {
            return Ok(None);
        }
        let scenario = Scenario::load(&config)?;
        let title = format!("the scenario {}", scenario.name);
        Ok(Some(Self {
            title,
            source: config.to_string_lossy().to_string(),
            conditions: vec![Condition {
                name: "scenario".to_string(),
                town: name.to_string(),
                weathers: vec![scenario.weather],
            }],
            tasks: vec![SuiteTask {
                name: scenario.name.clone(),
                kind: scenario.task,
                routes: None,
                traffic: Some(scenario.traffic),
                tick_limit: Some(scenario.tick_limit(DEFAULT_TICK_MS / 1000.0)),
                endless: false,
            }],
            weathers_in_turn: false,
            termination: Termination::default(),
            episodes: SCENARIO_EPISODES,
            name: scenario.name,
        }))
    }

    fn parse(text: &str) -> Result<Self, String> {
        let suite: Self = serde_json::from_str(text).map_err(|e| e.to_string())?;
        if suite.tasks.is_empty() || suite.conditions.is_empty() {
            return Err("expected one task and one condition or more".to_string());
        }
        if let Some(empty) = suite.conditions.iter().find(|condition| condition.weathers.is_empty()) {
            return Err(format!("the condition `{}` has no weathers", empty.name));
        }
        let mut names: Vec<&str> = suite.tasks.iter().map(|task| task.name.as_str()).collect();
        names.sort_unstable();
        if let Some(pair) = names.windows(2).find(|pair| pair[0] == pair[1]) {
            return Err(format!("two tasks are called `{}`", pair[0]));
        }
        Ok(suite)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shipped_suites_are_what_the_spec_says() {
        assert_eq!(names(), ["tasks", "composite", "corl2017", "nocrash", "infractions"]);
        let nocrash = Suite::find("nocrash").unwrap();
        assert!(nocrash.termination.collision && !nocrash.termination.red_light);
        let weathers: usize = nocrash.conditions.iter().map(|c| c.weathers.len()).sum();
        assert_eq!(nocrash.tasks.len() * weathers * nocrash.episodes as usize, 750);
        assert_eq!(Suite::find("corl2017").unwrap().termination, Termination::none());
        assert_eq!(Suite::find("tasks").unwrap().termination, Termination::default());
        assert_eq!(Suite::find("infractions").unwrap().tasks[0].tick_limit, Some(4000));
    }

    #[test]
    fn the_test_town_and_its_weathers_are_in_no_other_condition() {
        let conditions: Vec<Condition> =
            names().iter().flat_map(|name| Suite::find(name).unwrap().conditions).collect();
        let (test, others): (Vec<_>, Vec<_>) = conditions.iter().partition(|c| c.name == "test");
        assert_eq!(test.len(), names().len(), "every suite has it");
        let weathers = &test[0].weathers;
        assert!(test.iter().all(|c| c.town == "town7" && c.weathers == *weathers));
        for condition in others {
            assert_ne!(condition.town, "town7");
            assert!(!condition.weathers.iter().any(|w| weathers.contains(w)), "{condition:?}");
        }
    }

    #[test]
    fn the_former_name_of_development_is_read_as_that() {
        let old = r#"{"name": "new", "town": "town5", "weathers": ["WetSunset"]}"#;
        let condition: Condition = serde_json::from_str(old).unwrap();
        assert_eq!(condition.name, "development");
        assert!(serde_json::to_string(&condition).unwrap().contains("development"));
    }

    #[test]
    fn what_is_no_suite_says_what_is() {
        let error = Suite::find("nocash").unwrap_err().to_string();
        assert!(error.contains("nocash") && error.contains("corl2017"), "{error}");
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mine.json");
        let find = || Suite::find(&path.to_string_lossy());
        assert!(find().unwrap_err().to_string().contains("mine.json"));
        let own = include_str!("suites/nocrash.json").replace("nocrash", "mine");
        std::fs::write(&path, &own).unwrap();
        assert_eq!(find().unwrap().name, "mine");
        for (from, to, expected) in [
            ("\"episodes\"", "\"epsiodes\"", "epsiodes"),
            ("\"dense\", \"kind\"", "\"empty\", \"kind\"", "two tasks"),
        ] {
            std::fs::write(&path, own.replacen(from, to, 1)).unwrap();
            let error = find().unwrap_err().to_string();
            assert!(error.contains(expected) && error.contains("mine.json"), "{error}");
        }
    }
}
