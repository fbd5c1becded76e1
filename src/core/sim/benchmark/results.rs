//! What a suite gives: every run, each law's summary of each task, who did best, and where each law loses.

use super::{BenchmarkScenario, BenchmarkScore, BenchmarkSuite, BenchmarkTask, EntrantCard, RunScores};
use crate::report::numbers::significant;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::Path;

/// Laws whose scores differ by less than this share are equally good. Chosen by hand: below what another seed changes.
const ALIKE: f64 = 0.02;

/// All of it; the same to the last byte on any number of threads.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BenchmarkResults {
    /// The program, and its version.
    pub program: &'static str,
    /// Name of the suite.
    pub suite: String,
    /// What it is.
    pub about: String,
    /// Its seed.
    pub seed: u64,
    /// The laws, and then the entrants: name and what they are.
    pub laws: Vec<(String, String)>,
    /// Which of them are programs of others, with their settings.
    pub entrants: Vec<EntrantCard>,
    /// The tasks.
    pub tasks: Vec<TaskResult>,
    /// Where starts were not brought home, in sentences.
    pub losses: Vec<String>,
}

/// What became of a task.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TaskResult {
    /// Its name.
    pub name: String,
    /// What it asks.
    pub about: String,
    /// The run file it starts from.
    pub file: String,
    /// By what laws are compared that bring equally many starts home.
    pub score: BenchmarkScore,
    /// At the goal is who is this near in the image, px.
    pub tolerance_px: f64,
    /// Its starts.
    pub scenarios: Vec<BenchmarkScenario>,
    /// The laws.
    pub laws: Vec<LawResult>,
    /// The best of them; several where they differ by less than 2 %.
    pub best: Vec<String>,
}

/// What a law made of a task.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LawResult {
    /// Its name.
    pub law: String,
    /// In short.
    pub summary: LawSummary,
    /// The runs, in the order of the scenarios.
    pub runs: Vec<RunScores>,
}

/// A law's runs of a task in short: medians over those that converged, the margin's least over all.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LawSummary {
    /// How many starts were brought home.
    pub converged: usize,
    /// Of how many.
    pub starts: usize,
    /// Settling time, s.
    pub settling_s: Option<f64>,
    /// The same by the least time.
    pub settling_by_least: Option<f64>,
    /// Path excess in the image.
    pub image_path_excess: Option<f64>,
    /// Path excess in space, m.
    pub space_path_excess_m: Option<f64>,
    /// Least image margin, px.
    pub margin_px: f64,
    /// Final error, px.
    pub final_error_px: Option<f64>,
    /// Final error, m.
    pub final_error_m: Option<f64>,
    /// Work of the joints, J.
    pub energy_j: Option<f64>,
}

/// The middle one; of an even number the mean of both.
fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.filter(|v| v.is_finite()).collect();
    values.sort_by(f64::total_cmp);
    let n = values.len();
    Some(0.5 * (values.get(n.checked_sub(1)? / 2)? + values.get(n / 2)?))
}

impl LawSummary {
    fn of(runs: &[RunScores]) -> Self {
        let home = || runs.iter().filter(|run| run.converged);
        Self {
            converged: home().count(),
            starts: runs.len(),
            settling_s: median(home().filter_map(|run| run.settling_s)),
            settling_by_least: median(home().filter_map(|run| run.settling_by_least)),
            image_path_excess: median(home().filter_map(|run| run.image_path_excess)),
            space_path_excess_m: median(home().filter_map(|run| run.space_path_excess_m)),
            margin_px: runs.iter().map(|run| run.margin_px).fold(f64::INFINITY, f64::min),
            final_error_px: median(home().map(|run| run.final_error_px)),
            final_error_m: median(home().map(|run| run.final_error_m)),
            energy_j: median(home().map(|run| run.energy_j)),
        }
    }

    /// The value of a score, less is better; infinite where there is none.
    fn value(&self, score: BenchmarkScore) -> f64 {
        let value = match score {
            BenchmarkScore::Converged => Some(0.0),
            BenchmarkScore::Settling => self.settling_s,
            BenchmarkScore::ImagePath => self.image_path_excess.map(|x| 1.0 + x),
            BenchmarkScore::SpacePath => self.space_path_excess_m,
            // compared as what is missing to the whole image, so that a share of it is one
            BenchmarkScore::Margin => Some(1e3 - self.margin_px),
            BenchmarkScore::FinalError => self.final_error_px,
            BenchmarkScore::Energy => self.energy_j,
        };
        value.unwrap_or(f64::INFINITY)
    }
}

/// The best by the share of starts that were brought home, then by the task's score.
fn best(laws: &[LawResult], score: BenchmarkScore) -> Vec<String> {
    let most = laws.iter().map(|law| law.summary.converged).max().unwrap_or(0);
    let first = || laws.iter().filter(|law| most > 0 && law.summary.converged == most);
    let least = first().map(|law| law.summary.value(score)).fold(f64::INFINITY, f64::min);
    first()
        .filter(|law| law.summary.value(score) <= least * (1.0 + ALIKE))
        .map(|law| law.law.clone())
        .collect()
}

/// `k of n`, with the reasons of the others.
fn loss(task: &BenchmarkTask, law: &LawResult) -> Option<String> {
    let LawSummary { converged, starts, .. } = law.summary;
    let mut reasons = BTreeMap::new();
    for run in law.runs.iter().filter(|run| !run.converged) {
        *reasons.entry(run.end.as_str()).or_insert(0usize) += 1;
    }
    let told: Vec<String> = reasons.iter().map(|(reason, count)| format!("{count} {reason}")).collect();
    (converged < starts).then(|| {
        format!("{}: {} brings {converged} of {starts} home; {}", task.name, law.law, told.join(", "))
    })
}

impl BenchmarkResults {
    /// The results of `suite`: its scenarios in the order of their places, and for each of them the runs of all laws and of `entrants`.
    #[must_use]
    pub fn new(
        suite: &BenchmarkSuite,
        entrants: &[EntrantCard],
        scenarios: &[BenchmarkScenario],
        runs: &[Vec<RunScores>],
    ) -> Self {
        let laws = suite.laws.iter().map(|law| (law.name.clone(), law.about.clone()));
        let names: Vec<(String, String)> = laws
            .chain(entrants.iter().map(|entrant| (entrant.name.clone(), entrant.about.clone())))
            .collect();
        let mut losses = Vec::new();
        let of_task = |(number, task): (usize, &BenchmarkTask)| {
            let own =
                || scenarios.iter().zip(runs).filter(move |(scenario, _)| scenario.place.task == number);
            let of_law = |(k, (name, _)): (usize, &(String, String))| {
                let runs: Vec<RunScores> = own().filter_map(|(_, runs)| runs.get(k).cloned()).collect();
                let law = LawResult { law: name.clone(), summary: LawSummary::of(&runs), runs };
                losses.extend(loss(task, &law));
                law
            };
            let laws: Vec<LawResult> = names.iter().enumerate().map(of_law).collect();
            TaskResult {
                name: task.name.clone(),
                about: task.about.clone(),
                file: task.file.clone(),
                score: task.score,
                tolerance_px: task.tolerance_px,
                scenarios: own().map(|(scenario, _)| scenario.clone()).collect(),
                best: best(&laws, task.score),
                laws,
            }
        };
        let tasks = suite.tasks.iter().enumerate().map(of_task).collect();
        Self {
            program: concat!("vservo ", env!("CARGO_PKG_VERSION")),
            suite: Path::new(&suite.name).file_stem().unwrap_or_default().to_string_lossy().into_owned(),
            about: suite.about.clone(),
            seed: suite.seed,
            laws: names,
            entrants: entrants.to_vec(),
            tasks,
            losses,
        }
    }

    /// How many runs there are.
    #[must_use]
    pub fn runs(&self) -> usize {
        self.tasks.iter().flat_map(|task| &task.laws).map(|law| law.runs.len()).sum()
    }

    /// Over all tasks, for each law: starts brought home, starts, tasks of which it brings all home, tasks in which it is best.
    #[must_use]
    pub fn totals(&self) -> Vec<(String, [usize; 4])> {
        let total = |(k, (name, _)): (usize, &(String, String))| {
            let mut sums = [0; 4];
            for (task, law) in self.tasks.iter().filter_map(|task| Some((task, task.laws.get(k)?))) {
                let LawSummary { converged, starts, .. } = law.summary;
                let more = [
                    converged,
                    starts,
                    usize::from(converged == starts),
                    usize::from(task.best.contains(name)),
                ];
                sums.iter_mut().zip(more).for_each(|(sum, more)| *sum += more);
            }
            (name.clone(), sums)
        };
        self.laws.iter().enumerate().map(total).collect()
    }

    /// The table: a row a task and law, beginning with its head.
    #[must_use]
    pub fn rows(task: &TaskResult) -> Vec<[String; 9]> {
        let number =
            |value: Option<f64>, times: f64| value.map_or("-".to_owned(), |v| significant(v * times, 3));
        let row = |law: &LawResult| {
            let s = &law.summary;
            [
                format!("{}{}", law.law, if task.best.contains(&law.law) { " *" } else { "" }),
                format!("{}/{}", s.converged, s.starts),
                number(s.settling_s, 1.0),
                number(s.settling_by_least, 1.0),
                number(s.image_path_excess, 100.0),
                number(s.space_path_excess_m, 1e3),
                format!("{:.0}", s.margin_px),
                number(s.final_error_px, 1.0),
                number(s.energy_j, 1.0),
            ]
        };
        task.laws.iter().map(row).collect()
    }

    /// The head of that table.
    pub const HEAD: [&'static str; 9] = [
        "law",
        "converged",
        "settling s",
        "by least",
        "image path +%",
        "space path +mm",
        "margin px",
        "final px",
        "energy J",
    ];

    /// The tables in words.
    #[must_use]
    pub fn to_text(&self) -> String {
        let mut text = format!(
            "{} {}, {} runs; medians of the runs that converged, * the best\n",
            self.program,
            self.suite,
            self.runs()
        );
        for task in &self.tasks {
            text += &format!("\n{} ({}): {}\n", task.name, task.file, task.about);
            let rows: Vec<[String; 9]> =
                std::iter::once(Self::HEAD.map(str::to_owned)).chain(Self::rows(task)).collect();
            let width = |k: usize| rows.iter().map(|row| row[k].len()).max().unwrap_or(0);
            let widths: [usize; 9] = std::array::from_fn(width);
            for row in &rows {
                let [law, others @ ..] = row;
                text += &format!("  {law:<0$}", widths[0]);
                for (cell, width) in others.iter().zip(widths.iter().skip(1)) {
                    text += &format!("  {cell:>width$}");
                }
                text += "\n";
            }
        }
        if !self.entrants.is_empty() {
            text += "\nentrants: what they are, their settings, and how they were started\n";
        }
        for entrant in &self.entrants {
            text += &format!(
                "  {}: {}; {}; `{}`\n",
                entrant.name,
                entrant.about,
                entrant.settings_in_words(),
                entrant.command
            );
        }
        text += "\nall tasks: starts brought home, tasks of which all are, tasks in which it is best\n";
        for (law, [home, starts, whole, best]) in self.totals() {
            text += &format!("  {law}: {home} of {starts}, {whole} of {}, {best}\n", self.tasks.len());
        }
        if !self.losses.is_empty() {
            text += "\nwhere starts are lost\n";
            self.losses.iter().for_each(|line| text += &format!("  {line}\n"));
        }
        text
    }
}
