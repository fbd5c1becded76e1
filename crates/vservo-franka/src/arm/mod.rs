//! A robot that is commanded: from the first look at it to its rest.
//!
//! ```text
//! connect ─► make_ready ─► start ─► next, command, next, ... ─► come_to_rest
//!               │ refuses in words     │ a fault, in words: the robot brakes by itself
//!                                      └─ halt ─► next, recover, next, ... ─► ready: next, command, ...
//! ```
//! Each state is answered by one command, at once: the robot goes on by itself for a cycle without one, and stops after 20 of them.

mod ending;
mod recovery;
mod state;

pub use recovery::Recovered;
pub use state::{ArmSettings, ArmState, Command, CommandKind};

use crate::client::{FciClient, nanoseconds};
use crate::limits::{JointLimits, MAX_TORQUE};
use crate::robot::{Controller, Generator, RobotMode};
use crate::shaping::{Course, Wanted, limited_torques, torques_as_told};
use crate::wire::{Load, MoveStatus, Request, RobotCommand, RobotState};
use crate::{CYCLE_S, FrankaError, JOINTS, Joints};
use ending::Ending;
use recovery::Halt;
use state::plausible;
use std::time::Duration;
use vservo_clock::{ClockEstimate, ClockMap};

/// States in a row whose time does not go on before that is a fault. Chosen by hand: 20 ms.
const STANDING: u32 = 20;
/// States in a row in which the arm rests before the motion ends. Chosen by hand: 20 ms.
const RESTED: u32 = 20;
/// Longest wait for rest. Chosen by hand: 5.26 rad/s at 10 rad/s2 take 0.6 s.
const REST: Duration = Duration::from_secs(3);
/// Longest wait for a stop that was asked for after a fault. Chosen by hand: 5.26 rad/s at 10 rad/s2 take 0.53 s.
const STOP: Duration = Duration::from_secs(1);
/// A position that is farther away in time is not carried on any farther, ns. Chosen by hand: as long as the robot goes on without commands.
const OLDEST_NS: i64 = 20_000_000;
/// Stiffness and damping with which torques hold the arm, N m/rad and N m s/rad for each N m of a joint's torque. Chosen by hand: with an inertia of a hundredth of that torque
/// (which an FR3's joints have within a factor of three) poles at 25 rad/s, and nearly critically damped.
const HOLD_STIFFNESS: f64 = 6.0;
const HOLD_DAMPING: f64 = 0.5;

/// A robot.
#[derive(Debug)]
pub struct Arm {
    settings: ArmSettings,
    client: FciClient,
    limits: JointLimits,
    clock_map: ClockMap,
    last: Option<ArmState>,
    raw: Option<RobotState>,
    /// What the motion is or was commanded by.
    kind: Option<CommandKind>,
    /// The number of the request that began the motion that runs.
    motion: Option<u32>,
    /// What has been said of its end.
    ending: Ending,
    /// What was commanded last; of torques: the reference of what holds the arm.
    course: Course,
    /// What that continued.
    before: Course,
    tau: Joints,
    /// Whether the torques of the last cycle held the arm.
    holds: bool,
    /// The state that was answered last.
    answered: u64,
    standing: u32,
    /// States that were not there when they were due.
    gaps: u64,
    /// What stopped it, until it was started again.
    halt: Option<Halt>,
}

impl Arm {
    /// Connects to a robot, asks for its limits, and takes its first state. Nothing moves, and nothing is changed.
    ///
    /// # Errors
    /// When there is none, or not one that this driver can talk to.
    pub fn connect(settings: ArmSettings) -> Result<Self, FrankaError> {
        let mut client = FciClient::connect(settings.host, settings.patience, settings.clock)?;
        let limits = JointLimits::of_urdf(client.model()?).unwrap_or_else(JointLimits::fr3);
        let mut arm = Self {
            settings,
            client,
            limits,
            clock_map: ClockMap::default(),
            last: None,
            raw: None,
            kind: None,
            motion: None,
            ending: Ending::default(),
            course: Course::at([0.0; JOINTS]),
            before: Course::at([0.0; JOINTS]),
            tau: [0.0; JOINTS],
            holds: false,
            answered: u64::MAX,
            standing: 0,
            gaps: 0,
            halt: None,
        };
        arm.newest()?;
        Ok(arm)
    }

    /// The limits that commands are kept within.
    #[must_use]
    pub fn limits(&self) -> &JointLimits {
        &self.limits
    }

    /// What hangs on the end effector, told when the next motion begins; none: as it is set there.
    pub fn set_load(&mut self, load: Option<Load>) {
        self.settings.load = load;
    }

    /// The newest state.
    #[must_use]
    pub fn last(&self) -> Option<&ArmState> {
        self.last.as_ref()
    }

    /// States that were missing between others, and the longest delay of one beyond the least, ns.
    #[must_use]
    pub fn missed(&self) -> (u64, i64) {
        (self.gaps, self.clock_map.longest_delay_ns())
    }

    /// What is known of the controller's clock.
    #[must_use]
    pub fn clock(&self) -> Option<ClockEstimate> {
        self.clock_map.estimate()
    }

    /// Sees whether the arm may move: refuses in words what somebody must see to.
    ///
    /// # Errors
    /// When the robot has stopped, its brakes are closed, or somebody else moves it.
    pub fn make_ready(&mut self) -> Result<(), FrankaError> {
        let state = self.newest()?;
        match state.mode {
            RobotMode::Idle => Ok(()),
            RobotMode::Reflex => Err(FrankaError::Stopped { errors: state.errors }),
            mode => Err(FrankaError::NotReady { mode }),
        }
    }

    /// Sets what the settings ask for, begins a motion, and waits until it runs. From then on each state wants a command.
    ///
    /// # Errors
    /// When the robot refuses.
    pub fn start(&mut self, kind: CommandKind) -> Result<(), FrankaError> {
        let (collision, load, stiffness) =
            (self.settings.collision, self.settings.load, self.settings.stiffness);
        self.set("its collision thresholds", collision.map(Request::SetCollisionBehavior))?;
        self.set("its load", load.map(Request::SetLoad))?;
        self.set("the stiffness of its joints", stiffness.map(Request::SetJointImpedance))?;
        self.kind = Some(kind);
        let (controller, generator) = kind.asked();
        let number = self.client.send(&Request::Move { controller, generator })?;
        let deadline = (self.settings.clock)() + nanoseconds(self.settings.patience);
        loop {
            let came = self.next(Duration::from_millis(20))?.is_some();
            if let Some(status) = self.client.reply(number).map(MoveStatus::of)
                && status != MoveStatus::MotionStarted
            {
                return Err(FrankaError::MotionRefused { status });
            }
            if came && self.is_in_motion() {
                self.begin(number);
                return self.command(Command::Hold);
            }
            if (self.settings.clock)() > deadline {
                return Err(FrankaError::MotionNotStarted { seconds: self.settings.patience.as_secs_f64() });
            }
        }
    }

    fn set(&mut self, what: &'static str, request: Option<Request>) -> Result<(), FrankaError> {
        let Some(request) = request else { return Ok(()) };
        let why = match self.client.ask(&request)? {
            0 => return Ok(()),
            1 => "it is in no mode in which that is possible",
            2 => "the values are out of their range",
            _ => "a safety function is active: switch it off in Desk",
        };
        Err(FrankaError::Refused { what, why })
    }

    /// Whether the robot says that the motion runs that was asked for.
    fn is_in_motion(&self) -> bool {
        let (Some(state), Some(kind)) = (&self.raw, self.kind) else { return false };
        state.mode == RobotMode::Move && (state.controller, state.generator) == kind.told()
    }

    fn begin(&mut self, number: u32) {
        self.motion = Some(number);
        self.ending = Ending::default();
        self.holds = false;
        if let Some(state) = &self.raw {
            self.course = Course::told(state);
            self.before = self.course;
            self.tau = state.tau_d;
        }
    }

    /// The next state: the newest of those that wait, or what comes within `wait`; none when nothing came. While a motion runs, whatever ends it is told as the error.
    ///
    /// # Errors
    /// When the robot is stopped, lost, or not what it should be.
    pub fn next(&mut self, wait: Duration) -> Result<Option<ArmState>, FrankaError> {
        let received = self.client.receive(wait)?;
        self.client.read_replies()?;
        let Some((raw, arrival)) = received else {
            let quiet = (self.settings.clock)() - self.last.map_or(0, |s| s.stamp);
            // Before the first state nothing is missed.
            if self.last.is_some() && quiet > nanoseconds(self.settings.silence) {
                return Err(FrankaError::StatesStopped { milliseconds: quiet / 1_000_000 });
            }
            return Ok(None);
        };
        if !raw.is_finite() {
            return Err(FrankaError::Nonsense { what: "a value is not finite".into() });
        }
        if let Some(last) = &self.raw {
            if raw.message_id <= last.message_id {
                self.standing += 1;
                return if self.standing < STANDING { Ok(None) } else { Err(FrankaError::TimeStands) };
            }
            let passed = raw.message_id - last.message_id;
            self.gaps += passed - 1;
            plausible(last, &raw, passed as f64 * CYCLE_S)?;
        }
        self.standing = 0;
        let state = ArmState::of(&raw, &mut self.clock_map, arrival);
        (self.raw, self.last) = (Some(raw), Some(state));
        if let Some(number) = self.motion {
            self.running(number, &raw)?;
        }
        Ok(Some(state))
    }

    /// Answers the newest state, once. Commands that are no numbers hold the arm.
    ///
    /// # Errors
    /// When the connection is lost.
    pub fn command(&mut self, what: Command) -> Result<(), FrankaError> {
        self.answer(what, false)
    }

    fn answer(&mut self, what: Command, ends: bool) -> Result<(), FrankaError> {
        let (Some(raw), Some(last), Some(kind), Some(_)) = (self.raw, self.last, self.kind, self.motion)
        else {
            return Ok(());
        };
        if raw.message_id == self.answered {
            return Ok(());
        }
        let passed = raw.message_id.saturating_sub(self.answered).max(1);
        self.answered = raw.message_id;
        let mut command = RobotCommand::new(raw.message_id);
        let wanted = wanted(&what, last.stamp);
        if kind == CommandKind::Torque {
            self.tau = self.torques(&what, &wanted, &raw);
            command.tau_c = self.tau;
            command.torque_finished = ends;
        } else {
            // The last command has come, or it was lost.
            let expected = [self.course.unattended(passed - 1), self.before.unattended(passed)];
            let told = expected.into_iter().find(|course| course.is_told(&raw));
            self.before = told.unwrap_or_else(|| Course::told(&raw));
            self.course = self.before.step(&wanted, &self.limits);
            command.q_c = self.course.q;
            command.dq_c = self.course.qd;
            command.motion_finished = ends;
        }
        self.client.command(&command)
    }

    /// Torques of this cycle: those that are asked for, or those that hold the arm to a course.
    fn torques(&mut self, what: &Command, wanted: &Wanted, raw: &RobotState) -> Joints {
        let last = torques_as_told(&self.tau, raw);
        match what {
            Command::Torque(tau) if tau.iter().all(|t| t.is_finite()) => {
                self.holds = false;
                limited_torques(tau, &last)
            }
            _ => {
                if !std::mem::replace(&mut self.holds, true) {
                    self.course = Course { q: raw.q, qd: raw.dq, qdd: [0.0; JOINTS] };
                }
                self.course = self.course.step(wanted, &self.limits);
                let course = &self.course;
                let tau = std::array::from_fn(|i| {
                    let (e, ed) = (course.q[i] - raw.q[i], course.qd[i] - raw.dq[i]);
                    MAX_TORQUE[i] * (HOLD_STIFFNESS * e + HOLD_DAMPING * ed)
                });
                limited_torques(&tau, &last)
            }
        }
    }

    /// Brakes the arm, waits for its rest, and ends the motion.
    ///
    /// # Errors
    /// When it does not come to rest, or whatever stops it before.
    pub fn come_to_rest(&mut self) -> Result<(), FrankaError> {
        if self.motion.is_none() {
            return Ok(());
        }
        let clock = self.settings.clock;
        let deadline = clock() + nanoseconds(REST);
        let mut rested = 0;
        while rested < RESTED {
            if clock() > deadline {
                return Err(FrankaError::NotAtRest { seconds: REST.as_secs_f64() });
            }
            if let Some(s) = self.next(self.settings.silence)? {
                rested = if s.rests() && self.course.rests() { rested + 1 } else { 0 };
            }
            self.command(Command::Hold)?;
        }
        while self.motion.is_some() {
            if clock() > deadline {
                return Err(FrankaError::NotAtRest { seconds: REST.as_secs_f64() });
            }
            self.answer(Command::Hold, true)?;
            // What ends the motion now is what was asked for, whichever of state and reply comes first.
            match self.next(self.settings.silence) {
                Err(
                    FrankaError::MotionEnded { .. } | FrankaError::ModeInMotion { mode: RobotMode::Idle },
                ) => {
                    self.motion = None;
                }
                Err(error) => return Err(error),
                Ok(_) => {
                    let over = |s: &RobotState| {
                        s.controller != Controller::External
                            && matches!(s.generator, Generator::Idle | Generator::None)
                    };
                    if self.raw.as_ref().is_some_and(over) {
                        self.motion = None;
                    }
                }
            }
        }
        Ok(())
    }

    /// After a fault: whatever can still be done so that the arm stands. What fails here, the robot does by itself, 20 ms after the last command.
    pub fn abandon(&mut self) {
        self.halt = None;
        if self.motion.take().is_none() || self.client.send(&Request::StopMove).is_err() {
            return;
        }
        // A robot that is left while it brakes takes that for a lost connection.
        let clock = self.settings.clock;
        let deadline = clock() + nanoseconds(STOP);
        while self.is_in_motion() && clock() < deadline && self.next(Duration::from_millis(20)).is_ok() {}
    }

    /// The newest of what has come, or the next.
    fn newest(&mut self) -> Result<ArmState, FrankaError> {
        let clock = self.settings.clock;
        let deadline = clock() + nanoseconds(self.settings.patience);
        // What waits may be old: a state that comes from now on is not.
        self.next(Duration::ZERO)?;
        while clock() < deadline {
            if let Some(state) = self.next(Duration::from_millis(20))? {
                return Ok(state);
            }
        }
        Err(FrankaError::NoStates {
            address: self.client.address().to_string(),
            seconds: self.settings.patience.as_secs_f64(),
        })
    }

    fn silent(&self, awaited: &'static str) -> FrankaError {
        FrankaError::Silent {
            address: self.client.address().to_string(),
            awaited,
            seconds: self.settings.patience.as_secs_f64(),
        }
    }
}

/// What is wanted of a course at a state that was sampled at `stamp`, ns.
fn wanted(what: &Command, stamp: i64) -> Wanted {
    let finite = |values: &Joints| values.iter().all(|v| v.is_finite());
    let age_s =
        |at: Option<i64>| at.map_or(0.0, |at| (stamp - at).clamp(-OLDEST_NS, OLDEST_NS) as f64 * 1e-9);
    match what {
        Command::Position { q, qd, qdd, at } if finite(q) && finite(qd) && finite(qdd) => {
            let (mut q, mut v) = (*q, *qd);
            for i in 0..JOINTS {
                let t = carried_s(qd[i], qdd[i], age_s(*at));
                q[i] += t * (qd[i] + 0.5 * t * qdd[i]);
                v[i] += t * qdd[i];
            }
            Wanted::Position { q, qd: v }
        }
        Command::Velocity { qd, qdd, at } if finite(qd) && finite(qdd) => {
            Wanted::Velocity(std::array::from_fn(|i| qd[i] + carried_s(qd[i], qdd[i], age_s(*at)) * qdd[i]))
        }
        _ => Wanted::Rest,
    }
}

/// For how long a joint is carried on by its velocity and acceleration, s: what brakes, no farther than to rest.
fn carried_s(qd: f64, qdd: f64, age_s: f64) -> f64 {
    if qd * (qd + age_s * qdd) < 0.0 { -qd / qdd } else { age_s }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is commanded for other instants than the state's is carried on with its acceleration, to and fro, and what brakes no farther than to rest.
    #[test]
    fn commands_are_carried_on_to_the_instant_of_the_state() {
        let course = |t: f64| (0.4 * (1.0 - (5.0 * t).cos()), 2.0 * (5.0 * t).sin(), 10.0 * (5.0 * t).cos());
        let of = |value: f64| [value; JOINTS];
        for age_ms in [-3_i64, 1, 6] {
            let (q, qd, qdd) = course(0.2 - 1e-3 * age_ms as f64);
            let at = Some(500_000_000 - 1_000_000 * age_ms);
            let position = Command::Position { q: of(q), qd: of(qd), qdd: of(qdd), at };
            let Wanted::Position { q, qd: moves } = wanted(&position, 500_000_000) else { panic!() };
            let Wanted::Velocity(v) =
                wanted(&Command::Velocity { qd: of(qd), qdd: of(qdd), at }, 500_000_000)
            else {
                panic!()
            };
            // 50 rad/s3 are left: without the acceleration it would be 10 t^2/2 and 10 t.
            let t = 1e-3 * age_ms.unsigned_abs() as f64;
            let (right, left) = (course(0.2), (50.0 * t.powi(3) / 6.0, 50.0 * t * t / 2.0));
            assert!((q[0] - right.0).abs() <= left.0 + 1e-12, "{age_ms}: {} {}", q[0], right.0);
            assert!(
                (moves[0] - right.1).abs() <= left.1 + 1e-12 && v == moves,
                "{age_ms}: {} {}",
                moves[0],
                right.1
            );
        }
        let braking = Command::Velocity { qd: of(0.05), qdd: of(-10.0), at: Some(0) };
        assert_eq!(wanted(&braking, 15_000_000), Wanted::Velocity(of(0.0)));
    }
}
