//! Several targets in one run: the finder changes between the steps of a program, and nothing that was measured of one target moves the arm for another.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // helpers of tests are tests

use crate::common::{kill, vservo, wait_for_process, wait_until};
use crate::serve::Daemon;

/// A tag beside the four dots of the default run file, and a goal before each.
const CELL: &str = r#"
[targets.bin]
kind = "tags"
[targets.bin.tags]
size_m = 0.06
first_id = 7
[scene.objects.bin]
position_m = [1.12, 1.24, 1.0]
rotation_rpy_deg = [0, 0, 45]
[goals.part]
position_m = [-0.1, 0.1, 0.6]
rotation_rpy_deg = [0, 0, -60]
[goals.over_bin]
target = "bin"
position_m = [0.08, -0.05, 0.55]
rotation_rpy_deg = [0, 0, -50]
"#;

const PROGRAM: &str = r#"
[[steps]]
servo = "part"
[[steps]]
servo = "over_bin"
[[steps]]
servo = "present"
target = "target"
"#;

fn started(test: &str, folder: &tempfile::TempDir, more: &[&str]) -> Daemon {
    let cell = folder.path().join("cell.toml");
    std::fs::write(&cell, CELL).unwrap();
    Daemon::start(test, &[&[cell.to_str().unwrap()], more].concat())
}

/// `vservo` with these arguments for the daemon: exit code and what it told.
fn asked(daemon: &Daemon, arguments: &[&str]) -> (Option<i32>, String) {
    let output = vservo().args(arguments).args(["--instance", &daemon.instance.name]).output().unwrap();
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!told.contains("panicked"), "{told}");
    (output.status.code(), told)
}

#[test]
fn a_program_servoes_on_two_targets_by_turns() {
    let folder = tempfile::tempdir().unwrap();
    let recording = folder.path().join("run.mcap");
    let more = ["--clock", "lockstep", "--record", recording.to_str().unwrap()];
    let daemon = started("two-targets", &folder, &more);
    let program = folder.path().join("program.toml");
    std::fs::write(&program, PROGRAM).unwrap();
    let (code, told) = asked(&daemon, &["do", program.to_str().unwrap()]);
    assert_eq!(code, Some(0), "{told}");
    assert!(told.contains("steps[1]: servo over_bin of bin"), "{told}");
    let (_, status, _) = daemon.ctl("status");
    assert_eq!((&status["target_name"], &status["at_goal"]), (&"target".into(), &true.into()));
    // By truth, which knows where each of them is.
    assert!(status["position_error_m"].as_f64().unwrap() < 5e-4, "{status}");
    let (code, told) = asked(&daemon, &["ctl", "target", "bim"]);
    assert_eq!(code, Some(2), "{told}");
    assert!(
        told.contains("`bim` is no target of the run file; there are target, bin; did you mean `bin`?"),
        "{told}"
    );
    std::fs::write(&program, PROGRAM.replace("\"target\"\n", "\"lid\"\n")).unwrap();
    let (code, told) = asked(&daemon, &["do", program.to_str().unwrap()]);
    assert_eq!(code, Some(3), "{told}");
    assert!(
        told.contains("steps[2].target: `lid` is no target of the run file; there are target, bin"),
        "{told}"
    );
    daemon.accepts("shutdown");
    assert_eq!(daemon.ended().0, Some(0));
    // Control and vision come to the same once more.
    let replay = vservo().arg("replay").arg(&recording).output().unwrap();
    let text = String::from_utf8_lossy(&replay.stdout);
    assert_eq!(replay.status.code(), Some(0), "{text}{}", String::from_utf8_lossy(&replay.stderr));
}

#[test]
fn a_vision_that_died_comes_back_on_the_present_target() {
    let folder = tempfile::tempdir().unwrap();
    let daemon = started("target-restart", &folder, &[]);
    for arguments in [&["ctl", "start"][..], &["ctl", "wait", "converged"], &["ctl", "goal", "over_bin"]] {
        let (code, told) = asked(&daemon, arguments);
        assert_eq!(code, Some(0), "{arguments:?}: {told}");
    }
    let at_bin = |restarts: u64| {
        let (_, status, _) = daemon.ctl("status");
        status["at_goal"] == true && status["target_name"] == "bin" && status["vision_restarts"] == restarts
    };
    wait_until("the arm to be over the bin", || at_bin(0));
    kill(wait_for_process(&daemon.instance, "vision"), "KILL");
    wait_until("vision to be back, and the arm over the bin", || at_bin(1));
    daemon.accepts("shutdown");
    assert_eq!(daemon.ended().0, Some(0));
}
