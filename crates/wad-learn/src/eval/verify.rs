//! Simulates a kept episode again, and compares it bit for bit with its recording.

use super::DriverSpec;
use super::kept::{Kept, with_moment};
use super::runner::{EvalError, MakeAgent, begin, make};
use crate::agent::AgentError;
use crate::env::{EnvError, EnvOptions};
use serde::Serialize;
use wad_sim::assets::{Assets, AssetsError};
use wad_sim::end::End;
use wad_sim::replay::{Frame, Moment, Recording, digest};
use wad_sim::session::Act;
use wad_vehicle::Control;

/// Why an episode cannot be simulated again.
#[derive(Debug, thiserror::Error)]
pub enum VerifyError {
    /// The town cannot be read.
    #[error(transparent)]
    Assets(#[from] AssetsError),
    /// The environment fails.
    #[error(transparent)]
    Env(#[from] EnvError),
    /// The agent cannot be made or fails.
    #[error(transparent)]
    Agent(#[from] AgentError),
    /// The episode cannot be driven.
    #[error(transparent)]
    Eval(#[from] EvalError),
    /// The town's net has changed since.
    #[error("the episode was driven on another net: expected {town} with hash {expected}, found {found}")]
    OtherNet {
        /// The town.
        town: String,
        /// Hash of the episode's net.
        expected: String,
        /// Hash of the town's net.
        found: String,
    },
    /// SUMO failed during the second simulation, so nothing is known about the ticks that follow.
    #[error("SUMO failed at tick {tick} while the episode was simulated again: {cause}")]
    Lost {
        /// The tick.
        tick: u64,
        /// How it failed.
        cause: String,
    },
    /// It was driven among external agents' egos, whose controls are not in its recording.
    #[error(
        "the episode was driven beside other egos of an external agent, whose controls are not in this recording; \
         `replay` without --verify shows it"
    )]
    Others,
    /// The recording has fewer ticks than the episode.
    #[error("the recording is cut short: expected {expected} ticks, found {found}")]
    Short {
        /// Ticks of the episode.
        expected: u64,
        /// Ticks of the recording.
        found: u64,
    },
}

/// The driver of an episode's second simulation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Driven {
    /// The agent itself.
    Agent,
    /// The recorded controls: an external agent may not be available any more.
    Recorded,
}

/// The result of a second simulation.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Verdict {
    /// Compared states, including the one before the first tick.
    pub ticks: u64,
    /// No tick differs.
    pub same: bool,
    /// The first tick that differs, and the difference.
    pub first_difference: Option<(u64, String)>,
    /// The driver of the second simulation.
    pub driven: Driven,
}

/// Simulates a kept episode again and compares it tick by tick with its recording; `tick` is called for each,
/// and returns false to end early.
///
/// # Errors
/// The town has changed since, or the environment or the agent cannot be made.
pub fn verify(
    kept: &Kept,
    recording: &Recording,
    make_agent: &MakeAgent<'_>,
    gui: bool,
    mut tick: impl FnMut(u64) -> bool,
) -> Result<Verdict, VerifyError> {
    let case = &kept.episode.case;
    let assets = Assets::load(&case.town)?;
    if assets.net_hash() != kept.net {
        let (town, found) = (case.town.clone(), assets.net_hash().to_string());
        return Err(VerifyError::OtherNet { town, expected: kept.net.clone(), found });
    }
    let (expected, found) = (kept.episode.ticks, recording.frames().last().map_or(0, |frame| frame.tick));
    // SUMO died in the last tick of an episode with a fault.
    if found < expected && kept.episode.fault.is_none() {
        return Err(VerifyError::Short { expected, found });
    }
    let options = EnvOptions { gui, ..kept.options.clone() };
    let external = matches!(case.agent, DriverSpec::Exec(_));
    // Blind: an external agent's observations do not matter if its controls are given.
    let spec = if external { DriverSpec::Random } else { case.agent.clone() };
    let alone = std::slice::from_ref(case);
    let group = if kept.group.is_empty() { alone } else { &kept.group };
    let ego = group.iter().position(|other| other == case).unwrap_or_default();
    let (mut fleet, mut drivers) = make(&assets, &options, &spec, group.len(), make_agent)?;
    let driven = if external { Driven::Recorded } else { Driven::Agent };
    if external && group.len() > 1 {
        return Err(VerifyError::Others);
    }
    let mut verdict = Verdict { ticks: 0, same: true, first_difference: None, driven };
    begin(&mut fleet, &mut drivers, group)?;
    let mut ended = vec![false; group.len()];
    let mut acts = vec![Act::Stay; group.len()];
    let frames = recording.frames();
    for (index, frame) in frames.iter().enumerate() {
        let (mut control, mut events) = (Control::default(), Vec::new());
        if index > 0 {
            for (other, act) in acts.iter_mut().enumerate().filter(|(other, _)| !ended[*other]) {
                *act = match external {
                    true => Act::Control(frame.control),
                    false => drivers[other].act(fleet.eyes(other))?,
                };
            }
            let step = fleet.step(&acts)?;
            for (other, info) in step.infos.iter().enumerate() {
                ended[other] |= info.ending.is_some();
            }
            let info = &step.infos[ego];
            (control, events) = (step.controls[ego], info.events.clone());
            if let Some(ending) = info.ending.as_ref().filter(|ending| ending.end == End::Error) {
                // With a recorded fault the recording may end here too.
                if kept.episode.fault.is_none() {
                    return Err(VerifyError::Lost { tick: frame.tick, cause: ending.cause.clone() });
                }
            }
            if info.ending.is_some() && index + 1 < frames.len() {
                verdict.same = false;
                verdict.first_difference.get_or_insert((frame.tick, "it ended earlier".to_string()));
                break;
            }
        }
        verdict.ticks += 1;
        with_moment(fleet.ego(ego), frame.tick, control, &events, |now| {
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

/// The difference between two states, if there is one.
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
            "traffic round the ego: recorded {:?} vehicles and pedestrians in sight, now {:?}",
            count(&frame.world),
            count(now.world)
        )
    }
}
