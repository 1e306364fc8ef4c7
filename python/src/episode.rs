//! One environment: episodes, and what Python gets of each tick.

use crate::errors::Failure;
use crate::setup::{Part, Setup, Tasks};
use std::sync::Arc;
use wad_cosim::agent::action::{self, Action};
use wad_cosim::bridge::Ego;
use wad_cosim::camera::Outputs;
use wad_cosim::criteria::Event;
use wad_cosim::env::{Ending, Env, EnvError, Fleet, Info};
use wad_cosim::eyes::{Eyes, EyesError};
use wad_cosim::foxglove::{DriveLog, Moment};
use wad_cosim::geometry::Pose;
use wad_cosim::perception;
use wad_cosim::record::RecordError;
use wad_cosim::reward::RewardTerms;
use wad_cosim::session::Act;

/// Names of the numbers of a tick, in their order: [`Numbers`].
pub const NUMBERS: [&str; 19] = [
    "reward",
    "terminated",
    "truncated",
    "tick",
    "time",
    "speed",
    "driven",
    "route_done",
    "vehicles",
    "pedestrians",
    "x",
    "y",
    "heading",
    RewardTerms::NAMES[0],
    RewardTerms::NAMES[1],
    RewardTerms::NAMES[2],
    RewardTerms::NAMES[3],
    RewardTerms::NAMES[4],
    RewardTerms::NAMES[5],
];

/// The first of [`NUMBERS`] that is a fact: what a step leads to stands before.
pub const FACTS: usize = 3;

/// The first of [`NUMBERS`] that is a term of the reward.
pub const TERMS: usize = 13;

/// Those of [`NUMBERS`] that are whole: tick, vehicles, pedestrians.
pub const WHOLE: [usize; 3] = [3, 8, 9];

/// The numbers of a tick: flags as 0 and 1, SI units, the route done as a share, the ego's place in the net (m, rad), then the reward's terms.
pub type Numbers = [f64; NUMBERS.len()];

/// What seldom happens in a tick.
#[derive(Clone, Debug, Default)]
pub struct News {
    /// The tick's events.
    pub events: Vec<Event>,
    /// How the episode ended.
    pub ending: Option<Ending>,
}

/// An environment with its camera for people.
pub struct Episodes {
    tasks: Arc<Tasks>,
    env: Env,
    /// Draws pictures where the environment itself draws none.
    painter: Option<Eyes>,
    parts: Vec<Part>,
    log: Option<DriveLog>,
}

impl Episodes {
    /// An environment without an episode. `record`: the MCAP file that its drives go into.
    pub fn new(tasks: Arc<Tasks>, setup: &Setup, record: Option<&std::path::Path>) -> Result<Self, Failure> {
        let env = Env::new(tasks.assets.clone(), setup.options.clone(), setup.encoder()?)?;
        let own = !setup.options.observation.encodes();
        let painter = (setup.draws() && own)
            .then(|| painter(&tasks, setup, record.is_some()).map_err(EnvError::Eyes))
            .transpose()?;
        let network = tasks.assets.network();
        let log = |path: &std::path::Path| DriveLog::create(path, network, setup.options.camera);
        let log = record.map(log).transpose().map_err(unwritten)?;
        Ok(Self { tasks, env, painter, parts: setup.observation.clone(), log })
    }

    /// See [`Env::give_up_when`].
    pub fn give_up_when(&mut self, asked: impl FnMut() -> bool + Send + 'static) {
        self.env.give_up_when(asked);
    }

    /// Begins the episode of `seed`, on the route of that number if one is given.
    pub fn reset(&mut self, seed: u64, route: Option<usize>) -> Result<Numbers, Failure> {
        let task = self.tasks.episode(seed, route)?;
        self.env.reset(&task, seed)?;
        if let Some(painter) = &mut self.painter {
            painter.reset(task.weather, seed);
        }
        self.look();
        Ok(standing(self.env.ego()))
    }

    /// Drives one tick.
    pub fn step(&mut self, action: Action) -> Result<(Numbers, News), Failure> {
        let step = self.env.step(action::to_control(action))?;
        self.look();
        let numbers = numbers(step.reward, step.terminated, step.truncated, &step.info);
        self.note(&step.info)?;
        Ok((numbers, News { events: step.info.events, ending: step.info.ending }))
    }

    /// The expert's action for this tick.
    pub fn expert(&mut self) -> Result<Action, Failure> {
        Ok(action::from_control(self.env.expert()?))
    }

    /// Adds the tick to the recording.
    fn note(&mut self, info: &Info) -> Result<(), Failure> {
        let seen = self.parts.contains(&Part::Image);
        let (Some(log), Some(ego)) = (&mut self.log, self.env.ego()) else { return Ok(()) };
        if let Some(painter) = &mut self.painter
            && (painter.perception().is_some() || !seen)
        {
            painter.spot(&ego.state().pose).map_err(EnvError::Eyes)?;
        }
        let painter = self.painter.as_ref();
        let percept = self.env.eyes().percept().or_else(|| painter?.percept());
        let frame = painter.map_or_else(|| self.env.frame(), Eyes::frame);
        log.add(&Moment {
            time: info.time,
            ego: &ego.as_actor(),
            world: ego.world(),
            frame,
            detections: percept.map_or(&[], |percept| &percept.detections),
            reward: &RewardTerms::NAMES.into_iter().zip(info.reward.values()).collect::<Vec<_>>(),
        })
        .map_err(unwritten)
    }

    /// The painter's town follows; the picture is drawn if it is part of the observation.
    fn look(&mut self) {
        let seen = self.parts.contains(&Part::Image);
        if let (Some(painter), Some(ego)) = (&mut self.painter, self.env.ego()) {
            painter.follow(ego.world());
            if seen {
                painter.glance(&ego.state().pose);
            }
        }
    }

    /// The front camera's picture of this tick, drawn now if the observation has none; RGB, row by row.
    pub fn picture(&mut self) -> Result<&[u8], Failure> {
        let seen = self.parts.contains(&Part::Image);
        let Some(ego) = self.env.ego() else { return Err(EnvError::NoEpisode.into()) };
        if let Some(painter) = self.painter.as_mut().filter(|_| !seen) {
            painter.glance(&ego.state().pose);
        }
        self.drawn().ok_or_else(|| Failure::Other("this environment draws no pictures".to_string()))
    }

    fn drawn(&self) -> Option<&[u8]> {
        let frame = match &self.painter {
            Some(painter) => painter.frame(),
            None => self.env.frame(),
        };
        frame.map(|frame| frame.rgb.as_slice()).filter(|rgb| !rgb.is_empty())
    }

    /// Writes a part of the observation.
    pub fn write(&self, part: Part, row: Row<'_>) {
        match (part, row) {
            (Part::Image, Row::Bytes(row)) => {
                if let Some(rgb) = self.drawn() {
                    row.copy_from_slice(rgb);
                }
            }
            (part, row) => write(self.env.eyes(), part, row),
        }
    }

    /// Id of SUMO's process, for tests that kill it.
    pub fn sumo(&self) -> Option<u32> {
        self.env.sumo_pid()
    }

    /// Ends SUMO, and completes the recording.
    ///
    /// # Errors
    /// The recording cannot be completed.
    pub fn close(self) -> Result<(), Failure> {
        self.env.close();
        self.log.map_or(Ok(()), |log| log.finish().map_err(unwritten))
    }
}

/// Eyes that draw for people. In a recording they find the road users too, where the environment itself does not look for them.
fn painter(tasks: &Tasks, setup: &Setup, recorded: bool) -> Result<Eyes, EyesError> {
    let (town, camera) = (tasks.assets.town(), setup.options.camera);
    if !recorded || setup.options.observation.looks() {
        return Eyes::camera(town, camera);
    }
    let detector = perception::detector("truth", perception::LeastScore::Usual)?;
    Ok(Eyes::new(town, camera, detector)?.with_outputs(Outputs::RGB))
}

fn unwritten(error: RecordError) -> Failure {
    Failure::Input(error.to_string())
}

/// Writes what `eyes` saw.
fn write(eyes: &Eyes, part: Part, row: Row<'_>) {
    match (part, row) {
        (Part::Raw, Row::Numbers(row)) => row.copy_from_slice(&eyes.raw().vector()),
        (Part::Vector | Part::Latent, Row::Numbers(row)) => eyes.write_observation(row),
        (Part::Transformed, Row::Bytes(row)) => {
            if let Some(image) = eyes.image() {
                row.copy_from_slice(image.bytes());
            }
        }
        _ => unreachable!("the arrays are checked when the environment is made"),
    }
}

/// Several egos in one SUMO.
pub struct Egos {
    tasks: Arc<Tasks>,
    fleet: Fleet,
}

impl Egos {
    /// Egos without an episode. `returning`: each begins its next one by itself, in the step after an end; else it
    /// leaves the road until the next reset.
    pub fn new(tasks: Arc<Tasks>, setup: &Setup, returning: bool) -> Result<Self, Failure> {
        let encoders = (0..setup.egos).map(|_| setup.encoder()).collect::<Result<_, _>>()?;
        let mut fleet = Fleet::new(tasks.assets.clone(), setup.options.clone(), encoders)?;
        fleet.set_returning(returning);
        Ok(Self { tasks, fleet })
    }

    /// See [`Env::give_up_when`].
    pub fn give_up_when(&mut self, asked: impl FnMut() -> bool + Send + 'static) {
        self.fleet.give_up_when(asked);
    }

    /// Begins an episode of each ego.
    pub fn reset(&mut self, seed: u64) -> Result<Vec<(Numbers, News)>, Failure> {
        let egos = 0..self.fleet.egos();
        let drawn = |ego| self.tasks.episode(Fleet::episode_seed(seed, ego, 0), None);
        let tasks = egos.clone().map(drawn).collect::<Result<Vec<_>, _>>()?;
        self.fleet.reset(&tasks, seed)?;
        egos.clone().try_for_each(|ego| self.draw_next(ego))?;
        Ok(egos.map(|ego| (self.standing(ego), News::default())).collect())
    }

    /// Draws the task of an ego's next episode from that episode's seed.
    fn draw_next(&mut self, ego: usize) -> Result<(), Failure> {
        let seed = self.fleet.next_seed(ego);
        let task = self.tasks.episode(seed, None)?;
        self.fleet.set_next(ego, task, seed);
        Ok(())
    }

    /// Drives one tick; also says whose episode began.
    pub fn step(&mut self, actions: &[Action]) -> Result<Vec<(Numbers, News, bool)>, Failure> {
        let acts: Vec<Act> = actions.iter().map(|action| Act::Control(action::to_control(*action))).collect();
        self.fleet.step(&acts)?;
        for ego in 0..self.fleet.egos() {
            if self.fleet.last().began[ego] {
                self.draw_next(ego)?;
            }
        }
        let step = self.fleet.last();
        Ok((0..self.fleet.egos())
            .map(|ego| {
                if step.began[ego] {
                    return (self.standing(ego), News::default(), true);
                }
                let (reward, info) = (step.rewards[ego], &step.infos[ego]);
                let numbers = numbers(reward, step.terminated[ego], step.truncated[ego], info);
                (numbers, News { events: info.events.clone(), ending: info.ending.clone() }, false)
            })
            .collect())
    }

    fn standing(&self, ego: usize) -> Numbers {
        standing(self.fleet.ego(ego))
    }

    /// Writes a part of an ego's observation.
    pub fn write(&self, ego: usize, part: Part, row: Row<'_>) {
        write(self.fleet.eyes(ego), part, row);
    }

    /// Id of SUMO's process, for tests that kill it.
    pub fn sumo(&self) -> Option<u32> {
        self.fleet.sumo_pid()
    }

    /// Ends SUMO.
    pub fn close(self) {
        self.fleet.close();
    }
}

/// The numbers of an episode that begins.
fn standing(ego: Option<&Ego>) -> Numbers {
    let mut numbers = [0.0; NUMBERS.len()];
    if let Some(state) = ego.map(Ego::state) {
        numbers[5] = state.speed;
        numbers[10..13].copy_from_slice(&place(&state.pose));
    }
    numbers
}

/// Where an ego is: x, y (m) and heading (rad, counter-clockwise from east), in the net's frame.
fn place(pose: &Pose) -> [f64; 3] {
    [pose.position.x, pose.position.y, pose.heading]
}

/// An environment's row of an array.
pub enum Row<'a> {
    /// Of 32-bit numbers.
    Numbers(&'a mut [f32]),
    /// Of bytes.
    Bytes(&'a mut [u8]),
}

fn numbers(reward: f64, terminated: bool, truncated: bool, info: &Info) -> Numbers {
    let (terms, [x, y, heading]) = (info.reward.values(), place(&info.ego.pose));
    [
        reward,
        f64::from(terminated),
        f64::from(truncated),
        info.tick as f64,
        info.time,
        info.ego.speed,
        info.driven,
        (info.driven / info.route_length.max(1.0)).clamp(0.0, 1.0),
        info.traffic.0 as f64,
        info.traffic.1 as f64,
        x,
        y,
        heading,
        terms[0],
        terms[1],
        terms[2],
        terms[3],
        terms[4],
        terms[5],
    ]
}
