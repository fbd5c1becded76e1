//! Rotations, poses and twists, and the operators of Sect. 10.3 that act on them.
//!
//! Notation: frames are B base, E end-effector (flange), C camera, D desired camera, O object.
//! `X_CO` is the pose of O in C (T_o^c of the textbook), `R_CO` its rotation, `p_CO_C` the position of O
//! from C expressed in C, `V_BC_C` the twist of C relative to B expressed in C, ordered `[v; w]`.
//! Inner letters cancel: `X_BO = X_BC * X_CO`.

mod rotation;
mod twist;

pub use rotation::{
    angle_axis, closest_rotation, roll_pitch_yaw, rotation_angle, rotation_x, rotation_y, rotation_z, skew,
    unit_quaternion,
};
pub use twist::{gamma, integrate_body_twist, rotate_twist};

use nalgebra::{Isometry3, Vector6};

/// A rigid-body pose `X_AB`: frame B in frame A, metres.
pub type Pose = Isometry3<f64>;

/// A twist `[v; w]` in m/s and rad/s, in the order of (10.18).
pub type Twist = Vector6<f64>;
