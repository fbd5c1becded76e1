//! Wake-up latency of our 1 kHz thread, sleeping and with its spin, beside cyclictest (Debian package rt-tests) with the same
//! priority and interval: slices in the order A B C C B A, so that all see the same machine; idle, and under load (stress-ng)
//! where that is installed.
//!
//! `cargo bench --bench jitter -- [SECONDS_PER_SLICE] [SLICES] [idle|load]`, 5 s and 8 slices of each by default, which takes
//! two minutes idle and as long under load; needs the right to SCHED_FIFO. Of each quantile the median slice is told, with the
//! interquartile range of the slices; a difference counts only beyond that.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, missing_docs)]

use std::process::{Child, Command, Stdio};
use vservo::cli::doctor::{Median, compare, measure_each, median_slice};
use vservo::config::RealtimeRequest;
use vservo::rt::{USUAL_SPIN, prepare_process};
use vservo::time::SpanNs;

const REQUEST: RealtimeRequest = RealtimeRequest { priority: 80, cpu: None, lock_memory: true };
const QUANTILES: [(&str, f64); 4] = [("p50", 0.5), ("p99", 0.99), ("p99.9", 0.999), ("max", 1.0)];
/// Longest lateness of which cyclictest keeps a count of its own, us.
const LONGEST_US: u32 = 20_000;
/// Fewer slices show nothing.
const FEWEST_SLICES: u32 = 8;
/// cyclictest counts whole microseconds, rounded down.
const RESOLUTION_US: f64 = 1.0;

#[derive(Debug, Clone, Copy)]
enum Program {
    Sleeping,
    Spinning,
    Cyclictest,
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let mut numbers = arguments.iter().filter_map(|a| a.parse::<u32>().ok());
    let seconds = numbers.next().unwrap_or(5).max(1);
    // A B C C B A: two slices of each in a round
    let slices = numbers.next().unwrap_or(FEWEST_SLICES).max(FEWEST_SLICES).next_multiple_of(2);
    let wanted = |word: &str, other: &str| {
        let told = |w: &str| arguments.iter().any(|a| a == w);
        told(word) || !told(other)
    };
    if let Some(Err(e)) = prepare_process(&REQUEST) {
        println!("memory is not locked: {e}");
    }
    if wanted("idle", "load") {
        report("idle", seconds, slices);
    }
    if wanted("load", "idle") {
        match stress() {
            Some(_load) => report("under load", seconds, slices),
            None => println!("under load: skipped: no stress-ng (Debian package stress-ng)"),
        }
    }
}

fn report(machine: &str, seconds: u32, slices: u32) {
    use Program::{Cyclictest, Sleeping, Spinning};
    let (mut sleeping, mut spinning, mut theirs) = (Vec::new(), Vec::new(), Vec::new());
    for _ in 0..slices / 2 {
        for program in [Sleeping, Spinning, Cyclictest, Cyclictest, Spinning, Sleeping] {
            match program {
                Sleeping => sleeping.push(ours(seconds, SpanNs::ZERO)),
                Spinning => spinning.push(ours(seconds, USUAL_SPIN)),
                Cyclictest => theirs.extend(cyclictest(seconds)),
            }
        }
    }
    println!("{machine}: {slices} slices of {seconds} s each; median slice (interquartile range), us");
    for (name, q) in QUANTILES {
        let peer = median_slice(&theirs, q);
        let line = |who: &str, slices: &[Vec<f64>]| {
            let Some(own) = median_slice(slices, q) else { return };
            let verdict = peer.map_or("skipped: no cyclictest (Debian package rt-tests)".into(), |peer| {
                // as cyclictest counts them
                let whole: Vec<Vec<f64>> =
                    slices.iter().map(|slice| slice.iter().map(|us| us.floor()).collect()).collect();
                let counted = median_slice(&whole, q).unwrap_or(own);
                format!("cyclictest {}: {}", told(peer), compare(counted, peer, RESOLUTION_US))
            });
            println!("  {name:<6} {who:<9} {}   {verdict}", told(own));
        };
        line("sleeping", &sleeping);
        line("spinning", &spinning);
    }
}

fn told(m: Median) -> String {
    format!("{:8.2} ({:7.2})", m.median, m.spread)
}

fn ours(seconds: u32, spin: SpanNs) -> Vec<f64> {
    measure_each(f64::from(seconds), REQUEST, spin).expect("our thread starts")
}

/// Wake-up latencies of cyclictest, us, from its histogram; `None` where it is not installed or gives none. What is longer
/// than the histogram counts as long as the longest.
fn cyclictest(seconds: u32) -> Option<Vec<f64>> {
    let (longest, duration, priority) =
        (LONGEST_US.to_string(), seconds.to_string(), REQUEST.priority.to_string());
    let output = Command::new("cyclictest")
        .args(["-q", "-m", "-t1", "-i", "1000", "-h", &longest, "-D", &duration, "-p", &priority])
        .stderr(Stdio::null())
        .output()
        .ok()?;
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let mut late_us = Vec::new();
    for line in text.lines().filter(|l| !l.starts_with('#')) {
        let mut words = line.split_whitespace().map(str::parse::<u32>);
        if let (Some(Ok(us)), Some(Ok(count))) = (words.next(), words.next()) {
            late_us.extend(std::iter::repeat_n(f64::from(us), count as usize));
        }
    }
    let told = |name: &str| -> Option<u32> {
        text.lines().find_map(|l| l.strip_prefix(name)?.split_whitespace().next()?.parse().ok())
    };
    let (over, longest) = (told("# Histogram Overflows:")?, told("# Max Latencies:")?);
    late_us.extend(std::iter::repeat_n(f64::from(longest), over as usize));
    (!late_us.is_empty()).then_some(late_us)
}

struct Load(Child);

impl Drop for Load {
    fn drop(&mut self) {
        let _ = Command::new("kill").arg(self.0.id().to_string()).status();
        let _ = self.0.wait();
    }
}

fn stress() -> Option<Load> {
    let child = Command::new("stress-ng")
        .args(["--cpu", "0", "--vm", "1", "--vm-bytes", "64M", "--timeout", "7200"])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn();
    child.ok().map(Load)
}
