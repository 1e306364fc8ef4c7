//! One line of `episodes.jsonl`.

use super::Case;
use super::tally::{EventCounts, Histogram};
use crate::env::Ending;
use crate::reward::RewardTerms;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use wad_sim::tasks::Placement;

/// What stopped an episode before its end.
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
    #[serde(flatten)]
    pub case: Case,
    pub episode_seed: u64,
    pub placement: Placement,
    #[serde(flatten)]
    pub ending: Ending,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fault: Option<Fault>,
    pub ticks: u64,
    /// Length of a tick (s).
    pub tick_s: f64,
    pub route_length_m: f64,
    /// Way along the route.
    pub driven_m: f64,
    /// Way of the ego's centre.
    pub distance_m: f64,
    /// Over all ticks, standing ones too.
    pub mean_speed_mps: f64,
    pub top_speed_mps: f64,
    /// Root mean square over the ticks (m/s2, and steering per tick).
    pub rms_acceleration: f64,
    pub rms_steer_change: f64,
    /// Sum of the rewards, and by term.
    pub episodic_return: f64,
    pub terms: RewardTerms,
    pub vehicles_mean: f64,
    pub pedestrians_mean: f64,
    /// What happened on the way, whether it ended the episode or not.
    pub events: EventCounts,
    /// Ticks by speed, and by gap to the vehicle in front.
    pub speeds: Histogram,
    pub gaps: Histogram,
    /// Where it ended: x, y (m).
    pub end_at: [f64; 2],
    /// The recording's folder, relative to the evaluation's, where one was kept.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub recording: Option<RecordingFolder>,
}

/// A recording's folder, relative to its evaluation's: `episodes/NAME`.
///
/// Results may come from others. A path that leads out of the evaluation's folder cannot become one of these.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct RecordingFolder(String);

/// The folder in an evaluation's that recordings lie in.
pub(super) const RECORDINGS: &str = "episodes";

impl RecordingFolder {
    /// Where the recording of `case` goes.
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
