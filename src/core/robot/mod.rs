//! Serial arms of 2 to 7 joints: kinematics and dynamics without allocation, and the files that describe them.
//!
//! ```text
//! scara.toml (Denavit-Hartenberg) ─┐
//! ur5.urdf (+ ur5.toml) ───────────┴─► RobotDescription ─► Robot<N>  forward, jacobian, B(q), C qd + g, ...
//!         file, text, checks            dynamic, load time     pure arithmetic, used at 1 kHz
//! ```
//!
//! Frames: B base, E flange (end-effector), C camera or tool with `X_EC` fixed. The joint vectors `q`, `qd`,
//! `qdd`, `tau` are in rad and N m for revolute joints and in m and N for prismatic ones. Gravity is a vector in
//! B, so the base may stand in any orientation.
//!
//! [`load`] takes the name of a shipped robot or a path; [`crate::dispatch_robot`] turns the number of joints
//! that a file states into the const generic `N`, once, at start.

mod bounds;
mod build;
mod carried;
mod description;
mod dh;
mod dispatch;
mod dynamics;
mod energy;
mod error;
mod file;
mod inertia;
mod integrate;
mod inverse;
mod joint_axis;
mod joint_history;
mod joint_words;
mod kinematics;
mod mass_matrix;
mod model;
mod mount;
mod shipped;
mod skeleton;
mod trig;
mod urdf;

pub use bounds::POSITION_RAD_OR_M;
pub use description::{JointDescription, Motor, RobotDescription};
pub use error::{Defect, RobotError};
pub use inertia::Inertia;
pub(crate) use inertia::parallel_axis;
pub use inverse::{InverseOptions, JointVelocity};
pub use joint_history::JointHistory;
pub use joint_words::joint_in_words;
pub use kinematics::ExpressedIn;
pub use model::{Friction, JointKind, JointLimits, Robot};
pub use mount::{CameraJacobian, Mount};
pub use shipped::{SHIPPED, files, load};
pub use skeleton::Skeleton;

#[cfg(test)]
mod tests;
