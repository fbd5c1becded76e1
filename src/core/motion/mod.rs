//! From requested joint velocities to what a drive obeys: arm limits ahead of the reference, the limited reference, and
//! the joint controller that follows it.
//!
//! ```text
//! servo law ─► brakeable (the goal is not passed) ─► damp_singularity (singular postures, ends of ranges)
//!           ─► Reference (limits in space, then hard limits, last) ─► JointController ─► drive
//! ```

mod braking;
mod drive_lag;
mod excitation_motion;
mod external_torque;
mod goal_braking;
mod joint_control;
mod joint_observer;
mod limits;
mod motion_limits;
mod payload_estimator;
mod reference;
mod residual_model;
mod rotor_estimator;
mod singularity;
mod time_optimal;
mod workspace;

pub use drive_lag::DriveLagObserver;
pub use excitation_motion::{ExcitationMotion, MAX_EXCITATION};
pub use external_torque::ExternalTorqueObserver;
pub(crate) use external_torque::SETTLES;
pub use goal_braking::brakeable;
pub use joint_control::{InverseDynamicsControl, JointController, JointLaw, JointTorque, PdGravityControl};
pub use joint_observer::ObserverSettings;
pub use limits::{ActingLimits, Limit, LimitWatch, LongActing};
pub use motion_limits::MotionLimits;
pub use payload_estimator::PayloadFound;
pub use reference::{Reference, ReferenceState};
pub use singularity::damp_singularity;
pub use time_optimal::min_time_s;
pub use workspace::{
    ArmPlaces, Capsule, CheckedPoint, Clearance, HalfSpace, SpaceLimit, Workspace, WorkspaceSettings,
    checked_pairs, checked_points,
};
