//! What others may have laid in a run's way: its names in shared memory taken, by another user or by links and pipes; and
//! a run file exchanged between writing and reading.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)] // a skipped test says so

use crate::common::{Instance, vservo, wait_until};
use std::os::unix::fs::{MetadataExt, PermissionsExt, symlink};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};

const NOBODY: u32 = 65534;
const PRECIOUS: &str = "precious\n";

/// Whether this test can act as another user; says so where it cannot.
fn can_become_another() -> bool {
    let able = Command::new("setpriv")
        .args(["--reuid=65534", "--regid=65534", "--clear-groups", "true"])
        .stderr(Stdio::null())
        .status()
        .is_ok_and(|s| s.success());
    if !able {
        println!("skipped: needs root");
    }
    able
}

/// Runs a line of shell as another user.
fn as_nobody(line: &str) {
    let done = Command::new("setpriv")
        .args(["--reuid=65534", "--regid=65534", "--clear-groups", "sh", "-c", line])
        .status()
        .unwrap();
    assert!(done.success(), "{line}");
}

struct Refused {
    text: String,
    code: Option<i32>,
}

fn run(instance: &Instance) -> Refused {
    let output = vservo()
        .args(["run", "--clock", "lockstep", "--duration-s", "1", "--instance", &instance.name])
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!text.contains("panicked"), "{text}");
    Refused { text, code: output.status.code() }
}

fn directory(instance: &Instance) -> PathBuf {
    PathBuf::from(format!("/dev/shm/vservo-{}", instance.name))
}

fn precious() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("precious");
    std::fs::write(&path, PRECIOUS).unwrap();
    (folder, path)
}

fn assert_untouched(precious: &Path) {
    assert_eq!(std::fs::read_to_string(precious).unwrap(), PRECIOUS);
}

fn remove(path: &Path) {
    let _ = std::fs::remove_file(path).or_else(|_| std::fs::remove_dir_all(path));
}

/// Removes everything under an instance's names, whoever owns it.
struct Sweep<'a>(&'a Instance);

impl Drop for Sweep<'_> {
    fn drop(&mut self) {
        self.0.leftovers().iter().for_each(|path| remove(path));
    }
}

#[test]
fn another_users_directory_is_refused_and_not_written_to() {
    if !can_become_another() {
        return;
    }
    let (_folder, target) = precious();
    let target_text = target.to_str().unwrap();
    for lay in [
        "mkdir -m 777 $D; ln -s $T $D/config.toml",
        // A lock that cannot be taken keeps the clean-up from removing the link.
        "mkdir -m 777 $D; mkdir $D/drive.lock; ln -s $T $D/config.toml",
        "mkdir -m 755 $D; ln -s $T $D/config.toml",
        "mkdir -m 700 $D; ln -s $T $D/config.toml; ln -s $T $D/supervisor.lock",
        "mkdir -m 777 $D; mkfifo $D/supervisor.lock; mkfifo $D/config.toml",
        "mkdir -m 777 $D; for r in supervisor camera vision control drive; do ln -s $T $D/$r.lock; done",
        "echo > $D",
        "mkfifo $D",
        "ln -s / $D",
        "mkdir -m 777 $D.there; ln -s $D.there $D",
    ] {
        let instance = Instance::new("foreign");
        let _sweep = Sweep(&instance);
        let directory = directory(&instance);
        as_nobody(&lay.replace("$D", directory.to_str().unwrap()).replace("$T", target_text));
        let before = std::fs::symlink_metadata(&directory).unwrap();
        let refused = run(&instance);
        assert_untouched(&target);
        assert_eq!(refused.code, Some(3), "{lay}: {}", refused.text);
        let line = format!("{} is a", directory.display());
        assert!(refused.text.contains(&line), "{lay}: {}", refused.text);
        assert!(refused.text.contains(&format!("of user {NOBODY}, not yours")), "{lay}: {}", refused.text);
        assert!(refused.text.contains("--instance NAME"), "{lay}: {}", refused.text);
        let after = std::fs::symlink_metadata(&directory).unwrap();
        assert_eq!((after.ino(), after.mode(), after.uid()), (before.ino(), before.mode(), NOBODY), "{lay}");
        remove(&PathBuf::from(format!("{}.there", directory.display())));
    }
}

/// The same for a single process, and for one that is no root: it cannot even look into a directory of root.
#[test]
fn a_single_process_refuses_them_too() {
    if !can_become_another() {
        return;
    }
    let instance = Instance::new("foreignone");
    let _sweep = Sweep(&instance);
    as_nobody(&format!("mkdir -m 777 {}", directory(&instance).display()));
    for role in ["camera", "vision", "control"] {
        let output = vservo().args([role, "--instance", &instance.name]).output().unwrap();
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(3), "{text}");
        assert!(text.contains("of user 65534, not yours (you are user 0)"), "{text}");
    }
    let instance = Instance::new("ofroot");
    let _sweep = Sweep(&instance);
    std::fs::create_dir(directory(&instance)).unwrap();
    std::fs::set_permissions(directory(&instance), PermissionsExt::from_mode(0o700)).unwrap();
    // A copy that everybody can reach.
    let folder = tempfile::tempdir().unwrap();
    std::fs::set_permissions(folder.path(), PermissionsExt::from_mode(0o755)).unwrap();
    let program = folder.path().join("vservo");
    std::fs::copy(env!("CARGO_BIN_EXE_vservo"), &program).unwrap();
    let output = Command::new("setpriv")
        .args(["--reuid=65534", "--regid=65534", "--clear-groups"])
        .arg(&program)
        .args(["run", "--instance", &instance.name])
        .current_dir("/")
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(3), "{text}");
    assert!(text.contains("of user 0, not yours (you are user 65534)"), "{text}");
}

#[test]
fn segments_of_another_user_are_refused_and_left_alone() {
    if !can_become_another() {
        return;
    }
    let (_folder, target) = precious();
    for (lay, kind) in [
        ("echo 0123456789abcdef > $S; chmod 666 $S", "a file"),
        (": > $S; chmod 666 $S", "a file"),
        ("ln -s $T $S", "a symbolic link"),
        ("mkfifo $S", "a pipe"),
    ] {
        let instance = Instance::new("foreignsegment");
        let _sweep = Sweep(&instance);
        // The one name that can be known beforehand: the transport opens it where it finds it.
        let name = format!(
            "/dev/shm/vservo.{}.9204dd183d1c4d8e1ff592a30766ffa6765aa8b5_node.0_10_0.global_mgmt",
            instance.name
        );
        as_nobody(&lay.replace("$S", &name).replace("$T", target.to_str().unwrap()));
        let refused = run(&instance);
        assert_eq!(refused.code, Some(3), "{lay}: {}", refused.text);
        let words = format!("{name} is {kind} of user {NOBODY}, not yours");
        assert!(refused.text.contains(&words), "{lay}: {}", refused.text);
        assert_eq!(std::fs::symlink_metadata(&name).unwrap().uid(), NOBODY, "{lay}");
        assert_untouched(&target);
    }
}

#[test]
fn a_directory_of_ones_own_must_be_closed_to_writing_by_others() {
    let instance = Instance::new("open");
    let _sweep = Sweep(&instance);
    let directory = directory(&instance);
    std::fs::create_dir(&directory).unwrap();
    for mode in [0o777, 0o720, 0o702] {
        std::fs::set_permissions(&directory, PermissionsExt::from_mode(mode)).unwrap();
        let refused = run(&instance);
        assert_eq!(refused.code, Some(3), "{}", refused.text);
        assert!(refused.text.contains("in which other users may write"), "{}", refused.text);
        assert!(refused.text.contains(&format!("mode {mode:o}")), "{}", refused.text);
    }
    // Where others could only read, it is closed and used.
    std::fs::set_permissions(&directory, PermissionsExt::from_mode(0o755)).unwrap();
    assert_eq!(run(&instance).code, Some(5));
    instance.assert_gone();
}

/// Links among the leftovers are removed, and not what they lead to; in the place of a lock they are refused.
#[test]
fn links_in_the_directory_are_not_followed() {
    let (folder, target) = precious();
    let instance = Instance::new("links");
    let _sweep = Sweep(&instance);
    let directory = directory(&instance);
    std::fs::create_dir(&directory).unwrap();
    std::fs::set_permissions(&directory, PermissionsExt::from_mode(0o700)).unwrap();
    for name in ["nodes", "services", "other"] {
        symlink(folder.path(), directory.join(name)).unwrap();
    }
    symlink(&target, directory.join("config.toml")).unwrap();
    let segment = format!("/dev/shm/vservo.{}.old", instance.name);
    symlink(&target, &segment).unwrap();
    assert_eq!(run(&instance).code, Some(5));
    assert_untouched(&target);
    instance.assert_gone();

    for lock in ["supervisor", "control"] {
        std::fs::create_dir(&directory).unwrap();
        std::fs::set_permissions(&directory, PermissionsExt::from_mode(0o700)).unwrap();
        symlink(&target, directory.join(format!("{lock}.lock"))).unwrap();
        let refused = run(&instance);
        assert_untouched(&target);
        assert_eq!(refused.code, Some(3), "{lock}: {}", refused.text);
        let words = format!("{lock}.lock is a symbolic link, not a file");
        assert!(refused.text.contains(&words), "{lock}: {}", refused.text);
        std::fs::remove_dir_all(&directory).unwrap();
    }
}

/// All processes read the file that was written, whatever comes to its path: nobody needs to be quick, because it is
/// exchanged as soon as it is there.
#[test]
fn a_run_file_that_is_exchanged_is_not_read() {
    let instance = Instance::new("exchanged");
    let directory = directory(&instance);
    let done = AtomicBool::new(false);
    let exchanged = AtomicBool::new(false);
    let other = directory.join("other.toml");
    let path = directory.join("config.toml");
    std::thread::scope(|scope| {
        scope.spawn(|| {
            while !done.load(Ordering::Relaxed) {
                if path.exists()
                    && std::fs::write(&other, "[servo]\nnonsense = 1\n").is_ok()
                    && std::fs::rename(&other, &path).is_ok()
                {
                    exchanged.store(true, Ordering::Relaxed);
                }
            }
        });
        for _ in 0..3 {
            let output =
                vservo().args(["run", "--clock", "lockstep", "--instance", &instance.name]).output().unwrap();
            let text = String::from_utf8_lossy(&output.stderr).into_owned();
            if output.status.code() != Some(0) {
                done.store(true, Ordering::Relaxed);
            }
            assert_eq!(output.status.code(), Some(0), "{text}");
        }
        done.store(true, Ordering::Relaxed);
    });
    assert!(exchanged.load(Ordering::Relaxed));
    remove(&directory);
    instance.assert_gone();
}

/// During a run nothing of it is open to others.
#[test]
fn nothing_of_a_run_is_open_to_others() {
    let instance = Instance::new("closed");
    let mut child = vservo()
        .args(["run", "--instance", &instance.name, "--duration-s", "60", "--set", "goal.hold_s=60"])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let open = || -> Vec<String> {
        let paths = instance.leftovers().into_iter().chain([directory(&instance).join("config.toml")]);
        let mode = |p: &PathBuf| std::fs::symlink_metadata(p).map_or(0, |m| m.mode() & 0o077);
        paths.filter(|p| mode(p) != 0).map(|p| p.display().to_string()).collect()
    };
    wait_until("all segments", || instance.leftovers().len() > 20);
    wait_until("all of them to be closed", || open().is_empty());
    crate::common::kill(child.id() as i32, "INT");
    child.wait().unwrap();
    instance.assert_gone();
}
