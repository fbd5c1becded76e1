//! Who commands the arm of a simulated run instead of the law of its run file: what it sees, and what it may want.

use crate::geometry::Pose;
use crate::messages::Measurement;
use crate::time::MonoNs;
use std::ops::ControlFlow;

/// What a commander gets whenever a measurement reaches control: what the cell believes, and nothing of what is true of it alone.
#[derive(Debug, Clone, Copy)]
pub struct CommanderSight<'a> {
    /// When.
    pub now: MonoNs,
    /// What vision made of the frame.
    pub measurement: &'a Measurement,
    /// The frame itself, row by row, where the commander wants it.
    pub frame: Option<&'a [u8]>,
    /// Measured positions of the joints, rad or m.
    pub q: &'a [f64],
    /// Their velocities, rad/s or m/s.
    pub qd: &'a [f64],
    /// The camera as the arm's model has it, now and at the exposure, in the frame in which the object rests.
    pub X_WC: Pose,
    /// See above.
    pub X_WC_exposure: Pose,
    /// The camera's Jacobian now, six rows for each joint: `V_WC_C = J qd`.
    pub J: &'a [[f64; 6]],
}

/// What a commander wants, until it says otherwise.
#[derive(Debug, Clone, PartialEq)]
pub enum WantedMotion {
    /// The twist of the camera `V_WC_C`, m/s and rad/s.
    Twist([f64; 6]),
    /// A velocity for each joint, rad/s or m/s.
    Joints(Vec<f64>),
    /// No command: the arm brakes and rests.
    None,
}

/// Who commands the arm.
pub trait Commander {
    /// Whether it looks at frames.
    fn wants_frames(&self) -> bool;

    /// What it wants upon what is seen; a break ends the run.
    fn command(&mut self, sight: &CommanderSight<'_>) -> ControlFlow<(), WantedMotion>;
}
