//! The traffic light ahead, taken from the simulator as in the paper ("Traffic Light Detection").

use super::{EgoFacts, SeenLight};
use serde::{Deserialize, Serialize};
use sumo_network::network::SignalIndex;
use sumo_network::signal_ahead::SignalAhead;
use sumo_network::world::SignalState;

/// Within this of its stop line (m) the ego is at the intersection (spec.md "Events").
pub const AT_INTERSECTION: f64 = 20.0;

/// The next signalled link of the route.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LightAhead {
    /// What it shows.
    pub state: SignalState,
    /// From the front bumper to the line to wait at (m).
    pub distance: f64,
}

impl LightAhead {
    /// The signal that counts ([`SignalAhead`]); None where the next one's state is out of sight.
    pub fn find(facts: &EgoFacts<'_>) -> Option<Self> {
        Self::with_signal(facts).map(|(light, ..)| light)
    }

    /// The same with the signal, and the road's heading at its own stop line (rad).
    pub(super) fn with_signal(facts: &EgoFacts<'_>) -> Option<(Self, SignalIndex, f64)> {
        let front = facts.on_route.front_s;
        let ahead = SignalAhead::find(facts.network, facts.route, front, |signal| {
            let states = facts.signals.get(signal.traffic_light.index())?.as_ref()?;
            Some(SignalState::from_sumo(*states.as_bytes().get(signal.index)?))
        })?;
        let heading = facts.route.at(ahead.line_s).pose.heading;
        Some((Self { state: ahead.state, distance: ahead.stop_s - front }, ahead.signal, heading))
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

/// The fastest speed limit (m/s) that an ego is told whose lights the camera sees: it shows a signal head from 60 m on, and who
/// drives faster cannot stop for the red of one that has just come into sight.
pub const BY_SIGHT: f64 = 70.0 / 3.6;

/// Deceleration (m/s2) up to which a yellow light is obeyed, and one that the camera did not see begin: it may turn red at any
/// time. The delay until a decision acts (s).
const YELLOW: f64 = 3.0;
const OLD_YELLOW: f64 = 5.0;
const DELAY: f64 = 0.2;

/// Whether the ego has to stop for the light ahead, from tick to tick.
///
/// For red it has to. For yellow it has to if it can (spec.md "Events"); once it brakes for a yellow light, the
/// decision stays.
#[derive(Clone, Copy, Debug, Default)]
pub struct StopLight {
    /// It has to stop for the light that was this far ahead (m).
    decided: Option<f64>,
    /// The light that was this far ahead (m) has been watched since it was green.
    watched: Option<f64>,
}

impl StopLight {
    /// Forgets the light.
    pub fn reset(&mut self) {
        *self = Self::default();
    }

    /// The distance (m) to the place where an ego at `speed` (m/s) has to stop. Of a light that the camera saw (`is_seen`) that
    /// place is `STAND` (6 m) before the line: who can stop at the line has to.
    pub fn update(&mut self, light: Option<&LightAhead>, is_seen: bool, speed: f64) -> Option<f64> {
        // Further ahead than before: another light.
        let is_same =
            |light: &LightAhead, before: Option<f64>| before.is_some_and(|b| light.distance < b + 1.0);
        let watched = light.filter(|light| !light.stops() || is_same(light, self.watched));
        self.watched = watched.map(|light| light.distance);
        self.decided = light.filter(|light| light.stops()).and_then(|light| {
            let early = if is_seen { STAND } else { 0.0 };
            let hardest = if is_seen && watched.is_none() { OLD_YELLOW } else { YELLOW };
            let room = (light.distance + early - speed * DELAY).max(0.01);
            let can = speed * speed <= 2.0 * hardest * room;
            (is_same(light, self.decided) || can || light.state.is_red()).then_some(light.distance)
        });
        self.decided
    }
}

/// The light ahead as a network sees it, from tick to tick. Its distance is averaged along the ego's way; the lamp is
/// believed that has been seen the most of late; one that has left the picture, because the ego stands below it, is
/// remembered; and another light has to be seen for a while until it takes its place. Inside the junction behind a line
/// no other is expected: what is seen there is cross traffic's.
#[derive(Clone, Copy, Debug, Default)]
pub struct SeenLights {
    believed: Option<Track>,
    /// What is seen elsewhere.
    rival: Option<Track>,
    /// How far behind the ego the last line lies (m).
    passed: Option<f64>,
}

/// A light from tick to tick.
#[derive(Clone, Copy, Debug)]
struct Track {
    light: LightAhead,
    /// Where it was first seen (m before the line).
    first: f64,
    /// How well its distance is known: the sum of certainty / variance of the looks that made it (1/m2).
    known: f64,
    /// How surely it was seen in all: the sum of its certainties.
    sure: f64,
    /// How sure it was of late.
    fresh: f64,
    /// How sure red, yellow, green were of late, as far as it was seen.
    lamps: [f64; 3],
    /// Since it was last seen: time, as a share of how long it is remembered.
    hidden: f64,
}

/// A distance that is this much of itself, or this much (m), away from the expected one is another light's.
const SAME: (f64, f64) = (0.35, 4.0);
/// Standard deviation of a distance in one frame: metres, and share of it. So what is seen from near counts more.
const DOUBT: (f64, f64) = (0.5, 0.15);
/// Sure frames that a distance is averaged over. The ego's own way is exact, but errors hold from frame to frame: a line 60 m
/// ahead is seen too near for a second, and what comes nearer is seen the better (docs/detector.md, "The light from tick to
/// tick").
const AVERAGED: f64 = 3.0;
/// Most certainty that a light has: sure frames.
const SUREST: f64 = 12.0;
/// A frame says something of the distance if the ego has moved by this since the last one (m): one that stands sees
/// the same error again and again.
const MOVED: f64 = 0.05;
/// What was seen counts half after this (s).
const HALF: f64 = 0.4;
/// What is left of a lamp at the next look.
const FADES: f64 = 0.6;
/// Green after red or yellow must have been seen so many times as much as both: it may be another lane's.
const GOES: f64 = 2.0;
/// And so surely, as long as the ego's own heads are in the picture: this far before the line (m). Nearer to it only those across
/// the junction are seen, often of others: a light that turns there does not stop an ego that drives.
const SURELY: f64 = 0.8;
const HEADS: f64 = 5.5;
/// How sure a light must have been of late to be believed where none is, and to take another's place. Where there is
/// none, networks are at times half sure of one for a frame, and who brakes for it stands below nothing.
const FIRST: f64 = 1.0;
const RIVAL: f64 = 1.5;
/// The same for one that is first seen within this distance (m): a light is seen from afar, and what appears so near, in a
/// bend or inside a junction, is mostly another's.
const SUDDEN: (f64, f64) = (12.0, 2.0);
/// Before a line, the near heads are above the picture from here on (m); beyond it, a light is forgotten (m).
const BELOW: f64 = 10.0;
const PASSED: f64 = 1.5;
/// Behind a line, the next one is at least this far away (m).
const JUNCTION: f64 = 12.0;
/// The ego is to stop this much before the line (m), where it still sees when the near heads turn green: drivers stop 2 m
/// before what they are told, and from 8 m on the heads over the lane are in the rows that networks see.
pub(super) const STAND: f64 = 6.0;
/// Nor does one that turns where the ego cannot stop with this (m/s2).
const BRAKE: f64 = 6.0;
/// Below this the ego stands (m/s).
const CREEPS: f64 = 0.5;
/// How long a light is remembered that should be in the picture, and one that the ego stands below, or that somebody in front
/// of it hides, for each sure frame if it was seen in as many as count (s): in all longer than signals stay red, and not for
/// long if it was hardly seen.
const BLINK: f64 = 0.6;
const HIDDEN: f64 = 10.0;

impl SeenLights {
    /// Forgets everything.
    pub fn reset(&mut self) {
        *self = Self::default();
    }

    /// The light ahead after `tick` s at `speed` (m/s), with what the picture shows. `can_be`: whether the ego's light can
    /// have its line so far ahead (m), by the route.
    pub fn update(
        &mut self,
        seen: Option<SeenLight>,
        speed: f64,
        tick: f64,
        can_be: impl Fn(f64) -> bool,
    ) -> Option<LightAhead> {
        let moved = speed * tick;
        self.passed = self.passed.map(|passed| passed + moved).filter(|passed| *passed < JUNCTION);
        for track in [&mut self.believed, &mut self.rival] {
            let stays = |track: &Track| track.hidden <= 1.0 + 1e-9 && can_be(track.light.distance);
            *track = track.map(|track| track.later(speed, tick)).filter(stays);
        }
        if let Some(behind) = self.believed.take_if(|track| track.light.distance < -PASSED) {
            self.passed = Some(-behind.light.distance);
        }
        let is_next = |seen: &SeenLight| self.passed.is_none_or(|passed| seen.distance + passed > JUNCTION);
        if let Some(seen) = seen.filter(|seen| is_next(seen) && can_be(seen.distance)) {
            let fits = |track: &&mut Track| is_same(seen.distance, track.light.distance);
            if let Some(track) = self.believed.as_mut().filter(fits).or(self.rival.as_mut().filter(fits)) {
                track.again(seen, speed, tick);
            } else {
                self.rival = Some(Track::new(seen));
            }
        }
        let believed = self.believed.map_or(FIRST, |believed| RIVAL.max(believed.fresh));
        let needed = |rival: &Track| if rival.first < SUDDEN.0 { SUDDEN.1.max(believed) } else { believed };
        let is_surer = |rival: &mut Track| rival.fresh > needed(rival);
        if let Some(rival) = self.rival.take_if(is_surer) {
            self.believed = Some(rival);
        }
        let light = self.believed?.light;
        Some(LightAhead { distance: (light.distance - STAND).max(0.0), ..light })
    }
}

impl Track {
    fn new(seen: SeenLight) -> Self {
        let light = LightAhead { state: seen.state, distance: seen.distance };
        let certainty = f64::from(seen.certainty);
        let mut lamps = [0.0; 3];
        lamps[lamp(seen.state)] = certainty;
        let known = certainty / variance(seen.distance);
        Self { light, first: seen.distance, known, sure: certainty, fresh: certainty, lamps, hidden: 0.0 }
    }

    fn later(mut self, speed: f64, tick: f64) -> Self {
        self.light.distance -= speed * tick;
        let longest =
            if self.may_hide(speed) { BLINK.max(HIDDEN * self.sure.powi(2) / SUREST) } else { BLINK };
        self.hidden += tick / longest;
        self.fresh *= 0.5_f64.powf(tick / HALF);
        self
    }

    /// Whether its heads can be out of sight for long: above the picture, or, of one at which the ego stands, behind somebody
    /// in front of it.
    fn may_hide(&self, speed: f64) -> bool {
        self.light.distance < BELOW || (speed < CREEPS && self.light.stops())
    }

    /// Seen again, after a tick (s) at a speed (m/s) by which it is nearer.
    fn again(&mut self, seen: SeenLight, speed: f64, tick: f64) {
        let certainty = f64::from(seen.certainty);
        let late = HEADS.max(speed * speed / (2.0 * BRAKE));
        // From green to yellow or red, or from yellow to red: who has not braked for yellow crosses.
        let turns = lamp(seen.state) < lamp(self.light.state);
        if turns && speed > CREEPS && self.light.distance < late {
            return;
        }
        if speed * tick > MOVED {
            self.sure = (self.sure + certainty).min(SUREST);
            let variance = variance(seen.distance);
            let weight = certainty / variance;
            self.known = (self.known + weight).min(AVERAGED / variance);
            self.light.distance += (seen.distance - self.light.distance) * weight / self.known;
        }
        // Lamps age as far as they are seen: what was hidden meanwhile is not forgotten for one look.
        self.lamps.iter_mut().for_each(|lamp| *lamp *= FADES);
        self.lamps[lamp(seen.state)] += certainty;
        // Far away networks take yellow for red and red for yellow: both say that the ego has to stop.
        let [red, yellow, green] = self.lamps;
        let stops = red + yellow;
        let least = if self.light.distance < HEADS { 0.0 } else { SURELY };
        let goes = if self.light.stops() { green > (GOES * stops).max(least) } else { green >= stops };
        self.light.state = match goes {
            true => SignalState::GreenMajor,
            false if red >= yellow => SignalState::Red,
            false => SignalState::Yellow,
        };
        self.fresh += certainty;
        // A faint green that red is kept for does not keep it alive for ever.
        if !self.may_hide(speed) || seen.state.stops() == self.light.stops() {
            self.hidden = 0.0;
        }
    }
}

/// Of a distance in one frame (m2).
fn variance(distance: f64) -> f64 {
    (DOUBT.0 + DOUBT.1 * distance.max(0.0)).powi(2)
}

/// The number of a lamp that a network tells apart.
fn lamp(state: SignalState) -> usize {
    if state.is_red() { 0 } else { 2 - usize::from(state.stops()) }
}

fn is_same(seen: f64, expected: f64) -> bool {
    (seen - expected).abs() < SAME.1.max(SAME.0 * expected)
}

/// Whether a light whose line is seen `distance` m ahead can be the ego's: there its route enters a junction. What is seen
/// inside one, of other lanes and of those who walk, is not, nor is one whose line the ego's front has passed, however far ahead
/// that line seemed to be.
pub fn can_be(facts: &EgoFacts<'_>, distance: f64) -> bool {
    let mut entries = facts.route.links.iter().map(|link| link.stop_s - facts.on_route.front_s);
    entries.any(|entry| entry >= 0.0 && is_same(distance, entry))
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
        assert_eq!(light.update(Some(&yellow(18.0)), false, 10.0), None);
        assert_eq!(light.update(Some(&yellow(19.0)), false, 10.0), Some(19.0));
        assert_eq!(light.update(Some(&yellow(17.0)), false, 10.0), Some(17.0), "it began to brake");
        // The next light is another matter.
        assert_eq!(light.update(Some(&yellow(18.5)), false, 10.0), None);
        let red = LightAhead { state: SignalState::Red, distance: 5.0 };
        assert_eq!(light.update(Some(&red), false, 14.0), Some(5.0));
        assert_eq!(light.update(None, false, 14.0), None);
        light.update(Some(&yellow(19.0)), false, 10.0);
        light.reset();
        assert_eq!(light.update(Some(&yellow(17.0)), false, 10.0), None);
        // A place to stop at that is before the line changes where to stop, not whether.
        let green = LightAhead { state: SignalState::GreenMajor, distance: 13.0 };
        assert_eq!(light.update(Some(&green), true, 10.0), None);
        assert_eq!(light.update(Some(&yellow(12.0)), true, 10.0), None);
        assert_eq!(light.update(Some(&yellow(13.0)), true, 10.0), Some(13.0));
    }

    #[test]
    fn yellow_that_was_not_seen_to_begin_binds_who_can_brake_harder() {
        let yellow = |distance| LightAhead { state: SignalState::Yellow, distance };
        // 19 m/s: 36.1 m at 5 m/s2, 60.2 m at 3 m/s2, and 3.8 m before it begins.
        let told = |green: bool, is_seen: bool, distance: f64| {
            let mut light = StopLight::default();
            if green {
                let before = LightAhead { state: SignalState::GreenMajor, distance: distance + 3.0 };
                light.update(Some(&before), is_seen, 19.0);
            }
            // Longer than a tick: what was seen to begin stays so.
            light.update(Some(&yellow(distance)), is_seen, 19.0);
            light.update(Some(&yellow(distance - 1.0)), is_seen, 19.0).is_some()
        };
        assert!(told(false, true, 36.0), "42 m before its line");
        assert!(!told(false, true, 33.0), "too late");
        assert!(!told(true, true, 36.0) && told(true, true, 60.0), "it saw the yellow begin");
        assert!(!told(false, false, 42.0), "who is told of the light knows when it began");
    }

    #[test]
    fn a_light_is_remembered_below_it_and_no_longer() {
        let seen = |distance| Some(SeenLight { state: SignalState::Red, distance, certainty: 0.9 });
        let mut lights = SeenLights::default();
        assert!(lights.update(None, 5.0, 0.1, |_| true).is_none());
        assert!(lights.update(seen(20.0), 0.0, 0.1, |_| true).is_none(), "one look is not believed");
        // 0.5 m a tick; the third look is 1 m off, and half believed.
        let stand = 20.0 - STAND;
        let is = |light: Option<LightAhead>, at: f64| light.is_some_and(|l| (l.distance - at).abs() < 0.05);
        assert!(is(lights.update(seen(20.0), 0.0, 0.1, |_| true), stand));
        assert!(is(lights.update(seen(20.5), 5.0, 0.1, |_| true), stand));
        // A flicker is bridged, a light that stays away is gone.
        assert!(is(lights.update(None, 5.0, 0.1, |_| true), stand - 0.5));
        assert!((0..6).map(|_| lights.update(None, 1.0, 0.1, |_| true)).any(|light| light.is_none()));
        // Below the heads it stays, with the way that the ego goes, until the line is passed.
        let comes = (0..10).map(|n| seen(9.9 - 0.1 * f64::from(n)));
        assert!(comes.filter_map(|seen| lights.update(seen, 1.0, 0.1, |_| true)).last().is_some());
        let near = (0..20).filter_map(|_| lights.update(None, 1.0, 0.1, |_| true)).last().unwrap();
        assert!(near.state == SignalState::Red && (near.distance - 1.0).abs() < 1e-6, "{near:?}");
        assert!(
            (0..45).filter_map(|_| lights.update(None, 2.0, 0.1, |_| true)).all(|light| light.distance < 1.0)
        );
        assert!(lights.update(None, 1.0, 0.1, |_| true).is_none());
        // Cross traffic's heads, behind the line; then the next junction's.
        assert!(lights.update(seen(3.0), 5.0, 0.1, |_| true).is_none());
        assert!((0..5).filter_map(|_| lights.update(seen(30.0), 0.0, 0.1, |_| true)).last().is_some());
    }

    #[test]
    fn who_stands_behind_somebody_tall_remembers_the_light_and_believes_no_other_lane_s_green() {
        let seen = |state, certainty, distance| Some(SeenLight { state, distance, certainty });
        let mut lights = SeenLights::default();
        let mut stops = |seen, speed| lights.update(seen, speed, 0.1, |_| true).map(|light| light.stops());
        let comes = (0..20).map(|n| seen(SignalState::Red, 0.8, 24.0 - 0.5 * f64::from(n)));
        assert!(comes.map(|seen| stops(seen, 5.0)).last() == Some(Some(true)));
        let beside = seen(SignalState::GreenMajor, 0.3, 14.5);
        assert!((0..400).all(|n| stops(beside.filter(|_| n % 3 > 0), 0.0) == Some(true)));
        // Whoever stands in front goes.
        let own = seen(SignalState::GreenMajor, 0.7, 14.5);
        assert!((0..5).any(|_| stops(own, 0.5) == Some(false)));
        // Who moves and sees none has none.
        assert!((0..10).any(|_| stops(None, 1.0).is_none()));
    }

    #[test]
    fn another_lamp_is_believed_when_it_stays() {
        let seen = |state, certainty| Some(SeenLight { state, distance: 16.0, certainty });
        let (red, green) = (seen(SignalState::Red, 0.8), seen(SignalState::GreenMajor, 0.8));
        let mut lights = SeenLights::default();
        let mut stops = |seen| lights.update(seen, 0.0, 0.1, |_| true).is_some_and(|light| light.stops());
        assert!(!stops(red) && (0..20).all(|_| stops(red)));
        assert!((0..5).all(|_| stops(seen(SignalState::GreenMajor, 0.3)) && stops(red)), "unsure");
        assert!((0..20).all(|_| stops(red)));
        assert!(stops(green) && stops(green) && stops(None), "a moment");
        assert!((0..20).all(|_| stops(red)));
        let ticks = (0..20).take_while(|_| stops(green)).count();
        assert!((2..5).contains(&ticks), "{ticks}");
        assert!((0..20).map(|_| stops(red)).last() == Some(true));
    }

    #[test]
    fn red_and_yellow_say_the_same_when_they_are_told_apart_badly() {
        let seen = |state, certainty| Some(SeenLight { state, distance: 35.0, certainty });
        let mut lights = SeenLights::default();
        let mut state = |seen| lights.update(seen, 0.0, 0.1, |_| true).map(|light| light.state);
        assert!((0..20).filter_map(|_| state(seen(SignalState::GreenMajor, 0.7))).count() > 15);
        let stops = [(SignalState::Red, 0.4), (SignalState::Yellow, 0.56)];
        let ticks = (0..20).take_while(|n| {
            let (lamp, certainty) = stops[n % 2];
            state(seen(lamp, certainty)) == Some(SignalState::GreenMajor)
        });
        assert!(ticks.count() < 4);
    }

    #[test]
    fn what_is_seen_from_near_counts_more_than_what_was_seen_from_afar() {
        let seen = |distance| Some(SeenLight { state: SignalState::Red, distance, certainty: 0.8 });
        let mut lights = SeenLights::default();
        // Taken to be a fifth too near from 60 to 30 m, then rightly seen.
        let mut there = |true_one: f64| {
            let shown = if true_one > 30.0 { 0.8 * true_one } else { true_one };
            lights.update(seen(shown), 10.0, 0.1, |_| true).map(|light| light.distance + STAND)
        };
        let ends =
            (0..45).map(|n| 60.0 - f64::from(n)).filter_map(|d| there(d).map(|found| found - d)).last();
        assert!(ends.is_some_and(|error| error.abs() < 0.7), "{ends:?}");
    }

    #[test]
    fn a_faint_green_is_believed_only_below_the_heads() {
        let seen = |state, certainty, distance| Some(SeenLight { state, distance, certainty });
        let went = |from: f64| {
            let mut lights = SeenLights::default();
            for n in 0..80 {
                let distance = from + 8.0 - 0.1 * f64::from(n);
                lights.update(seen(SignalState::Red, 0.8, distance), 1.0, 0.1, |_| true);
            }
            let mut goes = |state, certainty| {
                lights
                    .update(seen(state, certainty, from), 0.0, 0.1, |_| true)
                    .is_some_and(|light| !light.stops())
            };
            assert!(!(0..30).any(|_| goes(SignalState::Red, 0.3)));
            let faint = (0..30).any(|_| goes(SignalState::GreenMajor, 0.3));
            (faint, (0..5).any(|_| goes(SignalState::GreenMajor, 0.6)))
        };
        assert_eq!(went(6.5), (false, true), "the ego's own heads are in the picture");
        assert_eq!(went(3.5), (true, true));
    }

    #[test]
    fn another_light_has_to_be_seen_for_a_while() {
        let seen = |state, distance| Some(SeenLight { state, distance, certainty: 0.8 });
        let (near, far) = (seen(SignalState::Red, 14.0), seen(SignalState::GreenMajor, 30.0));
        let mut lights = SeenLights::default();
        let mut stops = |seen| lights.update(seen, 0.0, 0.1, |_| true).is_some_and(|light| light.stops());
        assert!(!stops(near) && (0..20).all(|_| stops(near)));
        assert!(stops(far) && stops(near) && stops(far) && stops(None) && stops(near));
        assert!((0..20).map(|_| stops(far)).last() == Some(false));
        // What appears at once in front of the ego has to be seen longer, and is not remembered for long.
        let mut lights = SeenLights::default();
        let sudden = seen(SignalState::Red, 9.0);
        assert!((0..2).all(|_| lights.update(sudden, 0.0, 0.1, |_| true).is_none()));
        assert!(lights.update(sudden, 0.0, 0.1, |_| true).is_some());
        assert!((0..60).map(|_| lights.update(None, 0.0, 0.1, |_| true)).last() == Some(None));
        // A light that was hardly seen is not waited for.
        let mut lights = SeenLights::default();
        lights.update(
            Some(SeenLight { state: SignalState::Red, distance: 3.0, certainty: 0.4 }),
            0.0,
            0.1,
            |_| true,
        );
        assert!((0..60).map(|_| lights.update(None, 0.0, 0.1, |_| true)).last() == Some(None));
    }

    #[test]
    fn who_crosses_the_line_on_green_is_not_stopped() {
        let seen = |state, distance| Some(SeenLight { state, distance, certainty: 0.8 });
        let mut lights = SeenLights::default();
        let mut stops = |seen| lights.update(seen, 5.0, 0.1, |_| true).is_some_and(|light| light.stops());
        assert!((0..20).all(|n| !stops(seen(SignalState::GreenMajor, 12.0 - 0.5 * f64::from(n)))));
        assert!((0..15).all(|_| !stops(seen(SignalState::Red, 2.2))));
        // Nor by heads across the junction, once its own are above the picture.
        let mut lights = SeenLights::default();
        let mut stops = |state, distance, certainty| {
            let seen = Some(SeenLight { state, distance, certainty });
            lights.update(seen, 3.0, 0.1, |_| true).is_some_and(|light| light.stops())
        };
        assert!((0..10).all(|n| !stops(SignalState::GreenMajor, 8.0 - 0.3 * f64::from(n), 0.7)));
        assert!((10..15).all(|n| !stops(SignalState::Red, 8.0 - 0.3 * f64::from(n), 0.8)));
    }

    #[test]
    fn who_crosses_on_yellow_is_not_stopped_by_the_red_that_follows() {
        let seen = |state, distance| Some(SeenLight { state, distance, certainty: 0.8 });
        let mut lights = SeenLights::default();
        lights.update(seen(SignalState::Yellow, 17.0), 9.0, 0.1, |_| true);
        let mut shows =
            |state, distance| lights.update(seen(state, distance), 9.0, 0.1, |_| true).unwrap().state;
        assert!(
            (1..12).all(|n| shows(SignalState::Yellow, 17.0 - 0.9 * f64::from(n)) == SignalState::Yellow)
        );
        assert!((12..19).all(|n| shows(SignalState::Red, 17.0 - 0.9 * f64::from(n)) == SignalState::Yellow));
    }

    #[test]
    fn a_light_is_where_the_route_enters_a_junction() {
        let road = Road::new("GGG");
        let is_light = |before: f64, distance: f64| {
            can_be(&road.facts(road.route.links[0].stop_s - before - 0.5 * LENGTH, 0.0, 0.0, 5.0), distance)
        };
        assert!(is_light(20.0, 20.0) && is_light(20.0, 14.0), "a network's error");
        assert!(!is_light(20.0, 9.0) && !is_light(20.0, 40.0));
        assert!(is_light(0.1, 1.0), "who stands at the line");
        assert!(!is_light(-0.1, 1.0), "its front has passed the line, though that seems to be ahead");
        assert!(!is_light(-4.0, 2.0) && !is_light(-4.0, 10.0), "inside the junction");
        // One that was believed is forgotten there.
        let seen = Some(SeenLight { state: SignalState::Red, distance: 10.0, certainty: 0.9 });
        let mut lights = SeenLights::default();
        assert!((0..5).filter_map(|_| lights.update(seen, 0.0, 0.1, |_| true)).last().is_some());
        assert!((0..50).all(|_| lights.update(seen, 0.0, 0.1, |_| false).is_none()));
    }

    #[test]
    fn who_stands_learns_nothing_new_of_the_distance() {
        let seen = |distance, certainty| Some(SeenLight { state: SignalState::Red, distance, certainty });
        let mut lights = SeenLights::default();
        assert!(lights.update(seen(12.0, 0.8), 0.0, 0.1, |_| true).is_none());
        let mut there = |seen, speed| lights.update(seen, speed, 0.1, |_| true).unwrap().distance + STAND;
        assert!((0..8).all(|n| {
            let true_one = 12.0 - 0.4 * f64::from(n);
            (there(seen(true_one, 0.8), if n == 0 { 0.0 } else { 4.0 }) - true_one).abs() < 1e-6
        }));
        // As by a far head.
        assert!((0..50).all(|_| (there(seen(11.0, 0.4), 0.1) - 9.2).abs() < 0.6));
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
