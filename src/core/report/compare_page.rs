//! Two runs side by side on one page: how each ended and why, what differs in their run files, and their errors and joints over time in the same figures.
//!
//! The numbers here are layout; they were chosen by eye.

use super::csv_table::CsvTable;
use crate::report::chart::{Panel, Series, figure_svg};
use crate::report::page::{document, escaped, figure, heading};
use std::collections::BTreeSet;
use std::fmt::Write;

/// One of the two.
#[derive(Debug, Clone, Default)]
pub struct PairedRun {
    /// What it is called: its file.
    pub name: String,
    /// How it ended, in a sentence.
    pub verdict: String,
    /// The likeliest causes of trouble.
    pub findings: Vec<String>,
    /// Names and values.
    pub facts: Vec<(String, String)>,
    /// The keys of its run file, and their values.
    pub settings: Vec<(String, String)>,
    /// The names of its joints.
    pub joints: Vec<String>,
    /// A row a tick.
    pub trace: CsvTable,
    /// A row a measurement.
    pub measurements: CsvTable,
}

/// The page.
#[must_use]
pub fn compare_page(runs: &[PairedRun; 2]) -> String {
    let [a, b] = runs;
    let mut sections = vec![table("", &verdicts(runs), runs), facts(runs), settings(runs)];
    sections.push(errors(runs));
    sections.extend(joints(runs));
    document(&format!("vservo runs: {} and {}", a.name, b.name), "", &sections)
}

/// A row of a table: what, and of each run the value.
type ComparedRow = (String, [String; 2]);

fn table(title: &str, rows: &[ComparedRow], runs: &[PairedRun; 2]) -> String {
    let mut html = if title.is_empty() { String::new() } else { heading(title, "") };
    let [a, b] = runs.each_ref().map(|run| escaped(&run.name));
    // a String takes everything
    let _ = write!(html, "<table><tr><th></th><th>{a}</th><th>{b}</th></tr>");
    for (name, values) in rows {
        let [a, b] = values.each_ref().map(|value| escaped(value));
        let _ = write!(html, "<tr><td>{}</td><td>{a}</td><td>{b}</td></tr>", escaped(name));
    }
    html + "</table>\n"
}

fn verdicts(runs: &[PairedRun; 2]) -> Vec<ComparedRow> {
    let findings = |run: &PairedRun| {
        if run.findings.is_empty() {
            "nothing out of the ordinary".to_owned()
        } else {
            run.findings.join("; ")
        }
    };
    vec![
        ("end".into(), runs.each_ref().map(|run| run.verdict.clone())),
        ("likely because".into(), runs.each_ref().map(findings)),
    ]
}

fn value(list: &[(String, String)], name: &str) -> String {
    list.iter().find(|(known, _)| known == name).map_or_else(|| "-".to_owned(), |(_, value)| value.clone())
}

fn facts(runs: &[PairedRun; 2]) -> String {
    let mut names: Vec<&String> = Vec::new();
    for (name, _) in runs.iter().flat_map(|run| &run.facts) {
        if !names.contains(&name) {
            names.push(name);
        }
    }
    let rows: Vec<_> = names
        .into_iter()
        .map(|name| (name.clone(), runs.each_ref().map(|run| value(&run.facts, name))))
        .collect();
    table("Figures", &rows, runs)
}

fn settings(runs: &[PairedRun; 2]) -> String {
    const TITLE: &str = "What differs in the run files";
    let keys: BTreeSet<&String> =
        runs.iter().flat_map(|run| run.settings.iter().map(|(key, _)| key)).collect();
    let rows =
        keys.into_iter().map(|key| (key.clone(), runs.each_ref().map(|run| value(&run.settings, key))));
    let rows: Vec<ComparedRow> = rows.filter(|(_, [a, b])| a != b).collect();
    if rows.is_empty() {
        heading(TITLE, "Nothing: what differs in the runs is chance.")
    } else {
        table(TITLE, &rows, runs)
    }
}

/// A panel with one line for each run.
fn panel(
    title: &str,
    unit: &str,
    runs: &[PairedRun; 2],
    points: impl Fn(&PairedRun) -> Vec<[f64; 2]>,
) -> Panel {
    let mut panel = Panel::new(title, "t, s", unit);
    for (i, run) in runs.iter().enumerate() {
        panel.push(Series::line(i, points(run).into_iter().map(|[t, x]| (t, x))).label(run.name.clone()));
    }
    panel
}

fn errors(runs: &[PairedRun; 2]) -> String {
    const TITLE: &str = "Feature error over time";
    let panels = [panel("features", "root mean square, px", runs, |run| {
        run.measurements.points("taken_s", "error_px")
    })
    .log_y_if_wide()];
    figure(TITLE, &ends(runs), "", |width| figure_svg(&panels, 1, width, TITLE))
}

fn ends(runs: &[PairedRun; 2]) -> String {
    let last = |run: &PairedRun| {
        let points = run.measurements.points("taken_s", "error_px");
        let end = points
            .last()
            .map_or_else(|| "saw nothing".into(), |[t, px]| format!("ended with {px:.3} px at {t:.2} s"));
        format!("{} {end}", run.name)
    };
    let [a, b] = runs.each_ref().map(last);
    format!("{a}; {b}.")
}

/// The joints, where both arms have the same.
fn joints(runs: &[PairedRun; 2]) -> Option<String> {
    const TITLE: &str = "Joints over time";
    let [a, b] = runs;
    if a.joints != b.joints || a.joints.is_empty() {
        return None;
    }
    let panels: Vec<Panel> = (1..)
        .zip(&a.joints)
        .map(|(i, name)| {
            panel(name, "position, rad or m", runs, |run| run.trace.points("time_s", &format!("q_{i}")))
        })
        .collect();
    Some(figure(TITLE, "Measured positions.", "", |width| figure_svg(&panels, 3, width, TITLE)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(name: &str, gain: &str, error: &str) -> PairedRun {
        let pair = |a: &str, b: &str| (a.to_owned(), b.to_owned());
        PairedRun {
            name: name.into(),
            verdict: format!("{name} <ended>"),
            facts: vec![pair("clock", "lockstep")],
            settings: vec![pair("servo.gain_1_s", gain), pair("run.seed", "1")],
            joints: vec!["joint_1".into()],
            trace: CsvTable::parse("time_s,q_1\n0,1\n1,2\n"),
            measurements: CsvTable::parse(&format!("taken_s,error_px\n0,100\n1,{error}\n")),
            ..PairedRun::default()
        }
    }

    #[test]
    fn what_differs_is_told_and_what_does_not_is_left_out() {
        let html = compare_page(&[run("a.mcap", "15.0", "0.5"), run("b.mcap", "3.0", "7.25")]);
        assert!(
            html.contains("<td>servo.gain_1_s</td><td>15.0</td><td>3.0</td>") && !html.contains("run.seed")
        );
        assert!(html.contains("a.mcap ended with 0.500 px at 1.00 s; b.mcap ended with 7.250 px at 1.00 s."));
        assert!(html.contains("&lt;ended&gt;") && html.contains("Joints over time"));
        let same = compare_page(&[run("a", "1", "1"), run("b", "1", "1")]);
        assert!(same.contains("what differs in the runs is chance"));
        let other = PairedRun { joints: vec!["x".into()], ..run("b", "1", "1") };
        assert!(!compare_page(&[run("a", "1", "1"), other]).contains("Joints over time"));
    }
}
