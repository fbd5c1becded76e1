//! See before running, and place an arm: from a bare URDF to a converged run in two commands; what `check` says of goals and views; the
//! images of `view`.

#![allow(non_snake_case, clippy::unwrap_used, clippy::expect_used, clippy::panic)] // helpers of tests are tests

use crate::common::{Instance, vservo};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Output;
use vservo::config::Config;
use vservo::sim::preflight::{Preflight, Reach};

fn shipped(file: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("config").join(file)
}

fn told(output: &Output) -> String {
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    text(&output.stdout) + &text(&output.stderr)
}

fn asked(arguments: &[&str]) -> (Option<i32>, String, String) {
    let output = vservo().args(arguments).output().unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    assert!(!told(&output).contains("panicked"), "{}", told(&output));
    (output.status.code(), text(&output.stdout), text(&output.stderr))
}

#[test]
fn shipped_run_files_have_nothing_against_them() {
    let files = std::fs::read_dir(shipped("")).unwrap().map(|e| e.unwrap().path());
    let files: Vec<_> = files.filter(|p| p.extension().is_some_and(|e| e == "toml")).collect();
    assert!(files.len() > 10);
    let mut within = 0;
    for file in files {
        let preflight = Preflight::of(&Config::load(Some(&file), &[]).unwrap()).unwrap();
        assert_eq!((preflight.faults(), preflight.doubts()), (vec![], vec![]), "{}", file.display());
        within += usize::from(matches!(preflight.reach, Reach::Within(_)));
    }
    assert!(within > 15, "{within} goals were looked at");
}

/// Bare robot files, and shipped robots of few and of many joints: two commands.
#[test]
fn from_a_robot_file_to_a_converged_run() {
    let folder = tempfile::tempdir().unwrap();
    let urdf = |name: &str| shipped("robot").join(name).display().to_string();
    for (i, model) in [urdf("ur5.urdf") + "#tool0", urdf("xarm7.urdf"), "scara".into(), "pan_tilt".into()]
        .iter()
        .enumerate()
    {
        let file = folder.path().join(format!("{i}.toml"));
        let file = file.to_str().unwrap();
        let set = format!("robot.model={model}");
        let (code, out, error) = asked(&["place", "--set", &set, "--out", file]);
        assert_eq!(code, Some(0), "{model}: {error}");
        assert!(out.contains("converges") && out.contains("reach: the arm reaches the goal"), "{out}");

        // it names only what differs from the defaults
        let written: toml::Table = std::fs::read_to_string(file).unwrap().parse().unwrap();
        let tables: Vec<_> = written.keys().map(String::as_str).collect();
        assert_eq!(tables, ["robot", "scene", "servo"], "{model}");

        let (code, out, error) = asked(&["check", file]);
        assert_eq!((code, error.as_str()), (Some(0), ""), "{model}: {out}");
        assert!(out.lines().next().unwrap().contains(": ok: image_resolved_velocity on "), "{out}");

        let instance = Instance::new("place");
        let run = vservo()
            .args(["run", file, "--clock", "lockstep", "--instance", &instance.name])
            .output()
            .unwrap();
        assert_eq!(run.status.code(), Some(0), "{model}: {}", told(&run));
        assert!(!told(&run).contains("warning"), "{model}: {}", told(&run));
        instance.assert_gone();
    }
}

/// What a run file says stays; only start and place are new, and paths stay those of the file.
#[test]
fn what_a_run_file_says_stays() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("placed.toml");
    let cell = shipped("tag.toml");
    let (code, _, error) = asked(&[
        "place",
        cell.to_str().unwrap(),
        "--set",
        "servo.gain_1_s=8",
        "--out",
        file.to_str().unwrap(),
    ]);
    assert_eq!(code, Some(0), "{error}");
    let (old, new) = (Config::load(Some(&cell), &[]).unwrap(), Config::load(Some(&file), &[]).unwrap());
    let mut expected = old.effective.clone();
    expected.robot.q_start_rad_or_m = new.effective.robot.q_start_rad_or_m.clone();
    expected.scene.object = new.effective.scene.object.clone();
    expected.servo.desired = new.effective.servo.desired.clone();
    expected.servo.gain_1_s = new.effective.servo.gain_1_s.clone();
    expected.camera.external.folder = new.effective.camera.external.folder.clone();
    expected.drive.external.folder = new.effective.drive.external.folder.clone();
    assert_eq!(new.effective, expected);
    assert_ne!(new.effective.robot.q_start_rad_or_m, old.effective.robot.q_start_rad_or_m);
}

/// A run file names files beside it; the one that is written from it stands in another folder.
#[test]
fn files_beside_a_run_file_are_found_from_elsewhere() {
    let folder = tempfile::tempdir().unwrap();
    let [old, new] = ["old", "new"].map(|name| folder.path().join(name));
    [&old, &new].into_iter().for_each(|path| std::fs::create_dir(path).unwrap());
    let lens = "image_width: 640\nimage_height: 480\ncamera_matrix: {rows: 3, cols: 3, data: [800, 0, 319.5, 0, 800, 239.5, 0, 0, 1]}\n\
                distortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}\n";
    std::fs::write(old.join("lens.yaml"), lens).unwrap();
    let text = "[robot]\nmodel = \"ur5\"\n[[cameras]]\nname = \"hand\"\nlens.file = \"lens.yaml\"\n";
    std::fs::write(old.join("cell.toml"), text).unwrap();
    let placed = new.join("placed.toml");
    let (code, out, error) =
        asked(&["place", old.join("cell.toml").to_str().unwrap(), "--out", placed.to_str().unwrap()]);
    assert_eq!(code, Some(0), "{out}{error}");
    let (code, out, error) = asked(&["check", placed.to_str().unwrap()]);
    assert_eq!((code, error.as_str()), (Some(0), ""), "{out}");
}

#[test]
fn requests_that_cannot_be_are_told() {
    for (arguments, code, words) in [
        (vec!["--object", "5,0,0"], 5, "no posture has the camera before such a place"),
        (vec!["--object", "0.5,here,0"], 2, "is no list of numbers"),
        (vec!["--object", "0.5,0"], 2, "has neither 3 nor 6 numbers"),
        (vec!["--distance-m", "1e308"], 2, "is out of range"),
        (vec!["--object", "0.5,0.2,0.2,0,0,90", "--look", "down"], 2, "looks where --object is turned to"),
        (
            vec!["--set", "camera.source=v4l2", "--set", "camera.v4l2.device=/dev/video0"],
            3,
            "only `synthetic`",
        ),
        (vec!["--set", "robot.model=none.urdf"], 3, "none.urdf"),
    ] {
        let mut all = vec!["place"];
        if !arguments.iter().any(|a| a.starts_with("robot.model")) {
            all.extend(["--set", "robot.model=ur5"]);
        }
        all.extend(&arguments);
        let (found, out, error) = asked(&all);
        assert_eq!(found, Some(code), "{arguments:?}: {error}");
        assert!(error.contains(words), "{arguments:?}: {error}");
        assert_eq!(out, "", "{arguments:?}");
    }
}

#[test]
fn a_goal_that_cannot_be_reached_is_an_error() {
    let cell = shipped("ur5.toml");
    let set = "servo.desired.position_m=[-0.05, -0.05, 0.9]";
    let arguments = ["check", cell.to_str().unwrap(), "--set", set];
    let (code, out, error) = asked(&arguments);
    assert_eq!(code, Some(3), "{out}{error}");
    assert!(
        error.contains("servo.desired: the arm cannot bring the camera there: the nearest pose"),
        "{error}"
    );
    assert!(error.contains(" mm and ") && error.contains(" deg off"), "{error}");
    assert!(!out.contains(": ok: ") && out.contains("  start: the camera is at"), "{out}");
    let (code, out, _) = asked(&[&arguments[..], &["--json"]].concat());
    assert_eq!(code, Some(3));
    let answer: Value = serde_json::from_str(&out).unwrap();
    assert_eq!(answer["ok"], false);
    assert_eq!(answer["reach"]["kind"], "beyond");
    assert!(answer["reach"]["off_m"].as_f64().unwrap() > 0.05, "{answer}");
    assert!(answer["errors"][0].as_str().unwrap().contains("servo.desired"));
}

/// Centres in the image and dots that are not whole: the target could not be found, and `check` says by how much. At the goal some of
/// the dots may do.
#[test]
fn a_target_that_is_cut_is_told() {
    let aside = "scene.object.position_m=[0.9678, 1.0322, 1.0]";
    let (code, _, error) = asked(&["check", shipped("default.toml").to_str().unwrap(), "--set", aside]);
    assert_eq!(code, Some(3), "{error}");
    let far = "point 3 is outside, 4.0 px beyond the lower border, point 4 is outside, 5.3 px beyond the lower border";
    assert!(error.contains(far), "{error}");
    assert!(error.contains("at the start; move scene.object"), "{error}");

    let cell = shipped("ur5.toml");
    let cell = cell.to_str().unwrap();
    let near = "servo.desired.position_m=[-0.05, -0.05, 0.2]";
    let (code, _, error) = asked(&["check", cell, "--set", near]);
    assert_eq!(code, Some(0), "{error}");
    assert!(error.contains("warning: ") && error.contains("point 1 is outside, "), "{error}");
    assert!(error.contains("px beyond the upper border in the desired view"), "{error}");
    let nearer = "servo.desired.position_m=[-0.05, -0.05, 0.1]";
    let (code, out, error) = asked(&["check", cell, "--set", nearer]);
    assert_eq!(code, Some(3), "{error}");
    let large = "outside the image in the desired view (the target is 750 x 750 px here, the image 640 x 480";
    assert!(error.contains(large), "{error}");
    assert!(out.contains("goal:"), "the rest is told all the same: {out}");
}

#[test]
fn images_of_start_and_goal() {
    let folder = tempfile::tempdir().unwrap();
    let cell = shipped("scara-eye-to-hand.toml");
    let cell = cell.to_str().unwrap();
    let png = folder.path().join("view.png");
    let (code, out, error) = asked(&["view", cell, "--out", png.to_str().unwrap()]);
    assert_eq!(code, Some(0), "{error}");
    assert!(out.contains("view.png: written"), "{out}");
    let image = image::open(&png).unwrap().to_rgb8();
    assert!(image.width() > 2 * 640 && image.height() > 480 + 100, "{:?}", image.dimensions());
    // marks in colour lie over both images
    for (from, to) in [(12, 652), (664, 1304)] {
        let green = |x: u32, y: u32| image.get_pixel(x, y).0 == [0, 255, 64];
        let count =
            (30..510).flat_map(|y| (from..to).map(move |x| (x, y))).filter(|(x, y)| green(*x, *y)).count();
        assert!(count > 4 * 15, "{count} pixels of crosses and numbers");
    }

    let svg = folder.path().join("view.svg");
    let (code, _, error) = asked(&["view", cell, "--out", svg.to_str().unwrap()]);
    assert_eq!(code, Some(0), "{error}");
    let text = std::fs::read_to_string(&svg).unwrap();
    assert_eq!(text.matches("data:image/png;base64,").count(), 2);
    assert_eq!(text.matches("<svg").count(), text.matches("</svg>").count());
    assert!(text.contains(">4</text>") && text.contains("looks straight down"), "numbers and words");

    // what every other command refuses is drawn: that is when one wants to see it
    let away = "robot.q_start_rad_or_m=[0.0, 1.2, 0.5, -0.785]";
    let (code, out, error) = asked(&[
        "view",
        shipped("default.toml").to_str().unwrap(),
        "--set",
        away,
        "--out",
        png.to_str().unwrap(),
    ]);
    assert_eq!(code, Some(0), "{error}");
    assert!(out.contains("px beyond the"), "{out}");
    let image = image::open(&png).unwrap().to_rgb8();
    assert!(image.pixels().any(|p| p.0 == [255, 64, 64]), "it is drawn in red");

    let (code, _, error) = asked(&["view", cell, "--out", "view.bmp"]);
    assert_eq!((code, error.as_str()), (Some(2), "vservo: --out: the name must end in .png or .svg\n"));
}
