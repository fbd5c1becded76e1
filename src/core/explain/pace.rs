//! How the error fell, and what held the arm back.

use super::{Cause, RunEvidence, RunFinding, median};
use crate::control::outcome::Outcome;
use crate::report::csv_table::CsvTable;
use crate::report::numbers::significant;

/// Limits in the trace with the key of each, because the name of a limit does not tell what to change.
const LIMITS: [(&str, &str); 6] = [
    ("acceleration", "motion.max_acceleration_rad_s2_or_m_s2"),
    ("jerk", "motion.max_jerk_rad_s3_or_m_s3"),
    ("velocity", "the joints' velocity limits in the robot file"),
    ("effort", "the joints' effort limits in the robot file, motion.effort_rise_ms"),
    ("position", "the joints' ranges in the robot file: start or goal elsewhere, servo.limit_avoidance_1_s"),
    ("workspace", "[workspace]; the summary names which, safety.held_by"),
];
/// A limit holds the arm back when it acts in so large a share of the ticks in which the error falls. Chosen by hand: half of a short motion is
/// acceleration by any law.
const HELD_BACK: f64 = 0.8;
/// Measurements that tell how the error goes. Chosen by hand: a second of them.
const FEWEST: usize = 24;
/// A swing changes its direction in at least so large a share of the measurements. Chosen by hand: noise does in two thirds, one that falls in none; swings
/// of a loop take four to twenty frames.
const REVERSALS: f64 = 0.08;
/// A swing is at least so many tolerances high. Chosen by hand.
const SWING: f64 = 4.0;
/// An error that falls slower than this share of itself in a second hardly falls. Chosen by hand.
const FALLS_1_S: f64 = 0.02;

/// The feature errors with their times.
fn errors(evidence: &RunEvidence) -> Vec<(f64, f64)> {
    let table = &evidence.measurements;
    let rows = table.numbers("exposure_s").iter().zip(table.numbers("error_px"));
    rows.map(|(t, e)| (*t, *e)).filter(|(_, e)| e.is_finite()).collect()
}

/// Shares of ticks in which each limit acted, from the first motion to the settling of the error.
fn limited(trace: &CsvTable, settling_time_s: Option<f64>) -> Vec<(&'static str, &'static str, f64)> {
    let until = settling_time_s.unwrap_or(f64::INFINITY);
    let rows: Vec<usize> = (0..trace.rows())
        .filter(|row| {
            let serves = ["Servoing", "servoing"].contains(&trace.word("state", *row));
            serves && trace.number("time_s", *row) <= until
        })
        .collect();
    let share = |name: &str| {
        let column = trace.numbers(&format!("limit_{name}"));
        let acted = rows.iter().filter(|row| column.get(**row).is_some_and(|bits| *bits > 0.0)).count();
        acted as f64 / rows.len().max(1) as f64
    };
    let mut all: Vec<_> = LIMITS.into_iter().map(|(name, key)| (name, key, share(name))).collect();
    all.sort_by(|a, b| b.2.total_cmp(&a.2));
    all
}

/// What limited the speed of the run.
pub(super) fn speed(evidence: &RunEvidence) -> String {
    let latency_ms = median(evidence.measurements.numbers("exposure_to_command_us").iter().copied()) * 1e-3;
    let view = if latency_ms.is_finite() {
        format!("; views were {latency_ms:.1} ms old when used, {} a second", evidence.config.camera.rate_hz)
    } else {
        String::new()
    };
    let settled = evidence.summary.settling_time_s;
    let settled = settled.map_or(String::new(), |s| format!("settled to 2 % after {s:.2} s; "));
    match limited(&evidence.trace, evidence.summary.settling_time_s).first() {
        // Chosen by hand: below a tenth of the time a limit is no matter.
        Some((name, key, share)) if *share > 0.1 => format!(
            "{settled}the {name} limit acted in {:.0} % of the time until then ({key}){view}",
            share * 100.0
        ),
        _ => format!(
            "{settled}no limit of the arm acted for long: the law's gain sets the pace (servo.gain_1_s = {}){view}",
            gain(evidence)
        ),
    }
}

fn gain(evidence: &RunEvidence) -> String {
    let gain = toml::Value::try_from(&evidence.config.effective.servo.gain_1_s);
    gain.map_or_else(|_| "?".into(), |gain| gain.to_string())
}

pub(super) fn findings(evidence: &RunEvidence, is_explained: bool) -> Vec<RunFinding> {
    if evidence.summary.outcome != Outcome::NotConverged {
        return Vec::new();
    }
    let errors = errors(evidence);
    let late = errors.get(errors.len() / 2..).unwrap_or_default();
    if late.len() < FEWEST {
        return Vec::new();
    }
    // An arm that a limit in space holds back leaves the way of the law, and may swing by that.
    if let Some(finding) = held_by_space(evidence).or_else(|| swings(evidence, late)) {
        return vec![finding];
    }
    slow(evidence, late).into_iter().filter(|_| !is_explained).collect()
}

/// Limits in space that held the arm back for more than a twentieth of the run.
fn held_by_space(evidence: &RunEvidence) -> Option<RunFinding> {
    let RunEvidence { summary, .. } = evidence;
    let most = summary.safety.held_by.iter().max_by_key(|held| held.ticks)?;
    // Chosen by hand: what acts for less was passed by.
    (20 * most.ticks > summary.ticks).then(|| RunFinding {
        cause: Cause::HeldBySpace,
        what: format!("{} held the arm back from its way to the goal", most.limit),
        evidence: format!("it acted in {} of {} ticks, and the goal was not reached", most.ticks, summary.ticks),
        change: "[workspace]: move that limit; or another goal, or another start, from which the way does not lead there".into(),
    })
}

/// An error that goes up and down about its goal.
fn swings(evidence: &RunEvidence, late: &[(f64, f64)]) -> Option<RunFinding> {
    let tolerance = evidence.config.goal.feature_error_px;
    let (low, high) =
        late.iter().fold((f64::INFINITY, 0.0_f64), |(low, high), (_, e)| (low.min(*e), high.max(*e)));
    // Turns of more than a tenth of the whole swing, so that noise makes none.
    let least = 0.1 * (high - low);
    let (mut turns, mut rising, mut extreme) = (0, None, late.first()?.1);
    for (_, e) in late {
        let (up, down) = (e - extreme > least, extreme - e > least);
        match rising {
            Some(true) if *e > extreme => extreme = *e,
            Some(false) if *e < extreme => extreme = *e,
            None | Some(true) if down => {
                (turns, rising, extreme) = (turns + usize::from(rising.is_some()), Some(false), *e)
            }
            None | Some(false) if up => {
                (turns, rising, extreme) = (turns + usize::from(rising.is_some()), Some(true), *e)
            }
            _ => {}
        }
    }
    if (turns as f64) < REVERSALS * late.len() as f64 || high - low < SWING * tolerance {
        return None;
    }
    let span_s = late.last()?.0 - late.first()?.0;
    let latency_ms = median(evidence.measurements.numbers("exposure_to_command_us").iter().copied()) * 1e-3;
    Some(RunFinding {
        cause: Cause::GainTooHigh,
        what: "the loop swings about its goal: the gain is too high for views of that age and rate".into(),
        evidence: format!(
            "in the last {span_s:.1} s the error went between {} and {} px, and turned {turns} times; servo.gain_1_s is {}, views were {latency_ms:.0} ms old when used, \
             {} a second",
            significant(low, 3),
            significant(high, 3),
            gain(evidence),
            evidence.config.camera.rate_hz
        ),
        change:
            "servo.gain_1_s lower, by half first; servo.update = \"predict\", which bears four times as much"
                .into(),
    })
}

/// An error that falls, and had no time.
fn slow(evidence: &RunEvidence, late: &[(f64, f64)]) -> Option<RunFinding> {
    let ((t0, e0), (t1, e1)) = (*late.first()?, *late.last()?);
    let rate_1_s = (e0 / e1).ln() / (t1 - t0);
    if rate_1_s < FALLS_1_S || !rate_1_s.is_finite() {
        return None;
    }
    let tolerance = evidence.config.goal.feature_error_px;
    let needs_s = (e1 / tolerance).ln().max(0.0) / rate_1_s;
    let told = format!(
        "the error fell from {} to {} px in the last {:.1} s, and would have needed {needs_s:.1} s more",
        significant(e0, 3),
        significant(e1, 3),
        t1 - t0
    );
    let limits = limited(&evidence.trace, evidence.summary.settling_time_s);
    let held = limits.into_iter().find(|(_, _, share)| *share > HELD_BACK);
    Some(match held {
        Some((name, key, share)) => RunFinding {
            cause: Cause::Limits,
            what: format!("the {name} limit of the arm lets it move no faster"),
            evidence: format!("it acted in {:.0} % of the ticks; {told}", share * 100.0),
            change: format!("{key}; or run.duration_s longer"),
        },
        None => RunFinding {
            cause: Cause::GainTooLow,
            what: "the arm was still on its way: the law is slow, and no limit held the arm back".into(),
            evidence: format!("{told}; servo.gain_1_s is {}", gain(evidence)),
            change: "servo.gain_1_s higher, or run.duration_s longer".into(),
        },
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_limit_in_space_that_sets_the_pace_is_named() {
        let mut text = "tick,time_s,state,limit_velocity,limit_workspace\n".to_owned();
        for k in 0..100 {
            text += &format!("{k},{:.3},servoing,{},63\n", f64::from(k) * 1e-3, u8::from(k < 20));
        }
        let limits = limited(&CsvTable::parse(&text), None);
        assert_eq!((limits[0].0, limits[0].2), ("workspace", 1.0));
        assert_eq!((limits[1].0, limits[1].2), ("velocity", 0.2));
    }
}
