//! Pose from three points, with all solutions: intersection of two conics in the space of depths.
//!
//! The depths z of the points satisfy `|z_i s~_i - z_j s~_j|^2 = |r_i - r_j|^2`, three quadratic forms. Two combinations
//! without constant part are conics D1, D2 of the projective plane of (z_1, z_2, z_3). Some `D1 + g D2` is a pair of lines,
//! g from a cubic (the way of Persson and Nordberg's Lambda twist, ECCV 2018; of the up to three pairs the one that crosses
//! at the greatest angle is taken, Ding et al., CVPR 2023). Each line meets the conics in up to two of the solutions.
//! Up to two steps of Newton's method on the depths remove what rounding has done. No norm of a ray is needed.

use super::points::check;
use super::{PointSource, PoseError};
use crate::geometry::Pose;
use crate::linalg::cubic_roots;
use nalgebra::{Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

/// Twice the area of the triangle over its longest side squared, below which its points count as collinear.
const COLLINEAR: f64 = 1e-9;
/// A discriminant of this share of its terms below zero still counts as a double solution: it is a difference of products that
/// rounding moves by 1e-16 for each of the some hundred operations before it, and polishing judges what comes of it.
const DOUBLE: f64 = 1e-12;
/// Misfit of the squared lengths, relative to the longest, that is left of a solution after polishing. Newton's method on a simple solution
/// leaves rounding, and what is left above this after two steps was no solution.
const SOLVED: f64 = 1e-7;

/// Up to four poses; their order has no meaning.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct P3pPoses {
    poses: [Pose; 4],
    len: usize,
}

impl P3pPoses {
    /// The poses, one at least.
    #[must_use]
    pub fn as_slice(&self) -> &[Pose] {
        self.poses.get(..self.len).unwrap_or(&[])
    }
}

/// All poses `X_CO` that project three points exactly to their images, in front of the camera.
///
/// Where two solutions meet (the camera on the cylinder of danger), both or one of them come back, to half of the digits.
///
/// # Errors
/// [`PoseError::NotFinite`], [`PoseError::Degenerate`] for collinear or repeated points, and [`PoseError::BehindCamera`]
/// when no real solution has the points in front of the camera.
pub fn p3p<P: PointSource>(points: &[P; 3]) -> Result<P3pPoses, PoseError> {
    check(points, 3)?;
    let r = points.map(|p| Vector3::from(p.object()));
    let s = points.map(|p| {
        let [X, Y] = p.image();
        Vector3::new(X, Y, 1.0)
    });
    let triangle = Triangle::new(&r).ok_or(PoseError::Degenerate)?;
    let forms = QuadraticForms::new(&s, &triangle);
    let mut found = P3pPoses { poses: [Pose::identity(); 4], len: 0 };
    let mut depths = [[0.0; 3]; 4];
    let Some((lines, conic)) = forms.pair_of_lines() else { return Err(PoseError::BehindCamera) };
    for line in &lines {
        let Some(directions) = intersect(line, &conic) else { continue };
        for direction in directions {
            let Some(z) = forms.scaled(direction).and_then(|z| forms.polished(z)) else { continue };
            let known = depths.get(..found.len).unwrap_or(&[]);
            // Both lines meet the conic there: polished depths of one solution differ by rounding.
            let same = |a: &[f64; 3]| (0..3).all(|i| (a[i] - z[i]).abs() < 1e-9 * z[i]);
            if known.iter().any(same) {
                continue;
            }
            if let (Some(pose), Some(depth)) = (found.poses.get_mut(found.len), depths.get_mut(found.len)) {
                *pose = triangle.pose(&z, &s);
                *depth = z;
                found.len += 1;
            }
        }
    }
    if found.len == 0 { Err(PoseError::BehindCamera) } else { Ok(found) }
}

/// The three object points: squared lengths of the sides and the frame that two sides span.
struct Triangle {
    first: Vector3<f64>,
    /// |r1 - r2|^2, |r1 - r3|^2, |r2 - r3|^2 over the longest squared.
    sides: [f64; 3],
    /// Longest side, m.
    size: f64,
    /// Inverse of `[r1 - r2, r1 - r3, their cross product]`.
    inverse: Matrix3<f64>,
}

impl Triangle {
    #[inline]
    fn new(r: &[Vector3<f64>; 3]) -> Option<Self> {
        let (a, b, c) = (r[0] - r[1], r[0] - r[2], r[1] - r[2]);
        let n = a.cross(&b);
        let (aa, bb, cc) = (a.norm_squared(), b.norm_squared(), c.norm_squared());
        let (unit, area2) = (aa.max(bb).max(cc), n.norm_squared());
        if !(area2 > COLLINEAR * COLLINEAR * unit * unit && unit < f64::INFINITY) {
            return None;
        }
        // Rows of the inverse of [a b n]: (b x n), (n x a), n, over the determinant |n|^2.
        let scale = 1.0 / area2;
        let (x, y, z) = (b.cross(&n) * scale, n.cross(&a) * scale, n * scale);
        let inverse = Matrix3::new(x.x, x.y, x.z, y.x, y.y, y.z, z.x, z.y, z.z);
        let over = 1.0 / unit;
        Some(Self { first: r[0], sides: [aa * over, bb * over, cc * over], size: unit.sqrt(), inverse })
    }

    /// The pose for the depths `z` (in units of the longest side) along `s`.
    #[inline]
    fn pose(&self, z: &[f64; 3], s: &[Vector3<f64>; 3]) -> Pose {
        let size = self.size;
        let p1 = s[0] * (z[0] * size);
        let (a, b) = (p1 - s[1] * (z[1] * size), p1 - s[2] * (z[2] * size));
        let n = a.cross(&b);
        let R = Matrix3::from_columns(&[a, b, n]) * self.inverse;
        let q = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(R));
        // R is orthonormal up to rounding, and so is q after one of Newton's steps to unit length.
        let q = q.into_inner() * (1.5 - 0.5 * q.norm_squared());
        let q = UnitQuaternion::new_unchecked(q);
        Pose::from_parts(Translation3::from(p1 - R * self.first), q)
    }
}

/// The quadratic forms `n_i z_i^2 + n_j z_j^2 - 2 c_ij z_i z_j = a_ij`.
struct QuadraticForms {
    n: [f64; 3],
    /// s~_1 . s~_2, s~_1 . s~_3, s~_2 . s~_3.
    c: [f64; 3],
    a: [f64; 3],
}

/// Symmetric: 00, 01, 02, 11, 12, 22.
type Conic = [f64; 6];

impl QuadraticForms {
    #[inline]
    fn new(s: &[Vector3<f64>; 3], triangle: &Triangle) -> Self {
        let n = [s[0].norm_squared(), s[1].norm_squared(), s[2].norm_squared()];
        Self { n, c: [s[0].dot(&s[1]), s[0].dot(&s[2]), s[1].dot(&s[2])], a: triangle.sides }
    }

    /// Two lines that hold all solutions, and a conic that holds them too.
    #[inline]
    fn pair_of_lines(&self) -> Option<([[f64; 3]; 2], Conic)> {
        let ([n1, n2, n3], [c12, c13, c23], [a12, a13, a23]) = (self.n, self.c, self.a);
        let d1: Conic = [a23 * n1, -a23 * c12, 0.0, (a23 - a12) * n2, a12 * c23, -a12 * n3];
        let d2: Conic = [a23 * n1, 0.0, -a23 * c13, -a13 * n2, a13 * c23, (a23 - a13) * n3];
        let (adj1, adj2) = (adjugate(&d1), adjugate(&d2));
        let (k0, k3) = (
            d1[0] * adj1[0] + d1[1] * adj1[1] + d1[2] * adj1[2],
            d2[0] * adj2[0] + d2[1] * adj2[1] + d2[2] * adj2[2],
        );
        let (k1, k2) = (inner(&adj1, &d2), inner(&adj2, &d1));
        // det(D1 + g D2) = k0 + k1 g + k2 g^2 + k3 g^3; or with the roles changed, so that no root is far out.
        let (mut d1, mut d2, mut k) =
            if k3.abs() >= k0.abs() { (d1, d2, [k0, k1, k2, k3]) } else { (d2, d1, [k3, k2, k1, k0]) };
        // Chosen by hand: else a root would lie 20 times as far out as the others, and cost them a digit.
        if k[3].abs() < 0.05 * k1.abs().max(k2.abs()) {
            (d1, d2, k) = turned(d1, d2, k);
        }
        let [k0, k1, k2, k3] = k;
        let over = 1.0 / k3;
        let (roots, count) = cubic_roots(k2 * over, k1 * over, k0 * over);
        let mut best = (0.0, 0.0);
        for root in roots.iter().take(count) {
            // The lines are real when the adjugate is not positive; its trace is minus a quarter of |l x m|^2.
            let pair: Conic = std::array::from_fn(|i| d1[i] + root * d2[i]);
            let size: f64 = pair.iter().map(|x| x * x).sum();
            let crossing = ((pair[1] * pair[1] - pair[0] * pair[3])
                + (pair[2] * pair[2] - pair[0] * pair[5])
                + (pair[4] * pair[4] - pair[3] * pair[5]))
                / size;
            if crossing > best.0 {
                best = (crossing, *root);
            }
        }
        let (crossing, root) = best;
        if !(crossing > 0.0) {
            return None;
        }
        // The cubic's own values decide the last digits: sums over roots of other sizes have cost some.
        let slope = (3.0 * k3 * root + 2.0 * k2) * root + k1;
        let step = (((k3 * root + k2) * root + k1) * root + k0) / slope;
        // At a double root the slope vanishes, and a longer step than rounding explains would leave it.
        let g = if step.is_finite() && step.abs() < 1e-4 * root.abs() { root - step } else { root };
        let pair: Conic = std::array::from_fn(|i| d1[i] + g * d2[i]);
        let lines = split(&pair, &adjugate(&pair))?;
        // The conic that differs more from the pair.
        let size = |d: &Conic| d.iter().map(|x| x.abs()).sum::<f64>();
        Some((lines, if g.abs() * size(&d2) > size(&d1) { d1 } else { d2 }))
    }

    /// Depths along `direction` that give the triangle its size; `None` unless all are positive.
    #[inline]
    fn scaled(&self, direction: [f64; 3]) -> Option<[f64; 3]> {
        let ([n1, n2, n3], [c12, c13, c23], [x, y, z]) = (self.n, self.c, direction);
        let value = 2.0 * (n1 * x * x + n2 * y * y + n3 * z * z - c12 * x * y - c13 * x * z - c23 * y * z);
        let size = ((self.a[0] + self.a[1] + self.a[2]) / value).sqrt();
        let size = if x + y + z < 0.0 { -size } else { size };
        let z = direction.map(|d| d * size);
        (size.is_finite() && z.iter().all(|z| *z > 0.0)).then_some(z)
    }

    /// Newton's method on the three forms; `None` when it does not settle in front of the camera.
    #[inline]
    fn polished(&self, z: [f64; 3]) -> Option<[f64; 3]> {
        let ([n1, n2, n3], [c12, c13, c23], [a12, a13, a23]) = (self.n, self.c, self.a);
        let [mut x, mut y, mut z] = z;
        for last in [false, false, true] {
            let (f12, f13, f23) = (
                n1 * x * x + n2 * y * y - 2.0 * c12 * x * y - a12,
                n1 * x * x + n3 * z * z - 2.0 * c13 * x * z - a13,
                n2 * y * y + n3 * z * z - 2.0 * c23 * y * z - a23,
            );
            let off = f12.abs() + f13.abs() + f23.abs();
            // The sums have terms far above one when the triangle is far away.
            let rounding = 1e-15 * (n1 * x * x + n2 * y * y + n3 * z * z);
            if off < rounding || last {
                // chosen by hand: each of three forms may be off by its own rounding
                let solved = off < SOLVED.max(4.0 * rounding) && x > 0.0 && y > 0.0 && z > 0.0;
                return solved.then_some([x, y, z]);
            }
            // Halves of the derivatives: rows [p q 0], [r 0 t], [0 u v].
            let (p, q) = (n1 * x - c12 * y, n2 * y - c12 * x);
            let (r, t) = (n1 * x - c13 * z, n3 * z - c13 * x);
            let (u, v) = (n2 * y - c23 * z, n3 * z - c23 * y);
            let det = -2.0 * (p * t * u + q * r * v);
            // Near a double solution the determinant is rounding, and the step is left out rather than let go.
            let over = if det.abs() > 1e-14 { 1.0 / det } else { 0.0 };
            x -= (-t * u * f12 - q * v * f13 + q * t * f23) * over;
            y -= (-r * v * f12 + p * v * f13 - p * t * f23) * over;
            z -= (r * u * f12 - p * u * f13 - q * r * f23) * over;
        }
        None
    }
}

/// The pencil with D2 + D1 or D2 - D1 for D2, for triangles with equal sides, where D1 and D2 are pairs of lines themselves.
#[cold]
fn turned(d1: Conic, d2: Conic, [k0, k1, k2, k3]: [f64; 4]) -> (Conic, Conic, [f64; 4]) {
    let (plus, minus) = (k0 + k1 + k2 + k3, k3 - k2 + k1 - k0);
    if plus.abs() > minus.abs() {
        let k = [k0, 3.0 * k0 + k1, 3.0 * k0 + 2.0 * k1 + k2, plus];
        (d1, std::array::from_fn(|i| d2[i] + d1[i]), k)
    } else {
        let k = [k0, k1 - 3.0 * k0, 3.0 * k0 - 2.0 * k1 + k2, minus];
        (d1, std::array::from_fn(|i| d2[i] - d1[i]), k)
    }
}

#[inline]
fn adjugate(d: &Conic) -> Conic {
    [
        d[3] * d[5] - d[4] * d[4],
        d[2] * d[4] - d[1] * d[5],
        d[1] * d[4] - d[2] * d[3],
        d[0] * d[5] - d[2] * d[2],
        d[1] * d[2] - d[0] * d[4],
        d[0] * d[3] - d[1] * d[1],
    ]
}

/// Trace of the product of two symmetric matrices.
#[inline]
fn inner(a: &Conic, b: &Conic) -> f64 {
    a[0] * b[0] + a[3] * b[3] + a[5] * b[5] + 2.0 * (a[1] * b[1] + a[2] * b[2] + a[4] * b[4])
}

/// The lines l, m of `C = (l m^T + m l^T) / 2`, whose adjugate is `-p p^T` with `p = l x m / 2`: `C + S(p) = m l^T`.
#[inline]
fn split(c: &Conic, adj: &Conic) -> Option<[[f64; 3]; 2]> {
    let (k, least) = if adj[0] <= adj[3] && adj[0] <= adj[5] {
        ([adj[0], adj[1], adj[2]], adj[0])
    } else if adj[3] <= adj[5] {
        ([adj[1], adj[3], adj[4]], adj[3])
    } else {
        ([adj[2], adj[4], adj[5]], adj[5])
    };
    if !(least < 0.0) {
        return None;
    }
    let over = -1.0 / (-least).sqrt();
    let [px, py, pz] = k.map(|x| x * over);
    let rows = [[c[0], c[1] - pz, c[2] + py], [c[1] + pz, c[3], c[4] - px], [c[2] - py, c[4] + px, c[5]]];
    let columns = [0, 1, 2].map(|j| [rows[0][j], rows[1][j], rows[2][j]]);
    Some([longest(&rows), longest(&columns)])
}

/// All three are multiples of one vector: the longest has it best.
#[inline(always)]
fn longest(vectors: &[[f64; 3]; 3]) -> [f64; 3] {
    let [a, b, c] = vectors;
    let length2 = |v: &[f64; 3]| v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
    let (la, lb, lc) = (length2(a), length2(b), length2(c));
    // Without branches, which would be guessed wrong half of the time.
    let (l, v) = (la.max(lb), std::array::from_fn::<f64, 3, _>(|i| if la > lb { a[i] } else { b[i] }));
    std::array::from_fn(|i| if l > lc { v[i] } else { c[i] })
}

/// The two points of a line on a conic, up to scale.
#[inline]
fn intersect(l: &[f64; 3], d: &Conic) -> Option<[[f64; 3]; 2]> {
    // The coordinate k of the greatest coefficient follows from the two others.
    let [lx, ly, lz] = *l;
    let (k, la, lb, lk, [aa, ab, ak, bb, bk, kk]) = if lx.abs() >= ly.abs() && lx.abs() >= lz.abs() {
        (0, ly, lz, lx, [d[3], d[4], d[1], d[5], d[2], d[0]])
    } else if ly.abs() >= lz.abs() {
        (1, lx, lz, ly, [d[0], d[2], d[1], d[5], d[4], d[3]])
    } else {
        (2, lx, ly, lz, [d[0], d[1], d[2], d[3], d[4], d[5]])
    };
    let over = -1.0 / lk;
    let (u, v) = (la * over, lb * over);
    // With k = u a + v b.
    let qa = aa + 2.0 * u * ak + u * u * kk;
    let qb = ab + u * bk + v * ak + u * v * kk;
    let qc = bb + 2.0 * v * bk + v * v * kk;
    let discriminant = qb * qb - qa * qc;
    let size = qb * qb + (qa * qc).abs();
    let root = if discriminant >= 0.0 {
        discriminant.sqrt()
    } else if discriminant >= -DOUBLE * size {
        0.0
    } else {
        return None;
    };
    let w = -(qb + root.copysign(qb));
    // Roots (a : b) = (w : qa) and (qc : w).
    let point = |a: f64, b: f64| {
        let third = u * a + v * b;
        match k {
            0 => [third, a, b],
            1 => [a, third, b],
            _ => [a, b, third],
        }
    };
    Some([point(w, qa), point(qc, w)])
}

#[cfg(test)]
mod tests;
