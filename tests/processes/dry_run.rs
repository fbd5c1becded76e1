//! Runs without an arm, `drive.kind = "none"`: vision and law go, nothing moves, and the requested velocity of the camera is shown. And runs of an arm that was
//! recorded, `drive.kind = "replay"`: it moves as it did, whatever it is told.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, non_snake_case)] // helpers of tests are tests

use crate::common::{Instance, run as run_with, vservo};
use serde_json::Value;
use std::path::{Path, PathBuf};
use vservo::config::{Config, assemble};
use vservo::messages::{ControlState, TraceMsg};
use vservo::record::RecordingReader;
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
    let X_WC = config.camera.mount.X_WC(&robot, &nalgebra::SVector::from_row_slice(&q_start));
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

/// The ticks of a recording.
fn ticks(path: &Path) -> Vec<TraceMsg> {
    let mut reader = RecordingReader::open(std::fs::File::open(path).unwrap()).unwrap();
    let mut ticks = Vec::new();
    while let Some(message) = reader.next_message().unwrap() {
        if message.topic() == "/control/trace" {
            ticks.push(message.record().unwrap());
        }
    }
    ticks
}

/// Records the default run in lockstep.
fn recorded(name: &str, folder: &Path) -> PathBuf {
    let path = folder.join("cell.mcap");
    let made = run_with(name, &["--clock", "lockstep", "--record", path.to_str().unwrap()]);
    assert_eq!(made.output.status.code(), Some(0), "{}", made.text());
    path
}

/// Arm and camera of a recording.
fn replayed(path: &Path) -> [String; 4] {
    let path = path.display();
    [
        "drive.kind=replay".into(),
        format!("drive.replay.recording={path}"),
        "camera.source=replay".into(),
        format!("camera.replay.recording={path}"),
    ]
}

#[test]
fn a_recorded_cell_is_commanded_as_it_was_and_moves_as_it_did() {
    let folder = tempfile::tempdir().unwrap();
    let cell = recorded("dry-cell", folder.path());
    let again = |name: &str, more: &[&str]| {
        let dry = folder.path().join(format!("{name}.mcap"));
        let mut arguments = vec!["--clock", "lockstep", "--record", dry.to_str().unwrap()];
        let settings = replayed(&cell);
        for set in settings.iter().map(String::as_str).chain(more.iter().copied()) {
            arguments.extend(["--set", set]);
        }
        let made = run_with(name, &arguments);
        assert_eq!(made.output.status.code(), Some(0), "{}", made.text());
        assert_eq!(made.summary["outcome"], "finished", "{}", made.summary);
        assert_eq!(made.summary["reason"], "the recorded motion of the arm is over");
        (ticks(&dry), dry)
    };
    let then = ticks(&cell);
    let (same, dry) = again("dry-same", &[]);
    let (other, _) = again("dry-other", &["servo.gain_1_s=5", "drive.mode=velocity"]);
    for now in [&same, &other] {
        // The order to end takes a tick.
        assert!((then.len()..=then.len() + 1).contains(&now.len()), "{} of {}", now.len(), then.len());
        for (a, b) in then.iter().zip(now) {
            assert_eq!(
                (a.tick, a.q, a.qd, a.frame_id, a.exposure),
                (b.tick, b.q, b.qd, b.frame_id, b.exposure)
            );
        }
    }
    // A goal that is reached ends the one and not the other.
    let until = then.iter().position(|t| t.state == ControlState::Converged as u32 || t.orders > 2);
    let until = until.unwrap_or(then.len());
    assert!(until > 1000, "{until}");
    for (a, b) in then.iter().zip(&same).take(until) {
        assert_eq!((a.q_r, a.qd_r, a.tau), (b.q_r, b.qd_r, b.tau), "tick {}", a.tick);
    }
    assert!(then.iter().zip(&other).take(until).any(|(a, b)| a.qd_r != b.qd_r));
    let replay = vservo().arg("replay").arg(&dry).output().unwrap();
    let told = String::from_utf8_lossy(&replay.stdout);
    assert!(replay.status.success() && told.starts_with("identical"), "{told}");
}

#[test]
fn a_recorded_arm_moves_by_the_clock_too() {
    let folder = tempfile::tempdir().unwrap();
    let cell = recorded("dry-clock-cell", folder.path());
    let dry = folder.path().join("dry.mcap");
    let mut arguments = vec!["--clock", "realtime", "--record", dry.to_str().unwrap()];
    let settings = replayed(&cell);
    for set in &settings {
        arguments.extend(["--set", set]);
    }
    let made = run_with("dry-clock", &arguments);
    assert_eq!(made.summary["reason"], "the recorded motion of the arm is over", "{}", made.text());
    let (then, now) = (ticks(&cell), ticks(&dry));
    assert_eq!(now.last().unwrap().q, then.last().unwrap().q);
    // Each state is that of the time since the begin, within a tick; a loaded machine misses some ticks.
    let begin = now[0].stamp;
    let mut seen = 0;
    for tick in &now {
        let since_ms = (tick.stamp - begin).0 as f64 * 1e-6;
        let nearest = (since_ms.round() as usize).min(then.len() - 1);
        let near = [nearest.saturating_sub(1), nearest, (nearest + 1).min(then.len() - 1)];
        assert!(near.iter().any(|k| then[*k].q == tick.q), "at {since_ms} ms");
        seen += usize::from(tick.frame_id > 0);
    }
    assert!(seen > 10, "{seen} measurements");
}

#[test]
fn the_recording_of_another_arm_is_refused_with_both_lists() {
    let folder = tempfile::tempdir().unwrap();
    let cell = recorded("dry-arm", folder.path());
    let [kind, recording, ..] = replayed(&cell);
    let made = run_with("dry-ur5", &["ur5", "--set", &kind, "--set", &recording]);
    assert_eq!(made.output.status.code(), Some(3), "{}", made.text());
    let told = made.text();
    assert!(told.contains("drive.replay.recording") && told.contains("its arm has the joints"), "{told}");
    assert!(told.contains("shoulder_pan_joint") && told.contains("robot.model"), "{told}");
}

#[test]
fn a_recorded_arm_takes_what_needs_no_obedience() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.mcap");
    std::fs::write(&file, "").unwrap();
    let (kind, file) = ("drive.kind=replay", format!("drive.replay.recording={}", file.display()));
    let load = |set: &[&str]| {
        Config::load(None, &set.iter().map(ToString::to_string).collect::<Vec<_>>())
            .map_err(|error| error.to_string())
    };
    let config = load(&[kind, &file, "servo.scheme=image_pd"]).unwrap();
    assert!(!config.closes_the_loop() && config.has_an_arm());
    for (set, told) in [
        ("drive.replay.recording=/nowhere.mcap", "drive.replay.recording: /nowhere.mcap is not a file"),
        ("drive.replay.recording=''", "drive.replay.recording: is missing"),
        ("run.serve=true", "run.serve"),
        ("run.task=calibrate_load", "drive.kind: is `replay`"),
        ("servo.scheme=look_and_move", "servo.scheme"),
        ("camera.source=v4l2", "camera.source: does not show the motion of the recorded arm"),
        ("servo.interaction=estimated", "servo.interaction"),
    ] {
        let error = load(&[kind, &file, set]).unwrap_err();
        assert!(error.contains(told), "{set}: {error}");
    }
}
