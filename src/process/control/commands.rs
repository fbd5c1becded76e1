//! What `vservo ctl` wants, on its way to the loop and back.
//!
//! ```text
//! control/command ──► Commands ──ring──► real-time thread: ControlLoop::request
//! control/command ◄── Commands ◄─ring─── its answer
//! ```
//! Questions for the state alone are answered here, and requests that mean nothing are refused here. The companion itself asks on the same way, so that recordings have it.
//!
//! Clients cannot disturb a run: requests that cannot be taken are counted and reported, and never end it.

use super::requests::{Answered, ClientRequest};
use super::stops::Stops;
use crate::control::lifecycle::{Refusal, Request};
use crate::control::safety::ContactNumbers;
use crate::control::trace::Trace;
use crate::ipc::{Asked, CommandServer, MAX_CLIENTS};
use crate::messages::{
    ControlAnswer, ControlCommand, ControlState, DRIVE_TEXT_BYTES, DriveTextMsg, MAX_JOINTS, RequestMsg,
    Status, answer_flag,
};
use crate::mission::Mission;
use crate::time::MonoNs;
use std::collections::VecDeque;
use tracing::{Span, debug_span, info, warn};

/// Commands that came, and those that wait for their answers.
pub(super) struct Commands {
    server: CommandServer,
    /// Each with its number, the ticks that were noted when it came, and a span from its coming to its answer.
    waiting: VecDeque<(u64, u64, RequestOrigin, Span)>,
    /// What the companion itself asks for.
    own: Option<Request>,
    next: u64,
    standing: ControlAnswer,
    /// The state of the robot that the words in it are about.
    words_of: u32,
    /// Looks for a request that failed.
    failed: u64,
    /// Requests that were answered, of which there are records.
    answered: u64,
    /// Requests of clients that this pass still takes, at first one of each client that there may be: who asks faster than it is answered would keep the thread that carries
    /// measurements, records and the states of a drive, too.
    left: usize,
    /// Time of the last tick, and how many were noted.
    noted: MonoNs,
    ticks: u64,
}

/// Who asked for something.
enum RequestOrigin {
    /// A client, which waits for the answer.
    Client(Asked),
    /// The companion.
    Companion(Request),
}

impl RequestOrigin {
    fn command(&self) -> ControlCommand {
        match self {
            Self::Client(asked) => asked.command(),
            Self::Companion(request) => ControlCommand::of(*request as u32),
        }
    }

    /// Whether control asks itself, which it does to hold an arm whose camera or vision was lost.
    fn is_control(&self) -> bool {
        matches!(self, Self::Companion(_))
    }

    fn answer(self, answer: &ControlAnswer) {
        if let Self::Client(asked) = self {
            asked.answer(answer);
        }
    }
}

/// What a command asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum ParsedCommand {
    /// How things stand.
    State,
    /// Something of the loop.
    Request(Request),
    /// Something that no run can do.
    Nothing(Refusal),
}

impl ParsedCommand {
    fn of(command: &ControlCommand) -> Self {
        match (command.arm, command.camera, command.request) {
            (0, 0, 0) => Self::State,
            (0, 0, code) => {
                Request::from_code(code).map_or(Self::Nothing(Refusal::UnknownRequest), Self::Request)
            }
            (0, ..) => Self::Nothing(Refusal::UnknownCamera),
            _ => Self::Nothing(Refusal::UnknownArm),
        }
    }
}

impl Commands {
    pub(super) fn new(server: CommandServer, served: bool) -> Self {
        let standing =
            ControlAnswer { flags: if served { answer_flag::SERVED } else { 0 }, ..ControlAnswer::default() };
        Self {
            server,
            waiting: VecDeque::new(),
            own: None,
            next: 0,
            standing,
            words_of: 0,
            failed: 0,
            answered: 0,
            left: MAX_CLIENTS,
            noted: MonoNs::ZERO,
            ticks: 0,
        }
    }

    /// Takes in how things stand after a tick.
    pub(super) fn note<const N: usize>(&mut self, trace: &Trace, mission: &Mission<N>) {
        self.note_goal(mission);
        let (standing, js) = (&mut self.standing, &trace.joint_state);
        standing.state = trace.state as u32;
        standing.fault = trace.fault.map_or(0, crate::control::safety::Fault::code);
        standing.tick = js.tick;
        (standing.robot_state, standing.robot_code) = (trace.robot.state as u32, trace.robot.code);
        standing.flags &= !answer_flag::CLEARING;
        standing.flags |= if trace.clears { answer_flag::CLEARING } else { 0 };
        self.noted = trace.time;
        self.ticks += 1;
        let contact = ContactNumbers::of(trace.contact.as_ref());
        standing.contact_joint = contact.joint;
        (standing.contact_torque, standing.contact_force) = (contact.torque, contact.force);
        standing.joints = js.joints.min(MAX_JOINTS as u32);
        (standing.q, standing.qd) = (js.q, js.qd);
        if let Some(status) = &trace.status {
            standing.time_s = status.time_s;
            standing.target = status.target;
            standing.feature_error_px = status.feature_error_px;
            standing.position_error_m = status.position_error_m;
            standing.stability = status.stability;
            standing.orientation_error_rad = status.orientation_error_rad;
        }
    }

    /// Takes in how the goal stands.
    pub(super) fn note_goal<const N: usize>(&mut self, mission: &Mission<N>) {
        let (standing, goal) = (&mut self.standing, mission.goal());
        standing.at_goal_s = mission.at_goal_s();
        if standing.goal_points > 0 && standing.goal == goal.id {
            return;
        }
        if standing.goal_points > 0 {
            // These are of the goal before.
            standing.feature_error_px = f64::NAN;
            (standing.position_error_m, standing.orientation_error_rad) = (f64::NAN, f64::NAN);
        }
        standing.target_number = goal.set_point.target();
        (standing.goal, standing.goal_points) = (goal.id, goal.set_point.points().len() as u64);
        standing.goal_ids.iter_mut().zip(goal.set_point.ids()).for_each(|(place, id)| *place = *id);
        let features = goal.set_point.features().iter().flat_map(|s| [s.x, s.y]);
        standing.goal_features.iter_mut().zip(features).for_each(|(place, x)| *place = x);
    }

    /// Takes in what the drive says of its robot.
    pub(super) fn note_words(&mut self, words: &DriveTextMsg) {
        (self.words_of, self.standing.robot_text) = (words.robot_state, words.text);
    }

    /// How things stand. Words are told as long as the robot is in the state that they are about.
    fn standing(&self) -> ControlAnswer {
        let mut standing = self.standing;
        if self.words_of != 0 && self.words_of != standing.robot_state {
            standing.robot_text = [0; DRIVE_TEXT_BYTES];
        }
        standing
    }

    /// Takes in how camera and vision stand.
    pub(super) fn note_camera(&mut self, status: &Status) {
        let standing = &mut self.standing;
        (standing.camera_state, standing.camera_state_s) = (status.camera_state, status.camera_state_s);
        (standing.camera_restarts, standing.vision_restarts) =
            (status.camera_restarts, status.vision_restarts);
    }

    /// Asks for `hold` itself where the arm moves, or would with the next good measurement.
    pub(super) fn hold(&mut self) {
        use ControlState::{Holding, Returning, Servoing, Waiting};
        let state = ControlState::from_code(self.standing.state);
        if matches!(state, Waiting | Servoing | Holding | Returning) {
            self.own = Some(Request::Hold);
        }
    }

    /// Another pass of the thread that carries messages: it takes so many requests again.
    pub(super) fn begin_pass(&mut self) {
        self.left = MAX_CLIENTS;
    }

    /// The next request for the loop; everything else that has come is answered, as far as a pass goes. A question for the state that carries a goal or a posture asks whether that would
    /// be refused, which `examine` knows.
    pub(super) fn next(
        &mut self,
        examine: impl Fn(&ControlCommand) -> Result<(), Refusal>,
    ) -> Option<ClientRequest> {
        if let Some(request) = self.own.take() {
            let asker = RequestOrigin::Companion(request);
            let command = asker.command();
            return Some(self.wait_for(asker, request, command));
        }
        while self.left > 0 {
            let asked = self.take()?;
            self.left -= 1;
            let command = asked.command();
            let refusal = match ParsedCommand::of(&command) {
                ParsedCommand::State => examine(&command).err().map_or(0, |refusal| refusal as u32),
                ParsedCommand::Nothing(refusal) => refusal as u32,
                ParsedCommand::Request(request) => {
                    return Some(self.wait_for(RequestOrigin::Client(asked), request, command));
                }
            };
            let ControlCommand { request, arm, .. } = command;
            asked.answer(&ControlAnswer { request, arm, refusal, ..self.standing() });
        }
        None
    }

    /// Gives a request its number; it waits for its answer from now on.
    fn wait_for(&mut self, asker: RequestOrigin, request: Request, command: ControlCommand) -> ClientRequest {
        self.next += 1;
        let span = debug_span!("request", request = request.as_str());
        self.waiting.push_back((self.next, self.ticks, asker, span));
        ClientRequest { number: self.next, request, command }
    }

    /// Before the first tick: questions are answered, a stop and a shutdown are taken, everything else is refused.
    pub(super) fn attend(&mut self, stops: &Stops) {
        // What a goal or a posture means is known from the first tick on.
        let examine = |command: &ControlCommand| match command.form {
            0 => Ok(()),
            _ => Err(Refusal::NotReady),
        };
        self.begin_pass();
        while let Some(ClientRequest { number, request, .. }) = self.next(examine) {
            let refusal = stops.early(request).err();
            // Nobody records yet.
            let _ = self.answer(&Answered {
                number,
                refusal,
                state: ControlState::Idle,
                tick: 0,
                stamp: MonoNs::ZERO,
            });
        }
    }

    /// A command that has come. One that cannot be taken is not waited for: a client that asks again before it has heard the
    /// answer, or that has died, has itself to blame, and the arm nothing to do with it.
    fn take(&mut self) -> Option<Asked> {
        match self.server.receive() {
            Ok(asked) => asked,
            Err(error) => {
                self.failed += 1;
                // Each power of two: a client that goes on so would fill the log.
                if self.failed.is_power_of_two() {
                    warn!(count = self.failed, "a request was not taken, the run goes on: {error}");
                }
                None
            }
        }
    }

    /// Number and time of the last tick that was noted.
    pub(super) fn last_tick(&self) -> (u64, MonoNs) {
        (self.standing.tick, self.noted)
    }

    /// Hands an answer of the loop to the client that waits for it. Returns the record of both.
    pub(super) fn answer(&mut self, answered: &Answered) -> Option<RequestMsg> {
        let place = self.waiting.iter().position(|(number, ..)| *number == answered.number);
        let (number, planned, asked, span) = place.and_then(|place| self.waiting.remove(place))?;
        let _span = span.entered();
        let command = asked.command();
        let refusal = answered.refusal.map_or(0, |refusal| refusal as u32);
        // What is accepted is an event, and logged as such.
        if let Some(refusal) = answered.refusal {
            let request = Request::from_code(command.request);
            let word = request.map_or("?", Request::as_str);
            let why = request.map_or(refusal.describe(), |request| refusal.describe_for(request));
            info!(request = word, refusal = refusal as u32, "{word} was refused: {why}");
        }
        // The trace of that tick may come later than the next question.
        self.standing.state = answered.state as u32;
        forget_fault(&mut self.standing);
        let decides = ![Request::Goal, Request::Set].iter().any(|request| command.request == *request as u32);
        if refusal == 0 && decides {
            self.standing.motion_request = number;
            self.standing.flags &= !answer_flag::HELD_BY_CONTROL;
            self.standing.flags |= if asked.is_control() { answer_flag::HELD_BY_CONTROL } else { 0 };
        }
        // A reset that was accepted and is not done waits for the robot.
        let waits =
            command.request == Request::Reset as u32 && refusal == 0 && answered.state == ControlState::Fault;
        self.standing.flags |= if waits { answer_flag::CLEARING } else { 0 };
        asked.answer(&ControlAnswer { request: command.request, refusal, ..self.standing() });
        let record = RequestMsg {
            sequence: self.answered,
            stamp: answered.stamp,
            tick: answered.tick,
            number,
            planned,
            decided: self.ticks,
            refusal,
            state: answered.state as u32,
            goal: self.standing.goal,
            ..RequestMsg::of(&command)
        };
        self.answered += 1;
        Some(record)
    }
}

/// Leaves out the fault of the last trace, and what had touched the arm, where the state is none any more: it was reset.
fn forget_fault(standing: &mut ControlAnswer) {
    if standing.fault != 0 && standing.state != ControlState::Fault as u32 {
        standing.fault = 0;
        let none = ContactNumbers::of(None);
        (standing.contact_joint, standing.contact_torque) = (none.joint, none.torque);
        standing.contact_force = none.force;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ipc::{Instance, Services};
    use std::cell::{Cell, RefCell};

    #[test]
    fn an_answer_has_no_fault_that_was_reset() {
        let fault = |state: ControlState| {
            let mut standing = ControlAnswer { fault: 15, contact_joint: 2, ..ControlAnswer::default() };
            standing.state = state as u32;
            forget_fault(&mut standing);
            (standing.fault, standing.contact_joint)
        };
        assert_eq!(fault(ControlState::Fault), (15, 2));
        assert_eq!(fault(ControlState::Idle), (0, 0));
    }

    #[test]
    fn a_hold_of_control_itself_is_told_until_the_next_request() {
        let instance: Instance = format!("u-own-hold-{}", std::process::id()).parse().unwrap();
        let services = Services::join(&instance).unwrap();
        let mut commands = Commands::new(services.command_server().unwrap(), true);
        let client = services.command_client().unwrap();
        let answered =
            |number, state| Answered { number, refusal: None, state, tick: 1, stamp: MonoNs::ZERO };
        let is_told = |commands: &Commands| commands.standing().flags & answer_flag::HELD_BY_CONTROL != 0;
        commands.standing.state = ControlState::Servoing as u32;
        commands.hold();
        let asked = commands.next(|_| Ok(())).unwrap();
        assert_eq!(asked.request, Request::Hold);
        commands.answer(&answered(asked.number, ControlState::Held)).unwrap();
        assert!(is_told(&commands));
        for (request, stays) in [(Request::Set, true), (Request::Start, false)] {
            let _pending = client.ask(ControlCommand::of(request as u32)).unwrap();
            let asked = commands.next(|_| Ok(())).unwrap();
            commands.answer(&answered(asked.number, ControlState::Held)).unwrap();
            assert_eq!(is_told(&commands), stays, "{request:?}");
        }
        drop((commands, client, services));
        instance.remove_leftovers(None);
    }

    /// Two that ask in turn, each while the other is answered.
    #[test]
    fn who_asks_without_a_pause_ends_the_pass() {
        let instance: Instance = format!("u-flood-{}", std::process::id()).parse().unwrap();
        let services = Services::join(&instance).unwrap();
        let mut commands = Commands::new(services.command_server().unwrap(), false);
        let clients = [services.command_client().unwrap(), services.command_client().unwrap()];
        let question = ControlCommand::of(0);
        let waits = RefCell::new(VecDeque::from([clients[0].ask(question).unwrap()]));
        let asked = Cell::new(1);
        let examine = |_: &ControlCommand| {
            assert!(asked.get() < 1000, "the pass has no end");
            let mut waits = waits.borrow_mut();
            if waits.len() > 1 {
                waits.pop_front(); // answered
            }
            waits.push_back(clients[asked.replace(asked.get() + 1) % 2].ask(question).unwrap());
            Ok(())
        };
        assert!(commands.next(examine).is_none());
        assert_eq!(asked.get(), 1 + MAX_CLIENTS);
        commands.begin_pass();
        assert!(commands.next(examine).is_none());
        assert_eq!(asked.get(), 1 + 2 * MAX_CLIENTS);
        // Nothing is removed while somebody is there.
        drop((waits, clients, commands, services));
        instance.remove_leftovers(None);
    }

    #[test]
    fn what_means_nothing_is_refused() {
        let of = |request, arm, camera| {
            ParsedCommand::of(&ControlCommand { arm, camera, ..ControlCommand::of(request) })
        };
        assert_eq!(of(0, 0, 0), ParsedCommand::State);
        for request in Request::ALL {
            assert_eq!(of(request as u32, 0, 0), ParsedCommand::Request(request));
        }
        for code in [12, 99, u32::MAX] {
            assert_eq!(of(code, 0, 0), ParsedCommand::Nothing(Refusal::UnknownRequest), "{code}");
        }
        for number in [1, 7, u32::MAX] {
            for code in [0, Request::Stop as u32, 99] {
                assert_eq!(
                    of(code, number, 0),
                    ParsedCommand::Nothing(Refusal::UnknownArm),
                    "{code} {number}"
                );
                assert_eq!(of(code, 0, number), ParsedCommand::Nothing(Refusal::UnknownCamera), "{code}");
            }
        }
    }
}
