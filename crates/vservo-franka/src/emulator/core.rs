//! The emulated controller itself: modes, motions, errors and joints. It knows neither sockets nor threads.

use super::faults::Faults;
use super::plant::JointPlant;
use crate::limits::{JointLimits, MAX_ACCELERATION, MAX_JERK, MAX_TORQUE, MAX_TORQUE_RATE};
use crate::robot::{Controller, Generator, RobotError, RobotMode};
use crate::wire::{
    Load, MoveController, MoveGenerator, MoveStatus, Request, RequestKind, RobotCommand, RobotState,
};
use crate::{CYCLE_S, JOINTS, Joints};
use std::collections::VecDeque;

/// Cycles in a row without a command after which a robot ends the motion, by the maker's documentation.
pub const MISSED_CYCLES: u32 = 20;
/// What limits of commands may be passed by. Chosen by hand: clients compute with states of single precision, which is 2.4 % of the jerk.
const TOLERANCE: f64 = 1.1;
/// Time that clearing an error takes, cycles. Chosen by hand: shorter than a robot's, so that nobody waits.
const RECOVERY: u32 = 100;
/// Commands that the success rate is told of, by the maker's documentation.
const RATED: usize = 100;

/// A motion that runs.
#[derive(Debug, Clone, Copy)]
struct Motion {
    /// The number of its request.
    number: u32,
    controller: MoveController,
    generator: MoveGenerator,
    /// Cycles without a command, in a row; none before the first.
    missed: Option<u32>,
    /// All cycles without a command, in a row, those included in which the machine slept.
    silent: u32,
    /// It was asked to end: by this status, once the arm rests.
    ends: Option<MoveStatus>,
}

/// The controller.
pub(super) struct Core {
    pub(super) state: RobotState,
    pub(super) limits: JointLimits,
    pub(super) faults: Faults,
    /// What was told, newest last.
    pub(super) log: VecDeque<String>,
    /// Replies that wait to be sent: what to, its number, status.
    pub(super) replies: Vec<(RequestKind, u32, u8)>,
    /// Cycles that it goes on for without commands.
    missed_cycles: u32,
    /// What it was told to carry.
    pub(super) load: Option<Load>,
    plant: Box<dyn JointPlant>,
    // In double precision, beside the state's.
    q_d: Joints,
    dq_d: Joints,
    ddq_d: Joints,
    motion: Option<Motion>,
    /// Cycles until an error is cleared, and the request's number.
    clears: Option<(u32, u32)>,
    /// Numbers of requests to stop that wait for rest.
    stops: Vec<u32>,
    /// Whether the last commands came.
    came: VecDeque<bool>,
}

impl Core {
    pub(super) fn new(
        q: Joints,
        limits: JointLimits,
        plant: Box<dyn JointPlant>,
        missed_cycles: u32,
    ) -> Self {
        let zero = [0.0; JOINTS];
        Self {
            state: RobotState { message_id: 1000, ..RobotState::at(q) },
            limits,
            faults: Faults::default(),
            log: VecDeque::new(),
            replies: Vec::new(),
            missed_cycles,
            load: None,
            plant,
            q_d: q,
            dq_d: zero,
            ddq_d: zero,
            motion: None,
            clears: None,
            stops: Vec::new(),
            came: VecDeque::new(),
        }
    }

    pub(super) fn tell(&mut self, text: impl Into<String>) {
        // Chosen by hand: whoever does not read them misses the oldest, and memory stays flat.
        if self.log.len() >= 1000 {
            self.log.pop_front();
        }
        self.log.push_back(text.into());
    }

    /// A request; what is replied at once is in `replies`.
    pub(super) fn request(&mut self, number: u32, request: &Request) {
        let kind = request.kind();
        let idle = self.state.mode == RobotMode::Idle;
        let status =
            match request {
                Request::Connect { .. } | Request::GetRobotModel => return, // of the connection
                Request::Move { controller, generator } => {
                    return self.begin(number, *controller, *generator);
                }
                Request::StopMove => {
                    if let Some(motion) = &mut self.motion {
                        motion.ends.get_or_insert(MoveStatus::Preempted);
                        self.stops.push(number);
                        return;
                    }
                    u8::from(!idle)
                }
                Request::AutomaticErrorRecovery => return self.clear(number),
                _ if !idle => 1,
                Request::SetLoad(load) => {
                    let fits = load.mass_kg >= 0.0
                        && load.com_F.iter().chain(&load.inertia_kg_m2).all(|v| v.is_finite());
                    if fits {
                        self.state.masses_kg[1] = load.mass_kg;
                        self.load = Some(*load);
                        self.plant.carry(load);
                    }
                    if fits { 0 } else { 2 }
                }
                Request::SetJointImpedance(stiffness) => {
                    if stiffness.iter().all(|k| *k > 0.0 && k.is_finite()) { 0 } else { 2 }
                }
                Request::SetCollisionBehavior(b) => {
                    let torques = b.upper_torques_acceleration.iter().chain(&b.upper_torques_nominal);
                    let forces = b.upper_forces_acceleration.iter().chain(&b.upper_forces_nominal);
                    if torques.chain(forces).all(|v| *v > 0.0 && v.is_finite()) { 0 } else { 2 }
                }
                Request::Other(_) => 0,
            };
        self.replies.push((kind, number, status));
    }

    fn begin(&mut self, number: u32, controller: MoveController, generator: MoveGenerator) {
        let (told, runs) = match (controller, generator) {
            _ if self.state.mode != RobotMode::Idle
                || self.motion.is_some()
                || self.faults.refuse_motions =>
            {
                (MoveStatus::NotPossible, false)
            }
            (_, MoveGenerator::CartesianPosition | MoveGenerator::CartesianVelocity) => {
                self.tell("a Cartesian motion is asked for, which is not emulated");
                (MoveStatus::InvalidArgument, false)
            }
            (MoveController::JointImpedance | MoveController::CartesianImpedance, MoveGenerator::None) => {
                (MoveStatus::InvalidArgument, false)
            }
            _ => (MoveStatus::MotionStarted, true),
        };
        self.replies.push((RequestKind::Move, number, told as u8));
        if !runs {
            return;
        }
        self.motion = Some(Motion { number, controller, generator, missed: None, silent: 0, ends: None });
        self.state.mode = RobotMode::Move;
        self.state.reflex_reason = 0;
        self.state.controller = match controller {
            MoveController::JointImpedance => Controller::JointImpedance,
            MoveController::CartesianImpedance => Controller::CartesianImpedance,
            MoveController::External => Controller::External,
        };
        self.state.generator = match generator {
            MoveGenerator::JointPosition => Generator::JointPosition,
            MoveGenerator::JointVelocity => Generator::JointVelocity,
            MoveGenerator::CartesianPosition => Generator::CartesianPosition,
            MoveGenerator::CartesianVelocity => Generator::CartesianVelocity,
            MoveGenerator::None => Generator::None,
        };
        self.came.clear();
        self.stand();
    }

    /// The reference is where it was commanded, at rest.
    fn stand(&mut self) {
        (self.dq_d, self.ddq_d) = ([0.0; JOINTS], [0.0; JOINTS]);
        self.state.tau_d = [0.0; JOINTS];
    }

    fn clear(&mut self, number: u32) {
        let status = match self.state.mode {
            RobotMode::Reflex if self.faults.manual_recovery => 3,
            RobotMode::Reflex => {
                self.state.mode = RobotMode::AutomaticErrorRecovery;
                self.clears = Some((RECOVERY, number));
                return;
            }
            RobotMode::UserStopped => 5,
            RobotMode::Idle => 0, // there is nothing to clear
            _ => 1,
        };
        self.replies.push((RequestKind::AutomaticErrorRecovery, number, status));
    }

    /// An error ends whatever runs.
    pub(super) fn reflex(&mut self, errors: u64) {
        self.state.errors = errors;
        self.state.reflex_reason = errors;
        self.end(MoveStatus::ReflexAborted, RobotMode::Reflex);
        self.tell(format!("reflex: {}", crate::robot::name_errors(errors)));
    }

    /// Somebody presses a button, guides the arm, or closes its brakes; or the opposite.
    pub(super) fn enter(&mut self, mode: RobotMode) {
        if mode == RobotMode::Idle {
            (self.state.errors, self.clears) = (0, None);
        }
        let status = match mode {
            RobotMode::UserStopped => MoveStatus::EmergencyAborted,
            _ => MoveStatus::Aborted,
        };
        self.end(status, mode);
    }

    /// The client is gone.
    pub(super) fn abandon(&mut self) {
        // A motion that is being ended needs nobody.
        if self.motion.is_some_and(|motion| motion.ends.is_none()) {
            self.reflex(RobotError::Communication.bit());
        }
        self.replies.clear();
    }

    fn end(&mut self, status: MoveStatus, mode: RobotMode) {
        if let Some(motion) = self.motion.take() {
            self.replies.push((RequestKind::Move, motion.number, status as u8));
            if motion.controller == MoveController::External && motion.generator == MoveGenerator::None {
                // The robot's own control takes over where the arm is.
                (self.q_d, self.dq_d) = (self.state.q, self.state.dq);
            }
        }
        let stopped: u8 = match status {
            MoveStatus::Success | MoveStatus::Preempted => 0,
            MoveStatus::ReflexAborted => 4,
            MoveStatus::EmergencyAborted => 3,
            _ => 5,
        };
        for number in self.stops.drain(..) {
            self.replies.push((RequestKind::StopMove, number, stopped));
        }
        if let Some((_, number)) = self.clears.take_if(|_| mode != RobotMode::AutomaticErrorRecovery) {
            let status = match mode {
                RobotMode::Reflex => 4,
                RobotMode::UserStopped => 5,
                _ => 6,
            };
            self.replies.push((RequestKind::AutomaticErrorRecovery, number, status));
        }
        self.state.mode = mode;
        (self.state.generator, self.state.controller) = (Generator::Idle, Controller::Other);
        self.state.tau_d = [0.0; JOINTS];
    }

    /// One cycle with the command that came for the state before; `asked` is whether that state had been sent.
    pub(super) fn step(&mut self, command: Option<&RobotCommand>, asked: bool) {
        self.state.message_id += 1;
        if let Some((left, number)) = self.clears {
            self.clears = Some((left.saturating_sub(1), number)).filter(|_| left > 0);
            if left == 0 {
                self.state.errors = 0;
                self.state.mode = RobotMode::Idle;
                self.replies.push((RequestKind::AutomaticErrorRecovery, number, 0));
            }
        }
        let torque = self.motion.is_some_and(|m| m.generator == MoveGenerator::None && m.ends.is_none());
        match self.motion {
            Some(motion) if motion.ends.is_none() => self.obey(motion, command, asked),
            _ => self.brake(),
        }
        let torque = torque && self.motion.is_some();
        (self.state.q, self.state.dq) = match torque {
            true => self.plant.push(&self.state.tau_d),
            false => self.plant.follow(&self.q_d, &self.dq_d),
        };
        if torque {
            (self.q_d, self.dq_d, self.ddq_d) = (self.state.q, self.state.dq, [0.0; JOINTS]);
            self.watch_joints();
        }
        self.finish();
        let s = &mut self.state;
        (s.q_d, s.dq_d, s.ddq_d, s.tau) = (self.q_d, self.dq_d, self.ddq_d, s.tau_d);
        s.success_rate = self.came.iter().filter(|came| **came).count() as f64 / RATED as f64;
    }

    fn obey(&mut self, mut motion: Motion, command: Option<&RobotCommand>, asked: bool) {
        let command = command.filter(|_| !self.faults.deaf);
        let counts = asked && motion.missed.is_some() || command.is_some();
        if counts {
            if self.came.len() >= RATED {
                self.came.pop_front();
            }
            self.came.push_back(command.is_some());
        }
        motion.missed = match (command, motion.missed) {
            (Some(_), _) => Some(0),
            (None, Some(missed)) => Some(missed + u32::from(asked)),
            (None, None) => None,
        };
        motion.silent = if command.is_some() { 0 } else { motion.silent + 1 };
        if motion.missed.is_some_and(|missed| missed >= self.missed_cycles) {
            return self.reflex(RobotError::Communication.bit());
        }
        let ends = command.is_some_and(|c| c.motion_finished || c.torque_finished);
        motion.ends = ends.then_some(MoveStatus::Success);
        self.motion = Some(motion);
        let Some(command) = command else {
            return match motion.generator {
                MoveGenerator::None => {} // the last torques go on
                _ => self.extrapolate(motion.silent),
            };
        };
        let values = match motion.generator {
            MoveGenerator::None => &command.tau_c,
            MoveGenerator::JointVelocity => &command.dq_c,
            _ => &command.q_c,
        };
        if !values.iter().all(|v| v.is_finite()) {
            self.tell("a command that is no number");
            return self.end(MoveStatus::InputErrorAborted, RobotMode::Idle);
        }
        match motion.generator {
            MoveGenerator::None => self.take_torques(&command.tau_c),
            MoveGenerator::JointVelocity => self.take_velocities(&command.dq_c),
            _ => self.take_velocities(&std::array::from_fn(|i| (command.q_c[i] - self.q_d[i]) / CYCLE_S)),
        }
    }

    /// Without a command: accelerations go on, as the maker documents it; longer than a robot would wait, the arm brakes.
    fn extrapolate(&mut self, silent: u32) {
        if silent >= MISSED_CYCLES {
            return self.brake();
        }
        for i in 0..JOINTS {
            let (slow, fast) = self.limits.0[i].velocities(self.q_d[i]);
            let v = self.dq_d[i];
            self.dq_d[i] = (v + self.ddq_d[i] * CYCLE_S).clamp(slow.min(v), fast.max(v));
            self.q_d[i] += self.dq_d[i] * CYCLE_S;
        }
    }

    fn take_velocities(&mut self, dq_c: &Joints) {
        let mut errors = 0;
        for (i, limit) in self.limits.0.iter().enumerate() {
            let (v, q) = (dq_c[i], self.q_d[i] + dq_c[i] * CYCLE_S);
            let a = (v - self.dq_d[i]) / CYCLE_S;
            let j = (a - self.ddq_d[i]) / CYCLE_S;
            let (slow, fast) = limit.velocities(self.q_d[i]);
            // The maker's own tolerance of velocities is 1 mrad/s; nobody knows how much a robot has.
            let within = |v: f64| v >= TOLERANCE * slow - 1e-3 && v <= TOLERANCE * fast + 1e-3;
            if a.abs() > TOLERANCE * MAX_ACCELERATION {
                errors |= RobotError::VelocityDiscontinuity.bit();
            } else if j.abs() > TOLERANCE * MAX_JERK {
                errors |= RobotError::AccelerationDiscontinuity.bit();
            }
            if v.abs() > TOLERANCE * limit.velocity || !within(v) && v.abs() > self.dq_d[i].abs() {
                errors |= RobotError::CommandedVelocityLimits.bit();
            }
            if !(limit.lower..=limit.upper).contains(&q) {
                errors |= RobotError::CommandedPositionLimits.bit();
            }
        }
        if errors != 0 {
            return self.reflex(errors);
        }
        self.ddq_d = std::array::from_fn(|i| (dq_c[i] - self.dq_d[i]) / CYCLE_S);
        self.dq_d = *dq_c;
        for (q, v) in self.q_d.iter_mut().zip(dq_c) {
            *q += v * CYCLE_S;
        }
    }

    fn take_torques(&mut self, tau: &Joints) {
        let mut errors = 0;
        for ((tau, before), most) in tau.iter().zip(&self.state.tau_d).zip(&MAX_TORQUE) {
            if (tau - before).abs() > TOLERANCE * MAX_TORQUE_RATE * CYCLE_S {
                errors |= RobotError::TorqueDiscontinuity.bit();
            }
            if tau.abs() > TOLERANCE * most {
                errors |= RobotError::TorqueRange.bit();
            }
        }
        match errors {
            0 => self.state.tau_d = *tau,
            errors => self.reflex(errors),
        }
    }

    /// Under torques the joints themselves are looked at.
    fn watch_joints(&mut self) {
        let mut errors = 0;
        for (i, limit) in self.limits.0.iter().enumerate() {
            if !(limit.lower..=limit.upper).contains(&self.state.q[i]) {
                errors |= RobotError::JointPositionLimits.bit();
            }
            if self.state.dq[i].abs() > TOLERANCE * limit.velocity {
                errors |= RobotError::JointVelocity.bit();
            }
        }
        if errors != 0 {
            self.reflex(errors);
        }
    }

    /// Each joint slows down as fast as it may.
    fn brake(&mut self) {
        for i in 0..JOINTS {
            let v = self.dq_d[i];
            let slower = v - v.clamp(-MAX_ACCELERATION * CYCLE_S, MAX_ACCELERATION * CYCLE_S);
            self.ddq_d[i] = (slower - v) / CYCLE_S;
            self.dq_d[i] = slower;
            self.q_d[i] += slower * CYCLE_S;
        }
    }

    /// A motion that was asked to end is over when its reference rests.
    fn finish(&mut self) {
        let rests = self.dq_d.iter().all(|v| *v == 0.0);
        if let Some(status) = self.motion.and_then(|m| m.ends).filter(|_| rests) {
            self.end(status, RobotMode::Idle);
            self.stand();
        }
    }

    /// Whether a motion runs.
    pub(super) fn is_moved(&self) -> bool {
        self.motion.is_some()
    }
}

#[cfg(test)]
mod tests;
