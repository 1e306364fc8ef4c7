//! Eight lanes: AVX2.

use super::lane::Lane;
use std::arch::x86_64::*;
use std::ops::{Add, Div, Mul, Sub};

/// Eight numbers. Use it only inside functions compiled for AVX2, on processors that have it.
#[derive(Clone, Copy)]
pub struct Eight(__m256);

macro_rules! operator {
    ($trait:ident, $name:ident, $intrinsic:ident) => {
        impl $trait for Eight {
            type Output = Self;
            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                // SAFETY: see [`Eight`].
                unsafe { Self($intrinsic(self.0, other.0)) }
            }
        }
    };
}
operator!(Add, add, _mm256_add_ps);
operator!(Sub, sub, _mm256_sub_ps);
operator!(Mul, mul, _mm256_mul_ps);
operator!(Div, div, _mm256_div_ps);

/// Integer bits, masked, and fraction, as `simd::split`.
#[inline(always)]
fn split(x: Eight) -> (__m256i, Eight) {
    let magic = Eight::splat(12_582_912.0);
    let shifted = x - Eight::splat(0.5) + magic;
    // SAFETY: see [`Eight`].
    let bits = unsafe { _mm256_castps_si256(shifted.0) };
    (bits, (x - (shifted - magic)).unit())
}

#[inline(always)]
fn hash(mut x: __m256i) -> __m256i {
    // SAFETY: see [`Eight`].
    unsafe {
        x = _mm256_xor_si256(x, _mm256_srli_epi32::<16>(x));
        x = _mm256_mullo_epi32(x, _mm256_set1_epi32(0x7feb_352d));
        x = _mm256_xor_si256(x, _mm256_srli_epi32::<15>(x));
        x = _mm256_mullo_epi32(x, _mm256_set1_epi32(0x846c_a68b_u32 as i32));
        _mm256_xor_si256(x, _mm256_srli_epi32::<16>(x))
    }
}

#[inline(always)]
fn load_words(from: &[u32]) -> __m256i {
    let from = &from[..8];
    // SAFETY: see [`Eight`]; the slice has the length.
    unsafe { _mm256_loadu_si256(from.as_ptr().cast()) }
}

/// The low byte of each float's bits.
#[inline(always)]
fn byte(v: Eight) -> __m256i {
    // SAFETY: see [`Eight`].
    unsafe { _mm256_and_si256(_mm256_castps_si256(v.0), _mm256_set1_epi32(0xff)) }
}

/// Each word's low byte as a number.
#[inline(always)]
fn number(v: __m256i) -> Eight {
    // SAFETY: see [`Eight`].
    unsafe { Eight(_mm256_cvtepi32_ps(_mm256_and_si256(v, _mm256_set1_epi32(0xff)))) }
}

/// The places of the bits of each byte.
static PLACES: [[u8; 8]; 256] = {
    let mut table = [[0; 8]; 256];
    let mut bits = 0;
    while bits < 256 {
        let (mut place, mut count) = (0, 0);
        while place < 8 {
            if bits >> place & 1 == 1 {
                table[bits][count] = place as u8;
                count += 1;
            }
            place += 1;
        }
        bits += 1;
    }
    table
};

// SAFETY (all blocks below): see [`Eight`] for the instructions; loads and stores are of slices
// whose length was checked; gathered indices are masked to the table's checked size.
impl Lane for Eight {
    const COUNT: usize = 8;
    type Mask = __m256;
    #[inline(always)]
    fn splat(v: f32) -> Self {
        // SAFETY: see the impl.
        unsafe { Self(_mm256_set1_ps(v)) }
    }
    #[inline(always)]
    fn ramp() -> Self {
        // SAFETY: see the impl.
        unsafe { Self(_mm256_setr_ps(0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0)) }
    }
    #[inline(always)]
    fn load(from: &[f32]) -> Self {
        let from = &from[..8];
        // SAFETY: see the impl.
        unsafe { Self(_mm256_loadu_ps(from.as_ptr())) }
    }
    #[inline(always)]
    fn store(self, to: &mut [f32]) {
        let to = &mut to[..8];
        // SAFETY: see the impl.
        unsafe { _mm256_storeu_ps(to.as_mut_ptr(), self.0) }
    }
    #[inline(always)]
    fn load_bytes(from: &[u16]) -> (Self, Self) {
        let from = &from[..8];
        // SAFETY: see the impl.
        unsafe {
            let wide = _mm256_cvtepu16_epi32(_mm_loadu_si128(from.as_ptr().cast()));
            let low = _mm256_and_si256(wide, _mm256_set1_epi32(0xff));
            let high = _mm256_srli_epi32::<8>(wide);
            (Self(_mm256_cvtepi32_ps(low)), Self(_mm256_cvtepi32_ps(high)))
        }
    }
    #[inline(always)]
    fn store_bytes(self, to: &mut [u8]) {
        let to = &mut to[..8];
        // SAFETY: see the impl.
        unsafe {
            let whole = _mm256_cvttps_epi32(self.0);
            let (low, high) = (_mm256_castsi256_si128(whole), _mm256_extracti128_si256::<1>(whole));
            let words = _mm_packus_epi32(low, high);
            _mm_storel_epi64(to.as_mut_ptr().cast(), _mm_packus_epi16(words, words));
        }
    }
    #[inline(always)]
    fn pack(r: Self, g: Self, b: Self, to: &mut [u32], keep: __m256) {
        let to = &mut to[..8];
        let (r, g, b) = (byte(r), byte(g), byte(b));
        // SAFETY: see the impl.
        unsafe {
            let gb = _mm256_or_si256(_mm256_slli_epi32::<8>(g), _mm256_slli_epi32::<16>(b));
            let new = _mm256_or_si256(r, gb);
            let old = _mm256_loadu_si256(to.as_ptr().cast());
            // A blend would become a slow masked store.
            let change = _mm256_andnot_si256(_mm256_castps_si256(keep), _mm256_xor_si256(old, new));
            _mm256_storeu_si256(to.as_mut_ptr().cast(), _mm256_xor_si256(old, change));
        }
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        // SAFETY: see the impl.
        unsafe { Self(_mm256_min_ps(self.0, other.0)) }
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        // SAFETY: see the impl.
        unsafe { Self(_mm256_max_ps(self.0, other.0)) }
    }
    #[inline(always)]
    fn abs(self) -> Self {
        // SAFETY: see the impl.
        unsafe { Self(_mm256_andnot_ps(_mm256_set1_ps(-0.0), self.0)) }
    }
    #[inline(always)]
    fn fma(self, a: Self, b: Self) -> Self {
        // SAFETY: see the impl.
        unsafe { Self(_mm256_fmadd_ps(self.0, a.0, b.0)) }
    }
    #[inline(always)]
    fn root(self) -> Self {
        // SAFETY: see the impl.
        let guess = unsafe {
            let half = _mm256_srli_epi32::<1>(_mm256_castps_si256(self.0));
            Self(_mm256_castsi256_ps(_mm256_sub_epi32(_mm256_set1_epi32(0x5f1f_fff9), half)))
        };
        let half = self * guess;
        half * (half * guess).fma(Self::splat(-0.703_952_25), Self::splat(1.681_914_1))
    }
    #[inline(always)]
    fn less(self, other: Self) -> __m256 {
        // SAFETY: see the impl.
        unsafe { _mm256_cmp_ps::<_CMP_LT_OQ>(self.0, other.0) }
    }
    #[inline(always)]
    fn both(a: __m256, b: __m256) -> __m256 {
        // SAFETY: see the impl.
        unsafe { _mm256_and_ps(a, b) }
    }
    #[inline(always)]
    fn select(mask: __m256, yes: Self, no: Self) -> Self {
        // SAFETY: see the impl.
        unsafe { Self(_mm256_blendv_ps(no.0, yes.0, mask)) }
    }
    #[inline(always)]
    fn texel(table: &[u32], bits: u32, x: Self, y: Self) -> Self {
        let table = &table[..1 << (2 * bits)];
        let ((ix, fx), (iy, fy)) = (split(x), split(y));
        // SAFETY: see the impl.
        unsafe {
            let mask = _mm256_set1_epi32((1 << bits) - 1);
            let row = _mm256_sll_epi32(_mm256_and_si256(iy, mask), _mm_cvtsi32_si128(bits as i32));
            let index = _mm256_or_si256(row, _mm256_and_si256(ix, mask));
            let word = _mm256_i32gather_epi32::<4>(table.as_ptr().cast(), index);
            let c0 = number(word);
            let c1 = number(_mm256_srli_epi32::<8>(word));
            let c2 = number(_mm256_srli_epi32::<16>(word));
            let c3 = number(_mm256_srli_epi32::<24>(word));
            c0.mix(c1, fx).mix(c2.mix(c3, fx), fy)
        }
    }
    #[inline(always)]
    fn lookup(table: &[u32], index: Self, next: usize, to: &mut [u32]) {
        let to = &mut to[..8];
        assert!(!table.is_empty() && table.len() < 1 << 24);
        let index = index.max(Self::splat(0.0)).min(Self::splat((table.len() - 1) as f32));
        // SAFETY: see the impl.
        unsafe {
            let index = _mm256_cvttps_epi32(index.0);
            // A hint only: it may lie outside.
            for at in [_mm256_extract_epi32::<0>(index), _mm256_extract_epi32::<7>(index)] {
                let soon = table.as_ptr().wrapping_add(at as usize).wrapping_sub(next);
                _mm_prefetch::<_MM_HINT_T0>(soon.cast());
            }
            let words = _mm256_i32gather_epi32::<4>(table.as_ptr().cast(), index);
            _mm256_storeu_si256(to.as_mut_ptr().cast(), words);
        }
    }
    #[inline(always)]
    fn nearer(self, count: i32, depth: &mut [f32], ids: &mut [u32], id: u32) -> bool {
        // SAFETY: see the impl.
        let within = unsafe {
            let ramp = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7);
            _mm256_castsi256_ps(_mm256_cmpgt_epi32(_mm256_set1_epi32(count), ramp))
        };
        self.nearer_between(Self::splat(0.0).0, within, depth, ids, id)
    }
    #[inline(always)]
    fn nearer_between(self, begin: __m256, end: __m256, depth: &mut [f32], ids: &mut [u32], id: u32) -> bool {
        let (depth, ids) = (&mut depth[..8], &mut ids[..8]);
        // SAFETY: see the impl.
        unsafe {
            let new = _mm256_and_ps(self.0, _mm256_andnot_ps(begin, end));
            let old = _mm256_loadu_ps(depth.as_ptr());
            let nearer = _mm256_cmp_ps::<_CMP_GT_OQ>(new, old);
            // Blends that are stored where one side was loaded become slow masked stores.
            _mm256_storeu_ps(depth.as_mut_ptr(), _mm256_max_ps(new, old));
            let old = _mm256_loadu_si256(ids.as_ptr().cast());
            let change = _mm256_xor_si256(old, _mm256_set1_epi32(id as i32));
            let change = _mm256_and_si256(change, _mm256_castps_si256(nearer));
            _mm256_storeu_si256(ids.as_mut_ptr().cast(), _mm256_xor_si256(old, change));
            _mm256_movemask_ps(nearer) != 0
        }
    }
    #[inline(always)]
    fn fill_empty(self, far: f32, depth: &mut [f32], ids: &mut [u32], id: u32) {
        let (depth, ids) = (&mut depth[..8], &mut ids[..8]);
        // SAFETY: see the impl.
        unsafe {
            let old = _mm256_loadu_ps(depth.as_ptr());
            let empty = _mm256_cmp_ps::<_CMP_EQ_OQ>(old, _mm256_setzero_ps());
            if _mm256_movemask_ps(empty) == 0 {
                return;
            }
            let near = _mm256_cmp_ps::<_CMP_GT_OQ>(self.0, _mm256_set1_ps(far));
            let put = _mm256_and_ps(near, empty);
            _mm256_storeu_ps(depth.as_mut_ptr(), _mm256_or_ps(old, _mm256_and_ps(put, self.0)));
            let old = _mm256_loadu_si256(ids.as_ptr().cast());
            let kept = _mm256_andnot_si256(_mm256_castps_si256(empty), old);
            let new = _mm256_and_si256(_mm256_castps_si256(put), _mm256_set1_epi32(id as i32));
            _mm256_storeu_si256(ids.as_mut_ptr().cast(), _mm256_or_si256(kept, new));
        }
    }
    #[inline(always)]
    fn differ(a: &[u32], b: &[u32]) -> u32 {
        // SAFETY: see the impl.
        unsafe {
            let same = _mm256_cmpeq_epi32(load_words(a), load_words(b));
            _mm256_movemask_ps(_mm256_castsi256_ps(same)) as u32 ^ 0xff
        }
    }
    #[inline(always)]
    fn places(bits: u32, x: usize, to: &mut [u32], count: usize) -> usize {
        let (places, to) = (&PLACES[(bits & 0xff) as usize], &mut to[count..count + 8]);
        // SAFETY: see the impl.
        unsafe {
            let places = _mm256_cvtepu8_epi32(_mm_loadl_epi64(places.as_ptr().cast()));
            let places = _mm256_add_epi32(places, _mm256_set1_epi32(x as i32));
            _mm256_storeu_si256(to.as_mut_ptr().cast(), places);
        }
        count + bits.count_ones() as usize
    }
    #[inline(always)]
    fn borders(a: (&[u32], &[u32]), b: (&[u32], &[u32])) -> u32 {
        let (ids, colours) = (load_words(a.0), load_words(a.1));
        let (other_ids, others) = (load_words(b.0), load_words(b.1));
        // SAFETY: see the impl.
        unsafe {
            let gaps = _mm256_or_si256(_mm256_subs_epu8(colours, others), _mm256_subs_epu8(others, colours));
            let pairs = _mm256_maddubs_epi16(gaps, _mm256_set1_epi8(1));
            let sums = _mm256_madd_epi16(pairs, _mm256_set1_epi16(1));
            let seen = _mm256_cmpgt_epi32(sums, _mm256_set1_epi32(20));
            let border = _mm256_andnot_si256(_mm256_cmpeq_epi32(ids, other_ids), seen);
            _mm256_movemask_ps(_mm256_castsi256_ps(border)) as u32
        }
    }
    #[inline(always)]
    fn random(x: Self, y: Self, seed: u32) -> Self {
        let magic = Self::splat(12_582_912.0);
        // SAFETY: see the impl.
        unsafe {
            let x = _mm256_slli_epi32::<8>(_mm256_castps_si256((x + magic).0));
            let y = _mm256_slli_epi32::<20>(_mm256_castps_si256((y + magic).0));
            let mixed = hash(_mm256_xor_si256(_mm256_xor_si256(x, y), _mm256_set1_epi32(seed as i32)));
            let number = Self(_mm256_cvtepi32_ps(_mm256_srli_epi32::<8>(mixed)));
            number * Self::splat(1.0 / 16_777_216.0)
        }
    }
}
