//! The paper's backbone: ResNet-50 V2 (He et al. 2016, "Identity Mappings in Deep Residual Networks"),
//! brought back up to a quarter of the picture by three transposed convolutions (Zhou et al. 2019,
//! "Objects as Points", section 5).

use super::layer::{Conv, Kernel, Norm};
use tch::nn::Path;
use tch::{TchError, Tensor};

/// Blocks and channels of the four stages.
const STAGES: [(usize, i64); 4] = [(3, 256), (4, 512), (6, 1024), (3, 2048)];
/// Channels on the way up.
const UP: [i64; 3] = [256, 128, 64];
/// Channels that the heads see.
pub const OUT: i64 = UP[2];

/// Pre-activation bottleneck: norm and ReLU come before each convolution.
#[derive(Debug)]
struct Bottleneck {
    before: Norm,
    /// 1x1, 3x3 with batch norm after them; 1x1.
    convs: [Conv; 3],
    shortcut: Option<Conv>,
}

impl Bottleneck {
    fn new(path: &Path<'_>, from: i64, to: i64, stride: i64) -> Self {
        let middle = to / 4;
        Self {
            before: Norm::new(&(path / "before"), from),
            convs: [
                Conv::new(&(path / "conv1"), from, middle, Kernel::normed(1, 1)),
                Conv::new(&(path / "conv2"), middle, middle, Kernel::normed(3, stride)),
                Conv::new(&(path / "conv3"), middle, to, Kernel::plain(1)),
            ],
            shortcut: (from != to || stride != 1)
                .then(|| Conv::new(&(path / "shortcut"), from, to, Kernel { stride, ..Kernel::plain(1) })),
        }
    }

    fn forward(&self, x: &Tensor, train: bool) -> Result<Tensor, TchError> {
        let start = self.before.forward(x, train)?.f_relu()?;
        let mut y = self.convs[0].forward(&start, train)?.f_relu()?;
        y = self.convs[1].forward(&y, train)?.f_relu()?;
        y = self.convs[2].forward(&y, train)?;
        match &self.shortcut {
            Some(shortcut) => y.f_add(&shortcut.forward(&start, train)?),
            None => y.f_add(x),
        }
    }
}

/// The backbone.
#[derive(Debug)]
pub struct Resnet50V2 {
    stem: Conv,
    blocks: Vec<Bottleneck>,
    after: Norm,
    up: Vec<Conv>,
}

impl Resnet50V2 {
    /// With variables under `path`.
    pub fn new(path: &Path<'_>) -> Self {
        let stem = Conv::new(&(path / "stem"), 3, 64, Kernel { stride: 2, ..Kernel::plain(7) });
        let mut blocks = Vec::new();
        let mut from = 64;
        for (stage, &(count, to)) in STAGES.iter().enumerate() {
            for block in 0..count {
                let path = path / format!("stage{}", stage + 1) / format!("block{}", block + 1);
                let stride = if block == 0 && stage > 0 { 2 } else { 1 };
                blocks.push(Bottleneck::new(&path, from, to, stride));
                from = to;
            }
        }
        let after = Norm::new(&(path / "after"), from);
        let kernel = Kernel { up: true, ..Kernel::normed(4, 2) };
        let up = UP
            .iter()
            .enumerate()
            .map(|(i, &to)| {
                let conv = Conv::new(&(path / format!("up{}", i + 1)), from, to, kernel);
                from = to;
                conv
            })
            .collect();
        Self { stem, blocks, after, up }
    }

    /// Pictures (n, 3, h, w) to (n, [`OUT`], h / 4, w / 4).
    ///
    /// # Errors
    /// torch fails; h and w must be multiples of 32.
    pub fn forward(&self, x: &Tensor, train: bool) -> Result<Tensor, TchError> {
        let mut x = self.stem.forward(x, train)?.f_max_pool2d([3, 3], [2, 2], [1, 1], [1, 1], false)?;
        for block in &self.blocks {
            x = block.forward(&x, train)?;
        }
        x = self.after.forward(&x, train)?.f_relu()?;
        for up in &self.up {
            x = up.forward(&x, train)?.f_relu()?;
        }
        Ok(x)
    }

    /// Folds the batch norms that follow a convolution; the others stay.
    ///
    /// # Errors
    /// torch fails.
    pub fn fold(&mut self) -> Result<(), TchError> {
        for block in &mut self.blocks {
            block.convs.iter_mut().try_for_each(Conv::fold)?;
        }
        self.up.iter_mut().try_for_each(Conv::fold)
    }
}
