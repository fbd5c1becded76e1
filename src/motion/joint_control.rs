//! Joint controller by inverse dynamics: the arm behaves as double integrators and follows the reference with
//! `e'' + 2 zeta omega e' + omega^2 e = 0`, `e = q_r - q`.

use super::ReferenceState;
use crate::robot::Robot;
use nalgebra::SVector;

/// Inverse dynamics control in joint space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InverseDynamicsControl {
    stiffness_1_s2: f64,
    damping_1_s: f64,
}

/// Torques or forces, N m or N.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointTorque<const N: usize> {
    /// What to apply.
    pub tau: SVector<f64, N>,
    /// Whether an effort limit cut it.
    pub saturated: bool,
}

impl InverseDynamicsControl {
    /// A controller with natural frequency `omega_rad_s` and damping ratio `zeta`.
    #[must_use]
    pub fn new(omega_rad_s: f64, zeta: f64) -> Self {
        Self { stiffness_1_s2: omega_rad_s * omega_rad_s, damping_1_s: 2.0 * zeta * omega_rad_s }
    }

    /// `tau = B(q) (qdd_r + K_D (qd_r - qd) + K_P (q_r - q)) + C(q, qd) qd + g(q) + friction(qd_r)`, cut at the effort limits.
    #[must_use]
    pub fn torque<const N: usize>(
        &self,
        robot: &Robot<N>,
        q: &SVector<f64, N>,
        qd: &SVector<f64, N>,
        reference: &ReferenceState<N>,
    ) -> JointTorque<N> {
        let y =
            reference.qdd + (reference.qd - qd) * self.damping_1_s + (reference.q - q) * self.stiffness_1_s2;
        // Friction by the reference's velocity: the measured one would feed its noise back through the Coulomb part.
        let mut tau = robot.inverse_dynamics(q, qd, &y) + robot.friction_torque(&reference.qd);
        let mut saturated = false;
        for (tau, limit) in tau.iter_mut().zip(robot.limits()) {
            let cut = tau.clamp(-limit.effort, limit.effort);
            saturated |= cut != *tau;
            *tau = cut;
        }
        JointTorque { tau, saturated }
    }
}
