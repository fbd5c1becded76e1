//! Too little of what a run needs: it is named, with what helps, and nothing is left.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)] // a skipped test says so

use crate::common::Instance;
use std::process::Command;

/// A run behind shell lines that take something away; exit code and what it said.
fn run(wrap: &[&str], lines: &str) -> (Option<i32>, String) {
    let instance = Instance::new("scarce");
    let run = format!(
        "{lines}\n{} run --clock lockstep --instance {}\ncode=$?\nls /dev/shm | grep -F {}\nexit $code",
        env!("CARGO_BIN_EXE_vservo"),
        instance.name,
        instance.name
    );
    let [program, arguments @ ..] = wrap else { panic!("a program") };
    let output = Command::new(program).args(arguments).args(["-c", &run]).output().unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    let all = text(&output.stdout) + &text(&output.stderr);
    assert!(!all.contains("panicked"), "{lines}: {all}");
    assert!(!all.contains(&format!("vservo-{}\n", instance.name)), "leftovers: {all}");
    instance.assert_gone();
    (output.status.code(), all)
}

fn assert_not_misled(text: &str) {
    for wrong in ["same version", "another process of this role", "another version", "already has a running"]
    {
        assert!(!text.contains(wrong), "`{wrong}` in\n{text}");
    }
}

#[test]
fn too_few_file_descriptors_are_named() {
    let mut refused = 0;
    for limit in [8, 12, 16, 20, 24, 28, 32, 36, 40, 48, 56, 64, 80] {
        let (code, text) = run(&["sh"], &format!("ulimit -n {limit}"));
        if code == Some(0) {
            continue;
        }
        refused += 1;
        assert_not_misled(&text);
        assert!(text.contains("file descriptors") && text.contains("ulimit -n 1024"), "{limit}: {text}");
    }
    assert!(refused > 3, "some of the limits are too low");
}

#[test]
fn too_few_inodes_and_too_little_space_are_named() {
    let mut refused = 0;
    for (options, word) in [
        ("nr_inodes=4", "df -i /dev/shm"),
        ("nr_inodes=8", "df -i /dev/shm"),
        ("nr_inodes=12", "df -i /dev/shm"),
        ("nr_inodes=20", "df -i /dev/shm"),
        ("nr_inodes=40", "df -i /dev/shm"),
        ("nr_inodes=60", "df -i /dev/shm"),
        ("nr_inodes=80", "df -i /dev/shm"),
        ("size=4k", "df /dev/shm"),
        ("size=16k", "df /dev/shm"),
        ("size=64k", "df /dev/shm"),
        ("size=256k", "KiB are needed"),
        ("size=16m", "KiB are needed"),
    ] {
        let mount = format!("mount -t tmpfs -o mode=1777,{options} tmpfs /dev/shm || exit 77");
        let (code, text) = run(&["unshare", "-m", "sh"], &mount);
        if code == Some(77) || text.contains("unshare failed") {
            println!("skipped: needs root, and unshare and mount");
            return;
        }
        if code == Some(0) {
            continue;
        }
        refused += 1;
        assert_not_misled(&text);
        assert!(text.contains(word), "{options}: {text}");
    }
    assert!(refused > 5, "{refused}");
    let (code, text) =
        run(&["unshare", "-m", "sh"], "mount -t tmpfs -o mode=1777,size=40m tmpfs /dev/shm || exit 77");
    assert_eq!(code, Some(0), "what is asked for is enough: {text}");
}
