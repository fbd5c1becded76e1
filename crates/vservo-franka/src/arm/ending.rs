//! How a motion ends that nobody asked to end.
//!
//! The robot says it twice: by TCP in the other reply to the motion's request, by UDP in the mode and errors of its states. Either may come first. The reply does not
//! name the error of a reflex, and an idle robot does not tell why it is: so whichever comes first, the other is waited for, for a while.

use super::Arm;
use crate::FrankaError;
use crate::robot::RobotMode;
use crate::wire::{MoveStatus, RobotState};

/// States for which the other word is waited for. Chosen by hand: 50 ms, the robot itself stops the arm meanwhile.
const APART: u32 = 50;

/// What has been said of the end of a motion.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Ending {
    /// The reply, which is taken once.
    status: Option<MoveStatus>,
    /// States since one of the two words came.
    waited: u32,
}

impl Arm {
    /// Whether the motion still runs; why not.
    pub(super) fn running(&mut self, number: u32, s: &RobotState) -> Result<(), FrankaError> {
        // The other reply to the request, behind that by which it began.
        let reply = self.client.reply(number).map(MoveStatus::of).filter(|s| *s != MoveStatus::MotionStarted);
        self.ending.status = self.ending.status.or(reply);
        let status = self.ending.status;
        let (by_itself, idle) = (
            matches!(status, Some(MoveStatus::ReflexAborted | MoveStatus::EmergencyAborted)),
            s.mode == RobotMode::Idle && status.is_none(),
        );
        let waits = by_itself && s.mode == RobotMode::Move || idle;
        if waits && self.ending.waited < APART {
            self.ending.waited += 1;
            return Ok(());
        }
        match (s.mode, status) {
            (RobotMode::Reflex, _) => Err(FrankaError::StoppedInMotion {
                errors: if s.errors == 0 { s.reflex_reason } else { s.errors },
                success_rate: s.success_rate,
            }),
            (RobotMode::Move, None) if self.is_in_motion() => Ok(()),
            (RobotMode::UserStopped | RobotMode::Guiding | RobotMode::Other, _) => {
                Err(FrankaError::ModeInMotion { mode: s.mode })
            }
            (_, Some(status)) => Err(FrankaError::MotionEnded { status }),
            (mode, None) => Err(FrankaError::ModeInMotion { mode }),
        }
    }
}
