//! The covariance of a measured pose, expressed in the frame in which the estimator of the object's motion needs it.

use crate::geometry::Pose;
use crate::messages::Measurement;
use nalgebra::Matrix6;

/// The covariance that vision states of its pose, 6 x 6, of the twist `[v; w]` expressed in C, m and rad.
pub(super) fn stated_covariance(measurement: &Measurement) -> Matrix6<f64> {
    Matrix6::from_row_slice(&measurement.pose_covariance)
}

/// Mean variance of a point's place that vision states, both coordinates together, px^2.
pub(crate) fn stated_px2(m: &Measurement) -> f64 {
    let variances = m.features().iter().map(|point| 2.0 * point.sd_px * point.sd_px);
    variances.sum::<f64>() / m.features().len().max(1) as f64
}

/// The covariance of a twist `[v; w]`, given in C, transformed to W.
pub(super) fn covariance_in(X_WC: &Pose, covariance: &Matrix6<f64>) -> Matrix6<f64> {
    let R = X_WC.rotation.to_rotation_matrix();
    let mut both = Matrix6::zeros();
    both.fixed_view_mut::<3, 3>(0, 0).copy_from(R.matrix());
    both.fixed_view_mut::<3, 3>(3, 3).copy_from(R.matrix());
    both * covariance * both.transpose()
}
