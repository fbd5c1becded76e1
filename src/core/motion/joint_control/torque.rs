//! The torques of a tick, within the effort limits.

use crate::linalg::Ldlt;
use crate::robot::Robot;
use nalgebra::SVector;

/// Torques or forces, N m or N.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointTorque<const N: usize> {
    /// What to apply.
    pub tau: SVector<f64, N>,
    /// The joints whose effort limit cut it, as a mask.
    pub saturated: u8,
    /// The joints that do not move and whose torque was bounded, as a mask.
    pub stalled: u8,
}

/// Cuts torques at the effort limits.
pub(super) fn cut<const N: usize>(robot: &Robot<N>, wanted: &SVector<f64, N>) -> JointTorque<N> {
    let (mut tau, mut saturated) = (*wanted, 0);
    for (i, (tau, limit)) in tau.iter_mut().zip(robot.limits()).enumerate() {
        let within = tau.clamp(-limit.effort, limit.effort);
        if within != *tau {
            saturated |= 1 << i;
        }
        *tau = within;
    }
    JointTorque { tau, saturated, stalled: 0 }
}

/// The acceleration of the joints that the torque `tau` makes in the posture `q`.
pub(super) fn acceleration<const N: usize>(
    robot: &Robot<N>,
    q: &SVector<f64, N>,
    tau: &SVector<f64, N>,
) -> SVector<f64, N> {
    if tau.iter().all(|tau| *tau == 0.0) {
        return SVector::zeros();
    }
    Ldlt::of(&robot.mass_matrix(q)).map_or(SVector::zeros(), |factors| factors.solve(&(*tau).into()).into())
}
