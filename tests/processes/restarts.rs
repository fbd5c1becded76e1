//! Camera and vision that die or hang are started anew while the arm holds, and the run goes on as `safety.resume` says.

#![allow(clippy::unwrap_used, clippy::print_stdout)] // helpers of tests are tests; a figure that is measured

use crate::common::{Instance, Lines, kill, vservo, wait_for_process, wait_until};
use crate::serve::ServiceManager;
use serde_json::Value;
use std::fs::File;
use std::process::{Child, Stdio};
use vservo::messages::Measurement;
use vservo::record::RecordingReader;
use vservo::rt;

/// A served run in real time whose goal is never reached for good, with what it says.
struct Cell {
    instance: Instance,
    process: Child,
    lines: Lines,
}

impl Cell {
    fn start(test: &str, set: &[&str]) -> Self {
        Self::with(test, &set.iter().flat_map(|set| ["--set", set]).collect::<Vec<_>>())
    }

    fn with(test: &str, arguments: &[&str]) -> Self {
        let instance = Instance::new(test);
        let mut process = vservo()
            .args(["serve", "--instance", &instance.name])
            .args(arguments)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut lines = Lines::of(&mut process);
        lines.wait_for("target found");
        Self { instance, process, lines }
    }

    fn servoing(test: &str, set: &[&str]) -> Self {
        Self::start(test, set).started()
    }

    fn started(mut self) -> Self {
        assert_eq!(self.ctl("start").0, Some(0));
        // The supervisor's own line: it knows from then on that all have worked.
        self.lines.wait_for(" s  servoing ");
        self
    }

    fn ctl(&self, what: &str) -> (Option<i32>, Value) {
        let output =
            vservo().args(["ctl", what, "--json", "--instance", &self.instance.name]).output().unwrap();
        (output.status.code(), serde_json::from_slice(&output.stdout).unwrap_or_default())
    }

    fn state(&self) -> String {
        self.ctl("status").1["state"].as_str().unwrap_or("gone").into()
    }

    fn wait_for_state(&self, state: &str) {
        wait_until(&format!("the cell to be {state}"), || self.state() == state);
    }

    fn restarts(&self, role: &str) -> u64 {
        self.ctl("status").1[format!("{role}_restarts")].as_u64().unwrap_or(0)
    }

    /// Waits until `role` has been started anew so often and the arm is servoed again.
    fn wait_until_back(&self, role: &str, times: u64) {
        wait_until(&format!("{role} to be back"), || {
            let (_, status) = self.ctl("status");
            status[format!("{role}_restarts")] == times && status["state"] == "servoing"
        });
    }

    /// Ends it by SIGTERM: what it printed.
    fn ended(self) -> String {
        kill(self.process.id() as i32, "TERM");
        self.lines.drain();
        let output = self.process.wait_with_output().unwrap();
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        assert_eq!(output.status.code(), Some(0), "{text}");
        self.instance.assert_gone();
        text
    }
}

#[test]
fn a_killed_camera_or_vision_is_back_and_the_arm_servoes_again() {
    let mut cell = Cell::servoing("again", &[]);
    for (k, role) in ["camera", "vision"].into_iter().enumerate() {
        let killed = rt::now();
        kill(wait_for_process(&cell.instance, role), "KILL");
        let why = cell.lines.wait_for("control goes on without it");
        assert!(why.contains(&format!("the {role} process died (killed by signal 9)")), "{why}");
        assert!(why.contains("try 1 to start it anew comes at once"), "{why}");
        cell.wait_until_back(role, 1);
        // For the figure in docs/safety.md; nothing is asserted of it, since other work loads the machine.
        println!("{role} is back and the arm servoed {:.2} s after the kill", (rt::now() - killed).as_s());
        assert_eq!(cell.restarts("camera") + cell.restarts("vision"), k as u64 + 1);
    }
    let text = cell.ended();
    assert!(text.contains("started anew  camera 1, vision 1"), "{text}");
    assert!(text.contains("vision process started anew, restart 1"), "{text}");
}

/// The kernel tells a suspended process from a slow one, so that another is there within a second or so: judged by the stamps of the measurements, which the run records.
#[test]
fn a_suspended_camera_or_vision_is_killed_and_started_anew() {
    let folder = tempfile::tempdir().unwrap();
    let recording = folder.path().join("run.mcap");
    let mut cell = Cell::with("frozen", &["--record", recording.to_str().unwrap()]).started();
    let mut suspended = Vec::new();
    for role in ["camera", "vision"] {
        let frozen = wait_for_process(&cell.instance, role);
        let before = rt::now();
        kill(frozen, "STOP");
        suspended.push((role, before, rt::now()));
        let why = cell.lines.wait_for("control goes on without it");
        assert!(why.contains(&format!("the {role} process hung for ")), "{why}");
        cell.wait_until_back(role, 1);
        assert!(!cell.instance.processes().contains(&frozen));
    }
    cell.ended();
    let mut reader = RecordingReader::open(File::open(&recording).unwrap()).unwrap();
    let mut measured: Vec<Measurement> = Vec::new();
    while let Some(message) = reader.next_message().unwrap() {
        if message.topic() == "/vision/0/measurement" {
            measured.push(message.record().unwrap());
        }
    }
    for (role, before, after) in suspended {
        // What was exposed and begun after the signal is of the process in the place of the suspended one.
        let is_new = |m: &&Measurement| m.found() && m.exposure > after && m.vision_start > after;
        let took_s = (measured.iter().find(is_new).unwrap().vision_end - before).as_s();
        println!("{role}: the next measurement {took_s:.2} s after SIGSTOP");
        // A second on a machine that has room; other tests load this one. Silence counts from the last heartbeat, a frame or two before: sooner than 0.4 s after that nothing is taken
        // for suspended.
        assert!((0.3..5.0).contains(&took_s), "{role}: {took_s:.2} s from SIGSTOP to a new measurement");
    }
}

/// With manual resumption the arm is held from the loss on until somebody starts it.
#[test]
fn a_manual_resumption_waits_for_a_start() {
    for role in ["vision", "camera"] {
        // Slow, so that the arm is on its way when the process is killed.
        let mut cell = Cell::servoing("manual", &["safety.resume=manual", "servo.gain_1_s=0.3"]);
        kill(wait_for_process(&cell.instance, role), "KILL");
        cell.lines.wait_for(&format!("the {role} process is back"));
        cell.wait_for_state("held");
        let status = |key: &str| cell.ctl("status").1[key].as_f64().unwrap();
        let from = status("time_s");
        // Measurements of half a second by its own clock move nothing.
        wait_until("half a second of control", || status("time_s") > from + 0.5);
        let (_, held) = cell.ctl("status");
        assert_eq!((held["state"].as_str(), held["target"].as_str()), (Some("held"), Some("found")));
        let far = held["feature_error_px"].as_f64().unwrap();
        assert!(far > 5.0, "on its way: {held}");
        assert!((status("feature_error_px") - far).abs() < 0.5, "{far}");
        assert_eq!(cell.ctl("start").0, Some(0));
        wait_until("the arm to move on", || status("feature_error_px") < 0.5 * far);
        cell.ended();
    }
}

/// What a run file asks for by `[[faults]]`: vision dies, hangs or is slow 0.4 s after its first frame, each time anew.
#[test]
fn processes_that_are_to_fail_do_so_and_are_started_anew() {
    let fault = |kind: &str, process: &str| {
        format!("faults=[{{kind='{kind}',process='{process}',from_s=0.4,duration_s=100.0}}]")
    };
    for (kind, process, words) in [
        ("process_dies", "vision", "the vision process died (killed by signal 9)"),
        ("process_dies", "camera", "the camera process died (killed by signal 9)"),
        ("process_hangs", "vision", "the vision process hung for "),
    ] {
        let mut cell = Cell::start("asked", &[&fault(kind, process)]);
        let why = cell.lines.wait_for("control goes on without it");
        assert!(why.contains(words), "{why}");
        wait_until(&format!("{process} to be started anew"), || cell.restarts(process) > 0);
        cell.ended();
    }
    let slow =
        ["run", "ur5", "--set", "faults=[{kind='process_slows',from_s=0.2,duration_s=1.0,delay_ms=60.0}]"];
    let instance = Instance::new("slow");
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("summary.json");
    let output =
        vservo().args(slow).args(["--instance", &instance.name, "--summary"]).arg(&file).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let summary: Value = serde_json::from_slice(&std::fs::read(&file).unwrap()).unwrap();
    // 60 ms of work a frame, 40 ms between two: every third is skipped, about.
    assert!(summary["frames_dropped"].as_u64().unwrap() >= 3, "{summary}");
}

/// Kills in a row, at moments that nobody chose, leave nothing in shared memory and are all counted.
#[test]
fn ten_kills_in_a_row_leave_nothing_behind() {
    let cell = Cell::servoing("tenfold", &[]);
    let before = cell.instance.leftovers().len();
    for k in 0..10_u64 {
        let role = if k % 2 == 0 { "camera" } else { "vision" };
        kill(wait_for_process(&cell.instance, role), "KILL");
        cell.wait_until_back(role, k / 2 + 1);
    }
    wait_until("segments of the dead to be removed", || cell.instance.leftovers().len() <= before);
    let text = cell.ended();
    assert!(text.contains("started anew  camera 5, vision 5"), "{text}");
}

/// A camera that cannot come back is tried ever more rarely while the arm holds; it comes back when it can, and a stop ends all of it at once.
#[test]
fn a_camera_without_its_files_is_tried_again_and_again() {
    let folder = tempfile::tempdir().unwrap();
    let (arm, away) = (folder.path().join("scara.toml"), folder.path().join("away.toml"));
    std::fs::copy(concat!(env!("CARGO_MANIFEST_DIR"), "/config/robot/scara.toml"), &arm).unwrap();
    let mut cell = Cell::servoing("nofiles", &[&format!("robot.model={}", arm.display())]);
    std::fs::rename(&arm, &away).unwrap();
    kill(wait_for_process(&cell.instance, "camera"), "KILL");
    let mut pauses = Vec::new();
    for _ in 0..4 {
        let line = cell.lines.wait_for("to start it anew comes");
        pauses.push(line.rsplit("comes ").next().unwrap().split(" s").next().unwrap().to_owned());
    }
    assert_eq!(pauses, ["at once restarts=0", "in 0.25", "in 0.50", "in 1.00"]);
    cell.wait_for_state("holding");
    std::fs::rename(&away, &arm).unwrap();
    cell.lines.wait_for("the camera process is back");
    cell.wait_for_state("servoing");
    std::fs::rename(&arm, &away).unwrap();
    kill(wait_for_process(&cell.instance, "camera"), "KILL");
    cell.lines.wait_for("did not start again (exit code 3)");
    // In the middle of a pause.
    assert_eq!(cell.ctl("stop").0, Some(0));
    cell.wait_for_state("idle");
    let text = cell.ended();
    assert!(text.contains("started anew  camera "), "{text}");
}

/// A one-shot run goes on too, and reaches its goal.
#[test]
fn a_run_whose_vision_was_killed_reaches_its_goal() {
    let instance = Instance::new("oneshot");
    let mut run = vservo()
        .args(["run", "--instance", &instance.name, "--set", "goal.hold_s=1"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = Lines::of(&mut run);
    lines.wait_for("target found");
    lines.wait_for("servoing");
    kill(wait_for_process(&instance, "vision"), "KILL");
    lines.wait_for("the vision process is back");
    lines.drain();
    let output = run.wait_with_output().unwrap();
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert_eq!(output.status.code(), Some(0), "{text}");
    assert!(text.contains("converged") && text.contains("started anew  vision 1"), "{text}");
    instance.assert_gone();
}

/// Its time is over while vision is away: the reason says so.
#[test]
fn a_run_without_vision_ends_after_its_duration() {
    let instance = Instance::new("short");
    let mut run = vservo()
        .args(["run", "--instance", &instance.name, "--duration-s", "4", "--set", "goal.hold_s=60"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = Lines::of(&mut run);
    lines.wait_for("servoing");
    // Whatever comes in its place is frozen too: it is found out after the end of the run.
    kill(wait_for_process(&instance, "vision"), "KILL");
    lines.wait_for("comes at once");
    let again = wait_for_process(&instance, "vision");
    kill(again, "STOP");
    lines.drain();
    let output = run.wait_with_output().unwrap();
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert_eq!(output.status.code(), Some(5), "{text}");
    instance.assert_gone();
}

/// The service manager's watchdog is fed while control ticks, and not when it hangs.
#[test]
fn the_service_watchdog_is_fed_as_long_as_control_ticks() {
    let manager = ServiceManager::new();
    let heard = || manager.heard();
    let instance = Instance::new("watchdog");
    let mut process = vservo()
        .args(["serve", "--instance", &instance.name])
        .env("NOTIFY_SOCKET", manager.address())
        .env("WATCHDOG_USEC", "300000")
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    assert_eq!(heard(), "READY=1");
    for _ in 0..5 {
        assert_eq!(heard(), "WATCHDOG=1");
    }
    let control = wait_for_process(&instance, "control");
    kill(control, "STOP");
    // What was under way is heard; then nothing until the supervisor gives control up.
    let next = std::iter::repeat_with(heard).find(|word| word != "WATCHDOG=1").unwrap();
    assert_eq!(next, "STOPPING=1");
    assert_eq!(process.wait().unwrap().code(), Some(4));
    instance.assert_gone();
}
