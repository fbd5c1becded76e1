//! A realtime run of the whole program, idle and with every core busy: deadlines, times of the tick, CPU of each process, and
//! whether anything was done that nothing called for.
//!
//! `cargo bench --bench realtime -- [--seconds S]`, 60 by default. The load is stress-ng where it is installed, else busy
//! threads. The goal cannot be reached, so that the run takes its full time. Exit code 1 for a wrong reaction: a fault, a
//! hold, an end before the time, or deadlines that are not what the histogram shows.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout, missing_docs)]

use std::process::{Child, Command, ExitCode, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use vservo::control::outcome::Outcome;
use vservo::report::summary::{Summary, spin_text};

/// Largest share of a core, %; that of control beside its spin.
const GOALS: [(&str, f64); 2] = [("control", 5.0), ("vision", 2.0)];

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().collect();
    let seconds =
        arguments.iter().position(|a| a == "--seconds").and_then(|i| arguments.get(i + 1)?.parse().ok());
    let seconds: f64 = seconds.unwrap_or(60.0);
    let mut wrong = Vec::new();
    for busy in [false, true] {
        let load = busy.then(Load::start);
        println!("{}", load.as_ref().map_or("idle", Load::name));
        let summary = run(seconds);
        drop(load);
        print(&summary);
        wrong.extend(wrong_reactions(&summary));
    }
    for reaction in &wrong {
        println!("wrong: {reaction}");
    }
    if wrong.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

fn run(seconds: f64) -> Summary {
    let folder = tempfile::tempdir().expect("a place for the summary");
    let path = folder.path().join("summary.json");
    let status = Command::new(env!("CARGO_BIN_EXE_vservo"))
        .args(["run", "--instance", &format!("bench-{}", std::process::id())])
        .args(["--duration-s", &seconds.to_string(), "--set", "goal.feature_error_px=1e-6", "--summary"])
        .arg(&path)
        .env("VSERVO_LOG", "error")
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status()
        .expect("vservo starts");
    let text = std::fs::read_to_string(path).unwrap_or_default();
    serde_json::from_str(&text).unwrap_or_else(|e| panic!("no summary ({status}): {e}"))
}

fn print(s: &Summary) {
    let ticks = s.ticks + s.skipped_ticks;
    let share = s.missed_deadlines as f64 / ticks.max(1) as f64 * 100.0;
    println!(
        "  ticks      {ticks}, {} missed ({share:.3} %), {} of them skipped",
        s.missed_deadlines, s.skipped_ticks
    );
    let equal = if s.tick_us.late_ticks() == s.missed_deadlines { "equal" } else { "NOT EQUAL" };
    println!("  histogram  {} entries, {} at 1000 us or above: {equal}", entries(s), s.tick_us.late_ticks());
    for (name, q) in [("wake", &s.tick_us.wake), ("step", &s.tick_us.step), ("total", &s.tick_us.total)] {
        println!(
            "  {name:<9}  p50 {:8.1}  p99 {:8.1}  p99.9 {:8.1}  max {:8.1} us",
            q.p50, q.p99, q.p999, q.max
        );
    }
    for (role, used) in &s.processes {
        let goal = GOALS.iter().find(|(name, _)| name == role);
        let goal = goal.map_or(String::new(), |(_, percent)| format!(", goal {percent:.0} %"));
        let spin_share = s.realtime.as_ref().filter(|_| role == "control").map_or(0.0, |r| r.spin_share);
        let spin = if spin_share > 0.0 {
            format!(" beside {:.2} % of spinning", spin_share * 100.0)
        } else {
            String::new()
        };
        println!(
            "  {role:<9}  {:.2} % of a core{spin}{goal}, {:.1} MB",
            (used.cpu_share - spin_share) * 100.0,
            used.max_resident_mb
        );
    }
    if let Some(realtime) = &s.realtime {
        let spin = spin_text(realtime.spin_us, realtime.spin_share);
        println!("  real time  {}{spin}, {} page faults", realtime.scheduling, realtime.page_faults);
    }
    println!("  frames     {}, {} dropped, target lost {} times", s.frames, s.frames_dropped, s.target_lost);
    let final_px = s.final_errors.feature_error_px.map_or("unknown".into(), |e| format!("{e:.4} px"));
    println!("  outcome    {} ({}), final error {final_px}", s.outcome.as_str(), s.reason);
    for event in &s.safety.events {
        println!("  event      {:.3} s: {}", event.time_s, event.event);
    }
}

fn entries(s: &Summary) -> u64 {
    s.tick_us.total_histogram.iter().map(|(_, count)| count).sum()
}

fn wrong_reactions(s: &Summary) -> Vec<String> {
    let mut wrong = Vec::new();
    if s.outcome != Outcome::NotConverged {
        wrong.push(format!("the run ended as {}: {}", s.outcome.as_str(), s.reason));
    }
    // Nothing in this run calls for a reaction: the target lies still in full view, no limit is near for long.
    wrong.extend(s.safety.events.iter().map(|e| format!("{:.3} s: {}", e.time_s, e.event)));
    if s.tick_us.late_ticks() != s.missed_deadlines || entries(s) != s.ticks + s.skipped_ticks {
        wrong.push("the histogram shows other deadlines than were counted".into());
    }
    wrong
}

/// Keeps all cores busy while it lives.
enum Load {
    StressNg(Child),
    Threads(Arc<AtomicBool>),
}

impl Load {
    fn start() -> Self {
        let stress = Command::new("stress-ng")
            .args(["--cpu", "0", "--vm", "1", "--vm-bytes", "64M", "--timeout", "7200"])
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn();
        if let Ok(child) = stress {
            return Self::StressNg(child);
        }
        let stop = Arc::new(AtomicBool::new(false));
        for _ in 0..std::thread::available_parallelism().map_or(2, usize::from) {
            let stop = Arc::clone(&stop);
            let spin = move || while !stop.load(Ordering::Relaxed) {};
            std::thread::Builder::new().name("busy".into()).spawn(spin).expect("a thread starts");
        }
        Self::Threads(stop)
    }

    fn name(&self) -> &'static str {
        match self {
            Self::StressNg(_) => "under load: stress-ng --cpu 0 --vm 1",
            Self::Threads(_) => {
                "under load: a busy thread for each core (no stress-ng: Debian package stress-ng)"
            }
        }
    }
}

impl Drop for Load {
    fn drop(&mut self) {
        match self {
            Self::StressNg(child) => {
                let _ = Command::new("kill").arg(child.id().to_string()).status();
                let _ = child.wait();
            }
            Self::Threads(stop) => stop.store(true, Ordering::Relaxed),
        }
    }
}
