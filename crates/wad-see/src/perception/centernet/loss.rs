//! CenterNet's loss (Zhou et al. 2019, equations 1 to 4).

use super::network::Answer;
use tch::{TchError, Tensor};

/// The training targets of a batch.
#[derive(Debug)]
pub struct Target {
    /// (n, 8, h, w): 1 at centres, falling round them; [`super::targets::NO_MATTER`] where nothing counts.
    pub heat: Tensor,
    /// (m): picture * h * w + cell of each centre.
    pub cells: Tensor,
    /// (m, 2): width and height of each object, in cells.
    pub size: Tensor,
    /// (m, 2): each centre's place within its cell, in cells.
    pub offset: Tensor,
}

/// Weights of the sizes' and the offsets' part.
const SIZE: f64 = 0.1;
const OFFSET: f64 = 1.0;

/// The parts of the loss, each per centre.
#[derive(Debug)]
pub struct Loss {
    /// Focal loss of the heat map.
    pub heat: Tensor,
    /// L1 loss of width and height.
    pub size: Tensor,
    /// L1 loss of the place within the cell.
    pub offset: Tensor,
}

impl Loss {
    /// What is minimised.
    ///
    /// # Errors
    /// torch fails.
    pub fn total(&self) -> Result<Tensor, TchError> {
        self.heat.f_add(&self.size.f_mul_scalar(SIZE)?)?.f_add(&self.offset.f_mul_scalar(OFFSET)?)
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
    let centres = (target.cells.size()[0] as f64).max(1.0);
    let part = |answer: &Tensor, wanted: &Tensor| -> Result<Tensor, TchError> {
        // (n, 2, h, w) to (n h w, 2), then the centres' rows.
        let rows = answer.f_permute([0, 2, 3, 1])?.f_reshape([-1, 2])?.f_index_select(0, &target.cells)?;
        rows.f_sub(wanted)?.f_abs()?.f_sum(tch::Kind::Float)?.f_div_scalar(centres)
    };
    Ok(Loss {
        heat: focal(&answer.heat, &target.heat)?.f_div_scalar(centres)?,
        size: part(&answer.size, &target.size)?,
        offset: part(&answer.offset, &target.offset)?,
    })
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
            size: Tensor::full([1, 2, 2, 2], 3.0, (Kind::Float, Device::Cpu)),
            offset: Tensor::zeros([1, 2, 2, 2], (Kind::Float, Device::Cpu)),
            road: None,
        };
        let target = Target {
            heat,
            cells: Tensor::from_slice(&[0_i64]),
            size: Tensor::from_slice(&[5.0_f32, 2.0]).view([1, 2]),
            offset: Tensor::from_slice(&[0.25_f32, 0.5]).view([1, 2]),
        };
        let loss = loss(&answer, &target).unwrap();
        let half = 0.5_f64.ln();
        // -(1-p)^2 log p; -(1-y)^4 p^2 log(1-p) with y = 0.5 and y = 0.
        let heat = -0.25 * half - 0.0625 * 0.25 * half - 0.25 * half;
        assert!((loss.heat.double_value(&[]) - heat).abs() < 1e-6);
        assert!((loss.size.double_value(&[]) - 3.0).abs() < 1e-6);
        assert!((loss.offset.double_value(&[]) - 0.75).abs() < 1e-6);
        assert!((loss.total().unwrap().double_value(&[]) - (heat + 0.3 + 0.75)).abs() < 1e-6);
    }
}
