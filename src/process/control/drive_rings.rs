//! The rings between the real-time thread and the companion that carries the messages of an external drive.

use crate::drive::DriveLink;
use crate::messages::{DriveCommandMsg, DriveStateMsg};
use rtrb::{Consumer, Producer};

/// The drive core's end of the rings.
pub(super) struct Rings {
    pub(super) states: Consumer<DriveStateMsg>,
    pub(super) commands: Producer<DriveCommandMsg>,
}

impl DriveLink for Rings {
    fn receive(&mut self) -> Option<DriveStateMsg> {
        self.states.pop().ok()
    }

    fn send(&mut self, command: &DriveCommandMsg) {
        let _ = self.commands.push(*command); // full only when the companion hangs: the drive then stops by itself
    }
}
