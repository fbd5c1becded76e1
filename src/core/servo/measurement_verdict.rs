//! Whether the servo law uses a measurement, and if not, why: the checks of stamp, status, features and pose that each measurement passes.

use super::NoTask;
#[cfg(doc)]
use crate::messages::TargetStatus;

/// Result of the checks of one measurement.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MeasurementVerdict {
    /// The servo law uses it.
    Used,
    /// Used, although its stamp lies in the future.
    UsedFromFuture,
    /// Vision did not find the target.
    NoTarget,
    /// The law has no task for its features.
    NoTask(NoTask),
    /// None of its features is one of the set-point's, or one lies outside of what any lens can image.
    OtherFeatures,
    /// It is of another target than the goal: vision looks for the one of the goal only with the next frame.
    OtherTarget,
    /// So much of the target is hidden that the law has no output.
    TooFewFeatures,
    /// Its pose or the covariance of it is impossible for an object in front of a camera.
    ImpossiblePose,
    /// Vision found the target, but one pose does not explain its points: see [`TargetStatus::Inconsistent`].
    Inconsistent,
    /// It is not newer than the last one: repeated, out of order, or of an image that stays the same to a thousandth of a pixel while the camera moves.
    NotNewer,
    /// Its stamp lies too far in the future.
    RefusedFromFuture,
    /// Its exposure is older than the joint history.
    TooOld,
}

impl MeasurementVerdict {
    /// Whether the servo law uses it.
    #[must_use]
    pub fn is_used(self) -> bool {
        matches!(self, Self::Used | Self::UsedFromFuture)
    }

    /// Whether it was refused because of its stamp alone.
    #[must_use]
    pub fn is_refused(self) -> bool {
        matches!(self, Self::NotNewer | Self::RefusedFromFuture | Self::TooOld)
    }
}
