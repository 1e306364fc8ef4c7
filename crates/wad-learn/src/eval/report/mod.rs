//! Reports: results of evaluations as tables and figures, with the published numbers beside them.
//!
//! ```text
//! Results... --gather--> Report --tables--> Markdown, CSV, LaTeX
//!                               --page----> one HTML file with figures, maps, pictures of failures
//! ```

mod figures;
mod page;
mod pictures;
mod published;
mod svg;
mod table;
mod tables;

pub use page::{Page, page};
pub use pictures::{Thumbnail, thumbnails};
pub use svg::{Chart, Line};
pub use table::{Table, csv, latex, markdown};
pub use tables::tables;

use super::{EpisodeRecord, Manifest, Results, Suite};
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
    /// The episodes, each with the folder of its run.
    pub episodes: Vec<(PathBuf, EpisodeRecord)>,
}

/// The runs of a report.
#[derive(Clone, Debug, Default)]
pub struct Report {
    /// One section per suite.
    pub sections: Vec<Section>,
}

impl Report {
    /// Gathers runs: runs of the same suite make one section.
    ///
    /// # Errors
    /// A run is empty, or two of the same suite were made by other builds, settings, nets or weights.
    pub fn gather(runs: Vec<Results>) -> Result<Self, ReportError> {
        let mut report = Self::default();
        for run in runs {
            if run.episodes.is_empty() {
                return Err(ReportError::Empty { path: run.path });
            }
            let at = report.sections.iter().position(|s| s.suite.name == run.manifest.suite.name);
            let index = at.unwrap_or(report.sections.len());
            if index == report.sections.len() {
                let suite = run.manifest.suite.clone();
                report.sections.push(Section { suite, runs: Vec::new(), episodes: Vec::new() });
            }
            let section = &mut report.sections[index];
            for (path, manifest) in &section.runs {
                let differences = comparable(manifest).differences(&comparable(&run.manifest), false);
                let weights = manifest.agents.iter().filter_map(|(name, id)| {
                    let other = run.manifest.agents.get(name).filter(|other| *other != id)?;
                    Some(format!("agents.{name}: expected {id}, found {other}"))
                });
                let differences: Vec<String> = differences.into_iter().chain(weights).collect();
                if !differences.is_empty() {
                    let (first, second) = (path.clone(), run.path.clone());
                    return Err(ReportError::Mixed { first, second, differences });
                }
            }
            section.runs.push((run.path.clone(), run.manifest));
            section.episodes.extend(run.episodes.into_iter().map(|episode| (run.path.clone(), episode)));
        }
        for section in &mut report.sections {
            section.settle();
        }
        Ok(report)
    }
}

/// The settings that must be equal in gathered runs: all but the selection.
fn comparable(manifest: &Manifest) -> Manifest {
    Manifest {
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
        let agents = self.agents();
        let agent = |e: &EpisodeRecord| agents.iter().position(|a| *a == e.case.agent.to_string());
        let mut by_case = std::collections::BTreeMap::new();
        for (run, episode) in self.episodes.drain(..) {
            by_case.insert((agent(&episode), place(&episode)), (run, episode));
        }
        self.episodes = by_case.into_values().collect();
    }

    /// The agents in the order of the command line.
    pub fn agents(&self) -> Vec<String> {
        let mut agents: Vec<String> = Vec::new();
        let asked = self.runs.iter().flat_map(|(_, m)| m.selection.agents.iter().map(ToString::to_string));
        for agent in asked.chain(self.episodes.iter().map(|(_, e)| e.case.agent.to_string())) {
            if !agents.contains(&agent)
                && self.episodes.iter().any(|(_, e)| e.case.agent.to_string() == agent)
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
            .filter(|name| self.episodes.iter().any(|(_, e)| e.case.condition == *name))
            .collect()
    }

    /// The episodes for which `wanted` is true.
    pub fn of(&self, wanted: impl Fn(&EpisodeRecord) -> bool) -> Vec<&EpisodeRecord> {
        self.episodes.iter().map(|(_, e)| e).filter(|e| wanted(e)).collect()
    }
}

/// An agent's name for tables: a file's name without its folder, an external one's command cut short.
pub fn short(agent: &str) -> String {
    let text = match agent.strip_prefix("exec:") {
        Some(command) => format!("exec:{}", command.rsplit('/').next().unwrap_or(command)),
        None => agent.rsplit('/').next().unwrap_or(agent).trim_end_matches(".safetensors").to_string(),
    };
    if text.chars().count() <= 24 { text } else { text.chars().take(22).collect::<String>() + ".." }
}
