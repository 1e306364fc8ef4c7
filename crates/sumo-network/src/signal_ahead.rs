//! The signal that decides whether an ego may drive on, and the line to wait at.

use crate::network::{Network, Route, SignalIndex};
use crate::world::SignalState;

/// Room (m) between two junctions in which no car can wait.
pub const NO_ROOM: f64 = 5.0;

/// The signal that counts on a route: the next one or, where that one lets pass, one that does not and is so close
/// behind it that no car can wait between ([`NO_ROOM`]).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SignalAhead {
    /// Which one it is.
    pub signal: SignalIndex,
    /// What it shows.
    pub state: SignalState,
    /// Its own stop line (m on the route).
    pub line_s: f64,
    /// The line to wait at (m on the route): its own or, where none can wait there without standing in the junction
    /// before, that junction's. Signals that never let pass together leave no other place than the own line.
    pub stop_s: f64,
}

impl SignalAhead {
    /// The signal that counts for a front bumper at `front_s` (m on the route). `shown` is a signal's state, None where
    /// it is out of sight: behind such a signal nothing counts.
    pub fn find(
        network: &Network,
        route: &Route,
        front_s: f64,
        shown: impl Fn(SignalIndex) -> Option<SignalState>,
    ) -> Option<Self> {
        let next = route.links.partition_point(|link| link.stop_s < front_s);
        let mut counts: Option<Self> = None;
        // The signals that let pass, each without room behind it.
        let mut passed: Vec<(SignalIndex, f64)> = Vec::new();
        let mut end_s = f64::NEG_INFINITY;
        for link in &route.links[next..] {
            if counts.is_some() && link.stop_s - end_s >= NO_ROOM {
                break;
            }
            end_s = link.end_s;
            let Some(signal) = network.link(link.link).signal else { continue };
            let Some(state) = shown(signal) else { break };
            let own = Self { signal, state, line_s: link.stop_s, stop_s: link.stop_s };
            if state.stops() {
                let wait = passed.iter().find(|(other, _)| network.pass_together(*other, signal));
                return Some(Self { stop_s: wait.map_or(own.line_s, |(_, line_s)| *line_s), ..own });
            }
            passed.push((signal, link.stop_s));
            counts = counts.or(Some(own));
        }
        counts
    }
}
