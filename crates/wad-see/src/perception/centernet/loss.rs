//! CenterNet's loss for the heat map (Zhou et al. 2019, equation 1), and how far off boxes are in each object's
//! centre.

use super::network::Answer;
use super::targets::Centre;
use tch::{Device, TchError, Tensor};

/// The training targets of a batch.
#[derive(Debug)]
pub struct Target {
    /// (n, 8, h, w): 1 at centres, falling round them; [`super::targets::NO_MATTER`] where nothing counts.
    pub heat: Tensor,
    /// (m): picture * h * w + cell of each centre.
    pub cells: Tensor,
    /// (m, 4): left, top, right, bottom of its object from the cell's corner, in cells.
    pub bounds: Tensor,
}

impl Target {
    /// From a heat map (n, 8, h, w) and the centres in its pictures.
    ///
    /// # Errors
    /// torch fails.
    pub fn new(heat: Tensor, centres: &[(usize, Centre)], device: Device) -> Result<Self, TchError> {
        let plane: usize = heat.size()[2..].iter().map(|&side| side as usize).product();
        let cells: Vec<i64> =
            centres.iter().map(|(picture, one)| (picture * plane + one.cell) as i64).collect();
        let bounds = |one: &Centre| -> [f32; 4] {
            let ([x, y], [w, h]) = (one.offset, one.size.map(|side| 0.5 * side));
            [x - w, y - h, x + w, y + h]
        };
        let bounds: Vec<f32> = centres.iter().flat_map(|(_, one)| bounds(one)).collect();
        Ok(Self {
            heat: heat.f_to_device(device)?,
            cells: Tensor::f_from_slice(&cells)?.f_to_device(device)?,
            bounds: Tensor::f_from_slice(&bounds)?.f_view([-1, 4])?.f_to_device(device)?,
        })
    }
}

/// Weight of the boxes' part.
const BOXES: f64 = 5.0;

/// The parts of the loss, each per object.
#[derive(Debug)]
pub struct Loss {
    /// Focal loss of the heat map.
    pub heat: Tensor,
    /// How far off the boxes' edges are, as shares of the width and height that were answered; of large ones a share counts
    /// more. (As shares of the true ones, an answer is the less wrong the larger its object is, so that where sizes are
    /// unsure boxes are too small: models/detector/HISTORY.md.)
    pub boxes: Tensor,
}

impl Loss {
    /// What is minimised.
    ///
    /// # Errors
    /// torch fails.
    pub fn total(&self) -> Result<Tensor, TchError> {
        self.heat.f_add(&self.boxes.f_mul_scalar(BOXES)?)
    }
}

/// The penalty-reduced focal loss with alpha = 2, beta = 4, summed, of a map before the sigmoid.
pub(super) fn focal(answer: &Tensor, wanted: &Tensor) -> Result<Tensor, TchError> {
    // From logits: log p = -softplus(-x).
    let log_p = answer.f_log_sigmoid()?;
    let log_not_p = log_p.f_sub(answer)?;
    let p = answer.f_sigmoid()?;
    let is_centre = wanted.f_eq(1.0)?.f_to_kind(tch::Kind::Float)?;
    let is_other = wanted.f_ge(0.0)?.f_to_kind(tch::Kind::Float)?.f_sub(&is_centre)?;
    let positive = log_p.f_mul(&p.f_neg()?.f_add_scalar(1.0)?.f_square()?)?.f_mul(&is_centre)?;
    let spared = wanted.f_neg()?.f_add_scalar(1.0)?.f_square()?.f_square()?;
    let negative = log_not_p.f_mul(&p.f_square()?)?.f_mul(&spared)?.f_mul(&is_other)?;
    positive.f_sum(tch::Kind::Float)?.f_add(&negative.f_sum(tch::Kind::Float)?)?.f_neg()
}

/// The loss of answers.
///
/// # Errors
/// torch fails.
pub fn loss(answer: &Answer, target: &Target) -> Result<Loss, TchError> {
    let objects = target.cells.size()[0].max(1) as f64;
    // (n, 2, h, w) to (n h w, 2), then the rows of the centres.
    let rows = |answer: &Tensor| {
        answer.f_permute([0, 2, 3, 1])?.f_reshape([-1, 2])?.f_index_select(0, &target.cells)
    };
    let size = rows(&answer.size)?;
    let half = size.f_mul_scalar(0.5)?;
    let middle = rows(&answer.offset)?;
    let edges = Tensor::f_cat(&[middle.f_sub(&half)?, middle.f_add(&half)?], 1)?;
    // A unit is not learned: a larger answer would make all errors small.
    let size = size.f_detach()?.f_clamp_min(LEAST)?;
    let unit = size.f_minimum(&size.f_mul_scalar(LARGE)?.f_sqrt()?)?.f_repeat([1, 2])?;
    let off = edges.f_sub(&target.bounds)?.f_abs()?.f_div(&unit)?;
    Ok(Loss {
        heat: focal(&answer.heat, &target.heat)?.f_div_scalar(objects)?,
        boxes: off.f_sum(tch::Kind::Float)?.f_div_scalar(objects)?,
    })
}

/// Narrower boxes are judged as if they were as wide (cells).
const LEAST: f64 = 1.0;
/// Of wider ones a share counts more, by the square root (cells): how near they are is told by their edges, to the pixel.
const LARGE: f64 = 5.0;

#[cfg(test)]
mod tests {
    use super::*;
    use tch::{Device, Kind};

    #[test]
    fn the_loss_of_one_cell_by_hand() {
        // Four cells of one class: a centre at p = 0.5, a slope of 0.5 at p = 0.5, background at p = 0.5,
        // and one that does not count.
        let heat = Tensor::from_slice(&[1.0_f32, 0.5, 0.0, -1.0]).view([1, 1, 2, 2]);
        let answer = Answer {
            heat: Tensor::zeros([1, 1, 2, 2], (Kind::Float, Device::Cpu)),
            size: Tensor::full([1, 2, 2, 2], 2.0, (Kind::Float, Device::Cpu)),
            offset: Tensor::zeros([1, 2, 2, 2], (Kind::Float, Device::Cpu)),
            road: None,
        };
        // The answer's boxes reach from -1 to 1.
        let centres = [[1.0, 0.0], [2.0, 0.0]].map(|offset| (0, Centre { cell: 0, size: [2.0; 2], offset }));
        let target = Target::new(heat, &centres, Device::Cpu).unwrap();
        let loss = loss(&answer, &target).unwrap();
        let half = 0.5_f64.ln();
        // -(1-p)^2 log p; -(1-y)^4 p^2 log(1-p) with y = 0.5 and y = 0.
        let heat = 0.5 * (-0.25 * half - 0.0625 * 0.25 * half - 0.25 * half);
        assert!((loss.heat.double_value(&[]) - heat).abs() < 1e-6);
        // Of boxes two wide two edges are off by one, and by two.
        let boxes = 0.5 * 1.0 + 0.5 * 2.0;
        assert!((loss.boxes.double_value(&[]) - boxes).abs() < 1e-6, "{:?}", loss.boxes);
        assert!((loss.total().unwrap().double_value(&[]) - (heat + 5.0 * boxes)).abs() < 1e-5);
    }

    #[test]
    fn an_unsure_size_is_neither_too_small_nor_too_large() {
        // What looks alike is 1, 2 or 8 cells wide and high: 2 leaves as many larger as smaller.
        let size = Tensor::full([1, 2, 1, 1], 2.0, (Kind::Float, Device::Cpu)).set_requires_grad(true);
        let map = |planes: i64| Tensor::zeros([1, planes, 1, 1], (Kind::Float, Device::Cpu));
        let answer = Answer { heat: map(1), size: size.shallow_clone(), offset: map(2), road: None };
        let centres = [1.0, 2.0, 8.0].map(|side| (0, Centre { cell: 0, size: [side; 2], offset: [0.0; 2] }));
        loss(&answer, &Target::new(map(1), &centres, Device::Cpu).unwrap()).unwrap().boxes.backward();
        assert!(size.grad().abs().max().double_value(&[]) < 1e-6, "{:?}", size.grad());
    }
}
