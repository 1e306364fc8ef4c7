//! The next episode: demonstrations first, then the curriculum, with validations between.

use super::config::TrainConfig;
use crate::agent::action::Action;
use crate::agent::batch::InputScale;
use crate::env::Ending;
use crate::reward::RewardTerms;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::sync::Arc;
use sumo_network::seeds;
use wad_sim::tasks::{Progress, TaskSpec};

/// An actor's parameters as they were at some update.
#[derive(Debug)]
pub struct ActorCopy {
    pub version: u64,
    pub values: Vec<f32>,
    pub scale: InputScale,
}

/// An episode for a collector.
#[derive(Clone, Debug)]
pub struct Job {
    pub purpose: Purpose,
    /// The curriculum's stage that it was drawn from.
    pub stage: usize,
    pub task: TaskSpec,
    pub seed: u64,
}

/// The purpose of an episode.
#[derive(Clone, Debug)]
pub enum Purpose {
    /// A demonstration: the autopilot drives, in some episodes with noise.
    Demonstrate { noisy: bool },
    /// Random actions before learning starts.
    Start,
    /// Training: the newest actor with noise.
    Explore,
    /// Validation: a given actor without noise, in a fresh world.
    Validate(Arc<ActorCopy>),
}

impl Purpose {
    /// Whether it is a validation.
    pub fn validates(&self) -> bool {
        matches!(self, Self::Validate(_))
    }
}

/// The result of an episode.
#[derive(Clone, Debug)]
pub struct Report {
    pub purpose: Purpose,
    /// The curriculum's stage that it was drawn from.
    pub stage: usize,
    pub task: TaskSpec,
    pub ending: Ending,
    pub steps: u64,
    pub episodic_return: f64,
    /// The same, discounted (Monte Carlo), and where it began: the observation and the first action.
    pub discounted_return: f64,
    pub start: Option<(Vec<f32>, Action)>,
    /// The return that the critics expected there, by the critics of the episode's end.
    pub expected_return: Option<f64>,
    pub terms: RewardTerms,
    /// m/s, over the whole episode.
    pub mean_speed: f64,
    /// m.
    pub distance: f64,
}

/// The schedule's state for checkpoints.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ScheduleState {
    pub progress: Progress,
    /// Episodes handed out so far: seeds follow from it.
    pub episodes: u64,
    /// Environment steps that the autopilot drove.
    pub demonstrated: u64,
}

/// Hands out episodes.
#[derive(Debug)]
pub struct Schedule {
    pub state: ScheduleState,
    seed: u64,
    validations: VecDeque<Job>,
    /// Environment steps of the agent so far, by the learner's last message.
    pub steps: u64,
}

impl Schedule {
    /// The schedule of a new or resumed training.
    pub fn new(config: &TrainConfig, state: Option<ScheduleState>, steps: u64) -> Self {
        let fresh = ScheduleState { progress: Progress::default(), episodes: 0, demonstrated: 0 };
        Self { state: state.unwrap_or(fresh), seed: config.seed, validations: VecDeque::new(), steps }
    }

    /// The next episode.
    pub fn next(&mut self, config: &TrainConfig) -> Job {
        if let Some(job) = self.validations.pop_front() {
            return job;
        }
        self.state.episodes += 1;
        let seed = seeds::derive(self.seed, &format!("episode {}", self.state.episodes));
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        if self.state.demonstrated < config.demonstrations {
            // All tasks equally, so that the buffer has examples of each.
            let stages = &config.curriculum.stages;
            let everywhere = Progress { stage: rng.random_range(0..stages.len()), ..Progress::default() };
            let alone = wad_sim::tasks::Curriculum { replay: 0.0, ..config.curriculum.clone() };
            let noisy = rng.random::<f64>() < config.noisy_demonstrations;
            let (stage, task) = everywhere.draw(&alone, &mut rng);
            return Job { purpose: Purpose::Demonstrate { noisy }, stage, task, seed };
        }
        let (stage, task) = self.state.progress.draw(&config.curriculum, &mut rng);
        let knows_nothing = !config.is_warm() && config.init.is_none();
        let start = self.steps < config.learning_starts && knows_nothing;
        Job { purpose: if start { Purpose::Start } else { Purpose::Explore }, stage, task, seed }
    }

    /// Whether episodes of a validation wait.
    pub fn is_validating(&self) -> bool {
        !self.validations.is_empty()
    }

    /// Queues a validation of `actor` first: every task of the stages so far, in each traffic.
    pub fn validate(&mut self, config: &TrainConfig, actor: &Arc<ActorCopy>) -> usize {
        let params = config.validation;
        let weathers = &config.curriculum.weathers;
        for (stage, task) in tasks(config, self.state.progress.stage + 1) {
            for i in 0..params.episodes {
                self.validations.push_back(Job {
                    purpose: Purpose::Validate(Arc::clone(actor)),
                    stage,
                    task: task.clone().in_weather(weathers[i % weathers.len()]),
                    seed: seeds::derive(params.seed, &format!("{} {i}", task.kind)),
                });
            }
        }
        self.validations.len()
    }

    /// Episodes of a validation of all tasks.
    pub fn full_validation(config: &TrainConfig) -> usize {
        tasks(config, config.curriculum.stages.len()).len() * config.validation.episodes
    }
}

/// The first `stages` stages that differ in task or traffic, each with its task.
fn tasks(config: &TrainConfig, stages: usize) -> Vec<(usize, TaskSpec)> {
    let mut tasks: Vec<(usize, TaskSpec)> = Vec::new();
    for (index, stage) in config.curriculum.stages.iter().take(stages).enumerate() {
        let task = stage.spec();
        let same =
            |(_, other): &(usize, TaskSpec)| (other.kind, other.traffic()) == (task.kind, task.traffic());
        if !tasks.iter().any(same) {
            tasks.push((index, task));
        }
    }
    tasks
}
