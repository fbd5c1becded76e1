//! `vservo pose` as a real process: against the chapter's Example 10.1 in closed form, and against OpenCV's poses with covariances
//! written out in numpy (`tests/fixtures/image_tools`).

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // helpers of tests are tests

use crate::process_image::{ended, fixture, numbers};
use serde_json::Value;

fn answer(arguments: &[&str]) -> Value {
    let (code, out, err) = ended(&[&["pose"], arguments, &["--json"]].concat());
    assert_eq!(code, 0, "{err}");
    serde_json::from_str(&out).unwrap()
}

fn list(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
}

#[track_caller]
fn same(ours: &Value, theirs: &Value, within: f64) {
    let (a, b) = (list(ours), list(theirs));
    let off = a.iter().zip(&b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(a.len() == b.len() && off < within, "{a:?} against {b:?}");
}

/// Quaternions of one rotation have two signs.
#[track_caller]
fn same_rotation(ours: &Value, theirs: &Value, within: f64) {
    let dot: f64 = list(ours).iter().zip(list(theirs)).map(|(a, b)| a * b).sum();
    assert!(2.0 * (1.0 - dot.abs().min(1.0)).sqrt() < within, "{ours} against {theirs}");
}

#[test]
fn solutions_and_covariances_are_those_of_opencv_and_numpy() {
    let all = numbers();
    for (name, method, count) in [("square", "planar", 2), ("box", "pnp", 1), ("box", "dlt", 1)] {
        let ours = answer(&[fixture(&format!("{name}.csv")).to_str().unwrap(), "--method", method]);
        let theirs = all["poses"][name].as_array().unwrap();
        assert_eq!(ours["ambiguous"], false, "{ours}");
        let solutions = ours["solutions"].as_array().unwrap();
        assert!(solutions.len() >= count, "{name} {method}: {solutions:?}");
        for (own, other) in solutions.iter().zip(theirs).take(count) {
            let refined = &own["refined"];
            same(&refined["position_m"], &other["position_m"], 2e-5);
            same_rotation(&refined["rotation_xyzw"], &other["rotation_xyzw"], 2e-4);
            let rms = other["rms"].as_f64().unwrap();
            assert!((refined["rms"].as_f64().unwrap() / rms - 1.0).abs() < 1e-4, "{refined}");
        }
        // the covariance is compared where both have the same minimum to the last digits: the first
        let (own, other) = (&solutions[0]["refined"]["covariance"], &theirs[0]["covariance"]);
        let size = list(other).iter().fold(0.0f64, |m, v| m.max(v.abs()));
        same(own, other, 2e-3 * size);
    }
}

#[test]
fn three_points_have_four_poses_and_that_is_said() {
    let ours = answer(&[fixture("three.csv").to_str().unwrap(), "--method", "p3p"]);
    let theirs = numbers()["poses"]["three"].clone();
    let (solutions, theirs) = (ours["solutions"].as_array().unwrap(), theirs.as_array().unwrap());
    assert_eq!((solutions.len(), theirs.len()), (4, 4), "{ours}");
    for other in theirs {
        let z = list(&other["position_m"])[2];
        let own = solutions.iter().find(|s| (list(&s["position_m"])[2] - z).abs() < 1e-7);
        let own = own.unwrap_or_else(|| panic!("no pose at {z}: {solutions:?}"));
        same_rotation(&own["rotation_xyzw"], &other["rotation_xyzw"], 1e-5);
    }
    assert_eq!(ours["ambiguous"], true);
    assert!(ours["reason"].as_str().unwrap().contains("4 poses explain three points"), "{ours}");
}

/// Example 10.1: the square seen from 0.5 m, turned by 45 degrees about y.
fn example_10_1(folder: &std::path::Path) -> std::path::PathBuf {
    let half = 0.5f64.sqrt();
    let mut text = String::from("id,x_m,y_m,z_m,X,Y\n");
    for (id, (x, y)) in [(0.0, 0.0), (0.1, 0.0), (0.1, 0.1), (0.0, 0.1)].into_iter().enumerate() {
        let z = 0.5 - half * x;
        text += &format!("{id},{x},{y},0,{},{}\n", half * x / z, y / z);
    }
    let path = folder.join("example.csv");
    std::fs::write(&path, text).unwrap();
    path
}

#[test]
fn example_10_1_by_every_method_that_takes_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = example_10_1(folder.path());
    let path = path.to_str().unwrap();
    let (sin, cos) = (std::f64::consts::PI / 8.0).sin_cos();
    let wanted = serde_json::json!({ "p": [0.0, 0.0, 0.5], "q": [0.0, sin, 0.0, cos] });
    for method in ["planar", "pnp", "virtual_servoing"] {
        // from the start of Example 10.4's kind: in front, tilted the right way
        let start = ["--start", "0,0,1,0,0.785398163397,0"];
        let extra: &[&str] = if method == "virtual_servoing" { &start } else { &[] };
        let ours = answer(&[&[path, "--method", method], extra].concat());
        let first = &ours["solutions"][0];
        same(&first["position_m"], &wanted["p"], 1e-7);
        same_rotation(&first["rotation_xyzw"], &wanted["q"], 1e-6);
        assert!(first["refined"]["covariance"].is_null(), "no deviation is stated: {first}");
    }
    // six points in space are wanted
    let (code, _, err) = ended(&["pose", path, "--method", "dlt"]);
    assert!(code == 5 && err.contains("at least 6"), "{err}");
    let (code, _, err) = ended(&["pose", path, "--method", "p3p"]);
    assert!(code == 5 && err.contains("takes three points, not 4"), "{err}");
}

#[test]
fn poses_go_on_to_base_and_end_effector() {
    let folder = tempfile::tempdir().unwrap();
    let path = example_10_1(folder.path());
    let path = path.to_str().unwrap();
    // a camera that looks down from (0.4, 0, 1): a half turn about x
    let camera = "0.4,0,1,1,0,0,0";
    let ours = answer(&[path, "--method", "planar", "--sd", "0.001", "--camera-in-base", camera]);
    let first = &ours["solutions"][0];
    same(&first["object_in_base"]["position_m"], &serde_json::json!([0.4, 0.0, 0.5]), 1e-6);
    // turned about x by half a turn: y and z change their signs, variances stay
    let (own, base) = (list(&first["refined"]["covariance"]), list(&first["object_in_base"]["covariance"]));
    for i in 0..3 {
        assert!((own[7 * i] / base[7 * i] - 1.0).abs() < 1e-9, "{own:?} {base:?}");
    }
    assert!((own[1] + base[1]).abs() < 1e-15, "x with y changes its sign");
    let back = answer(&[path, "--method", "planar", "--object-in-base", &place(&first["object_in_base"])]);
    same(&back["solutions"][0]["camera_in_base"]["position_m"], &serde_json::json!([0.4, 0.0, 1.0]), 1e-6);
    // the end-effector 0.1 m behind the camera along its axis, turned alike
    let (object, effector) = (place(&first["object_in_base"]), "0.4,0,1.1,1,0,0,0");
    let arguments = [path, "--method", "planar", "--object-in-base", &object, "--effector-in-base", effector];
    let back = answer(&arguments);
    same(
        &back["solutions"][0]["camera_in_effector"]["position_m"],
        &serde_json::json!([0.0, 0.0, 0.1]),
        1e-6,
    );
    let on_arm = answer(&[path, "--method", "planar", "--camera-in-effector", "0,0,0.1,0,0,0,1"]);
    same(
        &on_arm["solutions"][0]["object_in_effector"]["position_m"],
        &serde_json::json!([0.0, 0.0, 0.6]),
        1e-6,
    );
    let (code, _, err) = ended(&["pose", path, "--method", "planar", "--camera-in-base", "1,2,3"]);
    assert!(code == 2 && err.contains("seven numbers"), "{err}");
}

fn place(pose: &Value) -> String {
    let numbers = [list(&pose["position_m"]), list(&pose["rotation_xyzw"])].concat();
    numbers.iter().map(|v| format!("{v:?}")).collect::<Vec<_>>().join(",")
}

#[test]
fn a_far_frontal_square_is_ambiguous() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("far.csv");
    // a square of 0.1 m seen from 2 m, turned by 10 degrees about y, to a thousandth of the distance
    let (sin, cos) = 10f64.to_radians().sin_cos();
    let mut text = String::from("x_m,y_m,X,Y,sd\n");
    for (x, y) in [(-0.05, -0.05), (0.05, -0.05), (0.05, 0.05), (-0.05, 0.05)] {
        let z = 2.0 - sin * x;
        text += &format!("{x},{y},{},{},0.001\n", cos * x / z, y / z);
    }
    std::fs::write(&path, text).unwrap();
    let ours = answer(&[path.to_str().unwrap(), "--method", "planar"]);
    assert_eq!(
        (ours["ambiguous"].as_bool(), ours["solutions"].as_array().unwrap().len()),
        (Some(true), 2),
        "{ours}"
    );
    // a parallel plane has four unknowns
    let text = "x_m,y_m,X,Y\n0,0,0.05,0.1\n0.1,0,0.05,0.3\n0.1,0.1,-0.15,0.3\n";
    std::fs::write(&path, text).unwrap();
    // seen from 0.5 m, turned by 90 degrees about z
    let ours = answer(&[
        path.to_str().unwrap(),
        "--method",
        "virtual_servoing",
        "--parallel",
        "--start",
        "0,0,1,1.2,0,0",
    ]);
    same(&ours["solutions"][0]["position_m"], &serde_json::json!([0.025, 0.05, 0.5]), 1e-6);
    let half = 0.5f64.sqrt();
    same_rotation(&ours["solutions"][0]["rotation_xyzw"], &serde_json::json!([0.0, 0.0, half, half]), 1e-6);
}
