//! Updates of a training as a file: every tensor of the learner before and after, and the batches between. Other implementations of
//! WAD-T and WAD-S are held to it, as `python/tests/test_learn.py` does.
//!
//!     cargo run --release --example update -- OUT.npz td3 both 2

use rand::RngExt;
use std::error::Error;
use sumo_network::seeds;
use tch::{Device, Tensor};
use wad_learn::agent::batch::{Batch, Metrics};
use wad_learn::agent::exploration::normals;
use wad_learn::agent::learner::{Algorithm, Learner};
use wad_learn::agent::params::Inputs;

/// Transitions of a batch.
const SIZE: i64 = 128;

fn main() -> Result<(), Box<dyn Error>> {
    let usage = "usage: update OUT.npz td3|sac both|latent|raw|vector [UPDATES]";
    let mut arguments = std::env::args().skip(1);
    let out = arguments.next().ok_or(usage)?;
    let algorithm = serde_json::json!({ "algo": arguments.next().ok_or(usage)? });
    let algorithm: Algorithm = serde_json::from_value(algorithm)?;
    let inputs: Inputs = serde_json::from_value(arguments.next().ok_or(usage)?.into())?;
    let updates: u32 = arguments.next().map_or(Ok(2), |text| text.parse())?;

    let dims = inputs.dims();
    let mut rng = seeds::rng(1, "updates");
    let mut learner = Learner::new(&algorithm, dims, 1, Device::Cpu);
    // Larger than a new actor's, so that outputs lie on the flat ends of their sigmoids too.
    let values: Vec<f32> = learner.actor_values().iter().map(|value| 3.0 * value).collect();
    learner.set_actor(&values)?;
    let mut said: Vec<(String, Tensor)> = Vec::new();
    tell("before", &mut learner, &mut said);
    for update in 0..updates {
        let mut normal = |columns: i64| {
            let mut numbers = vec![0.0; (SIZE * columns) as usize];
            normals(&mut rng, &mut numbers);
            Tensor::from_slice(&numbers).view([SIZE, columns])
        };
        let n = dims.observation();
        let (observation, next_observation) = (normal(n), normal(n));
        let (action, noise, reward) = (normal(3).tanh(), normal(3), normal(1).squeeze_dim(1));
        // One transition in twenty ends its episode.
        let discount: Vec<f32> =
            (0..SIZE).map(|_| if rng.random_bool(0.05) { 0.0 } else { 0.98_f32.powi(3) }).collect();
        let parts = [observation, next_observation, action, reward, Tensor::from_slice(&discount), noise];
        let names = ["observation", "next_observation", "action", "reward", "discount", "noise"];
        said.extend(names.iter().zip(&parts).map(|(name, part)| (format!("{update}.{name}"), part.copy())));
        let [observation, next_observation, action, reward, discount, noise] = parts;
        let (is_shown, shown) = (reward.zeros_like(), action.zeros_like());
        let batch = Batch { observation, next_observation, action, reward, discount, is_shown, shown, noise };
        learner.update(&batch, &mut Metrics::default());
    }
    tell("after", &mut learner, &mut said);
    Tensor::write_npz(&said, &out)?;
    println!("{} updates of {} in {out}", learner.updates(), algorithm.agent_name());
    Ok(())
}

fn tell(when: &str, learner: &mut Learner, said: &mut Vec<(String, Tensor)>) {
    let tensors = learner.tensors().into_iter();
    said.extend(tensors.map(|(name, tensor)| (format!("{when}.{name}"), tensor.copy())));
}
