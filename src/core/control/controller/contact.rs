//! Contact with the arm's surroundings: noticing it, and what is done about it.

use super::Controller;
use crate::control::behaviour::MotionCommand;
use crate::control::safety::{Contact, ContactReaction, Fault};
use crate::drive::{CommandMode, DriveState};
use crate::motion::SETTLES;
use crate::time::{MonoNs, SpanNs, TICK};
use nalgebra::SVector;

/// An arm that goes back goes to where it was so long before the contact was noticed. Chosen by hand: at 0.25 m/s that is 20 mm; the contact itself is noticed
/// after some 10 ms.
const BACK: SpanNs = SpanNs(80_000_000);
/// The same before a drive that closes its own loop, which goes on pressing where it is stopped: by what it pressed and little more.
/// Chosen by hand: twice what it takes to notice the contact.
const UNLOAD: SpanNs = SpanNs(40_000_000);
/// It goes back with the speed from which it can brake at its target with this share of its acceleration, and at most with this rate, 1/s. Chosen by hand: near to
/// the quickest way within the limits of the reference.
const BRAKES: f64 = 0.8;
/// The rate near the target. Chosen by hand with the share above: 30 1/s would brake with 10 rad/s^2 from 0.3 rad/s on.
const BACK_1_S: f64 = 30.0;

/// For how long it does so at most. Chosen by hand: four times what it takes; an arm that is clamped stands after that.
const GIVES_UP: SpanNs = SpanNs(1_000_000_000);

/// Time without a touch after which nothing acts on the arm any more. Derived: in which the observer of external torques forgets what it told.
const LET_GO: SpanNs = SpanNs(SETTLES as i64 * TICK.0);

/// Time without a touch after which an arm that a push has moved has braked; one that moves on sinks. Chosen by hand: where what is left of the
/// braking was learnt too, from 0.05 s on, a Panda that 68 N had pushed went on with 0.2 rad/s; from 0.3 s on none does (`contact::a_push_that_is_over_moves_the_arm_no_more`).
const BRAKED: SpanNs = SpanNs(300_000_000);

/// The way back from a contact.
#[derive(Debug, Clone, Copy)]
pub(super) struct WayBack<const N: usize> {
    target: SVector<f64, N>,
    /// Where the commands have led so far.
    at: SVector<f64, N>,
    until: MonoNs,
}

impl<const N: usize> Controller<N> {
    /// Takes in what the last command did to the arm; a contact while it moves by itself is a fault, unless it is ignored.
    pub(super) fn feel(&mut self, now: MonoNs, observed: Option<&DriveState<N>>) {
        let command = self.gate.passed();
        let did = observed.filter(|_| self.gate.is_open()).map(|state| (state, &command));
        let measured = self.measured_torque.as_ref();
        self.contact_watch.note((now, self.timing), &self.arm.robot, &mut self.joint_control, did, measured);
        if self.contact_watch.is_touched() {
            self.touched_at = Some(now);
        }
        if !self.obeys {
            return;
        }
        let acts = self.state.moves() && self.fault.is_none() && self.failure.is_none();
        if acts && self.mode == CommandMode::Torque {
            let steps = self.joint_control.encoder_step();
            let stays = std::array::from_fn(|i| self.encoder_watch.stays(i, now, steps[i]));
            // No contact, for all that is known: whoever ignores those does not ask for joints that nobody sees to be pushed on.
            if self.contact_watch.is_stuck(&self.arm.robot, &stays) {
                self.fail(Fault::StuckReading);
                return;
            }
        }
        if self.reaction == ContactReaction::Ignore {
            // What pushes the arm is no property of it: it would swing back by what was learnt.
            self.joint_control.pause_learning(self.contact_watch.is_touched());
            return;
        }
        let Some(state) = observed.filter(|_| acts) else { return };
        let robot = self.joint_control.carrying(&self.arm.robot);
        if let Some(contact) = self.contact_watch.contact(robot, &state.q) {
            self.contact = Some(contact);
            let before = if self.reaction == ContactReaction::Release { BACK } else { UNLOAD };
            let goes_back = self.reaction == ContactReaction::Release || self.mode != CommandMode::Torque;
            self.back = goes_back
                .then(|| self.servo.joints_at(now - before))
                .flatten()
                .map(|target| WayBack { target, at: state.q, until: now + GIVES_UP });
            self.fail(Fault::Contact);
        }
    }

    /// The motion of an arm that does not move by itself: back from a contact, or none.
    pub(super) fn motion_back(&mut self, now: MonoNs) -> MotionCommand<N> {
        let is_over = |back: &WayBack<N>| now > back.until || !self.fault.is_some_and(Fault::is_contact);
        if self.back.as_ref().is_some_and(is_over) {
            self.back = None;
        }
        let Some(back) = &mut self.back else { return MotionCommand::Stand };
        // The reference before a drive that obeys velocities is the measured arm, which something held: what was commanded beyond that is still in its loop.
        if self.mode == CommandMode::Velocity {
            back.at += self.gate.passed().qd_r * TICK.as_s();
        } else {
            back.at = self.reference.state().q;
        }
        let acceleration = &self.arm.limits.acceleration;
        MotionCommand::Joints(SVector::from_fn(|i, _| {
            let way = back.target[i] - back.at[i];
            let brakes = (2.0 * BRAKES * acceleration[i] * way.abs()).sqrt();
            way.signum() * brakes.min(BACK_1_S * way.abs())
        }))
    }

    /// Whether the arm is carried and can be moved by hand, after a contact; but not with a joint whose reading is stuck.
    pub(in crate::control) fn floats(&self) -> bool {
        self.fault == Some(Fault::Contact) && self.reaction == ContactReaction::Float
    }

    /// Whether nothing acts on the arm any more: the motors do what they are told, and the model tells what the arm does.
    pub(super) fn is_let_go(&self, now: MonoNs) -> bool {
        self.touched_at.is_none_or(|at| now - at > LET_GO)
    }

    /// Chooses what brakes an arm in a fault that does not brake as it is commanded, in state `q` with the velocities `qd`: its model, or each joint by itself.
    pub(super) fn choose_brake(
        &mut self,
        now: MonoNs,
        (q, qd): (&SVector<f64, N>, &SVector<f64, N>),
        (is_wild, is_overdue): (bool, bool),
    ) {
        // What the working joints do, learnt as a disturbance, would drive one whose encoder says nothing.
        let heard = self.encoder_watch.distrusted() == [false; N];
        let is_let_go = self.is_let_go(now);
        let is_slow = (0..N).all(|i| qd[i].abs() < self.arm.limits.velocity[i]);
        let control = &mut self.joint_control;
        if is_wild || !heard {
            control.brake_by_joint(q);
        } else if !is_overdue {
            if self.fault.is_some_and(Fault::is_contact) && is_let_go {
                control.brake_by_model();
            }
        } else if !control.brakes_by_joint() {
            control.brake_by_joint_for_good(q);
        } else if is_let_go && is_slow {
            control.brake_by_model_once(&self.arm.robot, q, qd);
        }
    }

    /// Whether disturbances are learnt on in a fault. An arm that moves on is not held by what was learnt before; what pressed against something is, and what the robot's
    /// own brakes hold. What pushes an arm is no property of it: learnt, it would drive the arm on when the push ends; nor is what moves one that each joint brakes by itself. What sinks
    /// on when nothing pushes any more has a load that nobody told, and is held; but what is to be moved by hand.
    pub(super) fn learns_in_fault(&self, now: MonoNs) -> bool {
        let is_held = self.fault.is_some_and(Fault::is_of_robot) || self.rest_watch.is_at_rest();
        let sinks =
            !self.floats() && self.back.is_none() && self.touched_at.is_none_or(|at| now - at > BRAKED);
        let touches = self.fault.is_some_and(Fault::is_contact) && !sinks;
        let is_pushed = touches || self.joint_control.brakes_by_joint();
        !is_pushed && (self.joint_control.damps() || !is_held)
    }

    /// What touches the arm in posture `q`, or stopped it where that fault stands.
    pub(super) fn touched_by(&self, q: &SVector<f64, N>) -> Option<Contact> {
        if self.fault.is_some_and(Fault::is_contact) {
            return self.contact;
        }
        let robot = self.joint_control.carrying(&self.arm.robot);
        self.contact_watch.contact(robot, q).filter(|_| self.obeys)
    }

    /// The contact that stopped the arm last.
    #[must_use]
    pub fn contact(&self) -> Option<Contact> {
        self.contact
    }
}
