//! When the law is computed, and for which view: takes measurements as they come, late or early or twice, and gives a
//! wish at every tick.
//!
//! A measurement is placed in time by its exposure stamp alone. Under `predict` the camera's own motion since then is
//! known from the joint history, so that for an object at rest the view now is exact, whatever the latency.

use super::{Arm, Law, SetPoint, Task, View, Wish};
use crate::geometry::Pose;
use crate::joint_history::JointHistory;
use crate::messages::Measurement;
use crate::robot::{ExpressedIn, Robot};
use crate::time::{MonoNs, SpanNs};
use nalgebra::SVector;

/// How far an exposure stamp may lie in the future: some drivers stamp the planned end of a frame.
const LONGEST_FUTURE: SpanNs = SpanNs(50_000_000);

/// When the servo law is computed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum UpdatePolicy {
    /// Once for each measurement; the wish is held.
    Frame,
    /// At every tick with the newest joint positions; the feature error is held.
    Tick,
    /// At every tick for the view of that tick, carried there from the last exposure by the arm's own motion.
    Predict,
}

/// What became of a measurement.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Intake {
    /// The servo law works with it.
    Used,
    /// Used, although its stamp lies in the future.
    UsedFromFuture,
    /// It has no target, or not the set-point's features.
    NoTarget,
    /// It is not newer than the last one: repeated, or overtaken.
    NotNewer,
    /// Its stamp lies too far in the future.
    RefusedFromFuture,
    /// Its exposure lies before everything that is known of the arm.
    TooOld,
}

impl Intake {
    /// Whether the servo law works with it.
    #[must_use]
    pub fn is_used(self) -> bool {
        matches!(self, Self::Used | Self::UsedFromFuture)
    }
}

/// The last measurement in use.
#[derive(Debug, Clone, Copy)]
struct Sighting {
    exposure: MonoNs,
    view: View,
    task: Task,
    /// Where the camera was at the exposure.
    X_BC: Pose,
}

/// Visual servoing of an arm with `N` joints.
#[derive(Debug, Clone)]
pub struct VisualServo<const N: usize> {
    law: Law,
    set_point: SetPoint,
    update: UpdatePolicy,
    /// Camera in the flange frame.
    X_EC: Pose,
    history: JointHistory<N>,
    sighting: Option<Sighting>,
    held: Option<Wish<N>>,
    fresh: bool,
}

impl<const N: usize> VisualServo<N> {
    /// Servoing to `set_point` with a camera at `X_EC` on the flange.
    #[must_use]
    pub fn new(law: Law, set_point: SetPoint, update: UpdatePolicy, X_EC: Pose) -> Self {
        Self {
            law,
            set_point,
            update,
            X_EC,
            history: JointHistory::new(),
            sighting: None,
            held: None,
            fresh: false,
        }
    }

    /// The goal.
    #[must_use]
    pub fn set_point(&self) -> &SetPoint {
        &self.set_point
    }

    /// Camera in the flange frame.
    #[must_use]
    pub fn X_EC(&self) -> &Pose {
        &self.X_EC
    }

    /// Notes where the arm is; at every tick, before anything else.
    pub fn note_arm(&mut self, now: MonoNs, q: &SVector<f64, N>, qd: &SVector<f64, N>) {
        self.history.push(now, q, qd);
    }

    /// Takes a measurement in.
    pub fn take(&mut self, now: MonoNs, measurement: &Measurement, robot: &Robot<N>) -> Intake {
        let exposure = measurement.exposure;
        let Some(view) = View::of(measurement) else { return Intake::NoTarget };
        let Some(task) = self.law.task(&self.set_point, &view) else { return Intake::NoTarget };
        if self.sighting.is_some_and(|last| exposure <= last.exposure) {
            return Intake::NotNewer;
        }
        if exposure - now > LONGEST_FUTURE {
            return Intake::RefusedFromFuture;
        }
        let full = self.history.oldest().is_some_and(|oldest| exposure >= oldest);
        // At the start the arm stands: a frame from before the first tick shows it where it still is.
        let standing_start = self.sighting.is_none();
        let Some(q) = self.history.joints(exposure).filter(|_| full || standing_start) else {
            return Intake::TooOld;
        };
        self.sighting = Some(Sighting { exposure, view, task, X_BC: robot.forward(&q) * self.X_EC });
        self.fresh = true;
        if exposure > now { Intake::UsedFromFuture } else { Intake::Used }
    }

    /// What the joints shall do at this tick, at which they stand in `q`. `None` before the first measurement, and
    /// where the law has no answer.
    pub fn wish(&mut self, q: &SVector<f64, N>, robot: &Robot<N>) -> Option<Wish<N>> {
        let sighting = self.sighting.as_ref()?;
        let fresh = std::mem::take(&mut self.fresh);
        if self.update == UpdatePolicy::Frame && !fresh {
            return self.held;
        }
        let (X_BC, J_C) = robot.forward_and_jacobian_of_frame(q, &self.X_EC, ExpressedIn::Moving);
        let arm = Arm { J_C };
        self.held = match self.update {
            UpdatePolicy::Frame | UpdatePolicy::Tick => self.law.wish(&sighting.task, &arm),
            UpdatePolicy::Predict => sighting
                .view
                .carried(&(X_BC.inverse() * sighting.X_BC), &self.set_point)
                .and_then(|now| self.law.task(&self.set_point, &now))
                .and_then(|task| self.law.wish(&task, &arm)),
        };
        self.held
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::{FeaturePoint, TargetStatus};
    use crate::servo::DepthSource;
    use nalgebra::{Point3, Vector4};

    const MS: i64 = 1_000_000;

    fn square() -> [Point3<f64>; 4] {
        [(0.0, 0.0), (0.1, 0.0), (0.1, 0.1), (0.0, 0.1)].map(|(x, y)| Point3::new(x, y, 0.0))
    }

    fn scara() -> Robot<4> {
        crate::robot::load("scara").unwrap().build::<4>().unwrap()
    }

    fn servo(update: UpdatePolicy) -> VisualServo<4> {
        let goal = Pose::new([-0.1, 0.1, 0.6].into(), [0.0, 0.0, -1.0].into());
        let set_point = SetPoint::from_pose(&goal, &square()).unwrap();
        let law = Law::ImageVelocity { gain_1_s: 1.0, depth: DepthSource::Estimated };
        VisualServo::new(law, set_point, update, Pose::identity())
    }

    fn q_at(ms: i64) -> Vector4<f64> {
        Vector4::new(0.0002 * ms as f64, 1.6, 0.5 + 0.0001 * ms as f64, -0.8)
    }

    /// What the camera sees at `ms` of an object at rest.
    fn seen_at(ms: i64) -> Measurement {
        let X_BO = Pose::new([1.0, 1.0, 1.1].into(), [0.0, 0.0, 0.7].into());
        let X_CO = scara().forward(&q_at(ms)).inverse() * X_BO;
        let mut m = Measurement { exposure: MonoNs(ms * MS), feature_count: 4, ..Measurement::default() };
        m.status = TargetStatus::Found as u32;
        for (f, p) in m.features.iter_mut().zip(square()) {
            let p = X_CO * p;
            *f = FeaturePoint { x: p.x / p.z, y: p.y / p.z, ..FeaturePoint::default() };
        }
        m.set_pose(&X_CO);
        m
    }

    fn moved_to(servo: &mut VisualServo<4>, ms: std::ops::RangeInclusive<i64>) {
        for k in ms {
            servo.note_arm(MonoNs(k * MS), &q_at(k), &Vector4::new(0.2, 0.0, 0.1, 0.0));
        }
    }

    fn velocity(wish: Option<Wish<4>>) -> Vector4<f64> {
        match wish.unwrap() {
            Wish::Velocity(qd) => qd,
        }
    }

    #[test]
    fn a_late_measurement_is_worth_a_fresh_one_under_predict() {
        let robot = scara();
        let (mut late, mut fresh) = (servo(UpdatePolicy::Predict), servo(UpdatePolicy::Predict));
        for s in [&mut late, &mut fresh] {
            moved_to(s, 0..=100);
        }
        assert_eq!(late.take(MonoNs(100 * MS), &seen_at(40), &robot), Intake::Used);
        assert_eq!(fresh.take(MonoNs(100 * MS), &seen_at(100), &robot), Intake::Used);
        let (a, b) = (velocity(late.wish(&q_at(100), &robot)), velocity(fresh.wish(&q_at(100), &robot)));
        assert!((a - b).norm() < 1e-9, "{a} {b}");
        let mut held = servo(UpdatePolicy::Tick);
        moved_to(&mut held, 0..=100);
        held.take(MonoNs(100 * MS), &seen_at(40), &robot);
        assert!(
            (velocity(held.wish(&q_at(100), &robot)) - b).norm() > 1e-3,
            "without prediction the delay shows"
        );
    }

    #[test]
    fn frame_holds_and_tick_follows_the_arm() {
        let robot = scara();
        for (update, holds) in [(UpdatePolicy::Frame, true), (UpdatePolicy::Tick, false)] {
            let mut s = servo(update);
            moved_to(&mut s, 0..=10);
            s.take(MonoNs(10 * MS), &seen_at(10), &robot);
            let first = velocity(s.wish(&q_at(10), &robot));
            let later = velocity(s.wish(&q_at(400), &robot));
            assert_eq!(first == later, holds);
        }
    }

    #[test]
    fn stamps_decide_what_is_used() {
        let robot = scara();
        let mut s = servo(UpdatePolicy::Predict);
        moved_to(&mut s, 1000..=1100);
        let now = MonoNs(1100 * MS);
        assert!(s.wish(&q_at(1100), &robot).is_none());
        assert_eq!(s.take(now, &seen_at(1160), &robot), Intake::RefusedFromFuture);
        assert_eq!(s.take(now, &seen_at(1080), &robot), Intake::Used);
        assert_eq!(s.take(now, &seen_at(1080), &robot), Intake::NotNewer, "repeated");
        assert_eq!(s.take(now, &seen_at(1040), &robot), Intake::NotNewer, "overtaken");
        assert_eq!(s.take(now, &seen_at(1120), &robot), Intake::UsedFromFuture);
        let lost = Measurement { exposure: MonoNs(1130 * MS), ..Measurement::default() };
        assert_eq!(s.take(now, &lost, &robot), Intake::NoTarget);
    }

    #[test]
    fn a_frame_from_before_the_first_tick_shows_the_arm_at_rest() {
        let robot = scara();
        let mut s = servo(UpdatePolicy::Predict);
        moved_to(&mut s, 1000..=1001);
        assert_eq!(s.take(MonoNs(1001 * MS), &seen_at(970), &robot), Intake::Used);
        let mut restarted = servo(UpdatePolicy::Predict);
        moved_to(&mut restarted, 1000..=1001);
        restarted.take(MonoNs(1001 * MS), &seen_at(1000), &robot);
        restarted.note_arm(MonoNs(5 * MS), &q_at(5), &Vector4::zeros());
        assert_eq!(restarted.take(MonoNs(2000 * MS), &seen_at(1001), &robot), Intake::Used);
    }
}
