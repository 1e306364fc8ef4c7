//! Several pixels at once: the shading is written once over [`Lane`], and runs on 8 lanes of AVX2 where
//! the processor has them and on single numbers elsewhere, with the same bits.

mod lane;

pub use lane::Lane;

#[cfg(target_arch = "x86_64")]
pub use avx::Eight;

#[cfg(target_arch = "x86_64")]
mod avx;

/// Defines a function over [`Lane`]s that picks the lanes at run time.
macro_rules! lanes {
    ($(#[$meta:meta])* $vis:vis fn $name:ident<$lane:ident>($($arg:ident: $ty:ty),* $(,)?) $body:block) => {
        $(#[$meta])*
        $vis fn $name($($arg: $ty),*) {
            #[inline(always)]
            fn body<$lane: $crate::lanes::Lane>($($arg: $ty),*) $body
            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx512f,avx512vl,avx512bw,avx512dq,avx2,fma,bmi1,bmi2")]
                fn fastest($($arg: $ty),*) {
                    body::<$crate::lanes::Eight>($($arg),*)
                }
                #[target_feature(enable = "avx2,fma,bmi1,bmi2")]
                fn fast($($arg: $ty),*) {
                    body::<$crate::lanes::Eight>($($arg),*)
                }
                match $crate::simd::instructions() {
                    // SAFETY: the processor has what the function was compiled for.
                    $crate::simd::Instructions::Avx512 => return unsafe { fastest($($arg),*) },
                    // SAFETY: as above.
                    $crate::simd::Instructions::Avx2 => return unsafe { fast($($arg),*) },
                    $crate::simd::Instructions::Plain => {}
                }
            }
            body::<f32>($($arg),*)
        }
    };
}
pub(super) use lanes;

#[cfg(all(test, target_arch = "x86_64"))]
mod tests;
