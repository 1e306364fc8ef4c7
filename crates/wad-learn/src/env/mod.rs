//! The environment: SUMO, the ego, the camera, perception and the encoder as `reset` and `step`.
//!
//! ```text
//! reset(task, seed) -> Observation
//! step(Control)     -> Step { observation, reward, terminated, truncated, info }
//! ```
//!
//! An [`Env`] is blocking: it has its own runtime, and the thread that steps it shares its core with SUMO, so step it
//! on one thread, or let a thread that has other work step it within a [`wad_sim::cores::Visit`]. Any number of them
//! run in parallel and share the town ([`Assets`]).
//!
//! ```no_run
//! # fn example() -> Result<(), Box<dyn std::error::Error>> {
//! use wad_learn::env::{Assets, Env, EnvOptions};
//! use wad_see::latent::PooledEncoder;
//! use wad_sim::tasks::{TaskKind, TaskSpec};
//! use wad_vehicle::Control;
//!
//! let assets = Assets::load("town3")?;
//! let mut env = Env::new(assets, EnvOptions::training(), Box::new(PooledEncoder::default()))?;
//! let observation = env.reset(&TaskSpec::new(TaskKind::Straight), 7)?;
//! assert_eq!(observation.concat().len(), 215);
//! loop {
//!     let step = env.step(Control { throttle: 0.4, ..Control::default() })?;
//!     if step.terminated || step.truncated {
//!         println!("{:?}", step.info.ending);
//!         break;
//!     }
//! }
//! # Ok(())
//! # }
//! ```
//!
//! **Transitions.** Store `terminated`, not `done`: a truncated episode still bootstraps. When SUMO dies
//! in the middle of an episode, `step` answers `truncated` with [`End::Error`], reward 0 and the last
//! observation; drop that transition, and call `reset`, which builds a new SUMO.

mod episode;
mod error;
mod fleet;
mod green;
mod obstacle;
mod options;
mod scratch;
mod slot;
mod world;

pub use error::EnvError;
pub use fleet::{Fleet, FleetStep};
pub use options::{EnvOptions, StartOffset, WorldMode};
pub use slot::{ego_id, is_ego};
pub use wad_see::observation::ObservationMode;
pub use wad_sim::assets::Assets;
pub use wad_sim::end::{End, Ending, Termination};

use crate::reward::RewardTerms;
use serde::{Deserialize, Serialize};
use slot::Outcome;
use std::sync::Arc;
use std::time::Duration;
use wad_see::eyes::{Eyes, LookTimes};
use wad_see::latent::Encoder;
use wad_see::observation::{Observation, RawState};
use wad_sim::criteria::Event;
use wad_sim::session::Act;
use wad_sim::tasks::{Placement, TaskSpec};
use wad_vehicle::{Control, EgoState};
use world::World;

/// The result of one control.
#[derive(Clone, Debug)]
pub struct Step {
    /// The observation after the tick.
    pub observation: Observation,
    /// The control that was driven.
    pub control: Control,
    /// Sum of `info.reward`.
    pub reward: f64,
    /// The ego ended the episode, e.g. by a collision: the value of the next state is 0.
    pub terminated: bool,
    /// The episode ended otherwise (arrival, the clock): the next state still has a value.
    pub truncated: bool,
    /// Details of the tick.
    pub info: Info,
}

/// Facts for logs, tables and people, never for the agent.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Info {
    /// Ticks of the episode so far.
    pub tick: u64,
    /// SUMO's clock (s).
    pub time: f64,
    /// The named reward terms.
    pub reward: RewardTerms,
    /// The tick's events.
    pub events: Vec<Event>,
    /// How the episode ended; None while it runs.
    pub ending: Option<Ending>,
    /// The six raw states by name, in units.
    pub raw: RawState,
    /// The ego's state.
    pub ego: EgoState,
    /// Way along the route since the start (m).
    pub driven: f64,
    /// The route's length (m).
    pub route_length: f64,
    /// Background vehicles and pedestrians in the net.
    pub traffic: (usize, usize),
}

/// Wall time of an environment by stage, summed over its life (s).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Stages {
    /// Number of steps.
    pub steps: u64,
    /// SUMO: message, step, decoding the new world.
    pub sumo: f64,
    /// The ego's physics.
    pub physics: f64,
    /// Rendering.
    pub camera: f64,
    /// Detection, lanes, painting, raw states.
    pub perception: f64,
    /// The encoder.
    pub encoder: f64,
    /// Number of resets.
    pub resets: u64,
    /// All resets.
    pub reset: f64,
}

/// One environment: see the module.
pub struct Env {
    runtime: tokio::runtime::Runtime,
    world: World,
}

impl Stages {
    fn looked(&mut self, times: &LookTimes) {
        self.camera += times.camera;
        self.perception += times.perception();
        self.encoder += times.encode;
    }
}

/// The environment's only ego.
const EGO: usize = 0;

impl Env {
    /// An environment in the town of `assets`. SUMO starts with the first reset.
    ///
    /// # Errors
    /// The detector or the camera cannot be made.
    pub fn new(
        assets: Arc<Assets>,
        options: EnvOptions,
        encoder: Box<dyn Encoder>,
    ) -> Result<Self, EnvError> {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .map_err(|source| EnvError::Runtime { source })?;
        Ok(Self { runtime, world: World::new(assets, options, vec![encoder])? })
    }

    /// Begins an episode of `task`; everything random (place, traffic, weather if several are
    /// given, the detector's faults) comes from `seed`. In [`WorldMode::Fresh`] equal calls give equal
    /// episodes bit for bit. A SUMO that died is replaced.
    ///
    /// # Errors
    /// The task cannot be placed on this net, or SUMO cannot be started.
    pub fn reset(&mut self, task: &TaskSpec, seed: u64) -> Result<Observation, EnvError> {
        self.runtime.block_on(self.world.reset(&[(task, seed)]))?;
        Ok(self.eyes().observation())
    }

    /// Drives one tick.
    ///
    /// # Errors
    /// No episode is running, or perception or encoder fail. SUMO's death is not an error here: see the
    /// module.
    pub fn step(&mut self, control: Control) -> Result<Step, EnvError> {
        // Where the expert was asked the ego shows the expert's lamps.
        let planned = self.world.is_planned(EGO);
        self.act(if planned { Act::Disturbed(control) } else { Act::Control(control) })
    }

    /// Drives one tick by the expert or with a control.
    ///
    /// # Errors
    /// As [`Env::step`].
    pub fn act(&mut self, act: Act) -> Result<Step, EnvError> {
        if !self.world.is_running(EGO) {
            return Err(EnvError::NoEpisode);
        }
        let outcome = self.runtime.block_on(self.world.step(&[act]))?.remove(EGO);
        let Outcome { control, reward, terminated, truncated, info } = outcome;
        let observation = self.eyes().observation();
        Ok(Step { observation, control, reward, terminated, truncated, info })
    }

    /// The rule-based expert's control for this tick (it sees the whole world). Call it at every tick of
    /// an episode that it drives, and only once a tick: it has a memory.
    ///
    /// # Errors
    /// No episode is running.
    pub fn expert(&mut self) -> Result<Control, EnvError> {
        self.world.expert(EGO)
    }

    /// Asks `asked` from the first second of a step on, every second, whether the step is given up: the episode then
    /// ends as if SUMO had died. For callers who hear of signals.
    pub fn give_up_when(&mut self, asked: impl FnMut() -> bool + Send + 'static) {
        self.world.give_up = Some(Box::new(asked));
    }

    /// Where the episode takes place: enough to drive it again.
    pub fn placement(&self) -> Option<&Placement> {
        self.world.slots()[EGO].placement()
    }

    /// The ego as an actor, for cameras outside it.
    pub fn ego(&self) -> Option<&wad_sim::bridge::Ego> {
        self.world.ego(EGO)
    }

    /// The ego's speed (m/s), 0 before the first reset.
    pub fn speed(&self) -> f64 {
        self.ego().map_or(0.0, |ego| ego.state().speed)
    }

    /// Id of SUMO's process, None before the first reset.
    pub fn sumo_pid(&self) -> Option<u32> {
        self.world.sumo_pid()
    }

    /// The ego's eyes, with the last frame.
    pub fn eyes(&self) -> &Eyes {
        self.world.slots()[EGO].eyes()
    }

    /// The six raw states of the last observation by name, in units.
    pub fn raw(&self) -> &RawState {
        self.eyes().raw()
    }

    /// The camera's last frame, the observation's source, for people and datasets.
    pub fn frame(&self) -> Option<&wad_camera::Frame> {
        self.eyes().frame()
    }

    /// The last transformed image; None where none is made.
    pub fn image(&self) -> Option<&wad_see::perception::TransformedImage> {
        self.eyes().image()
    }

    /// Length of a tick.
    pub fn tick(&self) -> Duration {
        self.world.tick()
    }

    /// Wall time by stage.
    pub fn stages(&self) -> Stages {
        self.world.stages
    }

    /// The town.
    pub fn assets(&self) -> &Arc<Assets> {
        self.world.assets()
    }

    /// The options.
    pub fn options(&self) -> &EnvOptions {
        self.world.options()
    }

    /// Ends SUMO in an orderly way; dropping an environment kills it.
    pub fn close(mut self) {
        self.runtime.block_on(self.world.close());
    }
}
