//! What the first motion tells of the mount, and how it is made: slowly, with a pause or a small motion of its own where the law's tells too little ([`MotionAgreement`](crate::servo::motion_agreement)).

use super::{LawAnswer, VisualServo};
use crate::geometry::Pose;
use crate::robot::{CameraJacobian, Robot};
use crate::servo::first_motion::REACH_M;
use crate::servo::{CameraError, Convergence, LawOutput, TwistTask, joint_velocity};
use nalgebra::{Matrix6, SVector, Vector6};

/// Rate at which a small motion of its own would converge, 1/s, by which the arm could brake before its end. Chosen by hand: that of the way back to a view.
const RATE_1_S: f64 = super::RETURN_RATE_1_S;
/// Least share of a turn of the camera that the arm has to make of the one that it is told. Chosen by hand: an arm that cannot turn about an axis makes none.
const TURNS: f64 = 0.7;

impl<const N: usize> VisualServo<N> {
    /// The same where the arm goes by another law, too, so that none moves it alone.
    #[must_use]
    pub fn beside_another(self) -> Self {
        Self { agreement: self.agreement.without_probes(), ..self }
    }

    /// How the camera's mount or lens is wrong, by how the image moved with the arm's first motion; `None` where it is not.
    #[must_use]
    pub fn camera_error(&self) -> Option<CameraError> {
        self.agreement.error()
    }

    /// Whether a small motion of the camera is under way that tells a wrong mount from one that is askew.
    pub(crate) fn tries_mount(&self) -> bool {
        self.agreement.probes()
    }

    /// Whether a small turn of the camera is under way that tells a lens which is not as told from a target that is.
    pub(crate) fn tries_lens(&self) -> bool {
        self.agreement.tries_lens()
    }

    /// The share of the joint velocity `qd` (rad/s or m/s), 0 to 1, with which the `first` motion of a camera at a pose with a Jacobian is slow enough
    /// ([`first_motion_m_s`](crate::servo::ServoSettings::first_motion_m_s)). 0 while it waits to see whether the object moves; 1 where the object moves or the Jacobian is learnt, since then nothing is known of how the image should move.
    pub fn first_motion_share(&mut self, qd: &SVector<f64, N>, first: (&Pose, &CameraJacobian<N>)) -> f64 {
        if self.agreement.pauses() {
            return 0.0;
        }
        let foretold = self.object.is_none() && self.learner.is_none();
        match self.settings.first_motion_m_s.filter(|_| foretold) {
            Some(speed) => self.first_motion.share(qd, first, speed, self.agreement.is_judged()),
            None => 1.0,
        }
    }

    /// What takes the place of the law's output while mount or lens are tried by a small motion: one of the camera without a turn, or without a way, as far as the arm can.
    pub(super) fn probing(&mut self, q: &SVector<f64, N>, robot: &Robot<N>) -> Option<LawAnswer<N>> {
        let (X_WC, J) = self.settings.mount.camera(robot, q);
        let (v_C, w_C) = self.agreement.probe_twist_C(&X_WC)?;
        let turn = REACH_M * REACH_M;
        let task = TwistTask {
            matrix: Matrix6::from_diagonal(&Vector6::new(1.0, 1.0, 1.0, turn, turn, turn)),
            vector: Vector6::new(v_C.x, v_C.y, v_C.z, turn * w_C.x, turn * w_C.y, turn * w_C.z),
            error: v_C.norm().hypot(REACH_M * w_C.norm()),
        };
        // An arm that cannot stands until it is judged.
        let qd = joint_velocity(&task, 1.0, &J).unwrap_or_else(SVector::zeros);
        if (J.matrix() * qd).fixed_rows::<3>(3).dot(&w_C) < TURNS * w_C.norm_squared() {
            self.agreement.cannot_turn();
        }
        Some(LawAnswer { law_output: LawOutput::Velocity(qd), convergence: Convergence::at(RATE_1_S) })
    }
}
