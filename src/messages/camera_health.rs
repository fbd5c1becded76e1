//! How a real camera stands: `camera/N/health`.

use crate::time::MonoNs;
#[cfg(feature = "transport")]
use iceoryx2::prelude::ZeroCopySend;

/// What a camera is doing.
#[repr(u32)]
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash)]
pub enum CameraState {
    /// Nobody says: a simulated camera, or one that was never heard of.
    #[default]
    Unknown = 0,
    /// It streams, and no frame has come yet.
    Starting = 1,
    /// Frames come.
    Streaming = 2,
    /// It streams, and no frame comes.
    Stalled = 3,
    /// Its stream failed and is begun anew.
    Recovering = 4,
    /// It was unplugged; it is looked for.
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

    /// A word for people.
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

    /// Whether no frames can be expected, and the camera's own process knows it.
    #[must_use]
    pub fn is_away(self) -> bool {
        matches!(self, Self::Stalled | Self::Recovering | Self::Gone)
    }
}

/// Bits of [`CameraHealth::flags`].
pub mod health_flag {
    /// The device's stamps are not believed: frames are dated by their arrival.
    pub const STAMPS_DOUBTED: u32 = 1;
    /// The device gives another rate than it was asked for.
    pub const RATE_MISSED: u32 = 2;
}

/// How a real camera stands; said at each change, and a few times a second.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq)]
#[cfg_attr(feature = "transport", derive(ZeroCopySend), type_name("vservo.CameraHealth.v1"))]
pub struct CameraHealth {
    /// Counts what its sender has sent, from 0: a gap is a record that was lost on the way.
    pub sequence: u64,
    /// When it was said.
    pub stamp: MonoNs,
    /// Since when the state is what it is.
    pub since: MonoNs,
    /// Frames handed over.
    pub frames: u64,
    /// Frames lost, for whatever reason.
    pub lost: u64,
    /// Among these: damaged.
    pub corrupt: u64,
    /// Among these: older than another one that was there too.
    pub superseded: u64,
    /// Among these: of unknown time.
    pub undated: u64,
    /// How often the camera was found again after it was unplugged, or opened anew.
    pub reopened: u64,
    /// How often its stream was begun anew.
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
