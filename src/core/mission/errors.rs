//! The errors at the end of a run.

use super::MeasurementLog;
use crate::geometry::{Pose, rotation_angle};
use crate::servo::SetPoint;
use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

/// Errors as control estimates them, from the last measurement; `null` where unknown.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct MeasuredErrors {
    /// Root mean square, px.
    pub feature_error_px: Option<f64>,
    /// Distance of the camera from its desired place, m.
    pub position_error_m: Option<f64>,
    /// Angle of the camera from its desired orientation, rad.
    pub orientation_error_rad: Option<f64>,
}

impl MeasuredErrors {
    /// From a feature error, px, NaN where unknown, and the distance, m, and angle, rad, of the camera.
    pub(super) fn new(feature_error_px: f64, pose: Option<(f64, f64)>) -> Self {
        Self {
            feature_error_px: Some(feature_error_px).filter(|e| e.is_finite()),
            position_error_m: pose.map(|(distance, _)| distance),
            orientation_error_rad: pose.map(|(_, angle)| angle),
        }
    }
}

/// Errors at the end of the run, against simulated truth where there is one; `null` where unknown.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct FinalErrors {
    /// Root mean square, px.
    pub feature_error_px: Option<f64>,
    /// Distance of the camera from its desired place, m.
    pub position_error_m: Option<f64>,
    /// Angle of the camera from its desired orientation, rad.
    pub orientation_error_rad: Option<f64>,
    /// The errors as control estimates them. A lens, mount, target or arm that differs from the configuration shows in the difference.
    #[serde(default)]
    pub believed: MeasuredErrors,
}

impl FinalErrors {
    /// Whether the estimated pose differs from the truth by more than image noise explains.
    #[must_use]
    pub fn is_not_as_believed(&self) -> bool {
        // Chosen by hand. Points that span 200 px at 0.5 m and f = 800 px and are found to 0.05 px give the distance to about
        // 0.5 m * 0.05 / 200 = 0.13 mm, and a tilt to about 2 mrad, for it changes half of the target by 25 px a rad.
        const NOISE_M: f64 = 1e-3;
        const NOISE_RAD: f64 = 3e-3;
        let apart =
            |a: Option<f64>, b: Option<f64>, noise| a.zip(b).is_some_and(|(a, b)| (a - b).abs() > noise);
        apart(self.position_error_m, self.believed.position_error_m, NOISE_M)
            || apart(self.orientation_error_rad, self.believed.orientation_error_rad, NOISE_RAD)
    }
}

/// Distance, m, and angle, rad, of the camera from the goal `set_point` when it sees the object at `X_CO`; `None` of a goal without a pose.
pub(super) fn off_goal(set_point: &SetPoint, X_CO: &Pose) -> Option<(f64, f64)> {
    let X_DC = set_point.X_DO()? * X_CO.inverse();
    Some((X_DC.translation.vector.norm(), rotation_angle(&X_DC.rotation.to_rotation_matrix())))
}

/// The goal as the true lens has it, with the focal lengths of that lens, px; of a goal that is an image. A lens that is believed and not true makes other features of
/// the same pixels, and another pose of them: neither says where the camera truly stands.
pub(super) type TrueGoal = (SetPoint, Vector2<f64>);

/// Errors at the goal `set_point` of a camera with the focal lengths `f_px`, px, that truly sees the object at `true_view`, where that is known, or else by the last of its `measurements`. Of a goal that
/// is an image the truth is compared with `true_goal`.
pub(super) fn errors_of(
    (set_point, f_px): (&SetPoint, &Vector2<f64>),
    measurements: &MeasurementLog,
    true_view: Option<Pose>,
    true_goal: Option<&TrueGoal>,
) -> FinalErrors {
    let measured = measurements.last_found().and_then(|m| off_goal(set_point, &m.pose()?));
    let believed = MeasuredErrors::new(measurements.error_px(), measured);
    let errors = true_view.map_or(believed, |X_CO| {
        let (goal, f_px) = true_goal.map_or((set_point, f_px), |(goal, f_px)| (goal, f_px));
        MeasuredErrors::new(goal.error_rms_px_at(&X_CO, f_px), off_goal(goal, &X_CO))
    });
    FinalErrors {
        feature_error_px: errors.feature_error_px,
        position_error_m: errors.position_error_m,
        orientation_error_rad: errors.orientation_error_rad,
        believed,
    }
}
