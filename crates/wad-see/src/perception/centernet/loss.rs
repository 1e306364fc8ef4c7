//! CenterNet's loss for the heat map (Zhou et al. 2019, equation 1), and the boxes' overlap (Rezatofighi et al. 2019) in the
//! cells round each centre (Liu et al. 2020).

use super::network::Answer;
use super::targets::Taught;
use tch::{Device, TchError, Tensor};

/// The training targets of a batch.
#[derive(Debug)]
pub struct Target {
    /// (n, 8, h, w): 1 at centres, falling round them; [`super::targets::NO_MATTER`] where nothing counts.
    pub heat: Tensor,
    /// (m): picture * h * w + cell of each cell that is taught a box.
    pub cells: Tensor,
    /// (m, 4): left, top, right, bottom of its object from its corner, in cells.
    pub bounds: Tensor,
    /// (m): how much it counts.
    pub weights: Tensor,
}

impl Target {
    /// From a heat map (n, 8, h, w) and what cells of its pictures are taught.
    ///
    /// # Errors
    /// torch fails.
    pub fn new(heat: Tensor, taught: &[(usize, Taught)], device: Device) -> Result<Self, TchError> {
        let plane: usize = heat.size()[2..].iter().map(|&side| side as usize).product();
        let cells: Vec<i64> =
            taught.iter().map(|(picture, one)| (picture * plane + one.cell) as i64).collect();
        let bounds: Vec<f32> = taught.iter().flat_map(|(_, one)| one.bounds).collect();
        let weights: Vec<f32> = taught.iter().map(|(_, one)| one.weight).collect();
        Ok(Self {
            heat: heat.f_to_device(device)?,
            cells: Tensor::f_from_slice(&cells)?.f_to_device(device)?,
            bounds: Tensor::f_from_slice(&bounds)?.f_view([-1, 4])?.f_to_device(device)?,
            weights: Tensor::f_from_slice(&weights)?.f_to_device(device)?,
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
    /// 1 less the generalised intersection over union of the boxes.
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
    // Those of an object sum up to 1.
    let objects = target.weights.f_sum(tch::Kind::Float)?.f_clamp_min(1.0)?;
    // (n, 2, h, w) to (n h w, 2), then the rows of cells that are taught.
    let rows = |answer: &Tensor| {
        answer.f_permute([0, 2, 3, 1])?.f_reshape([-1, 2])?.f_index_select(0, &target.cells)
    };
    let half = rows(&answer.size)?.f_clamp_min(LEAST)?.f_mul_scalar(0.5)?;
    let middle = rows(&answer.offset)?;
    let corners = [middle.f_sub(&half)?, middle.f_add(&half)?];
    let overlap = generalised_overlap(&corners, &target.bounds)?;
    let boxes = overlap.f_neg()?.f_add_scalar(1.0)?.f_mul(&target.weights)?.f_sum(tch::Kind::Float)?;
    Ok(Loss { heat: focal(&answer.heat, &target.heat)?.f_div(&objects)?, boxes: boxes.f_div(&objects)? })
}

/// Least width and height of a box (cells).
const LEAST: f64 = 0.05;

/// The generalised intersection over union of boxes (m): low and high corners (m, 2) with bounds (m, 4). 1 where they are the
/// same, towards -1 the farther apart they are.
fn generalised_overlap([low, high]: &[Tensor; 2], bounds: &Tensor) -> Result<Tensor, TchError> {
    let (other_low, other_high) = (bounds.f_narrow(1, 0, 2)?, bounds.f_narrow(1, 2, 2)?);
    let area = |sides: Tensor| sides.f_clamp_min(0.0)?.f_prod_dim_int(1, false, tch::Kind::Float);
    let common = area(high.f_minimum(&other_high)?.f_sub(&low.f_maximum(&other_low)?)?)?;
    let both = area(high.f_sub(low)?)?.f_add(&area(other_high.f_sub(&other_low)?)?)?;
    let union = both.f_sub(&common)?;
    let hull = area(high.f_maximum(&other_high)?.f_sub(&low.f_minimum(&other_low)?)?)?;
    common.f_div(&union)?.f_sub(&hull.f_sub(&union)?.f_div(&hull)?)
}

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
        // The answer's boxes reach from -1 to 1. Half of the first overlaps; the second is beside it.
        let taught = [[0.0, -1.0, 2.0, 1.0], [1.0, -1.0, 3.0, 1.0]];
        let taught = taught.map(|bounds| (0, Taught { cell: 0, bounds, weight: 0.5 }));
        let target = Target::new(heat, &taught, Device::Cpu).unwrap();
        let loss = loss(&answer, &target).unwrap();
        let half = 0.5_f64.ln();
        // -(1-p)^2 log p; -(1-y)^4 p^2 log(1-p) with y = 0.5 and y = 0.
        let heat = -0.25 * half - 0.0625 * 0.25 * half - 0.25 * half;
        assert!((loss.heat.double_value(&[]) - heat).abs() < 1e-6);
        // 2 / 6, and 0 of a hull of 8 that both fill.
        let boxes = 0.5 * (1.0 - 1.0 / 3.0) + 0.5;
        assert!((loss.boxes.double_value(&[]) - boxes).abs() < 1e-6, "{:?}", loss.boxes);
        assert!((loss.total().unwrap().double_value(&[]) - (heat + 5.0 * boxes)).abs() < 1e-5);
    }
}
