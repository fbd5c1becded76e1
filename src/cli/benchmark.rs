//! `vservo benchmark [--suite NAME|FILE.toml] [--law NAME]... [--entrant [NAME=]COMMAND]... --out DIR`: what each law, and each program that takes part, makes of
//! the tasks of a suite.
//!
//! `benchmark.json` is the same to the last byte on any load and number of threads, where entrants answer the same to the same; what depends on the machine, the time of a
//! control step under each law and of a round trip to each entrant, is in `times.json`.

mod entrants;
mod timed_drives;

use super::all_cores::{cores, on_threads};
use super::{json, shown, write_result};
use crate::input::{file, printable};
use crate::process::ProcessError;
use crate::rt::{tell, write_file};
use crate::sim::benchmark::{
    BenchmarkError, BenchmarkResults, BenchmarkScenario, BenchmarkSuite, EntrantCard, LawTime, Participant,
    RunScores, RunTruth, SHIPPED_SUITES, benchmark_page, run_scenario, scenario,
};
use clap::Args;
use entrants::{EntrantProgram, enrolled};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;
use timed_drives::TimedDrives;

/// Arguments of `vservo benchmark`.
#[derive(Debug, Args)]
pub struct BenchmarkArguments {
    /// Suite: short, full, or a file (TOML)
    #[arg(long, value_name = "NAME|FILE.toml", default_value = "short")]
    pub suite: String,
    /// Only this law of the suite; may be repeated
    #[arg(long = "law", value_name = "NAME")]
    pub laws: Vec<String>,
    /// A program that takes part, started by the shell for each run, which answers JSON lines; may be repeated
    #[arg(long = "entrant", value_name = "[NAME=]COMMAND")]
    pub entrants: Vec<String>,
    /// Longest time for an answer of an entrant; one that takes longer loses the run
    #[arg(long, value_name = "SECONDS", default_value = "10", value_parser = answer_time)]
    pub entrant_timeout: Duration,
    /// Also write what was true at each tick of each run, to DIR/truth
    #[arg(long, requires = "out")]
    pub truth: bool,
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

/// Seconds that a program may take to answer. Chosen by hand: no process answers a pipe within less, and who waits for an hour waits for nothing.
const ANSWER_S: (f64, f64) = (1e-3, 3600.0);

fn answer_time(text: &str) -> Result<Duration, String> {
    let seconds: Option<f64> = text.parse().ok().filter(|s| *s >= ANSWER_S.0 && *s <= ANSWER_S.1);
    let expected = || format!("expected seconds, {} to {}", ANSWER_S.0, ANSWER_S.1);
    seconds.map(Duration::from_secs_f64).ok_or_else(expected)
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
    let threads = arguments.threads.map_or_else(cores, usize::from);
    let field = match StartingField::of(arguments, threads) {
        Ok(field) => field,
        Err(error) => return Ok(Err(error)),
    };
    let truth = out.join("truth");
    let folder = if arguments.truth { &truth } else { out };
    std::fs::create_dir_all(folder).map_err(|cause| ProcessError::Write { path: folder.into(), cause })?;
    Ok(field.measured(threads, arguments.truth.then_some(folder)).map(|(results, times)| {
        let mut code = shown(&(results.to_text() + &words(&times)), 0);
        code = write_result(&out.join("benchmark.json"), json(&results), code);
        code = write_result(&out.join("times.json"), json(&times), code);
        write_result(&out.join("index.html"), benchmark_page(&results, &times), code)
    }))
}

/// What is to be run, and who takes part.
struct StartingField {
    suite: BenchmarkSuite,
    scenarios: Vec<BenchmarkScenario>,
    entrants: Vec<EntrantProgram>,
}

impl StartingField {
    fn of(arguments: &BenchmarkArguments, threads: usize) -> Result<Self, BenchmarkError> {
        let suite = suite(&arguments.suite)?.with_laws(&arguments.laws)?;
        let scenarios = on_threads(threads, &suite.places(), |place| scenario(&suite, *place));
        let scenarios: Vec<BenchmarkScenario> = scenarios.into_iter().collect::<Result<_, _>>()?;
        let entrants = match scenarios.first() {
            Some(first) => enrolled(&suite, first, &arguments.entrants, arguments.entrant_timeout)?,
            None => Vec::new(),
        };
        Ok(Self { suite, scenarios, entrants })
    }

    /// How many runs each scenario has.
    fn participants(&self) -> usize {
        self.suite.laws.len() + self.entrants.len()
    }

    /// The results, and the times of a step of laws and entrants. What was true of each run goes to the folder `truth`.
    fn measured(
        self,
        threads: usize,
        truth: Option<&Path>,
    ) -> Result<(BenchmarkResults, Vec<LawTime>), BenchmarkError> {
        let runs = self.all_runs(threads, truth)?;
        let (participants, laws) = (self.participants(), self.suite.laws.len());
        let Self { suite, scenarios, entrants } = self;
        let cards: Vec<EntrantCard> = entrants.into_iter().map(|entrant| entrant.card).collect();
        let names = suite.laws.iter().map(|law| &law.name).chain(cards.iter().map(|card| &card.name));
        let time = |(k, name): (usize, &String)| {
            let mut all: Vec<f64> =
                runs.iter().skip(k).step_by(participants).filter_map(|(_, ns)| *ns).collect();
            all.sort_by(f64::total_cmp);
            let step_us = all.get(all.len() / 2).map(|ns| 1e-3 * ns);
            LawTime { law: name.clone(), step_us, round_trip: k >= laws }
        };
        let times = names.enumerate().map(time).collect();
        let scores: Vec<RunScores> = runs.into_iter().map(|(scores, _)| scores).collect();
        let of_scenarios: Vec<Vec<RunScores>> =
            scores.chunks(participants.max(1)).map(<[_]>::to_vec).collect();
        Ok((BenchmarkResults::new(&suite, &cards, &scenarios, &of_scenarios), times))
    }

    /// Every run, of each scenario under each law and each entrant in this order, with the time of a step.
    fn all_runs(
        &self,
        threads: usize,
        truth: Option<&Path>,
    ) -> Result<Vec<(RunScores, Option<f64>)>, BenchmarkError> {
        let jobs: Vec<(&BenchmarkScenario, usize)> = self
            .scenarios
            .iter()
            .flat_map(|scenario| (0..self.participants()).map(move |k| (scenario, k)))
            .collect();
        let runs = jobs.len();
        let others = match self.entrants.len() {
            0 => String::new(),
            1 => " and an entrant".into(),
            n => format!(" and {n} entrants"),
        };
        let laws = match self.suite.laws.len() {
            1 => "one law".into(),
            n => format!("{n} laws"),
        };
        let starts = self.scenarios.len();
        tell(format_args!("vservo: {runs} runs, {starts} starts under {laws}{others}, on {threads} threads"));
        let (done, tenth) = (AtomicUsize::new(0), runs.div_ceil(10).max(1));
        let runs = on_threads(threads, &jobs, |(scenario, k)| {
            let result = self.one_run(scenario, *k, truth)?;
            let count = 1 + done.fetch_add(1, Ordering::Relaxed);
            if count.is_multiple_of(tenth) {
                tell(format_args!("vservo: {count} of {runs} runs"));
            }
            Ok(result)
        });
        runs.into_iter().collect()
    }

    /// The run of the law or entrant number `k`.
    fn one_run(
        &self,
        scenario: &BenchmarkScenario,
        k: usize,
        folder: Option<&Path>,
    ) -> Result<(RunScores, Option<f64>), BenchmarkError> {
        let suite = &self.suite;
        let mut truth = folder.map(|_| RunTruth::default());
        let (mut drives, entrant) = (TimedDrives::default(), k.checked_sub(suite.laws.len()));
        let (name, runs) = match entrant.and_then(|number| self.entrants.get(number)) {
            Some(entrant) => {
                let mut link = entrant.start();
                let participant = Participant::Entrant(&mut link);
                let scores = run_scenario(suite, scenario, participant, &mut drives, truth.as_mut())?;
                (Some(&entrant.card.name), (scores, link.median_ns()))
            }
            None => {
                let scores = run_scenario(suite, scenario, Participant::Law(k), &mut drives, truth.as_mut())?;
                (suite.laws.get(k).map(|law| &law.name), (scores, drives.median_ns()))
            }
        };
        if let (Some(folder), Some(truth), Some(name)) = (folder, truth, name) {
            let path = folder.join(suite.truth_file(scenario, name)?);
            write_file(&path, truth.to_csv()).map_err(|e| BenchmarkError::Suite {
                suite: path.display().to_string(),
                cause: format!("cannot be written: {e}"),
            })?;
        }
        Ok(runs)
    }
}

fn words(times: &[LawTime]) -> String {
    let told = |round_trip: bool| {
        let of = times.iter().filter(move |time| time.round_trip == round_trip);
        of.filter_map(|t| Some(format!("{} {:.2}", t.law, t.step_us?))).collect::<Vec<_>>().join(", ")
    };
    let steps =
        format!("\ntime of a control step on this machine, as loaded as it was, us: {}\n", told(false));
    match told(true) {
        none if none.is_empty() => steps,
        trips => format!("{steps}round trip to an entrant and back, us: {trips}\n"),
    }
}
