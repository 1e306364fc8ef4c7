//! One or more numbers that are worked on together; here single numbers.

use std::ops::{Add, Div, Mul, Sub};

/// One or more numbers that are worked on together.
pub trait Lane:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self>
{
    /// How many.
    const COUNT: usize;
    /// The outcome of comparisons.
    type Mask: Copy;
    fn splat(v: f32) -> Self;
    /// 0, 1, 2, ...
    fn ramp() -> Self;
    /// The first numbers of `from`, which must have [`Lane::COUNT`].
    fn load(from: &[f32]) -> Self;
    fn store(self, to: &mut [f32]);
    /// Low and high bytes of the first words of `from`, as numbers.
    fn load_bytes(from: &[u16]) -> (Self, Self);
    /// As bytes, for numbers within 0..256.
    fn store_bytes(self, to: &mut [u8]);
    /// Three bytes packed for each, from the low bits of floats, where `keep` does not hold.
    fn pack(r: Self, g: Self, b: Self, to: &mut [u32], keep: Self::Mask);
    /// The smaller, and the larger.
    fn min(self, other: Self) -> Self;
    fn max(self, other: Self) -> Self;
    fn abs(self) -> Self;
    /// `self` x `a` + `b`, rounded once.
    fn fma(self, a: Self, b: Self) -> Self;
    /// The square root within 0.07 %, for numbers from 0 on; faster.
    fn root(self) -> Self;
    fn less(self, other: Self) -> Self::Mask;
    fn both(a: Self::Mask, b: Self::Mask) -> Self::Mask;
    fn select(mask: Self::Mask, yes: Self, no: Self) -> Self;
    /// Four bytes (corners) at masked texel coordinates of a square table of `1 << bits` texels a side,
    /// blended by the fractions: 0..255. The table must have `1 << 2 * bits` words.
    fn texel(table: &[u32], bits: u32, x: Self, y: Self) -> Self;
    /// The words of `table` at whole-numbered indices, which are brought within it; those `next` before
    /// them will be asked for soon.
    fn lookup(table: &[u32], index: Self, next: usize, to: &mut [u32]);
    /// Puts these into the first `count` places of `depth`, and `id` into those of `ids`, where they are
    /// larger (and above 0); whether any is.
    fn nearer(self, count: i32, depth: &mut [f32], ids: &mut [u32], id: u32) -> bool;
    /// The same where `end` holds and `begin` does not.
    fn nearer_between(
        self,
        begin: Self::Mask,
        end: Self::Mask,
        depth: &mut [f32],
        ids: &mut [u32],
        id: u32,
    ) -> bool;
    /// Where `depth` is 0, puts these there and `id` into `ids` if they are above `far`, else 0 into `ids`.
    fn fill_empty(self, far: f32, depth: &mut [f32], ids: &mut [u32], id: u32);
    /// The places, as bits, where two rows of ids differ.
    fn differ(a: &[u32], b: &[u32]) -> u32;
    /// Puts `x` + the place of each bit of `bits` into `to` from `count` on; the new count. `to` must have
    /// room for 8 more.
    fn places(bits: u32, x: usize, to: &mut [u32], count: usize) -> usize;
    /// The places, as bits, where two rows of (ids, packed colours) have different ids and colours far
    /// enough apart (more than 20 of 765) to see it.
    fn borders(a: (&[u32], &[u32]), b: (&[u32], &[u32])) -> u32;
    /// A well-mixed number 0..1 for each pair of whole numbers and a seed.
    fn random(x: Self, y: Self, seed: u32) -> Self;

    /// Within 0..1.
    #[inline(always)]
    fn unit(self) -> Self {
        self.max(Self::splat(0.0)).min(Self::splat(1.0))
    }
    /// Rounded down, for |x| < 2^22.
    #[inline(always)]
    fn floor(self) -> Self {
        let magic = Self::splat(12_582_912.0);
        self - Self::splat(0.5) + magic - magic
    }
    /// From `self` to `other` by `t`.
    #[inline(always)]
    fn mix(self, other: Self, t: Self) -> Self {
        (other - self).fma(t, self)
    }
}

impl Lane for f32 {
    const COUNT: usize = 1;
    type Mask = bool;
    #[inline(always)]
    fn splat(v: f32) -> Self {
        v
    }
    #[inline(always)]
    fn ramp() -> Self {
        0.0
    }
    #[inline(always)]
    fn load(from: &[f32]) -> Self {
        from[0]
    }
    #[inline(always)]
    fn store(self, to: &mut [f32]) {
        to[0] = self;
    }
    #[inline(always)]
    fn load_bytes(from: &[u16]) -> (Self, Self) {
        (f32::from(from[0] & 0xff), f32::from(from[0] >> 8))
    }
    #[inline(always)]
    fn store_bytes(self, to: &mut [u8]) {
        to[0] = self as u8;
    }
    #[inline(always)]
    fn pack(r: Self, g: Self, b: Self, to: &mut [u32], keep: bool) {
        if !keep {
            let byte = |v: f32| v.to_bits() & 0xff;
            to[0] = byte(r) | byte(g) << 8 | byte(b) << 16;
        }
    }
    // As the processor's instructions, the second where one is NaN.
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        if self < other { self } else { other }
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        if self > other { self } else { other }
    }
    #[inline(always)]
    fn abs(self) -> Self {
        f32::abs(self)
    }
    #[inline(always)]
    fn fma(self, a: Self, b: Self) -> Self {
        f32::mul_add(self, a, b)
    }
    #[inline(always)]
    fn root(self) -> Self {
        // Kadlec's numbers for the inverse root by its bits, and one of Newton's steps:
        // x g 0.703952 (2.389245 - x g g).
        let guess = f32::from_bits(0x5f1f_fff9 - (self.to_bits() >> 1));
        let half = self * guess;
        half * (half * guess).fma(-0.703_952_25, 1.681_914_1)
    }
    #[inline(always)]
    fn less(self, other: Self) -> bool {
        self < other
    }
    #[inline(always)]
    fn both(a: bool, b: bool) -> bool {
        a & b
    }
    #[inline(always)]
    fn select(mask: bool, yes: Self, no: Self) -> Self {
        if mask { yes } else { no }
    }
    #[inline(always)]
    fn texel(table: &[u32], bits: u32, x: Self, y: Self) -> Self {
        let ((ix, fx), (iy, fy)) = (crate::simd::split(x), crate::simd::split(y));
        let mask = (1 << bits) - 1;
        let word = table[((iy & mask) << bits | ix & mask) as usize];
        let corner = |shift: u32| (word >> shift & 0xff) as f32;
        corner(0).mix(corner(8), fx).mix(corner(16).mix(corner(24), fx), fy)
    }
    #[inline(always)]
    fn lookup(table: &[u32], index: Self, _: usize, to: &mut [u32]) {
        to[0] = table[(index.max(0.0) as usize).min(table.len() - 1)];
    }
    #[inline(always)]
    fn nearer(self, count: i32, depth: &mut [f32], ids: &mut [u32], id: u32) -> bool {
        let nearer = count > 0 && self > depth[0];
        if nearer {
            (depth[0], ids[0]) = (self, id);
        }
        nearer
    }
    #[inline(always)]
    fn nearer_between(self, begin: bool, end: bool, depth: &mut [f32], ids: &mut [u32], id: u32) -> bool {
        self.nearer(i32::from(end & !begin), depth, ids, id)
    }
    #[inline(always)]
    fn fill_empty(self, far: f32, depth: &mut [f32], ids: &mut [u32], id: u32) {
        if depth[0] == 0.0 {
            (depth[0], ids[0]) = if self > far { (self, id) } else { (0.0, 0) };
        }
    }
    #[inline(always)]
    fn differ(a: &[u32], b: &[u32]) -> u32 {
        u32::from(a[0] != b[0])
    }
    #[inline(always)]
    fn places(bits: u32, x: usize, to: &mut [u32], count: usize) -> usize {
        to[count] = x as u32;
        count + (bits & 1) as usize
    }
    #[inline(always)]
    fn borders(a: (&[u32], &[u32]), b: (&[u32], &[u32])) -> u32 {
        let byte = |word: u32, shift: u32| word >> shift & 0xff;
        let gap = |shift| byte(a.1[0], shift).abs_diff(byte(b.1[0], shift));
        u32::from(a.0[0] != b.0[0] && gap(0) + gap(8) + gap(16) + gap(24) > 20)
    }
    #[inline(always)]
    fn random(x: Self, y: Self, seed: u32) -> Self {
        let magic = 12_582_912.0_f32;
        crate::simd::unit(seed ^ (x + magic).to_bits() << 8 ^ (y + magic).to_bits() << 20)
    }
}
