//! The camera's extrinsic parameters where the pose of the board is known: (10.62), (10.63).

use crate::geometry::Pose;

/// A camera beside the arm, (10.62): `X_BC = X_BO X_CO^-1`, the board's pose in the base known.
#[must_use]
pub fn camera_in_base(X_BO: &Pose, X_CO: &Pose) -> Pose {
    X_BO * X_CO.inverse()
}

/// A camera on the flange, (10.63): `X_EC = X_EO X_CO^-1`, the board's pose in the flange known: for a board that rests in the
/// base, `X_EO = X_BE^-1 X_BO`.
#[must_use]
pub fn camera_in_effector(X_EO: &Pose, X_CO: &Pose) -> Pose {
    X_EO * X_CO.inverse()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pose::{object_in_base, object_in_effector};

    #[test]
    fn it_is_the_way_back_of_the_objects_pose() {
        let X_CO = Pose::new([0.02, -0.03, 0.6].into(), [0.1, 0.4, 0.9].into());
        let camera = Pose::new([0.5, 0.1, 1.2].into(), [3.0, 0.2, -0.1].into());
        let back = camera_in_base(&object_in_base(&camera, &X_CO), &X_CO);
        assert!((back.to_homogeneous() - camera.to_homogeneous()).norm() < 1e-14);
        let back = camera_in_effector(&object_in_effector(&camera, &X_CO), &X_CO);
        assert!((back.to_homogeneous() - camera.to_homogeneous()).norm() < 1e-14);
    }
}
