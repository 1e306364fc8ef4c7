//! One ego's part of a world: its eyes, its episode, and what its task changed in the town.

use super::episode::{Episode, nowhere};
use super::green::Held;
use super::{EnvError, EnvOptions, Info};
use crate::reward::{self, RewardTerms};
use std::time::Instant;
use sumo_network::network::Network;
use wad_see::eyes::{Eyes, LookTimes};
use wad_see::perception::EgoFacts;
use wad_sim::bridge::Ego;
use wad_sim::destination::Destinations;
use wad_sim::end::{End, judge_limit};
use wad_sim::session::Tick;
use wad_sim::tasks::{Placement, TaskSpec};
use wad_vehicle::Control;

/// SUMO's id of the first ego; the others have their number behind it.
pub const FIRST: &str = "ego";

/// SUMO's id of ego number `index`: `ego`, `ego2`, ...
pub fn ego_id(index: usize) -> String {
    if index == 0 { FIRST.to_string() } else { format!("{FIRST}{}", index + 1) }
}

/// Whether SUMO's vehicle `id` is an ego of a fleet.
pub fn is_ego(id: &str) -> bool {
    id.strip_prefix(FIRST).is_some_and(|number| number.bytes().all(|b| b.is_ascii_digit()))
}

/// The result of a tick for one ego.
#[derive(Clone, Debug)]
pub struct Outcome {
    pub control: Control,
    pub reward: f64,
    pub terminated: bool,
    pub truncated: bool,
    pub info: Info,
}

/// What every ego's tick is judged with.
pub struct Judge<'a> {
    pub options: &'a EnvOptions,
    pub network: &'a Network,
    /// SUMO's clock (s).
    pub time: f64,
    /// Background vehicles and pedestrians.
    pub traffic: (usize, usize),
}

pub struct Slot {
    eyes: Eyes,
    episode: Option<Episode>,
    /// Draws the further destinations of a route that never ends.
    onward: Option<Destinations>,
    /// The last episode's obstacle is still there.
    pub obstacle: bool,
    /// Lights held at green by the last task.
    pub held: Held,
}

impl Slot {
    pub fn new(eyes: Eyes) -> Self {
        Self { eyes, episode: None, onward: None, obstacle: false, held: Held::default() }
    }

    pub fn eyes(&self) -> &Eyes {
        &self.eyes
    }

    pub fn placement(&self) -> Option<&Placement> {
        self.episode.as_ref().map(|episode| &episode.placement)
    }

    pub fn task(&self) -> Option<&TaskSpec> {
        self.episode.as_ref().map(|episode| &episode.task)
    }

    pub fn is_running(&self) -> bool {
        self.episode.as_ref().is_some_and(|episode| !episode.over)
    }

    /// Its SUMO is gone.
    pub fn moved_out(&mut self) {
        (self.obstacle, self.held) = Default::default();
    }

    /// Ends the episode without an outcome; where it took place is still known.
    pub fn give_up(&mut self) {
        if let Some(episode) = &mut self.episode {
            episode.over = true;
        }
    }

    /// Ends the episode without an outcome.
    pub fn forget(&mut self) {
        self.episode = None;
    }

    pub fn begin(&mut self, episode: Episode, onward: Option<Destinations>, seed: u64) {
        self.eyes.reset(episode.task.weather, seed);
        (self.episode, self.onward) = (Some(episode), onward);
    }

    pub fn look(&mut self, network: &Network, ego: &Ego, tick: f64) -> Result<LookTimes, EnvError> {
        let clock = Instant::now();
        self.eyes.follow(ego.world());
        let followed = clock.elapsed().as_secs_f64();
        self.eyes.look(&EgoFacts::of(network, ego, tick))?;
        let times = self.eyes.times();
        Ok(LookTimes { camera: times.camera + followed, ..times })
    }

    /// A tick of the episode has passed.
    pub fn count(&mut self) {
        if let Some(episode) = &mut self.episode {
            episode.tick += 1;
        }
    }

    /// What the tick brought, after the look.
    pub fn outcome(&mut self, judge: &Judge<'_>, ego: &Ego, tick: Tick) -> Outcome {
        let mut info = Info {
            tick: 0,
            time: judge.time,
            reward: RewardTerms::default(),
            events: tick.events,
            ending: None,
            raw: *self.eyes.raw(),
            ego: tick.after.state,
            driven: tick.after.s,
            route_length: ego.route().length(),
            traffic: judge.traffic,
        };
        let waiting =
            |info| Outcome { control: tick.control, reward: 0.0, terminated: false, truncated: false, info };
        let Some(episode) = self.episode.as_mut().filter(|episode| !episode.over) else {
            return waiting(info);
        };
        info.tick = episode.tick;
        // It has just been placed.
        if episode.tick == 0 {
            return waiting(info);
        }
        info.ending = match judge.options.termination.decide(&info.events) {
            Some((end, cause)) => Some(episode.ending(end, cause)),
            None if episode.tick >= episode.limit => {
                let kind = episode.task.kind;
                Some(judge_limit(kind, &episode.placement, episode.tick, judge.network, ego))
            }
            None => None,
        };
        let params = &judge.options.reward;
        let facts = episode.facts(params, ego, &self.eyes, &tick.control, &info.events, info.ending.as_ref());
        info.reward = reward::compute(params, &facts);
        let terminated = info.ending.as_ref().is_some_and(|ending| ending.end.is_terminal());
        episode.over = info.ending.is_some();
        Outcome {
            control: tick.control,
            reward: info.reward.total(),
            terminated,
            truncated: episode.over && !terminated,
            info,
        }
    }

    /// SUMO died at `time` (s), `why`.
    pub fn lost(&mut self, ego: Option<&Ego>, time: f64, why: &str) -> Outcome {
        let running = self.is_running();
        let (tick, ending) =
            self.episode.as_mut().filter(|episode| !episode.over).map_or((0, None), |episode| {
                episode.over = true;
                episode.tick += 1;
                (episode.tick, Some(episode.ending(End::Error, why.to_string())))
            });
        Outcome {
            control: Control::default(),
            reward: 0.0,
            terminated: false,
            truncated: running,
            info: Info {
                tick,
                time,
                reward: RewardTerms::default(),
                events: Vec::new(),
                ending,
                raw: *self.eyes.raw(),
                ego: ego.map_or_else(nowhere, Ego::state),
                driven: ego.map_or(0.0, |ego| ego.on_route().s),
                route_length: ego.map_or(0.0, |ego| ego.route().length()),
                traffic: (0, 0),
            },
        }
    }

    /// Lengthens a route that never ends, before its end comes into view ([`Destinations::lead_on`]); a place that is
    /// too near or out of reach is made good in the next tick.
    pub fn go_onward(&mut self, network: &Network, ego: &mut Ego) {
        let Some(places) = &mut self.onward else { return };
        let (route, s) = (ego.route(), ego.on_route().s);
        if let Some(longer) = places.lead_on(network, route, s) {
            ego.set_route(longer, s);
        }
    }
}
