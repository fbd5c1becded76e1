//! The rig itself, by the video tool of the system: what the drivers give is what the other tests take it to be.

use crate::guest::{self, Vivid, sh};
use crate::usb_camera::test_image::{self, Marks, difference};
use crate::usb_camera::{Fault, JPEGS, Model, UsbCamera};
use std::path::Path;

const WIDTH: usize = 640;
const HEIGHT: usize = 480;

/// Frames of a device, one behind the other, as the system's tool captures them.
fn captured(device: &Path, format: &str, count: usize) -> Vec<u8> {
    let file = tempfile::NamedTempFile::new().unwrap();
    let (device, to) = (device.display(), file.path().display());
    sh(&format!(
        "v4l2-ctl -d {device} --set-fmt-video=width={WIDTH},height={HEIGHT},pixelformat={format} \
         --stream-mmap --stream-count={count} --stream-to={to}"
    ));
    std::fs::read(file.path()).unwrap()
}

fn grey_of_yuyv(bytes: &[u8]) -> Vec<u8> {
    bytes.iter().step_by(2).copied().collect()
}

/// Asserts that frames are whole and that none is missing between them.
fn assert_gapless(frames: &[Vec<u8>]) {
    let marks: Vec<Marks> = frames.iter().map(|f| test_image::read(f, WIDTH).expect("an image")).collect();
    for (frame, mark) in frames.iter().zip(&marks) {
        assert_eq!(difference(frame, &test_image::draw(*mark, WIDTH, HEIGHT)), 0, "{mark:?}");
    }
    assert!(marks.windows(2).all(|w| w[1].number == w[0].number + 1), "{marks:?}");
}

#[test]
#[ignore = "runs in the virtual machine: tests/vm/run.py"]
fn vivid_shows_the_pattern_that_was_set() {
    let vivid = Vivid::webcam();
    for (pattern, level) in [(5, 16), (6, 235)] {
        vivid.set(&format!("osd_text_mode=2,test_pattern={pattern}"));
        let grey = captured(&vivid.capture(), "YUYV", 3);
        assert_eq!(grey.len(), 3 * WIDTH * HEIGHT * 2);
        let levels = grey_of_yuyv(&grey);
        assert!(levels.iter().all(|l| l.abs_diff(level) <= 1), "pattern {pattern}: {:?}", &levels[..8]);
    }
}

#[test]
#[ignore = "runs in the virtual machine: tests/vm/run.py"]
fn the_usb_camera_streams_every_format_without_loss() {
    guest::load_usb();
    for uvc in [0x0100, 0x0110] {
        let camera = UsbCamera::plug(&Model { uvc, ..Model::default() });
        let grey = captured(&camera.node(), "GREY", 30);
        let frames: Vec<Vec<u8>> = grey.chunks(WIDTH * HEIGHT).map(<[u8]>::to_vec).collect();
        assert_eq!(frames.len(), 30);
        assert_gapless(&frames);
        let yuyv = captured(&camera.node(), "YUYV", 30);
        let frames: Vec<Vec<u8>> = yuyv.chunks(WIDTH * HEIGHT * 2).map(grey_of_yuyv).collect();
        assert_gapless(&frames);
        camera.unplug();
    }
}

#[test]
#[ignore = "runs in the virtual machine: tests/vm/run.py"]
fn its_jpegs_are_its_images() {
    guest::load_usb();
    let camera = UsbCamera::plug(&Model::default());
    let bytes = captured(&camera.node(), "MJPG", 20);
    let mut starts: Vec<usize> =
        (0..bytes.len() - 2).filter(|i| bytes[*i..].starts_with(&[0xff, 0xd8, 0xff])).collect();
    starts.push(bytes.len());
    assert_eq!(starts.len(), 21);
    let mut numbers = Vec::new();
    for jpeg in starts.windows(2).map(|w| &bytes[w[0]..w[1]]) {
        let decoded = image::load_from_memory_with_format(jpeg, image::ImageFormat::Jpeg).unwrap();
        let grey = decoded.to_luma8().into_raw();
        let mark = test_image::read(&grey, WIDTH).expect("an image");
        let drawn = test_image::draw(mark, WIDTH, HEIGHT);
        let sum: u64 = grey.iter().zip(&drawn).map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
        assert!(sum < 3 * grey.len() as u64, "on average {} levels off", sum as f64 / grey.len() as f64);
        numbers.push(mark.number);
    }
    let next = |n: u16| (n + 1) % JPEGS as u16;
    assert!(numbers.windows(2).all(|w| w[1] == next(w[0])), "{numbers:?}");
}

#[test]
#[ignore = "runs in the virtual machine: tests/vm/run.py"]
fn faults_of_the_usb_camera_reach_the_driver() {
    guest::load_usb();
    let camera = UsbCamera::plug(&Model::default());
    camera.inject(&[Fault::ErrorBit, Fault::Short, Fault::Lost]);
    let grey = captured(&camera.node(), "GREY", 10);
    assert!(camera.faults_are_over());
    let numbers: Vec<u16> =
        grey.chunks(WIDTH * HEIGHT).map(|f| test_image::read(f, WIDTH).unwrap().number).collect();
    // The driver drops what is flagged or short; what was never sent nobody can tell.
    assert_eq!(numbers, (4..14).collect::<Vec<u16>>());
    let node = camera.node();
    camera.unplug();
    assert!(!node.exists());
    let again = UsbCamera::plug(&Model { serial: "0002", ..Model::default() });
    assert!(again.node().exists());
}
