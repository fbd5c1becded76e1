//! The guardian's judgement of what control sends to an external drive. It can only stop, and shares no code with what it judges: neither with the gate nor with the
//! safety functions of control.
//!
//! ```text
//! DriveCommandMsg ─► [command] finite? joints, mode? range, speed, acceleration, effort? half spaces, commanded and measured?  ─┐
//! DriveStateMsg   ─► [state]   is the measured arm too fast?                                                                 ─┼─► the first finding stops the arm
//! each look       ─► [look]    did a command come? is control suspended, or dead? does it move an arm that tells nothing?    ─┘
//!
//! START: unarmed ─ first command ─► armed ─ LAST ─► unarmed          armed ─ finding ─► stopped ─ reset ─► unarmed
//! ```
//! Between its first command and LAST a control that is well sends one each millisecond, also while the arm rests: every silence is a failure. Only time in which the
//! guardian itself came round counts as silence, so that a machine that stood as a whole stops nothing.

mod space;

pub use space::{GuardedAxis, GuardedSide, GuardedSpace, GuardedSphere, GuardedVector};

use crate::messages::{DriveCommandMsg, DriveStateMsg, drive_flag};
use crate::robot::joint_in_words;
use crate::time::{MonoNs, SpanNs, TICK};

/// Longest time that counts as silence between two looks. Chosen by hand: two periods of looks, so that a late look counts in full, and one after a suspension hardly.
const LONGEST_LOOK: SpanNs = SpanNs(2_000_000);
/// Silence after which it is asked whether control is suspended or dead. Chosen by hand: five commands, more than one that was late; with a look and a cycle of the drive
/// the brake begins within 8 ms, where 20 are asked for.
const ASK_AFTER: SpanNs = SpanNs(5_000_000);
/// Share of its limit that a number may be beyond it. Chosen by hand: the gate admits half of what the jerk changes of an acceleration in a tick, 2.5 % at
/// 500 rad/s3 and 10 rad/s2.
const TOLERANCE: f64 = 0.05;
/// What a number, or a difference of two, may be beyond that, in its unit. Chosen by hand: a hundredth of the step of 1e-2 rad/s that 10 rad/s2 make in a tick.
const ROUNDING: f64 = 1e-4;
/// Factor of the velocity limit beyond which the measured arm is too fast, as control has it.
const TOO_FAST: f64 = 1.5;
/// Time over which the measured speed is a mean. Chosen by hand: twice what control takes, which is to be first.
const SPEED_SPAN: SpanNs = SpanNs(40_000_000);
/// States farther apart begin anew: what lies between is not known. Chosen by hand: three spans.
const LONGEST_SPAN: SpanNs = SpanNs(120_000_000);
/// Displacement that is noise of encoders, rad or m, as control has it.
const NOISE: f64 = 5e-3;
/// The arm rests when it has reported no speed beyond this, rad/s or m/s, in so many states in a row. Chosen by hand: above the noise of a good drive's velocities; 20 ms.
const REST_SPEED: f64 = 0.01;
const RESTING_STATES: u32 = 20;
/// An arm moves where it is commanded a velocity beyond this, rad/s or m/s. Chosen by hand: a tenth of the speed at which it rests.
const MOVES: f64 = 1e-3;
/// How far an arm that moves may be beyond a plane, or farther than where its motion began, m. Chosen by hand: control, which is to be first, takes 0 and 2 mm.
const BEYOND_M: f64 = 5e-3;
/// Commands in a row with the arm beyond a plane that stop it. Chosen by hand: three times what control takes, which is to be first.
const BEYOND_COMMANDS: u32 = 15;

/// Numbers of the command modes, as every drive's program has them.
const TORQUE: u32 = 0;
const VELOCITY: u32 = 1;
const POSITION: u32 = 2;

/// The limits of one joint's commands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GuardedJoint {
    /// Lower end of its range, rad or m.
    pub lower: f64,
    /// Upper end.
    pub upper: f64,
    /// Largest speed, rad/s or m/s.
    pub velocity: f64,
    /// Largest acceleration, rad/s^2 or m/s^2.
    pub acceleration: f64,
    /// Largest torque or force, N m or N.
    pub effort: f64,
}

/// The limits of an arm's commands.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct GuardedLimits {
    /// Those of its joints, of which there are no more than a message has room for.
    pub joints: Vec<GuardedJoint>,
    /// Longest silence of a control that runs.
    pub silence: SpanNs,
    /// Longest time without a state from the drive while control moves the arm.
    pub states: SpanNs,
    /// The half spaces that it must stay in.
    pub space: GuardedSpace,
}

/// What the system says of control's process.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ControlLife {
    /// It runs, or waits for its core, or for something.
    Runs,
    /// It was suspended by a signal.
    Suspended,
    /// It has ended.
    Dead,
}

/// A number that has a limit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GuardedNumber {
    /// Commanded position, outside of its range and farther out than before.
    Position,
    /// Commanded velocity.
    Velocity,
    /// Mean velocity from one commanded position to the next.
    Step,
    /// Mean acceleration from one commanded velocity to the next.
    Acceleration,
    /// Commanded torque or force.
    Effort,
    /// Measured speed.
    MeasuredSpeed,
}

/// Why the arm is to be stopped. Joints count from 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum GuardianFinding {
    /// No command came.
    Silent {
        /// For so long.
        silence: SpanNs,
        /// What the system says of control.
        life: ControlLife,
    },
    /// Control moves the arm, and the drive's states are missing, or stand still.
    Blind {
        /// For so long.
        silence: SpanNs,
    },
    /// The arm moves beyond a plane, as commanded or as measured.
    Outside {
        /// The farthest sphere, by its number in [`GuardedSpace::spheres`], from 1.
        sphere: usize,
        /// How far, m.
        beyond_m: f64,
    },
    /// A command of another number of joints, or of another mode than those before.
    Malformed {
        /// Its joints.
        joints: u32,
        /// Its mode.
        mode: u32,
    },
    /// A commanded number that is none.
    NotFinite {
        /// Whose, from 0.
        joint: usize,
    },
    /// A number beyond its limit.
    Beyond {
        /// Whose, from 0.
        joint: usize,
        /// Which.
        what: GuardedNumber,
        /// The number, in SI units.
        value: f64,
        /// The limit.
        limit: f64,
    },
}

impl GuardianFinding {
    /// The description for people, of an arm whose joints have these `names`.
    #[must_use]
    pub fn describe(&self, names: &[String]) -> String {
        match *self {
            Self::Silent { silence, life } => {
                let life = match life {
                    ControlLife::Runs => "",
                    ControlLife::Suspended => ", whose process is suspended",
                    ControlLife::Dead => ", whose process has ended",
                };
                format!("no command from control for {:.1} ms{life}", silence.as_s() * 1e3)
            }
            Self::Blind { silence } => {
                let ms = silence.as_s() * 1e3;
                format!("control moves the arm, and no state has come from the drive for {ms:.1} ms")
            }
            Self::Outside { sphere, beyond_m } => {
                format!("point {sphere} of the arm is {beyond_m:.4} m beyond a plane of [workspace]")
            }
            Self::Malformed { joints, mode } => {
                format!("a command of {joints} joints in mode {mode}, which is not what the run began with")
            }
            Self::NotFinite { joint } => {
                format!("{} is commanded a number that is none", joint_in_words(names, joint))
            }
            Self::Beyond { joint, what, value, limit } => {
                let (what, unit) = match what {
                    GuardedNumber::Position => ("commanded to", " rad or m"),
                    GuardedNumber::Velocity => ("commanded a velocity of", " rad/s or m/s"),
                    GuardedNumber::Step => ("commanded a step of the position of", " rad/s or m/s"),
                    GuardedNumber::Acceleration => ("commanded a step of the velocity of", " rad/s2 or m/s2"),
                    GuardedNumber::Effort => ("commanded", " N m or N"),
                    GuardedNumber::MeasuredSpeed => ("measured at", " rad/s or m/s"),
                };
                format!("{} is {what} {value:.4}{unit}, beyond {limit:.4}", joint_in_words(names, joint))
            }
        }
    }
}

/// Whether commands are judged.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
enum GuardianStage {
    /// No command has come since START, LAST or a reset.
    #[default]
    Unarmed,
    /// One has.
    Armed,
    /// The arm is stopped.
    Stopped,
}

/// The judgement of one run.
#[derive(Debug, Clone, Default)]
pub struct Guardian {
    limits: GuardedLimits,
    stage: GuardianStage,
    /// The last command, where armed.
    last: DriveCommandMsg,
    silence: SpanNs,
    looked: Option<MonoNs>,
    /// The state from which the measured speed counts.
    from: Option<DriveStateMsg>,
    /// The newest state.
    newest: Option<DriveStateMsg>,
    /// Time without a newer one.
    blind: SpanNs,
    resting: u32,
    /// How far the arm may be beyond a plane, m: as far as where its motion began.
    allowed_m: f64,
    /// Commands in a row with which it was farther.
    outside: u32,
}

impl Guardian {
    /// Before the first command.
    #[must_use]
    pub fn new(limits: GuardedLimits) -> Self {
        Self { limits, ..Self::default() }
    }

    /// Takes a command in.
    pub fn command(&mut self, command: &DriveCommandMsg) -> Option<GuardianFinding> {
        self.silence = SpanNs::ZERO;
        if command.flags & (drive_flag::START | drive_flag::LAST) != 0 {
            // What is not a motion command moves nothing. A stop stands until it is reset.
            if self.stage != GuardianStage::Stopped {
                self.stage = GuardianStage::Unarmed;
            }
            return None;
        }
        if self.has_stopped() {
            return None;
        }
        let begins = !self.is_armed();
        if begins {
            // Nothing comes before it: it makes no step.
            (self.last, self.blind) = (*command, SpanNs::ZERO);
        }
        let before = std::mem::replace(&mut self.last, *command);
        self.stage = GuardianStage::Armed;
        let finding = self.judge(&before).or_else(|| self.judge_places(begins));
        self.stop_by(finding)
    }

    /// Takes a state of the arm in.
    pub fn state(&mut self, state: &DriveStateMsg) -> Option<GuardianFinding> {
        let joints = &self.limits.joints;
        let rests = state.qd.iter().take(joints.len()).all(|qd| qd.abs() <= REST_SPEED);
        self.resting = if rests { self.resting.saturating_add(1) } else { 0 };
        // A state that is no newer than the one before tells nothing.
        if self.newest.is_none_or(|newest| state.stamp != newest.stamp) {
            (self.newest, self.blind) = (Some(*state), SpanNs::ZERO);
        }
        let from = *self.from.get_or_insert(*state);
        let span = state.stamp - from.stamp;
        if span < SPEED_SPAN && span >= SpanNs::ZERO {
            return None;
        }
        self.from = Some(*state);
        if span > LONGEST_SPAN || span < SpanNs::ZERO || !self.is_armed() {
            return None;
        }
        let finding = (0..joints.len()).find_map(|i| {
            let speed = without_noise(state.q[i] - from.q[i], NOISE) / span.as_s();
            beyond(i, GuardedNumber::MeasuredSpeed, speed, TOO_FAST * joints[i].velocity)
        });
        self.stop_by(finding)
    }

    /// Looks at `now`, after everything that had come by then was taken in; `life` is asked where commands are missing.
    pub fn look(&mut self, now: MonoNs, life: impl FnOnce() -> ControlLife) -> Option<GuardianFinding> {
        let passed = self.looked.replace(now).map_or(SpanNs::ZERO, |looked| now - looked);
        if !self.is_armed() {
            return None;
        }
        let passed = passed.0.clamp(0, LONGEST_LOOK.0);
        self.silence.0 += passed;
        self.blind.0 += passed;
        if self.blind >= self.limits.states && self.moves() {
            return self.stop_by(Some(GuardianFinding::Blind { silence: self.blind }));
        }
        if self.silence < ASK_AFTER {
            return None;
        }
        let (silence, life) = (self.silence, life());
        let is_over = silence >= self.limits.silence || life != ControlLife::Runs;
        self.stop_by(is_over.then_some(GuardianFinding::Silent { silence, life }))
    }

    /// The stop was reset: what comes next is judged anew.
    pub fn reset(&mut self) {
        self.stage = GuardianStage::Unarmed;
    }

    /// A stop stands from elsewhere: of a guardian that was here before.
    pub fn stop(&mut self) {
        self.stage = GuardianStage::Stopped;
    }

    /// Whether commands are judged: a run is under way.
    #[must_use]
    pub fn is_armed(&self) -> bool {
        self.stage == GuardianStage::Armed
    }

    /// Whether the stop stands.
    #[must_use]
    pub fn has_stopped(&self) -> bool {
        self.stage == GuardianStage::Stopped
    }

    /// Whether the measured arm rests.
    #[must_use]
    pub fn is_at_rest(&self) -> bool {
        self.resting >= RESTING_STATES
    }

    fn stop_by(&mut self, finding: Option<GuardianFinding>) -> Option<GuardianFinding> {
        if finding.is_some() {
            self.stage = GuardianStage::Stopped;
        }
        finding
    }

    /// Whether the last command moves the arm.
    fn moves(&self) -> bool {
        self.last.qd_r.iter().take(self.limits.joints.len()).any(|qd| qd.abs() > MOVES)
    }

    /// Whether the arm moves beyond a plane. One that begins there may come back, and one that rests there is not stopped: it was put there by somebody else.
    fn judge_places(&mut self, begins: bool) -> Option<GuardianFinding> {
        let space = &self.limits.space;
        let commanded = space.farthest(&self.last.q_r);
        let measured = self.newest.map_or(commanded, |state| space.farthest(&state.q));
        let (beyond_m, sphere) = if measured.0 > commanded.0 { measured } else { commanded };
        if begins || !self.moves() {
            // Less is what a motion from inside may come to: it would add up from one to the next.
            let allowed_m = if beyond_m > BEYOND_M { beyond_m } else { 0.0 };
            (self.allowed_m, self.outside) = (allowed_m, 0);
            return None;
        }
        let is_outside = beyond_m > self.allowed_m + BEYOND_M;
        self.outside = if is_outside { self.outside + 1 } else { 0 };
        let found = GuardianFinding::Outside { sphere: sphere + 1, beyond_m };
        (self.outside >= BEYOND_COMMANDS).then_some(found)
    }

    /// Judges the last command by itself and as a step from the one `before`.
    fn judge(&self, before: &DriveCommandMsg) -> Option<GuardianFinding> {
        let DriveCommandMsg { joints, mode, .. } = self.last;
        if joints as usize != self.limits.joints.len() || mode > POSITION || mode != before.mode {
            return Some(GuardianFinding::Malformed { joints, mode });
        }
        (0..self.limits.joints.len()).find_map(|i| self.judge_joint(i, before))
    }

    fn judge_joint(&self, i: usize, before: &DriveCommandMsg) -> Option<GuardianFinding> {
        let (now, limits) = (&self.last, &self.limits.joints[i]);
        let (q, qd, tau) = (now.q_r[i], now.qd_r[i], now.tau[i]);
        if !(q.is_finite() && qd.is_finite() && tau.is_finite()) {
            return Some(GuardianFinding::NotFinite { joint: i });
        }
        let (way, dt) = (q - before.q_r[i], now.tick.saturating_sub(before.tick).max(1) as f64 * TICK.as_s());
        // What is commanded may lie outside only where the arm has started there, and then goes inward.
        let end = q.max(limits.lower).min(limits.upper);
        if (q - end).abs() > ROUNDING && way * (q - end) > 0.0 {
            let what = GuardedNumber::Position;
            return Some(GuardianFinding::Beyond { joint: i, what, value: q, limit: end });
        }
        let effort = if now.mode == TORQUE { tau } else { 0.0 };
        // A drive that obeys velocities alone is told positions for information: they are those of the measured arm now and then.
        let way = if now.mode == VELOCITY { 0.0 } else { way };
        let step = |difference: f64| without_noise(difference, ROUNDING) / dt;
        let numbers = [
            (GuardedNumber::Velocity, qd, limits.velocity),
            (GuardedNumber::Effort, effort, limits.effort),
            (GuardedNumber::Acceleration, step(qd - before.qd_r[i]), limits.acceleration),
            (GuardedNumber::Step, step(way), limits.velocity),
        ];
        numbers.into_iter().find_map(|(what, value, limit)| beyond(i, what, value, limit))
    }
}

/// The finding that `value` of joint `i` is beyond `limit`, where it is.
fn beyond(i: usize, what: GuardedNumber, value: f64, limit: f64) -> Option<GuardianFinding> {
    // Written so that a limit or a number that is none is beyond.
    let is_within = value.abs() <= limit * (1.0 + TOLERANCE) + ROUNDING;
    (!is_within).then_some(GuardianFinding::Beyond { joint: i, what, value, limit })
}

/// A difference of two numbers, less what may be noise, or rounding.
fn without_noise(difference: f64, noise: f64) -> f64 {
    difference.signum() * (difference.abs() - noise).max(0.0)
}

#[cfg(test)]
mod tests;
