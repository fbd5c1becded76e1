//! `control/trace`: every tick of a run of the real processes reaches whoever listens.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // helpers of tests are tests

use crate::common::{Instance, vservo, was_held_up};
use serde_json::Value;
use std::process::{Child, Stdio};
use std::time::Duration;
use vservo::ipc::Services;
use vservo::messages::{ControlState, TraceMsg, trace_flag};

/// Converged, not converged: codes of the outcome.
const CONVERGED: u32 = 1;
const NOT_CONVERGED: u32 = 2;

fn start(role: &str, instance: &Instance, set: &[&str]) -> Child {
    let mut command = vservo();
    command.args([role, "--instance", &instance.name]);
    for set in set {
        command.args(["--set", set]);
    }
    if role == "control" {
        command.arg("--json").stdout(Stdio::piped());
    }
    command.stderr(Stdio::null()).spawn().unwrap()
}

/// All records of a run, and its summary. The listener is there before the first tick, which waits for camera and vision.
fn listen(test: &str, set: &[&str]) -> (Vec<TraceMsg>, Value) {
    let instance = Instance::new(test);
    let mut control = start("control", &instance, set);
    let mut records: Vec<TraceMsg> = Vec::new();
    let mut peers = Vec::new();
    {
        let services = Services::join(&instance.name.parse().unwrap()).unwrap();
        let traces = services.trace_receiver().unwrap();
        peers.extend(["vision", "camera"].map(|role| start(role, &instance, set)));
        while records.last().is_none_or(|r| r.flags & trace_flag::LAST == 0) {
            let ended = control.try_wait().unwrap().is_some();
            while let Some(record) = traces.receive().unwrap() {
                records.push(*record);
            }
            if ended {
                break;
            }
            std::thread::sleep(Duration::from_micros(200));
        }
    }
    let output = control.wait_with_output().unwrap();
    for peer in &mut peers {
        crate::common::kill(peer.id() as i32, "TERM");
        peer.wait().unwrap();
    }
    instance.assert_gone();
    (records, serde_json::from_slice(&output.stdout).unwrap())
}

#[test]
fn every_tick_of_a_lockstep_run_is_there_without_a_gap() {
    // Fewer ticks than the buffer holds: however busy the machine is, none is overwritten.
    let (records, summary) = listen("trace", &["run.clock=lockstep", "run.duration_s=0.4"]);
    assert_eq!(summary["outcome"], "not_converged", "{summary}");
    assert_eq!(records.len() as u64, summary["ticks"].as_u64().unwrap());
    for (k, r) in (0..).zip(&records) {
        assert_eq!((r.tick, r.sequence, r.lost, r.stamp.0), (k, k, 0, k as i64 * 1_000_000));
        assert_eq!((r.joints, r.arm, r.camera, r.fault), (4, 0, 0, 0));
        assert!(r.flags & trace_flag::TRUTH != 0 && r.q_true == r.q, "exact encoders: {k}");
        assert!(r.tau.iter().chain(&r.q_r).chain(&r.qd_r).chain(&r.requested_qd).all(|x| x.is_finite()));
    }
    let measured: Vec<_> = records.iter().filter(|r| r.flags & trace_flag::MEASUREMENT != 0).collect();
    assert_eq!(measured.len() as u64, summary["measurements"].as_u64().unwrap());
    for (frame_id, r) in (0..).zip(&measured) {
        assert_eq!((r.frame_id, r.stamp - r.exposure), (frame_id, vservo::time::SpanNs(20_000_000)));
        assert_eq!(r.verdict, 1, "used");
    }
    let servoing = |r: &TraceMsg| r.state == ControlState::Servoing as u32;
    let moved = records.iter().find(|r| servoing(r)).unwrap();
    assert_eq!(moved.frame_id, 0, "from the first measurement on");
    assert!(moved.requested_qd.iter().any(|w| *w != 0.0));
    assert!(moved.limits.iter().any(|joints| *joints != 0), "its acceleration is limited: {moved:?}");
    // The command of a tick is in the joint state of the next: what the arm did follows from the records.
    let last = records.last().unwrap();
    assert_eq!((last.outcome, last.flags & trace_flag::LAST), (NOT_CONVERGED, trace_flag::LAST));
    assert!(records.iter().rev().skip(1).all(|r| r.outcome == 0));
}

/// In real time control waits for nobody: the listener comes when it can, and the numbers tell what was lost from then on.
#[test]
fn a_realtime_run_counts_what_is_lost() {
    let listen = || listen("tracert", &["run.duration_s=20"]);
    let (records, summary) =
        std::iter::repeat_with(listen).take(3).find(|(_, s)| !was_held_up(s)).expect("a calm run");
    assert_eq!(summary["outcome"], "converged", "{summary}");
    let (first, last) = (records.first().unwrap(), records.last().unwrap());
    assert_eq!((last.outcome, last.flags & trace_flag::LAST), (CONVERGED, trace_flag::LAST));
    assert_eq!(summary["ticks"].as_u64().unwrap(), last.sequence + 1);
    let missing = last.sequence + 1 - first.sequence - records.len() as u64;
    assert!(missing >= last.lost - first.lost, "{missing} of {} are missing", last.sequence);
    for pair in records.windows(2) {
        assert!(pair[0].sequence < pair[1].sequence && pair[0].tick < pair[1].tick);
    }
    assert!(records.iter().all(|r| r.commanded >= r.stamp));
}
