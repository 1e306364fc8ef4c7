//! The traffic light ahead, taken from the simulator as in the paper ("Traffic Light Detection").

use super::EgoFacts;
use crate::world::SignalState;
use serde::{Deserialize, Serialize};

/// Within this of its stop line (m) the ego is at the intersection (spec.md "Events").
pub const AT_INTERSECTION: f64 = 20.0;

/// The next signalled link of the route.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LightAhead {
    pub state: SignalState,
    /// From the front bumper to the stop line (m).
    pub distance: f64,
}

impl LightAhead {
    /// The next signal on the route whose state is in sight; None where there is none.
    pub fn find(facts: &EgoFacts<'_>) -> Option<Self> {
        let front = facts.on_route.front_s;
        let links = &facts.route.links;
        let next = links.partition_point(|link| link.stop_s < front);
        let (link, signal) =
            links[next..].iter().find_map(|link| Some((link, facts.network.link(link.link).signal?)))?;
        let state = facts.signals.get(signal.traffic_light.index())?.as_ref()?;
        let state = SignalState::from_sumo(*state.as_bytes().get(signal.index)?);
        Some(Self { state, distance: link.stop_s - front })
    }

    /// Whether it asks to stop: red, red with yellow, or yellow.
    pub fn stops(&self) -> bool {
        self.state.is_red() || self.state == SignalState::Yellow
    }

    /// Whether the ego is at the intersection and may not enter: the transformed image shows red.
    pub fn is_red_here(&self) -> bool {
        self.state.is_red() && self.distance <= AT_INTERSECTION
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perception::testing::{LENGTH, Road};

    fn ahead(state: &str, before: f64) -> Option<LightAhead> {
        let road = Road::new(state);
        let stop = road.route.links[0].stop_s;
        LightAhead::find(&road.facts(stop - before - 0.5 * LENGTH, 0.0, 0.0, 5.0))
    }

    #[test]
    fn red_is_painted_within_20_m_of_the_stop_line_only() {
        let near = ahead("rGG", 19.5).unwrap();
        assert!(near.is_red_here() && (near.distance - 19.5).abs() < 1e-6);
        assert!(!ahead("rGG", 20.5).unwrap().is_red_here());
        assert!(ahead("uGG", 5.0).unwrap().is_red_here());
        assert!(!ahead("GGG", 5.0).unwrap().is_red_here());
        let yellow = ahead("yGG", 5.0).unwrap();
        assert!(yellow.stops() && !yellow.is_red_here());
        // Past the line it is no more the ego's.
        assert!(ahead("rGG", -0.5).is_none());
    }

    #[test]
    fn a_light_out_of_sight_or_of_another_program_says_nothing() {
        let mut road = Road::new("rGG");
        road.signals = vec![None];
        assert!(LightAhead::find(&road.facts(250.0, 0.0, 0.0, 5.0)).is_none());
        road.signals = vec![Some("".into())];
        assert!(LightAhead::find(&road.facts(250.0, 0.0, 0.0, 5.0)).is_none());
        road.signals.clear();
        assert!(LightAhead::find(&road.facts(250.0, 0.0, 0.0, 5.0)).is_none());
    }
}
