//! Tells a misfit that stays from one that comes suddenly.
//!
//! A lens, a target or a shutter that is not as described leaves reprojection errors that change as slowly as the view: they are model errors, and image-based
//! laws converge in spite of them. A shadow, a hand or glare leaves errors that were not there in the frame before: that one frame is wrong. A misfit
//! that stays for [`ENOUGH`] frames is accepted from then on, as far as it does not leap.

use super::misfit::largest;
use nalgebra::Vector2;

/// So many frames with the same errors tell a model error. At 25 Hz the third comes 0.14 s after the last measurement, before `safety.slow_down_from` of
/// `safety.measurement_timeout_ms` slows the arm down (0.15 s), so that it is chosen no larger. What moves through a view changes from frame to frame by more than [`CHANGE`].
const ENOUGH: u32 = 3;
/// Share of the misfit by which it may change from frame to frame. What moves over a dot changes it from nothing to all within some frames; an arm that
/// moves changes the misfit of a wrong lens as little as the view. Chosen by hand between the two.
const CHANGE: f64 = 0.3;
/// Largest misfit, as a share of the target's extent in the image (root mean square distance of its points from their centre). Chosen by hand: points of another
/// object, or mistaken ones, leave tenths of it, and a wrong lens a few hundredths at most where a tilted target fills the image.
const MAX_SHARE: f64 = 0.04;
/// Factor by which the misfit may grow beyond the largest of the last second before it has to be found steady anew. Chosen by hand: three frames of [`CHANGE`].
const GROWS: f64 = 2.0;
/// Share of the accepted misfit that is kept per frame: half of it after 35 frames, 1.4 s at 25 Hz. An arm that passes a frontal view, in which a wrong lens shows
/// nothing, does not have to stop behind it. Chosen by hand.
const KEPT: f64 = 0.98;

/// Reprojection errors by the points' ids, px, ids rising.
pub(super) type Errors = Vec<(u32, Vector2<f64>)>;

/// Reprojection errors of the last frames, and how long they have been alike.
#[derive(Debug, Clone, Default)]
pub(super) struct SteadyMisfit {
    /// Those of the last frame, and of the last one that was accepted.
    last: Errors,
    accepted: Errors,
    /// Frames in a row that had nearly the same.
    frames: u32,
    /// The accepted misfit, root mean square over the points, px; zero while the description fits.
    accepted_px: f64,
}

impl SteadyMisfit {
    pub(super) fn with_room_for(count: usize) -> Self {
        Self { last: Vec::with_capacity(count), accepted: Vec::with_capacity(count), ..Self::default() }
    }

    /// Root mean square reprojection error, px, that is accepted in addition to what noise explains.
    pub(super) fn allowance_px(&self) -> f64 {
        GROWS * self.accepted_px
    }

    /// Whether a model error is known.
    pub(super) fn is_known(&self) -> bool {
        self.accepted_px > 0.0
    }

    /// Forgets the last frame, but not that the description is wrong: the target was lost, or fits without an allowance.
    pub(super) fn interrupt(&mut self) {
        self.last.clear();
        self.frames = 0;
    }

    /// Takes in the reprojection errors of a frame, whose points have the variance `variance_px2` in each coordinate. Whether they are those of the last
    /// accepted frame, as far as noise and motion explain.
    pub(super) fn note(&mut self, errors: &Errors, variance_px2: f64) -> bool {
        let stays = are_alike(errors, &self.last, variance_px2);
        self.frames = if stays { self.frames.saturating_add(1) } else { 1 };
        self.last.clone_from(errors);
        self.is_known() && are_alike(errors, &self.accepted, variance_px2)
    }

    /// Whether the errors have been alike for long enough to be a model error of a target with this extent in the image, px.
    pub(super) fn is_steady(&self, extent_px: f64) -> bool {
        self.frames >= ENOUGH && mean_square(&self.last).sqrt() <= MAX_SHARE * extent_px
    }

    /// Accepts the misfit of the last frame, whose points have the variance `variance_px2` in each coordinate.
    pub(super) fn accept(&mut self, variance_px2: f64) {
        self.accepted.clone_from(&self.last);
        let px = mean_square(&self.last).sqrt();
        self.accepted_px = px.max(KEPT * self.accepted_px);
        // What noise explains needs no allowance.
        if self.accepted_px * self.accepted_px < 2.0 * variance_px2 {
            self.accepted_px = 0.0;
        }
    }
}

/// Whether two frames have the same errors, as far as noise of the points and motion explain.
fn are_alike(errors: &Errors, before: &Errors, variance_px2: f64) -> bool {
    let (mut common, mut change, mut old) = (0usize, 0.0, before.iter().peekable());
    for (id, error) in errors {
        while old.next_if(|(other, _)| other < id).is_some() {}
        if let Some((_, other)) = old.next_if(|(other, _)| other == id) {
            common += 1;
            change += (error - other).norm_squared();
        }
    }
    let size = mean_square(errors).max(mean_square(before));
    let noise = largest(2.0 * common as f64) * 2.0 * variance_px2;
    common >= 4 && 2 * common >= before.len() && change <= common as f64 * CHANGE * CHANGE * size + noise
}

/// Mean of the squares of errors, px^2; zero of none.
pub(super) fn mean_square(errors: &Errors) -> f64 {
    errors.iter().map(|(_, e)| e.norm_squared()).sum::<f64>() / errors.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn errors(scale: f64, odd: f64) -> Errors {
        let error = |i: u32| Vector2::new(0.4, -0.4) * if i.is_multiple_of(2) { scale } else { -scale };
        (0..4).map(|i| (i, error(i) + Vector2::new(if i == 2 { odd } else { 0.0 }, 0.0))).collect()
    }

    /// Of dots that are found to 0.02 px.
    const VARIANCE_PX2: f64 = 4e-4;

    #[test]
    fn what_stays_is_known_after_three_frames() {
        let mut misfit = SteadyMisfit::with_room_for(4);
        for (scale, steady) in [(1.0, false), (0.9, false), (0.8, true)] {
            assert!(!misfit.note(&errors(scale, 0.0), VARIANCE_PX2), "nothing was accepted");
            assert_eq!(misfit.is_steady(60.0), steady);
        }
        assert!(!misfit.is_steady(10.0), "too large for so small a target");
        misfit.accept(VARIANCE_PX2);
        assert!(misfit.is_known() && misfit.allowance_px() > 0.8);
        assert!(misfit.note(&errors(0.7, 0.0), VARIANCE_PX2));
    }

    #[test]
    fn a_leap_has_to_stay_too_and_what_was_before_is_taken_at_once() {
        let mut misfit = SteadyMisfit::with_room_for(4);
        (0..3).for_each(|_| {
            misfit.note(&errors(1.0, 0.0), VARIANCE_PX2);
        });
        misfit.accept(VARIANCE_PX2);
        for steady in [false, false, true] {
            assert!(!misfit.note(&errors(1.0, 1.5), VARIANCE_PX2));
            assert_eq!(misfit.is_steady(60.0), steady);
        }
        assert!(misfit.note(&errors(1.0, 0.0), VARIANCE_PX2));
    }

    #[test]
    fn a_misfit_that_vanishes_is_forgotten() {
        let mut misfit = SteadyMisfit::with_room_for(4);
        (0..3).for_each(|_| {
            misfit.note(&errors(1.0, 0.0), VARIANCE_PX2);
        });
        misfit.accept(VARIANCE_PX2);
        for _ in 0..400 {
            misfit.note(&errors(0.02, 0.0), VARIANCE_PX2);
            misfit.accept(VARIANCE_PX2);
        }
        assert!(!misfit.is_known());
    }

    #[test]
    fn other_points_are_no_steady_misfit() {
        let mut misfit = SteadyMisfit::with_room_for(8);
        for i in 0..6 {
            let other: Errors = errors(1.0, 0.0).into_iter().map(|(id, e)| (id + 4 * (i % 2), e)).collect();
            misfit.note(&other, VARIANCE_PX2);
            assert!(!misfit.is_steady(60.0));
        }
    }
}
