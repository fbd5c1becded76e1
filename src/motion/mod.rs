//! From wished joint velocities to torques: the limited reference, and the joint controller that follows it.

mod joint_control;
mod reference;

pub use joint_control::{InverseDynamicsControl, JointTorque};
pub use reference::{MotionLimits, Reference, ReferenceState};
