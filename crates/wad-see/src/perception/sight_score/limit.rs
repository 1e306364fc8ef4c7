//! The speed limit that signs have set against the map's, by ticks.

use crate::perception::EgoFacts;
use crate::perception::road_truth::ego_lane;
use serde::{Deserialize, Serialize};
use wad_camera::model::LIMITS;

/// Signs stand this far behind a road's begin (m): from here on its limit is in force.
const FROM: f64 = 18.0;

/// Ticks on roads, from 18 m behind their begin on, by what was believed of the speed limit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct LimitCounts {
    /// All of them, as far as the map's limit is one that signs show.
    pub ticks: usize,
    /// Those in which a sign had set a limit.
    pub known: usize,
    /// Those in which what was believed was the map's.
    pub right: usize,
    /// Of `right`, those in which a sign had set it.
    #[serde(default)]
    pub known_right: usize,
}

impl LimitCounts {
    /// Counts a tick: `believed` in km/h, and whether a sign said so.
    pub(in crate::perception) fn note(&mut self, facts: &EgoFacts<'_>, believed: u32, is_signed: bool) {
        let Some(lane) = ego_lane(facts).map(|id| facts.network.lane(id)) else { return };
        let kmh = (lane.speed_limit * 3.6).round() as u32;
        if lane.shape.project(facts.on_route.state.pose.xy()).s >= FROM && LIMITS.contains(&kmh) {
            tracing::debug!(
                "limit: {believed} believed{}, {kmh} there",
                if is_signed { "" } else { " without a sign" }
            );
            self.ticks += 1;
            self.known += usize::from(is_signed);
            self.right += usize::from(believed == kmh);
            self.known_right += usize::from(is_signed && believed == kmh);
        }
    }

    /// Adds another episode's.
    pub fn add(&mut self, other: &Self) {
        self.ticks += other.ticks;
        self.known += other.known;
        self.right += other.right;
        self.known_right += other.known_right;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perception::signs::IN_TOWNS;
    use crate::perception::testing::Road;

    #[test]
    fn a_limit_counts_behind_its_sign_on_roads() {
        // Its roads have 10 m/s, which no sign shows.
        let mut road = Road::new("GGG");
        for lane in &mut road.network.lanes {
            lane.speed_limit = 50.0 / 3.6;
        }
        let stop = road.route.links[0].stop_s;
        let mut ticks = LimitCounts::default();
        let mut tick = |before: f64, believed, is_signed| {
            ticks.note(&road.facts(stop - before, 0.0, 0.0, 5.0), believed, is_signed)
        };
        tick(100.0, IN_TOWNS, false);
        tick(90.0, 50, true);
        tick(80.0, 30, true);
        // Inside the junction.
        tick(-3.0, 50, true);
        assert_eq!(ticks, LimitCounts { ticks: 3, known: 2, right: 2, known_right: 1 });
        ticks.note(&Road::new("GGG").facts(stop - 50.0, 0.0, 0.0, 5.0), 50, true);
        assert_eq!(ticks.ticks, 3, "no sign shows 36 km/h");
    }
}
