//! What the integration tests share: runs of the real program under names of their own, and waiting for conditions.

#![allow(dead_code, unreachable_pub, non_snake_case)] // each test binary uses a part
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // helpers of tests are tests

use nalgebra::SVector;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;
use vservo::config::Config;
use vservo::messages::Measurement;
use vservo::robot::Robot;
use vservo::sim::perfect_measurement;
use vservo::time::MonoNs;

/// Waits are for conditions; this only bounds a test that has already failed.
const PATIENCE: Duration = Duration::from_secs(120);
/// As many characters has the name of an instance at most.
const LONGEST_INSTANCE: usize = 18;

/// The program.
pub fn vservo() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_vservo"));
    // No black box in the home of whoever runs the tests.
    command.stdin(Stdio::null()).env("VSERVO_BLACK_BOX", "off");
    command
}

/// An instance of its own for one run; checks at the end that nothing is left of it.
pub struct Instance {
    pub name: String,
}

impl Instance {
    pub fn new(test: &str) -> Self {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let count = COUNT.fetch_add(1, Ordering::Relaxed);
        let number = format!("-{}-{count}", std::process::id());
        let room = LONGEST_INSTANCE.saturating_sub(number.len());
        Self { name: format!("{}{number}", test.get(..room).unwrap_or(test)) }
    }

    /// Its directory in shared memory.
    pub fn directory(&self) -> PathBuf {
        format!("/dev/shm/vservo-{}", self.name).into()
    }

    /// What lies in shared memory under this name.
    pub fn leftovers(&self) -> Vec<PathBuf> {
        let directory = format!("vservo-{}", self.name);
        let prefix = format!("vservo.{}.", self.name);
        std::fs::read_dir("/dev/shm")
            .unwrap()
            .flatten()
            .filter(|e| {
                let name = e.file_name().to_string_lossy().into_owned();
                name == directory || name.starts_with(&prefix)
            })
            .map(|e| e.path())
            .collect()
    }

    /// Processes that were started under this name.
    pub fn processes(&self) -> Vec<i32> {
        processes_with(&self.name)
    }

    /// Asserts that neither process nor file is left, giving those that are about to end the time to do so.
    pub fn assert_gone(&self) {
        wait_until("all processes of the instance to end", || self.processes().is_empty());
        wait_until("shared memory to be clean", || self.leftovers().is_empty());
    }
}

impl Drop for Instance {
    fn drop(&mut self) {
        for pid in self.processes() {
            kill(pid, "KILL");
        }
    }
}

fn processes_with(argument: &str) -> Vec<i32> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir("/proc").unwrap().flatten() {
        let Ok(pid) = entry.file_name().to_string_lossy().parse::<i32>() else { continue };
        let Ok(line) = std::fs::read(entry.path().join("cmdline")) else { continue };
        if line.split(|b| *b == 0).any(|a| a == argument.as_bytes()) {
            found.push(pid);
        }
    }
    found
}

/// The process of `role` in an instance, as soon as it runs.
pub fn wait_for_process(instance: &Instance, role: &str) -> i32 {
    let mut found = None;
    wait_until(&format!("the {role} process"), || {
        found = instance.processes().into_iter().find(|pid| {
            std::fs::read(format!("/proc/{pid}/cmdline"))
                .is_ok_and(|line| line.split(|b| *b == 0).nth(1) == Some(role.as_bytes()))
        });
        found.is_some()
    });
    found.unwrap()
}

/// Waits for `condition`.
pub fn wait_until(what: &str, mut condition: impl FnMut() -> bool) {
    let mut waited = Duration::ZERO;
    let step = Duration::from_millis(10);
    while !condition() {
        assert!(waited < PATIENCE, "waited in vain for {what}");
        std::thread::sleep(step);
        waited += step;
    }
}

/// Waits for a line on stderr that contains `text`; stderr is drained to the end of the process.
pub fn wait_for_line(child: &mut Child, text: &str) {
    use std::io::{BufRead, BufReader};
    let mut lines = BufReader::new(child.stderr.take().expect("stderr is piped")).lines();
    let found = lines.by_ref().map_while(Result::ok).any(|line| line.contains(text));
    assert!(found, "the process ended without saying `{text}`");
    std::thread::Builder::new().name("drain".into()).spawn(move || lines.for_each(drop)).unwrap();
}

/// What a child says on stderr, line by line.
pub struct Lines(Box<dyn Iterator<Item = String> + Send>);

impl Lines {
    pub fn of(child: &mut Child) -> Self {
        use std::io::{BufRead, BufReader};
        let lines = BufReader::new(child.stderr.take().expect("stderr is piped")).lines();
        Self(Box::new(lines.map_while(Result::ok)))
    }

    /// The next line that contains `text`.
    pub fn wait_for(&mut self, text: &str) -> String {
        let mut said = Vec::new();
        for line in self.0.by_ref() {
            if line.contains(text) {
                return line;
            }
            said.push(line);
        }
        panic!("the process ended without saying `{text}`, but {said:#?}")
    }

    /// Takes the rest, to the end of the process.
    pub fn drain(self) {
        std::thread::Builder::new().name("drain".into()).spawn(move || self.0.for_each(drop)).unwrap();
    }
}

/// Sends a signal by name.
pub fn kill(pid: i32, signal: &str) {
    let _ =
        Command::new("kill").args([&format!("-{signal}"), &pid.to_string()]).stderr(Stdio::null()).status();
}

/// Keeps every core busy while it lives.
pub struct BusyCores {
    stop: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl BusyCores {
    pub fn start() -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let cores = std::thread::available_parallelism().map_or(2, usize::from);
        let busy = |_| {
            let stop = Arc::clone(&stop);
            let spin = move || while !stop.load(Ordering::Relaxed) {};
            std::thread::Builder::new().name("busy".into()).spawn(spin).unwrap()
        };
        Self { threads: (0..cores).map(busy).collect(), stop }
    }
}

impl Drop for BusyCores {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        self.threads.drain(..).for_each(|t| drop(t.join()));
    }
}

/// A finished run: its summary and what it printed.
pub struct Run {
    pub summary: Value,
    pub output: Output,
}

impl Run {
    pub fn text(&self) -> String {
        let o = &self.output;
        format!("{}{}", String::from_utf8_lossy(&o.stdout), String::from_utf8_lossy(&o.stderr))
    }
}

/// Repetitions of a run in real time that the machine held up.
const REPEATS: usize = 3;
/// A loop that slept longer than this was held up by the machine, us: the plant obeys the last torque for as long, and a fault is then the
/// right end of an arm in full motion (a virtual machine that stood still for 62 ms in CI ended a run so).
const HELD_UP_US: f64 = 20_000.0;

/// Whether a run in real time came to no good end while the machine held its loop up: it tells nothing about what a test asks.
pub fn was_held_up(summary: &Value) -> bool {
    let longest = summary["tick_us"]["wake"]["max"].as_f64();
    summary["outcome"] != "converged" && longest.is_some_and(|wake| wake > HELD_UP_US)
}

/// `vservo run ARGUMENTS` under a name of its own, to its end; again where the machine held it up.
pub fn run(test: &str, arguments: &[&str]) -> Run {
    let mut last = run_once(test, arguments);
    for _ in 1..REPEATS {
        if !was_held_up(&last.summary) {
            break;
        }
        last = run_once(test, arguments);
    }
    last
}

/// `vservo run ARGUMENTS` under a name of its own, to its end, whatever the machine did.
pub fn run_once(test: &str, arguments: &[&str]) -> Run {
    let instance = Instance::new(test);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("summary.json");
    let output = vservo()
        .arg("run")
        .args(arguments)
        .args(["--instance", &instance.name, "--summary"])
        .arg(&path)
        .output()
        .unwrap();
    instance.assert_gone();
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!text.contains("panicked"), "{text}");
    let summary = read_summary(&path);
    Run { summary, output }
}

pub fn read_summary(path: &Path) -> Value {
    let text = std::fs::read_to_string(path).unwrap_or_default();
    serde_json::from_str(&text).unwrap_or(Value::Null)
}

/// A number of a summary by its path.
pub fn number(summary: &Value, path: &[&str]) -> f64 {
    let value = path.iter().fold(summary, |v, key| &v[*key]);
    value.as_f64().unwrap_or_else(|| panic!("{path:?} is {value} in {summary}"))
}

/// Asserts that a realtime run counted its ticks honestly: each has an entry, and those that came late are the missed ones.
pub fn assert_deadlines_are_honest(summary: &Value) {
    let count = |key| summary[key].as_u64().unwrap_or_else(|| panic!("{key} in {summary}"));
    let (ticks, skipped, missed) = (count("ticks"), count("skipped_ticks"), count("missed_deadlines"));
    let buckets = summary["tick_us"]["total_histogram"].as_array().expect("a histogram");
    let entries = |above: f64| -> u64 {
        let above = |b: &&Value| b[0].as_f64().unwrap() > above;
        buckets.iter().filter(above).map(|b| b[1].as_u64().unwrap()).sum()
    };
    assert_eq!(entries(0.0), ticks + skipped, "an entry for every tick: {summary}");
    assert_eq!(entries(1000.0), missed, "late entries are missed deadlines: {summary}");
    assert!(skipped <= missed, "{summary}");
    let milliseconds = (number(summary, &["duration_s"]) * 1e3).round();
    assert_eq!((ticks + skipped) as f64, milliseconds, "a tick every millisecond: {summary}");
}

/// Asserts the accuracy that a converged run owes: 0.5 mm, 0.1 degree, 0.1 px.
pub fn assert_accurate(run: &Run) {
    let s = &run.summary;
    assert_eq!(s["outcome"], "converged", "{}", run.text());
    assert!(number(s, &["final", "position_error_m"]) <= 0.5e-3, "{s}");
    assert!(number(s, &["final", "orientation_error_rad"]).to_degrees() <= 0.1, "{s}");
    assert!(number(s, &["final", "feature_error_px"]) <= 0.1, "{s}");
    assert_eq!(run.output.status.code(), Some(0));
}

/// What a perfect camera that looks everywhere measures at `k` ms from an arm in `q`.
pub fn seen<const N: usize>(config: &Config, robot: &Robot<N>, q: &SVector<f64, N>, k: i64) -> Measurement {
    let X_CO = config.camera.mount.X_WC(robot, q).inv_mul(&config.X_WO().unwrap());
    let points_O: Vec<_> = config.target.points().iter().map(|point| point.p_O).collect();
    perfect_measurement(&points_O, &X_CO, MonoNs(k * 1_000_000)).unwrap()
}
