//! The object's pose in the base or end-effector frame, (10.14) and (10.15), and the propagation of covariances.
//!
//! Covariances are those of small twists `[v; w]` (m, rad) of the named frame relative to the other, as
//! [`super::RefinedPose::covariance`] has them.

use crate::geometry::{Pose, skew};
use nalgebra::{Matrix3, Matrix6};

/// Pose of the object in the base frame, `X_BO`, (10.14), for an eye-to-hand camera with the extrinsic parameters `X_BC`.
#[must_use]
pub fn object_in_base(X_BC: &Pose, X_CO: &Pose) -> Pose {
    X_BC * X_CO
}

/// Pose of the object in the end-effector frame, `X_EO`, (10.15), for an eye-in-hand camera with the extrinsic parameters `X_EC`.
#[must_use]
pub fn object_in_effector(X_EC: &Pose, X_CO: &Pose) -> Pose {
    X_EC * X_CO
}

/// Covariance of the twist of C relative to A, expressed in A, for the product `X_AB * X_BC` of two uncertain poses.
///
/// `covariance_AB` that of the twist of B relative to A, expressed in A; `covariance_BC` that of C relative to B, expressed
/// in B. Zeros where a pose is known exactly: the second is then only rotated to A. To first order.
#[must_use]
pub fn chained_covariance(
    X_AB: &Pose,
    covariance_AB: &Matrix6<f64>,
    X_BC: &Pose,
    covariance_BC: &Matrix6<f64>,
) -> Matrix6<f64> {
    let R = X_AB.rotation.to_rotation_matrix();
    // V_AC = [v + w x p, w] of B, with p from B to C in A, plus R V_BC.
    let p = R * X_BC.translation.vector;
    let mut carried = Matrix6::identity();
    carried.fixed_view_mut::<3, 3>(0, 3).copy_from(&-skew(&p));
    let mut turned = Matrix6::zeros();
    let block: &Matrix3<f64> = R.matrix();
    turned.fixed_view_mut::<3, 3>(0, 0).copy_from(block);
    turned.fixed_view_mut::<3, 3>(3, 3).copy_from(block);
    let sum = carried * covariance_AB * carried.transpose() + turned * covariance_BC * turned.transpose();
    (sum + sum.transpose()) * 0.5
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::linalg::Random;
    use nalgebra::{UnitQuaternion, Vector3, Vector6};

    fn moved(X: &Pose, d: &Vector6<f64>) -> Pose {
        let turn = UnitQuaternion::from_scaled_axis(d.fixed_rows::<3>(3).into_owned());
        Pose::from_parts((X.translation.vector + d.fixed_rows::<3>(0)).into(), turn * X.rotation)
    }

    #[test]
    fn object_beyond_the_camera() {
        let X_BC = Pose::new([0.5, 0.1, 1.2].into(), [3.0, 0.2, -0.1].into());
        let X_CO = Pose::new([0.02, -0.03, 0.6].into(), [0.1, 0.4, 0.9].into());
        // (10.14), (10.15) in homogeneous matrices.
        let T = X_BC.to_homogeneous() * X_CO.to_homogeneous();
        assert!((object_in_base(&X_BC, &X_CO).to_homogeneous() - T).norm() < 1e-14);
        assert!((object_in_effector(&X_BC, &X_CO).to_homogeneous() - T).norm() < 1e-14);
    }

    #[test]
    fn covariances_of_a_chain_are_those_of_samples() {
        let X_AB = Pose::new([0.5, 0.1, 1.2].into(), [3.0, 0.2, -0.1].into());
        let X_BC = Pose::new([0.2, -0.3, 0.6].into(), [0.1, 0.4, 0.9].into());
        let mut random = Random::new(5);
        let spread = |random: &mut Random| nalgebra::Matrix6::from_fn(|_, _| 1e-3 * random.gaussian());
        let (A, B) = (spread(&mut random), spread(&mut random));
        let chained = chained_covariance(&X_AB, &(A * A.transpose()), &X_BC, &(B * B.transpose()));
        let mut sampled = Matrix6::zeros();
        let count = 20_000;
        for _ in 0..count {
            let mut unit = || Vector6::from_fn(|_, _| random.gaussian());
            let X = moved(&X_AB, &(A * unit())) * moved(&X_BC, &(B * unit()));
            let exact = X_AB * X_BC;
            let w = (X.rotation * exact.rotation.inverse()).scaled_axis();
            let v: Vector3<f64> = X.translation.vector - exact.translation.vector;
            let d = Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z);
            sampled += d * d.transpose() / f64::from(count);
        }
        assert_eq!(chained, chained.transpose());
        for i in 0..6 {
            for j in 0..6 {
                let size = (chained[(i, i)] * chained[(j, j)]).sqrt();
                assert!((sampled[(i, j)] - chained[(i, j)]).abs() < 0.05 * size, "{i} {j}");
            }
        }
    }
}
