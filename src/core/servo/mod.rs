//! The servo laws of Sects. 10.6 to 10.10: from what the camera sees to what the joints shall do.
//!
//! ```text
//! Measurement ─► View ─► Law::task: error, normal equations or wrench ─► Law::output: joint velocity or torque
//!                │ frame:   task and law output once for a measurement, held
//!                │ tick:    task once, law output at every tick with the newest J(q), qd, g(q)
//!                └ predict: view carried to now by the arm's own motion, task and law output at every tick
//! ```
//!
//! | scheme | task | law output |
//! | --- | --- | --- |
//! | A, (10.74) | [`OperationalSpaceError::wrench`] | [`joint_torque`] |
//! | B, (10.76) | [`OperationalSpaceError::twist_task`] | [`joint_velocity`] |
//! | C, (10.84) | [`image_task`], [`image_wrench`]; [`image_wrench_by`] with matrices | [`joint_torque`] |
//! | D, (10.87), (10.89)-(10.91) | [`image_task`]; [`image_task_by`] with a matrix | [`joint_velocity`] |
//! | hybrid, (10.92)-(10.97) | [`hybrid_task`] | [`joint_velocity`] |
//!
//! Two cameras that move one arm have a law each, and [`compromise`] makes one joint velocity of both.
//!
//! A task lives in the camera's frame and knows nothing of the arm. The arm enters by [`CameraJacobian`](crate::robot::CameraJacobian), the
//! camera's motion in the frame in which the object rests, so that one implementation serves a camera in the hand and one beside
//! the arm, and m = 4 and m = 6: with the four joints of a SCARA the least-squares solution among the motions that it can
//! make is the square system of the text. To step a law without processes: a [`SetPoint`], a [`View`] of the present
//! features (and pose), [`Law::task`], and [`Law::output`] with an [`Arm`].
//!
//! # Terms
//!
//! | term | meaning |
//! | --- | --- |
//! | feature, `s` | A number that the image of the target yields: a normalized coordinate of a point, the length of a segment, an area. |
//! | set-point | The features, and where it is known the pose, that the camera shall see at the goal ([`SetPoint`]). |
//! | view | The features of one instant, and where it is known the pose of the object in the camera's frame ([`View`]). |
//! | task | What a law computes from a view and a set-point in the camera's frame: an error with its normal equations, or a wrench ([`Task`]). |
//! | goal path | A set-point that moves: the desired pose over time, and its twist ([`GoalPath`]). |
//! | law output | What a law asks of the joints: velocities (rad/s or m/s), or torques (N m or N) ([`LawOutput`]). |
//! | interaction matrix, `L_s` | The derivative of the features by the relative motion of camera and object, (10.21). |
//! | gain | The rate at which a resolved-velocity law reduces its error, 1/s ([`Gain`]). |
//! | convergence | How a joint velocity leads to its goal: at what rate, and which part of it has no goal ([`Convergence`]). |
//! | posture | The joint positions of the arm, rad or m. |
//!
//! # Example
//!
//! ```
//! # use vservo_core as vservo;
//! use vservo::geometry::Pose;
//! use vservo::servo::{Interaction, SetPoint, View, image_task};
//! use vservo::target::FourDots;
//!
//! // The object lies 5 cm to the right of where the goal has it, so that the camera moves to the right.
//! let points: Vec<_> = FourDots::default().points_O().into();
//! let goal = SetPoint::from_pose(&Pose::translation(0.0, 0.0, 0.5), &points).ok_or("behind the camera")?;
//! let now = SetPoint::from_pose(&Pose::translation(0.05, 0.0, 0.5), &points).ok_or("behind the camera")?;
//! let view = View::new(now.features().iter().copied(), None).ok_or("no features")?;
//! let task = image_task(&goal, &view, Interaction::TEXTBOOK).ok_or("no interaction matrix")?;
//! let V_BC_C = task.twist(1.0).ok_or("the points do not fix the camera's motion")?;
//! assert!(V_BC_C.x > 0.04 && V_BC_C.x < 0.06);
//! # Ok::<(), &str>(())
//! ```

mod compromise;
mod convergence;
mod first_motion;
mod gain;
mod gain_matrix;
mod goal_path;
mod hybrid;
mod image;
mod interaction;
mod jacobian_estimator;
mod jacobian_learner;
mod law;
mod learning_motion;
mod measurement_verdict;
mod motion_agreement;
mod null_space;
mod object_motion;
mod orientation;
mod position;
mod posture;
mod resolve;
mod selection;
mod set_point;
mod settings;
mod similarity;
mod stability;
#[cfg(test)]
mod tests;
mod unobserved_motion;
mod view;
mod visibility;
mod visual_servo;

pub use compromise::{JointWish, compromise};
pub use convergence::Convergence;
pub use gain::Gain;
pub use gain_matrix::{FeatureEntries, FeatureMatrix, GainMatrix, NoGainMatrix, eigenvalue_range};
pub use goal_path::{GoalPath, MovingGoal};
pub use hybrid::{Displacement, HybridGains, J_o, J_p, hybrid_task};
pub use image::{
    FeatureGains, determined_directions, image_error, image_task, image_task_by, image_wrench,
    image_wrench_by, preconditioned_wrench, weighted_rows,
};
pub use interaction::{DepthRow, DepthSource, Interaction, InteractionAt};
pub use jacobian_estimator::{CautiousTask, Innovation, JacobianEstimator};
pub use jacobian_learner::EstimationSettings;
pub use law::{Arm, Damping, Law, LawOutput, NoTask, Task};
pub use measurement_verdict::MeasurementVerdict;
pub use motion_agreement::CameraError;
pub use null_space::{away_from_limits, seek_null_motion};
pub use object_motion::{ObjectDynamics, ObjectMotion};
pub use orientation::{OrientationError, euler_zyx};
pub use position::{
    OperationalSpace, OperationalSpaceError, PoseGains, TwistWeights, image_weights, operational_pose,
    pose_gains_4,
};
pub use posture::{PostureSearch, nearest_limit};
pub use resolve::{TwistTask, WrenchTask, joint_torque, joint_velocity};
pub use selection::{FeatureKind, OutlineFeature, Selection};
pub use set_point::SetPoint;
pub use settings::{ServoSettings, UpdatePolicy};
use similarity::fit_similarity;
pub use stability::{Margins, Stability, StabilityMargin, error_motion, felt_share};
pub use unobserved_motion::UnobservedMotion;
pub use view::View;
pub use visibility::VisibilityGuard;
pub(crate) use visual_servo::stated_px2;
pub use visual_servo::{MAX_TARGETS, VisualServo};
