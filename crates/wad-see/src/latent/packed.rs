//! The encoder for one image, without libtorch: half-precision weights in the order of AVX-512's loads.
//!
//! For a single image the last layers are limited by memory: 10 MB of weights for 16 pixels or fewer. Half
//! precision halves that, and the processor widens the weights as it reads them: no number changes, and
//! sums are in single precision. Batch norm and standardisation are a factor and an offset per
//! channel after the sum. Processors without AVX-512 leave the work to libtorch.

use super::network::Autoencoder;
use crate::observation::LATENT_SIZE;
use crate::perception::{TRANSFORMED_SIZE, TransformedImage};
use crate::weights::Weights;
use tch::{Kind, TchError, Tensor};

/// Outputs that are computed together, and pixels.
const WIDE: usize = 64;
const NARROW: usize = 32;
const PIXELS: usize = 4;
/// Pixels whose inputs are gathered at once, at least: more reads of the weights otherwise.
const GATHERED: usize = 32;

/// A layer: outputs = relu?(inputs x weights * factor + bias).
#[derive(Debug)]
struct Layer {
    /// Side of the picture that comes in, and its channels.
    side: usize,
    channels: usize,
    /// Numbers per pixel, a multiple of [`NARROW`].
    outputs: usize,
    /// By block of [`WIDE`] outputs ([`NARROW`] where they do not fill those): for each input (kernel row,
    /// kernel column, channel) the block's weights, as bits of half-precision numbers.
    weights: Vec<u16>,
    /// Per output.
    factor: Vec<f32>,
    bias: Vec<f32>,
}

impl Layer {
    /// Inputs per pixel of a convolution.
    fn inputs(&self) -> usize {
        9 * self.channels
    }

    /// Of weights (outputs, inputs), and factor and bias per output; padded to whole blocks.
    fn new(
        (side, channels): (usize, usize),
        weights: &Tensor,
        factor: &Tensor,
        bias: &Tensor,
    ) -> Result<Self, TchError> {
        let (wanted, inputs) = match weights.size()[..] {
            [outputs, inputs] => (outputs as usize, inputs as usize),
            _ => return Err(TchError::Convert("expected a matrix of weights".to_string())),
        };
        let outputs = wanted.next_multiple_of(NARROW);
        let block = block(outputs);
        let mut flat = vec![half::f16::ZERO; wanted * inputs];
        weights.f_contiguous()?.f_copy_data(&mut flat, wanted * inputs)?;
        let mut packed = vec![0; outputs * inputs];
        for (output, row) in flat.chunks_exact(inputs.max(1)).enumerate() {
            let first = output / block * block * inputs + output % block;
            for (input, weight) in row.iter().enumerate() {
                packed[first + input * block] = weight.to_bits();
            }
        }
        let numbers = |tensor: &Tensor| -> Result<Vec<f32>, TchError> {
            let mut numbers = vec![0.0; wanted];
            tensor.f_to_kind(Kind::Float)?.f_contiguous()?.f_copy_data(&mut numbers, wanted)?;
            numbers.resize(outputs, 0.0);
            Ok(numbers)
        };
        Ok(Self { side, channels, outputs, weights: packed, factor: numbers(factor)?, bias: numbers(bias)? })
    }

    /// The inputs of a convolution's output pixels in `rows`: for each pixel kernel row, column, channel.
    fn gather(&self, picture: &[f32], rows: std::ops::Range<usize>, gathered: &mut Vec<f32>) {
        let (side, channels, half) = (self.side, self.channels, self.side / 2);
        let count = rows.len() * half * self.inputs();
        gathered.resize(count, 0.0);
        let mut parts = gathered.chunks_exact_mut(3 * channels);
        for (y, x) in rows.flat_map(|y| (0..half).map(move |x| (y, x))) {
            for (row, part) in (0..3).zip(&mut parts) {
                // The row and the column before the first are padding; behind the last none is needed.
                let Some(line) = (2 * y + row).checked_sub(1) else {
                    part.fill(0.0);
                    continue;
                };
                let line = &picture[line * side * channels..][..side * channels];
                match (2 * x).checked_sub(1) {
                    Some(first) => part.copy_from_slice(&line[first * channels..][..3 * channels]),
                    None => {
                        let (pad, rest) = part.split_at_mut(channels);
                        pad.fill(0.0);
                        rest.copy_from_slice(&line[..2 * channels]);
                    }
                }
            }
        }
    }

    /// The picture after this convolution, pixel by pixel.
    fn convolve(&self, picture: &[f32], gathered: &mut Vec<f32>, out: &mut Vec<f32>) {
        let half = self.side / 2;
        out.resize(half * half * self.outputs, 0.0);
        let step = (GATHERED / half).clamp(1, half);
        for first in (0..half).step_by(step) {
            let rows = first..(first + step).min(half);
            let made = rows.len() * half * self.outputs;
            self.gather(picture, rows, gathered);
            self.product(gathered, true, &mut out[first * half * self.outputs..][..made]);
        }
    }

    /// Pixels by pixels: `inputs` times weights.
    fn product(&self, inputs: &[f32], relu: bool, out: &mut [f32]) {
        let pixels = out.len() / self.outputs;
        let count = inputs.len() / pixels.max(1);
        for (n, weights) in self.weights.chunks_exact(count * block(self.outputs)).enumerate() {
            let block = block(self.outputs);
            let job = Job { layer: self, inputs, count, weights, first: n * block, relu };
            // SAFETY: a packed encoder is only made where the processor has AVX-512 F.
            #[cfg(target_arch = "x86_64")]
            unsafe {
                match (block, pixels.is_multiple_of(PIXELS)) {
                    (WIDE, true) => job.run::<{ WIDE / 16 }, PIXELS>(out),
                    (WIDE, false) => job.run::<{ WIDE / 16 }, 1>(out),
                    (_, true) => job.run::<{ NARROW / 16 }, PIXELS>(out),
                    (_, false) => job.run::<{ NARROW / 16 }, 1>(out),
                }
            }
            #[cfg(not(target_arch = "x86_64"))]
            job.run(out);
        }
    }
}

/// Outputs computed together in a layer of so many.
fn block(outputs: usize) -> usize {
    if outputs.is_multiple_of(WIDE) { WIDE } else { NARROW }
}

/// One block of outputs of some pixels.
struct Job<'a> {
    layer: &'a Layer,
    inputs: &'a [f32],
    /// Inputs per pixel.
    count: usize,
    weights: &'a [u16],
    /// The block's first output.
    first: usize,
    relu: bool,
}

impl Job<'_> {
    /// `P` pixels at a time, `V` vectors of 16 outputs.
    ///
    /// # Safety
    /// The processor must have AVX-512 F.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx512f")]
    fn run<const V: usize, const P: usize>(&self, out: &mut [f32]) {
        use std::arch::x86_64::{
            __m512, _mm256_loadu_si256, _mm512_cvtph_ps, _mm512_fmadd_ps, _mm512_loadu_ps, _mm512_max_ps,
            _mm512_set1_ps, _mm512_setzero_ps, _mm512_storeu_ps,
        };
        let width = self.layer.outputs;
        let load = |numbers: &[f32], at: usize| -> __m512 {
            let numbers = &numbers[at..at + 16];
            // SAFETY: there are 16 of them.
            unsafe { _mm512_loadu_ps(numbers.as_ptr()) }
        };
        for (inputs, out) in self.inputs.chunks_exact(P * self.count).zip(out.chunks_exact_mut(P * width)) {
            let rows: [&[f32]; P] = std::array::from_fn(|p| &inputs[p * self.count..][..self.count]);
            let mut sums = [[_mm512_setzero_ps(); V]; P];
            for (k, weights) in self.weights.chunks_exact(16 * V).enumerate() {
                let (vectors, _) = weights.as_chunks::<16>();
                let weights: [__m512; V] = std::array::from_fn(|v| {
                    // SAFETY: 16 numbers of 16 bits.
                    _mm512_cvtph_ps(unsafe { _mm256_loadu_si256(vectors[v].as_ptr().cast()) })
                });
                for p in 0..P {
                    let input = _mm512_set1_ps(rows[p][k]);
                    for v in 0..V {
                        sums[p][v] = _mm512_fmadd_ps(input, weights[v], sums[p][v]);
                    }
                }
            }
            let least = _mm512_set1_ps(if self.relu { 0.0 } else { f32::NEG_INFINITY });
            for (sums, out) in sums.iter().zip(out.chunks_exact_mut(width)) {
                for (v, sum) in sums.iter().enumerate() {
                    let at = self.first + 16 * v;
                    let (factor, bias) = (load(&self.layer.factor, at), load(&self.layer.bias, at));
                    let made = _mm512_max_ps(_mm512_fmadd_ps(*sum, factor, bias), least);
                    let out = &mut out[at..at + 16];
                    // SAFETY: there is room for 16.
                    unsafe { _mm512_storeu_ps(out.as_mut_ptr(), made) };
                }
            }
        }
    }

    /// Never run: a packed encoder is not made on such a processor.
    #[cfg(not(target_arch = "x86_64"))]
    fn run(&self, _out: &mut [f32]) {}
}

/// The whole encoder.
#[derive(Debug)]
pub struct Packed {
    convolutions: Vec<Layer>,
    last: Layer,
}

/// Room that encoding needs; keep it between images.
#[derive(Debug, Default)]
pub struct Scratch {
    picture: Vec<f32>,
    next: Vec<f32>,
    gathered: Vec<f32>,
}

impl Packed {
    /// Of an encoder's weights; None where the processor cannot, or the file's numbers are not in half
    /// precision. `mean` and `deviation` (200) standardise the latent.
    ///
    /// # Errors
    /// torch fails.
    pub fn new(
        network: &Autoencoder,
        weights: &Weights,
        mean: &Tensor,
        deviation: &Tensor,
    ) -> Result<Option<Self>, TchError> {
        let architecture = &network.architecture;
        let is_fit = architecture.encoder.iter().all(|channels| channels % NARROW as i64 == 0);
        if !has_avx512() || !is_fit {
            return Ok(None);
        }
        let find = |name: String| {
            let tensor = weights.tensors.iter().find(|(n, _)| *n == name).map(|(_, tensor)| tensor);
            tensor.filter(|tensor| tensor.kind() == Kind::Half)
        };
        let (mut side, mut channels) = (TRANSFORMED_SIZE, 3);
        let mut convolutions = Vec::new();
        for (i, &outputs) in architecture.encoder.iter().enumerate() {
            let Some(weights) = find(format!("encoder.conv{}.weight", i + 1)) else { return Ok(None) };
            let (mut factor, bias) = network.encoder_affine(i)?;
            if i == 0 {
                // Bytes come in.
                factor = factor.f_div_scalar(255.0)?;
            }
            let weights = weights.f_permute([0, 2, 3, 1])?.f_reshape([outputs, -1])?;
            convolutions.push(Layer::new((side, channels), &weights, &factor, &bias)?);
            (side, channels) = (side / 2, outputs as usize);
        }
        let Some(weights) = find("encoder.latent.weight".to_string()) else { return Ok(None) };
        // The features come by channel, ours by pixel.
        let latent = architecture.latent;
        let weights = weights.f_narrow(0, 0, latent)?.f_view([latent, channels as i64, -1])?;
        let weights = weights.f_permute([0, 2, 1])?.f_reshape([latent, -1])?;
        let bias = network.latent_bias()?.f_sub(mean)?.f_div(deviation)?;
        let last = Layer::new((side, channels), &weights, &deviation.f_reciprocal()?, &bias)?;
        Ok(Some(Self { convolutions, last }))
    }

    /// The latent of an image.
    pub fn encode(&self, image: &TransformedImage, scratch: &mut Scratch, latent: &mut Vec<f32>) {
        let Scratch { picture, next, gathered } = scratch;
        picture.clear();
        picture.extend(image.bytes().iter().map(|byte| f32::from(*byte)));
        for layer in &self.convolutions {
            layer.convolve(picture, gathered, next);
            std::mem::swap(picture, next);
        }
        latent.resize(self.last.outputs, 0.0);
        self.last.product(picture, false, latent);
        latent.truncate(LATENT_SIZE);
    }
}

fn has_avx512() -> bool {
    #[cfg(target_arch = "x86_64")]
    return std::is_x86_feature_detected!("avx512f");
    #[cfg(not(target_arch = "x86_64"))]
    false
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::latent::{Encoder, TchEncoder};
    use rand::RngExt;
    use sumo_network::seeds;

    #[test]
    fn latents_are_those_of_the_trained_network() {
        let mut encoder = TchEncoder::find("default").unwrap();
        let mut rng = seeds::rng(5, "images");
        let mut worst = 0.0_f32;
        for n in 0..6 {
            let mut image = TransformedImage::default();
            // Noise, then broad stripes: every layer has something to do.
            for (at, byte) in image.bytes_mut().iter_mut().enumerate() {
                *byte = if n % 2 == 0 { rng.random() } else { ((at >> (2 + n)) % 200) as u8 };
            }
            let mut latent = Vec::new();
            encoder.encode(&image, &mut latent).unwrap();
            let wanted = encoder.encode_as_trained(&image).unwrap();
            assert_eq!((latent.len(), wanted.len()), (LATENT_SIZE, LATENT_SIZE));
            let apart = latent.iter().zip(&wanted).map(|(a, b)| (a - b).abs());
            worst = apart.fold(worst, f32::max);
            assert!(wanted.iter().any(|v| v.abs() > 0.3), "{wanted:?}");
        }
        assert!(worst < 1e-4, "{worst}");
    }
}
