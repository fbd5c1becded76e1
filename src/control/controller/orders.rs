//! What clients and the mission want of a controller: it is so from the next step on.

use super::Controller;
use crate::control::lifecycle::{Cue, Refusal, Request, State, Step};
use crate::control::safety::Fault;
use crate::control::trace::Event;
use crate::motion::ExcitationMotion;
use crate::servo::SetPoint;
use nalgebra::SVector;

/// Share of the rate of learning that is left to an arm that swings.
const REDUCED_SHARE: f64 = 0.4;

impl<const N: usize> Controller<N> {
    /// Somebody wants something; it is so from the next step on.
    ///
    /// # Errors
    /// Why not.
    pub fn request(&mut self, request: Request) -> Result<(), Refusal> {
        match self.state.next(Cue::Request(request)) {
            Step::Refuse(refusal) => Err(refusal),
            Step::Stay => Ok(()),
            Step::To(next) => {
                if request == Request::Reset {
                    (self.fault, self.failure) = (None, None);
                }
                if matches!(request, Request::Start | Request::Reset) {
                    self.restore_gain();
                    self.servo.restore_gain();
                }
                self.state = next;
                Ok(())
            }
        }
    }

    /// Something outside has failed. The first fault is the one that is told.
    pub fn fail(&mut self, fault: Fault) {
        self.failure.get_or_insert(fault);
    }

    /// From now on `goal` is sought. While it is taught, that ends the lesson.
    pub fn set_goal(&mut self, goal: SetPoint) {
        self.servo.set_goal(goal);
        self.cue(Cue::Taught);
    }

    /// One more posture to go to, rad or m.
    pub fn add_waypoint(&mut self, q: &SVector<f64, N>) {
        self.behaviour.add_waypoint(q);
    }

    /// The motion by which to calibrate.
    pub fn excite(&mut self, motion: &ExcitationMotion<N>) {
        self.behaviour.excite(motion);
    }

    /// The arm moves about its goal and gets no nearer: from now on it goes there, and learns, more slowly. Whether it does, which is an
    /// event too.
    pub fn reduce_gain(&mut self) -> bool {
        let reduced = self.state == State::Servoing && !self.behaviour.is_dry() && self.servo.reduce_gain();
        if reduced {
            self.learning *= REDUCED_SHARE;
            self.joint_control.learn_at(self.learning);
            self.events.push(Event::GainReduced);
        }
        reduced
    }

    /// The arm stands before its goal: what was slowed down learns at its full rate again, which frees a joint that sticks.
    pub fn restore_gain(&mut self) {
        self.learning = 1.0;
        self.joint_control.learn_at(1.0);
    }
}
