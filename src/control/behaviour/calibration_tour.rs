//! From posture to posture before a board, with a rest in each: by the images taken there the camera's mounting is found.
//!
//! Between two postures all joints follow `q(t) = q_a + (q_b - q_a) s(t / T)`, `s(u) = 10 u^3 - 15 u^4 + 6 u^5`: velocity and acceleration
//! begin and end with zero, with T such that a quarter of each joint's limits is used. It is requested as a velocity; where the arm
//! really is when it rests shows in its encoders.

use super::{ArmModel, Behaviour, MotionCommand};
use crate::calibration::hand_eye::{TourCell, TourError, plan_tour};
use crate::camera_model::CameraModel;
use crate::control::outcome::{Finish, Outcome};
use crate::drive::DriveState;
use crate::messages::Measurement;
use crate::motion::MotionLimits;
use crate::robot::Robot;
use crate::servo::{MeasurementVerdict, SetPoint, VisualServo};
use crate::time::{MonoNs, SpanNs, TICK};
use nalgebra::{Point3, SMatrix, SVector};

/// Share of a joint's limits on velocity, acceleration and jerk that the motion uses.
const LIMIT_SHARE: f64 = 0.25;
/// Largest velocity, acceleration and jerk of s(u).
const PEAKS: [f64; 3] = [1.875, 5.7735, 60.0];
/// Shortest motion, s.
const SHORTEST_S: f64 = 0.2;
/// The arm rests so long in each posture, long enough to settle and for images that show it.
const REST: SpanNs = SpanNs(1_200_000_000);

const OVER: Finish =
    Finish { outcome: Outcome::Finished, reason: "all views of the board have been visited" };
const TOO_FEW: Finish = Finish {
    outcome: Outcome::NotConverged,
    reason: "too few views of the board are within reach: start with the board in the middle of the image and small in it, and \
             with the joints away from the ends of their ranges",
};
const ONE_AXIS: Finish = Finish {
    outcome: Outcome::NotConverged,
    reason: "this arm turns the camera about one axis only: the camera's position along it cannot show",
};
const NOTHING_SEEN: &str =
    "the board was not seen where the arm starts: bring it into the image, and check [target]";
const TOO_SHORT: &str = "run.duration_s is over before all views were visited";

/// A tour of all views.
#[derive(Debug)]
pub struct CalibrationTour<const N: usize> {
    /// Knows target and mount, and judges measurements.
    servo: VisualServo<N>,
    camera: CameraModel,
    points: Vec<Point3<f64>>,
    plan: Option<Plan<N>>,
    refused: Option<TourError>,
}

#[derive(Debug)]
struct Plan<const N: usize> {
    limits: MotionLimits<N>,
    /// Still to come, the next one last.
    left: Vec<SVector<f64, N>>,
    leg: Option<Leg<N>>,
    rested: SpanNs,
}

/// On the way between two postures.
#[derive(Debug, Clone, Copy)]
struct Leg<const N: usize> {
    way: SVector<f64, N>,
    duration_s: f64,
    elapsed: SpanNs,
}

impl<const N: usize> CalibrationTour<N> {
    /// A tour before `camera` that begins when the board, whose points are `points` in O, is seen.
    #[must_use]
    pub fn new(servo: VisualServo<N>, camera: CameraModel, points: Vec<Point3<f64>>) -> Self {
        Self { servo, camera, points, plan: None, refused: None }
    }
}

impl<const N: usize> Leg<N> {
    fn new(way: SVector<f64, N>, limits: &MotionLimits<N>) -> Self {
        let [v, a, j] = PEAKS;
        let mut duration_s = SHORTEST_S;
        for (i, way) in way.iter().map(|way| way.abs()).enumerate() {
            duration_s = duration_s
                .max(v * way / (LIMIT_SHARE * limits.velocity[i]))
                .max((a * way / (LIMIT_SHARE * limits.acceleration[i])).sqrt())
                .max((j * way / (LIMIT_SHARE * limits.jerk[i])).cbrt());
        }
        Self { way, duration_s, elapsed: SpanNs(0) }
    }

    /// The velocity of the next tick; `None` at the end.
    fn advance(&mut self) -> Option<SVector<f64, N>> {
        // that of the tick's middle: what is covered is then what was meant
        let u = (self.elapsed.as_s() + 0.5 * TICK.as_s()) / self.duration_s;
        self.elapsed = SpanNs(self.elapsed.0.saturating_add(TICK.0));
        (u < 1.0).then(|| self.way * (30.0 * u * u * (1.0 - u) * (1.0 - u) / self.duration_s))
    }
}

impl<const N: usize> Plan<N> {
    fn advance(&mut self, q: &SVector<f64, N>) -> SVector<f64, N> {
        if let Some(qd) = self.leg.as_mut().and_then(Leg::advance) {
            return qd;
        }
        if self.leg.take().is_some() {
            self.rested = SpanNs(0);
        }
        self.rested = SpanNs(self.rested.0.saturating_add(TICK.0));
        if self.rested >= REST
            && let Some(next) = self.left.pop()
        {
            self.leg = Some(Leg::new(next - q, &self.limits));
        }
        SVector::zeros()
    }

    fn is_over(&self) -> bool {
        self.left.is_empty() && self.leg.is_none() && self.rested >= REST
    }
}

impl<const N: usize> Behaviour<N> for CalibrationTour<N> {
    fn note_arm(&mut self, now: MonoNs, state: &DriveState<N>) {
        self.servo.note_arm(now, &state.q, &state.qd);
    }

    fn take(
        &mut self,
        now: MonoNs,
        q: &SVector<f64, N>,
        m: &Measurement,
        arm: &ArmModel<N>,
    ) -> MeasurementVerdict {
        let verdict = self.servo.take(now, m, &arm.robot);
        if self.plan.is_none()
            && self.refused.is_none()
            && m.found()
            && let Some(X_CO) = m.pose()
        {
            let cell = TourCell {
                robot: &arm.robot,
                mount: &self.servo.settings().mount,
                camera: &self.camera,
                points: &self.points,
                limits: &arm.limits,
            };
            match plan_tour(&cell, q, &X_CO) {
                Ok(mut left) => {
                    left.reverse();
                    self.plan = Some(Plan { limits: arm.limits.clone(), left, leg: None, rested: SpanNs(0) });
                }
                Err(why) => self.refused = Some(why),
            }
        }
        verdict
    }

    /// The way is known once it is planned, whether the board is in view on it or not.
    fn confidence(&self, _now: MonoNs) -> f64 {
        if self.plan.is_some() { 1.0 } else { 0.0 }
    }

    fn motion_command(&mut self, state: &DriveState<N>, _robot: &Robot<N>) -> MotionCommand<N> {
        self.plan.as_mut().map_or(MotionCommand::Stand, |plan| MotionCommand::Joints(plan.advance(&state.q)))
    }

    fn pause(&mut self) {}

    fn camera_jacobian(&self, robot: &Robot<N>, q: &SVector<f64, N>) -> SMatrix<f64, 6, N> {
        *self.servo.settings().mount.camera(robot, q).1.matrix()
    }

    fn set_point(&self) -> &SetPoint {
        self.servo.set_point()
    }

    fn teach(&mut self) {}

    fn finished(&self) -> Option<Finish> {
        match self.refused {
            Some(TourError::TooFewViews) => Some(TOO_FEW),
            Some(TourError::OneAxis) => Some(ONE_AXIS),
            None => self.plan.as_ref().is_some_and(Plan::is_over).then_some(OVER),
        }
    }

    fn has_goal(&self) -> bool {
        false
    }

    fn when_late(&self) -> Option<&'static str> {
        Some(if self.plan.is_some() { TOO_SHORT } else { NOTHING_SEEN })
    }
}
