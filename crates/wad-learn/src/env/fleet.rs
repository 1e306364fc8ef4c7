//! Many egos in one SUMO: a vectorised environment.

use super::slot::{Outcome, is_ego};
use super::world::World;
use super::{Assets, EnvError, EnvOptions, Info, Stages};
use std::sync::Arc;
use std::time::Duration;
use sumo_network::seeds;
use wad_see::eyes::Eyes;
use wad_see::latent::Encoder;
use wad_see::observation::RAW_SIZE;
use wad_sim::bridge::Ego;
use wad_sim::criteria::Event;
use wad_sim::session::Act;
use wad_sim::tasks::{Placement, TaskSpec};
use wad_vehicle::{Control, PartnerKind};

/// N egos in one SUMO, each with its own task, route, seed, eyes, criteria and reward. They see each other and
/// collide with each other. An ego whose episode ended begins its next one elsewhere in the following step, while
/// the others drive on (Gymnasium's autoreset mode NEXT_STEP): that step ignores its act. After
/// [`Fleet::set_returning`] with false it leaves the road instead, and stays out until the next reset (DISABLED).
///
/// A fleet is blocking and belongs to one thread; physics and eyes use the cores that are free. Equal seeds and
/// acts give equal bytes, whatever the number of threads.
///
/// ```no_run
/// # fn example() -> Result<(), Box<dyn std::error::Error>> {
/// use wad_learn::env::{Assets, EnvOptions, Fleet, ObservationMode};
/// use wad_see::latent::PooledEncoder;
/// use wad_sim::session::Act;
/// use wad_sim::tasks::{TaskKind, TaskSpec};
///
/// let options = EnvOptions { observation: ObservationMode::Vector, ..EnvOptions::training() };
/// let encoders = (0..16).map(|_| Box::new(PooledEncoder) as _).collect();
/// let mut fleet = Fleet::new(Assets::load("town5")?, options, encoders)?;
/// fleet.reset(&[TaskSpec::new(TaskKind::Composite)], 7)?;
/// for _ in 0..100 {
///     let acts = [Act::Expert; 16];
///     println!("{:?}", fleet.step(&acts)?.rewards);
///     println!("{:?}", &fleet.observations()[..fleet.observation_size()]);
/// }
/// # Ok(())
/// # }
/// ```
pub struct Fleet {
    runtime: tokio::runtime::Runtime,
    world: World,
    /// Egos whose episode ended begin another.
    returning: bool,
    /// Each ego's task.
    tasks: Vec<TaskSpec>,
    seed: u64,
    /// Episodes that each ego has begun.
    episodes: Vec<u64>,
    /// The seed of each ego's next episode, where the caller chose it.
    chosen: Vec<Option<u64>>,
    /// [N, D], row by row.
    observations: Vec<f32>,
    acts: Vec<Act>,
    step: FleetStep,
}

/// The result of one step of all egos, each by the ego's number.
#[derive(Clone, Debug, Default)]
pub struct FleetStep {
    /// Reward of the tick; 0 where an episode just began.
    pub rewards: Vec<f64>,
    /// The ego ended its episode: the value of the next state is 0.
    pub terminated: Vec<bool>,
    /// The episode ended otherwise: the next state still has a value.
    pub truncated: Vec<bool>,
    /// The episode has just begun: observation is its first, the act was ignored.
    pub began: Vec<bool>,
    /// The control that was driven.
    pub controls: Vec<Control>,
    /// Details of the tick.
    pub infos: Vec<Info>,
}

impl FleetStep {
    /// Whether the episode of ego `index` ended in this step.
    pub fn is_over(&self, index: usize) -> bool {
        self.terminated[index] || self.truncated[index]
    }

    /// Collisions of egos with other egos in this step; both of a pair are told, so a crash counts once for each.
    pub fn ego_collisions(&self) -> usize {
        let among = |event: &&Event| matches!(event, Event::Collision { kind: PartnerKind::Vehicle, partner, .. } if is_ego(partner));
        self.infos.iter().flat_map(|info| &info.events).filter(among).count()
    }
}

impl Fleet {
    /// A fleet in the town of `assets` with one ego for each of `encoders`. SUMO starts with the first reset.
    ///
    /// # Errors
    /// The detector or the camera cannot be made.
    ///
    /// # Panics
    /// `encoders` is empty.
    pub fn new(
        assets: Arc<Assets>,
        options: EnvOptions,
        encoders: Vec<Box<dyn Encoder>>,
    ) -> Result<Self, EnvError> {
        assert!(!encoders.is_empty(), "a fleet has one ego or more");
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .map_err(|source| EnvError::Runtime { source })?;
        let egos = encoders.len();
        let size = options.observation.latent_size() + RAW_SIZE;
        Ok(Self {
            runtime,
            world: World::new(assets, options, encoders)?,
            returning: true,
            tasks: Vec::new(),
            seed: 0,
            episodes: vec![0; egos],
            chosen: vec![None; egos],
            observations: vec![0.0; egos * size],
            acts: vec![Act::Stay; egos],
            step: FleetStep::default(),
        })
    }

    /// The number of egos.
    pub fn egos(&self) -> usize {
        self.episodes.len()
    }

    /// Numbers of an observation: latent (or surroundings) and raw states.
    pub fn observation_size(&self) -> usize {
        self.observations.len() / self.egos()
    }

    /// The seed of episode number `episode` (from 0) of an ego in a fleet with `seed`.
    pub fn episode_seed(seed: u64, ego: usize, episode: u64) -> u64 {
        seeds::derive(seed, &format!("ego {ego} episode {episode}"))
    }

    /// Begins an episode of every ego; ego `i` drives `tasks[i % tasks.len()]`, in the largest traffic of the tasks.
    /// Returns the first observations, as [`Fleet::observations`].
    ///
    /// # Errors
    /// The town has no room for so many egos, a task cannot be placed, or SUMO cannot be started.
    ///
    /// # Panics
    /// `tasks` is empty.
    pub fn reset(&mut self, tasks: &[TaskSpec], seed: u64) -> Result<&[f32], EnvError> {
        assert!(!tasks.is_empty(), "a fleet has one task or more");
        self.seed = seed;
        let each = tasks.iter().cycle().take(self.egos()).enumerate();
        let starts: Vec<_> =
            each.map(|(ego, task)| (task.clone(), Self::episode_seed(seed, ego, 0))).collect();
        self.reset_each(&starts)
    }

    /// Begins the episode of each ego with its own task and seed, in the largest traffic of the tasks.
    ///
    /// # Errors
    /// As [`Fleet::reset`].
    ///
    /// # Panics
    /// There is not one of them for each ego.
    pub fn reset_each(&mut self, starts: &[(TaskSpec, u64)]) -> Result<&[f32], EnvError> {
        assert_eq!(starts.len(), self.egos(), "one start for each ego");
        self.tasks = starts.iter().map(|(task, _)| task.clone()).collect();
        self.chosen = starts.iter().map(|(_, seed)| Some(*seed)).collect();
        self.episodes.fill(0);
        self.begin()?;
        Ok(&self.observations)
    }

    fn begin(&mut self) -> Result<(), EnvError> {
        let seeds: Vec<u64> = (0..self.egos()).map(|ego| self.next_seed(ego)).collect();
        let starts: Vec<_> = self.tasks.iter().zip(&seeds).map(|(task, seed)| (task, *seed)).collect();
        self.runtime.block_on(self.world.reset(&starts))?;
        self.episodes.iter_mut().for_each(|episodes| *episodes += 1);
        self.chosen.fill(None);
        self.observe();
        Ok(())
    }

    /// The seed of ego `index`'s next episode.
    ///
    /// # Panics
    /// `index` is out of range.
    pub fn next_seed(&self, index: usize) -> u64 {
        self.chosen[index].unwrap_or_else(|| Self::episode_seed(self.seed, index, self.episodes[index]))
    }

    /// Chooses task and seed of ego `index`'s next episode; without it the task stays, and the seed follows from
    /// the fleet's.
    ///
    /// # Panics
    /// `index` is out of range, or there was no reset.
    pub fn set_next(&mut self, index: usize, task: TaskSpec, seed: u64) {
        self.tasks[index] = task;
        self.chosen[index] = Some(seed);
    }

    /// Whether an ego whose episode ended begins another in the following step (the default), or leaves the road and
    /// stays out until [`Fleet::reset`].
    pub fn set_returning(&mut self, returning: bool) {
        self.returning = returning;
    }

    /// As [`super::Env::give_up_when`].
    pub fn give_up_when(&mut self, asked: impl FnMut() -> bool + Send + 'static) {
        self.world.give_up = Some(Box::new(asked));
    }

    /// The task of ego `index`.
    ///
    /// # Panics
    /// Before the first reset.
    pub fn task(&self, index: usize) -> &TaskSpec {
        &self.tasks[index]
    }

    /// One tick of all egos, `acts` by their numbers. After SUMO's death, which ends every episode with
    /// [`super::End::Error`], the next step begins new ones in a new SUMO.
    ///
    /// # Errors
    /// There was no reset (after SUMO's death none of egos that do not return), or perception or encoder fail.
    ///
    /// # Panics
    /// There is not one act for each ego.
    pub fn step(&mut self, acts: &[Act]) -> Result<&FleetStep, EnvError> {
        assert_eq!(acts.len(), self.egos(), "one act for each ego");
        if self.tasks.is_empty() || !(self.returning || self.world.has_sumo()) {
            return Err(EnvError::NoEpisode);
        }
        self.step.began.clear();
        self.step.began.resize(self.egos(), false);
        if !self.world.has_sumo() {
            self.begin()?;
            self.step.began.fill(true);
            self.step.rewards.fill(0.0);
            self.step.terminated.fill(false);
            self.step.truncated.fill(false);
            self.step.infos.iter_mut().for_each(|info| (info.ending, info.events) = Default::default());
            return Ok(&self.step);
        }
        self.acts.copy_from_slice(acts);
        let mut lost = None;
        for ego in 0..self.egos() {
            if self.world.is_running(ego) {
                continue;
            }
            self.acts[ego] = Act::Stay;
            let seed = self.next_seed(ego);
            let start = self.returning.then_some((&self.tasks[ego], seed));
            if start.is_none() && self.world.is_away(ego) {
                continue;
            }
            lost = self.runtime.block_on(self.world.go_next(ego, start))?;
            if lost.is_some() {
                break;
            }
            // Where no place is free it waits off the road: traffic moves on.
            if self.world.is_running(ego) {
                self.episodes[ego] += 1;
                self.chosen[ego] = None;
                self.step.began[ego] = true;
            }
        }
        let outcomes = match lost {
            Some(outcomes) => outcomes,
            None => self.runtime.block_on(self.world.step(&self.acts))?,
        };
        let FleetStep { rewards, terminated, truncated, controls, infos, .. } = &mut self.step;
        rewards.clear();
        terminated.clear();
        truncated.clear();
        controls.clear();
        infos.clear();
        for outcome in outcomes {
            let Outcome { control, reward, terminated: ended, truncated: cut, info } = outcome;
            rewards.push(reward);
            terminated.push(ended);
            truncated.push(cut);
            controls.push(control);
            infos.push(info);
        }
        self.observe();
        Ok(&self.step)
    }

    /// Copies what the eyes saw last.
    fn observe(&mut self) {
        let size = self.observation_size();
        for (row, slot) in self.observations.chunks_exact_mut(size).zip(self.world.slots()) {
            slot.eyes().write_observation(row);
        }
    }

    /// Ends the episode of ego `index` without an outcome, because its driver has failed.
    ///
    /// # Panics
    /// `index` is out of range.
    pub fn give_up(&mut self, index: usize) {
        self.world.give_up(index);
    }

    /// The observations of the last reset or step, [N, D] row by row: latent (or surroundings), then raw states.
    pub fn observations(&self) -> &[f32] {
        &self.observations
    }

    /// The expert's control for ego `index` (it sees the whole world). Call it once a tick at most.
    ///
    /// # Errors
    /// No episode of that ego is running.
    pub fn expert(&mut self, index: usize) -> Result<Control, EnvError> {
        self.world.expert(index)
    }

    /// The last step.
    pub fn last(&self) -> &FleetStep {
        &self.step
    }

    /// Ego `index` as an actor, for cameras outside it.
    pub fn ego(&self, index: usize) -> Option<&Ego> {
        self.world.ego(index)
    }

    /// Where the episode of ego `index` takes place.
    pub fn placement(&self, index: usize) -> Option<&Placement> {
        self.world.slots().get(index)?.placement()
    }

    /// The eyes of ego `index`.
    ///
    /// # Panics
    /// `index` is out of range.
    pub fn eyes(&self, index: usize) -> &Eyes {
        self.world.slots()[index].eyes()
    }

    /// Id of SUMO's process, None before the first reset.
    pub fn sumo_pid(&self) -> Option<u32> {
        self.world.sumo_pid()
    }

    /// Length of a tick.
    pub fn tick(&self) -> Duration {
        self.world.tick()
    }

    /// Wall time by stage; camera, perception and encoder summed over the egos, which look in parallel.
    pub fn stages(&self) -> Stages {
        self.world.stages
    }

    /// The options.
    pub fn options(&self) -> &EnvOptions {
        self.world.options()
    }

    /// The town.
    pub fn assets(&self) -> &Arc<Assets> {
        self.world.assets()
    }

    /// Ends SUMO in an orderly way; dropping a fleet kills it.
    pub fn close(mut self) {
        self.runtime.block_on(self.world.close());
    }
}
