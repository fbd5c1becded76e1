//! A USB camera that is pulled out, put back, exchanged, or sends what is wrong.

use crate::capture::{Capture, CaptureRequest, assert_image, config, run_file};
use crate::guest;
use crate::usb_camera::test_image;
use crate::usb_camera::{Fault, Model, UsbCamera};
use std::path::Path;
use std::time::Duration;
use vservo::config::Config;
use vservo::messages::CameraState;
use vservo::time::SpanNs;

const SECOND: SpanNs = SpanNs(1_000_000_000);
const AT_30: CaptureRequest<'_> = CaptureRequest { rate_hz: 30.0, ..CaptureRequest::VGA };

fn assert_streams(capture: &mut Capture, count: usize) {
    for _ in 0..count {
        capture.next();
        assert_image(&capture.grey, AT_30.size, false);
    }
}

#[test]
#[ignore = "runs in the virtual machine: tests/vm/run.py"]
fn unplugged_and_plugged_in_again_it_goes_on() {
    guest::load_usb();
    let mut camera = UsbCamera::plug(&Model::default());
    let by_path = camera.node().to_str().unwrap().to_owned();
    for device in [&by_path, "Emulated Camera"] {
        let text = run_file(device, AT_30, "");
        let config = Config::parse("cell.toml", &text, Path::new("."), &[]).unwrap();
        let mut capture = Capture::with(&config).unwrap();
        let mut last = capture.next();
        for _ in 0..2 {
            assert_streams(&mut capture, 5);
            camera.unplug();
            while capture.within(SpanNs(SECOND.0 / 2)).is_some() {}
            assert_eq!(capture.within(SECOND), None);
            assert_eq!(capture.health().state, CameraState::Gone);
            camera = UsbCamera::plug(&Model::default());
            let next = capture.next();
            assert!(next.sequence > last.sequence && next.mid > last.mid, "{last:?}, {next:?}");
            last = next;
            assert_streams(&mut capture, 5);
        }
        assert_eq!((capture.health().reopened, capture.health().state), (2, CameraState::Streaming));
    }
}

#[test]
#[ignore = "runs in the virtual machine: tests/vm/run.py"]
fn another_camera_in_its_place_is_not_taken_for_it() {
    guest::load_usb();
    let ours = Model::default();
    let camera = UsbCamera::plug(&ours);
    let node = camera.node();
    let mut capture = Capture::with(&config(&node, AT_30, "")).unwrap();
    assert_streams(&mut capture, 5);
    camera.unplug();
    let others = [
        Model { serial: "0002", ..ours.clone() },
        Model { name: "Another Camera", serial: "0003", product: 2, ..ours.clone() },
    ];
    for other in others {
        // What was on its way.
        while capture.within(SpanNs(SECOND.0 / 2)).is_some() {}
        let stranger = UsbCamera::plug(&other);
        if stranger.node() != node {
            // The number is taken as long as somebody has the old device open.
            assert_eq!(capture.within(SpanNs(2 * SECOND.0)), None);
        }
        assert_eq!(capture.within(SpanNs(3 * SECOND.0)), None, "{other:?}");
        assert_eq!(stranger.streams(), None);
        stranger.unplug();
    }
    let _camera = UsbCamera::plug(&ours);
    assert_streams(&mut capture, 10);
}

#[test]
#[ignore = "runs in the virtual machine: tests/vm/run.py"]
fn what_it_sends_wrong_is_never_shown() {
    guest::load_usb();
    let camera = UsbCamera::plug(&Model::default());
    // The driver keeps bad frames to itself; with `nodrop` it hands them over, flagged.
    for nodrop in [0, 1] {
        guest::sh(&format!("echo {nodrop} >/sys/module/uvcvideo/parameters/nodrop"));
        let mut capture = Capture::open(&camera.node(), AT_30);
        let (first, first_marks) = capture.next_marked();
        assert_streams(&mut capture, 5);
        camera.inject(&[Fault::ErrorBit, Fault::Short, Fault::ErrorBit]);
        let mut last = (first, first_marks);
        for _ in 0..30 {
            last = capture.next_marked();
            assert_image(&capture.grey, AT_30.size, false);
        }
        assert!(camera.faults_are_over());
        let exposed = u64::from(last.1.number.wrapping_sub(first_marks.number));
        assert_eq!(exposed, 38, "nodrop {nodrop}: 35 frames and 3 bad ones");
        let lost = last.0.sequence - first.sequence - 35 + last.0.lost - first.lost;
        assert_eq!(lost, 3, "nodrop {nodrop}: {first:?} {last:?}");
    }
    guest::sh("echo 0 >/sys/module/uvcvideo/parameters/nodrop");
}

#[test]
#[ignore = "runs in the virtual machine: tests/vm/run.py"]
fn half_a_jpeg_is_not_shown() {
    guest::load_usb();
    let camera = UsbCamera::plug(&Model::default());
    let request = CaptureRequest { format: "MJPG", ..AT_30 };
    let mut capture = Capture::open(&camera.node(), request);
    let first = capture.next();
    camera.inject(&[Fault::Short]);
    let mut last = first;
    for _ in 0..15 {
        last = capture.next();
        assert_image(&capture.grey, request.size, true);
    }
    assert!(camera.faults_are_over());
    assert_eq!(last.sequence - first.sequence - 15 + last.lost - first.lost, 1, "{last:?}");
}

#[test]
#[ignore = "runs in the virtual machine: tests/vm/run.py"]
fn a_stall_and_frames_that_never_come_pass() {
    guest::load_usb();
    let camera = UsbCamera::plug(&Model::default());
    let mut capture = Capture::open(&camera.node(), AT_30);
    assert_streams(&mut capture, 5);
    camera.inject(&[Fault::Lost, Fault::Lost]);
    assert_streams(&mut capture, 10);
    camera.inject(&[Fault::Stall(Duration::from_secs(2))]);
    while capture.within(SpanNs(SECOND.0 / 4)).is_some() {}
    assert!(capture.within(SECOND).is_none());
    assert_streams(&mut capture, 10);
    assert!(test_image::read(&capture.grey, capture.width).is_some());
}
