//! Kept episodes: a folder with `episode.json` and the recorded states, for `replay`.

use super::{Case, EpisodeRecord};
use crate::env::{EnvOptions, Fleet};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use sumo_network::network::{Network, Route};
use wad_sim::bridge::Ego;
use wad_sim::criteria::Event;
use wad_sim::replay::{self, Body, Header, Moment, Recorder, Recording, ReplayError};
use wad_sim::tasks::TaskError;
use wad_sim::telemetry::{WriteError, pretty_json, write_whole};
use wad_vehicle::Control;

/// `episode.json`: everything that is needed to drive the episode again.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Kept {
    /// The program's version.
    pub build: String,
    /// Hash of the town's net.
    pub net: String,
    /// The environment's options.
    pub options: EnvOptions,
    /// All episodes that were driven in its SUMO, its own among them; empty where it was driven alone.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub group: Vec<Case>,
    /// The episode's result.
    pub episode: EpisodeRecord,
}

/// Why a kept episode cannot be read or driven again.
#[derive(Debug, thiserror::Error)]
pub enum KeptError {
    /// A file cannot be read or written.
    #[error("cannot {what} {}: {source}", path.display())]
    File {
        /// The action that failed.
        what: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// The folder is not a kept episode.
    #[error("{} is not a kept episode: {why}; expected a folder that `eval` keeps of a failure", path.display())]
    Format {
        /// The file or folder.
        path: PathBuf,
        /// The cause.
        why: String,
    },
    /// The recording cannot be read.
    #[error(transparent)]
    Replay(#[from] ReplayError),
}

const FILE: &str = "episode.json";

impl Kept {
    /// The folder's files, to be written here or elsewhere.
    ///
    /// # Errors
    /// The episode cannot be said in JSON.
    pub fn pack(&self, recorder: &Recorder) -> Result<Packed, KeptError> {
        let episode = pretty_json(self).map_err(|source| KeptError::File {
            what: "make",
            path: FILE.into(),
            source,
        })?;
        Ok(Packed { episode, states: recorder.bytes() })
    }

    /// The ego's route to its end: the episode's, with what it was lengthened to while it was driven.
    ///
    /// # Errors
    /// A place of it is not on this net.
    pub fn route(&self, recording: &Recording, network: &Network) -> Result<Route, TaskError> {
        let mut route = self.episode.placement.route(network)?;
        for spot in recording.frames().iter().flat_map(|frame| &frame.onward) {
            network.extend_route(&mut route, spot.on(network)?)?;
        }
        Ok(route)
    }

    /// Reads the folder.
    ///
    /// # Errors
    /// It is not a kept episode, or cannot be read.
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

/// The files of a kept episode: the machine that drives it need not be the one that keeps it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Packed {
    /// `episode.json`.
    pub episode: Vec<u8>,
    /// `states.jsonl.gz`.
    pub states: Vec<u8>,
}

impl Packed {
    /// Writes the folder, each file whole or not at all.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn write(&self, folder: &Path) -> Result<(), KeptError> {
        let file = |what, path, source| KeptError::File { what, path, source };
        std::fs::create_dir_all(folder).map_err(|source| file("make", folder.to_path_buf(), source))?;
        for (name, bytes) in [(replay::FILE, &self.states), (FILE, &self.episode)] {
            let failed = |e: WriteError| file("write", e.path, e.source);
            write_whole(&folder.join(name), bytes).map_err(failed)?;
        }
        Ok(())
    }
}

/// Metres between the points of a recorded route.
const ROUTE_STEP: f64 = 5.0;

/// The recording's header for an episode that has just begun.
pub(super) fn header(fleet: &Fleet, ego: usize, case: &Case) -> Header {
    let (assets, options) = (fleet.assets(), fleet.options());
    let body = Body::of(&options.ego);
    let mut header = Header::new(&case.town, assets.name(), options.tick_ms, case.spec.weather, body);
    if let Some(route) = fleet.ego(ego).map(|ego| ego.route()) {
        let points = (route.length() / ROUTE_STEP).ceil() as usize;
        header.route = (0..=points)
            .map(|i| route.at((i as f64 * ROUTE_STEP).min(route.length())).pose.xy())
            .map(|p| [p.x, p.y].map(|x| (x * 100.0).round() / 100.0))
            .collect();
    }
    header.lights = assets.network().traffic_lights.iter().map(|light| light.id.clone()).collect();
    header
}

/// Calls `then` with the current state of an ego.
pub(super) fn with_moment(
    ego: Option<&Ego>,
    tick: u64,
    control: Control,
    events: &[Event],
    then: impl FnOnce(&Moment<'_>),
) {
    let Some(ego) = ego else { return };
    let at = ego.on_route();
    then(&Moment {
        tick,
        control,
        ego: &at.state,
        s: at.s,
        d: at.d,
        destinations: &ego.route().destinations,
        world: ego.world(),
        events,
    });
}
