//! One line of `episodes.jsonl`.

use super::Case;
use crate::env::Ending;
use crate::reward::RewardTerms;
use crate::tasks::Placement;
use serde::{Deserialize, Serialize};

/// What came of an episode, and everything that is needed to drive it again. It holds nothing that
/// depends on wall time: equal cases give equal bytes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EpisodeRecord {
    #[serde(flatten)]
    pub case: Case,
    pub episode_seed: u64,
    pub placement: Placement,
    #[serde(flatten)]
    pub ending: Ending,
    pub ticks: u64,
    pub route_length_m: f64,
    /// Way along the route.
    pub driven_m: f64,
    /// Over all ticks, standing ones too.
    pub mean_speed_mps: f64,
    /// Root mean square over the ticks (m/s2, and steering per tick).
    pub rms_acceleration: f64,
    pub rms_steer_change: f64,
    /// Sum of the rewards, and by term.
    pub episodic_return: f64,
    pub terms: RewardTerms,
    pub vehicles_mean: f64,
    pub pedestrians_mean: f64,
}
