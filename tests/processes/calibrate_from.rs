//! `vservo calibrate from` with the real processes: a run before a wrong description is refined by its recording and by its report, and the refined run file is one.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // helpers of tests are tests

use crate::common::{Instance, run, vservo};
use serde_json::Value;
use std::path::Path;
use std::process::Output;

fn recorded(test: &str, file: &str, settings: &[&str], recording: &Path, report: &Path) {
    let instance = Instance::new(test);
    let output = vservo()
        .args(["run", file, "--clock", "lockstep", "--anyway", "--instance", &instance.name])
        .args(settings.iter().flat_map(|set| ["--set", set]))
        .arg("--record")
        .arg(recording)
        .arg("--report")
        .arg(report)
        .output()
        .unwrap();
    assert!([Some(0), Some(5)].contains(&output.status.code()), "{output:?}");
}

fn from(run: &Path, extra: &[&str]) -> Output {
    vservo().args(["calibrate", "from"]).arg(run).args(extra).output().unwrap()
}

fn text(output: &Output) -> String {
    format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr))
}

/// The number of this key: refined, and its standard deviation.
fn refined(output: &Output, key: &str) -> (f64, f64) {
    assert_eq!(output.status.code(), Some(0), "{}", text(output));
    let found: Value = serde_json::from_slice(&output.stdout).unwrap();
    let number = found["numbers"].as_array().unwrap().iter().find(|n| n["key"] == key).unwrap();
    (number["refined"].as_f64().unwrap(), number["sd"].as_f64().unwrap())
}

#[test]
fn a_recording_and_a_report_refine_the_run_file() {
    let folder = tempfile::tempdir().unwrap();
    let (recording, report) = (folder.path().join("run.mcap"), folder.path().join("report"));
    let truth =
        ["scene.camera.lens.fx_px=840", "scene.camera.lens.fy_px=840", "camera.synthetic.stamp_error_ms=10"];
    recorded("from", "ur5", &truth, &recording, &report);
    for place in [&recording, &report] {
        let told = from(place, &["--json"]);
        let (fx, sd) = refined(&told, "camera.lens.fx_px");
        assert!((fx - 840.0).abs() < 4.0 * sd && sd < 80.0, "{fx} +- {sd}");
        let (stamps, sd) = refined(&told, "camera.stamp_offset_ms, change");
        assert!((stamps + 10.0).abs() < 4.0 * sd && sd < 5.0, "{stamps} +- {sd}");
        let words = from(place, &[]);
        assert!(text(&words).contains("camera.lens.fx_px") && text(&words).contains(" views that differ"));
    }
    let out = folder.path().join("refined.toml");
    let written = from(&recording, &["--out", out.to_str().unwrap()]);
    assert_eq!(written.status.code(), Some(0), "{}", text(&written));
    let refined = std::fs::read_to_string(&out).unwrap();
    assert!(refined.starts_with("# vservo calibrate from "), "{refined}");
    let again = run("from", &[out.to_str().unwrap(), "--clock", "lockstep"]);
    assert_eq!(again.summary["outcome"], "converged", "{}", again.text());
}

#[test]
fn runs_that_tell_nothing_are_refused_in_words() {
    let folder = tempfile::tempdir().unwrap();
    for (k, (settings, told, exit_code)) in [
        (&["scene.motion.kind=conveyor"][..], "the target moved in this run", 3),
        (&["run.duration_s=0.1"][..], "nothing was refined: only ", 5),
    ]
    .into_iter()
    .enumerate()
    {
        let (recording, report) =
            (folder.path().join(format!("{k}.mcap")), folder.path().join(format!("{k}")));
        recorded("from-refused", "default", settings, &recording, &report);
        let output = from(&recording, &[]);
        assert_eq!(output.status.code(), Some(exit_code), "{}", text(&output));
        assert!(text(&output).contains(told), "{}", text(&output));
        assert!(output.stdout.is_empty());
    }
    let nothing = from(&folder.path().join("nothing.mcap"), &[]);
    assert_eq!(nothing.status.code(), Some(3), "{}", text(&nothing));
}

/// A load that a run in torques has moved is told with its deviation, by recording and report, and written; a drive that takes positions tells none, and what would.
#[test]
fn the_load_of_a_run_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let (recording, report) = (folder.path().join("run.mcap"), folder.path().join("report"));
    let payload = ["drive.simulated.payload_kg=1.5", "drive.simulated.payload_com_m=[0.02, 0.0, 0.06]"];
    recorded("from-load", "ur5", &payload, &recording, &report);
    for place in [&recording, &report] {
        let told = from(place, &["--json"]);
        assert_eq!(told.status.code(), Some(0), "{}", text(&told));
        let found: Value = serde_json::from_slice(&told.stdout).unwrap();
        let load = &found["load"];
        let (mass, sd) = (load["mass_kg"].as_f64().unwrap(), load["mass_sd_kg"].as_f64().unwrap());
        assert!((mass - 1.5).abs() < 4.0 * sd && sd < 0.5, "{load}");
        for (k, truth) in [0.02, 0.0, 0.06].into_iter().enumerate() {
            let (com, sd) = (load["com_m"][k].as_f64().unwrap(), load["com_sd_m"][k].as_f64().unwrap());
            assert!((com - truth).abs() < 4.0 * sd, "{k}: {load}");
        }
        assert_eq!(found["load_unseen"], Value::Null);
        assert!(text(&from(place, &[])).contains("load: the flange carries 1."));
    }
    let out = folder.path().join("laden.toml");
    let written = from(&recording, &["--out", out.to_str().unwrap()]);
    assert_eq!(written.status.code(), Some(0), "{}", text(&written));
    let again = run("from-laden", &[out.to_str().unwrap(), "--clock", "lockstep"]);
    assert_eq!(again.summary["outcome"], "converged", "{}", again.text());
    let (recording, report) = (folder.path().join("2.mcap"), folder.path().join("2"));
    let positions = ["drive.mode=position", payload[0]];
    recorded("from-positions", "ur5", &positions, &recording, &report);
    for place in [&recording, &report] {
        let found: Value = serde_json::from_slice(&from(place, &["--json"]).stdout).unwrap();
        assert_eq!(found["load"], Value::Null, "{found}");
        assert!(found["load_unseen"].as_str().unwrap().contains("drive.mode = \"torque\""), "{found}");
    }
}
