//! An update's input and output: transitions on the device with scaled observations, and metrics.

use super::networks::Dims;
pub use super::params::{InputScale, Inputs};
use super::replay_buffer::Sampled;
use rand::{Rng, RngExt};
use std::collections::BTreeMap;
use tch::{Device, Kind, Tensor, no_grad};

/// One update's transitions, on the learner's device, observations scaled.
#[derive(Debug)]
pub struct Batch {
    /// [B, latent + raw]
    pub observation: Tensor,
    /// The observation after the transition's last reward, [B, latent + raw].
    pub next_observation: Tensor,
    /// [B, A]
    pub action: Tensor,
    /// `[B]`, scaled.
    pub reward: Tensor,
    /// gamma^n, or 0 where the episode terminated, `[B]`.
    pub discount: Tensor,
    /// 1 where an expert's action is known, else 0, `[B]`.
    pub is_shown: Tensor,
    /// The expert's action, [B, A]; its values do not matter where `is_shown` is 0.
    pub shown: Tensor,
    /// Standard normal noise, [B, A]: the update's only randomness.
    pub noise: Tensor,
}

/// Several batches, brought to the device together.
#[derive(Debug)]
pub struct Batches {
    /// [K, 2, B, D]: now and next.
    observations: Tensor,
    /// [K, B, 3 A + 3]: action, noise, reward, discount, whether shown, the shown action.
    rest: Tensor,
    actions: i64,
}

impl Batches {
    /// Moves a sample of the replay buffer to `device`, and scales the observations.
    ///
    /// # Panics
    /// `sampled` is not of `dims`.
    pub fn upload(sampled: &Sampled, dims: Dims, scale: &Scale, device: Device) -> Self {
        let (k, b) = (sampled.batches as i64, sampled.size as i64);
        // SAFETY: `f16` is two bytes without padding and any byte is valid as `u8`, so the slice covers
        // exactly the memory of `latents`, which outlives it.
        let bytes = unsafe {
            std::slice::from_raw_parts(sampled.latents.as_ptr().cast::<u8>(), 2 * sampled.latents.len())
        };
        let latents = Tensor::from_data_size(bytes, &[k, 2, b, dims.latent], Kind::Half);
        let latents = latents.to_device(device).to_kind(Kind::Float);
        let raw = Tensor::from_slice(&sampled.raw).view([k, 2, b, dims.raw]).to_device(device);
        let observations = scale.apply(&Tensor::cat(&[latents, raw], 3));
        let rest = Tensor::from_slice(&sampled.rest).view([k, b, 3 * dims.actions + 3]).to_device(device);
        Self { observations, rest, actions: dims.actions }
    }

    /// Adds to each latent, now and next, a share of the difference between two others of its batch, drawn
    /// with `rng` uniformly from 0 to `most` per transition, so that the agent relies less on the look of a
    /// day.
    pub fn mix_latents(&self, dims: Dims, most: f64, rng: &mut impl Rng) {
        no_grad(|| {
            let mut latents = self.observations.narrow(3, 0, dims.latent);
            let others = latents.select(1, 0);
            let (k, b) = (others.size()[0], others.size()[1]);
            let share: Vec<f32> = (0..k * b).map(|_| rng.random::<f32>() * most as f32).collect();
            let share = Tensor::from_slice(&share).view([k, b, 1]).to_device(latents.device());
            let difference = (others.roll(1, 1) - others.roll(2, 1)) * share;
            let _ = latents.g_add_(&difference.unsqueeze(1));
        });
    }

    /// Batch `i`.
    pub fn get(&self, i: usize) -> Batch {
        let observations = self.observations.get(i as i64);
        let rest = self.rest.get(i as i64);
        let a = self.actions;
        Batch {
            observation: observations.get(0),
            next_observation: observations.get(1),
            action: rest.narrow(1, 0, a),
            noise: rest.narrow(1, a, a),
            reward: rest.select(1, 2 * a),
            discount: rest.select(1, 2 * a + 1),
            is_shown: rest.select(1, 2 * a + 2),
            shown: rest.narrow(1, 2 * a + 3, a),
        }
    }
}

impl InputScale {
    /// On a device.
    pub fn tensors(&self, device: Device) -> Scale {
        Scale {
            offset: Tensor::from_slice(&self.offset).to_device(device),
            factor: Tensor::from_slice(&self.factor).to_device(device),
        }
    }
}

/// [`InputScale`] as tensors.
#[derive(Debug)]
pub struct Scale {
    offset: Tensor,
    factor: Tensor,
}

impl Scale {
    /// Scales observations [.., D].
    pub fn apply(&self, observation: &Tensor) -> Tensor {
        (observation - &self.offset) * &self.factor
    }
}

/// Sums of metrics, kept on the device until they are read.
#[derive(Debug, Default)]
pub struct Metrics {
    sums: BTreeMap<&'static str, (Tensor, u32)>,
}

impl Metrics {
    pub(super) fn add(&mut self, name: &'static str, value: &Tensor) {
        no_grad(|| match self.sums.get_mut(name) {
            Some((sum, count)) => {
                *sum += value;
                *count += 1;
            }
            None => {
                self.sums.insert(name, (value.detach().copy(), 1));
            }
        });
    }

    pub(super) fn add_pair(&mut self, names: [&'static str; 2], pair: &Tensor) {
        for (i, name) in names.into_iter().enumerate() {
            self.add(name, &pair.get(i as i64));
        }
    }

    /// The means since the last call.
    pub fn take(&mut self) -> BTreeMap<&'static str, f64> {
        std::mem::take(&mut self.sums)
            .into_iter()
            .map(|(name, (sum, count))| (name, sum.double_value(&[]) / f64::from(count)))
            .collect()
    }
}
