//! Joints whose encoders are not trusted.

use super::JointObserver;
use nalgebra::SVector;

impl<const N: usize> JointObserver<N> {
    /// Position and velocity at the last tick, and the accelerations that the command makes until the next; `None` while none acts.
    pub(in crate::motion) fn expected_motion(
        &self,
    ) -> Option<(SVector<f64, N>, SVector<f64, N>, SVector<f64, N>)> {
        let ((q, qd), commanded) = (self.state?, self.commanded?);
        let qdd = commanded.u + self.a + commanded.feedback.component_div(&self.settings.inertia);
        Some((q, qd, qdd))
    }

    /// The joints whose encoders are not trusted.
    pub(in crate::motion) fn unheard(&self) -> [bool; N] {
        self.unheard
    }

    /// Learns nothing more from joints whose encoders are not trusted, and forgets what was learnt since their readings last changed.
    pub(in crate::motion) fn distrust(&mut self, joints: [bool; N]) {
        if joints != self.unheard {
            self.unheard = joints;
            self.forget_unheard();
        }
    }

    /// Sets the disturbance of joints that are not trusted to what it was when their readings last changed.
    pub(super) fn forget_unheard(&mut self) {
        for i in (0..N).filter(|i| self.unheard[*i]) {
            (self.p[i], self.t[i]) = (self.heard.1[i], self.heard.2[i]);
        }
    }
}
