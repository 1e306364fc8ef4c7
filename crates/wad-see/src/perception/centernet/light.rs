//! The backbone that runs in real time on one core: a small residual network with a feature pyramid.
//!
//! ```text
//! 3 --/2--> 16 --/4--> 24 --/8--> 48 x2 --/16--> 96 x2 --/32--> 160 x2
//!                      |          |             |              |
//!                      32 <--up-- 32 <---up---- 32 <---up----- 32      3x3 at /4 -> 48
//! ```
//!
//! In `eyes` the last level has a second block whose numbers lie two cells apart: from a near vehicle's middle its
//! edges are farther away than the others see.
//!
//! Plain 3x3 convolutions: on processors they come nearer to the peak than depthwise ones. Batch norm is
//! folded into them for use.

use super::graph::{CHANNELS, OUT, PYRAMID, WIDE};
use super::layer::{Conv, Kernel};
use tch::nn::Path;
use tch::{TchError, Tensor};

/// Two 3x3 convolutions round a shortcut.
#[derive(Debug)]
struct Block {
    first: Conv,
    second: Conv,
}

impl Block {
    fn new(path: &Path<'_>, channels: i64, dilation: i64) -> Self {
        let conv = |name: &str| Conv::new(&(path / name), channels, channels, Kernel::dilated(dilation));
        Self { first: conv("first"), second: conv("second") }
    }

    fn fold(&mut self) -> Result<(), TchError> {
        self.first.fold()?;
        self.second.fold()
    }

    fn forward(&self, x: &Tensor, train: bool) -> Result<Tensor, TchError> {
        let y = self.first.forward(x, train)?.f_relu_()?;
        self.second.forward(&y, train)?.f_add_(x)?.f_relu_()
    }
}

/// The backbone.
#[derive(Debug)]
pub struct Light {
    stem: [Conv; 2],
    /// Strides 8, 16, 32: the way down and the block there.
    down: Vec<(Conv, Block)>,
    /// The last level's second block; None: it has none.
    wide: Option<Block>,
    /// Strides 4, 8, 16, 32.
    lateral: Vec<Conv>,
    smooth: Conv,
}

impl Light {
    /// With variables under `path`, and `wide` with a second block at the last level.
    ///
    /// # Errors
    /// torch fails.
    pub fn new(path: &Path<'_>, wide: bool) -> Result<Self, TchError> {
        let [a, b, ..] = CHANNELS;
        let stem = [
            Conv::new(&(path / "stem1"), 3, a, Kernel::normed(3, 2)),
            Conv::new(&(path / "stem2"), a, b, Kernel::normed(3, 2)),
        ];
        let down = (2..CHANNELS.len())
            .map(|i| {
                let path = path / format!("stride{}", 2 << i);
                let (from, to) = (CHANNELS[i - 1], CHANNELS[i]);
                (
                    Conv::new(&(&path / "down"), from, to, Kernel::normed(3, 2)),
                    Block::new(&(&path / "block"), to, 1),
                )
            })
            .collect();
        let mut wide = wide.then(|| Block::new(&(path / "wide"), CHANNELS[CHANNELS.len() - 1], WIDE));
        if let Some(block) = &mut wide {
            block.second.begin_silent()?;
        }
        let lateral = (1..CHANNELS.len())
            .map(|i| {
                let path = path / format!("lateral{}", 2 << i);
                Conv::new(&path, CHANNELS[i], PYRAMID, Kernel::normed(1, 1))
            })
            .collect();
        let smooth = Conv::new(&(path / "smooth"), PYRAMID, OUT, Kernel::normed(3, 1));
        Ok(Self { stem, down, wide, lateral, smooth })
    }

    /// Pictures (n, 3, h, w) to (n, [`OUT`], h / 4, w / 4).
    ///
    /// # Errors
    /// torch fails; h and w must be multiples of 32.
    pub fn forward(&self, x: &Tensor, train: bool) -> Result<Tensor, TchError> {
        let mut x = self.stem[0].forward(x, train)?.f_relu_()?;
        x = self.stem[1].forward(&x, train)?.f_relu_()?;
        let mut levels = vec![x];
        for (down, block) in &self.down {
            let last = &levels[levels.len() - 1];
            let x = down.forward(last, train)?.f_relu_()?;
            levels.push(block.forward(&x, train)?);
        }
        if let (Some(block), Some(last)) = (&self.wide, levels.last_mut()) {
            *last = block.forward(last, train)?;
        }
        let mut top: Option<Tensor> = None;
        for (level, lateral) in levels.iter().zip(&self.lateral).rev() {
            let mut side = lateral.forward(level, train)?;
            let (h, w) = (level.size()[2], level.size()[3]);
            top = Some(match top {
                Some(top) => side.f_add(&top.f_upsample_nearest2d([h, w], None, None)?)?.f_relu_()?,
                None => side.f_relu_()?,
            });
        }
        let top = top.ok_or_else(|| TchError::Convert("a pyramid without levels".to_string()))?;
        self.smooth.forward(&top, train)?.f_relu_()
    }

    /// Folds every batch norm.
    ///
    /// # Errors
    /// torch fails.
    pub fn fold(&mut self) -> Result<(), TchError> {
        let convs = self.stem.iter_mut().chain(&mut self.lateral).chain(std::iter::once(&mut self.smooth));
        for conv in convs {
            conv.fold()?;
        }
        for (down, block) in &mut self.down {
            down.fold()?;
            block.fold()?;
        }
        self.wide.as_mut().map_or(Ok(()), Block::fold)
    }
}
