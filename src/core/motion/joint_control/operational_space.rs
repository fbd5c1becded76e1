//! Inverse dynamics control in operational space (Sect. 8.6.3): the error of the flange's pose, and not that of the joints, decays as the gains say.
//!
//! With x the flange's pose, V its twist and J its Jacobian, all in B, and the reference of the joints `q_r`, `qd_r`, `qdd_r`:
//!
//! ```text
//! a = J_r qdd_r + J_r' qd_r + 2 zeta omega (J_r qd_r - J qd) + omega^2 x~,   x~ = [p_r - p; axis times angle of R_r R^T]
//! y = y_q + J^+ (a - J' qd - J y_q),   u = B(q) y + n(q, qd)
//! ```
//! `y_q` is the acceleration of the law in joint space. With six joints `y = J^-1 (a - J' qd)`; with more, `y_q` moves what the pose leaves free; with fewer,
//! y is the least-squares solution, metre against radian. Near a singular posture, where `J^+` is damped, y goes over into `y_q`.

use super::law::InverseDynamicsControl;
use crate::geometry::{Twist, angle_axis};
use crate::motion::ReferenceState;
use crate::robot::{CameraJacobian, Robot};
use crate::servo::{TwistTask, joint_velocity};
use nalgebra::{Matrix6, SMatrix, SVector, Vector3};

impl InverseDynamicsControl {
    /// The joint acceleration y, rad/s^2 or m/s^2, of an arm in `q` that moves at `qd`; `y_q` is that of the law in joint space.
    pub(super) fn in_operational_space<const N: usize>(
        &self,
        robot: &Robot<N>,
        (q, qd): (&SVector<f64, N>, &SVector<f64, N>),
        reference: &ReferenceState<N>,
        y_q: &SVector<f64, N>,
    ) -> SVector<f64, N> {
        let (X, X_r) = (robot.forward(q), robot.forward(&reference.q));
        let (J, J_r) = (robot.jacobian(q), robot.jacobian(&reference.q));
        let p = X_r.translation.vector - X.translation.vector;
        let turn = angle_axis(&(X_r.rotation * X.rotation.inverse()).to_rotation_matrix());
        let x = Twist::new(p.x, p.y, p.z, turn.x, turn.y, turn.z);
        let (k_P, k_D) = (self.omega_rad_s * self.omega_rad_s, 2.0 * self.zeta * self.omega_rad_s);
        let a = J_r * reference.qdd
            + acceleration_of_motion(&J_r, &reference.qd)
            + (J_r * reference.qd - J * qd) * k_D
            + x * k_P;
        let missing = a - acceleration_of_motion(&J, qd) - J * y_q;
        let task = TwistTask { matrix: Matrix6::identity(), vector: missing, error: missing.norm() };
        joint_velocity(&task, 1.0, &CameraJacobian::of_moving_camera(J)).map_or(*y_q, |y| y_q + y)
    }
}

/// `J' qd`, m/s^2 and rad/s^2: the acceleration of the flange while the joints move at constant `qd`, for its geometric Jacobian J in B.
///
/// With the columns `[v_i; w_i]` of J a motion of joint j changes column i by `[w_j x v_i; w_j x w_i]` for `j <= i`, which turns its axis and arm, and by
/// `[w_i x v_j; 0]` for the others, which move the flange alone.
fn acceleration_of_motion<const N: usize>(J: &SMatrix<f64, 6, N>, qd: &SVector<f64, N>) -> Twist {
    let V = J * qd;
    let (mut v_after, mut w_until) = (Vector3::new(V.x, V.y, V.z), Vector3::zeros());
    let (mut linear, mut angular) = (Vector3::zeros(), Vector3::zeros());
    for (column, rate) in J.column_iter().zip(qd.iter()) {
        let v = Vector3::new(column[0], column[1], column[2]) * *rate;
        let w = Vector3::new(column[3], column[4], column[5]) * *rate;
        v_after -= v;
        w_until += w;
        linear += w_until.cross(&v) + w.cross(&v_after);
        angular += w_until.cross(&w);
    }
    Twist::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::ActingLimits;
    use proptest::prelude::*;

    fn robot<const N: usize>(name: &str) -> Robot<N> {
        crate::robot::load(name).unwrap().build().unwrap()
    }

    /// `J' qd` by differences of J, of fourth order.
    fn by_differences<const N: usize>(robot: &Robot<N>, q: &SVector<f64, N>, qd: &SVector<f64, N>) -> Twist {
        let h = 1e-3;
        let J = |k: f64| robot.jacobian(&(q + qd * (k * h)));
        ((J(1.0) - J(-1.0)) * (8.0 / 12.0) - (J(2.0) - J(-2.0)) / 12.0) / h * qd
    }

    fn reference<const N: usize>(
        q: SVector<f64, N>,
        qd: SVector<f64, N>,
        qdd: SVector<f64, N>,
    ) -> ReferenceState<N> {
        ReferenceState { q, qd, qdd, a: qdd, limits: ActingLimits::default() }
    }

    /// The task as the text states it, by differences and dense matrices: `a` of the module's head.
    fn wanted<const N: usize>(
        robot: &Robot<N>,
        (q, qd): (&SVector<f64, N>, &SVector<f64, N>),
        r: &ReferenceState<N>,
        (omega, zeta): (f64, f64),
    ) -> Twist {
        let (T, T_r) = (robot.forward(q).to_homogeneous(), robot.forward(&r.q).to_homogeneous());
        let R = T_r.fixed_view::<3, 3>(0, 0) * T.fixed_view::<3, 3>(0, 0).transpose();
        let angle = ((R.trace() - 1.0) / 2.0).acos();
        let axis = Vector3::new(R[(2, 1)] - R[(1, 2)], R[(0, 2)] - R[(2, 0)], R[(1, 0)] - R[(0, 1)]);
        let (p, turn) =
            (T_r.fixed_view::<3, 1>(0, 3) - T.fixed_view::<3, 1>(0, 3), axis * (angle / (2.0 * angle.sin())));
        let x = Twist::new(p[0], p[1], p[2], turn.x, turn.y, turn.z);
        let (J, J_r) = (robot.jacobian(q), robot.jacobian(&r.q));
        J_r * r.qdd
            + by_differences(robot, &r.q, &r.qd)
            + (J_r * r.qd - J * qd) * (2.0 * zeta * omega)
            + x * (omega * omega)
    }

    proptest! {
        #[test]
        fn the_motion_of_the_jacobian_is_that_of_differences(q in prop::array::uniform7(-2.0..2.0f64), qd in prop::array::uniform7(-1.0..1.0f64)) {
            fn check<const N: usize>(name: &str, q: [f64; 7], qd: [f64; 7]) -> Result<(), TestCaseError> {
                let robot = robot::<N>(name);
                let (q, qd) = (SVector::from_fn(|i, _| q[i]), SVector::from_fn(|i, _| qd[i]));
                let (found, by) = (acceleration_of_motion(&robot.jacobian(&q), &qd), by_differences(&robot, &q, &qd));
                prop_assert!((found - by).amax() < 1e-9, "{name}: {found} {by}");
                Ok(())
            }
            check::<4>("scara", q, qd)?;
            check::<6>("ur5", q, qd)?;
            check::<7>("panda", q, qd)?;
        }

        /// Against the form `u = J^T (J^-T B J^-1) (a - J' qd) + n`, with J inverted densely, to 1e-8.
        #[test]
        fn torques_are_those_of_the_inertia_in_operational_space(
            q in prop::array::uniform6(-1.5..1.5f64), qd in prop::array::uniform6(-1.0..1.0f64), off in prop::array::uniform6(-0.02..0.02f64),
            fast in prop::array::uniform6(-1.0..1.0f64), qdd in prop::array::uniform6(-3.0..3.0f64), omega in 5.0..60.0f64, zeta in 0.5..1.5f64
        ) {
            let robot = robot::<6>("ur5");
            let [q, qd, off, fast, qdd]: [SVector<f64, 6>; 5] = [q, qd, off, fast, qdd].map(SVector::from);
            let J = robot.jacobian(&q);
            let J_inverse = J.try_inverse().filter(|inverse| inverse.norm() < 50.0);
            prop_assume!(J_inverse.is_some() && off.norm() > 1e-4);
            let J_inverse = J_inverse.unwrap();
            let r = reference(q + off, fast, qdd);
            let a = wanted(&robot, (&q, &qd), &r, (omega, zeta)) - by_differences(&robot, &q, &qd);
            let inertia = J_inverse.transpose() * robot.mass_matrix(&q) * J_inverse;
            let n = robot.inverse_dynamics(&q, &qd, &SVector::zeros());
            let by_inertia = J.transpose() * inertia * a + n;
            let y_q = SVector::from_fn(|i, _| i as f64 - 2.5);
            let y = InverseDynamicsControl::new(omega, zeta).in_operational_space(&robot, (&q, &qd), &r, &y_q);
            let u = robot.inverse_dynamics(&q, &qd, &y);
            prop_assert!((u - by_inertia).amax() < 1e-8 * (1.0 + by_inertia.amax()), "{u} {by_inertia}");
        }

        /// Seven joints: the flange accelerates as the task has it, and what is left of the joints' own acceleration does not move it.
        #[test]
        fn more_joints_leave_their_own_motion(
            qd in prop::array::uniform7(-0.5..0.5f64), off in prop::array::uniform7(-0.02..0.02f64), y_q in prop::array::uniform7(-2.0..2.0f64)
        ) {
            let robot = robot::<7>("panda");
            let q = SVector::<f64, 7>::from([-0.17, -0.48, -0.2, -1.53, 0.08, 1.8, 0.17]);
            let [qd, off, y_q]: [SVector<f64, 7>; 3] = [qd, off, y_q].map(SVector::from);
            prop_assume!(off.norm() > 1e-4);
            let r = reference(q + off, SVector::zeros(), SVector::zeros());
            let y = InverseDynamicsControl::new(20.0, 0.7).in_operational_space(&robot, (&q, &qd), &r, &y_q);
            let J = robot.jacobian(&q);
            let a = wanted(&robot, (&q, &qd), &r, (20.0, 0.7));
            prop_assert!((J * y + by_differences(&robot, &q, &qd) - a).amax() < 1e-8 * (1.0 + a.amax()));
            let free = y - y_q;
            let smallest = J.transpose() * (J * J.transpose()).try_inverse().unwrap() * (J * free);
            prop_assert!((free - smallest).amax() < 1e-8 * (1.0 + free.amax()));
        }
    }

    /// At a singular posture the law is that of the joints, and nothing is large.
    #[test]
    fn a_singular_posture_keeps_it_finite() {
        let robot = robot::<6>("ur5");
        let q = SVector::<f64, 6>::from([0.3, -1.2, 1.0, -1.4, 0.0, 0.2]);
        let r = reference(q.add_scalar(1e-3), SVector::zeros(), SVector::zeros());
        let y_q = (r.q - q) * 400.0;
        let y = InverseDynamicsControl::new(20.0, 1.0).in_operational_space(
            &robot,
            (&q, &SVector::zeros()),
            &r,
            &y_q,
        );
        assert!((y - y_q).amax() < 0.5 * y_q.amax(), "{y} {y_q}");
    }
}
