//! The frozen encoder as the agents use it, and the decoder for pictures.

use super::architecture::Slot;
use super::file::{self, KIND, keys};
use super::network::{Autoencoder, Views};
use super::packed::{Packed, Scratch};
use super::{Decoder, Encoder, LatentError};
use crate::observation::LATENT_SIZE;
use crate::perception::{ImageKind, TRANSFORMED_SIZE, TransformedImage};
use crate::weights::{Stored, Weights, WeightsError, half};
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use tch::{Device, Kind, TchError, Tensor};
use wad_camera::CameraConfig;

/// The encoder-decoder, frozen. Its latent is standardised: over the training images each number has mean
/// 0 and standard deviation 1.
pub struct TchEncoder {
    network: Autoencoder,
    /// Batch norm and standardisation folded in: weight and bias of each layer.
    layers: Vec<(Tensor, Tensor)>,
    /// For one image at a time; None of weights in single precision.
    packed: Option<Arc<Packed>>,
    scratch: Scratch,
    /// Mean and deviation of the raw latent (200).
    mean: Tensor,
    deviation: Tensor,
    views: Views,
    device: Device,
    hash: String,
}

impl std::fmt::Debug for TchEncoder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("TchEncoder").field("hash", &self.hash).finish_non_exhaustive()
    }
}

impl TchEncoder {
    /// The encoder that `name` means: a file, a folder with `encoder.safetensors`, or a bundled one's name
    /// (`default`), on the processor.
    ///
    /// # Errors
    /// There is none of that name, or the file does not fit this program.
    pub fn find(name: &str) -> Result<Self, LatentError> {
        Ok(Self::of(file::find(name)?, Device::Cpu)?)
    }

    /// Reads a file.
    ///
    /// # Errors
    /// The file cannot be read or does not fit this program.
    pub fn load(path: &Path, device: Device) -> Result<Self, WeightsError> {
        Self::of(Weights::load(path)?, device)
    }

    /// An encoder from weights.
    ///
    /// # Errors
    /// They are of another network or of another camera.
    pub fn of(weights: Weights, device: Device) -> Result<Self, WeightsError> {
        crate::torch::one_thread();
        let (architecture, hash) = file::check(&weights)?;
        let find = |slot: &Slot| weights.get(&slot.name, &slot.shape);
        let network = Autoencoder::from_named(architecture, device, find)?;
        let latent = [LATENT_SIZE as i64];
        let float = |name: &str| -> Result<Tensor, WeightsError> {
            Ok(weights.get(name, &latent)?.f_to_kind(Kind::Float)?.f_to_device(device)?)
        };
        let (mean, deviation) = (float("latent.mean")?, float("latent.deviation")?);
        let mut layers = network.folded_encoder()?;
        if let Some((weight, bias)) = layers.last_mut() {
            *bias = bias.f_sub(&mean)?.f_div(&deviation)?;
            *weight = weight.f_div(&deviation.f_view([-1, 1])?)?;
        }
        let convolutions = layers.len().saturating_sub(1);
        for (weight, _) in &mut layers[..convolutions] {
            *weight = channels_last(weight)?;
        }
        let packed = match device {
            Device::Cpu => Packed::new(&weights, &network.architecture)?.map(Arc::new),
            _ => None,
        };
        let views = network.views(&network.theta)?;
        let scratch = Scratch::default();
        Ok(Self { network, layers, packed, scratch, mean, deviation, views, device, hash })
    }

    /// Images (n, 128, 128, 3) of bytes to latents (n, 200), on the encoder's device.
    ///
    /// # Errors
    /// torch fails.
    pub fn encode_tensor(&self, images: &Tensor) -> Result<Tensor, TchError> {
        tch::no_grad(|| {
            // Channels last in memory, as the bytes are: two thirds of the time of channels first.
            let images = images.f_to_device(self.device)?.f_permute([0, 3, 1, 2])?;
            let mut x = images.f_to_kind(Kind::Float)?.f_div_scalar(255.0)?;
            let Some(((weight, bias), convolutions)) = self.layers.split_last() else {
                return Err(TchError::Convert("an encoder without layers".to_string()));
            };
            for (weight, bias) in convolutions {
                x = x.f_conv2d(weight, Some(bias), [2, 2], [1, 1], [1, 1], 1)?.f_relu_()?;
            }
            x.f_flatten(1, -1)?.f_linear(weight, Some(bias))
        })
    }

    /// The latent of one image, by the network as it was trained: nothing folded, nothing packed.
    ///
    /// # Errors
    /// torch fails.
    pub fn encode_as_trained(&self, image: &TransformedImage) -> Result<Vec<f32>, LatentError> {
        tch::no_grad(|| {
            let pictures = to_pictures(&images_tensor(image.bytes(), 1)?.f_to_device(self.device)?)?;
            let raw = self.network.encode(&self.views, &pictures, None)?;
            let raw = raw.f_narrow(1, 0, LATENT_SIZE as i64)?;
            let encoded = raw.f_sub(&self.mean)?.f_div(&self.deviation)?.f_to_device(Device::Cpu)?;
            let mut latent = vec![0.0; LATENT_SIZE];
            encoded.f_copy_data(&mut latent, LATENT_SIZE)?;
            Ok(latent)
        })
    }

    /// The latent of one image, the fastest way.
    ///
    /// # Errors
    /// torch fails.
    pub fn encode_one(
        &self,
        image: &TransformedImage,
        scratch: &mut Scratch,
        latent: &mut Vec<f32>,
    ) -> Result<(), LatentError> {
        if let Some(packed) = &self.packed {
            packed.encode(image, scratch, latent);
            return Ok(());
        }
        let encoded = self.encode_tensor(&images_tensor(image.bytes(), 1)?)?.f_to_device(Device::Cpu)?;
        latent.resize(LATENT_SIZE, 0.0);
        Ok(encoded.f_copy_data(latent, LATENT_SIZE)?)
    }

    /// The latents of many images, `batch` at a time.
    ///
    /// # Errors
    /// torch fails.
    pub fn encode_all(
        &self,
        images: &[&TransformedImage],
        batch: usize,
    ) -> Result<Vec<Vec<f32>>, LatentError> {
        let mut latents = Vec::with_capacity(images.len());
        for images in images.chunks(batch.max(1)) {
            let bytes: Vec<u8> = images.iter().flat_map(|image| image.bytes()).copied().collect();
            let tensor = images_tensor(&bytes, images.len())?;
            let encoded = self.encode_tensor(&tensor)?.f_to_device(Device::Cpu)?.f_contiguous()?;
            let mut numbers = vec![0.0_f32; images.len() * LATENT_SIZE];
            let count = numbers.len();
            encoded.f_copy_data(&mut numbers, count)?;
            latents.extend(numbers.chunks(LATENT_SIZE).map(<[f32]>::to_vec));
        }
        Ok(latents)
    }

    /// Latents (n, 200) to images (n, 128, 128, 3) of bytes, on the encoder's device.
    ///
    /// # Errors
    /// torch fails.
    pub fn decode_tensor(&self, latents: &Tensor) -> Result<Tensor, TchError> {
        tch::no_grad(|| {
            let raw = latents.f_to_device(self.device)?.f_mul(&self.deviation)?.f_add(&self.mean)?;
            let pictures = self.network.decode_logits(&self.views, &raw, false)?.f_sigmoid()?;
            let bytes = pictures.f_mul_scalar(255.0)?.f_round()?.f_to_kind(Kind::Uint8)?;
            bytes.f_permute([0, 2, 3, 1])?.f_contiguous()
        })
    }
}

impl Encoder for TchEncoder {
    fn hash(&self) -> &str {
        &self.hash
    }

    fn image_kind(&self) -> ImageKind {
        self.network.architecture.image
    }

    fn camera(&self) -> Option<CameraConfig> {
        Some(CameraConfig::default())
    }

    fn encode(&mut self, image: &TransformedImage, latent: &mut Vec<f32>) -> Result<(), LatentError> {
        let mut scratch = std::mem::take(&mut self.scratch);
        let encoded = self.encode_one(image, &mut scratch, latent);
        self.scratch = scratch;
        encoded
    }
}

impl Decoder for TchEncoder {
    fn decode(&mut self, latent: &[f32], image: &mut TransformedImage) -> Result<(), LatentError> {
        if latent.len() != LATENT_SIZE {
            let found = latent.len();
            return Err(LatentError::Encoder(format!("expected a latent of {LATENT_SIZE}, found {found}")));
        }
        let latent = Tensor::f_from_slice(latent)?.f_view([1, LATENT_SIZE as i64])?;
        let picture = self.decode_tensor(&latent)?.f_to_device(Device::Cpu)?;
        Ok(picture.f_copy_data(image.bytes_mut(), TransformedImage::BYTES)?)
    }
}

/// The same weights (out, in, 3, 3) with the channels last in memory.
fn channels_last(weight: &Tensor) -> Result<Tensor, TchError> {
    weight.f_permute([0, 2, 3, 1])?.f_contiguous()?.f_permute([0, 3, 1, 2])
}

/// Bytes of `count` transformed images as a tensor (count, 128, 128, 3).
///
/// # Errors
/// The number of bytes is another.
pub fn images_tensor(bytes: &[u8], count: usize) -> Result<Tensor, TchError> {
    let side = TRANSFORMED_SIZE as i64;
    Tensor::f_from_data_size(bytes, &[count as i64, side, side, 3], Kind::Uint8)
}

/// Bytes (n, 128, 128, 3) to pictures (n, 3, 128, 128), 0..1.
///
/// # Errors
/// torch fails.
pub fn to_pictures(images: &Tensor) -> Result<Tensor, TchError> {
    // The bytes are put in order before they are made four times as large.
    images.f_permute([0, 3, 1, 2])?.f_contiguous()?.f_to_kind(Kind::Float)?.f_div_scalar(255.0)
}

/// The file of a trained network: half precision, with `metadata`, the hash added. `mean` and `deviation`
/// (200) standardise the latent.
///
/// # Errors
/// torch fails.
pub fn weights_of(
    network: &Autoencoder,
    mean: &Tensor,
    deviation: &Tensor,
    mut metadata: HashMap<String, String>,
) -> Result<Weights, WeightsError> {
    let mut tensors = Vec::new();
    for (name, tensor) in network.named()? {
        tensors.push((name, half(&tensor)?));
    }
    tensors.push(("latent.mean".to_string(), half(mean)?));
    tensors.push(("latent.deviation".to_string(), half(deviation)?));
    let architecture = serde_json::to_string(&network.architecture).unwrap_or_default();
    metadata.insert(keys::KIND.to_string(), KIND.to_string());
    metadata.insert(keys::ARCHITECTURE.to_string(), architecture);
    metadata.insert(keys::CAMERA.to_string(), CameraConfig::default().hash());
    let mut weights = Weights { path: PathBuf::new(), tensors: Stored::all(&tensors)?, metadata };
    let hash = weights.hash();
    weights.metadata.insert(keys::HASH.to_string(), hash);
    Ok(weights)
}
