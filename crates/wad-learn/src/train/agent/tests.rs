//! Checkpoints that resume bit for bit, and the schedule's order.

use super::checkpoint::{Checkpoints, RngState, State};
use super::config::{TrainConfig, ValidationParams};
use super::schedule::{ActorCopy, Purpose, Schedule};
use crate::agent::batch::{Batches, InputScale, Inputs, Metrics};
use crate::agent::learner::{Algorithm, Learner};
use crate::agent::networks::Dims;
use crate::agent::replay_buffer::{ReplayBuffer, Sampled, Sampling, Segment};
use crate::agent::sac::SacParams;
use crate::agent::td3::Td3Params;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use serde_json::Value;
use std::path::Path;
use std::sync::Arc;
use sumo_network::seeds;
use tch::Device;
use wad_sim::tasks::{Curriculum, TaskKind};
use wad_sim::traffic::TrafficSpec;

const DIMS: Dims = Dims { latent: 6, raw: 4, actions: 3 };
const SAMPLING: Sampling =
    Sampling { batch_size: 32, n_step: 2, gamma: 0.97, reward_scale: 1.0, near_ends: 0.0 };

pub(super) fn config() -> TrainConfig {
    let text = include_str!("../../../../../scenarios/curriculum.json");
    let curriculum = Curriculum::parse(Path::new("curriculum.json"), text).unwrap();
    TrainConfig::new(Algorithm::Td3(Td3Params::default()), curriculum, "pooled", "hash")
}

struct Learning {
    learner: Learner,
    buffer: ReplayBuffer,
    rng: ChaCha8Rng,
}

impl Learning {
    fn new(algorithm: &Algorithm) -> Self {
        Self {
            learner: Learner::new(algorithm, DIMS, 4, Device::Cpu),
            buffer: ReplayBuffer::new(DIMS, 3000).unwrap(),
            rng: seeds::rng(4, "learner"),
        }
    }

    fn experience(&mut self, seed: u64) {
        let mut rng = seeds::rng(seed, "experience");
        for _ in 0..20 {
            let mut numbers = |n: usize| -> Vec<f32> { (0..n).map(|_| rng.random::<f32>()).collect() };
            self.buffer.push(&Segment {
                observations: (0..31).map(|_| numbers(10)).collect(),
                actions: (0..30).map(|_| [numbers(1)[0], 0.3, 0.1]).collect(),
                rewards: numbers(30),
                terminated: seed.is_multiple_of(2),
                ..Segment::default()
            });
        }
    }

    fn learn(&mut self, updates: usize) {
        let scale = InputScale::identity(DIMS).tensors(Device::Cpu);
        let mut sampled = Sampled::default();
        for _ in 0..updates {
            self.buffer.sample(&mut self.rng, SAMPLING, 1, &mut sampled);
            let batches = Batches::upload(&sampled, DIMS, &scale, Device::Cpu);
            self.learner.update(&batches.get(0), &mut Metrics::default());
        }
    }

    fn save(&mut self, checkpoints: &mut Checkpoints, steps: u64) {
        let state = State {
            steps,
            updates: 0,
            raw_meaning: 0,
            adam_steps: Vec::new(),
            rng: RngState::of(&self.rng),
            schedule: Schedule::new(&config(), None, 0).state,
            scale: None,
            best: None,
            validated_at: 0,
            recorded: 0,
            cloned: 0,
            begins_trained: false,
            logged: None,
            wall_seconds: 1.0,
            replay: Default::default(),
            learner_bytes: 0,
            learner_crc: 0,
        };
        checkpoints.save(state, &mut self.learner, &self.buffer, &config()).unwrap();
    }

    fn bits(&mut self) -> Vec<(&'static str, Vec<u32>)> {
        let tensors = self.learner.tensors();
        tensors
            .into_iter()
            .map(|(name, t)| {
                (name, Vec::<f32>::try_from(&*t).unwrap().into_iter().map(f32::to_bits).collect())
            })
            .collect()
    }
}

fn restore(algorithm: &Algorithm, out: &Path) -> Result<(Learning, u64, Checkpoints), super::TrainError> {
    let mut learning = Learning::new(algorithm);
    let mut checkpoints = Checkpoints::new(out);
    let (state, buffer) =
        checkpoints.restore(&mut learning.learner, || Ok(ReplayBuffer::new(DIMS, 3000)?))?;
    learning.buffer = buffer;
    learning.rng = state.rng.generator().unwrap();
    Ok((learning, state.steps, checkpoints))
}

fn resumes_bit_for_bit(algorithm: &Algorithm) {
    let out = tempfile::tempdir().unwrap();
    let mut straight = Learning::new(algorithm);
    let mut checkpoints = Checkpoints::new(out.path());
    straight.experience(1);
    straight.learn(7);
    straight.save(&mut checkpoints, 100);
    let (mut resumed, steps, _) = restore(algorithm, out.path()).unwrap();
    assert_eq!(steps, 100);
    assert_eq!(resumed.learner.counters(), straight.learner.counters());
    for learning in [&mut straight, &mut resumed] {
        learning.experience(2);
        learning.learn(9);
    }
    for (one, two) in straight.bits().into_iter().zip(resumed.bits()) {
        assert!(one == two, "`{}` differs after the resume", one.0);
    }
}

#[test]
fn td3_resumes_bit_for_bit() {
    resumes_bit_for_bit(&Algorithm::Td3(Td3Params::default()));
}

#[test]
fn sac_resumes_bit_for_bit() {
    resumes_bit_for_bit(&Algorithm::Sac(SacParams { autotune: true, ..SacParams::default() }));
}

#[test]
fn a_checkpoint_cut_short_is_passed_over_for_the_one_before() {
    let algorithm = Algorithm::Td3(Td3Params::default());
    for damage in ["learner.safetensors", "state.json", "chunk"] {
        let out = tempfile::tempdir().unwrap();
        let mut learning = Learning::new(&algorithm);
        let mut checkpoints = Checkpoints::new(out.path());
        for steps in [100, 200, 300] {
            learning.experience(steps);
            learning.learn(2);
            learning.save(&mut checkpoints, steps);
        }
        let folder = out.path().join("checkpoints");
        assert!(!folder.join("000000100").exists(), "two are kept");
        let newest: State =
            serde_json::from_slice(&std::fs::read(folder.join("000000300/state.json")).unwrap()).unwrap();
        let file = match damage {
            "chunk" => folder.join("replay").join(&newest.replay.chunks[0].file),
            name => folder.join("000000300").join(name),
        };
        let data = std::fs::read(&file).unwrap();
        std::fs::write(&file, &data[..data.len() / 2]).unwrap();
        let (mut found, steps, mut checkpoints) = restore(&algorithm, out.path()).unwrap();
        assert_eq!((steps, found.learner.counters().0), (200, 4), "after damage to {damage}");
        // The next checkpoint follows on that one.
        found.experience(9);
        found.save(&mut checkpoints, 250);
        assert_eq!(restore(&algorithm, out.path()).unwrap().1, 250);
    }
}

#[test]
fn a_training_that_was_saved_without_its_steps_has_the_default() {
    let mut saved = serde_json::to_value(TrainConfig { steps: 1_000_000, ..config() }).unwrap();
    let steps = |saved: &Value| serde_json::from_value::<TrainConfig>(saved.clone()).unwrap().steps;
    assert_eq!(steps(&saved), 1_000_000);
    saved.as_object_mut().unwrap().remove("steps").unwrap();
    assert_eq!(steps(&saved), 400_000);
}

#[test]
fn settings_that_hang_or_destroy_a_training_are_refused() {
    let sac = |alpha: f64| {
        let algorithm = Algorithm::Sac(SacParams { alpha, ..SacParams::default() });
        TrainConfig { algorithm, ..config() }
    };
    let validation = |every: u64| {
        let validation = ValidationParams { every, episodes: 0, ..ValidationParams::default() };
        TrainConfig { validation, ..config() }
    };
    for config in [config(), sac(0.1), validation(0)] {
        assert_eq!(config.problem(), None);
    }
    let curriculum = |curriculum: Curriculum| TrainConfig { curriculum, ..config() };
    let bundled = config().curriculum;
    for (config, expected) in [
        (validation(1000), "--validate-every 0"),
        (sac(0.0), "alpha"),
        (sac(f64::NAN), "alpha"),
        (curriculum(Curriculum { weathers: Vec::new(), ..bundled.clone() }), "weathers"),
        (curriculum(Curriculum { stages: Vec::new(), ..bundled }), "stages"),
        (
            TrainConfig { inputs: Inputs::Vector, recorded: vec!["recorded".into()], ..config() },
            "--inputs vector",
        ),
    ] {
        let problem = config.problem().unwrap();
        assert!(problem.contains(expected), "{problem}");
    }
}

#[test]
fn nothing_to_resume_and_another_form_are_said() {
    let out = tempfile::tempdir().unwrap();
    let td3 = Algorithm::Td3(Td3Params::default());
    let error = restore(&td3, out.path()).err().unwrap().to_string();
    assert!(error.contains("there is none"), "{error}");
    let mut learning = Learning::new(&td3);
    learning.experience(1);
    learning.save(&mut Checkpoints::new(out.path()), 100);
    let error = restore(&Algorithm::Sac(SacParams::default()), out.path()).err().unwrap().to_string();
    assert!(error.contains("tensor `policy`"), "{error}");
}

#[test]
fn a_buffer_whose_raw_states_mean_something_else_is_not_gone_on_with() {
    let out = tempfile::tempdir().unwrap();
    let td3 = Algorithm::Td3(Td3Params::default());
    let mut learning = Learning::new(&td3);
    learning.experience(1);
    learning.save(&mut Checkpoints::new(out.path()), 100);
    // Written before there was a second meaning.
    let path = out.path().join("checkpoints/000000100/state.json");
    let text = std::fs::read_to_string(&path).unwrap();
    let mut state: Value = serde_json::from_str(&text).unwrap();
    state.as_object_mut().unwrap().remove("raw_meaning").unwrap();
    std::fs::write(&path, state.to_string()).unwrap();
    let error = restore(&td3, out.path()).err().unwrap().to_string();
    assert!(error.contains("of meaning 1, expected 3"), "{error}");
}

#[test]
fn demonstrations_come_first_then_the_curriculum_and_validations_between() {
    let mut config = config();
    config.demonstrations = 1000;
    let mut schedule = Schedule::new(&config, None, 0);
    let mut shown = std::collections::BTreeSet::new();
    for _ in 0..60 {
        let job = schedule.next(&config);
        assert!(matches!(job.purpose, Purpose::Demonstrate { .. }));
        shown.insert(job.task.kind);
    }
    assert_eq!(shown.len(), 6, "every task is demonstrated: {shown:?}");
    schedule.state.demonstrated = 1000;
    let job = schedule.next(&config);
    assert!(matches!(job.purpose, Purpose::Explore));
    assert_eq!(job.task.kind, TaskKind::Straight);

    schedule.state.progress.stage = 1;
    let scale = InputScale::identity(Dims::DRIVING);
    let actor = Arc::new(ActorCopy { version: 3, values: Vec::new(), scale });
    let validation = |schedule: &mut Schedule| -> Vec<(TaskKind, u64)> {
        let n = schedule.validate(&config, &actor);
        assert_eq!(n, 2 * config.validation.episodes, "the tasks come to so far");
        (0..n)
            .map(|_| {
                let job = schedule.next(&config);
                assert!(matches!(job.purpose, Purpose::Validate(_)));
                (job.task.kind, job.seed)
            })
            .collect()
    };
    let first = validation(&mut schedule);
    assert!(matches!(schedule.next(&config).purpose, Purpose::Explore));
    assert_eq!(validation(&mut schedule), first, "always the same episodes");
}

#[test]
fn a_task_is_validated_in_each_traffic_of_its_stages() {
    let text = include_str!("../../../../../scenarios/curriculum_dense.json");
    let curriculum = Curriculum::parse(Path::new("curriculum_dense.json"), text).unwrap();
    let config = TrainConfig { curriculum, ..config() };
    let mut schedule = Schedule::new(&config, None, 0);
    schedule.state.progress.stage = 6;
    let scale = InputScale::identity(Dims::DRIVING);
    let actor = Arc::new(ActorCopy { version: 3, values: Vec::new(), scale });
    let n = schedule.validate(&config, &actor);
    assert_eq!((n, n), (7 * config.validation.episodes, Schedule::full_validation(&config)));
    let jobs: Vec<_> = (0..n).map(|_| schedule.next(&config)).collect();
    let dense = jobs.iter().filter(|job| job.task.traffic == Some(TrafficSpec::Dense));
    assert!(dense.clone().all(|job| job.stage == 6));
    assert_eq!(dense.count(), config.validation.episodes);
}

#[test]
fn mixed_latents_leave_the_raw_states_alone() {
    let mut learning = Learning::new(&Algorithm::Td3(Td3Params::default()));
    learning.experience(1);
    let mut sampled = Sampled::default();
    learning.buffer.sample(&mut learning.rng, SAMPLING, 2, &mut sampled);
    let scale = InputScale::identity(DIMS).tensors(Device::Cpu);
    let numbers = |mixing: Option<(f64, u64)>| {
        let batches = Batches::upload(&sampled, DIMS, &scale, Device::Cpu);
        if let Some((most, seed)) = mixing {
            batches.mix_latents(DIMS, most, &mut seeds::rng(seed, "learner"));
        }
        let batch = batches.get(1);
        let vector = |t: tch::Tensor| Vec::<f32>::try_from(t.reshape(-1)).unwrap();
        (vector(batch.observation), vector(batch.next_observation))
    };
    let (plain, mixed) = (numbers(None), numbers(Some((0.5, 1))));
    assert_eq!(mixed, numbers(Some((0.5, 1))), "the generator alone decides");
    assert_ne!(mixed, numbers(Some((0.5, 2))));
    let (mut most, mut moved) = (0.0_f32, 0);
    for (i, before) in plain.0.iter().enumerate() {
        let (now, next) = (mixed.0[i] - before, mixed.1[i] - plain.1[i]);
        let is_latent = i % 10 < 6;
        assert!(is_latent || now == 0.0 && next == 0.0, "raw number {i} moved by {now}");
        // A transition is looked at through one pair of eyes.
        assert!((now - next).abs() < 1e-6);
        most = most.max(now.abs());
        moved += usize::from(now != 0.0);
    }
    // All numbers here are from 0 to 1.
    assert!(most <= 0.5 && most > 0.1 && moved > 150, "{moved} moved, {most} at most");
}

#[test]
fn without_demonstrations_gentle_driving_comes_first() {
    let mut config = config();
    let mut schedule = Schedule::new(&config, None, 0);
    assert!(matches!(schedule.next(&config).purpose, Purpose::Start));
    schedule.steps = config.learning_starts;
    assert!(matches!(schedule.next(&config).purpose, Purpose::Explore));
    schedule.steps = 0;
    config.init = Some("wad-t".to_string());
    assert!(matches!(schedule.next(&config).purpose, Purpose::Explore), "a trained actor drives at once");
}
