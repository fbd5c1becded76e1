//! Several cameras: `[camera]` for one, `[[cameras]]` for more, each with processes and services of its own.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // helpers of tests are tests

use crate::common::{Instance, kill, vservo};
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::Duration;
use vservo::config::Config;
use vservo::ipc::Services;
use vservo::messages::CameraId;

const TWO: &str = "
[[cameras]]
name = 'left'

[[cameras]]
name = 'right'
rate_hz = 50.0
mount.position_m = [0.02, 0.0, 0.0]
lens.fx_px = 790.0
";

fn parse(text: &str) -> Result<Config, String> {
    Config::parse("cell.toml", text, Path::new("."), &[]).map_err(|e| e.to_string())
}

fn written(folder: &tempfile::TempDir, text: &str) -> PathBuf {
    let path = folder.path().join("cell.toml");
    std::fs::write(&path, text).unwrap();
    path
}

#[test]
fn a_list_of_one_is_the_camera() {
    let listed = parse("[[cameras]]\nrate_hz = 50.0\nlens.fx_px = 790.0\n").unwrap();
    let single = parse("[camera]\nrate_hz = 50.0\nlens.fx_px = 790.0\n").unwrap();
    assert_eq!(listed.effective, single.effective);
    assert_eq!((listed.camera.id, listed.camera.name.as_str()), (CameraId::FIRST, "0"));
}

#[test]
fn each_camera_has_its_number_its_name_and_its_own_values() {
    let config = parse(TWO).unwrap();
    let seen: Vec<_> = config.cameras().map(|c| (c.id.0, c.name.as_str(), c.rate_hz)).collect();
    assert_eq!(seen, [(0, "left", 25.0), (1, "right", 50.0)]);
    let again = parse(&config.to_toml().unwrap()).unwrap();
    assert_eq!(again.effective, config.effective, "the effective file reads back");
    let right = config.clone().seen_by(CameraId(1)).unwrap();
    assert_eq!((right.camera.id, right.camera.model.intrinsics().fx_px), (CameraId(1), 790.0));
    assert_eq!(right.scene.unwrap().mount, right.camera.mount, "it is rendered from where it sits");
    assert!(config.seen_by(CameraId(2)).is_none());
}

#[test]
fn what_is_wrong_with_a_list_is_told_at_its_entry() {
    let refused = |text: &str, words: &[&str]| {
        let error = parse(text).unwrap_err();
        for word in words {
            assert!(error.contains(word), "{word}: {error}");
        }
    };
    refused(&format!("[camera]\nrate_hz = 30.0\n{TWO}"), &["[camera] and [[cameras]] are both given"]);
    refused(&TWO.replace("790.0", "0.0"), &["cell.toml:9", "cameras[1].lens.fx_px: 0 is out of range"]);
    refused(&TWO.replace("rate_hz", "rat_hz"), &["cell.toml:7", "cameras[1].rat_hz", "unknown field"]);
    refused(&"[[cameras]]\n".repeat(5), &["cameras", "at most 4"]);
}

#[test]
fn several_cameras_or_an_absent_one_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let file = written(&folder, TWO);
    let instance = Instance::new("several");
    for arguments in [
        vec!["check"],
        vec!["run", "--instance", &instance.name],
        vec!["control", "--instance", &instance.name],
    ] {
        let output = vservo().args(&arguments).arg(&file).output().unwrap();
        let text = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(3), "{arguments:?}: {text}");
        assert!(
            text.contains("2 cameras, and nothing says how they control the arm"),
            "{arguments:?}: {text}"
        );
    }
    let output =
        vservo().args(["vision", "--camera", "2", "--instance", &instance.name]).arg(&file).output().unwrap();
    let text = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(3), "{text}");
    assert!(text.contains("--camera 2: the run file has 2 camera(s), counted from 0"), "{text}");
    instance.assert_gone();
}

/// Two pairs of processes side by side in one instance: the measurements of each carry its number, on a service of its own.
#[test]
fn processes_of_each_camera_live_side_by_side() {
    let folder = tempfile::tempdir().unwrap();
    let file = written(&folder, TWO);
    let instance = Instance::new("pairs");
    let mut processes = Vec::new();
    for camera in ["0", "1"] {
        for role in ["vision", "camera"] {
            let mut command = vservo();
            command.arg(role).arg(&file).args(["--instance", &instance.name, "--camera", camera]);
            processes.push(command.stderr(Stdio::null()).spawn().unwrap());
        }
    }
    {
        let services = Services::join(&instance.name.parse().unwrap()).unwrap();
        for id in [CameraId(0), CameraId(1)] {
            let (measurements, listener) = services.measurement_receiver(id).unwrap();
            let found = loop {
                listener.wait(Duration::from_millis(50)).unwrap();
                if let Some(m) = measurements.receive_newest().unwrap().filter(|m| m.found()) {
                    break m;
                }
                assert!(processes.iter_mut().all(|p| p.try_wait().unwrap().is_none()), "a process has ended");
            };
            assert_eq!(found.camera, u32::from(id));
        }
    }
    for process in &mut processes {
        kill(process.id() as i32, "TERM");
        assert!(process.wait().unwrap().success());
    }
    instance.assert_gone();
}
