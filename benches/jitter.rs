//! Wake-up latency of our 1 kHz thread beside cyclictest (Debian package rt-tests), in alternating slices, so that both
//! see the same machine; idle, and under load (stress-ng) where that is installed.
//!
//! `cargo bench --bench jitter -- [SECONDS_PER_SLICE] [SLICES]`, 10 and 3 by default; needs the right to SCHED_FIFO.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, missing_docs)]

use std::collections::BTreeMap;
use std::process::{Child, Command, Stdio};
use vservo::config::RealtimeRequest;
use vservo::rt::doctor::measure_each;

const PRIORITY: u32 = 80;
const QUANTILES: [(&str, f64); 4] = [("p50", 0.5), ("p99", 0.99), ("p99.9", 0.999), ("max", 1.0)];

fn main() {
    let mut numbers = std::env::args().skip(1).filter_map(|a| a.parse::<u32>().ok());
    let (seconds, slices) = (numbers.next().unwrap_or(10), numbers.next().unwrap_or(3));
    for load in [false, true] {
        let _stress = match load.then(stress) {
            Some(None) => {
                println!("under load: skipped: no stress-ng (Debian package stress-ng)");
                continue;
            }
            other => other.flatten(),
        };
        let (mut ours, mut theirs) = (Vec::new(), Vec::new());
        for _ in 0..slices {
            let request = RealtimeRequest { priority: PRIORITY, cpu: None, lock_memory: false };
            ours.push(measure_each(f64::from(seconds), request).expect("our thread starts"));
            theirs.push(cyclictest(seconds));
        }
        println!("{} ({} slices of {seconds} s each)", if load { "under load" } else { "idle" }, slices);
        print_comparison(ours, theirs);
    }
}

/// Wake-up latencies of cyclictest, us, from its histogram; empty where it is not installed.
fn cyclictest(seconds: u32) -> Vec<f64> {
    let output = Command::new("cyclictest")
        .args([
            "-q",
            "-m",
            "-t1",
            "-i",
            "1000",
            "-h",
            "20000",
            "-D",
            &seconds.to_string(),
            "-p",
            &PRIORITY.to_string(),
        ])
        .stderr(Stdio::null())
        .output();
    let Ok(output) = output else { return Vec::new() };
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let bars: BTreeMap<u32, u32> = text
        .lines()
        .filter(|l| !l.starts_with('#'))
        .filter_map(|l| {
            let mut words = l.split_whitespace();
            Some((words.next()?.parse().ok()?, words.next()?.parse().ok()?))
        })
        .collect();
    bars.into_iter().flat_map(|(us, count)| std::iter::repeat_n(f64::from(us), count as usize)).collect()
}

/// Over all slices together, and the median of what the single slices show: one stall of a virtual machine decides the tail of
/// the first, but not of the second.
fn print_comparison(ours: Vec<Vec<f64>>, theirs: Vec<Vec<f64>>) {
    let sorted = |mut v: Vec<f64>| {
        v.sort_by(f64::total_cmp);
        v
    };
    let at = |v: &[f64], q: f64| v[((v.len() as f64 * q).ceil() as usize).clamp(1, v.len()) - 1];
    let of_slices = |slices: &[Vec<f64>], q: f64| {
        at(&sorted(slices.iter().map(|slice| at(&sorted(slice.clone()), q)).collect()), 0.5)
    };
    for (name, q) in QUANTILES {
        let (own, own_slices) = (at(&sorted(ours.concat()), q), of_slices(&ours, q));
        if theirs.iter().any(Vec::is_empty) {
            println!(
                "  {name:<6} ours {own:8.1} us   cyclictest: skipped: not installed (Debian package rt-tests)"
            );
        } else {
            let (peer, peer_slices) = (at(&sorted(theirs.concat()), q), of_slices(&theirs, q));
            println!(
                "  {name:<6} ours {own:8.1} us   cyclictest {peer:8.1} us   ratio {:.2}   median slice {own_slices:8.1} {peer_slices:8.1} us  {:.2}",
                own / peer.max(1.0),
                own_slices / peer_slices.max(1.0)
            );
        }
    }
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
        .args(["--cpu", "0", "--vm", "1", "--vm-bytes", "64M", "--timeout", "600"])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn();
    child.ok().map(Load)
}
