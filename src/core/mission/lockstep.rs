//! Control and mission on one thread: the loop of lockstep and simulated runs.

use super::{FinalErrors, Mission};
use crate::control::control_loop::ControlLoop;
use crate::control::controller::Controller;
use crate::control::lifecycle::{Refusal, Request};
use crate::control::safety::Fault;
use crate::control::trace::Trace;
use crate::messages::{ControlCommand, ControlState, JointState, Measurement};
use crate::time::MonoNs;

/// A run whose mission is called after each tick: an order of tick k always takes effect at tick k + 1.
pub struct LockstepRun<const N: usize> {
    /// The loop.
    pub control: ControlLoop<N>,
    /// The mission.
    pub mission: Mission<N>,
}

impl<const N: usize> LockstepRun<N> {
    /// A run before its first tick.
    #[must_use]
    pub fn new(control: ControlLoop<N>, mission: Mission<N>) -> Self {
        let mut run = Self { control, mission };
        run.obey();
        run
    }

    /// First half of a tick: reads the drive at the tick's time.
    pub fn sense(&mut self, tick: u64, now: MonoNs) -> JointState {
        self.control.sense(tick, now)
    }

    /// Second half: control acts, its command is written at once, and the mission evaluates the tick. A finish ends the run.
    pub fn act(&mut self, now: MonoNs, measurement: Option<&Measurement>) -> Trace {
        let mut trace = self.control.act(now, measurement);
        self.control.commanded(now, &mut trace);
        self.mission.note(&mut trace, measurement);
        self.obey();
        trace
    }

    /// A whole tick.
    pub fn tick(&mut self, tick: u64, now: MonoNs, measurement: Option<&Measurement>) -> Trace {
        self.sense(tick, now);
        self.act(now, measurement)
    }

    fn obey(&mut self) {
        while let Some(order) = self.mission.next_order() {
            self.control.obey(&order);
        }
    }

    /// Brings the arm to rest and ends the run with `reason`.
    pub fn stop(&mut self, reason: &'static str) {
        self.control.stop(reason);
    }

    /// Takes a request of a client.
    ///
    /// # Errors
    /// When the lifecycle refuses the request, with the reason.
    pub fn request(&mut self, request: Request) -> Result<(), Refusal> {
        self.control.request(request)
    }

    /// Takes the request `number` of a client, with what it carries.
    ///
    /// # Errors
    /// When it cannot be done, or the lifecycle refuses it, with the reason.
    pub fn ask(&mut self, number: u64, request: Request, command: &ControlCommand) -> Result<(), Refusal> {
        let order = self.mission.plan(number, request, command)?;
        let answer = self.control.request_with(request, order.as_ref());
        self.mission.decided(number, answer.is_ok());
        answer
    }

    /// Reports a fault from outside the control core.
    pub fn fail(&mut self, fault: Fault) {
        self.control.fail(fault);
    }

    /// The controller.
    #[must_use]
    pub fn controller(&self) -> &Controller<N> {
        self.control.controller()
    }

    /// The last state of control.
    #[must_use]
    pub fn state(&self) -> ControlState {
        self.mission.state()
    }

    /// Errors when the end of the run was decided, or now: the displacement of braking at the end does not count.
    #[must_use]
    pub fn final_errors(&self) -> FinalErrors {
        self.mission.final_errors()
    }
}

#[cfg(test)]
mod tests;
