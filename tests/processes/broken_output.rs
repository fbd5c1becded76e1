//! stdout and stderr may be full, closed, or read by nobody: nothing panics, and the run goes on to its end.

#![allow(clippy::unwrap_used)]

use crate::common::{Instance, kill, read_summary, vservo, wait_for_process};
use std::fs::{File, OpenOptions};
use std::io::{Read, Write};
use std::os::unix::process::ExitStatusExt;
use std::process::{Command, Output, Stdio};

fn full() -> File {
    OpenOptions::new().write(true).open("/dev/full").unwrap()
}

/// A pipe that takes nothing more, and its reading end.
fn stuffed_pipe() -> (std::io::PipeReader, std::io::PipeWriter) {
    let (reader, mut writer) = std::io::pipe().unwrap();
    rustix::io::ioctl_fionbio(&writer, true).unwrap();
    while writer.write(&[b'x'; 4096]).is_ok() {}
    rustix::io::ioctl_fionbio(&writer, false).unwrap();
    (reader, writer)
}

fn text(output: &Output) -> String {
    format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr))
}

fn assert_no_panic(output: &Output) {
    assert_ne!(output.status.code(), Some(101), "{}", text(output));
    assert_eq!(output.status.signal(), None, "{}", text(output));
    assert!(!text(output).contains("panicked"), "{}", text(output));
}

#[test]
fn a_run_does_not_need_stderr() {
    let (reader, stuffed) = stuffed_pipe();
    let (gone, closed) = std::io::pipe().unwrap();
    drop(gone);
    for (what, stderr) in
        [("full", Stdio::from(full())), ("closed", Stdio::from(closed)), ("not read", Stdio::from(stuffed))]
    {
        let instance = Instance::new("nostderr");
        let output = vservo()
            .args(["run", "--clock", "lockstep", "--instance", &instance.name])
            .env("VSERVO_LOG", "info")
            .stderr(stderr)
            .output()
            .unwrap();
        let text = text(&output);
        assert_eq!(output.status.code(), Some(0), "{what}: {text}");
        assert!(text.contains("outcome       converged"), "{what}: {text}");
        instance.assert_gone();
    }
    drop(reader);
}

/// In the middle of the motion the reader of stderr goes: the arm goes on, and a stop brings it to rest with a summary.
#[test]
fn a_log_reader_that_leaves_takes_nothing_with_it() {
    let instance = Instance::new("head");
    let folder = tempfile::tempdir().unwrap();
    let summary = folder.path().join("summary.json");
    let mut child = vservo()
        .args([
            "run",
            "--instance",
            &instance.name,
            "--duration-s",
            "60",
            "--set",
            "goal.hold_s=60",
            "--summary",
        ])
        .arg(&summary)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // One byte, like `head -c 1`.
    let mut stderr = child.stderr.take().unwrap();
    stderr.read_exact(&mut [0]).unwrap();
    drop(stderr);
    wait_for_process(&instance, "camera");
    std::thread::sleep(std::time::Duration::from_millis(1500)); // some lines of progress that nobody takes
    assert_eq!(child.try_wait().unwrap(), None, "the run goes on");
    kill(child.id() as i32, "INT");
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(6), "{}", text(&output));
    assert_eq!(read_summary(&summary)["outcome"], "stopped");
    instance.assert_gone();
}

#[test]
fn results_that_cannot_be_shown_are_told_and_never_a_panic() {
    let config = concat!(env!("CARGO_MANIFEST_DIR"), "/config/default.toml");
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().to_str().unwrap();
    let instance = Instance::new("fullstdout");
    let commands: [&[&str]; 6] = [
        &["check", config],
        &["completions", "bash"],
        &["doctor", "--jitter-s", "0"],
        &["experiment", "example-10-5", "--out", out],
        &["run", "--clock", "lockstep", "--instance", &instance.name],
        &["calibrate", "latency", "--clock", "lockstep", "--instance", &instance.name, "--json"],
    ];
    for command in commands {
        let output = vservo().args(command).stdout(full()).output().unwrap();
        assert_no_panic(&output);
        assert_eq!(output.status.code(), Some(3), "{command:?}: {}", text(&output));
        assert!(text(&output).contains("stdout: cannot be written"), "{command:?}: {}", text(&output));
        let both = vservo().args(command).stdout(full()).stderr(full()).output().unwrap();
        assert_no_panic(&both);
        assert_eq!(both.status.code(), Some(3), "{command:?}");
        // A reader that has seen enough is no error.
        let (gone, closed) = std::io::pipe().unwrap();
        drop(gone);
        let output = vservo().args(command).stdout(closed).output().unwrap();
        assert_no_panic(&output);
        assert_eq!(output.status.code(), Some(0), "{command:?}: {}", text(&output));
    }
    for wrong in [
        &["--help"][..],
        &["--version"],
        &["rum"],
        &["check", "no-such-file"],
        &["experiment", "x", "--out", out],
    ] {
        assert_no_panic(&vservo().args(wrong).stdout(full()).stderr(full()).output().unwrap());
    }
    for role in [env!("CARGO_BIN_EXE_vservo-camera"), env!("CARGO_BIN_EXE_vservo-control")] {
        assert_no_panic(
            &Command::new(role).arg("no-such-file").stdout(full()).stderr(full()).output().unwrap(),
        );
    }
    instance.assert_gone();
}
