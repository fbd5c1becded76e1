//! Position-based laws from the homography: what they take for the pose of a plane of unknown size.

use crate::geometry::Pose;
use crate::servo::{
    OperationalSpace, OperationalSpaceError, OrientationError, SetPoint, View, operational_pose,
};
use nalgebra::{Point3, Vector3};
use proptest::prelude::*;

/// The images of the points, without a pose.
fn view(points: &[Point3<f64>], X_CO: &Pose) -> View {
    View::new(points.iter().map(|p| (X_CO * p).coords).map(|p| p.xy() / p.z), None).unwrap()
}

proptest! {
    /// The error of (10.69) with the believed size, against the true one by the poses themselves: the rotation is the same, the position `size` times it.
    #[test]
    fn the_position_error_is_right_up_to_a_scale(
        size in 0.3..3.0f64, off in prop::array::uniform3(-0.15..0.15f64), turn in prop::array::uniform3(-0.4..0.4f64),
        tilt in prop::array::uniform2(-0.4..0.4f64), beside in prop::array::uniform8(-0.02..0.02f64)
    ) {
        let corners = [[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]];
        let points: Vec<_> = corners
            .iter()
            .enumerate()
            .map(|(i, [x, y])| Point3::new(x + beside[2 * i], y + beside[2 * i + 1], 0.0))
            .collect();
        let X_DO = Pose::new(Vector3::new(0.02, -0.03, 0.6), Vector3::new(tilt[0], tilt[1], 0.3));
        let X_CD = Pose::new(Vector3::from(off), Vector3::from(turn));
        let X_CO = X_CD * X_DO;
        // What is believed: the same images of a target that is `size` times as large, as many times as far away.
        let believed: Vec<_> = points.iter().map(|p| Point3::from(p.coords * size)).collect();
        let X_DO_believed = Pose::from_parts((X_DO.translation.vector * size).into(), X_DO.rotation);
        let set_point = SetPoint::from_pose(&X_DO_believed, &believed).unwrap();
        let seen = view(&points, &X_CO);
        let found = operational_pose(&set_point, &seen, OperationalSpace::Homography).unwrap();
        let error = |X_DO: &Pose, X_CO: &Pose| OperationalSpaceError::new(X_DO, X_CO, OrientationError::AngleAxis).x;
        let (truth, of_law) = (error(&X_DO, &X_CO), error(&X_DO_believed, &found));
        let (p, p_found) = (truth.fixed_rows::<3>(0) * size, of_law.fixed_rows::<3>(0));
        prop_assert!((p - p_found).norm() < 1e-7 * size, "{p} {p_found}");
        prop_assert!((truth.fixed_rows::<3>(3) - of_law.fixed_rows::<3>(3)).norm() < 1e-7);
    }
}

#[test]
fn three_points_give_no_homography() {
    let points = [[0.0, 0.0], [0.1, 0.0], [0.0, 0.1]].map(|[x, y]| Point3::new(x, y, 0.0));
    let X_DO = Pose::translation(0.0, 0.0, 0.5);
    let set_point = SetPoint::from_pose(&X_DO, &points).unwrap();
    let seen = view(&points, &(Pose::translation(0.01, 0.0, 0.1) * X_DO));
    assert!(operational_pose(&set_point, &seen, OperationalSpace::Homography).is_none());
}
