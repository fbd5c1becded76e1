//! Sums of powers of consecutive integers.

/// Sums of `1`, `x`, `x^2` and `x^3` for `x` in `x0..x1`, `x0 <= x1`. Right up to 2^20; wrong, without a panic, far beyond.
#[inline(always)]
pub(in crate::imaging) fn power_sums(x0: u32, x1: u32) -> (u64, u64, u64, u128) {
    let (a, b) = (u64::from(x0), u64::from(x1));
    // below k: k (k - 1) / 2, k (k - 1) (2 k - 1) / 6, and the first one squared
    let triangle = |k: u64| k.wrapping_mul(k.wrapping_sub(1)) / 2;
    let squares = |k: u64| k.wrapping_mul(k.wrapping_sub(1)).wrapping_mul((2 * k).wrapping_sub(1)) / 6;
    let (ta, tb) = (triangle(a), triangle(b));
    let sum = tb.wrapping_sub(ta);
    let cubes = u128::from(sum) * u128::from(tb.wrapping_add(ta));
    (b.wrapping_sub(a), sum, squares(b).wrapping_sub(squares(a)), cubes)
}
