//! What a controller is made of, and what its steps lead to.

use crate::control::behaviour::ArmModel;
use crate::control::gate::GateSettings;
use crate::control::lifecycle::State;
use crate::control::safety::Fault;
use crate::control::trace::Events;
use crate::drive::{CommandMode, DriveCommand};
use crate::motion::{ActingLimits, JointController};
use crate::servo::MeasurementVerdict;
use crate::time::SpanNs;
use nalgebra::SVector;

/// What a controller is made of.
#[derive(Debug, Clone)]
pub struct ControllerSettings<const N: usize> {
    /// The arm.
    pub arm: ArmModel<N>,
    /// Joint controller.
    pub joint_control: JointController<N>,
    /// What the drive obeys.
    pub mode: CommandMode,
    /// Time in which the effort of a joint may rise from zero to its largest.
    pub effort_rise: SpanNs,
    /// Where the run file has the arm start, rad or m.
    pub q_start: SVector<f64, N>,
    /// Distance of a joint from there beyond which the arm is not where the run file says.
    pub start_tolerance: f64,
    /// Whether it may start elsewhere.
    pub may_start_elsewhere: bool,
    /// Largest distance of a joint from its reference, rad or m.
    pub max_tracking_error: f64,
}

impl<const N: usize> ControllerSettings<N> {
    /// A controller of `arm` that starts in `q_start` before a drive which obeys `mode`; the rest as in the default run.
    #[must_use]
    pub fn new(
        arm: ArmModel<N>,
        joint_control: JointController<N>,
        mode: CommandMode,
        q_start: SVector<f64, N>,
    ) -> Self {
        Self {
            arm,
            joint_control,
            mode,
            effort_rise: SpanNs(10_000_000),
            q_start,
            start_tolerance: 0.02,
            may_start_elsewhere: false,
            max_tracking_error: 0.1,
        }
    }

    pub(super) fn gate(&self) -> GateSettings<N> {
        let limits = self.arm.robot.limits();
        let effort = SVector::from_fn(|i, _| limits[i].effort);
        GateSettings {
            effort,
            effort_rate: effort / self.effort_rise.as_s(),
            mode: self.mode,
            // Half-way to where the watch of the tracking error ends the run at the latest.
            max_excess: 0.5 * self.max_tracking_error,
        }
    }
}

/// What a step leads to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ControlOutput<const N: usize> {
    /// For the drive.
    pub command: DriveCommand<N>,
    /// What the controller does.
    pub state: State,
    /// Why it does nothing more, in fault.
    pub fault: Option<Fault>,
    /// The joint velocity that the behaviour asks for, before limits; rad/s or m/s.
    pub requested_qd: SVector<f64, N>,
    /// The limits that acted, and on which joints.
    pub limits: ActingLimits,
    /// What became of the measurement, if there was one.
    pub verdict: Option<MeasurementVerdict>,
    /// What happened.
    pub events: Events,
}

/// Whether the arm stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Rest {
    /// Reference or measured arm move.
    Moving,
    /// Both stand.
    AtRest,
    /// The arm goes on moving although its reference has rested for 2 s.
    Restless,
    /// The reference stands; the arm cannot be seen.
    Unknown,
}
