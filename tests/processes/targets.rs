//! Several targets in one run: the finder changes between the steps of a program, and nothing that was measured of one target moves the arm for another.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // helpers of tests are tests

use crate::common::{kill, vservo, wait_for_process, wait_until};
use crate::serve::Daemon;
use std::path::Path;
use vservo::report::csv_table::CsvTable;

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
    let report = folder.path().join("report");
    ran(&["report", recording.to_str().unwrap(), report.to_str().unwrap()]);
    the_report_knows_both(&report);
}

/// `vservo` with these arguments, which end well: what it printed.
fn ran(arguments: &[&str]) -> String {
    let output = vservo().args(arguments).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// Points and poses of each target, and the camera at the goal of each, by the folder's own numbers.
fn the_report_knows_both(report: &Path) {
    let text = |name: &str| std::fs::read_to_string(report.join(name)).unwrap();
    let page = text("index.html");
    for part in [
        "The goal was of target from ",
        ", of bin from ",
        "whole image, target<",
        "whole image, bin<",
        ">looked for<",
        ">D bin",
        " of target</figcaption>",
    ] {
        assert!(page.contains(part), "{part}");
    }
    let table = CsvTable::parse(&text("measurements.csv"));
    for (number, desired_m, points) in [(0.0, [-0.1, 0.1, 0.6], [1, 4]), (1.0, [0.08, -0.05, 0.55], [1, 4])] {
        let of_target = table.rows_of("target_number", number);
        // Each came to its goal for half a second at 25 Hz and more.
        let at_goal = (0..of_target.rows()).filter(|row| of_target.number("error_px", *row) <= 0.05);
        let at_goal: Vec<usize> = at_goal.collect();
        assert!(at_goal.len() >= 10, "{number}: {}", at_goal.len());
        for row in at_goal {
            let p = ["CO_x_m", "CO_y_m", "CO_z_m"].map(|name| of_target.number(name, row));
            let off_m = p.iter().zip(desired_m).map(|(p, at)| (p - at).powi(2)).sum::<f64>().sqrt();
            assert!(off_m < 2e-3, "{number}: {p:?}");
            assert!(
                points.iter().all(|point| of_target.number(&format!("u_{point}_px"), row).is_finite()),
                "{number}"
            );
        }
    }
    let goal = CsvTable::parse(&text("goal.csv"));
    assert_eq!(
        (goal.rows_of("target_number", 0.0).rows(), goal.rows_of("target_number", 1.0).rows()),
        (4, 4)
    );
}

#[test]
fn check_view_and_teach_know_each_target() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let cell = path("cell.toml");
    std::fs::write(&cell, CELL).unwrap();
    // From this start both are in the image.
    let start = ["--set", "robot.q_start_rad_or_m=[0.1259, 1.3662, 0.4, 0.3405]"];
    let told = ran(&[&["check", &cell], &start[..]].concat());
    assert!(told.contains("target `bin`: at the start: points, px: 1 ("), "{told}");
    let json: serde_json::Value =
        serde_json::from_str(&ran(&[&["check", &cell, "--json"], &start[..]].concat())).unwrap();
    assert_eq!(json["targets"][0]["name"], "bin");
    let seen_px = |point: usize| {
        let point = &json["targets"][0]["start"]["visibility"]["points"][point];
        (point["px"][0].as_f64().unwrap(), point["px"][1].as_f64().unwrap())
    };
    ran(&["view", &cell, "--out", &path("view.svg")]);
    let svg = std::fs::read_to_string(path("view.svg")).unwrap();
    for part in [">START<", ">GOAL OF target<", ">GOAL OF bin<"] {
        assert_eq!(svg.matches(part).count(), 1, "{part}");
    }
    // In the view of the start and in those of both goals each has its name, but for what is out of an image.
    assert_eq!(svg.matches(">bin<").count() + svg.matches(">bin: OUT OF THE IMAGE<").count(), 3, "{svg}");
    assert_eq!(svg.matches(">target<").count() + svg.matches(">target: OUT OF THE IMAGE<").count(), 3);
    // What is taught is what is seen from the start, as check tells it.
    let told = ran(&[&["teach", &cell, "--target", "bin", "--out", &path("bin.toml")], &start[..]].concat());
    assert!(told.contains("4 points of `bin`") && told.contains("vservo ctl goal"), "{told}");
    let goal: toml::Table = std::fs::read_to_string(path("bin.toml")).unwrap().parse().unwrap();
    assert_eq!((goal["target"].as_str(), goal["target_name"].as_str()), (Some("tags"), Some("bin")));
    for (i, feature) in goal["features"].as_array().unwrap().iter().enumerate() {
        let px: Vec<f64> = feature["px"].as_array().unwrap().iter().map(|v| v.as_float().unwrap()).collect();
        let (u, v) = seen_px(i);
        assert!((px[0] - u).hypot(px[1] - v) < 0.3, "{i}: {px:?}, {u} {v}");
    }
    let output =
        vservo().args(["teach", &cell, "--target", "bim", "--out", &path("b.toml")]).output().unwrap();
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(
        told.contains(
            "--target: `bim` is no target of the run file; there are target, bin; did you mean `bin`?"
        ),
        "{told}"
    );
    let set = format!("servo.set_point.file={}", path("bin.toml"));
    let output = vservo().args(["check", &cell, "--set", &set]).output().unwrap();
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.code() == Some(3) && told.contains("is of the target `bin`"), "{told}");
    // A daemon that is given the file knows of which target it is.
    std::fs::write(&cell, format!("{CELL}[goals.taught]\nfile = \"bin.toml\"\n")).unwrap();
    let daemon = Daemon::start("target-file", &[&cell, "--clock", "lockstep"]);
    let name = || daemon.ctl("status").1["target_name"].clone();
    assert_eq!(name(), "target");
    for goal in [path("bin.toml"), "taught".to_owned()] {
        let (code, told) = asked(&daemon, &["ctl", "goal", &goal]);
        assert_eq!((code, name()), (Some(0), "bin".into()), "{told}");
        assert_eq!(asked(&daemon, &["ctl", "target", "target"]).0, Some(0));
    }
    daemon.accepts("shutdown");
    assert_eq!(daemon.ended().0, Some(0));
}

/// A bin so far from the part that neither is in the image at the goal of the other, and a posture from where the bin is.
const FAR: &str = "scene.objects.bin.position_m=[0.6, 1.45, 1.0]";
const BEFORE_BIN: &str = "0.42,1.5,0.4,-0.2";

#[test]
fn the_arm_goes_back_to_where_it_saw_each_target() {
    let folder = tempfile::tempdir().unwrap();
    let daemon = started("target-return", &folder, &["--clock", "lockstep", "--set", FAR]);
    let all = |orders: &[&[&str]]| {
        for order in orders {
            let (code, told) = asked(&daemon, &[&["ctl"], *order].concat());
            assert_eq!(code, Some(0), "{order:?}: {told}");
        }
    };
    let converged_on = |name: &str| {
        all(&[&["wait", "converged"]]);
        let (_, status, _) = daemon.ctl("status");
        assert_eq!(status["target_name"], name);
        assert!(status["position_error_m"].as_f64().unwrap() < 5e-4, "{status}");
    };
    all(&[&["start"]]);
    converged_on("target");
    // It was never seen: the arm waits to be brought there.
    all(&[&["goal", "over_bin"]]);
    let (code, told) = asked(&daemon, &["ctl", "wait", "converged", "--timeout-s", "1"]);
    assert!(code == Some(5) && told.contains("still holding"), "{told}");
    all(&[&["goto", "--q", BEFORE_BIN], &["wait", "state=held"], &["start"]]);
    converged_on("bin");
    // Each was seen now, and is gone back to, by turns and from rest.
    for name in ["target", "bin"] {
        all(&[&["target", name]]);
        converged_on(name);
    }
    all(&[&["hold"], &["wait", "state=held"], &["target", "target"], &["start"]]);
    converged_on("target");
    // So is one that was seen again since its goal was set, on the way of a motion, and is out of view where the arm starts.
    let goes_away = &["goto", "--q", "-1.2,1.5,0.4,-0.2"];
    for order in [&["goal", "over_bin"][..], &["goto", "--q", BEFORE_BIN], goes_away] {
        all(&[&["hold"], &["wait", "state=held"], order, &["wait", "state=held"]]);
    }
    all(&[&["start"]]);
    converged_on("bin");
    daemon.accepts("shutdown");
    let (code, printed) = daemon.ended();
    assert_eq!(code, Some(0), "{printed}");
    let times = |what: &str| printed.matches(what).count();
    assert_eq!(times("is not in view and was never seen whole in this run"), 1, "{printed}");
    assert_eq!(times("the arm goes back to where it saw the whole target last"), 4, "{printed}");
}

/// An arm that is held off for 20 s, here by a speed with which the way takes longer, holds where it is; `start` from rest goes on.
#[test]
fn a_way_back_that_takes_too_long_is_given_up() {
    let folder = tempfile::tempdir().unwrap();
    let slow = ["--clock", "lockstep", "--set", FAR, "--set", "workspace.camera_speed_m_s=0.02"];
    let daemon = started("target-late", &folder, &slow);
    let asks = |order: &[&str]| {
        let (code, told) = asked(&daemon, &[&["ctl"], order].concat());
        assert_eq!(code, Some(0), "{order:?}: {told}");
    };
    for order in
        [&["start"][..], &["wait", "converged"], &["goto", "--q", BEFORE_BIN], &["wait", "state=held"]]
    {
        asks(order);
    }
    for order in [&["goal", "over_bin"][..], &["start"], &["wait", "converged"], &["target", "target"]] {
        asks(order);
    }
    let left_m = || daemon.ctl("status").1["position_error_m"].as_f64().unwrap_or(f64::NAN);
    // It holds for three frames at first, until the target is known to be out of view.
    wait_until("the arm to give up on its way", || daemon.state() == "holding" && left_m() < 0.5);
    let at = left_m();
    // 20 s at 0.02 m/s are 0.4 m of 0.57 m.
    assert!((0.1..0.3).contains(&at) && (left_m() - at).abs() < 1e-3, "{at}");
    for order in [&["hold"][..], &["start"], &["wait", "converged"]] {
        asks(order);
    }
    assert!(left_m() < 5e-4);
    daemon.accepts("shutdown");
    assert_eq!(daemon.ended().0, Some(0));
}

/// A further target on a circle, on which it stays in view however far the time of lockstep runs ahead; followed as far as its truth goes.
#[test]
fn a_further_target_that_moves_is_followed() {
    let folder = tempfile::tempdir().unwrap();
    let moves = [
        "goal.feature_error_px=0.5",
        "servo.object.moves=true",
        "scene.objects.bin.motion.kind=circle",
        "scene.objects.bin.motion.radius_m=[0.04, 0.0, 0.0]",
        "scene.objects.bin.motion.frequency_hz=0.05",
        "scene.motion.kind=still",
    ];
    let set = moves.iter().flat_map(|key| ["--set", key]);
    let more: Vec<&str> = ["--clock", "lockstep"].into_iter().chain(set).collect();
    let daemon = started("target-moves", &folder, &more);
    for order in [&["start"][..], &["wait", "converged"], &["goal", "over_bin"], &["wait", "converged"]] {
        let (code, told) = asked(&daemon, &[&["ctl"], order].concat());
        assert_eq!(code, Some(0), "{order:?}: {told}");
    }
    let q = || daemon.ctl("status").1["q_rad_or_m"][0].as_f64().unwrap();
    let (before, (_, status, _)) = (q(), daemon.ctl("status"));
    assert_eq!(status["target_name"], "bin");
    assert!(status["position_error_m"].as_f64().unwrap() < 1e-3, "{status}");
    // The arm goes along: the error stays small because the arm moves, not because the bin rests.
    wait_until("the arm to have moved on with the bin", || (q() - before).abs() > 2e-3);
    daemon.accepts("shutdown");
    assert_eq!(daemon.ended().0, Some(0));
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
