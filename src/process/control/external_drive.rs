//! Control's connection to an external drive: messages between shared memory and the [`DriveLink`](crate::drive::DriveLink) of the
//! drive core.
//!
//! ```text
//! drive/state   ──► DrivePorts ──ring──► Rings (DriveLink) ──► ExternalDrive::read
//! drive/command ◄── DrivePorts ◄─ring─── Rings (DriveLink) ◄── ExternalDrive::write
//! ```
//! In real time the ports belong to the companion thread and the rings cross to the real-time thread. In lockstep both
//! ends are on one thread, which waits for the answer to every command.

use super::commands::Commands;
use super::drive_rings::{Lost, Rings};
use super::drive_words::DriveWords;
use super::stops::Stops;
use crate::config::Config;
use crate::config::{Clock, DriveKind, Task};
use crate::control::safety::ABSURD_SPEED;
use crate::drive::{CommandMode, DriveFault, DriveProperties, ExternalDrive};
use crate::ipc::{DrivePresence, Receiver, Sender, Spin, WakeListener};
use crate::messages::{DriveCommandMsg, DriveStateMsg, MAX_JOINTS, RobotState, drive_flag};
use crate::motion::MotionLimits;
use crate::process::{LONGEST_SPIN, LONGEST_WAIT, Membership, ProcessError};
use crate::robot::{POSITION_RAD_OR_M, joint_in_words};
use crate::rt::now;
use crate::time::{MonoNs, SpanNs, TICK};
use nalgebra::SVector;
use rtrb::{Consumer, Producer, RingBuffer};
use std::time::Duration;
use tracing::{info, warn};

/// States that wait for a tick. Chosen by hand: the newest one alone is used, and a companion that lags more ticks must have stopped.
const STATES: usize = 64;
/// Commands that wait for the companion: a quarter of a second. Chosen by hand; a command that finds no room is counted as lost.
const COMMANDS: usize = 256;
/// Time after which an unanswered start is requested again. Chosen by hand: some hundred times an answer, which takes a tick or two.
const ASK_AGAIN: SpanNs = SpanNs(500_000_000);
/// Time after the begin of a tick at which its command is looked for. Measured: a tick with an external drive takes 15 us, and 48 us at the 99th percentile; twice that.
const AFTER_TICK: SpanNs = SpanNs(100_000);
/// Where it was not there then it is looked for after this. Chosen by hand: a fifth of a tick, so that a late command is hardly later.
const LOOK_AGAIN: Duration = Duration::from_micros(200);
/// Time without an answer after which control looks for the drive's process. Chosen by hand: hundreds of ticks, so that a drive that pauses is not
/// searched for in each of them, and short for a user who waits.
const LOOK_AFTER: SpanNs = SpanNs(500_000_000);
/// Period of the messages while the drive is awaited. Chosen by hand, for people.
pub(super) const TELL: SpanNs = SpanNs(4_000_000_000);
/// Periods of the search for a drive: 2 ms in the first half second, so that one that is starting is met at once, then 20 ms. Chosen by hand:
/// with the second the wait costs little while no drive comes, and a user hardly notices that it is longer.
pub(super) const LOOK_FIRST: Duration = Duration::from_millis(2);
pub(super) const LOOK_LATER: Duration = Duration::from_millis(20);
pub(super) const HURRY: SpanNs = SpanNs(500_000_000);
/// Time that the drive has to receive the end of the run. Chosen by hand: 200 of its ticks, because messages vanish with their sender.
const FAREWELL: SpanNs = SpanNs(200_000_000);
/// Time that a run which is to stop still waits for the drive. Chosen by hand: hundreds of its ticks; a user who has pressed Ctrl-C hardly notices it.
const STOP_PATIENCE: SpanNs = SpanNs(300_000_000);

/// The result of the wait for a state.
pub(super) enum WaitOutcome {
    /// The state arrived.
    Here,
    /// The state will not arrive.
    Failed(DriveFault),
}

/// The process's end of the rings, and the ports.
pub(super) struct DrivePorts<'a> {
    membership: &'a Membership,
    presence: DrivePresence,
    received: Producer<DriveStateMsg>,
    to_send: Consumer<DriveCommandMsg>,
    /// Commands that were lost because the ring was full.
    lost_commands: Lost,
    /// States that were lost because the ring was full.
    lost_states: u64,
    command: Sender<DriveCommandMsg>,
    /// Commands sent.
    sent: u64,
    /// Time of the tick of the last one.
    tick_of_command: MonoNs,
    state: Receiver<DriveStateMsg>,
    /// What the newest state tells of the robot.
    robot: RobotState,
    words: DriveWords,
    /// How fast each joint may be, rad/s or m/s.
    speeds: Vec<f64>,
    wake_listener: WakeListener,
    answer_timeout: SpanNs,
    spin: Spin,
}

/// The drive core and the process's end of it, where the configuration wants an external drive.
pub(super) fn open<'a, const N: usize>(
    config: &Config,
    membership: &'a Membership,
) -> Result<Option<(ExternalDrive<N>, DrivePorts<'a>)>, ProcessError> {
    if config.drive.kind != DriveKind::External {
        return Ok(None);
    }
    let services = membership.services();
    let (received, states) = RingBuffer::new(STATES);
    let (commands, to_send) = RingBuffer::new(COMMANDS);
    let timeout = match config.clock {
        Clock::Realtime => config.safety.drive_timeout,
        Clock::Lockstep => SpanNs(i64::MAX), // simulated time stands still while control waits
    };
    let q_start: SVector<f64, N> = crate::config::assemble::q_start(config)?;
    let lost_commands = Lost::default();
    let link = Box::new(Rings { states, commands, lost_commands: lost_commands.clone() });
    let robot = config.robot.build::<N>()?;
    let limits = MotionLimits::of(&robot, SVector::zeros(), SVector::zeros());
    let speeds = (0..N).map(|i| limits.speed(i)).collect();
    let drive = ExternalDrive::new(link, config.drive.mode, timeout, q_start)
        .with_contents(config.drive.torque_contains, robot);
    let words = DriveWords::open(services, config)?;
    let (state, wake_listener) = services.drive_state_receiver()?;
    let command = services.drive_command_sender()?;
    let answer_timeout = config.drive.external.answer_timeout;
    let presence = services.drive_presence()?;
    let spin = Spin::new(LONGEST_SPIN);
    let ports = DrivePorts {
        membership,
        presence,
        received,
        to_send,
        lost_commands,
        lost_states: 0,
        command,
        sent: 0,
        tick_of_command: MonoNs::ZERO,
        state,
        robot: RobotState::Unknown,
        words,
        speeds,
        wake_listener,
        answer_timeout,
        spin,
    };
    Ok(Some((drive, ports)))
}

impl DrivePorts<'_> {
    /// Waits for a drive, starts it and takes its first state; without one when a stop is requested meanwhile.
    pub(super) fn connect(
        &mut self,
        config: &Config,
        stops: &Stops,
        commands: &mut Commands,
    ) -> Result<(), ProcessError> {
        let mut start = DriveCommandMsg {
            joints: config.start.q.len() as u32,
            mode: config.drive.mode as u32,
            flags: drive_flag::START | config.drive.torque_contains.flags(config.drive.mode),
            ..DriveCommandMsg::default()
        };
        if config.clock == Clock::Lockstep {
            start.flags |= drive_flag::LOCKSTEP;
        }
        for (to, from) in start.q_r.iter_mut().zip(&config.start.q).take(MAX_JOINTS) {
            *to = *from;
        }
        let mut wait = DriveWait::new(config);
        let mut asked = None;
        while !stops.end_the_start() {
            self.membership.beat();
            commands.attend(stops);
            wait.look(&self.presence, asked.is_some())?;
            if !self.presence.is_there() {
                std::thread::sleep(wait.pause());
                continue;
            }
            if asked.is_none_or(|at| now() - at > ASK_AGAIN) {
                self.membership.services().remove_dead_peers();
                if config.clock == Clock::Realtime {
                    start.stamp = now();
                }
                self.send_counted(start)?;
                asked = Some(now());
            }
            self.wake_listener.wait(LONGEST_WAIT)?;
            while let Some(mut state) = self.state.receive()?.map(|state| *state) {
                if state.flags & drive_flag::INITIAL != 0 {
                    // What was sent before that state has come.
                    self.words.take()?;
                    self.hand_words_to(commands);
                    check(&state, &start, (config.drive.mode, &self.speeds), &config.robot.joint_names())?;
                    if lacks_torques(config, &state) {
                        return Err(ProcessError::DriveWithoutTorques { mode: config.drive.mode.as_str() });
                    }
                    if config.clock == Clock::Realtime {
                        state.stamp = state.stamp.min(now());
                    }
                    self.robot = RobotState::from_code(state.robot_state);
                    let _ = self.received.push(state);
                    self.words.tell_of_names();
                    info!(
                        joints = state.joints,
                        mode = config.drive.mode.as_str(),
                        "external drive connected"
                    );
                    return Ok(());
                }
            }
        }
        Ok(())
    }

    /// What the drive has told of itself, once it is connected.
    pub(super) fn properties(&self) -> &DriveProperties {
        self.words.properties()
    }

    /// Lockstep: sends what the drive core wants sent, all of it: one command that does not get through keeps none back.
    pub(super) fn send(&mut self) -> Result<(), ProcessError> {
        let mut sent = Ok(());
        while let Ok(command) = self.to_send.pop() {
            self.tick_of_command = command.stamp;
            sent = sent.and(self.send_counted(command));
        }
        sent
    }

    fn send_counted(&mut self, command: DriveCommandMsg) -> Result<(), ProcessError> {
        self.command.send(&DriveCommandMsg { sequence: self.sent, ..command })?;
        self.sent += 1;
        Ok(())
    }

    /// Lockstep: waits for the state of `tick`, the one answer to the command before.
    pub(super) fn wait_for_state(&mut self, tick: u64, stops: &Stops) -> Result<WaitOutcome, ProcessError> {
        let began = now();
        let mut looked = began;
        let mut stopped = None;
        loop {
            self.membership.beat();
            while let Some(state) = self.state.receive()? {
                if state.flags & drive_flag::INITIAL != 0 {
                    continue; // the answer to a start that was asked for twice
                }
                if state.tick != tick {
                    warn!(wanted = tick, got = state.tick, "the external drive is out of step");
                    return Ok(WaitOutcome::Failed(DriveFault::OutOfStep));
                }
                self.robot = RobotState::from_code(state.robot_state);
                let _ = self.received.push(*state);
                return Ok(WaitOutcome::Here);
            }
            let time = now();
            if stops.are_asked() && time - *stopped.get_or_insert(time) > STOP_PATIENCE {
                return Ok(WaitOutcome::Failed(DriveFault::Silent));
            }
            if time - began > self.answer_timeout {
                return Ok(WaitOutcome::Failed(DriveFault::Silent));
            }
            if time - looked > LOOK_AFTER {
                looked = time;
                self.membership.services().remove_dead_peers();
                if !self.presence.is_there() {
                    return Ok(WaitOutcome::Failed(DriveFault::Left));
                }
            }
            self.wake_listener.wait_spinning(LONGEST_WAIT, &mut self.spin, || self.state.is_waiting())?;
        }
    }

    /// Real time: waits for a state, or until a command is due, and carries everything there is both ways, also where one of them fails.
    pub(super) fn carry(&mut self) -> Result<(), ProcessError> {
        let sent = self.send();
        let waited = self.wake_listener.wait(self.until_command()).map_err(ProcessError::from);
        let taken = self.take_states();
        let told = self.words.take();
        sent.and(waited).and(taken).and(told).and(self.send())
    }

    /// Lockstep: takes what the drive says beside its states, without which the arm can be braked.
    pub(super) fn take_words(&mut self) -> Result<(), ProcessError> {
        self.words.take()
    }

    /// What the drive says, for who asks how things stand.
    pub(super) fn hand_words_to(&mut self, commands: &mut Commands) {
        if let Some(words) = self.words.next() {
            commands.note_words(&words);
        }
    }

    /// States wake this thread, and commands do not, since the real-time thread makes no system call for them: it looks for them when they are due.
    fn until_command(&self) -> Duration {
        let due = self.tick_of_command + TICK + AFTER_TICK - now();
        if due > SpanNs::ZERO { Duration::from_nanos(due.0.unsigned_abs()) } else { LOOK_AGAIN }
    }

    fn take_states(&mut self) -> Result<(), ProcessError> {
        while let Some(mut state) = self.state.receive()?.map(|state| *state) {
            // A drive whose clock runs ahead must not look fresh for ever.
            state.stamp = state.stamp.min(now());
            self.robot = RobotState::from_code(state.robot_state);
            // Full only when the real-time thread has ended or stalls: it takes the newest anyway.
            self.lost_states += u64::from(self.received.push(state).is_err());
        }
        Ok(())
    }
}

/// Whether the torques of a load calibration are neither commanded nor measured.
fn lacks_torques(config: &Config, state: &DriveStateMsg) -> bool {
    let measures = state.tau.iter().any(|tau| *tau != 0.0);
    config.task == Task::CalibrateLoad && config.drive.mode != CommandMode::Torque && !measures
}

/// The wait for a drive: reported from time to time, and bounded.
struct DriveWait {
    began: MonoNs,
    told: Option<MonoNs>,
    /// The run has started the drive itself; people may take their time to start theirs, but then it is to answer.
    supervised: bool,
    there_since: Option<MonoNs>,
    timeout: SpanNs,
    /// A run that is to end by itself does not wait longer than it may last.
    longest: Option<SpanNs>,
}

impl DriveWait {
    fn new(config: &Config) -> Self {
        let external = &config.drive.external;
        Self {
            began: now(),
            told: None,
            supervised: !external.command.is_empty(),
            there_since: None,
            timeout: external.connect_timeout,
            longest: (!config.serve).then_some(config.duration),
        }
    }

    /// Must be called repeatedly until the drive has answered.
    fn look(&mut self, presence: &DrivePresence, asked: bool) -> Result<(), ProcessError> {
        let time = now();
        let there = presence.is_there();
        self.there_since = if there { self.there_since.or(Some(time)) } else { None };
        let since = if self.supervised { Some(self.began) } else { self.there_since };
        let state = || {
            if there { "it is there, but does not answer START".into() } else { presence.describe() }
        };
        let limit = if since.is_some_and(|since| time - since > self.timeout) {
            Some("drive.external.connect_timeout_s")
        } else {
            self.longest.filter(|longest| time - self.began > *longest).map(|_| "run.duration_s")
        };
        if let Some(limit) = limit {
            return Err(ProcessError::DriveAbsent {
                waited_s: (time - self.began).as_s(),
                limit,
                state: state(),
            });
        }
        match self.told {
            None if !there => {
                info!("waiting for the external drive of this instance");
                self.told = Some(time);
            }
            None => self.told = Some(time),
            Some(told) if time - told > TELL && (asked || !there) => {
                warn!(
                    "still waiting for the external drive, for {:.0} s now: {}",
                    (time - self.began).as_s(),
                    state()
                );
                self.told = Some(time);
            }
            Some(_) => {}
        }
        Ok(())
    }

    fn pause(&self) -> Duration {
        if now() - self.began < HURRY { LOOK_FIRST } else { LOOK_LATER }
    }
}

/// What is left to tell of a drive.
#[derive(Debug, Default)]
pub(super) struct DriveEnd {
    /// Commands that were lost on their way here.
    pub(super) lost_commands: u64,
    /// What it says of a robot that does not obey.
    pub(super) robot_words: Option<String>,
}

/// Messages vanish with their sender: after the last command, waits until the drive has received it and left.
pub(super) fn farewell(drive: Option<DrivePorts<'_>>) -> Result<DriveEnd, ProcessError> {
    let Some(mut drive) = drive else { return Ok(DriveEnd::default()) };
    let sent = drive.send();
    let lost_commands = drive.lost_commands.count();
    if lost_commands > 0 || drive.lost_states > 0 {
        warn!(
            commands = lost_commands,
            states = drive.lost_states,
            "messages of the external drive found no room between control's threads"
        );
    }
    let until = now() + FAREWELL;
    while now() < until && drive.presence.is_there() {
        std::thread::sleep(Duration::from_millis(2));
    }
    let robot_words = drive.words.at_the_end(drive.robot);
    sent.map(|()| DriveEnd { lost_commands, robot_words })
}

fn check(
    state: &DriveStateMsg,
    start: &DriveCommandMsg,
    (mode, speeds): (CommandMode, &[f64]),
    names: &[String],
) -> Result<(), ProcessError> {
    if state.joints != start.joints {
        return Err(ProcessError::DriveJoints { drive: state.joints, robot: start.joints });
    }
    if state.modes & mode.bit() == 0 {
        let takes = CommandMode::ALL.into_iter().filter(|m| state.modes & m.bit() != 0);
        let takes = takes.map(CommandMode::as_str).collect::<Vec<_>>().join(", ");
        return Err(ProcessError::DriveMode { mode, takes });
    }
    let joints = state.q.iter().zip(&state.qd).enumerate().take(start.joints as usize);
    for (i, (q, qd)) in joints {
        // Later states that are as fast are a fault; this one would be taken for where the arm is. In this form NaN is out of range too.
        let limit = speeds.get(i).copied().unwrap_or_default();
        if !(q.abs() <= POSITION_RAD_OR_M && qd.abs() <= ABSURD_SPEED * limit) {
            return Err(ProcessError::DriveState { joint: joint_in_words(names, i), q: *q, qd: *qd, limit });
        }
    }
    Ok(())
}
