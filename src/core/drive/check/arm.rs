//! What a check must know of the arm and of the run file.

use crate::drive::CommandMode;
use crate::robot::JointLimits;
use crate::time::SpanNs;

/// What must be known of a joint.
#[derive(Debug, Clone, PartialEq)]
pub struct JointFacts {
    /// Its name.
    pub name: String,
    /// Its limits, rad or m.
    pub limits: JointLimits,
    /// Whether it slides.
    pub prismatic: bool,
}

/// What must be known of the arm and of the run file.
#[derive(Debug, Clone, PartialEq)]
pub struct ArmFacts {
    /// The joints of the robot file, from the base.
    pub joints: Vec<JointFacts>,
    /// Longest wait for the answer to START.
    pub connect_timeout: SpanNs,
    /// Age of a state at which a run would end.
    pub drive_timeout: SpanNs,
    /// `servo.lead_ms` of the run file.
    pub lead: SpanNs,
    /// `drive.mode` of the run file.
    pub wanted: CommandMode,
    /// Whether the drive is to answer every command with one state.
    pub lockstep: bool,
}
