//! The offset between the camera's stamps and the encoders', from what a moving arm sees of a target at rest.
//!
//! ```text
//! s_ij = proj( X_WC(q(t_i + tau))^-1 X_WO P_j )        frame i with stamp t_i, point j of the target
//! ```
//! Unknown are tau and, beside it, the pose X_WO of the object and what is wrong with that of the camera. The start is the
//! best of a coarse search over tau; `fit` does the rest.

mod fit;

use super::Recording;
use crate::robot::{Mount, Robot};
use fit::{Free, LatencyProblem, LatencyUnknowns};
use nalgebra::{Point3, Vector2};
use thiserror::Error;

/// Offsets are searched up to this, s. Chosen by hand: a quarter of a second, six frames at 25 Hz.
const RANGE_S: f64 = 0.25;
/// Step of the coarse search, s. Chosen by hand: no joint moves with more than 10 cycles in 8 s, so that a step is at most a fortieth of a
/// period, and the fine search starts near the minimum.
const COARSE_STEP_S: f64 = 0.02;
/// Frames of the coarse search; of more, every n-th is used. Chosen by hand, for its time.
const COARSE_FRAMES: usize = 100;
/// Fewest frames with the target. Chosen by hand: with the pose's six unknowns and the offset there must be enough to see a motion.
const MIN_FRAMES: usize = 12;
/// Smallest motion of the target that shows a delay, root mean square, px.
const MIN_MOTION_PX: f64 = 1.0;
/// Standard deviation above which the offset counts as not found, s. Chosen by hand: a tick; a larger error would not improve control.
const MAX_SD_S: f64 = 1e-3;
/// Share of the motion above which residuals mean that the arm does not move the image. Chosen by hand: a right model leaves per cents.
const MAX_RESIDUAL_SHARE: f64 = 0.25;
/// Most steps of the last search, and of that at each coarse offset. Chosen by hand: a bound; converging ends them earlier.
const MAX_ITERATIONS: u32 = 50;
const COARSE_ITERATIONS: u32 = 8;

/// What is known of the cell.
#[derive(Debug, Clone, Copy)]
pub struct KnownCell<'a, const N: usize> {
    /// The arm.
    pub robot: &'a Robot<N>,
    /// Where the camera sits.
    pub mount: &'a Mount,
    /// Focal lengths, px.
    pub f_px: Vector2<f64>,
    /// The target's points in O, m.
    pub points: &'a [Point3<f64>],
}

/// An offset that was found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StampOffset {
    /// What has to be added to the camera's stamps, s; negative where they are late.
    pub offset_s: f64,
    /// Its standard deviation, s.
    pub sd_s: f64,
    /// Frames that it rests on.
    pub frames: usize,
    /// Distance of the points from where they should be without the offset, root mean square, px.
    pub rms_before_px: f64,
    /// The same with it.
    pub rms_after_px: f64,
}

/// Why no offset was found.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum LatencyError {
    /// Too few frames show the target.
    #[error(
        "only {found} frames showed the target, {needed} are needed: raise camera.rate_hz, or see why vision loses it"
    )]
    TooFewFrames {
        /// With target.
        found: usize,
        /// At least.
        needed: usize,
    },
    /// No frame gave the target's pose.
    #[error("vision found no pose of the target: check [target] and [camera.lens]")]
    NoPose,
    /// The target hardly moved in the image.
    #[error(
        "the target moved by only {motion_px:.2} px in the image: start where the joints are away from the ends of \
         their ranges and the target is near the middle of the image"
    )]
    TooLittleMotion {
        /// Root mean square, px.
        motion_px: f64,
    },
    /// The image does not move as the arm does.
    #[error(
        "the image does not follow the arm ({residual_px:.1} px of {motion_px:.1} px remain): the target must rest, and \
         [camera.mount], [camera.lens] and the robot's model be right"
    )]
    NotFollowing {
        /// Root mean square residual, px.
        residual_px: f64,
        /// Root mean square motion, px.
        motion_px: f64,
    },
    /// The best offset lies at the end of what is searched.
    #[error(
        "no offset within {range_ms:.0} ms explains the image: the camera's stamps may count from another origin than \
         the control's clock, camera.stamp_offset_ms be far off, or the target have moved by itself"
    )]
    OutOfRange {
        /// Largest offset that is searched, ms.
        range_ms: f64,
    },
    /// The offset is too uncertain.
    #[error(
        "the offset is uncertain by {sd_ms:.1} ms: more motion in the image, more frames or less noise are needed"
    )]
    Uncertain {
        /// Standard deviation, ms.
        sd_ms: f64,
    },
    /// The iteration did not come to rest.
    #[error("the search for the offset did not converge: the recording contradicts itself")]
    NotConverged,
}

/// The offset that brings the camera's stamps into line with the joints'.
///
/// # Errors
/// [`LatencyError`], each with what helps.
pub fn stamp_offset<const N: usize>(
    cell: &KnownCell<'_, N>,
    recording: &Recording<N>,
) -> Result<StampOffset, LatencyError> {
    let fit = LatencyProblem::new(cell, recording);
    let frames = fit.frames();
    if frames < MIN_FRAMES || recording.track.is_empty() {
        return Err(LatencyError::TooFewFrames { found: frames, needed: MIN_FRAMES });
    }
    let motion_px = fit.motion_px();
    if motion_px < MIN_MOTION_PX {
        return Err(LatencyError::TooLittleMotion { motion_px });
    }
    let start = fit.first_guess().ok_or(LatencyError::NoPose)?;
    let without = fit.descend(start, Free::Poses, MAX_ITERATIONS).state;
    let out_of_range = LatencyError::OutOfRange { range_ms: RANGE_S * 1e3 };
    let coarse = search(&fit.thinned(COARSE_FRAMES), &without).ok_or(out_of_range)?;
    let residual_px = fit.rms_px(&coarse);
    if !(residual_px <= MAX_RESIDUAL_SHARE * motion_px) {
        return Err(LatencyError::NotFollowing { residual_px, motion_px });
    }
    let with = fit.descend(coarse, Free::All, MAX_ITERATIONS);
    if !with.converged {
        return Err(LatencyError::NotConverged);
    }
    if with.state.tau_s.abs() > RANGE_S {
        return Err(out_of_range);
    }
    let sd_s = fit.sd_s(&with.state);
    if !(sd_s <= MAX_SD_S) {
        return Err(LatencyError::Uncertain { sd_ms: sd_s * 1e3 });
    }
    Ok(StampOffset {
        offset_s: with.state.tau_s,
        sd_s,
        frames,
        rms_before_px: fit.rms_px(&without),
        rms_after_px: fit.rms_px(&with.state),
    })
}

/// The best of evenly spaced offsets, each with its own poses; `None` where that is the first or the last one.
fn search<const N: usize>(fit: &LatencyProblem<'_, N>, start: &LatencyUnknowns) -> Option<LatencyUnknowns> {
    let steps = (RANGE_S / COARSE_STEP_S).round() as i32;
    let mut best: Option<(f64, i32, LatencyUnknowns)> = None;
    for k in -steps..=steps {
        let at = start.with_offset(f64::from(k) * COARSE_STEP_S);
        let at = fit.descend(at, Free::Poses, COARSE_ITERATIONS).state;
        let distance = fit.sum_of_lengths(&at);
        if best.is_none_or(|(least, _, _)| distance < least) {
            best = Some((distance, k, at));
        }
    }
    best.filter(|(_, k, _)| k.abs() < steps).map(|(_, _, state)| state)
}

#[cfg(test)]
mod tests;
