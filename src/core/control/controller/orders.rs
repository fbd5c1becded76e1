//! Requests of clients and orders of the mission. They take effect from the next step on.

use super::Controller;
use crate::control::behaviour::{CommandedMotion, MotionCommand};
use crate::control::lifecycle::{Cue, Refusal, Request, State, Step};
use crate::control::safety::Fault;
use crate::control::trace::Event;
use crate::drive::DriveState;
use crate::motion::ExcitationMotion;
use crate::servo::SetPoint;
use crate::time::{MonoNs, SpanNs, TICK};
use nalgebra::SVector;

/// Factor of the disturbance estimation rate each time that an arm oscillates. Chosen by hand: nearer to 1 an arm oscillates for more rounds before
/// it is calm, nearer to 0 a load that was not modelled is learnt too slowly afterwards.
/// `arm_unlike_model::an_arm_that_swings_is_calmed_and_comes_home` is the test of it.
const REDUCED_SHARE: f64 = 0.4;
/// How quickly the share of the velocity limits changes that reduced mode leaves, 1/s. Derived: from all of it to a quarter in 0.3 s, so that an arm has slowed down within the 0.5 s that safety systems
/// of robots usually wait; from 3.1 rad/s that takes 8 rad/s2, less than arms have by default, so that motions on a path stay on it.
const SPEED_SHARE_1_S: f64 = 2.5;

impl<const N: usize> Controller<N> {
    /// Takes a request, which takes effect from the next step on.
    ///
    /// # Errors
    /// When the lifecycle refuses the request in its present state, with the reason.
    pub fn request(&mut self, request: Request) -> Result<(), Refusal> {
        match self.state.next(Cue::Request(request)) {
            Step::Refuse(refusal) => Err(refusal),
            Step::Stay => Ok(()),
            Step::To(next) => {
                if request == Request::Reset {
                    self.forget_fault();
                }
                if matches!(request, Request::Start | Request::Reset) {
                    self.restore_gain();
                    self.begin_law_anew();
                }
                self.state = next;
                Ok(())
            }
        }
    }

    /// The fault is to be reset when the robot has cleared its error: until then the arm rests in the state `Clearing`.
    pub fn await_robot(&mut self) {
        self.cue(Cue::RobotClears);
    }

    /// The robot has cleared its error, or does not: the end of [`Self::await_robot`].
    pub fn robot_answered(&mut self, is_ready: bool) {
        // What has failed at this tick comes before: the next step takes it in.
        if self.state != State::Clearing || self.failure.is_some() {
            return;
        }
        self.events.push(if is_ready { Event::RobotReady } else { Event::RobotNotCleared });
        self.cue(if is_ready { Cue::RobotReady } else { Cue::RobotStays });
        if is_ready {
            self.forget_fault();
            self.restore_gain();
            self.begin_law_anew();
        }
    }

    /// What has failed since the last step is kept: nobody who asked for the reset knew of it.
    fn forget_fault(&mut self) {
        self.fault = None;
        self.encoder_watch.restart();
    }

    /// Reports a fault from outside the controller. The first fault is the one that is kept.
    pub fn fail(&mut self, fault: Fault) {
        self.failure.get_or_insert(fault);
    }

    /// Whether the robot says that its own limits are reduced, at every tick: the arm slows down to its share of the velocity limits, and becomes quick again.
    pub(in crate::control) fn reduce_speed(&mut self, is_reduced: bool) {
        let share = if is_reduced { self.reduced_speed_share } else { 1.0 };
        let most = SPEED_SHARE_1_S * TICK.as_s();
        self.speed_share += (share - self.speed_share).clamp(-most, most);
    }

    /// The next state of the drive is an old one: supervision does not take it for a joint that stands.
    pub fn hear_old_state(&mut self) {
        self.is_state_old = true;
    }

    /// The fault, where there is one.
    #[must_use]
    pub fn fault(&self) -> Option<Fault> {
        self.fault
    }

    /// Sets the goal. In the state `Teaching` this also ends teaching. A goal of another target waits for its first measurement: an arm that servoes brakes until then.
    pub fn set_goal(&mut self, goal: SetPoint) {
        if goal.target() != self.servo.set_point().target() {
            self.behaviour.forget_target();
            self.returning.forget_target();
        }
        self.forget_losses();
        self.servo.set_goal(goal);
        self.cue(Cue::Taught);
    }

    /// Moves to the posture `q`, rad or m, in the state `Moving`.
    pub fn go_to(&mut self, q: &SVector<f64, N>) {
        self.velocity.end();
        self.posture.begin(q);
    }

    /// Moves by `motion`, and brakes after `hold` unless the next one has come, in the state `Moving`.
    pub fn move_by(&mut self, motion: CommandedMotion<N>, hold: SpanNs) {
        self.posture.end();
        self.velocity.command(motion, hold);
    }

    /// Whether a client's velocities move the arm.
    #[must_use]
    pub fn moves_by_velocities(&self) -> bool {
        self.velocity.is_active()
    }

    /// The motion command of a client's motion at this tick, in the state `Moving`.
    pub(super) fn motion_asked_for(&mut self, now: MonoNs, state: &DriveState<N>) -> MotionCommand<N> {
        let may_move = (self.rests(), !self.probes);
        if self.velocity.is_active() {
            let cell = (&self.arm, &self.servo.settings().mount);
            self.velocity.motion_command(now, state, may_move, cell)
        } else {
            let pace = self.pace();
            self.posture.motion_command(self.reference.state(), may_move, pace, &self.arm.limits)
        }
    }

    /// Sets the gain of a resolved-velocity law, 1/s, where it has a single one.
    pub fn set_gain(&mut self, gain_1_s: f64) {
        self.servo.set_gain(gain_1_s);
        if let Some(second) = &mut self.second {
            second.set_gain(gain_1_s);
        }
    }

    /// Appends a waypoint, rad or m; that the motion is complete is reported after it.
    pub fn add_waypoint(&mut self, q: &SVector<f64, N>) {
        self.over_told = false;
        self.behaviour.add_waypoint(q);
    }

    /// Sets the excitation motion for a calibration.
    pub fn excite(&mut self, motion: &ExcitationMotion<N>) {
        self.behaviour.excite(motion);
    }

    /// From now on somebody else commands the arm, by [`Self::command`], instead of the law. Returns whether: only servoing by one camera is handed over.
    pub fn hand_over(&mut self) -> bool {
        self.second.is_none() && self.behaviour.hand_over(self.servo.settings().mount)
    }

    /// Sets the motion that somebody else commands, or that there is none.
    pub fn command(&mut self, motion: Option<CommandedMotion<N>>) {
        self.behaviour.command(motion);
    }

    /// Reduces the gain of the law and the estimation rate, for an arm that oscillates about its goal. Returns whether they were reduced,
    /// which is reported as an event too.
    pub fn reduce_gain(&mut self) -> bool {
        let reduced = self.state == State::Servoing && !self.behaviour.is_dry() && self.reduce_law();
        if reduced {
            self.learning *= REDUCED_SHARE;
            self.joint_control.learn_at(self.learning);
            self.events.push(Event::GainReduced);
        }
        reduced
    }

    /// Restores the full estimation rate, for an arm that stands before its goal: this frees a joint that sticks.
    pub fn restore_gain(&mut self) {
        self.learning = 1.0;
        self.joint_control.learn_at(1.0);
    }
}
