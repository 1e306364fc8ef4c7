//! Convolution and batch norm, trained apart and folded into one for use.

use super::graph::EPSILON;
use tch::nn::{Init, Path};
use tch::{TchError, Tensor};

/// Batch norm's share of the new batch in the running statistics.
const MOMENTUM: f64 = 0.1;

/// Batch norm.
#[derive(Debug)]
pub struct Norm {
    scale: Tensor,
    shift: Tensor,
    mean: Tensor,
    variance: Tensor,
}

impl Norm {
    /// Batch norm of `channels` channels.
    pub fn new(path: &Path<'_>, channels: i64) -> Self {
        Self {
            scale: path.var("scale", &[channels], Init::Const(1.0)),
            shift: path.var("shift", &[channels], Init::Const(0.0)),
            mean: path.zeros_no_train("mean", &[channels]),
            variance: path.ones_no_train("variance", &[channels]),
        }
    }

    /// The normed picture.
    ///
    /// # Errors
    /// torch fails.
    pub fn forward(&self, x: &Tensor, train: bool) -> Result<Tensor, TchError> {
        let (scale, shift) = (Some(&self.scale), Some(&self.shift));
        let (mean, variance) = (Some(&self.mean), Some(&self.variance));
        x.f_batch_norm(scale, shift, mean, variance, train, MOMENTUM, EPSILON, true)
    }
}

/// A convolution's parameters beside its channels.
#[derive(Clone, Copy, Debug)]
pub struct Kernel {
    /// Side, odd (or 4 where `up`).
    pub side: i64,
    pub stride: i64,
    /// Cells between the numbers that are summed.
    pub dilation: i64,
    /// Upwards: a transposed convolution.
    pub up: bool,
    /// Followed by batch norm, which then brings the bias.
    pub norm: bool,
}

impl Kernel {
    /// `side` x `side` with batch norm.
    pub const fn normed(side: i64, stride: i64) -> Self {
        Self { side, stride, dilation: 1, up: false, norm: true }
    }

    /// 3x3 with batch norm, `dilation` cells apart.
    pub const fn dilated(dilation: i64) -> Self {
        Self { dilation, ..Self::normed(3, 1) }
    }

    /// `side` x `side` with a bias.
    pub const fn plain(side: i64) -> Self {
        Self { side, stride: 1, dilation: 1, up: false, norm: false }
    }
}

/// A convolution with what follows it.
#[derive(Debug)]
pub struct Conv {
    kernel: Kernel,
    weight: Tensor,
    bias: Option<Tensor>,
    norm: Option<Norm>,
}

impl Conv {
    /// A convolution of `from` to `to` channels; He's normal initialisation.
    pub fn new(path: &Path<'_>, from: i64, to: i64, kernel: Kernel) -> Self {
        let Kernel { side, stride, up, norm, .. } = kernel;
        let (shape, seen) = if up {
            ([from, to, side, side], from * side * side / (stride * stride))
        } else {
            ([to, from, side, side], from * side * side)
        };
        let init = Init::Randn { mean: 0.0, stdev: (2.0 / seen as f64).sqrt() };
        Self {
            kernel,
            weight: path.var("weight", &shape, init),
            bias: (!norm).then(|| path.var("bias", &[to], Init::Const(0.0))),
            norm: norm.then(|| Norm::new(path, to)),
        }
    }

    /// Initialises weights and bias again: a head whose first outputs are small.
    ///
    /// # Errors
    /// torch fails.
    pub fn begin_at(&mut self, deviation: f64, bias: f64) -> Result<(), TchError> {
        tch::no_grad(|| {
            let _ = self.weight.f_normal_(0.0, deviation)?;
            self.bias.as_mut().map_or(Ok(()), |b| b.f_fill_(bias).map(|_| ()))
        })
    }

    /// Batch norm answers 0 at first: a layer round a shortcut that changes nothing until it learns.
    ///
    /// # Errors
    /// torch fails.
    pub fn begin_silent(&mut self) -> Result<(), TchError> {
        let Some(norm) = &mut self.norm else { return Ok(()) };
        tch::no_grad(|| norm.scale.f_fill_(0.0).map(|_| ()))
    }

    /// The convolution, and batch norm after it, in the precision of `x`.
    ///
    /// # Errors
    /// torch fails.
    pub fn forward(&self, x: &Tensor, train: bool) -> Result<Tensor, TchError> {
        let Kernel { side, stride, dilation, up, .. } = self.kernel;
        let weight = self.weight.f_to_kind(x.kind())?;
        let bias = self.bias.as_ref().map(|b| b.f_to_kind(x.kind())).transpose()?;
        let bias = bias.as_ref();
        let x = if up {
            let pad = (side - stride) / 2;
            x.f_conv_transpose2d(&weight, bias, [stride; 2], [pad; 2], [0; 2], 1, [1; 2])?
        } else {
            x.f_conv2d(&weight, bias, [stride; 2], [side / 2 * dilation; 2], [dilation; 2], 1)?
        };
        self.norm.as_ref().map_or(Ok(x.shallow_clone()), |norm| norm.forward(&x, train))
    }

    /// Folds batch norm into weight and bias. The layer cannot be trained after that.
    ///
    /// # Errors
    /// torch fails.
    pub fn fold(&mut self) -> Result<(), TchError> {
        tch::no_grad(|| {
            if let Some(norm) = self.norm.take() {
                let factor = norm.scale.f_div(&norm.variance.f_add_scalar(EPSILON)?.f_sqrt()?)?;
                let shape: [i64; 4] = if self.kernel.up { [1, -1, 1, 1] } else { [-1, 1, 1, 1] };
                self.weight = self.weight.f_mul(&factor.f_view(shape)?)?;
                self.bias = Some(norm.shift.f_sub(&norm.mean.f_mul(&factor)?)?);
            }
            Ok(())
        })
    }
}
