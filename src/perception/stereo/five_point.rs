//! Essential matrices of five conjugate points: Nister's solver (PAMI 2004).
//!
//! Five equations (10.46) leave `E = x E_0 + y E_1 + z E_2 + E_3`. `det E = 0` and `2 E E^T E = tr(E E^T) E` are ten cubics in x,
//! y, z; elimination leaves three equations linear in (x, y, 1) whose coefficients are polynomials in z. Their determinant, of
//! degree ten, is zero at the solutions.

#![allow(clippy::needless_range_loop)] // matrix indices read better

use super::StereoError;
use super::epipolar::{Conjugates, check};
use super::root_finding::real_roots;
use nalgebra::Matrix3;

/// Up to ten essential matrices; their order and signs have no meaning.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EssentialMatrices {
    matrices: [Matrix3<f64>; 10],
    len: usize,
}

impl EssentialMatrices {
    /// The matrices, of unit Frobenius norm; none where no real solution exists.
    #[must_use]
    pub fn as_slice(&self) -> &[Matrix3<f64>] {
        self.matrices.get(..self.len).unwrap_or(&[])
    }
}

/// Linear in x, y, z, 1.
type Linear = [f64; 4];
/// Coefficients of xx, xy, xz, x, yy, yz, y, zz, z, 1.
type Quadratic = [f64; 10];
/// Monomials in the order of the elimination: xxx, yyy, xxy, xyy, xxz, xx, yyz, yy, xyz, xy, then xzz, xz, x, yzz, yz, y,
/// zzz, zz, z, 1.
type Cubic = [f64; 20];

/// All essential matrices that five pairs are conjugate under, (10.46).
///
/// # Errors
/// [`StereoError::NotFinite`], [`StereoError::Degenerate`] for points that repeat or otherwise give dependent equations.
pub fn essential_5_point(pairs: &[Conjugates; 5]) -> Result<EssentialMatrices, StereoError> {
    check(pairs, 5)?;
    let basis = null_space(pairs).ok_or(StereoError::Degenerate)?;
    let mut rows = constraints(&basis);
    if !eliminate(&mut rows) {
        return Err(StereoError::Degenerate);
    }
    let hidden = [hide(&rows[4], &rows[5]), hide(&rows[6], &rows[7]), hide(&rows[8], &rows[9])];
    let mut all = EssentialMatrices { matrices: [Matrix3::zeros(); 10], len: 0 };
    real_roots(&determinant(&hidden), |z| {
        let Some(place) = all.matrices.get_mut(all.len) else { return };
        let Some((x, y)) = solve(&hidden, z) else { return };
        let E = Matrix3::from_fn(|i, j| {
            let k = 3 * i + j;
            basis[0][k] * x + basis[1][k] * y + basis[2][k] * z + basis[3][k]
        });
        let size = E.norm();
        if size > 0.0 && size.is_finite() {
            *place = E / size;
            all.len += 1;
        }
    });
    Ok(all)
}

/// Four orthonormal vectors that the five equations leave free, by Householder's reflections.
#[inline]
fn null_space(pairs: &[Conjugates; 5]) -> Option<[[f64; 9]; 4]> {
    let mut a = pairs.map(|p| {
        let ([x, y], [u, v]): ([f64; 2], [f64; 2]) = (p.s_1.into(), p.s_2.into());
        [x * u, x * v, x, y * u, y * v, y, u, v, 1.0]
    });
    let mut basis = [[0.0; 9]; 4];
    for (k, vector) in basis.iter_mut().enumerate() {
        vector[5 + k] = 1.0;
    }
    let mut mirrors = [[0.0; 9]; 5];
    for i in 0..5 {
        let mut w = a[i];
        w[..i].fill(0.0);
        let whole: f64 = a[i].iter().map(|x| x * x).sum();
        let size2: f64 = w.iter().map(|x| x * x).sum();
        // Of what was there 1e-10 is left: six digits more and the row would be rounding of those before.
        if !(size2 > 1e-20 * whole) {
            return None;
        }
        let size = size2.sqrt();
        let length2 = 2.0 * (size2 + size * w[i].abs());
        w[i] += size.copysign(w[i]);
        let scale = (2.0 / length2).sqrt();
        w = w.map(|x| x * scale);
        for row in &mut a[i + 1..] {
            mirror(row, &w, i);
        }
        mirrors[i] = w;
    }
    for vector in &mut basis {
        for i in (0..5).rev() {
            mirror(vector, &mirrors[i], i);
        }
    }
    Some(basis)
}

#[inline(always)]
fn mirror(x: &mut [f64; 9], w: &[f64; 9], from: usize) {
    let mut dot = 0.0;
    for k in from..9 {
        dot += x[k] * w[k];
    }
    for k in from..9 {
        x[k] -= dot * w[k];
    }
}

#[inline(always)]
fn add_product(q: &mut Quadratic, a: &Linear, b: &Linear, factor: f64) {
    let [ax, ay, az, aw] = a.map(|a| factor * a);
    let [bx, by, bz, bw] = *b;
    q[0] += ax * bx;
    q[1] += ax * by + ay * bx;
    q[2] += ax * bz + az * bx;
    q[3] += ax * bw + aw * bx;
    q[4] += ay * by;
    q[5] += ay * bz + az * by;
    q[6] += ay * bw + aw * by;
    q[7] += az * bz;
    q[8] += az * bw + aw * bz;
    q[9] += aw * bw;
}

#[inline(always)]
fn add_cubic(c: &mut Cubic, q: &Quadratic, l: &Linear) {
    let [xx, xy, xz, x, yy, yz, y, zz, z, w] = *q;
    let [a, b, g, d] = *l;
    c[0] += xx * a;
    c[1] += yy * b;
    c[2] += xx * b + xy * a;
    c[3] += xy * b + yy * a;
    c[4] += xx * g + xz * a;
    c[5] += xx * d + x * a;
    c[6] += yy * g + yz * b;
    c[7] += yy * d + y * b;
    c[8] += xy * g + xz * b + yz * a;
    c[9] += xy * d + x * b + y * a;
    c[10] += xz * g + zz * a;
    c[11] += xz * d + x * g + z * a;
    c[12] += x * d + w * a;
    c[13] += yz * g + zz * b;
    c[14] += yz * d + y * g + z * b;
    c[15] += y * d + w * b;
    c[16] += zz * g;
    c[17] += zz * d + z * g;
    c[18] += z * d + w * g;
    c[19] += w * d;
}

/// The ten cubics.
#[inline]
fn constraints(basis: &[[f64; 9]; 4]) -> [Cubic; 10] {
    let e: [[Linear; 3]; 3] =
        std::array::from_fn(|i| std::array::from_fn(|j| std::array::from_fn(|k| basis[k][3 * i + j])));
    // E E^T - tr(E E^T) / 2.
    let mut square = [[[0.0; 10]; 3]; 3];
    for i in 0..3 {
        for j in 0..=i {
            for k in 0..3 {
                add_product(&mut square[i][j], &e[i][k], &e[j][k], 1.0);
            }
        }
    }
    let half: Quadratic =
        std::array::from_fn(|k| 0.5 * (square[0][0][k] + square[1][1][k] + square[2][2][k]));
    for i in 0..3 {
        for k in 0..10 {
            square[i][i][k] -= half[k];
        }
        for j in i + 1..3 {
            square[i][j] = square[j][i];
        }
    }
    let mut rows = [[0.0; 20]; 10];
    for i in 0..3 {
        for j in 0..3 {
            for k in 0..3 {
                add_cubic(&mut rows[3 * i + j], &square[i][k], &e[k][j]);
            }
        }
    }
    for k in 0..3 {
        let (a, b) = ((k + 1) % 3, (k + 2) % 3);
        let mut minor = [0.0; 10];
        add_product(&mut minor, &e[1][a], &e[2][b], 1.0);
        add_product(&mut minor, &e[1][b], &e[2][a], -1.0);
        add_cubic(&mut rows[9], &minor, &e[0][k]);
    }
    rows
}

/// Gauss and Jordan on the first ten columns, for the rows 4..10; false when they are dependent.
#[inline]
fn eliminate(rows: &mut [Cubic; 10]) -> bool {
    for i in 0..10 {
        let mut pivot = i;
        for r in i + 1..10 {
            if rows[r][i].abs() > rows[pivot][i].abs() {
                pivot = r;
            }
        }
        rows.swap(i, pivot);
        let over = 1.0 / rows[i][i];
        if !over.is_finite() {
            return false;
        }
        let row = rows[i].map(|x| x * over);
        rows[i] = row;
        // The first four rows are not looked at again: upwards the others alone are cleared.
        for r in 4.max(i + 1).min(10)..10 {
            subtract(&mut rows[r], &row, i);
        }
        for r in i + 1..4 {
            subtract(&mut rows[r], &row, i);
        }
        for r in 4..i {
            subtract(&mut rows[r], &row, i);
        }
    }
    true
}

#[inline(always)]
fn subtract(row: &mut Cubic, pivot: &Cubic, column: usize) {
    let factor = row[column];
    for k in 0..20 {
        row[k] -= factor * pivot[k];
    }
}

/// Polynomials in z that multiply x, y and 1: of degree 3, 3, 4.
type Hidden = [[f64; 5]; 3];

/// The row of xxz less z times that of xx, and its like: the cubic monomials cancel.
#[inline]
fn hide(a: &Cubic, b: &Cubic) -> Hidden {
    [
        [a[12], a[11] - b[12], a[10] - b[11], -b[10], 0.0],
        [a[15], a[14] - b[15], a[13] - b[14], -b[13], 0.0],
        [a[19], a[18] - b[19], a[17] - b[18], a[16] - b[17], -b[16]],
    ]
}

/// Determinant of the three rows, lowest power first.
#[inline]
fn determinant(h: &[Hidden; 3]) -> [f64; 11] {
    let mut det = [0.0; 11];
    for (i, j, k) in [(0, 1, 2), (1, 2, 0), (2, 0, 1)] {
        // Minor of the columns x and y in the rows j, k.
        let mut minor = [0.0; 7];
        for a in 0..4 {
            for b in 0..4 {
                minor[a + b] += h[j][0][a] * h[k][1][b] - h[j][1][a] * h[k][0][b];
            }
        }
        for a in 0..7 {
            for b in 0..5 {
                det[a + b] += minor[a] * h[i][2][b];
            }
        }
    }
    det
}

/// x and y at a root z: the rows leave one direction (x, y, 1), taken from the two that differ most.
#[inline]
fn solve(h: &[Hidden; 3], z: f64) -> Option<(f64, f64)> {
    let rows = h.map(|row| row.map(|p| (((p[4] * z + p[3]) * z + p[2]) * z + p[1]) * z + p[0]));
    let mut best = [0.0_f64; 3];
    for (a, b) in [(0, 1), (0, 2), (1, 2)] {
        let ([ax, ay, aw], [bx, by, bw]) = (rows[a], rows[b]);
        let cross = [ay * bw - aw * by, aw * bx - ax * bw, ax * by - ay * bx];
        if cross[2].abs() > best[2].abs() {
            best = cross;
        }
    }
    let (x, y) = (best[0] / best[2], best[1] / best[2]);
    (x.is_finite() && y.is_finite()).then_some((x, y))
}

#[cfg(test)]
mod tests {
    use super::super::essential_matrix;
    use super::super::testing::scene;
    use super::*;
    use crate::geometry::Pose;
    use crate::linalg::Random;
    use nalgebra::Vector2;

    fn five(X: &Pose, seed: u64) -> [Conjugates; 5] {
        std::array::from_fn(|i| scene(X, 5, seed)[i].0)
    }

    #[test]
    fn the_truth_is_among_them_and_all_are_essential() {
        let mut random = Random::new(2);
        let (mut bad, mut count, count_trials) = (0, 0, 2000);
        for seed in 0..count_trials {
            let mut vector =
                |size: f64| nalgebra::Vector3::from([(); 3].map(|()| random.between(-size, size)));
            let X = Pose::new(vector(0.5), vector(0.5));
            let pairs = five(&X, seed);
            let E = essential_matrix(&X).normalize();
            let found = essential_5_point(&pairs).unwrap();
            let off = |F: &Matrix3<f64>| (F - E).norm().min((F + E).norm());
            let best = found.as_slice().iter().map(off).fold(f64::INFINITY, f64::min);
            bad += i32::from(best > 1e-5);
            count += found.as_slice().len();
            for F in found.as_slice() {
                let worst = pairs.iter().map(|p| {
                    let (s1, s2) = p.homogeneous();
                    s1.dot(&(F * s2)).abs()
                });
                assert!(worst.fold(0.0, f64::max) < 1e-12);
            }
        }
        // Near a double root, or with a base line of nothing.
        assert!(bad <= 4, "{bad} of {count_trials} worse than 1e-5");
        let mean = count as f64 / count_trials as f64;
        assert!((3.0..6.0).contains(&mean), "{mean}");
    }

    #[test]
    fn a_plane_will_do() {
        let X = Pose::new([0.3, 0.1, -0.1].into(), [0.1, -0.2, 0.3].into());
        let mut random = Random::new(4);
        let pairs = std::array::from_fn(|_| {
            let p = nalgebra::Point3::new(random.between(-0.5, 0.5), random.between(-0.5, 0.5), 2.0);
            let q = X.inverse() * p;
            Conjugates { s_1: p.xy().coords / p.z, s_2: q.xy().coords / q.z }
        });
        let E = essential_matrix(&X).normalize();
        let found = essential_5_point(&pairs).unwrap();
        assert!(found.as_slice().iter().any(|F| (F - E).norm().min((F + E).norm()) < 1e-6));
    }

    #[test]
    fn bad_input_is_refused() {
        let X = Pose::new([0.3, 0.1, -0.1].into(), [0.1, -0.2, 0.3].into());
        let mut pairs = five(&X, 1);
        pairs[3] = pairs[1];
        assert_eq!(essential_5_point(&pairs).err(), Some(StereoError::Degenerate));
        pairs[2].s_1 = Vector2::new(0.0, f64::INFINITY);
        assert_eq!(essential_5_point(&pairs).err(), Some(StereoError::NotFinite { index: 2 }));
    }
}
