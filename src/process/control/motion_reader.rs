//! The motion of a recorded arm, for a drive: the joint states of a recording, one after the other, with what its drive told of the robot.

use crate::drive::{NextState, RecordedMotion, RobotReport};
use crate::messages::{DriveStateMsg, JointState, RobotState};
use crate::record::RecordingReader;
use crate::replay::ReplayError;
use std::io::Read;
use tracing::warn;

/// Reads the joint states of a recording.
pub(super) struct MotionReader<R: Read> {
    reader: RecordingReader<R>,
    ahead: Option<(JointState, RobotReport)>,
    robot: RobotReport,
}

impl<R: Read> MotionReader<R> {
    /// Of a recording from whose messages nothing was taken yet; `None` where it has no joint state.
    pub(super) fn new(reader: RecordingReader<R>) -> Result<Option<Self>, ReplayError> {
        let mut motion = Self { reader, ahead: None, robot: RobotReport::default() };
        motion.ahead = motion.read()?;
        Ok(motion.ahead.is_some().then_some(motion))
    }

    /// The number of joints.
    pub(super) fn joints(&self) -> u32 {
        self.ahead.as_ref().map_or(0, |(state, _)| state.joints)
    }

    fn read(&mut self) -> Result<Option<(JointState, RobotReport)>, ReplayError> {
        while let Some(message) = self.reader.next_message()? {
            match message.topic() {
                "/drive/state" => {
                    let told: DriveStateMsg = message.record()?;
                    let state = RobotState::from_code(told.robot_state);
                    self.robot = RobotReport { state, code: told.robot_code };
                }
                "/control/joint_state" => return Ok(Some((message.record()?, self.robot))),
                _ => {}
            }
        }
        Ok(None)
    }
}

impl<R: Read + Send> RecordedMotion for MotionReader<R> {
    fn next_state(&mut self) -> NextState {
        let Some((state, robot)) = self.ahead.take() else { return NextState::Over };
        self.ahead = self.read().unwrap_or_else(|error| {
            warn!("the arm's recording cannot be read any further, its motion ends there: {error}");
            None
        });
        NextState::State(state, robot)
    }
}
