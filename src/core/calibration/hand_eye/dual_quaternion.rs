//! `A X = X B` in one step, rotation and position together, by dual quaternions (after Daniilidis 1999).
//!
//! A pose is the dual quaternion `q + e q'`, `q' = p q / 2`. With the motions a = (a0, a), b = (b0, b) of two views the screw of
//! the one is that of the other in X's frame, linear in X:
//! ```text
//! [ a - b    S(a + b)     0       0        ] [ q  ]
//! [ a'- b'   S(a'+ b')    a - b   S(a + b) ] [ q' ] = 0          q.q = 1,  q.q' = 0
//! ```
//! Over all pairs of views two singular values vanish; the solution is the combination of their vectors that meets the two
//! constraints. Lengths are measured in the arm's own, so that neither half outweighs the other.

use super::{LoopSample, motions};
use crate::geometry::{Pose, skew};
use crate::linalg::symmetric_eigen;
use nalgebra::{Quaternion, SMatrix, SVector, Translation3, UnitQuaternion, Vector3, Vector4};

/// The camera's pose `X_MC`. `near`: a rotation to tell the signs of half turns by, such as that of
/// [`super::separate_solution`]. `None` where the views do not fix it.
#[must_use]
pub fn dual_quaternion_solution(samples: &[LoopSample], near: &UnitQuaternion<f64>) -> Option<Pose> {
    let length = length_m(samples);
    let mut normal = SMatrix::<f64, 8, 8>::zeros();
    for (A, B) in motions(samples) {
        let (a, a_dual) = dual(&A, length);
        let (mut b, mut b_dual) = dual(&B, length);
        let alike = UnitQuaternion::new_unchecked(a).inverse() * near * UnitQuaternion::new_unchecked(b);
        if alike.coords.dot(&near.coords) < 0.0 {
            (b, b_dual) = (-b, -b_dual);
        }
        let mut rows = SMatrix::<f64, 6, 8>::zeros();
        let (minus, plus) = (a.imag() - b.imag(), skew(&(a.imag() + b.imag())));
        for (row, column) in [(0, 0), (3, 4)] {
            rows.fixed_view_mut::<3, 1>(row, column).copy_from(&minus);
            rows.fixed_view_mut::<3, 3>(row, column + 1).copy_from(&plus);
        }
        rows.fixed_view_mut::<3, 1>(3, 0).copy_from(&(a_dual.imag() - b_dual.imag()));
        rows.fixed_view_mut::<3, 3>(3, 1).copy_from(&skew(&(a_dual.imag() + b_dual.imag())));
        normal += rows.transpose() * rows;
    }
    let (_, vectors) = symmetric_eigen(&normal)?;
    let (first, second): (SVector<f64, 8>, SVector<f64, 8>) =
        (vectors.column(6).into_owned(), vectors.column(7).into_owned());
    let halves = |v: &SVector<f64, 8>| -> (Vector4<f64>, Vector4<f64>) {
        (v.fixed_rows::<4>(0).into_owned(), v.fixed_rows::<4>(4).into_owned())
    };
    let ((u1, w1), (u2, w2)) = (halves(&first), halves(&second));
    // q.q' = 0 of the combination x first + y second
    let (xx, xy, yy) = (u1.dot(&w1), u1.dot(&w2) + u2.dot(&w1), u2.dot(&w2));
    let best = directions(xx, xy, yy)
        .into_iter()
        .map(|(x, y)| first * x + second * y)
        .max_by(|a, b| halves(a).0.norm().total_cmp(&halves(b).0.norm()))?;
    let (q, q_dual) = halves(&best);
    let size = q.norm();
    // otherwise rounding would be its direction: of the two vectors of length 1 at least one has a real part
    if !(size > 1e-6) {
        return None;
    }
    // scalar first in the equations, last in nalgebra
    let of = |v: Vector4<f64>| Quaternion::new(v.x, v.y, v.z, v.w) / size;
    let (q, q_dual) = (of(q), of(q_dual));
    let p: Vector3<f64> = (q_dual * q.conjugate()).imag() * (2.0 * length);
    let finite = p.iter().all(|x| x.is_finite());
    finite.then(|| Pose::from_parts(Translation3::from(p), UnitQuaternion::from_quaternion(q)))
}

/// Unit directions (x, y) with `xx x^2 + xy x y + yy y^2 = 0`; where noise leaves none, the nearest.
fn directions(xx: f64, xy: f64, yy: f64) -> [(f64, f64); 2] {
    let root = (xy * xy - 4.0 * xx * yy).max(0.0).sqrt();
    // xx x^2 + xy x y + yy y^2: (x : y) = (-xy -+ root : 2 xx) = (2 yy : -xy +- root); the sum without cancellation serves both
    let sum = -(xy + root.copysign(xy)) * 0.5;
    let unit = |x: f64, y: f64| {
        let size = x.hypot(y);
        if size > 0.0 { (x / size, y / size) } else { (0.0, 1.0) }
    };
    [unit(sum, xx), unit(yy, sum)]
}

/// Real and dual part of a pose, lengths divided by `length`.
fn dual(X: &Pose, length: f64) -> (Quaternion<f64>, Quaternion<f64>) {
    let q = *X.rotation.quaternion();
    (q, Quaternion::from_imag(X.translation.vector / length) * q * 0.5)
}

/// Root mean square length of all motions, m.
fn length_m(samples: &[LoopSample]) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for (A, B) in motions(samples) {
        sum += A.translation.vector.norm_squared() + B.translation.vector.norm_squared();
        count += 2.0;
    }
    let length = (sum / f64::max(count, 1.0)).sqrt();
    // An arm that only turned has no length, and needs none.
    if length > 1e-9 { length } else { 1.0 }
}
