//! The table of an evaluation.

use super::{EpisodeRecord, Row, Score, grouped, rows};
use serde::Serialize;
use wad_sim::traffic::TrafficSpec;

/// `summary.json`: independent of when, where and in which order the episodes were driven.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    /// The suite's name.
    pub suite: String,
    /// Episodes driven.
    pub episodes: u64,
    /// Episodes planned.
    pub planned: u64,
    /// By agent, condition, town, task and traffic.
    pub totals: Vec<Total>,
    /// By weather and seed too.
    pub rows: Vec<Row>,
}

/// A task of one agent in one condition and traffic, over all weathers and seeds.
#[derive(Clone, Debug, Serialize)]
pub struct Total {
    /// The driver's name.
    pub agent: String,
    /// The condition's name.
    pub condition: String,
    /// CONFIG.
    pub town: String,
    /// The suite's name for the task.
    pub task: String,
    /// The background traffic.
    pub traffic: TrafficSpec,
    /// How it was done.
    #[serde(flatten)]
    pub score: Score,
}

impl Summary {
    /// Of the episodes of a plan, in its order.
    pub fn of(suite: &str, planned: usize, episodes: &[EpisodeRecord]) -> Self {
        let key = |e: &EpisodeRecord| {
            let c = &e.case;
            (c.agent.to_string(), c.condition.clone(), c.town.clone(), c.task.clone(), traffic_key(e))
        };
        let totals = grouped(episodes.iter(), key).into_iter().map(|group| {
            let case = &group[0].case;
            Total {
                agent: case.agent.to_string(),
                condition: case.condition.clone(),
                town: case.town.clone(),
                task: case.task.clone(),
                traffic: case.spec.traffic(),
                score: Score::of(&group),
            }
        });
        Self {
            suite: suite.to_string(),
            episodes: episodes.len() as u64,
            planned: planned as u64,
            totals: totals.collect(),
            rows: rows(episodes),
        }
    }
}

fn traffic_key(episode: &EpisodeRecord) -> String {
    episode.case.spec.traffic().to_string()
}
