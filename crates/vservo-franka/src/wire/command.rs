//! A command of one cycle.

use super::{Reader, WireError, Writer};
use crate::{JOINTS, Joints};

/// Bytes of a command.
pub const ROBOT_COMMAND_SIZE: usize = 371;

/// What the robot shall do in a cycle. Which of the values it uses is what the motion was begun with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RobotCommand {
    /// The number of the state that it answers.
    pub message_id: u64,
    /// Positions of the joints, rad.
    pub q_c: Joints,
    /// Velocities of the joints, rad/s.
    pub dq_c: Joints,
    /// The motion ends with this command.
    pub motion_finished: bool,
    /// Torques of the joints without gravity, which the robot adds, N m.
    pub tau_c: Joints,
    /// The torques end with this command.
    pub torque_finished: bool,
}

impl RobotCommand {
    /// A command without values.
    #[must_use]
    pub fn new(message_id: u64) -> Self {
        let zero = [0.0; JOINTS];
        Self {
            message_id,
            q_c: zero,
            dq_c: zero,
            motion_finished: false,
            tau_c: zero,
            torque_finished: false,
        }
    }

    /// As bytes. What belongs to Cartesian motions is zero.
    #[must_use]
    pub fn encode(&self) -> [u8; ROBOT_COMMAND_SIZE] {
        let mut bytes = [0; ROBOT_COMMAND_SIZE];
        let mut writer = Writer::new(&mut bytes);
        writer.put(&self.message_id.to_le_bytes());
        writer.f64s(&self.q_c);
        writer.f64s(&self.dq_c);
        // Pose (16), twist (6) and elbow (2), and whether the elbow counts.
        writer.f64s(&[0.0; 24]);
        writer.put(&[0, u8::from(self.motion_finished)]);
        writer.f64s(&self.tau_c);
        writer.put(&[u8::from(self.torque_finished)]);
        bytes
    }

    /// From bytes.
    ///
    /// # Errors
    /// When they are not as many as a command has.
    pub fn decode(bytes: &[u8]) -> Result<Self, WireError> {
        if bytes.len() != ROBOT_COMMAND_SIZE {
            return Err(WireError::Size { size: u32::try_from(bytes.len()).unwrap_or(u32::MAX) });
        }
        let mut reader = Reader::new(bytes);
        let message_id = u64::from_le_bytes(reader.take("number")?);
        let q_c = reader.f64s("positions")?;
        let dq_c = reader.f64s("velocities")?;
        let _: [f64; 24] = reader.f64s("Cartesian values")?;
        let [_, motion_finished] = reader.take("flags")?;
        let tau_c = reader.f64s("torques")?;
        let torque_finished = reader.u8("flag")? != 0;
        Ok(Self { message_id, q_c, dq_c, motion_finished: motion_finished != 0, tau_c, torque_finished })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Places as `offsetof` tells them for the maker's structures (version 10, gcc 12, packed by one).
    #[test]
    fn places_are_those_of_the_makers_structures() {
        let mut command = RobotCommand::new(7);
        (command.q_c[0], command.dq_c[0], command.tau_c[0]) = (1.0, 2.0, 3.0);
        (command.motion_finished, command.torque_finished) = (true, true);
        let bytes = command.encode();
        let number = |at: usize| f64::from_le_bytes(bytes[at..at + 8].try_into().unwrap());
        assert_eq!((number(8), number(8 + 56), number(314)), (1.0, 2.0, 3.0));
        assert_eq!((bytes[0], bytes[8 + 304], bytes[8 + 305], bytes[314 + 56]), (7, 0, 1, 1));
        assert_eq!(bytes.len(), 371);
        assert_eq!(RobotCommand::decode(&bytes), Ok(command));
        assert!(RobotCommand::decode(&bytes[1..]).is_err());
    }
}
