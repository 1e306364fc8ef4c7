//! The tables of a report.

use super::paired::{beside_autopilot, route};
use super::published::published;
use super::table::columns;
use super::{Driver, Entry, Report, Section, Table};
use crate::env::End;
use crate::eval::{EpisodeRecord, EventCounts, Score, grouped};
use wad_camera::Preset;

/// The weathers that encoder, detector and agents were trained in.
const TRAINED_IN: [Preset; 3] = [Preset::ClearNoon, Preset::CloudyNoon, Preset::SoftRainNoon];

/// All tables of a section, the published ones last.
pub fn tables(section: &Section) -> Vec<Table> {
    let mut all = vec![success(section), driving(section), infractions(section)];
    all.extend(lights(section).into_iter().chain(beside_autopilot(section)));
    all.extend([ends(section), weathers(section)]);
    if let Some(published) = published() {
        let own = published.tables.iter().filter(|t| t.suite == section.suite.name);
        all.extend(own.map(|table| table.table(&published.note)));
    }
    all
}

/// Successes and episodes of every task of every suite; None of a single suite, whose own table says as much.
pub fn overview(report: &Report) -> Option<Table> {
    let sections: Vec<&Section> = report.sections.iter().collect();
    let count = |group: &[&EpisodeRecord]| {
        let score = Score::of(group);
        format!("{} of {}", score.successes, score.episodes)
    };
    let own = [(String::new(), 1), (String::new(), 1)];
    let suites = sections.iter().map(|section| (section.suite.name.clone(), section.tasks().len()));
    (sections.len() > 1).then(|| Table {
        title: "All suites: episodes that succeeded".to_string(),
        groups: own.into_iter().chain(suites).collect(),
        ..by_task(&sections, count)
    })
}

/// A column for each task, and a line for each agent in each condition, so that the table grows downwards with them.
fn by_task(sections: &[&Section], cell: impl Fn(&[&EpisodeRecord]) -> String) -> Table {
    let (mut drivers, mut conditions): (Vec<&Driver>, Vec<String>) = Default::default();
    for section in sections {
        drivers.extend(&section.drivers);
        conditions.extend(section.conditions());
    }
    let (drivers, conditions) = (first_of_each(drivers), first_of_each(conditions));
    let columns =
        sections.iter().flat_map(|section| section.tasks().into_iter().map(move |task| (section, task)));
    let columns: Vec<(&&Section, String)> = columns.collect();
    let lines =
        drivers.iter().flat_map(|driver| conditions.iter().map(move |condition| (*driver, condition)));
    let row = |(driver, condition): (&Driver, &String)| {
        let shown = |(section, task): &(&&Section, String)| {
            let group = section.by(driver, |e| e.task == *task && e.condition == *condition);
            if group.is_empty() { NOT_DRIVEN.to_string() } else { cell(&group) }
        };
        let cells: Vec<String> = columns.iter().map(shown).collect();
        let drove = cells.iter().any(|cell| cell != NOT_DRIVEN);
        drove.then(|| [driver.to_string(), condition.clone()].into_iter().chain(cells).collect())
    };
    let rows = lines.filter_map(row).collect();
    let tasks = columns.iter().map(|(_, task)| task.clone());
    Table {
        head: ["agent", "condition"].map(String::from).into_iter().chain(tasks).collect(),
        rows,
        ..Table::default()
    }
}

/// The same without repetitions.
fn first_of_each<T: PartialEq>(all: Vec<T>) -> Vec<T> {
    let mut found = Vec::new();
    for one in all {
        if !found.contains(&one) {
            found.push(one);
        }
    }
    found
}

/// A cell without episodes.
const NOT_DRIVEN: &str = "-";

/// `96.0 ± 1.9 %  [91.2–98.3], n 150`; the deviation is that of trainings where there are several.
fn rate(group: &[&EpisodeRecord]) -> String {
    if group.is_empty() {
        return NOT_DRIVEN.to_string();
    }
    let score = Score::of(group);
    let pooled = group.iter().any(|e| e.case.agent != group[0].case.agent);
    let training = |e: &EpisodeRecord| e.case.agent.to_string();
    let cells = grouped(group.iter().copied(), |e| {
        if pooled { (training(e), "", 0) } else { (String::new(), e.case.spec.weather.name(), e.case.seed) }
    });
    let rates: Vec<f64> = cells.iter().map(|cell| Score::of(cell).success_rate).collect();
    let spread = deviation(&rates).map_or(String::new(), |sd| format!(" ± {:.1}", 100.0 * sd));
    format!(
        "{:.1}{spread} % [{:.1}–{:.1}], n {}",
        100.0 * score.success_rate,
        100.0 * score.interval.0,
        100.0 * score.interval.1,
        score.episodes
    )
}

/// Of a sample; None of fewer than two.
fn deviation(values: &[f64]) -> Option<f64> {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    (values.len() > 1).then(|| (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt())
}

fn percent_of(part: u64, all: u64) -> String {
    if part == 0 {
        "-".to_string()
    } else {
        format!("{part} ({:.0} %)", 100.0 * part as f64 / all.max(1) as f64)
    }
}

fn success(section: &Section) -> Table {
    let drivers = &section.drivers;
    let mut notes = vec![
        "Success rate, its standard deviation over weathers and seeds, Wilson's 95 % interval, number of episodes."
            .to_string(),
    ];
    let pools = drivers.iter().filter_map(|driver| {
        let trainings = grouped(section.by(driver, |_| true).into_iter(), |e| e.case.agent.to_string()).len();
        (trainings > 1).then(|| format!("{driver} of {trainings}"))
    });
    let pools: Vec<String> = pools.collect();
    if !pools.is_empty() {
        notes.push(format!("Over several trainings, whose deviation is given: {}.", pools.join("; ")));
    }
    let repeats = |driver: &&Driver| {
        let own = section.by(driver, |_| true).into_iter();
        let drives = grouped(own, |e| (e.case.agent.to_string(), route(&e.case)));
        !driver.looks && drives.iter().any(|weathers| weathers.len() > 1)
    };
    let blind: Vec<String> = drivers.iter().filter(repeats).map(Driver::to_string).collect();
    if !blind.is_empty() {
        notes.push(format!(
            "Blind agents drive the same in every weather: the intervals of {} count each episode once per weather, \
             and are narrower than they should be.",
            blind.join(", ")
        ));
    }
    if section.lost > 0 {
        notes.push(format!("{} episodes in which SUMO died do not count.", section.lost));
    }
    let untrained = odd_weathers(section, "training", false);
    if !untrained.is_empty() {
        notes.push(format!(
            "“training” is the benchmark's name: agents, encoder and detector were not trained in {} (only in town3 in {}).",
            untrained.join(", "),
            TRAINED_IN.map(Preset::name).join(", ")
        ));
    }
    let trained = odd_weathers(section, "development", true);
    if !trained.is_empty() {
        notes.push(format!(
            "“development” has the weathers that the benchmark calls new: agents, encoder and detector were trained in {}, though in another town.",
            trained.join(", ")
        ));
    }
    Table { title: format!("{}: success", section.suite.title), notes, ..by_task(&[section], rate) }
}

/// The driven weathers of a condition that were (`trained`) or were not trained in.
fn odd_weathers(section: &Section, condition: &str, trained: bool) -> Vec<&'static str> {
    let driven = section.conditions();
    let own = section.suite.conditions.iter().filter(|c| c.name == condition && driven.contains(&c.name));
    own.flat_map(|c| &c.weathers)
        .filter(|weather| TRAINED_IN.contains(weather) == trained)
        .map(|weather| weather.name())
        .collect()
}

fn driving(section: &Section) -> Table {
    let row = |(mut cells, group): (Vec<String>, Vec<&EpisodeRecord>)| {
        let s = Score::of(&group);
        let spread = |value: &dyn Fn(&EpisodeRecord) -> f64, digits: usize| {
            let values: Vec<f64> = group.iter().map(|e| value(e)).collect();
            let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
            match deviation(&values) {
                Some(sd) => format!("{mean:.digits$} ± {sd:.digits$}"),
                None => format!("{mean:.digits$}"),
            }
        };
        cells.push(s.episodes.to_string());
        cells.push(spread(&|e| e.distance_m / 1000.0, 2));
        cells.push(spread(&|e| e.ticks as f64 * e.tick_s / 60.0, 2));
        cells.push(format!("{:.1}", 3.6 * s.mean_speed_mps));
        cells.push(spread(&|e| 3.6 * e.top_speed_mps, 1));
        cells.push(match s.mean_return {
            Some(_) => spread(&|e| e.episodic_return, 0),
            None => "-".to_string(),
        });
        let done = s.mean_route_completion.map(|done| format!("{:.0} %", 100.0 * done));
        cells.push(done.unwrap_or_else(|| "-".to_string()));
        cells.push(format!("{:.2}", s.rms_acceleration));
        cells
    };
    Table {
        title: format!("{}: driving", section.suite.title),
        head: columns(&[
            "n",
            "distance (km)",
            "time alive (min)",
            "mean speed (km/h)",
            "top speed (km/h)",
            "return",
            "route done",
            "rms acceleration (m/s2)",
        ]),
        rows: section.lines().into_iter().map(row).collect(),
        notes: vec![
            "Mean ± standard deviation over episodes; mean speed and rms acceleration over all ticks. Drivers that do \
             not look have no return: their reward knows no vehicle in front. An endless route is never done."
                .to_string(),
        ],
        ..Table::default()
    }
}

fn infractions(section: &Section) -> Table {
    let among = section.episodes.iter().any(|e| e.record.events.collisions_ego > 0);
    let shown = |name: &str| among || name != EventCounts::WITH_EGOS;
    let kinds = EventCounts::default().named().into_iter().map(|(name, _)| name).filter(|name| shown(name));
    let row = |(mut cells, group): (Vec<String>, Vec<&EpisodeRecord>)| {
        let s = Score::of(&group);
        cells.push(format!("{:.2}", s.distance_km));
        cells.extend(s.events.named().into_iter().filter(|(name, _)| shown(name)).map(|(_, n)| {
            match s.distance_km {
                _ if n == 0 => "0".to_string(),
                // An agent that does not move has no rate per km.
                km if km < 0.1 => format!("({n})"),
                km => format!("{:.2} ({n})", n as f64 / km),
            }
        }));
        cells.push(s.events.collisions_caused.to_string());
        cells
    };
    let mut head = columns(&["km"]);
    head.extend(kinds.map(String::from));
    head.push("collisions caused by the ego".to_string());
    Table {
        title: format!("{}: infractions per km (and how many)", section.suite.title),
        head,
        rows: section.lines().into_iter().map(row).collect(),
        ..Table::default()
    }
}

/// What egos believed of their lights and limits, where the detector sees them; None where the simulator told it.
fn lights(section: &Section) -> Option<Table> {
    let row = |(mut cells, group): (Vec<String>, Vec<&EpisodeRecord>)| {
        let Score { light, limit, .. } = Score::of(&group);
        let (light, limit) = (light?, limit.unwrap_or_default());
        let share = |part: usize, whole: usize| match whole {
            0 => "-".to_string(),
            _ => format!("{:.3} of {whole}", part as f64 / whole as f64),
        };
        cells.push(share(light.right, light.ahead));
        cells.push(share(light.missed, light.ahead));
        cells.push(format!("{} of {}", light.red_as_green, light.reds));
        cells.push(share(light.phantom, light.without));
        cells.push(share(limit.right, limit.ticks));
        Some(cells)
    };
    let rows: Vec<Vec<String>> = section.lines().into_iter().filter_map(row).collect();
    (!rows.is_empty()).then(|| Table {
        title: format!("{}: light and speed limit as they were believed, by ticks", section.suite.title),
        head: columns(&[
            "right within 40 m",
            "none believed",
            "red believed green",
            "stopping where none is",
            "speed limit right",
        ]),
        rows,
        notes: vec![
            "“right within 40 m” and “none believed” are of ticks with a light within 40 m, hidden ones too; “red believed \
             green” is of those where it is red; “stopping where none is” is of ticks with none within 60 m; “speed limit \
             right” is of ticks on roads, from 18 m behind their begin on, where signs stand."
                .to_string(),
        ],
        ..Table::default()
    })
}

fn ends(section: &Section) -> Table {
    let row = |(mut cells, group): (Vec<String>, Vec<&EpisodeRecord>)| {
        let s = Score::of(&group);
        cells.push(s.episodes.to_string());
        cells.extend(End::ALL.map(|end| percent_of(s.ends.get(&end).copied().unwrap_or(0), s.episodes)));
        cells
    };
    let mut head = columns(&["n"]);
    head.extend(End::ALL.map(|end| end.name().replace('_', " ")));
    Table {
        title: format!("{}: how episodes ended", section.suite.title),
        head,
        rows: section.lines().into_iter().map(row).collect(),
        notes: vec!["“error” is an external agent that died, hung or gave an invalid answer.".to_string()],
        ..Table::default()
    }
}

fn weathers(section: &Section) -> Table {
    let (drivers, conditions) = (&section.drivers, section.conditions());
    let mut rows = Vec::new();
    for condition in &conditions {
        let mut weathers: Vec<Preset> = Vec::new();
        for e in section.episodes.iter().filter(|e| e.condition == *condition) {
            let weather = e.record.case.spec.weather;
            if !weathers.contains(&weather) {
                weathers.push(weather);
            }
        }
        for weather in weathers {
            let mark = if TRAINED_IN.contains(&weather) { "" } else { " †" };
            let cells = drivers.iter().map(|driver| {
                let here = |e: &Entry| e.condition == *condition && e.record.case.spec.weather == weather;
                rate(&section.by(driver, here))
            });
            rows.push(
                [condition.clone(), format!("{}{mark}", weather.name())].into_iter().chain(cells).collect(),
            );
        }
    }
    let head =
        ["condition", "weather"].map(String::from).into_iter().chain(drivers.iter().map(Driver::to_string));
    Table {
        title: format!("{}: success by weather", section.suite.title),
        head: head.collect(),
        rows,
        notes: vec!["† agents, encoder and detector were not trained in this weather.".to_string()],
        ..Table::default()
    }
}
