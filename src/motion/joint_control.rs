//! From the reference to what a drive obeys.
//!
//! | controller | gives | law, with `e = q_r - q` |
//! | --- | --- | --- |
//! | inverse dynamics | torque | `B(q) (qdd_r + K_D e' + K_P e) + C(q, qd) qd + g(q)`: the arm behaves as double integrators, `e'' + 2 zeta omega e' + omega^2 e = 0` |
//! | PD with gravity compensation | torque | `K_P e + K_D e' + g(q)` |
//! | pass-through | no torque | `q_r`, `qd_r` as they are, for drives that close their own loop |
//!
//! Both torques also carry the friction that the robot file states, `F(qd_r)`: at the reference's velocity, which does
//! not chatter about zero as a measured one does. Without it a light wrist with much friction would lag far behind.

use super::ReferenceState;
use crate::linalg::Ldlt;
use crate::robot::Robot;
use nalgebra::SVector;

/// A joint controller.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum JointController<const N: usize> {
    /// Inverse dynamics in joint space.
    InverseDynamics(InverseDynamicsControl),
    /// PD with gravity compensation.
    PdGravity(PdGravityControl<N>),
    /// The reference itself.
    PassThrough,
}

/// Inverse dynamics control in joint space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InverseDynamicsControl {
    stiffness_1_s2: f64,
    damping_1_s: f64,
}

/// PD control with gravity compensation, each joint with gains of its own.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PdGravityControl<const N: usize> {
    /// K_P, N m/rad or N/m.
    pub stiffness: SVector<f64, N>,
    /// K_D, N m s/rad or N s/m.
    pub damping: SVector<f64, N>,
}

/// Torques or forces, N m or N.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointTorque<const N: usize> {
    /// What to apply.
    pub tau: SVector<f64, N>,
    /// The joints whose effort limit cut it, as a mask.
    pub saturated: u8,
}

impl<const N: usize> JointController<N> {
    /// The torque that gives an arm in (q, qd) the acceleration `qdd`, friction included, cut at the effort limits; zero from
    /// the pass-through.
    #[must_use]
    pub fn torque_for(
        &self,
        robot: &Robot<N>,
        q: &SVector<f64, N>,
        qd: &SVector<f64, N>,
        qdd: &SVector<f64, N>,
    ) -> JointTorque<N> {
        let _ = self;
        within_effort(robot, robot.inverse_dynamics(q, qd, qdd) + robot.friction_torque(qd))
    }

    /// The torque that keeps an arm which cannot be seen on its reference.
    #[must_use]
    pub fn blind_torque(&self, robot: &Robot<N>, reference: &ReferenceState<N>) -> JointTorque<N> {
        self.torque_for(robot, &reference.q, &reference.qd, &reference.qdd)
    }

    /// The torque of a controller that gives one, cut at the effort limits; zero from the pass-through.
    #[must_use]
    pub fn torque(
        &self,
        robot: &Robot<N>,
        q: &SVector<f64, N>,
        qd: &SVector<f64, N>,
        reference: &ReferenceState<N>,
    ) -> JointTorque<N> {
        let tau = match self {
            Self::InverseDynamics(control) => control.torque(robot, q, qd, reference),
            Self::PdGravity(control) => control.torque(robot, q, qd, reference),
            Self::PassThrough => SVector::zeros(),
        };
        within_effort(robot, tau)
    }
}

fn within_effort<const N: usize>(robot: &Robot<N>, mut tau: SVector<f64, N>) -> JointTorque<N> {
    let mut saturated = 0;
    for (i, (tau, limit)) in tau.iter_mut().zip(robot.limits()).enumerate() {
        let cut = tau.clamp(-limit.effort, limit.effort);
        if cut != *tau {
            saturated |= 1 << i;
        }
        *tau = cut;
    }
    JointTorque { tau, saturated }
}

impl InverseDynamicsControl {
    /// A controller with natural frequency `omega_rad_s` and damping ratio `zeta`.
    #[must_use]
    pub fn new(omega_rad_s: f64, zeta: f64) -> Self {
        Self { stiffness_1_s2: omega_rad_s * omega_rad_s, damping_1_s: 2.0 * zeta * omega_rad_s }
    }

    fn torque<const N: usize>(
        &self,
        robot: &Robot<N>,
        q: &SVector<f64, N>,
        qd: &SVector<f64, N>,
        reference: &ReferenceState<N>,
    ) -> SVector<f64, N> {
        let y =
            reference.qdd + (reference.qd - qd) * self.damping_1_s + (reference.q - q) * self.stiffness_1_s2;
        robot.inverse_dynamics(q, qd, &y) + robot.friction_torque(&reference.qd)
    }
}

impl<const N: usize> PdGravityControl<N> {
    /// Gains from natural frequency `omega_rad_s` and damping ratio `zeta` at the posture `q`: `K_P = omega^2 m`,
    /// `K_D = 2 zeta omega m` with `m` the inertia that each joint has while the others are free, `1 / (B^-1)_ii`.
    ///
    /// The inertia with the others locked, `b_ii`, can be many times that, where axes nearly coincide; gains from it
    /// are too stiff for a tick of 1 ms.
    #[must_use]
    pub fn for_posture(robot: &Robot<N>, q: &SVector<f64, N>, omega_rad_s: f64, zeta: f64) -> Self {
        let B = robot.mass_matrix(q);
        let free = Ldlt::of(&B).map_or(B.diagonal(), |factors| {
            let inverse = factors.inverse();
            SVector::from_fn(|i, _| inverse[i][i].recip())
        });
        Self { stiffness: free * (omega_rad_s * omega_rad_s), damping: free * (2.0 * zeta * omega_rad_s) }
    }

    fn torque(
        &self,
        robot: &Robot<N>,
        q: &SVector<f64, N>,
        qd: &SVector<f64, N>,
        reference: &ReferenceState<N>,
    ) -> SVector<f64, N> {
        self.stiffness.component_mul(&(reference.q - q))
            + self.damping.component_mul(&(reference.qd - qd))
            + robot.gravity(q)
            + robot.friction_torque(&reference.qd)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::ActingLimits;
    use nalgebra::Vector6;
    use proptest::prelude::*;

    fn at_rest(q: Vector6<f64>) -> ReferenceState<6> {
        let zero = Vector6::zeros();
        ReferenceState { q, qd: zero, qdd: zero, a: zero, limits: ActingLimits::default() }
    }

    fn ur5() -> Robot<6> {
        crate::robot::load("ur5").unwrap().build().unwrap()
    }

    proptest! {
        /// The closed loop of inverse dynamics: `qdd = qdd_r + K_D e' + K_P e`, whatever the posture and the speed.
        #[test]
        fn inverse_dynamics_makes_double_integrators(
            q in prop::array::uniform6(-1.5..1.5f64), qd in prop::array::uniform6(-0.5..0.5f64)
        ) {
            let (robot, q, qd) = (ur5(), Vector6::from(q), Vector6::from(qd));
            let reference = at_rest(q.add_scalar(1e-3));
            let control = InverseDynamicsControl::new(20.0, 0.7);
            let tau = control.torque(&robot, &q, &qd, &reference);
            let qdd = robot.forward_dynamics(&q, &qd, &tau);
            let wanted = Vector6::repeat(400.0 * 1e-3) - qd * 28.0;
            prop_assert!((qdd - wanted).amax() < 1e-8 * (1.0 + wanted.amax()), "{qdd} {wanted}");
        }

        /// PD with gravity compensation brings a still arm to its reference without a lasting error.
        #[test]
        fn pd_holds_the_reference_against_gravity(q in prop::array::uniform6(-1.5..1.5f64)) {
            let (robot, q) = (ur5(), Vector6::from(q));
            let control = PdGravityControl::for_posture(&robot, &q, 20.0, 1.0);
            let reference = at_rest(q.add_scalar(0.01));
            let (mut at, mut v) = (q, Vector6::zeros());
            for _ in 0..4000 {
                let tau = control.torque(&robot, &at, &v, &reference);
                v += robot.forward_dynamics(&at, &v, &tau) * 1e-3;
                at += v * 1e-3;
            }
            prop_assert!((at - reference.q).amax() < 1e-4, "{}", at - reference.q);
        }
    }

    #[test]
    fn effort_limits_cut_and_tell_the_joint() {
        let robot = ur5();
        let q = Vector6::new(0.0, -1.0, 1.0, 0.0, 0.0, 0.0);
        let far = at_rest(q + Vector6::new(0.0, 0.0, 0.0, 0.0, 0.0, 100.0));
        let control = PdGravityControl { stiffness: Vector6::repeat(50.0), damping: Vector6::repeat(1.0) };
        let torque = JointController::PdGravity(control).torque(&robot, &q, &Vector6::zeros(), &far);
        assert_eq!(torque.saturated, 0b10_0000);
        assert_eq!(torque.tau[5], robot.limits()[5].effort);
        let through = JointController::PassThrough.torque(&robot, &q, &Vector6::zeros(), &far);
        assert_eq!((through.tau, through.saturated), (Vector6::zeros(), 0));
    }
}
