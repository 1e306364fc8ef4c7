//! The programs of traffic lights, as the net has them: whether two signals ever let pass at the same time.

use super::{Network, SignalIndex};
use crate::world::SignalState;

/// Programs with more phases are not looked through.
const MOST_PHASES: usize = 200;

/// A `<tlLogic>`: its phases, one after the other, for ever.
#[derive(Clone, Debug)]
pub struct SignalProgram {
    /// Each phase lasts as long as it says: the program is neither actuated nor without durations.
    fixed: bool,
    /// How much later than at 0 s it begins (s).
    offset: f64,
    /// How long each phase lasts (s), and its state.
    phases: Vec<(f64, Box<str>)>,
}

impl SignalProgram {
    /// A program without phases, of SUMO's `type` and `offset`.
    pub(super) fn new(kind: Option<&str>, offset: Option<&str>) -> Self {
        let offset = offset.map_or(Some(0.0), seconds);
        let fixed = kind.is_none_or(|kind| kind == "static") && offset.is_some();
        Self { fixed, offset: offset.unwrap_or(0.0), phases: Vec::new() }
    }

    pub(super) fn push(&mut self, state: &str, duration: Option<&str>) {
        let duration = duration.and_then(seconds).filter(|duration| *duration > 0.0);
        self.fixed &= duration.is_some();
        self.phases.push((duration.unwrap_or(0.0), state.into()));
    }

    fn cycle(&self) -> f64 {
        self.phases.iter().map(|(duration, _)| duration).sum()
    }

    /// When each phase begins (s), within a cycle.
    fn begins(&self) -> impl Iterator<Item = f64> + '_ {
        self.phases.iter().scan(self.offset, |at, (duration, _)| {
            let begin = *at;
            *at += duration;
            Some(begin)
        })
    }

    /// The state just after `time` s.
    fn at(&self, time: f64) -> &str {
        // Phases begin at sums of decimals: a moment later each has begun.
        let mut rest = (time + 1e-3 - self.offset).rem_euclid(self.cycle());
        for (duration, state) in &self.phases {
            if rest < *duration {
                return state;
            }
            rest -= duration;
        }
        self.phases.last().map_or("", |(_, state)| state)
    }
}

fn seconds(text: &str) -> Option<f64> {
    text.trim().parse().ok().filter(|value: &f64| value.is_finite())
}

impl Network {
    /// Whether both signals let pass at the same time once, by the net's programs. True where the net does not say:
    /// programs of different lengths or without fixed times drift against each other.
    pub fn pass_together(&self, a: SignalIndex, b: SignalIndex) -> bool {
        let passes = |state: &str, signal: SignalIndex| {
            state.as_bytes().get(signal.index).is_some_and(|&c| !SignalState::from_sumo(c).stops())
        };
        let (first, second) = (self.traffic_light(a.traffic_light), self.traffic_light(b.traffic_light));
        if first.programs.iter().chain(&second.programs).any(|program| program.phases.len() > MOST_PHASES) {
            return true;
        }
        if a.traffic_light == b.traffic_light {
            let any = |program: &SignalProgram| {
                program.phases.iter().any(|(_, state)| passes(state, a) && passes(state, b))
            };
            return first.programs.is_empty() || first.programs.iter().any(any);
        }
        let ([first], [second]) = (first.programs.as_slice(), second.programs.as_slice()) else {
            return true;
        };
        let comparable = first.fixed && second.fixed && (first.cycle() - second.cycle()).abs() < 1e-6;
        if !comparable || first.phases.is_empty() {
            return true;
        }
        first.begins().chain(second.begins()).any(|t| passes(first.at(t), a) && passes(second.at(t), b))
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
