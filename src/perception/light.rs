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
