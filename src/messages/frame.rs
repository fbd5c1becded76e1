//! Header that a camera sends with each image: `camera/N/frame`.

use super::layout::record;
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

/// Bits of [`FrameHeader::flags`] and [`super::Measurement::flags`].
pub mod frame_flag {
    /// The source ends with this frame (replay, played once).
    pub const LAST: u32 = 1;
}
