//! Opening and closing for ever: nothing is left open, mapped, or taken from the driver.

use crate::capture::{Capture, CaptureRequest};
use crate::guest::{self, Vivid, sh};
use crate::usb_camera::{Model, UsbCamera};
use std::fs;
use std::path::Path;

/// What this process holds.
#[derive(Debug, PartialEq, Eq)]
struct Held {
    descriptors: usize,
    /// Mappings of video devices.
    mapped: usize,
}

fn held() -> Held {
    let mappings = fs::read_to_string("/proc/self/maps").unwrap();
    Held {
        descriptors: fs::read_dir("/proc/self/fd").unwrap().count(),
        mapped: mappings.lines().filter(|line| line.contains("/dev/video")).count(),
    }
}

/// Resident memory, kB.
fn resident() -> i64 {
    let status = fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap();
    line.split_whitespace().next().unwrap().parse().unwrap()
}

fn open_and_close(device: &Path, request: CaptureRequest<'_>, cycles: usize) {
    for _ in 0..cycles {
        let mut capture = Capture::open(device, request);
        capture.next();
    }
}

fn assert_nothing_stays(device: &Path, request: CaptureRequest<'_>) {
    open_and_close(device, request, 20);
    let (before, memory) = (held(), resident());
    assert_eq!(before.mapped, 0);
    open_and_close(device, request, 200);
    assert_eq!(held(), before);
    let grown = resident() - memory;
    assert!(grown < 1024, "{grown} kB more in 200 cycles");
    // All buffers are the driver's again: another program can have its own.
    sh(&format!("v4l2-ctl -d {} --stream-mmap=8 --stream-count=2", device.display()));
}

#[test]
#[ignore = "runs in the virtual machine: tests/vm/run.py"]
fn nothing_is_left_of_a_vivid_camera() {
    let vivid = Vivid::webcam();
    assert_nothing_stays(
        &vivid.capture(),
        CaptureRequest { size: (320, 180), rate_hz: 60.0, ..CaptureRequest::VGA },
    );
}

#[test]
#[ignore = "runs in the virtual machine: tests/vm/run.py"]
fn nothing_is_left_of_a_usb_camera() {
    guest::load_usb();
    let camera = UsbCamera::plug(&Model::default());
    assert_nothing_stays(&camera.node(), CaptureRequest { format: "YUYV", size: (320, 240), rate_hz: 30.0 });
}
