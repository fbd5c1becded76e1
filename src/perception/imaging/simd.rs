//! Kernels that are written once, as plain loops, and compiled for what the processor offers.
//!
//! `kernel!` turns a loop `body` (`#[inline(always)]`, safe code that the compiler vectorises) into a function that chooses at run
//! time: AVX2 where the processor has it, else what every processor of the architecture has (SSE2 on x86-64). All compute the
//! same: whole numbers, or single IEEE operations in the order in which they are written.

/// `kernel!(/// docs pub(super) fn name(a: A, ...) = body);`: see the module.
macro_rules! kernel {
    ($(#[$meta:meta])* $vis:vis fn $name:ident($($arg:ident: $type:ty),* $(,)?) $(-> $out:ty)? = $body:ident) => {
        $(#[$meta])*
        $vis fn $name($($arg: $type),*) $(-> $out)? {
            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
                fn wide($($arg: $type),*) $(-> $out)? {
                    $body($($arg),*)
                }
                if $crate::imaging::simd::has_avx2() {
                    // SAFETY: the features were just detected.
                    #[allow(unsafe_code)]
                    return unsafe { wide($($arg),*) };
                }
            }
            $body($($arg),*)
        }
    };
}
pub(crate) use kernel;

/// Whether the processor has AVX2, and what came with it.
#[inline]
pub fn has_avx2() -> bool {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::is_x86_feature_detected as has;
        // the first answer is kept by the standard library
        has!("avx2") && has!("bmi1") && has!("bmi2") && has!("lzcnt") && has!("popcnt")
    }
    #[cfg(not(target_arch = "x86_64"))]
    {
        false
    }
}
