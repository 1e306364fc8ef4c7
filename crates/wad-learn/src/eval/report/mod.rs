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

use super::{EpisodeRecord, Fault, Manifest, Results, Suite};
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
    /// The episodes that count.
    pub episodes: Vec<Entry>,
    /// Number of episodes in which SUMO died: they do not count.
    pub lost: usize,
}

/// An episode of a section.
#[derive(Clone, Debug)]
pub struct Entry {
    /// The folder of its run.
    pub run: PathBuf,
    /// The line in which it counts.
    pub driver: Driver,
    /// Its condition, with the town where episodes of the condition have several.
    pub condition: String,
    /// Its task, with the traffic where episodes of the task have several.
    pub task: String,
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
                    lost: 0,
                });
            }
            let section = &mut report.sections[index];
            for (path, manifest) in &section.runs {
                let differences = comparable(manifest).differences(&comparable(&run.manifest), false);
                let files = [
                    named_alike("agents", &manifest.agents, &run.manifest.agents),
                    named_alike("nets", &manifest.nets, &run.manifest.nets),
                    named_alike("towns", &manifest.towns, &run.manifest.towns),
                ];
                let same = manifest.options.detector == run.manifest.options.detector;
                let eyes = (same && manifest.detector != run.manifest.detector)
                    .then(|| "detector: other weights".into());
                let differences: Vec<String> =
                    differences.into_iter().chain(files.concat()).chain(eyes).collect();
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
                condition: record.case.condition.clone(),
                task: record.case.task.clone(),
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

/// The differences in what both maps name.
fn named_alike(
    what: &str,
    first: &BTreeMap<String, String>,
    second: &BTreeMap<String, String>,
) -> Vec<String> {
    let differences = first.iter().filter_map(|(name, id)| {
        let other = second.get(name).filter(|other| *other != id)?;
        Some(format!("{what}.{name}: expected {id}, found {other}"))
    });
    differences.collect()
}

/// The settings that must be equal in gathered runs: all but the selection, by what agents see, and what differs only
/// where both runs name it.
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
    /// If an episode was driven twice (SUMO died the first time), the last record counts, and none in which SUMO died;
    /// the order is that of the suite, not the order in which episodes ended.
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
        let (lost, counting): (Vec<Entry>, Vec<Entry>) =
            by_case.into_values().partition(|e| e.record.fault == Some(Fault::Simulator));
        (self.episodes, self.lost) = (counting, lost.len());
        self.tell_apart();
    }

    /// Names the town in a condition that has several, and the traffic in a task that has several.
    fn tell_apart(&mut self) {
        let mut towns = BTreeMap::<String, BTreeSet<String>>::new();
        let mut traffic = BTreeMap::<String, BTreeSet<String>>::new();
        for Entry { record, .. } in &self.episodes {
            let case = &record.case;
            towns.entry(case.condition.clone()).or_default().insert(case.town.clone());
            traffic.entry(case.task.clone()).or_default().insert(case.spec.traffic().to_string());
        }
        for Entry { condition, task, record, .. } in &mut self.episodes {
            if towns[&record.case.condition].len() > 1 {
                *condition = format!("{condition}, {}", record.case.town);
            }
            if traffic[&record.case.task].len() > 1 {
                *task = format!("{task}, {}", record.case.spec.traffic());
            }
        }
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
        let place = |name: &str| self.suite.conditions.iter().position(|c| c.name == name);
        self.driven(|e| (place(&e.record.case.condition), &e.condition))
    }

    /// The driven tasks, in the suite's order.
    pub fn tasks(&self) -> Vec<String> {
        let place = |name: &str| self.suite.tasks.iter().position(|t| t.name == name);
        self.driven(|e| (place(&e.record.case.task), &e.task))
    }

    /// The names that episodes have, by their places; those without a place last.
    fn driven(&self, placed: impl Fn(&Entry) -> (Option<usize>, &String)) -> Vec<String> {
        let found = self.episodes.iter().map(|e| {
            let (place, name) = placed(e);
            (place.unwrap_or(usize::MAX), name.clone())
        });
        found.collect::<BTreeSet<_>>().into_iter().map(|(_, name)| name).collect()
    }

    /// A driver's episodes for which `wanted` is true.
    pub fn by(&self, driver: &Driver, wanted: impl Fn(&Entry) -> bool) -> Vec<&EpisodeRecord> {
        let own = self.episodes.iter().filter(|e| e.driver == *driver && wanted(e));
        own.map(|e| &e.record).collect()
    }

    /// Groups by agent, condition and task, in that order, with their names.
    fn lines(&self) -> Vec<(Vec<String>, Vec<&EpisodeRecord>)> {
        let (conditions, tasks) = (self.conditions(), self.tasks());
        let mut all = Vec::new();
        for driver in &self.drivers {
            for condition in &conditions {
                for task in &tasks {
                    let group = self.by(driver, |e| e.task == *task && e.condition == *condition);
                    if !group.is_empty() {
                        all.push((vec![driver.to_string(), condition.clone(), task.clone()], group));
                    }
                }
            }
        }
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::eval::{DriverSpec, Selection, Store};
    use wad_camera::Preset;

    fn manifest(suite: &str, selection: Selection) -> Manifest {
        Manifest {
            build: "1".into(),
            sumo: "1.28.0".into(),
            suite: Suite::find(suite).unwrap(),
            selection: Selection {
                agents: vec![DriverSpec::Autopilot],
                conditions: vec!["development".into()],
                ..selection
            },
            options: EnvOptions::evaluation(),
            egos: 1,
            agents: BTreeMap::new(),
            nets: [("town5".to_string(), "abc".to_string())].into(),
            towns: BTreeMap::new(),
            detector: None,
            shard: None,
        }
    }

    /// All episodes of the plan, each changed by `change`.
    fn results(manifest: &Manifest, change: impl Fn(&mut EpisodeRecord)) -> Results {
        let folder = tempfile::tempdir().unwrap();
        let (mut store, _) = Store::open(folder.path(), manifest, false).unwrap();
        for (case, _) in manifest.selection.cases(&manifest.suite).unwrap() {
            let mut episode = EpisodeRecord::of_a_tick(case);
            change(&mut episode);
            store.add(&episode).unwrap();
        }
        Results::open(folder.path()).unwrap()
    }

    fn section(manifest: &Manifest, change: impl Fn(&mut EpisodeRecord)) -> Section {
        Report::gather(vec![results(manifest, change)], &[]).unwrap().sections.remove(0)
    }

    fn table<'a>(all: &'a [Table], title: &str) -> &'a Table {
        all.iter().find(|table| table.title.ends_with(title)).unwrap()
    }

    #[test]
    fn results_of_other_nets_share_no_line() {
        let first = manifest("composite", Selection { episodes: Some(2), ..Selection::default() });
        let run = |manifest: &Manifest| results(manifest, |_| ());
        let mut second = first.clone();
        second.nets = [("town7".to_string(), "xyz".to_string())].into();
        Report::gather(vec![run(&first), run(&second)], &[]).expect("no net is named by both");
        second.nets = [("town5".to_string(), "xyz".to_string())].into();
        let error = Report::gather(vec![run(&first), run(&second)], &[]).unwrap_err().to_string();
        assert!(error.contains("nets.town5: expected abc, found xyz"), "{error}");
    }

    #[test]
    fn towns_and_traffic_of_one_condition_and_task_have_lines_of_their_own() {
        let one = manifest("composite", Selection { episodes: Some(2), ..Selection::default() });
        let one = section(&one, |_| ());
        assert_eq!((one.conditions(), one.tasks()), (vec!["development".into()], vec!["composite".into()]));
        let several = Selection {
            towns: vec!["a.net.xml".into(), "b.net.xml".into()],
            traffic: vec!["20,50".parse().unwrap(), "100,250".parse().unwrap()],
            episodes: Some(2),
            ..Selection::default()
        };
        let section = section(&manifest("composite", several), |_| ());
        let lines: Vec<String> = section.lines().iter().map(|(names, _)| names[1..].join(": ")).collect();
        let expected = [
            "other, a.net.xml: composite, 100,250",
            "other, a.net.xml: composite, 20,50",
            "other, b.net.xml: composite, 100,250",
            "other, b.net.xml: composite, 20,50",
        ];
        assert_eq!(lines, expected);
        let tables = tables(&section);
        let success = table(&tables, ": success");
        assert_eq!((success.rows.len(), success.head.len()), (2, 4));
        assert!(success.rows.iter().flatten().filter(|cell| cell.ends_with("n 2")).count() == 4);
    }

    #[test]
    fn episodes_in_which_sumo_died_count_nowhere() {
        let manifest = manifest("composite", Selection { episodes: Some(4), ..Selection::default() });
        let section = section(&manifest, |e| {
            if e.case.episode == 3 {
                (e.fault, e.ending.success, e.distance_m) = (Some(Fault::Simulator), false, 1e6);
            }
        });
        assert_eq!((section.episodes.len(), section.lost), (3, 1));
        let tables = tables(&section);
        assert_eq!(table(&tables, ": driving").rows[0][3..5], ["3", "0.00 ± 0.00"]);
        let success = table(&tables, ": success");
        assert!(success.rows[0][2].starts_with("100.0 ± 0.0 %"), "{:?}", success.rows);
        assert!(success.notes.iter().any(|note| note.starts_with("1 episodes in which SUMO died")));
    }

    #[test]
    fn blind_agents_are_said_to_repeat_a_drive_only_where_they_do() {
        let weathers = vec![Preset::WetNoon, Preset::WetSunset];
        for (in_turn, repeats) in [(true, false), (false, true)] {
            let selection = Selection {
                weathers: weathers.clone(),
                weathers_in_turn: in_turn,
                episodes: Some(2),
                ..Selection::default()
            };
            let section = section(&manifest("nocrash", selection), |_| ());
            let notes = table(&tables(&section), ": success").notes.join("\n");
            assert_eq!(notes.contains("Blind agents drive the same"), repeats, "{notes}");
        }
    }

    #[test]
    fn one_weather_of_the_autopilot_is_beside_all_of_a_driver() {
        let in_weathers = |agent: DriverSpec, weathers: &[Preset]| {
            let selection =
                Selection { weathers: weathers.to_vec(), episodes: Some(2), ..Selection::default() };
            let mut manifest = manifest("nocrash", selection);
            manifest.selection.agents = vec![agent];
            results(&manifest, |_| ())
        };
        let driver: DriverSpec = "wad-t".parse().unwrap();
        let runs = vec![
            in_weathers(driver, &[Preset::WetNoon, Preset::WetSunset]),
            in_weathers(DriverSpec::Autopilot, &[Preset::ClearNoon]),
        ];
        let report = Report::gather(runs, &[]).unwrap();
        let tables = tables(&report.sections[0]);
        let rows = &table(&tables, "beside the autopilot on the same routes").rows;
        let routes: usize = rows.iter().map(|row| row[3].parse::<usize>().unwrap()).sum();
        assert_eq!(routes, 3 * 2 * 2, "three tasks, two weathers, two episodes");
    }

    #[test]
    fn an_endless_route_is_never_done() {
        let driven = |suite: &str| {
            let manifest = manifest(suite, Selection { episodes: Some(1), ..Selection::default() });
            let section = section(&manifest, |_| ());
            table(&tables(&section), ": driving").rows[0][9].clone()
        };
        assert_eq!((&*driven("infractions"), &*driven("composite")), ("-", "100 %"));
    }
}
