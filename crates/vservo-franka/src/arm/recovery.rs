//! The way back from a stop of the robot, while its states go on. Nothing here waits.
//!
//! ```text
//! halt ─► next, recover(false), ...      nothing is asked of the robot
//!         next, recover(true), ...       reflex ─► automatic error recovery ─► idle ─► a motion is begun ─► it holds the arm: ready
//!                                           └ a robot that refuses: in words, and no second try before recover(false)
//! ```

use super::{Arm, Command};
use crate::client::nanoseconds;
use crate::robot::RobotMode;
use crate::wire::{MoveStatus, Request};
use crate::{CommandKind, FrankaError};

/// What the robot has come to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Recovered {
    /// It is still stopped.
    Not,
    /// A motion runs again, and holds the arm.
    Ready,
}

/// A stop of the robot.
#[derive(Debug, Clone, Copy)]
pub(super) struct Halt {
    /// Whether an error was cleared since that was asked for: another is not.
    cleared: bool,
    stage: RecoveryStage,
}

#[derive(Debug, Clone, Copy)]
enum RecoveryStage {
    /// Nothing is under way.
    Waits,
    /// The robot was asked to clear its error, by a request of this number; it has to be done by then, ns.
    Clears(u32, i64),
    /// A motion was asked for likewise.
    Begins(u32, i64),
    /// It was tried in vain.
    Failed,
}

impl Arm {
    /// After an error that [is of the robot](FrankaError::is_of_the_robot): its states go on, and [`Self::recover`] brings its motion back.
    pub fn halt(&mut self) {
        self.motion = None;
        self.halt = Some(Halt { cleared: false, stage: RecoveryStage::Waits });
    }

    /// Whether the robot was stopped, and no motion runs again yet.
    #[must_use]
    pub fn is_halted(&self) -> bool {
        self.halt.is_some()
    }

    /// A step of a robot that was stopped, with each of its states instead of a command. With `asked` a reflex is cleared, and the motion begun again as soon as the
    /// robot lets it; without, nothing is.
    ///
    /// # Errors
    /// When the robot refuses; once, until it was called without `asked`. Or when the connection is lost.
    pub fn recover(&mut self, asked: bool) -> Result<Recovered, FrankaError> {
        let Some(mut halt) = self.halt else { return Ok(Recovered::Ready) };
        let step = if asked {
            self.step(&mut halt)
        } else {
            if let RecoveryStage::Begins(..) = halt.stage {
                self.client.send(&Request::StopMove)?; // nobody will command it
            }
            halt.cleared = false;
            Ok(RecoveryStage::Waits)
        };
        let (stage, result) = match step {
            Ok(RecoveryStage::Begins(number, _)) if self.is_in_motion() => {
                self.halt = None;
                self.begin(number);
                self.command(Command::Hold)?;
                return Ok(Recovered::Ready);
            }
            Ok(stage) => (stage, Ok(Recovered::Not)),
            Err(error) => (RecoveryStage::Failed, Err(error)),
        };
        self.halt = Some(Halt { stage, ..halt });
        result
    }

    fn step(&mut self, halt: &mut Halt) -> Result<RecoveryStage, FrankaError> {
        let Some(last) = self.raw else { return Ok(halt.stage) };
        let (now, patience) = ((self.settings.clock)(), self.settings.patience);
        let until = now + nanoseconds(patience);
        match halt.stage {
            RecoveryStage::Waits => match last.mode {
                RobotMode::Reflex if halt.cleared => Err(FrankaError::StoppedAgain { errors: last.errors }),
                RobotMode::Reflex => {
                    halt.cleared = true;
                    self.client
                        .send(&Request::AutomaticErrorRecovery)
                        .map(|number| RecoveryStage::Clears(number, until))
                }
                RobotMode::Idle => {
                    let (controller, generator) = self.kind.unwrap_or(CommandKind::Position).asked();
                    let number = self.client.send(&Request::Move { controller, generator })?;
                    Ok(RecoveryStage::Begins(number, until))
                }
                _ => Ok(RecoveryStage::Waits), // somebody has to see to it at the robot
            },
            RecoveryStage::Clears(number, until) => match self.client.reply(number) {
                Some(0) => Ok(RecoveryStage::Waits),
                Some(status) => {
                    Err(FrankaError::Refused { what: "to clear its error", why: recovery_words(status) })
                }
                None if now > until => Err(self.silent("Automatic Error Recovery")),
                None => Ok(RecoveryStage::Clears(number, until)),
            },
            RecoveryStage::Begins(number, until) => {
                let status = self.client.reply(number).map(MoveStatus::of);
                if last.mode == RobotMode::Reflex {
                    return Err(FrankaError::StoppedAgain { errors: last.errors });
                }
                match status {
                    Some(MoveStatus::MotionStarted) | None if now <= until => {
                        Ok(RecoveryStage::Begins(number, until))
                    }
                    Some(MoveStatus::MotionStarted) | None => {
                        Err(FrankaError::MotionNotStarted { seconds: patience.as_secs_f64() })
                    }
                    Some(status) => Err(FrankaError::MotionRefused { status }),
                }
            }
            RecoveryStage::Failed => Ok(RecoveryStage::Failed),
        }
    }

    /// Clears a reflex without a motion, because somebody asks for it by name, and waits until that is done.
    ///
    /// # Errors
    /// When the robot refuses.
    pub fn clear(&mut self) -> Result<RobotMode, FrankaError> {
        let status = self.client.ask(&Request::AutomaticErrorRecovery)?;
        if status != 0 {
            return Err(FrankaError::Refused { what: "to clear its error", why: recovery_words(status) });
        }
        Ok(self.newest()?.mode)
    }
}

/// Why an error was not cleared, by the maker's statuses.
fn recovery_words(status: u8) -> &'static str {
    match status {
        1 => "there is none that can be cleared in its mode",
        2 => "a safety function is active: switch it off in Desk",
        3 => "somebody has to see to it in Desk",
        4 => "another reflex came",
        5 => "the user stop is pressed",
        _ => "it was ended",
    }
}
