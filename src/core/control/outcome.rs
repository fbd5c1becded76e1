//! How a run ended, and why.

use super::safety::Fault;
use serde::{Deserialize, Serialize};

/// The exit code of what was stopped before it was done. Chosen: the next one that is free.
pub const STOPPED: u8 = 6;

/// How a run ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// The goal was reached and held.
    Converged,
    /// The time of the run was over before the goal was reached.
    NotConverged,
    /// An open-loop run, or the motion of a calibration, was completed.
    Finished,
    /// The end was requested.
    Stopped,
    /// A fault.
    Fault,
}

impl Outcome {
    /// All, in the order of their codes.
    const ALL: [Self; 5] = [Self::Converged, Self::NotConverged, Self::Finished, Self::Stopped, Self::Fault];

    /// Its code in a message, from 1.
    #[must_use]
    pub fn code(self) -> u32 {
        self as u32 + 1
    }

    /// The outcome of a code in a message; `None` for 0 and unknown ones.
    #[must_use]
    pub fn from_code(code: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|outcome| outcome.code() == code)
    }

    /// The word for it in the summary.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Converged => "converged",
            Self::NotConverged => "not_converged",
            Self::Finished => "finished",
            Self::Stopped => "stopped",
            Self::Fault => "fault",
        }
    }

    /// The exit code of a run that ended like this. A run that was to reach something (`awaited`) and was stopped before has not done it.
    #[must_use]
    pub fn exit_code_of(self, awaited: bool) -> u8 {
        if self == Self::Stopped && awaited { STOPPED } else { self.exit_code() }
    }

    /// The exit code of a run that ended like this, where a stop is an end as good as any.
    #[must_use]
    pub fn exit_code(self) -> u8 {
        match self {
            Self::Converged | Self::Finished | Self::Stopped => 0,
            Self::Fault => 4,
            Self::NotConverged => 5,
        }
    }
}

/// The end of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Finish {
    /// The outcome.
    pub outcome: Outcome,
    /// The reason, for people.
    pub reason: &'static str,
}

impl Finish {
    /// A run that ends because of `fault`.
    #[must_use]
    pub fn fault(fault: Fault) -> Self {
        Self { outcome: Outcome::Fault, reason: fault.describe() }
    }
}
