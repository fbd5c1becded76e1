//! The servo controller: accepts measurements with any latency and order, and computes a law output at every tick.
//!
//! Data flow: [`VisualServo::note_arm`] (joint history) and [`VisualServo::take`] (measurement to checked view), then
//! [`VisualServo::law_output`]: the view, predicted to now, gives a task, and task and arm a law output. Time is that of the exposure stamp
//! alone. Under `predict` the camera's motion since then follows from the joint history, so that the view of an object at rest is exact for any
//! latency; the motion of a moving object is estimated, where [`ServoSettings::object`] asks for it.

mod covariance;
mod estimated;
mod feed_forward;
mod frozen_image;
mod hidden_features;
mod law_answer;
mod look_around;
mod mount_watch;
mod pace;
mod target_change;

use super::first_motion::FirstMotion;
use super::jacobian_learner::JacobianLearner;
use super::motion_agreement::MotionAgreement;
use super::unobserved_motion::{LONGEST_SPAN, unobserved_motion};
use super::{
    Arm, Convergence, DepthRow, LawOutput, MeasurementVerdict, MovingGoal, ObjectMotion, ServoSettings,
    SetPoint, Task, TwistTask, UnobservedMotion, UpdatePolicy, View, joint_velocity,
};
use crate::geometry::Pose;
use crate::messages::{Measurement, TargetStatus};
use crate::robot::{CameraJacobian, JointHistory, Robot};
use crate::time::{MonoNs, SpanNs};
pub(crate) use covariance::stated_px2;
use covariance::{covariance_in, stated_covariance};
use nalgebra::{Matrix6, SVector, Vector6};
pub use target_change::MAX_TARGETS;
use target_change::{MISSES, SeenWhole, centre};

/// How far an exposure stamp may lie in the future, since some drivers stamp the planned end of a frame: a period of 20 Hz. Half and twice of it
/// change no unit test.
const LONGEST_FUTURE: SpanNs = SpanNs(50_000_000);

/// The share of its gains above which a swinging arm is slowed down once more. Shares are halved, so that a half and a quarter
/// are possible, and any number between these means the same: twice. That twice is enough is chosen by hand.
const MIN_SHARE: f64 = 0.3;
/// Gain of the return to the last complete view, 1/s, and the distance from it that counts as arrived, rad or m. Chosen by hand.
const RETURN_RATE_1_S: f64 = 2.0;
const RETURNED: f64 = 1e-3;
/// The last measurement that was used.
#[derive(Debug, Clone, Copy)]
struct LastMeasurement {
    exposure: MonoNs,
    view: View,
    task: Task,
    /// Pose of the camera at the exposure, in the frame W in which the object rests.
    X_WC: Pose,
    /// The same at the first exposure that showed the features exactly there.
    first_X_WC: Pose,
    /// Whether features were hidden.
    partial: bool,
    /// Whether features of it were predicted by the arm's motion, not measured.
    supposed: bool,
}

/// A law output, and how it leads to the goal.
#[derive(Debug, Clone, Copy)]
struct LawAnswer<const N: usize> {
    law_output: LawOutput<N>,
    convergence: Convergence<N>,
}

/// Set-point and share of the gain at one tick.
#[derive(Debug, Clone, Copy)]
struct ServoGoal<'a> {
    goal: &'a SetPoint,
    /// How the goal moves, where the arm is moved along with it.
    motion: Option<MovingGoal>,
    /// Share of each gain that resolved velocities have.
    gain_share: f64,
    /// What the points scatter by, normalized ([`pace::noise_of`]).
    noise: f64,
}

/// Visual servoing of an arm with `N` joints.
#[derive(Debug, Clone)]
pub struct VisualServo<const N: usize> {
    settings: ServoSettings,
    goal: SetPoint,
    history: JointHistory<N>,
    last: Option<LastMeasurement>,
    /// The last complete measurement: without hidden features, and with a pose.
    whole: Option<LastMeasurement>,
    /// The depths that the first measurement with a pose gave; kept over goals, stops and losses of the target.
    initial: Option<DepthRow>,
    /// The arm's postures at the exposures of complete measurements of each target, by the targets' numbers.
    q_whole: [Option<SeenWhole<N>>; MAX_TARGETS],
    /// Of a goal of another target than the one before, until a measurement of it is used: how many showed none.
    sought: Option<u32>,
    held: Option<LawAnswer<N>>,
    fresh: bool,
    /// First requested velocity, and when: a smooth start subtracts its fading part.
    start: Option<(MonoNs, SVector<f64, N>)>,
    object: Option<ObjectMotion>,
    /// Whether the goal moves on its path: until another one is set.
    follows_path: bool,
    /// When the path of the goal began.
    path_began: Option<MonoNs>,
    /// Joint motion that the last measurement showed beyond the history.
    drift: Option<UnobservedMotion<N>>,
    /// Whether the image moves as the arm's motion should make it.
    agreement: MotionAgreement,
    first_motion: FirstMotion,
    /// Share of each gain that resolved velocities have; less for an arm that swings about its goal.
    gain_share: f64,
    /// What the points of the last measurement that was used scatter by, normalized.
    noise: f64,
    /// The image Jacobian that is learnt, where the law goes by none that is computed.
    learner: Option<Box<JacobianLearner<N>>>,
}

impl<const N: usize> VisualServo<N> {
    /// Servoing to `goal` as `settings` say.
    #[must_use]
    pub fn new(settings: ServoSettings, goal: SetPoint) -> Self {
        let object = settings.object.map(ObjectMotion::new);
        let points = goal.points().len();
        let learner = settings.estimation.map(|of| Box::new(JacobianLearner::new(of, points)));
        let agreement = MotionAgreement::new(!settings.law.is_torque());
        Self {
            settings,
            goal,
            history: JointHistory::new(),
            last: None,
            whole: None,
            initial: None,
            q_whole: [None; MAX_TARGETS],
            sought: None,
            held: None,
            fresh: false,
            start: None,
            object,
            follows_path: true,
            path_began: None,
            drift: None,
            agreement,
            first_motion: FirstMotion::default(),
            gain_share: 1.0,
            noise: 0.0,
            learner,
        }
    }

    /// The goal.
    #[must_use]
    pub fn set_point(&self) -> &SetPoint {
        &self.goal
    }

    /// The settings.
    #[must_use]
    pub fn settings(&self) -> &ServoSettings {
        &self.settings
    }

    /// Changes the set-point to `goal`, which stays where it is; measurements that were already taken are used for it too, unless it is of another target.
    pub fn set_goal(&mut self, goal: SetPoint) {
        if goal.target() != self.goal.target() {
            self.forget_target();
        }
        (self.follows_path, self.path_began) = (false, None);
        if let Some(learner) = &mut self.learner {
            learner.begin_anew(goal.ids() != self.goal.ids());
        }
        self.goal = goal;
        self.held = None;
        self.last = self.last.and_then(|last| {
            let task = self.settings.law.task(&self.goal, &last.view).ok()?;
            Some(LastMeasurement { task, ..last })
        });
    }

    /// Whether the law uses a view in which features are hidden.
    #[must_use]
    pub fn is_degraded(&self) -> bool {
        self.last.as_ref().is_some_and(|last| last.partial)
    }

    /// Halves the gain of resolved velocities from now on, so that an arm that differs from its model oscillates less. Returns whether it was
    /// reduced; the feed-forward for a moving object is not, and laws that output torques have no such gain.
    pub fn reduce_gain(&mut self) -> bool {
        let has_pace = self.object.is_none() && !self.settings.law.is_torque() && self.learner.is_none();
        let reduced = has_pace && self.gain_share > MIN_SHARE;
        if reduced {
            self.gain_share *= 0.5;
        }
        reduced
    }

    /// Restores the full gain.
    pub fn restore_gain(&mut self) {
        self.gain_share = 1.0;
    }

    /// The next law output starts smoothly again, as the first one did; after a stop or a hold.
    pub fn restart(&mut self) {
        self.start = None;
        if self.agreement.interrupt() {
            self.first_motion = FirstMotion::default();
        }
        if let Some(learner) = &mut self.learner {
            learner.interrupt();
        }
    }

    /// Adds a joint state (rad or m, rad/s or m/s) to the history; called at every tick, before anything else.
    pub fn note_arm(&mut self, now: MonoNs, q: &SVector<f64, N>, qd: &SVector<f64, N>) {
        self.history.push(now, q, qd);
    }

    /// The posture of the arm at `time`, rad or m; `None` where that is too long ago.
    #[must_use]
    pub fn joints_at(&self, time: MonoNs) -> Option<SVector<f64, N>> {
        self.history.joints(time)
    }

    /// Checks a measurement and, if it is used, makes it the current view.
    pub fn add_measurement(
        &mut self,
        now: MonoNs,
        measurement: &Measurement,
        robot: &Robot<N>,
    ) -> MeasurementVerdict {
        if measurement.target_number != self.goal.target() {
            return MeasurementVerdict::OtherTarget;
        }
        let verdict = self.add_of_target(now, measurement, robot);
        self.note_sought(verdict);
        if verdict.is_used() {
            self.noise = pace::noise_of(measurement);
        }
        verdict
    }

    /// The same of a measurement of the goal's target.
    fn add_of_target(
        &mut self,
        now: MonoNs,
        measurement: &Measurement,
        robot: &Robot<N>,
    ) -> MeasurementVerdict {
        let exposure = measurement.exposure;
        if measurement.target_status() == TargetStatus::Inconsistent {
            return MeasurementVerdict::Inconsistent;
        }
        let set_point = &self.goal;
        let Some(seen) = View::of(measurement, set_point) else {
            return if measurement.found() {
                MeasurementVerdict::OtherFeatures
            } else {
                MeasurementVerdict::NoTarget
            };
        };
        let seen = if self.learner.is_some() { seen.without_pose() } else { seen };
        if !seen.is_possible(set_point, &stated_covariance(measurement)) {
            return MeasurementVerdict::ImpossiblePose;
        }
        if self.last.is_some_and(|last| exposure <= last.exposure) {
            return MeasurementVerdict::NotNewer;
        }
        if exposure - now > LONGEST_FUTURE {
            return MeasurementVerdict::RefusedFromFuture;
        }
        let full = self.history.oldest().is_some_and(|oldest| exposure >= oldest);
        // At the start the arm stands: a frame from before the first tick shows it where it still is.
        let standing_start = self.last.is_none();
        let Some(q) = self.history.joints(exposure).filter(|_| full || standing_start) else {
            return MeasurementVerdict::TooOld;
        };
        let X_WC = self.settings.mount.X_WC(robot, &q);
        if self.learner.is_some() {
            return self.learn_from((now, measurement), seen, (&q, &X_WC));
        }
        let Some(first_X_WC) = self.first_shown_from(measurement, &seen, &X_WC) else {
            return MeasurementVerdict::NotNewer;
        };
        let partial = seen.is_partial();
        let incomplete = partial && seen.X_CO().is_none();
        let by_motion = if incomplete { self.completed_by_motion(&seen, exposure, &X_WC) } else { None };
        let supposed = by_motion.is_some();
        self.first_motion.note(&X_WC);
        // What is hidden was placed by the mount that is judged.
        if self.object.is_none() && incomplete {
            self.agreement.note(exposure, &seen, &X_WC, &self.goal);
        }
        let stated = || seen.sufficient(&self.goal).map(|view| (view, stated_covariance(measurement)));
        let Some((view, covariance)) = by_motion.or_else(stated) else {
            return MeasurementVerdict::TooFewFeatures;
        };
        let initial = self.initial.or_else(|| view.X_CO().map(DepthRow::of));
        let known = self.settings.X_WO.get(self.goal.target() as usize).map(|X_WO| X_WC.inv_mul(X_WO));
        let view = view.with_known(known).with_initial(initial);
        let task = match self.settings.law.task(&self.goal, &view) {
            Ok(task) => task,
            Err(why) => return MeasurementVerdict::NoTask(why),
        };
        if let (Some(object), Some(X_CO)) = (&mut self.object, view.X_CO()) {
            object.observe(exposure, &(X_WC * X_CO), &covariance_in(&X_WC, &covariance));
        }
        if !partial {
            self.seen_whole_at(&q, view.X_CO().map(|X_CO| X_WC * X_CO * centre(self.goal.points())));
        }
        if self.object.is_none() && !incomplete {
            self.agreement.note(exposure, &view, &X_WC, &self.goal);
        }
        let last = LastMeasurement { exposure, view, task, X_WC, first_X_WC, partial, supposed };
        self.drift = self.unobserved_motion_until(&last, &q, robot);
        if !partial && view.X_CO().is_some() {
            self.whole = Some(last);
        }
        self.last = Some(last);
        self.initial = initial;
        self.fresh = true;
        if exposure > now { MeasurementVerdict::UsedFromFuture } else { MeasurementVerdict::Used }
    }

    /// Joint motion since the last measurement beyond the history, for joints at `q` at this one's exposure.
    fn unobserved_motion_until(
        &self,
        now: &LastMeasurement,
        q: &SVector<f64, N>,
        robot: &Robot<N>,
    ) -> Option<UnobservedMotion<N>> {
        let before = self.last.as_ref()?;
        let (from, span) = (before.exposure, now.exposure - before.exposure);
        let at_rest = self.settings.watches_drift && self.object.is_none();
        if !at_rest || before.supposed || now.supposed || span > LONGEST_SPAN {
            return None;
        }
        let set_point = &self.goal;
        let predicted = before.view.predicted_at(&now.X_WC.inv_mul(&before.X_WC), set_point)?;
        let (_, J) = self.settings.mount.camera(robot, q);
        let dq = unobserved_motion(set_point, &predicted, &now.view, &J)?;
        Some(UnobservedMotion { dq, from, span })
    }

    /// Takes the joint motion that the last measurement showed beyond the history; `None` at the next call.
    pub fn take_unobserved_motion(&mut self) -> Option<UnobservedMotion<N>> {
        self.drift.take()
    }

    /// The law output at this tick for the joint positions `q` (rad or m) and velocities `qd` (rad/s or m/s). `None` before the first
    /// measurement, and where the law has no finite output.
    pub fn law_output(
        &mut self,
        q: &SVector<f64, N>,
        qd: &SVector<f64, N>,
        robot: &Robot<N>,
    ) -> Option<LawOutput<N>> {
        if self.learner.is_some() {
            return self.learnt_output((q, qd), robot).filter(LawOutput::is_finite);
        }
        self.agreement.begin();
        let motion = self.move_goal();
        if let Some(probing) = self.probing(q, robot) {
            self.held = Some(probing);
            return Some(probing.law_output);
        }
        let last = self.last.as_ref()?;
        let fresh = std::mem::take(&mut self.fresh);
        let held = self.settings.update == UpdatePolicy::Frame && !fresh;
        if !held {
            let now = self.history.newest().unwrap_or(last.exposure);
            let object = self.object.as_ref().map(|object| (object, now));
            self.held = self.settings.law_output(
                ServoGoal { motion, ..self.pursuit() },
                last,
                object,
                (q, qd),
                robot,
            );
        }
        let LawAnswer { law_output, .. } = self.held?;
        Some(self.started(law_output)).filter(LawOutput::is_finite)
    }

    /// Share of the requested velocity that is justified by what is known of the object's motion at `now`, 0 to 1: less and
    /// less when a moving object has not been measured for a while. 1 for an object at rest.
    #[must_use]
    pub fn confidence(&self, now: MonoNs) -> f64 {
        self.object.as_ref().map_or(1.0, |object| object.confidence(now + self.settings.lead))
    }

    /// Return to the posture of the last complete measurement of the goal's target, or of the first one since the law began where it is `to_begin`, for an arm at `q`: the joint
    /// velocity, rad/s or m/s, and how it leads there. `None` where it is not enabled
    /// ([`ServoSettings::returns`]), there was no complete measurement, the arm has arrived, or it is not known yet whether another target is in view.
    #[must_use]
    pub fn way_back(&self, q: &SVector<f64, N>, to_begin: bool) -> Option<(SVector<f64, N>, Convergence<N>)> {
        if self.sought.is_some_and(|misses| misses < MISSES) {
            return None;
        }
        let end = if to_begin { self.posture_first_seen_whole() } else { self.posture_seen_whole() };
        let remaining = end.filter(|_| self.settings.returns)? - q;
        let is_finite = remaining.iter().all(|x| x.is_finite());
        (is_finite && remaining.amax() > RETURNED)
            .then(|| (remaining * RETURN_RATE_1_S, Convergence::at(RETURN_RATE_1_S)))
    }

    /// The twist `V_WC_C` that the law would request of a camera without an arm, m/s and rad/s, for the last view at its
    /// exposure. `None` where [`law_output`](Self::law_output) has none, and for a torque law.
    #[must_use]
    pub fn camera_law_output(&self) -> Option<Vector6<f64>> {
        let last = self.last.as_ref().filter(|_| self.learner.is_none())?;
        let J = CameraJacobian::of_moving_camera(Matrix6::identity());
        let camera = Arm { J, qd: Vector6::zeros(), gravity: Vector6::zeros() };
        match self.settings.answer(self.pursuit(), (&last.view, &last.task), &camera, None)?.law_output {
            LawOutput::Velocity(V_C) => Some(V_C).filter(|V_C| V_C.iter().all(|x| x.is_finite())),
            LawOutput::Torque(_) => None,
        }
    }

    fn pursuit(&self) -> ServoGoal<'_> {
        ServoGoal { goal: &self.goal, motion: None, gain_share: self.gain_share, noise: self.noise }
    }

    /// How the last requested velocity leads to its goal; `None` without one.
    #[must_use]
    pub fn convergence(&self) -> Option<&Convergence<N>> {
        self.held.as_ref().map(|answer| &answer.convergence)
    }

    /// Smooth start: the law output less the fading first one, `v(t) - exp(-rate t) v(0)`, which begins at rest without a jump.
    fn started(&mut self, law_output: LawOutput<N>) -> LawOutput<N> {
        let (Some(rate_1_s), LawOutput::Velocity(qd), Some(now)) =
            (self.settings.smooth_start_1_s, law_output, self.history.newest())
        else {
            return law_output;
        };
        let (since, first) = *self.start.get_or_insert((now, qd));
        LawOutput::Velocity(qd - first * (-rate_1_s * (now - since).as_s()).exp())
    }
}

#[cfg(test)]
mod tests;
