//! `replay --detector`: looks at the recorded states again, and tells what is seen beside what is there.

use super::Exit;
use serde::Serialize;
use std::sync::Arc;
use wad_cosim::assets::Assets;
use wad_cosim::camera::Outputs;
use wad_cosim::eval::kept::Kept;
use wad_cosim::eyes::Eyes;
use wad_cosim::network::{Network, Route};
use wad_cosim::observation::LeadState;
use wad_cosim::perception::{self, EgoFacts, LightAhead, sight_score};
use wad_cosim::replay::{Frame, Recording};

/// Farther (m) from where its route has it, the ego drives another route: recordings of older builds do not tell where one that
/// has no end goes on.
const ASTRAY: f64 = 1.0;

/// What is seen, and what is there.
#[derive(Clone, Copy, Debug, Serialize)]
struct Both<T> {
    seen: Option<T>,
    there: Option<T>,
}

/// What was seen in a tick.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Row {
    tick: u64,
    speed_mps: f64,
    /// Who is in front.
    lead: Both<LeadState>,
    /// Who will cross the path where the ego has to give way.
    crossing: Both<LeadState>,
    light: Both<LightAhead>,
}

impl Row {
    /// The names above the rows.
    pub fn heads() -> String {
        let pair = format!("{:>13} {:>13}", "seen", "there");
        format!(
            "{:>7} {:>5}   {:^27}   {:^27}   {:^27}\n{:>7} {:>5}   {pair}   {pair}   {pair}",
            "", "", "in front: m, m/s", "will cross: m, m/s", "light: m", "tick", "km/h"
        )
    }
}

impl std::fmt::Display for Row {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let lead = |state: Option<LeadState>| {
            state.map_or("-".into(), |lead| format!("{:.1} {:+.1}", lead.gap, -lead.closing_speed))
        };
        let light = |light: Option<LightAhead>| {
            light.map_or("-".into(), |light| format!("{:?} {:.0}", light.state, light.distance))
        };
        write!(f, "{:>7} {:>5.1}", self.tick, 3.6 * self.speed_mps)?;
        for both in [self.lead, self.crossing] {
            write!(f, "   {:>13} {:>13}", lead(both.seen), lead(both.there))?;
        }
        write!(f, "   {:>13} {:>13}", light(self.light.seen), light(self.light.there))
    }
}

/// Looks at recorded states.
pub struct Looker {
    eyes: Eyes,
    network: Arc<Network>,
    route: Route,
    /// The ego's length (m).
    length: f64,
    /// Between states (s).
    tick: f64,
}

impl Looker {
    /// Looks through the detector of that name at the episode `kept`.
    ///
    /// # Errors
    /// No such detector, or the episode's route is not in the town as it is now.
    pub fn new(kept: &Kept, recording: &Recording, assets: &Assets, detector: &str) -> anyhow::Result<Self> {
        let detector = perception::detector(detector, perception::LeastScore::Usual)
            .map_err(|e| Exit::Input.because(e))?;
        let route = kept.route(recording, assets.network()).map_err(|e| Exit::Input.because(e))?;
        let camera = kept.options.camera;
        let eyes = Eyes::new(assets.town(), camera, detector).map_err(|e| Exit::Input.because(e))?;
        let eyes = eyes.with_mirrors(kept.options.mirrors).map_err(|e| Exit::Input.because(e))?;
        let mut eyes = eyes.with_outputs(Outputs { boxes: true, ..Outputs::RGB });
        let header = recording.header();
        eyes.reset(header.weather, kept.episode.episode_seed);
        let (network, length) = (Arc::clone(assets.network()), header.ego.length);
        Ok(Self { eyes, network, route, length, tick: header.tick_ms / 1000.0 })
    }

    /// What sees.
    pub fn eyes(&self) -> &Eyes {
        &self.eyes
    }

    /// The world moves on, unseen.
    pub fn follow(&mut self, frame: &Frame) {
        self.eyes.follow(&frame.world);
    }

    /// Looks at the state that it was led to; None where the ego is on another route than the recording tells.
    ///
    /// # Errors
    /// A stage of perception fails.
    pub fn look(&mut self, frame: &Frame) -> anyhow::Result<Option<Row>> {
        let here = self.route.at(frame.s.min(self.route.length())).pose.xy();
        if (here - frame.ego.pose.xy()).norm() > frame.d.abs() + ASTRAY {
            return Ok(None);
        }
        let facts = EgoFacts {
            network: &self.network,
            route: &self.route,
            on_route: frame.on_route(self.length),
            length: self.length,
            signals: &frame.world.traffic_lights,
            tick: self.tick,
        };
        self.eyes.look(&facts)?;
        let (Some(picture), Some(percept)) = (self.eyes.frame(), self.eyes.percept()) else {
            return Ok(None);
        };
        Ok(Some(Row {
            tick: frame.tick,
            speed_mps: frame.ego.speed,
            lead: Both { seen: percept.lead, there: sight_score::in_front(&facts, &frame.world, picture) },
            crossing: Both {
                seen: percept.crossing,
                there: sight_score::who_crosses(&facts, &frame.world, picture).0,
            },
            light: Both { seen: percept.light, there: LightAhead::find(&facts) },
        }))
    }
}
