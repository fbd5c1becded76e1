//! Headers of images: that of the frames that the camera process sends, `camera/N/frame`, and that of the images that another program gives to
//! it, `camera/N/image`.

use super::layout::{named_codes, record};
use crate::time::MonoNs;
#[cfg(feature = "transport")]
use iceoryx2::prelude::ZeroCopySend;

record! {
    "vservo.FrameHeader.v2",
    /// Stamps and size of an 8-bit grey frame; the user header of a `[u8]` payload of `width_px * height_px` bytes.
    #[derive(Debug, Clone, Copy, Default, PartialEq)]
    pub struct FrameHeader {
        /// Counts the camera's exposures from 0; a gap is a frame that the camera itself lost.
        pub frame_id: u64,
        /// The source's own number of the exposure; `frame_id` where it has none.
        pub sequence: u64,
        /// Middle of the exposure.
        pub exposure: MonoNs,
        /// When the frame was sent.
        pub sent: MonoNs,
        /// Length of the exposure, ns.
        pub exposure_span_ns: u64,
        /// Exposures since the start that the camera itself lost.
        pub lost: u64,
        /// Which camera.
        pub camera: u32,
        /// Columns, px.
        pub width_px: u32,
        /// Rows, px.
        pub height_px: u32,
        /// Bits of [`frame_flag`].
        pub flags: u32,
    }
}

record! {
    "vservo.ImageHeader.v1",
    /// What an external camera says of an image; the user header of a `[u8]` payload that holds it as `format` has it.
    #[derive(Debug, Clone, Copy, Default, PartialEq)]
    pub struct ImageHeader {
        /// Counts the exposures, from any number; a gap is as many images that the program lost.
        pub sequence: u64,
        /// Middle of the exposure, `CLOCK_MONOTONIC`; 0 where the program does not know it: the arrival counts.
        pub stamp: MonoNs,
        /// Length of the exposure, ns; 0 where the program does not know it: `camera.exposure_ms`.
        pub exposure_span_ns: u64,
        /// Pixel format by its four letters, the first in the lowest byte: `GREY`, `BGR3`, `RGB3`, `YUYV`, `MJPG` and others.
        pub format: u32,
        /// Columns, px.
        pub width_px: u32,
        /// Rows, px.
        pub height_px: u32,
        /// From one line to the next, bytes; 0 where no padding lies between them.
        pub stride_bytes: u32,
        /// For later; zero.
        pub flags: u32,
        /// For later; zero.
        pub reserved: u32,
    }
}

named_codes! {
    /// Bits of [`FrameHeader::flags`] and [`super::Measurement::flags`].
    pub mod frame_flag {
        /// The source ends with this frame (replay, played once).
        pub const LAST: u32 = 1;
    }
}
