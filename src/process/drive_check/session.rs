//! One life of the drive's program: START, the phases of a plan, LAST.

use super::HoldingTorques;
use crate::config::Config;
use crate::drive::check::{
    DriveLog, DriveTrial, ENDS_WITHIN, LoggedPhase, PhaseKind, ProgramExit, ReceivedState, ReceivedText,
    SentCommand, TrialPlan, departs,
};
use crate::drive::{CommandMode, TorqueContents};
use crate::ipc::{DrivePresence, Instance, Receiver, Sender, WakeListener};
use crate::messages::{DriveCommandMsg, DriveStateMsg, DriveTextMsg, MAX_JOINTS, drive_flag};
use crate::process::drive_guard::GRACE_OF_DRIVE;
use crate::process::supervisor::child::Child;
use crate::process::{Membership, ProcessError, StopFlag};
use crate::rt::{now, tell};
use crate::time::{MonoNs, SpanNs, TICK};
use std::time::Duration;

/// Time after which an unanswered START is sent again, as control does.
const ASK_AGAIN: SpanNs = SpanNs(500_000_000);
/// Time that a drive has to answer a second START. Chosen by hand: some hundred times what an answer takes.
const AGAIN_WITHIN: SpanNs = SpanNs(2_000_000_000);
/// Period of the looks for a drive, and for the end of its program. Chosen by hand: a user does not notice it.
const LOOK: Duration = Duration::from_millis(5);
/// Time for which the arm is told to hold before LAST. Chosen by hand: at the speeds of a trial an arm brakes within a few of them.
const HOLDS: SpanNs = SpanNs(100_000_000);
/// Longest time without a state, beside `safety.drive_timeout_ms`, before a trial is given up. Chosen by hand: a busy machine is not taken for a drive that is gone.
const MISSING: SpanNs = SpanNs(500_000_000);
/// How long it is waited for a drive that was started by hand to leave after LAST. Chosen by hand: nothing is told from it but that messages have arrived.
const FAREWELL: SpanNs = SpanNs(500_000_000);
/// Time that the guard has to end a program that did not end by itself: what it gives the program, and a second for itself. Chosen by hand.
const GUARD: SpanNs = SpanNs(GRACE_OF_DRIVE.0 + 1_000_000_000);

pub(super) struct TrialSession<'a> {
    pub(super) instance: &'a Instance,
    pub(super) stop: &'a StopFlag,
    pub(super) membership: Membership,
    pub(super) presence: DrivePresence,
    pub(super) command: Sender<DriveCommandMsg>,
    pub(super) state: Receiver<DriveStateMsg>,
    pub(super) texts: Receiver<DriveTextMsg>,
    pub(super) listener: WakeListener,
    pub(super) program: Option<Child>,
    /// Longest wait for an answer in lockstep.
    pub(super) answer_timeout: SpanNs,
    pub(super) torques: HoldingTorques,
    /// What they contain.
    pub(super) contents: TorqueContents,
    pub(super) log: DriveLog,
}

impl TrialSession<'_> {
    /// START and the phases of the plan.
    pub(super) fn go(&mut self, config: &Config, moves: bool) -> Result<(), ProcessError> {
        if !self.meet()? || !self.start(config)? {
            return Ok(());
        }
        let Some(initial) = self.newest_where(|s| s.flags & drive_flag::INITIAL != 0) else { return Ok(()) };
        let plan = TrialPlan::new(self.log.trial, &self.log.arm, self.log.mode, moves, &initial);
        // Nobody commands a drive whose first state cannot be right, or which does not take the commands.
        self.log.given_up = departs(&self.log.arm, &plan.reference(SpanNs::ZERO).0, &initial);
        let fits = initial.joints as usize == self.log.arm.joints.len()
            && initial.modes & self.log.mode.bit() != 0
            && self
                .log
                .arm
                .joints
                .iter()
                .zip(&initial.q)
                .all(|(j, q)| (j.limits.lower..=j.limits.upper).contains(q));
        if fits && self.log.given_up.is_none() { self.follow(&plan) } else { Ok(()) }
    }

    /// Waits until the drive has joined.
    fn meet(&mut self) -> Result<bool, ProcessError> {
        let began = now();
        if self.program.is_none() {
            tell(format_args!(
                "vservo drive check: waiting for the drive of instance {}: start it now",
                self.instance
            ));
        }
        while !self.presence.is_there() {
            self.membership.beat();
            if self.has_ended() || self.stop.is_requested() {
                return Ok(false);
            }
            if self.program.is_some() && now() - began > self.log.arm.connect_timeout {
                self.log.given_up = Some(format!(
                    "did not join within {:.1} s: {}",
                    self.log.arm.connect_timeout.as_s(),
                    self.presence.describe()
                ));
                return Ok(false);
            }
            std::thread::sleep(LOOK);
        }
        Ok(true)
    }

    /// Sends START until it is answered, and then once more.
    fn start(&mut self, config: &Config) -> Result<bool, ProcessError> {
        let mut start = self.message(0, drive_flag::START);
        if self.log.arm.lockstep {
            start.flags |= drive_flag::LOCKSTEP;
        }
        for (to, from) in start.q_r.iter_mut().zip(&config.start.q) {
            *to = *from;
        }
        let (began, mut asked) = (now(), None);
        while self.answers() == 0 {
            if self.has_ended() || self.stop.is_requested() || now() - began > self.log.arm.connect_timeout {
                return Ok(false);
            }
            if asked.is_none_or(|at| now() - at > ASK_AGAIN) {
                self.send(start)?;
                asked = Some(now());
            }
            self.take_until(now() + SpanNs::from_s(LOOK.as_secs_f64()))?;
        }
        let (answers, began) = (self.answers(), now());
        self.send(start)?;
        while self.answers() == answers && now() - began < AGAIN_WITHIN {
            if self.has_ended() || self.stop.is_requested() {
                return Ok(false);
            }
            self.take_until(now() + SpanNs::from_s(LOOK.as_secs_f64()))?;
        }
        Ok(true)
    }

    /// The phases of the plan, a command each millisecond, or with each answer in lockstep.
    fn follow(&mut self, plan: &TrialPlan) -> Result<(), ProcessError> {
        let lockstep = self.log.arm.lockstep;
        let first = if lockstep { MonoNs::ZERO } else { now() };
        let (mut tick, mut reference) = (0_u64, plan.reference(SpanNs::ZERO).0);
        let begun = self.log.received.len();
        loop {
            let time = if lockstep { first + SpanNs(tick as i64 * TICK.0) } else { now() };
            let Some(phase) = plan.phase(time - first) else { return Ok(()) };
            let logged = LoggedPhase { kind: phase.kind, from: first + phase.from, to: first + phase.to };
            if self.log.phases.last() != Some(&logged) {
                self.log.phases.push(logged);
            }
            tick = if lockstep { tick } else { ((time - first).0 / TICK.0).unsigned_abs() };
            if phase.kind != PhaseKind::Silence {
                let mut command = self.message(tick, 0);
                command.stamp = time;
                (command.q_r, command.qd_r) = plan.reference(time - first);
                self.fill_torques(&mut command);
                if phase.kind == PhaseKind::Refused {
                    self.spoil(&mut command);
                } else {
                    reference = command.q_r;
                }
                self.send(command)?;
            }
            if lockstep {
                if !self.answer(tick)? {
                    self.log.given_up = Some(format!("tick {tick} was not answered: given up"));
                    return Ok(());
                }
                tick += 1;
            } else {
                self.take_until(first + SpanNs((tick as i64 + 1) * TICK.0))?;
            }
            if self.has_ended() || self.stop.is_requested() || self.is_given_up(begun, &reference, phase.kind)
            {
                return Ok(());
            }
        }
    }

    /// Makes a command one that no drive may obey.
    fn spoil(&self, command: &mut DriveCommandMsg) {
        if self.log.trial == DriveTrial::WrongJoints {
            command.joints -= 1;
        } else {
            for values in [&mut command.q_r, &mut command.qd_r, &mut command.qdd_r, &mut command.tau] {
                *values = [f64::NAN; MAX_JOINTS];
            }
        }
    }

    /// Whether the arm or its states are where no trial can go on.
    fn is_given_up(&mut self, begun: usize, reference: &[f64; MAX_JOINTS], kind: PhaseKind) -> bool {
        let newest = self.log.received.get(begun..).and_then(<[_]>::last);
        let missing = SpanNs(self.log.arm.drive_timeout.0 + MISSING.0);
        let since = newest.or(self.log.received.last()).map_or(self.log.until, |r| r.at);
        let why = match newest {
            Some(newest) => departs(&self.log.arm, reference, &newest.state),
            None => None,
        };
        let silent = now() - since > missing && !matches!(kind, PhaseKind::Silence | PhaseKind::Refused);
        let silent = silent.then(|| format!("no state for {:.1} s: given up", missing.as_s()));
        self.log.given_up = why.or(silent);
        self.log.given_up.is_some()
    }

    /// Holds the arm for a moment, then LAST; waits for the program's end.
    pub(super) fn say_last(&mut self) -> Result<(), ProcessError> {
        if self.has_ended() || self.answers() == 0 {
            return Ok(());
        }
        let ordinary = self.log.sent.iter().rev().find(|s| s.command.flags == 0).map(|s| s.command);
        let finite = |s: &DriveStateMsg| s.q.iter().chain(&s.qd).all(|v| v.is_finite());
        // Where the arm is; its reference was to end where it began, so that both are the same at a good end.
        let Some(at) = self.newest_where(finite) else { return Ok(()) };
        let odd =
            self.log.given_up.is_some() || self.log.trial != DriveTrial::Motion || self.stop.is_requested();
        let place = ordinary.filter(|_| !odd).map_or(at.q, |command| command.q_r);
        let mut tick = ordinary.map_or(0, |command| command.tick + 1);
        let mut stamp = ordinary.map_or(MonoNs::ZERO, |command| command.stamp);
        let until = now() + HOLDS;
        let ticks_of_silence = (HOLDS.0 / TICK.0).unsigned_abs();
        // Silence has braked the arm; commands would move it again.
        let holds = ordinary.is_some() && self.log.trial != DriveTrial::Silence;
        for _ in 0..if holds { ticks_of_silence } else { 0 } {
            let mut command = self.message(tick, 0);
            stamp = if self.log.arm.lockstep { stamp + TICK } else { now() };
            (command.q_r, command.stamp) = (place, stamp);
            self.fill_torques(&mut command);
            self.send(command)?;
            tick += 1;
            let goes_on = if self.log.arm.lockstep {
                self.answer(tick - 1)?
            } else {
                self.take_until(now() + TICK)?;
                now() <= until
            };
            if !goes_on || self.has_ended() {
                break;
            }
        }
        let mut last = self.message(tick, drive_flag::LAST);
        (last.q_r, last.stamp) = (place, if self.log.arm.lockstep { stamp + TICK } else { now() });
        self.fill_torques(&mut last);
        self.send(last)?;
        let (began, by_hand) = (now(), self.program.is_none());
        let longest = if by_hand { FAREWELL } else { ENDS_WITHIN };
        while now() - began < longest && !self.has_ended() && (!by_hand || self.presence.is_there()) {
            self.take_until(now() + SpanNs::from_s(LOOK.as_secs_f64()))?;
        }
        Ok(())
    }

    /// Leaves, and ends a program that has not ended: its guard asks it first, once nobody is control any more.
    pub(super) fn end(mut self) -> DriveLog {
        let Some(mut program) = self.program.take() else { return self.log };
        drop((self.command, self.state, self.texts, self.listener, self.presence, self.membership));
        program.terminate();
        let began = now();
        while program.poll().is_none() && now() - began < GUARD {
            std::thread::sleep(LOOK);
        }
        self.log
    }

    fn message(&self, tick: u64, flags: u32) -> DriveCommandMsg {
        let stamp = if self.log.arm.lockstep { MonoNs::ZERO } else { now() };
        let (joints, mode) = (self.log.arm.joints.len() as u32, self.log.mode as u32);
        let flags = flags | self.contents.flags(self.log.mode);
        DriveCommandMsg { tick, stamp, joints, mode, flags, ..DriveCommandMsg::default() }
    }

    fn fill_torques(&self, command: &mut DriveCommandMsg) {
        if self.log.mode == CommandMode::Torque
            && let Some(newest) = self.log.received.last()
        {
            command.tau = (self.torques)(&command.q_r, &newest.state);
        }
    }

    fn send(&mut self, mut command: DriveCommandMsg) -> Result<(), ProcessError> {
        command.sequence = self.log.sent.len() as u64;
        // Noted before: an answer may be here sooner than this goes on.
        self.log.sent.push(SentCommand { at: now(), command });
        Ok(self.command.send(&command)?)
    }

    /// Takes states until `deadline`.
    fn take_until(&mut self, deadline: MonoNs) -> Result<(), ProcessError> {
        self.membership.beat();
        loop {
            let (begin, looks) = (self.log.received.len(), now());
            while let Some(state) = self.state.receive()? {
                self.log.received.push(ReceivedState { at: now(), of_batch: 0, batch: 0, state: *state });
            }
            while let Some(text) = self.texts.receive()? {
                self.log.texts.push(ReceivedText { at: looks, text: *text });
            }
            let batch = (self.log.received.len() - begin) as u32;
            for (r, of_batch) in self.log.received.iter_mut().skip(begin).zip(1..) {
                (r.of_batch, r.batch) = (of_batch, batch);
            }
            self.log.until = now();
            let left = deadline - now();
            if left <= SpanNs::ZERO {
                return Ok(());
            }
            self.listener.wait(Duration::from_nanos(left.0.unsigned_abs()))?;
        }
    }

    /// Lockstep: takes states until the command of `tick` is answered, or for as long as a run would wait; then the trial is given up.
    fn answer(&mut self, tick: u64) -> Result<bool, ProcessError> {
        let began = now();
        let answered = |log: &DriveLog| {
            log.received
                .last()
                .is_some_and(|r| r.state.flags & drive_flag::INITIAL == 0 && r.state.tick > tick)
        };
        let longest = self.answer_timeout;
        while !answered(&self.log)
            && now() - began < longest
            && !self.has_ended()
            && !self.stop.is_requested()
        {
            if let Some(state) = self.state.receive()? {
                self.log.received.push(ReceivedState { at: now(), of_batch: 1, batch: 1, state: *state });
            } else {
                self.listener.wait(LOOK)?;
            }
        }
        Ok(answered(&self.log))
    }

    fn answers(&self) -> usize {
        self.log.received.iter().filter(|r| r.state.flags & drive_flag::INITIAL != 0).count()
    }

    fn newest_where(&self, is_it: impl Fn(&DriveStateMsg) -> bool) -> Option<DriveStateMsg> {
        self.log.received.iter().rev().map(|r| r.state).find(|s| is_it(s))
    }

    /// Whether the program has ended, which is noted.
    fn has_ended(&mut self) -> bool {
        if matches!(self.log.exit, ProgramExit::Ended { .. }) {
            return true;
        }
        let Some(end) = self.program.as_mut().and_then(Child::poll) else { return false };
        let words = self.instance.words_of_drive();
        self.log.exit = ProgramExit::Ended { at: now(), code: end.exit_code(), words };
        true
    }
}
