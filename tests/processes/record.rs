//! Recordings of real runs: complete, without influence on the run, and readable whatever becomes of the recorder.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)] // helpers of tests are tests

use crate::common::{Instance, Lines, kill, read_summary, run, vservo, wait_for_process, wait_until};
use std::collections::BTreeMap;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;
use vservo::config::Config;
use vservo::control::lifecycle::{Refusal, Request};
use vservo::messages::{
    CommandForm, ControlState, FrameHeader, JointState, Measurement, RequestMsg, Status, TraceMsg, trace_flag,
};
use vservo::record::{ABOUT, END, RUN_FILE, RecordingReader};

/// Everything in a recording.
#[derive(Default)]
struct Recorded {
    headers: Vec<FrameHeader>,
    images: usize,
    measurements: Vec<Measurement>,
    states: Vec<JointState>,
    traces: Vec<TraceMsg>,
    statuses: Vec<Status>,
    requests: Vec<RequestMsg>,
    run_file: String,
    files: Vec<String>,
    about: BTreeMap<String, String>,
    end: BTreeMap<String, String>,
    cut_off: bool,
}

fn read(path: &Path) -> Recorded {
    let mut reader = RecordingReader::open(File::open(path).unwrap()).unwrap();
    let mut all = Recorded::default();
    while let Some(message) = reader.next_message().unwrap() {
        match message.topic() {
            "/camera/0/frame_header" => all.headers.push(message.record().unwrap()),
            "/camera/0/frame" => {
                let (image, header) = (message.image().unwrap(), all.headers.last().unwrap());
                assert_eq!((image.stamp, image.pixels.len()), (header.exposure, 640 * 480));
                all.images += 1;
            }
            "/vision/0/measurement" => all.measurements.push(message.record().unwrap()),
            "/control/joint_state" => all.states.push(message.record().unwrap()),
            "/control/trace" => all.traces.push(message.record().unwrap()),
            "/control/status" => all.statuses.push(message.record().unwrap()),
            "/control/request" => all.requests.push(message.record().unwrap()),
            drive if drive.starts_with("/drive/") => {}
            other => panic!("{other}"),
        }
    }
    all.cut_off = reader.cut_off().is_some();
    all.files = reader.attachments().keys().cloned().collect();
    all.run_file = String::from_utf8(reader.attachments()[RUN_FILE].clone()).unwrap();
    all.about = reader.metadata()[ABOUT].clone();
    all.end = reader.metadata().get(END).cloned().unwrap_or_default();
    all
}

fn assert_gapless(sequences: impl Iterator<Item = u64>) {
    sequences.fold(None, |before, sequence| {
        assert!(before.is_none_or(|before: u64| sequence == before + 1), "{before:?}, then {sequence}");
        Some(sequence)
    });
}

/// A file in a folder that goes with the test.
fn file(folder: &tempfile::TempDir) -> PathBuf {
    folder.path().join("run.mcap")
}

#[test]
fn a_lockstep_recording_has_everything_and_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let path = file(&folder);
    let without = run("norec", &["--clock", "lockstep"]);
    let with = run("rec", &["--clock", "lockstep", "--record", path.to_str().unwrap()]);
    assert_eq!(without.summary["state_hash"], with.summary["state_hash"], "{}", with.text());
    assert_eq!(with.output.status.code(), Some(0));
    let r = read(&path);
    let count = |key: &str| with.summary[key].as_u64().unwrap();
    assert!(!r.cut_off);
    assert_eq!(
        (r.traces.len() as u64, r.states.len() as u64),
        (count("ticks"), count("ticks")),
        "{}",
        with.text()
    );
    assert_gapless(r.traces.iter().map(|t| t.sequence));
    assert_gapless(r.states.iter().map(|s| s.sequence));
    assert_gapless(r.statuses.iter().map(|s| s.sequence));
    assert_gapless(r.measurements.iter().map(|m| m.frame_id));
    assert_gapless(r.headers.iter().map(|h| h.frame_id));
    assert_eq!((r.traces[0].tick, r.headers[0].frame_id, r.measurements[0].frame_id), (0, 0, 0));
    assert!(r.traces.last().unwrap().flags & trace_flag::LAST != 0);
    // The camera has exposed, and vision has measured, what control no longer waited for.
    assert!(r.measurements.len() as u64 >= count("measurements") && r.images >= r.measurements.len());
    assert_eq!(r.images, r.headers.len());
    let lost: Vec<_> = r.end.iter().filter(|(key, n)| key.ends_with(": lost") && *n != "0").collect();
    assert!(lost.is_empty(), "{lost:?}");
    assert_eq!(r.end["control/trace: recorded"], count("ticks").to_string());
    assert_eq!(r.about["clock"], "lockstep");
    assert_eq!(r.files, ["machine.json", "robot/scara.toml", RUN_FILE]);
    let resolved = Config::parse("recorded", &r.run_file, Path::new("/nowhere"), &[]).unwrap();
    assert_eq!(resolved.clock_name(), "lockstep");
}

/// At a random instant of a run by the clock.
#[test]
fn a_killed_recorder_loses_a_second_at_most_and_the_run_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let (path, summary) = (file(&folder), folder.path().join("summary.json"));
    let instance = Instance::new("reckill");
    let mut child = vservo()
        .args(["run", "--instance", &instance.name, "--set", "goal.hold_s=60"])
        .args(["--duration-s", "6", "--record"])
        .arg(&path)
        .arg("--summary")
        .arg(&summary)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let recorder = wait_for_process(&instance, "record");
    wait_until("a part of the recording", || path.metadata().is_ok_and(|m| m.len() > 12_000_000));
    let killed = vservo::rt::now();
    kill(recorder, "KILL");
    let code = child.wait().unwrap().code();
    let s = read_summary(&summary);
    assert_eq!(
        (code, s["outcome"].as_str()),
        (Some(5), Some("not_converged")),
        "the goal was not held for a minute: {s}"
    );
    instance.assert_gone();
    let r = read(&path);
    assert!(r.cut_off && r.end.is_empty());
    assert_gapless(r.traces.iter().map(|t| t.sequence));
    let last = r.traces.last().unwrap();
    assert!((killed - last.stamp).as_s() <= 1.0, "{:?} of the end are lost", killed - last.stamp);
    assert!(s["ticks"].as_u64().unwrap() > r.traces.len() as u64 + 1000, "the run went on: {s}");
}

/// The recorder, or every process of the run in any order. `VSERVO_KILLS` says how often; each draw has its own instant.
#[test]
fn killed_at_any_time_a_recording_has_all_but_the_last_second() {
    let kills: u64 = std::env::var("VSERVO_KILLS").ok().and_then(|n| n.parse().ok()).unwrap_or(2);
    let mut lost = Vec::new();
    for k in 0..kills {
        let folder = tempfile::tempdir().unwrap();
        let path = file(&folder);
        let instance = Instance::new(&format!("reckills{k}"));
        let mut child = vservo()
            .args([
                "run",
                "--instance",
                &instance.name,
                "--set",
                "goal.hold_s=60",
                "--duration-s",
                "30",
                "--record",
            ])
            .arg(&path)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let recorder = wait_for_process(&instance, "record");
        // Spread over three seconds, by the golden ratio: from before the first tick to long after the goal.
        std::thread::sleep(Duration::from_secs_f64((k as f64 * 0.618_034 + 0.3).fract() * 3.0));
        let killed = vservo::rt::now();
        if k % 2 == 0 {
            kill(recorder, "KILL");
            kill(child.id().cast_signed(), "TERM");
        } else {
            let mut all = instance.processes();
            all.push(child.id().cast_signed());
            let first = (k / 2) as usize % all.len();
            all.rotate_left(first);
            all.into_iter().for_each(|process| kill(process, "KILL"));
        }
        child.wait().unwrap();
        let output = vservo().arg("replay").arg(&path).output().unwrap();
        let text = String::from_utf8([output.stdout, output.stderr].concat()).unwrap();
        if output.status.code() == Some(3) {
            let without = ["No such file", "no tick", "no run file", "cannot be read", "in the middle"];
            assert!(without.iter().any(|why| text.contains(why)), "draw {k}: {text}");
        } else {
            let last = read(&path).traces.last().unwrap().stamp;
            lost.push((killed - last).as_s());
            assert!(*lost.last().unwrap() <= 1.0, "draw {k}: {lost:?}");
            assert!(output.status.code() == Some(0) && text.contains("identical"), "draw {k}: {text}");
        }
        instance.leftovers().iter().for_each(|left| {
            let _ = std::fs::remove_dir_all(left).or_else(|_| std::fs::remove_file(left));
        });
    }
    assert!(kills < 2 || !lost.is_empty(), "draw 1 kills seconds after the first tick");
    lost.sort_by(f64::total_cmp);
    println!("{kills} kills, of which {} after the first tick: lost at most {:?} s", lost.len(), lost.last());
}

#[test]
fn a_full_disk_ends_the_recording_and_not_the_run() {
    let without = run("nofull", &["--clock", "lockstep"]);
    let with = run("recfull", &["--clock", "lockstep", "--record", "/dev/full"]);
    assert_eq!(with.output.status.code(), Some(0), "{}", with.text());
    assert_eq!(without.summary["state_hash"], with.summary["state_hash"]);
    let text = with.text();
    assert!(text.contains("/dev/full: cannot be written: No space left on device"), "{text}");
    assert!(text.contains("the recording ended before the run"), "{text}");
}

/// `vservo record` comes late, and ends when nobody is left.
#[test]
fn a_recorder_joins_a_running_instance_and_ends_with_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = file(&folder);
    let instance = Instance::new("recjoin");
    let mut daemon = vservo()
        .args(["serve", "--instance", &instance.name])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let ctl = |what: &str| vservo().args(["ctl", what, "--instance", &instance.name]).output().unwrap();
    wait_until("control to answer", || ctl("status").status.success());
    let mut recorder = vservo()
        .args(["record", "--instance", &instance.name, "--out"])
        .arg(&path)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = Lines::of(&mut recorder);
    lines.wait_for("recording to");
    lines.drain();
    assert!(ctl("start").status.success());
    wait_until("a part of the recording", || path.metadata().is_ok_and(|m| m.len() > 4_000_000));
    assert!(ctl("shutdown").status.success());
    let output = recorder.wait_with_output().unwrap();
    assert_eq!(daemon.wait().unwrap().code(), Some(0));
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.success() && text.starts_with("recorded "), "{text}");
    instance.assert_gone();
    let r = read(&path);
    assert!(!r.cut_off && r.traces[0].sequence > 0, "it came late");
    assert!(r.traces.last().unwrap().flags & trace_flag::LAST != 0, "the end is there");
    let lost: u64 = r.end["control/trace: lost"].parse().unwrap();
    let (first, last) = (r.traces[0].sequence, r.traces.last().unwrap().sequence);
    assert_eq!(last - first + 1, r.traces.len() as u64 + lost);
    let nobody = vservo().args(["record", "--instance", "recnobody", "--out", "/dev/null"]).output().unwrap();
    assert_eq!(nobody.status.code(), Some(5));
}

/// Control was told to end, and does not know why; the recording does.
#[test]
fn the_reason_of_the_supervisor_is_in_the_recording() {
    let folder = tempfile::tempdir().unwrap();
    let path = file(&folder);
    let command = r#"drive.external.command=["/bin/sh","-c","sleep 1; exit 7"]"#;
    let set = ["--set", "drive.kind=external", "--set", "drive.mode=velocity", "--set", command];
    let run = run("recwhy", &[&["ur5", "--record", path.to_str().unwrap()], &set[..]].concat());
    assert_eq!(run.output.status.code(), Some(4), "{}", run.text());
    let reason = run.summary["reason"].as_str().unwrap();
    assert!(reason.contains("the drive process ended"), "{reason}");
    assert!(read(&path).end["failure"].contains("the drive process ended"));
    let explained = vservo().arg("explain").arg(&path).output().unwrap();
    let told = String::from_utf8(explained.stdout).unwrap();
    assert!(told.starts_with("Ended by a fault") && told.contains("the drive process ended"), "{told}");
}

/// Of a run that goes on there is something to record at each look.
#[test]
fn a_recorder_ends_when_it_is_told_to_while_its_run_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let path = file(&folder);
    let daemon = crate::serve::Daemon::start("recstop", &[]);
    let mut recorder = vservo()
        .args(["record", "--instance", &daemon.instance.name, "--out"])
        .arg(&path)
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = Lines::of(&mut recorder);
    lines.wait_for("recording to");
    lines.drain();
    daemon.accepts("start");
    wait_until("a part of the recording", || path.metadata().is_ok_and(|m| m.len() > 1_000_000));
    kill(recorder.id() as i32, "TERM");
    assert_eq!(recorder.wait().unwrap().code(), Some(0));
    assert_eq!(daemon.state(), "servoing");
    let r = read(&path);
    assert!(!r.cut_off && r.traces.iter().all(|t| t.flags & trace_flag::LAST == 0));
    daemon.accepts("shutdown");
    assert_eq!(daemon.ended().0, Some(0));
}

/// The Python that has the packages `mcap` and `mcap-ros2-support`.
pub(crate) fn python() -> Option<PathBuf> {
    let python = std::env::var_os("VSERVO_PYTHON").map_or_else(|| PathBuf::from("python3"), PathBuf::from);
    let output = Command::new(&python).args(["-c", "import mcap.reader, mcap_ros2.decoder"]).output();
    if output.as_ref().is_ok_and(|o| o.status.success()) {
        return Some(python);
    }
    assert!(std::env::var_os("VSERVO_REQUIRE_MCAP").is_none(), "{}: {output:?}", python.display());
    println!("skipped: {} has no mcap and mcap-ros2-support", python.display());
    None
}

/// What programs for ROS read is what was sent: sums of every field's values.
const SUMS: &str = "
import sys
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
sums = {}
with open(sys.argv[1], 'rb') as file:
    for schema, channel, message, m in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages():
        value = {'JointState': lambda: sum(m.q) + m.tick, 'Image': lambda: sum(m.data) + m.width,
                 'Measurement': lambda: sum(f.u_px for f in m.features) + m.frames_received,
                 'Trace': lambda: sum(m.qd_r) + sum(m.limits), 'Status': lambda: m.time_s + m.limits,
                 'FrameHeader': lambda: m.exposure + m.height_px}[schema.name.split('/')[-1]]()
        count, total = sums.get(channel.topic, (0, 0.0))
        sums[channel.topic] = (count + 1, total + value)
for topic, (count, total) in sorted(sums.items()):
    print(topic, count, repr(float(total)))
";

#[test]
fn the_official_python_reader_reads_the_same() {
    let Some(python) = python() else { return };
    let folder = tempfile::tempdir().unwrap();
    let path = file(&folder);
    run("recpy", &["--clock", "lockstep", "--set", "run.duration_s=0.4", "--record", path.to_str().unwrap()]);
    let output = Command::new(python).args(["-c", SUMS]).arg(&path).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).unwrap();
    let mut seen = BTreeMap::new();
    for line in text.lines() {
        let words: Vec<_> = line.split(' ').collect();
        seen.insert(
            words[0].to_owned(),
            (words[1].parse::<usize>().unwrap(), words[2].parse::<f64>().unwrap()),
        );
    }
    let r = read(&path);
    // in the order of the file, as Python adds them
    let sum = |values: Vec<f64>| (values.len(), values.iter().fold(0.0, |sum, x| sum + x));
    let states = r.states.iter().map(|s| s.q.iter().fold(0.0, |sum, q| sum + q) + s.tick as f64);
    let features = |m: &Measurement| m.features.iter().fold(0.0, |sum, f| sum + f.u_px);
    let measurements = r.measurements.iter().map(|m| features(m) + m.frames_received as f64);
    let headers = r.headers.iter().map(|h| h.exposure.0 as f64 + f64::from(h.height_px));
    let statuses = r.statuses.iter().map(|s| s.time_s + f64::from(s.limits));
    let near = |topic: &str, (count, total): (usize, f64)| {
        let (seen_count, seen_total) = seen[topic];
        assert_eq!(seen_count, count, "{topic}");
        assert!((seen_total - total).abs() <= 1e-9 * total.abs(), "{topic}: {seen_total}, not {total}");
    };
    near("/control/joint_state", sum(states.collect()));
    near("/vision/0/measurement", sum(measurements.collect()));
    near("/camera/0/frame_header", sum(headers.collect()));
    near("/control/status", sum(statuses.collect()));
    assert_eq!((seen["/camera/0/frame"].0, seen["/control/trace"].0), (r.images, r.traces.len()));
}

/// What clients asked for, with its numbers, its answer and the tick at which it took effect: enough to ask the same of a run that is repeated.
#[test]
fn requests_are_recorded_with_their_answers() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("requests.mcap");
    let daemon = crate::serve::Daemon::start(
        "record-requests",
        &["--clock", "lockstep", "--record", path.to_str().unwrap()],
    );
    let ctl = |arguments: &[&str]| {
        vservo().args(["ctl", "--instance", &daemon.instance.name]).args(arguments).output().unwrap()
    };
    // The first chunk has the topics of all services, to which the recorder listens by then.
    wait_until("the recorder to listen", || std::fs::metadata(&path).is_ok_and(|file| file.len() > 0));
    assert_eq!(ctl(&["start"]).status.code(), Some(0));
    daemon.wait_for("servoing");
    assert_eq!(ctl(&["goal", "--position-m", "-0.04,0.03,0.55"]).status.code(), Some(0));
    assert_eq!(ctl(&["start"]).status.code(), Some(5));
    assert_eq!(ctl(&["goto", "--q", "100,0,0,0"]).status.code(), Some(5));
    daemon.accepts("shutdown");
    assert_eq!(daemon.ended().0, Some(0));
    let r = read(&path);
    let told: Vec<_> =
        r.requests.iter().map(|m| (Request::from_code(m.request), Refusal::from_code(m.refusal))).collect();
    let wanted = [
        (Some(Request::Start), None),
        (Some(Request::Goal), None),
        (Some(Request::Start), Some(Refusal::AlreadyStarted)),
        (Some(Request::Goto), Some(Refusal::OutOfRange)),
    ];
    assert_eq!(told, wanted);
    assert_gapless(r.requests.iter().map(|m| m.sequence));
    let goal = &r.requests[1];
    assert_eq!((goal.form, goal.count, goal.goal), (CommandForm::Pose as u32, 7, 1));
    assert_eq!(goal.values[..7], [-0.04, 0.03, 0.55, 0.0, 0.0, 0.0, 1.0]);
    // The trace of the tick at which the first start took effect has the state after it.
    let start = &r.requests[0];
    let tick = r.traces.iter().find(|trace| trace.tick == start.tick).unwrap();
    assert_eq!(tick.stamp, start.stamp);
    let state = ControlState::from_code(tick.state);
    assert!([ControlState::Waiting, ControlState::Servoing].contains(&state), "{state:?}");
    let before = r.traces.iter().rfind(|trace| trace.tick < start.tick).unwrap();
    assert_eq!(ControlState::from_code(before.state), ControlState::Idle);
}
