//! A trained actor in plain Rust: the forward pass of [`super::params`]' networks for one observation, in every build.
//! A test holds it to the networks that learn.

use super::action::{ACTION_SIZE, Action};
use super::params::{Algorithm, Dims, HIDDEN_S, InputScale, Misfit};

/// A layer's weights [inputs, outputs], row by row, and its biases.
#[derive(Clone, Debug)]
struct Layer {
    weights: Vec<f32>,
    biases: Vec<f32>,
}

impl Layer {
    fn forward(&self, x: &[f32], relu: bool) -> Vec<f32> {
        let mut y = self.biases.clone();
        for (x, weights) in x.iter().zip(self.weights.chunks_exact(y.len())) {
            for (y, weight) in y.iter_mut().zip(weights) {
                *y += x * weight;
            }
        }
        if relu {
            // NaN stays NaN, as in libtorch: it is refused at the end.
            y.iter_mut().filter(|y| **y < 0.0).for_each(|y| *y = 0.0);
        }
        y
    }
}

/// The actor of WAD-T or WAD-S with its parameters.
#[derive(Clone, Debug)]
pub struct PlainActor {
    dims: Dims,
    scale: InputScale,
    /// Of the latent and of the raw states; WAD-S has none.
    branches: [Vec<Layer>; 2],
    joined: Vec<Layer>,
    /// The last layer holds what a tanh rescales (WAD-S), not a sigmoid's argument (WAD-T).
    rescales: bool,
}

/// Sizes of the layers: of the latent's branch, of the raw states', and of what follows both.
fn chains(algorithm: &Algorithm, dims: Dims) -> [Vec<usize>; 3] {
    let (latent, raw, actions) = (dims.latent as usize, dims.raw as usize, dims.actions as usize);
    if matches!(algorithm, Algorithm::Sac(_)) {
        let [a, b, c] = HIDDEN_S.map(|size| size as usize);
        return [vec![], vec![], vec![latent + raw, a, b, c, 2 * actions]];
    }
    // A part that is left out has no branch.
    let latent = if latent > 0 { vec![latent, 150, 100] } else { vec![] };
    let raw = if raw > 0 { vec![raw, 50] } else { vec![] };
    let last = [&latent, &raw].into_iter().filter_map(|branch| branch.last()).sum();
    [latent, raw, vec![last, 100, 75, actions]]
}

fn pairs(chain: &[usize]) -> impl Iterator<Item = (usize, usize)> {
    chain.windows(2).map(|pair| (pair[0], pair[1]))
}

impl PlainActor {
    /// An actor of `algorithm`'s form with the parameters `values`, in the order of the learning networks.
    ///
    /// # Errors
    /// The number of parameters is another.
    pub fn new(
        algorithm: &Algorithm,
        dims: Dims,
        scale: &InputScale,
        values: &[f32],
    ) -> Result<Self, Misfit> {
        let sizes = Self::layers(algorithm, dims);
        let expected = sizes.iter().map(|(inputs, outputs)| inputs * outputs + outputs).sum::<usize>();
        if expected != values.len() {
            let (name, found) = ("actor".to_string(), values.len().to_string());
            return Err(Misfit { name, expected: expected as i64, found });
        }
        let mut left = values;
        let mut take = |count: usize| {
            let (taken, rest) = left.split_at(count);
            left = rest;
            taken.to_vec()
        };
        let [latent, raw, joined] = chains(algorithm, dims).map(|chain| -> Vec<Layer> {
            pairs(&chain)
                .map(|(inputs, outputs)| Layer { weights: take(inputs * outputs), biases: take(outputs) })
                .collect()
        });
        let (branches, rescales) = ([latent, raw], matches!(algorithm, Algorithm::Sac(_)));
        Ok(Self { dims, scale: scale.clone(), branches, joined, rescales })
    }

    /// Inputs and outputs of each layer of an actor of `algorithm`'s form, in the order of its parameters.
    pub fn layers(algorithm: &Algorithm, dims: Dims) -> Vec<(usize, usize)> {
        chains(algorithm, dims).iter().flat_map(|chain| pairs(chain)).collect()
    }

    /// Sizes of its inputs and outputs.
    pub fn dims(&self) -> Dims {
        self.dims
    }

    /// The deterministic action for `observation` (latent, then raw).
    ///
    /// # Panics
    /// The observation has another size than the network's.
    pub fn act(&self, observation: &[f32]) -> Action {
        assert_eq!(observation.len(), self.dims.observation() as usize, "numbers of the observation");
        let scaled = observation.iter().zip(self.scale.offset.iter().zip(&self.scale.factor));
        let scaled: Vec<f32> = scaled.map(|(x, (offset, factor))| (x - offset) * factor).collect();
        let (latent, raw) = scaled.split_at(self.dims.latent as usize);
        let mut x = Vec::new();
        for (input, branch) in [latent, raw].into_iter().zip(&self.branches) {
            let passed = branch.iter().fold(input.to_vec(), |x, layer| layer.forward(&x, true));
            x.extend(passed);
        }
        for (index, layer) in self.joined.iter().enumerate() {
            x = layer.forward(&x, index + 1 < self.joined.len());
        }
        let mut action = [0.0; ACTION_SIZE];
        for (index, (out, x)) in action.iter_mut().zip(&x).take(self.dims.actions as usize).enumerate() {
            // sigmoid(x) = (1 + tanh(x / 2)) / 2.
            *out = match (index, self.rescales) {
                (0, _) => x.tanh(),
                (_, true) => 0.5 * x.tanh() + 0.5,
                (_, false) => 0.5 * (0.5 * x).tanh() + 0.5,
            };
        }
        action
    }
}

#[cfg(all(test, feature = "learn"))]
mod tests {
    use super::super::learner::Actor;
    use super::super::params::{Inputs, SacParams, Td3Params};
    use super::*;
    use rand::RngExt;
    use sumo_network::seeds;

    #[test]
    fn actions_are_those_of_the_networks_that_learn() {
        let mut rng = seeds::rng(3, "actors");
        for algorithm in [Algorithm::Td3(Td3Params::default()), Algorithm::Sac(SacParams::default())] {
            for inputs in [Inputs::Both, Inputs::Latent, Inputs::Raw, Inputs::Vector] {
                let dims = inputs.dims();
                let n = dims.observation() as usize;
                let mut draw = |n: usize, most: f32| -> Vec<f32> {
                    (0..n).map(|_| most * (2.0 * rng.random::<f32>() - 1.0)).collect()
                };
                let scale = InputScale { offset: draw(n, 0.5), factor: draw(n, 2.0) };
                let mut learned = Actor::new(&algorithm, dims, &scale);
                let values = draw(learned.size(), 0.2);
                learned.set(&values).unwrap();
                let plain = PlainActor::new(&algorithm, dims, &scale, &values).unwrap();
                let mut moved = 0.0_f32;
                for _ in 0..20 {
                    let observation = draw(n, 1.0);
                    let (found, expected) = (plain.act(&observation), learned.act(&observation));
                    for (found, expected) in found.iter().zip(&expected) {
                        assert!((found - expected).abs() < 1e-5, "{found} {expected}");
                        moved = moved.max((expected - 0.5).abs());
                    }
                }
                assert!(moved > 0.05, "{algorithm:?} {inputs:?}");
                assert!(PlainActor::new(&algorithm, dims, &scale, &values[1..]).is_err());
            }
        }
    }
}
