//! The target changes between two goals: nothing that was measured of the old one says anything about the new one. From where each of them was last seen
//! whole is kept, so that the arm can go back there when it is looked for again.

use super::VisualServo;
use crate::servo::first_motion::FirstMotion;
use crate::servo::motion_agreement::MotionAgreement;
use crate::servo::{MeasurementVerdict, ObjectMotion};
use nalgebra::SVector;

/// Most targets of a run. Chosen by hand: each takes the memory of a finder, a few megabytes for a VGA camera, and a cell has a part, a place and a bin.
pub const MAX_TARGETS: usize = 16;
/// So many measurements of another target that none of it was used of say that it is out of view. Chosen by hand: a single frame may be lost to a passing
/// shadow, and three are 120 ms at 25 Hz, in which the arm brakes anyway.
pub(super) const MISSES: u32 = 3;

impl<const N: usize> VisualServo<N> {
    /// Forgets all that was seen: view, depths, and the motion of the object. What is kept concerns the arm and the camera: the joint history, whether the image
    /// was seen to move as the mount says, and from where each target was seen.
    pub(super) fn forget_target(&mut self) {
        (self.last, self.whole, self.initial) = (None, None, None);
        (self.held, self.start, self.drift, self.fresh) = (None, None, None, false);
        self.sought = Some(0);
        self.object = self.settings.object.map(ObjectMotion::new);
        if self.agreement.interrupt() {
            (self.agreement, self.first_motion) = (MotionAgreement::default(), FirstMotion::default());
        }
    }

    /// Takes in what became of a measurement of the goal's target.
    pub(super) fn note_sought(&mut self, verdict: MeasurementVerdict) {
        self.sought = self.sought.filter(|_| !verdict.is_used()).map(|misses| misses.saturating_add(1));
    }

    /// Whether a goal of another target was set, of which no measurement was used yet.
    #[must_use]
    pub fn looks_for_another(&self) -> bool {
        self.sought.is_some()
    }

    /// Whether the newest measurement says that such a target is out of view, and it was never seen whole: nobody knows where it is.
    #[must_use]
    pub fn knows_no_place(&self) -> bool {
        self.sought.is_some_and(|misses| misses >= MISSES) && self.posture_seen_whole().is_none()
    }

    /// The posture from which the goal's target was last seen whole, rad or m.
    pub(super) fn posture_seen_whole(&self) -> Option<SVector<f64, N>> {
        self.q_whole.get(self.goal.target() as usize).copied().flatten()
    }

    /// The goal's target was seen whole from the posture `q`, rad or m.
    pub(super) fn seen_whole_at(&mut self, q: &SVector<f64, N>) {
        if let Some(place) = self.q_whole.get_mut(self.goal.target() as usize) {
            *place = Some(*q);
        }
    }
}
