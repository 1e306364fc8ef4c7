//! The plan of a dataset: drives with weathers and traffic in turn, and a seed for each.

use serde::{Deserialize, Serialize};
use sumo_network::seeds;
use wad_camera::variety::{self, Varied};
use wad_camera::{Preset, Town, Weather};
use wad_sim::assets::{Assets, LOOK};
use wad_sim::traffic::Counts;

/// One SUMO run and one shard.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Segment {
    /// Number in the dataset.
    pub index: usize,
    /// The segment's own seed.
    pub seed: u64,
    /// The weather of its frames.
    pub weather: Preset,
    /// Background traffic.
    pub traffic: Counts,
    /// Frames to collect.
    pub frames: usize,
}

impl Segment {
    /// The town in which it is driven, with what varies drawn for this segment.
    pub(super) fn varied_town(&self, vary: &[Varied], assets: &Assets) -> Town {
        assets.town_with(variety::look(vary, LOOK, self.seed))
    }

    /// Its weather, with what varies drawn for this segment.
    pub(super) fn varied_weather(&self, vary: &[Varied]) -> Weather {
        variety::weather(vary, self.weather, self.seed)
    }
}

/// Shares of the dense population, in percent, in turn.
const DENSITY: [usize; 5] = [100, 60, 25, 100, 130];

/// The segments of a dataset of `frames` frames, `per_segment` each. `dense` is the town's dense
/// population. Five densities and the weathers (their number must not be a multiple of five) meet in every
/// pair.
pub fn plan(
    frames: usize,
    per_segment: usize,
    weathers: &[Preset],
    dense: Counts,
    seed: u64,
) -> Vec<Segment> {
    let per_segment = per_segment.max(1);
    (0..frames.div_ceil(per_segment))
        .map(|index| {
            let share = |count: usize| count * DENSITY[index % DENSITY.len()] / 100;
            Segment {
                index,
                seed: seed_of(seed, index),
                weather: weathers.get(index % weathers.len().max(1)).copied().unwrap_or_default(),
                traffic: Counts::new(share(dense.vehicles), share(dense.pedestrians)),
                frames: per_segment.min(frames - index * per_segment),
            }
        })
        .collect()
}

/// The own seed of the segment `index` of a dataset with this `seed`.
pub(super) fn seed_of(seed: u64, index: usize) -> u64 {
    seeds::derive(seed, &format!("segment {index}"))
}

/// Time between frames at standstill (s), at the least.
const STANDING_EVERY: f64 = 2.5;

/// Time from a frame to the next one, if the ego has stood for `standing` (all s).
pub(super) fn due(standing: f64, every: f64) -> f64 {
    if standing > 1.0 { every.max(STANDING_EVERY) } else { every }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    #[test]
    fn every_weather_meets_every_density_and_the_frames_add_up() {
        let weathers = [Preset::ClearNoon, Preset::CloudyNoon, Preset::SoftRainNoon];
        let segments = plan(7_490, 500, &weathers, Counts::new(100, 250), 7);
        assert_eq!(segments.iter().map(|s| s.frames).sum::<usize>(), 7_490);
        let pairs: HashSet<_> = segments.iter().map(|s| (s.weather, s.traffic.vehicles)).collect();
        // 100 % comes twice among the five.
        assert_eq!(pairs.len(), 3 * 4);
        let seeds: HashSet<_> = segments.iter().map(|s| s.seed).collect();
        assert_eq!(seeds.len(), segments.len());
    }

    #[test]
    fn who_stands_is_never_recorded_more_often() {
        assert_eq!([0.5, 4.0].map(|every| due(0.0, every)), [0.5, 4.0]);
        assert_eq!([0.5, 4.0].map(|every| due(3.0, every)), [2.5, 4.0]);
    }

    #[test]
    fn a_longer_dataset_begins_with_the_shorter_one() {
        let weathers = [Preset::ClearNoon];
        let long = plan(5_000, 500, &weathers, Counts::new(10, 10), 1);
        let short = plan(2_000, 500, &weathers, Counts::new(10, 10), 1);
        assert_eq!(long[..4], short[..]);
    }
}
