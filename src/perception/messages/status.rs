//! State of the run, 50 times a second: `control/status`.

use super::layout::{named_codes, record};
use crate::time::MonoNs;
#[cfg(feature = "transport")]
use iceoryx2::prelude::ZeroCopySend;

/// State of the control process.
#[repr(u32)]
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash)]
pub enum ControlState {
    /// No measurement yet: the arm holds its position.
    #[default]
    Waiting = 0,
    /// The servo law moves the arm.
    Servoing = 1,
    /// Measurements stopped: the arm slows down and holds.
    Holding = 2,
    /// The goal has been reached and held.
    Converged = 3,
    /// The run is over.
    Stopped = 4,
    /// A fault: the arm slows down and the run ends, or waits for a reset.
    Fault = 5,
    /// No task was started: the arm stands.
    Idle = 6,
    /// The present measurements become the set-point: the arm stands.
    Teaching = 7,
    /// The arm slows down on request, or because the run ends.
    Stopping = 8,
    /// Held on request: the arm slows down and stands.
    Held = 9,
    /// Measurements stopped: the arm returns to the posture of the last complete measurement.
    Returning = 10,
    /// The arm moves to a posture on request.
    Moving = 11,
}

impl ControlState {
    /// All states.
    pub const ALL: [Self; 12] = [
        Self::Waiting,
        Self::Servoing,
        Self::Holding,
        Self::Converged,
        Self::Stopped,
        Self::Fault,
        Self::Idle,
        Self::Teaching,
        Self::Stopping,
        Self::Held,
        Self::Returning,
        Self::Moving,
    ];

    /// The state of a code in a message; an unknown one counts as [`Self::Fault`].
    #[must_use]
    pub fn from_code(code: u32) -> Self {
        match code {
            0 => Self::Waiting,
            1 => Self::Servoing,
            2 => Self::Holding,
            3 => Self::Converged,
            4 => Self::Stopped,
            6 => Self::Idle,
            7 => Self::Teaching,
            8 => Self::Stopping,
            9 => Self::Held,
            10 => Self::Returning,
            11 => Self::Moving,
            _ => Self::Fault,
        }
    }

    /// Its name for messages.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Waiting => "waiting",
            Self::Servoing => "servoing",
            Self::Holding => "holding",
            Self::Converged => "converged",
            Self::Stopped => "stopped",
            Self::Fault => "fault",
            Self::Idle => "idle",
            Self::Teaching => "teaching",
            Self::Stopping => "stopping",
            Self::Held => "held",
            Self::Returning => "returning",
            Self::Moving => "moving",
        }
    }
}

named_codes! {
    /// Bits of [`Status::flags`].
    pub mod status_flag {
        /// Some features are hidden; the law uses the others.
        pub const DEGRADED: u32 = 1;
        /// While the state is `returning`: the arm looks around for its target.
        pub const SEARCHING: u32 = 2;
    }
}

record! {
    "vservo.Status.v8",
    /// State of the run, in a flat record, so that plotting tools can show every field.
    #[derive(Debug, Clone, Copy, Default, PartialEq)]
    pub struct Status {
        /// Number of the control tick.
        pub tick: u64,
        /// Counts what its sender has sent, from 0: a gap is a record that was lost on the way.
        pub sequence: u64,
        /// Time of that tick.
        pub stamp: MonoNs,
        /// Time since the first tick, s.
        pub time_s: f64,
        /// Root mean square feature error in the image, px; NaN before the first measurement.
        pub feature_error_px: f64,
        /// Distance of the camera from its desired position, m; NaN where unknown.
        pub position_error_m: f64,
        /// Angle of the camera from its desired orientation, rad; NaN where unknown.
        pub orientation_error_rad: f64,
        /// Exposure to command of the newest measurement, us; NaN before the first.
        pub exposure_to_command_us: f64,
        /// From exposure to the sending of its frame, us; NaN where the two have different clocks (lockstep).
        pub exposure_to_frame_us: f64,
        /// From the frame's sending to the start of its processing in vision, us.
        pub frame_to_vision_us: f64,
        /// Time that vision needed to process it, us.
        pub vision_us: f64,
        /// From the finished measurement to the command that used it, us; NaN in lockstep.
        pub measurement_to_command_us: f64,
        /// The twist `[v; w]` that the law requests of a camera which no arm moves (`drive.kind = "none"`, replayed images), in the
        /// camera's frame, m/s and rad/s; NaN where an arm moves it, and without a view.
        pub V_C: [f64; 6],
        /// Measurements used.
        pub measurements: u64,
        /// Frames that vision received.
        pub frames: u64,
        /// Frames that vision skipped.
        pub frames_dropped: u64,
        /// How often the target was lost.
        pub target_lost: u64,
        /// Deadlines missed.
        pub missed_deadlines: u64,
        /// For how long the camera has been in its state, s; NaN where unknown.
        pub camera_state_s: f64,
        /// Share of the gain at which the slowest error near the goal falls with what the law believes of depth, lens, mount and target, as
        /// `vservo check` tells it (`stability`); 0 or less: unstable. NaN for other laws than scheme D, and without a scene.
        pub stability: f64,
        /// For how long the goal has been reached and held, s; NaN where it is not, or was left again.
        pub at_goal_s: f64,
        /// The torque from outside of the joint that feels what touches the arm most, N m or N; NaN where nothing touches it, or torques are not known.
        pub contact_torque: f64,
        /// The force on the flange's origin in the frame of the base that explains the torques best, N; NaN likewise.
        pub contact_force: [f64; 3],
        /// Code of a [`ControlState`]: what control does.
        pub state: u32,
        /// Code of the [`super::TargetStatus`] of the last measurement.
        pub target: u32,
        /// The limits that acted since the last status: bits of `motion::Limit`.
        pub limits: u32,
        /// The joints on which they acted: bit 0 is the first.
        pub limited_joints: u32,
        /// Which arm.
        pub arm: u32,
        /// Bits of [`status_flag`].
        pub flags: u32,
        /// Code of a [`super::CameraState`] of a real camera.
        pub camera_state: u32,
        /// Number of the goal in the run: 0 is that of the run file, each new one has the next number.
        pub goal: u32,
        /// How often the supervisor has started a camera process anew.
        pub camera_restarts: u32,
        /// How often it has started vision anew.
        pub vision_restarts: u32,
        /// Number of the target of the goal, as in [`super::JointState::target_number`].
        pub target_number: u32,
        /// That joint, counted from 1; 0 where nothing touches the arm.
        pub contact_joint: u32,
    }
}
