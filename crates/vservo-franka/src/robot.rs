//! What the robot is, in the maker's words.

use std::fmt;

/// Mode of the robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)] // the maker's words
pub enum RobotMode {
    Other,
    Idle,
    Move,
    Guiding,
    Reflex,
    UserStopped,
    AutomaticErrorRecovery,
    /// A number that is not known here.
    Unknown(u8),
}

impl RobotMode {
    const ALL: [(Self, &'static str); 7] = [
        (Self::Other, "the robot's brakes are closed, or it boots"),
        (Self::Idle, "the robot is idle"),
        (Self::Move, "the robot moves"),
        (Self::Guiding, "the robot is guided by hand"),
        (Self::Reflex, "the robot has stopped by a reflex"),
        (Self::UserStopped, "the user stop is pressed"),
        (Self::AutomaticErrorRecovery, "the robot clears an error"),
    ];

    /// The mode of a number.
    #[must_use]
    pub fn of(number: u8) -> Self {
        Self::ALL.get(usize::from(number)).map_or(Self::Unknown(number), |(mode, _)| *mode)
    }

    /// Its number.
    #[must_use]
    pub fn number(self) -> u8 {
        match self {
            Self::Unknown(number) => number,
            known => Self::ALL.iter().position(|(mode, _)| *mode == known).unwrap_or_default() as u8,
        }
    }
}

impl fmt::Display for RobotMode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match Self::ALL.iter().find(|(mode, _)| mode == self) {
            Some((_, text)) => f.write_str(text),
            None => write!(f, "the robot is in the unknown mode {}", self.number()),
        }
    }
}

/// What is commanded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)] // the maker's words
pub enum Generator {
    Idle,
    JointPosition,
    JointVelocity,
    CartesianPosition,
    CartesianVelocity,
    /// Torques alone.
    None,
}

impl Generator {
    const ALL: [Self; 6] = [
        Self::Idle,
        Self::JointPosition,
        Self::JointVelocity,
        Self::CartesianPosition,
        Self::CartesianVelocity,
        Self::None,
    ];

    /// Of its number; an unknown one is none.
    #[must_use]
    pub fn of(number: u8) -> Self {
        Self::ALL.get(usize::from(number)).copied().unwrap_or(Self::Idle)
    }

    /// Its number.
    #[must_use]
    pub fn number(self) -> u8 {
        self as u8
    }
}

/// What makes torques.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)] // the maker's words
pub enum Controller {
    JointImpedance,
    CartesianImpedance,
    External,
    Other,
}

impl Controller {
    const ALL: [Self; 4] = [Self::JointImpedance, Self::CartesianImpedance, Self::External, Self::Other];

    /// Of its number; an unknown one is another.
    #[must_use]
    pub fn of(number: u8) -> Self {
        Self::ALL.get(usize::from(number)).copied().unwrap_or(Self::Other)
    }

    /// Its number.
    #[must_use]
    pub fn number(self) -> u8 {
        self as u8
    }
}

/// An error of the robot, in the maker's order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)] // the maker's words
pub enum RobotError {
    JointPositionLimits = 0,
    JointVelocity = 3,
    JointReflex = 6,
    StartPoseInvalid = 11,
    CommandedPositionLimits = 12,
    CommandedVelocityLimits = 13,
    VelocityDiscontinuity = 14,
    AccelerationDiscontinuity = 15,
    Communication = 25,
    TorqueDiscontinuity = 32,
    TorqueRange = 34,
}

impl RobotError {
    /// Its bit in a state.
    #[must_use]
    pub fn bit(self) -> u64 {
        1 << self as u64
    }
}

/// Names of the errors, in the order of their bytes in a state.
const NAMES: [&str; crate::wire::ERRORS] = [
    "joint_position_limits_violation",
    "cartesian_position_limits_violation",
    "self_collision_avoidance_violation",
    "joint_velocity_violation",
    "cartesian_velocity_violation",
    "force_control_safety_violation",
    "joint_reflex",
    "cartesian_reflex",
    "max_goal_pose_deviation_violation",
    "max_path_pose_deviation_violation",
    "cartesian_velocity_profile_safety_violation",
    "joint_position_motion_generator_start_pose_invalid",
    "joint_motion_generator_position_limits_violation",
    "joint_motion_generator_velocity_limits_violation",
    "joint_motion_generator_velocity_discontinuity",
    "joint_motion_generator_acceleration_discontinuity",
    "cartesian_position_motion_generator_start_pose_invalid",
    "cartesian_motion_generator_elbow_limit_violation",
    "cartesian_motion_generator_velocity_limits_violation",
    "cartesian_motion_generator_velocity_discontinuity",
    "cartesian_motion_generator_acceleration_discontinuity",
    "cartesian_motion_generator_elbow_sign_inconsistent",
    "cartesian_motion_generator_start_elbow_invalid",
    "force_controller_desired_force_tolerance_violation",
    "start_elbow_sign_inconsistent",
    "communication_constraints_violation",
    "power_limit_violation",
    "cartesian_motion_generator_joint_position_limits_violation",
    "cartesian_motion_generator_joint_velocity_limits_violation",
    "cartesian_motion_generator_joint_velocity_discontinuity",
    "cartesian_motion_generator_joint_acceleration_discontinuity",
    "cartesian_position_motion_generator_invalid_frame_flag",
    "controller_torque_discontinuity",
    "joint_p2p_insufficient_torque_for_planning",
    "tau_J_range_violation",
    "instability_detected",
    "joint_move_in_wrong_direction",
    "cartesian_spline_motion_generator_violation",
    "joint_via_motion_generator_planning_joint_limit_violation",
    "base_acceleration_initialization_timeout",
    "base_acceleration_invalid_reading",
];

/// The maker's names of errors, one bit each.
#[must_use]
pub fn name_errors(bits: u64) -> String {
    let named: Vec<_> =
        NAMES.iter().enumerate().filter(|(i, _)| bits >> i & 1 != 0).map(|(_, n)| *n).collect();
    if named.is_empty() { "no error is told".into() } else { named.join(", ") }
}

/// The number of the first error, from 0; none where there is none.
#[must_use]
pub fn first_error(bits: u64) -> Option<u32> {
    (bits != 0).then(|| bits.trailing_zeros())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_have_the_names_of_their_numbers() {
        let named = [
            (RobotError::JointPositionLimits, "joint_position_limits_violation"),
            (RobotError::JointVelocity, "joint_velocity_violation"),
            (RobotError::JointReflex, "joint_reflex"),
            (RobotError::StartPoseInvalid, "joint_position_motion_generator_start_pose_invalid"),
            (RobotError::CommandedPositionLimits, "joint_motion_generator_position_limits_violation"),
            (RobotError::CommandedVelocityLimits, "joint_motion_generator_velocity_limits_violation"),
            (RobotError::VelocityDiscontinuity, "joint_motion_generator_velocity_discontinuity"),
            (RobotError::AccelerationDiscontinuity, "joint_motion_generator_acceleration_discontinuity"),
            (RobotError::Communication, "communication_constraints_violation"),
            (RobotError::TorqueDiscontinuity, "controller_torque_discontinuity"),
            (RobotError::TorqueRange, "tau_J_range_violation"),
        ];
        for (error, name) in named {
            assert_eq!(name_errors(error.bit()), name);
            assert_eq!(first_error(error.bit() | 1 << 40), Some(error as u32));
        }
        assert_eq!(first_error(0), None);
        for number in 0..9 {
            assert_eq!(RobotMode::of(number).number(), number);
        }
    }
}
