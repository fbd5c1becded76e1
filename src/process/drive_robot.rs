//! The loop of a robot's drive: a process of its own between control and the robot's controller, the same for every maker.
//!
//! ```text
//! drive/command (1 kHz) ─► the newest, at each state ─► the robot, by its own wire
//! drive/state           ◄─ each state, with the time of its sample ◄─ the robot
//! drive/text            ◄─ the joints' names with START, and why the robot has stopped
//! START ─► ready? begun ─► INITIAL      LAST, a stop, silence ─► braked, at rest, ended      a fault ─► its words, exit code 4
//! the robot stops ─► its words, states with what the robot is ─ CLEAR ─► cleared, begun again ─► ready
//! ```
//! The robot's states set the pace: a state comes, is passed on, and the newest command goes back. Without commands for a tenth of a second the arm is braked; without
//! this process the robot does so. While the guardian's stop stands, the arm is held whatever is commanded.

use super::{DrivePayload, ProcessError, StopFlag};
use crate::config::RealtimeRequest;
use crate::drive::DriveProperties;
use crate::ipc::{Instance, QuietSender, Receiver, Sender, Services, StopWord};
use crate::messages::{DriveCommandMsg, DriveStateMsg, DriveTextMsg, RobotState, drive_flag};
use crate::rt::{ClockEstimate, now, prepare_thread, tell};
use crate::time::{MonoNs, SpanNs};
use std::time::Duration;

/// Longest time without a command while a run goes on. Chosen by hand: a hundred ticks; control that is late by more has ended.
const SILENCE: SpanNs = SpanNs(100_000_000);
/// How long before a stop its controller may have said why. Chosen by hand: messages and states come over two connections.
const SAID_BEFORE: SpanNs = SpanNs(500_000_000);
/// Longest wait for a state, after which requests to stop are looked at. Chosen by hand: some cycles of every robot.
const WAIT: Duration = Duration::from_millis(20);

/// A robot as this loop uses it. Its errors are in words that say what to do.
pub(super) trait RobotArm {
    /// A state of it.
    type State: Copy;
    /// What it shall do until the next command.
    type Command: Copy;
    /// Why it cannot be used, or no longer.
    type Error: std::fmt::Display + Into<ProcessError>;
    /// The program that drives it, which its messages begin with.
    const PROGRAM: &'static str;
    /// What is told when a robot that had stopped obeys again.
    const BACK: &'static str;
    /// Its joints.
    const JOINTS: usize;
    /// The command modes that it takes, a bit each.
    const MODES: u32;
    /// To brake, and to stay.
    const HOLD: Self::Command;

    /// The next state: what waits already, or what comes within `wait`; none when nothing came.
    fn next(&mut self, wait: Duration) -> Result<Option<Self::State>, Self::Error>;
    /// The newest state.
    fn last(&self) -> Option<Self::State>;
    /// States that were missing, and the longest delay of one, ns.
    fn missed(&self) -> (u64, i64);
    /// What is known of its clock.
    fn clock(&self) -> Option<ClockEstimate>;
    /// What is told of the drive in this mode.
    fn properties(&self, mode: u32) -> DriveProperties;
    /// Sees to it that it obeys commands of this mode from now on; false where `stop` said that nobody wants it any more.
    fn begin(&mut self, mode: u32, stop: &dyn Fn() -> bool) -> Result<bool, Self::Error>;
    /// Answers the newest state.
    fn command(&mut self, what: Self::Command) -> Result<(), Self::Error>;
    /// The next words of the robot's controller about a stop, where it says some.
    fn heard(&mut self) -> Option<String> {
        None
    }
    /// What is newly to be told about the ways to the robot that it is not commanded by.
    fn notice(&mut self) -> Option<String> {
        None
    }
    /// Whether the robot itself has stopped, and may come back.
    fn is_of_the_robot(error: &Self::Error) -> bool;
    /// Whether there is no robot any more to come back.
    fn is_of_the_connection(error: &Self::Error) -> bool;
    /// After such an error.
    fn halt(&mut self);
    /// Whether it was stopped, and does not obey again yet.
    fn is_halted(&self) -> bool;
    /// A step of a robot that was stopped, which clears nothing unless it is `asked` to; whether it obeys again.
    fn recover(&mut self, asked: bool) -> Result<bool, Self::Error>;
    /// Brakes, waits for rest, and ends what obeys commands.
    fn come_to_rest(&mut self) -> Result<(), Self::Error>;
    /// Whatever can still be done after a fault.
    fn abandon(&mut self);
    /// What a command of control is to it, whose joints are counted already.
    fn of_message(&self, message: &DriveCommandMsg) -> Self::Command;
    /// Time, joints, state and code of a state.
    fn describe(&self, state: &Self::State, message: &mut DriveStateMsg);
}

/// The first values of a message.
pub(super) fn joints<const N: usize>(values: &[f64]) -> [f64; N] {
    std::array::from_fn(|i| values.get(i).copied().unwrap_or(f64::NAN))
}

/// How a run is joined.
#[derive(Debug, Clone)]
pub struct DriveJoining {
    /// Its instance.
    pub instance: Instance,
    /// SCHED_FIFO priority that is taken where it can be had; 0 for none.
    pub priority: u32,
    /// Names of the joints that are told, in the robot's order; without any, none are told.
    pub joint_names: Vec<String>,
    /// What the robot is told of what hangs on its flange.
    pub payload: DrivePayload,
}

/// Runs the drive until the run ends, whatever ends it; what it leaves is an arm at rest. `connect` gives the robot, and what to tell of it.
pub(super) fn run<A: RobotArm>(
    connect: impl FnOnce() -> Result<(A, String), ProcessError>,
    joining: &DriveJoining,
    stop: &StopFlag,
) -> Result<u8, ProcessError> {
    let DriveJoining { instance, priority, .. } = joining;
    if *priority > 0 {
        let asked = RealtimeRequest { priority: *priority, cpu: None, lock_memory: false };
        if let Some(Err(refusal)) = prepare_thread(&asked).fifo {
            tell(format_args!("{}: normal priority (SCHED_FIFO: {refusal})", A::PROGRAM));
        }
    }
    let result = drive(connect, joining, stop);
    if let Err(error) = &result {
        instance.leave_words_of_drive(&error.to_string());
    }
    instance.remove_leftovers(None);
    result
}

fn drive<A: RobotArm>(
    connect: impl FnOnce() -> Result<(A, String), ProcessError>,
    joining: &DriveJoining,
    stop: &StopFlag,
) -> Result<u8, ProcessError> {
    let DriveJoining { instance, joint_names, .. } = joining;
    let (arm, about) = connect()?;
    tell(format_args!("{}: {about}", A::PROGRAM));
    let services = Services::join(instance)?;
    // In this order: with both, the drive counts as present.
    let texts = services.drive_text_sender()?;
    let (commands, _listener) = services.drive_command_receiver()?;
    let states = services.drive_state_sender()?;
    let (run, word) = (DriveStage::Waits, None);
    let mut link = Link {
        instance,
        arm,
        commands,
        states,
        texts,
        joint_names,
        texts_sent: 0,
        sent: 0,
        count: 0,
        run,
        word,
        is_guarded: false,
        clear: ClearWish::None,
        heard: None,
        stop_words: String::new(),
    };
    let result = link.serve(stop);
    if result.is_err() {
        link.arm.abandon();
    }
    let (missed, delay_ns) = link.arm.missed();
    // A run that was too short tells no drift.
    let clock = link.arm.clock().filter(|clock| clock.drift_sd_ppm.is_finite()).map(|clock| {
        let ClockEstimate { drift_ppm, drift_sd_ppm, offset_sd_ns, .. } = clock;
        format!(
            ", its clock slower by {drift_ppm:.1} +- {drift_sd_ppm:.1} ppm, stamps within {:.3} ms",
            offset_sd_ns * 1e-6
        )
    });
    tell(format_args!(
        "{}: {} states, {missed} missed, latest by {:.1} ms{}",
        A::PROGRAM,
        link.count,
        SpanNs(delay_ns).as_s() * 1e3,
        clock.unwrap_or_default()
    ));
    result
}

/// How far a run is.
#[derive(Debug, Clone, Copy, PartialEq)]
enum DriveStage<C> {
    /// No START has come.
    Waits,
    /// The arm is held; no command has come since START.
    Held,
    /// The newest command, and when it came.
    Obeys(C, MonoNs),
}

/// What control wants of a robot that has stopped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum ClearWish {
    /// Nothing: the newest command is without CLEAR.
    None,
    /// That it clears its error.
    Asked,
    /// The same wish still, which was fulfilled: what stops it from now on needs another.
    Fulfilled,
}

struct Link<'a, A: RobotArm> {
    instance: &'a Instance,
    arm: A,
    commands: Receiver<DriveCommandMsg>,
    states: Sender<DriveStateMsg>,
    texts: QuietSender<DriveTextMsg>,
    joint_names: &'a [String],
    texts_sent: u64,
    sent: u64,
    count: u64,
    run: DriveStage<A::Command>,
    /// Where the guardian's stop is written.
    word: Option<StopWord>,
    /// Whether that stop stood at the last look.
    is_guarded: bool,
    clear: ClearWish,
    /// The controller's newest words, and when they came.
    heard: Option<(MonoNs, String)>,
    /// Why the robot has stopped, by its states.
    stop_words: String,
}

impl<A: RobotArm> Link<'_, A> {
    fn serve(&mut self, stop: &StopFlag) -> Result<u8, ProcessError> {
        loop {
            self.hear();
            let state = self.next()?;
            if let (Some(state), DriveStage::Held | DriveStage::Obeys(..)) = (&state, self.run) {
                self.count += 1;
                self.send(state, self.count, 0)?;
            }
            while let Some(command) = self.commands.receive()? {
                if command.flags & drive_flag::LAST != 0 {
                    self.rest()?;
                    return Ok(0);
                }
                self.clear = match (command.flags & drive_flag::CLEAR != 0, self.clear) {
                    (false, _) => ClearWish::None,
                    (true, ClearWish::None) => ClearWish::Asked,
                    (true, wish) => wish,
                };
                if command.flags & drive_flag::START != 0 {
                    self.start(&command, stop)?;
                } else if !matches!(self.run, DriveStage::Waits) {
                    self.run = DriveStage::Obeys(self.of_message(&command)?, now());
                }
            }
            if stop.is_requested() {
                self.rest()?;
                tell(format_args!("{}: a stop was requested; the arm is at rest", A::PROGRAM));
                return Ok(0);
            }
            let command = match self.run {
                DriveStage::Obeys(_, since) if now() - since > SILENCE => {
                    self.rest()?;
                    return Err(ProcessError::NoCommands { milliseconds: (now() - since).0 / 1_000_000 });
                }
                DriveStage::Obeys(command, _) => command,
                DriveStage::Waits | DriveStage::Held => A::HOLD,
            };
            let is_held = self.is_stopped_by_guardian() || self.clear != ClearWish::None;
            match state {
                Some(_) if self.arm.is_halted() => self.recover()?,
                Some(_) => self.arm.command(if is_held { A::HOLD } else { command }).map_err(Into::into)?,
                None => {}
            }
        }
    }

    /// The next state. One in which the robot has stopped by itself is a state as any other, from when on it says so.
    fn next(&mut self) -> Result<Option<A::State>, ProcessError> {
        match self.arm.next(WAIT) {
            Err(error) if A::is_of_the_robot(&error) => {
                self.arm.halt();
                self.tell_stop(&error);
                Ok(self.arm.last())
            }
            other => other.map_err(Into::into),
        }
    }

    /// Why the robot does not move: for the log, for who asks how things stand, and for the summary where the run ends by it.
    fn tell_stop(&mut self, error: &A::Error) {
        self.stop_words = error.to_string();
        let said = self.heard.take().filter(|(when, _)| now() - *when < SAID_BEFORE);
        self.tell_words(said.map(|(_, words)| words));
    }

    fn tell_words(&mut self, said: Option<String>) {
        let words = match said {
            Some(said) => format!("{}; its controller says: {said}", self.stop_words),
            None => self.stop_words.clone(),
        };
        tell(format_args!("{}: {words}", A::PROGRAM));
        self.instance.leave_words_of_drive(&words);
        self.send_words(&words);
    }

    /// Takes in what the controller says, which may come before or after the state that shows the stop.
    fn hear(&mut self) {
        while let Some(words) = self.arm.notice() {
            tell(format_args!("{}: {words}", A::PROGRAM));
        }
        while let Some(words) = self.arm.heard() {
            if self.arm.is_halted() {
                self.tell_words(Some(words));
            } else {
                tell(format_args!("{}: the robot's controller says: {words}", A::PROGRAM));
                self.heard = Some((now(), words));
            }
        }
    }

    /// What there is to say of the robot's newest state. What cannot be sent is in the log all the same.
    fn send_words(&mut self, words: &str) {
        let mut state = DriveStateMsg::default();
        if let Some(last) = self.arm.last() {
            self.arm.describe(&last, &mut state);
        }
        let robot_state = RobotState::from_code(state.robot_state);
        let _ = self.send_text(DriveTextMsg::of_robot(robot_state, state.robot_code, words));
    }

    fn send_text(&mut self, mut text: DriveTextMsg) -> Result<(), ProcessError> {
        (text.sequence, text.stamp) = (self.texts_sent, now());
        self.texts_sent += 1;
        Ok(self.texts.send(|| text)?)
    }

    /// A step of a robot that has stopped by itself.
    fn recover(&mut self) -> Result<(), ProcessError> {
        match self.arm.recover(self.clear == ClearWish::Asked) {
            Ok(false) => {}
            Ok(true) => {
                self.clear = ClearWish::Fulfilled;
                self.instance.leave_words_of_drive(""); // what comes later has other reasons
                self.send_words("");
                tell(format_args!("{}: {}", A::PROGRAM, A::BACK));
            }
            Err(error) if A::is_of_the_connection(&error) => return Err(error.into()),
            // Somebody sees to it, and asks again.
            Err(error) => self.tell_stop(&error),
        }
        Ok(())
    }

    /// Leaves an arm at rest, without a program that could go on.
    fn rest(&mut self) -> Result<(), ProcessError> {
        if self.arm.is_halted() {
            self.arm.abandon();
        }
        self.arm.come_to_rest().map_err(Into::into)
    }

    /// A run begins: the robot is made to obey, once, and its state is the answer, each time. A stop that is requested while the robot is switched on ends that.
    fn start(&mut self, command: &DriveCommandMsg, stop: &StopFlag) -> Result<(), ProcessError> {
        if command.flags & drive_flag::LOCKSTEP != 0 {
            return Err(ProcessError::DriveLockstep);
        }
        // Control makes it before its first START.
        self.word = self.instance.open_stop_word().ok().flatten();
        if matches!(self.run, DriveStage::Waits) {
            if !self.arm.begin(command.mode, &|| stop.is_requested()).map_err(Into::into)? {
                return Ok(());
            }
            self.run = DriveStage::Held;
        }
        // Before the answer, which control takes with what came before it.
        if !self.joint_names.is_empty() {
            self.send_text(DriveTextMsg::of_joints(self.joint_names))?;
        }
        let properties = self.arm.properties(command.mode);
        self.send_text(DriveTextMsg::of_properties(&properties.to_string()))?;
        match self.arm.last() {
            Some(state) => self.send(&state, 0, drive_flag::INITIAL),
            None => Ok(()),
        }
    }

    /// Whether the guardian's stop stands; tells when it has come.
    fn is_stopped_by_guardian(&mut self) -> bool {
        let stands = self.word.as_ref().is_some_and(StopWord::is_stopped_by_guardian);
        if stands && !std::mem::replace(&mut self.is_guarded, stands) {
            tell(format_args!(
                "{}: the guardian has stopped the arm; it is held until that is reset",
                A::PROGRAM
            ));
        }
        self.is_guarded = stands;
        stands
    }

    fn send(&mut self, state: &A::State, tick: u64, flags: u32) -> Result<(), ProcessError> {
        let mut message = DriveStateMsg {
            tick,
            sequence: self.sent,
            joints: A::JOINTS as u32,
            modes: A::MODES,
            flags,
            ..Default::default()
        };
        self.arm.describe(state, &mut message);
        self.sent += 1;
        Ok(self.states.send(&message)?)
    }

    /// What the robot shall do by a command of control.
    fn of_message(&self, message: &DriveCommandMsg) -> Result<A::Command, ProcessError> {
        if message.joints as usize != A::JOINTS {
            return Err(ProcessError::DriveJoints { drive: A::JOINTS as u32, robot: message.joints });
        }
        Ok(self.arm.of_message(message))
    }
}
