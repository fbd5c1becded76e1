//! The drive of an arm of Universal Robots: a process of its own between control and the robot's controller.
//!
//! ```text
//! drive/command (1 kHz) ─► the newest, at each state ─► registers ─► program on the robot: servoj, speedj
//! drive/state           ◄─ each state, 500 or 125 Hz, with the time of its sample ◄─ RTDE
//! START ─► ready? program ─► INITIAL      LAST, a stop, silence ─► braked, at rest, program ended      a fault ─► its words, exit code 4
//! the robot stops ─► its words, states with what the robot is ─ CLEAR ─► unlocked, program started ─► ready
//! ```
//! The robot's states set the pace: a state comes, is passed on, and the newest command goes back. Without commands for a tenth of a second the arm is braked; without
//! this process the program on the robot does so. While the guardian's stop stands, the arm is held whatever is commanded.

use super::{ProcessError, StopFlag};
use crate::config::RealtimeRequest;
use crate::drive::CommandMode;
use crate::ipc::{Instance, Receiver, Sender, Services, StopWord};
use crate::messages::{DriveCommandMsg, DriveStateMsg, RobotState, drive_flag};
use crate::rt::{now, prepare_thread, tell};
use crate::time::{MonoNs, SpanNs};
use std::time::Duration;
use vservo_ur::arm::{ArmState, Recovered};
use vservo_ur::program::state as program_state;
use vservo_ur::{Arm, ArmSettings, Command, JOINTS, RobotMode, SafetyMode, UrError};

/// Longest time without a command while a run goes on. Chosen by hand: a hundred ticks; control that is late by more has ended.
const SILENCE: SpanNs = SpanNs(100_000_000);
/// Longest wait for a state, after which requests to stop are looked at. Chosen by hand: some cycles of either series.
const WAIT: Duration = Duration::from_millis(20);
/// The command modes that the robot takes.
const MODES: u32 = (1 << CommandMode::Velocity as u32) | (1 << CommandMode::Position as u32);

/// Runs the drive until the run ends, whatever ends it; what it leaves is an arm at rest. Powers the arm and releases its brakes only with `enable`. Takes SCHED_FIFO
/// of this priority where it is not 0 and can be had.
///
/// # Errors
/// When the robot cannot be moved, or no longer, and when the run cannot be joined.
pub fn run(
    settings: ArmSettings,
    enable: bool,
    priority: u32,
    instance: &Instance,
    stop: &StopFlag,
) -> Result<u8, ProcessError> {
    if priority > 0 {
        let asked = RealtimeRequest { priority, cpu: None, lock_memory: false };
        if let Some(Err(refusal)) = prepare_thread(&asked).fifo {
            tell(format_args!("vservo-drive-ur: normal priority (SCHED_FIFO: {refusal})"));
        }
    }
    let result = drive(settings, enable, instance, stop);
    if let Err(error) = &result {
        instance.leave_words_of_drive(&error.to_string());
    }
    instance.remove_leftovers(None);
    result
}

fn drive(
    settings: ArmSettings,
    enable: bool,
    instance: &Instance,
    stop: &StopFlag,
) -> Result<u8, ProcessError> {
    let arm = Arm::connect(settings)?;
    tell(format_args!(
        "vservo-drive-ur: robot at {}, software {}, {:.0} Hz",
        settings.host,
        arm.version(),
        arm.series().rate_hz()
    ));
    let services = Services::join(instance)?;
    // In this order: with both, the drive counts as present.
    let (commands, _listener) = services.drive_command_receiver()?;
    let states = services.drive_state_sender()?;
    let (run, word) = (DriveStage::Waits, None);
    let mut link = Link {
        instance,
        arm,
        commands,
        states,
        sent: 0,
        count: 0,
        run,
        word,
        is_guarded: false,
        clear: ClearWish::None,
    };
    let result = link.serve(enable, stop);
    if result.is_err() {
        link.arm.abandon();
    }
    let (missed, delay_ns) = link.arm.missed();
    tell(format_args!(
        "vservo-drive-ur: {} states, {missed} missed, latest by {:.1} ms",
        link.count,
        SpanNs(delay_ns).as_s() * 1e3
    ));
    result
}

/// How far a run is.
#[derive(Debug, Clone, Copy, PartialEq)]
enum DriveStage {
    /// No START has come.
    Waits,
    /// The arm is held; no command has come since START.
    Held,
    /// The newest command, and when it came.
    Obeys(Command, MonoNs),
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

struct Link<'a> {
    instance: &'a Instance,
    arm: Arm,
    commands: Receiver<DriveCommandMsg>,
    states: Sender<DriveStateMsg>,
    sent: u64,
    count: u64,
    run: DriveStage,
    /// Where the guardian's stop is written.
    word: Option<StopWord>,
    /// Whether that stop stood at the last look.
    is_guarded: bool,
    clear: ClearWish,
}

impl Link<'_> {
    fn serve(&mut self, enable: bool, stop: &StopFlag) -> Result<u8, ProcessError> {
        loop {
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
                    self.start(&command, enable, stop)?;
                } else if self.run != DriveStage::Waits {
                    self.run = DriveStage::Obeys(of_message(&command)?, now());
                }
            }
            if stop.is_requested() {
                self.rest()?;
                tell("vservo-drive-ur: a stop was requested; the arm is at rest");
                return Ok(0);
            }
            let command = match self.run {
                DriveStage::Obeys(_, since) if now() - since > SILENCE => {
                    self.rest()?;
                    return Err(ProcessError::NoCommands { milliseconds: (now() - since).0 / 1_000_000 });
                }
                DriveStage::Obeys(command, _) => command,
                DriveStage::Waits | DriveStage::Held => Command::Hold,
            };
            let is_held = self.is_stopped_by_guardian() || self.clear != ClearWish::None;
            match state {
                Some(_) if self.arm.is_halted() => self.recover()?,
                Some(_) => self.arm.command(if is_held { Command::Hold } else { command })?,
                None => {}
            }
        }
    }

    /// The next state. One in which the robot has stopped by itself is a state as any other, from when on it says so.
    fn next(&mut self) -> Result<Option<ArmState>, ProcessError> {
        match self.arm.next(WAIT) {
            Err(error) if error.is_of_the_robot() => {
                self.arm.halt();
                self.tell_stop(&error);
                Ok(self.arm.last().copied())
            }
            other => Ok(other?),
        }
    }

    /// Why the robot does not move: for the log, and for the summary where the run ends by it.
    fn tell_stop(&self, error: &UrError) {
        tell(format_args!("vservo-drive-ur: {error}"));
        self.instance.leave_words_of_drive(&error.to_string());
    }

    /// A step of a robot that has stopped by itself.
    fn recover(&mut self) -> Result<(), ProcessError> {
        match self.arm.recover(self.clear == ClearWish::Asked) {
            Ok(Recovered::Not) => {}
            Ok(Recovered::Ready) => {
                self.clear = ClearWish::Fulfilled;
                self.instance.leave_words_of_drive(""); // what comes later has other reasons
                tell("vservo-drive-ur: the robot's program runs again");
            }
            Err(error @ (UrError::Lost { .. } | UrError::Wire { .. })) => return Err(error.into()),
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
        Ok(self.arm.come_to_rest()?)
    }

    /// What the robot is beside its joints.
    fn robot_state(&self, s: &ArmState) -> RobotState {
        match (s.safety, s.mode) {
            (SafetyMode::RobotEmergencyStop | SafetyMode::SystemEmergencyStop, _) => {
                RobotState::EmergencyStop
            }
            (
                SafetyMode::ProtectiveStop
                | SafetyMode::SafeguardStop
                | SafetyMode::AutomaticModeSafeguardStop
                | SafetyMode::ThreePositionEnablingStop,
                _,
            ) => RobotState::ProtectiveStop,
            (safety, _) if !safety.lets_move() => RobotState::Fault,
            (_, RobotMode::PowerOn) => RobotState::Enabling,
            (_, RobotMode::Idle) => RobotState::Braked,
            (_, RobotMode::Running) if self.arm.is_halted() => RobotState::Halted,
            (SafetyMode::Reduced, RobotMode::Running) => RobotState::Reduced,
            (_, RobotMode::Running) if s.program[0] == program_state::MOVES && !s.rests() => {
                RobotState::Moving
            }
            (_, RobotMode::Running) => RobotState::Ready,
            (_, RobotMode::Backdrive | RobotMode::UpdatingFirmware | RobotMode::Unknown(_)) => {
                RobotState::Fault
            }
            _ => RobotState::Off,
        }
    }

    /// A run begins: the program is sent, once, and the robot's state is the answer, each time. A stop that is requested while the robot is switched on ends that.
    fn start(
        &mut self,
        command: &DriveCommandMsg,
        enable: bool,
        stop: &StopFlag,
    ) -> Result<(), ProcessError> {
        if command.flags & drive_flag::LOCKSTEP != 0 {
            return Err(ProcessError::DriveLockstep);
        }
        // Control makes it before its first START.
        self.word = self.instance.open_stop_word().ok().flatten();
        if self.run == DriveStage::Waits {
            if !self.arm.make_ready(enable, &|| stop.is_requested())? {
                return Ok(());
            }
            self.arm.start()?;
            self.run = DriveStage::Held;
        }
        match self.arm.last().copied() {
            Some(state) => self.send(&state, 0, drive_flag::INITIAL),
            None => Ok(()),
        }
    }

    /// Whether the guardian's stop stands; tells when it has come.
    fn is_stopped_by_guardian(&mut self) -> bool {
        let stands = self.word.as_ref().is_some_and(StopWord::is_stopped_by_guardian);
        if stands && !std::mem::replace(&mut self.is_guarded, stands) {
            tell("vservo-drive-ur: the guardian has stopped the arm; it is held until that is reset");
        }
        self.is_guarded = stands;
        stands
    }

    fn send(&mut self, state: &ArmState, tick: u64, flags: u32) -> Result<(), ProcessError> {
        let mut message = DriveStateMsg {
            tick,
            sequence: self.sent,
            stamp: MonoNs(state.stamp),
            joints: JOINTS as u32,
            modes: MODES,
            flags,
            robot_state: self.robot_state(state) as u32,
            robot_code: robot_code(state),
            ..Default::default()
        };
        for (to, from) in message.q.iter_mut().zip(&state.q) {
            *to = *from;
        }
        for (to, from) in message.qd.iter_mut().zip(&state.qd) {
            *to = *from;
        }
        self.sent += 1;
        Ok(self.states.send(&message)?)
    }
}

/// The maker's numbers of the robot's and the safety system's mode: 703 is a running robot in a protective stop.
fn robot_code(s: &ArmState) -> u32 {
    let number = |n: i32| u32::try_from(n).unwrap_or(0);
    100 * number(s.mode.number()) + number(s.safety.number())
}

/// What the robot shall do by a command of control.
fn of_message(message: &DriveCommandMsg) -> Result<Command, ProcessError> {
    if message.joints as usize != JOINTS {
        return Err(ProcessError::DriveJoints { drive: JOINTS as u32, robot: message.joints });
    }
    let joints = |values: &[f64]| std::array::from_fn(|i| values.get(i).copied().unwrap_or(f64::NAN));
    match message.mode {
        mode if mode == CommandMode::Velocity as u32 => Ok(Command::Velocity(joints(&message.qd_r))),
        mode if mode == CommandMode::Position as u32 => Ok(Command::Position(joints(&message.q_r))),
        // Control asks for no mode that the first state does not name.
        _ => Ok(Command::Hold),
    }
}

/// Unlocks a protective stop, because somebody asks for it by name.
///
/// # Errors
/// When the robot's dashboard does not.
pub fn unlock(settings: &ArmSettings) -> Result<u8, ProcessError> {
    let patience = settings.patience;
    let mut dashboard = vservo_ur::dashboard::Dashboard::connect(settings.host, patience, settings.clock)?;
    dashboard.unlock_protective_stop()?;
    let safety = dashboard.safety_status()?;
    tell(format_args!("vservo-drive-ur: unlocked; safety status {safety}"));
    Ok(0)
}
