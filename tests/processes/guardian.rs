//! The guardian before an external drive, whose own record tells what the arm did: it stops the arm alone when control cannot, stops none without need, and
//! whatever happens to it harms no run.

#![allow(clippy::unwrap_used, clippy::print_stdout)] // what was measured is told

use crate::common::{Instance, Lines, kill, read_summary, vservo, wait_for_process, wait_until};
use crate::drive::command;
use rustix::process::{Pid, Signal, kill_process};
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;
use std::process::{Child, Stdio};
use vservo::ipc::Instance as Place;
use vservo::rt::now;

/// Quick enough to be at speed, and too far from its goal to end by itself; a loaded machine may keep the drive waiting, which is nothing to these tests.
const QUICK: [&str; 8] = [
    "--set",
    "servo.gain_1_s=10",
    "--set",
    "goal.hold_s=60",
    "--set",
    "safety.drive_timeout_ms=2000",
    "--set",
    "servo.first_motion_m_s=0",
];

/// A run in real time before the drive of the tests, which records into `plant`.
fn start(word: &str, instance: &Instance, mode: &str, plant: &Path, extra: &[&str]) -> Child {
    vservo()
        .env("VSERVO_TEST_PLANT", plant)
        .args([word, "--instance", &instance.name, "--set", "drive.kind=external"])
        .args(["--set", &command(""), "--set", &format!("drive.mode={mode}")])
        .args(QUICK)
        .args(extra)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

/// A cycle of the plant.
#[derive(Debug, Clone, Copy)]
struct Cycle {
    time_ns: i64,
    /// It brakes by itself, because of the guardian.
    brakes: bool,
    speed: f64,
    asked: f64,
}

fn cycle(line: &str) -> Cycle {
    let words: Vec<_> = line.split(' ').collect();
    let number = |i: usize| words[i].parse::<f64>().unwrap();
    Cycle { time_ns: words[0].parse().unwrap(), brakes: words[1] == "1", speed: number(2), asked: number(3) }
}

fn record(plant: &Path) -> Vec<Cycle> {
    let text = std::fs::read_to_string(plant).unwrap_or_default();
    let whole = text.rfind('\n').map_or("", |end| &text[..end]);
    whole.lines().map(cycle).collect()
}

/// The last cycle, without reading all of them.
fn last(plant: &Path) -> Option<Cycle> {
    let mut file = std::fs::File::open(plant).ok()?;
    let length = file.metadata().ok()?.len();
    let _ = file.seek(SeekFrom::Start(length.saturating_sub(300))).ok()?;
    let mut text = String::new();
    let _ = file.read_to_string(&mut text).ok()?;
    let mut lines = text.rsplit('\n');
    let _ = lines.next()?; // what is being written
    let line = lines.next()?;
    lines.next().map(|_| cycle(line))
}

fn wait_for_speed(plant: &Path) {
    wait_until("an arm at speed", || last(plant).is_some_and(|c| c.speed > 0.3));
}

fn wait_for_rest(plant: &Path) {
    wait_until("an arm that its drive has braked", || {
        last(plant).is_some_and(|c| c.brakes && c.speed < 0.02)
    });
}

/// Waits until the plant has gone on for so long.
fn wait_for_cycles(plant: &Path, ms: i64) {
    let time_ns = || last(plant).map_or(0, |c| c.time_ns);
    let end = time_ns() + ms * 1_000_000;
    wait_until("cycles of the plant", || time_ns() > end);
}

/// Asserts that from the guardian's stop on the arm went no faster and came to rest, within the accelerations of the run file.
fn assert_braked(plant: &Path) -> Cycle {
    let all = record(plant);
    let began = all.iter().position(|c| c.brakes).unwrap();
    // An arm that lags behind its commands, which a loaded machine makes late, still catches up for some cycles.
    let before = all[began].speed.max(all[began].asked);
    let brake = &all[began..];
    assert!(brake.iter().all(|c| c.speed < before + 0.3), "it went faster than {before}");
    assert!(brake.last().unwrap().speed < 0.02, "{:?}", brake.last());
    all[began]
}

fn words_of(child: Child) -> (Option<i32>, String) {
    let output = child.wait_with_output().unwrap();
    let text =
        format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    (output.status.code(), text)
}

#[test]
fn a_suspended_control_is_stopped_by_the_guardian_alone() {
    for mode in ["velocity", "position", "torque"] {
        let (instance, folder) = (Instance::new("guardstop"), tempfile::tempdir().unwrap());
        let plant = folder.path().join("plant");
        let child = start("run", &instance, mode, &plant, &[]);
        wait_for_speed(&plant);
        let control = wait_for_process(&instance, "control");
        kill(control, "STOP");
        wait_for_rest(&plant);
        assert_braked(&plant);
        // Nothing moves it again: control, which goes on, brakes and ends.
        kill(control, "CONT");
        let (code, text) = words_of(child);
        assert_eq!(code, Some(4), "{mode}: {text}");
        assert!(text.contains("the guardian has stopped the arm: no command from control for"), "{text}");
        assert!(text.contains("whose process is suspended"), "{text}");
        assert_braked(&plant);
        instance.assert_gone();
    }
}

/// The drive's program is not ended before the arm rests.
#[test]
fn a_control_that_dies_leaves_an_arm_that_is_braked() {
    for signal in ["KILL", "BUS"] {
        let (instance, folder) = (Instance::new("guarddead"), tempfile::tempdir().unwrap());
        let (plant, summary) = (folder.path().join("plant"), folder.path().join("summary.json"));
        let child = start("run", &instance, "velocity", &plant, &["--summary", summary.to_str().unwrap()]);
        wait_for_speed(&plant);
        let control = wait_for_process(&instance, "control");
        kill(control, signal);
        // The handler of Rust's runtime takes one that no memory access has caused for an error of its own, and the next one counts.
        kill(control, signal);
        let (code, text) = words_of(child);
        assert_eq!(code, Some(4), "{text}");
        assert_braked(&plant);
        let reason = read_summary(&summary)["reason"].as_str().unwrap().to_owned();
        assert!(reason.contains("whose process has ended: the control process ended"), "{reason}");
        instance.assert_gone();
    }
}

#[test]
fn a_guardian_that_dies_or_hangs_is_started_anew() {
    let (instance, folder) = (Instance::new("guardian"), tempfile::tempdir().unwrap());
    let (plant, summary) = (folder.path().join("plant"), folder.path().join("summary.json"));
    let mut child = start("run", &instance, "velocity", &plant, &["--summary", summary.to_str().unwrap()]);
    let mut lines = Lines::of(&mut child);
    wait_for_speed(&plant);
    let guardian = wait_for_process(&instance, "guardian");
    kill(guardian, "KILL");
    lines.wait_for("the guardian process is back");
    let second = wait_for_process(&instance, "guardian");
    assert_ne!(second, guardian);
    kill(second, "STOP");
    let line = lines.wait_for("the guardian process hung");
    assert!(line.contains("control goes on without it"), "{line}");
    lines.wait_for("the guardian process is back");
    kill(child.id() as i32, "INT");
    lines.drain();
    child.wait().unwrap();
    let summary = read_summary(&summary);
    assert_eq!((&summary["outcome"], summary["restarts"]["guardian"].as_u64()), (&"stopped".into(), Some(2)));
    assert!(record(&plant).iter().all(|c| !c.brakes));
    instance.assert_gone();
}

/// A guardian that was suspended for a while, and goes on, has missed nothing that it would stop the arm for.
#[test]
fn a_guardian_that_was_suspended_for_a_moment_stops_nothing() {
    let (instance, folder) = (Instance::new("guardwakes"), tempfile::tempdir().unwrap());
    let plant = folder.path().join("plant");
    let child = start("run", &instance, "velocity", &plant, &[]);
    wait_for_speed(&plant);
    let guardian = wait_for_process(&instance, "guardian");
    kill(guardian, "STOP");
    wait_for_cycles(&plant, 200);
    kill(guardian, "CONT");
    wait_for_cycles(&plant, 500);
    kill(child.id() as i32, "INT");
    let (_, text) = words_of(child);
    assert!(text.contains("outcome       stopped"), "{text}");
    assert!(record(&plant).iter().all(|c| !c.brakes), "{text}");
    instance.assert_gone();
}

#[test]
fn a_served_run_goes_on_when_the_stop_was_reset() {
    let (instance, folder) = (Instance::new("guardreset"), tempfile::tempdir().unwrap());
    let plant = folder.path().join("plant");
    let mut child = start("serve", &instance, "position", &plant, &[]);
    let ctl = |word: &str| {
        let output = vservo().args(["ctl", word, "--json", "--instance", &instance.name]).output().unwrap();
        serde_json::from_slice::<serde_json::Value>(&output.stdout).unwrap_or_default()
    };
    let wait_for = |state: &str| {
        wait_until(state, || ctl("status")["state"] == state);
    };
    wait_for("idle");
    ctl("start");
    wait_for_speed(&plant);
    let control = wait_for_process(&instance, "control");
    kill(control, "STOP");
    wait_for_rest(&plant);
    kill(control, "CONT");
    wait_for("fault");
    wait_for_cycles(&plant, 500);
    assert!(last(&plant).unwrap().brakes, "it stands until somebody resets it");
    assert_braked(&plant);
    wait_until("a reset", || ctl("reset")["state"] == "idle");
    wait_until("the drive's release", || last(&plant).is_some_and(|c| !c.brakes));
    let released = record(&plant).len();
    wait_for_cycles(&plant, 300);
    assert!(
        record(&plant)[released..].iter().all(|c| !c.brakes && c.speed < 0.1),
        "nothing leaps by the reset"
    );
    ctl("start");
    wait_for("servoing");
    wait_for_speed(&plant);
    assert!(record(&plant)[released..].iter().all(|c| !c.brakes));
    ctl("shutdown");
    child.wait().unwrap();
    instance.assert_gone();
}

/// Not a test of a limit: tells how long after SIGSTOP the plant brakes, and how long that takes. `cargo test --test processes -- --ignored --nocapture guardian::how`
#[test]
#[ignore = "a measurement"]
fn how_soon_a_suspended_control_is_braked() {
    let (mut to_word, mut to_brake, mut to_rest) = (Vec::new(), Vec::new(), Vec::new());
    for _ in 0..20 {
        let (instance, folder) = (Instance::new("guardtime"), tempfile::tempdir().unwrap());
        let plant = folder.path().join("plant");
        let child = start("run", &instance, "velocity", &plant, &[]);
        wait_for_speed(&plant);
        let control = wait_for_process(&instance, "control");
        let place: Place = instance.name.parse().unwrap();
        let word = place.open_stop_word().unwrap().unwrap();
        let asked = now();
        kill_process(Pid::from_raw(control).unwrap(), Signal::STOP).unwrap();
        while !word.is_stopped_by_guardian() {
            std::thread::sleep(std::time::Duration::from_micros(100));
        }
        to_word.push((now() - asked).as_s() * 1e3);
        wait_for_rest(&plant);
        let began = assert_braked(&plant);
        let all = record(&plant);
        let rest = all.iter().find(|c| c.brakes && c.speed < 0.02).unwrap();
        to_brake.push((began.time_ns - asked.0) as f64 * 1e-6);
        to_rest.push((rest.time_ns - asked.0) as f64 * 1e-6);
        kill(control, "CONT");
        let _ = words_of(child);
    }
    for (what, times) in [("stop word", &mut to_word), ("brake", &mut to_brake), ("rest", &mut to_rest)] {
        times.sort_by(f64::total_cmp);
        println!("{what}: median {:.1} ms, worst {:.1} ms of {}", times[10], times[19], times.len());
    }
}
