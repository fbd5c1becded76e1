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

/// The sample of an entrant, beside a law; and its runs, with everyone's, once more from what was true.
#[test]
fn a_program_takes_part_and_its_scores_can_be_computed_anew() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("suite.toml"), SUITE).unwrap();
    let own = vservo().args(["config", "ur5"]).output().unwrap().stdout;
    std::fs::write(folder.path().join("mine.toml"), own).unwrap();
    let sample = format!("python-ibvs=python3 {}", root("examples/entrant/ibvs.py"));
    let mut bytes = Vec::new();
    for (out, threads) in [("one", "1"), ("two", "2")] {
        let arguments =
            ["--suite", "suite.toml", "--entrant", &sample, "--truth", "--out", out, "--threads", threads];
        let done = benchmark(folder.path(), &arguments);
        assert!(done.status.success(), "{}", text(&done.stderr));
        assert!(text(&done.stdout).contains("gain_1_s = 2.0"), "settings are shown");
        bytes.push(std::fs::read(folder.path().join(out).join("benchmark.json")).unwrap());
    }
    assert_eq!(bytes.first(), bytes.last(), "the same bytes");
    let results: Value = serde_json::from_slice(&bytes[0]).unwrap();
    let laws = &results["tasks"][0]["laws"];
    assert_eq!((&laws[2]["law"], &laws[2]["summary"]["converged"]), (&"python-ibvs".into(), &4.into()));
    assert_ne!(laws[2]["runs"][0]["state_hash"], laws[1]["runs"][0]["state_hash"]);
    assert!(results["entrants"][0]["command"].as_str().unwrap().ends_with("ibvs.py"));
    let times: Value =
        serde_json::from_slice(&std::fs::read(folder.path().join("one/times.json")).unwrap()).unwrap();
    assert!(times[2]["round_trip"] == true && times[2]["step_us"].as_f64().unwrap() > 1.0, "{times}");
    let page = std::fs::read_to_string(folder.path().join("one/index.html")).unwrap();
    assert!(
        page.contains("Entrants")
            && page.contains("mean interaction matrix")
            && page.contains("round trip, us")
    );
    // 5 starts, two laws and an entrant
    let anew = || {
        std::process::Command::new("python3")
            .arg(root("contrib/benchmark/scores.py"))
            .arg(folder.path().join("one"))
            .output()
            .unwrap()
    };
    let computed = anew();
    assert_eq!(text(&computed.stdout), "15 runs agree, 0 differ\n", "{}", text(&computed.stderr));
    // a run that jumps back to its start at its end is not the one that was scored
    let one = folder.path().join("one/truth/turns-0-B.csv");
    let truth = std::fs::read_to_string(&one).unwrap();
    let start = truth.lines().nth(2).unwrap().to_owned() + "\n";
    std::fs::write(&one, truth + &start).unwrap();
    let computed = anew();
    assert!(
        computed.status.code() == Some(1) && text(&computed.stdout).contains("turns-0-B.csv: "),
        "{}",
        text(&computed.stdout)
    );
}

/// Programs that answer the task, and then go wrong: their runs are lost with the reason, and the benchmark goes on.
#[test]
fn an_entrant_that_fails_loses_its_runs_alone() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("suite.toml"), SUITE.replace("mine.toml", "ur5")).unwrap();
    let program = "import sys, time\nprint('{\"about\": \"fails\"}', flush=True) if sys.stdin.readline() else 0\nsys.stdin.readline()\n";
    let mut arguments = ["--suite", "suite.toml", "--law", "D", "--out", "out", "--entrant-timeout", "3"]
        .map(String::from)
        .to_vec();
    for (name, deed) in [
        ("ends", "sys.exit(7)"),
        ("hangs", "time.sleep(1000)"),
        ("babbles", "print('x' * 200_000, flush=True); time.sleep(1000)"),
        ("nonsense", "sys.stdout.buffer.write(bytes([255, 10])); sys.stdout.flush(); time.sleep(1000)"),
        ("nan", "print('{\"twist\": [NaN, 0, 0, 0, 0, 0]}', flush=True); time.sleep(1000)"),
        ("rests", "print('null', flush=True)\nfor line in sys.stdin: print('null', flush=True)"),
    ] {
        let file = folder.path().join(format!("{name}.py"));
        std::fs::write(&file, format!("{program}{deed}\n")).unwrap();
        arguments.extend(["--entrant".into(), format!("{name}=python3 {}", file.display())]);
    }
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let done = benchmark(folder.path(), &arguments);
    assert!(done.status.success(), "{}", text(&done.stderr));
    let results: Value =
        serde_json::from_slice(&std::fs::read(folder.path().join("out/benchmark.json")).unwrap()).unwrap();
    let laws = results["tasks"][0]["laws"].as_array().unwrap();
    assert_eq!(laws[0]["summary"]["converged"], 4, "the law is as good as ever");
    for (law, words) in laws[1..].iter().zip([
        "the entrant ended before its run was over (exit status: 7)",
        "the entrant did not answer within 3 s (--entrant-timeout)",
        "the entrant answers with more than 100000 bytes in a line",
        "the entrant answers with bytes that are no text in UTF-8",
        "the entrant answers `{\"twist\": [NaN, 0, 0, 0, 0, 0]}`",
        "not there in time",
    ]) {
        assert_eq!(law["summary"]["converged"], 0, "{law}");
        for run in law["runs"].as_array().unwrap() {
            assert!(run["end"].as_str().unwrap().starts_with(words), "{words}: {}", run["end"]);
        }
    }
    assert!(text(&done.stdout).contains("hangs brings 0 of 4 home; 4 the entrant did not answer"));
}

#[test]
fn entrants_that_cannot_take_part_are_refused_in_words() {
    let folder = tempfile::tempdir().unwrap();
    let ready = "read line; echo '{\"about\": \"x\"}'";
    let twice = format!("D-mean={ready}");
    for (entrant, timeout, code, words) in [
        ("no-such-program", "10", 3, "`no-such-program` ended before its run was over (exit status: 127)"),
        ("mute=sleep 1000", "0.2", 3, "`sleep 1000` did not answer within 0.2 s"),
        ("cat", "10", 3, "`cat` answers the task with"),
        (&twice, "10", 3, "law or entrant `D-mean`: stands there twice; name it"),
        (ready, "never", 2, "expected seconds, 0.001 to 3600"),
        (ready, "0", 2, "expected seconds, 0.001 to 3600"),
    ] {
        let arguments = ["--entrant", entrant, "--entrant-timeout", timeout, "--out", "x"];
        let done = benchmark(folder.path(), &arguments);
        let told = text(&done.stderr);
        assert!(done.status.code() == Some(code) && told.contains(words), "{entrant}: {told}");
    }
}

fn root(path: &str) -> String {
    format!("{}/{path}", env!("CARGO_MANIFEST_DIR"))
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
