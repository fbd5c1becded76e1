//! Recordings that are replayed: runs in lockstep and by the clock, with requests, stops and faults, give the same bits again; a change is found.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // helpers of tests are tests

use crate::common::{kill, run, vservo, wait_until};
use crate::serve::Daemon;
use std::collections::BTreeMap;
use std::fs::File;
use std::path::Path;
use vservo::control::lifecycle::{Refusal, Request};
use vservo::messages::{MessageRecord, RequestMsg, TraceMsg, trace_flag};
use vservo::record::{RUN_FILE, RecordingReader, RecordingWriter};

/// Exit code and what it printed.
fn replay(path: &Path, arguments: &[&str]) -> (Option<i32>, String) {
    let output = vservo().arg("replay").arg(path).args(arguments).output().unwrap();
    let text = [output.stdout, output.stderr].concat();
    (output.status.code(), String::from_utf8(text).unwrap())
}

#[track_caller]
pub(crate) fn assert_identical(path: &Path) -> String {
    let (code, text) = replay(path, &[]);
    assert!(code == Some(0) && text.starts_with("identical: "), "{code:?} {text}");
    text
}

fn all<T: MessageRecord>(path: &Path, topic: &str) -> Vec<T> {
    let mut reader = RecordingReader::open(File::open(path).unwrap()).unwrap();
    let mut found = Vec::new();
    while let Some(message) = reader.next_message().unwrap() {
        if message.topic() == topic {
            found.push(message.record().unwrap());
        }
    }
    found
}

#[test]
fn runs_in_lockstep_are_replayed_to_the_same_hash() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    let jam = ["ur5", "--set", "drive.simulated.jam={joint=1,from_s=0.4}"];
    for (i, settings) in [&[][..], &["scara-b"], &jam, &["ur5-path"], &["stereo"], &["--set", "run.seed=8"]]
        .into_iter()
        .enumerate()
    {
        let mut arguments = settings.to_vec();
        arguments.extend(["--clock", "lockstep", "--record", path.to_str().unwrap()]);
        let run = run(&format!("replock{i}"), &arguments);
        let text = assert_identical(&path);
        let hash = run.summary["state_hash"].as_str().unwrap();
        assert!(text.contains(hash) && text.contains(&run.summary["ticks"].to_string()), "{text}");
        if settings != ["stereo"] {
            let (code, text) = replay(&path, &["--from", "frames"]);
            assert!(code == Some(0) && text.starts_with("identical: "), "{code:?} {text}");
        }
    }
}

/// By the clock: everything that a client can ask for, stops and starts, and two requests at a time.
#[test]
fn a_served_run_by_the_clock_gives_the_same_bits() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("served.mcap");
    let daemon = Daemon::start("repserve", &["--record", path.to_str().unwrap()]);
    wait_until("the recorder to listen", || std::fs::metadata(&path).is_ok_and(|file| file.len() > 0));
    let ctl = |words: &str| {
        let arguments = words.split(' ');
        vservo().args(["ctl", "--instance", &daemon.instance.name]).args(arguments).spawn().unwrap()
    };
    for words in ["start", "wait state=servoing", "goal --position-m -0.04,0.03,0.55", "goto --q 9,9,9,9"] {
        ctl(words).wait().unwrap();
    }
    let mut both = [ctl("set gain 1.5"), ctl("set tolerance 0.8")];
    for child in &mut both {
        child.wait().unwrap();
    }
    for words in ["wait converged", "hold", "jog --q 0.02,0,0,0", "wait state=held", "stop", "start", "stop"]
    {
        ctl(words).wait().unwrap();
    }
    daemon.accepts("shutdown");
    assert_eq!(daemon.ended().0, Some(0));
    let traces: Vec<TraceMsg> = all(&path, "/control/trace");
    if traces[0].sequence > 0 {
        return; // on a machine that is too busy the recorder comes after the first tick
    }
    assert_identical(&path);
    let requests: Vec<RequestMsg> = all(&path, "/control/request");
    let codes: Vec<_> = requests.iter().filter_map(|r| Request::from_code(r.request)).collect();
    for wanted in [Request::Start, Request::Goal, Request::Set, Request::Hold, Request::Jog] {
        assert!(codes.contains(&wanted), "{wanted:?} in {codes:?}");
    }
    assert!(requests.iter().any(|r| Refusal::from_code(r.refusal) == Some(Refusal::OutOfRange)));
    let has = |flag| traces.iter().any(|t| t.flags & flag != 0);
    assert!(has(trace_flag::STOP_ASKED) && has(trace_flag::SHUTDOWN_ASKED), "the stop word is recorded");
}

#[test]
fn a_run_that_a_signal_ends_gives_the_same_bits() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("stopped.mcap");
    let mut child = vservo()
        .args(["run", "--instance", &format!("repsig-{}", std::process::id()), "--record"])
        .arg(&path)
        .stdout(std::process::Stdio::null())
        .stderr(std::process::Stdio::null())
        .spawn()
        .unwrap();
    wait_until("a part of the recording", || path.metadata().is_ok_and(|m| m.len() > 4_000_000));
    kill(child.id().cast_signed(), "INT");
    assert_eq!(child.wait().unwrap().code(), Some(6));
    let text = assert_identical(&path);
    let traces: Vec<TraceMsg> = all(&path, "/control/trace");
    assert!(traces.iter().any(|t| t.flags & trace_flag::END_ASKED != 0), "{text}");
}

/// A copy with other files and other records.
fn changed(
    path: &Path,
    run_file: impl Fn(String) -> String,
    change: impl Fn(&mut TraceMsg) -> bool,
) -> Vec<u8> {
    let mut reader = RecordingReader::open(File::open(path).unwrap()).unwrap();
    let mut writer = RecordingWriter::new(Vec::new(), &BTreeMap::new()).unwrap();
    let text = String::from_utf8(reader.attachments()[RUN_FILE].clone()).unwrap();
    writer.attach(RUN_FILE, "application/toml", run_file(text).as_bytes()).unwrap();
    for (name, data) in reader.attachments().iter().filter(|(name, _)| *name != RUN_FILE) {
        writer.attach(name, "text/plain", data).unwrap();
    }
    let traces = writer.add_records::<TraceMsg>("/control/trace").unwrap();
    let measurements = writer.add_records("/vision/0/measurement").unwrap();
    while let Some(message) = reader.next_message().unwrap() {
        match message.topic() {
            "/control/trace" => {
                let mut trace = message.record::<TraceMsg>().unwrap();
                if change(&mut trace) {
                    writer.write(traces, trace.sequence, trace.stamp, &trace).unwrap();
                }
            }
            "/vision/0/measurement" => {
                let m = message.record::<vservo::messages::Measurement>().unwrap();
                writer.write(measurements, m.frame_id, m.exposure, &m).unwrap();
            }
            _ => {}
        }
    }
    writer.finish(&BTreeMap::new()).unwrap()
}

#[test]
fn what_differs_is_found_and_what_is_missing_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    run("repdiff", &["--clock", "lockstep", "--record", path.to_str().unwrap()]);
    let other = folder.path().join("other.mcap");
    let replayed = |run_file: &dyn Fn(String) -> String, change: &dyn Fn(&mut TraceMsg) -> bool| {
        std::fs::write(&other, changed(&path, run_file, change)).unwrap();
        replay(&other, &[])
    };
    let same = |text: String| text;
    assert_eq!(replayed(&same, &|_| true).0, Some(0), "a copy is as good");
    // One bit of one command.
    let one_bit = |trace: &mut TraceMsg| {
        if trace.tick == 700 {
            trace.qd_r[2] = f64::from_bits(trace.qd_r[2].to_bits() ^ 1);
        }
        true
    };
    let (code, text) = replayed(&same, &one_bit);
    assert!(
        code == Some(5)
            && text.contains("differs after 700 ticks: /control/trace, tick 700")
            && text.contains("qd_r[2] was "),
        "{code:?} {text}"
    );
    // Another gain in the run file is another run.
    let gain = |text: String| {
        let changed = text.replace("\ngain_1_s = 15", "\ngain_1_s = 12");
        assert_ne!(changed, text);
        changed
    };
    let (code, text) = replayed(&gain, &|_| true);
    assert!(code == Some(5) && text.contains("/control/trace"), "{code:?} {text}");
    let (code, text) = replayed(&same, &|trace| trace.tick != 300);
    assert!(code == Some(5) && text.contains("1 ticks are missing before tick 301"), "{code:?} {text}");
    let (code, text) = replayed(&same, &|trace| trace.tick > 100);
    assert!(code == Some(3) && text.contains("begins at tick 101"), "{code:?} {text}");
    // Other settings: the same ones change nothing, another gain does from the first view on.
    let (code, text) = replay(&path, &["--set", "run.duration_s=60"]);
    assert!(code == Some(0) && text.contains("the same commands in"), "{code:?} {text}");
    let (code, text) = replay(&path, &["--set", "servo.gain_1_s=2.5"]);
    assert!(code == Some(5) && text.contains("qd_r of joint"), "{code:?} {text}");
    // Cut off in the middle of the file.
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(&other, &bytes[..bytes.len() / 2]).unwrap();
    let (code, text) = replay(&other, &[]);
    assert!(code == Some(0) && text.contains("the recording ends there"), "{code:?} {text}");
    std::fs::write(&other, b"no recording").unwrap();
    assert_eq!(replay(&other, &[]).0, Some(3));
}

/// The robot file of the run is gone, or another one: what is in the recording counts.
#[test]
fn a_recording_needs_no_file_beside_it() {
    let folder = tempfile::tempdir().unwrap();
    let (robot, path) = (folder.path().join("arm.toml"), folder.path().join("run.mcap"));
    let text = include_str!("../../config/robot/scara.toml");
    std::fs::write(&robot, text).unwrap();
    let model = format!("robot.model={:?}", robot.display().to_string());
    run("reprobot", &["--clock", "lockstep", "--set", &model, "--record", path.to_str().unwrap()]);
    let before = assert_identical(&path);
    std::fs::remove_file(&robot).unwrap();
    assert_eq!(assert_identical(&path), before);
    std::fs::write(&robot, include_str!("../../config/robot/ur5.toml")).unwrap();
    assert_eq!(assert_identical(&path), before);
}
