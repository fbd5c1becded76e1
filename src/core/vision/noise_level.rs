//! Learns how far a target's points scatter from frame to frame beyond what their finder states.
//!
//! A camera that shakes, air that shimmers, a compressed stream or a light that flickers moves each point in each frame by another amount. No pose explains that,
//! and none of those errors stays, so that it is neither a model error ([`super::steady_misfit`]) nor one wrong frame. It is told from both by second
//! differences of the reprojection errors over three frames, `e_k - 2 e_{k-1} + e_{k-2}`: a steady error and one that changes evenly while the arm moves have none, and
//! noise of the variance `s^2` has `6 s^2`. Their median over the last frames is the noise, so that single wrong frames do not count.

use super::steady_misfit::{Errors, mean_square};
use nalgebra::Vector2;

/// Frames whose noise is kept. Chosen by hand: a second at 25 Hz, over which light and vibration of a cell are as they were.
const FRAMES: usize = 25;
/// So many of them tell the noise. Derived: one wrong frame is in three of the differences, and two such frames are fewer than half of thirteen. Of four points, two degrees of freedom each,
/// their median has the noise's deviation to a quarter. At 25 Hz an arm begins 0.6 s after its first frame.
const ENOUGH: usize = 13;
/// Factor by which the variance exceeds the stated one from which on it is noise that the finder does not know. Chosen by hand: in strong blur stated variances are a few times
/// too small.
const KNOWN_FROM: f64 = 4.0;
/// The same below which it is forgotten. Chosen by hand: half of it, so that a level at the border does not come and go.
const FORGOTTEN_BELOW: f64 = 2.0;

/// Largest misfit that may be noise, as a share of the target's extent in the image. Chosen by hand: noise of 5 px leaves 3.5 px of four points, which is 0.06 of an extent of 60 px; points of
/// another object leave tenths of it.
const MAX_SHARE: f64 = 0.08;

/// Whether the errors of a target with this `extent_px` in the image, root mean square distance of its points from their centre, may be noise, and are not those of another object.
pub(super) fn may_be_noise(errors: &Errors, extent_px: f64) -> bool {
    !errors.is_empty() && mean_square(errors).sqrt() <= MAX_SHARE * extent_px
}

/// Second differences of the reprojection errors of the last frames.
#[derive(Debug, Clone, Default)]
pub(super) struct NoiseLevel {
    /// Reprojection errors of the last frame, and of the one before it.
    last: Errors,
    before: Errors,
    /// Variances of a coordinate, px^2, of which each follows from three frames; the oldest is replaced.
    variances_px2: Vec<f64>,
    oldest: usize,
    /// Room to sort them.
    sorted: Vec<f64>,
    /// The variance of a coordinate, px^2, beyond the stated one; zero while the stated one explains what is seen.
    unstated_px2: f64,
}

impl NoiseLevel {
    pub(super) fn with_room_for(count: usize) -> Self {
        Self {
            last: Vec::with_capacity(count),
            before: Vec::with_capacity(count),
            variances_px2: Vec::with_capacity(FRAMES),
            sorted: Vec::with_capacity(FRAMES),
            ..Self::default()
        }
    }

    /// The variance of a coordinate, px^2, that the finder does not state; zero while the stated one explains what is seen.
    pub(super) fn unstated_px2(&self) -> f64 {
        self.unstated_px2
    }

    /// Frames are missing: the next ones are compared with none before. The level stays.
    pub(super) fn interrupt(&mut self) {
        self.last.clear();
        self.before.clear();
    }

    /// Something lies over the target's points: what was seen until now may be its doing, too. The level stays, and is learnt anew.
    pub(super) fn disturb(&mut self) {
        self.interrupt();
        self.variances_px2.clear();
        self.oldest = 0;
    }

    /// Takes in the reprojection errors of a frame, ids rising, whose points have the stated variance `stated_px2` in each coordinate.
    pub(super) fn note(&mut self, errors: &Errors, stated_px2: f64) {
        if let Some(variance_px2) = self.variance_px2(errors) {
            if self.variances_px2.len() < FRAMES {
                self.variances_px2.push(variance_px2);
            } else if let Some(oldest) = self.variances_px2.get_mut(self.oldest) {
                *oldest = variance_px2;
                self.oldest = (self.oldest + 1) % FRAMES;
            }
        }
        std::mem::swap(&mut self.last, &mut self.before);
        self.last.clone_from(errors);
        let Some(variance_px2) = self.median_px2() else { return };
        let from = if self.unstated_px2 > 0.0 { FORGOTTEN_BELOW } else { KNOWN_FROM };
        self.unstated_px2 = if variance_px2 > from * stated_px2 { variance_px2 - stated_px2 } else { 0.0 };
    }

    /// The variance of a coordinate, px^2, of the points that this frame and the two before it have in common, over the median of chi-square over its degrees of freedom, so that its
    /// median is the noise's; `None` of fewer than four points.
    fn variance_px2(&self, errors: &Errors) -> Option<f64> {
        let (mut last, mut before) = (self.last.iter().peekable(), self.before.iter().peekable());
        let (mut common, mut squares) = (0usize, 0.0);
        for (id, error) in errors {
            let of = |frame: &mut std::iter::Peekable<std::slice::Iter<'_, (u32, Vector2<f64>)>>| {
                while frame.next_if(|(other, _)| other < id).is_some() {}
                frame.next_if(|(other, _)| other == id).map(|(_, error)| *error)
            };
            if let (Some(last), Some(before)) = (of(&mut last), of(&mut before)) {
                common += 1;
                squares += (error - 2.0 * last + before).norm_squared();
            }
        }
        // Six of the coordinates went into the pose.
        let freedom = (2 * common).checked_sub(6).filter(|freedom| *freedom > 0)? as f64;
        let median = freedom * (1.0 - 2.0 / (9.0 * freedom)).powi(3);
        Some(squares / 6.0 / median).filter(|variance| variance.is_finite())
    }

    /// Median of the variances; `None` before there are enough.
    fn median_px2(&mut self) -> Option<f64> {
        if self.variances_px2.len() < ENOUGH {
            return None;
        }
        self.sorted.clone_from(&self.variances_px2);
        self.sorted.sort_unstable_by(f64::total_cmp);
        self.sorted.get(self.sorted.len() / 2).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::linalg::Random;

    /// A number that is nearly Gaussian, of the standard deviation 1.
    fn gauss(random: &mut Random) -> f64 {
        (0..12).map(|_| random.between(-0.5, 0.5)).sum()
    }

    /// Errors of `count` points before any pose is fitted.
    fn noise(count: u32, sd_px: f64, random: &mut Random) -> Errors {
        (0..count).map(|id| (id, Vector2::new(gauss(random), gauss(random)) * sd_px)).collect()
    }

    /// Noise of four points after a fit of six unknowns: two random numbers along two directions of the eight coordinates.
    fn of_four(sd_px: f64, random: &mut Random) -> Errors {
        let (a, b) = (gauss(random) * sd_px, gauss(random) * sd_px);
        let signs = [[1.0, 1.0], [-1.0, -1.0], [1.0, 1.0], [-1.0, -1.0]];
        let error = |[x, y]: [f64; 2]| Vector2::new(0.5 * a * x, 0.5 * b * y);
        (0..4).zip(signs.map(error)).collect()
    }

    /// Of points that are found to 0.01 px.
    const STATED_PX2: f64 = 1e-4;

    #[test]
    fn noise_beyond_the_stated_one_is_learnt() {
        for seed in 0..50 {
            let (mut level, mut random) = (NoiseLevel::with_room_for(4), Random::new(seed));
            for k in 0..60 {
                level.note(&of_four(0.1, &mut random), STATED_PX2);
                assert!(k > ENOUGH || level.unstated_px2() == 0.0, "{k}");
            }
            let sd_px = level.unstated_px2().sqrt();
            assert!((0.04..0.2).contains(&sd_px), "{seed}: {sd_px}");
        }
    }

    #[test]
    fn many_points_tell_it_exactly() {
        let (mut level, mut random) = (NoiseLevel::with_room_for(48), Random::new(1));
        // As a pose fits six of the 96 coordinates, they have a little less than here.
        (0..40).for_each(|_| level.note(&noise(48, 0.3, &mut random), STATED_PX2));
        let sd_px = level.unstated_px2().sqrt();
        assert!((sd_px / 0.3 - 1.0).abs() < 0.1, "{sd_px}");
    }

    #[test]
    fn what_is_stated_stays_or_changes_evenly_is_none() {
        for seed in 0..50 {
            let (mut level, mut random) = (NoiseLevel::with_room_for(4), Random::new(seed));
            for k in 0..200 {
                let mut errors = of_four(0.01, &mut random);
                // A wrong lens while the arm moves: a pixel more in a second.
                let moved_px = 0.04 * f64::from(k);
                errors.iter_mut().for_each(|(id, e)| e.x += if *id < 2 { moved_px } else { -moved_px });
                level.note(&errors, STATED_PX2);
                assert_eq!(level.unstated_px2(), 0.0, "{seed}, {k}");
            }
        }
    }

    #[test]
    fn single_wrong_frames_are_none_and_what_is_over_is_forgotten() {
        let (mut level, mut random) = (NoiseLevel::with_room_for(4), Random::new(7));
        for k in 0..100 {
            level.note(&of_four(if k % 10 == 9 { 5.0 } else { 0.01 }, &mut random), STATED_PX2);
            assert_eq!(level.unstated_px2(), 0.0, "{k}");
        }
        (0..40).for_each(|_| level.note(&of_four(0.2, &mut random), STATED_PX2));
        assert!(level.unstated_px2() > 0.0);
        (0..40).for_each(|_| level.note(&of_four(0.01, &mut random), STATED_PX2));
        assert_eq!(level.unstated_px2(), 0.0);
    }

    #[test]
    fn other_points_tell_nothing() {
        let (mut level, mut random) = (NoiseLevel::with_room_for(8), Random::new(7));
        for k in 0..40 {
            let errors: Errors =
                of_four(1.0, &mut random).into_iter().map(|(id, e)| (id + 4 * (k % 2), e)).collect();
            level.note(&errors, STATED_PX2);
        }
        assert_eq!(level.unstated_px2(), 0.0);
    }
}
