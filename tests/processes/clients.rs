//! Clients that are killed, that hang, that are too many, and shared memory that is full: the arm is stopped all the same.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)] // a skipped test says so

use crate::common::{Instance, kill, vservo, wait_for_process, wait_until};
use crate::serve::Daemon;
use std::process::{Child, Command, Stdio};
use std::time::Duration;
use vservo::rt::now;
use vservo::time::SpanNs;

/// Clients that may ask at once, and a few more.
const CROWD: usize = 12;

fn client(daemon: &Daemon, what: &str, timeout_s: &str) -> Child {
    vservo()
        .args(["ctl", what, "--instance", &daemon.instance.name, "--timeout-s", timeout_s])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap()
}

/// As root a segment without a size can be opened, and is waited for: then this test shows most.
#[test]
fn clients_killed_at_any_moment_hold_up_nobody() {
    // All of its 300 draws behind a switch, as they take a minute.
    let clients = if std::env::var_os("VSERVO_LONG").is_some() { 300 } else { 60 };
    let daemon = Daemon::start("clients-killed", &[]);
    let (mut random, mut longest) = (0x2545_f491_4f6c_dd1d_u64, SpanNs::ZERO);
    for i in 0..clients {
        random ^= random << 13;
        random ^= random >> 7;
        random ^= random << 17;
        let mut doomed = client(&daemon, ["status", "start", "hold"][i % 3], "5");
        std::thread::sleep(Duration::from_micros(random % 20_000));
        kill(doomed.id() as i32, ["INT", "TERM", "KILL"][(random >> 32) as usize % 3]);
        doomed.wait().unwrap();
        let began = now();
        daemon.accepts("stop");
        longest = longest.max(now() - began);
    }
    println!("{clients} clients killed, slowest stop {:.3} s", longest.as_s());
    wait_until("somebody to be answered", || daemon.ctl("status").0 == Some(0));
    kill(daemon.process.id() as i32, "TERM");
    let (code, printed) = daemon.ended();
    assert_eq!(code, Some(0), "{printed}");
    assert!(printed.contains("a stop was requested"), "{printed}");
}

#[test]
fn clients_that_hang_and_hold_every_slot_keep_no_stop_out() {
    let daemon = Daemon::start("clients-hang", &["--clock", "lockstep"]);
    daemon.accepts("start");
    daemon.wait_for("servoing");
    // Control does not answer meanwhile, so that each client that has joined stays.
    let control = wait_for_process(&daemon.instance, "control");
    let nodes = daemon.instance.directory().join("nodes");
    let joined = || {
        std::fs::read_dir(&nodes)
            .map_or(0, |dir| dir.flatten().filter(|e| e.file_type().is_ok_and(|t| t.is_dir())).count())
    };
    let before = joined();
    kill(control, "STOP");
    let mut crowd: Vec<_> = (0..CROWD).map(|_| client(&daemon, "status", "60")).collect();
    // Eight ports; those for whom there is none try again, and are nodes now and then.
    wait_until("all slots to be taken", || joined() >= before + 8);
    std::thread::sleep(Duration::from_millis(100));
    crowd.iter().for_each(|c| kill(c.id() as i32, "STOP"));
    kill(control, "CONT");
    let (code, answer, told) = daemon.ctl("stop");
    assert_eq!(code, Some(0), "{answer} {told}");
    assert!(["stopping", "idle"].contains(&answer["state"].as_str().unwrap()), "{answer}");
    let output = vservo()
        .args(["ctl", "status", "--timeout-s", "0.5", "--instance", &daemon.instance.name])
        .output()
        .unwrap();
    let told = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(5), "{told}");
    assert!(told.contains("as many programs") && told.contains("ctl stop"), "{told}");
    for client in &mut crowd {
        kill(client.id() as i32, "KILL");
        client.wait().unwrap();
    }
    wait_until("the slots of the dead to be free", || daemon.ctl("status").0 == Some(0));
    assert_eq!(daemon.state(), "idle");
    daemon.accepts("shutdown");
    assert_eq!(daemon.ended().0, Some(0));
}

/// A client that is stopped cannot leave: its files go with the run, whether it is killed afterwards or goes on.
#[test]
fn stopped_clients_leave_nothing_behind_a_run() {
    for signal in ["KILL", "CONT"] {
        let daemon = Daemon::start("clients-left", &["--clock", "lockstep"]);
        let control = wait_for_process(&daemon.instance, "control");
        kill(control, "STOP");
        let nodes = daemon.instance.directory().join("nodes");
        let joined = || std::fs::read_dir(&nodes).map_or(0, Iterator::count);
        let before = joined();
        let mut asks = client(&daemon, "status", "60");
        wait_until("the client to have joined", || joined() > before);
        std::thread::sleep(Duration::from_millis(100));
        kill(asks.id() as i32, "STOP");
        kill(control, "CONT");
        daemon.accepts("shutdown");
        let began = now();
        let Daemon { instance, mut process } = daemon;
        assert_eq!(process.wait().unwrap().code(), Some(0));
        assert!(now() - began < SpanNs(2_000_000_000), "bounded");
        let left = instance.leftovers();
        assert!(left.is_empty(), "{left:?}");
        kill(asks.id() as i32, signal);
        let began = now();
        asks.wait().unwrap();
        assert!(now() - began < SpanNs(5_000_000_000), "one that goes on hears that nobody is there");
    }
}

#[test]
fn as_many_clients_as_come_at_once_are_answered() {
    let daemon = Daemon::start("clients-many", &[]);
    let mut crowd: Vec<_> = (0..40).map(|_| client(&daemon, "status", "60")).collect();
    daemon.accepts("stop");
    let codes: Vec<_> = crowd.iter_mut().map(|c| c.wait().unwrap().code()).collect();
    assert!(codes.iter().all(|code| *code == Some(0)), "{codes:?}");
    daemon.accepts("shutdown");
    assert_eq!(daemon.ended().0, Some(0));
}

/// Shell lines in a mount namespace with shared memory of its own; what they said, `None` where that is not possible.
fn with_own_shared_memory(size: &str, lines: &str) -> Option<String> {
    let mount = format!("mount -t tmpfs -o mode=1777,size={size} tmpfs /dev/shm || exit 77\n{lines}");
    let output = Command::new("unshare").args(["-m", "sh", "-c", &mount]).output().ok()?;
    let text = String::from_utf8_lossy(&[output.stdout, output.stderr].concat()).into_owned();
    if output.status.code() == Some(77) || text.contains("unshare failed") {
        println!("skipped: needs root, and unshare and mount");
        return None;
    }
    Some(text)
}

#[test]
fn full_shared_memory_does_not_prevent_a_stop() {
    let instance = Instance::new("clients-full");
    let (vservo, name) = (env!("CARGO_BIN_EXE_vservo"), &instance.name);
    let lines = format!(
        "ctl() {{ {vservo} ctl $1 --instance {name}; }}
         until_it_is() {{ i=0; until ctl status 2>/dev/null | grep -q $1; do i=$((i+1)); [ $i -gt 600 ] && exit 1; sleep 0.05; done; }}
         {vservo} serve --instance {name} --set scene.motion.kind=pendulum 2>&1 &
         daemon=$!
         until_it_is idle
         ctl start
         until_it_is servoing
         dd if=/dev/zero of=/dev/shm/filler bs=4k 2>/dev/null
         echo free: $(df --output=avail /dev/shm | tail -1)
         sleep 1
         ctl stop; echo stop: $?
         ctl shutdown; echo shutdown: $?
         wait $daemon; echo serve: $?
         rm /dev/shm/filler; ls /dev/shm"
    );
    let Some(text) = with_own_shared_memory("64m", &lines) else { return };
    assert!(text.contains("free: 0"), "{text}");
    for done in ["stop: 0", "shutdown: 0", "serve: 0"] {
        assert!(text.contains(done), "{done} in\n{text}");
    }
    assert!(!text.contains("signal") && !text.ends_with(&format!("vservo-{name}\n")), "{text}");
}

/// Wherever the filling falls, nobody dies of it without a word: either the run is refused, or it goes on.
#[test]
fn shared_memory_that_fills_up_while_a_run_starts_is_named() {
    for ms in [0, 20, 50, 100, 200] {
        let instance = Instance::new("clients-fills");
        let (vservo, name) = (env!("CARGO_BIN_EXE_vservo"), &instance.name);
        let lines = format!(
            "{vservo} run --instance {name} 2>&1 & daemon=$!
             sleep {}
             dd if=/dev/zero of=/dev/shm/filler bs=4k 2>/dev/null
             wait $daemon; echo run: $?",
            f64::from(ms) / 1e3
        );
        let Some(text) = with_own_shared_memory("64m", &lines) else { return };
        // Where the last page goes in the very milliseconds in which control makes its segments it ends before its first tick, which is told: no arm has moved.
        let control_died =
            text.contains("control process ended") && text.contains("signal") && !text.contains(", 0 ticks,");
        assert!(!control_died, "{ms} ms: {text}");
        assert!(text.contains("run: 0") || text.contains("/dev/shm"), "{ms} ms: {text}");
    }
}

#[test]
fn a_daemon_waiting_for_its_drive_answers_and_stops() {
    for how in ["shutdown", "stop"] {
        let served = how == "shutdown";
        let instance = Instance::new("clients-drive");
        let run = vservo()
            .args([if served { "serve" } else { "run" }, "--instance", &instance.name])
            .args(["--set", "drive.kind=external", "--set", "realtime.policy=off"])
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let ctl = |what: &str| vservo().args(["ctl", what, "--instance", &instance.name]).output().unwrap();
        wait_until("an answer", || ctl("status").status.code() == Some(0));
        let refused = ctl("start");
        assert_eq!(refused.status.code(), Some(5));
        let told = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert!(told.contains("still starting"), "{told}");
        if served {
            assert_eq!(ctl("stop").status.code(), Some(0));
            assert_eq!(ctl("status").status.code(), Some(0), "a stop does not end a daemon");
        }
        assert_eq!(ctl(how).status.code(), Some(0));
        let output = run.wait_with_output().unwrap();
        let printed = String::from_utf8_lossy(&output.stdout);
        // A run that was stopped has not reached its goal; a daemon has none to reach.
        assert_eq!(output.status.code(), Some(if served { 0 } else { 6 }), "{printed}");
        assert!(printed.contains("stopped"), "{printed}");
        instance.assert_gone();
    }
}

#[test]
fn the_daemon_of_another_user_is_told_from_none() {
    let instance = Instance::new("clients-other");
    let place = instance.directory();
    std::fs::create_dir(&place).unwrap();
    if std::os::unix::fs::chown(&place, Some(65534), None).is_err() {
        println!("skipped: needs root");
    } else {
        for what in ["status", "stop"] {
            let output = vservo().args(["ctl", what, "--instance", &instance.name]).output().unwrap();
            let told = String::from_utf8_lossy(&output.stderr);
            assert_eq!(output.status.code(), Some(5), "{told}");
            assert!(told.contains("another user's run") && told.contains("65534"), "{told}");
            assert!(!told.contains("start one"), "{told}");
        }
    }
    std::fs::remove_dir(&place).unwrap();
}

/// A process that makes a segment and is kept from its processor before the segment has a size, as on a machine with much to do, is not
/// taken for one that was killed there: nobody removes what it makes.
#[test]
fn a_slow_maker_of_segments_is_not_taken_for_a_dead_one() {
    let delayed =
        ["-f", "-o", "/dev/null", "-e", "trace=ftruncate", "-e", "inject=ftruncate:delay_enter=150000"];
    if !Command::new("strace").args(delayed).arg("true").status().is_ok_and(|s| s.success()) {
        return println!("skipped: no strace, or tracing is not allowed");
    }
    let instance = Instance::new("slow-maker");
    let mut process = Command::new("strace")
        .args(delayed)
        .arg(env!("CARGO_BIN_EXE_vservo"))
        .args(["serve", "--instance", &instance.name])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let ctl = |what: &str| {
        let mut ctl = vservo();
        ctl.args(["ctl", what, "--instance", &instance.name]).stdout(Stdio::null()).stderr(Stdio::null());
        ctl.status().unwrap().success()
    };
    wait_until("the slow daemon to answer", || {
        assert!(process.try_wait().unwrap().is_none(), "it ended by itself");
        ctl("status")
    });
    assert!(ctl("shutdown"));
    wait_until("the end of the slow daemon", || process.try_wait().unwrap().is_some_and(|end| end.success()));
}
