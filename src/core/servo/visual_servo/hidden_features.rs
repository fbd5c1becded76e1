//! What a view lacks is predicted from the last complete one.

use super::{View, VisualServo};
use crate::geometry::Pose;
use crate::time::{MonoNs, SpanNs};
use nalgebra::Matrix6;

/// How long hidden features are predicted by the arm's motion from the last complete view. Chosen by hand.
const LONGEST_GUESS: SpanNs = SpanNs(3_000_000_000);
/// Root mean square distance, normalized, of visible features from their prediction by that motion, beyond which the object has
/// moved, or the calibration of the camera's mount is wrong: 24 px of a lens of 800 px. Chosen by hand; no unit test of servo comes to it.
const MAX_CONTRADICTION: f64 = 0.03;
/// Standard deviation of the features of a view with predicted ones, normalized: half a pixel of a lens of 800 px. Chosen by hand.
const SD_OF_A_GUESS: f64 = 6e-4;

impl<const N: usize> VisualServo<N> {
    /// Completes a view in which so much is hidden that it has no pose: hidden features are predicted from the last complete view by the arm's
    /// known motion (and the object's, where it is estimated); the pose is that of least reprojection error for all features. `None` when there
    /// is no complete view that is recent enough, or prediction and visible features contradict each other.
    pub(super) fn completed_by_motion(
        &self,
        seen: &View,
        exposure: MonoNs,
        X_WC: &Pose,
    ) -> Option<(View, Matrix6<f64>)> {
        let set_point = &self.goal;
        let whole = self.whole.as_ref().filter(|whole| exposure - whole.exposure <= LONGEST_GUESS)?;
        // An object at rest is predicted from the last complete view; one that moves is predicted from frame to frame, so that what
        // is wrong with its estimated speed does not add up before it is put right.
        let from = if self.object.is_some() { self.last.as_ref()? } else { whole };
        let moved = self.object.as_ref().map(|object| object.displacement(from.exposure, exposure));
        let X_WC_then = moved.map_or(from.X_WC, |moved| moved * from.X_WC);
        let guess = from.view.predicted_at(&X_WC.inv_mul(&X_WC_then), set_point)?;
        seen.with_hidden_of(&guess, set_point, (MAX_CONTRADICTION, SD_OF_A_GUESS))
    }
}
