//! Files for results that cannot be written: the result itself is on stdout first, the failure is told, and what was there
//! before stays whole.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)] // a skipped test says so

use crate::common::{Instance, vservo};
use std::path::Path;
use std::process::{Command, Output};

fn run(arguments: &[&str]) -> (Output, String, String) {
    let instance = Instance::new("results");
    let output = vservo().args(arguments).args(["--instance", &instance.name]).output().unwrap();
    instance.assert_gone();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    let (out, err) = (text(&output.stdout), text(&output.stderr));
    assert!(!err.contains("panicked"), "{err}");
    (output, out, err)
}

const LOCKSTEP: [&str; 3] = ["run", "--clock", "lockstep"];

#[test]
fn an_unwritable_summary_goes_to_stdout_with_an_error() {
    let full = ["--summary", "/dev/full"];
    let (output, out, err) = run(&[&LOCKSTEP[..], &full].concat());
    assert!(out.contains("outcome       converged") && out.contains("state hash"), "{out}{err}");
    assert!(err.contains("vservo: /dev/full: cannot be written: "), "{err}");
    assert_eq!(output.status.code(), Some(3), "{err}");
    // The run's own failure is the graver one.
    let (output, out, err) = run(&[&LOCKSTEP[..], &full, &["--duration-s", "0.3"]].concat());
    assert!(out.contains("outcome       not_converged"), "{out}{err}");
    assert!(err.contains("/dev/full: cannot be written"), "{err}");
    assert_eq!(output.status.code(), Some(5), "{err}");
}

#[test]
fn a_calibration_is_on_stdout_even_if_its_disk_is_full() {
    let calibrate = ["calibrate", "latency", "--clock", "lockstep", "--out", "/dev/full"];
    let (output, out, err) = run(&calibrate);
    assert!(out.contains("stamp_offset_ms = "), "{out}{err}");
    assert!(err.contains("/dev/full: cannot be written"), "{err}");
    assert_eq!(output.status.code(), Some(3));
}

/// `/dev/stdout` is the same file as stdout: text and JSON are both in it.
#[test]
fn a_summary_may_go_to_stdout() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out");
    let instance = Instance::new("tostdout");
    let status = vservo()
        .args(LOCKSTEP)
        .args(["--summary", "/dev/stdout", "--instance", &instance.name])
        .stdout(std::fs::File::create(&path).unwrap())
        .status()
        .unwrap();
    assert_eq!(status.code(), Some(0));
    let text = std::fs::read_to_string(&path).unwrap();
    let json = &text[text.find("\n{").expect("JSON after the text")..];
    assert!(text.starts_with("outcome       converged"), "{text}");
    assert_eq!(serde_json::from_str::<serde_json::Value>(json).unwrap()["outcome"], "converged");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
}

/// Runs shell lines in a place of their own where `$D` is a small full disk; `None` where that cannot be had.
fn on_a_full_disk(disk: &Path, lines: &str) -> Option<Output> {
    let mount = format!("mount -t tmpfs -o size=16k tmpfs {0} || exit 77\nD={0}\n", disk.display());
    let fill = "printf old > $D/old.json; cat /dev/zero > $D/fill 2>/dev/null\n";
    let output = Command::new("unshare")
        .args(["-m", "sh", "-c", &format!("{mount}{fill}{lines}")])
        .env("VSERVO", env!("CARGO_BIN_EXE_vservo"))
        .output()
        .ok()?;
    let possible = output.status.code() != Some(77) && !output.stdout.is_empty();
    if !possible {
        println!("skipped: needs root, and unshare and mount");
    }
    possible.then_some(output)
}

#[test]
fn a_full_disk_leaves_the_file_from_before() {
    let folder = tempfile::tempdir().unwrap();
    let instance = Instance::new("fulldisk");
    let lines = format!(
        "$VSERVO run --clock lockstep --instance {} --summary $D/old.json; echo code $?; cat $D/old.json; echo; ls -A $D",
        instance.name
    );
    let Some(output) = on_a_full_disk(folder.path(), &lines) else { return };
    let (out, err) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(out.contains("outcome       converged"), "{out}{err}");
    assert!(out.contains("code 3\nold\nfill\nold.json\n"), "{out}{err}");
    assert!(err.contains("old.json: cannot be written: No space left"), "{err}");
}

#[test]
fn an_experiment_leaves_no_half_file_on_a_full_disk() {
    let folder = tempfile::tempdir().unwrap();
    let lines = "$VSERVO experiment example-10-1 --out $D/out; echo code $?; find $D/out -type f | wc -l";
    let Some(output) = on_a_full_disk(folder.path(), lines) else { return };
    let (out, err) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(out.starts_with("example-10-1\n  ") && out.contains("code 3\n0\n"), "{out}{err}");
    assert!(err.contains("cannot be written: No space left"), "{err}");
}

/// A result never takes the place of what it was made of, whatever command, name or link leads there.
#[test]
fn no_command_writes_over_what_it_reads() {
    let folder = tempfile::tempdir().unwrap();
    let vservo = |arguments: &[&str]| {
        let instance = Instance::new("inputs");
        let own = if arguments[0] == "run" { vec!["--instance", &instance.name] } else { vec![] };
        let output = vservo().args(arguments).args(own).current_dir(folder.path()).output().unwrap();
        (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    let (code, err) = vservo(&["target", "four_dots:0.1", "--out", "dots.png"]);
    assert_eq!(code, Some(0), "{err}");
    std::fs::write(folder.path().join("cell.toml"), "[run]\nclock = \"lockstep\"\n").unwrap();
    for link in ["link.toml", "shot.png"] {
        std::os::unix::fs::symlink("cell.toml", folder.path().join(link)).unwrap();
    }
    for (arguments, file) in [
        (&["detect", "dots.png", "--target", "four_dots:0.1", "--overlay", "dots.png"][..], "dots.png"),
        (&["run", "cell.toml", "--summary", "cell.toml"], "cell.toml"),
        (&["run", "link.toml", "--summary", "cell.toml"], "cell.toml"),
        (&["run", "cell.toml", "--summary", "link.toml"], "cell.toml"),
        (&["teach", "cell.toml", "--out", "cell.toml"], "cell.toml"),
        (&["place", "cell.toml", "--out", "cell.toml"], "cell.toml"),
        (&["view", "cell.toml", "--out", "shot.png"], "cell.toml"),
    ] {
        let path = folder.path().join(file);
        let before = std::fs::read(&path).unwrap();
        let (code, err) = vservo(arguments);
        assert_eq!(code, Some(2), "{arguments:?}: {err}");
        assert_eq!(std::fs::read(&path).unwrap(), before, "{arguments:?}");
    }
}

/// Recordings, of which a run or a calibration is made, and the folder of a report.
#[test]
fn no_recording_is_written_over_by_what_is_made_of_it() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (recording, report) = (at("run.mcap"), at("report"));
    let record = [&LOCKSTEP[..], &["ur5", "--record", &recording, "--report", &report]].concat();
    assert_eq!(run(&record).0.status.code(), Some(0));
    std::os::unix::fs::symlink(&recording, at("link.mcap")).unwrap();
    let before = std::fs::read(&recording).unwrap();
    let (drive, camera) =
        (format!("drive.replay.recording={recording}"), format!("camera.replay.recording={recording}"));
    let config = format!("{report}/config.toml");
    let told = std::fs::read(&config).unwrap();
    for arguments in [
        &["run", "ur5", "--record", &recording, "--set", "drive.kind=replay", "--set", &drive][..],
        &["run", "ur5", "--summary", &recording, "--set", "camera.source=replay", "--set", &camera],
        &["run", "ur5", "--record", &at("link.mcap"), "--set", "camera.source=replay", "--set", &camera],
    ] {
        let (output, _, err) = run(&[arguments, &["--clock", "lockstep"]].concat());
        assert_eq!(output.status.code(), Some(2), "{arguments:?} {err}");
        assert!(err.contains("it is read by this command"), "{arguments:?} {err}");
    }
    for (from, out) in [(&recording, &recording), (&report, &config)] {
        let output = vservo().args(["calibrate", "from", from, "--out", out]).output().unwrap();
        assert_eq!(output.status.code(), Some(2), "{from} {output:?}");
    }
    assert_eq!(std::fs::read(&recording).unwrap(), before);
    assert_eq!(std::fs::read(&config).unwrap(), told);
}

/// What is written last would be all that is left.
#[test]
fn two_outputs_of_one_name_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("both");
    let (name, other) = (path.to_str().unwrap(), folder.path().join("./both"));
    for (first, second) in [(name, name), (name, other.to_str().unwrap())] {
        let (output, _, told) = run(&[&LOCKSTEP[..], &["--summary", first, "--record", second]].concat());
        assert!(output.status.code() == Some(2) && told.contains("two outputs"), "{told}");
        assert!(!path.exists());
    }
}
