//! How large frames are, and what a run takes of shared memory with them and beside them.

use super::channel::Channel;

/// Most readers of a service. Chosen by hand: the next process, a recorder, a black box, a view, and one to spare. Each one more needs buffers of its own.
pub(super) const MAX_READERS: usize = 5;
/// The same of the joint states, which two cameras and the vision of each may take.
const JOINT_STATE_READERS: usize = MAX_READERS + 2;
/// Upper bound of what transport and header add to a frame, bytes. Chosen by hand: the header has 64, and of a VGA frame all of it is less than two
/// thousandths.
const FRAME_OVERHEAD_BYTES: u64 = 512;
/// Shared memory of all services of a run that carry no frames, bytes. Measured: 18.3 MB of measurements, 4.2 MB of traces and 3.5 MB of joint states,
/// 2.6 MB for an external drive, each with room for every reader, and the connections.
pub const SPACE_BESIDE_FRAMES_BYTES: u64 = 29 << 20;
/// The same of the measurements of a second vision. Measured with those of the first.
pub const SPACE_OF_MEASUREMENTS_BYTES: u64 = 19 << 20;

/// Most readers of the records of `service`.
pub(super) fn readers(service: Channel) -> usize {
    if service == Channel::JointState { JOINT_STATE_READERS } else { MAX_READERS }
}

/// How large frames are, and how many of them may be in flight.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FrameShape {
    /// Bytes of one frame.
    pub bytes: usize,
    /// Frames that wait for vision: 1 in real time (the newest), more in lockstep.
    pub in_flight: usize,
    /// Frames that wait for a recorder.
    pub recorded: usize,
    /// Frames that the camera may hold back at once, exposed but not yet due.
    pub held_back: usize,
}

impl FrameShape {
    /// Frames that may wait for a reader at most.
    pub(super) fn buffer(&self) -> usize {
        self.in_flight.max(self.recorded)
    }

    /// What the frames of one camera take in shared memory, bytes: all that may be waiting, read or filled at once.
    #[must_use]
    pub fn space_bytes(&self) -> u64 {
        let frames = MAX_READERS * (self.buffer() + 1) + self.held_back + 1;
        (frames as u64).saturating_mul(self.bytes as u64 + FRAME_OVERHEAD_BYTES)
    }
}
