//! The schemes of Sect. 10.9 and Example 10.6 with their gains, and the pose estimation that A and B need.
//!
//! The numbers here are the textbook's, where it has any, and else chosen settings of the simulation.

use super::cell::{POINTS, desired_object, pose_of};
use super::{Cell, ExperimentError, LawInput};
use crate::features::segment_features;
use crate::geometry::Pose;
use crate::pose::{Correspondence, algorithmic_step_4, algorithmic_step_segment};
use crate::robot::{CameraJacobian, ExpressedIn};
use crate::servo::{
    Arm, Damping, DepthSource, FeatureKind, Gain, HybridGains, Interaction, Law, LawOutput, OperationalSpace,
    OrientationError, Selection, SetPoint, TwistWeights, View, pose_gains_4,
};
use nalgebra::{Vector2, Vector3, Vector4};

/// Steps of the pose estimation in a frame, of 1 ms each.
const ESTIMATION_STEPS: usize = 40;
/// K_s of the pose estimation, 1/s.
const ESTIMATION_GAIN_1_S: f64 = 160.0;
const ESTIMATION_STEP_S: f64 = 1e-3;

/// A scheme of the comparison.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scheme {
    /// Position-based PD with gravity compensation, (10.74).
    A,
    /// Position-based resolved velocity, (10.76).
    B,
    /// Image-based PD with gravity compensation, (10.84).
    C,
    /// Image-based resolved velocity, (10.89).
    D,
    /// Hybrid, (10.92)-(10.97).
    Hybrid,
}

/// All of them, in the order of the text.
pub const SCHEMES: [Scheme; 5] = [Scheme::A, Scheme::B, Scheme::C, Scheme::D, Scheme::Hybrid];

impl Scheme {
    /// Its name, also of its files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::A => "A",
            Self::B => "B",
            Self::C => "C",
            Self::D => "D",
            Self::Hybrid => "hybrid",
        }
    }

    /// Whether it works on an estimated pose.
    #[must_use]
    pub fn is_position_based(self) -> bool {
        matches!(self, Self::A | Self::B)
    }

    /// The law with the gains of Sect. 10.9 and Example 10.6.
    #[must_use]
    pub fn law(self) -> Law {
        let (orientation, space) = (OrientationError::EulerZyx, OperationalSpace::Six);
        match self {
            Self::A => Law::PositionTorque {
                K_P: pose_gains_4(&[500.0, 500.0, 10.0, 10.0]),
                damping: Damping::Task(pose_gains_4(&[500.0, 500.0, 10.0, 10.0])),
                orientation,
                space,
            },
            Self::B => Law::PositionVelocity {
                K: pose_gains_4(&[1.0, 1.0, 1.0, 2.0]),
                gain: Gain::Constant(1.0),
                orientation,
                space,
                weights: TwistWeights::Unit,
            },
            Self::C => Law::ImageTorque {
                K_Ps: 300.0.into(),
                damping: Damping::Task(330.0.into()),
                interaction: Interaction::TEXTBOOK,
            },
            Self::D => Law::ImageVelocity {
                K_s: 1.0.into(),
                gain: Gain::Constant(1.0),
                interaction: Interaction::TEXTBOOK,
            },
            Self::Hybrid => Law::Hybrid {
                gains: HybridGains { K_p: Vector3::repeat(1.0).into(), K_o: Vector3::repeat(2.0).into() },
                gain: Gain::Constant(1.0),
                orientation,
                space: OperationalSpace::Four, // as in Example 10.5
                depth: DepthSource::Desired,
            },
        }
    }

    /// The features that it compares: P1 and P2, for the hybrid scheme all four points, P1 first.
    #[must_use]
    pub fn selection(self) -> Selection {
        match self {
            Self::Hybrid => Selection::all_points(POINTS.len()),
            _ => Selection::all_points(2),
        }
    }
}

/// What the pose estimation looks at.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PoseFeature {
    /// The points P1 and P2.
    Points,
    /// The line segment P1 P2, (10.28).
    Segment,
}

/// The pose estimation of Sect. 10.3.3 with m = 4, warm-started from frame to frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimator {
    x: Vector4<f64>,
    watched: PoseFeature,
}

impl Estimator {
    /// Starts from x_d,o, as in Sect. 10.9.
    #[must_use]
    pub fn new(watched: PoseFeature) -> Self {
        Self { x: desired_object(), watched }
    }

    /// Forty steps towards what is seen now; x_c,o of (10.33).
    ///
    /// # Errors
    /// Why a step has no answer.
    pub fn run(&mut self, seen: &[Vector2<f64>; 4]) -> Result<Vector4<f64>, String> {
        let [s1, s2, ..] = *seen;
        let [p1, p2, ..] = POINTS;
        let pairs = [(p1, s1), (p2, s2)].map(|(p, s)| Correspondence { r: p.coords.xy(), s });
        for _ in 0..ESTIMATION_STEPS {
            let (gain, dt) = (ESTIMATION_GAIN_1_S, ESTIMATION_STEP_S);
            let step = match self.watched {
                PoseFeature::Points => algorithmic_step_4(&self.x, &pairs, gain, dt),
                PoseFeature::Segment => {
                    algorithmic_step_segment(&self.x, &[p1, p2], &segment_features(&[s1, s2]), gain, dt)
                }
            };
            self.x = step.map_err(|e| format!("pose estimation: {e}"))?.x;
        }
        Ok(self.x)
    }
}

/// A law at work on frames: set-point, and pose estimation where the law needs it.
#[derive(Debug, Clone)]
pub struct SchemeController<'a> {
    cell: &'a Cell,
    law: Law,
    set_point: SetPoint,
    estimator: Option<Estimator>,
    /// Hands the law the object's true pose, for the depths.
    knows_depth: bool,
}

impl<'a> SchemeController<'a> {
    /// `scheme` in the operating conditions of Sect. 10.9: s_d from x_d,o.
    ///
    /// # Errors
    /// [`ExperimentError::Cell`] when the goal does not show all points.
    pub fn textbook(cell: &'a Cell, scheme: Scheme) -> Result<Self, ExperimentError> {
        let estimator = scheme.is_position_based().then(|| Estimator::new(PoseFeature::Points));
        Ok(Self::new(cell, scheme.law(), set_point(&cell.X_DO, scheme.selection())?, estimator))
    }

    /// Any law and set-point; `estimator` for laws that need a pose.
    #[must_use]
    pub fn new(cell: &'a Cell, law: Law, set_point: SetPoint, estimator: Option<Estimator>) -> Self {
        Self { cell, law, set_point, estimator, knows_depth: false }
    }

    /// The same, with the true depths at hand for laws that ask for them.
    #[must_use]
    pub fn knowing_depth(self) -> Self {
        Self { knows_depth: true, ..self }
    }

    /// The control for one frame.
    ///
    /// # Errors
    /// Why the law has no answer.
    pub fn control(&mut self, frame: &LawInput) -> Result<LawOutput<4>, String> {
        let X_CO = match &mut self.estimator {
            Some(estimator) => Some(pose_of(&estimator.run(&frame.seen)?)),
            None => None,
        };
        let known = self.knows_depth.then(|| self.cell.X_CO(&frame.q));
        let view =
            View::new(frame.seen.into_iter(), X_CO).ok_or("a feature is not finite")?.with_known(known);
        let task = self.law.task(&self.set_point, &view).map_err(|_| "the law has no task for this view")?;
        let arm = Arm {
            J: CameraJacobian::of_moving_camera(self.cell.arm.jacobian_of_frame(
                &frame.q,
                &Pose::identity(),
                ExpressedIn::Moving,
            )),
            qd: frame.qd,
            gravity: self.cell.arm.gravity(&frame.q),
        };
        self.law.output(&task, &arm).ok_or_else(|| "the law has no finite answer".into())
    }
}

/// The set-point of (10.78) for a desired pose of the square.
///
/// # Errors
/// [`ExperimentError::Cell`] when a point would lie behind the camera or the selection names other points.
pub fn set_point(X_DO: &Pose, selection: Selection) -> Result<SetPoint, ExperimentError> {
    SetPoint::from_pose(X_DO, &POINTS)
        .and_then(|s| s.with_selection(selection))
        .ok_or_else(|| ExperimentError::Cell { cause: "the desired pose does not show the points".into() })
}

/// The line segment P1 P2 as the one feature.
///
/// # Errors
/// [`ExperimentError::Cell`] never in practice.
pub fn segment_selection() -> Result<Selection, ExperimentError> {
    Selection::new([(FeatureKind::Segment(0, 1), 1.0)])
        .ok_or_else(|| ExperimentError::Cell { cause: "the segment is refused".into() })
}
