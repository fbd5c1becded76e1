//! What a new user meets: words that are misspelt, run files by name, what there is to choose from, logs for programs, a terminal.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout)] // helpers of tests; a skip is told

use std::path::Path;
use std::process::{Command, Output, Stdio};

const VSERVO: &str = env!("CARGO_BIN_EXE_vservo");

/// Runs the program in an empty folder, as after `cargo install`.
fn elsewhere(arguments: &[&str]) -> Output {
    let folder = tempfile::tempdir().unwrap();
    in_folder(folder.path(), arguments, &[])
}

fn in_folder(folder: &Path, arguments: &[&str], environment: &[(&str, &str)]) -> Output {
    let mut command = Command::new(VSERVO);
    command.args(arguments).envs(environment.iter().copied()).current_dir(folder).stdin(Stdio::null());
    command.output().unwrap()
}

fn text(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr)
}

#[test]
fn a_misspelt_command_is_told_and_taken_for_no_file() {
    for (word, meant) in
        [("rum", "vservo run"), ("chek", "vservo check"), ("ur", "ur5"), ("frobnicate", "--help")]
    {
        let output = elsewhere(&[word]);
        assert_eq!(output.status.code(), Some(2), "{word}: {}", text(&output));
        assert!(text(&output).contains(meant), "{word}: {}", text(&output));
    }
    let output = elsewhere(&["run", "ur55"]);
    assert_eq!(output.status.code(), Some(3), "{}", text(&output));
    assert!(text(&output).contains("did you mean `ur5`?"), "{}", text(&output));
}

#[test]
fn shipped_run_files_are_at_hand_anywhere() {
    let instance = format!("hour-{}", std::process::id());
    let output = elsewhere(&["run", "ur5", "--clock", "lockstep", "--instance", &instance]);
    assert!(output.status.success(), "{}", text(&output));
    assert!(text(&output).contains("converged"), "{}", text(&output));
    let output = elsewhere(&["check", "ur5"]);
    assert!(text(&output).starts_with("ur5: ok: "), "{}", text(&output));
    let output = elsewhere(&["check"]);
    assert!(text(&output).starts_with("default: ok: "), "{}", text(&output));
    // a file of that name comes before
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("ur5"), "[camera]\nrate_hz = 1e9\n").unwrap();
    let output = in_folder(folder.path(), &["check", "ur5"], &[]);
    assert_eq!(output.status.code(), Some(3), "{}", text(&output));
    assert!(text(&output).contains("ur5:2:1: camera.rate_hz"), "{}", text(&output));
    // one that needs more than the program has says so
    let output = elsewhere(&["check", "real-cell"]);
    assert_eq!(output.status.code(), Some(3), "{}", text(&output));
    assert!(text(&output).contains("vservo config real-cell"), "{}", text(&output));
}

#[test]
fn lists_tell_what_there_is() {
    let list = elsewhere(&["config", "--list"]);
    let experiments = elsewhere(&["experiment", "--list"]);
    assert!(list.status.success() && experiments.status.success());
    assert!(text(&list).lines().any(|line| line.starts_with("ur5-hybrid ")), "{}", text(&list));
    assert!(text(&experiments).lines().any(|line| line.starts_with("comparison ")), "{}", text(&experiments));
    let printed = elsewhere(&["config", "panda"]);
    assert_eq!(
        printed.stdout,
        std::fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("config/panda.toml")).unwrap()
    );
    let default = elsewhere(&["config"]);
    assert!(text(&default).contains("[servo.visibility]"));
    let unknown = elsewhere(&["config", "pnada"]);
    assert_eq!(unknown.status.code(), Some(2));
    assert!(text(&unknown).contains("did you mean `panda`?"), "{}", text(&unknown));
}

/// As a shell's script asks: by the variable, the words, and the index of the one that is typed.
#[test]
fn a_shell_is_offered_run_files_experiments_and_keys() {
    let folder = tempfile::tempdir().unwrap();
    let offered = |words: &[&str]| {
        let index = (words.len() - 1).to_string();
        let environment =
            [("COMPLETE", "bash"), ("_CLAP_COMPLETE_INDEX", index.as_str()), ("_CLAP_IFS", "\n")];
        let arguments: Vec<&str> = ["--"].into_iter().chain(words.iter().copied()).collect();
        text(&in_folder(folder.path(), &arguments, &environment))
    };
    assert!(offered(&["vservo", "run", "ur"]).lines().any(|line| line == "ur5-b"));
    assert!(offered(&["vservo", "experiment", "comp"]).contains("comparison"));
    assert!(offered(&["vservo", "run", "--set", "servo.ga"]).contains("servo.gain_1_s="));
    assert!(offered(&["vservo", "exp"]).contains("experiment"));
    for shell in ["bash", "zsh", "fish"] {
        let script = elsewhere(&["completions", shell]);
        assert!(script.status.success() && text(&script).contains("vservo"), "{shell}");
    }
}

/// Each command that `--help` shows has a page, and what a package takes from this clone is there.
#[test]
fn a_package_has_its_pages_unit_and_user() {
    let folder = tempfile::tempdir().unwrap();
    let pages = folder.path().join("share/man1");
    let written = in_folder(folder.path(), &["man", "--out", pages.to_str().unwrap()], &[]);
    assert!(written.status.success(), "{}", text(&written));
    let page = |name: &str| std::fs::read_to_string(pages.join(format!("{name}.1"))).expect(name);
    let help = text(&in_folder(folder.path(), &["--help"], &[]));
    let commands = help.lines().skip_while(|line| *line != "Commands:").skip(1);
    let commands: Vec<&str> = commands
        .take_while(|line| !line.is_empty())
        .filter(|line| !line.starts_with("   ")) // which go on with a sentence
        .filter_map(|line| line.split_whitespace().next())
        .collect();
    assert!(commands.len() > 20, "{help}");
    for command in commands.iter().filter(|command| **command != "help") {
        assert!(page(&format!("vservo-{command}")).contains("SYNOPSIS"), "{command}");
    }
    assert!(page("vservo-run").contains("clock") && page("vservo").contains("Visual servoing"));
    let hidden = std::fs::read_dir(&pages).unwrap().any(|page| {
        let name = page.unwrap().file_name();
        name.to_string_lossy().contains("guard")
    });
    assert!(!hidden, "commands for the supervisor alone have no page");

    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let manifest: toml::Value =
        std::fs::read_to_string(root.join("Cargo.toml")).unwrap().parse::<toml::Table>().unwrap().into();
    let package = &manifest["package"]["metadata"]["deb"];
    for asset in package["assets"].as_array().unwrap() {
        let source = asset[0].as_str().unwrap();
        let is_built = source.starts_with("target/");
        let fixed = source.split('*').next().unwrap();
        assert!(is_built || root.join(fixed).exists(), "{source}");
    }
    let unit = std::fs::read_to_string(root.join("contrib/vservo@.service")).unwrap();
    for man in unit.split("man:").skip(1) {
        page(man.split('(').next().unwrap());
    }
}

#[test]
fn a_log_for_programs_is_objects_with_times() {
    let folder = tempfile::tempdir().unwrap();
    let instance = format!("hour-json-{}", std::process::id());
    for arguments in [["run", "default", "--log-format", "json"], ["--log-format", "json", "run", "default"]]
    {
        let arguments = [&arguments[..], &["--clock", "lockstep", "--instance", &instance]].concat();
        let output = in_folder(folder.path(), &arguments, &[]);
        assert!(output.status.success(), "{}", text(&output));
        let log = String::from_utf8(output.stderr).unwrap();
        assert!(log.lines().count() > 3, "{log}");
        for line in log.lines() {
            let object: serde_json::Value = serde_json::from_str(line).expect(line);
            assert!(object["timestamp"].is_string() && object["level"].is_string(), "{line}");
        }
        assert!(log.contains("target found"), "that of the other processes too: {log}");
    }
    // what is no level is told once, and not by each process
    let arguments = ["run", "default", "--clock", "lockstep", "--instance", &instance];
    let output = in_folder(folder.path(), &arguments, &[("VSERVO_LOG", "json")]);
    assert_eq!(text(&output).matches("--log-format json").count(), 1, "{}", text(&output));
    assert!(text(&output).contains("target found"), "{}", text(&output));
}

/// On a terminal a line of the log takes the place of the progress, and does not stand behind it.
#[test]
fn no_log_line_begins_on_the_line_of_the_progress() {
    if Command::new("script").arg("--version").output().is_err() {
        println!("skipped: no `script` to make a terminal");
        return;
    }
    let instance = format!("hour-tty-{}", std::process::id());
    let run = format!("{VSERVO} run default --duration-s 1.5 --instance {instance}");
    let output =
        Command::new("script").args(["-qec", &run, "/dev/null"]).stdin(Stdio::null()).output().unwrap();
    let shown = text(&output);
    let infos = shown.match_indices("INFO").count();
    assert!(infos >= 3, "{shown}");
    for (at, _) in shown.match_indices("INFO") {
        let before = shown[..at].rsplit(['\n', '\r']).next().unwrap();
        assert!(before.starts_with("\u{1b}[2K"), "{before:?} before a line of the log");
        assert!(!before.contains("feature error") && !before.contains("waiting"), "{before:?}");
    }
}

#[test]
fn a_goal_is_taught_in_one_place_and_come_back_to_from_another() {
    let folder = tempfile::tempdir().unwrap();
    let there = "robot.q_start_rad_or_m=[0.48, -1.7, 1.44, -1.28, -1.8, 0.9]";
    let taught = in_folder(folder.path(), &["teach", "ur5", "--set", there, "--out", "goal.toml"], &[]);
    assert!(
        taught.status.success() && text(&taught).contains("4 points from 10 images"),
        "{}",
        text(&taught)
    );
    let image = image::open(folder.path().join("goal.png")).unwrap();
    assert_eq!((image.width(), image.height()), (640, 480));
    let instance = format!("hour-teach-{}", std::process::id());
    let run = ["run", "ur5", "--set", "servo.set_point.file=goal.toml", "--summary", "run.json"];
    let run = [&run[..], &["--clock", "lockstep", "--instance", &instance]].concat();
    let run = in_folder(folder.path(), &run, &[]);
    assert!(run.status.success(), "{}", text(&run));
    let summary = std::fs::read_to_string(folder.path().join("run.json")).unwrap();
    let summary: serde_json::Value = serde_json::from_str(&summary).unwrap();
    assert!(summary["final"]["position_error_m"].as_f64().unwrap() < 2e-4, "{summary}");
    // the image of it teaches the same
    let again = ["teach", "ur5", "--image", "goal.png", "--measurements", "1", "--out", "again.toml"];
    let again = in_folder(folder.path(), &again, &[]);
    assert!(again.status.success(), "{}", text(&again));
    // what shows no target teaches nothing
    image::GrayImage::new(640, 480).save(folder.path().join("dark.png")).unwrap();
    let dark = in_folder(folder.path(), &["teach", "ur5", "--image", "dark.png", "--out", "dark.toml"], &[]);
    assert_eq!(dark.status.code(), Some(5), "{}", text(&dark));
    assert!(
        text(&dark).contains("no contrast") && !folder.path().join("dark.toml").exists(),
        "{}",
        text(&dark)
    );
    let nowhere = in_folder(folder.path(), &["teach", "ur5", "--out", "absent/goal.toml"], &[]);
    assert_eq!(nowhere.status.code(), Some(3), "{}", text(&nowhere));
}

#[test]
fn doctor_ends_with_a_verdict() {
    let output = elsewhere(&["doctor", "--jitter-s", "0.2"]);
    let last = text(&output).lines().last().unwrap().to_owned();
    assert!(last.starts_with("verdict ") && last.contains("1 kHz"), "{last}");
}
