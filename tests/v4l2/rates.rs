//! Every format at its rate: nothing lost, stamps that grow, pixels that are right.

use crate::capture::{CHECKERS, Capture, CaptureRequest, assert_checkers, assert_image, number_after};
use crate::guest::{self, Vivid};
use crate::usb_camera::test_image;
use crate::usb_camera::{Model, UsbCamera};
use vservo::time::SpanNs;

const TEN_SECONDS: SpanNs = SpanNs(10_000_000_000);

#[test]
#[ignore = "runs in the virtual machine: tests/vm/run.py"]
fn vivid_at_25_and_30_frames_a_second() {
    let vivid = Vivid::webcam();
    vivid.set(CHECKERS);
    // The webcam of vivid has no 30 Hz at 640x480.
    for (size, rate_hz) in [((640, 480), 25.0), ((640, 360), 30.0)] {
        for format in ["GREY", "YUYV"] {
            let mut capture = Capture::open(&vivid.capture(), CaptureRequest { format, size, rate_hz });
            capture.next();
            let mut count = 0;
            let taken = capture.run(TEN_SECONDS, |_, grey| {
                if count % 25 == 0 {
                    assert_checkers(grey, size.0);
                }
                count += 1;
            });
            taken.assert_whole(TEN_SECONDS, rate_hz);
        }
    }
}

#[test]
#[ignore = "runs in the virtual machine: tests/vm/run.py"]
fn the_usb_camera_at_25_and_30_frames_a_second() {
    guest::load_usb();
    let camera = UsbCamera::plug(&Model::default());
    for rate_hz in [25.0, 30.0] {
        for format in ["GREY", "YUYV", "MJPG"] {
            let is_jpeg = format == "MJPG";
            let request = CaptureRequest { format, size: (640, 480), rate_hz };
            let mut capture = Capture::open(&camera.node(), request);
            let (_, first) = capture.next_marked();
            let mut number = first.number;
            let taken = capture.run(TEN_SECONDS, |_, grey| {
                // Each is there and the next one; of some, every pixel is looked at.
                let marks = match number % 8 {
                    0 => assert_image(grey, request.size, is_jpeg),
                    _ => test_image::read(grey, request.size.0).expect("a whole image"),
                };
                assert_eq!(marks.number, number_after(number, is_jpeg), "{request:?}");
                number = marks.number;
            });
            taken.assert_whole(TEN_SECONDS, rate_hz);
        }
    }
}

/// The image says when it was exposed: the source's stamp differs from it by a constant.
#[test]
#[ignore = "runs in the virtual machine: tests/vm/run.py"]
fn stamps_keep_step_with_the_exposures() {
    guest::load_usb();
    let camera = UsbCamera::plug(&Model::default());
    let mut capture = Capture::open(&camera.node(), CaptureRequest { rate_hz: 30.0, ..CaptureRequest::VGA });
    // The first frames find camera and driver still at their start.
    for _ in 0..5 {
        capture.next();
    }
    let lags_us: Vec<i32> = (0..60)
        .map(|_| {
            let (captured, marks) = capture.next_marked();
            ((captured.mid.0 / 1000) as u32).wrapping_sub(marks.exposed_us) as i32
        })
        .collect();
    let mut sorted = lags_us.clone();
    sorted.sort_unstable();
    let median = sorted[sorted.len() / 2];
    assert!((0..100_000).contains(&median), "{lags_us:?}");
    // A transfer may be late once; never early.
    let near = lags_us.iter().filter(|lag| (*lag - median).abs() < 500).count();
    assert!(near >= 54 && sorted[0] > median - 500, "{lags_us:?}");
}
