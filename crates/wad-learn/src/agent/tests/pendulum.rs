//! The pendulum that every algorithm must swing up: a rod hung at one end, a motor too weak to lift it
//! in one go. From its equations of motion; the constants are those that published returns refer to.

use super::super::batch::{Batches, InputScale, Metrics};
use super::super::learner::{Actor, Algorithm, Learner};
use super::super::networks::{CriticEnd, Dims};
use super::super::replay_buffer::{ReplayBuffer, Sampled, Sampling, Segment};
use super::super::sac::SacParams;
use super::super::td3::Td3Params;
use rand::{Rng, RngExt};
use sumo_network::geometry::wrap_angle;
use sumo_network::seeds::{self, normal};
use tch::Device;

const GRAVITY: f64 = 10.0;
const TICK: f64 = 0.05;
const EPISODE: usize = 200;

/// Angle from upright (rad) and its rate (rad/s).
struct Pendulum {
    angle: f64,
    rate: f64,
}

impl Pendulum {
    fn new(rng: &mut impl Rng) -> Self {
        let mut draw = |bound: f64| bound * (2.0 * rng.random::<f64>() - 1.0);
        Self { angle: draw(std::f64::consts::PI), rate: draw(1.0) }
    }

    /// Seen twice, as latent and as raw vector.
    fn observation(&self) -> Vec<f32> {
        let seen = [self.angle.cos() as f32, self.angle.sin() as f32, (self.rate / 8.0) as f32];
        [seen, seen].concat()
    }

    /// Turns for a tick with a torque of 2 N m times `action`; a rod of 1 kg and 1 m.
    fn step(&mut self, action: f32) -> f64 {
        let torque = 2.0 * f64::from(action).clamp(-1.0, 1.0);
        let cost = wrap_angle(self.angle).powi(2) + 0.1 * self.rate.powi(2) + 0.001 * torque.powi(2);
        self.rate += (1.5 * GRAVITY * self.angle.sin() + 3.0 * torque) * TICK;
        self.rate = self.rate.clamp(-8.0, 8.0);
        self.angle += self.rate * TICK;
        -cost
    }
}

const DIMS: Dims = Dims { latent: 3, raw: 3, actions: 1 };

/// Mean return of twenty episodes without noise, after learning from `steps` steps.
fn learn(algorithm: &Algorithm, steps: usize, seed: u64) -> f64 {
    let mut rng = seeds::rng(seed, "pendulum");
    let mut learner = Learner::new(algorithm, DIMS, seed, Device::Cpu);
    let scale = InputScale::identity(DIMS);
    let on_device = scale.tensors(Device::Cpu);
    let mut actor = Actor::new(algorithm, DIMS, &scale);
    let mut buffer = ReplayBuffer::new(DIMS, 50_000).unwrap();
    let sampling =
        Sampling { batch_size: 128, n_step: 1, gamma: algorithm.gamma(), reward_scale: 0.1, near_ends: 0.0 };
    let (mut sampled, mut metrics) = (Sampled::default(), Metrics::default());
    let mut done = 0;
    while done < steps {
        let mut pendulum = Pendulum::new(&mut rng);
        let mut segment = Segment { observations: vec![pendulum.observation()], ..Segment::default() };
        actor.set(&learner.actor_values()).unwrap();
        for step in 0..EPISODE {
            let noise = normal(&mut rng) as f32;
            let observation = segment.observations.last().unwrap();
            let action = match actor.is_stochastic() {
                _ if done < 1000 => 2.0 * rng.random::<f32>() - 1.0,
                true => actor.draw(observation, [noise, 0.0, 0.0])[0],
                false => (actor.act(observation)[0] + 0.1 * noise).clamp(-1.0, 1.0),
            };
            segment.rewards.push(pendulum.step(action) as f32);
            segment.actions.push([action, 0.0, 0.0]);
            segment.observations.push(pendulum.observation());
            done += 1;
            if segment.len() == 50 {
                segment.truncated = step + 1 == EPISODE;
                buffer.push(&segment);
                let last = segment.observations.pop().unwrap();
                segment = Segment { observations: vec![last], ..Segment::default() };
                for _ in 0..if done > 1000 { 5 } else { 0 } {
                    buffer.sample(&mut rng, sampling, 10, &mut sampled);
                    let batches = Batches::upload(&sampled, DIMS, &on_device, Device::Cpu);
                    (0..10).for_each(|i| learner.update(&batches.get(i), &mut metrics));
                }
                actor.set(&learner.actor_values()).unwrap();
            }
        }
    }
    let mut sum = 0.0;
    for _ in 0..20 {
        let mut pendulum = Pendulum::new(&mut rng);
        sum += (0..EPISODE).map(|_| pendulum.step(actor.act(&pendulum.observation())[0])).sum::<f64>();
    }
    eprintln!("{}: mean return {:.0}, {:?}", algorithm.agent_name(), sum / 20.0, metrics.take());
    sum / 20.0
}

/// A pendulum that only hangs gets about -1200; one that is swung up well about -150.
const SOLVED: f64 = -250.0;

/// Swings it up with one of three seeds: processors round differently, and now and then one of them is unlucky.
fn solves(algorithm: &Algorithm) {
    let means = (1..=3).map(|seed| learn(algorithm, 8_000, seed));
    let mut seen = Vec::new();
    assert!(means.inspect(|mean| seen.push(*mean)).any(|mean| mean > SOLVED), "mean returns {seen:?}");
}

#[test]
fn wad_t_with_the_papers_sigmoid_swings_the_pendulum_up() {
    // Returns of a tenth of the rewards: none is above 0, and few below -80.
    let critic_end = CriticEnd::Sigmoid { low: -80.0, high: 5.0 };
    let algorithm =
        Algorithm::Td3(Td3Params { critic_end, policy_noise: 0.2, noise_clip: 0.5, ..Td3Params::default() });
    solves(&algorithm);
}

#[test]
fn wad_s_swings_the_pendulum_up() {
    let algorithm = Algorithm::Sac(SacParams { alpha: 0.02, ..SacParams::default() });
    solves(&algorithm);
}
