//! The encoder-decoder (paper, section "Latent State Extraction", figure 4).
//!
//! Encoder: six convolutions 3x3, stride 2, channels 32 to 512, batch norm and dropout (of whole channels) after the
//! second and the fifth, ReLU; 128x128 becomes 2x2, and one linear layer makes the latent of 200. Decoder: the
//! latent as a 1x1 picture of 200 channels, seven transposed convolutions 3x3, stride 2, batch norm after
//! the second and the fifth, ReLU, a sigmoid at the end. L2 regularization is Adam's weight decay.
//!
//! The paper gives the first and the last number of channels, 32 and 512; the others are
//! [`Architecture::default`]'s.
//!
//! All parameters lie in one flat tensor, cut into views: one Adam step is a handful of operations over
//! it, and a checkpoint is three tensors.

use super::architecture::{Architecture, EPSILON, NORMED, Slot};
use super::chance;
use rand_chacha::ChaCha8Rng;
use tch::{Device, Kind, TchError, Tensor};

/// Batch norm's share of the new batch in the running statistics.
const MOMENTUM: f64 = 0.1;

/// The parameters cut out of the flat tensor, by name.
pub struct Views {
    slots: Vec<Slot>,
    tensors: Vec<Tensor>,
}

impl Views {
    fn get(&self, name: &str) -> Result<&Tensor, TchError> {
        let missing = || TchError::Convert(format!("no tensor `{name}`"));
        let index = self.slots.iter().position(|slot| slot.name == name).ok_or_else(missing)?;
        self.tensors.get(index).ok_or_else(missing)
    }
}

/// The encoder-decoder with its parameters.
pub struct Autoencoder {
    /// The sizes of the layers.
    pub architecture: Architecture,
    /// All parameters, flat, float32.
    pub theta: Tensor,
    /// Batch norm's running statistics.
    pub statistics: Vec<(String, Tensor)>,
    /// Number type of the convolutions: single precision, or bfloat16 (twice as fast in training where the
    /// processor has matrix units for it). Parameters, latents and pictures made are in single precision either way.
    pub precision: Kind,
    slots: Vec<Slot>,
    decayed: i64,
}

impl Autoencoder {
    /// A network with weights drawn from `rng` (He's normal; biases 0, scales 1).
    ///
    /// # Errors
    /// torch fails, e.g. out of memory.
    pub fn new(architecture: Architecture, rng: &mut ChaCha8Rng, device: Device) -> Result<Self, TchError> {
        let options = (Kind::Float, device);
        let (slots, decayed) = architecture.slots();
        let mut parts = Vec::new();
        for slot in &slots {
            let tensor = if slot.name.ends_with(".weight") {
                // What one output sees: for a transposed convolution of stride 2 a quarter of the kernel.
                let seen: i64 = match slot.name.starts_with("decoder") {
                    true => slot.shape[0] * 9 / 4,
                    false => slot.shape[1..].iter().product(),
                };
                let last = slot.name.starts_with("encoder.latent");
                let gain = if last { 1.0 } else { 2.0 };
                let deviation = (gain / seen as f64).sqrt();
                chance::normal(rng, &slot.shape, device)?.f_mul_scalar(deviation)?
            } else if slot.name.ends_with(".scale") {
                Tensor::f_ones(slot.shape.as_slice(), options)?
            } else {
                Tensor::f_zeros(slot.shape.as_slice(), options)?
            };
            parts.push(tensor.f_reshape([-1])?);
        }
        let theta = Tensor::f_cat(&parts, 0)?;
        let mut statistics = Vec::new();
        for slot in architecture.statistics() {
            let shape = slot.shape.as_slice();
            let tensor = match slot.name.ends_with(".variance") {
                true => Tensor::f_ones(shape, options)?,
                false => Tensor::f_zeros(shape, options)?,
            };
            statistics.push((slot.name, tensor));
        }
        let decayed = slots[..decayed].iter().map(Slot::count).sum();
        Ok(Self { architecture, theta, statistics, precision: Kind::Float, slots, decayed })
    }

    /// The first so many numbers of [`Self::theta`] are weights, which decay.
    pub fn decayed(&self) -> i64 {
        self.decayed
    }

    /// The parameters as views into `flat`, which has [`Self::theta`]'s layout; gradients flow through.
    ///
    /// # Errors
    /// `flat` has another length.
    pub fn views(&self, flat: &Tensor) -> Result<Views, TchError> {
        let counts: Vec<i64> = self.slots.iter().map(Slot::count).collect();
        let parts = flat.f_split_with_sizes(counts, 0)?;
        let tensors = parts
            .iter()
            .zip(&self.slots)
            .map(|(part, slot)| part.f_view(slot.shape.as_slice()))
            .collect::<Result<_, _>>()?;
        Ok(Views { slots: self.slots.clone(), tensors })
    }

    fn statistic(&self, name: &str) -> Result<&Tensor, TchError> {
        let found = self.statistics.iter().find(|(n, _)| n == name);
        found.map(|(_, t)| t).ok_or_else(|| TchError::Convert(format!("no tensor `{name}`")))
    }

    fn normed(
        &self,
        views: &Views,
        part: &str,
        i: usize,
        x: &Tensor,
        train: bool,
    ) -> Result<Tensor, TchError> {
        let name = |what: &str| format!("{part}.norm{}.{what}", i + 1);
        x.f_batch_norm(
            Some(views.get(&name("scale"))?),
            Some(views.get(&name("shift"))?),
            Some(self.statistic(&name("mean"))?),
            Some(self.statistic(&name("variance"))?),
            train,
            MOMENTUM,
            EPSILON,
            true,
        )
    }

    /// Pictures (n, 3, 128, 128), 0..1, to (n, 200), or (n, 400) of a variational one: means, then log
    /// variances. Raw: not yet standardised. With `train`, which then draws dropout, as in training.
    ///
    /// # Errors
    /// torch fails.
    pub fn encode(
        &self,
        views: &Views,
        pictures: &Tensor,
        mut train: Option<&mut ChaCha8Rng>,
    ) -> Result<Tensor, TchError> {
        let mut x = self.in_precision(pictures)?;
        for i in 0..self.architecture.encoder.len() {
            let normed = NORMED.contains(&i);
            let (weight, bias) = self.convolution(views, "encoder", i, normed)?;
            x = x.f_conv2d(&weight, bias.as_ref(), [2, 2], [1, 1], [1, 1], 1)?;
            if normed {
                x = self.normed(views, "encoder", i, &x, train.is_some())?;
            }
            x = x.f_relu()?;
            let dropout = self.architecture.dropout;
            if let Some(rng) = train.as_deref_mut().filter(|_| normed && dropout > 0.0) {
                let shape = [x.size()[0], x.size()[1], 1, 1];
                let kept = chance::uniform(rng, &shape, x.device())?.f_ge(dropout)?;
                x = x.f_mul(&kept.f_to_kind(x.kind())?.f_div_scalar(1.0 - dropout)?)?;
            }
        }
        let weight = views.get("encoder.latent.weight")?;
        let x = x.f_flatten(1, -1)?.f_to_kind(Kind::Float)?;
        x.f_linear(weight, Some(views.get("encoder.latent.bias")?))
    }

    /// Raw latents (n, 200) to pictures (n, 3, 128, 128), 0..1, before the sigmoid.
    ///
    /// # Errors
    /// torch fails.
    pub fn decode_logits(&self, views: &Views, latents: &Tensor, train: bool) -> Result<Tensor, TchError> {
        let last = self.architecture.decoder.len();
        let mut x = self.in_precision(&latents.f_view([-1, self.architecture.latent, 1, 1])?)?;
        for i in 0..=last {
            let normed = NORMED.contains(&i) && i < last;
            let (weight, bias) = self.convolution(views, "decoder", i, normed)?;
            x = x.f_conv_transpose2d(&weight, bias.as_ref(), [2, 2], [1, 1], [1, 1], 1, [1, 1])?;
            if normed {
                x = self.normed(views, "decoder", i, &x, train)?;
            }
            if i < last {
                x = x.f_relu()?;
            }
        }
        x.f_to_kind(Kind::Float)
    }

    /// A picture as convolutions take it: in bfloat16 the processor likes the channels innermost.
    fn in_precision(&self, x: &Tensor) -> Result<Tensor, TchError> {
        if x.kind() == self.precision {
            return Ok(x.shallow_clone());
        }
        let innermost = x.f_to_kind(self.precision)?.f_permute([0, 2, 3, 1])?.f_contiguous()?;
        innermost.f_permute([0, 3, 1, 2])
    }

    /// Weight and bias of a convolution; no bias before a norm.
    fn convolution(
        &self,
        views: &Views,
        part: &str,
        i: usize,
        normed: bool,
    ) -> Result<(Tensor, Option<Tensor>), TchError> {
        let get = |what: &str| views.get(&format!("{part}.conv{}.{what}", i + 1))?.f_to_kind(self.precision);
        Ok((get("weight")?, if normed { None } else { Some(get("bias")?) }))
    }

    /// Every tensor by name: parameters and running statistics.
    ///
    /// # Errors
    /// torch fails.
    pub fn named(&self) -> Result<Vec<(String, Tensor)>, TchError> {
        let views = self.views(&self.theta.f_detach()?)?;
        let mut named: Vec<(String, Tensor)> =
            views.slots.into_iter().map(|slot| slot.name).zip(views.tensors).collect();
        named.extend(self.statistics.iter().map(|(name, t)| (name.clone(), t.shallow_clone())));
        Ok(named)
    }

    /// A network from tensors by name; `find` gives each in the shape asked for.
    ///
    /// # Errors
    /// What `find` says, or torch fails.
    pub fn from_named<E: From<TchError>>(
        architecture: Architecture,
        device: Device,
        find: impl Fn(&Slot) -> Result<Tensor, E>,
    ) -> Result<Self, E> {
        let (slots, decayed) = architecture.slots();
        let take = |slot: &Slot| -> Result<Tensor, E> {
            Ok(find(slot)?.f_to_kind(Kind::Float)?.f_to_device(device)?)
        };
        let mut parts = Vec::new();
        for slot in &slots {
            parts.push(take(slot)?.f_reshape([-1])?);
        }
        let theta = Tensor::f_cat(&parts, 0)?;
        let mut statistics = Vec::new();
        for slot in architecture.statistics() {
            let tensor = take(&slot)?;
            statistics.push((slot.name, tensor));
        }
        let decayed = slots[..decayed].iter().map(Slot::count).sum();
        Ok(Self { architecture, theta, statistics, precision: Kind::Float, slots, decayed })
    }

    /// Factor and offset of each channel after the sum of the encoder's convolution `i` (from 0),
    /// of batch norm where it has one.
    ///
    /// # Errors
    /// torch fails.
    pub fn encoder_affine(&self, i: usize) -> Result<(Tensor, Tensor), TchError> {
        let views = self.views(&self.theta.f_detach()?)?;
        if !NORMED.contains(&i) {
            let bias = views.get(&format!("encoder.conv{}.bias", i + 1))?;
            return Ok((bias.f_ones_like()?, bias.shallow_clone()));
        }
        let name = |what: &str| format!("encoder.norm{}.{what}", i + 1);
        let variance = self.statistic(&name("variance"))?;
        let factor = views.get(&name("scale"))?.f_div(&variance.f_add_scalar(EPSILON)?.f_sqrt()?)?;
        let mean = self.statistic(&name("mean"))?;
        let bias = views.get(&name("shift"))?.f_sub(&mean.f_mul(&factor)?)?;
        Ok((factor, bias))
    }

    /// The linear layer's bias (means alone).
    ///
    /// # Errors
    /// torch fails.
    pub fn latent_bias(&self) -> Result<Tensor, TchError> {
        let views = self.views(&self.theta.f_detach()?)?;
        views.get("encoder.latent.bias")?.f_narrow(0, 0, self.architecture.latent)
    }

    /// The encoder's weights with batch norm folded into the convolutions: weight and bias of each layer,
    /// then of the linear one (means alone).
    ///
    /// # Errors
    /// torch fails.
    pub fn folded_encoder(&self) -> Result<Vec<(Tensor, Tensor)>, TchError> {
        let views = self.views(&self.theta.f_detach()?)?;
        let mut layers = Vec::new();
        for i in 0..self.architecture.encoder.len() {
            let weight = views.get(&format!("encoder.conv{}.weight", i + 1))?;
            let (factor, bias) = self.encoder_affine(i)?;
            layers.push((weight.f_mul(&factor.f_view([-1, 1, 1, 1])?)?, bias));
        }
        let weight = views.get("encoder.latent.weight")?.f_narrow(0, 0, self.architecture.latent)?;
        layers.push((weight, self.latent_bias()?));
        Ok(layers)
    }
}
