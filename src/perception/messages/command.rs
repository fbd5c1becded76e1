//! Requests to control and its answers: `control/command`.

use super::drive_text::{DRIVE_TEXT_BYTES, text_of};
use super::layout::{named_codes, record};
use super::{MAX_FEATURES, MAX_JOINTS};
#[cfg(feature = "transport")]
use iceoryx2::prelude::ZeroCopySend;

/// Numbers that a request can carry: two for each of the features of a goal.
pub const COMMAND_VALUES: usize = 2 * MAX_FEATURES;

record! {
    "vservo.ControlCommand.v3",
    /// A request to control.
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub struct ControlCommand {
        /// Code of a `control::lifecycle::Request`; 0 asks for the answer alone, and every other code is refused. With 0 and the form [`CommandForm::Features`] or
        /// [`CommandForm::Pose`] the answer's refusal tells whether that goal would be refused; with [`CommandForm::Joints`] whether that posture would be, and where two
        /// postures stand there, the second one after the first.
        pub request: u32,
        /// Which arm: 0; a request for any other is refused.
        pub arm: u32,
        /// The camera that a goal is meant for: 0; a request for any other is refused.
        pub camera: u32,
        /// What the numbers are: code of a [`CommandForm`].
        pub form: u32,
        /// Entries of `values` in use.
        pub count: u32,
        /// Of `goal`, the target that it is of: 0: that of the present goal, else 1 more than its number; 0 with all other requests.
        pub target: u32,
        /// With the form [`CommandForm::Features`], which point each two values belong to.
        pub ids: [u32; MAX_FEATURES],
        /// The numbers.
        pub values: [f64; COMMAND_VALUES],
    }
}

impl Default for ControlCommand {
    fn default() -> Self {
        Self {
            request: 0,
            arm: 0,
            camera: 0,
            form: 0,
            count: 0,
            target: 0,
            ids: [0; MAX_FEATURES],
            values: [0.0; COMMAND_VALUES],
        }
    }
}

/// What the numbers of a request are.
#[repr(u32)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum CommandForm {
    /// Desired features: normalized image coordinates x, y of each point.
    Features = 1,
    /// Desired pose X_DO of the object in the camera at the goal: position, m, and unit quaternion x, y, z, w.
    Pose = 2,
    /// Joint positions, or for `jog` displacements of the joints, rad or m.
    Joints = 3,
    /// A displacement of the camera in its own frame: position, m, and rotation vector, rad.
    CameraMotion = 4,
    /// Gain of a resolved-velocity law, 1/s.
    Gain = 5,
    /// Largest root mean square feature error at which the goal counts as reached, px.
    Tolerance = 6,
    /// Time for which the goal must be held, s.
    Hold = 7,
    /// Velocities of the joints, rad/s or m/s, and for how long they hold, s.
    JointVelocity = 8,
    /// Twist of the camera `V_WC_C`: m/s and rad/s, and for how long it holds, s.
    CameraTwist = 9,
}

impl CommandForm {
    /// All forms.
    pub const ALL: [Self; 9] = [
        Self::Features,
        Self::Pose,
        Self::Joints,
        Self::CameraMotion,
        Self::Gain,
        Self::Tolerance,
        Self::Hold,
        Self::JointVelocity,
        Self::CameraTwist,
    ];

    /// The form of a code in a message.
    #[must_use]
    pub fn from_code(code: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|form| *form as u32 == code)
    }
}

impl ControlCommand {
    /// The request with this code, without numbers.
    #[must_use]
    pub fn of(request: u32) -> Self {
        Self { request, ..Self::default() }
    }

    /// The request with this code and with `numbers`; `None` where they are too many.
    #[must_use]
    pub fn with_numbers(request: u32, form: CommandForm, numbers: &[f64]) -> Option<Self> {
        let mut command = Self { form: form as u32, count: numbers.len() as u32, ..Self::of(request) };
        command.values.get_mut(..numbers.len())?.copy_from_slice(numbers);
        Some(command)
    }

    /// Its numbers.
    #[must_use]
    pub fn numbers(&self) -> &[f64] {
        self.values.get(..self.count as usize).unwrap_or_default()
    }
}

record! {
    "vservo.ControlAnswer.v11",
    /// The answer to a request, with the state of the run.
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub struct ControlAnswer {
        /// The request that this answers.
        pub request: u32,
        /// Code of a `control::lifecycle::Refusal`; 0: it was accepted.
        pub refusal: u32,
        /// Code of a [`super::ControlState`].
        pub state: u32,
        /// Code of a `control::safety::Fault`; 0: none.
        pub fault: u32,
        /// Code of the [`super::TargetStatus`] of the last measurement.
        pub target: u32,
        /// Joints in use.
        pub joints: u32,
        /// Bits of [`answer_flag`].
        pub flags: u32,
        /// Which arm.
        pub arm: u32,
        /// Code of a [`super::CameraState`] of a real camera.
        pub camera_state: u32,
        /// Number of the goal in the run: 0 is that of the run file, each new one has the next number.
        pub goal: u32,
        /// How often the supervisor has started a camera process anew.
        pub camera_restarts: u32,
        /// How often it has started vision anew.
        pub vision_restarts: u32,
        /// What the robot of an external drive is beside its joints: code of a [`super::RobotState`].
        pub robot_state: u32,
        /// The maker's own code for that; 0 where there is none.
        pub robot_code: u32,
        /// Number of the target of the goal, as in [`super::JointState::target_number`].
        pub target_number: u32,
        /// The joint, counted from 1, that feels what touches the arm most; 0 where nothing does.
        pub contact_joint: u32,
        /// Number of the control tick.
        pub tick: u64,
        /// Number of the last accepted request that decides what the arm does, all but `goal` and `set`; 0 before the first. Who finds another one than
        /// in the answer to its own request was overtaken by another client.
        pub motion_request: u64,
        /// Time since the first tick, s.
        pub time_s: f64,
        /// Root mean square feature error, px; NaN before the first measurement.
        pub feature_error_px: f64,
        /// Distance of the camera from its desired position, m; NaN where unknown.
        pub position_error_m: f64,
        /// Angle of the camera from its desired orientation, rad; NaN where unknown.
        pub orientation_error_rad: f64,
        /// For how long the camera has been in its state, s; NaN where unknown.
        pub camera_state_s: f64,
        /// For how long the goal has been reached and held, s; NaN where it is not, or was left again.
        pub at_goal_s: f64,
        /// The stability condition of scheme D at the goal as the run was planned, as in [`super::Status`]; NaN where it is not known.
        pub stability: f64,
        /// The torque of that joint from outside, N m or N; NaN where nothing touches the arm, or torques are not known.
        pub contact_torque: f64,
        /// The force on the flange's origin in the frame of the base that explains the torques best, N; NaN likewise.
        pub contact_force: [f64; 3],
        /// Measured joint positions, rad or m.
        pub q: [f64; MAX_JOINTS],
        /// Measured joint velocities, rad/s or m/s.
        pub qd: [f64; MAX_JOINTS],
        /// Points of the goal.
        pub goal_points: u64,
        /// Which points they are.
        pub goal_ids: [u32; MAX_FEATURES],
        /// Their desired features: normalized image coordinates x, y of each.
        pub goal_features: [f64; COMMAND_VALUES],
        /// What the maker says of `robot_state`, as the drive tells it: UTF-8, with a zero byte at its end; empty where it tells nothing.
        pub robot_text: [u8; DRIVE_TEXT_BYTES],
    }
}

impl Default for ControlAnswer {
    fn default() -> Self {
        Self {
            request: 0,
            refusal: 0,
            state: 0,
            fault: 0,
            target: 0,
            joints: 0,
            flags: 0,
            arm: 0,
            camera_state: 0,
            goal: 0,
            camera_restarts: 0,
            vision_restarts: 0,
            robot_state: 0,
            robot_code: 0,
            target_number: 0,
            contact_joint: 0,
            tick: 0,
            motion_request: 0,
            time_s: 0.0,
            feature_error_px: f64::NAN,
            position_error_m: f64::NAN,
            orientation_error_rad: f64::NAN,
            camera_state_s: f64::NAN,
            at_goal_s: f64::NAN,
            stability: f64::NAN,
            contact_torque: f64::NAN,
            contact_force: [f64::NAN; 3],
            q: [0.0; MAX_JOINTS],
            qd: [0.0; MAX_JOINTS],
            goal_points: 0,
            goal_ids: [0; MAX_FEATURES],
            goal_features: [0.0; COMMAND_VALUES],
            robot_text: [0; DRIVE_TEXT_BYTES],
        }
    }
}

impl ControlAnswer {
    /// What the maker says of the robot's state, empty where the drive tells nothing.
    #[must_use]
    pub fn robot_text(&self) -> String {
        text_of(&self.robot_text)
    }
}

named_codes! {
    /// Bits of [`ControlAnswer::flags`].
    pub mod answer_flag {
        /// The run serves requests, and ends on request.
        pub const SERVED: u32 = 1;
        /// A reset was accepted, and waits until the robot has cleared its error.
        pub const CLEARING: u32 = 2;
        /// Control holds the arm itself, since camera or vision was lost and the start is manual: until the next request that moves or stops it.
        pub const HELD_BY_CONTROL: u32 = 4;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::mem::{align_of, offset_of, size_of};

    #[test]
    #[allow(unsafe_code)]
    fn layouts_are_fixed_and_named() {
        assert_eq!((size_of::<ControlCommand>(), align_of::<ControlCommand>()), (1304, 8));
        assert_eq!((size_of::<ControlAnswer>(), align_of::<ControlAnswer>()), (2080, 8));
        assert_eq!((offset_of!(ControlCommand, ids), offset_of!(ControlCommand, values)), (24, 280));
        assert_eq!(offset_of!(ControlAnswer, tick), 64);
        assert_eq!(offset_of!(ControlAnswer, q), 168);
        // SAFETY: the names are only read.
        let names = unsafe { (ControlCommand::type_name(), ControlAnswer::type_name()) };
        assert_eq!(names, ("vservo.ControlCommand.v3", "vservo.ControlAnswer.v11"));
    }
}
