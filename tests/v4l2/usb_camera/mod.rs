//! A USB camera without a camera: threads of the test speak USB/IP to the kernel's virtual host controller (vhci-hcd), which finds
//! a video class device at its port and gives it to the real uvcvideo driver.
//!
//! ```text
//! uvcvideo ── vhci-hcd ── socket ──► control thread: answers questions, keeps transfers that wait for data
//!                            ▲                 │
//!                            └──── stream thread: an image at every interval, in transfers of 16 KiB
//! ```
//! It can be unplugged, stall, lose frames, cut them short or flag them as wrong, on demand.

mod controls;
mod descriptors;
mod stream;
pub mod test_image;
mod usbip;

pub use descriptors::{Model, Stream};
pub use stream::JPEGS;
pub use usbip::Plug;

use controls::Controls;
use std::collections::VecDeque;
use std::fs;
use std::path::PathBuf;
use std::sync::{Condvar, Mutex, MutexGuard};
use std::time::Duration;

/// What the camera does wrong with one frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Fault {
    /// Its transfers are flagged as erroneous.
    ErrorBit,
    /// Only its first half is sent.
    Short,
    /// It is not sent at all, and nothing tells of it: the number in the image goes on.
    Lost,
    /// Nothing is sent for so long.
    Stall(Duration),
}

/// What the threads of a camera share.
struct Device {
    model: Model,
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    /// Transfers of the stream that the kernel has prepared, by their sequence numbers.
    transfers: VecDeque<u32>,
    negotiated: Stream,
    streaming: bool,
    /// Counts starts of the stream.
    session: u64,
    unplugged: bool,
    controls: Controls,
    /// One for each of the next frames.
    faults: VecDeque<Fault>,
    /// Frames exposed since the camera was plugged in.
    exposed: u64,
}

impl Device {
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap()
    }
}

/// A camera that is plugged in until it is dropped.
pub struct UsbCamera(Plug);

impl UsbCamera {
    /// Plugs it in at the first free port, and waits until there is a capture device.
    pub fn plug(model: &Model) -> Self {
        let camera = Self(Plug::connect(model.clone()));
        crate::common::wait_until("the USB camera's device", || camera.find_node().is_some());
        camera
    }

    /// Its capture device.
    pub fn node(&self) -> PathBuf {
        self.find_node().expect("the camera is plugged in")
    }

    fn find_node(&self) -> Option<PathBuf> {
        let attribute = |entry: &fs::DirEntry, name: &str| {
            Some(fs::read_to_string(entry.path().join(name)).ok()?.trim().to_owned())
        };
        let mut found = None;
        for entry in fs::read_dir("/sys/class/video4linux").ok()?.flatten() {
            // The driver makes a second device for metadata, with index 1. Above them is the interface, then the camera.
            let captures = attribute(&entry, "index").as_deref() == Some("0");
            let serial = attribute(&entry, "device/../serial");
            if captures && serial.as_deref() == Some(self.0.device().model.serial) {
                let node = PathBuf::from("/dev").join(entry.file_name());
                found = node.exists().then_some(node);
            }
        }
        found
    }

    /// Makes the next frames wrong, one each.
    pub fn inject(&self, faults: &[Fault]) {
        self.0.device().state().faults.extend(faults);
    }

    /// Whether all that was injected has happened.
    pub fn faults_are_over(&self) -> bool {
        self.0.device().state().faults.is_empty()
    }

    /// What it streams at present.
    pub fn streams(&self) -> Option<Stream> {
        let state = self.0.device().state();
        state.streaming.then_some(state.negotiated)
    }

    /// Frames exposed since it was plugged in.
    pub fn exposed(&self) -> u64 {
        self.0.device().state().exposed
    }

    /// Length of its exposure at present, us.
    pub fn exposure_us(&self) -> u32 {
        100 * self.0.device().state().controls.exposure()
    }

    /// Pulls the plug, and waits until the kernel has taken the device away.
    pub fn unplug(self) {
        let node = self.node();
        drop(self);
        crate::common::wait_until("the USB camera's device to vanish", || !node.exists());
    }
}
