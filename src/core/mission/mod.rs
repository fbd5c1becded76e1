//! The mission: the task of a run, its next goal, and its end. It reads the [`Trace`] of each tick and sends
//! [`ControlOrder`]s to control, which take effect before the next tick.
//!
//! ```text
//! control: tick k ─► Trace k ─► [`Mission::note`]: counts, teaches, plans, judges ─► Order ─► control: before tick k + 1
//!                                   └► adds to Trace k: feature error, events, status, how the run ended ─► ports, report
//! ```
//! On one thread ([`LockstepRun`]) an order of tick k takes effect at tick k + 1; in real time the mission runs beside the
//! real-time thread, and its order takes effect when the ring was read, mostly one or two ticks later. Nothing that keeps the arm safe
//! depends on the mission: control alone holds, stops and brings the arm to rest.
//!
//! | term | what it is |
//! | --- | --- |
//! | [`Goal`] | the features to be reached, how near, and for how long |
//! | [`RunTask`] | the task of the run: servoing, look-and-move, the excitation motion, a tour of views or of postures |
//! | [`RunPlan`] | the conditions under which the run begins and ends |
//! | end | decided first ([`run_end`]); then the arm is brought to rest, and the last trace contains the outcome |
//! | residual | the remaining error of an arm that has come to rest, or oscillates, away from its goal ([`residual`]) |

mod accuracy;
mod adapt_law;
mod errors;
mod goal_mean;
mod goal_path;
mod goal_watch;
mod lockstep;
mod look_and_move;
pub mod measurement_log;
mod model_error;
mod plan;
pub mod requests;
pub mod residual;
pub mod run_end;
mod second_goal;
mod status;
mod task;
mod teaching;
pub mod truth;

pub use accuracy::{Accuracy, Hindsight, contradicted_text};
pub use errors::{FinalErrors, MeasuredErrors};
pub use goal_path::PathTracking;
pub use lockstep::LockstepRun;
pub use look_and_move::LookAndMove;
pub use measurement_log::{MeasurementLog, VisionCounts};
pub use model_error::{DescriptionError, ModelError, ModelErrorLog};
pub use plan::{Goal, RunPlan, Service};
pub use second_goal::SecondGoal;
pub use task::{BelievedCell, RunTask};

use crate::control::lifecycle::Request;
use crate::control::order::ControlOrder;
use crate::control::outcome::{Finish, Outcome};
use crate::control::safety::{Fault, RestWatch};
use crate::control::trace::{Event, Trace};
use crate::drive::DriveState;
use crate::messages::{ControlState, JointState, Measurement, frame_flag, joint_flag, trace_flag};
use crate::motion::{ActingLimits, Limit, SpaceLimit, Workspace};
use crate::servo::{MeasurementVerdict, SetPoint, View};
use crate::time::MonoNs;
use accuracy::RunViewLog;
use errors::TrueGoal;
use goal_path::TrackingSums;
use goal_watch::GoalWatch;
use nalgebra::SVector;
use requests::MissionChange;
use residual::{
    AMBIGUOUS_VIEW, AT_ITS_END, BELOW_SCATTER, OUT_OF_REACH, ResidualWatch, TILT, TOO_FEW_FEATURES, TOO_WEAK,
    is_another_pose, is_at_its_end, leaves_pose_open, why_it_stays,
};
use run_end::{HELD_OFF, LAST_FRAME, LATELY, MOTION_OVER, NO_MORE_FRAMES, RunEnd};
use std::collections::VecDeque;
use teaching::GoalTeacher;
use truth::{Truth, true_goal};

/// Ticks between two status records. Chosen by hand: 50 Hz is more than a person follows and 5 % of the ticks.
const STATUS_PERIOD: u64 = 20;
/// The points that a law compares are where they should be when their error is this share of that of all. Chosen by hand: well above the noise of
/// single points, and well below what is left where nothing is met.
const MET_SHARE: f64 = 0.1;
/// Orders that can wait: a tour of 14 postures and the orders beside it, so that the queue never grows during a run.
const ORDERS: usize = 32;
/// The mission of one run.
pub struct Mission<const N: usize> {
    plan: RunPlan,
    task: RunTask<N>,
    goal: Goal,
    /// That of a second camera that controls the arm, too.
    second: Option<Box<SecondGoal<N>>>,
    /// The last goal of each target, by the targets' numbers.
    goals: Vec<SetPoint>,
    truth: Option<Truth<N>>,
    true_goal: Option<TrueGoal>,
    measurements: MeasurementLog,
    teacher: Option<GoalTeacher>,
    /// The first exposure that is taught from: the arm must stand.
    teaches_from: Option<MonoNs>,
    /// What changes here when control accepts the request of this number.
    pending: VecDeque<(u64, MissionChange)>,
    /// The cell in which requests of clients are planned.
    cell: Option<BelievedCell<N>>,
    /// Limits in space, and when one last held the arm off a place.
    space: Option<Workspace<N>>,
    held_off: Option<MonoNs>,
    first: Option<MonoNs>,
    last: MonoNs,
    joint_state: JointState,
    state: ControlState,
    goal_watch: GoalWatch,
    /// When the goal began to move on its path.
    path_began: Option<MonoNs>,
    tracking: TrackingSums,
    rest: RestWatch<N>,
    residual: ResidualWatch,
    /// Whether the gain of control is reduced.
    is_reduced: bool,
    /// Whether the law was asked to go another way to this goal.
    way_asked: bool,
    last_frame_seen: bool,
    end: RunEnd,
    /// Whether control was given the order.
    end_sent: bool,
    errors_at_end: Option<FinalErrors>,
    /// Views of the target, where they tell how near the run has come.
    views: Option<RunViewLog<N>>,
    /// The posture in which the end was decided.
    q_at_end: Option<SVector<f64, N>>,
    finish: Option<Finish>,
    statuses: u64,
    /// Whether the arm looks around for its target.
    searches: bool,
    /// Limits that acted since the last status.
    acted: ActingLimits,
    orders: VecDeque<ControlOrder<N>>,
}

impl<const N: usize> Mission<N> {
    /// A mission whose first orders wait to be taken; `truth` is that of a simulated cell.
    #[must_use]
    pub fn new(plan: RunPlan, task: RunTask<N>, goal: Goal, truth: Option<Truth<N>>) -> Self {
        let mut orders = VecDeque::with_capacity(ORDERS);
        let teaches = plan.service == Service::OneShot { teaches: true };
        let teacher = teaches.then(|| GoalTeacher::new(plan.teaching_measurements));
        if plan.service != Service::Served {
            let first = if teaches { Request::Teach } else { Request::Start };
            orders.push_back(ControlOrder::Request(first));
        }
        Self {
            plan,
            task,
            goals: vec![goal.set_point.clone()],
            true_goal: true_goal(truth.as_ref(), &goal.set_point),
            goal,
            second: None,
            truth,
            measurements: MeasurementLog::new(),
            teacher,
            teaches_from: Some(MonoNs(i64::MIN)),
            pending: VecDeque::new(),
            cell: None,
            space: None,
            held_off: None,
            first: None,
            last: MonoNs::ZERO,
            joint_state: JointState::default(),
            state: ControlState::Waiting,
            goal_watch: GoalWatch::default(),
            path_began: None,
            tracking: TrackingSums::default(),
            rest: RestWatch::default(),
            residual: ResidualWatch::default(),
            is_reduced: false,
            way_asked: false,
            last_frame_seen: false,
            end: RunEnd::default(),
            end_sent: false,
            errors_at_end: None,
            views: None,
            q_at_end: None,
            finish: None,
            statuses: 0,
            searches: false,
            acted: ActingLimits::default(),
            orders,
        }
    }

    /// Takes in the trace of a tick, with its measurement, and adds the feature error, events, status and end. A trace that is lost
    /// is missing in the counts; nothing else depends on it.
    pub fn note(&mut self, trace: &mut Trace, measurement: Option<&Measurement>) {
        let (now, js) = (trace.time, trace.joint_state);
        self.first.get_or_insert(now);
        (self.last, self.joint_state, self.state) = (now, js, trace.state);
        self.rest.note(&DriveState { q: vector(&js.q), qd: vector(&js.qd), truth: None });
        self.acted = self.acted.with(&trace.limits);
        if trace.held_by.is_some_and(SpaceLimit::is_of_places) {
            self.held_off = Some(now);
        }
        let slows = trace.held_by.is_some_and(|limit| !limit.is_of_places());
        self.residual.note_speed(slows || trace.limits.joints(Limit::Velocity) != 0);
        if let Some(views) = &mut self.views {
            views.note_arm(js.stamp, &vector(&js.q), &vector(&js.qd));
        }
        self.hear(trace);
        if self.teacher.is_some() && self.teaches_from.is_none() && self.rest.is_at_rest() {
            self.teaches_from = Some(now);
        }
        self.move_goal(trace);
        if let RunTask::LookAndMove(task) = &mut self.task {
            task.note_arm(now, self.state, self.rest.is_at_rest());
        }
        self.task.note_rest(&vector(&js.q), self.rest.is_at_rest());
        if let (Some(m), Some(verdict)) = (measurement, trace.measurement_record.map(|record| record.verdict))
            && !self.count_second(trace, m, verdict)
        {
            self.learn(m, verdict);
            self.count(trace, m, verdict);
            self.task.note(m, &vector(&js.q));
            self.look(m, verdict, trace.measurement_record.map(|record| record.error_px));
        }
        self.orders.extend(self.task.next_orders());
        if self.plan.service != Service::Served
            && let Some(fault) = trace.fault
        {
            self.end.decide(Finish::fault(fault));
        }
        let tells = js.tick.is_multiple_of(STATUS_PERIOD);
        if tells {
            self.note_arm_at_goals(now);
            self.adapt_law(&trace.limits);
        }
        self.judge(trace);
        if tells || trace.over {
            trace.status = Some(self.status(trace));
            self.statuses += 1;
            self.acted = ActingLimits::default();
        }
    }

    /// The next order to control.
    pub fn next_order(&mut self) -> Option<ControlOrder<N>> {
        self.orders.pop_front()
    }

    /// Takes in the requests of clients that took effect, and the events of control.
    fn hear(&mut self, trace: &Trace) {
        if let Some(reason) = trace.stopped {
            self.end.decide(Finish { outcome: Outcome::Stopped, reason });
        }
        self.searches &= trace.state == ControlState::Returning;
        for event in trace.events.iter() {
            match event {
                Event::Searching => self.searches = true,
                Event::Returning => self.searches = false,
                Event::Requested(Request::Start) => {
                    self.views.iter_mut().for_each(RunViewLog::begin_anew);
                    self.watch_goals_anew();
                    (self.is_reduced, self.way_asked) = (false, false);
                    // What an earlier start came to says nothing about this one.
                    self.residual.begin_anew();
                }
                Event::Requested(Request::Reset) => self.is_reduced = false,
                Event::Requested(Request::Teach) => {
                    self.teacher = Some(GoalTeacher::new(self.plan.teaching_measurements));
                    // An arm that was moving comes to rest first.
                    self.teaches_from = self.rest.is_at_rest().then_some(MonoNs(i64::MIN));
                }
                Event::GainReduced => {
                    // One that was asked for again before the answer came has been met.
                    self.orders.retain(|order| *order != ControlOrder::ReduceGain);
                    self.is_reduced = true;
                    self.residual.begin_anew();
                }
                Event::AnotherWay => self.residual.begin_anew(),
                // The fault that came first is the reason, this one its consequence.
                Event::Fault(Fault::NotAtRest) => self.end.decide(Finish::fault(Fault::NotAtRest)),
                Event::Fault(Fault::RestUnknown) => {
                    self.end.decide(Finish::fault(trace.fault.unwrap_or(Fault::RestUnknown)));
                }
                Event::Holding | Event::MotionOver => {
                    self.task.hear(event).into_iter().for_each(|finish| self.end.decide(finish));
                }
                _ => {}
            }
        }
    }

    fn count(&mut self, trace: &mut Trace, m: &Measurement, verdict: Option<MeasurementVerdict>) {
        self.last_frame_seen |= m.flags & frame_flag::LAST != 0;
        let then = self.set_point_at(m.exposure);
        let set_point = then.as_ref().unwrap_or(&self.goal.set_point);
        // What the law refused says nothing about the goal: it is old, or of another target. Nor does braking at the end.
        let has_ended = self.end.decided().is_some();
        let is_of_goal =
            !matches!(verdict, Some(MeasurementVerdict::TooFewFeatures | MeasurementVerdict::ImpossiblePose));
        let judged = is_of_goal && !has_ended;
        let view = View::of(m, set_point).filter(|_| judged);
        let error_px = view.map_or(f64::NAN, |view| set_point.error_rms_px(&view, &self.plan.f_px));
        self.measurements.note(m, verdict, error_px, &mut trace.events);
        if let Some(views) = self.views.as_mut().filter(|_| view.is_some()) {
            views.note(m);
        }
        if let Some(record) = &mut trace.measurement_record {
            record.error_px = error_px;
            if verdict.is_some_and(MeasurementVerdict::is_used) {
                self.measurements.note_degraded(record.degraded, &mut trace.events);
            }
            self.measurements.commanded(record.latency);
        }
        if verdict.is_some_and(MeasurementVerdict::is_refused) {
            return;
        }
        self.residual.note_error(trace.time, error_px, crate::servo::stated_px2(m).sqrt());
        self.note_tracking(m.exposure, error_px);
        let arrived = self.has_arrived(m.exposure);
        self.watch_goal(trace.time, m, error_px, arrived);
    }

    /// The next look of a look-and-move, until the end is decided.
    fn look(&mut self, m: &Measurement, verdict: Option<MeasurementVerdict>, error_px: Option<f64>) {
        let RunTask::LookAndMove(task) = &mut self.task else { return };
        if self.end.decided().is_none() && verdict.is_some_and(MeasurementVerdict::is_used) {
            task.look(m, error_px.unwrap_or(f64::NAN), &vector(&self.joint_state.q), &self.goal);
        }
    }

    /// Decides on the end, and reports it once the arm is at rest.
    fn judge(&mut self, trace: &mut Trace) {
        if self.end.decided().is_none()
            && let Some(finish) = self.reached(trace)
        {
            self.end.decide(finish);
        }
        let Some(finish) = self.end.decided() else { return };
        if self.errors_at_end.is_none() {
            self.errors_at_end = Some(self.errors());
            self.keep_second_errors();
            self.q_at_end = Some(vector(&self.joint_state.q));
        }
        if !std::mem::replace(&mut self.end_sent, true) {
            self.orders.push_back(ControlOrder::End);
        }
        if trace.over {
            self.state = match finish.outcome {
                Outcome::Converged => ControlState::Converged,
                Outcome::Fault => ControlState::Fault,
                Outcome::NotConverged | Outcome::Finished | Outcome::Stopped => ControlState::Stopped,
            };
            (self.finish, trace.finish, trace.state) = (Some(finish), Some(finish), self.state);
        }
    }

    /// The end by goal, time or last frame, if it is reached at this tick.
    fn reached(&mut self, trace: &mut Trace) -> Option<Finish> {
        let (now, servoing) = (trace.time, self.state == ControlState::Servoing);
        let has_goal = self.plan.closed_loop && matches!(self.task, RunTask::Servo | RunTask::LookAndMove(_));
        let held = self.held(now).filter(|_| servoing && has_goal);
        if self.plan.service == Service::Served {
            let away = self.second_is_away(now);
            self.goal_watch
                .change(servoing && !away, held.is_some())
                .into_iter()
                .for_each(|event| trace.events.push(event));
            return None;
        }
        if let Some(finish) = self.task.refused() {
            return Some(finish);
        }
        if held.is_some() {
            return held;
        }
        if trace.inputs & trace_flag::MOTION_OVER != 0 {
            return Some(MOTION_OVER);
        }
        if self.last_frame_seen {
            return Some(if self.plan.closed_loop { NO_MORE_FRAMES } else { LAST_FRAME });
        }
        let time = now - self.first.unwrap_or(now);
        let time_is_up = self.plan.duration.is_some_and(|duration| time >= duration);
        let goal_px = self.goal.tolerance_px;
        let seen = self.measurements.last_found();
        let met_px = (MET_SHARE * self.measurements.error_px()).max(goal_px);
        let (law, set_point) = (&self.plan.law, &self.goal.set_point);
        let joints = self.cell.as_ref().map_or(N, |cell| cell.mount.moving_joints(N));
        let no_nearer = || self.residual.why_no_nearer(goal_px, self.plan.follows, (law, joints));
        let why = |px| match seen.filter(|m| is_another_pose(set_point, m, &self.plan.f_px, met_px)) {
            Some(_) if !self.residual.scatters() => AMBIGUOUS_VIEW,
            _ => match why_it_stays(law, set_point, seen, (px, N)) {
                // noise of the tilt is what moves it aside
                why if self.residual.scatters() && why != TILT => BELOW_SCATTER,
                // what is seen has no explanation of its own
                OUT_OF_REACH | TOO_WEAK if is_at_its_end(&trace.limits) => AT_ITS_END,
                OUT_OF_REACH | TOO_WEAK if leaves_pose_open(law, set_point, joints) => TOO_FEW_FEATURES,
                why => why,
            },
        };
        let stays = || self.residual.constant_px(goal_px).map(why).or_else(no_nearer);
        let in_view = self.measurements.last().is_some_and(Measurement::found);
        let last = self.measurements.last().map(|m| (now - m.exposure, m.target_status()));
        let held_off = self.held_off.filter(|at| now - *at < LATELY).map(|_| HELD_OFF);
        let known = held_off.or_else(|| self.why_not_both(now, trace));
        let when_late = known
            .or_else(|| self.task.when_late(last, self.plan.measurement_timeout))
            .or_else(|| stays().filter(|_| servoing && has_goal));
        let are_old = self.measurements.are_older_than(self.plan.measurement_timeout);
        let is_held = matches!(self.state, ControlState::Holding | ControlState::Returning);
        let when_late =
            when_late.or_else(|| (is_held && in_view && are_old).then_some(run_end::OLD_EXPOSURES));
        let measured = (&self.measurements, self.point_kind());
        time_is_up.then(|| run_end::time_is_up(self.plan.closed_loop, self.state, when_late, measured))
    }

    /// Tells the status of what is known of the law's stability: [`Status::stability`](crate::messages::Status::stability).
    pub fn set_stability(&mut self, slowest: f64) {
        self.plan.stability = slowest;
    }

    /// The true joint positions of the simulated arm.
    fn q_true(&self) -> Option<SVector<f64, N>> {
        let js = &self.joint_state;
        (js.flags & joint_flag::TRUTH != 0).then(|| vector(&js.q_true))
    }
}

fn vector<const N: usize>(numbers: &[f64]) -> SVector<f64, N> {
    SVector::from_fn(|i, _| numbers.get(i).copied().unwrap_or_default())
}
