//! The feedback laws of the joint controller.

use crate::linalg::Ldlt;
use crate::motion::ReferenceState;
use crate::robot::Robot;
use crate::time::TICK;
use nalgebra::SVector;

/// The feedback law of a joint controller.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum JointLaw<const N: usize> {
    /// Inverse dynamics in joint space.
    InverseDynamics(InverseDynamicsControl),
    /// Inverse dynamics in operational space: the pose of the flange.
    OperationalSpace(InverseDynamicsControl),
    /// PD with gravity compensation.
    PdGravity(PdGravityControl<N>),
    /// The reference itself.
    PassThrough,
}

/// Inverse dynamics control: of the joints, or of the pose of the flange.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InverseDynamicsControl {
    pub(super) omega_rad_s: f64,
    pub(super) zeta: f64,
}

/// PD control with gravity compensation, each joint with gains of its own.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PdGravityControl<const N: usize> {
    /// K_P, N m/rad or N/m.
    pub stiffness: SVector<f64, N>,
    /// K_D, N m s/rad or N s/m.
    pub damping: SVector<f64, N>,
    /// Rate at which an error decays against viscous friction alone, 1/s.
    pub rate_1_s: f64,
}

/// The output of a feedback law.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Feedback<const N: usize> {
    /// Acceleration.
    pub(super) u: SVector<f64, N>,
    /// The part of it that the reference requires.
    pub(super) expected: SVector<f64, N>,
    /// Additional torque.
    pub(super) torque: SVector<f64, N>,
    /// Velocity at the end of the step, for which friction is compensated.
    pub(super) velocity: SVector<f64, N>,
    /// Velocity at which the error is to decay: viscous friction is compensated for it too.
    pub(super) slip: SVector<f64, N>,
}

impl<const N: usize> JointLaw<N> {
    /// The feedback to the position error `e` and the velocity error `ed`.
    pub(super) fn feedback(
        &self,
        e: &SVector<f64, N>,
        ed: &SVector<f64, N>,
        reference: &ReferenceState<N>,
    ) -> Feedback<N> {
        let velocity = reference.qd + reference.qdd * TICK.as_s();
        let zero = SVector::zeros();
        match self {
            // In operational space the joints' own acceleration is what is left where the pose leaves motion free.
            Self::InverseDynamics(InverseDynamicsControl { omega_rad_s, zeta })
            | Self::OperationalSpace(InverseDynamicsControl { omega_rad_s, zeta }) => Feedback {
                u: reference.qdd + ed * (2.0 * zeta * omega_rad_s) + e * (omega_rad_s * omega_rad_s),
                expected: reference.qdd,
                torque: zero,
                velocity,
                slip: e * *omega_rad_s,
            },
            Self::PdGravity(control) => Feedback {
                u: reference.qdd,
                expected: reference.qdd,
                torque: control.stiffness.component_mul(e) + control.damping.component_mul(ed),
                velocity,
                slip: e * control.rate_1_s,
            },
            Self::PassThrough => {
                Feedback { u: zero, expected: zero, torque: zero, velocity: zero, slip: zero }
            }
        }
    }
}

impl InverseDynamicsControl {
    /// A controller with natural frequency `omega_rad_s` and damping ratio `zeta`.
    #[must_use]
    pub fn new(omega_rad_s: f64, zeta: f64) -> Self {
        Self { omega_rad_s, zeta }
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
        Self {
            stiffness: free * (omega_rad_s * omega_rad_s),
            damping: free * (2.0 * zeta * omega_rad_s),
            rate_1_s: omega_rad_s,
        }
    }
}
