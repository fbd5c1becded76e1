//! Real roots of a cubic by Newton's method: no trigonometric function, hence the same bits on every machine.

/// A third of the exponent's bits, with the bias put right: cube root to 6 %. `(1023 - 1023 / 3 - 0.03306235651) 2^20` in the upper half, as
/// fdlibm's `s_cbrt.c` has it, whose last term halves the largest error.
const CUBE_ROOT_BITS: u64 = 0x2A9F_7893_782D_A1CE;

/// Real roots of `t^3 + b t^2 + c t + d`, that of greatest distance from their mean first; one or three.
///
/// Where two roots meet, rounding decides whether they count. Coefficients that are not finite give no root.
pub(crate) fn cubic_roots(b: f64, c: f64, d: f64) -> ([f64; 3], usize) {
    // t = s - b / 3: s^3 + p s + q, mirrored so that q <= 0. Its one positive root has the greatest size.
    let third = b / 3.0;
    let p = c - b * third;
    let q = third * (2.0 * third * third - c) + d;
    if !(p.is_finite() && q.is_finite()) {
        return ([0.0; 3], 0);
    }
    let (mirror, q) = if q > 0.0 { (-1.0, -q) } else { (1.0, q) };
    let a2 = (-p).max(0.0);
    let mut s = 0.0;
    if q < 0.0 {
        let mut root = f64::from_bits((-q).to_bits() / 3 + CUBE_ROOT_BITS);
        root = (2.0 * root - q / (root * root)) / 3.0;
        // Convex for s > 0: from anywhere beyond the turning point Newton's steps end at the root. The first guess is
        // exact for q = 0 and for p = 0, and 7 % too far where two roots meet.
        s = if p > 0.0 { root.min(-q / p) } else { (a2 + root * root).sqrt() };
        for _ in 0..60 {
            let s2 = s * s;
            let step = ((s2 + p) * s + q) / (3.0 * s2 + p);
            s -= step;
            // quadratic: what is left is the square of it, so that it is below rounding
            if !(step.abs() > 1e-7 * s) {
                break;
            }
        }
        if !(s > 0.0) {
            return ([0.0; 3], 0);
        }
    } else if p < 0.0 {
        s = a2.sqrt();
    }
    // The others: s^2 + r s - q / r, with the product rather than p + r^2, which cancels.
    let first = mirror * s - third;
    let product = if s > 0.0 { -q / s } else { 0.0 };
    let discriminant = 0.25 * s * s - product;
    if !(discriminant >= 0.0) {
        return ([first, 0.0, 0.0], 1);
    }
    let far = -0.5 * s - discriminant.sqrt();
    let near = if far == 0.0 { 0.0 } else { product / far };
    ([first, mirror * far - third, mirror * near - third], 3)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn three_real_roots_come_back(r in prop::array::uniform3(-10.0..10.0f64)) {
            let [x, y, z] = r;
            let (mut roots, count) = cubic_roots(-(x + y + z), x * y + y * z + z * x, -x * y * z);
            prop_assert!(count == 3 || (x - y).abs().min((y - z).abs()).min((z - x).abs()) < 1e-5);
            if count == 3 {
                let mut expected = r;
                expected.sort_by(f64::total_cmp);
                roots.sort_by(f64::total_cmp);
                // A double root keeps half of the digits.
                prop_assert!(roots.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-5), "{roots:?} {expected:?}");
            }
        }

        #[test]
        fn one_real_root_comes_back(r in -10.0..10.0f64, re in -10.0..10.0f64, im in 0.01..10.0f64) {
            // (t - r)(t^2 - 2 re t + re^2 + im^2)
            let m = re * re + im * im;
            let (roots, count) = cubic_roots(-r - 2.0 * re, m + 2.0 * re * r, -r * m);
            prop_assert_eq!(count, 1);
            prop_assert!((roots[0] - r).abs() < 1e-8, "{} {r}", roots[0]);
        }
    }

    #[test]
    fn special_cubics() {
        assert_eq!(cubic_roots(0.0, 0.0, 0.0), ([0.0; 3], 3));
        let (roots, count) = cubic_roots(0.0, -4.0, 0.0);
        assert_eq!((roots[0].abs(), count), (2.0, 3));
        assert!((cubic_roots(0.0, 0.0, -27.0).0[0] - 3.0).abs() < 1e-15);
        assert!((cubic_roots(0.0, 1e12, -1.0).0[0] - 1e-12).abs() < 1e-24);
        assert_eq!(cubic_roots(f64::NAN, 0.0, 0.0).1, 0);
        assert_eq!(cubic_roots(0.0, f64::INFINITY, 0.0).1, 0);
    }
}
