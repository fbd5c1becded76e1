//! Whole processes on a device of the guest: camera, vision and control.

use crate::capture::{CHECKERS, CaptureRequest, assert_checkers, assert_image, number_after, run_file};
use crate::common::{Instance, kill, read_summary, vservo};
use crate::guest::{self, Vivid};
use crate::usb_camera::{Model, UsbCamera};
use std::path::PathBuf;
use std::process::Stdio;
use std::time::Duration;
use tempfile::TempDir;
use vservo::config::Config;
use vservo::ipc::Services;
use vservo::messages::{CameraId, CameraState};
use vservo::process::frame_shape;
use vservo::time::SpanNs;

fn written(folder: &TempDir, text: &str) -> PathBuf {
    let path = folder.path().join("cell.toml");
    std::fs::write(&path, text).unwrap();
    path
}

#[test]
#[ignore = "runs in the virtual machine: tests/vm/run.py"]
fn the_camera_process_hands_over_every_frame() {
    guest::load_usb();
    let camera = UsbCamera::plug(&Model::default());
    let folder = tempfile::tempdir().unwrap();
    let text = run_file(
        camera.node().to_str().unwrap(),
        CaptureRequest { rate_hz: 30.0, ..CaptureRequest::VGA },
        "",
    );
    let file = written(&folder, &text);
    let config = Config::load(Some(&file), &[]).unwrap();
    let instance = Instance::new("camera");
    let mut process = vservo().arg("camera").arg(&file).args(["--instance", &instance.name]).spawn().unwrap();
    {
        let services = Services::join(&instance.name.parse().unwrap()).unwrap();
        let frames = services.frame_receiver(CameraId::FIRST, frame_shape(&config)).unwrap();
        let mut before = None;
        let mut count = 0;
        while count < 300 {
            frames.wait(Duration::from_millis(50)).unwrap();
            assert!(process.try_wait().unwrap().is_none(), "the camera process has ended");
            let Some(frame) = frames.receive().unwrap() else { continue };
            let (header, marks) =
                (frame.header(), assert_image(frame.pixels(), CaptureRequest::VGA.size, false));
            if let Some((id, number, exposure)) = before {
                assert_eq!((header.frame_id, header.lost), (id + 1, 0));
                assert_eq!(marks.number, number_after(number, false));
                let period: SpanNs = header.exposure - exposure;
                assert!((period.as_s() - 1.0 / 30.0).abs() < 0.005, "{period:?}");
            }
            before = Some((header.frame_id, marks.number, header.exposure));
            count += 1;
        }
    }
    kill(process.id() as i32, "TERM");
    assert!(process.wait().unwrap().success());
    instance.assert_gone();
    assert_eq!(camera.streams(), None);
}

/// vivid's image through camera, vision and control to the end of the run; there is no target in it, and nothing moves.
#[test]
#[ignore = "runs in the virtual machine: tests/vm/run.py"]
fn a_test_image_passes_all_processes_to_the_end_of_the_run() {
    let vivid = Vivid::webcam();
    vivid.set(CHECKERS);
    let folder = tempfile::tempdir().unwrap();
    let text = format!(
        "[run]\nduration_s = 6.0\n[drive]\nkind = \"none\"\n{}",
        run_file(
            vivid.capture().to_str().unwrap(),
            CaptureRequest { format: "YUYV", ..CaptureRequest::VGA },
            ""
        )
    );
    let file = written(&folder, &text);
    let config = Config::load(Some(&file), &[]).unwrap();
    let summary = folder.path().join("summary.json");
    let instance = Instance::new("whole");
    let mut run = vservo()
        .args(["run", "--instance", &instance.name, "--summary"])
        .args([&summary, &file])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let place = PathBuf::from("/dev/shm").join(format!("vservo-{}/config.toml", instance.name));
    crate::common::wait_until("the instance", || place.exists());
    let (mut seen, mut newest) = (0_u64, None);
    {
        let services = Services::join(&instance.name.parse().unwrap()).unwrap();
        let status = services.status_receiver().unwrap();
        let frames = services.frame_receiver(CameraId::FIRST, frame_shape(&config)).unwrap();
        while run.try_wait().unwrap().is_none() {
            frames.wait(Duration::from_millis(10)).unwrap();
            if let Some(frame) = frames.receive().unwrap() {
                if seen % 25 == 0 {
                    assert_checkers(frame.pixels(), CaptureRequest::VGA.size.0);
                }
                seen += 1;
            }
            newest = status.receive().unwrap().map(|status| *status).or(newest);
        }
    }
    instance.name.parse::<vservo::ipc::Instance>().unwrap().remove_leftovers(None);
    let s = read_summary(&summary);
    assert_eq!(run.wait().unwrap().code(), Some(0), "{s}");
    assert_eq!(s["outcome"], "finished", "{s}");
    assert_eq!(s["reason"], "run.duration_s is over", "{s}");
    // 6 s of 25 Hz and of 50 Hz, less the start of what joined late; a reader that is kept waiting gets the newest status alone. The
    // camera shows images from before control starts to count until after it has ended: a slow start is a second of them, and a frame
    // that came twice each time would be 300.
    assert!((130..=185).contains(&seen), "{seen} frames");
    let newest = newest.unwrap();
    assert!((250..=305).contains(&newest.sequence), "{newest:?}");
    assert!(newest.frames >= 130, "{newest:?}");
    instance.assert_gone();
}

/// The camera is pulled out of a run in the middle, and put back.
#[test]
#[ignore = "runs in the virtual machine: tests/vm/run.py"]
fn a_run_holds_while_its_camera_is_away() {
    guest::load_usb();
    let model = Model::default();
    let mut camera = Some(UsbCamera::plug(&model));
    let folder = tempfile::tempdir().unwrap();
    let text = format!(
        "[run]\nduration_s = 12.0\n[drive]\nkind = \"none\"\n{}",
        run_file("Emulated Camera", CaptureRequest { rate_hz: 30.0, ..CaptureRequest::VGA }, "")
    );
    let file = written(&folder, &text);
    let summary = folder.path().join("summary.json");
    let instance = Instance::new("away");
    let mut run = vservo();
    run.args(["run", "--instance", &instance.name, "--summary"]).args([&summary, &file]);
    let mut run = run.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let place = PathBuf::from("/dev/shm").join(format!("vservo-{}/config.toml", instance.name));
    crate::common::wait_until("the instance", || place.exists());
    let mut in_status = Vec::new();
    {
        let services = Services::join(&instance.name.parse().unwrap()).unwrap();
        let status = services.status_receiver().unwrap();
        while run.try_wait().unwrap().is_none() {
            std::thread::sleep(Duration::from_millis(10));
            let Some(s) = status.receive().unwrap() else { continue };
            let state = CameraState::from_code(s.camera_state);
            if in_status.last() != Some(&state) {
                in_status.push(state);
            }
            if s.time_s > 3.0 && s.time_s < 6.0 {
                camera.take().into_iter().for_each(UsbCamera::unplug);
            } else if s.time_s >= 6.0 && camera.is_none() {
                camera = Some(UsbCamera::plug(&model));
            }
        }
    }
    instance.name.parse::<vservo::ipc::Instance>().unwrap().remove_leftovers(None);
    let s = read_summary(&summary);
    assert_eq!((run.wait().unwrap().code(), &s["outcome"]), (Some(0), &"finished".into()), "{s}");
    let (gone, streams) = (CameraState::Gone, CameraState::Streaming);
    let before = in_status.iter().position(|s| *s == streams).expect("it streams");
    let away = before + in_status[before..].iter().position(|s| *s == gone).expect("it is away");
    assert_eq!(in_status.last(), Some(&streams), "{in_status:?}");
    assert!(away < in_status.len() - 1, "{in_status:?}");
    let events = s["safety"]["events"].to_string();
    assert!(events.contains("camera unplugged") && events.contains("camera streaming again"), "{events}");
    instance.assert_gone();
}
