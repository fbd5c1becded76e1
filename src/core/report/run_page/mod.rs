//! A run as a page: one HTML file with its figures in it, which needs nothing else.
//!
//! verdict, command, facts · image plane · errors · errors by axis · cell in space · joints · law and singular postures · what happened when · latencies ·
//! jitter · filmstrip · frames · files

mod errors;
mod facts;
mod image_plane;
mod joints;
mod latency;
mod law;
mod photographs;
mod record;
mod timeline;
mod view3d;

pub use facts::{run_facts, run_verdict};
pub use record::{ImageData, JointSummary, RunRecord};

use crate::report::page::{TIME_CURSOR, document, escaped, heading};
use std::fmt::Write;

/// The page.
#[must_use]
pub fn run_page(r: &RunRecord) -> String {
    let sections = [
        head(r),
        image_plane::image_plane(r),
        time_note(r),
        errors::errors_over_time(r),
        errors::errors_by_axis(r),
        view3d::view3d(r),
        joints::joints(r),
        law::requested(r),
        law::singularity(r),
        timeline::timeline(r),
        latency::latencies(r),
        latency::jitter(r),
        photographs::photographs(r),
        files(r),
        TIME_CURSOR.into(),
    ];
    document(&format!("vservo run: {}", r.title), "", &sections)
}

/// Share of a run for which it may stand before its first motion without that the figures begin there. Chosen by eye.
const LONG_WAIT: f64 = 0.25;

/// How the figures over time are read; with the range in which the arm moves, where it waited for long.
fn time_note(r: &RunRecord) -> String {
    let times = r.trace.numbers("time_s");
    let stands = |state: &str| matches!(state, "" | "waiting" | "idle" | "held" | "stopped");
    let first = (0..times.len()).find(|row| !stands(r.trace.word("state", *row)));
    let (from, end) = (first.and_then(|row| times.get(row)), times.last());
    let how = "In a browser: the cursor is at the same time in all figures, and tells the values below it; drag over a figure to zoom, double-click to see all again.";
    match (from, end) {
        (Some(from), Some(end)) if *from > LONG_WAIT * end => format!(
            "<p class=\"note\" data-from=\"{from} {end}\">The arm stood until {from:.2} s: the figures over time begin there. {how}</p>\n"
        ),
        _ => format!("<p class=\"note\">{how}</p>\n"),
    }
}

fn head(r: &RunRecord) -> String {
    let class = if r.is_good { "verdict" } else { "verdict bad" };
    let mut html = format!(
        "<p class=\"{class}\">{}</p>\n{}<p class=\"note\">vservo {}, seed {}. This repeats it{}:</p>\n",
        escaped(&r.verdict),
        explanation(r),
        escaped(&r.version),
        r.seed,
        if r.simulated_time { ", to the last bit" } else { "" }
    );
    for command in &r.commands {
        let _ = writeln!(html, "<pre>{}</pre>", escaped(command)); // a String takes everything
    }
    html += "<dl>";
    for (name, value) in &r.facts {
        let _ = write!(html, "<div><dt>{}</dt><dd>{}</dd></div>", escaped(name), escaped(value));
    }
    html += "</dl>\n";
    if !r.config.is_empty() {
        let lines: Vec<String> = r.config.lines().map(escaped).collect();
        let _ = writeln!(
            html,
            "<details><summary>The run file with all its values</summary><pre>{}</pre></details>",
            lines.join("\n")
        );
    }
    html
}

/// The findings, the likeliest cause first, and what limited the speed.
fn explanation(r: &RunRecord) -> String {
    let mut html = String::new();
    if !r.findings.is_empty() {
        html += "<ol>";
        for finding in &r.findings {
            let [what, evidence, change] = finding.each_ref().map(|text| escaped(text));
            let _ = write!(
                html,
                "<li>{what} <span class=\"note\">Evidence: {evidence}. Change: {change}</span></li>"
            );
        }
        html += "</ol>\n";
    }
    if !r.speed.is_empty() {
        let _ = writeln!(html, "<p class=\"note\">Speed: {}</p>", escaped(&r.speed));
    }
    html
}

fn files(r: &RunRecord) -> String {
    if r.files.is_empty() {
        return String::new();
    }
    let ticks = r.trace.rows();
    let mut html = heading(
        "Data",
        &format!(
            "All figures are drawn from the files beside this page; trace.csv has {ticks} ticks{}.",
            thinned(r)
        ),
    );
    html += "<dl>";
    for (file, what) in &r.files {
        let _ = write!(
            html,
            "<div><dt><a href=\"{0}\">{0}</a></dt><dd>{1}</dd></div>",
            escaped(file),
            escaped(what)
        );
    }
    html + "</dl>\n"
}

/// That not every tick was kept, where that is so.
fn thinned(r: &RunRecord) -> String {
    let ticks = r.trace.numbers("tick");
    let whole = ticks.get(..ticks.len().saturating_sub(1)).unwrap_or(ticks);
    let steps = whole.windows(2).filter_map(|w| Some(w.last()? - w.first()?));
    let least = steps.reduce(f64::min).unwrap_or(1.0);
    // Chosen by hand: the trace has a row every millisecond unless it was thinned.
    if least < 1.5 {
        String::new()
    } else {
        format!(", one in {least:.0} of the run: it was too long for more")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::csv_table::CsvTable;

    #[test]
    fn an_empty_run_has_a_page_too() {
        let html =
            run_page(&RunRecord { commands: vec!["vservo run 'a <b>'".into()], ..RunRecord::default() });
        for part in ["<pre>vservo run 'a &lt;b&gt;'</pre>", "No frame reached vision", "No measurement says"]
        {
            assert!(html.contains(part), "{part}");
        }
        // The name of SVG's language is no address that anybody asks.
        assert!(!html.replace("http://www.w3.org/2000/svg", "").contains("http") && !html.contains("NaN"));
    }

    #[test]
    fn the_page_begins_with_what_was_found_out() {
        let findings = vec![["it jammed".into(), "q & qd".into(), "free it".into()]];
        let html = run_page(&RunRecord { findings, speed: "the <law>".into(), ..RunRecord::default() });
        assert!(html.contains(
            "<li>it jammed <span class=\"note\">Evidence: q &amp; qd. Change: free it</span></li>"
        ));
        assert!(html.contains("Speed: the &lt;law&gt;"));
    }

    #[test]
    fn figures_begin_with_the_motion_where_the_arm_stood_for_long() {
        let of = |text: &str| time_note(&RunRecord { trace: CsvTable::parse(text), ..RunRecord::default() });
        let waits = of("time_s,state\n0,idle\n6,servoing\n10,servoing\n");
        assert!(waits.contains("data-from=\"6 10\"") && waits.contains("stood until 6.00 s"), "{waits}");
        assert!(!of("time_s,state\n0,waiting\n1,servoing\n10,held\n").contains("data-from"));
    }

    #[test]
    fn all_values_are_in_the_page_line_by_line() {
        let html = run_page(&RunRecord { config: "[run]\nseed = 1\n".into(), ..RunRecord::default() });
        assert!(html.contains("values</summary><pre>[run]\nseed = 1</pre></details>"));
    }

    #[test]
    fn a_thinned_history_is_told() {
        let of = |text: &str| thinned(&RunRecord { trace: CsvTable::parse(text), ..RunRecord::default() });
        assert_eq!(of("tick\n0\n1\n5\n6\n"), "", "ticks that were skipped are no thinning");
        assert!(of("tick\n0\n4\n8\n12\n14\n").contains("one in 4 of"), "the last one is always there");
    }
}
