//! A part of the sensor (`[camera.roi]`): the same pixels as in the whole image, whoever cuts it.

use crate::capture::{Capture, CaptureRequest, config};
use crate::guest::{Vivid, sh};
use std::path::Path;

/// Columns and rows of a region: first column, first row, width, height.
type Region = [usize; 4];

/// A still image with every level, whole and by regions.
fn assert_regions(device: &Path, request: CaptureRequest<'_>, regions: &[Region]) {
    let whole = {
        let mut capture = Capture::open(device, request);
        capture.next();
        capture.grey
    };
    let (columns, _) = request.size;
    for &[x, y, width, height] in regions {
        let roi = format!(
            "[camera.roi]\nx_px = {x}\ny_px = {y}\nwidth_px = {width}\nheight_px = {height}\n\
             [servo.desired]\nposition_m = [-0.05, -0.05, 1.2]"
        );
        let config = config(device, request, &roi);
        let mut capture = Capture::with(&config).unwrap();
        capture.next();
        assert_eq!((capture.width, capture.grey.len()), (width, width * height));
        for (row, line) in capture.grey.chunks(width).enumerate() {
            let from = (y + row) * columns + x;
            assert_eq!(line, &whole[from..from + width], "{request:?} {x} {y} {width} {height}: row {row}");
        }
    }
}

#[test]
#[ignore = "runs in the virtual machine: tests/vm/run.py"]
fn a_device_that_cannot_cut_is_cut_on_the_way_to_grey() {
    let vivid = Vivid::webcam();
    vivid.set("quantization=1,osd_text_mode=2,test_pattern=20");
    // The last one is odd, begins within a pair of pixels, and ends with the last column.
    let regions = [[0, 0, 640, 480], [32, 20, 560, 430], [31, 17, 609, 463]];
    for format in ["GREY", "YUYV", "UYVY", "Y16", "NV12"] {
        assert_regions(&vivid.capture(), CaptureRequest { format, ..CaptureRequest::VGA }, &regions);
    }
}

#[test]
#[ignore = "runs in the virtual machine: tests/vm/run.py"]
fn a_device_that_can_cut_does() {
    let vivid = Vivid::load("node_types=0x1 num_inputs=1 input_types=3");
    let device = vivid.capture();
    let tool = |what: &str| sh(&format!("v4l2-ctl -d {} {what}", device.display()));
    tool("--set-dv-bt-timings cvt,width=640,height=480,fps=60");
    vivid.set("quantization=1,osd_text_mode=2,test_pattern=20");
    let request = CaptureRequest { rate_hz: 60.0, ..CaptureRequest::VGA };
    assert_regions(&device, request, &[[32, 20, 560, 432]]);
    let area = tool("--get-selection target=crop");
    assert!(area.contains("Left 32, Top 20, Width 560, Height 432"), "{area}");
    // Without a region all of it is read again, whatever somebody cut before.
    Capture::open(&device, request).next();
    let area = tool("--get-selection target=crop");
    assert!(area.contains("Left 0, Top 0, Width 640, Height 480"), "{area}");
}
