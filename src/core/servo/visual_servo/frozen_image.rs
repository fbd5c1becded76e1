//! An image that does not change while the camera moves: a camera that repeats one image under new stamps. Of objects that are known to move it is not looked for, since an arm that follows one
//! well sees one image.

use super::{LastMeasurement, View, VisualServo};
use crate::geometry::Pose;
use crate::messages::Measurement;
use nalgebra::Vector2;

/// Features that stay within this of those before, normalized, are those before: a thousandth of a pixel of a lens of 800 px. Derived from noise: a good measurement
/// scatters by 0.01 px and more, so that four points stay within it in all their eight coordinates once in 1e10 frames (0.06^8).
const SAME: f64 = 1.25e-6;
/// The motion of the camera, in the image, normalized, from which on it would have been seen: 2 px of a lens of 800 px, above what an arm at rest does. Chosen by hand.
const WOULD_BE_SEEN: f64 = 2.5e-3;
/// Points that have to be the same. Chosen by hand: by fewer, chance would tell.
const POINTS: usize = 4;

/// Whether the features are said to have noise, so that no two images are the same: those of a camera that is computed have none, and late stamps are no frozen camera.
fn has_noise(measurement: &Measurement) -> bool {
    measurement.features.iter().take(measurement.feature_count as usize).all(|feature| feature.sd_px > 0.0)
}

impl<const N: usize> VisualServo<N> {
    /// The pose of the camera at the first exposure that showed exactly what `seen` shows, now that it is at `X_WC`; `None` where the image should have changed since.
    pub(super) fn first_shown_from(
        &self,
        measurement: &Measurement,
        seen: &View,
        X_WC: &Pose,
    ) -> Option<Pose> {
        let repeated = self.repeated(seen).filter(|_| self.object.is_none() && has_noise(measurement));
        match repeated {
            Some(before) if self.would_have_changed(before, seen, X_WC) => None,
            Some(before) => Some(before.first_X_WC),
            None => Some(*X_WC),
        }
    }

    /// The last measurement, where `seen` shows exactly the same.
    fn repeated(&self, seen: &View) -> Option<&LastMeasurement> {
        let last = self.last.as_ref().filter(|last| !last.supposed)?;
        let before = last.view.features();
        let is_same = |(i, s): (usize, Vector2<f64>)| before.get(i).is_some_and(|b| (s - b).amax() <= SAME);
        (seen.seen().count() >= POINTS && seen.seen().all(is_same)).then_some(last)
    }

    /// Whether the camera, now at `X_WC`, has moved so far since it first showed what `seen` repeats that it would show something else. Such an image says nothing of where the object is
    /// now; followed, it leads the arm away for as long as it lasts. The motion counts from the first of a series: an arm that creeps moves too little from one to the next.
    fn would_have_changed(&self, before: &LastMeasurement, seen: &View, X_WC: &Pose) -> bool {
        let Some(moved) = before.view.predicted_at(&X_WC.inv_mul(&before.first_X_WC), &self.goal) else {
            return false;
        };
        let far = |(i, s): (usize, Vector2<f64>)| {
            moved.feature(i).is_some_and(|at| (at - s).amax() > WOULD_BE_SEEN)
        };
        seen.seen().any(far)
    }
}
