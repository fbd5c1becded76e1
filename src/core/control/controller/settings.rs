//! Settings of a controller and the output of its steps.

use crate::control::behaviour::ArmModel;
use crate::control::gate::GateSettings;
use crate::control::lifecycle::State;
use crate::control::safety::{Contact, ContactReaction, Fault};
use crate::control::trace::Events;
use crate::drive::{CommandMode, DriveCommand};
use crate::motion::{ActingLimits, JointController, SpaceLimit, WorkspaceSettings};
use crate::servo::MeasurementVerdict;
use crate::time::SpanNs;
use nalgebra::SVector;

/// Time in which the effort of a joint may rise from zero to its largest, s. Chosen by hand: that of the default run file (`motion.effort_rise_ms`).
const EFFORT_RISE_S: f64 = 0.01;

/// Settings of a controller.
#[derive(Debug, Clone)]
pub struct ControllerSettings<const N: usize> {
    /// The arm.
    pub arm: ArmModel<N>,
    /// Joint controller.
    pub joint_control: JointController<N>,
    /// What the drive obeys.
    pub mode: CommandMode,
    /// Largest change of each joint's effort in a second, N m/s or N/s.
    pub effort_rate: SVector<f64, N>,
    /// Time from one state of the drive to the next, where it tells that.
    pub drive_period: Option<SpanNs>,
    /// Start posture of the run file, rad or m.
    pub q_start: SVector<f64, N>,
    /// Largest distance of a joint from there at the start, rad or m.
    pub start_tolerance: f64,
    /// Whether it may start elsewhere.
    pub may_start_elsewhere: bool,
    /// Largest distance of a joint from its reference, rad or m.
    pub max_tracking_error: f64,
    /// Whether the arm does as it is told. One that was recorded does not, so that nothing is concluded from what it does instead: no contact, jam, swing, distance from
    /// its reference or frozen encoder, and no torques that were held back.
    pub obeys: bool,
    /// What is done about a contact.
    pub reaction: ContactReaction,
    /// Share of the velocity limits with which the arm moves while the robot says that its own limits are reduced, above 0, up to 1.
    pub reduced_speed_share: f64,
    /// Limits in space, where there are some.
    pub space: Option<WorkspaceSettings>,
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
        let limits = arm.robot.limits();
        Self {
            effort_rate: SVector::from_fn(|i, _| limits[i].effort / EFFORT_RISE_S),
            arm,
            joint_control,
            mode,
            drive_period: None,
            q_start,
            start_tolerance: 0.02,
            may_start_elsewhere: false,
            max_tracking_error: 0.1,
            obeys: true,
            reaction: ContactReaction::Stop,
            reduced_speed_share: 1.0,
            space: None,
        }
    }

    pub(super) fn gate(&self) -> GateSettings<N> {
        let limits = self.arm.robot.limits();
        let effort = SVector::from_fn(|i, _| limits[i].effort);
        GateSettings {
            effort,
            effort_rate: self.effort_rate,
            mode: self.mode,
            // Half of the tracking error at which the supervision ends the run at the latest.
            max_excess: 0.5 * self.max_tracking_error,
        }
    }
}

/// The output of a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ControlOutput<const N: usize> {
    /// The command for the drive.
    pub command: DriveCommand<N>,
    /// The state of the lifecycle.
    pub state: State,
    /// The fault, where there is one.
    pub fault: Option<Fault>,
    /// The joint velocity that the behaviour requests, before limits; rad/s or m/s.
    pub requested_qd: SVector<f64, N>,
    /// The limits that acted, and on which joints.
    pub limits: ActingLimits,
    /// The limit in space that acted.
    pub held_by: Option<SpaceLimit>,
    /// The verdict on the measurement, if there was one.
    pub verdict: Option<MeasurementVerdict>,
    /// The events of the step.
    pub events: Events,
    /// The torque of each joint that comes from outside, N m or N, and its standard deviation; `None` where torques are not known.
    pub external_torque: Option<(SVector<f64, N>, SVector<f64, N>)>,
    /// What touches the arm, or stopped it where that fault stands.
    pub contact: Option<Contact>,
}

/// Whether the arm stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Rest {
    /// The reference or the measured arm moves.
    Moving,
    /// Both are at rest.
    AtRest,
    /// The arm keeps moving although its reference has been at rest for 3 s.
    Restless,
    /// The reference is at rest; the state of the arm is unknown.
    Unknown,
}

/// The check of the start posture.
#[derive(Debug, Clone, Copy)]
pub(super) struct StartCheck<const N: usize> {
    pub(super) q: SVector<f64, N>,
    pub(super) tolerance: f64,
    pub(super) elsewhere: bool,
    pub(super) is_checked: bool,
}
