//! Real roots of a polynomial of any degree, isolated by the signs of its Bernstein coefficients.
//!
//! A polynomial has at most as many roots in an interval as its Bernstein coefficients there change sign, and an even number
//! less. Intervals are halved until there is one change or none; then Newton's method, kept inside, finds the root. Roots
//! beyond -1..1 are those of the polynomial with its coefficients reversed. No function of a library, the same bits everywhere.

#![allow(clippy::needless_range_loop)] // matrix indices read better

/// Halvings of -1..1 before an interval counts as one (multiple) root.
const MAX_HALVINGS: u32 = 30;

/// Calls `found` with every real root of `a[0] + a[1] t + ... + a[N - 1] t^(N - 1)`; N at most 16.
pub(super) fn real_roots<const N: usize>(a: &[f64; N], mut found: impl FnMut(f64)) {
    let size = a.iter().fold(0.0_f64, |most, x| most.max(x.abs()));
    if !(size > 0.0 && size.is_finite()) {
        return;
    }
    let a = a.map(|x| x / size);
    let mut reversed = a;
    reversed.reverse();
    inside(&a, &mut found);
    inside(&reversed, |t: f64| {
        // The ends belong to the first half.
        if t.abs() < 1.0 && t != 0.0 {
            found(1.0 / t);
        }
    });
}

/// Roots in -1..1.
fn inside<const N: usize>(a: &[f64; N], mut found: impl FnMut(f64)) {
    // Intervals that wait: at each halving one waits, so that no more than the halvings do.
    let mut waiting: [([f64; N], f64, f64, u32); MAX_HALVINGS as usize + 2] =
        [([0.0; N], 0.0, 0.0, 0); MAX_HALVINGS as usize + 2];
    let mut len = 1;
    waiting[0] = (bernstein(a), -1.0, 1.0, 0);
    while len > 0 {
        len -= 1;
        let (b, low, high, halvings) = waiting[len];
        let changes = sign_changes(&b);
        if changes == 0 {
            continue;
        }
        let middle = 0.5 * (low + high);
        if changes == 1 {
            found(polished(a, low, high, b[0] < 0.0));
        } else if halvings >= MAX_HALVINGS {
            found(middle);
        } else {
            // De Casteljau: the left half's coefficients come first in each round, the right half's stay.
            let (mut left, mut right) = (b, b);
            for i in 1..N {
                for j in 0..N - i {
                    right[j] = 0.5 * (right[j] + right[j + 1]);
                }
                left[i] = right[0];
            }
            if right[0] == 0.0 {
                found(middle); // no sign changes there, on neither side
            }
            waiting[len] = (right, middle, high, halvings + 1);
            waiting[len + 1] = (left, low, middle, halvings + 1);
            len += 2;
        }
    }
}

/// Bernstein coefficients on -1..1.
fn bernstein<const N: usize>(a: &[f64; N]) -> [f64; N] {
    // t = 2 u - 1: shift by -1, then stretch by 2.
    let mut c = *a;
    for i in 0..N {
        for j in (i..N - 1).rev() {
            c[j] -= c[j + 1];
        }
    }
    let (mut scale, mut choose) = (1.0, 1.0);
    let degree = (N - 1) as f64;
    for (k, c) in c.iter_mut().enumerate() {
        *c *= scale / choose;
        scale *= 2.0;
        choose *= (degree - k as f64) / (k as f64 + 1.0);
    }
    // b_i is the sum over j of choose(i, j) c_j / choose(n, j): repeated sums of neighbours.
    for i in 1..N {
        for j in (i..N).rev() {
            c[j] += c[j - 1];
        }
    }
    c
}

fn sign_changes<const N: usize>(b: &[f64; N]) -> u32 {
    let (mut changes, mut last) = (0, 0.0);
    for &x in b {
        if x != 0.0 {
            changes += u32::from(x * last < 0.0);
            last = x.signum();
        }
    }
    changes
}

/// The one root between `low` and `high`.
fn polished<const N: usize>(a: &[f64; N], mut low: f64, mut high: f64, rises: bool) -> f64 {
    let mut t = 0.5 * (low + high);
    for _ in 0..60 {
        let (mut value, mut slope) = (0.0, 0.0);
        for &c in a.iter().rev() {
            slope = slope * t + value;
            value = value * t + c;
        }
        if value == 0.0 {
            return t;
        }
        if (value < 0.0) == rises {
            low = t;
        } else {
            high = t;
        }
        let next = t - value / slope;
        let next = if next > low && next < high { next } else { 0.5 * (low + high) };
        let step = (next - t).abs();
        t = next;
        // a few units of rounding; at a root of 0 there is no relative one
        if step <= 1e-15 * t.abs() || step < 1e-300 {
            return t;
        }
    }
    t
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Coefficients of the product of (t - r) and of (t^2 - 2 a t + a^2 + b^2).
    fn polynomial<const N: usize>(roots: &[f64], pairs: &[[f64; 2]]) -> [f64; N] {
        let mut c = [0.0; N];
        c[0] = 1.0;
        let mut times = |factor: &[f64]| {
            let mut product = [0.0; N];
            for i in 0..N {
                for (k, f) in factor.iter().enumerate() {
                    if i + k < N {
                        product[i + k] += c[i] * f;
                    }
                }
            }
            c = product;
        };
        for r in roots {
            times(&[-r, 1.0]);
        }
        for [a, b] in pairs {
            times(&[a * a + b * b, -2.0 * a, 1.0]);
        }
        c
    }

    fn all<const N: usize>(c: &[f64; N]) -> Vec<f64> {
        let mut found = Vec::new();
        real_roots(c, |t| found.push(t));
        found.sort_by(f64::total_cmp);
        found
    }

    proptest! {
        #[test]
        fn separate_roots_come_back(
            mut roots in prop::array::uniform4(-5.0..5.0f64), pairs in prop::array::uniform3(prop::array::uniform2(0.3..2.0f64))
        ) {
            roots.sort_by(f64::total_cmp);
            prop_assume!(roots.windows(2).all(|w| w[1] - w[0] > 0.05));
            let found = all(&polynomial::<11>(&roots, &pairs));
            prop_assert_eq!(found.len(), 4, "{:?} for {:?}", found, roots);
            for (a, b) in found.iter().zip(roots) {
                prop_assert!((a - b).abs() < 1e-5, "{a} {b}");
            }
        }
    }

    #[test]
    fn special_polynomials() {
        assert_eq!(all(&[0.0; 11]), [] as [f64; 0]);
        assert_eq!(all(&[f64::NAN, 1.0]), [] as [f64; 0]);
        assert_eq!(all(&[1.0, 0.0, 1.0]), [] as [f64; 0]);
        assert_eq!(all(&[-6.0, 2.0]), [3.0]);
        // A double root counts once or twice.
        let double = all(&[1.0, -2.0, 1.0]);
        assert!(double.iter().all(|t| (t - 1.0).abs() < 1e-6));
        // A degree that is lower than its place says.
        let low = all(&[-0.25, 0.0, 1.0, 0.0, 0.0]);
        assert!(low.len() == 2 && (low[1] - 0.5).abs() < 1e-14, "{low:?}");
    }
}
