//! The environment's options; saved with every result.

use crate::reward::RewardParams;
use rand::RngExt;
use serde::{Deserialize, Serialize};
use sumo_network::seeds;
use wad_camera::CameraConfig;
use wad_see::observation::ObservationMode;
use wad_sim::bridge::Fetch;
use wad_sim::criteria::CriteriaParams;
use wad_sim::end::Termination;
use wad_vehicle::EgoParams;

/// What happens to SUMO between episodes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum WorldMode {
    /// A new SUMO per episode: reproducible from task and seed alone. For evaluation.
    #[default]
    Fresh,
    /// SUMO and its traffic run on; the ego moves to another free place. For training.
    Running,
}

/// Random displacement of the ego at the start, drawn from the seed, uniformly to both sides. Without it, a
/// blind driver could follow a straight road by luck.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StartOffset {
    /// Most distance from the lane's middle (m). Default 0.25.
    pub lateral: f64,
    /// Most deviation from the lane's heading (degrees). Default 2.5.
    pub heading_deg: f64,
}

impl Default for StartOffset {
    fn default() -> Self {
        Self { lateral: 0.25, heading_deg: 2.5 }
    }
}

impl StartOffset {
    /// To the left (m), and turned to the left (rad).
    pub fn draw(&self, seed: u64) -> (f64, f64) {
        let mut rng = seeds::rng(seed, "start");
        let mut even = |most: f64| if most > 0.0 { rng.random_range(-most..most) } else { 0.0 };
        (even(self.lateral), even(self.heading_deg.to_radians()))
    }
}

/// An environment's options.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EnvOptions {
    /// SUMO's life between episodes.
    pub world: WorldMode,
    /// Parts of the observation to compute.
    pub observation: ObservationMode,
    /// Detector by name, e.g. `truth`.
    pub detector: String,
    /// The expert goes by the light that the detector believes, not by SUMO's: so that it shows an agent nothing that the agent
    /// cannot see. Default false.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub told_expert: bool,
    /// The expert also follows whom the agent is told of as the vehicle in front, seen or foretold, though it may see that
    /// nobody is there. Default false.
    pub told_lead: bool,
    /// Cameras in place of the door mirrors look back before a change of lane, and who is there counts as the vehicle in front.
    /// Default false: the paper has a front camera alone.
    pub mirrors: bool,
    /// The front camera.
    pub camera: CameraConfig,
    /// Tick length (ms). Default 167, the paper's six a second.
    pub tick_ms: f64,
    /// Radius of the ego's world (m). Default 100.
    pub sight: f64,
    /// How the road users in sight are fetched.
    #[serde(skip_serializing_if = "is_auto")]
    pub fetch: Fetch,
    /// The ego's physics.
    pub ego: EgoParams,
    /// Random displacement of the ego at the start.
    pub start: StartOffset,
    /// Thresholds of the events.
    pub criteria: CriteriaParams,
    /// Which events end an episode.
    pub termination: Termination,
    /// The reward's constants.
    pub reward: RewardParams,
    /// In [`WorldMode::Running`]: episodes after which a reset starts SUMO again, so that jams dissolve and the
    /// traffic's seed changes. Default 200. A fleet's egos begin anew without a reset: its SUMO runs on.
    pub episodes_per_sumo: u64,
    /// Longest time a tick may take before SUMO counts as hung (s). Default 60.
    pub tick_timeout: f64,
    /// Show SUMO's window. It does not change the simulation, so it is not saved with results.
    #[serde(skip)]
    pub gui: bool,
}

fn is_auto(fetch: &Fetch) -> bool {
    *fetch == Fetch::Auto
}

impl Default for EnvOptions {
    fn default() -> Self {
        Self {
            world: WorldMode::Fresh,
            observation: ObservationMode::default(),
            detector: "truth".to_string(),
            told_expert: false,
            told_lead: false,
            mirrors: false,
            camera: CameraConfig::default(),
            tick_ms: wad_sim::bridge::DEFAULT_TICK_MS,
            sight: 100.0,
            fetch: Fetch::Auto,
            ego: EgoParams::default(),
            start: StartOffset::default(),
            criteria: CriteriaParams::default(),
            termination: Termination::default(),
            reward: RewardParams::default(),
            episodes_per_sumo: 200,
            tick_timeout: 60.0,
            gui: false,
        }
    }
}

impl EnvOptions {
    /// By what agents see: the detector's name, `and mirrors` where there are some.
    pub fn sight_name(&self) -> String {
        let mirrors = if self.mirrors { " and mirrors" } else { "" };
        format!("{}{mirrors}", self.detector)
    }

    /// For evaluation: fresh worlds, the spec's thresholds.
    pub fn evaluation() -> Self {
        Self::default()
    }

    /// For training: running traffic, and standing without a reason ends an episode after 4 s, not 90: hard
    /// termination keeps an agent from learning for hours how to stand.
    pub fn training() -> Self {
        Self {
            world: WorldMode::Running,
            criteria: CriteriaParams { blocked_after: 4.0, ..CriteriaParams::default() },
            ..Self::default()
        }
    }
}
