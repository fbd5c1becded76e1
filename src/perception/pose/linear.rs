//! The direct linear transformation (10.10), (10.13), for planes (D = 3) and for space (D = 4).
//!
//! The rows of S(s~) P r~ = 0 give, with r~ the homogeneous object point, u and v its image and p1, p2, p3 the
//! rows of P, the quadratic form
//! `sum (p1.r - u p3.r)^2 + (p2.r - v p3.r)^2`. For a given p3 the best p1 and p2 solve D x D systems; what
//! remains is the smallest eigenvector of a D x D matrix instead of a 3D x 3D one.

#![allow(clippy::needless_range_loop)] // matrix indices read better

use super::PoseError;
use crate::linalg::Ldlt;

/// Second-smallest pivot, relative to the mean eigenvalue, below which p3 is not unique. Chosen by hand. Pivots are squares: points 1e-5 from a
/// degenerate set, three orders above the shift by which the factors are kept from zero.
const UNIQUE: f64 = 1e-10;

/// A scale and a shift that make coordinates have zero mean and unit spread.
#[derive(Debug, Clone, Copy)]
pub(super) struct Whitening<const N: usize> {
    pub(super) mean: [f64; N],
    pub(super) scale: f64,
}

impl<const N: usize> Whitening<N> {
    /// From `count` points; `None` when they all coincide.
    #[inline(always)]
    pub(super) fn new(count: usize, point: impl Fn(usize) -> [f64; N]) -> Option<Self> {
        let mut mean = [0.0; N];
        for i in 0..count {
            let x = point(i);
            for k in 0..N {
                mean[k] += x[k];
            }
        }
        let inverse = 1.0 / count as f64;
        mean = mean.map(|x| x * inverse);
        let mut spread = 0.0;
        for i in 0..count {
            let x = point(i);
            for k in 0..N {
                spread += (x[k] - mean[k]) * (x[k] - mean[k]);
            }
        }
        let scale = (N as f64 / (spread * inverse)).sqrt();
        scale.is_finite().then_some(Self { mean, scale })
    }

    /// The point in whitened coordinates.
    #[inline(always)]
    pub(super) fn apply(&self, x: [f64; N]) -> [f64; N] {
        std::array::from_fn(|k| (x[k] - self.mean[k]) * self.scale)
    }
}

/// The 3 x D matrix P, rows p1, p2, p3, for whitened homogeneous object points `[f64; D]` and their images.
#[inline(always)]
pub(super) fn direct_linear<const D: usize>(
    count: usize,
    point: impl Fn(usize) -> ([f64; D], [f64; 2]),
) -> Result<[[f64; D]; 3], PoseError> {
    let zero = [[0.0; D]; D];
    let (mut m0, mut mu, mut mv, mut mw) = (zero, zero, zero, zero);
    for i in 0..count {
        let (r, [u, v]) = point(i);
        let w = u * u + v * v;
        for a in 0..D {
            for b in 0..=a {
                let rr = r[a] * r[b];
                m0[a][b] += rr;
                mu[a][b] += u * rr;
                mv[a][b] += v * rr;
                mw[a][b] += w * rr;
            }
        }
    }
    mirror(&mut mu);
    mirror(&mut mv);
    // Singular when the object points do not span their space (all on one line, or on one plane).
    let factors = Ldlt::new(&m0, &[0.0; D]).ok_or(PoseError::Degenerate)?;
    // Columns of G = M0^-1 Mu and M0^-1 Mv: p1 = Gu p3, p2 = Gv p3.
    let gu: [[f64; D]; D] = std::array::from_fn(|j| factors.solve(&mu[j]));
    let gv: [[f64; D]; D] = std::array::from_fn(|j| factors.solve(&mv[j]));
    let mut trace = 0.0;
    for a in 0..D {
        trace += mw[a][a];
        for b in 0..=a {
            for k in 0..D {
                mw[a][b] -= mu[a][k] * gu[b][k] + mv[a][k] * gv[b][k];
            }
        }
    }
    let p3 = smallest_eigenvector(&mw, trace / D as f64).ok_or(PoseError::Degenerate)?;
    let product = |g: &[[f64; D]; D]| {
        let mut p = [0.0; D];
        for j in 0..D {
            for (out, x) in p.iter_mut().zip(g[j]) {
                *out += x * p3[j];
            }
        }
        p
    };
    Ok([product(&gu), product(&gv), p3])
}

#[inline(always)]
fn mirror<const D: usize>(a: &mut [[f64; D]; D]) {
    for i in 0..D {
        for j in 0..i {
            a[j][i] = a[i][j];
        }
    }
}

/// Inverse iteration on a positive semi-definite matrix (lower triangle) whose rounding level is `size` * eps.
///
/// `None` when two or more eigenvalues vanish.
#[inline(always)]
fn smallest_eigenvector<const D: usize>(s: &[[f64; D]; D], size: f64) -> Option<[f64; D]> {
    // A matrix of rank r has exactly D - r vanishing pivots, in whatever order it is factored.
    // Sums of squares of `size` round to about 1e-15 of it, so that a hundred times as much keeps every pivot of a true eigenvalue.
    let shift = 1e-13 * size;
    let mut lower = [[0.0; D]; D];
    let mut pivots = [0.0; D];
    let mut vanishing = 0;
    for j in 0..D {
        let mut pivot = s[j][j] + shift;
        for k in 0..j {
            pivot -= lower[j][k] * lower[j][k] * pivots[k];
        }
        // Rounding may carry the last pivot below zero: it then counts as the shift.
        pivot = pivot.max(0.1 * shift);
        vanishing += usize::from(pivot < UNIQUE * size);
        pivots[j] = pivot;
        for i in j + 1..D {
            let mut x = s[i][j];
            for k in 0..j {
                x -= lower[i][k] * lower[j][k] * pivots[k];
            }
            lower[i][j] = x / pivot;
        }
    }
    if vanishing > 1 || !(size > 0.0 && size < f64::INFINITY) {
        return None;
    }
    let mut v = [1.0; D];
    for _ in 0..40 {
        let mut x = v;
        for i in 0..D {
            for k in 0..i {
                x[i] -= lower[i][k] * x[k];
            }
        }
        for i in 0..D {
            x[i] /= pivots[i];
        }
        for i in (0..D).rev() {
            for k in i + 1..D {
                x[i] -= lower[k][i] * x[k];
            }
        }
        let norm = x.iter().map(|c| c * c).sum::<f64>().sqrt();
        if !(norm > 0.0 && norm < f64::INFINITY) {
            return None;
        }
        let inverse = 1.0 / norm;
        let change: f64 = x.iter().zip(v).map(|(a, b)| (a * inverse - b) * (a * inverse - b)).sum();
        v = x.map(|c| c * inverse);
        // The square of 1e-14: what is left is rounding of unit vectors.
        if change < 1e-28 {
            break;
        }
    }
    Some(v)
}
