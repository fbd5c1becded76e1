//! Secondary tasks in the null space of the servo task: joint motions that do not move the features.
//!
//! They exist for arms with seven joints, and wherever the features determine fewer motions than there are joints. The secondary task here is the avoidance
//! of joint limits; its velocity is projected onto the null space of `L_s J` and added to the law output.

use super::TwistTask;
use crate::linalg::symmetric_eigen;
use crate::robot::{CameraJacobian, JointLimits};
use nalgebra::SVector;

/// Squared singular values of the task in joint space, as share of the largest, up to which a motion belongs to the null space: far above the
/// rounding of the eigenvalues, 1e-15 of the largest; such a motion moves the features 3e-5 times as much as the best one.
const FREE_DIRECTION: f64 = 1e-9;
/// Share of half a joint's range, from its middle, in which limit avoidance is inactive. Chosen by hand: half of
/// it changes no unit test; twice of it would be no avoidance at all, which they show.
const QUIET_SHARE: f64 = 0.5;

/// The projection of the joint velocity `wanted` (rad/s or m/s) onto the null space of `task`: the part that does not move the features.
///
/// `None` when the null space is empty, or something is not finite.
#[must_use]
pub fn seek_null_motion<const N: usize>(
    task: &TwistTask,
    J: &CameraJacobian<N>,
    wanted: &SVector<f64, N>,
) -> Option<SVector<f64, N>> {
    let J = J.matrix();
    let normal = J.tr_mul(&(task.matrix * J));
    let (values, vectors) = symmetric_eigen(&normal)?;
    let largest = values.amax();
    let mut motion = SVector::zeros();
    let mut free = false;
    for (i, direction) in vectors.column_iter().enumerate() {
        if values[i] <= FREE_DIRECTION * largest {
            motion += direction * direction.dot(wanted);
            free = true;
        }
    }
    (free && motion.iter().all(|x| x.is_finite())).then_some(motion)
}

/// A joint velocity away from the joint limits, rad/s or m/s: zero in the inner half of a range, rising to `gain_1_s` times a quarter of the range
/// at its ends. Zero for joints without limits.
#[must_use]
pub fn away_from_limits<const N: usize>(
    q: &SVector<f64, N>,
    limits: &[JointLimits; N],
    gain_1_s: f64,
) -> SVector<f64, N> {
    SVector::from_fn(|i, _| {
        let limit = &limits[i];
        let (middle, half) = (0.5 * (limit.lower + limit.upper), 0.5 * (limit.upper - limit.lower));
        if !(half > 0.0 && half < f64::INFINITY) {
            return 0.0;
        }
        let away = q[i] - middle;
        -gain_1_s * (away.abs() - QUIET_SHARE * half).max(0.0) * away.signum()
    })
}
