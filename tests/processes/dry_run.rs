//! Runs without an arm, `drive.kind = "none"`: vision and law go, nothing moves, and the requested velocity of the camera is shown.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, non_snake_case)] // helpers of tests are tests

use crate::common::{Instance, vservo};
use serde_json::Value;
use vservo::config::{Config, assemble};
use vservo::sim;

fn config(set: &[&str]) -> Result<Config, vservo::config::ConfigError> {
    let mut all = vec!["drive.kind=none".to_string(), "run.clock=lockstep".into(), "run.duration_s=2".into()];
    all.extend(set.iter().map(ToString::to_string));
    Config::load(None, &all)
}

/// Exit code, summary and stderr of a run of the program.
fn run(name: &str, set: &[&str]) -> (Option<i32>, Value, String) {
    let instance = Instance::new(name);
    let folder = tempfile::tempdir().unwrap();
    let summary = folder.path().join("summary.json");
    let mut command = vservo();
    command.args(["run", "--instance", &instance.name, "--summary"]).arg(&summary);
    for set in set {
        command.args(["--set", set]);
    }
    let output = command.output().unwrap();
    instance.assert_gone();
    let summary = std::fs::read_to_string(summary).map_or(Value::Null, |s| serde_json::from_str(&s).unwrap());
    (output.status.code(), summary, String::from_utf8_lossy(&output.stderr).into_owned())
}

#[test]
fn the_law_runs_and_the_line_shows_what_it_asks_of_the_camera() {
    // Long enough for lines of progress: one a second where stderr is no terminal.
    let (code, summary, told) = run("dry-real", &["drive.kind=none", "run.duration_s=4"]);
    assert_eq!(code, Some(0), "{told}");
    assert_eq!(summary["outcome"], "finished", "{summary}");
    assert_eq!(summary["reason"], "run.duration_s is over");
    let lines: Vec<&str> = told.lines().filter(|line| line.contains("camera v ")).collect();
    assert!(!lines.is_empty() && lines[0].contains("mm/s  w "), "{told}");
}

#[test]
fn nothing_moves_and_the_request_stays_that_of_the_first_view() {
    let config = config(&["camera.synthetic.noise_sd_levels=0"]).unwrap();
    let robot = config.robot.build::<4>().unwrap();
    let q_start = config.start.q.clone();
    let mut control = assemble::control_loop(&config, robot.clone()).unwrap();
    let X_WC = config.camera.mount.X_WC(&robot.forward(&nalgebra::SVector::from_row_slice(&q_start)));
    let X_CO = X_WC.inv_mul(&config.scene.as_ref().unwrap().X_WO);
    let points: Vec<_> = config.target.points().iter().map(|p| p.p_O).collect();
    let (mut seen, mut finish) = (None, None);
    for tick in 0..5_000 {
        let now = vservo::time::MonoNs(tick as i64 * 1_000_000);
        let m = (tick % 40 == 20).then(|| sim::perfect_measurement(&points, &X_CO, now).unwrap());
        let trace = control.tick(tick, now, m.as_ref());
        assert_eq!(trace.joint_state.q[..4], q_start[..]);
        assert_eq!(trace.command.qd_r, [0.0; 7]);
        assert_eq!(trace.command.q_r[..4], q_start[..]);
        if let Some(status) = trace.status
            && status.measurements > 0
        {
            let V_C = *seen.get_or_insert(status.V_C);
            assert!(V_C.iter().all(|x| x.is_finite()) && V_C.iter().any(|x| x.abs() > 1e-2), "{V_C:?}");
            assert_eq!(status.V_C, V_C, "at {tick}");
        }
        finish = trace.finish;
        if finish.is_some() {
            // The duration is over at tick 2000; the order to end takes effect at the next one.
            assert_eq!(tick, 2_001);
            break;
        }
    }
    assert!(seen.is_some());
    assert_eq!(finish.unwrap().reason, "run.duration_s is over");
}

#[test]
fn an_arm_that_moves_shows_no_request_of_the_camera() {
    let config = Config::load(None, &["run.clock=lockstep".into(), "run.duration_s=0.2".into()]).unwrap();
    let mut control = assemble::control_loop(&config, config.robot.build::<4>().unwrap()).unwrap();
    let trace = control.tick(0, vservo::time::MonoNs(0), None);
    assert!(trace.status.unwrap().V_C.iter().all(|x| x.is_nan()));
}

#[test]
fn what_needs_an_arm_is_refused() {
    for (set, key) in [
        ("run.serve=true", "run.serve"),
        ("run.task=calibrate_latency", "drive.kind"),
        ("servo.scheme=position_pd", "servo.scheme"),
        ("servo.scheme=image_pd", "servo.scheme"),
    ] {
        let problems = config(&[set]).unwrap_err().problems;
        assert!(problems.iter().any(|p| p.key == key), "{set}: {problems:?}");
    }
    for scheme in ["position_resolved_velocity", "image_resolved_velocity", "hybrid"] {
        config(&[&format!("servo.scheme={scheme}")]).unwrap();
    }
}

#[test]
fn the_run_files_of_real_cameras_are_accepted() {
    let load = |name: &str| {
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("config/{name}.toml"));
        Config::load(Some(&path), &[]).unwrap()
    };
    let (hand, cell) = (load("hand-held"), load("real-cell"));
    for config in [&hand, &cell] {
        assert!(config.scene.is_none() && config.warnings.is_empty(), "{:?}", config.warnings);
        assert_eq!(config.camera.model.intrinsics().fx_px, 612.4, "from the calibration file");
    }
    assert!(!hand.closes_the_loop());
    assert!(cell.closes_the_loop());
}
