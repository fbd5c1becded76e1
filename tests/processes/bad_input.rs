//! Bad input: one line that names the place and the remedy, the exit code of its kind, no panic, nothing left running.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // helpers of tests are tests

use crate::common::{Instance, vservo};
use std::path::Path;

fn refused(arguments: &[&str]) -> (String, Option<i32>) {
    let instance = Instance::new("bad");
    let output = vservo().args(arguments).args(["--instance", &instance.name]).output().unwrap();
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!text.contains("panicked"), "{text}");
    instance.assert_gone();
    (text, output.status.code())
}

fn config_error(text: &str) -> String {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.toml");
    std::fs::write(&path, text).unwrap();
    let (error, code) = refused(&["run", path.to_str().unwrap()]);
    assert_eq!(code, Some(3), "{error}");
    let checked = vservo().arg("check").arg(&path).output().unwrap();
    assert_eq!(checked.status.code(), Some(3));
    assert_eq!(String::from_utf8_lossy(&checked.stderr), error, "`check` says the same");
    error
}

#[test]
fn configuration_errors_name_line_key_and_remedy() {
    for (text, wanted) in [
        ("[servo]\ngainn = 1\n", "run.toml:2:1: servo.gainn: unknown field `gainn`, expected one of"),
        (
            "[servo]\ngain_1_s = \"fast\"\n",
            "run.toml:2:1: servo.gain_1_s: invalid type: string \"fast\", expected a number or a list of numbers",
        ),
        (
            "[servo]\ngain_1_s = -1.0\n",
            "run.toml:2:1: servo.gain_1_s: -1 is out of range, allowed is 0.001 to 100",
        ),
        (
            "[servo]\nupdate = \"often\"\n",
            "servo.update: unknown variant `often`, expected one of `frame`, `tick`, `predict`",
        ),
        ("[nonsense]\n", "run.toml:1:2: nonsense: unknown field"),
        ("[camera]\nrate_hz = nan\n", "camera.rate_hz: NaN is out of range"),
        ("[camera.lens]\nk1 = -3.0\n", "camera.lens: "),
        ("[camera]\nsource = \"replay\"\n", "camera.replay.folder: is missing"),
        ("[camera]\nsource = \"replay\"\n[camera.replay]\nfolder = \"none\"\n", "is not a folder"),
        ("[robot]\nmodel = \"r2d2\"\n", "robot.model: robot `r2d2`: no such robot"),
        ("[robot]\nq_start_rad_or_m = [0.0]\n", "has 1 entries"),
        (
            "[robot]\nq_start_rad_or_m = [0.0, 1.57, 99.0, 0.0]\n",
            "run.toml:2:32: robot.q_start_rad_or_m[2]: 99 is out of range",
        ),
        ("[scene.object]\nposition_m = [1.0, 1.0, -1.0]\n", "behind the camera at the start"),
        ("[scene.object]\nposition_m = [2.0, 1.0, 1.0]\n", "outside the image at the start"),
        ("[servo.desired]\nposition_m = [0.0, 0.0, -0.5]\n", "behind the camera in the desired view"),
        ("[target]\nradius_m = 0.2\n", "target: "),
        ("[safety]\nmeasurement_timeout_ms = 30\n", "the arm would stop at every frame"),
        (
            "[run]\nclock = \"lockstep\"\n[camera]\nrate_hz = 1000\nwidth_px = 4096\nheight_px = 4096\nexposure_ms = 0.1\nlatency_ms = 40.0\n",
            "512 MB",
        ),
        ("a = \n", "run.toml:1:"),
    ] {
        let error = config_error(text);
        assert!(error.contains(wanted), "{text}\n-> {error}");
        assert_eq!(error.lines().count(), 1, "{error}");
    }
}

#[test]
fn all_errors_of_a_file_come_at_once_in_its_order() {
    let error = config_error(
        "[run]\nseed = -1\n[camera]\nrate_hz = 1e9\nbogus = 1\n[goal]\nhold_s = 'x'\n[servo]\ngain_1_s = 0\n",
    );
    let lines: Vec<_> = error.lines().collect();
    assert_eq!(lines.len(), 5, "{error}");
    for (line, key) in
        lines.iter().zip(["run.seed", "camera.rate_hz", "camera.bogus", "goal.hold_s", "servo.gain_1_s"])
    {
        assert!(line.contains(key), "{error}");
    }
}

#[test]
fn settings_on_the_command_line_go_through_the_same_checks() {
    for (set, wanted) in [
        ("servo.gain_1_s=0", "--set servo.gain_1_s=0: servo.gain_1_s: 0 is out of range"),
        ("servo.gain=1", "servo.gain: unknown field `gain`"),
        ("servo.gain_1_s", "expected key.path=value"),
    ] {
        let (error, code) = refused(&["run", "--set", set]);
        assert_eq!(code, Some(3), "{error}");
        assert!(error.contains(wanted), "{error}");
    }
    assert_eq!(refused(&["run", "--duration-s", "-4"]).1, Some(2), "clap refuses what looks like an option");
    assert_eq!(refused(&["run", "--duration-s=-4"]).1, Some(3));
    assert_eq!(refused(&["run", "--clock", "sundial"]).1, Some(2));
}

#[test]
fn missing_files_and_unusable_places_are_refused() {
    let (error, code) = refused(&["run", "/no/such/file.toml"]);
    assert!(error.contains("/no/such/file.toml: cannot be read") && code == Some(3), "{error}");
    let (error, code) = refused(&["run", "--summary", "/no/such/folder/s.json"]);
    assert!(error.contains("/no/such/folder/s.json: cannot be written") && code == Some(3), "{error}");
    let output = vservo().args(["run", "--instance", "a/b"]).output().unwrap();
    assert_eq!(output.status.code(), Some(3));
    assert!(String::from_utf8_lossy(&output.stderr).contains("letters, digits"));
}

#[test]
fn bad_images_in_a_replay_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let save = |name: &str, w, h| image::GrayImage::new(w, h).save(folder.path().join(name)).unwrap();
    let replay = |strict: bool, wanted: i32, expected: &str| {
        let set = format!("camera.replay.folder={}", folder.path().display());
        for clock in ["lockstep", "realtime"] {
            let run = [
                "run",
                "--clock",
                clock,
                "--set",
                "camera.source=replay",
                "--set",
                &set,
                "--duration-s",
                "5",
            ];
            let strict = ["--strict"].into_iter().filter(|_| strict);
            let (error, code) = refused(&run.into_iter().chain(strict).collect::<Vec<_>>());
            assert_eq!(code, Some(wanted), "{error}");
            assert!(error.contains(expected), "{error}");
        }
    };
    replay(false, 3, "holds no .png");
    save("1.png", 640, 480);
    save("2.png", 320, 240);
    replay(true, 3, "2.png: is 320x240 px, the camera is 640x480 px");
    replay(false, 0, "2.png: is 320x240 px, the camera is 640x480 px");
    save("2.png", 640, 480);
    truncate(&folder.path().join("2.png"));
    replay(true, 3, "2.png: cannot be decoded");
    replay(false, 0, "played without it");
    // where none is left it is an error in any case
    std::fs::remove_file(folder.path().join("1.png")).unwrap();
    replay(false, 3, "2.png: cannot be decoded");
}

fn truncate(path: &Path) {
    let bytes = std::fs::read(path).unwrap();
    std::fs::write(path, &bytes[..bytes.len() / 2]).unwrap();
}

#[test]
fn the_spin_is_short_and_may_be_left_to_what_is_obtained() {
    let spin = |set: &str| vservo::config::Config::load(None, &[set.to_string()]).map(|c| c.realtime.spin);
    assert_eq!(vservo::config::Config::load(None, &[]).unwrap().realtime.spin, None);
    assert_eq!(spin("realtime.spin_us=0").unwrap(), Some(vservo::time::SpanNs::ZERO));
    assert_eq!(spin("realtime.spin_us=12.5").unwrap(), Some(vservo::time::SpanNs(12_500)));
    for wrong in ["realtime.spin_us=501", "realtime.spin_us=-1", "realtime.spin_us=nan"] {
        let error = spin(wrong).unwrap_err().to_string();
        assert!(error.contains("realtime.spin_us: ") && error.contains("allowed is 0 to 500"), "{error}");
    }
}
