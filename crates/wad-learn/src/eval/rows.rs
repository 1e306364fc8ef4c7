//! From episodes to table rows.

use super::record::Fault;
use super::tally::{EventCounts, Histogram};
use super::{Case, EpisodeRecord};
use crate::env::End;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use wad_camera::Preset;
use wad_see::perception::sight_score::{LightCounts, LimitCounts};
use wad_sim::traffic::TrafficSpec;

/// The episodes of one agent under one condition. Rates are fractions 0..1.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// The suite's name.
    pub suite: String,
    /// The agent.
    pub agent: String,
    /// The condition.
    pub condition: String,
    /// The town.
    pub town: String,
    /// The task.
    pub task: String,
    /// The weather.
    pub weather: Preset,
    /// The background traffic.
    pub traffic: TrafficSpec,
    /// The evaluation's seed.
    pub seed: u64,
    /// Their totals.
    #[serde(flatten)]
    pub score: Score,
}

/// The totals of a set of episodes. Rates are fractions 0..1.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Score {
    /// Episodes that count: all except those in which SUMO died.
    pub episodes: u64,
    /// Episodes in which SUMO died.
    pub lost: u64,
    /// Successful episodes.
    pub successes: u64,
    /// Share of successful episodes.
    pub success_rate: f64,
    /// Wilson's 95 % interval of the success rate.
    pub interval: (f64, f64),
    /// Number of episodes by end; ends that did not occur are left out.
    pub ends: BTreeMap<End, u64>,
    /// Episodes in which the agent failed.
    pub agent_failures: u64,
    /// Total way (km).
    pub distance_km: f64,
    /// Mean way per episode (m).
    pub mean_distance_m: f64,
    /// Mean speed over all ticks (m/s).
    pub mean_speed_mps: f64,
    /// Mean over the episodes of their highest speed (m/s).
    pub mean_top_speed_mps: f64,
    /// Highest speed (m/s).
    pub top_speed_mps: f64,
    /// Mean number of ticks per episode.
    pub mean_ticks: f64,
    /// Mean simulated time per episode (s).
    pub mean_seconds: f64,
    /// Mean share of the route that was driven; None for endless routes.
    pub mean_route_completion: Option<f64>,
    /// Mean sum of rewards per episode; None for drivers that do not look: their reward has no vehicle in
    /// front, so it cannot be compared.
    pub mean_return: Option<f64>,
    /// Root mean square acceleration over all ticks (m/s2).
    pub rms_acceleration: f64,
    /// Root mean square of the steering's change per tick, over all ticks (share of full lock).
    pub rms_steer_change: f64,
    /// Events by kind.
    pub events: EventCounts,
    /// Ticks by speed.
    pub speeds: Histogram,
    /// Ticks by true gap to the vehicle in front.
    pub gaps: Histogram,
    /// Ticks by what egos believed of their light; None where the simulator told it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub light: Option<LightCounts>,
    /// Ticks by what they believed of the speed limit; None where the detector sees no signs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub limit: Option<LimitCounts>,
}

/// The rows of episodes, in the order in which their conditions first appear.
pub fn rows(episodes: &[EpisodeRecord]) -> Vec<Row> {
    let key = |case: &Case| {
        let (weather, traffic) = (case.spec.weather, case.spec.traffic().to_string());
        let names = [&case.suite, &case.condition, &case.town, &case.task].map(Clone::clone);
        (case.agent.to_string(), names, weather.name(), traffic, case.seed)
    };
    grouped(episodes.iter(), |episode| key(&episode.case))
        .into_iter()
        .map(|group| {
            let case = &group[0].case;
            Row {
                suite: case.suite.clone(),
                agent: case.agent.to_string(),
                condition: case.condition.clone(),
                town: case.town.clone(),
                task: case.task.clone(),
                weather: case.spec.weather,
                traffic: case.spec.traffic(),
                seed: case.seed,
                score: Score::of(&group),
            }
        })
        .collect()
}

/// Episodes with equal keys, in the order in which those first appear.
pub fn grouped<'a, K: Ord>(
    episodes: impl Iterator<Item = &'a EpisodeRecord>,
    key: impl Fn(&EpisodeRecord) -> K,
) -> Vec<Vec<&'a EpisodeRecord>> {
    let mut index: BTreeMap<K, usize> = BTreeMap::new();
    let mut groups: Vec<Vec<&EpisodeRecord>> = Vec::new();
    for episode in episodes {
        let at = *index.entry(key(episode)).or_insert(groups.len());
        if at == groups.len() {
            groups.push(Vec::new());
        }
        groups[at].push(episode);
    }
    groups
}

impl Score {
    /// The totals of a set of episodes.
    pub fn of(group: &[&EpisodeRecord]) -> Self {
        let counting: Vec<&EpisodeRecord> =
            group.iter().copied().filter(|e| e.fault != Some(Fault::Simulator)).collect();
        let n = counting.len() as u64;
        let sum = |value: &dyn Fn(&EpisodeRecord) -> f64| counting.iter().map(|e| value(e)).sum::<f64>();
        let mean = |value: &dyn Fn(&EpisodeRecord) -> f64| if n == 0 { 0.0 } else { sum(value) / n as f64 };
        let successes = counting.iter().filter(|episode| episode.ending.success).count() as u64;
        let (mut events, mut speeds, mut gaps) = Default::default();
        let mut light: Option<LightCounts> = None;
        let mut limit: Option<LimitCounts> = None;
        let mut ends = BTreeMap::new();
        for episode in &counting {
            *ends.entry(episode.ending.end).or_insert(0) += 1;
            EventCounts::add(&mut events, &episode.events);
            Histogram::add(&mut speeds, &episode.speeds);
            Histogram::add(&mut gaps, &episode.gaps);
            if let Some(ticks) = &episode.light {
                light.get_or_insert_default().add(ticks);
            }
            if let Some(ticks) = &episode.limit {
                limit.get_or_insert_default().add(ticks);
            }
        }
        let ticks = sum(&|e| e.ticks as f64).max(1.0);
        let over_ticks = |value: &dyn Fn(&EpisodeRecord) -> f64| sum(&|e| value(e) * e.ticks as f64) / ticks;
        let routed: Vec<&&EpisodeRecord> = counting.iter().filter(|e| !e.case.spec.endless).collect();
        let share = |e: &EpisodeRecord| (e.driven_m / e.route_length_m.max(1.0)).clamp(0.0, 1.0);
        let done: f64 = routed.iter().map(|e| share(e)).sum();
        Self {
            episodes: n,
            lost: group.len() as u64 - n,
            successes,
            success_rate: if n == 0 { 0.0 } else { successes as f64 / n as f64 },
            interval: wilson(successes, n),
            ends,
            agent_failures: counting.iter().filter(|e| e.fault == Some(Fault::Agent)).count() as u64,
            distance_km: sum(&|e| e.distance_m) / 1000.0,
            mean_distance_m: mean(&|e| e.distance_m),
            mean_speed_mps: over_ticks(&|e| e.mean_speed_mps),
            mean_top_speed_mps: mean(&|e| e.top_speed_mps),
            top_speed_mps: counting.iter().map(|e| e.top_speed_mps).fold(0.0, f64::max),
            mean_ticks: mean(&|e| e.ticks as f64),
            mean_seconds: mean(&|e| e.ticks as f64 * e.tick_s),
            mean_route_completion: (!routed.is_empty()).then(|| done / routed.len() as f64),
            mean_return: group.iter().all(|e| e.case.agent.looks()).then(|| mean(&|e| e.episodic_return)),
            rms_acceleration: over_ticks(&|e| e.rms_acceleration.powi(2)).sqrt(),
            rms_steer_change: over_ticks(&|e| e.rms_steer_change.powi(2)).sqrt(),
            events,
            speeds,
            gaps,
            light,
            limit,
        }
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
    use crate::eval::{Selection, Suite};

    #[test]
    fn accelerations_count_by_ticks_as_speeds_do() {
        let selection = Selection { episodes: Some(1), ..Selection::default() };
        let case = selection.cases(&Suite::find("composite").unwrap()).unwrap().remove(0).0;
        let episode = |ticks: u64, rms: f64| EpisodeRecord {
            ticks,
            mean_speed_mps: rms,
            rms_acceleration: rms,
            rms_steer_change: rms,
            ..EpisodeRecord::of_a_tick(case.clone())
        };
        let score = Score::of(&[&episode(1, 2.0), &episode(3, 0.0)]);
        assert_eq!((score.mean_speed_mps, score.rms_acceleration, score.rms_steer_change), (0.5, 1.0, 1.0));
    }

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
