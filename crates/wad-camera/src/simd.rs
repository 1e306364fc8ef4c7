//! Arithmetic that vectorises, and the choice of the instruction set at run time.
//!
//! The compiler fuses no multiply and add by itself; where the lanes do so, single numbers do too, so
//! that every instruction set gives the same bits.

use std::sync::atomic::{AtomicU8, Ordering};

/// Defines a function whose body is compiled for AVX-512 (on vectors of 256 bits: its masks and its many
/// registers are what helps), for AVX2 with FMA and for any machine, and picked at run time.
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
                #[target_feature(enable = "avx512f,avx512vl,avx512bw,avx512dq,avx2,fma,bmi1,bmi2")]
                #[allow(clippy::too_many_arguments)]
                fn fastest($($arg: $ty),*) $(-> $ret)? {
                    body($($arg),*)
                }
                #[target_feature(enable = "avx2,fma,bmi1,bmi2")]
                #[allow(clippy::too_many_arguments)]
                fn fast($($arg: $ty),*) $(-> $ret)? {
                    body($($arg),*)
                }
                match $crate::simd::instructions() {
                    // SAFETY: the processor has what the function was compiled for.
                    $crate::simd::Instructions::Avx512 => return unsafe { fastest($($arg),*) },
                    // SAFETY: as above.
                    $crate::simd::Instructions::Avx2 => return unsafe { fast($($arg),*) },
                    $crate::simd::Instructions::Plain => {}
                }
            }
            body($($arg),*)
        }
    };
}
pub(super) use multiversion;

/// The instruction sets that functions are compiled for, each with all before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Instructions {
    /// What every processor has.
    Plain,
    /// AVX2, FMA, F16C, BMI1, BMI2.
    Avx2,
    /// AVX2's, and AVX-512 F, VL, BW, DQ.
    Avx512,
}

impl Instructions {
    /// The environment variable that limits them, to measure and to test what other processors do: a name.
    pub const VARIABLE: &str = "WAD_COSIM_CPU";

    /// All, the plainest first.
    pub const ALL: [Self; 3] = [Self::Plain, Self::Avx2, Self::Avx512];

    /// `plain`, `avx2` or `avx512`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Plain => "plain",
            Self::Avx2 => "avx2",
            Self::Avx512 => "avx512",
        }
    }

    /// The best that the processor has.
    pub fn of_processor() -> Self {
        #[cfg(target_arch = "x86_64")]
        {
            use std::is_x86_feature_detected as has;
            let avx2 = has!("avx2") && has!("fma") && has!("f16c") && has!("bmi1") && has!("bmi2");
            let avx512 = has!("avx512f") && has!("avx512vl") && has!("avx512bw") && has!("avx512dq");
            match (avx2, avx512) {
                (false, _) => Self::Plain,
                (true, false) => Self::Avx2,
                (true, true) => Self::Avx512,
            }
        }
        #[cfg(not(target_arch = "x86_64"))]
        Self::Plain
    }

    /// By its name.
    ///
    /// # Errors
    /// There is none of this name.
    pub fn named(name: &str) -> Result<Self, String> {
        Self::ALL.into_iter().find(|set| name == set.name()).ok_or_else(|| {
            format!("expected one of {}, found `{name}`", Self::ALL.map(Self::name).join(", "))
        })
    }

    /// The most that the environment allows.
    ///
    /// # Errors
    /// The variable has another value than a name.
    pub fn allowed() -> Result<Self, String> {
        let Some(name) = std::env::var_os(Self::VARIABLE) else { return Ok(Self::Avx512) };
        Self::named(&name.to_string_lossy()).map_err(|wrong| format!("{}: {wrong}", Self::VARIABLE))
    }
}

/// The best that the processor has and [`Instructions::VARIABLE`] allows, where it has a valid value.
#[inline]
pub fn instructions() -> Instructions {
    static BEST: AtomicU8 = AtomicU8::new(0);
    match BEST.load(Ordering::Relaxed) {
        0 => choose(&BEST),
        1 => Instructions::Plain,
        2 => Instructions::Avx2,
        _ => Instructions::Avx512,
    }
}

#[cold]
fn choose(best: &AtomicU8) -> Instructions {
    let allowed = Instructions::allowed().unwrap_or(Instructions::Avx512);
    let found = Instructions::of_processor().min(allowed);
    best.store(1 + found as u8, Ordering::Relaxed);
    found
}

/// Added to a float below 2^22, it leaves the nearest integer in the low bits.
pub const MAGIC: f32 = 12_582_912.0;

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
