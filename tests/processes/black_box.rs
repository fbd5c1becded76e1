//! The black box: what was sent before a fault, and before a control process that died, is in a file afterwards; nothing else is written.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // helpers of tests are tests

use crate::common::{Instance, Lines, kill, vservo, wait_for_process, wait_until};
use crate::serve::Daemon;
use std::collections::BTreeMap;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use vservo::messages::{FrameHeader, JointState, TraceMsg, trace_flag};
use vservo::record::{END, RUN_FILE, RecordingReader};

/// The files in the folder of an instance, the oldest first.
fn boxes(folder: &Path, instance: &str) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder.join(instance)).into_iter().flatten().flatten();
    let mut found: Vec<_> =
        entries.map(|e| e.path()).filter(|path| path.extension().is_some_and(|e| e == "mcap")).collect();
    found.sort();
    found
}

/// What is in a file: traces, frames, joint states, and what is told at its end.
struct Kept {
    traces: Vec<TraceMsg>,
    frames: Vec<FrameHeader>,
    images: usize,
    states: Vec<JointState>,
    end: BTreeMap<String, String>,
}

fn read(path: &Path) -> Kept {
    let mut reader = RecordingReader::open(File::open(path).unwrap()).unwrap();
    let (mut traces, mut frames, mut states, mut images) = (vec![], vec![], vec![], 0);
    while let Some(message) = reader.next_message().unwrap() {
        match message.topic() {
            "/control/trace" => traces.push(message.record::<TraceMsg>().unwrap()),
            "/control/joint_state" => states.push(message.record().unwrap()),
            "/camera/0/frame_header" => frames.push(message.record().unwrap()),
            "/camera/0/frame" => images += usize::from(message.image().unwrap().pixels.len() == 640 * 480),
            _ => {}
        }
    }
    assert_eq!(reader.cut_off(), None, "it has an end");
    let files = reader.attachments();
    assert!(files.contains_key(RUN_FILE) && files.contains_key("robot/scara.toml"), "{:?}", files.keys());
    let gaps = traces.windows(2).filter(|pair| pair[1].sequence != pair[0].sequence + 1).count() as u64;
    let end = reader.metadata()[END].clone();
    assert!(gaps <= end["control/trace: lost"].parse().unwrap(), "{gaps} gaps, {end:?}");
    assert_eq!(end["control/trace: recorded"], traces.len().to_string());
    assert_eq!(images, frames.len());
    Kept { traces, frames, images, states, end }
}

/// Until it takes what is sent: it has the segments of the camera and of control.
fn wait_for_black_box(daemon: &Daemon) {
    let recorder = wait_for_process(&daemon.instance, "record");
    let segments = || {
        let maps = std::fs::read_to_string(format!("/proc/{recorder}/maps")).unwrap();
        maps.lines().filter(|line| line.ends_with(".data")).count()
    };
    wait_until("the black box to take what is sent", || segments() >= 4);
}

#[test]
fn each_fault_leaves_the_time_before_and_after_it() {
    let folder = tempfile::tempdir().unwrap();
    let daemon = Daemon::start("boxfault", &["--black-box", folder.path().to_str().unwrap()]);
    let name = daemon.instance.name.clone();
    wait_for_black_box(&daemon);
    for count in 1..=2 {
        daemon.accepts("start");
        daemon.wait_for("servoing");
        assert_eq!(boxes(folder.path(), &name).len(), count - 1, "nothing is written while all is well");
        kill(daemon.process.id() as i32, "USR1");
        daemon.wait_for("fault");
        wait_until("the file of the fault", || boxes(folder.path(), &name).len() == count);
        wait_until("the arm to stand", || daemon.ctl("reset").0 == Some(0));
    }
    let [first, second] = &boxes(folder.path(), &name)[..] else { panic!() };
    let (a, b) = (read(first), read(second));
    for kept in [&a, &b] {
        assert_eq!(kept.end["kept because"], "there was a fault");
        let fault = kept.traces.iter().rposition(|t| t.fault == 0).unwrap() + 1;
        let (at, last) = (kept.traces[fault].stamp, kept.traces.last().unwrap().stamp);
        assert!((last - at).as_s() > 1.0, "the way to rest is in it");
        let counts = (fault, kept.images, kept.states.len());
        assert!(fault > 0 && kept.images > 2 && !kept.states.is_empty(), "{counts:?}");
        let newest = kept.frames.iter().map(|frame| frame.exposure).max().unwrap();
        assert!((last - newest).as_s().abs() < 1.0, "frames of that time");
    }
    assert!(b.traces[0].sequence < a.traces.last().unwrap().sequence, "the second has the first one too");
    let tables = folder.path().join("tables");
    let export = vservo().args(["export", "--for", "csv", "--out"]).arg(&tables).arg(first).output().unwrap();
    assert!(export.status.success(), "{export:?}");
    let explain = vservo().arg("explain").arg(second).output().unwrap();
    let told = String::from_utf8(explain.stdout).unwrap();
    assert!(explain.status.success() && told.starts_with("Ended by a fault"), "{told}");
    for words in ["a stop was latched from outside", "start on request", "reset on request"] {
        assert!(told.contains(words), "{words}: {told}");
    }
    let page = folder.path().join("page");
    let report = vservo().arg("report").arg(first).arg(&page).output().unwrap();
    assert!(report.status.success() && page.join("index.html").exists(), "{report:?}");
    daemon.accepts("shutdown");
    assert_eq!(daemon.ended().0, Some(0));
    assert_eq!(boxes(folder.path(), &name).len(), 2, "the end of a daemon is no fault");
}

#[test]
fn a_control_that_is_killed_leaves_its_last_seconds() {
    let folder = tempfile::tempdir().unwrap();
    let daemon = Daemon::start("boxkill", &["--black-box", folder.path().to_str().unwrap()]);
    let name = daemon.instance.name.clone();
    wait_for_black_box(&daemon);
    daemon.accepts("start");
    daemon.wait_for("servoing");
    kill(wait_for_process(&daemon.instance, "control"), "KILL");
    assert_eq!(daemon.ended().0, Some(4));
    let [file] = &boxes(folder.path(), &name)[..] else { panic!("one file") };
    let kept = read(file);
    assert_eq!(kept.end["kept because"], "the control process died");
    // A quick machine servoes after some 40 ms, with the first frame.
    let (count, ended) = (kept.traces.len(), kept.traces.iter().any(|t| t.flags & trace_flag::LAST != 0));
    assert!(count > 0 && !ended, "{count} traces");
}

/// Started by hand before a run that is there, it writes down what it has when it is told to end, of no more time than it was asked for.
#[test]
fn by_hand_it_keeps_as_much_as_was_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let daemon = Daemon::start("boxhand", &[]);
    let name = daemon.instance.name.clone();
    let mut keeper = vservo()
        .args(["record", "--last", "1s", "--instance", &name, "--out"])
        .arg(folder.path())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = Lines::of(&mut keeper);
    lines.wait_for("the last 1 s are kept");
    daemon.accepts("start");
    let tick = || daemon.ctl("status").1["time_s"].as_f64().unwrap_or_default();
    let begin = tick();
    wait_until("more than it keeps", || tick() > begin + 3.0);
    kill(keeper.id() as i32, "TERM");
    assert!(lines.wait_for("what was before is in").contains("it was asked to"));
    lines.drain();
    assert_eq!(keeper.wait().unwrap().code(), Some(0));
    let [file] = &boxes(folder.path(), &name)[..] else { panic!("one file") };
    let kept = read(file);
    let length = kept.traces.last().unwrap().stamp - kept.traces[0].stamp;
    assert!((1.0..2.1).contains(&length.as_s()), "{length:?}: a second, and the blocks at its ends");
    let explain = vservo().arg("explain").arg(file).output().unwrap();
    let told = String::from_utf8(explain.stdout).unwrap();
    assert!(explain.status.success() && told.contains("the recording begins at tick"), "{told}");
    let replay = vservo().args(["replay", "--from", "frames"]).arg(file).output().unwrap();
    assert_eq!(replay.status.code(), Some(3), "{replay:?}");
    daemon.accepts("shutdown");
    assert_eq!(daemon.ended().0, Some(0));
}

#[test]
fn a_folder_that_cannot_be_made_is_told_and_ends_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("file");
    std::fs::write(&file, "").unwrap();
    let instance = Instance::new("boxnowhere");
    let mut daemon = vservo()
        .args(["serve", "--instance", &instance.name, "--black-box"])
        .arg(&file)
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = Lines::of(&mut daemon);
    assert!(lines.wait_for("cannot be written").contains("file/"), "it says where");
    lines.wait_for("the black-box has ended before the run, which goes on");
    lines.drain();
    let ctl = |what: &str| vservo().args(["ctl", what, "--instance", &instance.name]).output().unwrap();
    wait_until("control to answer", || ctl("start").status.success());
    assert!(ctl("shutdown").status.success());
    assert_eq!(daemon.wait().unwrap().code(), Some(0));
    instance.assert_gone();
}

/// Simulated time does not wait for it.
#[test]
fn before_a_run_in_lockstep_it_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let daemon = Daemon::start("boxlock", &["--clock", "lockstep"]);
    let name = daemon.instance.name.clone();
    let command = ["record", "--last", "60s", "--instance", &name, "--out"];
    let output = vservo().args(command).arg(folder.path()).output().unwrap();
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.code() == Some(2) && told.contains("without --last"), "{output:?}");
    daemon.accepts("shutdown");
    assert_eq!(daemon.ended().0, Some(0));
}
