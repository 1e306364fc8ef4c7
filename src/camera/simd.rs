//! Arithmetic that vectorises, and the choice of the instruction set at run time.
//!
//! The compiler fuses no multiply and add by itself; where the lanes do so, single numbers do too, so
//! that every instruction set gives the same bits.

/// Defines a function whose body is compiled twice, for AVX2 with FMA and for any x86-64 (or other) machine,
/// and picked at run time.
macro_rules! multiversion {
    ($(#[$meta:meta])* $vis:vis fn $name:ident($($arg:ident: $ty:ty),* $(,)?) $(-> $ret:ty)? $body:block) => {
        $(#[$meta])*
        #[allow(clippy::too_many_arguments)]
        $vis fn $name($($arg: $ty),*) $(-> $ret)? {
            #[inline(always)]
            #[allow(clippy::too_many_arguments)]
            fn body($($arg: $ty),*) $(-> $ret)? $body
            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx2,fma,bmi1,bmi2")]
                #[allow(clippy::too_many_arguments)]
                fn fast($($arg: $ty),*) $(-> $ret)? {
                    body($($arg),*)
                }
                if $crate::camera::simd::has_avx2() {
                    // SAFETY: the processor has what `fast` was compiled for.
                    return unsafe { fast($($arg),*) };
                }
            }
            body($($arg),*)
        }
    };
}
pub(super) use multiversion;

/// Whether the processor has the faster instruction set.
#[cfg(target_arch = "x86_64")]
#[inline]
pub fn has_avx2() -> bool {
    std::is_x86_feature_detected!("avx2")
        && std::is_x86_feature_detected!("fma")
        && std::is_x86_feature_detected!("bmi1")
        && std::is_x86_feature_detected!("bmi2")
}

/// Added to a float below 2^22, it leaves the nearest integer in the low bits.
const MAGIC: f32 = 12_582_912.0;

/// The integer part of `x` for |x| < 2^22, as bits to be masked, and the fraction 0..1.
#[inline(always)]
pub fn split(x: f32) -> (u32, f32) {
    let shifted = (x - 0.5) + MAGIC;
    (shifted.to_bits(), (x - (shifted - MAGIC)).clamp(0.0, 1.0))
}

/// The smallest pixel whose centre is not before `x`, within 0..=`limit`.
#[inline(always)]
pub fn first_centre(x: f32, limit: f32) -> i32 {
    let x = x - 0.5;
    // NaN becomes 0.
    let x = if x > 0.0 { x } else { 0.0 };
    let x = if x < limit { x } else { limit };
    // SAFETY: 0 <= x <= limit, a picture's side.
    let whole = unsafe { x.to_int_unchecked::<i32>() };
    whole + i32::from((whole as f32) < x)
}

/// A byte from a value in 0..1.
#[inline(always)]
pub fn byte(x: f32) -> u32 {
    (x.clamp(0.0, 1.0) * 255.0 + MAGIC).to_bits() & 0xff
}

/// Red, green, blue bytes in one word.
#[inline(always)]
pub fn pack(r: f32, g: f32, b: f32) -> u32 {
    byte(r) | byte(g) << 8 | byte(b) << 16
}

/// The mix of two packed colours: `t` = 0 gives `a`, 256 gives `b`.
#[inline(always)]
pub fn mix_packed(a: u32, b: u32, t: u32) -> u32 {
    let s = 256 - t;
    let rb = ((a & 0xff_00ff) * s + (b & 0xff_00ff) * t) >> 8 & 0xff_00ff;
    let g = ((a & 0xff00) * s + (b & 0xff00) * t) >> 8 & 0xff00;
    rb | g
}

/// Scene light to display value 0..1: a soft shoulder, about a square root below it.
#[inline(always)]
pub fn tone(x: f32) -> f32 {
    let s = x.clamp(0.0, 1.6).sqrt();
    s * (1.15 + s * (0.0565 - 0.2693 * s))
}

/// A well-mixed hash.
#[inline(always)]
pub fn hash(mut x: u32) -> u32 {
    x ^= x >> 16;
    x = x.wrapping_mul(0x7feb_352d);
    x ^= x >> 15;
    x = x.wrapping_mul(0x846c_a68b);
    x ^ x >> 16
}

/// A hash as a number 0..1.
#[inline(always)]
pub fn unit(x: u32) -> f32 {
    (hash(x) >> 8) as f32 * (1.0 / 16_777_216.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fractions_agree_with_the_standard_library() {
        for i in -4000..4000 {
            let x = i as f32 * 0.37 + 0.01;
            // At a whole number the neighbour with the fraction 1 is as good.
            if (x - x.round()).abs() < 1e-3 {
                continue;
            }
            let (bits, fraction) = split(x);
            assert_eq!(bits & 0xff, (x.floor() as i32 & 0xff) as u32, "{x}");
            assert!((fraction - (x - x.floor())).abs() < 1e-6);
        }
    }

    #[test]
    fn tone_rises_from_black_to_white() {
        let mut last = -1.0;
        for i in 0..=160 {
            let y = tone(i as f32 * 0.01);
            assert!(y > last);
            last = y;
        }
        assert_eq!(tone(0.0), 0.0);
        assert!((last - 1.0).abs() < 0.01);
    }
}
