//! A camera and its pose from points in space by the direct linear transformation: (10.13) on pixels, where the matrix of the
//! intrinsic parameters (5.41) is unknown too.
//!
//! The 3 x 4 matrix is `P = zeta Omega [R p]`. Its left block is the product of an upper triangular matrix and a rotation, which
//! Gram and Schmidt's way from the last row upwards takes apart (RQ).

use super::super::points::check;
use super::super::{Correspondence3, PoseError};
use super::{LinearProjection, linear_projection};
use crate::geometry::Pose;
use nalgebra::{Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

/// What the direct linear transformation tells of a camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinearCamera {
    /// Omega, with the angle between the axes of pixels that the linear equations leave free in its second entry; the last one is 1.
    pub Omega: Matrix3<f64>,
    /// The object in the camera.
    pub X_CO: Pose,
}

/// Camera and pose from at least six points that are not all coplanar, `s` in pixels (without a lens); exact without noise, a start with it.
///
/// # Errors
/// [`PoseError::TooFewPoints`], [`PoseError::NotFinite`], [`PoseError::Degenerate`] for coplanar points and others that leave the camera open,
/// and [`PoseError::BehindCamera`] when the solution leaves a point behind the camera.
pub fn dlt_camera(points: &[Correspondence3]) -> Result<LinearCamera, PoseError> {
    check(points, 6)?;
    let LinearProjection { M, p, mean } = linear_projection(points)?;
    let (K, R) = upper_times_rotation(&(M * M.determinant().signum())).ok_or(PoseError::Degenerate)?;
    // P is known up to a factor, whose sign makes det R positive: K has a positive diagonal.
    let at_mean = K.try_inverse().ok_or(PoseError::Degenerate)? * p * M.determinant().signum();
    let X_CO = Pose::from_parts(
        Translation3::from(at_mean - R * mean),
        UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(R)),
    );
    let in_front = points.iter().all(|point| (X_CO * point.r).z > 0.0);
    if in_front { Ok(LinearCamera { Omega: K / K.m33, X_CO }) } else { Err(PoseError::BehindCamera) }
}

/// `M = K R` with K upper triangular, its diagonal positive, and R orthogonal; a rotation where det M > 0. `None` for a singular M.
fn upper_times_rotation(M: &Matrix3<f64>) -> Option<(Matrix3<f64>, Matrix3<f64>)> {
    let [m1, m2, m3] = [0, 1, 2].map(|i| M.row(i).transpose());
    let k33 = m3.norm();
    let r3: Vector3<f64> = m3 / k33;
    let k23 = m2.dot(&r3);
    let rest = m2 - r3 * k23;
    let k22 = rest.norm();
    let r2 = rest / k22;
    let (k13, k12) = (m1.dot(&r3), m1.dot(&r2));
    let rest = m1 - r2 * k12 - r3 * k13;
    let k11 = rest.norm();
    let R = Matrix3::from_rows(&[(rest / k11).transpose(), r2.transpose(), r3.transpose()]);
    let K = Matrix3::new(k11, k12, k13, 0.0, k22, k23, 0.0, 0.0, k33);
    R.iter().chain(K.iter()).all(|x| x.is_finite()).then_some((K, R))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Point3, Vector2};
    use proptest::prelude::*;

    /// Points of a cube of side 2 and some more inside, seen by a camera with these numbers.
    fn seen(Omega: &Matrix3<f64>, X_CO: &Pose, count: u32) -> Vec<Correspondence3> {
        (0..count)
            .map(|k| {
                let t = |rate: f64| (rate * f64::from(k) + 0.4 * rate).sin();
                let r = Point3::new(t(2.1), t(3.7), t(5.3));
                let p = Omega * (X_CO * r).coords;
                Correspondence3 { r, s: Vector2::new(p.x / p.z, p.y / p.z) }
            })
            .collect()
    }

    proptest! {
        #[test]
        fn exact_points_give_the_camera(
            f in 300.0..2000.0f64, aspect in 0.8..1.25f64, skew in -20.0..20.0f64, c in prop::array::uniform2(100.0..800.0f64),
            p in prop::array::uniform2(-0.7..0.7f64), z in 3.0..8.0f64, w in prop::array::uniform3(-1.8..1.8f64), count in 8..30u32
        ) {
            let Omega = Matrix3::new(f, skew, c[0], 0.0, f * aspect, c[1], 0.0, 0.0, 1.0);
            let X_CO = Pose::new(Vector3::new(p[0], p[1], z), Vector3::from(w));
            let found = dlt_camera(&seen(&Omega, &X_CO, count)).unwrap();
            prop_assert!((found.Omega - Omega).norm() < 1e-5 * f, "{}", found.Omega);
            prop_assert!((found.X_CO.to_homogeneous() - X_CO.to_homogeneous()).norm() < 1e-5, "{}", found.X_CO);
        }
    }

    #[test]
    fn what_leaves_the_camera_open_is_refused() {
        let Omega = Matrix3::new(800.0, 0.0, 320.0, 0.0, 800.0, 240.0, 0.0, 0.0, 1.0);
        let X_CO = Pose::new(Vector3::new(0.1, 0.0, 5.0), Vector3::new(0.3, 0.2, 0.1));
        let all = seen(&Omega, &X_CO, 20);
        assert_eq!(dlt_camera(&all[..5]), Err(PoseError::TooFewPoints { needed: 6, given: 5 }));
        let flat = |point: &Correspondence3| {
            let r = Point3::new(point.r.x, point.r.y, 0.3 * point.r.x - 0.2);
            let p = Omega * (X_CO * r).coords;
            Correspondence3 { r, s: Vector2::new(p.x / p.z, p.y / p.z) }
        };
        let plane: Vec<_> = all.iter().map(flat).collect();
        assert_eq!(dlt_camera(&plane), Err(PoseError::Degenerate));
        let mut nan = all.clone();
        nan[3].s.x = f64::NAN;
        assert_eq!(dlt_camera(&nan), Err(PoseError::NotFinite { index: 3 }));
    }
}
