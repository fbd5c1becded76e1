//! A run as a page: one HTML file with its figures in it, which needs nothing else.
//!
//! verdict, command, facts · image plane · errors · cell in space · joints · what happened when · latencies · jitter · frames · files

mod errors;
mod facts;
mod image_plane;
mod joints;
mod latency;
mod photographs;
mod record;
mod timeline;
mod view3d;

pub use facts::{run_facts, run_verdict};
pub use record::{ImageData, JointSummary, RunRecord};

use crate::report::page::{document, escaped, heading};
use std::fmt::Write;

/// The page.
#[must_use]
pub fn run_page(r: &RunRecord) -> String {
    let sections = [
        head(r),
        image_plane::image_plane(r),
        errors::errors_over_time(r),
        view3d::view3d(r),
        joints::joints(r),
        timeline::timeline(r),
        latency::latencies(r),
        latency::jitter(r),
        photographs::photographs(r),
        files(r),
    ];
    document(&format!("vservo run: {}", r.title), "", &sections)
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
    html + "</dl>\n"
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
    fn a_thinned_history_is_told() {
        let of = |text: &str| thinned(&RunRecord { trace: CsvTable::parse(text), ..RunRecord::default() });
        assert_eq!(of("tick\n0\n1\n5\n6\n"), "", "ticks that were skipped are no thinning");
        assert!(of("tick\n0\n4\n8\n12\n14\n").contains("one in 4 of"), "the last one is always there");
    }
}
