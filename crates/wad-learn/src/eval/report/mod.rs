//! Reports: results of evaluations as tables and figures, with the published numbers beside them.
//!
//! ```text
//! Results... --gather--> Report --tables--> Markdown, CSV, LaTeX
//!                               --page----> one HTML file with figures, maps, pictures of failures
//! ```

mod driver;
mod figures;
mod page;
mod paired;
mod pictures;
mod published;
mod svg;
mod table;
mod tables;

pub use driver::{Driver, Pool, short};
pub use page::{Page, page};
pub use pictures::{Thumbnail, thumbnails};
pub use svg::{Chart, Line};
pub use table::{Table, csv, latex, markdown};
pub use tables::{overview, tables};

use super::{EpisodeRecord, Manifest, Results, Suite};
use crate::env::EnvOptions;
use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

/// Why a report cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// The run has no episodes.
    #[error("{} has no episodes yet", path.display())]
    Empty {
        /// The file or folder.
        path: PathBuf,
    },
    /// A pool has an agent that no run has.
    #[error("no run has the agent {agent}; there are {}", found.join(", "))]
    Unknown {
        /// The agent.
        agent: String,
        /// The agents of all runs.
        found: Vec<String>,
    },
    /// Two runs of the same suite differ in their settings.
    #[error(
        "{} and {} are results of the same suite, made otherwise: {}; report them apart", first.display(),
        second.display(), differences.join("; ")
    )]
    Mixed {
        /// The first run.
        first: PathBuf,
        /// The run that differs.
        second: PathBuf,
        /// What differs.
        differences: Vec<String>,
    },
}

/// One suite's results, of one run or several.
#[derive(Clone, Debug)]
pub struct Section {
    /// The suite.
    pub suite: Suite,
    /// The settings of the runs.
    pub runs: Vec<(PathBuf, Manifest)>,
    /// Who drove: agents in the order of the command line, each behind its detectors in the order of the runs.
    pub drivers: Vec<Driver>,
    /// The episodes.
    pub episodes: Vec<Entry>,
}

/// An episode of a section.
#[derive(Clone, Debug)]
pub struct Entry {
    /// The folder of its run.
    pub run: PathBuf,
    /// The line in which it counts.
    pub driver: Driver,
    /// What happened.
    pub record: EpisodeRecord,
}

/// The runs of a report.
#[derive(Clone, Debug, Default)]
pub struct Report {
    /// One section per suite.
    pub sections: Vec<Section>,
}

impl Report {
    /// Gathers runs: runs of the same suite make one section, in which agents of a pool share a line, and each
    /// detector has its own.
    ///
    /// # Errors
    /// A run is empty, two of the same suite were made by other builds, settings, nets or weights, or a pool has an
    /// agent that no run has.
    pub fn gather(runs: Vec<Results>, pools: &[Pool]) -> Result<Self, ReportError> {
        let mut report = Self::default();
        let found: BTreeSet<String> =
            runs.iter().flat_map(|run| &run.episodes).map(|e| e.case.agent.to_string()).collect();
        for agent in pools.iter().flat_map(|pool| &pool.agents) {
            if !found.contains(agent) {
                let (agent, found) = (agent.clone(), found.into_iter().collect());
                return Err(ReportError::Unknown { agent, found });
            }
        }
        for run in runs {
            if run.episodes.is_empty() {
                return Err(ReportError::Empty { path: run.path });
            }
            let at = report.sections.iter().position(|s| s.suite.name == run.manifest.suite.name);
            let index = at.unwrap_or(report.sections.len());
            if index == report.sections.len() {
                let suite = run.manifest.suite.clone();
                report.sections.push(Section {
                    suite,
                    runs: Vec::new(),
                    drivers: Vec::new(),
                    episodes: Vec::new(),
                });
            }
            let section = &mut report.sections[index];
            for (path, manifest) in &section.runs {
                let differences = comparable(manifest).differences(&comparable(&run.manifest), false);
                let weights = manifest.agents.iter().filter_map(|(name, id)| {
                    let other = run.manifest.agents.get(name).filter(|other| *other != id)?;
                    Some(format!("agents.{name}: expected {id}, found {other}"))
                });
                let same = manifest.options.detector == run.manifest.options.detector;
                let eyes = (same && manifest.detector != run.manifest.detector)
                    .then(|| "detector: other weights".into());
                let differences: Vec<String> = differences.into_iter().chain(weights).chain(eyes).collect();
                if !differences.is_empty() {
                    let (first, second) = (path.clone(), run.path.clone());
                    return Err(ReportError::Mixed { first, second, differences });
                }
            }
            let detector = run.manifest.options.sight_name();
            section.runs.push((run.path.clone(), run.manifest));
            section.episodes.extend(run.episodes.into_iter().map(|record| Entry {
                run: run.path.clone(),
                driver: Driver::of(&record.case.agent, &detector, pools),
                record,
            }));
        }
        // Where all have one detector, it needs no name.
        let entries = || report.sections.iter().flat_map(|section| &section.episodes);
        if entries().filter_map(|e| e.driver.detector.as_ref()).collect::<BTreeSet<_>>().len() < 2 {
            let all = report.sections.iter_mut().flat_map(|section| &mut section.episodes);
            all.for_each(|e| e.driver.detector = None);
        }
        for section in &mut report.sections {
            section.settle();
        }
        Ok(report)
    }
}

/// The settings that must be equal in gathered runs: all but the selection and by what agents see.
fn comparable(manifest: &Manifest) -> Manifest {
    Manifest {
        options: EnvOptions { detector: String::new(), mirrors: false, ..manifest.options.clone() },
        detector: None,
        selection: Default::default(),
        agents: Default::default(),
        nets: Default::default(),
        towns: Default::default(),
        ..manifest.clone()
    }
}

impl Section {
    /// If an episode was driven twice (SUMO died the first time), the last record counts; the order is that
    /// of the suite, not the order in which episodes ended.
    fn settle(&mut self) {
        let suite = &self.suite;
        let place = |e: &EpisodeRecord| {
            let c = &e.case;
            let task = suite.tasks.iter().position(|t| t.name == c.task);
            let condition = suite.conditions.iter().position(|t| t.name == c.condition);
            let rank = |p: Option<usize>| p.unwrap_or(usize::MAX);
            let names = (c.town.clone(), c.spec.weather.name(), c.spec.traffic().to_string());
            (rank(condition), rank(task), names, c.seed, c.episode)
        };
        let mut drivers: Vec<(usize, Driver)> = Vec::new();
        let agents = self.agents();
        for e in &self.episodes {
            let agent = e.record.case.agent.to_string();
            let rank = agents.iter().position(|a| *a == agent).unwrap_or(agents.len());
            match drivers.iter_mut().find(|(_, driver)| *driver == e.driver) {
                Some((first, _)) => *first = rank.min(*first),
                None => drivers.push((rank, e.driver.clone())),
            }
        }
        drivers.sort_by_key(|(rank, _)| *rank);
        self.drivers = drivers.into_iter().map(|(_, driver)| driver).collect();
        let drivers = &self.drivers;
        let driver = |e: &Entry| drivers.iter().position(|driver| *driver == e.driver);
        let mut by_case = BTreeMap::new();
        for episode in self.episodes.drain(..) {
            let agent = episode.record.case.agent.to_string();
            by_case.insert((driver(&episode), agent, place(&episode.record)), episode);
        }
        self.episodes = by_case.into_values().collect();
    }

    /// The agents in the order of the command line.
    pub fn agents(&self) -> Vec<String> {
        let mut agents: Vec<String> = Vec::new();
        let asked = self.runs.iter().flat_map(|(_, m)| m.selection.agents.iter().map(ToString::to_string));
        for agent in asked.chain(self.episodes.iter().map(|e| e.record.case.agent.to_string())) {
            if !agents.contains(&agent)
                && self.episodes.iter().any(|e| e.record.case.agent.to_string() == agent)
            {
                agents.push(agent);
            }
        }
        agents
    }

    /// The driven conditions, in the suite's order; `other` last.
    pub fn conditions(&self) -> Vec<String> {
        let own = self.suite.conditions.iter().map(|c| c.name.clone());
        own.chain(["other".to_string()])
            .filter(|name| self.episodes.iter().any(|e| e.record.case.condition == *name))
            .collect()
    }

    /// The driven tasks, in the suite's order.
    pub fn tasks(&self) -> Vec<String> {
        let own = self.suite.tasks.iter().map(|task| task.name.clone());
        own.filter(|name| self.episodes.iter().any(|e| e.record.case.task == *name)).collect()
    }

    /// The episodes for which `wanted` is true.
    pub fn of(&self, wanted: impl Fn(&EpisodeRecord) -> bool) -> Vec<&EpisodeRecord> {
        self.episodes.iter().map(|e| &e.record).filter(|e| wanted(e)).collect()
    }

    /// A driver's episodes for which `wanted` is true.
    pub fn by(&self, driver: &Driver, wanted: impl Fn(&EpisodeRecord) -> bool) -> Vec<&EpisodeRecord> {
        self.episodes
            .iter()
            .filter(|e| e.driver == *driver)
            .map(|e| &e.record)
            .filter(|e| wanted(e))
            .collect()
    }

    /// Groups by agent, condition and task, in that order, with their names.
    fn lines(&self) -> Vec<(Vec<String>, Vec<&EpisodeRecord>)> {
        let conditions = self.conditions();
        let mut all = Vec::new();
        for driver in &self.drivers {
            for condition in &conditions {
                for task in &self.suite.tasks {
                    let group =
                        self.by(driver, |e| e.case.task == task.name && e.case.condition == *condition);
                    if !group.is_empty() {
                        all.push((vec![driver.to_string(), condition.clone(), task.name.clone()], group));
                    }
                }
            }
        }
        all
    }
}
