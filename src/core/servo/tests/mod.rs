//! The laws against the printed equations with dense matrices, and in closed loops without dynamics.

mod areas;
mod depths;
mod energy;
mod equations;
mod fewer_joints;
mod gains;
mod local_minimum;
mod loops;
mod up_to_scale;

use super::{SetPoint, View};
use crate::geometry::Pose;
use nalgebra::Point3;
use proptest::prelude::*;

pub(super) fn square() -> [Point3<f64>; 4] {
    [(0.0, 0.0), (0.1, 0.0), (0.1, 0.1), (0.0, 0.1)].map(|(x, y)| Point3::new(x, y, 0.0))
}

pub(super) fn seen(X_CO: &Pose, points: &[Point3<f64>]) -> View {
    View::new(points.iter().map(|p| (X_CO * p).coords).map(|p| p.xy() / p.z), Some(*X_CO)).unwrap()
}

/// Poses from which the square is seen, turned up to a radian and more about every axis.
pub(super) fn pose() -> impl Strategy<Value = Pose> {
    prop::array::uniform6(-0.3..0.3f64).prop_map(|a| {
        Pose::new([a[0] * 0.5, a[1] * 0.5, 0.7 + a[2]].into(), [a[3] * 2.0, a[4] * 2.0, a[5] * 4.0].into())
    })
}

pub(super) fn goal(X_DO: &Pose) -> SetPoint {
    SetPoint::from_pose(X_DO, &square()).unwrap()
}
