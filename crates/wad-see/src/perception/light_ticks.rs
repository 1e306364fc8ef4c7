//! What an ego believed of the light ahead against what was true, tick by tick: the measure of detectors that see
//! lights, as the driver was told them. For measuring only.

use super::facts::EgoFacts;
use super::light::LightAhead;
use super::road_truth::colour;
use serde::{Deserialize, Serialize};

/// A light counts up to this far before its stop line (m).
const REACH: f64 = 40.0;
/// Where no light is within this on the route (m), one that is believed to be within [`REACH`] is none.
const CLEAR: f64 = 60.0;
const RED: usize = 0;
const GREEN: usize = 2;

/// Ticks by what was believed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct LightTicks {
    /// Ticks with a light within 40 m: seen, hidden, or above the picture.
    pub ahead: u64,
    /// Of these, ticks in which its lamp was believed.
    pub right: u64,
    /// Of these, ticks in which no light was believed.
    pub missed: u64,
    /// Of these, ticks in which it was red.
    pub reds: u64,
    /// Red ones that were believed to be green.
    pub red_as_green: u64,
    /// Ticks with no light within 60 m of a route that goes on for longer.
    pub without: u64,
    /// Of these, ticks in which one that stops was believed to be within 40 m.
    pub phantom: u64,
}

impl LightTicks {
    /// Counts a tick.
    pub(super) fn note(&mut self, facts: &EgoFacts<'_>, believed: Option<&LightAhead>) {
        let light = LightAhead::find(facts);
        let lamp = believed.and_then(|light| colour(light.state));
        match light.map(|light| (colour(light.state), light.distance)) {
            Some((Some(there), distance)) if distance <= REACH => {
                self.ahead += 1;
                self.right += u64::from(lamp == Some(there));
                self.missed += u64::from(lamp.is_none());
                self.reds += u64::from(there == RED);
                self.red_as_green += u64::from(there == RED && lamp == Some(GREEN));
            }
            Some((_, distance)) if distance <= CLEAR => {}
            // Behind the route's end there may be one in plain view.
            _ if facts.route.length() - facts.on_route.front_s <= CLEAR => {}
            _ => {
                let stops = |light: &LightAhead| light.stops() && light.distance <= REACH;
                self.without += 1;
                self.phantom += u64::from(believed.is_some_and(stops));
            }
        }
    }

    /// Adds another episode's.
    pub fn add(&mut self, other: &Self) {
        self.ahead += other.ahead;
        self.right += other.right;
        self.missed += other.missed;
        self.reds += other.reds;
        self.red_as_green += other.red_as_green;
        self.without += other.without;
        self.phantom += other.phantom;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perception::testing::Road;
    use sumo_network::world::SignalState;

    #[test]
    fn what_was_believed_is_counted_by_what_was_there() {
        let road = Road::new("rGG");
        let stop = road.route.links[0].stop_s;
        let mut ticks = LightTicks::default();
        let believed = |state| Some(LightAhead { state, distance: 12.0 });
        let mut tick = |before: f64, believed: Option<LightAhead>| {
            ticks.note(&road.facts(stop - before, 0.0, 0.0, 5.0), believed.as_ref());
        };
        tick(20.0, believed(SignalState::Red));
        tick(20.0, believed(SignalState::GreenMajor));
        tick(20.0, None);
        // Too far to count, too near to be none.
        tick(52.0, None);
        tick(100.0, believed(SignalState::Red));
        tick(100.0, believed(SignalState::GreenMajor));
        // Behind the junction the route goes on without a light, and ends.
        tick(-30.0, believed(SignalState::Yellow));
        let end = road.route.length() - stop;
        tick(20.0 - end, believed(SignalState::Red));
        let once =
            LightTicks { ahead: 3, right: 1, missed: 1, reds: 3, red_as_green: 1, without: 3, phantom: 2 };
        assert_eq!(ticks, once);
        let mut twice = once;
        twice.add(&once);
        assert_eq!((twice.ahead, twice.right, twice.phantom), (6, 2, 4));
    }
}
