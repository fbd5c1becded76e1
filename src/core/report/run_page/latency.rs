//! Where the time goes: latencies of the measurements, stage by stage, and how late ticks were.
//!
//! The numbers here are layout, or keep logarithms and divisions from zero and infinity; they were chosen by hand.

use super::record::RunRecord;
use crate::report::chart::{Panel, Series, Symbol, figure_svg, spans_decades};
use crate::report::numbers::{counted, significant};
use crate::report::page::{figure, heading};
use crate::time::TICK;

/// Column of `measurements.csv`, and what it is.
const STAGES: [(&str, &str); 5] = [
    ("exposure_to_command_us", "exposure to command, all of it"),
    ("exposure_to_frame_us", "exposure to hand-over"),
    ("frame_to_vision_us", "hand-over to vision"),
    ("vision_us", "vision"),
    ("measurement_to_command_us", "measurement to command"),
];
/// Most bars of a histogram.
const MAX_BARS: usize = 40;
/// Steps of a decade in the histogram of ticks: 1000 us is an edge.
const STEPS: f64 = 20.0;

/// A value of sorted ones that a share of all does not exceed.
fn quantile(sorted: &[f64], share: f64) -> f64 {
    let at = ((share * sorted.len() as f64).ceil() as usize).clamp(1, sorted.len().max(1)) - 1;
    sorted.get(at).copied().unwrap_or(f64::NAN)
}

/// A time in the unit in which it has few digits.
fn time(us: f64, digits: usize) -> String {
    if us.abs() >= 1000.0 {
        format!("{} ms", significant(us * 1e-3, digits))
    } else {
        format!("{} us", significant(us, digits))
    }
}

/// Edges and counts of bars: `(edge, count)`, the last edge with a count of zero.
fn bars(sorted: &[f64], log: bool) -> Vec<(f64, f64)> {
    let (Some(low), Some(high)) = (sorted.first(), sorted.last()) else { return Vec::new() };
    let count = ((sorted.len() as f64).sqrt() as usize).clamp(8, MAX_BARS);
    // All alike: one bar, with room beside it.
    let same = high - low <= 1e-6 * high.abs();
    let (count, log) = if same { (1, false) } else { (count, log) };
    let (low, high) = if same { (low * 0.99 - 1e-3, high * 1.01 + 1e-3) } else { (*low, *high) };
    let edge = |i: usize| {
        let share = i as f64 / count as f64;
        if log { low * (high / low).powf(share) } else { low + share * (high - low) }
    };
    let below = |i: usize| if i == count { sorted.len() } else { sorted.partition_point(|v| *v < edge(i)) };
    let mut all: Vec<_> =
        (0..count).map(|i| (edge(i), (below(i + 1) - if i == 0 { 0 } else { below(i) }) as f64)).collect();
    all.push((edge(count), 0.0));
    all
}

/// The figure of latencies.
pub(super) fn latencies(r: &RunRecord) -> String {
    const TITLE: &str = "Latencies of the measurements";
    let mut panels = Vec::new();
    let mut says = String::new();
    for (column, what) in STAGES {
        let mut values: Vec<f64> =
            r.measurements.numbers(column).iter().copied().filter(|v| v.is_finite()).collect();
        if values.is_empty() {
            continue;
        }
        values.sort_unstable_by(f64::total_cmp);
        let log = spans_decades(values.iter().copied());
        let (half, most) = (quantile(&values, 0.5), values.last().copied().unwrap_or(0.0));
        let unit_ms = most >= 2000.0;
        let scale = if unit_ms { 1e-3 } else { 1.0 };
        let all_alike = values.first().is_some_and(|least| most - least < 0.0015);
        let told = if all_alike {
            format!("always {}", time(half, 4))
        } else {
            format!(
                "median {}, p99 {}, largest {}",
                time(half, 3),
                time(quantile(&values, 0.99), 3),
                time(most, 3)
            )
        };
        if says.is_empty() {
            says = format!(
                "{}: {told}, of {}",
                super::joints::capital(what),
                counted(values.len() as u64, "measurement")
            );
        }
        let scaled = bars(&values, log).into_iter().map(|(edge, count)| (edge * scale, count));
        let panel = Panel::new(
            super::joints::capital(what),
            if unit_ms { "ms" } else { "us" },
            format!("measurements; {told}"),
        )
        .with(Series::new(Symbol::Bars, 0, scaled));
        panels.push(match (all_alike, log) {
            (true, _) => panel.x_range(0.0, 1.25 * most * scale),
            (false, true) => panel.log_x(),
            (false, false) => panel,
        });
    }
    if panels.is_empty() {
        return heading(TITLE, "No measurement was used by a command, so no latency is known.");
    }
    if r.simulated_time {
        says += "; in simulated time only what lies within one clock is known, and the whole is what the camera was told to take";
    }
    let note = "Each bar counts the measurements between its edges; the numbers above come from stamps to a nanosecond, not from the bars.";
    let columns = if panels.len() == 5 { 3 } else { panels.len().min(3) };
    figure(TITLE, &format!("{says}."), note, |width| figure_svg(&panels, columns, width, TITLE))
}

/// The histogram of ticks in steps that can be seen: edges and counts.
fn steps(tick_times: &[(f64, u64)]) -> Vec<(f64, f64)> {
    // A bucket lies below its upper edge, which belongs to the next one.
    let step = |edge_us: f64| ((edge_us * 0.9999).max(0.01).log10() * STEPS).floor() as i32;
    let (Some(first), Some(last)) = (tick_times.first(), tick_times.last()) else { return Vec::new() };
    let (first, last) = (step(first.0), step(last.0));
    let count = |k: i32| tick_times.iter().filter(|b| step(b.0) == k).map(|b| b.1 as f64).sum::<f64>();
    let edge = |k: i32| 10f64.powf(f64::from(k) / STEPS);
    (first..=last).map(|k| (edge(k), count(k))).chain([(edge(last + 1), 0.0)]).collect()
}

/// The upper edge below which a share of all ticks lies, us.
fn below(tick_times: &[(f64, u64)], share: f64) -> f64 {
    let all: u64 = tick_times.iter().map(|b| b.1).sum();
    let wanted = share * all as f64;
    let mut seen = 0.0;
    for (edge, count) in tick_times {
        seen += *count as f64;
        if seen >= wanted {
            return *edge;
        }
    }
    f64::NAN
}

/// The figure of ticks.
pub(super) fn jitter(r: &RunRecord) -> String {
    const TITLE: &str = "Jitter: deadline to command of every tick";
    let ticks: u64 = r.tick_times.iter().map(|b| b.1).sum();
    if r.simulated_time || ticks == 0 {
        let why = if r.simulated_time {
            "Time was simulated: ticks had no deadline that could be missed."
        } else {
            "No tick was counted."
        };
        return heading(TITLE, why);
    }
    let limit = TICK.as_us();
    let missed = match r.missed_deadlines {
        0 => "none missed its deadline".to_owned(),
        missed => format!("{missed} missed their deadline: the next command came a millisecond late or more"),
    };
    // The edges of buckets are 3 % apart: two digits.
    let says = format!(
        "Half of {ticks} ticks had their command within {}, 99 % within {}, 99.9 % within {}, all within {}; {missed}.",
        time(below(&r.tick_times, 0.5), 2),
        time(below(&r.tick_times, 0.99), 2),
        time(below(&r.tick_times, 0.999), 2),
        time(below(&r.tick_times, 1.0), 2),
    );
    let bars = steps(&r.tick_times);
    let most = bars.iter().map(|b| b.1).fold(1.0, f64::max);
    let panel = Panel::new("", "us", "ticks")
        .log_x()
        .log_y()
        .with(Series::new(Symbol::Bars, 0, bars.iter().copied()).label("ticks"))
        .with(
            Series::new(Symbol::Limit, 0, [(limit, 0.7), (limit, most)]).label("deadline of the next tick"),
        );
    let note = "Counted in buckets 3 % wide, drawn in steps of 12 %; skipped ticks are counted with the command that came instead of theirs.";
    figure(TITLE, &says, note, |width| figure_svg(std::slice::from_ref(&panel), 1, width, TITLE))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::csv_table::CsvTable;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn bars_count_every_value_once(mut values in prop::collection::vec(0.001..1e6f64, 1..300), log in any::<bool>()) {
            values.sort_unstable_by(f64::total_cmp);
            let bars = bars(&values, log);
            prop_assert_eq!(bars.iter().map(|b| b.1).sum::<f64>(), values.len() as f64);
            prop_assert!(bars.windows(2).all(|w| w[0].0 < w[1].0));
        }

        #[test]
        fn steps_count_every_tick_once_with_an_edge_at_1_ms(edges in prop::collection::btree_set(1u32..40_000_000, 1..50)) {
            let buckets: Vec<(f64, u64)> = edges.iter().map(|ns| (f64::from(*ns) * 1e-3, 3)).collect();
            let steps = steps(&buckets);
            prop_assert_eq!(steps.iter().map(|s| s.1).sum::<f64>(), 3.0 * buckets.len() as f64);
            let late: u64 = buckets.iter().filter(|b| b.0 > 1000.0 * 1.0001).map(|b| b.1).sum();
            let drawn: f64 = steps.iter().filter(|s| s.0 > 999.0).map(|s| s.1).sum();
            prop_assert_eq!(drawn, late as f64);
        }
    }

    #[test]
    fn sentences_have_the_digits_that_they_are_worth() {
        let r = RunRecord {
            tick_times: vec![(7.63, 900), (61.04, 99), (1062.5, 1)],
            missed_deadlines: 1,
            measurements: CsvTable::parse(
                "exposure_to_command_us,vision_us\n20000.0004,120.1\n20000.0,330.7\n",
            ),
            ..RunRecord::default()
        };
        let jitter = jitter(&r);
        assert!(
            jitter.contains(
                "within 7.6 us, 99 % within 61 us, 99.9 % within 61 us, all within 1.1 ms; 1 missed"
            ),
            "{jitter}"
        );
        let latencies = latencies(&r);
        assert!(latencies.contains("always 20.00 ms, of 2 measurements."), "{latencies}");
        assert!(latencies.contains("median 120 us, p99 331 us, largest 331 us"), "{latencies}");
        assert!(super::jitter(&RunRecord { simulated_time: true, ..r }).contains("Time was simulated"));
    }
}
