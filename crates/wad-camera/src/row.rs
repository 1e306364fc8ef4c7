//! What all shading needs: a row of the picture, runs of one surface in it, what is linear along them.

use super::lanes::Lane;
use super::raster::PAD;
use super::surface::Surface;

/// Pixels from post to post.
pub(super) const POST: usize = 8;
/// One row of the picture while it is shaded: scene light, and how much it mirrors. Padded: a run's last
/// lanes may write beyond its end, where the next run writes over them.
#[derive(Default)]
pub struct Row {
    pub r: Vec<f32>,
    pub g: Vec<f32>,
    pub b: Vec<f32>,
    /// Share (0..255) of what a wet ground mirrors.
    pub mirror: Vec<u8>,
    /// Of the ground's posts: colour, shine, light on paint, noise.
    pub posts: [Vec<f32>; 8],
}

impl Row {
    /// Makes room for a row of `width` pixels.
    pub fn resize(&mut self, width: usize) {
        for line in [&mut self.r, &mut self.g, &mut self.b] {
            line.resize(width + PAD, 0.0);
        }
        self.mirror.clear();
        self.mirror.resize(width + PAD, 0);
        for posts in &mut self.posts {
            posts.resize(width / POST + 2 * PAD, 0.0);
        }
    }
}

/// A run of pixels of one surface.
pub struct Run<'a> {
    pub surface: &'a Surface,
    pub x0: usize,
    pub x1: usize,
    /// Row's centre.
    pub y: f32,
    /// 1 / depth of the row, padded.
    pub iz: &'a [f32],
}

/// 1 near, falling to 0 as a pixel's footprint grows past `size` (m).
pub(super) fn fade(footprint: f32, size: f32) -> f32 {
    let t = footprint / size;
    1.0 / (1.0 + t * t * t)
}

/// A quantity that is linear over a triangle, in the row of a run: depth (base + step x) + rest.
#[derive(Clone, Copy)]
pub(super) struct Linear {
    pub base: f32,
    pub step: f32,
    pub rest: f32,
}

impl Linear {
    #[inline(always)]
    pub fn of(plane: &[f32; 4], y: f32) -> Self {
        Self { base: plane[1] * y + plane[2] + plane[0] * 0.5, step: plane[0], rest: plane[3] }
    }
    #[inline(always)]
    pub fn at<L: Lane>(&self, x: L, z: L) -> L {
        z.fma(L::splat(self.step).fma(x, L::splat(self.base)), L::splat(self.rest))
    }
    pub fn one(&self, x: usize, z: f32) -> f32 {
        z * (self.base + self.step * x as f32) + self.rest
    }
}

/// Grain about 0: cells of `1 / scale` m, each of its own brightness. Their middles are not smoothed: the
/// cells are too small to see it, and no table is needed.
#[inline(always)]
pub(super) fn grain<L: Lane>(x: L, y: L, scale: f32, share: f32) -> L {
    // As strong as smoothed cells of the full share would be.
    let share = 0.7 * share;
    L::random(x * L::splat(scale), y * L::splat(scale), 1).fma(L::splat(share), L::splat(-0.5 * share))
}
