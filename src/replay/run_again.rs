//! Control and mission on what was recorded.
//!
//! ```text
//! tick k: orders, requests, stops, faults ─► sense ─► act ─► Trace k ─► Mission ─► orders, each at the tick at which it was obeyed
//! ```
//! Requests are planned, and their answers heard, when the mission knew as many ticks as the record of the request says.

use super::recorded_arm::{RecordedArm, reported_fault};
use super::recorded_run::{RecordedRun, RecordedTick};
use super::{Difference, ReplayError, difference};
use crate::config::assemble::control_loop_with;
use crate::config::{Clock, Config};
use crate::control::control_loop::ControlLoop;
use crate::control::lifecycle::{Refusal, Request};
use crate::control::order::ControlOrder;
use crate::control::safety::Fault;
use crate::control::trace::Trace;
use crate::messages::{
    COMMAND_VALUES, ControlCommand, MAX_FEATURES, MAX_JOINTS, Measurement, MessageRecord, RequestMsg,
    TraceMsg, trace_flag,
};
use crate::mission::{LockstepRun, Mission};
use crate::report::statistics::RunStatistics;
use crate::robot::Robot;
use crate::sim::preflight::Preflight;
use crate::time::MonoNs;
use std::collections::{BTreeMap, VecDeque};
use std::io::Read;

/// Ticks after which an order is obeyed for which the recorded run has none. Chosen by hand: in real time orders come one or two ticks late, and some
/// more on a loaded machine.
const ORDER_PATIENCE: u64 = 20;
/// The reason of an end that was asked for; records do not carry it.
const END_ASKED: &str = "the end was asked for when it was recorded";

/// What is wanted of a replay.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum How {
    /// The same bits; it ends at the first that differs.
    Exactly,
    /// Other settings: it goes on to the end, and tells how far commands are from the recorded ones.
    WithOtherSettings,
}

/// The largest deviation of a command.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CommandDeviation {
    /// Field of the trace.
    pub field: &'static str,
    /// The first tick at which it is another one.
    pub first_tick: u64,
    /// Where it deviates most.
    pub tick: u64,
    /// Which joint, from 1.
    pub joint: usize,
    /// What it was there.
    pub recorded: f64,
    /// What it would have been.
    pub replayed: f64,
}

/// What came of a replay.
#[derive(Debug, Clone, PartialEq)]
pub struct Replayed {
    /// Ticks that were compared.
    pub ticks: u64,
    /// Hash over the joint states, as in the summary of a run in lockstep.
    pub state_hash: String,
    /// Where it is not what was recorded.
    pub difference: Option<Difference>,
    /// Where commands deviate, with other settings.
    pub deviations: Vec<CommandDeviation>,
    /// What is missing in the recording, so that it could be followed no further.
    pub gap: Option<String>,
    /// Where the recording ends before its run.
    pub cut_off: Option<String>,
    /// How the run ended: code of a [`crate::control::outcome::Outcome`], recorded and replayed; 0 where it did not.
    pub outcomes: [u32; 2],
}

/// Runs control on a recording of a run of `config`.
///
/// # Errors
/// When the recording cannot be read, or the configuration does not make a working whole.
pub fn replay<R: Read>(run: &mut RecordedRun<R>, config: &Config, how: How) -> Result<Replayed, ReplayError> {
    crate::dispatch_robot!(config.robot, |robot| replay_robot(run, config, robot, how))?
}

fn replay_robot<R: Read, const N: usize>(
    run: &mut RecordedRun<R>,
    config: &Config,
    robot: Robot<N>,
    how: How,
) -> Result<Replayed, ReplayError> {
    let config = run.config_before_drive(config, &robot);
    ControlAgain::new(&config, robot, how)?.run(run, &mut |_, _| ())
}

pub(super) fn differs<T: MessageRecord>(
    topic: &str,
    number: u64,
    stamp: MonoNs,
    recorded: &T,
    replayed: &T,
) -> Option<Difference> {
    let (field, recorded, replayed) = difference(recorded, replayed)?;
    Some(Difference { topic: topic.into(), number, stamp, field, recorded, replayed })
}

/// Control and mission, with what waits for its tick.
pub struct ControlAgain<const N: usize> {
    /// Control.
    pub control: ControlLoop<N>,
    /// The mission.
    pub mission: Mission<N>,
    /// What was counted.
    pub statistics: RunStatistics,
    arm: RecordedArm<N>,
    clock: Clock,
    how: How,
    /// Ticks that the mission has seen.
    noted: u64,
    /// Orders that were given out, each with `noted` then.
    given: VecDeque<(u64, ControlOrder<N>)>,
    /// Requests that are not planned yet, by their numbers.
    asked: BTreeMap<u64, RequestMsg>,
    /// Requests that are planned, with what they carry.
    planned: VecDeque<(RequestMsg, Option<ControlOrder<N>>)>,
    /// Those whose answer the mission has not heard.
    answered: VecDeque<(RequestMsg, bool)>,
    /// The first answer that is not the recorded one.
    wrong_answer: Option<Difference>,
}

impl<const N: usize> ControlAgain<N> {
    /// Before the first tick of a run of `config`.
    ///
    /// # Errors
    /// When the configuration does not make a working whole.
    pub fn new(config: &Config, robot: Robot<N>, how: How) -> Result<Self, ReplayError> {
        let arm = RecordedArm::new();
        let LockstepRun { control, mut mission } = control_loop_with(config, robot, Box::new(arm.clone()))?;
        if let Some(stability) = Preflight::of(config).ok().and_then(|preflight| preflight.stability) {
            mission.set_stability(stability.slowest());
        }
        Ok(Self {
            control,
            mission,
            statistics: RunStatistics::new(config.robot.joint_names()),
            arm,
            clock: config.clock,
            how,
            noted: 0,
            given: VecDeque::new(),
            asked: BTreeMap::new(),
            planned: VecDeque::new(),
            answered: VecDeque::new(),
            wrong_answer: None,
        })
    }

    /// Runs through a recording; `note` hears of each tick and its measurement.
    ///
    /// # Errors
    /// When the recording cannot be read.
    pub fn run<R: Read>(
        &mut self,
        run: &mut RecordedRun<R>,
        note: &mut dyn FnMut(&Trace, Option<&Measurement>),
    ) -> Result<Replayed, ReplayError> {
        let mut deviations = Deviations::default();
        let mut outcomes = [0; 2];
        let mut found = None;
        while let Some(RecordedTick { trace: then, measurement }) = run.next_tick()? {
            self.asked.extend(run.requests().map(|request| (request.number, request)));
            let trace = self.tick(&then, measurement.as_ref());
            self.statistics.note(&trace);
            note(&trace, measurement.as_ref());
            let now = trace.record();
            outcomes = [then.outcome, now.outcome];
            match self.how {
                How::Exactly => {
                    let answer = self.wrong_answer.take();
                    found = answer.or_else(|| differs("/control/trace", then.tick, then.stamp, &then, &now));
                }
                How::WithOtherSettings => deviations.note(&then, &now),
            }
            if found.is_some() || trace.over {
                break;
            }
        }
        Ok(Replayed {
            ticks: self.control.ticks(),
            state_hash: self.statistics.state_hash(),
            difference: found,
            deviations: deviations.0.into_iter().flatten().collect(),
            gap: run.gap().map(str::to_owned),
            cut_off: run.cut_off().map(str::to_owned),
            outcomes,
        })
    }

    fn tick(&mut self, then: &TraceMsg, measurement: Option<&Measurement>) -> Trace {
        let (tick, time) = (then.tick, then.stamp);
        self.arm.set(then);
        if self.clock == Clock::Lockstep {
            self.obey(then);
            self.control.sense(tick, time);
        }
        let fault = reported_fault(then);
        if let Some(fault @ (Fault::DeadlinesMissed | Fault::CompanionSilent | Fault::StopLatched)) = fault {
            self.control.fail(fault);
        }
        if then.flags & trace_flag::END_ASKED != 0 {
            self.control.stop(END_ASKED);
        }
        for (flag, request) in
            [(trace_flag::STOP_ASKED, Request::Stop), (trace_flag::SHUTDOWN_ASKED, Request::Shutdown)]
        {
            if then.flags & flag != 0 {
                let _ = self.control.halt(request); // refused where it was then
            }
        }
        while let Some(request) = self.next_of(then) {
            self.obey_before(request.planned, then);
            self.request(&request);
        }
        if self.clock == Clock::Realtime {
            self.obey(then);
            self.control.sense(tick, time);
        }
        if fault == Some(Fault::PeersSilent) {
            self.control.fail(Fault::PeersSilent);
        }
        let mut trace = self.control.act(time, measurement);
        self.control.commanded(then.commanded, &mut trace);
        trace.lost = then.lost;
        trace.gives_orders = then.flags & trace_flag::ORDERS_GIVEN != 0;
        while let Some(number) = self.first_to_plan() {
            self.plan(number);
        }
        self.mission.note(&mut trace, measurement);
        self.noted += 1;
        while self.answered.front().is_some_and(|(request, _)| request.decided <= self.noted) {
            self.hear();
        }
        if trace.gives_orders {
            let noted = self.noted;
            self.given.extend(std::iter::from_fn(|| self.mission.next_order()).map(|order| (noted, order)));
        }
        trace
    }

    /// The next request that took effect at this tick, planned.
    fn next_of(&mut self, then: &TraceMsg) -> Option<RequestMsg> {
        while self.planned.is_empty() {
            // A refusal of the mission leaves nothing for control.
            let number = self.first_to_plan().filter(|number| self.asked[number].tick == then.tick)?;
            self.plan(number);
        }
        self.planned.front().map(|(request, _)| *request).filter(|request| request.tick == then.tick)
    }

    /// The next request that the mission plans before it sees more.
    fn first_to_plan(&self) -> Option<u64> {
        let (number, request) = self.asked.first_key_value()?;
        (request.planned <= self.noted).then_some(*number)
    }

    fn plan(&mut self, number: u64) {
        let Some(asked) = self.asked.remove(&number) else { return };
        let request = Request::from_code(asked.request).unwrap_or(Request::Stop);
        match self.mission.plan(number, request, &command(&asked)) {
            Ok(order) => self.planned.push_back((asked, order)),
            Err(refusal) => {
                self.mission.decided(number, false);
                self.compare(&asked, Some(refusal), self.mission.state() as u32);
            }
        }
    }

    fn request(&mut self, asked: &RequestMsg) {
        let Some((_, order)) = self.planned.pop_front() else { return };
        let request = Request::from_code(asked.request).unwrap_or(Request::Stop);
        let refusal = self.control.request_with(request, order.as_ref()).err();
        let state = self.control.controller().state().told() as u32;
        self.compare(asked, refusal, state);
        self.answered.push_back((*asked, refusal.is_none()));
        // Mostly the mission hears it before it sees the tick.
        while self.answered.front().is_some_and(|(request, _)| request.decided <= self.noted) {
            self.hear();
        }
    }

    fn hear(&mut self) {
        if let Some((request, accepted)) = self.answered.pop_front() {
            self.mission.decided(request.number, accepted);
        }
    }

    fn compare(&mut self, asked: &RequestMsg, refusal: Option<Refusal>, state: u32) {
        let now = RequestMsg { refusal: refusal.map_or(0, |refusal| refusal as u32), state, ..*asked };
        if self.wrong_answer.is_none() {
            self.wrong_answer = differs("/control/request", asked.tick, asked.stamp, asked, &now);
        }
    }

    /// Obeys what was obeyed by this tick.
    fn obey(&mut self, then: &TraceMsg) {
        self.obey_before(u64::MAX, then);
    }

    /// The same of what the mission gave out when it knew no more than so many ticks.
    fn obey_before(&mut self, noted: u64, then: &TraceMsg) {
        while let Some((at, order)) = self.given.front().filter(|(at, _)| *at <= noted) {
            let was_obeyed = self.control.orders() < then.orders;
            let is_another = self.how == How::WithOtherSettings && self.noted > at + ORDER_PATIENCE;
            if !was_obeyed && !is_another {
                break;
            }
            self.control.obey(order);
            self.given.pop_front();
        }
    }
}

/// What a client asked for.
fn command(asked: &RequestMsg) -> ControlCommand {
    let RequestMsg { request, arm, camera, form, count, target, ids, values, .. } = *asked;
    let ids: [u32; MAX_FEATURES] = ids;
    let values: [f64; COMMAND_VALUES] = values;
    ControlCommand { request, arm, camera, form, count, target, ids, values }
}

/// Largest deviations of what is commanded.
#[derive(Default)]
struct Deviations([Option<CommandDeviation>; 3]);

impl Deviations {
    fn note(&mut self, then: &TraceMsg, now: &TraceMsg) {
        let fields: [(&'static str, &[f64; MAX_JOINTS], &[f64; MAX_JOINTS]); 3] =
            [("q_r", &then.q_r, &now.q_r), ("qd_r", &then.qd_r, &now.qd_r), ("tau", &then.tau, &now.tau)];
        for (largest, (field, then_values, now_values)) in self.0.iter_mut().zip(fields) {
            for (i, (&recorded, &replayed)) in then_values.iter().zip(now_values).enumerate() {
                if recorded.to_bits() == replayed.to_bits() {
                    continue;
                }
                let first_tick = largest.map_or(then.tick, |d| d.first_tick);
                let by = |d: &CommandDeviation| (d.replayed - d.recorded).abs();
                if largest.as_ref().is_none_or(|d| (replayed - recorded).abs() > by(d)) {
                    let (tick, joint) = (then.tick, i + 1);
                    *largest = Some(CommandDeviation { field, first_tick, tick, joint, recorded, replayed });
                }
            }
        }
    }
}
