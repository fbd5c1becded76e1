//! How well the loop closes: where each view has the board in W, and how far these places lie apart.
//!
//! Deviation from the mean, root mean square over the views: `sqrt(sum |d_i|^2 / n)`, of rotation vectors and of positions of the board's
//! origin.

use super::LoopSample;
use crate::geometry::{Pose, closest_rotation};
use nalgebra::{Matrix3, Translation3, UnitQuaternion, Vector3};

/// How far the places of the board in W lie apart.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LoopScatter {
    /// Mean of the places: the board in W.
    pub X_WO: Pose,
    /// Of the rotation, rad.
    pub rotation_rad: f64,
    /// Of the position, m.
    pub position_m: f64,
}

/// The camera by a closed form.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClosedFormCamera {
    /// Which, in words.
    pub method: &'static str,
    /// The camera in the frame that bears it.
    pub X_MC: Pose,
    /// How far the board's places by the single views lie apart with it.
    pub scatter: LoopScatter,
}

/// The board in W as one view has it, for a camera at `X_MC`.
pub(super) fn board(sample: &LoopSample, X_MC: &Pose) -> Pose {
    sample.X_WM * X_MC * sample.X_CO
}

/// The scatter of the board's places for a camera at `X_MC`; `None` without views or with numbers that are none.
#[must_use]
pub fn loop_scatter(samples: &[LoopSample], X_MC: &Pose) -> Option<LoopScatter> {
    let places: Vec<Pose> = samples.iter().map(|sample| board(sample, X_MC)).collect();
    let (mut turn, mut place) = (Matrix3::zeros(), Vector3::zeros());
    for X_WO in &places {
        turn += X_WO.rotation.to_rotation_matrix().matrix();
        place += X_WO.translation.vector;
    }
    let R = UnitQuaternion::from_rotation_matrix(&closest_rotation(&turn)?);
    let X_WO = Pose::from_parts(Translation3::from(place / places.len().max(1) as f64), R);
    let (rotation_rad, position_m) = deviation(&places, &X_WO);
    (!places.is_empty()).then_some(LoopScatter { X_WO, rotation_rad, position_m })
}

/// Root mean square deviation of `places` from `X_WO`: rad and m.
pub(super) fn deviation(places: &[Pose], X_WO: &Pose) -> (f64, f64) {
    let (mut turn, mut way) = (0.0, 0.0);
    for place in places {
        turn += X_WO.rotation.rotation_to(&place.rotation).scaled_axis().norm_squared();
        way += (place.translation.vector - X_WO.translation.vector).norm_squared();
    }
    let count = places.len().max(1) as f64;
    ((turn / count).sqrt(), (way / count).sqrt())
}
