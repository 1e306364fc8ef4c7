//! The signal that decides whether an ego may drive on, and the line to wait at.

use crate::network::{Network, Route, SignalIndex, SignalProgram};
use crate::world::SignalState;

/// Room (m) between two junctions in which no car can wait.
pub const NO_ROOM: f64 = 5.0;

/// Programs with more phases are not looked through.
const MOST_PHASES: usize = 200;

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

impl Network {
    /// Whether both signals let pass at the same time once, by the net's programs. True where the net does not say:
    /// programs of different lengths or without fixed times drift against each other.
    pub fn pass_together(&self, a: SignalIndex, b: SignalIndex) -> bool {
        let passes = |state: &str, signal: SignalIndex| {
            state.as_bytes().get(signal.index).is_some_and(|&c| !SignalState::from_sumo(c).stops())
        };
        let (first, second) = (self.traffic_light(a.traffic_light), self.traffic_light(b.traffic_light));
        let programs = first.programs.iter().chain(&second.programs);
        if programs.map(|program| program.states().len()).any(|phases| phases > MOST_PHASES) {
            return true;
        }
        if a.traffic_light == b.traffic_light {
            let mut states = first.programs.iter().flat_map(SignalProgram::states);
            return first.programs.is_empty() || states.any(|state| passes(state, a) && passes(state, b));
        }
        let ([first], [second]) = (first.programs.as_slice(), second.programs.as_slice()) else {
            return true;
        };
        let comparable =
            first.is_fixed() && second.is_fixed() && (first.cycle() - second.cycle()).abs() < 1e-6;
        !comparable
            || first
                .begins()
                .chain(second.begins())
                .any(|t| passes(first.at(t), a) && passes(second.at(t), b))
    }
}

#[cfg(test)]
mod tests {
    use crate::network::testing;
    use crate::network::{Network, SignalIndex};

    /// The small net with a second traffic light, and programs of `kind` for both.
    fn net(first: &str, second: &str, kind: &str, offset: &str) -> Network {
        let program = |id: &str, offset: &str, phases: &str| {
            format!(r#"<tlLogic id="{id}" type="{kind}" programID="0" offset="{offset}">{phases}</tlLogic>"#)
        };
        let text = testing::text("");
        let (head, rest) = text.split_once("<tlLogic").unwrap();
        let tail = rest.split_once("</tlLogic>").unwrap().1;
        let both = program("light", "0", first) + &program("other", offset, second);
        testing::parsed(&(head.to_owned() + &both + tail)).unwrap()
    }

    fn together(network: &Network, second: &str, index: usize) -> bool {
        let signal = |id: &str, index| {
            let traffic_light = network.traffic_light_by_id(id).unwrap();
            SignalIndex { traffic_light, index }
        };
        network.pass_together(signal("light", 0), signal(second, index))
    }

    const HALVES: &str = r#"<phase duration="20" state="Grr"/><phase duration="20" state="rGG"/>"#;

    #[test]
    fn signals_of_one_light_pass_together_where_a_phase_has_both() {
        let network = net(HALVES, HALVES, "static", "0");
        assert!(together(&network, "light", 0) && !together(&network, "light", 1));
        // Which phase follows is open; that none has both is not.
        assert!(!together(&net(HALVES, HALVES, "actuated", "0"), "light", 1));
    }

    #[test]
    fn signals_of_two_lights_pass_together_where_their_greens_overlap() {
        assert!(together(&net(HALVES, HALVES, "static", "0"), "other", 0));
        assert!(!together(&net(HALVES, HALVES, "static", "0"), "other", 1));
        assert!(!together(&net(HALVES, HALVES, "static", "20"), "other", 0));
        assert!(together(&net(HALVES, HALVES, "static", "-19.5"), "other", 0));
        // Where the net does not say, they may.
        assert!(together(&net(HALVES, HALVES, "actuated", "0"), "other", 1));
        let longer = r#"<phase duration="20" state="Grr"/><phase duration="25" state="rGG"/>"#;
        assert!(together(&net(HALVES, longer, "static", "0"), "other", 1));
        assert!(together(&net(HALVES, r#"<phase state="rGG"/>"#, "static", "0"), "other", 2));
        assert!(together(&net(HALVES, "", "static", "x"), "other", 0));
    }
}
