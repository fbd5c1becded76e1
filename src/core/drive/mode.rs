//! What a drive is commanded by.

use serde::{Deserialize, Serialize};
use std::fmt;

/// The part of a [`DriveCommand`](super::DriveCommand) that a drive obeys.
#[repr(u32)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CommandMode {
    /// `tau`: the controller closes every loop.
    Torque = 0,
    /// `qd_r`: the drive closes a velocity loop of its own.
    Velocity = 1,
    /// `q_r` and `qd_r`: the drive closes a position loop of its own.
    Position = 2,
}

impl CommandMode {
    /// All modes.
    pub const ALL: [Self; 3] = [Self::Torque, Self::Velocity, Self::Position];

    /// The word of the run file.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Torque => "torque",
            Self::Velocity => "velocity",
            Self::Position => "position",
        }
    }

    /// The mode's bit in `DriveStateMsg::modes`.
    #[must_use]
    pub fn bit(self) -> u32 {
        1 << self as u32
    }
}

impl fmt::Display for CommandMode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}
