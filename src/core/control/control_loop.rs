//! The loop of the real-time thread: drive, controller, and bringing the arm to rest. The task of a run, and its end, belong to the
//! mission. That a run ends only when the arm is at rest is ensured here.
//!
//! ```text
//! orders, requests, stops ─► [ControlLoop] ─► Trace, one a tick
//! end asked for ─► the arm brakes within its limits ─► measured arm at rest ─► the last tick
//!                       └─ still moving 3 s after its reference came to rest, or no state that tells: a fault ─► the last tick
//! ```
//! It does not allocate, log or fail.

use crate::control::controller::{Controller, Rest, UnknownJoint};
use crate::control::lifecycle::{Refusal, Request, State};
use crate::control::order::ControlOrder;
use crate::control::records::{command_trace, joint_state, padded};
use crate::control::safety::Fault;
use crate::control::trace::{Event, Events, FrameStamps, LatencyStages, MeasurementRecord, Trace};
use crate::drive::{Drive, DriveCommand, DriveHealth, DriveState, RobotReport};
use crate::messages::{JointState, MAX_JOINTS, Measurement, RobotState, TraceMsg, trace_flag};
use crate::time::{MonoNs, SpanNs};
use nalgebra::SVector;

/// The reason of a run that ends because a client asked for it.
const SHUT_DOWN: &str = "somebody asked for the end";
/// Time that a robot has to clear its error after a reset was asked for. Derived: a protective stop of Universal Robots is unlocked 5 s after it came at the
/// earliest, and the driver gives the robot's program 5 s to start; half as much more, because others are slower.
const CLEARS_WITHIN: SpanNs = SpanNs(15_000_000_000);

/// Settings of a loop.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LoopSettings {
    /// Whether it continues after a stop, idle, until a request to shut down.
    pub served: bool,
    /// Whether this loop moves the arm, so that its end waits until the arm is at rest.
    pub moves_an_arm: bool,
    /// Whether ticks, frames and measurements are stamped by one clock: in real time, not in lockstep.
    pub one_clock: bool,
}

/// Drive and controller of one run.
pub struct ControlLoop<const N: usize> {
    controller: Controller<N>,
    drive: Box<dyn Drive<N> + Send>,
    settings: LoopSettings,
    ticks: u64,
    sensed: DriveState<N>,
    command: DriveCommand<N>,
    /// The end, with its reason, where it was not decided by the mission.
    ends: bool,
    stopped: Option<&'static str>,
    joint_state: JointState,
    events: Events,
    /// The joint of which nobody could tell whether it stood when the loop ended.
    unknown: Option<UnknownJoint>,
    /// What the drive told of its robot at this tick, and since when a reset waits for that.
    robot: RobotReport,
    clears_since: Option<MonoNs>,
    /// Whether an arm in a fault should be at rest, and moves on.
    is_restless: bool,
    /// What came from outside since the last tick: bits of [`trace_flag`], and orders in all.
    inputs: u32,
    orders: u32,
}

impl<const N: usize> ControlLoop<N> {
    /// A loop before its first tick.
    #[must_use]
    pub fn new(controller: Controller<N>, drive: Box<dyn Drive<N> + Send>, settings: LoopSettings) -> Self {
        let zero = SVector::zeros();
        Self {
            controller,
            drive,
            settings,
            ticks: 0,
            sensed: DriveState { q: zero, qd: zero, truth: None },
            command: DriveCommand { tau: zero, q_r: zero, qd_r: zero, qdd_r: zero },
            ends: false,
            stopped: None,
            joint_state: JointState::default(),
            events: Events::default(),
            unknown: None,
            robot: RobotReport::default(),
            clears_since: None,
            is_restless: false,
            inputs: 0,
            orders: 0,
        }
    }

    /// First half of a tick: reads the drive at the tick's time.
    pub fn sense(&mut self, tick: u64, now: MonoNs) -> JointState {
        self.sensed = self.drive.read(now);
        self.controller.hear_torque(self.drive.measured_torque());
        if self.drive.health().is_old {
            self.controller.hear_old_state();
            self.inputs |= trace_flag::LATE_STATE;
        }
        if self.drive.is_over() {
            self.inputs |= trace_flag::MOTION_OVER;
        }
        let DriveHealth { fault, robot, .. } = self.drive.health();
        if let Some(fault) = fault {
            self.fail(Fault::Drive(fault));
        }
        self.hear_robot(now, robot);
        let wanted = self.controller.servo().set_point().target();
        self.joint_state = joint_state(tick, self.ticks, now, &self.sensed, &self.command, wanted);
        self.joint_state
    }

    /// Takes in what the robot is beside its joints: one that has stopped by itself is a fault, and one that obeys again ends the wait of a reset.
    fn hear_robot(&mut self, now: MonoNs, robot: RobotReport) {
        self.robot = robot;
        self.controller.reduce_speed(robot.state == RobotState::Reduced);
        let clears = self.controller.state() == State::Clearing;
        let since = clears.then(|| self.clears_since.unwrap_or(now));
        self.clears_since = since;
        if let Some(since) = since {
            let RobotReport { state, .. } = robot;
            // A robot that opens its brakes meanwhile is on its way.
            let goes_on = state.can_be_cleared() || state == RobotState::Enabling;
            if state.obeys() {
                self.drive.reset();
                self.controller.robot_answered(true);
            } else if !goes_on || now - since > CLEARS_WITHIN {
                self.controller.robot_answered(false);
            }
        }
        if let Some(fault) = Fault::of_robot(robot.state).filter(|_| self.controller.fault().is_none()) {
            self.fail(fault);
        }
        self.drive.clear_robot(self.controller.state() == State::Clearing);
    }

    /// Second half: steps the controller on that state and writes the drive. [`Trace::over`] ends the loop.
    pub fn act(&mut self, now: MonoNs, measurement: Option<&Measurement>) -> Trace {
        let output = self.controller.step(now, &self.sensed, measurement);
        self.drive.write(&output.command);
        self.command = output.command;
        self.ticks += 1;
        output.events.iter().for_each(|event| self.events.push(event));
        self.tell_restless(output.state);
        // In lockstep there are no more states when the drive does not answer, so that it makes no sense to wait for the arm to come to rest.
        let is_cut_off = !self.settings.one_clock && matches!(output.fault, Some(Fault::Drive(_)));
        let is_cut_off = is_cut_off && (self.ends || !self.settings.served);
        let over = if is_cut_off && self.settings.moves_an_arm {
            self.ends_unseen()
        } else {
            is_cut_off || (self.ends && self.comes_to_its_end())
        };
        if over {
            self.drive.end(&self.controller.last_command());
        }
        let record = measurement.map(|m| MeasurementRecord {
            frame: FrameStamps::of(m),
            verdict: output.verdict,
            degraded: self.controller.is_degraded(m.camera),
            error_px: f64::NAN,
            latency: None,
        });
        Trace {
            joint_state: self.joint_state,
            command: command_trace(&output),
            V_C: self.controller.camera_law_output(now).map(Into::into),
            state: output.state.told(),
            fault: output.fault,
            stopped: self.stopped,
            over,
            inputs: std::mem::take(&mut self.inputs),
            robot: self.robot,
            clears: output.state == State::Clearing,
            orders: self.orders,
            path_began: self.controller.servo().path_began(),
            measurement_record: record,
            limits: output.limits,
            held_by: output.held_by,
            external_torque: output
                .external_torque
                .map_or([[f64::NAN; MAX_JOINTS]; 2], |(torque, sd)| [torque, sd].map(|v| padded(&v))),
            contact: output.contact,
            measured_torque: self.drive.measured_torque().map(|tau| padded(&tau)),
            events: std::mem::take(&mut self.events),
            ..Trace::at(now)
        }
    }

    /// Notes when the command of the tick of `trace` was written, which completes the latency of the measurement that it used.
    pub fn commanded(&self, at: MonoNs, trace: &mut Trace) {
        trace.commanded = at;
        if let Some(record) = &mut trace.measurement_record {
            record.latency = Some(LatencyStages::of(&record.frame, at, self.settings.one_clock));
        }
    }

    /// Whether this was the last tick of a loop that is to end: the arm stands, cannot be waited for, or does not come to rest.
    fn comes_to_its_end(&mut self) -> bool {
        if !self.settings.moves_an_arm {
            return true;
        }
        match self.controller.rest() {
            Rest::AtRest => true,
            Rest::Restless => self.ends_as(Fault::NotAtRest),
            Rest::Unknown => self.ends_unseen(),
            Rest::Moving => {
                let _ = self.controller.request(Request::Shutdown); // nothing refuses it
                false
            }
        }
    }

    /// Tells in a fault of a loop that goes on that the arm should be at rest, and moves.
    fn tell_restless(&mut self, state: State) {
        let is_left_alone = self.ends || self.controller.floats(); // one that floats is led by hand
        let should_stand = matches!(state, State::Failing | State::Fault) && !is_left_alone;
        let moves_on = should_stand && self.controller.rest() == Rest::Restless;
        if moves_on && !self.is_restless {
            self.events.push(Event::StillMoves);
        }
        self.is_restless = moves_on;
    }

    /// This is the last tick although the arm is not known to stand: tells so.
    fn ends_as(&mut self, fault: Fault) -> bool {
        self.events.push(Event::Fault(fault));
        true
    }

    /// The same where its joints are not seen. Of those that stood when they were seen last nothing is told but the fault that hides them.
    fn ends_unseen(&mut self) -> bool {
        self.unknown = self.controller.unknown_joint(&self.sensed).filter(|joint| !joint.stood());
        self.unknown.is_none() || self.ends_as(Fault::RestUnknown)
    }

    /// Brings the arm to rest and ends the loop with `reason`.
    pub fn stop(&mut self, reason: &'static str) {
        self.inputs |= trace_flag::END_ASKED;
        if !self.ends {
            self.stopped = Some(reason);
            self.events.push(Event::Stopping);
            self.end();
        }
    }

    fn end(&mut self) {
        self.ends = true;
        let _ = self.controller.request(Request::Shutdown); // nothing refuses it
    }

    /// Takes a request that comes by no message: of the stop word.
    ///
    /// # Errors
    /// When the lifecycle refuses the request, with the reason.
    pub fn halt(&mut self, request: Request) -> Result<(), Refusal> {
        self.inputs |= match request {
            Request::Shutdown => trace_flag::SHUTDOWN_ASKED,
            _ => trace_flag::STOP_ASKED,
        };
        self.request(request)
    }

    /// Takes a request of a client.
    ///
    /// # Errors
    /// When the lifecycle refuses the request, with the reason.
    pub fn request(&mut self, request: Request) -> Result<(), Refusal> {
        if self.ends {
            return Err(Refusal::Ending);
        }
        match self.blocked_by() {
            Some(refusal) if request == Request::Reset && self.controller.state() == State::Fault => {
                refusal?;
                self.controller.await_robot();
            }
            _ => self.controller.request(request)?,
        }
        // Velocities come many times a second: the first of them is an event.
        if !(request == Request::Velocity && self.controller.moves_by_velocities()) {
            self.events.push(Event::Requested(request));
        }
        // A run that is not served has no idle state: a stop ends it.
        if request == Request::Shutdown || (request == Request::Stop && !self.settings.served) {
            (self.ends, self.stopped) = (true, Some(SHUT_DOWN));
        }
        if request == Request::Reset {
            self.drive.reset();
        }
        Ok(())
    }

    /// What a reset has to wait for before the robot obeys again, or why it is refused; `None` where it obeys.
    fn blocked_by(&self) -> Option<Result<(), Refusal>> {
        match self.robot.state {
            state if state.obeys() => None,
            RobotState::EmergencyStop => Some(Err(Refusal::RobotEmergencyStop)),
            RobotState::Off | RobotState::Braked | RobotState::Enabling => Some(Err(Refusal::RobotOff)),
            RobotState::Fault => Some(Err(Refusal::RobotFault)),
            _ => Some(Ok(())),
        }
    }

    /// Takes a request of a client and, where it is accepted, the order that carries what it asks for.
    ///
    /// # Errors
    /// When the lifecycle refuses the request, with the reason.
    pub fn request_with(&mut self, request: Request, order: Option<&ControlOrder<N>>) -> Result<(), Refusal> {
        self.request(request)?;
        if let Some(order) = order {
            self.do_as_ordered(order);
        }
        Ok(())
    }

    /// Takes an order of the mission.
    pub fn obey(&mut self, order: &ControlOrder<N>) {
        self.orders = self.orders.wrapping_add(1);
        self.do_as_ordered(order);
    }

    fn do_as_ordered(&mut self, order: &ControlOrder<N>) {
        match order {
            ControlOrder::End => self.end(),
            // The lifecycle refuses it where a client's request contradicts it.
            ControlOrder::Request(request) => {
                let _ = self.controller.request(*request);
            }
            ControlOrder::Goal(goal) => self.controller.set_goal(goal.clone()),
            ControlOrder::Waypoint(q) => self.controller.add_waypoint(q),
            ControlOrder::Posture(q) => self.controller.go_to(q),
            ControlOrder::Velocity(motion, hold) => self.controller.move_by(*motion, *hold),
            ControlOrder::Gain(gain_1_s) => self.controller.set_gain(*gain_1_s),
            ControlOrder::Excite(motion) => self.controller.excite(motion),
            ControlOrder::Command(motion) => self.controller.command(*motion),
            ControlOrder::ReduceGain => {
                let _ = self.controller.reduce_gain();
            }
            ControlOrder::TryAnotherWay => self.controller.try_another_way(),
            ControlOrder::RestoreGain => self.controller.restore_gain(),
        }
    }

    /// From now on somebody else commands the arm, by [`ControlOrder::Command`], instead of the law. Returns whether: only servoing is handed over.
    pub fn hand_over(&mut self) -> bool {
        self.controller.hand_over()
    }

    /// Reports a fault from outside the control core: the arm is brought to rest from the next [`act`](Self::act) on.
    pub fn fail(&mut self, fault: Fault) {
        if TraceMsg::reported_fault_of(self.inputs) == 0 {
            self.inputs |= fault.code() << trace_flag::REPORTED_FAULT;
        }
        self.controller.fail(fault);
    }

    /// No tick follows, whatever state the loop is in: the drive is to stop by its own means.
    pub fn abandon(&mut self) {
        self.drive.end(&self.controller.last_command());
    }

    /// The joint of which nobody could tell whether it stood when the loop ended; `None` where all were seen.
    #[must_use]
    pub fn unknown_joint(&self) -> Option<UnknownJoint> {
        self.unknown
    }

    /// Ticks that found no new state of the drive in time.
    #[must_use]
    pub fn late_drive_states(&self) -> u64 {
        self.drive.health().late_states
    }

    /// Orders of the mission that were obeyed.
    #[must_use]
    pub fn orders(&self) -> u32 {
        self.orders
    }

    /// Positions (rad or m) and velocities (rad/s or m/s) of the joints as the drive tells them at this tick.
    #[must_use]
    pub fn measured_arm(&self) -> (SVector<f64, N>, SVector<f64, N>) {
        (self.sensed.q, self.sensed.qd)
    }

    /// The controller.
    #[must_use]
    pub fn controller(&self) -> &Controller<N> {
        &self.controller
    }

    /// Ticks done.
    #[must_use]
    pub fn ticks(&self) -> u64 {
        self.ticks
    }
}
