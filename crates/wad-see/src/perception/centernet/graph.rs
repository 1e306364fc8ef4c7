//! The light network for inference without libtorch: batch norms folded, in single precision or in whole numbers of
//! 8 bits.
//!
//! With 8 bits a convolution's weights have a scale per output channel, of which they use half, and what goes into it the scale of its range:
//! 0 to about the largest number that the network was seen to have there (see [`Ranges`]). The heads stay in single
//! precision.

use super::decode::{LIGHT, SIGN_CHANNELS, SIGN_ROWS};
use super::kind::{CLASSES, Part, STRIDE, Sees};
use crate::inference::ir::{Ir, Node};
use crate::perception::area::{CELL, ROWS};
use crate::weights::{Stored, Weights, WeightsError};
use safetensors::Dtype;

/// Channels at strides 2, 4, 8, 16, 32.
pub(super) const CHANNELS: [i64; 5] = [16, 24, 48, 96, 160];
/// Cells between the numbers of the second block at stride 32, which `eyes` have.
pub(super) const WIDE: i64 = 2;
/// Channels of the pyramid, and of what the heads see.
pub(super) const PYRAMID: i64 = 32;
/// Channels that the heads see.
pub const OUT: i64 = 48;
/// Channels of the road's heads between features and answers.
pub(super) const HIDDEN: i64 = 32;
/// Colours of the picture of which the light's head sees the strongest in each cell.
pub(super) const COLOURS: i64 = 8;
/// Channels of what the head for signs sees of the picture itself, at stride 2.
pub(super) const SIGN_STEM: i64 = 16;
/// Channels of the network that reads a sign's plate: of its convolutions, and between its last layers.
pub(super) const READ: [i64; 2] = [16, 32];
pub(super) const READ_HIDDEN: i64 = 64;
/// Batch norm keeps its root from 0.
pub(super) const EPSILON: f64 = 1e-5;

/// Rows and columns of the picture that the network sees.
pub const PICTURE: [usize; 2] = [320, 512];
/// Rows and columns of the cells that heads see.
pub(super) const MAP: [usize; 2] = [PICTURE[0] / STRIDE, PICTURE[1] / STRIDE];
/// Name of the tensor of ranges in a file of weights.
pub const RANGES: &str = "ranges";

/// The largest number at each place of the network that is rounded, in the order in which the network meets them.
pub type Ranges = Vec<f32>;

/// So many of them, the last, belong to this head.
pub(super) fn ranges_of(part: Part) -> usize {
    match part {
        Part::Signs => 3,
        // What goes into it goes into the lanes' too.
        Part::Area => 0,
    }
}

/// The numbers that the network computes with.
#[derive(Clone, Copy, Debug)]
pub enum Numbers<'a> {
    /// Single precision.
    Single,
    /// The same, and what would be rounded comes out behind the other outputs: to find ranges.
    Watched,
    /// Whole numbers of 8 bits within these ranges.
    Whole(&'a Ranges),
}

/// Where the cells of the light's map are: 2 x 80 x 128, column and row from 0 to 1.
pub(super) fn place() -> Vec<f32> {
    let [rows, columns] = MAP;
    let part = |at: usize, of: usize| (at as f32 + 0.5) / of as f32;
    let columns_of = (0..rows * columns).map(|cell| part(cell % columns, columns));
    columns_of.chain((0..rows * columns).map(|cell| part(cell / columns, rows))).collect()
}

struct Builder<'a> {
    ir: Ir,
    weights: &'a Weights,
    numbers: Numbers<'a>,
    /// Places that are rounded, so far.
    places: Vec<Node>,
}

/// The network of some weights: one picture of [`PICTURE`] (1, 320, 512, 3) in bytes to objects (heatmap before its
/// sigmoid, size, offset), and where it sees the road, light, lanes, signs and area: as in [`super::decode`].
///
/// # Errors
/// The weights are of another network, or have ranges for another number of places.
pub fn graph(weights: &Weights, sees: Sees, numbers: Numbers<'_>) -> Result<Ir, WeightsError> {
    let mut net = Builder { ir: Ir::default(), weights, numbers, places: Vec::new() };
    let [rows, columns] = PICTURE;
    let picture = net.ir.bytes(&[1, rows, columns, 3]);
    let picture = net.ir.to_float(picture);
    // About zero in the middle, one wide: 0 to 255 are 256 numbers from -1.8 to 2.2.
    let factor = net.ir.floats(&[1], &[4.0 / 255.0]);
    let shift = net.ir.floats(&[1], &[-1.8]);
    let x = net.ir.multiply(picture, factor);
    let mut x = net.ir.sum(x, shift);
    if matches!(numbers, Numbers::Whole(_)) {
        x = net.round_all(x, -1.8, 2.2);
    }
    let picture = x;
    // Once for each layer that sees it: OpenVINO leaves out an order that only the next layer asks for.
    x = net.ir.channels_first(picture);
    let [stem1, stem2, ..] = CHANNELS;
    x = net.layer(x, "backbone.stem1", [3, stem1, 3, 2])?;
    x = net.layer(x, "backbone.stem2", [stem1, stem2, 3, 2])?;
    let mut levels = vec![x];
    for i in 2..CHANNELS.len() {
        let (from, to) = (CHANNELS[i - 1], CHANNELS[i]);
        let path = format!("backbone.stride{}", 2 << i);
        let down = net.layer(x, &format!("{path}.down"), [from, to, 3, 2])?;
        x = net.block(down, &format!("{path}.block"), to, 1)?;
        if sees == Sees::Road && i == CHANNELS.len() - 1 {
            x = net.block(x, "backbone.wide", to, WIDE)?;
        }
        levels.push(x);
    }
    let mut top: Option<Node> = None;
    for (i, level) in levels.iter().enumerate().rev() {
        let name = format!("backbone.lateral{}", 4 << i);
        let mut side = net.convolution(*level, &name, [CHANNELS[i + 1], PYRAMID, 1, 1], true)?;
        if let Some(top) = top {
            let top = net.ir.double(top);
            side = net.ir.sum(side, top);
        }
        let side = net.ir.relu(side);
        top = Some(net.rounded(side)?);
    }
    let top = top.unwrap_or(x);
    let features = net.convolution(top, "backbone.smooth", [PYRAMID, OUT, 3, 1], true)?;
    let features = net.ir.relu(features);
    let objects =
        net.heads(features, OUT, &[("heat.last", CLASSES), ("size.last", 2), ("offset.last", 2)])?;
    net.ir.output(objects);
    if sees == Sees::Road {
        // What it sees is what the lanes see, so it is rounded alike.
        let all = net.rounded(features)?;
        let hidden = net.convolution(all, "road.light_hidden", [OUT, HIDDEN, 3, 1], true)?;
        let colours = net.ir.channels_first(picture);
        let colours = net.convolution(colours, "road.colours", [3, COLOURS, 1, 1], false)?;
        let colours = net.ir.relu(colours);
        let colours = net.ir.largest(colours, STRIDE);
        let colours = net.rounded(colours)?;
        let hidden = net.placed(hidden, colours, "road.light_colours")?;
        let hidden = net.ir.relu(hidden);
        let light = net.heads(hidden, HIDDEN, &[("road.light", LIGHT)])?;
        net.ir.output(light);
        let half = net.ir.halve(features);
        let last = (PICTURE[0] / CELL) as i64;
        let below = net.ir.part(half, 2, last - ROWS as i64, last);
        let below = net.rounded(below)?;
        let hidden = net.convolution(below, "road.hidden", [OUT, HIDDEN, 3, 1], true)?;
        let hidden = net.ir.relu(hidden);
        let answers = net.heads(hidden, HIDDEN, &[("road.lanes", 4)])?;
        let [columns, none] = [0, 2].map(|from| net.ir.part(answers, 1, from, from + 2));
        let none = net.ir.mean(none, 3);
        let lanes = net.ir.join(columns, none, 3);
        net.ir.output(lanes);
        let [first, last] = SIGN_ROWS.map(|row| row as i64);
        let pixels = net.ir.part(picture, 1, first * STRIDE as i64, last * STRIDE as i64);
        let pixels = net.ir.channels_first(pixels);
        let pixels = net.layer(pixels, "road.signs_stem1", [3, SIGN_STEM, 3, 2])?;
        let pixels = net.layer(pixels, "road.signs_stem2", [SIGN_STEM, HIDDEN, 3, 2])?;
        let pixels = net.convolution(pixels, "road.signs_pixels", [HIDDEN, HIDDEN, 3, 1], true)?;
        let near = net.ir.part(all, 2, first, last);
        let hidden = net.convolution(near, "road.signs_features", [OUT, HIDDEN, 3, 1], true)?;
        let hidden = net.ir.sum(hidden, pixels);
        let hidden = net.ir.relu(hidden);
        let hidden = net.rounded(hidden)?;
        let hidden = net.convolution(hidden, "road.signs_hidden", [HIDDEN, HIDDEN, 3, 1], true)?;
        let hidden = net.ir.relu(hidden);
        let signs = net.heads(hidden, HIDDEN, &[("road.signs", SIGN_CHANNELS)])?;
        net.ir.output(signs);
        let hidden = net.convolution(below, "road.area_hidden", [OUT, HIDDEN, 3, 1], true)?;
        let hidden = net.ir.relu(hidden);
        let area = net.heads(hidden, HIDDEN, &[("road.area", 1)])?;
        net.ir.output(area);
    }
    if matches!(numbers, Numbers::Watched) {
        for place in std::mem::take(&mut net.places) {
            net.ir.output(place);
        }
    } else if let Numbers::Whole(ranges) = numbers
        && ranges.len() != net.places.len()
    {
        return Err(net.ranges_of_another());
    }
    Ok(net.ir)
}

impl Builder<'_> {
    fn ranges_of_another(&self) -> WeightsError {
        WeightsError::Format {
            path: self.weights.path.clone(),
            why: format!("tensor `{RANGES}` is of another network"),
        }
    }

    fn round_all(&mut self, x: Node, low: f32, high: f32) -> Node {
        let [low, high] = [low, high].map(|bound| self.ir.floats(&[1], &[bound]));
        self.ir.round(x, low, high, 256)
    }

    /// A place that is rounded: numbers of 0 or more.
    fn rounded(&mut self, x: Node) -> Result<Node, WeightsError> {
        self.places.push(x);
        let Numbers::Whole(ranges) = self.numbers else { return Ok(x) };
        let range = *ranges.get(self.places.len() - 1).ok_or_else(|| self.ranges_of_another())?;
        Ok(self.round_all(x, 0.0, range))
    }

    /// A convolution with batch norm and what follows it.
    fn layer(&mut self, x: Node, name: &str, shape: [i64; 4]) -> Result<Node, WeightsError> {
        let x = self.convolution(x, name, shape, true)?;
        let x = self.ir.relu(x);
        self.rounded(x)
    }

    /// Two 3x3 convolutions round a shortcut.
    fn block(&mut self, x: Node, path: &str, channels: i64, dilation: i64) -> Result<Node, WeightsError> {
        let shape = [channels, channels, 3, 1];
        let first = self.dilated(x, &format!("{path}.first"), shape, dilation, true)?;
        let first = self.ir.relu(first);
        let first = self.rounded(first)?;
        let second = self.dilated(first, &format!("{path}.second"), shape, dilation, true)?;
        let both = self.ir.sum(second, x);
        let both = self.ir.relu(both);
        self.rounded(both)
    }

    /// Convolutions of single cells with a bias, in single precision: name and channels of each. They are one, for each
    /// by itself would read `x` anew.
    fn heads(&mut self, x: Node, from: i64, heads: &[(&str, i64)]) -> Result<Node, WeightsError> {
        let mut all = Kernel { channels: [0, from as usize], side: 1, ..Kernel::default() };
        for &(name, to) in heads {
            let one = self.kernel(name, [to, from, 1], false)?;
            all.channels[0] += one.channels[0];
            all.weight.extend(one.weight);
            all.bias.extend(one.bias);
        }
        let numbers = std::mem::replace(&mut self.numbers, Numbers::Single);
        let answers = self.apply(x, &all, [1, 1]);
        self.numbers = numbers;
        Ok(answers)
    }

    /// Adds to `before` a 3x3 convolution over colours, and [where each cell is](place) behind them. What the latter gives
    /// is the same in every picture.
    fn placed(&mut self, before: Node, x: Node, name: &str) -> Result<Node, WeightsError> {
        let kernel = self.kernel(name, [HIDDEN, COLOURS + 2, 3], false)?;
        let [to, from] = kernel.channels;
        let [of_x, cells] = [from - 2, kernel.side * kernel.side];
        let mut of_place = Vec::with_capacity(to * 2 * cells);
        let mut weight = Vec::with_capacity(to * of_x * cells);
        for row in kernel.weight.chunks_exact(from * cells) {
            let (x, place) = row.split_at(of_x * cells);
            weight.extend_from_slice(x);
            of_place.extend_from_slice(place);
        }
        let bias = vec![0.0; to];
        let of_place = Kernel { weight: of_place, bias, channels: [to, 2], side: kernel.side };
        let [rows, columns] = MAP;
        let constant = self.ir.floats(&[1, to, rows, columns], &of_place.over(&place(), MAP));
        let before = self.ir.sum(before, constant);
        let x = self.apply(x, &Kernel { weight, channels: [to, of_x], ..kernel }, [1, 1]);
        Ok(self.ir.sum(x, before))
    }

    /// `shape`: channels from and to, side, stride.
    fn convolution(
        &mut self,
        x: Node,
        name: &str,
        shape: [i64; 4],
        normed: bool,
    ) -> Result<Node, WeightsError> {
        self.dilated(x, name, shape, 1, normed)
    }

    /// The same with numbers that lie `dilation` cells apart.
    fn dilated(
        &mut self,
        x: Node,
        name: &str,
        [from, to, side, stride]: [i64; 4],
        dilation: i64,
        normed: bool,
    ) -> Result<Node, WeightsError> {
        let kernel = self.kernel(name, [to, from, side], normed)?;
        Ok(self.apply(x, &kernel, [stride as usize, dilation as usize]))
    }

    /// Reads a convolution's numbers, with batch norm folded into them where it is `normed`.
    fn kernel(&self, name: &str, [to, from, side]: [i64; 3], normed: bool) -> Result<Kernel, WeightsError> {
        let of = |what: &str| format!("{name}.{what}");
        let mut weight = self.weights.floats(&of("weight"), &[to, from, side, side])?;
        let bias = if normed {
            let vector = |what: &str| self.weights.floats(&of(what), &[to]);
            let [scale, shift, mean, variance] =
                [vector("scale")?, vector("shift")?, vector("mean")?, vector("variance")?];
            let mut bias = Vec::with_capacity(to as usize);
            for (channel, row) in weight.chunks_exact_mut((from * side * side) as usize).enumerate() {
                let factor = scale[channel] / (variance[channel] + EPSILON as f32).sqrt();
                row.iter_mut().for_each(|w| *w *= factor);
                bias.push(shift[channel] - mean[channel] * factor);
            }
            bias
        } else {
            self.weights.floats(&of("bias"), &[to])?
        };
        Ok(Kernel { weight, bias, channels: [to as usize, from as usize], side: side as usize })
    }

    /// Stride, and how many cells the numbers lie apart. Its numbers are rounded where all are.
    fn apply(&mut self, x: Node, kernel: &Kernel, [stride, dilation]: [usize; 2]) -> Node {
        let Kernel { weight, bias, channels: [to, from], side } = kernel;
        let mut w = self.ir.floats(&[*to, *from, *side, *side], weight);
        if matches!(self.numbers, Numbers::Whole(_)) {
            // Twice what is there: processors without VNNI add pairs of products in 16 bits, which 255 * 127 * 2 leaves.
            let largest: Vec<f32> = weight
                .chunks_exact(from * side * side)
                .map(|row| 2.0 * row.iter().fold(1e-9, |most: f32, w| most.max(w.abs())))
                .collect();
            let least: Vec<f32> = largest.iter().map(|x| -x).collect();
            let low = self.ir.floats(&[*to, 1, 1, 1], &least);
            let high = self.ir.floats(&[*to, 1, 1, 1], &largest);
            w = self.ir.round(w, low, high, 255);
        }
        let x = self.ir.convolution(x, w, *side, stride, dilation);
        let bias = self.ir.floats(&[1, *to, 1, 1], bias);
        self.ir.sum(x, bias)
    }
}

/// The numbers of a convolution.
#[derive(Debug, Default)]
struct Kernel {
    /// to x from x side x side.
    weight: Vec<f32>,
    bias: Vec<f32>,
    /// To and from.
    channels: [usize; 2],
    side: usize,
}

impl Kernel {
    /// What it makes of a map of so many rows and columns, with a border of zeros of half a side.
    fn over(&self, map: &[f32], [rows, columns]: [usize; 2]) -> Vec<f32> {
        let Self { weight, bias, channels: [_, from], side } = self;
        let cells = rows * columns;
        let at = |channel: usize, row: usize, column: usize, within: usize| {
            // Below 0 is beyond the last.
            let [row, column] =
                [row + within / side, column + within % side].map(|n| n.wrapping_sub(side / 2));
            if row < rows && column < columns { map[channel * cells + row * columns + column] } else { 0.0 }
        };
        let mut answer = Vec::with_capacity(bias.len() * cells);
        for (bias, row_of) in bias.iter().zip(weight.chunks_exact(from * side * side)) {
            answer.extend((0..cells).map(|cell| {
                let products = row_of.iter().enumerate().map(|(i, w)| {
                    let (channel, within) = (i / (side * side), i % (side * side));
                    w * at(channel, cell / columns, cell % columns, within)
                });
                bias + products.sum::<f32>()
            }));
        }
        answer
    }
}

/// The ranges in a file of weights; None where it has none.
///
/// # Errors
/// They are no row of numbers.
pub fn ranges(weights: &Weights) -> Result<Option<Ranges>, WeightsError> {
    let Some((_, stored)) = weights.tensors.iter().find(|(name, _)| name == RANGES) else { return Ok(None) };
    let shape: Vec<i64> = stored.shape.iter().map(|&n| n as i64).collect();
    weights.floats(RANGES, &shape).map(Some)
}

/// Puts the ranges into weights.
pub fn set_ranges(weights: &mut Weights, ranges: &Ranges) {
    weights.tensors.retain(|(name, _)| name != RANGES);
    let data = ranges.iter().flat_map(|x| x.to_le_bytes()).collect();
    weights.tensors.push((RANGES.to_string(), Stored { dtype: Dtype::F32, shape: vec![ranges.len()], data }));
}

#[cfg(test)]
mod tests {
    use super::Kernel;

    #[test]
    fn a_kernel_over_a_map_counts_its_border_as_zeros() {
        // Of a map 1 2 3 / 4 5 6 the cells above, and twice those to the right of another channel.
        let mut weight = vec![0.0; 18];
        (weight[1], weight[9 + 5]) = (1.0, 2.0);
        let kernel = Kernel { weight, bias: vec![0.5], channels: [1, 2], side: 3 };
        let map = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0];
        assert_eq!(kernel.over(&map, [2, 3]), [40.5, 60.5, 0.5, 101.5, 122.5, 3.5]);
    }
}
