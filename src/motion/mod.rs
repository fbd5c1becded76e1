//! From wished joint velocities to what a drive obeys: arm limits ahead of the reference, the limited reference, and
//! the joint controller that follows it.
//!
//! ```text
//! servo law ─► brakeable (the goal is not passed) ─► evade (singular postures, ends of ranges)
//!           ─► Reference (hard limits, last) ─► JointController ─► drive
//! ```

mod approach;
mod braking;
mod evasion;
mod joint_control;
mod joint_observer;
mod limits;
mod reference;
mod time_optimal;

pub use approach::brakeable;
pub use evasion::evade;
pub use joint_control::{InverseDynamicsControl, JointController, JointLaw, JointTorque, PdGravityControl};
pub use joint_observer::ObserverSettings;
pub use limits::{ActingLimits, Limit, LimitWatch, LongActing};
pub use reference::{MotionLimits, Reference, ReferenceState};
pub use time_optimal::least_time_s;
