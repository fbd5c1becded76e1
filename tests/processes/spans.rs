//! Spans tell where the time of a run goes: the run, its frames, measurements and requests, the stages of a calibration. The real-time thread has none.

#![allow(clippy::unwrap_used, clippy::panic)] // helpers of tests are tests

use crate::common::{Instance, vservo, wait_until};
use serde_json::Value;
use std::fs::File;
use std::process::Command;

/// The spans that ended, as the program's own subscriber told them in the log `told`.
fn spans(told: &str) -> Vec<Value> {
    let lines = told.lines().filter_map(|line| serde_json::from_str::<Value>(line).ok());
    lines.filter(|line| line["fields"]["message"] == "close").collect()
}

fn named<'a>(spans: &'a [Value], name: &str) -> Vec<&'a Value> {
    spans.iter().filter(|line| line["span"]["name"] == name).collect()
}

/// The names of the spans around one, the outermost first.
fn around(line: &Value) -> Vec<&str> {
    line["spans"].as_array().unwrap().iter().map(|span| span["name"].as_str().unwrap()).collect()
}

fn told(command: &mut Command) -> String {
    let output = command.args(["--log-format", "json"]).env("VSERVO_LOG", "vservo=debug").output().unwrap();
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{told}");
    told
}

#[test]
fn a_run_tells_where_its_time_goes() {
    let instance = Instance::new("spans");
    let run = |command: &mut Command| {
        command.args(["run", "--clock", "lockstep", "--instance", &instance.name]);
    };
    let mut command = vservo();
    run(&mut command);
    let all = spans(&told(&mut command));
    assert_eq!(named(&all, "run").len(), 1, "{all:?}");
    // The camera exposes each frame, vision measures it, and control waits for that.
    let of = |name: &str, target: &str| -> Vec<u64> {
        let lines = named(&all, name).into_iter();
        let lines = lines.filter(|line| line["target"].as_str().unwrap().contains(target));
        lines.map(|line| line["span"]["frame"].as_u64().unwrap()).collect()
    };
    let [exposed, measured] = [of("frame", "::camera"), of("frame", "::vision")];
    let awaited = of("measurement", "::control");
    assert!(awaited.len() > 10 && measured.len() >= awaited.len() && exposed.len() >= measured.len());
    for frames in [&exposed, &measured, &awaited] {
        assert!((0..).zip(frames.iter()).all(|(k, frame)| k == *frame), "each once: {frames:?}");
    }
    let in_vision: Vec<_> = named(&all, "measurement")
        .into_iter()
        .filter(|line| line["target"].as_str().unwrap().contains("::vision"))
        .collect();
    assert_eq!(in_vision.len(), measured.len());
    assert!(in_vision.iter().all(|line| around(line) == ["frame"]), "{in_vision:?}");
    assert!(all.iter().all(|line| line["fields"]["time.busy"].is_string()));

    // Without being asked nobody is told.
    let mut command = vservo();
    run(&mut command);
    let output = command.args(["--log-format", "json"]).env_remove("VSERVO_LOG").output().unwrap();
    assert!(spans(&String::from_utf8_lossy(&output.stderr)).is_empty());
}

/// In real time requests have spans from their coming to their answer; nothing is told by the real-time thread.
#[test]
fn requests_have_spans_and_the_real_time_thread_has_none() {
    let instance = Instance::new("spans-served");
    let file = tempfile::NamedTempFile::new().unwrap();
    let mut daemon = vservo()
        .args(["serve", "--log-format", "json", "--instance", &instance.name])
        .env("VSERVO_LOG", "vservo=debug")
        .stderr(File::create(file.path()).unwrap())
        .spawn()
        .unwrap();
    let ctl = |what: &str| {
        let asked = vservo().args(["ctl", what, "--instance", &instance.name]).output().unwrap();
        asked.status.success()
    };
    wait_until("the daemon to answer", || ctl("status"));
    assert!(ctl("start"));
    let read = || spans(&std::fs::read_to_string(file.path()).unwrap());
    wait_until("measurements", || !named(&read(), "measurement").is_empty());
    assert!(ctl("hold") && ctl("shutdown"));
    daemon.wait().unwrap();
    instance.assert_gone();
    let all = read();
    let asked: Vec<_> =
        named(&all, "request").into_iter().map(|line| line["span"]["request"].as_str().unwrap()).collect();
    assert_eq!(asked, ["start", "hold"], "a shutdown is taken before the loop answers");
    for line in &all {
        let thread = line["threadName"].as_str().unwrap();
        assert_ne!(thread, "control-rt", "{line}");
    }
}

#[test]
fn a_calibration_tells_its_stages() {
    let instance = Instance::new("spans-stages");
    let mut command = vservo();
    command.args(["calibrate", "latency", "--clock", "lockstep", "--instance", &instance.name]);
    let all = spans(&told(&mut command));
    let stages = named(&all, "stage");
    assert_eq!(stages.len(), 1, "{stages:?}");
    assert_eq!(around(stages[0]), ["run"]);
}
