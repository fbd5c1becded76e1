//! Planar homographies, (10.7)-(10.10), and the pose that follows from one, (10.8), (10.11), (10.12).

use super::linear::{Whitening, direct_linear};
use super::points::check;
use super::{Correspondence, PoseError};
use crate::geometry::{Pose, closest_rotation};
use nalgebra::{Matrix2, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

/// Twice the area of a triangle over the square of its set's size, below which it counts as collinear: the area of a triangle of doubles
/// is rounded to 1e-16, so that seven digits of a homography from such points are still its own.
const COLLINEAR: f64 = 1e-9;

/// The homography H with `s~ ~ H [r_x, r_y, 1]^T`, (10.7).
///
/// `points`: at least four, no three of the first four collinear when there are just four. `r` and `s` may also be
/// the two images of a plane, (10.61), or pixels (10.64). The result has unit Frobenius norm and the sign that puts
/// all points in front of the camera. Four points are met exactly; more in the algebraic least-squares sense.
///
/// # Errors
/// [`PoseError::TooFewPoints`], [`PoseError::NotFinite`], [`PoseError::Degenerate`], and
/// [`PoseError::BehindCamera`] when no sign puts all points in front.
pub fn homography(points: &[Correspondence]) -> Result<Matrix3<f64>, PoseError> {
    check(points, 4)?;
    let H = if let [a, b, c, d] = points { from_four(&[a, b, c, d])? } else { from_many(points)? };
    let norm = H.norm();
    if !(norm > 0.0 && norm < f64::INFINITY) {
        return Err(PoseError::Degenerate);
    }
    let depth = |p: &Correspondence| H.m31 * p.r.x + H.m32 * p.r.y + H.m33;
    let sign = points.first().map_or(1.0, |p| depth(p).signum());
    if points.iter().all(|p| sign * depth(p) > 0.0) {
        Ok(H * (sign / norm))
    } else {
        Err(PoseError::BehindCamera)
    }
}

/// The homography through four points, by way of the projective basis that each set of four defines.
fn from_four(p: &[&Correspondence; 4]) -> Result<Matrix3<f64>, PoseError> {
    let object = basis(p.map(|p| [p.r.x, p.r.y])).ok_or(PoseError::Degenerate)?;
    let image = basis(p.map(|p| [p.s.x, p.s.y])).ok_or(PoseError::Degenerate)?;
    // H = B_image B_object^-1. The columns of B are w_i x_i, those of its inverse (up to scale) follow from the
    // cross products of the x_i: row i of B^-1 is (x_j x x_k) / (w_i det).
    let [a, b, c] = object.corners;
    let ratio: [f64; 3] = std::array::from_fn(|i| image.weights[i] / object.weights[i]);
    let rows = [line(b, c), line(c, a), line(a, b)];
    let mut H = [[0.0; 3]; 3];
    for i in 0..3 {
        let [x, y] = image.corners[i];
        for j in 0..3 {
            let t = ratio[i] * rows[i][j];
            H[0][j] += (x + image.origin[0]) * t;
            H[1][j] += (y + image.origin[1]) * t;
            H[2][j] += t;
        }
    }
    // The object's coordinates were taken from its fourth point.
    for row in &mut H {
        row[2] -= row[0] * object.origin[0] + row[1] * object.origin[1];
    }
    Ok(Matrix3::from(H).transpose())
}

/// Three corners relative to the fourth, and the weights that make their sum the fourth.
struct Basis {
    corners: [[f64; 2]; 3],
    origin: [f64; 2],
    weights: [f64; 3],
}

fn basis(p: [[f64; 2]; 4]) -> Option<Basis> {
    let origin = p[3];
    let corners: [[f64; 2]; 3] = std::array::from_fn(|i| [p[i][0] - origin[0], p[i][1] - origin[1]]);
    let [a, b, c] = corners;
    // Twice the signed areas of the triangles with the fourth point, which lies in the origin here.
    let weights = [cross(b, c), cross(c, a), cross(a, b)];
    let whole = weights[0] + weights[1] + weights[2];
    let size = corners.iter().map(|x| x[0] * x[0] + x[1] * x[1]).fold(0.0, f64::max);
    let bound = COLLINEAR * size;
    let spread = weights.iter().all(|w| w.abs() > bound) && whole.abs() > bound;
    spread.then_some(Basis { corners, origin, weights })
}

#[inline]
fn cross(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}

/// The line through two points: the cross product of (a, 1) and (b, 1).
#[inline]
fn line(a: [f64; 2], b: [f64; 2]) -> [f64; 3] {
    [a[1] - b[1], b[0] - a[0], cross(a, b)]
}

/// The homography of five or more points: [`direct_linear`] in whitened coordinates.
fn from_many(points: &[Correspondence]) -> Result<Matrix3<f64>, PoseError> {
    let at = |i: usize| points.get(i).map_or([0.0; 4], |p| [p.r.x, p.r.y, p.s.x, p.s.y]);
    let r = Whitening::new(points.len(), |i| [at(i)[0], at(i)[1]]).ok_or(PoseError::Degenerate)?;
    let s = Whitening::new(points.len(), |i| [at(i)[2], at(i)[3]]).ok_or(PoseError::Degenerate)?;
    let P = direct_linear::<3>(points.len(), |i| {
        let [rx, ry, sx, sy] = at(i);
        let [x, y] = r.apply([rx, ry]);
        ([x, y, 1.0], s.apply([sx, sy]))
    })?;
    // Undo the whitening: H = T_s^-1 P T_r.
    let column = |j: usize| {
        let (u, v, w) = (P[0][j] / s.scale, P[1][j] / s.scale, P[2][j]);
        Vector3::new(u + s.mean[0] * w, v + s.mean[1] * w, w)
    };
    let (h1, h2) = (column(0) * r.scale, column(1) * r.scale);
    Ok(Matrix3::from_columns(&[h1, h2, column(2) - h1 * r.mean[0] - h2 * r.mean[1]]))
}

/// The pose of a plane from its homography, (10.8): scale zeta from the first two columns, then the rotation
/// closest to `[r1 r2 r1 x r2]`, (10.12).
///
/// `H`: any scale, with the sign given by [`homography`]. `None` when the first two columns are parallel, zero or
/// not finite. The textbook's single solution: [`super::planar_pose`] also knows the mirrored one and refines both.
#[must_use]
pub fn pose_from_homography(H: &Matrix3<f64>) -> Option<Pose> {
    let columns = H.fixed_columns::<2>(0).into_owned();
    let C = columns.transpose() * columns;
    let area = C.determinant().max(0.0).sqrt();
    // Polar factor M (M^T M)^(-1/2) of the two columns: with the third one their cross product, it is what (10.12)
    // gives for [r1 r2 r1 x r2], and the root of a 2 x 2 matrix has a closed form.
    let spread = (C.trace() + 2.0 * area).sqrt();
    let root = (C + Matrix2::identity() * area) / spread;
    let zeta = 2.0 / spread;
    // A plane viewed nearly edge-on: the root loses half of the digits of its determinant, and the general way keeps them. Derived: rounding of
    // the determinant by 1e-16 moves an area of 1e-6 by 5e-11.
    let R = if area > 1e-6 * C.trace() {
        let polar = columns * root.try_inverse()?;
        let (r1, r2) = (polar.column(0).into_owned(), polar.column(1).into_owned());
        Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[r1, r2, r1.cross(&r2)]))
    } else {
        let (r1, r2) = (columns.column(0) * zeta, columns.column(1) * zeta);
        let r3 = r1.cross(&r2);
        // Columns of unit size are parallel to rounding: no plane has that homography.
        if r3.norm() <= 1e-12 || r3.norm().is_nan() {
            return None;
        }
        closest_rotation(&Matrix3::from_columns(&[r1, r2, r3]))?
    };
    let p: Vector3<f64> = H.column(2) * zeta;
    let finite = p.iter().chain(R.matrix().iter()).all(|x| x.is_finite());
    finite.then(|| Pose::from_parts(Translation3::from(p), UnitQuaternion::from_rotation_matrix(&R)))
}

#[cfg(test)]
mod tests;
