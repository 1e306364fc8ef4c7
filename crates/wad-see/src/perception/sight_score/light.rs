//! What was said of the light ahead against what was true: by frames, of what a network sees in each, and by ticks, of
//! what the driver was told.

use crate::perception::{EgoFacts, LightAhead, colour};
use serde::{Deserialize, Serialize};

/// A light counts up to this far before its stop line (m).
pub(super) const REACH: f64 = 40.0;
/// Where no light is within this on the route (m), one that is believed to be within [`REACH`] is none.
const CLEAR: f64 = 60.0;
pub(super) const RED: usize = 0;
pub(super) const GREEN: usize = 2;

/// Ticks, or frames, by what was said of the light. Frames count where a head of the ego's is in the picture, or none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct LightCounts {
    /// Ticks with a light within 40 m: seen, hidden, or above the picture.
    pub ahead: usize,
    /// Of these, ticks in which its lamp was believed.
    pub right: usize,
    /// Of these, ticks in which no light was believed.
    pub missed: usize,
    /// Of these, ticks in which it was red.
    pub reds: usize,
    /// Red ones that were believed to be green.
    pub red_as_green: usize,
    /// Ticks with no light within 60 m of a route that goes on for longer.
    pub without: usize,
    /// Of these, ticks in which one that stops was believed to be within 40 m.
    pub phantom: usize,
}

impl LightCounts {
    /// Counts a tick: `there` is the light of `facts`.
    pub(in crate::perception) fn note(
        &mut self,
        facts: &EgoFacts<'_>,
        there: Option<&LightAhead>,
        believed: Option<&LightAhead>,
    ) {
        let lamp = believed.and_then(|light| colour(light.state));
        match there.map(|light| (colour(light.state), light.distance)) {
            Some((Some(there), distance)) if distance <= REACH => self.add_lit(there, lamp),
            Some((_, distance)) if distance <= CLEAR => {}
            // Behind the route's end there may be one in plain view.
            _ if facts.route.length() - facts.on_route.front_s <= CLEAR => {}
            _ => {
                let stops = |light: &LightAhead| light.stops() && light.distance <= REACH;
                self.add_dark(believed.is_some_and(stops));
            }
        }
    }

    /// Counts one with a light whose lamp is `there`.
    pub(super) fn add_lit(&mut self, there: usize, said: Option<usize>) {
        self.ahead += 1;
        self.right += usize::from(said == Some(there));
        self.missed += usize::from(said.is_none());
        self.reds += usize::from(there == RED);
        self.red_as_green += usize::from(there == RED && said == Some(GREEN));
    }

    /// Counts one without a light.
    pub(super) fn add_dark(&mut self, is_phantom: bool) {
        self.without += 1;
        self.phantom += usize::from(is_phantom);
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
        let mut ticks = LightCounts::default();
        let believed = |state| Some(LightAhead { state, distance: 12.0 });
        let mut tick = |before: f64, believed: Option<LightAhead>| {
            let facts = road.facts(stop - before, 0.0, 0.0, 5.0);
            ticks.note(&facts, LightAhead::find(&facts).as_ref(), believed.as_ref());
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
            LightCounts { ahead: 3, right: 1, missed: 1, reds: 3, red_as_green: 1, without: 3, phantom: 2 };
        assert_eq!(ticks, once);
        let mut twice = once;
        twice.add(&once);
        assert_eq!((twice.ahead, twice.right, twice.phantom), (6, 2, 4));
    }
}
