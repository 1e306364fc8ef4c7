//! The layers of the encoder-decoder, and the names of their tensors.

use crate::observation::LATENT_SIZE;
use crate::perception::{ImageKind, TRANSFORMED_SIZE};
use serde::{Deserialize, Serialize};

/// The sizes of a network's layers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Architecture {
    /// Channels after each of the encoder's convolutions.
    pub encoder: Vec<i64>,
    /// Channels after each of the decoder's convolutions but the last, which makes 3.
    pub decoder: Vec<i64>,
    /// Numbers in the latent.
    pub latent: i64,
    /// The encoder makes a mean and a log variance of each number; the latent is the mean.
    pub variational: bool,
    /// Share of channels that dropout leaves out in training.
    pub dropout: f64,
    /// The image that it takes.
    #[serde(default)]
    pub image: ImageKind,
}

impl Default for Architecture {
    fn default() -> Self {
        Self {
            encoder: vec![32, 64, 128, 256, 256, 512],
            decoder: vec![512, 256, 256, 128, 64, 32],
            latent: LATENT_SIZE as i64,
            variational: false,
            dropout: 0.1,
            image: ImageKind::Transformed,
        }
    }
}

/// Batch norm (and, in the encoder, dropout) comes after these layers, counted from 0.
pub(super) const NORMED: [usize; 2] = [1, 4];
/// What keeps the root of batch norm's variance from 0.
pub(super) const EPSILON: f64 = 1e-5;

/// A named tensor's place among the parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct Slot {
    /// The tensor's name in the weights file.
    pub name: String,
    /// The tensor's shape.
    pub shape: Vec<i64>,
}

impl Slot {
    fn new(name: impl Into<String>, shape: &[i64]) -> Self {
        Self { name: name.into(), shape: shape.to_vec() }
    }

    /// Numbers in it.
    pub fn count(&self) -> i64 {
        self.shape.iter().product()
    }
}

impl Architecture {
    /// Whether the layers bring 128 pixels down to some and a latent back up to 128.
    pub fn is_possible(&self) -> bool {
        let side = TRANSFORMED_SIZE;
        (1..=7).contains(&self.encoder.len())
            && side >> (self.decoder.len() + 1) == 1
            && self.latent > 0
            && self.encoder.iter().chain(&self.decoder).all(|channels| *channels > 0)
    }

    /// Side of the encoder's last picture.
    fn last_side(&self) -> i64 {
        TRANSFORMED_SIZE as i64 >> self.encoder.len()
    }

    /// All trained tensors in order: weights, which decay, then `decayed` says how many, then the rest.
    pub fn slots(&self) -> (Vec<Slot>, usize) {
        let (mut weights, mut rest) = (Vec::new(), Vec::new());
        let mut channels = 3;
        for (i, &next) in self.encoder.iter().enumerate() {
            weights.push(Slot::new(format!("encoder.conv{}.weight", i + 1), &[next, channels, 3, 3]));
            norm_or_bias(&mut rest, "encoder", i, next);
            channels = next;
        }
        let features = channels * self.last_side() * self.last_side();
        let outputs = if self.variational { 2 * self.latent } else { self.latent };
        weights.push(Slot::new("encoder.latent.weight", &[outputs, features]));
        rest.push(Slot::new("encoder.latent.bias", &[outputs]));
        let mut channels = self.latent;
        for (i, &next) in self.decoder.iter().chain(&[3]).enumerate() {
            weights.push(Slot::new(format!("decoder.conv{}.weight", i + 1), &[channels, next, 3, 3]));
            norm_or_bias(&mut rest, "decoder", i, next);
            channels = next;
        }
        let decayed = weights.len();
        weights.extend(rest);
        (weights, decayed)
    }

    /// Batch norm's running statistics.
    pub fn statistics(&self) -> Vec<Slot> {
        let mut slots = Vec::new();
        for (part, layers) in [("encoder", &self.encoder), ("decoder", &self.decoder)] {
            for i in NORMED {
                if let Some(&channels) = layers.get(i) {
                    slots.push(Slot::new(format!("{part}.norm{}.mean", i + 1), &[channels]));
                    slots.push(Slot::new(format!("{part}.norm{}.variance", i + 1), &[channels]));
                }
            }
        }
        slots
    }
}

/// A normed layer's scale and shift, or another's bias.
fn norm_or_bias(rest: &mut Vec<Slot>, part: &str, layer: usize, channels: i64) {
    if NORMED.contains(&layer) {
        rest.push(Slot::new(format!("{part}.norm{}.scale", layer + 1), &[channels]));
        rest.push(Slot::new(format!("{part}.norm{}.shift", layer + 1), &[channels]));
    } else {
        rest.push(Slot::new(format!("{part}.conv{}.bias", layer + 1), &[channels]));
    }
}
