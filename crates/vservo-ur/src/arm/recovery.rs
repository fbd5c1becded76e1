//! The way back from a stop of the robot, while its states go on. Nothing here waits: what talks to the dashboard does so in a thread of its own.
//!
//! ```text
//! halt ─► next, recover(false), ...      what runs there is told to end, and nothing is unlocked
//!         next, recover(true), ...       protective stop ─ 5 s over ─► unlock ─► normal, running ─► program sent ─► it holds the arm: ready
//!                                              └ a dashboard that refuses: in words, and no second try before recover(false)
//! ```

use super::readiness::SLIDER;
use super::{Arm, ArmSettings, ArmState, Command, session};
use crate::UrError;
use crate::dashboard::Dashboard;
use crate::program;
use crate::robot::{RobotMode, SafetyMode, Series};
use crate::rtde::nanoseconds;
use std::io::Write;
use std::net::{SocketAddr, TcpStream};
use std::thread::JoinHandle;

/// Time by the controller's clock after which a protective stop may be unlocked, by the maker's documentation, and a tenth of a second for its own count, s.
const UNLOCK_AFTER_S: f64 = 5.1;

/// What the robot has come to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Recovered {
    /// It is still stopped.
    Not,
    /// Its program runs again, and holds the arm.
    Ready,
}

/// A stop of the robot.
#[derive(Debug)]
pub(super) struct Halt {
    /// Since when the protective stop is there that is there now, by the controller's clock, s.
    stopped_since_s: Option<f64>,
    /// Whether one was unlocked since it was asked for: another is not.
    unlocked: bool,
    stage: RecoveryStage,
}

#[derive(Debug)]
enum RecoveryStage {
    /// Nothing is under way.
    Waits,
    /// The dashboard is asked to unlock.
    Unlocks(JoinHandle<Result<(), UrError>>),
    /// It was: the safety system has to say so by then, ns.
    Unlocked(i64),
    /// The old program is ended, and the new one sent.
    Sends(JoinHandle<Result<TcpStream, UrError>>),
    /// The program was sent: it has to run by then, ns. The stream stays open until it does.
    Starts(TcpStream, i64),
    /// It was tried in vain.
    Failed,
}

impl Halt {
    fn new() -> Self {
        Self { stopped_since_s: None, unlocked: false, stage: RecoveryStage::Waits }
    }

    /// Takes a state in.
    pub(super) fn note(&mut self, state: &ArmState) {
        let stopped = state.safety == SafetyMode::ProtectiveStop;
        self.stopped_since_s = stopped.then(|| self.stopped_since_s.unwrap_or(state.robot_s));
    }
}

impl Arm {
    /// After an error that [is of the robot](UrError::is_of_the_robot): its states go on, and [`Self::recover`] brings its program back.
    pub fn halt(&mut self) {
        self.started = false;
        let mut halt = Halt::new();
        if let Some(last) = &self.last {
            halt.note(last);
        }
        self.halt = Some(halt);
    }

    /// Whether the robot was stopped, and its program does not run again yet.
    #[must_use]
    pub fn is_halted(&self) -> bool {
        self.halt.is_some()
    }

    /// A step of a robot that was stopped, with each of its states instead of a command. With `asked` a protective stop is unlocked, 5 s after it came at the
    /// earliest, and the program is started as soon as robot and safety let it; without, nothing is: what may still run there is told to end.
    ///
    /// # Errors
    /// When the robot refuses; once, until it was called without `asked`. Or when the connection is lost.
    pub fn recover(&mut self, asked: bool) -> Result<Recovered, UrError> {
        let (Some(mut halt), Some(last)) = (self.halt.take(), self.last) else { return Ok(Recovered::Ready) };
        let stage = std::mem::replace(&mut halt.stage, RecoveryStage::Failed);
        // The registers first: a program that waits on the robot reads in them that it shall end, the new one that it shall hold.
        let starts = asked && matches!(stage, RecoveryStage::Sends(_) | RecoveryStage::Starts(..));
        let sent = self.command(if starts { Command::Hold } else { Command::End });
        halt.unlocked &= asked;
        let step = if asked { self.step(stage, &mut halt, &last) } else { Ok(RecoveryStage::Waits) };
        let ready = matches!(step, Ok(RecoveryStage::Starts(..))) && last.holds_for(self.program.session);
        if ready && last.safety.lets_move() {
            self.started = true;
            return sent.map(|()| Recovered::Ready);
        }
        let (stage, result) = match step {
            Ok(stage) => (stage, Ok(Recovered::Not)),
            Err(error) => (RecoveryStage::Failed, Err(error)),
        };
        self.halt = Some(Halt { stage, ..halt });
        sent.and(result)
    }

    fn step(
        &mut self,
        stage: RecoveryStage,
        halt: &mut Halt,
        last: &ArmState,
    ) -> Result<RecoveryStage, UrError> {
        let (settings, clock) = (self.settings, self.settings.clock);
        let lets_move = last.safety.lets_move() && last.mode == RobotMode::Running;
        match stage {
            RecoveryStage::Waits => {
                if let Some(since_s) = halt.stopped_since_s {
                    if halt.unlocked {
                        return Err(UrError::StoppedAgain { safety: last.safety });
                    }
                    if last.robot_s - since_s < UNLOCK_AFTER_S {
                        return Ok(RecoveryStage::Waits);
                    }
                    halt.unlocked = true;
                    return spawn("ur-unlock", move || unlock(&settings)).map(RecoveryStage::Unlocks);
                }
                if !lets_move {
                    return Ok(RecoveryStage::Waits); // somebody has to see to it at the robot
                }
                if last.slider < SLIDER {
                    return Err(UrError::SpeedSlider { percent: 100.0 * last.slider });
                }
                self.program.session = session(clock);
                let (series, text) = (self.series, self.program.text());
                spawn("ur-restart", move || restart(&settings, series, &text)).map(RecoveryStage::Sends)
            }
            RecoveryStage::Unlocks(thread) if thread.is_finished() => {
                joined(thread)?;
                Ok(RecoveryStage::Unlocked(clock() + nanoseconds(settings.patience)))
            }
            RecoveryStage::Unlocked(until) => {
                if halt.stopped_since_s.is_none() {
                    Ok(RecoveryStage::Waits)
                } else if clock() > until {
                    Err(UrError::Stopped { safety: last.safety })
                } else {
                    Ok(RecoveryStage::Unlocked(until))
                }
            }
            RecoveryStage::Sends(thread) if thread.is_finished() => {
                Ok(RecoveryStage::Starts(joined(thread)?, clock() + nanoseconds(settings.patience)))
            }
            RecoveryStage::Starts(stream, until) => {
                if !lets_move {
                    return Ok(RecoveryStage::Waits); // stopped once more
                }
                if clock() > until {
                    return Err(UrError::ProgramNotStarted { seconds: settings.patience.as_secs_f64() });
                }
                Ok(RecoveryStage::Starts(stream, until))
            }
            under_way => Ok(under_way),
        }
    }
}

/// Sends a program. The stream stays open until the program runs: closed with states unread it would be reset, and the program's text with it.
pub(super) fn send_program(settings: &ArmSettings, text: &str) -> Result<TcpStream, UrError> {
    let address = SocketAddr::new(settings.host, program::PORT);
    let failed = |cause| UrError::Connect {
        what: "the robot's interface for programs",
        address: address.to_string(),
        cause,
    };
    let mut stream = TcpStream::connect_timeout(&address, settings.patience).map_err(failed)?;
    stream.set_write_timeout(Some(settings.patience)).map_err(failed)?;
    stream.write_all(text.as_bytes()).map_err(failed)?;
    Ok(stream)
}

/// Unlocks a protective stop.
fn unlock(settings: &ArmSettings) -> Result<(), UrError> {
    Dashboard::connect(settings.host, settings.patience, settings.clock)?.unlock_protective_stop()
}

/// Ends the program that may wait on the robot, and sends another.
fn restart(settings: &ArmSettings, series: Series, text: &str) -> Result<TcpStream, UrError> {
    let mut dashboard = Dashboard::connect(settings.host, settings.patience, settings.clock)?;
    if !dashboard.is_under_remote_control(series)? {
        return Err(UrError::LocalControl);
    }
    // A robot without a program refuses to stop one.
    let _ = dashboard.stop_program();
    send_program(settings, text)
}

fn spawn<T: Send + 'static>(
    name: &'static str,
    work: impl FnOnce() -> Result<T, UrError> + Send + 'static,
) -> Result<JoinHandle<Result<T, UrError>>, UrError> {
    std::thread::Builder::new().name(name.into()).spawn(work).map_err(|_| UrError::RecoveryFailed)
}

fn joined<T>(thread: JoinHandle<Result<T, UrError>>) -> Result<T, UrError> {
    thread.join().map_err(|_| UrError::RecoveryFailed)?
}
