//! The networks and losses once more, in plain loops and double precision: what the updates must do.

use super::super::networks::{Dims, HIDDEN_S};

/// A reader of flat parameters: weights [inputs, outputs] then biases, layer by layer.
struct Layers<'a> {
    params: &'a [f64],
    at: usize,
}

impl Layers<'_> {
    fn linear(&mut self, x: &[f64], outputs: usize) -> Vec<f64> {
        let (w, b) = (self.at, self.at + x.len() * outputs);
        self.at = b + outputs;
        (0..outputs)
            .map(|o| {
                let sum: f64 = x.iter().enumerate().map(|(i, x)| x * self.params[w + i * outputs + o]).sum();
                sum + self.params[b + o]
            })
            .collect()
    }

    fn relu(&mut self, x: &[f64], outputs: usize) -> Vec<f64> {
        self.linear(x, outputs).into_iter().map(|x| x.max(0.0)).collect()
    }
}

pub fn sigmoid(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}

/// WAD-T's actor: latent 150-100, raw 50, joined 100-75, steer tanh, pedals sigmoid.
pub fn actor_t(params: &[f64], dims: Dims, observation: &[f64]) -> Vec<f64> {
    let (latent, raw) = observation.split_at(dims.latent as usize);
    let mut layers = Layers { params, at: 0 };
    let latent = layers.relu(latent, 150);
    let mut joined = layers.relu(&latent, 100);
    joined.extend(layers.relu(raw, 50));
    let x = layers.relu(&joined, 100);
    let x = layers.relu(&x, 75);
    let x = layers.linear(&x, dims.actions as usize);
    assert_eq!(layers.at, params.len(), "every parameter is used once");
    x.iter().enumerate().map(|(i, x)| if i == 0 { x.tanh() } else { sigmoid(*x) }).collect()
}

/// One of a pair of critics, before the end.
pub fn critic(params: &[f64], which: usize, hidden: &[i64], observation: &[f64], action: &[f64]) -> f64 {
    let mut x = [observation, action].concat();
    let mut at = 0;
    for (layer, &outputs) in hidden.iter().chain(&[1]).enumerate() {
        let (inputs, outputs) = (x.len(), outputs as usize);
        // Weights of both, then biases of both.
        let w = at + which * inputs * outputs;
        let b = at + 2 * inputs * outputs + which * outputs;
        at += 2 * (inputs + 1) * outputs;
        x = (0..outputs)
            .map(|o| {
                let sum: f64 = x.iter().enumerate().map(|(i, x)| x * params[w + i * outputs + o]).sum();
                let y = sum + params[b + o];
                if layer < hidden.len() { y.max(0.0) } else { y }
            })
            .collect();
    }
    assert_eq!(at, params.len(), "every parameter is used once");
    x[0]
}

/// WAD-S' value network.
pub fn value(params: &[f64], observation: &[f64]) -> f64 {
    let mut layers = Layers { params, at: 0 };
    let mut x = observation.to_vec();
    for outputs in HIDDEN_S {
        x = layers.relu(&x, outputs as usize);
    }
    layers.linear(&x, 1)[0]
}

/// WAD-S' policy with its chance: the action and its log-probability, the density taken over -1..1 and
/// by the definition, log N(u) - log(1 - tanh(u)^2).
pub fn policy_s(params: &[f64], dims: Dims, observation: &[f64], noise: &[f64]) -> (Vec<f64>, f64) {
    let mut layers = Layers { params, at: 0 };
    let mut x = observation.to_vec();
    for outputs in HIDDEN_S {
        x = layers.relu(&x, outputs as usize);
    }
    let a = dims.actions as usize;
    let out = layers.linear(&x, 2 * a);
    assert_eq!(layers.at, params.len(), "every parameter is used once");
    let (mut action, mut log_prob) = (Vec::new(), 0.0);
    for i in 0..a {
        let log_std = -5.0 + 0.5 * 7.0 * (out[a + i].tanh() + 1.0);
        let std = log_std.exp();
        let u = out[i] + std * noise[i];
        let density = (-0.5 * ((u - out[i]) / std).powi(2)).exp() / (std * std::f64::consts::TAU.sqrt());
        log_prob += density.ln() - (1.0 - u.tanh().powi(2)).ln();
        action.push(if i == 0 { u.tanh() } else { 0.5 * (u.tanh() + 1.0) });
    }
    (action, log_prob)
}

/// The slope of `loss` along each parameter of `picked`, by central differences.
pub fn slopes(params: &[f64], picked: &[usize], loss: impl Fn(&[f64]) -> f64) -> Vec<f64> {
    let mut moved = params.to_vec();
    picked
        .iter()
        .map(|&i| {
            const STEP: f64 = 1e-6;
            moved[i] = params[i] + STEP;
            let up = loss(&moved);
            moved[i] = params[i] - STEP;
            let down = loss(&moved);
            moved[i] = params[i];
            (up - down) / (2.0 * STEP)
        })
        .collect()
}
