//! Real-time runs: they converge, end on request, and leave nothing behind, however they are ended.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)] // helpers of tests are tests

use crate::common::{
    BusyCores, Instance, assert_accurate, assert_deadlines_are_honest, kill, number, run, vservo,
    wait_for_line, wait_for_process, wait_until,
};
use std::os::unix::process::ExitStatusExt;
use std::process::{Child, Stdio};

fn start(instance: &Instance, extra: &[&str]) -> Child {
    start_for("60", instance, extra)
}

fn start_for(duration_s: &str, instance: &Instance, extra: &[&str]) -> Child {
    vservo()
        .arg("run")
        .args(["--instance", &instance.name, "--duration-s", duration_s, "--set", "goal.hold_s=60"])
        .args(extra)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

fn start_servoing(instance: &Instance) -> Child {
    let mut child = start(instance, &[]);
    wait_for_line(&mut child, "servoing");
    child
}

#[test]
fn the_default_run_converges() {
    let r = run("rt", &[]);
    assert_accurate(&r);
    let s = &r.summary;
    assert_eq!(s["clock"], "realtime");
    assert!(s["state_hash"].is_null());
    assert_deadlines_are_honest(s);
    assert!(number(s, &["latency_us", "exposure_to_command", "p50"]) >= 20_000.0, "{s}");
    assert!(String::from_utf8_lossy(&r.output.stderr).contains("real-time scheduling: "), "{}", r.text());
}

#[test]
fn a_spin_before_the_deadlines_is_told_with_its_cost() {
    for (setting, wanted) in
        [(None, None), (Some("realtime.spin_us=120"), Some(120.0)), (Some("realtime.spin_us=0"), Some(0.0))]
    {
        let set: Vec<&str> = setting.iter().flat_map(|s| ["--set", *s]).collect();
        let r = run("spin", &[&["--duration-s", "1"][..], &set].concat());
        let s = &r.summary;
        let scheduling = s["realtime"]["scheduling"].as_str().unwrap();
        // By itself only under SCHED_FIFO, which not every machine grants.
        let usual = if scheduling.starts_with("SCHED_FIFO") { 50.0 } else { 0.0 };
        let spin_us = wanted.unwrap_or(usual);
        assert_eq!(number(s, &["realtime", "spin_us"]), spin_us, "{s}");
        let share = number(s, &["realtime", "spin_share"]);
        // No more than that part of each millisecond; a machine whose timers are always too late spins nothing.
        assert!((0.0..=spin_us * 1e-3 + 0.01).contains(&share), "{s}");
        assert!(spin_us > 0.0 || share == 0.0, "{s}");
        let (line, summary) = (&r.output.stderr, &r.output.stdout);
        for text in [line, summary].map(|t| String::from_utf8_lossy(t)) {
            let told = text.contains(&format!("spins the last {spin_us} us ("));
            assert_eq!(told, spin_us > 0.0, "{text}");
        }
        assert_deadlines_are_honest(s);
    }
}

#[test]
fn what_each_process_used_is_told() {
    for clock in ["realtime", "lockstep"] {
        let start = vservo::rt::now();
        let r = run("used", &["--clock", clock, "--duration-s", "2", "--set", "goal.hold_s=60"]);
        let all_s = (vservo::rt::now() - start).as_s();
        let used = |role, what| number(&r.summary, &["processes", role, what]);
        for role in ["camera", "vision", "control"] {
            let (cpu_s, share) = (used(role, "cpu_s"), used(role, "cpu_share"));
            assert!(cpu_s > 0.0 && share > 0.0, "{role}: {}", r.summary);
            // The share is that of the time which the process lived: as long as the run, and no longer than all of this.
            let lived_s = cpu_s / share;
            let min_s = if clock == "realtime" { 2.0 } else { 0.0 };
            assert!(lived_s >= min_s && lived_s <= all_s, "{role}: {lived_s} of {all_s} s: {}", r.summary);
            // One thread works, in control two.
            assert!(share < if role == "control" { 2.0 } else { 1.05 }, "{role}: {}", r.summary);
            assert!((1.0..60.0).contains(&used(role, "max_resident_mb")), "{role}: {}", r.summary);
        }
        let text = String::from_utf8_lossy(&r.output.stdout).into_owned();
        assert!(text.contains("processes     camera") && text.contains("% of a core"), "{text}");
    }
}

#[test]
fn ticks_find_their_memory_there() {
    let r = run("faults", &["--duration-s", "2"]);
    let scheduling = r.summary["realtime"]["scheduling"].as_str().unwrap();
    if !scheduling.ends_with(", memory locked") {
        println!("skipped: memory was not locked ({scheduling})");
        return;
    }
    // Without fetching before the first tick there are 160 and more; the system may still take a page back.
    assert!(number(&r.summary, &["realtime", "page_faults"]) < 20.0, "{}", r.summary);
}

#[test]
fn busy_cores_neither_stop_the_arm_nor_hide_a_missed_deadline() {
    let _busy = BusyCores::start();
    let r = run("busy", &["--duration-s", "5", "--set", "goal.feature_error_px=1e-6"]);
    assert_eq!(r.summary["outcome"], "not_converged", "{}", r.text());
    assert_deadlines_are_honest(&r.summary);
}

#[test]
fn signals_end_the_run_in_order() {
    for signal in ["INT", "TERM", "HUP"] {
        let instance = Instance::new("signal");
        let child = start_servoing(&instance);
        kill(child.id() as i32, signal);
        let output = child.wait_with_output().unwrap();
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(text.contains("outcome       stopped (a stop was requested)"), "{signal}: {text}");
        assert!(text.contains("the arm slows down"), "{signal}: {text}");
        assert_eq!(output.status.code(), Some(6), "{signal}: stopped before its goal");
        assert!(
            instance.processes().is_empty(),
            "{signal}: all children are reaped before the supervisor ends"
        );
        assert!(instance.leftovers().is_empty(), "{signal}: {:?}", instance.leftovers());
    }
}

/// From the first moment on: while processes start, join and connect.
#[test]
fn an_early_signal_is_a_stop_like_any_other() {
    for clock in ["realtime", "lockstep"] {
        for ms in (6..66).step_by(4) {
            let instance = Instance::new("early");
            let child = start(&instance, &["--clock", clock]);
            std::thread::sleep(std::time::Duration::from_millis(ms));
            kill(child.id() as i32, "INT");
            let output = child.wait_with_output().unwrap();
            let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
            let (out, err) = (text(&output.stdout), text(&output.stderr));
            // A signal that comes before anything of the program runs ends it as the system does.
            if output.status.signal() != Some(2) {
                assert_eq!(output.status.code(), Some(6), "{clock} {ms} ms: {out}{err}");
                assert!(
                    out.contains("outcome       stopped (a stop was requested"),
                    "{clock} {ms} ms: {out}{err}"
                );
                let is_error =
                    |l: &str| l.starts_with("vservo:") && !l.contains("warning:") || l.contains("ERROR");
                assert!(!err.lines().any(is_error), "{clock} {ms} ms: {err}");
            }
            instance.assert_gone();
        }
    }
}

#[test]
fn children_follow_a_killed_supervisor() {
    for clock in ["realtime", "lockstep"] {
        let instance = Instance::new("orphan");
        let mut child = start(&instance, &["--clock", clock, "--set", "goal.feature_error_px=1e-6"]);
        wait_for_process(&instance, "control");
        kill(child.id() as i32, "KILL");
        child.wait().unwrap();
        instance.assert_gone();
    }
}

/// Control is never started anew, and nothing is in lockstep; what is in real time has `tests/processes/restarts.rs`.
#[test]
fn a_killed_child_ends_the_run_with_a_reason() {
    for (clock, role) in
        [("realtime", "control"), ("lockstep", "control"), ("lockstep", "vision"), ("lockstep", "camera")]
    {
        let instance = Instance::new("killed");
        // Out of reach in lockstep, so that the run is still there.
        let far = ["--clock", clock, "--set", "goal.feature_error_px=1e-6"];
        let mut child = start_for("80000", &instance, &far);
        wait_for_line(&mut child, "servoing");
        kill(wait_for_process(&instance, role), "KILL");
        let output = child.wait_with_output().unwrap();
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        assert_eq!(output.status.code(), Some(4), "{text}");
        assert!(
            text.contains("fault") && text.contains(role) && text.contains("killed by signal 9"),
            "{text}"
        );
        instance.assert_gone();
    }
}

#[test]
fn a_hanging_child_is_killed() {
    let instance = Instance::new("hanging");
    let child = start_servoing(&instance);
    kill(wait_for_process(&instance, "vision"), "STOP");
    kill(child.id() as i32, "TERM");
    child.wait_with_output().unwrap();
    instance.assert_gone();
}

#[test]
fn when_vision_stands_still_the_arm_holds_and_then_goes_on() {
    let instance = Instance::new("still");
    let child = start_servoing(&instance);
    let vision = wait_for_process(&instance, "vision");
    kill(vision, "STOP");
    let control = wait_for_process(&instance, "control");
    // Longer than the time-out of 200 ms by control's own ticks, and mostly shorter than the 400 ms after which vision would be started anew.
    std::thread::sleep(std::time::Duration::from_millis(320));
    kill(vision, "CONT");
    std::thread::sleep(std::time::Duration::from_millis(700));
    assert!(instance.processes().contains(&control), "control goes on without vision");
    kill(child.id() as i32, "INT");
    let text = String::from_utf8_lossy(&child.wait_with_output().unwrap().stdout).into_owned();
    assert!(text.contains("measurements stopped"), "{text}");
    assert!(text.contains("measurements are back"), "{text}");
}

#[test]
fn the_next_start_removes_the_files_of_a_killed_run() {
    let instance = Instance::new("massacre");
    let mut child = start(&instance, &[]);
    // All of them: one that starts during the massacre would find itself alone and clean up.
    for role in ["control", "vision", "camera"] {
        wait_for_process(&instance, role);
    }
    wait_until("shared memory in use", || instance.leftovers().len() > 1);
    let all = instance.processes();
    for pid in all {
        kill(pid, "STOP");
    }
    // The supervisor, which came first, dies last: the kernel wakes stopped children whose parent dies.
    let mut all = instance.processes();
    all.sort_unstable();
    for pid in all.iter().rev() {
        kill(*pid, "KILL");
    }
    child.wait().unwrap();
    // A dying process loses its command line before its locks: it is dead when it is gone, or a zombie.
    let dead = |pid: &i32| {
        let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
        stat.rsplit(')').next().is_none_or(|s| s.is_empty() || s.starts_with(" Z"))
    };
    wait_until("all to be dead", || all.iter().all(dead));
    assert!(!instance.leftovers().is_empty(), "a killed run leaves something, or this test shows nothing");
    let output = vservo()
        .args(["run", "--clock", "lockstep", "--duration-s", "0.1", "--instance", &instance.name])
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(5), "{}", String::from_utf8_lossy(&output.stderr));
    instance.assert_gone();
}

#[test]
fn a_second_run_of_the_same_name_is_refused() {
    let instance = Instance::new("twice");
    let mut first = start_servoing(&instance);
    let second = vservo().args(["run", "--instance", &instance.name]).output().unwrap();
    let text = String::from_utf8_lossy(&second.stderr).into_owned();
    assert_eq!(second.status.code(), Some(3), "{text}");
    assert!(text.contains("already has a running supervisor") && text.contains("--instance"), "{text}");
    assert_eq!(first.try_wait().unwrap(), None);
    kill(first.id() as i32, "INT");
    assert_eq!(first.wait().unwrap().code(), Some(6));
    instance.assert_gone();
}

#[test]
fn three_processes_by_hand_work_like_one_command() {
    let instance = Instance::new("byhand");
    let role = |name: &str, extra: &[&str]| {
        vservo()
            .arg(name)
            .args(["--instance", &instance.name])
            .args(extra)
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap()
    };
    let (vision, camera) = (role("vision", &[]), role("camera", &[]));
    let control = role("control", &[]);
    let output = control.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stdout));
    assert!(String::from_utf8_lossy(&output.stdout).contains("converged"));
    let same_role = vservo().args(["camera", "--instance", &instance.name]).output().unwrap();
    assert_eq!(same_role.status.code(), Some(3));
    for mut child in [camera, vision] {
        kill(child.id() as i32, "INT");
        assert_eq!(child.wait().unwrap().code(), Some(0));
    }
    instance.assert_gone();
}

#[test]
fn a_latency_longer_than_the_frame_period_loses_no_frame() {
    let r = run("late", &["--set", "camera.latency_ms=100", "--set", "safety.measurement_timeout_ms=400"]);
    assert_accurate(&r);
    let frames = number(&r.summary, &["frames"]);
    let exposures = number(&r.summary, &["duration_s"]) * 25.0;
    // Under load a camera may miss some; a camera without pipeline would miss two of three.
    assert!(frames > 0.7 * exposures, "{frames} of {exposures}");
    assert!(number(&r.summary, &["latency_us", "exposure_to_command", "p50"]) >= 100_000.0, "{}", r.summary);
}

#[test]
fn a_control_process_that_was_frozen_stops_the_arm() {
    let instance = Instance::new("frozen");
    let child = start_servoing(&instance);
    let control = wait_for_process(&instance, "control");
    kill(control, "STOP");
    std::thread::sleep(std::time::Duration::from_millis(400));
    kill(control, "CONT");
    let output = child.wait_with_output().unwrap();
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert_eq!(output.status.code(), Some(4), "{text}");
    assert!(text.contains("max_missed_deadlines_in_a_row"), "{text}");
    instance.assert_gone();
}
