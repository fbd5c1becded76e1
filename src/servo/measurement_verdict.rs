//! What becomes of a measurement that reaches the servo law.

use super::NoTask;
#[cfg(doc)]
use crate::messages::TargetStatus;

/// What became of a measurement.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MeasurementVerdict {
    /// The servo law works with it.
    Used,
    /// Used, although its stamp lies in the future.
    UsedFromFuture,
    /// It has no target.
    NoTarget,
    /// The law has no task for what it shows.
    NoTask(NoTask),
    /// None of its features is one of the set-point's, or one of them is nowhere a camera looks.
    OtherFeatures,
    /// So much of the target is hidden that the law has no answer.
    TooFewFeatures,
    /// Its pose, or what it states of its deviation, is none that an object before a camera has.
    ImpossiblePose,
    /// Vision found the target and does not believe it: see [`TargetStatus::Inconsistent`].
    Inconsistent,
    /// It is not newer than the last one: repeated, or overtaken.
    NotNewer,
    /// Its stamp lies too far in the future.
    RefusedFromFuture,
    /// Its exposure lies before everything that is known of the arm.
    TooOld,
}

impl MeasurementVerdict {
    /// Whether the servo law works with it.
    #[must_use]
    pub fn is_used(self) -> bool {
        matches!(self, Self::Used | Self::UsedFromFuture)
    }

    /// Whether its stamp alone spoke against it.
    #[must_use]
    pub fn is_refused(self) -> bool {
        matches!(self, Self::NotNewer | Self::RefusedFromFuture | Self::TooOld)
    }
}
