//! State and counters of a real camera: `camera/N/health`.

use super::layout::{named_codes, record};
use crate::time::MonoNs;
#[cfg(feature = "transport")]
use iceoryx2::prelude::ZeroCopySend;

/// State of a camera's stream.
#[repr(u32)]
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash)]
pub enum CameraState {
    /// Unknown: a simulated camera, or one that has sent no record.
    #[default]
    Unknown = 0,
    /// The stream is on, and no frame has arrived yet.
    Starting = 1,
    /// Frames arrive.
    Streaming = 2,
    /// The stream is on, but no frames arrive any more.
    Stalled = 3,
    /// The stream failed and is restarted.
    Recovering = 4,
    /// The device was unplugged; its return is awaited.
    Gone = 5,
}

impl CameraState {
    /// The state of a code in a message.
    #[must_use]
    pub fn from_code(code: u32) -> Self {
        match code {
            1 => Self::Starting,
            2 => Self::Streaming,
            3 => Self::Stalled,
            4 => Self::Recovering,
            5 => Self::Gone,
            _ => Self::Unknown,
        }
    }

    /// Its name for messages.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Unknown => "unknown",
            Self::Starting => "starting",
            Self::Streaming => "streaming",
            Self::Stalled => "stalled",
            Self::Recovering => "recovering",
            Self::Gone => "unplugged",
        }
    }

    /// Whether the camera process itself knows that no frames can be expected.
    #[must_use]
    pub fn is_away(self) -> bool {
        matches!(self, Self::Stalled | Self::Recovering | Self::Gone)
    }
}

named_codes! {
    /// Bits of [`CameraHealth::flags`].
    pub mod health_flag {
        /// The device's stamps are implausible: frames are stamped by their arrival.
        pub const STAMPS_DOUBTED: u32 = 1;
        /// The device delivers another frame rate than requested.
        pub const RATE_MISSED: u32 = 2;
    }
}

record! {
    "vservo.CameraHealth.v1",
    /// State and counters of a real camera, sent at each change and a few times a second.
    #[derive(Debug, Clone, Copy, Default, PartialEq)]
    pub struct CameraHealth {
        /// Counts what its sender has sent, from 0: a gap is a record that was lost on the way.
        pub sequence: u64,
        /// When the record was sent.
        pub stamp: MonoNs,
        /// Time of the last change of the state.
        pub since: MonoNs,
        /// Frames handed over.
        pub frames: u64,
        /// Frames lost, for whatever reason.
        pub lost: u64,
        /// Of these: damaged.
        pub corrupt: u64,
        /// Of these: replaced by a newer frame that had arrived too.
        pub superseded: u64,
        /// Of these: without a usable stamp.
        pub undated: u64,
        /// How often the device was opened again, after it was unplugged or failed.
        pub reopened: u64,
        /// How often its stream was restarted.
        pub restarted: u64,
        /// Frames whose stamps lay in the future.
        pub stamps_clamped: u64,
        /// Frames per second that the device really exposes; NaN while unknown.
        pub rate_hz: f64,
        /// Code of a [`CameraState`].
        pub state: u32,
        /// Which camera.
        pub camera: u32,
        /// Bits of [`health_flag`].
        pub flags: u32,
        /// For later; zero.
        pub reserved: u32,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::mem::{align_of, offset_of, size_of};

    #[test]
    #[allow(unsafe_code)]
    fn the_layout_is_fixed_and_named() {
        assert_eq!((size_of::<CameraHealth>(), align_of::<CameraHealth>()), (112, 8));
        assert_eq!((offset_of!(CameraHealth, rate_hz), offset_of!(CameraHealth, state)), (88, 96));
        // SAFETY: the name is only read.
        assert_eq!(unsafe { CameraHealth::type_name() }, "vservo.CameraHealth.v1");
    }

    #[test]
    fn codes_survive_the_message() {
        for code in 0..8 {
            let state = CameraState::from_code(code);
            assert!(state as u32 == code || (state == CameraState::Unknown && code > 5));
        }
        assert!(!CameraState::Streaming.is_away() && !CameraState::Starting.is_away());
    }
}
