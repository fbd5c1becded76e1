//! Epipolar geometry, (10.43)-(10.46): `s~_1^T E s~_2 = 0` with `E = S(o) R`.

use super::StereoError;
use crate::geometry::{Pose, skew};
use crate::linalg::symmetric_eigen;
use nalgebra::{Matrix3, Vector2, Vector3};

/// The images of one point in both views.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Conjugates {
    /// In image 1.
    pub s_1: Vector2<f64>,
    /// In image 2.
    pub s_2: Vector2<f64>,
}

impl Conjugates {
    /// Both in homogeneous coordinates.
    #[inline(always)]
    pub(super) fn homogeneous(&self) -> (Vector3<f64>, Vector3<f64>) {
        (self.s_1.push(1.0), self.s_2.push(1.0))
    }
}

/// Refuses sets that are too small or hold NaN or infinity.
pub(super) fn check(pairs: &[Conjugates], needed: usize) -> Result<(), StereoError> {
    if pairs.len() < needed {
        return Err(StereoError::TooFewPoints { needed, given: pairs.len() });
    }
    let bad = |p: &Conjugates| !p.s_1.iter().chain(p.s_2.iter()).all(|x| x.is_finite());
    pairs.iter().position(bad).map_or(Ok(()), |index| Err(StereoError::NotFinite { index }))
}

/// The essential matrix `S(o_12) R_12` of (10.46), in the units of the base line.
#[must_use]
pub fn essential_matrix(X_12: &Pose) -> Matrix3<f64> {
    skew(&X_12.translation.vector) * X_12.rotation.to_rotation_matrix().matrix()
}

/// The fundamental matrix, which does for pixels (u, v, 1) what E does for normalized coordinates.
///
/// `Omega_1`, `Omega_2`: the intrinsic parameters of (5.45). `None` when one of them is singular.
#[must_use]
pub fn fundamental_matrix(
    E: &Matrix3<f64>,
    Omega_1: &Matrix3<f64>,
    Omega_2: &Matrix3<f64>,
) -> Option<Matrix3<f64>> {
    Some(Omega_1.try_inverse()?.transpose() * E * Omega_2.try_inverse()?)
}

/// The epipoles `e_1` and `e_2`, homogeneous and of unit length: `e_1^T E = 0`, `E e_2 = 0`.
///
/// Serves for fundamental matrices too. `None` when E is zero or not finite.
#[must_use]
pub fn epipoles(E: &Matrix3<f64>) -> Option<(Vector3<f64>, Vector3<f64>)> {
    let size = E.norm();
    if !(size > 0.0 && size.is_finite()) {
        return None;
    }
    let E = E / size;
    let null = |A: Matrix3<f64>| symmetric_eigen(&A).map(|(_, V)| V.column(2).into_owned());
    Some((null(E * E.transpose())?, null(E.transpose() * E)?))
}

/// The epipolar line `l` in image 1 of a point seen in image 2: `l . s~_1 = 0`.
#[must_use]
pub fn epipolar_line_1(E: &Matrix3<f64>, s_2: &Vector2<f64>) -> Vector3<f64> {
    E * s_2.push(1.0)
}

/// The epipolar line in image 2 of a point seen in image 1.
#[must_use]
pub fn epipolar_line_2(E: &Matrix3<f64>, s_1: &Vector2<f64>) -> Vector3<f64> {
    E.tr_mul(&s_1.push(1.0))
}

/// Distance of a point from a line, in the units of the point.
#[must_use]
pub fn line_distance(line: &Vector3<f64>, s: &Vector2<f64>) -> f64 {
    (line.dot(&s.push(1.0)) / line.xy().norm()).abs()
}

/// Squared distance of a pair from the epipolar constraint to first order: the least sum of squares by which both points have
/// to move (Sampson).
#[must_use]
#[inline]
pub fn sampson_error2(E: &Matrix3<f64>, pair: &Conjugates) -> f64 {
    let (x, y) = (&pair.s_1, &pair.s_2);
    let l1 = [
        E.m11 * y.x + E.m12 * y.y + E.m13,
        E.m21 * y.x + E.m22 * y.y + E.m23,
        E.m31 * y.x + E.m32 * y.y + E.m33,
    ];
    let l2 = [E.m11 * x.x + E.m21 * x.y + E.m31, E.m12 * x.x + E.m22 * x.y + E.m32];
    let c = x.x * l1[0] + x.y * l1[1] + l1[2];
    c * c / (l1[0] * l1[0] + l1[1] * l1[1] + l2[0] * l2[0] + l2[1] * l2[1])
}

#[cfg(test)]
mod tests {
    use super::super::testing::{camera_pose, scene};
    use super::*;

    #[test]
    fn conjugates_meet_the_constraint() {
        let (X, E) = (camera_pose(), essential_matrix(&camera_pose()));
        let Omega_1 = Matrix3::new(800.0, 0.0, 320.0, 0.0, 790.0, 240.0, 0.0, 0.0, 1.0);
        let Omega_2 = Matrix3::new(700.0, 0.0, 310.0, 0.0, 710.0, 250.0, 0.0, 0.0, 1.0);
        let F = fundamental_matrix(&E, &Omega_1, &Omega_2).unwrap();
        for (pair, _) in scene(&X, 20, 1) {
            let (s1, s2) = pair.homogeneous();
            assert!(s1.dot(&(E * s2)).abs() < 1e-14 && sampson_error2(&E, &pair) < 1e-28);
            assert!((Omega_1 * s1).dot(&(F * (Omega_2 * s2))).abs() < 1e-12);
            assert!(line_distance(&epipolar_line_1(&E, &pair.s_2), &pair.s_1) < 1e-13);
            assert!(line_distance(&epipolar_line_2(&E, &pair.s_1), &pair.s_2) < 1e-13);
        }
    }

    #[test]
    fn epipoles_are_the_images_of_the_other_centre() {
        let (X, E) = (camera_pose(), essential_matrix(&camera_pose()));
        let (e1, e2) = epipoles(&E).unwrap();
        let o = X.translation.vector;
        assert!(e1.cross(&o.normalize()).norm() < 1e-12);
        assert!(e2.cross(&(X.rotation.inverse() * o).normalize()).norm() < 1e-12);
        // Every epipolar line passes through them.
        for (pair, _) in scene(&X, 5, 2) {
            assert!(epipolar_line_1(&E, &pair.s_2).dot(&e1).abs() < 1e-13);
            assert!(epipolar_line_2(&E, &pair.s_1).dot(&e2).abs() < 1e-13);
        }
        assert!(
            epipoles(&Matrix3::zeros()).is_none() && epipoles(&Matrix3::from_element(f64::NAN)).is_none()
        );
    }

    #[test]
    fn sampson_error_is_the_least_motion_to_first_order() {
        let E = essential_matrix(&camera_pose());
        for (mut pair, _) in scene(&camera_pose(), 20, 3) {
            pair.s_1.y += 1e-4;
            let best = sampson_error2(&E, &pair).sqrt();
            // One point alone has to move farther.
            assert!(best <= line_distance(&epipolar_line_1(&E, &pair.s_2), &pair.s_1) && best > 1e-6);
            let (d1, d2) = (
                line_distance(&epipolar_line_1(&E, &pair.s_2), &pair.s_1),
                line_distance(&epipolar_line_2(&E, &pair.s_1), &pair.s_2),
            );
            assert!((best - (1.0 / (1.0 / (d1 * d1) + 1.0 / (d2 * d2))).sqrt()).abs() < 1e-9);
        }
    }
}
