//! What panels show, in a sentence: where curves end or between which values they lie, how straight paths are, and which curve lies
//! under another.
//!
//! The numbers here are layout, or keep logarithms and divisions from zero and infinity; they were chosen by hand.

use super::panel::{Panel, Series, Symbol};
use crate::report::numbers::significant;

/// Most series of a panel that are named, so that it stays a sentence.
const MOST: usize = 6;
/// Curves that are nearer to each other than this share of the panel's height are on each other: less than a line's width. Chosen by eye.
const SAME: f64 = 0.006;
/// Places at which curves are compared. Chosen: what lies between two of them is not a sixtieth of the panel wide.
const PLACES: usize = 60;

/// The sentence; empty where nothing has a name.
#[must_use]
pub fn panels_say(panels: &[Panel]) -> String {
    let mut parts: Vec<String> = panels.iter().filter_map(says).collect();
    for panel in panels {
        let hidden = hidden(panel);
        if !hidden.is_empty() {
            parts.push(format!("in {} {}", quoted(panel, panels), hidden.join(", ")));
        }
    }
    let text = parts.join("; ");
    let mut letters = text.chars();
    let first: String = letters.next().map(|c| c.to_uppercase().collect()).unwrap_or_default();
    if first.is_empty() { text } else { format!("{first}{}.", letters.as_str()) }
}

fn quoted(panel: &Panel, all: &[Panel]) -> String {
    if all.len() == 1 || panel.title().is_empty() {
        "the figure".into()
    } else {
        format!("\"{}\"", panel.title())
    }
}

fn says(panel: &Panel) -> Option<String> {
    let named: Vec<&Series> =
        panel.series().iter().filter(|s| s.label.is_some() && !s.points.is_empty()).collect();
    let told: Vec<String> = named
        .iter()
        .take(MOST)
        .filter_map(|s| Some(format!("{} {}", s.label.as_ref()?, value(panel, s)?)))
        .collect();
    if told.is_empty() {
        return None;
    }
    let more = named.len().saturating_sub(MOST);
    let more = if more == 0 { String::new() } else { format!(" and {more} more") };
    let list = format!("{}{more}", told.join(", "));
    Some(match (panel.is_equal(), panel.is_over_time()) {
        (true, _) => format!("{}, length of the way by that of the straight line: {list}", panel.title()),
        (false, true) => format!("{} at the end: {list} {}", panel.title(), panel.unit()),
        (false, false) => format!("{}: {list} {}", panel.title(), panel.unit()),
    })
    .map(|text| text.trim_end().trim_start_matches(": ").to_owned())
}

/// What a series says in a panel of this kind.
fn value(panel: &Panel, series: &Series) -> Option<String> {
    let is_line = matches!(series.symbol, Symbol::Line | Symbol::Dashed);
    let (first, last) = (series.points.first()?, series.points.last()?);
    if panel.is_equal() {
        let steps = series.points.windows(2).filter_map(|w| Some(distance(w.first()?, w.last()?)));
        let straight = distance(first, last);
        return (is_line && straight > 1e-9).then(|| significant(steps.sum::<f64>() / straight, 3));
    }
    if panel.is_over_time() {
        return is_line.then(|| significant(last[1], 3));
    }
    let ends =
        series.points.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), p| (l.min(p[1]), h.max(p[1])));
    let (low, high) = (significant(ends.0, 3), significant(ends.1, 3));
    Some(if low == high { low } else { format!("{low} to {high}") })
}

fn distance(a: &[f64; 2], b: &[f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// "x lies under y", for each curve that nobody can see.
fn hidden(panel: &Panel) -> Vec<String> {
    let lines = panel
        .series()
        .iter()
        .filter(|s| matches!(s.symbol, Symbol::Line | Symbol::Dashed) && s.points.len() > 2);
    let lines: Vec<&Series> = lines.filter(|s| s.label.is_some()).collect();
    let all = || lines.iter().flat_map(|s| s.points.iter());
    let reach = |i: usize| {
        let values = || all().filter_map(|p| p.get(i).copied());
        values().fold(f64::NEG_INFINITY, f64::max) - values().fold(f64::INFINITY, f64::min)
    };
    let (width, height) = (reach(0).max(1e-300), reach(1).max(1e-300));
    let on_each_other = |a: &Series, b: &Series| {
        (0..=PLACES).all(|k| {
            let at = |s: &Series| s.points.get(k * (s.points.len() - 1) / PLACES).copied();
            match (at(a), panel.is_equal()) {
                (Some(p), true) => {
                    b.points.iter().any(|q| ((p[0] - q[0]) / width).hypot((p[1] - q[1]) / height) < SAME)
                }
                (Some(p), false) => value_at(&b.points, p[0]).is_some_and(|y| near(panel, p[1], y, height)),
                (None, _) => false,
            }
        })
    };
    let mut told = Vec::new();
    for (i, under) in lines.iter().enumerate() {
        if let Some(over) = lines.iter().skip(i + 1).find(|over| on_each_other(under, over))
            && let (Some(under), Some(over)) = (&under.label, &over.label)
        {
            told.push(format!("{under} lies under {over}"));
        }
    }
    told
}

fn near(panel: &Panel, a: f64, b: f64, height: f64) -> bool {
    if panel.is_logarithmic() {
        a > 0.0 && b > 0.0 && (a / b).ln().abs() < 0.02
    } else {
        (a - b).abs() < SAME * height
    }
}

/// The value of a curve whose x rise.
fn value_at(points: &[[f64; 2]], x: f64) -> Option<f64> {
    let after = points.partition_point(|p| p[0] < x);
    let (b, a) = (points.get(after)?, points.get(after.saturating_sub(1))?);
    let span = b[0] - a[0];
    Some(if span > 0.0 { a[1] + (b[1] - a[1]) * (x - a[0]) / span } else { b[1] })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curve(slope: f64, bend: f64) -> Vec<(f64, f64)> {
        (0..200).map(|k| f64::from(k) * 0.01).map(|t| (t, slope * t + bend * t * (2.0 - t))).collect()
    }

    #[test]
    fn ends_lengths_and_what_is_hidden() {
        let time = Panel::new("speed", "t [s]", "v [m/s]")
            .with(Series::line(0, curve(1.0, 0.0)).label("a"))
            .with(Series::line(1, curve(1.0, 0.0)).label("b"))
            .with(Series::line(2, curve(2.0, 1.0)).label("c"));
        let paths = Panel::new("paths", "x [m]", "y [m]")
            .equal_scales()
            .with(Series::line(0, curve(0.0, 1.0)).label("P1"));
        let gains = Panel::new("gains", "delay [ms]", "K [1/s]")
            .with(Series::new(Symbol::Circle, 0, [(0.0, 3.0), (1.0, 5.0)]).label("D"));
        let text = panels_say(&[time, paths, gains, Panel::new("nothing", "x", "y")]);
        assert_eq!(
            text,
            "Speed at the end: a 1.99, b 1.99, c 4.00 m/s; paths, length of the way by that of the straight line: P1 1.48; gains: D 3.00 to 5.00 1/s; \
             in \"speed\" a lies under b."
        );
        assert_eq!(panels_say(&[]), "");
    }
}
