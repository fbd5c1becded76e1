//! The real-time thread makes no system call but its sleep: seen with strace, where it is installed and allowed.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)]

use crate::common::Instance;
use std::process::{Command, Stdio};

#[test]
fn the_real_time_thread_only_sleeps() {
    if !Command::new("strace")
        .args(["-o", "/dev/null", "true"])
        .stderr(Stdio::null())
        .status()
        .is_ok_and(|s| s.success())
    {
        println!("skipped: no strace, or tracing is not allowed");
        return;
    }
    let instance = Instance::new("strace");
    let folder = tempfile::tempdir().unwrap();
    let trace = folder.path().join("trace");
    let status = Command::new("strace")
        .args(["-f", "-qq", "-o"])
        .arg(&trace)
        .arg(env!("CARGO_BIN_EXE_vservo"))
        .args(["run", "--duration-s", "1", "--instance", &instance.name])
        // Traced ticks take longer than a millisecond now and then; that is not what this test is about.
        .args(["--set", "safety.max_missed_deadlines_in_a_row=60000"])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status()
        .unwrap();
    assert_eq!(status.code(), Some(5), "the run ends when its time is over");
    instance.assert_gone();

    let text = std::fs::read_to_string(&trace).unwrap();
    let lines = || text.lines().filter_map(|l| l.split_once(' ').map(|(pid, call)| (pid, call.trim_start())));
    let (thread, _) = lines()
        .find(|(_, call)| call.starts_with("prctl(PR_SET_NAME, \"control-rt\""))
        .expect("the thread tells its name");
    // A call that other threads interrupt is printed in two parts; one of them counts.
    let calls: Vec<&str> = lines()
        .filter(|(pid, _)| *pid == thread)
        .filter_map(|(_, call)| call.split_once('(').map(|(name, _)| name))
        .filter(|name| !name.contains(' '))
        .collect();
    let is_sleep = |name: &&str| *name == "clock_nanosleep";
    let first = calls.iter().position(is_sleep).expect("the thread ticks");
    let last = calls.iter().rposition(is_sleep).expect("the thread ticks");
    let ticking = &calls[first..=last];
    assert!(ticking.len() > 20, "the thread ticks: {calls:?}");
    let others: Vec<_> = ticking.iter().filter(|name| !is_sleep(name)).collect();
    assert!(others.is_empty(), "system calls beside the sleep: {others:?} in {} ticks", ticking.len());
}
