//! The traffic light ahead, taken from the simulator as in the paper ("Traffic Light Detection").

use super::{EgoFacts, SeenLight};
use serde::{Deserialize, Serialize};
use sumo_network::network::SignalIndex;
use sumo_network::world::{SignalAhead, SignalState};

/// Within this of its stop line (m) the ego is at the intersection (spec.md "Events").
pub const AT_INTERSECTION: f64 = 20.0;

/// The next signalled link of the route.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LightAhead {
    /// What it shows.
    pub state: SignalState,
    /// From the front bumper to the stop line (m).
    pub distance: f64,
}

impl LightAhead {
    /// The signal that counts ([`SignalAhead`]); None where the next one's state is out of sight.
    pub fn find(facts: &EgoFacts<'_>) -> Option<Self> {
        Self::with_signal(facts).map(|(light, ..)| light)
    }

    /// The same with the signal, and the road's heading at its stop line (rad).
    pub(super) fn with_signal(facts: &EgoFacts<'_>) -> Option<(Self, SignalIndex, f64)> {
        let front = facts.on_route.front_s;
        let links = &facts.route.links;
        let next = links.partition_point(|link| link.stop_s < front);
        let mut ahead = SignalAhead::default();
        for link in &links[next..] {
            let signal = facts.network.link(link.link).signal;
            let state = signal.and_then(|signal| {
                let states = facts.signals.get(signal.traffic_light.index())?.as_ref()?;
                Some(SignalState::from_sumo(*states.as_bytes().get(signal.index)?))
            });
            if signal.is_some() && state.is_none() {
                break;
            }
            ahead.pass(state, link.stop_s, link.end_s);
            if ahead.is_decided() {
                break;
            }
        }
        let (state, stop_s) = ahead.counts()?;
        let link = links[next..].iter().find(|link| link.stop_s == stop_s)?;
        let heading = facts.route.at(stop_s).pose.heading;
        Some((Self { state, distance: stop_s - front }, facts.network.link(link.link).signal?, heading))
    }

    /// Whether it requires to stop: red, red with yellow, or yellow.
    pub fn stops(&self) -> bool {
        self.state.stops()
    }

    /// Whether the ego is at the intersection and may not enter: the transformed image shows red.
    pub fn is_red_here(&self) -> bool {
        self.state.is_red() && self.distance <= AT_INTERSECTION
    }
}

/// Deceleration (m/s2) up to which a yellow light is obeyed, and the delay until a decision acts (s).
const YELLOW: f64 = 3.0;
const DELAY: f64 = 0.2;

/// Whether the ego has to stop for the light ahead, from tick to tick.
///
/// For red it has to. For yellow it has to if it can (spec.md "Events"); once it brakes for a yellow light, the
/// decision stays.
#[derive(Clone, Copy, Debug, Default)]
pub struct StopLight {
    /// It has to stop for the light that was this far ahead (m).
    decided: Option<f64>,
}

impl StopLight {
    /// Forgets the light.
    pub fn reset(&mut self) {
        *self = Self::default();
    }

    /// The distance (m) to the line where an ego at `speed` (m/s) has to stop.
    pub fn update(&mut self, light: Option<&LightAhead>, speed: f64) -> Option<f64> {
        let light = light.filter(|light| light.stops());
        self.decided = light.and_then(|light| {
            // Further ahead than before: another light.
            let same = self.decided.is_some_and(|before| light.distance < before + 1.0);
            let room = (light.distance - speed * DELAY).max(0.01);
            let can = speed * speed <= 2.0 * YELLOW * room;
            (same || can || light.state.is_red()).then_some(light.distance)
        });
        self.decided
    }
}

/// The light ahead as a network sees it, from tick to tick: distances are averaged along the ego's way, and a light
/// that has left the picture, because the ego stands below it, is remembered.
#[derive(Clone, Copy, Debug, Default)]
pub struct SeenLights {
    last: Option<Remembered>,
}

#[derive(Clone, Copy, Debug)]
struct Remembered {
    light: LightAhead,
    /// Frames that made its distance, and the time since the last of them (s).
    seen: u32,
    hidden: f64,
}

/// A distance that is this much of itself, or this much (m), away from the expected one is another light's.
const SAME: (f64, f64) = (0.35, 4.0);
/// Most frames that a distance is averaged over.
const AVERAGED: u32 = 8;
/// Before a line, the near heads are above the picture from here on (m); beyond it, a light is forgotten (m).
const BELOW: f64 = 10.0;
const PASSED: f64 = 1.5;
/// How long a light is remembered that should be in the picture, and one that the ego stands below (s).
const BLINK: f64 = 0.6;
const LONGEST_HIDDEN: f64 = 45.0;

impl SeenLights {
    /// Forgets everything.
    pub fn reset(&mut self) {
        *self = Self::default();
    }

    /// The light ahead after `tick` s at `speed` (m/s), with what the picture shows.
    pub fn update(&mut self, seen: Option<SeenLight>, speed: f64, tick: f64) -> Option<LightAhead> {
        let expected = self.last.map(|mut last| {
            last.light.distance -= speed * tick;
            last
        });
        self.last = match (seen, expected) {
            (Some(seen), Some(last)) if is_same(seen.distance, last.light.distance) => {
                let frames = (last.seen + 1).min(AVERAGED);
                let off = seen.distance - last.light.distance;
                let distance = last.light.distance + off / f64::from(frames);
                let light = LightAhead { state: seen.state, distance };
                Some(Remembered { light, seen: frames, hidden: 0.0 })
            }
            (Some(seen), _) => {
                let light = LightAhead { state: seen.state, distance: seen.distance };
                Some(Remembered { light, seen: 1, hidden: 0.0 })
            }
            (None, last) => {
                last.map(|last| Remembered { hidden: last.hidden + tick, ..last }).filter(|last| {
                    let longest = if last.light.distance < BELOW { LONGEST_HIDDEN } else { BLINK };
                    last.hidden <= longest
                })
            }
        };
        self.last = self.last.filter(|last| last.light.distance > -PASSED);
        let light = self.last?.light;
        Some(LightAhead { distance: light.distance.max(0.0), ..light })
    }
}

fn is_same(seen: f64, expected: f64) -> bool {
    (seen - expected).abs() < SAME.1.max(SAME.0 * expected)
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
        // Past the line the light no longer concerns the ego.
        assert!(ahead("rGG", -0.5).is_none());
    }

    #[test]
    fn yellow_binds_who_can_stop_and_goes_on_binding() {
        let yellow = |distance| LightAhead { state: SignalState::Yellow, distance };
        let mut light = StopLight::default();
        // 10 m/s: 16.7 m at 3 m/s2, and 2 m before it begins.
        assert_eq!(light.update(Some(&yellow(18.0)), 10.0), None);
        assert_eq!(light.update(Some(&yellow(19.0)), 10.0), Some(19.0));
        assert_eq!(light.update(Some(&yellow(17.0)), 10.0), Some(17.0), "it began to brake");
        // The next light is another matter.
        assert_eq!(light.update(Some(&yellow(18.5)), 10.0), None);
        let red = LightAhead { state: SignalState::Red, distance: 5.0 };
        assert_eq!(light.update(Some(&red), 14.0), Some(5.0));
        assert_eq!(light.update(None, 14.0), None);
        light.update(Some(&yellow(19.0)), 10.0);
        light.reset();
        assert_eq!(light.update(Some(&yellow(17.0)), 10.0), None);
    }

    #[test]
    fn a_light_is_remembered_below_it_and_no_longer() {
        let seen = |distance| Some(SeenLight { state: SignalState::Red, distance, certainty: 0.9 });
        let mut lights = SeenLights::default();
        assert!(lights.update(None, 5.0, 0.1).is_none());
        // 0.5 m a tick; the second look is 1 m off, and half believed.
        assert_eq!(lights.update(seen(20.0), 5.0, 0.1).map(|l| l.distance), Some(20.0));
        assert_eq!(lights.update(seen(20.5), 5.0, 0.1).map(|l| l.distance), Some(20.0));
        // A flicker is bridged, a light that stays away is gone.
        assert_eq!(lights.update(None, 5.0, 0.1).map(|l| l.distance), Some(19.5));
        assert!((0..6).map(|_| lights.update(None, 0.0, 0.1)).any(|light| light.is_none()));
        // Below the heads it stays, with the way that the ego goes, until the line is passed.
        lights.update(seen(6.0), 0.0, 0.1);
        let near = (0..50).filter_map(|_| lights.update(None, 1.0, 0.1)).last().unwrap();
        assert!(near.state == SignalState::Red && (near.distance - 1.0).abs() < 1e-6, "{near:?}");
        assert!((0..30).filter_map(|_| lights.update(None, 1.0, 0.1)).all(|light| light.distance < 1.0));
        assert!(lights.update(None, 1.0, 0.1).is_none());
        // One that shows something else is believed at once.
        lights.update(seen(6.0), 0.0, 0.1);
        let green = SeenLight { state: SignalState::GreenMajor, distance: 6.0, certainty: 0.9 };
        assert_eq!(lights.update(Some(green), 0.0, 0.1).map(|l| l.stops()), Some(false));
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
