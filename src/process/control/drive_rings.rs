//! The rings between the real-time thread and the companion that carries the messages of an external drive.

use crate::drive::DriveLink;
use crate::messages::{DriveCommandMsg, DriveStateMsg};
use rtrb::{Consumer, Producer};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Messages that were dropped because a ring was full. They are counted there and reported at the end of the run.
#[derive(Debug, Clone, Default)]
pub(super) struct Lost(Arc<AtomicU64>);

impl Lost {
    pub(super) fn note(&self) {
        self.0.fetch_add(1, Ordering::Relaxed);
    }

    pub(super) fn count(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}

/// The drive core's end of the rings.
pub(super) struct Rings {
    pub(super) states: Consumer<DriveStateMsg>,
    pub(super) commands: Producer<DriveCommandMsg>,
    pub(super) lost_commands: Lost,
}

impl DriveLink for Rings {
    fn receive(&mut self) -> Option<DriveStateMsg> {
        self.states.pop().ok()
    }

    fn send(&mut self, command: &DriveCommandMsg) {
        // Full only when the companion hangs: the drive then stops by itself.
        if self.commands.push(*command).is_err() {
            self.lost_commands.note();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rtrb::RingBuffer;

    #[test]
    fn commands_that_find_no_room_are_counted() {
        let (_, states) = RingBuffer::new(1);
        let (commands, mut to_send) = RingBuffer::new(2);
        let lost = Lost::default();
        let mut rings = Rings { states, commands, lost_commands: lost.clone() };
        for tick in 0..5 {
            rings.send(&DriveCommandMsg { tick, ..DriveCommandMsg::default() });
        }
        assert_eq!(lost.count(), 3);
        assert_eq!([to_send.pop().unwrap().tick, to_send.pop().unwrap().tick], [0, 1]);
        rings.send(&DriveCommandMsg::default());
        assert_eq!(lost.count(), 3, "there is room again");
    }
}
