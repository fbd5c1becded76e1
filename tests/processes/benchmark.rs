//! `vservo benchmark`: results that are the same to the last byte on any number of threads, its files, and what is refused.

#![allow(clippy::unwrap_used, clippy::expect_used)] // helpers of tests are tests

use crate::common::vservo;
use serde_json::Value;
use std::path::Path;
use std::process::Output;

const SUITE: &str = r#"
about = "two small tasks"
seed = 9

[[laws]]
name = "B"
about = "position-based"
set = { "servo.scheme" = "position_resolved_velocity" }

[[laws]]
name = "D"
about = "image-based"
set = { }

[[tasks]]
name = "turns"
about = "turned and seen late"
file = "ur5"
count = 2
score = "settling"
start = { roll_deg = { from = -40.0, to = 40.0 } }
world = { "camera.latency_ms" = { each = [10.0, 60.0] } }

[[tasks]]
name = "nearly-no-time"
about = "nobody can be there in a tenth of a second"
file = "mine.toml"
count = 1
score = "converged"
duration_s = 0.1
hold_s = 0.05
"#;

fn benchmark(folder: &Path, arguments: &[&str]) -> Output {
    vservo().current_dir(folder).arg("benchmark").args(arguments).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

#[test]
fn a_benchmark_is_the_same_on_any_number_of_threads() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("suite.toml"), SUITE).unwrap();
    let own = vservo().args(["config", "ur5"]).output().unwrap().stdout;
    std::fs::write(folder.path().join("mine.toml"), own).unwrap();
    let mut bytes = Vec::new();
    for (out, threads) in [("one", "1"), ("three", "3")] {
        let done = benchmark(folder.path(), &["--suite", "suite.toml", "--out", out, "--threads", threads]);
        assert!(done.status.success(), "{}", text(&done.stderr));
        assert!(text(&done.stdout).contains("nearly-no-time: D brings 0 of 1 home; 1 not there in time"));
        let at = folder.path().join(out);
        bytes.push(std::fs::read(at.join("benchmark.json")).unwrap());
        let page = std::fs::read_to_string(at.join("index.html")).unwrap();
        assert!(
            page.contains("<svg")
                && page.contains("No law brings any start home.")
                && !page.contains("<script src")
        );
        let times: Value = serde_json::from_slice(&std::fs::read(at.join("times.json")).unwrap()).unwrap();
        assert!(times[1]["step_us"].as_f64().unwrap() > 0.0, "{times}");
    }
    assert_eq!(bytes.first(), bytes.last(), "the same bytes");
    let results: Value = serde_json::from_slice(&bytes[0]).unwrap();
    let task = &results["tasks"][0];
    assert_eq!(
        (task["scenarios"].as_array().unwrap().len(), &task["laws"][1]["summary"]["converged"]),
        (4, &4.into())
    );
    // the same starts for both latencies, seen later in the second case
    assert_eq!(task["scenarios"][0]["q_start"], task["scenarios"][2]["q_start"]);
    assert_eq!(task["scenarios"][3]["case"]["world.camera.latency_ms"], 60.0);
    let one =
        benchmark(folder.path(), &["--suite", "suite.toml", "--law", "D", "--out", "law", "--threads", "2"]);
    assert!(one.status.success());
    let of_one: Value =
        serde_json::from_slice(&std::fs::read(folder.path().join("law/benchmark.json")).unwrap()).unwrap();
    assert_eq!(
        of_one["tasks"][0]["laws"][0], task["laws"][1],
        "a law does not depend on who else takes part"
    );
}

#[test]
fn what_is_no_suite_is_refused_in_words() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("bad.toml"), SUITE.replace("roll_deg", "rol_deg")).unwrap();
    for (arguments, code, word) in [
        (&["--suite", "bad.toml", "--out", "x"][..], 3, "did you mean `roll_deg`?"),
        (&["--suite", "shrt", "--out", "x"], 3, "give a file, or one of short, full"),
        (&["--law", "E", "--out", "x"], 3, "there is no law `E`; choose of A, B, C"),
        (&["--print", "long"], 3, "there is none; choose of short, full"),
        (&["--suite", "short"], 2, "--out"),
        (&["--out", "x", "--threads", "0"], 2, "--threads"),
    ] {
        let done = benchmark(folder.path(), arguments);
        let told = text(&done.stderr);
        assert!(done.status.code() == Some(code) && told.contains(word), "{arguments:?}: {told}");
    }
    assert!(!folder.path().join("x").exists(), "nothing is left of what was refused");
    let printed = benchmark(folder.path(), &["--print", "short"]);
    assert!(printed.status.success() && text(&printed.stdout).contains("[[tasks]]"));
}
