//! What happened when: states of control, the target, limits that acted, and numbered events.
//!
//! The numbers here are layout, or keep logarithms and divisions from zero and infinity; they were chosen by hand.

use super::errors::blind_spans;
use super::record::{RunRecord, TargetSpell};
use crate::report::chart::{Anchor, Axis, Canvas, Width, over_time, text_width};
use crate::report::numbers::{counted, significant};
use crate::report::page::{escaped, figure};
use std::fmt::Write;

/// A span of a lane: from, to, class of its colour, and what it is.
type TimelineSpan = (f64, f64, &'static str, String);

/// A lane of the figure.
struct TimelineLane {
    name: String,
    spans: Vec<TimelineSpan>,
}

/// Spans shorter than this share of the run are joined with their neighbours: they could not be seen.
const SHORTEST: f64 = 1.0 / 1500.0;

fn lanes(r: &RunRecord, end: f64) -> Vec<TimelineLane> {
    let times = r.trace.numbers("time_s");
    let mut states: Vec<TimelineSpan> = Vec::new();
    for (row, time) in times.iter().enumerate() {
        let state = r.trace.word("state", row);
        match states.last_mut() {
            Some(last) if last.3 == state => last.1 = *time,
            _ => {
                if let Some(last) = states.last_mut() {
                    last.1 = *time;
                }
                states.push((*time, *time, class_of(state), state.to_owned()));
            }
        }
    }
    let mut lanes = vec![TimelineLane { name: "control".into(), spans: states }];
    let first = r.measurements.number("exposure_s", 0);
    if first.is_finite() {
        lanes.push(TimelineLane { name: "target".into(), spans: target_spans(first.max(0.0), end, r) });
    }
    if r.targets_looked_for().len() > 1 {
        let spells = r.spells();
        let ends = spells.iter().skip(1).map(|next| next.from_s).chain([end]);
        let span = |(spell, to): (&TargetSpell, f64)| {
            let class = if spell.target.is_multiple_of(2) { "b0" } else { "b2" };
            (spell.from_s.max(0.0), to, class, r.target_name(spell.target).to_owned())
        };
        lanes.push(TimelineLane {
            name: "looked for".into(),
            spans: spells.iter().zip(ends).map(span).collect(),
        });
    }
    for name in r.trace.names().iter().filter(|n| n.starts_with("limit_")) {
        let mut spans: Vec<TimelineSpan> = Vec::new();
        for (time, mask) in times.iter().zip(r.trace.numbers(name)) {
            if *mask > 0.0 {
                match spans.last_mut() {
                    Some(last) if time - last.1 <= (SHORTEST * end).max(2.5e-3) => last.1 = *time,
                    _ => spans.push((*time, *time, "b2", String::new())),
                }
            }
        }
        if !spans.is_empty() {
            lanes.push(TimelineLane {
                name: format!("{} limit acts", name.trim_start_matches("limit_")),
                spans,
            });
        }
    }
    lanes
}

/// When the target was found and when not, by turns: a word stands on its own span alone.
fn target_spans(first: f64, end: f64, r: &RunRecord) -> Vec<TimelineSpan> {
    let mut spans: Vec<TimelineSpan> = Vec::new();
    let mut found_since = first;
    let found = |from: f64, to: f64| (to > from).then(|| (from, to, "b0", "found".to_owned()));
    for (from, to) in blind_spans(r) {
        let (from, to) = (from.max(first), to.min(end));
        spans.extend(found(found_since, from));
        spans.push((from, to, "b1", "not found".into()));
        found_since = to;
    }
    spans.extend(found(found_since, end));
    spans
}

fn class_of(state: &str) -> &'static str {
    match state {
        "servoing" => "b0",
        "converged" => "b5",
        "holding" | "returning" | "held" => "b2",
        "fault" => "b1",
        _ => "b3",
    }
}

fn says(r: &RunRecord, lanes: &[TimelineLane], end: f64) -> String {
    let count = r.events.len() as u64 + r.events_left_out;
    let mut text = match count {
        0 => "Nothing happened that safety had to tell".to_owned(),
        count => counted(count, "event"),
    };
    if let Some(control) = lanes.first() {
        let served: f64 = control.spans.iter().filter(|s| s.3 == "servoing").map(|s| s.1 - s.0).sum();
        text += &format!(
            "; the law moved the arm in {} % of {} s",
            significant(100.0 * served / end.max(1e-9), 3),
            significant(end, 3)
        );
    }
    let blind = blind_spans(r);
    let seconds: f64 = blind.iter().map(|(from, to)| to - from).sum();
    if blind.is_empty() {
        text += &format!("; the target was found in all {} measurements", r.measurements.rows());
    } else {
        text += &format!(
            "; the target was not found for {} s in {}",
            significant(seconds, 2),
            counted(blind.len() as u64, "span")
        );
    }
    text + "."
}

/// The figure, and the events in words.
pub(super) fn timeline(r: &RunRecord) -> String {
    const TITLE: &str = "What happened when";
    let last_event = r.events.last().map_or(0.0, |e| e.0);
    let end = r.trace.numbers("time_s").last().copied().unwrap_or(0.0).max(last_event).max(1e-3);
    let lanes = lanes(r, end);
    let note = "Bars that are shorter than can be seen are drawn as wide as a line.";
    let mut html = figure(TITLE, &says(r, &lanes, end), note, |width| draw(r, &lanes, end, width));
    if !r.events.is_empty() {
        html += "<ol>";
        let gap = (r.events_left_out > 0).then_some(r.events.len() / 2);
        for (i, (time_s, event)) in r.events.iter().enumerate() {
            if gap == Some(i) {
                // a String takes everything
                let _ = write!(
                    html,
                    "</ol><p class=\"note\">{} more events</p><ol start=\"{}\">",
                    r.events_left_out,
                    i + 1
                );
            }
            let _ = write!(html, "<li>{time_s:.3} s: {}</li>", escaped(event));
        }
        html += "</ol>\n";
    }
    html
}

fn draw(r: &RunRecord, lanes: &[TimelineLane], end: f64, width: Width) -> String {
    let mut canvas = Canvas::new(width, 0.0);
    let h = canvas.letters();
    let axis = Axis::linear(0.0, end);
    let (left, right) = (0.6 * h, width.units() - 1.6 * h);
    let x = |t: f64| left + axis.place(t).unwrap_or(0.0).clamp(0.0, 1.0) * (right - left);
    let mut y = 0.0;
    for lane in lanes {
        y += 1.4 * h;
        canvas.text("t tm", [left, y], Anchor::Start, &lane.name);
        let (top, bottom) = (y + 0.45 * h, y + 2.0 * h);
        canvas.rectangle("frame", [left, top, right, bottom]);
        let mut free = left;
        for (from, to, class, text) in &lane.spans {
            let (x0, x1) = (x(*from), x(*to).max(x(*from) + 1.2));
            canvas.rectangle(class, [x0, top, x1, bottom]);
            let needed = text_width(text, h) + 0.6 * h;
            if !text.is_empty() && x1 - x0 > needed && x0 >= free {
                canvas.text("t", [x0 + 0.3 * h, y + 1.55 * h], Anchor::Start, text);
                free = x0 + needed;
            }
        }
        y = bottom + 0.3 * h;
    }
    y = flags(&mut canvas, r, &x, [left, y + 0.6 * h], right);
    // The cursor of the page goes through all of it.
    canvas.open(&over_time([left, 0.0, right, y], [0.0, end], None));
    canvas.close();
    canvas.path("frame", [[left, y], [right, y]]);
    let mut free = f64::NEG_INFINITY;
    for (value, text) in axis.ticks(((right - left) / (5.5 * h)) as usize) {
        let half = 0.5 * text_width(&text, h);
        canvas.path("frame", [[x(value), y], [x(value), y + 0.35 * h]]);
        let middle = x(value).max(half);
        if middle - half > free && middle + half < right + 1.6 * h {
            canvas.text("t", [middle, y + 1.5 * h], Anchor::Middle, &text);
            free = middle + half + 0.4 * h;
        }
    }
    canvas.text("t tm", [right, y + 2.9 * h], Anchor::End, "t, s");
    canvas.set_height(y + 3.4 * h);
    canvas.finish(&format!("chart {}", width.class()), "what happened when")
}

/// Numbers of events above the axis, in as many rows as they need; where the axis lies.
fn flags(
    canvas: &mut Canvas,
    r: &RunRecord,
    x: &dyn Fn(f64) -> f64,
    [left, top]: [f64; 2],
    right: f64,
) -> f64 {
    if r.events.is_empty() {
        return top;
    }
    let h = canvas.letters();
    // Neighbours that would be on each other are one flag: 3-7.
    let mut groups: Vec<(f64, usize, usize)> = Vec::new();
    for (i, (time_s, _)) in r.events.iter().enumerate() {
        let at = x(*time_s).clamp(left, right);
        match groups.last_mut() {
            Some((first, _, last)) if (at - *first) < 1.2 * h => *last = i + 1,
            _ => groups.push((at, i + 1, i + 1)),
        }
    }
    let text =
        |first: usize, last: usize| if first == last { first.to_string() } else { format!("{first}-{last}") };
    let mut rows: Vec<f64> = Vec::new();
    let mut placed = Vec::new();
    for (at, first, last) in groups {
        let text = text(first, last);
        let wide = text_width(&text, h) + 0.7 * h;
        let from = at.min(right + 1.4 * h - wide);
        let row = rows.iter().position(|end| *end < from - 0.2 * h).unwrap_or(rows.len());
        match rows.get_mut(row) {
            Some(end) => *end = from + wide,
            None => rows.push(from + wide),
        }
        placed.push((at, from, wide, row, text));
    }
    let bottom = top + (1.7 * rows.len() as f64 + 0.5) * h;
    for (at, from, wide, row, text) in placed {
        let y = top + 1.7 * row as f64 * h;
        canvas.path("leader", [[at, y], [at, bottom]]);
        canvas.rectangle("flag", [from, y, from + wide, y + 1.45 * h]);
        canvas.text("t flagtext", [from + 0.35 * h, y + 1.1 * h], Anchor::Start, &text);
    }
    bottom
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::chart::overlap;
    use crate::report::csv_table::CsvTable;

    fn record(events: usize) -> RunRecord {
        RunRecord {
            trace: CsvTable::parse(
                "time_s,state,limit_jerk\n0,waiting,0\n1,servoing,1\n2,servoing,1\n9,servoing,0\n10,stopped,0\n",
            ),
            measurements: CsvTable::parse("exposure_s,status\n0,Found\n4,NoMatch\n5,Found\n"),
            events: (0..events).map(|i| (0.03 * i as f64, format!("<event> {i}"))).collect(),
            ..RunRecord::default()
        }
    }

    #[test]
    fn several_targets_have_a_lane_that_names_them() {
        let mut r = record(0);
        r.further_targets = vec![("bin".into(), [[0.0; 2]; 2])];
        r.measurements =
            CsvTable::parse("exposure_s,status,target_number\n0,Found,0\n4,Found,1\n5,Found,1\n7,Found,0\n");
        let lanes = lanes(&r, 10.0);
        let lane = lanes.iter().find(|lane| lane.name == "looked for").unwrap();
        let told: Vec<_> = lane.spans.iter().map(|s| (s.0, s.1, s.3.as_str())).collect();
        assert_eq!(told, [(0.0, 4.0, "target"), (4.0, 7.0, "bin"), (7.0, 10.0, "target")]);
    }

    #[test]
    fn spans_and_sentence() {
        let r = record(0);
        let lanes = lanes(&r, 10.0);
        let told: Vec<_> = lanes.iter().map(|l| (l.name.as_str(), l.spans.len())).collect();
        assert_eq!(told, [("control", 3), ("target", 3), ("jerk limit acts", 2)]);
        assert_eq!(
            says(&r, &lanes, 10.0),
            "Nothing happened that safety had to tell; the law moved the arm in 90.0 % of 10.0 s; the target was not found for 1.0 s in 1 span."
        );
    }

    #[test]
    fn found_stands_where_the_target_was_found() {
        let words = |text: &str| {
            let measurements = CsvTable::parse(text);
            let r = RunRecord { measurements, ..record(0) };
            let spans = target_spans(0.5, 10.0, &r);
            spans.into_iter().map(|(from, to, _, word)| (from, to, word)).collect::<Vec<_>>()
        };
        let (found, not) = ("found".to_owned(), "not found".to_owned());
        // It begins without the target: no "found" stands there.
        assert_eq!(
            words("exposure_s,status\n0.5,NoMatch\n3,Found\n6,NoMatch\n7,Found\n"),
            [
                (0.5, 3.0, not.clone()),
                (3.0, 6.0, found.clone()),
                (6.0, 7.0, not.clone()),
                (7.0, 10.0, found.clone())
            ]
        );
        assert_eq!(words("exposure_s,status\n0.5,NoMatch\n"), [(0.5, 10.0, not)]);
        assert_eq!(words("exposure_s,status\n0.5,Found\n"), [(0.5, 10.0, found)]);
    }

    #[test]
    fn many_events_are_joined_and_none_hides_another() {
        let r = record(64);
        for width in Width::ALL {
            let mut canvas = Canvas::new(width, 0.0);
            let right = width.units() - 20.0;
            flags(&mut canvas, &r, &|t| 8.0 + t / 2.0 * (right - 8.0), [8.0, 0.0], right);
            let texts = canvas.texts();
            assert!(texts.len() > 3);
            for (i, a) in texts.iter().enumerate() {
                assert!(a[2] < width.units() && texts[i + 1..].iter().all(|b| !overlap(a, b)), "{width:?}");
            }
        }
        let html = timeline(&r);
        assert!(html.contains("<li>0.000 s: &lt;event&gt; 0</li>") && html.contains("64 events"), "{html}");
    }
}
