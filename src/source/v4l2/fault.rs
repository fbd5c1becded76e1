//! What can be wrong with a camera of the kernel's video interface: where, what, and how to mend it.

use rustix::io::Errno;
use std::path::PathBuf;
use thiserror::Error;

/// A camera cannot be used as the run file says.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum V4l2Error {
    /// No device answers to that name.
    #[error("camera.v4l2.device: there is no `{device}`; {there_is}")]
    NoDevice {
        /// What was asked for.
        device: String,
        /// What there is instead.
        there_is: String,
    },
    /// Several devices answer to that name.
    #[error(
        "camera.v4l2.device: `{device}` is the name of several cameras: {candidates}; give the path or the bus of one"
    )]
    SeveralDevices {
        /// What was asked for.
        device: String,
        /// Those.
        candidates: String,
    },
    /// The path leads to something else.
    #[error("camera.v4l2.device: {path} is {kind}, no video device; `vservo camera --list` shows those", path = path.display())]
    NotVideo {
        /// The path.
        path: PathBuf,
        /// What it is.
        kind: String,
    },
    /// The node does something else.
    #[error("camera.v4l2.device: {path} is {kind}; {remedy}", path = path.display())]
    NotCapture {
        /// The path.
        path: PathBuf,
        /// What it is.
        kind: &'static str,
        /// Where the images are.
        remedy: String,
    },
    /// The system does not let this user open it.
    #[error("{path}: permission denied{group}", path = path.display())]
    Permission {
        /// The path.
        path: PathBuf,
        /// Whose it is, and what to do.
        group: String,
    },
    /// Somebody else captures from it.
    #[error(
        "{path}: busy: another program captures from it (a browser, a video call, another run); end that one; \
         `fuser -v {path}` says who it is",
        path = path.display()
    )]
    Busy {
        /// The path.
        path: PathBuf,
    },
    /// The device has none of the formats that can be turned into grey, or not the one that is asked for.
    #[error("camera.v4l2.format: the device does not offer {requested}; it offers {offered}")]
    NoFormat {
        /// What was asked for.
        requested: String,
        /// What there is.
        offered: String,
    },
    /// The device has no images of this size.
    #[error(
        "camera.width_px, camera.height_px: the device does not offer {width}x{height}{format}; it offers {offered}"
    )]
    NoSize {
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
        /// In which format, where only one is in question.
        format: String,
        /// What there is.
        offered: String,
    },
    /// The device takes another format or size than was requested.
    #[error(
        "the device does not keep to what it is told: {tried}; set camera.width_px, camera.height_px and \
             camera.v4l2.format to what it makes of it; it offers {offered}"
    )]
    Substituted {
        /// What became of each attempt.
        tried: String,
        /// What it says to offer.
        offered: String,
    },
    /// The device gives half images.
    #[error(
        "the device gives interlaced images (field order {field}), whose rows are of two exposures: choose another \
             camera.v4l2.input or size"
    )]
    Interlaced {
        /// The kernel's number of the order.
        field: u32,
    },
    /// The device takes another rate, and that is refused.
    #[error(
        "camera.rate_hz: asked for {asked_hz} Hz, the device takes {obtained}; it offers {offered} at this size and \
             format; set one of them, or camera.v4l2.strict_rate = false"
    )]
    Rate {
        /// What was asked for.
        asked_hz: f64,
        /// What it took.
        obtained: String,
        /// What it offers.
        offered: String,
    },
    /// No control of this name.
    #[error("camera.v4l2.controls.{name}: the device has no such control; it has {offered}")]
    NoControl {
        /// What was asked for.
        name: String,
        /// What there is.
        offered: String,
    },
    /// A value that a control does not take.
    #[error("camera.v4l2.controls.{name} = {value}: {allowed}")]
    ControlValue {
        /// The control.
        name: String,
        /// What was asked for.
        value: String,
        /// What is allowed.
        allowed: String,
    },
    /// The exposure cannot be set.
    #[error(
        "camera.v4l2.set_exposure: the device has no control of the exposure time in units of time; set what it has \
             in [camera.v4l2.controls], and camera.exposure_ms to what that means"
    )]
    NoExposureControl,
    /// An exposure that the device cannot have.
    #[error("camera.exposure_ms: {asked_ms} is out of the device's range, allowed is {min_ms} to {max_ms}")]
    Exposure {
        /// What was asked for, ms.
        asked_ms: f64,
        /// Shortest, ms.
        min_ms: f64,
        /// Longest, ms.
        max_ms: f64,
    },
    /// A region that the device takes elsewhere.
    #[error("camera.roi: the device cuts {taken} instead of {asked}; set that")]
    Region {
        /// What was asked for.
        asked: String,
        /// What it takes.
        taken: String,
    },
    /// An image that the grey levels cannot be taken from.
    #[error("the device's images cannot be turned into grey: {0}")]
    Layout(String),
    /// The device went away while it was opened.
    #[error("{path}: the camera was unplugged", path = path.display())]
    Gone {
        /// The path.
        path: PathBuf,
    },
    /// Streaming needs more of a bus than is left.
    #[error("{path}: the bus has no bandwidth left for this stream: another camera on the same USB bus takes it; lower size \
             or rate, choose MJPG, or plug the camera into another port", path = path.display())]
    Bandwidth {
        /// The path.
        path: PathBuf,
    },
    /// The driver refuses a request.
    #[error("the driver refuses {what}: {cause}")]
    Refused {
        /// What was asked for.
        what: String,
        /// The system's word for it.
        cause: String,
    },
}

impl V4l2Error {
    /// Whether nothing but the driver is to blame, so that no change of a file helps.
    #[must_use]
    pub fn is_internal(&self) -> bool {
        matches!(self, Self::Refused { .. })
    }

    /// Whether the same again may succeed.
    pub(super) fn may_pass(&self) -> bool {
        matches!(self, Self::Refused { .. } | Self::Gone { .. })
    }
}

/// A request that the driver refused.
pub(super) fn refused(what: String, cause: Errno) -> V4l2Error {
    V4l2Error::Refused { what, cause: std::io::Error::from(cause).to_string() }
}

/// Whether this is the system's word for a device that is no longer there.
pub(super) fn is_gone(cause: Errno) -> bool {
    matches!(cause, Errno::NODEV | Errno::NXIO | Errno::NOENT)
}
