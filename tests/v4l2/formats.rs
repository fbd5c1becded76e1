//! The other formats that vivid has, by both of the kernel's interfaces: the same grey image from each.

use crate::capture::{CHECKERS, Capture, CaptureRequest, assert_checkers};
use crate::guest::{Vivid, sh};

const FORMATS: [&str; 7] = ["GREY", "Y10", "Y12", "Y16", "YUYV", "UYVY", "NV12"];

#[test]
#[ignore = "runs in the virtual machine: tests/vm/run.py"]
fn every_format_gives_the_same_image() {
    for multiplanar in [1, 2] {
        let vivid =
            Vivid::load(&format!("node_types=0x1 num_inputs=1 input_types=0 multiplanar={multiplanar}"));
        let has = sh(&format!("v4l2-ctl -d {} --list-formats", vivid.capture().display()));
        for format in FORMATS {
            assert!(has.contains(&format!("'{format:<4}'")), "{format}: {has}");
            let mut capture =
                Capture::open(&vivid.capture(), CaptureRequest { format, ..CaptureRequest::VGA });
            vivid.set(CHECKERS);
            capture.next();
            capture.next();
            capture.next();
            assert_checkers(&capture.grey, capture.width);
        }
        // A ramp of grey, with all of its levels in every format.
        vivid.set("quantization=1,osd_text_mode=2,test_pattern=20");
        let ramp = |format| {
            let mut capture =
                Capture::open(&vivid.capture(), CaptureRequest { format, ..CaptureRequest::VGA });
            capture.next();
            capture.grey
        };
        let grey = ramp("GREY");
        assert!(
            grey[..640].windows(2).all(|w| w[0] <= w[1]) && grey[639] - grey[0] > 200,
            "{:?}",
            &grey[..640]
        );
        for format in &FORMATS[1..] {
            let other = ramp(*format);
            let off = grey.iter().zip(&other).map(|(a, b)| a.abs_diff(*b)).max().unwrap();
            assert!(off <= 1, "{format}: {off} levels off");
        }
    }
}
