//! What a camera without lens, noise and edges measures.

use crate::geometry::Pose;
use crate::messages::{FeaturePoint, Measurement, TargetStatus};
use crate::time::MonoNs;
use nalgebra::Point3;

/// The measurement of the points `points_O`, ids 0, 1 ..., of an object at `X_CO`, exposed at `exposure`; `None` when one of them is not
/// in front of the camera.
#[must_use]
pub fn perfect_measurement(points_O: &[Point3<f64>], X_CO: &Pose, exposure: MonoNs) -> Option<Measurement> {
    let mut m = Measurement { exposure, status: TargetStatus::Found as u32, ..Measurement::default() };
    for ((f, p_O), id) in m.features.iter_mut().zip(points_O).zip(0..) {
        let p = X_CO * p_O;
        if !(p.z > 0.0) {
            return None;
        }
        *f = FeaturePoint { id, x: p.x / p.z, y: p.y / p.z, ..FeaturePoint::default() };
        m.feature_count += 1;
    }
    m.set_pose(X_CO);
    Some(m)
}
