//! Cameras of the kernel's video interface (V4L2): USB cameras, frame grabbers, sensors on a board.
//!
//! ```text
//! name.rs, host.rs      which device is meant, and whether it is the same as before
//! node.rs               a video node as a trait ◄── device.rs: the kernel's, by abi.rs; in tests a scripted one
//! crop, format,         what it is asked for, and what it made of that
//! controls
//! session.rs            one opening: buffers, the newest good frame, its one conversion
//! ../stamp, ../count    pure: when a frame was exposed, how many were lost, how long to pause
//! track.rs              numbers, times and rate of a stream's frames
//! camera.rs             the source: goes on, whatever happens to the device
//! listing.rs, probe.rs  what there is, and how well it does: `vservo camera --list`, `--probe`
//! ```
//! **Buffers.** Four buffers of the driver are mapped, and each frame is turned into grey from there straight into the loaned sample of
//! shared memory: one pass over its pixels, which most formats need anyway. The driver writing there by itself (USERPTR, DMABUF) would save
//! that pass for `GREY` with rows without gaps alone, some tens of microseconds for VGA; for that a loan would have to be out for every
//! queued buffer, the driver would pin other pages with every frame, as loans change their addresses, boards with contiguous DMA refuse
//! such memory, and a driver in trouble would write into what vision reads.

mod abi;
mod camera;
mod controls;
mod crop;
mod device;
mod fault;
mod format;
mod host;
mod listing;
mod mapped;
mod name;
mod node;
mod probe;
mod session;
#[cfg(test)]
mod tests;
mod track;

pub use crate::source::stamp::{StampClock, StampDoubt};
pub use camera::V4l2Camera;
pub use fault::V4l2Error;
pub use format::{OfferedFormat, OfferedSize, rates_line};
pub use listing::{ListedNode, OfferedControl, UsualCapture, list, usual};
pub use node::{
    ControlKind, ControlOffer, FormatName, FourCc, Interval, NodeInfo, NodeKind, RateOffer, SensorArea,
    SizeOffer,
};
pub use probe::{Probe, ProbeReport, SourceCheck, Spread};

use crate::config::{self, V4l2Settings};
use crate::time::SpanNs;
use std::path::PathBuf;

/// What is wanted of a camera.
#[derive(Debug, Clone, PartialEq)]
pub struct CaptureRequest {
    /// Its table in the run file.
    pub settings: V4l2Settings,
    /// Columns of the whole image, px.
    pub width: u32,
    /// Rows of it, px.
    pub height: u32,
    /// The part that is captured; all where it is `None`.
    pub region: Option<SensorArea>,
    /// Frames per second.
    pub rate_hz: f64,
    /// Length of the exposure, where the device does not say, or is told.
    pub exposure: SpanNs,
}

impl CaptureRequest {
    /// Of a camera of a run file.
    #[must_use]
    pub fn of(camera: &config::Camera, settings: &V4l2Settings) -> Self {
        let (width, height) = camera.full_size_px();
        let region = camera.roi().map(|r| SensorArea {
            left: r.x_px.cast_signed(),
            top: r.y_px.cast_signed(),
            width: r.width_px,
            height: r.height_px,
        });
        Self {
            settings: settings.clone(),
            width,
            height,
            region,
            rate_hz: camera.rate_hz,
            exposure: camera.exposure,
        }
    }
}

/// How a device is used.
#[derive(Debug, Clone, PartialEq)]
pub struct CaptureFacts {
    /// Its node.
    pub path: PathBuf,
    /// What it says of itself.
    pub info: NodeInfo,
    /// Pixel format.
    pub format: FourCc,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Rate that the device says to keep; `None` where it says nothing.
    pub rate_hz: Option<f64>,
    /// Buffers.
    pub buffers: u32,
    /// Length of the exposure.
    pub exposure: SpanNs,
    /// Whether that is the device's word.
    pub exposure_is_read: bool,
    /// Whether the device changes it by itself.
    pub exposure_is_automatic: bool,
    /// By what clock it stamps; `None` before the first frame.
    pub stamp_clock: Option<StampClock>,
    /// Whether stamps are of the start of the exposure.
    pub stamp_at_start: bool,
    /// Why its stamps are not believed.
    pub stamp_doubt: Option<StampDoubt>,
    /// Frames that were turned into grey: passes over pixels.
    pub conversions: u64,
}

/// Opens a camera of this machine, and begins to stream.
///
/// # Errors
/// [`V4l2Error`].
pub fn open(request: CaptureRequest) -> Result<V4l2Camera, V4l2Error> {
    V4l2Camera::open(Box::new(host::ThisMachine), request)
}
