//! `vservo calibrate load` with the real processes: what a simulated arm carries is found, printed and written, and told where it cannot be found.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // helpers of tests are tests

use crate::common::{Instance, number, run, vservo};
use serde_json::Value;
use std::process::Output;

fn calibrate(test: &str, arguments: &[&str]) -> Output {
    let instance = Instance::new(test);
    let output = vservo()
        .args(["calibrate", "load", "ur5", "--clock", "lockstep"])
        .args(arguments)
        .args(["--instance", &instance.name])
        .output()
        .unwrap();
    instance.assert_gone();
    output
}

fn text(output: &Output) -> String {
    format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr))
}

#[test]
fn a_load_is_found_and_its_lines_are_those_of_a_run_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("load.toml");
    let out = path.to_str().unwrap();
    let load = [
        "--set=drive.simulated.payload_kg=2.5",
        "--set=drive.simulated.payload_com_m=[0.03, -0.02, 0.07]",
        "--set=tool.mass_kg=0.5",
        "--set=tool.com_m=[0.0, 0.0, 0.04]",
    ];
    let output = calibrate("load", &[&load[..], &["--out", out]].concat());
    assert_eq!(output.status.code(), Some(0), "{}", text(&output));
    let printed = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(printed.starts_with("the flange carries ") && printed.contains("(told 0.500)"), "{printed}");
    assert!(printed.contains("joint \"wrist_3_joint\": friction "), "{printed}");
    let written = std::fs::read_to_string(&path).unwrap();
    let (head, lines) = written.split_once('\n').unwrap();
    assert!(head.starts_with("# vservo calibrate load: the flange carries ") && printed.ends_with(lines));
    let table: toml::Table = written.parse().unwrap();
    let kg = table["tool"]["mass_kg"].as_float().unwrap();
    assert!((kg - 3.0).abs() < 0.15, "what was told is counted in: {written}");
    let z = table["tool"]["com_m"][2].as_float().unwrap();
    assert!((z - (2.5 * 0.07 + 0.5 * 0.04) / 3.0).abs() < 0.005, "{written}");

    // The arm that is told what it carries has nothing left to be found.
    let told = [
        format!("--set=tool.mass_kg={kg}"),
        format!("--set=tool.com_m={}", table["tool"]["com_m"]),
        "--set=drive.simulated.payload_kg=0".to_owned(),
    ];
    let told = told.each_ref().map(String::as_str);
    let again = run("load", &[&["ur5", "--clock", "lockstep"][..], &told].concat());
    assert_eq!(again.summary["outcome"], "converged", "{}", again.text());
    assert!(again.summary.get("load").is_none(), "a normal run finds no load");
}

#[test]
fn a_load_is_told_as_json_and_none_is_told_as_none() {
    let output = calibrate("load-json", &["--json"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output));
    let summary: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(summary["load"]["is_there"], false, "{}", summary["load"]);
    let (kg, sd) = (number(&summary, &["load", "mass_kg"]), number(&summary, &["load", "mass_sd_kg"]));
    assert!(kg.abs() < 3.0 * sd && sd < 0.1, "{kg} +- {sd}");
    assert_eq!(summary["load"]["joints"].as_array().unwrap().len(), 6);
}

#[test]
fn what_shows_no_load_is_refused_with_its_reason() {
    for (extra, told, exit_code) in [
        ("drive.mode=velocity", "drive.mode: is `velocity`: no torques are commanded", 3),
        ("drive.kind=ideal", "this drive measures none", 3),
        ("drive.simulated.payload_kg=60", "vservo: no load was found: ", 4),
        ("run.duration_s=5", "all postures were visited", 5),
    ] {
        let output = calibrate("no-load", &["--set", extra]);
        assert_eq!(output.status.code(), Some(exit_code), "{extra}: {}", text(&output));
        assert!(text(&output).contains(told), "{extra}: {}", text(&output));
        assert!(output.stdout.is_empty(), "{extra}: {}", text(&output));
    }
}
