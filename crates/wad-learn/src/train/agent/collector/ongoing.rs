//! An episode while a collector drives it.

use crate::agent::action::Action;
use crate::agent::exploration::Exploration;
use crate::agent::places::Place;
use crate::agent::replay_buffer::Segment;
use crate::env::{End, Ending, Info};
use crate::reward::RewardTerms;
use crate::train::agent::config::TrainConfig;
use crate::train::agent::schedule::{Job, Purpose, Report};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::time::Duration;
use wad_sim::bridge::Ego;

/// What was chosen for a tick.
#[derive(Clone, Copy, Debug, Default)]
pub struct Chosen {
    pub action: Action,
    /// The expert's, if it was asked.
    pub shown: Option<Action>,
    /// The ego's speed before it (m/s).
    pub speed: f64,
    /// Where the ego was before it.
    pub place: Place,
}

impl Chosen {
    /// Nothing yet, for an ego as it is before a tick.
    pub fn before(ego: Option<&Ego>) -> Self {
        let state = ego.map(Ego::state);
        let place = state.map_or(Place::UNKNOWN, |state| Place::of(&state.pose));
        Self { speed: state.map_or(0.0, |state| state.speed), place, ..Self::default() }
    }
}

/// The result of a tick.
pub struct Passed<'a> {
    pub reward: f64,
    pub terminated: bool,
    pub truncated: bool,
    pub info: &'a Info,
    /// Length of a tick.
    pub tick: Duration,
}

/// An episode while it is driven.
pub struct Ongoing {
    pub job: Job,
    pub rng: ChaCha8Rng,
    pub noise: Exploration,
    pub segment: Segment,
    pub episodic_return: f64,
    pub discounted_return: f64,
    pub discount: f64,
    pub start: Option<(Vec<f32>, Action)>,
    pub steps: u64,
    pub terms: RewardTerms,
}

impl Ongoing {
    pub fn new(job: Job, config: &TrainConfig, first: Vec<f32>) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(sumo_network::seeds::derive(job.seed, "exploration"));
        let noise = Exploration::new(config.exploration, &mut rng);
        Self {
            job,
            rng,
            noise,
            segment: Self::segment(first),
            episodic_return: 0.0,
            discounted_return: 0.0,
            discount: 1.0,
            start: None,
            steps: 0,
            terms: RewardTerms::default(),
        }
    }

    pub fn segment(first: Vec<f32>) -> Segment {
        Segment { observations: vec![first], ..Segment::default() }
    }

    /// Whether the expert's action is wanted.
    pub fn asks(&self, config: &TrainConfig) -> bool {
        matches!(self.job.purpose, Purpose::Demonstrate { .. })
            || !self.job.purpose.validates() && config.asks()
    }

    pub fn report(&self, result: &Passed<'_>) -> Report {
        let unknown = || Ending { end: End::Error, cause: "unknown".to_string(), success: false };
        let info = result.info;
        Report {
            purpose: self.job.purpose.clone(),
            stage: self.job.stage,
            task: self.job.task.clone(),
            ending: info.ending.clone().unwrap_or_else(unknown),
            steps: self.steps,
            episodic_return: self.episodic_return,
            discounted_return: self.discounted_return,
            start: self.start.clone(),
            expected_return: None,
            terms: self.terms,
            mean_speed: info.driven / (info.tick.max(1) as f64 * result.tick.as_secs_f64()),
            distance: info.driven,
        }
    }
}
