//! What can be said about real cameras where there is none: arguments, run files, messages, exit codes. What they do on real drivers is
//! in `tests/v4l2`.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // helpers of tests are tests

use crate::common::{Instance, vservo};
use std::path::Path;
use std::process::Output;
use vservo::config::{Config, ControlValue, Source};
use vservo::imaging::grey::PixelFormat;
use vservo::ipc::Services;
use vservo::messages::{CameraHealth, CameraId, CameraState};

const CELL: &str = "
[camera]
source = 'v4l2'
width_px = 1280
height_px = 960
rate_hz = 60.0
roi = { x_px = 320, y_px = 240, width_px = 640, height_px = 480 }

[camera.v4l2]
device = 'usb-0000:00:14.0-99'
format = 'YUYV'
shutter = 'global'
controls = { gain = 10, auto_exposure = 'Manual Mode', backlight = true }
";

fn parse(text: &str) -> Result<Config, String> {
    Config::parse("cell.toml", text, Path::new("."), &[]).map_err(|e| e.to_string())
}

fn asked(arguments: &[&str]) -> (Output, String) {
    let output = vservo().args(arguments).output().unwrap();
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!text.contains("panicked"), "{text}");
    (output, text)
}

#[test]
fn a_run_file_says_all_of_a_real_camera_and_reads_back() {
    let config = parse(CELL).unwrap();
    // Lens and mount are to be calibrated.
    let keys: Vec<_> = config.warnings.iter().map(|w| w.key.as_str()).collect();
    assert_eq!(keys, ["camera.lens", "camera.mount"], "{:?}", config.warnings);
    assert!(
        config.scene.is_none() && config.closes_the_loop(),
        "a real one closes the loop without a known truth"
    );
    let Source::V4l2(settings) = &config.camera.source else { panic!("the source is V4L2") };
    assert_eq!((settings.format, settings.buffers), (Some(PixelFormat::Yuyv), 4));
    assert_eq!(settings.controls["auto_exposure"], ControlValue::Entry("Manual Mode".into()));
    assert_eq!(settings.controls["backlight"], ControlValue::Switch(true));
    assert_eq!((config.camera.full_size_px(), config.camera.roi().unwrap().x_px), ((1280, 960), 320));
    let again = parse(&config.to_toml().unwrap()).unwrap();
    assert_eq!(again.effective, config.effective);
}

#[test]
fn what_is_wrong_with_its_table_is_told_at_its_key() {
    for (from, to, words) in [
        ("device = 'usb-0000:00:14.0-99'\n", "", "camera.v4l2.device: is missing"),
        ("'YUYV'", "'H264'", "camera.v4l2.format: unknown variant `H264`, expected one of `GREY`, `Y10`"),
        (
            "gain = 10",
            "gain = 1.5",
            "controls.gain: invalid type: floating point `1.5`, expected a whole number",
        ),
        ("shutter = 'global'", "buffers = 1", "camera.v4l2.buffers: 1 is out of range, allowed is 2 to 32"),
        ("shutter = 'global'", "give_up_s = 0.0", "camera.v4l2.give_up_s: 0 is out of range"),
        ("shutter = 'global'", "readout_ms = -1.0", "camera.v4l2.readout_ms: -1 is out of range"),
        ("shutter = 'global'", "shuter = 'global'", "camera.v4l2.shuter: unknown field"),
        ("[camera]\n", "[run]\nclock = 'lockstep'\n[camera]\n", "run.clock: is `lockstep`"),
    ] {
        let text = CELL.replacen(from, to, 1);
        assert_ne!(text, CELL);
        let error = parse(&text).unwrap_err();
        assert!(error.contains(words), "{words}: {error}");
    }
}

/// The device of the file does not exist: checking it opens nothing.
#[test]
fn check_opens_no_device_and_camera_reports_it_missing() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cell.toml");
    std::fs::write(&path, CELL).unwrap();
    let file = path.to_str().unwrap();
    let (checked, error) = asked(&["check", file]);
    assert_eq!(checked.status.code(), Some(0), "{error}");
    let instance = Instance::new("no-camera");
    let (started, error) = asked(&["camera", file, "--instance", &instance.name]);
    assert_eq!(started.status.code(), Some(3), "{error}");
    assert!(error.contains("camera.v4l2.device: there is no `usb-0000:00:14.0-99`"), "{error}");
    let (run, error) = asked(&["run", file, "--instance", &instance.name]);
    assert_eq!(run.status.code(), Some(3), "{error}");
    instance.assert_gone();
}

#[test]
fn looking_at_cameras_ends_with_an_answer() {
    let (listed, error) = asked(&["camera", "--list", "--json"]);
    assert_eq!(listed.status.code(), Some(0), "{error}");
    let nodes: serde_json::Value = serde_json::from_slice(&listed.stdout).unwrap();
    assert!(nodes.is_array());
    for (device, words) in [
        ("/dev/video-none", "there is no `/dev/video-none`"),
        ("/dev/null", "is a device of another kind, no video device"),
        ("/tmp", "is a folder, no video device"),
        ("no such\u{1b}[31m camera", "there is no `no such\\u{1b}[31m camera`"),
    ] {
        let (probed, error) = asked(&["camera", "--probe", device]);
        assert!(probed.status.code() == Some(3) && error.contains(words), "{device}: {error}");
        let (seen, error) = asked(&["camera", "--device", device, "--snapshot", "/dev/null"]);
        assert!(seen.status.code() == Some(3) && error.contains(words), "{device}: {error}");
    }
    let (synthetic, error) = asked(&["camera", "--snapshot", "/dev/null"]);
    assert!(synthetic.status.code() == Some(3) && error.contains("camera.source"), "{error}");
    for wrong in [
        vec!["--list", "--probe", "x"],
        vec!["--probe", "x", "--duration-s", "0"],
        vec!["--probe", "x", "--duration-s", "nan"],
        vec!["--probe", "x", "--size", "640"],
        vec!["--probe", "x", "--rate", "0"],
        vec!["--probe", "x", "--format", "H264"],
        vec!["--device", "x"],
    ] {
        let (refused, error) = asked(&[&["camera"], wrong.as_slice()].concat());
        assert_eq!(refused.status.code(), Some(2), "{wrong:?}: {error}");
    }
}

/// A camera's word, through shared memory to whoever listens.
#[test]
fn health_travels() {
    let run = Instance::new("health");
    let instance: vservo::ipc::Instance = run.name.parse().unwrap();
    let services = Services::join(&instance).unwrap();
    let listens = services.health_receiver(CameraId(1)).unwrap();
    let speaks = services.health_sender(CameraId(1)).unwrap();
    for state in [CameraState::Streaming, CameraState::Gone] {
        let said = CameraHealth { state: state as u32, lost: 3, ..CameraHealth::default() };
        speaks.send_quietly(&said).unwrap();
    }
    let heard: Vec<_> =
        std::iter::from_fn(|| listens.receive().unwrap()).map(|health| health.state).collect();
    assert_eq!(heard, [CameraState::Streaming as u32, CameraState::Gone as u32], "no change is missed");
    drop((listens, speaks, services));
    instance.remove_leftovers(None);
    run.assert_gone();
}
