//! What commanded torques contain, and what a robot adds to them by itself.

use super::CommandMode;
use crate::messages::drive_flag;

/// Which of the torques that an arm needs are commanded; a robot adds the others by itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TorqueContents {
    /// What holds the arm's weight.
    pub gravity: bool,
    /// What makes up for the friction of the joints.
    pub friction: bool,
}

impl TorqueContents {
    /// All that the arm needs.
    pub const WHOLE: Self = Self { gravity: true, friction: true };

    /// Their bits of [`drive_flag`] in commands of this mode; commands without torques have none.
    #[must_use]
    pub fn flags(self, mode: CommandMode) -> u32 {
        if mode != CommandMode::Torque {
            return 0;
        }
        let gravity = if self.gravity { drive_flag::GRAVITY } else { 0 };
        gravity | if self.friction { drive_flag::FRICTION } else { 0 }
    }
}

impl Default for TorqueContents {
    fn default() -> Self {
        Self::WHOLE
    }
}
