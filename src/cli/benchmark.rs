//! `vservo benchmark [--suite NAME|FILE.toml] [--law NAME]... --out DIR`: what each law makes of the tasks of a suite.
//!
//! `benchmark.json` is the same to the last byte on any load and number of threads; what depends on the machine, the time of a control step under each law, is
//! in `times.json`.

use super::all_cores::{cores, on_threads};
use super::{json, shown, write_result};
use crate::config::Config;
use crate::config::assemble::{self, AnyDrive};
use crate::drive::{CommandMode, Drive, DriveCommand, DriveHealth, DriveState};
use crate::input::{file, printable};
use crate::process::ProcessError;
use crate::robot::Robot;
use crate::rt::{now, tell};
use crate::sim::benchmark::{
    BenchmarkError, BenchmarkResults, BenchmarkScenario, BenchmarkSuite, LawTime, RunScores, SHIPPED_SUITES,
    benchmark_page, fly, scenario,
};
use crate::sim::{Drives, SimError};
use crate::time::MonoNs;
use clap::Args;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};

/// Times of a run that are kept. Chosen by hand: ten seconds of ticks, from which a median is taken.
const KEPT: usize = 10_000;

/// Arguments of `vservo benchmark`.
#[derive(Debug, Args)]
pub struct BenchmarkArguments {
    /// Suite: short, full, or a file (TOML)
    #[arg(long, value_name = "NAME|FILE.toml", default_value = "short")]
    pub suite: String,
    /// Only this law of the suite; may be repeated
    #[arg(long = "law", value_name = "NAME")]
    pub laws: Vec<String>,
    /// Folder for benchmark.json, times.json and index.html; made when it does not exist
    #[arg(long, value_name = "DIR", required_unless_present = "print")]
    pub out: Option<PathBuf>,
    /// Threads that simulate; as many as there are cores where it is left out
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Print a shipped suite, to start from, and do nothing else
    #[arg(long, value_name = "NAME")]
    pub print: Option<String>,
}

/// # Errors
/// When the suite is wrong, or a task of it cannot be simulated.
pub(super) fn benchmark(arguments: &BenchmarkArguments) -> Result<u8, ProcessError> {
    let result = match (&arguments.print, &arguments.out) {
        (Some(name), _) => print_suite(name),
        (None, Some(out)) => measure(arguments, out)?,
        (None, None) => return Ok(2), // which clap has told
    };
    Ok(result.unwrap_or_else(|error| {
        // a message of a run file has lines
        error
            .to_string()
            .lines()
            .for_each(|line| tell(format_args!("vservo: benchmark: {}", printable(line))));
        match error {
            BenchmarkError::Run { .. } => 1,
            _ => 3,
        }
    }))
}

fn print_suite(name: &str) -> Result<u8, BenchmarkError> {
    let names = SHIPPED_SUITES.map(|(name, _)| name).join(", ");
    let unknown =
        || BenchmarkError::Suite { suite: name.into(), cause: format!("there is none; choose of {names}") };
    Ok(shown(BenchmarkSuite::shipped(name).ok_or_else(unknown)?, 0))
}

/// The suite that is named: a shipped one, or a file.
fn suite(name: &str) -> Result<BenchmarkSuite, BenchmarkError> {
    if let Some(text) = BenchmarkSuite::shipped(name) {
        return BenchmarkSuite::parse(name, text, Path::new("."));
    }
    let names = SHIPPED_SUITES.map(|(name, _)| name).join(", ");
    let path = Path::new(name);
    let text = file::read(path, file::MAX_TOML).map_err(|e| BenchmarkError::Suite {
        suite: name.into(),
        cause: format!("cannot be read: {e}; give a file, or one of {names}"),
    })?;
    let folder = path.parent().filter(|f| !f.as_os_str().is_empty()).unwrap_or(Path::new("."));
    BenchmarkSuite::parse(name, &text, folder)
}

/// Everything: the outer error is that of the folder, the inner that of the suite.
fn measure(arguments: &BenchmarkArguments, out: &Path) -> Result<Result<u8, BenchmarkError>, ProcessError> {
    let suite = match suite(&arguments.suite).and_then(|suite| suite.with_laws(&arguments.laws)) {
        Ok(suite) => suite,
        Err(error) => return Ok(Err(error)),
    };
    std::fs::create_dir_all(out).map_err(|cause| ProcessError::Write { path: out.into(), cause })?;
    let threads = arguments.threads.map_or_else(cores, usize::from);
    Ok(flown(&suite, threads).map(|(results, times)| {
        let mut code = shown(&(results.to_text() + &words(&times)), 0);
        code = write_result(&out.join("benchmark.json"), json(&results), code);
        code = write_result(&out.join("times.json"), json(&times), code);
        write_result(&out.join("index.html"), benchmark_page(&results, &times), code)
    }))
}

/// The results of a suite, and the times of a step of its laws.
fn flown(suite: &BenchmarkSuite, threads: usize) -> Result<(BenchmarkResults, Vec<LawTime>), BenchmarkError> {
    let places = suite.places();
    let runs = places.len() * suite.laws.len();
    tell(format_args!(
        "vservo: {runs} runs, {} starts under {} laws, on {threads} threads",
        places.len(),
        suite.laws.len()
    ));
    let scenarios = on_threads(threads, &places, |place| scenario(suite, *place));
    let scenarios: Vec<BenchmarkScenario> = scenarios.into_iter().collect::<Result<_, _>>()?;
    let laws = suite.laws.len();
    let jobs: Vec<(usize, usize)> =
        (0..scenarios.len()).flat_map(|s| (0..laws).map(move |law| (s, law))).collect();
    let (done, tenth) = (AtomicUsize::new(0), runs.div_ceil(10).max(1));
    let flown = on_threads(threads, &jobs, |(s, law)| {
        let mut drives = TimedDrives::default();
        let scenario = scenarios
            .get(*s)
            .ok_or_else(|| BenchmarkError::Suite { suite: suite.name.clone(), cause: "is empty".into() })?;
        let scores = fly(suite, scenario, *law, &mut drives)?;
        let count = 1 + done.fetch_add(1, Ordering::Relaxed);
        if count.is_multiple_of(tenth) {
            tell(format_args!("vservo: {count} of {runs} runs"));
        }
        Ok((scores, drives.median_ns()))
    });
    let flown: Vec<(RunScores, Option<f64>)> = flown.into_iter().collect::<Result<_, BenchmarkError>>()?;
    let time = |(k, law): (usize, &crate::sim::benchmark::BenchmarkLaw)| {
        let mut all: Vec<f64> = flown.iter().skip(k).step_by(laws).filter_map(|(_, ns)| *ns).collect();
        all.sort_by(f64::total_cmp);
        LawTime { law: law.name.clone(), step_us: all.get(all.len() / 2).map(|ns| 1e-3 * ns) }
    };
    let times = suite.laws.iter().enumerate().map(time).collect();
    let scores: Vec<RunScores> = flown.into_iter().map(|(scores, _)| scores).collect();
    let of_scenarios: Vec<Vec<RunScores>> = scores.chunks(laws.max(1)).map(<[_]>::to_vec).collect();
    Ok((BenchmarkResults::new(suite, &scenarios, &of_scenarios), times))
}

fn words(times: &[LawTime]) -> String {
    let told = times.iter().filter_map(|t| Some(format!("{} {:.2}", t.law, t.step_us?)));
    format!(
        "\ntime of a control step on this machine, as loaded as it was, us: {}\n",
        told.collect::<Vec<_>>().join(", ")
    )
}

/// The drives of run files, with a clock about the control step.
#[derive(Default)]
struct TimedDrives {
    spans_ns: Arc<Mutex<Vec<i64>>>,
}

impl TimedDrives {
    /// From a state of the drive to the command after it, in the middle.
    fn median_ns(&self) -> Option<f64> {
        let mut spans = self.spans_ns.lock().ok()?;
        spans.sort_unstable();
        spans.get(spans.len() / 2).map(|ns| *ns as f64)
    }
}

impl Drives for TimedDrives {
    fn drive<const N: usize>(&mut self, config: &Config, robot: &Robot<N>) -> Result<AnyDrive<N>, SimError> {
        let drive = assemble::drive(config, robot)?;
        Ok(Box::new(TimedDrive { drive, read: None, spans_ns: Arc::clone(&self.spans_ns) }))
    }
}

/// A drive that notes how long control takes.
struct TimedDrive<const N: usize> {
    drive: AnyDrive<N>,
    read: Option<MonoNs>,
    spans_ns: Arc<Mutex<Vec<i64>>>,
}

impl<const N: usize> Drive<N> for TimedDrive<N> {
    fn read(&mut self, at: MonoNs) -> DriveState<N> {
        let state = self.drive.read(at);
        self.read = Some(now());
        state
    }

    fn write(&mut self, command: &DriveCommand<N>) {
        let span = self.read.take().map(|read| (now() - read).0);
        if let (Some(span), Ok(mut spans)) = (span, self.spans_ns.lock())
            && spans.len() < KEPT
        {
            spans.push(span);
        }
        self.drive.write(command);
    }

    fn modes(&self) -> &'static [CommandMode] {
        self.drive.modes()
    }

    fn health(&self) -> DriveHealth {
        self.drive.health()
    }

    fn reset(&mut self) {
        self.drive.reset();
    }

    fn clear_robot(&mut self, asked: bool) {
        self.drive.clear_robot(asked);
    }

    fn end(&mut self, last: &DriveCommand<N>) {
        self.drive.end(last);
    }
}
