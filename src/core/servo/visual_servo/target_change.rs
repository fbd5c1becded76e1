//! The target changes between two goals: nothing that was measured of the old one says anything about the new one.

use super::VisualServo;
use crate::servo::ObjectMotion;
use crate::servo::first_motion::FirstMotion;
use crate::servo::motion_agreement::MotionAgreement;

impl<const N: usize> VisualServo<N> {
    /// Forgets all that was seen: view, way back, depths, and the motion of the object. What is kept concerns the arm and the camera: the joint history, and
    /// whether the image was seen to move as the mount says.
    pub(super) fn forget_target(&mut self) {
        (self.last, self.whole, self.initial, self.q_whole) = (None, None, None, None);
        (self.held, self.start, self.drift, self.fresh) = (None, None, None, false);
        self.object = self.settings.object.map(ObjectMotion::new);
        if self.agreement.interrupt() {
            (self.agreement, self.first_motion) = (MotionAgreement::default(), FirstMotion::default());
        }
    }
}
