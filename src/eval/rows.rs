//! From episodes to table rows.

use super::{EpisodeRecord, Suite};
use crate::camera::Preset;
use crate::env::End;
use crate::tasks::TaskKind;
use crate::traffic::TrafficSpec;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The episodes of one agent under one condition. Rates are fractions 0..1.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Row {
    pub suite: Suite,
    pub agent: String,
    pub town: String,
    pub task: TaskKind,
    pub weather: Preset,
    pub traffic: TrafficSpec,
    pub seed: u64,
    pub episodes: u64,
    pub successes: u64,
    pub success_rate: f64,
    /// Wilson's 95 % interval of the success rate.
    pub interval: (f64, f64),
    /// How many ended how; those that nobody did are left out.
    pub ends: BTreeMap<End, u64>,
    pub mean_speed_mps: f64,
    pub mean_ticks: f64,
    pub mean_route_completion: f64,
    pub mean_return: f64,
    pub rms_acceleration: f64,
    pub rms_steer_change: f64,
}

/// The rows of episodes, in the order in which their conditions first appear.
pub fn rows(episodes: &[EpisodeRecord]) -> Vec<Row> {
    let mut groups: Vec<Vec<&EpisodeRecord>> = Vec::new();
    let same = |a: &EpisodeRecord, b: &EpisodeRecord| {
        let (a, b) = (&a.case, &b.case);
        (a.suite, &a.agent, &a.town, a.seed) == (b.suite, &b.agent, &b.town, b.seed)
            && (a.task.kind, a.task.weather, a.task.traffic) == (b.task.kind, b.task.weather, b.task.traffic)
    };
    for episode in episodes {
        match groups.iter_mut().find(|group| same(group[0], episode)) {
            Some(group) => group.push(episode),
            None => groups.push(vec![episode]),
        }
    }
    groups.iter().map(|group| row(group)).collect()
}

fn row(group: &[&EpisodeRecord]) -> Row {
    let n = group.len() as u64;
    let case = &group[0].case;
    let mean = |value: &dyn Fn(&EpisodeRecord) -> f64| {
        group.iter().map(|episode| value(episode)).sum::<f64>() / n as f64
    };
    let successes = group.iter().filter(|episode| episode.ending.success).count() as u64;
    let mut ends = BTreeMap::new();
    for episode in group {
        *ends.entry(episode.ending.end).or_insert(0) += 1;
    }
    Row {
        suite: case.suite,
        agent: case.agent.to_string(),
        town: case.town.clone(),
        task: case.task.kind,
        weather: case.task.weather,
        traffic: case.task.traffic(),
        seed: case.seed,
        episodes: n,
        successes,
        success_rate: successes as f64 / n as f64,
        interval: wilson(successes, n),
        ends,
        mean_speed_mps: mean(&|e| e.mean_speed_mps),
        mean_ticks: mean(&|e| e.ticks as f64),
        mean_route_completion: mean(&|e| (e.driven_m / e.route_length_m.max(1.0)).clamp(0.0, 1.0)),
        mean_return: mean(&|e| e.episodic_return),
        rms_acceleration: mean(&|e| e.rms_acceleration.powi(2)).sqrt(),
        rms_steer_change: mean(&|e| e.rms_steer_change.powi(2)).sqrt(),
    }
}

/// Wilson's 95 % interval of `successes` out of `n`; 0 to 1 where n is 0.
pub fn wilson(successes: u64, n: u64) -> (f64, f64) {
    if n == 0 {
        return (0.0, 1.0);
    }
    let z = 1.959_963_984_540_054_f64;
    let (n, p) = (n as f64, successes as f64 / n as f64);
    let middle = p + z * z / (2.0 * n);
    let half = z * (p * (1.0 - p) / n + z * z / (4.0 * n * n)).sqrt();
    let scale = 1.0 / (1.0 + z * z / n);
    (((middle - half) * scale).max(0.0), ((middle + half) * scale).min(1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wilson_as_in_its_tables() {
        let close = |(low, high): (f64, f64), expected: (f64, f64)| {
            assert!((low - expected.0).abs() < 1e-3 && (high - expected.1).abs() < 1e-3, "{low} {high}");
        };
        close(wilson(25, 25), (0.8668, 1.0));
        close(wilson(0, 25), (0.0, 0.1332));
        close(wilson(92, 100), (0.8500, 0.9589));
        assert_eq!(wilson(0, 0), (0.0, 1.0));
    }
}
