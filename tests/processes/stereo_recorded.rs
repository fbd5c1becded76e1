//! `vservo stereo motion RUN.mcap --at T1,T2` on recordings of real processes: the displacement of ONE moving camera and the structure of what it
//! saw, against the joints and against the target's own sizes.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)] // helpers of tests are tests

use crate::common::{Instance, vservo};
use nalgebra::Vector3;
use serde_json::Value;
use std::path::Path;
use std::process::Output;
use vservo::config::Config;

fn recorded(test: &str, file: &str, settings: &[&str], recording: &Path) {
    let instance = Instance::new(test);
    let output = vservo()
        .args(["run", file, "--clock", "lockstep", "--instance", &instance.name])
        .args(settings.iter().flat_map(|set| ["--set", set]))
        .arg("--record")
        .arg(recording)
        .output()
        .unwrap();
    assert!([Some(0), Some(5)].contains(&output.status.code()), "{output:?}");
}

fn motion(recording: &Path, arguments: &[&str]) -> Output {
    vservo().args(["stereo", "motion"]).arg(recording).args(arguments).output().unwrap()
}

fn answer(recording: &Path, arguments: &[&str]) -> Value {
    let output = motion(recording, &[arguments, &["--json"]].concat());
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value}"))
}

/// Root mean square of the ratio of distances between points of the structure to those of the target, less 1; and how many points there are.
fn scale_error(structure: &Value, file: &str) -> (f64, usize) {
    let config = Config::load(Some(Path::new(file)), &[]).unwrap();
    let place = |id: &Value| {
        config.target.points().iter().find(|p| Some(u64::from(p.id)) == id.as_u64()).unwrap().p_O.coords
    };
    let points: Vec<(Vector3<f64>, Vector3<f64>)> = (structure["points"].as_array().unwrap().iter())
        .map(|p| (Vector3::from_fn(|i, _| number(&p["position"][i])), place(&p["id"])))
        .collect();
    let (mut squares, mut count) = (0.0, 0.0);
    for (i, (seen_a, a)) in points.iter().enumerate() {
        for (seen_b, b) in &points[..i] {
            squares += ((seen_a - seen_b).norm() / (a - b).norm() - 1.0).powi(2);
            count += 1.0;
        }
    }
    (f64::sqrt(squares / count), points.len())
}

/// A board is a plane: by its homography, whose true reading the joints tell; the structure is in m by the joints' base line.
#[test]
fn one_moving_camera_tells_the_structure_of_a_board() {
    let folder = tempfile::tempdir().unwrap();
    let recording = folder.path().join("run.mcap");
    recorded("rec-board", "chessboard", &["scene.occluder.until_s=0", "run.duration_s=4"], &recording);
    let told = answer(&recording, &["--at", "0.1,3"]);
    assert_eq!((&told["method"], &told["ambiguous"]), (&"plane".into(), &false.into()), "{told}");
    let (recording_told, reading) = (&told["recording"], &told["plane"]["readings"][0]);
    let kinematics = &recording_told["kinematics"];
    let (turn, way) = (number(&kinematics["rotation_off_deg"]), number(&kinematics["direction_off_deg"]));
    let (scale, points) = scale_error(&reading["structure"], "config/chessboard.toml");
    println!(
        "board: base line {} m, rotation {turn:.4} deg, direction {way:.4} deg off, {points} points, sizes {scale:.5}",
        kinematics["base_line_m"]
    );
    assert!(turn < 0.2 && way < 2.0, "{kinematics}");
    assert!(points >= 40 && scale < 0.02, "{points} {scale}");
    assert_eq!(
        (&reading["structure"]["unit"], &reading["structure"]["in_front"]),
        (&"m".into(), &points.into())
    );
    assert!((number(&recording_told["times_s"][0]) - 0.1).abs() < 0.05, "{recording_told}");
    assert!(recording_told["method_reason"].as_str().unwrap().contains("one plane"));
    // by the essential matrix both readings are told
    let both = answer(&recording, &["--at", "0.1,3", "--method", "eight_point"]);
    let solutions = both["solutions"].as_array().unwrap();
    assert_eq!((solutions.len(), &both["ambiguous"]), (2, &true.into()), "{both}");
    assert!(solutions.iter().all(|s| s["structure"]["unit"] == "m"), "{both}");
    // words
    let words = motion(&recording, &["--at", "0.1,3"]);
    let words = String::from_utf8_lossy(&words.stdout).into_owned();
    assert!(
        words.contains("by the joints: camera 2 at") && words.contains("structure, in camera 1, m"),
        "{words}"
    );
    // what makes no sense
    for (arguments, code, what) in [
        (&["--at", "0.1,0.1"][..], 5, "same measurement"),
        (&[], 2, "--at T1,T2"),
        (&["--at", "1"], 2, "two times"),
        (&["--at", "1,2", "--baseline-m", "0"], 2, "greater than 0"),
    ] {
        let refused = motion(&recording, arguments);
        let err = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert!(refused.status.code() == Some(code) && err.contains(what), "{arguments:?}: {err}");
    }
}

/// Tags on a cube are not of one plane, once a second face is seen: by the essential matrix. Of one face alone, which both views share before that, by its homography.
#[test]
fn one_moving_camera_tells_the_structure_of_a_cube() {
    let folder = tempfile::tempdir().unwrap();
    let recording = folder.path().join("run.mcap");
    recorded("rec-cube", "tag-cube", &["run.duration_s=4"], &recording);
    let told = answer(&recording, &["--at", "0.8,3"]);
    let (kinematics, first) = (&told["recording"]["kinematics"], &told["solutions"][0]);
    let (turn, way) = (number(&kinematics["rotation_off_deg"]), number(&kinematics["direction_off_deg"]));
    let (scale, points) = scale_error(&first["structure"], "config/tag-cube.toml");
    println!(
        "cube: {}, base line {} m, rotation {turn:.4} deg, direction {way:.4} deg off, {points} points, sizes {scale:.5}",
        told["method"], kinematics["base_line_m"]
    );
    assert_eq!(told["method"], "consensus", "{told}");
    assert!(turn < 0.2 && way < 2.0, "{kinematics}");
    assert!(points >= 6 && scale < 0.02, "{points} {scale}");
    assert_eq!(first["structure"]["unit"], "m");
    let face = answer(&recording, &["--at", "0.1,3"]);
    assert_eq!((&face["method"], &face["pairs"]), (&"plane".into(), &4.into()), "{face}");
    assert!(number(&face["recording"]["kinematics"]["direction_off_deg"]) < 2.0, "{face}");
}
