//! WAD-T's and WAD-S' networks (paper, section "Network Architectures").
//!
//! ```text
//! WAD-T actor   latent 200 - 150 - 100 \
//!               raw 15 - 50             > 150 - 100 - 75 - 3   steer tanh, throttle and brake sigmoid
//! WAD-T critics observation + action 218 - 256 - 128 - 1       two of them; sigmoid at the end, or linear
//! WAD-S policy  observation 215 - 256 - 128 - 64 - (3 means, 3 log standard deviations)
//! WAD-S critics observation + action 218 - 256 - 128 - 64 - 1  two of them
//! WAD-S value   observation 215 - 256 - 128 - 64 - 1
//! ```
//!
//! All layers between are ReLU. The paper does not give the sizes of WAD-T's critics.
//!
//! Shapes: B is the batch. All of a network's parameters lie in one flat tensor ([`Params`]); a pair of
//! critics is one network whose weights have a leading dimension of two.

pub use super::params::{CriticEnd, Dims, HIDDEN_S};
use rand::{Rng, RngExt};
use tch::{Device, Kind, Tensor, no_grad};

/// A network's parameters: one flat tensor, and the weights and biases as leaves that share its memory.
#[derive(Debug)]
pub struct Params {
    flat: Tensor,
    leaves: Vec<Tensor>,
    shapes: Vec<Vec<i64>>,
}

/// A flat tensor's numbers, on the CPU.
pub fn flat_values(flat: &Tensor) -> Vec<f32> {
    let flat = flat.to_device(Device::Cpu).contiguous();
    let mut values = vec![0.0; flat.numel()];
    flat.copy_data(&mut values, flat.numel());
    values
}

impl Params {
    fn new(values: &[f32], shapes: Vec<Vec<i64>>, device: Device) -> Self {
        let flat = Tensor::from_slice(values).to_device(device);
        let mut params = Self { flat, leaves: Vec::new(), shapes };
        params.make_leaves();
        params
    }

    fn make_leaves(&mut self) {
        let mut at = 0;
        self.leaves = self
            .shapes
            .iter()
            .map(|shape| {
                let size: i64 = shape.iter().product();
                let leaf = no_grad(|| self.flat.narrow(0, at, size).view(shape.as_slice()).detach());
                at += size;
                leaf.set_requires_grad(true)
            })
            .collect();
    }

    /// A copy with its own memory.
    pub fn copy(&self, device: Device) -> Self {
        let flat = no_grad(|| self.flat.detach().to_device(device).copy());
        let mut params = Self { flat, leaves: Vec::new(), shapes: self.shapes.clone() };
        params.make_leaves();
        params
    }

    /// All parameters, one after the other.
    pub fn flat(&self) -> &Tensor {
        &self.flat
    }

    /// For optimisers.
    pub fn flat_mut(&mut self) -> &mut Tensor {
        &mut self.flat
    }

    /// Number of parameters.
    pub fn size(&self) -> i64 {
        self.flat.size()[0]
    }

    /// Copies other values of the same length.
    pub fn set(&mut self, flat: &Tensor) {
        no_grad(|| self.flat.copy_(flat));
    }

    /// All parameters, on the CPU.
    pub fn values(&self) -> Vec<f32> {
        flat_values(&self.flat)
    }

    /// The gradient of `loss`, flat.
    pub fn gradient(&self, loss: &Tensor) -> Tensor {
        let parts = Tensor::run_backward(&[loss], &self.leaves, false, false);
        no_grad(|| Tensor::cat(&parts.iter().map(|part| part.reshape([-1])).collect::<Vec<_>>(), 0))
    }

    /// self = (1 - tau) self + tau other.
    pub fn follow(&mut self, other: &Self, tau: f64) {
        no_grad(|| {
            let _ = self.flat.lerp_(&other.flat, tau);
        });
    }

    /// Layer `layer` of one network: x [B, in] -> [B, out].
    fn linear(&self, layer: usize, x: &Tensor) -> Tensor {
        self.leaves[2 * layer + 1].addmm(x, &self.leaves[2 * layer])
    }

    /// Layer `layer` of a pair: x [2, B, in] -> [2, B, out].
    fn linear_pair(&self, layer: usize, x: &Tensor) -> Tensor {
        self.leaves[2 * layer + 1].baddbmm(x, &self.leaves[2 * layer], 1.0, 1.0)
    }

    /// The same for the first of the pair only: x [B, in] -> [B, out].
    fn linear_first(&self, layer: usize, x: &Tensor) -> Tensor {
        self.leaves[2 * layer + 1].select(0, 0).addmm(x, &self.leaves[2 * layer].select(0, 0))
    }
}

/// Draws a network's initial parameters, uniform in +-1 / sqrt(inputs) as torch does.
struct Draw<'a, R> {
    rng: &'a mut R,
    values: Vec<f32>,
    shapes: Vec<Vec<i64>>,
}

impl<'a, R: Rng> Draw<'a, R> {
    fn new(rng: &'a mut R) -> Self {
        Self { rng, values: Vec::new(), shapes: Vec::new() }
    }

    fn layer(&mut self, copies: Option<i64>, inputs: i64, outputs: i64) {
        let bound = 1.0 / (inputs as f32).sqrt();
        let n = copies.unwrap_or(1);
        self.uniform((n * inputs * outputs) as usize, bound);
        self.uniform((n * outputs) as usize, bound);
        match copies {
            None => self.shapes.extend([vec![inputs, outputs], vec![1, outputs]]),
            Some(n) => self.shapes.extend([vec![n, inputs, outputs], vec![n, 1, outputs]]),
        }
    }

    /// The last layer of an actor: small weights, and biases that set the initial action.
    fn last_layer(&mut self, inputs: i64, biases: &[f32]) {
        self.uniform(inputs as usize * biases.len(), LAST_LAYER);
        self.values.extend(biases);
        self.shapes.extend([vec![inputs, biases.len() as i64], vec![1, biases.len() as i64]]);
    }

    fn chain(&mut self, copies: Option<i64>, sizes: &[i64]) {
        for pair in sizes.windows(2) {
            self.layer(copies, pair[0], pair[1]);
        }
    }

    fn uniform(&mut self, n: usize, bound: f32) {
        self.values.extend((0..n).map(|_| 0.0));
        let from = self.values.len() - n;
        for value in &mut self.values[from..] {
            *value = bound * (2.0 * self.rng.random::<f32>() - 1.0);
        }
    }

    fn finish(self, device: Device) -> Params {
        Params::new(&self.values, self.shapes, device)
    }
}

/// Bound of the initial weights of an actor's last layer: small, so that its biases set the initial action.
const LAST_LAYER: f32 = 3e-3;

/// A driving actor's initial action, before the squashing: straight on, throttle sigmoid(-0.6) = 0.35, brake
/// sigmoid(-3) = 0.05, less than the pedal's free travel: a new agent creeps forward.
const START: [f32; 3] = [0.0, -0.6, -3.0];

fn start(actions: i64) -> Vec<f32> {
    (0..actions as usize).map(|i| START.get(i).copied().unwrap_or(0.0)).collect()
}

/// Squashes an actor's last layer, x [.., A]: the first number with tanh to -1..1, the others with a
/// sigmoid to 0..1. sigmoid(x) = (1 + tanh(x / 2)) / 2, so that one tanh does for all.
#[derive(Debug)]
struct Squash {
    half: Tensor,
    offset: Tensor,
}

impl Squash {
    fn new(actions: i64, device: Device) -> Self {
        let pick = |steer: f32, pedal: f32| {
            let values: Vec<f32> = (0..actions).map(|i| if i == 0 { steer } else { pedal }).collect();
            Tensor::from_slice(&values).to_device(device)
        };
        Self { half: pick(1.0, 0.5), offset: pick(0.0, 0.5) }
    }

    /// 0 where an output is within [`UNSATURATED`], then rising as a square, `[B, A]`.
    fn saturation(&self, x: &Tensor) -> Tensor {
        ((x * &self.half).abs() - UNSATURATED).relu().square()
    }

    fn sigmoid_form(&self, x: &Tensor) -> Tensor {
        (x * &self.half).tanh() * &self.half + &self.offset
    }

    /// -1..1 to the actions' ranges.
    fn rescale(&self, t: &Tensor) -> Tensor {
        t * &self.half + &self.offset
    }
}

/// Arguments of tanh up to this size pass 7 % of the gradient or more; the action is then at 98 % of its limit.
const UNSATURATED: f64 = 2.0;

/// WAD-T's actor.
#[derive(Debug)]
pub struct ActorT {
    /// All weights and biases.
    pub params: Params,
    dims: Dims,
    squash: Squash,
}

impl ActorT {
    /// A new actor.
    pub fn new(dims: Dims, rng: &mut impl Rng, device: Device) -> Self {
        let mut draw = Draw::new(rng);
        // A part that is left out has no branch.
        let latent: &[i64] = if dims.latent > 0 { &[dims.latent, 150, 100] } else { &[] };
        let raw: &[i64] = if dims.raw > 0 { &[dims.raw, 50] } else { &[] };
        draw.chain(None, latent);
        draw.chain(None, raw);
        let joined = [latent, raw].iter().filter_map(|branch| branch.last()).sum();
        draw.chain(None, &[joined, 100, 75]);
        draw.last_layer(75, &start(dims.actions));
        Self { params: draw.finish(device), dims, squash: Squash::new(dims.actions, device) }
    }

    /// A copy with its own memory.
    pub fn copy(&self, device: Device) -> Self {
        Self {
            params: self.params.copy(device),
            dims: self.dims,
            squash: Squash::new(self.dims.actions, device),
        }
    }

    /// Actions [B, A] for observations [B, latent + raw].
    pub fn forward(&self, observation: &Tensor) -> Tensor {
        self.squash.sigmoid_form(&self.outputs(observation))
    }

    /// Actions [B, A], and how far each lies in the flat part of its sigmoid [B, A], 0 where it does not.
    pub fn forward_with_saturation(&self, observation: &Tensor) -> (Tensor, Tensor) {
        let outputs = self.outputs(observation);
        (self.squash.sigmoid_form(&outputs), self.squash.saturation(&outputs))
    }

    /// What goes into the sigmoids.
    fn outputs(&self, observation: &Tensor) -> Tensor {
        let p = &self.params;
        let mut layers = 0..;
        let mut linear = |x: &Tensor| p.linear(layers.next().unwrap_or_default(), x);
        let mut branches = Vec::with_capacity(2);
        if self.dims.latent > 0 {
            let hidden = linear(&observation.narrow(1, 0, self.dims.latent)).relu();
            branches.push(linear(&hidden).relu());
        }
        if self.dims.raw > 0 {
            branches.push(linear(&observation.narrow(1, self.dims.latent, self.dims.raw)).relu());
        }
        let joined = linear(&Tensor::cat(&branches, 1)).relu();
        let joined = linear(&joined).relu();
        linear(&joined)
    }
}

/// Two critics of one form: Q1 and Q2.
#[derive(Debug)]
pub struct Critics {
    /// All weights and biases of both critics; leading dimension 2.
    pub params: Params,
    layers: usize,
}

impl Critics {
    /// A new pair with `hidden` layers between observation + action and the one output.
    pub fn new(dims: Dims, hidden: &[i64], rng: &mut impl Rng, device: Device) -> Self {
        let sizes = [&[dims.observation() + dims.actions], hidden, &[1]].concat();
        let mut draw = Draw::new(rng);
        draw.chain(Some(2), &sizes);
        Self { params: draw.finish(device), layers: sizes.len() - 1 }
    }

    /// A copy with its own memory.
    pub fn copy(&self, device: Device) -> Self {
        Self { params: self.params.copy(device), layers: self.layers }
    }

    /// Both outputs [2, B], before [`CriticEnd`].
    pub fn forward(&self, observation: &Tensor, action: &Tensor) -> Tensor {
        let x = Tensor::cat(&[observation, action], 1).unsqueeze(0);
        let size = x.size();
        let mut x = x.expand([2, size[1], size[2]], false);
        for layer in 0..self.layers {
            x = self.params.linear_pair(layer, &x);
            if layer + 1 < self.layers {
                x = x.relu();
            }
        }
        x.squeeze_dim(2)
    }

    /// Q1 only, `[B]`: the actor's objective.
    pub fn first(&self, observation: &Tensor, action: &Tensor) -> Tensor {
        let mut x = Tensor::cat(&[observation, action], 1);
        for layer in 0..self.layers {
            x = self.params.linear_first(layer, &x);
            if layer + 1 < self.layers {
                x = x.relu();
            }
        }
        x.squeeze_dim(1)
    }
}

/// Bounds of the logarithm of WAD-S' standard deviations; a tanh moves between them.
const LOG_STD: [f64; 2] = [-5.0, 2.0];

/// Initial log standard deviation, before its tanh: exp(-1.0), a third of the range.
const START_LOG_STD: f32 = 0.145;

/// WAD-S' policy: a squashed Gaussian.
#[derive(Debug)]
pub struct PolicyS {
    /// All weights and biases.
    pub params: Params,
    actions: i64,
    squash: Squash,
}

impl PolicyS {
    /// A new policy.
    pub fn new(dims: Dims, rng: &mut impl Rng, device: Device) -> Self {
        let mut draw = Draw::new(rng);
        draw.chain(None, &[dims.observation(), HIDDEN_S[0], HIDDEN_S[1], HIDDEN_S[2]]);
        // Pedals are rescaled tanhs here: half of a sigmoid's argument.
        let mut biases: Vec<f32> =
            start(dims.actions).iter().enumerate().map(|(i, b)| if i == 0 { *b } else { 0.5 * b }).collect();
        biases.resize(2 * dims.actions as usize, START_LOG_STD);
        draw.last_layer(HIDDEN_S[2], &biases);
        Self { params: draw.finish(device), actions: dims.actions, squash: Squash::new(dims.actions, device) }
    }

    /// A copy with its own memory.
    pub fn copy(&self, device: Device) -> Self {
        Self {
            params: self.params.copy(device),
            actions: self.actions,
            squash: Squash::new(self.actions, device),
        }
    }

    /// Means and logarithms of the standard deviations, each [B, A], before the squashing.
    pub fn distribution(&self, observation: &Tensor) -> (Tensor, Tensor) {
        let p = &self.params;
        let mut x = observation.shallow_clone();
        for layer in 0..HIDDEN_S.len() {
            x = p.linear(layer, &x).relu();
        }
        let x = p.linear(HIDDEN_S.len(), &x);
        let mean = x.narrow(1, 0, self.actions);
        let log_std = x.narrow(1, self.actions, self.actions).tanh();
        let [low, high] = LOG_STD;
        (mean, log_std * (0.5 * (high - low)) + 0.5 * (high + low))
    }

    /// The deterministic action, [B, A].
    pub fn mean_action(&self, observation: &Tensor) -> Tensor {
        self.squash.rescale(&self.distribution(observation).0.tanh())
    }

    /// The action sampled with standard normal `noise` [B, A].
    pub fn sample(&self, observation: &Tensor, noise: &Tensor) -> Tensor {
        let (mean, log_std) = self.distribution(observation);
        self.squash.rescale(&(mean + log_std.exp() * noise).tanh())
    }

    /// The same with the log-probability `[B]`, the density taken over -1..1 for all three numbers:
    ///
    /// u = mean + std n;  log pi = sum(log N(u) - log(1 - tanh(u)^2))
    pub fn sample_with_log_prob(&self, observation: &Tensor, noise: &Tensor) -> (Tensor, Tensor) {
        let (mean, log_std) = self.distribution(observation);
        let u = mean + log_std.exp() * noise;
        let gaussian = noise * noise * -0.5 - &log_std - 0.5 * std::f64::consts::TAU.ln();
        // log(1 - tanh(u)^2) = 2 (log 2 - u - softplus(-2 u)), which does not lose its digits.
        let squashed = ((&u + (&u * -2.0).softplus()) * -1.0 + std::f64::consts::LN_2) * 2.0;
        let log_prob = (gaussian - squashed).sum_dim_intlist([1i64].as_slice(), false, Kind::Float);
        (self.squash.rescale(&u.tanh()), log_prob)
    }
}

/// WAD-S' value network.
#[derive(Debug)]
pub struct Value {
    /// All weights and biases.
    pub params: Params,
}

impl Value {
    /// A new network.
    pub fn new(dims: Dims, rng: &mut impl Rng, device: Device) -> Self {
        let mut draw = Draw::new(rng);
        draw.chain(None, &[dims.observation(), HIDDEN_S[0], HIDDEN_S[1], HIDDEN_S[2], 1]);
        Self { params: draw.finish(device) }
    }

    /// A copy with its own memory.
    pub fn copy(&self, device: Device) -> Self {
        Self { params: self.params.copy(device) }
    }

    /// Values `[B]`.
    pub fn forward(&self, observation: &Tensor) -> Tensor {
        let mut x = observation.shallow_clone();
        for layer in 0..HIDDEN_S.len() {
            x = self.params.linear(layer, &x).relu();
        }
        self.params.linear(HIDDEN_S.len(), &x).squeeze_dim(1)
    }
}
