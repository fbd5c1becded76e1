//! The real-time thread makes no system call but its sleep: seen with strace, where it is installed and allowed.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)]

mod common;

use common::Instance;
use std::collections::BTreeMap;
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
    let mut calls: BTreeMap<&str, u32> = BTreeMap::new();
    let mut ticking = false;
    for (_, call) in lines().filter(|(pid, _)| *pid == thread) {
        // A call that other threads interrupt is printed in two parts; one of them counts.
        let Some((name, _)) = call.split_once('(').filter(|(name, _)| !name.contains(' ')) else { continue };
        ticking |= name == "clock_nanosleep";
        if ticking {
            *calls.entry(name).or_default() += 1;
        }
    }
    let sleeps = calls.remove("clock_nanosleep").unwrap_or(0);
    assert!(sleeps > 20, "the thread ticks: {sleeps} sleeps");
    // What a thread does once when it ends.
    let ends: u32 = ["futex", "madvise", "munmap", "rseq", "rt_sigprocmask", "sigaltstack", "exit", "write"]
        .iter()
        .filter_map(|name| calls.remove(name))
        .sum();
    assert!(calls.is_empty(), "system calls beside the sleep: {calls:?}");
    assert!(ends < 40, "{ends} calls that belong to the end of a thread, in {sleeps} ticks");
}
