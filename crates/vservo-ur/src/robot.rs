//! What the robot says of itself, in its own numbers and in words. The numbers are those of the maker's protocol.

use crate::program::TorqueInterface;
use std::fmt;

/// Mode of the robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)] // the maker's words
pub enum RobotMode {
    NoController,
    Disconnected,
    ConfirmSafety,
    Booting,
    PowerOff,
    PowerOn,
    Idle,
    Backdrive,
    Running,
    UpdatingFirmware,
    /// A number that is not known here.
    Unknown(i32),
}

impl RobotMode {
    const ALL: [(i32, Self, &'static str, &'static str); 10] = [
        (-1, Self::NoController, "NO_CONTROLLER", "the robot has no controller"),
        (0, Self::Disconnected, "DISCONNECTED", "the arm is disconnected from its controller"),
        (1, Self::ConfirmSafety, "CONFIRM_SAFETY", "the safety configuration has to be confirmed"),
        (2, Self::Booting, "BOOTING", "the robot is booting"),
        (3, Self::PowerOff, "POWER_OFF", "the robot is powered off"),
        (4, Self::PowerOn, "POWER_ON", "the robot is powering on"),
        (5, Self::Idle, "IDLE", "the brakes are closed"),
        (6, Self::Backdrive, "BACKDRIVE", "the arm is being moved by hand (backdrive)"),
        (7, Self::Running, "RUNNING", "the robot is running"),
        (8, Self::UpdatingFirmware, "UPDATING_FIRMWARE", "the robot updates its firmware"),
    ];

    /// The mode of a number.
    #[must_use]
    pub fn of(number: i32) -> Self {
        Self::ALL.iter().find(|(n, ..)| *n == number).map_or(Self::Unknown(number), |(_, mode, ..)| *mode)
    }

    /// Its number.
    #[must_use]
    pub fn number(self) -> i32 {
        match self {
            Self::Unknown(number) => number,
            known => Self::ALL.iter().find(|(_, mode, ..)| *mode == known).map_or(-1, |(n, ..)| *n),
        }
    }

    /// The maker's word.
    #[must_use]
    pub fn word(self) -> &'static str {
        Self::ALL.iter().find(|(_, mode, ..)| *mode == self).map_or("UNKNOWN", |(_, _, word, _)| word)
    }
}

impl fmt::Display for RobotMode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match Self::ALL.iter().find(|(_, mode, ..)| mode == self) {
            Some((.., text)) => f.write_str(text),
            None => write!(f, "the robot is in the unknown mode {}", self.number()),
        }
    }
}

/// Mode of the safety system.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)] // the maker's words
pub enum SafetyMode {
    Normal,
    Reduced,
    ProtectiveStop,
    Recovery,
    SafeguardStop,
    SystemEmergencyStop,
    RobotEmergencyStop,
    Violation,
    Fault,
    ValidateJointId,
    Undefined,
    AutomaticModeSafeguardStop,
    ThreePositionEnablingStop,
    /// A number that is not known here: taken for a stop.
    Unknown(i32),
}

impl SafetyMode {
    const ALL: [(i32, Self, &'static str, &'static str); 13] = [
        (1, Self::Normal, "NORMAL", "safety is normal"),
        (2, Self::Reduced, "REDUCED", "safety is in reduced mode"),
        (3, Self::ProtectiveStop, "PROTECTIVE_STOP", "protective stop"),
        (4, Self::Recovery, "RECOVERY", "recovery mode: the arm stands outside of its safety limits"),
        (5, Self::SafeguardStop, "SAFEGUARD_STOP", "safeguard stop"),
        (6, Self::SystemEmergencyStop, "SYSTEM_EMERGENCY_STOP", "emergency stop of the system"),
        (7, Self::RobotEmergencyStop, "ROBOT_EMERGENCY_STOP", "emergency stop of the robot"),
        (8, Self::Violation, "VIOLATION", "violation of a safety limit"),
        (9, Self::Fault, "FAULT", "fault of the safety system"),
        (10, Self::ValidateJointId, "VALIDATE_JOINT_ID", "the identity of a joint has to be validated"),
        (11, Self::Undefined, "UNDEFINED_SAFETY_MODE", "the safety system is in no defined mode"),
        (
            12,
            Self::AutomaticModeSafeguardStop,
            "AUTOMATIC_MODE_SAFEGUARD_STOP",
            "safeguard stop of automatic mode",
        ),
        (
            13,
            Self::ThreePositionEnablingStop,
            "SYSTEM_THREE_POSITION_ENABLING_STOP",
            "the enabling device is not pressed",
        ),
    ];

    /// The mode of a number.
    #[must_use]
    pub fn of(number: i32) -> Self {
        Self::ALL.iter().find(|(n, ..)| *n == number).map_or(Self::Unknown(number), |(_, mode, ..)| *mode)
    }

    /// Its number.
    #[must_use]
    pub fn number(self) -> i32 {
        match self {
            Self::Unknown(number) => number,
            known => Self::ALL.iter().find(|(_, mode, ..)| *mode == known).map_or(-1, |(n, ..)| *n),
        }
    }

    /// The maker's word.
    #[must_use]
    pub fn word(self) -> &'static str {
        Self::ALL.iter().find(|(_, mode, ..)| *mode == self).map_or("UNKNOWN", |(_, _, word, _)| word)
    }

    /// Whether the arm may move.
    #[must_use]
    pub fn lets_move(self) -> bool {
        matches!(self, Self::Normal | Self::Reduced)
    }
}

impl fmt::Display for SafetyMode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match Self::ALL.iter().find(|(_, mode, ..)| mode == self) {
            Some((.., text)) => f.write_str(text),
            None => write!(f, "the safety system is in the unknown mode {}", self.number()),
        }
    }
}

/// What the controller's program does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)] // the maker's words
pub enum RuntimeState {
    Stopping,
    Stopped,
    Playing,
    Pausing,
    Paused,
    Resuming,
    /// A number that is not known here.
    Unknown(i32),
}

impl RuntimeState {
    const ALL: [(i32, Self); 6] = [
        (0, Self::Stopping),
        (1, Self::Stopped),
        (2, Self::Playing),
        (3, Self::Pausing),
        (4, Self::Paused),
        (5, Self::Resuming),
    ];

    /// The state of a number.
    #[must_use]
    pub fn of(number: i32) -> Self {
        Self::ALL.iter().find(|(n, _)| *n == number).map_or(Self::Unknown(number), |(_, state)| *state)
    }

    /// Its number.
    #[must_use]
    pub fn number(self) -> i32 {
        match self {
            Self::Unknown(number) => number,
            known => Self::ALL.iter().find(|(_, state)| *state == known).map_or(-1, |(n, _)| *n),
        }
    }
}

/// The controller's generation, which tells its rate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Series {
    /// Software 3: 125 Hz.
    Cb3,
    /// Software 5 and later: 500 Hz.
    ESeries,
}

impl Series {
    /// Cycles a second, by the maker's documentation.
    #[must_use]
    pub fn rate_hz(self) -> f64 {
        match self {
            Self::Cb3 => 125.0,
            Self::ESeries => 500.0,
        }
    }
}

/// Version of the controller's software.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Version {
    /// 3 (CB3), 5 or later (e-Series).
    pub major: u32,
    /// Minor number.
    pub minor: u32,
    /// Number of the bug fix.
    pub bugfix: u32,
    /// Number of the build.
    pub build: u32,
}

impl Version {
    /// The series of this software; none of one that is older than both.
    #[must_use]
    pub fn series(self) -> Option<Series> {
        match self.major {
            3 => Some(Series::Cb3),
            5.. => Some(Series::ESeries),
            _ => None,
        }
    }

    /// Whether the registers 24 to 47 are there: since 3.9 and 5.3, as the maker's documentation says.
    #[must_use]
    pub fn has_upper_registers(self) -> bool {
        match self.major {
            3 => self.minor >= 9,
            5 => self.minor >= 3,
            other => other > 5,
        }
    }

    /// Whether programs can tell the inertia of a payload: since 5.10, as the maker's own client has it.
    #[must_use]
    pub fn has_payload_inertia(self) -> bool {
        (self.major, self.minor) >= (5, 10)
    }

    /// How programs command torques: since 5.23 and 10.11, with shares of the friction since 5.25.1 and 10.12.1, as the maker's own client has it.
    #[must_use]
    pub fn torques(self) -> Option<TorqueInterface> {
        let is_since = |five: (u32, u32), ten: (u32, u32)| match self.major {
            5 => (self.minor, self.bugfix) >= five,
            other => other >= 10 && (other > 10 || (self.minor, self.bugfix) >= ten),
        };
        match (is_since((25, 1), (12, 1)), is_since((23, 0), (11, 0))) {
            (true, _) => Some(TorqueInterface::FrictionScales),
            (_, true) => Some(TorqueInterface::FrictionSwitch),
            _ => None,
        }
    }
}

impl fmt::Display for Version {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{}.{}.{}", self.major, self.minor, self.bugfix, self.build)
    }
}
