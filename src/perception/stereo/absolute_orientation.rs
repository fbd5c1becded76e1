//! Displacement between two sets of the same points in space, (10.54)-(10.57).
//!
//! `p_i = o + R p'_i`: p measured at t, p' at t', both in frame 1; the pose returned is that of frame 1 at t' in frame 1 at t
//! when the cameras move (and the object's own displacement when it moves instead).

use super::StereoError;
use crate::geometry::{Pose, closest_rotation, skew};
use crate::linalg::{Ldlt, symmetric_eigen};
use nalgebra::{Matrix3, Matrix6, Point3, SMatrix, Translation3, UnitQuaternion, Vector3, Vector6};

/// Width over length of a set, below which it counts as collinear: roots of eigenvalues that round to 1e-16 of the largest, so that ratios
/// below 1e-8 cannot be distinguished from zero.
const COLLINEAR: f64 = 1e-7;

/// A displacement and how well it explains the points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AbsoluteOrientation {
    /// R and o of (10.54).
    pub X: Pose,
    /// Root mean square of `|p_i - o - R p'_i|`, m.
    pub rms_m: f64,
}

/// A point measured twice, with the covariances of both positions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeasuredPair {
    /// At t.
    pub p: Point3<f64>,
    /// At t'.
    pub p_prime: Point3<f64>,
    /// Covariance of `p`, m^2, as triangulation gives it.
    pub covariance: Matrix3<f64>,
    /// Covariance of `p_prime`, m^2.
    pub covariance_prime: Matrix3<f64>,
}

/// The R and o of least squares (10.55), by (10.56) and (10.12); `pairs` holds (p_i, p'_i), three at least, not collinear.
///
/// # Errors
/// [`StereoError::TooFewPoints`], [`StereoError::NotFinite`], [`StereoError::Degenerate`] for collinear points.
pub fn absolute_orientation(
    pairs: &[(Point3<f64>, Point3<f64>)],
) -> Result<AbsoluteOrientation, StereoError> {
    orientation_of(pairs.iter().copied())
}

fn orientation_of(
    mut pairs: impl ExactSizeIterator<Item = (Point3<f64>, Point3<f64>)> + Clone,
) -> Result<AbsoluteOrientation, StereoError> {
    let all = pairs.clone();
    if all.len() < 3 {
        return Err(StereoError::TooFewPoints { needed: 3, given: all.len() });
    }
    let bad = |(a, b): (Point3<f64>, Point3<f64>)| !a.iter().chain(b.iter()).all(|x| x.is_finite());
    if let Some(index) = pairs.position(bad) {
        return Err(StereoError::NotFinite { index });
    }
    let over = 1.0 / all.len() as f64;
    let mean = all.clone().map(|p| p.0.coords).sum::<Vector3<f64>>() * over;
    let mean_prime = all.clone().map(|p| p.1.coords).sum::<Vector3<f64>>() * over;
    let (mut K, mut scatter) = (Matrix3::zeros(), Matrix3::zeros());
    for (p, p_prime) in all.clone() {
        let (d, d_prime) = (p.coords - mean, p_prime.coords - mean_prime);
        K += d * d_prime.transpose();
        scatter += d_prime * d_prime.transpose();
    }
    // K alone cannot tell a line from noise about it.
    let (extents, _) = symmetric_eigen(&scatter).ok_or(StereoError::Degenerate)?;
    let singular = symmetric_eigen(&K.tr_mul(&K)).ok_or(StereoError::Degenerate)?.0;
    let size = extents.x;
    let line = |wide: f64, long: f64| !(wide > COLLINEAR * COLLINEAR * long);
    if line(extents.y, size) || line(singular.y.max(0.0).sqrt(), singular.x.max(0.0).sqrt()) {
        return Err(StereoError::Degenerate);
    }
    let R = closest_rotation(&(K / K.norm())).ok_or(StereoError::Degenerate)?;
    let o = mean - R * mean_prime;
    let X = Pose::from_parts(Translation3::from(o), UnitQuaternion::from_rotation_matrix(&R));
    let sum: f64 = all.map(|(p, q)| (p - X * q).norm_squared()).sum();
    Ok(AbsoluteOrientation { X, rms_m: (sum * over).sqrt() })
}

/// The displacement that is most likely for the covariances of the points, and its own covariance.
///
/// Triangulated points are known several times better across the line of sight than along it: this counts. The covariance is
/// that of the twist `[v; w]` (m, rad) that turns and moves frame t' about its own origin, expressed in frame t.
///
/// # Errors
/// As [`absolute_orientation`], and [`StereoError::BadGuess`] for covariances that are not positive definite,
/// [`StereoError::NotConverged`].
pub fn absolute_orientation_weighted(
    pairs: &[MeasuredPair],
) -> Result<(AbsoluteOrientation, Matrix6<f64>), StereoError> {
    // So that a start from which nothing converges ends; Gauss-Newton near the closed form needs a handful.
    const MAX_STEPS: u32 = 50;
    let plain = pairs.iter().map(|pair| (pair.p, pair.p_prime));
    let mut X = orientation_of(plain.clone())?.X;
    let mut covariance = Matrix6::zeros();
    for step in 0..MAX_STEPS {
        let mut normal = Matrix6::zeros();
        let mut right = Vector6::zeros();
        let R = X.rotation.to_rotation_matrix();
        for pair in pairs {
            let turned = R * pair.p_prime.coords;
            let C = pair.covariance + R.matrix() * pair.covariance_prime * R.matrix().transpose();
            let factors = Ldlt::of(&C).ok_or(StereoError::BadGuess)?;
            let information = Matrix3::from(factors.inverse());
            let mut J = SMatrix::<f64, 3, 6>::zeros();
            J.fixed_view_mut::<3, 3>(0, 0).copy_from(&Matrix3::identity());
            J.fixed_view_mut::<3, 3>(0, 3).copy_from(&-skew(&turned));
            let e = pair.p.coords - turned - X.translation.vector;
            normal += J.transpose() * information * J;
            right += J.transpose() * (information * e);
        }
        let factors = Ldlt::of(&normal).ok_or(StereoError::Degenerate)?;
        let d = Vector6::from(factors.solve(&right.into()));
        covariance.copy_from(&Matrix6::from(factors.inverse()));
        let turn = UnitQuaternion::from_scaled_axis(d.fixed_rows::<3>(3).into_owned());
        X = Pose::from_parts(
            Translation3::from(X.translation.vector + d.fixed_rows::<3>(0)),
            turn * X.rotation,
        );
        let size = 1.0 + X.translation.vector.norm();
        // Steps shrink by the share of the curvature that is left out: what follows is below rounding.
        if d.norm() < 1e-11 * size {
            let sum: f64 = plain.map(|(p, q)| (p - X * q).norm_squared()).sum();
            let rms_m = (sum / pairs.len() as f64).sqrt();
            return Ok((AbsoluteOrientation { X, rms_m }, covariance));
        }
        if !d.norm().is_finite() || step + 1 == MAX_STEPS {
            break;
        }
    }
    Err(StereoError::NotConverged { iterations: MAX_STEPS })
}

#[cfg(test)]
mod tests {
    use super::super::Triangulator;
    use super::super::testing::{camera_pose, noisy, scene};
    use super::*;
    use crate::linalg::Random;
    use crate::pose::normalized_error;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn displacements_come_back(
            x in prop::array::uniform6(-2.0..2.0f64), seed in 0..1000_u64, n in 3..12_usize, flat in prop::bool::ANY
        ) {
            let X = Pose::new([x[0], x[1], x[2]].into(), [x[3], x[4], x[5]].into());
            let mut random = Random::new(seed);
            let pairs: Vec<_> = (0..n).map(|_| {
                let depth = if flat { 0.0 } else { random.between(-1.0, 1.0) };
                let p = Point3::new(random.between(-1.0, 1.0), random.between(-1.0, 1.0), depth);
                (X * p, p)
            }).collect();
            let found = absolute_orientation(&pairs).unwrap();
            prop_assert!((found.X.to_homogeneous() - X.to_homogeneous()).norm() < 1e-7 && found.rms_m < 1e-9, "{found:?}");
        }

        #[test]
        fn no_other_displacement_fits_better(d in prop::array::uniform6(-0.01..0.01f64), seed in 0..1000_u64) {
            let mut random = Random::new(seed);
            let mut point = || Point3::from([(); 3].map(|()| random.between(-1.0, 1.0)));
            let pairs: Vec<_> = (0..6).map(|_| (point(), point())).collect();
            let found = absolute_orientation(&pairs).unwrap();
            let other = Pose::new([d[0], d[1], d[2]].into(), [d[3], d[4], d[5]].into()) * found.X;
            let sum = |X: &Pose| pairs.iter().map(|(p, q)| (p - X * q).norm_squared()).sum::<f64>();
            prop_assert!(sum(&other) >= sum(&found.X) - 1e-12);
            prop_assert!((sum(&found.X) / 6.0 - found.rms_m * found.rms_m).abs() < 1e-9);
        }
    }

    #[test]
    fn triangulated_points_move_with_an_honest_covariance() {
        let rig = Triangulator::new(&camera_pose()).unwrap();
        let X = Pose::new([0.05, 0.02, -0.1].into(), [0.1, -0.05, 0.2].into());
        let sd = 0.3 / 800.0;
        let mut random = Random::new(8);
        let count = 300;
        let (mut normalized, mut plain, mut weighted) = (0.0, 0.0, 0.0);
        for seed in 0..count {
            let before = scene(&camera_pose(), 12, seed);
            // The same points after the cameras have moved: p = X p'.
            let after: Vec<_> = before
                .iter()
                .map(|(_, p)| {
                    let q = X.inverse() * p;
                    let r = camera_pose().inverse() * q;
                    (super::super::Conjugates { s_1: q.xy().coords / q.z, s_2: r.xy().coords / r.z }, q)
                })
                .collect();
            let at = |pairs: Vec<super::super::Conjugates>| {
                pairs.iter().map(|p| rig.point(p).unwrap()).collect::<Vec<_>>()
            };
            let (a, b) = (at(noisy(&before, sd, &mut random)), at(noisy(&after, sd, &mut random)));
            let v = sd * sd;
            let pairs: Vec<_> = a
                .iter()
                .zip(&b)
                .map(|(a, b)| MeasuredPair {
                    p: a.p_1,
                    p_prime: b.p_1,
                    covariance: a.covariance * v,
                    covariance_prime: b.covariance * v,
                })
                .collect();
            let points: Vec<_> = pairs.iter().map(|p| (p.p, p.p_prime)).collect();
            let (found, covariance) = absolute_orientation_weighted(&pairs).unwrap();
            normalized += normalized_error(&found.X, &covariance, &X).unwrap() / count as f64;
            weighted += (found.X.translation.vector - X.translation.vector).norm();
            plain +=
                (absolute_orientation(&points).unwrap().X.translation.vector - X.translation.vector).norm();
        }
        assert!((normalized - 6.0).abs() < 0.7, "{normalized}");
        assert!(weighted < 0.8 * plain, "{weighted} {plain}");
    }

    #[test]
    fn bad_input_is_refused() {
        let p = |x: f64, y: f64| (Point3::new(x, y, 0.0), Point3::new(x, y, 1.0));
        assert_eq!(
            absolute_orientation(&[p(0.0, 0.0), p(1.0, 0.0)]),
            Err(StereoError::TooFewPoints { needed: 3, given: 2 })
        );
        assert_eq!(
            absolute_orientation(&[p(0.0, 0.0), p(1.0, 0.0), p(2.0, 0.0)]),
            Err(StereoError::Degenerate)
        );
        assert_eq!(absolute_orientation(&[p(0.0, 0.0); 5]), Err(StereoError::Degenerate));
        assert_eq!(
            absolute_orientation(&[p(0.0, 0.0), p(f64::NAN, 0.0), p(2.0, 0.0)]),
            Err(StereoError::NotFinite { index: 1 })
        );
    }
}
