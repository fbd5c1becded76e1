//! Two cameras in the loop: an object of unknown size is servoed on, in one process and in many to the last bit, and by the clock; frames
//! that do not pair, and what is wrong with a run file.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // helpers of tests are tests
#![allow(non_snake_case)]

use crate::common::{Instance, Lines, Run, kill, number, run, vservo, wait_until};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use vservo::config::{Config, assemble};
use vservo::control::outcome::Outcome;
use vservo::sim::{SystemRun, simulate_system};

fn file() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("config/stereo.toml")
}

fn text() -> String {
    std::fs::read_to_string(file()).unwrap()
}

fn parse(text: &str, set: &[&str]) -> Result<Config, String> {
    let set: Vec<String> = set.iter().map(ToString::to_string).collect();
    Config::parse("stereo.toml", text, Path::new("."), &set).map_err(|e| e.to_string())
}

fn alone(text: &str, set: &[&str]) -> SystemRun {
    simulate_system(&parse(text, set).unwrap(), &mut |_| ControlFlow::Continue(())).unwrap()
}

fn processes(text: &str, set: &[&str]) -> Run {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cell.toml");
    std::fs::write(&path, text).unwrap();
    let mut arguments = vec![path.to_str().unwrap(), "--clock", "lockstep"];
    set.iter().for_each(|s| arguments.extend(["--set", s]));
    run("stereo", &arguments)
}

/// The same file, whose right camera has more to say.
fn with_right(more: &str) -> String {
    text().replace("name = \"right\"\n", &format!("name = \"right\"\n{more}\n"))
}

/// The shipped file: the object is not as large as described, nobody is told, and the arm comes to the true place. In one process, in
/// five, and in five again: the same states.
#[test]
fn an_object_of_unknown_size_is_servoed_on() {
    let one = alone(&text(), &[]);
    assert_eq!(one.finish.outcome, Outcome::Converged, "{}", one.finish.reason);
    let (off_m, off_rad) = (one.errors.position_error_m.unwrap(), one.errors.orientation_error_rad.unwrap());
    assert!(off_m < 0.5e-3 && off_rad.to_degrees() < 0.1, "{off_m} {off_rad}");
    assert_eq!(one.target_lost, 0);
    for _ in 0..2 {
        let run = processes(&text(), &[]);
        assert_eq!(run.summary["state_hash"], one.state_hash, "{}", run.text());
        assert_eq!(run.summary["outcome"], "converged");
    }
    // One camera believes what it is told of the size, and ends elsewhere.
    let mut config: toml::Table = text().parse().unwrap();
    config.remove("stereo");
    let list = config.get_mut("cameras").unwrap().as_array_mut().unwrap();
    list.truncate(1);
    let believed = alone(&toml::to_string(&config).unwrap(), &["run.duration_s=20"]);
    assert!(believed.errors.position_error_m.unwrap() > 0.05, "{:?}", believed.errors);
}

/// Each camera loses frames of its own: those that have no mate say so, the others serve, and all of it repeats.
#[test]
fn frames_that_are_lost_leave_their_mates_alone() {
    let lossy = with_right("synthetic.frame_loss = 0.2")
        .replace("name = \"left\"\n", "name = \"left\"\nsynthetic.frame_loss = 0.1\n");
    let one = alone(&lossy, &[]);
    assert_eq!(one.finish.outcome, Outcome::Converged, "{}", one.finish.reason);
    let run = processes(&lossy, &[]);
    assert_eq!(run.summary["state_hash"], one.state_hash, "{}", run.text());
    let text = run.text();
    assert!(text.contains("no frame of the right camera at this instant"), "{text}");
    assert!(!text.contains("no frames of the two cameras pair"), "{text}");
}

/// Stamps that lie apart are no pairs: there is no measurement, the run holds and says why.
#[test]
fn frames_that_never_pair_are_told() {
    let apart = with_right("synthetic.stamp_error_ms = 15.0");
    let run = processes(&apart, &["run.duration_s=2"]);
    let text = run.text();
    assert_eq!(run.output.status.code(), Some(5), "{text}");
    assert!(
        run.summary["reason"].as_str().unwrap().contains("frames of the two cameras do not pair"),
        "{text}"
    );
    assert!(text.contains("15.00 ms apart") || text.contains("-25.00 ms apart"), "{text}");
    // what calibration would find puts it right
    let mended = with_right("synthetic.stamp_error_ms = 15.0\nstamp_offset_ms = -15.0");
    assert_eq!(alone(&mended, &[]).finish.outcome, Outcome::Converged);
}

/// Where the right camera sits is believed: an error of its angle moves the points, but those of the taught view alike.
#[test]
fn a_taught_file_takes_the_place_of_the_lesson() {
    let config = parse(&text(), &[]).unwrap();
    let view = assemble::taught_view(&config).unwrap();
    let points: Vec<String> = view
        .points_O()
        .map(|(id, p_O)| {
            let p = view.X_DO() * p_O;
            format!("[[points]]\nid = {id}\nposition_m = [{:?}, {:?}, {:?}]\n", p.x, p.y, p.z)
        })
        .collect();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("view.toml");
    std::fs::write(&path, points.join("\n")).unwrap();
    let set = format!("stereo.taught_file={}", path.display());
    let taught = parse(&text(), &[&set]).unwrap();
    assert_eq!(taught.effective.stereo.as_ref().unwrap().points.len(), view.count());
    let again = parse(&taught.to_toml().unwrap(), &[]).unwrap();
    assert_eq!(again.effective, taught.effective, "the effective file needs no other");
    let run = alone(&text(), &[&set]);
    assert_eq!(run.finish.outcome, Outcome::Converged, "{}", run.finish.reason);
    assert!(run.errors.position_error_m.unwrap() < 0.5e-3);
}

#[test]
fn what_is_wrong_with_a_pair_is_told_at_its_key() {
    let refused = |text: &str, set: &[&str], words: &[&str]| {
        let error = parse(text, set).map(|_| ()).unwrap_err();
        for word in words {
            assert!(error.contains(word), "{word}: {error}");
        }
    };
    let t = text();
    assert!(parse(&t, &[]).is_ok());
    refused(
        &t,
        &["stereo.pair_tolerance_ms=21"],
        &["stereo.pair_tolerance_ms", "more than half a frame period"],
    );
    refused(&t, &["stereo.pair_tolerance_ms=0"], &["stereo.pair_tolerance_ms: 0 is out of range"]);
    refused(&t, &["stereo.right_in_left.position_m=[0,0,0]"], &["cameras[1].mount", "sit in one place"]);
    refused(&t, &["stereo.taught_file=nowhere.toml"], &["stereo.taught_file", "cannot be read"]);
    refused(&t, &["stereo.tolerance_ms=2"], &["stereo.tolerance_ms", "unknown field"]);
    refused(&t, &["servo.dimension=4"], &["servo.dimension: must be 6 with [stereo]"]);
    refused(&t, &["servo.set_point.kind=taught"], &["servo.set_point.kind", "taught_file"]);
    refused(&t, &["servo.points=[1,2]"], &["servo.points", "all taught points count"]);
    refused(&t, &["run.task=calibrate_latency"], &["run.task", "must be `servo`"]);
    refused(&t, &["servo.desired.position_m=[-0.06,0.0,0.1]"], &["servo.desired: only 0", "in both images"]);
    refused(
        &with_right("rate_hz = 30.0"),
        &[],
        &["cameras[1].rate_hz", "frames of one instant need one rate"],
    );
    refused(
        &with_right("mount.position_m = [0.1, 0.0, 0.0]"),
        &[],
        &["cameras[1].mount", "leave out one of them"],
    );
    refused(
        &with_right("latency_ms = 30.0"),
        &["run.clock=lockstep"],
        &["cameras[1].latency_ms", "raise cameras[0].latency_ms"],
    );
    refused("[stereo]\n", &[], &["stereo: needs two [[cameras]]", "the run file has 1"]);
    let points = |list: &[(u32, [f64; 3])]| {
        let point = |(id, [x, y, z]): &(u32, [f64; 3])| {
            format!("[[stereo.points]]\nid = {id}\nposition_m = [{x:?}, {y:?}, {z:?}]\n")
        };
        format!("{t}\n{}", list.iter().map(point).collect::<String>())
    };
    let (a, b) = ((0, [0.0, 0.0, 0.4]), (1, [0.03, 0.0, 0.4]));
    refused(&points(&[a, b]), &[], &["stereo.points", "three at least"]);
    refused(&points(&[a, b, (2, [0.06, 0.0, 0.4])]), &[], &["lie in one line"]);
    refused(&points(&[a, b, (1, [0.0, 0.03, 0.4])]), &[], &["point 1 comes twice"]);
    refused(&points(&[a, b, (9999, [0.0, 0.03, 0.4])]), &[], &["point 9999 is none of the target's"]);
    refused(&points(&[a, b, (2, [0.0, 0.03, -0.4])]), &[], &["point 2: its position must lie before"]);
    refused(&points(&[a, b, (2, [0.0, 0.9, 0.4])]), &[], &["point 2 lies outside of an image"]);
    refused(&points(&[a, b, (2, [0.0, 1e9, 0.4])]), &[], &["stereo.points[2].position_m[1]", "out of range"]);
}

/// Five processes by the clock, to the goal; all of them are named in the summary.
#[test]
fn five_processes_converge_by_the_clock() {
    let run = run("stereo-rt", &[file().to_str().unwrap(), "--clock", "realtime"]);
    let s = &run.summary;
    assert_eq!(s["outcome"], "converged", "{}", run.text());
    assert!(number(s, &["final", "position_error_m"]) < 1e-3, "{s}");
    let processes = s["processes"].as_object().unwrap();
    for role in ["camera", "camera-1", "vision", "control"] {
        assert!(processes.contains_key(role), "{role}: {s}");
    }
    assert!(run.text().contains("target found by both cameras"), "{}", run.text());
}

/// The right camera's process dies: it is started anew, as any other, and the pair is measured again.
#[test]
fn a_killed_right_camera_is_started_anew() {
    let instance = Instance::new("stereo-death");
    let mut child = vservo()
        .args(["run", file().to_str().unwrap(), "--instance", &instance.name, "--duration-s", "60"])
        .args(["--set", "goal.feature_error_px=1e-6"])
        .stderr(Stdio::piped())
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let mut lines = Lines::of(&mut child);
    // Before its first tick a run ends with its camera.
    lines.wait_for("servoing");
    let right = instance
        .processes()
        .into_iter()
        .find(|pid| {
            let line = std::fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
            let words: Vec<_> = line.split(|b| *b == 0).collect();
            words.get(1) == Some(&&b"camera"[..]) && words.windows(2).any(|w| w == [&b"--camera"[..], b"1"])
        })
        .unwrap();
    kill(right, "KILL");
    lines.wait_for("the camera-1 process died (killed by signal 9)");
    lines.wait_for("the camera-1 process is back");
    lines.wait_for("servoing");
    kill(child.id() as i32, "TERM");
    lines.drain();
    assert_eq!(child.wait().unwrap().code(), Some(6));
    instance.assert_gone();
}

/// One vision process serves both: a second one is refused, and says so.
#[test]
fn a_vision_process_of_the_right_camera_alone_is_refused() {
    let instance = Instance::new("stereo-second");
    let output = vservo()
        .args(["vision", file().to_str().unwrap(), "--camera", "1", "--instance", &instance.name])
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(3), "{text}");
    assert!(text.contains("one vision process serves both cameras"), "{text}");
}

/// `ctl teach` before a pair: the goal is where the arm stands, as a pose, although the points are no plane.
#[test]
fn a_pair_is_taught_on_request() {
    let instance = Instance::new("stereo-teach");
    let mut daemon = vservo()
        .args(["serve", file().to_str().unwrap(), "--clock", "lockstep", "--instance", &instance.name])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let ctl = |what: &str| {
        let output = vservo().args(["ctl", what, "--json", "--instance", &instance.name]).output().unwrap();
        let answer: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap_or_default();
        (output.status.code(), answer)
    };
    wait_until("the daemon to answer", || ctl("status").0 == Some(0));
    let off_m = || ctl("status").1["position_error_m"].as_f64();
    wait_until("a measurement", || off_m().is_some_and(|m| m > 0.1));
    assert_eq!(ctl("teach").0, Some(0));
    wait_until("the goal to be taught", || ctl("status").1["state"] == "held");
    wait_until("a measurement of the new goal", || off_m().is_some_and(|m| m < 1e-3));
    assert_eq!(ctl("start").0, Some(0));
    wait_until("the arm to servo", || ctl("status").1["state"] == "servoing");
    assert!(off_m().unwrap() < 1e-3);
    assert_eq!(ctl("shutdown").0, Some(0));
    assert_eq!(daemon.wait().unwrap().code(), Some(0));
    instance.assert_gone();
}
