//! Cells that are not as the run file says: lens, mount and size of the target. Image-based laws with a taught goal converge in spite of that, and the run tells
//! what does not fit.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::common::{run, vservo};
use serde_json::Value;

/// `--set` for each value.
fn sets(values: &[String]) -> Vec<&str> {
    values.iter().flat_map(|value| ["--set", value.as_str()]).collect()
}

fn lockstep(test: &str, file: &str, values: &[String]) -> Value {
    let mut args = vec![file, "--clock", "lockstep", "--duration-s", "15"];
    args.extend(sets(values));
    run(test, &args).summary
}

fn lens(f_px: f64, cx_px: f64, cy_px: f64, k1: f64) -> Vec<String> {
    let numbers = [("fx_px", f_px), ("fy_px", f_px), ("cx_px", cx_px), ("cy_px", cy_px), ("k1", k1)];
    numbers.iter().map(|(key, value)| format!("scene.camera.lens.{key}={value}")).collect()
}

/// Goals that were taught in the cell as it is, at the posture in which the arm ends when all is as described.
#[test]
fn a_coarse_description_suffices_for_a_taught_goal() {
    let folder = tempfile::tempdir().unwrap();
    let goal = folder.path().join("goal.toml");
    let at_goal = "robot.q_start_rad_or_m=[-0.02041,-1.60918,1.95122,-1.91285,-1.57077,-0.02044]".to_owned();
    let cells = [
        (lens(580.0, 360.0, 200.0, -0.10), [8.0, -6.0, 5.0], 1.0),
        (lens(784.0, 325.0, 236.0, -0.13), [0.0, 6.0, 10.0], 0.93),
        (lens(900.0, 319.5, 239.5, 0.0), [2.0, -2.0, 18.0], 1.0),
    ];
    for (k, (mut cell, rpy, scale)) in cells.into_iter().enumerate() {
        cell.push(format!("scene.camera.mount.rotation_rpy_deg={rpy:?}"));
        cell.push(format!("scene.target.scale={scale}"));
        let mut values = cell.clone();
        values.push(at_goal.clone());
        let taught =
            vservo().args(["teach", "ur5", "--out"]).arg(&goal).args(sets(&values)).output().unwrap();
        assert!(taught.status.success(), "{k}: {}", String::from_utf8_lossy(&taught.stderr));
        cell.push(format!("servo.set_point.file={}", goal.display()));
        let summary = lockstep("coarse", "ur5", &cell);
        assert_eq!(summary["outcome"], "converged", "{k}: {summary}");
        // Truth: the pixels that were taught, by the true lens, and the place from which that sees them.
        let error_of = |key: &str| summary["final"][key].as_f64().unwrap();
        // centres of dots are corrected for their slant by the believed lens, which leaves a tenth of a pixel
        assert!(error_of("feature_error_px") < 0.2, "{k}: {}", summary["final"]);
        assert!(error_of("position_error_m") < 1e-3, "{k}: {}", summary["final"]);
        assert!(error_of("orientation_error_rad") < 5e-3, "{k}: {}", summary["final"]);
        let believed_px = summary["final"]["believed"]["feature_error_px"].as_f64().unwrap();
        assert!(believed_px < 0.1, "{k}: {}", summary["final"]);
        std::fs::remove_file(&goal).unwrap();
        std::fs::remove_file(goal.with_extension("png")).unwrap();
    }
}

/// A lens that is believed a third too long puts the taught view out of the arm's reach: nobody says so, since the arm stands there.
#[test]
fn a_taught_goal_is_no_pose_that_is_out_of_reach() {
    let folder = tempfile::tempdir().unwrap();
    let goal = folder.path().join("goal.toml");
    let mut cell = lens(800.0, 319.5, 239.5, -0.15);
    cell.extend(["camera.lens.fx_px=1040".to_owned(), "camera.lens.fy_px=1040".to_owned()]);
    let mut values = cell.clone();
    values.push("robot.q_start_rad_or_m=[-0.0204,-1.6092,1.9512,-1.9128,-1.5708,-0.0204]".into());
    let taught = vservo().args(["teach", "ur5", "--out"]).arg(&goal).args(sets(&values)).output().unwrap();
    assert!(taught.status.success(), "{}", String::from_utf8_lossy(&taught.stderr));
    cell.push(format!("servo.set_point.file={}", goal.display()));
    let mut args = vec!["ur5", "--clock", "lockstep"];
    args.extend(sets(&cell));
    let run = run("far-lens", &args);
    let (summary, words) = (&run.summary, String::from_utf8_lossy(&run.output.stderr));
    assert_eq!(summary["outcome"], "converged", "{summary}");
    assert!(summary["final"]["feature_error_px"].as_f64().unwrap() < 0.1, "{}", summary["final"]);
    assert!(summary["final"]["position_error_m"].as_f64().unwrap() < 1e-3, "{}", summary["final"]);
    assert!(!words.contains("cannot bring the camera there") && !words.contains("servo.desired"), "{words}");
}

/// A camera turned by 100 degrees on the flange, with half the focal length and a larger target: to the view that was taught there.
#[test]
fn an_uncalibrated_run_comes_to_its_taught_goal() {
    let folder = tempfile::tempdir().unwrap();
    let goal = folder.path().join("goal.toml");
    let mut cell = lens(450.0, 350.0, 215.0, -0.05);
    cell.push("scene.camera.mount.rotation_rpy_deg=[4.0, -6.0, 100.0]".into());
    cell.push("scene.target.scale=1.4".into());
    let mut values = cell.clone();
    values.push("robot.q_start_rad_or_m=[-0.02041,-1.60918,1.95122,-1.91285,-1.57077,-0.02044]".into());
    let teach = ["teach", "ur5", "--uncalibrated", "--out"];
    let taught = vservo().args(teach).arg(&goal).args(sets(&values)).output().unwrap();
    assert!(taught.status.success(), "{}", String::from_utf8_lossy(&taught.stderr));
    cell.push("robot.q_start_rad_or_m=[0.1,-1.65,1.9,-1.85,-1.65,0.1]".into());
    // a goal that no camera can see without its lens
    let refused =
        vservo().args(["run", "ur5", "--uncalibrated"]).args(sets(&cell)).output().expect("vservo runs");
    let words = String::from_utf8_lossy(&refused.stderr);
    assert_eq!(refused.status.code(), Some(3), "{words}");
    assert!(words.contains("servo.set_point.kind") && words.contains("vservo teach"), "{words}");
    cell.push(format!("servo.set_point.file={}", goal.display()));
    let mut args = vec!["ur5", "--uncalibrated", "--clock", "lockstep"];
    args.extend(sets(&cell));
    let summary = run("uncalibrated", &args).summary;
    assert_eq!(summary["outcome"], "converged", "{summary}");
    let error_px = summary["final"]["believed"]["feature_error_px"].as_f64().unwrap();
    assert!(error_px < 0.1, "{}", summary["final"]);
}

/// What the run tells of the lens is true within its deviation, for four dots and a board.
#[test]
fn a_run_tells_which_lens_fits() {
    let cells = [
        ("ur5", lens(880.0, 319.5, 239.5, -0.15), "camera.lens.fx_px", 880.0),
        ("ur5", lens(700.0, 319.5, 239.5, -0.15), "camera.lens.fx_px", 700.0),
        ("ur5", lens(800.0, 350.0, 239.5, -0.15), "camera.lens.cx_px", 350.0),
        ("chessboard", lens(770.0, 319.5, 239.5, -0.15), "camera.lens.fx_px", 770.0),
    ];
    for (file, values, key, truth) in cells {
        let summary = lockstep("lens", file, &values);
        assert_eq!(summary["outcome"], "converged", "{file} {key} {truth}: {summary}");
        let told = summary["model_error"]["differences"].as_array().unwrap();
        let found =
            told.iter().find(|d| d["key"] == key).unwrap_or_else(|| panic!("{file} {truth}: {summary}"));
        let (estimated, sd) = (found["estimated"].as_f64().unwrap(), found["sd"].as_f64().unwrap());
        assert!((estimated - truth).abs() < 4.0 * sd + 0.002 * truth, "{file}: {estimated} +- {sd}, {truth}");
    }
    assert_eq!(lockstep("lens", "ur5", &[])["model_error"], Value::Null, "all is as described");
}
