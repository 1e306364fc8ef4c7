//! What a run is asked for, and why it cannot be.

use crate::agent::AgentError;
use crate::driver::PilotRecord;
use crate::one::{is_one, one};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use wad_see::eyes::EyesError;
use wad_sim::assets::AssetsError;
use wad_sim::autopilot::AutopilotParams;
use wad_sim::bridge::{BridgeError, BridgeOptions};
use wad_sim::criteria::CriteriaParams;
use wad_sim::destination::DestinationError;
use wad_sim::session::{APART, ItineraryError};
use wad_sim::telemetry::{FolderError, WriteError};
use wad_sim::traffic::TrafficSpec;
use wad_vehicle::EgoParams;

/// A run's options; saved as its `config.json`.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct DriveOptions {
    /// SUMO, town, traffic and ticks.
    pub bridge: BridgeOptions,
    /// `FROM,TO` of the first ego's first route; None: drawn from the seed.
    pub route: Option<String>,
    /// The number of egos; set by [`Drive::start_in`](crate::drive::Drive::start_in).
    #[serde(default = "one", skip_serializing_if = "is_one")]
    pub egos: usize,
    /// The ego's physics.
    pub ego: EgoParams,
    /// The autopilot's constants.
    pub autopilot: AutopilotParams,
    /// Thresholds of the events.
    pub criteria: CriteriaParams,
    /// The run's folder.
    pub out: PathBuf,
}

impl DriveOptions {
    /// The defaults: a route drawn from the seed, into the folder `out`.
    pub fn new(bridge: BridgeOptions, out: PathBuf) -> Self {
        Self {
            bridge,
            route: None,
            egos: one(),
            ego: Default::default(),
            autopilot: Default::default(),
            criteria: Default::default(),
            out,
        }
    }

    /// Options of a drive without results: all its files go into the folder `scratch`.
    pub fn passing(config: PathBuf, seed: u64, traffic: TrafficSpec, scratch: &Path) -> Self {
        let bridge = BridgeOptions { seed, traffic, ..BridgeOptions::new(config, scratch.join("sumo")) };
        Self::new(bridge, scratch.join("run"))
    }
}

/// Why a run could not start or go on.
#[derive(Debug, thiserror::Error)]
pub enum DriveError {
    /// SUMO or the bridge fail.
    #[error(transparent)]
    Bridge(#[from] BridgeError),
    /// There is no route.
    #[error(transparent)]
    Destination(#[from] DestinationError),
    /// The run folder cannot be made.
    #[error(transparent)]
    Folder(#[from] FolderError),
    /// Telemetry or summary cannot be written.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// The town cannot be read.
    #[error(transparent)]
    Assets(#[from] AssetsError),
    /// The agent fails.
    #[error(transparent)]
    Agent(#[from] AgentError),
    /// Camera or perception fail.
    #[error(transparent)]
    Eyes(#[from] EyesError),
    /// More egos than the town has room for.
    #[error(
        "{town} has room for {fit} egos, {APART} m apart, not for {egos}: ask for {fit} or fewer, or for a larger town"
    )]
    Crowded {
        /// The town.
        town: String,
        /// How many were placed.
        fit: usize,
        /// How many were asked for.
        egos: usize,
    },
    /// A scenario is written for one ego.
    #[error("a scenario has one ego, found {egos}: leave the number of egos out, or drive in a town")]
    Scenario {
        /// How many were asked for.
        egos: usize,
    },
}

impl DriveError {
    /// Whether the user's input is wrong, not this machine or SUMO.
    pub fn is_input(&self) -> bool {
        match self {
            Self::Bridge(error) => error.is_input(),
            Self::Assets(error) => error.is_input(),
            Self::Destination(_)
            | Self::Crowded { .. }
            | Self::Scenario { .. }
            | Self::Folder(FolderError::Taken { .. }) => true,
            _ => false,
        }
    }

    /// Whether SUMO failed.
    pub fn is_sumo(&self) -> bool {
        match self {
            Self::Bridge(error) => error.is_sumo(),
            Self::Assets(error) => !error.is_input(),
            _ => false,
        }
    }
}

impl From<ItineraryError> for DriveError {
    fn from(error: ItineraryError) -> Self {
        match error {
            ItineraryError::Bridge(error) => error.into(),
            ItineraryError::Destination(error) => error.into(),
        }
    }
}

/// The contents of `config.json`.
#[derive(Serialize)]
pub(super) struct RunConfig<'a> {
    #[serde(flatten)]
    pub options: &'a DriveOptions,
    /// The driver; None for the autopilot.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub driver: Option<&'a PilotRecord>,
}
