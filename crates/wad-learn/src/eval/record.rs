//! One line of `episodes.jsonl`.

use super::Case;
use super::tally::{EventCounts, Histogram};
use crate::env::Ending;
use crate::reward::RewardTerms;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use wad_see::perception::sight_score::{LightCounts, LimitCounts};
use wad_sim::tasks::Placement;

/// The fault that stopped an episode before its end.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Fault {
    /// The agent died, hung, or gave an invalid answer: the episode counts as failed.
    Agent,
    /// SUMO died, twice: the episode does not count, and is driven again on `--resume`.
    Simulator,
}

/// The result of an episode, and everything that is needed to drive it again. Nothing in it depends
/// on wall time: equal cases give equal bytes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EpisodeRecord {
    /// The case that was driven.
    #[serde(flatten)]
    pub case: Case,
    /// The episode's own seed.
    pub episode_seed: u64,
    /// Where it took place.
    pub placement: Placement,
    /// How it ended.
    #[serde(flatten)]
    pub ending: Ending,
    /// The fault that ended it, if one did.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fault: Option<Fault>,
    /// Ticks driven.
    pub ticks: u64,
    /// Length of a tick (s).
    pub tick_s: f64,
    /// The route's length (m).
    pub route_length_m: f64,
    /// Way along the route (m).
    pub driven_m: f64,
    /// Way of the ego's centre (m).
    pub distance_m: f64,
    /// Mean speed over all ticks, including standstill (m/s).
    pub mean_speed_mps: f64,
    /// Highest speed (m/s).
    pub top_speed_mps: f64,
    /// Root mean square acceleration over the ticks (m/s2).
    pub rms_acceleration: f64,
    /// Root mean square of the steering's change per tick (share of full lock).
    pub rms_steer_change: f64,
    /// Sum of the rewards.
    pub episodic_return: f64,
    /// Sums of the reward's terms.
    pub terms: RewardTerms,
    /// Mean number of background vehicles.
    pub vehicles_mean: f64,
    /// Mean number of pedestrians.
    pub pedestrians_mean: f64,
    /// All events, also those that did not end the episode.
    pub events: EventCounts,
    /// Ticks by speed.
    pub speeds: Histogram,
    /// Ticks by true gap to the vehicle in front.
    pub gaps: Histogram,
    /// Ticks by what the ego believed of its light; None where the simulator told it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub light: Option<LightCounts>,
    /// Ticks by what it believed of the speed limit, by signs; None where the detector sees none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub limit: Option<LimitCounts>,
    /// Where it ended: x, y (m).
    pub end_at: [f64; 2],
    /// The recording's folder, relative to the evaluation's; None if it was not kept.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub recording: Option<RecordingFolder>,
}

/// A recording's folder, relative to its evaluation's: `episodes/NAME`.
///
/// Results may come from others: a path that leads out of the evaluation's folder is refused.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct RecordingFolder(String);

/// The folder of recordings in an evaluation's folder.
pub(super) const RECORDINGS: &str = "episodes";

impl RecordingFolder {
    /// The folder for the recording of `case`.
    pub fn of(case: &Case) -> Self {
        Self(format!("{RECORDINGS}/{}", case.name()))
    }

    /// Its path in the evaluation's folder `run`.
    pub fn within(&self, run: &Path) -> PathBuf {
        run.join(&self.0)
    }
}

impl TryFrom<String> for RecordingFolder {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        let name = text.strip_prefix(RECORDINGS).and_then(|rest| rest.strip_prefix('/'));
        let plain = |name: &str| !["", ".", ".."].contains(&name) && !name.contains(['/', '\\', '\0']);
        match name {
            Some(name) if plain(name) => Ok(Self(text)),
            _ => Err(format!("expected a recording's folder as `{RECORDINGS}/NAME`, found `{text}`")),
        }
    }
}

impl From<RecordingFolder> for String {
    fn from(folder: RecordingFolder) -> Self {
        folder.0
    }
}

#[cfg(test)]
impl EpisodeRecord {
    /// One that went well for a tick.
    pub(super) fn of_a_tick(case: Case) -> Self {
        let spot = || wad_sim::tasks::Spot { lane: "a_0".into(), s: 1.0 };
        Self {
            episode_seed: case.episode_seed(),
            case,
            placement: Placement { from: spot(), to: spot(), obstacle: None, via: Vec::new() },
            ending: Ending { end: crate::env::End::Survived, cause: "alive".into(), success: true },
            fault: None,
            ticks: 1,
            tick_s: 0.167,
            route_length_m: 1.0,
            driven_m: 1.0,
            distance_m: 1.0,
            mean_speed_mps: 1.0,
            top_speed_mps: 1.0,
            rms_acceleration: 0.0,
            rms_steer_change: 0.0,
            episodic_return: 0.0,
            terms: RewardTerms::default(),
            vehicles_mean: 0.0,
            pedestrians_mean: 0.0,
            events: EventCounts::default(),
            speeds: Histogram::default(),
            gaps: Histogram::default(),
            light: None,
            limit: None,
            end_at: [0.0; 2],
            recording: None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_recording_lies_in_its_evaluations_folder() {
        let folder = RecordingFolder::try_from("episodes/wad-t_s0_000".to_string()).unwrap();
        assert_eq!(folder.within("runs/a".as_ref()), Path::new("runs/a/episodes/wad-t_s0_000"));
        for out in [
            "/etc",
            "../../b",
            "episodes",
            "episodes/",
            "episodes/..",
            "episodes/.",
            "episodes/a/../../..",
            "other/a",
            "episodes//etc",
            "episodes/a/b",
            "episodes/..\\a",
            "",
        ] {
            let error = RecordingFolder::try_from(out.to_string()).unwrap_err();
            assert!(error.contains("episodes/NAME") && error.contains(&format!("`{out}`")), "{error}");
        }
    }
}
