//! Episodes that were kept to be seen again: a folder with `episode.json` and the recorded states.

use super::runner::make;
use super::{Case, DriverError, DriverSpec, EpisodeRecord, MakeAgent};
use crate::agent::AgentError;
use crate::env::{Assets, Env, EnvError, EnvOptions};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use wad_sim::assets::AssetsError;
use wad_sim::criteria::Event;
use wad_sim::replay::{self, Body, Frame, Header, Moment, Recorder, Recording, ReplayError, digest};
use wad_sim::session::Act;
use wad_sim::telemetry::write_json;
use wad_vehicle::Control;

/// `episode.json`: everything that is needed to drive it again.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Kept {
    /// The program's version, and [`Assets::net_hash`] of the town.
    pub build: String,
    pub net: String,
    pub options: EnvOptions,
    pub episode: EpisodeRecord,
}

/// Why a kept episode cannot be read or driven again.
#[derive(Debug, thiserror::Error)]
pub enum KeptError {
    #[error("cannot {what} {}: {source}", path.display())]
    File { what: &'static str, path: PathBuf, source: std::io::Error },
    #[error("{} is no kept episode: {why}; expected a folder as `eval` keeps of each failure", path.display())]
    Format { path: PathBuf, why: String },
    #[error(transparent)]
    Replay(#[from] ReplayError),
    #[error(transparent)]
    Env(#[from] EnvError),
    #[error(transparent)]
    Assets(#[from] AssetsError),
    #[error(transparent)]
    Driver(#[from] DriverError),
    #[error(transparent)]
    Agent(#[from] AgentError),
    #[error("{0}")]
    Eval(Box<super::EvalError>),
    #[error("the episode was driven on another net: {town} was {expected} then, and is {found} now")]
    OtherNet { town: String, expected: String, found: String },
}

const FILE: &str = "episode.json";

impl Kept {
    /// Writes the folder.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn save(&self, folder: &Path, recorder: &Recorder) -> Result<(), KeptError> {
        std::fs::create_dir_all(folder).map_err(|source| KeptError::File {
            what: "make",
            path: folder.to_path_buf(),
            source,
        })?;
        recorder.save(&folder.join(replay::FILE))?;
        write_json(&folder.join(FILE), self).map_err(|e| KeptError::File {
            what: "write",
            path: e.path,
            source: e.source,
        })
    }

    /// Reads the folder.
    ///
    /// # Errors
    /// It is none, or cannot be read.
    pub fn open(folder: &Path) -> Result<(Self, Recording), KeptError> {
        let path = folder.join(FILE);
        let text = std::fs::read_to_string(&path).map_err(|source| KeptError::File {
            what: "read",
            path: path.clone(),
            source,
        })?;
        let kept = serde_json::from_str(&text)
            .map_err(|e| KeptError::Format { path: folder.to_path_buf(), why: format!("{FILE}: {e}") })?;
        Ok((kept, Recording::open(folder)?))
    }
}

/// Metres between the points of a recorded route.
const ROUTE_STEP: f64 = 5.0;

/// The recording's header for an episode that has just begun.
pub(super) fn header(env: &Env, case: &Case) -> Header {
    let (assets, options) = (env.assets(), env.options());
    let body = Body::of(&options.ego);
    let mut header = Header::new(&case.town, assets.name(), options.tick_ms, case.spec.weather, body);
    if let Some(route) = env.ego().map(|ego| ego.route()) {
        let points = (route.length() / ROUTE_STEP).ceil() as usize;
        header.route = (0..=points)
            .map(|i| route.at((i as f64 * ROUTE_STEP).min(route.length())).pose.xy())
            .map(|p| [p.x, p.y].map(|x| (x * 100.0).round() / 100.0))
            .collect();
    }
    header.lights = assets.network().traffic_lights.iter().map(|light| light.id.clone()).collect();
    header
}

/// Calls `then` with the state that `env` is in.
pub(super) fn with_moment(
    env: &Env,
    tick: u64,
    control: Control,
    events: &[Event],
    then: impl FnOnce(&Moment<'_>),
) {
    let Some(ego) = env.ego() else { return };
    let at = ego.on_route();
    then(&Moment { tick, control, ego: &at.state, s: at.s, d: at.d, world: ego.world(), events });
}

/// Who drove when an episode was simulated again.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Driven {
    /// The agent itself.
    Agent,
    /// The controls that were recorded: an external agent need not be there any more.
    Recorded,
}

/// What a second simulation found.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Verdict {
    /// Ticks that were compared, the state before the first one too.
    pub ticks: u64,
    pub same: bool,
    /// The first tick that differs, and what of it.
    pub first_difference: Option<(u64, String)>,
    pub driven: Driven,
}

/// Simulates a kept episode again, tick by tick against its recording; `tick` hears of each, and ends it
/// early with false.
///
/// # Errors
/// The town is another one by now, or the environment or the agent cannot be made.
pub fn verify(
    kept: &Kept,
    recording: &Recording,
    make_agent: &MakeAgent<'_>,
    gui: bool,
    mut tick: impl FnMut(u64) -> bool,
) -> Result<Verdict, KeptError> {
    let case = &kept.episode.case;
    let assets = Assets::load(&case.town)?;
    if assets.net_hash() != kept.net {
        let (town, found) = (case.town.clone(), assets.net_hash().to_string());
        return Err(KeptError::OtherNet { town, expected: kept.net.clone(), found });
    }
    let options = EnvOptions { gui, ..kept.options.clone() };
    let external = matches!(case.agent, DriverSpec::Exec(_));
    // Blind: what an external agent saw is of no account where its controls are given.
    let spec = if external { DriverSpec::Random } else { case.agent.clone() };
    let (mut env, mut driver) =
        make(&assets, &options, &spec, make_agent).map_err(|e| KeptError::Eval(Box::new(e)))?;
    let driven = if external { Driven::Recorded } else { Driven::Agent };
    let mut verdict = Verdict { ticks: 0, same: true, first_difference: None, driven };
    env.reset(&case.spec, kept.episode.episode_seed)?;
    driver.reset(kept.episode.episode_seed);
    let frames = recording.frames();
    for (index, frame) in frames.iter().enumerate() {
        let (mut control, mut events) = (Control::default(), Vec::new());
        if index > 0 {
            let act = if external { Act::Control(frame.control) } else { driver.act(env.eyes())? };
            let step = env.act(act)?;
            (control, events) = (step.control, step.info.events);
            if step.info.ending.is_some() && index + 1 < frames.len() {
                verdict.same = false;
                verdict.first_difference.get_or_insert((frame.tick, "it ended earlier".to_string()));
                break;
            }
        }
        verdict.ticks += 1;
        with_moment(&env, frame.tick, control, &events, |now| {
            if digest(now) != frame.bits || now.events != frame.events {
                verdict.same = false;
                verdict.first_difference.get_or_insert_with(|| (frame.tick, difference(frame, now)));
            }
        });
        if !verdict.same || !tick(frame.tick) {
            break;
        }
    }
    Ok(verdict)
}

/// What of a state is another.
fn difference(frame: &Frame, now: &Moment<'_>) -> String {
    let (a, b) = (frame.ego.pose.position, now.ego.pose.position);
    if frame.control != now.control {
        format!("control: recorded {:?}, now {:?}", frame.control, now.control)
    } else if frame.ego != *now.ego {
        format!("the ego: recorded at {:.6}, {:.6}, now at {:.6}, {:.6}", a.x, a.y, b.x, b.y)
    } else if frame.events != now.events {
        format!("events: recorded {:?}, now {:?}", frame.events, now.events)
    } else {
        let count = |world: &sumo_network::world::WorldState| (world.vehicles.len(), world.pedestrians.len());
        format!(
            "those round the ego: recorded {:?} vehicles and pedestrians in sight, now {:?}",
            count(&frame.world),
            count(now.world)
        )
    }
}
