//! Joint motion that the encoders are too coarse to show, estimated from two views.
//!
//! Data flow: the view of one exposure is predicted at the next exposure by the joint motion of the history (`s_predicted`); for an object at rest
//! it should equal the measured view `s`. The difference is attributed to joint motion `dq` that the history does not contain,
//! `s - s_predicted = L J dq`, with the interaction matrix `L` and the camera's Jacobian `J`. It is estimated by damped least squares:
//!
//! ```text
//! dq = (J^T L^T L J + lambda 1)^-1 J^T L^T (s - s_predicted)
//! ```

use super::{SetPoint, View};
use crate::features::NormalEquations;
use crate::linalg::Ldlt;
use crate::robot::CameraJacobian;
use crate::time::{MonoNs, SpanNs};
use nalgebra::SVector;

/// Lambda, as share of the largest diagonal entry: motions that move the features thirty times less than others, sqrt(1000), are halved,
/// because noise of the features would appear as thirty times as much of them. Chosen by hand: half and twice of it change no unit test.
const DAMPING: f64 = 1e-3;

/// Exposures farther apart than this do not determine a velocity, since the arm may have changed it in between: three frames at 20 Hz. Chosen by
/// hand; no unit test comes near it.
pub(super) const LONGEST_SPAN: SpanNs = SpanNs(150_000_000);

/// Joint motion between two exposures that the joint history does not contain.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct UnobservedMotion<const N: usize> {
    /// The motion, rad or m.
    pub dq: SVector<f64, N>,
    /// The first exposure.
    pub from: MonoNs,
    /// Time from the first to the second exposure.
    pub span: SpanNs,
}

/// The joint motion `dq`, rad or m, that turns the predicted view `predicted` into the measured view `seen`; `None` where the features do not
/// determine it or something is not finite.
pub(super) fn unobserved_motion<const N: usize>(
    set_point: &SetPoint,
    predicted: &View,
    seen: &View,
    J: &CameraJacobian<N>,
) -> Option<SVector<f64, N>> {
    let X_CO = seen.X_CO()?;
    let mut equations = NormalEquations::<6>::new();
    for (i, p_O) in set_point.points().iter().enumerate() {
        if let (Some(s), Some(believed)) = (seen.feature(i), predicted.feature(i)) {
            equations.add_point(s, (X_CO * p_O).z, &(s - believed), 1.0);
        }
    }
    let J = J.matrix();
    let b = J.tr_mul(&equations.vector());
    let normal = J.tr_mul(&(equations.matrix() * J));
    let largest = normal.diagonal().amax();
    let matrix: [[f64; N]; N] = std::array::from_fn(|i| std::array::from_fn(|j| normal[(i, j)]));
    let dq = SVector::from(Ldlt::new(&matrix, &[DAMPING * largest; N])?.solve(&b.into()));
    dq.iter().all(|x| x.is_finite()).then_some(dq)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose;
    use crate::robot::Mount;
    use crate::sim::perfect_measurement;
    use nalgebra::{Point3, Vector6};
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]
        #[test]
        fn what_nobody_believed_is_found(
            dq in prop::array::uniform6(-3e-4..3e-4f64), believed in prop::array::uniform6(-0.02..0.02f64), hand in any::<bool>()
        ) {
            let robot = crate::robot::load("ur5").unwrap().build::<6>().unwrap();
            let points = [(0.0, 0.0), (0.1, 0.0), (0.1, 0.1), (0.0, 0.1)].map(|(x, y)| Point3::new(x, y, 0.0));
            let goal = Pose::new([-0.05, -0.05, 0.4].into(), [0.1, -0.2, 0.0].into());
            let set_point = SetPoint::from_pose(&goal, &points).unwrap();
            let q = Vector6::new(0.0, -1.6, 1.9, -1.9, -1.57, 0.0);
            let mount = if hand {
                Mount::EyeInHand { X_EC: Pose::identity() }
            } else {
                Mount::EyeToHand { X_BC: robot.forward(&q) * Pose::new([0.0, 0.0, 0.4].into(), [3.0, 0.1, 0.0].into()) }
            };
            let X_WC = |q: &Vector6<f64>| mount.X_WC(&robot, q);
            let X_WO = X_WC(&q) * goal;
            let view_at = |q: &Vector6<f64>| {
                let seen = perfect_measurement(&points, &X_WC(q).inv_mul(&X_WO), MonoNs::ZERO).unwrap();
                View::of(&seen, &set_point).unwrap()
            };
            let dq = Vector6::from(dq);
            let q_now = q + Vector6::from(believed);
            let predicted = view_at(&q).predicted_at(&X_WC(&q_now).inv_mul(&X_WC(&q)), &set_point).unwrap();
            let seen = view_at(&(q_now + dq));
            let (_, J) = mount.camera(&robot, &q_now);
            let found = unobserved_motion(&set_point, &predicted, &seen, &J).unwrap();
            // The rest is not observable in the features, or damped.
            let left = view_at(&(q_now + dq - found));
            let off = |a: &View, b: &View| -> f64 {
                a.features().iter().zip(b.features()).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max)
            };
            prop_assert!(off(&left, &predicted) < 0.25 * off(&seen, &predicted) + 1e-7, "{dq} {found}");
        }
    }
}
