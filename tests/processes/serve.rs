//! `vservo serve` and `vservo ctl`: a run does what it is told, refuses what it cannot do, and ends when it is told.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // helpers of tests are tests

use crate::common::{Instance, kill, vservo, wait_until};
use serde_json::Value;
use std::os::unix::net::UnixDatagram;
use std::process::{Child, Stdio};

/// A daemon under a name of its own.
pub(crate) struct Daemon {
    pub(crate) instance: Instance,
    pub(crate) process: Child,
}

impl Daemon {
    pub(crate) fn start(test: &str, arguments: &[&str]) -> Self {
        let instance = Instance::new(test);
        let told = std::env::temp_dir().join(format!("{}.stderr", instance.name));
        let process = vservo()
            .arg("serve")
            .args(arguments)
            .args(["--instance", &instance.name])
            .stdout(Stdio::piped())
            .stderr(std::fs::File::create(&told).unwrap())
            .spawn()
            .unwrap();
        let mut daemon = Self { instance, process };
        let mut last = String::new();
        wait_until("the daemon to answer", || {
            let ended = daemon.process.try_wait().unwrap();
            assert!(ended.is_none(), "{ended:?}: {}; {last}", std::fs::read_to_string(&told).unwrap());
            let (code, _, why) = daemon.ctl("status");
            last = why;
            code == Some(0)
        });
        std::fs::remove_file(told).unwrap();
        daemon
    }

    /// Exit code, answer and what was told on stderr.
    pub(crate) fn ctl(&self, what: &str) -> (Option<i32>, Value, String) {
        let output =
            vservo().args(["ctl", what, "--json", "--instance", &self.instance.name]).output().unwrap();
        let told = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!told.contains("panicked"), "{told}");
        (output.status.code(), serde_json::from_slice(&output.stdout).unwrap_or(Value::Null), told)
    }

    pub(crate) fn state(&self) -> String {
        self.ctl("status").1["state"].as_str().unwrap_or("gone").into()
    }

    pub(crate) fn wait_for(&self, state: &str) {
        wait_until(&format!("the daemon to be {state}"), || self.state() == state);
    }

    #[track_caller]
    pub(crate) fn accepts(&self, what: &str) {
        let (code, answer, told) = self.ctl(what);
        assert_eq!(code, Some(0), "{what}: {answer} {told}");
    }

    #[track_caller]
    pub(crate) fn refuses(&self, what: &str, why: &str) {
        let (code, answer, told) = self.ctl(what);
        assert_eq!(code, Some(5), "{what}: {answer} {told}");
        let reason = answer["reason"].as_str().unwrap();
        assert!(reason.contains(why) && told.contains(why), "{what}: {reason} {told}");
    }

    /// Waits for its end: exit code and what it printed.
    pub(crate) fn ended(self) -> (Option<i32>, String) {
        let output = self.process.wait_with_output().unwrap();
        self.instance.assert_gone();
        (output.status.code(), String::from_utf8_lossy(&output.stdout).into_owned())
    }
}

fn error_px(daemon: &Daemon) -> f64 {
    daemon.ctl("status").1["feature_error_px"].as_f64().unwrap_or(f64::INFINITY)
}

#[test]
fn a_daemon_starts_holds_goes_on_stops_and_ends_as_it_is_told() {
    let daemon = Daemon::start("serve", &["--clock", "lockstep"]);
    assert_eq!(daemon.state(), "idle");
    daemon.refuses("hold", "nothing was started");
    daemon.refuses("reset", "no fault");
    daemon.accepts("stop");
    let far = error_px(&daemon);
    assert!(far > 10.0, "it stands where it stood: {far} px");

    daemon.accepts("start");
    daemon.wait_for("servoing");
    daemon.refuses("start", "already");
    daemon.accepts("hold");
    daemon.wait_for("held");
    daemon.accepts("hold");
    daemon.accepts("start");
    wait_until("the goal to be reached", || error_px(&daemon) < 0.05);
    assert_eq!(daemon.state(), "servoing", "a daemon stays at its goal");

    daemon.accepts("stop");
    daemon.wait_for("idle");
    daemon.accepts("start");
    daemon.wait_for("servoing");
    daemon.accepts("shutdown");
    let (code, printed) = daemon.ended();
    assert_eq!(code, Some(0), "{printed}");
    assert!(printed.contains("stopped") && printed.contains("the goal was reached and held"), "{printed}");
    assert!(printed.contains("start on request") && printed.contains("shutdown on request"), "{printed}");
}

#[test]
fn teaching_on_request_keeps_the_arm_at_rest() {
    let daemon = Daemon::start("serve-teach", &["--clock", "lockstep"]);
    let before = daemon.ctl("status").1["q_rad_or_m"].clone();
    daemon.accepts("teach");
    wait_until("the goal to be taught", || daemon.state() == "held");
    wait_until("a measurement of the new goal", || error_px(&daemon) < 0.2);
    assert_eq!(daemon.ctl("status").1["q_rad_or_m"], before);
    daemon.accepts("shutdown");
    assert_eq!(daemon.ended().0, Some(0));
}

#[test]
fn a_fault_stays_until_it_is_reset() {
    let set = |key: &str| ["--set".to_string(), key.to_string()];
    let wrong =
        [set("scene.arm.friction_scale=6.0"), set("safety.max_tracking_error_rad_or_m=0.0002")].concat();
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/config/pan_tilt.toml");
    let mut arguments = vec![file, "--clock", "lockstep"];
    arguments.extend(wrong.iter().map(String::as_str));
    let daemon = Daemon::start("serve-fault", &arguments);
    for _ in 0..2 {
        daemon.accepts("start");
        daemon.wait_for("fault");
        let (_, answer, _) = daemon.ctl("status");
        assert!(answer["fault"].as_str().unwrap().contains("max_tracking_error"), "{answer}");
        daemon.refuses("start", "reset");
        daemon.refuses("hold", "reset");
        wait_until("the arm to stand", || daemon.ctl("reset").0 == Some(0));
        assert_eq!(daemon.state(), "idle");
    }
    daemon.accepts("shutdown");
    let (code, printed) = daemon.ended();
    assert_eq!(code, Some(0), "{printed}");
    assert!(printed.contains("reset on request"), "{printed}");
}

/// By the command, by the signal, and by eight bytes in the file: the arm stands in a fault that only a reset ends.
#[test]
fn a_latched_stop_is_left_by_a_reset_alone() {
    let daemon = Daemon::start("serve-latch", &["--clock", "lockstep"]);
    let word = std::path::PathBuf::from(format!("/dev/shm/vservo-{}/stop", daemon.instance.name));
    let by_command = || {
        let output = vservo()
            .args(["ctl", "stop", "--latched", "--instance", &daemon.instance.name])
            .output()
            .unwrap();
        assert_eq!(output.status.code(), Some(0), "{output:?}");
    };
    let by_signal = || kill(daemon.process.id() as i32, "USR1");
    let by_file = || {
        let file = std::fs::OpenOptions::new().read(true).write(true).open(&word).unwrap();
        let mut asked = [0; 8];
        std::os::unix::fs::FileExt::read_exact_at(&file, &mut asked, 48).unwrap();
        let next = (u64::from_le_bytes(asked) + 1).to_le_bytes();
        std::os::unix::fs::FileExt::write_all_at(&file, &next, 48).unwrap();
    };
    for latch in [&by_command as &dyn Fn(), &by_signal, &by_file] {
        daemon.accepts("start");
        daemon.wait_for("servoing");
        latch();
        daemon.wait_for("fault");
        let (_, answer, _) = daemon.ctl("status");
        assert!(answer["fault"].as_str().unwrap().contains("latched"), "{answer}");
        daemon.refuses("start", "reset");
        wait_until("the arm to stand", || daemon.ctl("reset").0 == Some(0));
        assert_eq!(daemon.state(), "idle");
    }
    daemon.accepts("shutdown");
    assert_eq!(daemon.ended().0, Some(0));
}

#[test]
fn several_clients_are_all_answered() {
    let daemon = Daemon::start("serve-many", &[]);
    let ask = |what| {
        vservo()
            .args(["ctl", what, "--json", "--timeout-s", "60", "--instance", &daemon.instance.name])
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap()
    };
    let clients: Vec<_> = ["status", "start", "status", "start", "status"].into_iter().map(ask).collect();
    let codes: Vec<_> = clients
        .into_iter()
        .map(|client| client.wait_with_output().unwrap())
        .map(|output| {
            let answer: Value = serde_json::from_slice(&output.stdout).unwrap();
            (output.status.code().unwrap(), answer["accepted"].as_bool().unwrap())
        })
        .collect();
    assert_eq!(codes.iter().filter(|(code, accepted)| *code == 0 && *accepted).count(), 4, "{codes:?}");
    assert_eq!(codes.iter().filter(|(code, accepted)| *code == 5 && !*accepted).count(), 1, "{codes:?}");
    // A client that is killed while it asks leaves nobody waiting.
    for _ in 0..3 {
        let mut client = ask("status");
        kill(client.id() as i32, "KILL");
        client.wait().unwrap();
    }
    daemon.accepts("status");
    kill(daemon.process.id() as i32, "TERM");
    let (code, printed) = daemon.ended();
    assert_eq!(code, Some(0), "{printed}");
    assert!(printed.contains("a stop was requested"), "{printed}");
}

#[test]
fn a_run_that_is_not_served_takes_orders_too_and_ends_by_a_stop() {
    let instance = Instance::new("serve-run");
    let run = vservo()
        .args(["run", "--instance", &instance.name, "--set", "goal.feature_error_px=0.000001"])
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let ctl = |what: &str| vservo().args(["ctl", what, "--instance", &instance.name]).output().unwrap();
    wait_until("the arm to move", || String::from_utf8_lossy(&ctl("status").stdout).contains("servoing"));
    assert_eq!(ctl("stop").status.code(), Some(0));
    let output = run.wait_with_output().unwrap();
    let printed = String::from_utf8_lossy(&output.stdout);
    assert_eq!(output.status.code(), Some(6), "its goal was not reached: {printed}");
    assert!(printed.contains("stopped"), "{printed}");
    instance.assert_gone();
}

#[test]
fn a_wait_beside_a_run_hears_how_that_ended() {
    // Both are long enough to be asked before they end, beside any load: the first holds its goal for long, that of the second cannot be reached.
    for (duration_s, goal_px, code) in [("30", "1", Some(0)), ("8", "0.000001", Some(5))] {
        let instance = Instance::new("serve-wait");
        let sets = [format!("run.duration_s={duration_s}"), format!("goal.feature_error_px={goal_px}")];
        let mut run = vservo()
            .args(["run", "--instance", &instance.name, "--set", &sets[0], "--set", &sets[1]])
            .args(["--set", "goal.hold_s=6.0"])
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let ctl = |what: &[&str]| {
            vservo().arg("ctl").args(what).args(["--instance", &instance.name]).output().unwrap()
        };
        wait_until("the run to answer", || ctl(&["status"]).status.success());
        let end = ctl(&["wait", "converged"]);
        let told = String::from_utf8_lossy(&end.stderr);
        assert_eq!(end.status.code(), code, "{told}");
        assert_eq!(
            told.contains("was not reached: the run has ended in the state"),
            code != Some(0),
            "{told}"
        );
        assert_eq!(run.wait().unwrap().code(), code);
        instance.assert_gone();
    }
}

#[test]
fn nobody_there_is_told_and_leaves_nothing() {
    let instance = Instance::new("serve-nobody");
    let output = vservo().args(["ctl", "status", "--instance", &instance.name]).output().unwrap();
    assert_eq!(output.status.code(), Some(5));
    let told = String::from_utf8_lossy(&output.stderr);
    assert!(told.contains("vservo serve") && told.contains(&instance.name), "{told}");
    assert_eq!(instance.leftovers(), Vec::<std::path::PathBuf>::new());
    let output = vservo().args(["ctl", "status", "--timeout-s", "0"]).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    let output = vservo().args(["ctl", "dance"]).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
}

/// What a service manager hears of a process.
pub(crate) struct ServiceManager {
    socket: UnixDatagram,
    folder: tempfile::TempDir,
}

impl ServiceManager {
    pub(crate) fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let socket = UnixDatagram::bind(folder.path().join("notify")).unwrap();
        socket.set_read_timeout(Some(std::time::Duration::from_secs(60))).unwrap();
        Self { socket, folder }
    }

    /// What stands in `NOTIFY_SOCKET`.
    pub(crate) fn address(&self) -> std::path::PathBuf {
        self.folder.path().join("notify")
    }

    /// The next word, which comes within a minute.
    pub(crate) fn heard(&self) -> String {
        let mut buffer = [0; 64];
        let length = self.socket.recv(&mut buffer).unwrap();
        String::from_utf8_lossy(&buffer[..length]).into_owned()
    }
}

#[test]
fn the_service_manager_hears_that_control_ticks_and_ends() {
    let manager = ServiceManager::new();
    let heard = || manager.heard();
    let instance = Instance::new("serve-notify");
    let mut process = vservo()
        .args(["serve", "--clock", "lockstep", "--instance", &instance.name])
        .env("NOTIFY_SOCKET", manager.address())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    assert_eq!(heard(), "READY=1");
    let answers = vservo().args(["ctl", "status", "--instance", &instance.name]).status().unwrap();
    assert!(answers.success());
    kill(process.id() as i32, "TERM");
    assert_eq!(heard(), "STOPPING=1");
    assert_eq!(process.wait().unwrap().code(), Some(0));
    instance.assert_gone();
}
