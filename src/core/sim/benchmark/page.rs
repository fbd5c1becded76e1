//! The page of a benchmark: who did best, who lost what and why, and each task with its table and a figure over what it varies.
//!
//! The numbers here are layout; they were chosen by eye.

use super::{BenchmarkResults, BenchmarkScenario, LawResult, RunScores, TaskResult};
use crate::report::chart::{Panel, Series, Symbol, figure_svg};
use crate::report::numbers::significant;
use crate::report::page::{document, escaped, figure, heading};
use serde::Serialize;
use std::fmt::Write;

const STYLE: &str = ".best{font-weight:600}.lost{color:var(--red)}th{font-weight:500;color:var(--soft)}th.n{text-align:right}\
table.scores{margin:.4rem 0 1rem}.wide-table{overflow-x:auto}table.scores td:first-child,td.whole{white-space:nowrap}";
/// Runs at the same place of an axis stand beside each other, this share of the axis's step apart, so that all laws are seen; less where there are so many that they would take
/// more than this share in all.
const APART: (f64, f64) = (0.09, 0.8);

/// How long a control step takes under a law, on the machine that ran the benchmark.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LawTime {
    /// The law.
    pub law: String,
    /// From the state of the drive to its command, median, us; of an entrant from what it is sent to its answer.
    pub step_us: Option<f64>,
    /// Whether it is an entrant's, a round trip to another process.
    pub round_trip: bool,
}

/// The page.
#[must_use]
pub fn benchmark_page(results: &BenchmarkResults, times: &[LawTime]) -> String {
    let mut sections = vec![verdict(results), totals(results, times), entrants(results), losses(results)];
    for task in &results.tasks {
        sections.push(section(task, results.laws.len() - results.entrants.len()));
    }
    document(&format!("vservo benchmark: {}", results.suite), STYLE, &sections)
}

fn verdict(results: &BenchmarkResults) -> String {
    let totals = results.totals();
    let most = totals.iter().map(|(_, sums)| sums[0]).max().unwrap_or(0);
    let first: Vec<&str> =
        totals.iter().filter(|(_, sums)| sums[0] == most).map(|(law, _)| law.as_str()).collect();
    let starts = totals.first().map_or(0, |(_, sums)| sums[1]);
    let home = match first.as_slice() {
        [one] => format!("{one} brings most starts home, {most} of {starts}"),
        [others @ .., last] => {
            format!("{} and {last} bring most starts home, {most} of {starts}", others.join(", "))
        }
        [] => String::new(),
    };
    format!(
        "<p class=\"verdict\">{}: {} runs of {}. {}; {} task and law pairs lose starts.</p>\n<p class=\"note\">Seed {}. Scores are computed from the truth of the \
         simulation, by the same equations for all laws; truth, belief and starts are in benchmark.json.</p>\n",
        escaped(&results.about),
        results.runs(),
        escaped(results.program),
        escaped(&home),
        results.losses.len(),
        results.seed
    )
}

fn totals(results: &BenchmarkResults, times: &[LawTime]) -> String {
    let mut html = heading("All tasks", "How each law fares over the whole suite.");
    html += "<div class=\"wide-table\"><table class=\"scores\"><tr><th>law</th><th>what it is</th><th class=\"n\">starts home</th><th class=\"n\">all home in</th>\
             <th class=\"n\">best in</th><th class=\"n\">control step, us</th><th class=\"n\">round trip, us</th></tr>";
    for ((law, [home, starts, whole, best]), (_, about)) in results.totals().iter().zip(&results.laws) {
        let time = times.iter().find(|time| time.law == *law);
        let step = |round_trip: bool| {
            let us = time.filter(|time| time.round_trip == round_trip).and_then(|time| time.step_us);
            us.map_or("-".into(), |us| significant(us, 3))
        };
        let (step, round_trip) = (step(false), step(true));
        // a String takes everything
        let _ = write!(
            html,
            "<tr><td>{}</td><td>{}</td><td class=\"n\">{home} of {starts}</td><td class=\"n\">{whole} of {}</td><td class=\"n\">{best}</td><td class=\"n\">{step}</td><td class=\"n\">{round_trip}</td></tr>",
            escaped(law),
            escaped(about),
            results.tasks.len()
        );
    }
    html + "</table></div>\n"
}

/// The programs of others, with all that they say of themselves; nothing where none takes part.
fn entrants(results: &BenchmarkResults) -> String {
    if results.entrants.is_empty() {
        return String::new();
    }
    let says = "Programs of others, on the same cell: its camera, its vision, its arm with its limits, its latencies. A round trip is from a question to its answer, \
                in another process; simulated time stands still meanwhile.";
    let mut html = heading("Entrants", says);
    html += "<div class=\"wide-table\"><table class=\"scores\"><tr><th>entrant</th><th>what it is</th><th>settings</th><th>command</th><th>sees</th></tr>";
    for entrant in &results.entrants {
        let sees = if entrant.frames { "features and frames" } else { "features" };
        let _ = write!(
            html,
            "<tr><td>{}</td><td>{}</td><td>{}</td><td><code>{}</code></td><td class=\"whole\">{sees}</td></tr>",
            escaped(&entrant.name),
            escaped(&entrant.about),
            escaped(&entrant.settings_in_words()),
            escaped(&entrant.command)
        );
    }
    html + "</table></div>\n"
}

fn losses(results: &BenchmarkResults) -> String {
    if results.losses.is_empty() {
        return heading("Where starts are lost", "Nowhere: every law brings every start home.");
    }
    let says = format!("{} pairs of task and law lose starts.", results.losses.len());
    let lines: Vec<String> = results.losses.iter().map(|line| escaped(line)).collect();
    heading("Where starts are lost", &says) + &format!("<pre>{}</pre>\n", lines.join("\n"))
}

fn section(task: &TaskResult, laws: usize) -> String {
    let whole = task.laws.iter().filter(|law| law.summary.converged == law.summary.starts).count();
    let best = match task.best.as_slice() {
        [] => "No law brings any start home.".to_owned(),
        best => format!("Best: {}.", best.join(", ")),
    };
    let says = format!(
        "{}; {} starts from {}, within {} px. {whole} of {} laws bring all home. {best}",
        task.about,
        task.scenarios.len(),
        task.file,
        significant(task.tolerance_px, 3),
        task.laws.len()
    );
    let panels = panels(task, laws);
    let html = if panels.is_empty() {
        heading(&task.name, &says)
    } else {
        figure(&task.name, &says, "Only runs that converged are drawn.", |width| {
            figure_svg(&panels, 3, width, &task.name)
        })
    };
    html + &table(task)
}

fn table(task: &TaskResult) -> String {
    let mut html = "<div class=\"wide-table\"><table class=\"scores\"><tr>".to_owned();
    for (k, head) in BenchmarkResults::HEAD.iter().enumerate() {
        let _ = write!(html, "<th{}>{}</th>", if k == 0 { "" } else { " class=\"n\"" }, escaped(head));
    }
    html += "</tr>";
    for (row, law) in BenchmarkResults::rows(task).iter().zip(&task.laws) {
        let is_best = task.best.contains(&law.law);
        html += if is_best { "<tr class=\"best\">" } else { "<tr>" };
        let lost = law.summary.converged < law.summary.starts;
        for (k, cell) in row.iter().enumerate() {
            let class = match k {
                0 => "",
                1 if lost => " class=\"n lost\"",
                _ => " class=\"n\"",
            };
            let _ = write!(html, "<td{class}>{}</td>", escaped(cell));
        }
        html += "</tr>";
    }
    html + "</table></div>\n"
}

/// What a task varies, as a number: the value of its first case key, or the number of the start.
fn place_of(scenario: &BenchmarkScenario, number: usize) -> (String, f64) {
    let varied = scenario.case.iter().find_map(|(key, value)| {
        Some((key.clone(), value.as_float().or_else(|| value.as_integer().map(|i| i as f64))?))
    });
    varied.unwrap_or_else(|| ("start".to_owned(), number as f64 + 1.0))
}

/// What a panel draws: its title, its unit, and the score of a run.
type DrawnScore = (&'static str, &'static str, fn(&RunScores) -> Option<f64>);

/// Settling and paths over what the task varies, a symbol a run; the first `laws` are laws, the others entrants.
fn panels(task: &TaskResult, laws: usize) -> Vec<Panel> {
    let places: Vec<(String, f64)> = task.scenarios.iter().enumerate().map(|(k, s)| place_of(s, k)).collect();
    let Some((label, _)) = places.first() else { return Vec::new() };
    let mut steps: Vec<f64> = places.iter().map(|(_, x)| *x).collect();
    steps.sort_by(f64::total_cmp);
    let step = steps
        .windows(2)
        .filter_map(|w| Some(w.last()? - w.first()?))
        .filter(|d| *d > 0.0)
        .fold(f64::INFINITY, f64::min);
    let step = if step.is_finite() { step } else { 1.0 };
    let value: [DrawnScore; 3] = [
        ("settling time", "s", |run| run.settling_s),
        ("path excess in the image", "%", |run| run.image_path_excess.map(|x| 100.0 * x)),
        ("path excess in space", "mm", |run| run.space_path_excess_m.map(|x| 1e3 * x)),
    ];
    let panel = |(title, unit, of): DrawnScore| {
        let series = |(k, law): (usize, &LawResult)| {
            let count = task.laws.len() as f64;
            let beside = APART.0.min(APART.1 / count) * step * (k as f64 - 0.5 * (count - 1.0));
            let points =
                law.runs.iter().zip(&places).filter_map(|(run, (_, x))| Some((x + beside, of(run)?)));
            // entrants have the colours of the laws once more, with another symbol
            let (symbol, colour) = k.checked_sub(laws).map_or((Symbol::Circle, k), |k| (Symbol::Cross, k));
            Series::new(symbol, colour, points.collect::<Vec<_>>()).label(law.law.clone())
        };
        let panel = Panel::new(title, label.clone(), format!("{title} [{unit}]"));
        task.laws.iter().enumerate().map(series).fold(panel, Panel::with)
    };
    value.into_iter().map(panel).collect()
}
