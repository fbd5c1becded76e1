//! What became of the measurements? Those that control refused tell nothing of cell and loop, and where it refused all that came they are why a run failed.

use super::{Cause, RunEvidence, RunFinding, median};
use crate::control::outcome::Outcome;
use crate::report::csv_table::CsvTable;

/// Refused measurements at the end of a run that explain its failure. Chosen by hand: the arm holds after 200 ms, five frames at 25 Hz; twice of it.
const REFUSED: usize = 10;

fn is_used(table: &CsvTable, row: usize) -> bool {
    matches!(table.word("verdict", row), "used" | "used_from_future")
}

/// The measurements that the law used; all of a table that does not tell.
pub(super) fn used(table: &CsvTable) -> CsvTable {
    table.rows_where(|row| is_used(table, row) || table.word("verdict", row).is_empty())
}

/// How old views were when they were used, ms; NaN where that is not known.
pub(super) fn age_ms(evidence: &RunEvidence) -> f64 {
    median(used(&evidence.measurements).numbers("exposure_to_command_us").iter().copied()) * 1e-3
}

/// Measurements that found the target and were refused for their stamps, or because control had them.
pub(super) fn finding(evidence: &RunEvidence) -> Option<RunFinding> {
    let (table, summary) = (&evidence.measurements, &evidence.summary);
    if summary.outcome != Outcome::NotConverged {
        return None;
    }
    let rows = table.rows();
    let end = (0..rows).rev().find(|row| is_used(table, *row)).map_or(0, |last| last + 1);
    let i = &summary.intake;
    let kinds = [
        ("refused_from_future", i.refused_from_future),
        ("too_old", i.refused_too_old),
        ("not_newer", i.refused_not_newer),
    ];
    let (word, count) = kinds.into_iter().max_by_key(|(_, count)| *count)?;
    let refused: Vec<usize> = (0..rows).filter(|row| table.word("verdict", *row) == word).collect();
    let at_end = refused.iter().filter(|row| **row >= end).count();
    let explains = at_end > REFUSED && 2 * at_end > rows - end;
    let first = refused.first().filter(|_| explains || 2 * refused.len() > rows)?;
    let of = |name: &str| median(refused.iter().map(|row| table.number(name, *row)));
    let age_ms = of("exposure_to_command_us") * 1e-3;
    let last_s = used(table).numbers("exposure_s").iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let stamps = "camera.stamp_offset_ms (`vservo calibrate latency` measures it), camera.latency_ms; where it began in the midst of the run, see to the camera's clock";
    let (cause, what, told, change) = match word {
        "refused_from_future" => (
            Cause::WrongStamps,
            "exposure stamps lie too far in the future to be used",
            format!("they lay {:.0} ms ahead of the ticks that took them", -age_ms),
            stamps,
        ),
        "too_old" => (
            Cause::WrongStamps,
            "exposures are too old to be used",
            format!("they were {age_ms:.0} ms old"),
            stamps,
        ),
        // New stamps on what was seen before.
        _ if of("exposure_s") > last_s => (
            Cause::RepeatedViews,
            "the camera gives one image again and again: new stamps, and the same to a thousandth of a pixel while the arm moves",
            format!("their stamps go on after the last used one, {last_s:.3} s"),
            "no key: see to the camera, its driver and the program that gives its frames",
        ),
        _ => (
            Cause::RepeatedViews,
            "measurements come again, or after newer ones: control has had their exposures",
            format!(
                "none of them was exposed after the last used one, {last_s:.3} s; they were {age_ms:.0} ms old"
            ),
            "see to vision, to the camera's clock, which must not stand or go back, and to whatever else sends on their channels",
        ),
    };
    Some(RunFinding {
        cause,
        what: what.into(),
        evidence: format!(
            "{count} of {} measurements were refused for that, the first one at {:.3} s; {told}",
            summary.measurements,
            table.number("taken_s", *first)
        ),
        change: change.into(),
    })
}

#[cfg(test)]
mod tests {
    use super::super::tests::{evidence, failed};
    use super::*;

    /// Measurements at 25 Hz of which control uses the first 13, and refuses the rest; each is exposed by `exposure_s` of its time.
    fn refused(word: &str, exposure_s: impl Fn(f64) -> f64) -> RunEvidence {
        let mut text = "exposure_s,taken_s,status,verdict,error_px,exposure_to_command_us\n".to_owned();
        for k in 0..200 {
            let taken_s = 0.02 + 0.04 * f64::from(k);
            let (exposed_s, word) =
                if k < 13 { (taken_s - 0.02, "used") } else { (exposure_s(taken_s), word) };
            text += &format!("{exposed_s},{taken_s},Found,{word},79.4,{}\n", 1e6 * (taken_s - exposed_s));
        }
        let mut evidence = failed(evidence("ur5", "", &text), "");
        let intake = &mut evidence.summary.intake;
        match word {
            "not_newer" => intake.refused_not_newer = 187,
            _ => intake.refused_from_future = 187,
        }
        evidence.summary.measurements = 200;
        evidence
    }

    #[test]
    fn measurements_that_were_refused_are_the_first_cause() {
        let future = refused("refused_from_future", |taken_s| taken_s + 0.18);
        let found = super::super::explain(&future).findings;
        assert_eq!(found.len(), 1, "{found:?}");
        assert_eq!(found[0].cause, Cause::WrongStamps);
        assert!(found[0].evidence.contains("187 of 200") && found[0].evidence.contains("180 ms ahead"));
        for (exposure_s, word) in [
            ((|taken_s| taken_s - 0.02) as fn(f64) -> f64, "one image again"),
            (|_| 0.48, "come again"),
            (|_| 0.44, "come again"),
        ] {
            let found = super::super::explain(&refused("not_newer", exposure_s)).findings;
            assert_eq!(found.len(), 1, "{found:?}");
            assert!(found[0].cause == Cause::RepeatedViews && found[0].what.contains(word), "{found:?}");
        }
    }

    #[test]
    fn views_that_were_refused_have_no_part_in_the_age() {
        let stale = refused("not_newer", |_| 0.48);
        assert!((age_ms(&stale) - 20.0).abs() < 1e-6);
        assert_eq!(used(&stale.measurements).rows(), 13);
        assert_eq!(used(&CsvTable::parse("error_px\n1\n2\n")).rows(), 2, "a table without verdicts");
    }
}
