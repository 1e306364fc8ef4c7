//! Tiles of noise, made once, sampled with one load for the four corners.

use super::lanes::Lane;
use super::simd::hash;
use std::sync::OnceLock;

/// Texels along a side of a tile; it repeats.
pub const SIZE: usize = 128;

/// A repeating tile: each word holds the texel's value and its right, upper and diagonal neighbours'.
pub struct Tile(Box<[u32; SIZE * SIZE]>);

impl Tile {
    fn new(value: impl Fn(usize, usize) -> f32) -> Self {
        let plain: Vec<u32> = (0..SIZE * SIZE)
            .map(|i| (value(i % SIZE, i / SIZE).clamp(0.0, 1.0) * 255.0).round() as u32)
            .collect();
        let at = |x: usize, y: usize| plain[y % SIZE * SIZE + x % SIZE];
        let mut packed = Box::new([0; SIZE * SIZE]);
        for y in 0..SIZE {
            for x in 0..SIZE {
                packed[y * SIZE + x] =
                    at(x, y) | at(x + 1, y) << 8 | at(x, y + 1) << 16 | at(x + 1, y + 1) << 24;
            }
        }
        Self(packed)
    }

    /// The values 0..1 at texel coordinates, interpolated.
    #[inline(always)]
    pub fn sample<L: Lane>(&self, x: L, y: L) -> L {
        L::texel(self.0.as_slice(), SIZE.ilog2(), x, y) * L::splat(1.0 / 255.0)
    }

    /// The value 0..1 at texel coordinates, interpolated.
    pub fn at(&self, x: f32, y: f32) -> f32 {
        self.sample(x, y)
    }
}

/// The tiles that the shading uses.
pub struct Tiles {
    /// Clouds of several sizes.
    pub clouds: Tile,
    /// Thin dark lines where fields of noise cross their middle.
    pub cracks: Tile,
}

/// The tiles, made on first use.
pub fn tiles() -> &'static Tiles {
    static TILES: OnceLock<Tiles> = OnceLock::new();
    TILES.get_or_init(|| Tiles {
        clouds: Tile::new(|x, y| fractal(x as f32, y as f32, 3)),
        cracks: Tile::new(|x, y| {
            let warp = fractal(x as f32, y as f32, 9) - 0.5;
            let field = fractal(x as f32 + 14.0 * warp, y as f32 + 9.0 * warp, 17);
            1.0 - ((field - 0.5).abs() * 26.0).min(1.0)
        }),
    })
}

fn random(x: usize, y: usize, seed: u32) -> f32 {
    (hash(x as u32 ^ (y as u32) << 12 ^ seed << 24) >> 8) as f32 / 16_777_216.0
}

/// Repeating value noise of five octaves, spread to fill 0..1.
fn fractal(x: f32, y: f32, seed: u32) -> f32 {
    let (mut sum, mut weight) = (0.0, 0.5);
    for octave in 0..5 {
        let cells = 4usize << octave;
        let scale = cells as f32 / SIZE as f32;
        let (fx, fy) = ((x * scale).rem_euclid(cells as f32), (y * scale).rem_euclid(cells as f32));
        let (ix, iy) = (fx as usize, fy as usize);
        let smooth = |t: f32| t * t * (3.0 - 2.0 * t);
        let (tx, ty) = (smooth(fx - ix as f32), smooth(fy - iy as f32));
        let v = |dx: usize, dy: usize| random((ix + dx) % cells, (iy + dy) % cells, seed + octave);
        let low = v(0, 0) + (v(1, 0) - v(0, 0)) * tx;
        let high = v(0, 1) + (v(1, 1) - v(0, 1)) * tx;
        sum += weight * (low + (high - low) * ty);
        weight *= 0.5;
    }
    ((sum / 0.96875 - 0.5) * 1.9 + 0.5).clamp(0.0, 1.0)
}
