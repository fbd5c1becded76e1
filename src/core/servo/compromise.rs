//! One joint velocity for two cameras (10.1.1): each has a law, a target and a goal of its own, and both move one arm.
//!
//! ```text
//! min over qd of  sum of w_k |J_k qd - V_k|^2,   V_k = J_k qd_k        qd_k: what the law of camera k asks of the joints
//! qd = qm + (sum of w_k J_k^T J_k)^-1 sum of w_k J_k^T J_k (qd_k - qm),   qm = (sum of w_k qd_k) / (sum of w_k)
//! ```
//! It is the stacked task, with the twists of the cameras (m/s, rad/s) as its rows: what each law makes of its own features stands in V_k. About the weighted mean qm,
//! because the difference alone is damped near singularities: where both ask for the same they have it, and where neither camera is moved the mean counts.

use super::Convergence;
use super::resolve::damped_factors;
use crate::robot::CameraJacobian;
use nalgebra::{SMatrix, SVector};

/// What the law of one camera asks of the joints.
#[derive(Debug, Clone, Copy)]
pub struct JointWish<const N: usize> {
    /// The joint velocity, rad/s or m/s.
    pub qd: SVector<f64, N>,
    /// How it leads to the goal of this camera.
    pub convergence: Convergence<N>,
    /// The camera's Jacobian.
    pub J: CameraJacobian<N>,
    /// Its weight, above 0.
    pub weight: f64,
}

/// The joint velocity that meets both wishes as well as one arm can, rad/s or m/s, and how it leads to where they balance. `None` when it is not finite.
#[must_use]
pub fn compromise<const N: usize>(wishes: &[JointWish<N>; 2]) -> Option<(SVector<f64, N>, Convergence<N>)> {
    let [a, b] = wishes;
    let part = |wish: &JointWish<N>| wish.J.matrix().tr_mul(wish.J.matrix()) * wish.weight;
    let (of_a, of_b) = (part(a), part(b));
    let share = a.weight / (a.weight + b.weight);
    let factors = damped_factors(&rows(&(of_a + of_b)))?;
    // The same linear map for all that is asked for.
    let meet = |of: fn(&JointWish<N>) -> SVector<f64, N>| {
        let (a, b) = (of(a), of(b));
        let mean = a * share + b * (1.0 - share);
        mean + SVector::from(factors.solve(&(of_a * (a - mean) + of_b * (b - mean)).into()))
    };
    let qd = meet(|wish| wish.qd);
    let convergence = Convergence {
        // The quicker of the two: the arm then brakes in time for both.
        rate_1_s: a.convergence.rate_1_s.max(b.convergence.rate_1_s),
        remaining: meet(|wish| wish.convergence.remaining),
        feed_forward: meet(|wish| wish.convergence.feed_forward),
        null_space: meet(|wish| wish.convergence.null_space),
    };
    qd.iter().all(|x| x.is_finite()).then_some((qd, convergence))
}

fn rows<const N: usize>(m: &SMatrix<f64, N, N>) -> [[f64; N]; N] {
    std::array::from_fn(|i| std::array::from_fn(|j| m[(i, j)]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose;
    use crate::robot::{Mount, Robot};
    use nalgebra::{DMatrix, DVector, Vector6};
    use proptest::prelude::*;

    /// `V_WC_C` of each joint's unit velocity by differences of the camera's pose: not by the Jacobian that is tested with.
    fn by_differences<const N: usize>(
        mount: &Mount,
        robot: &Robot<N>,
        q: &SVector<f64, N>,
    ) -> SMatrix<f64, 6, N> {
        // Rounding of 1e-16 m leaves 1e-10 of a central difference, and the third derivative 1e-12.
        const H: f64 = 1e-6;
        SMatrix::from_columns(&std::array::from_fn::<_, N, _>(|i| {
            let (mut before, mut after) = (*q, *q);
            (before[i], after[i]) = (q[i] - H, q[i] + H);
            let moved = mount.X_WC(robot, q).inv_mul(&mount.X_WC(robot, &after));
            let back = mount.X_WC(robot, q).inv_mul(&mount.X_WC(robot, &before));
            let v = (moved.translation.vector - back.translation.vector) / (2.0 * H);
            let w = (moved.rotation.scaled_axis() - back.rotation.scaled_axis()) / (2.0 * H);
            Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z)
        }))
    }

    fn wish<const N: usize>(
        mount: &Mount,
        robot: &Robot<N>,
        q: &SVector<f64, N>,
        qd: SVector<f64, N>,
        weight: f64,
    ) -> JointWish<N> {
        let (_, J) = mount.camera(robot, q);
        JointWish { qd, convergence: Convergence { remaining: qd * 0.5, ..Convergence::at(2.0) }, J, weight }
    }

    fn cameras(a: [f64; 6]) -> [Mount; 2] {
        let pose = |k: f64| Pose::new([a[0], a[1] * k, a[2] + k].into(), [a[3], a[4], a[5] * k].into());
        [Mount::EyeInHand { X_EC: pose(0.1) }, Mount::EyeToHand { X_BC: pose(1.0) }]
    }

    proptest! {
        /// Against the stacked rows of both cameras, solved by their singular values.
        #[test]
        fn the_compromise_is_the_least_squares_solution(
            dq in prop::array::uniform6(-0.4..0.4_f64), first in prop::array::uniform6(-1.0..1.0_f64),
            second in prop::array::uniform6(-1.0..1.0_f64), mounted in prop::array::uniform6(-0.3..0.3_f64), weight in 0.05..20.0_f64
        ) {
            let robot: Robot<6> = crate::robot::load("ur5").unwrap().build().unwrap();
            let q = SVector::from([0.46, -1.72, 1.45, -1.28, -1.82, 0.97]) + SVector::from(dq);
            let [a, b] = cameras(mounted);
            let wishes = [wish(&a, &robot, &q, first.into(), 1.0), wish(&b, &robot, &q, second.into(), weight)];
            let (qd, convergence) = compromise(&wishes).unwrap();
            let (mut rows, mut wanted) = (DMatrix::zeros(12, 6), DVector::zeros(12));
            for (k, (mount, asked, weight)) in [(a, first, 1.0), (b, second, weight)].into_iter().enumerate() {
                let J = by_differences(&mount, &robot, &q) * f64::sqrt(weight);
                rows.fixed_view_mut::<6, 6>(6 * k, 0).copy_from(&J);
                wanted.fixed_rows_mut::<6>(6 * k).copy_from(&(J * SVector::from(asked)));
            }
            let svd = rows.svd(true, true);
            let worst = svd.singular_values.max() / svd.singular_values.min();
            prop_assume!(worst < 1e3);
            let expected = svd.solve(&wanted, 0.0).unwrap();
            prop_assert!((qd - expected.fixed_rows::<6>(0)).amax() < 1e-6 * worst, "{qd} {expected}");
            prop_assert!((convergence.remaining - qd * 0.5).amax() < 1e-9);
        }

        /// Where both ask for the same they have it, also an arm whose joints have motions that move no camera.
        #[test]
        fn what_both_ask_for_is_done(q in prop::array::uniform7(-1.0..1.0_f64), qd in prop::array::uniform7(-1.0..1.0_f64), weight in 0.01..100.0_f64) {
            let robot: Robot<7> = crate::robot::load("panda").unwrap().build().unwrap();
            let [a, b] = cameras([0.1; 6]);
            let wishes = [wish(&a, &robot, &q.into(), qd.into(), 1.0), wish(&b, &robot, &q.into(), qd.into(), weight)];
            prop_assert!((compromise(&wishes).unwrap().0 - SVector::from(qd)).amax() < 1e-12);
        }
    }

    /// A stretched arm: whatever is asked for, the answer is no larger than what was.
    #[test]
    fn a_singular_posture_keeps_the_compromise_bounded() {
        let robot: Robot<6> = crate::robot::load("ur5").unwrap().build().unwrap();
        let [a, b] = cameras([0.1; 6]);
        for elbow in [0.0, 1e-6, 1e-4, 1e-2] {
            let q = SVector::from([0.3, -1.0, elbow, 0.2, 0.0, 0.5]);
            let ask = |sign: f64| SVector::from([0.5, -0.3, 0.8, 0.1, -0.9, 0.4]) * sign;
            let wishes = [wish(&a, &robot, &q, ask(1.0), 1.0), wish(&b, &robot, &q, ask(-1.0), 3.0)];
            let (qd, _) = compromise(&wishes).unwrap();
            assert!(qd.amax() < 5.0, "{elbow}: {qd}");
        }
    }
}
