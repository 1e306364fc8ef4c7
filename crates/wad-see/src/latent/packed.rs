//! The encoder for one image, without libtorch: half-precision weights in the order in which they are used.
//!
//! For a single image the last layers are limited by memory: 10 MB of weights for 16 pixels or fewer. Half
//! precision halves that, and the processor widens the weights as it reads them: no number changes, and
//! sums are in single precision. Batch norm and standardisation are a factor and an offset per
//! channel after the sum. Each output is one sum in one order, each term multiplied and added with one rounding, so
//! AVX-512 and AVX2 give the same bits.

use super::architecture::{Architecture, EPSILON, NORMED};
use crate::observation::LATENT_SIZE;
use crate::perception::{TRANSFORMED_SIZE, TransformedImage};
use crate::weights::{Weights, WeightsError};
use half::f16;
use safetensors::Dtype;
use wad_camera::{Instructions, instructions};

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

    /// Of so many inputs and `wanted` outputs: `weight` of an output and an input, and factor and bias per output;
    /// padded to whole blocks.
    fn new(
        (side, channels): (usize, usize),
        [wanted, inputs]: [usize; 2],
        weight: impl Fn(usize, usize) -> f16,
        mut factor: Vec<f32>,
        mut bias: Vec<f32>,
    ) -> Self {
        let outputs = wanted.next_multiple_of(NARROW);
        let block = block(outputs);
        let mut packed = vec![0; outputs * inputs];
        for output in 0..wanted {
            let first = output / block * block * inputs + output % block;
            for input in 0..inputs {
                packed[first + input * block] = weight(output, input).to_bits();
            }
        }
        factor.resize(outputs, 0.0);
        bias.resize(outputs, 0.0);
        Self { side, channels, outputs, weights: packed, factor, bias }
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
    fn convolve(&self, level: Instructions, picture: &[f32], gathered: &mut Vec<f32>, out: &mut Vec<f32>) {
        let half = self.side / 2;
        out.resize(half * half * self.outputs, 0.0);
        let step = (GATHERED / half).clamp(1, half);
        for first in (0..half).step_by(step) {
            let rows = first..(first + step).min(half);
            let made = rows.len() * half * self.outputs;
            self.gather(picture, rows, gathered);
            self.product(level, gathered, true, &mut out[first * half * self.outputs..][..made]);
        }
    }

    /// Pixels by pixels: `inputs` times weights.
    fn product(&self, level: Instructions, inputs: &[f32], relu: bool, out: &mut [f32]) {
        let pixels = out.len() / self.outputs;
        let count = inputs.len() / pixels.max(1);
        let block = block(self.outputs);
        for (n, weights) in self.weights.chunks_exact(count * block).enumerate() {
            let job = Job { layer: self, inputs, count, weights, block, first: n * block, relu };
            match level {
                // SAFETY: the level is one that the processor has.
                #[cfg(target_arch = "x86_64")]
                Instructions::Avx512 => unsafe {
                    match (block, pixels.is_multiple_of(PIXELS)) {
                        (WIDE, true) => job.run_avx512::<{ WIDE / 16 }, PIXELS>(out),
                        (WIDE, false) => job.run_avx512::<{ WIDE / 16 }, 1>(out),
                        (_, true) => job.run_avx512::<{ NARROW / 16 }, PIXELS>(out),
                        (_, false) => job.run_avx512::<{ NARROW / 16 }, 1>(out),
                    }
                },
                // SAFETY: the level is one that the processor has.
                #[cfg(target_arch = "x86_64")]
                Instructions::Avx2 => unsafe {
                    for part in (0..block).step_by(NARROW) {
                        match pixels.is_multiple_of(2) {
                            true => job.run_avx2::<2>(part, out),
                            false => job.run_avx2::<1>(part, out),
                        }
                    }
                },
                _ => job.run(out),
            }
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
    /// Outputs in the block, and its first.
    block: usize,
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
    fn run_avx512<const V: usize, const P: usize>(&self, out: &mut [f32]) {
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

    /// `P` pixels at a time, four vectors of 8 outputs from the block's output `part` on.
    ///
    /// # Safety
    /// The processor must have AVX2, FMA and F16C.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma,f16c")]
    fn run_avx2<const P: usize>(&self, part: usize, out: &mut [f32]) {
        use std::arch::x86_64::{
            __m256, _mm_loadu_si128, _mm256_cvtph_ps, _mm256_fmadd_ps, _mm256_loadu_ps, _mm256_max_ps,
            _mm256_set1_ps, _mm256_setzero_ps, _mm256_storeu_ps,
        };
        const V: usize = NARROW / 8;
        let width = self.layer.outputs;
        let load = |numbers: &[f32], at: usize| -> __m256 {
            let numbers = &numbers[at..at + 8];
            // SAFETY: there are 8 of them.
            unsafe { _mm256_loadu_ps(numbers.as_ptr()) }
        };
        for (inputs, out) in self.inputs.chunks_exact(P * self.count).zip(out.chunks_exact_mut(P * width)) {
            let rows: [&[f32]; P] = std::array::from_fn(|p| &inputs[p * self.count..][..self.count]);
            let mut sums = [[_mm256_setzero_ps(); V]; P];
            for (k, weights) in self.weights.chunks_exact(self.block).enumerate() {
                let (vectors, _) = weights[part..part + NARROW].as_chunks::<8>();
                let weights: [__m256; V] = std::array::from_fn(|v| {
                    // SAFETY: 8 numbers of 16 bits.
                    _mm256_cvtph_ps(unsafe { _mm_loadu_si128(vectors[v].as_ptr().cast()) })
                });
                for p in 0..P {
                    let input = _mm256_set1_ps(rows[p][k]);
                    for v in 0..V {
                        sums[p][v] = _mm256_fmadd_ps(input, weights[v], sums[p][v]);
                    }
                }
            }
            let least = _mm256_set1_ps(if self.relu { 0.0 } else { f32::NEG_INFINITY });
            for (sums, out) in sums.iter().zip(out.chunks_exact_mut(width)) {
                for (v, sum) in sums.iter().enumerate() {
                    let at = self.first + part + 8 * v;
                    let (factor, bias) = (load(&self.layer.factor, at), load(&self.layer.bias, at));
                    let made = _mm256_max_ps(_mm256_fmadd_ps(*sum, factor, bias), least);
                    let out = &mut out[at..at + 8];
                    // SAFETY: there is room for 8.
                    unsafe { _mm256_storeu_ps(out.as_mut_ptr(), made) };
                }
            }
        }
    }

    /// On any processor.
    fn run(&self, out: &mut [f32]) {
        let width = self.layer.outputs;
        let mut sums = vec![0.0; self.block];
        for (inputs, out) in self.inputs.chunks_exact(self.count).zip(out.chunks_exact_mut(width)) {
            sums.fill(0.0);
            for (input, weights) in inputs.iter().zip(self.weights.chunks_exact(self.block)) {
                if *input != 0.0 {
                    for (sum, weight) in sums.iter_mut().zip(weights) {
                        *sum = multiply_add(*input, f16::from_bits(*weight).to_f32(), *sum);
                    }
                }
            }
            let least = if self.relu { 0.0 } else { f32::NEG_INFINITY };
            for (at, sum) in (self.first..).zip(&sums) {
                out[at] = multiply_add(*sum, self.layer.factor[at], self.layer.bias[at]).max(least);
            }
        }
    }
}

/// With one rounding, except on x86-64 processors without FMA, where that would be a library's call.
fn multiply_add(a: f32, b: f32, c: f32) -> f32 {
    if cfg!(target_arch = "x86_64") { a * b + c } else { a.mul_add(b, c) }
}

/// The whole encoder.
#[derive(Debug)]
pub struct Packed {
    convolutions: Vec<Layer>,
    last: Layer,
    level: Instructions,
}

/// Room that encoding needs; keep it between images.
#[derive(Debug, Default)]
pub struct Scratch {
    picture: Vec<f32>,
    next: Vec<f32>,
    gathered: Vec<f32>,
}

impl Packed {
    /// Of an encoder's weights; None if they are not in half precision.
    ///
    /// # Errors
    /// A tensor is missing or has another shape.
    pub fn new(weights: &Weights, architecture: &Architecture) -> Result<Option<Self>, WeightsError> {
        let (slots, _) = architecture.slots();
        let stored = |name: &str| {
            let shape = slots.iter().find(|slot| slot.name == name).map_or(&[][..], |slot| &slot.shape);
            weights.stored(name, shape)
        };
        let halves = |name: &str| -> Result<Option<Vec<f16>>, WeightsError> {
            let tensor = stored(name)?;
            Ok((tensor.dtype == Dtype::F16).then(|| tensor.halves().collect()))
        };
        let (mut side, mut real, mut channels) = (TRANSFORMED_SIZE, 3, 3);
        let mut convolutions = Vec::new();
        for (i, &outputs) in architecture.encoder.iter().enumerate() {
            let Some(numbers) = halves(&format!("encoder.conv{}.weight", i + 1))? else { return Ok(None) };
            let (mut factor, bias) = affine(weights, i, outputs)?;
            if i == 0 {
                // Bytes come in.
                factor.iter_mut().for_each(|factor| *factor /= 255.0);
            }
            let outputs = outputs as usize;
            // The file's order is output, channel, row, column; ours by row, column, channel.
            let weight = |output: usize, input: usize| match (input / channels, input % channels) {
                (place, channel) if channel < real => numbers[(output * real + channel) * 9 + place],
                _ => f16::ZERO,
            };
            let layer = Layer::new((side, channels), [outputs, 9 * channels], weight, factor, bias);
            (side, real, channels) = (side / 2, outputs, layer.outputs);
            convolutions.push(layer);
        }
        let Some(numbers) = halves("encoder.latent.weight")? else { return Ok(None) };
        let latent = [architecture.latent];
        let (mean, deviation) =
            (weights.floats("latent.mean", &latent)?, weights.floats("latent.deviation", &latent)?);
        let mut bias = stored("encoder.latent.bias")?.floats().unwrap_or_default();
        bias.truncate(mean.len());
        for ((bias, mean), deviation) in bias.iter_mut().zip(&mean).zip(&deviation) {
            *bias = (*bias - mean) / deviation;
        }
        let factor = deviation.iter().map(|deviation| 1.0 / deviation).collect();
        // The features come by channel, ours by pixel.
        let places = side * side;
        let weight = |output: usize, input: usize| match (input / channels, input % channels) {
            (place, channel) if channel < real => numbers[(output * real + channel) * places + place],
            _ => f16::ZERO,
        };
        let last = Layer::new((side, channels), [mean.len(), places * channels], weight, factor, bias);
        Ok(Some(Self { convolutions, last, level: instructions() }))
    }

    /// The latent of an image.
    pub fn encode(&self, image: &TransformedImage, scratch: &mut Scratch, latent: &mut Vec<f32>) {
        let Scratch { picture, next, gathered } = scratch;
        picture.clear();
        picture.extend(image.bytes().iter().map(|byte| f32::from(*byte)));
        for layer in &self.convolutions {
            layer.convolve(self.level, picture, gathered, next);
            std::mem::swap(picture, next);
        }
        latent.resize(self.last.outputs, 0.0);
        self.last.product(self.level, picture, false, latent);
        latent.truncate(LATENT_SIZE);
    }
}

/// Factor and offset of each output of convolution `i` (from 0) after its sum: batch norm's where it has one.
fn affine(weights: &Weights, i: usize, outputs: i64) -> Result<(Vec<f32>, Vec<f32>), WeightsError> {
    let floats = |name: String| weights.floats(&name, &[outputs]);
    if !NORMED.contains(&i) {
        return Ok((vec![1.0; outputs as usize], floats(format!("encoder.conv{}.bias", i + 1))?));
    }
    let of = |what: &str| floats(format!("encoder.norm{}.{what}", i + 1));
    let (mut factor, mut bias) = (of("scale")?, of("shift")?);
    let statistics = of("mean")?.into_iter().zip(of("variance")?);
    for ((factor, bias), (mean, variance)) in factor.iter_mut().zip(&mut bias).zip(statistics) {
        *factor /= (variance + EPSILON as f32).sqrt();
        *bias -= mean * *factor;
    }
    Ok((factor, bias))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::latent::file;
    use rand::RngExt;
    use sumo_network::seeds;

    fn pictures() -> impl Iterator<Item = TransformedImage> {
        let mut rng = seeds::rng(5, "images");
        (0..6).map(move |n| {
            let mut image = TransformedImage::default();
            // Noise, then broad stripes: every layer has something to do.
            for (at, byte) in image.bytes_mut().iter_mut().enumerate() {
                *byte = if n % 2 == 0 { rng.random() } else { ((at >> (2 + n)) % 200) as u8 };
            }
            image
        })
    }

    #[test]
    fn every_processor_makes_the_same_latent() {
        let weights = file::find("default").unwrap();
        let (architecture, _) = file::check(&weights).unwrap();
        let mut packed = Packed::new(&weights, &architecture).unwrap().unwrap();
        let mut scratch = Scratch::default();
        for image in pictures().take(3) {
            let levels = Instructions::ALL.into_iter().rev().filter(|level| *level <= instructions());
            let latents: Vec<(Instructions, Vec<f32>)> = levels
                .map(|level| {
                    let mut latent = Vec::new();
                    packed.level = level;
                    packed.encode(&image, &mut scratch, &mut latent);
                    (level, latent)
                })
                .collect();
            let [(_, best), others @ ..] = &latents[..] else { unreachable!("one level is everywhere") };
            assert!(best.len() == LATENT_SIZE && best.iter().any(|v| v.abs() > 0.3), "{best:?}");
            for (level, latent) in others {
                let apart = latent.iter().zip(best).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
                let most = if *level == Instructions::Plain { 1e-4 } else { 0.0 };
                assert!(apart <= most, "{level:?}: {apart}");
            }
        }
    }

    #[test]
    fn channels_are_padded_to_whole_blocks() {
        // Three layers of odd sizes, each weight of a layer the same: each output is the sum of what it sees.
        let architecture = Architecture { encoder: vec![5, 40], ..Architecture::default() };
        let mut tensors = Vec::new();
        let (slots, _) = architecture.slots();
        for slot in slots.iter().chain(&architecture.statistics()) {
            let value = match slot.name.as_str() {
                "encoder.conv1.weight" => 1.0 / 27.0,
                "encoder.conv2.weight" => 1.0 / 45.0,
                "encoder.latent.weight" => 1.0 / (40.0 * 32.0 * 32.0),
                "encoder.norm2.scale" | "encoder.norm2.variance" => 1.0,
                _ => 0.0,
            };
            tensors.push((slot.name.clone(), value, slot.shape.clone()));
        }
        let size = [LATENT_SIZE as i64].to_vec();
        tensors.extend([("latent.mean".into(), 0.25, size.clone()), ("latent.deviation".into(), 0.5, size)]);
        let tensors = tensors.into_iter().map(|(name, value, shape)| {
            let shape: Vec<usize> = shape.iter().map(|&n| n as usize).collect();
            let data = f16::from_f32(value).to_le_bytes().repeat(shape.iter().product());
            (name, crate::weights::Stored { dtype: Dtype::F16, shape, data })
        });
        let weights = Weights { path: "a".into(), tensors: tensors.collect(), metadata: Default::default() };
        let packed = Packed::new(&weights, &architecture).unwrap().unwrap();
        let mut image = TransformedImage::default();
        image.bytes_mut().fill(255);
        let mut latent = Vec::new();
        packed.encode(&image, &mut Scratch::default(), &mut latent);
        // White stays 1 but at the upper and left rims, where a third of each side is padding.
        let (inner, half) = (31.0 / 32.0, 1.0 / 32.0);
        let rim: f32 = inner * inner + 2.0 * inner * half * (2.0 / 3.0) + half * half * (4.0 / 9.0);
        let seen = 2.0 * (rim - 0.25);
        assert!(latent.iter().all(|v| (v - seen).abs() < 0.02), "{} instead of {seen}", latent[0]);
        assert_eq!(latent.len(), LATENT_SIZE);
    }

    #[cfg(feature = "learn")]
    #[test]
    fn latents_are_those_of_the_trained_network() {
        use crate::latent::{Encoder, TchEncoder};
        let mut encoder = TchEncoder::find("default").unwrap();
        let mut worst = 0.0_f32;
        for image in pictures() {
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
