//! The program on the guest's devices: what it says of them, what it refuses and why, and its exit codes.

use crate::capture::{CHECKERS, CaptureRequest, assert_checkers, assert_image, run_file};
use crate::common::{kill, vservo, wait_until};
use crate::guest::{self, Vivid};
use crate::usb_camera::{Model, UsbCamera};
use serde_json::Value;
use std::os::unix::process::CommandExt;
use std::process::{Command, Stdio};

/// Who owns nothing.
const NOBODY: u32 = 65534;

/// Exit code, standard output and standard error.
fn ended(command: &mut Command) -> (Option<i32>, String, String) {
    let output = command.output().unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (output.status.code(), text(&output.stdout), text(&output.stderr))
}

fn camera(arguments: &[&str]) -> (Option<i32>, String, String) {
    ended(vservo().arg("camera").args(arguments))
}

fn json(arguments: &[&str]) -> Value {
    let (code, out, told) = camera(arguments);
    assert_eq!(code, Some(0), "{told}");
    serde_json::from_str(&out).unwrap_or_else(|e| panic!("{e}: {out}"))
}

#[test]
#[ignore = "runs in the virtual machine: tests/vm/run.py"]
fn a_list_shows_devices_formats_sizes_rates_and_controls() {
    let (code, out, _) = camera(&["--list"]);
    assert_eq!(code, Some(0));
    assert!(out.contains("no video device"), "{out}");
    guest::load_usb();
    let vivid = Vivid::webcam();
    let usb = UsbCamera::plug(&Model::default());
    let nodes = json(&["--list", "--json"]);
    let node = |path: &std::path::Path| {
        let all = nodes.as_array().unwrap();
        all.iter()
            .find(|n| n["path"] == path.to_str().unwrap())
            .unwrap_or_else(|| panic!("{path:?}: {nodes}"))
            .clone()
    };
    let found = node(&usb.node());
    assert_eq!(found["serial"], "0001");
    let text = found.to_string();
    for word in [
        "Emulated Camera",
        "uvcvideo",
        "MJPG",
        "YUYV",
        "GREY",
        "640",
        "320",
        "exposure",
        "gain",
        "brightness",
    ] {
        assert!(text.contains(word), "{word}: {text}");
    }
    let controls = found["controls"].as_array().unwrap();
    let gain = controls.iter().find(|c| c["name"].as_str().unwrap().eq_ignore_ascii_case("gain")).unwrap();
    assert_eq!((&gain["minimum"], &gain["maximum"], &gain["value"]), (&0.into(), &100.into(), &10.into()));
    let found = node(&vivid.capture()).to_string();
    for word in ["vivid", "GREY", "NV12", "test_pattern"] {
        assert!(found.contains(word), "{word}: {found}");
    }
    let (code, out, _) = camera(&["--list"]);
    assert_eq!(code, Some(0));
    for word in ["Emulated Camera", "640x480", "at 30, 25, 15 Hz", "MJPG", "not used here", "metadata"] {
        assert!(out.contains(word), "{word}: {out}");
    }
}

#[test]
#[ignore = "runs in the virtual machine: tests/vm/run.py"]
fn a_probe_measures_and_its_table_runs() {
    guest::load_usb();
    let usb = UsbCamera::plug(&Model::default());
    let device = usb.node();
    let device = device.to_str().unwrap();
    for (format, rate) in [("YUYV", "30"), ("MJPG", "25"), ("GREY", "30")] {
        let probed =
            json(&["--probe", device, "--format", format, "--rate", rate, "--duration-s", "2", "--json"]);
        let number = |key: &str| probed[key].as_f64().unwrap_or_else(|| panic!("{key}: {probed}"));
        let rate_hz: f64 = rate.parse().unwrap();
        assert!((number("obtained_hz") / rate_hz - 1.0).abs() < 0.01, "{probed}");
        assert_eq!((number("lost"), number("corrupt")), (0.0, 0.0), "{probed}");
        assert_eq!(probed["format"], format);
        assert!((number("frames") - 2.0 * rate_hz).abs() < 5.0, "{probed}");
        // The camera's own exposure, as its control says.
        assert!((number("exposure_ms") - 1e-3 * f64::from(usb.exposure_us())).abs() < 1e-6, "{probed}");
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("cell.toml");
        let table = probed["suggestion"].as_str().unwrap();
        std::fs::write(&file, format!("[drive]\nkind = \"none\"\n{table}")).unwrap();
        let (code, out, told) = ended(vservo().arg("check").arg(&file));
        assert_eq!(code, Some(0), "{table}: {out}{told}");
        if format == "YUYV" {
            let instance = crate::common::Instance::new("probed");
            let (code, out, told) = ended(vservo().arg("run").arg(&file).args([
                "--duration-s",
                "2",
                "--instance",
                &instance.name,
            ]));
            assert_eq!(code, Some(0), "{out}{told}");
            assert!(out.contains("run.duration_s is over"), "{out}");
            instance.assert_gone();
        }
    }
    let (code, out, _) = camera(&["--probe", device, "--duration-s", "1"]);
    assert_eq!(code, Some(0));
    assert!(out.contains("put this into the run file") && out.contains("jitter"), "{out}");
}

#[test]
#[ignore = "runs in the virtual machine: tests/vm/run.py"]
fn a_snapshot_is_the_image() {
    guest::load_usb();
    let vivid = Vivid::webcam();
    vivid.set(CHECKERS);
    let usb = UsbCamera::plug(&Model::default());
    let folder = tempfile::tempdir().unwrap();
    let png = folder.path().join("image.png");
    let image = |arguments: &[&str]| {
        let all = [&["--snapshot", png.to_str().unwrap()][..], arguments].concat();
        let (code, out, told) = camera(&all);
        assert_eq!(code, Some(0), "{out}{told}");
        let image = image::open(&png).unwrap();
        assert_eq!(image.color(), image::ColorType::L8);
        assert_eq!((image.width(), image.height()), (640, 480));
        image.into_luma8().into_raw()
    };
    let device = vivid.capture();
    for format in ["GREY", "YUYV"] {
        assert_checkers(&image(&["--device", device.to_str().unwrap(), "--format", format]), 640);
    }
    for format in ["GREY", "MJPG"] {
        let grey = image(&["--device", usb.node().to_str().unwrap(), "--format", format]);
        assert_image(&grey, (640, 480), format == "MJPG");
    }
    // Of a run file's camera.
    let file = folder.path().join("cell.toml");
    std::fs::write(
        &file,
        run_file("Emulated Camera", CaptureRequest { rate_hz: 30.0, ..CaptureRequest::VGA }, ""),
    )
    .unwrap();
    assert_image(&image(&[file.to_str().unwrap()]), (640, 480), false);
}

#[test]
#[ignore = "runs in the virtual machine: tests/vm/run.py"]
fn what_cannot_be_opened_is_told_with_its_reason() {
    let vivid = Vivid::load("node_types=0x20101 num_inputs=1 input_types=0");
    let folder = tempfile::tempdir().unwrap();
    let plain = folder.path().join("plain");
    std::fs::write(&plain, "no camera").unwrap();
    let refused = |device: &str, words: &[&str]| {
        let (code, out, told) = camera(&["--probe", device]);
        assert_eq!(code, Some(3), "{device}: {out}{told}");
        for word in words {
            assert!(told.contains(word), "{device}: {word}: {told}");
        }
    };
    refused("/dev/video77", &["there is no `/dev/video77`", vivid.capture().to_str().unwrap()]);
    refused("Webcam 3000", &["there is no `Webcam 3000`", "vivid"]);
    refused(plain.to_str().unwrap(), &["is a file, no video device", "vservo camera --list"]);
    refused("/dev/null", &["is a device of another kind, no video device"]);
    refused(vivid.output().to_str().unwrap(), &["/dev/video1"]);

    // Belongs to root alone.
    let mut command = vservo();
    command.args(["camera", "--probe"]).arg(vivid.capture()).uid(NOBODY).gid(NOBODY);
    let (code, _, told) = ended(&mut command);
    assert_eq!(code, Some(3), "{told}");
    assert!(told.contains("permission denied") && told.contains("usermod -aG video"), "{told}");
    let (code, out, told) = ended(vservo().args(["camera", "--list"]).uid(NOBODY).gid(NOBODY));
    assert_eq!(code, Some(0), "{told}");
    assert!(out.contains("permission denied"), "{out}");
}

#[test]
#[ignore = "runs in the virtual machine: tests/vm/run.py"]
fn a_camera_that_somebody_else_uses_is_busy() {
    let vivid = Vivid::webcam();
    let device = vivid.capture();
    let device = device.to_str().unwrap();
    let mut other = Command::new("v4l2-ctl")
        .args(["-d", device, "--stream-mmap"])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    // Somebody streams as soon as the format cannot be changed any more.
    let change = ["-d", device, "--set-fmt-video=width=640,height=360"];
    wait_until("the other program to stream", || {
        let out = Command::new("v4l2-ctl").args(change).output().unwrap();
        String::from_utf8_lossy(&out.stderr).contains("busy") || !out.status.success()
    });
    let (code, _, told) = camera(&["--probe", device]);
    assert_eq!(code, Some(3), "{told}");
    assert!(told.contains("busy: another program captures from it"), "{told}");
    kill(other.id() as i32, "TERM");
    other.wait().unwrap();
    let (code, _, told) = camera(&["--probe", device, "--duration-s", "0.5"]);
    assert_eq!(code, Some(0), "{told}");
}

#[test]
#[ignore = "runs in the virtual machine: tests/vm/run.py"]
fn what_a_device_does_not_offer_is_told_with_what_it_does() {
    guest::load_usb();
    let usb = UsbCamera::plug(&Model::default());
    let device = usb.node();
    let device = device.to_str().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("cell.toml");
    let refused = |request: CaptureRequest<'_>, extra: &str, words: &[&str]| {
        std::fs::write(&file, run_file(device, request, extra)).unwrap();
        let png = folder.path().join("image.png");
        let (code, out, told) = camera(&[file.to_str().unwrap(), "--snapshot", png.to_str().unwrap()]);
        assert_eq!(code, Some(3), "{request:?} {extra}: {out}{told}");
        for word in words {
            assert!(told.contains(word), "{word}: {told}");
        }
    };
    refused(
        CaptureRequest { format: "Y16", ..CaptureRequest::VGA },
        "",
        &["camera.v4l2.format", "Y16", "YUYV", "MJPG", "GREY"],
    );
    refused(
        CaptureRequest { size: (1280, 720), ..CaptureRequest::VGA },
        "",
        &["1280x720", "640x480", "320x240"],
    );
    refused(
        CaptureRequest { rate_hz: 90.0, ..CaptureRequest::VGA },
        "strict_rate = true",
        &["90", "30", "25", "15"],
    );
    refused(CaptureRequest::VGA, "controls = { gain = 101 }", &["camera.v4l2.controls.gain", "101", "100"]);
    refused(CaptureRequest::VGA, "controls = { iris = 1 }", &["camera.v4l2.controls.iris", "brightness"]);
    refused(CaptureRequest::VGA, "controls = { auto_exposure = \"Sideways\" }", &["Sideways", "Manual Mode"]);
}

/// The exposure of the run file is set on the device, read back, and counts in the stamps.
#[test]
#[ignore = "runs in the virtual machine: tests/vm/run.py"]
fn exposure_and_gain_are_set_on_the_device() {
    guest::load_usb();
    let usb = UsbCamera::plug(&Model::default());
    assert_eq!(usb.exposure_us(), 20_000);
    let text = run_file(
        usb.node().to_str().unwrap(),
        CaptureRequest { rate_hz: 30.0, ..CaptureRequest::VGA },
        "set_exposure = true\ncontrols = { gain = 42 }",
    );
    let text = text.replace("[camera.v4l2]", "exposure_ms = 8.0\n[camera.v4l2]");
    let config = vservo::config::Config::parse("cell.toml", &text, std::path::Path::new("."), &[]).unwrap();
    let mut capture = crate::capture::Capture::with(&config).unwrap();
    assert_eq!(capture.next().span, vservo::time::SpanNs(8_000_000));
    assert_eq!(usb.exposure_us(), 8_000);
    let gain = guest::sh(&format!("v4l2-ctl -d {} -C gain", usb.node().display()));
    assert_eq!(gain.trim(), "gain: 42");
}
