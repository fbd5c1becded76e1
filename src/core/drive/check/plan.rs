//! What a trial does with the arm: phases, and a reference that is a function of time.
//!
//! ```text
//! motion    hold ─ joint 1 there and back ─ settle ─ joint 2 ... ─ hold ─ LAST
//! silence   hold ─ one joint creeps ─ no commands ─ LAST
//! refusal   hold ─ commands that no drive may obey, which creep or are not finite ─ LAST
//! ```
//! A joint goes there and back along `stroke sin^4(pi t / T)`, whose velocity and acceleration begin and end at zero:
//! at most `1.3 pi/T stroke`, which is 0.1 rad/s.

use super::arm::{ArmFacts, JointFacts};
use crate::drive::CommandMode;
use crate::messages::{DriveStateMsg, MAX_JOINTS, RobotState};
use crate::time::SpanNs;
use std::f64::consts::PI;

/// How far a turning joint is moved, rad, and a sliding one, m. Chosen by hand: well above what encoders and friction hide (a milliradian), and hardly to be
/// seen; half of it measures a lag half as well.
const STROKE_RAD: f64 = 0.03;
const STROKE_M: f64 = 0.01;
/// Time of one joint's way there and back, s. Chosen by hand: accelerations stay below 1 rad/s2; twice the time only makes one wait.
const THERE_AND_BACK_S: f64 = 1.2;
/// Time after a motion in which a lag runs out, s. Chosen by hand: more than the largest lag that is looked for.
const SETTLES_S: f64 = 0.3;
/// Time for which the arm is held, s. Chosen by hand: at 125 Hz still dozens of states.
const HOLD_S: f64 = 0.6;
/// Time in which a joint creeps before commands cease, and in which commands that are to be refused come, s. Chosen by hand: long enough for an arm
/// that obeys them to go by a third of its stroke, which is told apart from noise.
const CREEP_S: f64 = 0.5;
/// Time without commands, s. Chosen by hand: several times the 0.1 s after which a drive should brake, and then as much again in which it must stand.
const SILENCE_S: f64 = 1.2;
/// Strokes a second of a creeping joint: 0.02 rad/s. Chosen by hand: a drive that goes on through the whole silence moves by less than a stroke.
pub(super) const CREEP_STROKES_S: f64 = 0.7;
/// The share of a joint's speed limit, and of the room to its limit, that a gentle motion uses at most. Chosen by hand: a half would be no longer gentle.
const GENTLE: f64 = 0.25;
/// The least stroke worth a motion, as a share of the full one. Chosen by hand: 3 mrad, some steps of a coarse encoder.
const LEAST: f64 = 0.1;
/// Strokes that a joint may be off its reference before the trial is given up: 0.06 rad. Chosen by hand: a drive that lags by 0.25 s is off by one.
const DEPARTED: f64 = 2.0;

/// What one life of the drive's program is used for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DriveTrial {
    /// The arm is held, and moved if it may be.
    Motion,
    /// No command follows in the middle of a motion.
    Silence,
    /// Commands of another number of joints.
    WrongJoints,
    /// Commands that are not finite.
    NotFinite,
}

/// What a span of a trial is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PhaseKind {
    /// The reference rests.
    Hold,
    /// This joint goes there and back; the rest of the phase lets a lag run out.
    Move(usize),
    /// This joint creeps.
    Creep(usize),
    /// No commands.
    Silence,
    /// Commands that no drive may obey.
    Refused,
}

impl PhaseKind {
    /// Whether the drive is not commanded as in a run.
    pub(super) fn is_odd(self) -> bool {
        matches!(self, Self::Silence | Self::Refused)
    }
}

/// A span of a trial.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrialPhase {
    /// What it is for.
    pub kind: PhaseKind,
    /// Its begin, from the first command on.
    pub from: SpanNs,
    /// Its end.
    pub to: SpanNs,
}

/// The phases of a trial, and the reference.
#[derive(Debug, Clone, PartialEq)]
pub struct TrialPlan {
    /// One after the other.
    pub phases: Vec<TrialPhase>,
    q0: [f64; MAX_JOINTS],
    /// How far each joint is moved, and to which side, rad or m.
    strokes: [f64; MAX_JOINTS],
}

impl JointFacts {
    /// The full stroke of such a joint, rad or m: the measure of all tolerances.
    pub(super) fn stroke(&self) -> f64 {
        if self.prismatic { STROKE_M } else { STROKE_RAD }
    }

    /// How far it may be moved from `q`: to the side with more room, slowly; 0 where that is too little to tell anything.
    fn gentle_stroke(&self, q: f64) -> f64 {
        let (down, up) = (q - self.limits.lower, self.limits.upper - q);
        let fastest = GENTLE * self.limits.velocity * THERE_AND_BACK_S / (1.3 * PI);
        let size = self.stroke().min(GENTLE * down.max(up)).min(fastest);
        let side = if up >= down { 1.0 } else { -1.0 };
        if size >= LEAST * self.stroke() { side * size } else { 0.0 }
    }
}

impl TrialPlan {
    /// What `trial` does with an arm that stands at `q0`; nothing moves where `moves` says so, or under torques.
    #[must_use]
    pub fn new(
        trial: DriveTrial,
        arm: &ArmFacts,
        mode: CommandMode,
        moves: bool,
        q0: &DriveStateMsg,
    ) -> Self {
        let mut strokes = [0.0; MAX_JOINTS];
        if moves && mode != CommandMode::Torque {
            for ((stroke, joint), q) in strokes.iter_mut().zip(&arm.joints).zip(&q0.q) {
                *stroke = joint.gentle_stroke(*q);
            }
        }
        let creeps = strokes.iter().position(|s| *s != 0.0);
        let mut plan = Self { phases: Vec::new(), q0: q0.q, strokes };
        plan.add(PhaseKind::Hold, HOLD_S);
        match trial {
            DriveTrial::Motion => {
                for joint in (0..MAX_JOINTS).filter(|j| strokes.get(*j).is_some_and(|s| *s != 0.0)) {
                    plan.add(PhaseKind::Move(joint), THERE_AND_BACK_S + SETTLES_S);
                }
                plan.add(PhaseKind::Hold, HOLD_S);
            }
            DriveTrial::Silence => {
                if let Some(joint) = creeps {
                    plan.add(PhaseKind::Creep(joint), CREEP_S);
                }
                plan.add(PhaseKind::Silence, SILENCE_S);
            }
            DriveTrial::WrongJoints | DriveTrial::NotFinite => {
                plan.add(PhaseKind::Refused, CREEP_S);
            }
        }
        plan
    }

    fn add(&mut self, kind: PhaseKind, length_s: f64) {
        let from = self.phases.last().map_or(SpanNs::ZERO, |p| p.to);
        self.phases.push(TrialPhase { kind, from, to: SpanNs(from.0 + SpanNs::from_s(length_s).0) });
    }

    /// The phase at `t` after the first command.
    #[must_use]
    pub fn phase(&self, t: SpanNs) -> Option<&TrialPhase> {
        self.phases.iter().find(|p| t < p.to)
    }

    /// The reference at `t` after the first command: positions, rad or m, and velocities. In commands that are to be refused a joint creeps.
    #[must_use]
    pub fn reference(&self, t: SpanNs) -> ([f64; MAX_JOINTS], [f64; MAX_JOINTS]) {
        let (mut q, mut qd) = (self.q0, [0.0; MAX_JOINTS]);
        let Some(phase) = self.phase(t) else { return (q, qd) };
        let s = SpanNs(t.0 - phase.from.0).as_s();
        let refused =
            self.strokes.iter().position(|s| *s != 0.0).filter(|_| phase.kind == PhaseKind::Refused);
        let (joint, along, speed) = match (phase.kind, refused) {
            (PhaseKind::Move(joint), _) if s < THERE_AND_BACK_S => {
                let (sin, cos) = (PI * s / THERE_AND_BACK_S).sin_cos();
                (joint, sin.powi(4), 4.0 * sin.powi(3) * cos * PI / THERE_AND_BACK_S)
            }
            (PhaseKind::Creep(joint), _) | (_, Some(joint)) => (joint, CREEP_STROKES_S * s, CREEP_STROKES_S),
            _ => return (q, qd),
        };
        let stroke = self.strokes.get(joint).copied().unwrap_or(0.0);
        if let (Some(q), Some(qd)) = (q.get_mut(joint), qd.get_mut(joint)) {
            *q += along * stroke;
            *qd = speed * stroke;
        }
        (q, qd)
    }
}

/// Why the trial must be given up: the robot obeys no commands, the arm is not where its reference is, or its state is not finite.
#[must_use]
pub fn departs(arm: &ArmFacts, q_r: &[f64; MAX_JOINTS], state: &DriveStateMsg) -> Option<String> {
    let robot = RobotState::from_code(state.robot_state);
    if !robot.obeys() {
        return Some(format!("the robot reports {} ({}): given up", robot.as_str(), state.robot_code));
    }
    let joints = arm.joints.iter().zip(q_r.iter().zip(&state.q)).zip(1..);
    for ((joint, (q_r, q)), number) in joints {
        // In this form a number that is none departs too.
        if !((q - q_r).abs() <= DEPARTED * joint.stroke()) {
            return Some(format!(
                "joint {number} ({}) is at {q:.4}, its reference at {q_r:.4}: given up",
                joint.name
            ));
        }
    }
    None
}
