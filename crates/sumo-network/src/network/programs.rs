//! The programs of traffic lights, as the net has them.

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

    /// Whether each phase lasts as long as the net says, and there is one.
    pub(crate) fn is_fixed(&self) -> bool {
        self.fixed && !self.phases.is_empty()
    }

    /// Each phase's state.
    pub(crate) fn states(&self) -> impl ExactSizeIterator<Item = &str> {
        self.phases.iter().map(|(_, state)| &**state)
    }

    /// How long it takes (s).
    pub(crate) fn cycle(&self) -> f64 {
        self.phases.iter().map(|(duration, _)| duration).sum()
    }

    /// When each phase begins (s), within a cycle.
    pub(crate) fn begins(&self) -> impl Iterator<Item = f64> + '_ {
        self.phases.iter().scan(self.offset, |at, (duration, _)| {
            let begin = *at;
            *at += duration;
            Some(begin)
        })
    }

    /// The state just after `time` s.
    pub(crate) fn at(&self, time: f64) -> &str {
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
