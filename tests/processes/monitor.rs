//! `vservo monitor` in a pseudo-terminal: what it shows of a run, what its keys do, and how it leaves the terminal.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)] // helpers of tests are tests

use crate::common::{kill, run, vservo, wait_until};
use crate::serve::Daemon;
use rustix::fs::{Mode, OFlags, open};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{Termios, Winsize, tcgetattr, tcsetwinsize};
use std::io::{Read, Write};
use std::os::fd::{AsFd, OwnedFd};
use std::process::{Child, Command, ExitStatus};
use std::sync::{Arc, Mutex};

/// Sequences with which a terminal is taken and given back.
const ENTER: &str = "\x1b[?1049h";
const LEAVE: &str = "\x1b[?1049l";

/// A terminal of 80 columns and 24 rows, and a program in it.
struct PseudoTerminal {
    master: std::fs::File,
    slave: OwnedFd,
    before: Termios,
    output: Arc<Mutex<Vec<u8>>>,
    child: Child,
}

impl PseudoTerminal {
    fn run(mut command: Command) -> Self {
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
        grantpt(&master).unwrap();
        unlockpt(&master).unwrap();
        let name = ptsname(&master, Vec::new()).unwrap();
        let slave = open(name, OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC, Mode::empty()).unwrap();
        tcsetwinsize(&slave, Winsize { ws_col: 80, ws_row: 24, ws_xpixel: 0, ws_ypixel: 0 }).unwrap();
        let before = tcgetattr(&slave).unwrap();
        let end = || slave.as_fd().try_clone_to_owned().unwrap();
        let child = command.stdin(end()).stdout(end()).stderr(end()).env("TERM", "xterm").spawn().unwrap();
        drop(command);
        let master = std::fs::File::from(master);
        let output = Arc::new(Mutex::new(Vec::new()));
        let (mut reader, sink) = (master.try_clone().unwrap(), Arc::clone(&output));
        let read = move || {
            let mut bytes = [0; 4096];
            while let Ok(count @ 1..) = reader.read(&mut bytes) {
                sink.lock().unwrap().extend_from_slice(&bytes[..count]);
            }
        };
        std::thread::Builder::new().name("terminal".into()).spawn(read).unwrap();
        Self { master, slave, before, output, child }
    }

    fn monitor(daemon: &Daemon) -> Self {
        let mut command = vservo();
        command.args(["monitor", "--instance", &daemon.instance.name]);
        Self::run(command)
    }

    fn text(&self) -> String {
        String::from_utf8_lossy(&self.output.lock().unwrap()).into_owned()
    }

    /// What stands on the terminal: it obeys places, and skips looks and modes.
    fn screen(&self) -> Vec<String> {
        let mut cells = vec![vec![' '; 80]; 24];
        let (mut row, mut column) = (0_usize, 0_usize);
        let text = self.text();
        let mut rest = text.chars();
        while let Some(symbol) = rest.next() {
            if symbol != '\x1b' {
                if let Some(cell) = cells.get_mut(row).and_then(|cells| cells.get_mut(column)) {
                    *cell = symbol;
                }
                column += 1;
                continue;
            }
            assert_eq!(rest.next(), Some('['));
            let mut parameters = String::new();
            let Some(end) = rest.by_ref().find(|c| {
                let ends = c.is_ascii_alphabetic();
                if !ends {
                    parameters.push(*c);
                }
                ends
            }) else {
                break; // the rest has not come yet
            };
            match end {
                'H' => {
                    let mut numbers = parameters.split(';').map(|n| n.parse::<usize>().unwrap() - 1);
                    (row, column) = (numbers.next().unwrap(), numbers.next().unwrap());
                }
                'J' => cells.iter_mut().for_each(|row| row.fill(' ')),
                'm' | 'h' | 'l' => {}
                other => panic!("a sequence that this terminal does not know: {parameters}{other}"),
            }
        }
        cells.iter().map(|row| row.iter().collect::<String>().trim_end().to_owned()).collect()
    }

    #[track_caller]
    fn wait_for(&self, what: &str) {
        let mut last = Vec::new();
        let seen = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
            wait_until(what, || {
                last = self.screen();
                last.iter().any(|line| line.contains(what))
            });
        }));
        assert!(seen.is_ok(), "`{what}` is not on the screen:\n{}", last.join("\n"));
    }

    fn press(&mut self, keys: &str) {
        self.master.write_all(keys.as_bytes()).unwrap();
    }

    /// Waits for its end, and checks that the terminal is as it was.
    #[track_caller]
    fn ended(mut self) -> (ExitStatus, String) {
        let status = self.child.wait().unwrap();
        wait_until("the terminal to be given back", || self.text().contains(LEAVE));
        let now = tcgetattr(&self.slave).unwrap();
        let modes = |t: &Termios| (t.input_modes, t.output_modes, t.control_modes, t.local_modes);
        assert_eq!(modes(&now), modes(&self.before));
        let text = self.text();
        assert!(text.contains("\x1b[?25h"), "the cursor is back");
        (status, text)
    }
}

/// Numbers of the first row that begins like `title`.
fn numbers(screen: &[String], title: &str) -> Vec<f64> {
    let line = screen.iter().find(|line| line.starts_with(title)).unwrap_or_else(|| panic!("{screen:#?}"));
    line.split_whitespace().filter_map(|word| word.parse().ok()).collect()
}

#[test]
fn a_run_is_watched_and_told_what_to_do() {
    let daemon = Daemon::start("monitor", &["--set", "servo.gain_1_s=0.5"]);
    let mut monitor = PseudoTerminal::monitor(&daemon);
    monitor.wait_for("IDLE  waits for a start: s");
    monitor.wait_for("+ seen o goal  1:");
    let place = |monitor: &PseudoTerminal| {
        let screen = monitor.screen();
        let line = screen.iter().find(|line| line.starts_with("+ seen")).unwrap().clone();
        let at = line.split("goal  1: ").nth(1).unwrap_or_else(|| panic!("{screen:#?}")).to_owned();
        let mut words = at.split_whitespace().map(|word| word.parse::<f64>().unwrap());
        [words.next().unwrap(), words.next().unwrap()]
    };
    let before = place(&monitor);
    // What is shown is what another reader of the same run is told.
    let told = daemon.ctl("status").1;
    let error_px = told["feature_error_px"].as_f64().unwrap();
    wait_until("the feature error that others are told", || {
        let shown = numbers(&monitor.screen(), "feature error");
        shown.first().is_some_and(|shown| (shown - error_px).abs() < 1.0)
    });
    // A screen may be read while it is drawn.
    for i in 1..=told["q_rad_or_m"].as_array().unwrap().len() {
        monitor.wait_for(&format!("joint_{i}"));
    }
    wait_until("four goals, of which two may share a cell", || {
        let view = &monitor.screen()[4..16];
        view.iter().map(|line| line.chars().take(31).filter(|c| *c == 'o').count()).sum::<usize>() >= 3
    });

    monitor.press("s");
    monitor.wait_for("SERVOING");
    monitor.wait_for("start: accepted");
    wait_until("the features to move", || {
        let now = place(&monitor);
        (now[0] - before[0]).hypot(now[1] - before[1]) > 5.0
    });
    assert_eq!(daemon.state(), "servoing");
    monitor.press("h");
    monitor.wait_for("HELD");
    assert_eq!(daemon.state(), "held");
    monitor.press("s");
    monitor.wait_for("SERVOING");
    // A stop asks, and anything but yes is no.
    monitor.press("x");
    monitor.wait_for("Stop the arm? y: yes");
    monitor.press("n");
    monitor.wait_for("s start  h hold");
    assert_eq!(daemon.state(), "servoing");
    monitor.press("xy");
    monitor.wait_for("IDLE");
    assert_eq!(daemon.state(), "idle");
    monitor.press("h");
    monitor.wait_for("hold was refused: nothing was started");
    monitor.press("t");
    monitor.wait_for("HELD");
    monitor.wait_for("taught");
    monitor.wait_for("   goal 1");
    monitor.press("q");
    let (status, text) = monitor.ended();
    assert!(status.success() && text.starts_with(ENTER), "{status}");
    assert_eq!(daemon.state(), "held", "the run goes on");
    daemon.accepts("shutdown");
    let (code, printed) = daemon.ended();
    assert_eq!(code, Some(0), "{printed}");
}

/// Ctrl-C as a key, signals, and a hang-up: the terminal comes back, and the run knows nothing of it.
#[test]
fn every_end_of_a_monitor_gives_the_terminal_back() {
    let daemon = Daemon::start("monitor-ends", &["--clock", "lockstep"]);
    for how in ["\x03", "TERM", "INT", "HUP"] {
        let mut monitor = PseudoTerminal::monitor(&daemon);
        monitor.wait_for("IDLE");
        if how == "\x03" {
            monitor.press(how);
        } else {
            kill(monitor.child.id() as i32, how);
        }
        assert!(monitor.ended().0.success(), "{how}");
    }
    // One that stays is told of the end of the run, and leaves nothing behind.
    let mut monitor = PseudoTerminal::monitor(&daemon);
    monitor.wait_for("IDLE");
    daemon.accepts("shutdown");
    monitor.wait_for("the run has ended");
    monitor.press("q");
    assert!(monitor.ended().0.success());
    assert_eq!(daemon.ended().0, Some(0));
}

/// Watchers that hang or are killed change nothing of a run in simulated time, and a recorder finds its place beside as many as may watch.
#[test]
fn watchers_that_hang_or_die_disturb_no_run() {
    let plain = run("monitor-none", &["--clock", "lockstep", "--set", "goal.hold_s=2"]);
    let daemon = Daemon::start("monitor-hang", &["--clock", "lockstep"]);
    let dead = PseudoTerminal::monitor(&daemon);
    dead.wait_for("IDLE");
    kill(dead.child.id() as i32, "KILL");
    let mut dead = dead;
    dead.child.wait().unwrap();
    let hanging = PseudoTerminal::monitor(&daemon);
    hanging.wait_for("IDLE");
    kill(hanging.child.id() as i32, "STOP");
    // The place of the dead one is free again, and the last place is not for watchers.
    let second = PseudoTerminal::monitor(&daemon);
    second.wait_for("IDLE");
    let mut third = vservo();
    third.args(["monitor", "--instance", &daemon.instance.name]);
    let output = third.output().unwrap();
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(5), "{told}");
    assert!(told.contains("as many programs as can") && told.contains("left to a recorder"), "{told}");
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    let mut recorder = vservo()
        .args(["record", "--instance", &daemon.instance.name, "--out"])
        .arg(&path)
        .stdout(std::process::Stdio::null())
        .spawn()
        .unwrap();
    wait_until("the recorder to listen", || path.metadata().is_ok_and(|file| file.len() > 0));
    daemon.accepts("start");
    wait_until("the goal to be reached", || daemon.ctl("status").1["at_goal"] == true);
    daemon.accepts("shutdown");
    assert!(recorder.wait().unwrap().success(), "a recorder found its place");
    kill(hanging.child.id() as i32, "CONT");
    for mut monitor in [hanging, second] {
        monitor.wait_for("the run has ended");
        monitor.press("q");
        assert!(monitor.ended().0.success());
    }
    assert_eq!(daemon.ended().0, Some(0));
    assert_eq!(plain.summary["outcome"], "converged");
}

#[test]
fn a_monitor_without_run_or_terminal_says_what_to_do() {
    let output = vservo().args(["monitor", "--instance", "nobody-here"]).output().unwrap();
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(5), "{told}");
    assert!(told.contains("no run of instance `nobody-here`") && told.contains("vservo serve"), "{told}");
    let daemon = Daemon::start("monitor-pipe", &["--clock", "lockstep"]);
    let output = vservo().args(["monitor", "--instance", &daemon.instance.name]).output().unwrap();
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{told}");
    assert!(told.contains("no terminal") && told.contains("vservo ctl status --json"), "{told}");
    daemon.accepts("shutdown");
    assert_eq!(daemon.ended().0, Some(0));
}

/// Run by the next test in a terminal of its own: a program that panics while it has the terminal.
#[test]
#[ignore = "a part of the next test"]
fn panics_in_its_terminal() {
    let terminal = vservo::rt::Terminal::take().expect("stdout is a terminal");
    assert!(terminal.write("shown"));
    panic!("planted");
}

#[test]
fn a_panic_gives_the_terminal_back_before_it_is_told() {
    let mut command = Command::new(std::env::current_exe().unwrap());
    command.args([
        "--ignored",
        "--exact",
        "--nocapture",
        "--test-threads=1",
        "monitor::panics_in_its_terminal",
    ]);
    let (status, text) = PseudoTerminal::run(command).ended();
    assert!(!status.success());
    let left = text.find(LEAVE).unwrap();
    assert!(text[..left].contains("shown") && text[left..].contains("planted"), "{text}");
    assert!(!text[..left].contains("planted"), "{text}");
}
