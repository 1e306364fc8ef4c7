//! One update of each algorithm against plain arithmetic.
//!
//! After Adam's first step its running mean is a tenth of the gradient, which is how the gradients are
//! looked at here.

use super::super::batch::{Batch, Metrics};
use super::super::imitation::{HARD_BRAKE, HARD_BRAKING, Imitation, STEERING};
use super::super::learner::{Algorithm, Learner};
use super::super::networks::{CriticEnd, Dims, Params};
use super::super::sac::{Sac, SacParams};
use super::super::td3::{Td3, Td3Params};
use super::reference::{actor_t, critic, policy_s, sigmoid, slopes, value};
use crate::agent::networks::HIDDEN_S;
use rand::RngExt;
use sumo_network::seeds;
use tch::{Device, Tensor};

const DIMS: Dims = Dims { latent: 4, raw: 3, actions: 3 };
const B: usize = 5;
const D: usize = 7;
const GAMMA: f64 = 0.9;

/// The same batch for both.
struct Data {
    now: Vec<Vec<f64>>,
    next: Vec<Vec<f64>>,
    action: Vec<Vec<f64>>,
    noise: Vec<Vec<f64>>,
    reward: Vec<f64>,
    discount: Vec<f64>,
    is_shown: Vec<f64>,
    shown: Vec<Vec<f64>>,
}

impl Data {
    fn new() -> Self {
        let mut rng = seeds::rng(11, "data");
        // What single precision holds exactly, so that both see the same.
        let mut matrix = |rows: usize, columns: usize, low: f64, high: f64| -> Vec<Vec<f64>> {
            let mut number = || f64::from((low + (high - low) * rng.random::<f64>()) as f32);
            (0..rows).map(|_| (0..columns).map(|_| number()).collect()).collect()
        };
        Self {
            now: matrix(B, D, -1.0, 1.0),
            next: matrix(B, D, -1.0, 1.0),
            action: matrix(B, 3, 0.1, 0.9),
            noise: matrix(B, 3, -2.0, 2.0),
            reward: matrix(1, B, -3.0, 3.0).remove(0),
            // The third terminated.
            discount: (0..B).map(|i| if i == 2 { 0.0 } else { f64::from(GAMMA as f32) }).collect(),
            is_shown: vec![1.0, 0.0, 1.0, 1.0, 0.0],
            shown: matrix(B, 3, 0.1, 0.9),
        }
    }

    fn batch(&self) -> Batch {
        let matrix = |rows: &[Vec<f64>]| {
            let flat: Vec<f32> = rows.iter().flatten().map(|x| *x as f32).collect();
            Tensor::from_slice(&flat).view([rows.len() as i64, -1])
        };
        let vector = |x: &[f64]| Tensor::from_slice(&x.iter().map(|x| *x as f32).collect::<Vec<_>>());
        Batch {
            observation: matrix(&self.now),
            next_observation: matrix(&self.next),
            action: matrix(&self.action),
            noise: matrix(&self.noise),
            reward: vector(&self.reward),
            discount: vector(&self.discount),
            is_shown: vector(&self.is_shown),
            shown: matrix(&self.shown),
        }
    }
}

fn double(params: &Params) -> Vec<f64> {
    params.values().into_iter().map(f64::from).collect()
}

fn tensor(t: &Tensor) -> Vec<f64> {
    Vec::<f32>::try_from(t).unwrap().into_iter().map(f64::from).collect()
}

/// A few parameters of every layer, the last ones among them.
fn pick(n: usize) -> Vec<usize> {
    let mut rng = seeds::rng(3, "pick");
    (0..60).map(|_| rng.random_range(0..n)).chain(n.saturating_sub(6)..n).collect()
}

/// Adam's first mean is (1 - 0.9) g.
fn check_gradient(m: &Tensor, picked: &[usize], expected: &[f64], what: &str) {
    let found = tensor(m);
    let largest = expected.iter().fold(0.0_f64, |a, b| a.max(b.abs()));
    assert!(largest > 1e-4, "{what}: a gradient to compare with");
    for (&i, expected) in picked.iter().zip(expected) {
        let found = found[i] / 0.1;
        assert!(
            (found - expected).abs() < 2e-4 * largest + 2e-3 * expected.abs(),
            "{what}, parameter {i}: expected {expected}, found {found}"
        );
    }
}

fn mean(x: impl Iterator<Item = f64>) -> f64 {
    x.sum::<f64>() / B as f64
}

fn td3(end: CriticEnd, imitation: Imitation) -> Td3 {
    let params = Td3Params {
        gamma: GAMMA,
        policy_noise: 0.3,
        noise_clip: 0.4,
        critic_hidden: vec![9, 8],
        critic_end: end,
        imitation,
        ..Td3Params::default()
    };
    Td3::new(params, DIMS, &mut seeds::rng(1, "networks"), Device::Cpu)
}

/// What TD3's critics must come to: y of each transition.
fn td3_targets(data: &Data, actor: &[f64], critics: &[f64], end: CriticEnd) -> Vec<f64> {
    (0..B)
        .map(|b| {
            let mut action = actor_t(actor, DIMS, &data.next[b]);
            for (i, a) in action.iter_mut().enumerate() {
                let half = if i == 0 { 1.0 } else { 0.5 };
                let low = if i == 0 { -1.0 } else { 0.0 };
                *a = (*a + half * (0.3 * data.noise[b][i]).clamp(-0.4, 0.4)).clamp(low, 1.0);
            }
            let q = |which| critic(critics, which, &[9, 8], &data.next[b], &action);
            let q = q(0).min(q(1));
            match end {
                CriticEnd::Linear => data.reward[b] + data.discount[b] * q,
                CriticEnd::Sigmoid { low, high } => {
                    let y = data.reward[b] + data.discount[b] * (low + (high - low) * sigmoid(q));
                    ((y - low) / (high - low)).clamp(0.0, 1.0)
                }
            }
        })
        .collect()
}

fn td3_updates_as_computed_by_hand(end: CriticEnd) {
    let data = Data::new();
    let mut td3 = td3(end, Imitation::default());
    let squash = |q: f64| if end == CriticEnd::Linear { q } else { sigmoid(q) };
    let (actor, critics) = (double(&td3.actor.params), double(&td3.critics.params));
    let y = td3_targets(&data, &actor, &critics, end);
    td3.update(&data.batch(), Some(&mut Metrics::default()));

    let loss = |params: &[f64]| -> f64 {
        let error = |b: usize, which: usize| {
            (squash(critic(params, which, &[9, 8], &data.now[b], &data.action[b])) - y[b]).powi(2)
        };
        (0..2).map(|which| mean((0..B).map(|b| error(b, which)))).sum()
    };
    let picked = pick(critics.len());
    check_gradient(&td3.critics_adam.m, &picked, &slopes(&critics, &picked, loss), "critics");
    assert_eq!(double(&td3.actor.params), actor, "the actor waits for the second update");
    assert_eq!(double(&td3.critics_target.params), critics, "so do the targets");

    td3.update(&data.batch(), None);
    let now = double(&td3.critics.params);
    let loss = |params: &[f64]| {
        let q = |b: usize| critic(&now, 0, &[9, 8], &data.now[b], &actor_t(params, DIMS, &data.now[b]));
        -mean((0..B).map(|b| squash(q(b))))
    };
    let picked = pick(actor.len());
    check_gradient(&td3.actor_adam.m, &picked, &slopes(&actor, &picked, loss), "actor");
    let target = double(&td3.critics_target.params);
    for i in picked.into_iter().filter(|i| *i < target.len()) {
        let expected = 0.995 * critics[i] + 0.005 * now[i];
        assert!((target[i] - expected).abs() < 1e-6, "target {i}: {} {expected}", target[i]);
    }
}

#[test]
fn td3_with_the_papers_sigmoid_updates_as_computed_by_hand() {
    td3_updates_as_computed_by_hand(CriticEnd::Sigmoid { low: -20.0, high: 10.0 });
}

#[test]
fn td3_with_linear_critics_updates_as_computed_by_hand() {
    td3_updates_as_computed_by_hand(CriticEnd::Linear);
}

fn pulled_as_computed_by_hand(filter: bool, end: CriticEnd) {
    let data = Data::new();
    let imitation = Imitation { weight: 2.0, filter, ..Imitation::default() };
    let mut td3 = td3(end, imitation);
    let actor = double(&td3.actor.params);
    td3.update(&data.batch(), None);
    td3.update(&data.batch(), None);
    // The actor climbs the critics of its own update.
    let critics = double(&td3.critics.params);
    // The critic as a return: its size there is what imitation is weighed against.
    let q = |b: usize, action: &[f64]| {
        let q = critic(&critics, 0, &[9, 8], &data.now[b], action);
        match end {
            CriticEnd::Linear => q,
            CriticEnd::Sigmoid { low, high } => low + (high - low) * sigmoid(q),
        }
    };
    let own: Vec<f64> = (0..B).map(|b| q(b, &actor_t(&actor, DIMS, &data.now[b]))).collect();
    let scale = 1.0 / (mean(own.iter().map(|q| q.abs())) + 1e-6);
    let preferred = |b: usize| !filter || q(b, &data.shown[b]) >= own[b];
    let mask: Vec<f64> = (0..B).map(|b| if preferred(b) { data.is_shown[b] } else { 0.0 }).collect();
    let weight = imitation.at(2);
    let loss = |params: &[f64]| {
        let actions: Vec<Vec<f64>> = (0..B).map(|b| actor_t(params, DIMS, &data.now[b])).collect();
        let apart = |b: usize| {
            let d = |i: usize| (actions[b][i] - data.shown[b][i]) / if i == 0 { 1.0 } else { 0.5 };
            let hard = if data.shown[b][2] >= HARD_BRAKE { HARD_BRAKING } else { 1.0 };
            hard * (STEERING * d(0).powi(2) + d(1).powi(2) + d(2).powi(2)) / 3.0
        };
        let imitation = (0..B).map(|b| mask[b] * apart(b)).sum::<f64>() / (mask.iter().sum::<f64>() + 1.0);
        weight * imitation - scale * mean((0..B).map(|b| q(b, &actions[b])))
    };
    let picked = pick(actor.len());
    check_gradient(&td3.actor_adam.m, &picked, &slopes(&actor, &picked, loss), "actor");
}

#[test]
fn imitation_pulls_towards_what_was_shown() {
    pulled_as_computed_by_hand(false, CriticEnd::Linear);
}

#[test]
fn imitation_is_weighed_against_the_return_behind_the_papers_sigmoid() {
    pulled_as_computed_by_hand(false, CriticEnd::Sigmoid { low: -20.0, high: 10.0 });
}

#[test]
fn imitation_pulls_only_where_the_critic_prefers_what_was_shown() {
    pulled_as_computed_by_hand(true, CriticEnd::Linear);
}

#[test]
fn sac_updates_as_computed_by_hand() {
    let data = Data::new();
    let params = SacParams { gamma: GAMMA, alpha: 0.3, autotune: true, ..SacParams::default() };
    let mut sac = Sac::new(params, DIMS, &mut seeds::rng(2, "networks"), Device::Cpu);
    let (policy, critics) = (double(&sac.policy.params), double(&sac.critics.params));
    let v = double(&sac.value.params);
    sac.update(&data.batch(), Some(&mut Metrics::default()));

    let q = |params: &[f64], which: usize, b: usize, action: &[f64]| {
        critic(params, which, &HIDDEN_S, &data.now[b], action)
    };
    let y: Vec<f64> = (0..B).map(|b| data.reward[b] + data.discount[b] * value(&v, &data.next[b])).collect();
    let q_loss = |params: &[f64]| -> f64 {
        let error = |b: usize, which: usize| (q(params, which, b, &data.action[b]) - y[b]).powi(2);
        0.5 * (0..2).map(|which| mean((0..B).map(|b| error(b, which)))).sum::<f64>()
    };
    let picked = pick(critics.len());
    check_gradient(&sac.critics_adam.m, &picked, &slopes(&critics, &picked, q_loss), "critics");

    let drawn = |params: &[f64], b: usize| {
        let (action, log_prob) = policy_s(params, DIMS, &data.now[b], &data.noise[b]);
        (q(&critics, 0, b, &action).min(q(&critics, 1, b, &action)), log_prob)
    };
    let policy_loss = |params: &[f64]| {
        mean((0..B).map(|b| {
            let (q, log_prob) = drawn(params, b);
            0.3 * log_prob - q
        }))
    };
    let picked = pick(policy.len());
    check_gradient(&sac.policy_adam.m, &picked, &slopes(&policy, &picked, policy_loss), "policy");

    let soft: Vec<f64> = (0..B).map(|b| drawn(&policy, b)).map(|(q, log_prob)| q - 0.3 * log_prob).collect();
    let v_loss = |params: &[f64]| 0.5 * mean((0..B).map(|b| (value(params, &data.now[b]) - soft[b]).powi(2)));
    let picked = pick(v.len());
    check_gradient(&sac.value_adam.m, &picked, &slopes(&v, &picked, v_loss), "value");

    let log_prob = mean((0..B).map(|b| drawn(&policy, b).1));
    check_gradient(&sac.alpha_adam.m, &[0], &[-(log_prob - 3.0)], "temperature");
    let (target, now) = (double(&sac.value_target.params), double(&sac.value.params));
    for i in pick(v.len()) {
        assert!((target[i] - (0.995 * v[i] + 0.005 * now[i])).abs() < 1e-6);
    }
}

#[test]
fn an_actor_waits_while_new_critics_learn() {
    let batch = Data::new().batch();
    let rng = || seeds::rng(3, "networks");
    let params = Td3Params { critics_first: 4, ..Td3Params::default() };
    let mut td3 = Td3::new(params, DIMS, &mut rng(), Device::Cpu);
    let mut sac =
        Sac::new(SacParams { critics_first: 4, ..SacParams::default() }, DIMS, &mut rng(), Device::Cpu);
    let (actor, policy) = (double(&td3.actor.params), double(&sac.policy.params));
    let (theirs, hers) = (double(&td3.critics.params), double(&sac.critics.params));
    let alpha = tensor(&sac.log_alpha);
    for _ in 0..4 {
        td3.update(&batch, None);
        sac.update(&batch, None);
    }
    assert_eq!((double(&td3.actor.params), double(&sac.policy.params)), (actor.clone(), policy.clone()));
    assert_eq!(tensor(&sac.log_alpha), alpha);
    assert!(double(&td3.critics.params) != theirs && double(&sac.critics.params) != hers);
    for _ in 0..2 {
        td3.update(&batch, None);
        sac.update(&batch, None);
    }
    assert!(double(&td3.actor.params) != actor && double(&sac.policy.params) != policy);
}

#[test]
fn the_kept_actor_is_the_mean_of_the_newest() {
    let batch = Data::new().batch();
    let sac = SacParams { actor_average: 3, ..SacParams::default() };
    let td3 = Td3Params { actor_average: 3, ..Td3Params::default() };
    for algorithm in [Algorithm::Td3(td3), Algorithm::Sac(sac)] {
        let mut learner = Learner::new(&algorithm, DIMS, 3, Device::Cpu);
        assert_eq!(learner.kept_actor_values(), learner.actor_values());
        let mut mean = vec![0.0; learner.actor_values().len()];
        for share in [1.0, 1.0 / 2.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0] {
            learner.update(&batch, &mut Metrics::default());
            for (mean, newest) in mean.iter_mut().zip(learner.actor_values()) {
                *mean += share * (f64::from(newest) - *mean);
            }
        }
        let kept = learner.kept_actor_values();
        assert!(kept.iter().zip(&mean).all(|(kept, mean)| (f64::from(*kept) - mean).abs() < 1e-6));
        assert!(kept != learner.actor_values());

        // It comes back from a checkpoint.
        let saved = learner.tensors().into_iter().map(|(name, tensor)| (name.to_string(), tensor.copy()));
        let saved = saved.collect();
        let (updates, steps) = learner.counters();
        let mut resumed = Learner::new(&algorithm, DIMS, 4, Device::Cpu);
        resumed.restore(&saved, updates, &steps).unwrap();
        assert_eq!(resumed.kept_actor_values(), kept);

        // Another actor begins another mean.
        let newest = learner.actor_values();
        learner.set_actor(&newest).unwrap();
        assert_eq!(learner.kept_actor_values(), newest);
    }
}
