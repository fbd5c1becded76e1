//! How the pose of one frame is found, Sect. 10.3: in closed form, by iteration from a near one, or both.
//!
//! ```text
//!              both        plane: homography, both its tilts, each to its least error (10.8)-(10.12); space: every minimum that comes close
//! points ──►   iterative   the last pose, carried by the arm's motion ───────────────────────────────┐
//!              analytical  homography, closest rotation (10.8), (10.11), (10.12): that is the pose   ├─► least error, (10.36), and covariance
//! ```

use crate::geometry::Pose;
use crate::pose::{
    Correspondence, Correspondence3, PlanarPose, PoseError, PoseSolution, homography, planar_pose, pnp,
    pose_from_homography, reprojection_rms,
};
use nalgebra::{Matrix6, Vector6};
use serde::{Deserialize, Serialize};

/// Which way a pose is found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PoseApproach {
    /// In closed form in every frame, and from each of its solutions by iteration to the least reprojection error; the last pose tells
    /// which of two that fit alike is meant.
    #[default]
    Both,
    /// In closed form alone, from the homography of a plane: the closest rotation, not the least error. A plane's other tilt is not looked at.
    Analytical,
    /// By iteration from the last pose, or where that was carried to; in closed form where there is none, and where it leads to no pose that
    /// explains the view.
    Iterative,
}

/// Where iteration starts: one pose, or both that a plane leaves. `plane` is a buffer.
pub(super) fn start(
    method: PoseApproach,
    is_flat: bool,
    pairs: &[Correspondence3],
    known: Option<&Pose>,
    plane: &mut Vec<Correspondence>,
) -> Result<PlanarPose, PoseError> {
    let one = |X_CO: Pose| {
        let best = PoseSolution { X_CO, rms: reprojection_rms(&X_CO, pairs) };
        PlanarPose { best, other: None }
    };
    match (method, known) {
        (PoseApproach::Iterative, Some(known)) => Ok(one(*known)),
        (PoseApproach::Analytical, _) => analytical(pairs, plane).map(one).ok_or(PoseError::Degenerate),
        _ if !is_flat => {
            let found = pnp(pairs)?;
            Ok(PlanarPose { best: found.best(), other: found.as_slice().get(1).copied() })
        }
        _ => {
            fill(plane, pairs);
            planar_pose(plane)
        }
    }
}

fn fill(plane: &mut Vec<Correspondence>, pairs: &[Correspondence3]) {
    plane.clear();
    plane.extend(pairs.iter().map(|pair| Correspondence { r: pair.r.coords.xy(), s: pair.s }));
}

/// The pose of the homography.
fn analytical(pairs: &[Correspondence3], plane: &mut Vec<Correspondence>) -> Option<Pose> {
    fill(plane, pairs);
    pose_from_homography(&homography(plane).ok()?)
}

/// The pose of the homography, and its covariance as twist `[v; w]` of O relative to C, expressed in C: what points of standard deviation
/// `sd` (normalized) make of it, by the central difference over two of their deviations.
pub(super) fn analytical_pose(
    pairs: &mut [Correspondence3],
    sd: f64,
    plane: &mut Vec<Correspondence>,
) -> Option<(Pose, Matrix6<f64>)> {
    let X_CO = analytical(pairs, plane)?;
    let mut covariance = Matrix6::zeros();
    for i in 0..pairs.len() {
        for k in 0..2 {
            let mut at = |offset: f64| {
                let s = pairs.get(i)?.s;
                pairs.get_mut(i)?.s[k] += offset;
                let moved = analytical(pairs, plane);
                pairs.get_mut(i)?.s = s;
                moved
            };
            let (before, after) = (at(-sd)?, at(sd)?);
            let v = after.translation.vector - before.translation.vector;
            let w = (after.rotation * before.rotation.inverse()).scaled_axis();
            let half = Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z) * 0.5;
            covariance += half * half.transpose();
        }
    }
    Some((X_CO, covariance))
}
