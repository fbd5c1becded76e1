//! How the error fell, and what held the arm back.

use super::{Cause, RunEvidence, RunFinding, intake, median};
use crate::control::lifecycle::Request;
use crate::control::outcome::Outcome;
use crate::control::trace::Event;
use crate::mission::residual::{AT_ITS_END, SCATTER_SHARE, falls_no_more, stands};
use crate::report::csv_table::CsvTable;
use crate::report::numbers::significant;
use crate::report::statistics::describe;

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
/// And comes below this share of its height, because it is about the goal. Measured: those of gains that are too high come below 0.04; one of an arm that is stretched out to 0.95.
const SWING_LOW: f64 = 0.5;
/// An error is noise while it is less than so many times the misfit of the points. Measured: at rest the largest of a hundred errors of four points is 4 to 5 times it;
/// swings are 1000 times and more.
const NOISE: f64 = 8.0;
/// A tolerance that suits is this many times the largest error of a scatter. Chosen by hand: a goal is held over many measurements.
const ABOVE_SCATTER: f64 = 1.5;
/// An error that falls slower than this share of itself in a second hardly falls. Chosen by hand.
const FALLS_1_S: f64 = 0.02;

/// The feature errors with their times.
fn errors(evidence: &RunEvidence) -> Vec<(f64, f64)> {
    let table = intake::used(&evidence.measurements);
    let rows = table.numbers("exposure_s").iter().zip(table.numbers("error_px"));
    rows.map(|(t, e)| (*t, *e)).filter(|(_, e)| e.is_finite()).collect()
}

/// Those of the second half, where there are enough.
fn late_errors(evidence: &RunEvidence) -> Option<Vec<(f64, f64)>> {
    let mut errors = errors(evidence);
    let late = errors.split_off(errors.len() / 2);
    (late.len() >= FEWEST).then_some(late)
}

/// The least and the largest error.
fn range(errors: &[(f64, f64)]) -> (f64, f64) {
    errors.iter().fold((f64::INFINITY, 0.0), |(low, high), (_, e)| (e.min(low), e.max(high)))
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
    let latency_ms = intake::age_ms(evidence);
    let view = if latency_ms.is_finite() {
        format!("; views were {latency_ms:.1} ms old when used, {} a second", evidence.config.camera.rate_hz)
    } else {
        String::new()
    };
    let settled_s = evidence.summary.settling_time_s;
    let settled = settled_s.map_or(String::new(), |at_s| {
        format!("settled to 2 % after {:.2} s; ", at_s - started_s(evidence, at_s))
    });
    let until_then = if settled_s.is_some() { " until then" } else { "" };
    match limited(&evidence.trace, evidence.summary.settling_time_s).first() {
        // Chosen by hand: below a tenth of the time a limit is no matter.
        Some((name, key, share)) if *share > 0.1 => format!(
            "{settled}the {name} limit acted in {:.0} % of the time{until_then} ({key}){view}",
            share * 100.0
        ),
        _ => format!(
            "{settled}no limit of the arm acted for long: the law's gain sets the pace (servo.gain_1_s = {}){view}",
            gain(evidence)
        ),
    }
}

/// When a client asked for the start that led to the settling at `at_s`, s; the begin of a run that started by itself.
fn started_s(evidence: &RunEvidence, at_s: f64) -> f64 {
    let start = describe(Event::Requested(Request::Start));
    let events = evidence.summary.safety.events.iter().rev();
    let mut starts = events.filter(|event| event.event == start && event.time_s <= at_s);
    starts.next().map_or(0.0, |event| event.time_s)
}

fn gain(evidence: &RunEvidence) -> String {
    let gain = toml::Value::try_from(&evidence.config.effective.servo.gain_1_s);
    gain.map_or_else(|_| "?".into(), |gain| gain.to_string())
}

pub(super) fn findings(evidence: &RunEvidence, is_explained: bool) -> Vec<RunFinding> {
    if evidence.summary.outcome != Outcome::NotConverged {
        return Vec::new();
    }
    let Some(late) = late_errors(evidence) else { return Vec::new() };
    // An arm that a limit in space, or its own end, holds back leaves the way of the law, and may swing by that.
    let held = held_by_space(evidence).or_else(|| at_its_end(evidence, &late));
    if let Some(finding) = held.or_else(|| below_scatter(evidence)).or_else(|| swings(evidence, &late)) {
        return vec![finding];
    }
    slow(evidence, &late).into_iter().filter(|_| !is_explained).collect()
}

/// An arm that the end of a joint's range or a singular posture holds before its goal.
fn at_its_end(evidence: &RunEvidence, late: &[(f64, f64)]) -> Option<RunFinding> {
    let is_told = evidence.summary.reason == AT_ITS_END;
    let ((t0, _), (_, e1)) = (*late.first()?, *late.last()?);
    let trace = &evidence.trace;
    let serves = |row: usize| {
        ["Servoing", "servoing"].contains(&trace.word("state", row)) && trace.number("time_s", row) >= t0
    };
    let rows: Vec<usize> = (0..trace.rows()).filter(|row| serves(*row)).collect();
    let share = |name: &str| {
        let acted = rows.iter().filter(|row| trace.number(name, **row) > 0.0).count();
        acted as f64 / rows.len().max(1) as f64
    };
    let (position, singularity) = (share("limit_position"), share("limit_singularity"));
    let stays = falls_1_s(late).is_none_or(|rate_1_s| rate_1_s < FALLS_1_S);
    if !(is_told || stays && position.max(singularity) > HELD_BACK) {
        return None;
    }
    let (what, limit, acted) = if position > singularity {
        ("a joint is at the end of its range", "the position limit", position)
    } else {
        (
            "the arm is stretched out, or in another singular posture",
            "the singular posture near by",
            singularity,
        )
    };
    Some(RunFinding {
        cause: Cause::AtItsEnd,
        what: format!("{what}, and cannot go on to the goal"),
        evidence: format!(
            "{limit} acted in {:.0} % of the ticks since {t0:.1} s; {} px remained",
            acted * 100.0,
            significant(e1, 3)
        ),
        change: "another goal (servo.desired) or another start, or target and arm nearer together; `vservo check` tells what is within reach".into(),
    })
}

/// A tolerance of the goal that is below the scatter of an error that falls no more.
pub(super) fn below_scatter(evidence: &RunEvidence) -> Option<RunFinding> {
    let late = late_errors(evidence).filter(|_| evidence.summary.outcome == Outcome::NotConverged)?;
    let misfit_px =
        median(intake::used(&evidence.measurements).numbers("reprojection_rms_px").iter().copied());
    let (low, high) = range(&late);
    let tolerance = evidence.config.goal.feature_error_px;
    if high > NOISE * misfit_px || low > SCATTER_SHARE * high || high < tolerance || misfit_px.is_nan() {
        return None;
    }
    let suits = significant(ABOVE_SCATTER * high, 2);
    Some(RunFinding {
        cause: Cause::FineTolerance,
        what: "the goal's tolerance is below what the measurements scatter by: the arm is at its goal as well as they tell".into(),
        evidence: format!(
            "in the second half of the run the error went between {} and {} px, of points that fit their target to {} px; goal.feature_error_px is {tolerance}",
            significant(low, 3),
            significant(high, 3),
            significant(misfit_px, 2)
        ),
        change: format!(
            "goal.feature_error_px = {suits}; a finer one needs a view with less noise: light, focus, a target that is larger in the image or has more points"
        ),
    })
}

/// The share of itself by which an error falls in a second, 1/s; `None` where that cannot be told.
fn falls_1_s(late: &[(f64, f64)]) -> Option<f64> {
    let ((t0, e0), (t1, e1)) = (*late.first()?, *late.last()?);
    Some((e0 / e1).ln() / (t1 - t0)).filter(|rate_1_s| rate_1_s.is_finite())
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
    if stands(&evidence.summary.reason) {
        return None;
    }
    let tolerance = evidence.config.goal.feature_error_px;
    let (low, high) = range(late);
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
    if (turns as f64) < REVERSALS * late.len() as f64
        || high - low < SWING * tolerance
        || low > SWING_LOW * high
    {
        return None;
    }
    let span_s = late.last()?.0 - late.first()?.0;
    let latency_ms = intake::age_ms(evidence);
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
    let rate_1_s = falls_1_s(late).filter(|rate_1_s| *rate_1_s >= FALLS_1_S)?;
    if falls_no_more(&evidence.summary.reason) {
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
    use super::super::tests::{evidence, failed};
    use super::*;
    use crate::report::summary::SafetyEvent;

    const TIME_IS_OVER: &str = "run.duration_s is over before the goal was reached";

    /// A UR5 that serves for 8 s and did not converge: every hundredth tick, measurements at 25 Hz of points that fit to 1.5e-3 px.
    fn served(reason: &str, limits: [u8; 2], error_px: impl Fn(f64) -> f64) -> RunEvidence {
        let mut trace = "time_s,state,limit_acceleration,limit_singularity\n".to_owned();
        let mut table = "exposure_s,taken_s,status,verdict,error_px,reprojection_rms_px\n".to_owned();
        for k in 0..80 {
            trace += &format!("{:.1},servoing,{},{}\n", 0.1 * f64::from(k), limits[0], limits[1]);
        }
        for k in 0..200 {
            let t = 0.04 * f64::from(k);
            table += &format!("{t:.3},{:.3},Found,used,{},1.5e-3\n", t + 0.02, error_px(t));
        }
        failed(evidence("ur5", &trace, &table), reason)
    }

    #[track_caller]
    fn causes(evidence: &RunEvidence) -> Vec<Cause> {
        super::super::explain(evidence).findings.iter().map(|finding| finding.cause).collect()
    }

    #[test]
    fn an_arm_that_is_stretched_out_is_no_slow_one() {
        let creeps = |t: f64| 17.7 + 36.0 * (-0.5 * t).exp();
        assert_eq!(causes(&served(AT_ITS_END, [63, 63], creeps)), [Cause::AtItsEnd]);
        let about_75 = |t: f64| 75.0 + 2.0 * (15.0 * t).sin();
        assert_eq!(causes(&served(TIME_IS_OVER, [63, 63], about_75)), [Cause::AtItsEnd]);
        assert_eq!(causes(&served(TIME_IS_OVER, [63, 0], about_75)), [], "that is not about its goal");
        let slow = |t: f64| 80.0 * (-0.2 * t).exp();
        assert_eq!(causes(&served(TIME_IS_OVER, [63, 63], slow)), [Cause::Limits]);
        let about_goal = |t: f64| 4.0 + 3.9 * (15.0 * t).sin();
        assert_eq!(causes(&served(TIME_IS_OVER, [0, 0], about_goal)), [Cause::GainTooHigh]);
    }

    #[test]
    fn a_tolerance_below_the_noise_is_told_alone() {
        use crate::mission::residual::{BELOW_SCATTER, OUT_OF_REACH};
        let noise = |t: f64| 5e-3 + 3e-3 * (15.0 * t).sin();
        for reason in [BELOW_SCATTER, OUT_OF_REACH, TIME_IS_OVER] {
            let mut evidence = served(reason, [0, 0], noise);
            evidence.config.goal.feature_error_px = 1e-4;
            assert_eq!(causes(&evidence), [Cause::FineTolerance], "{reason}");
            let change = below_scatter(&evidence).unwrap().change;
            assert!(change.starts_with("goal.feature_error_px = 0.012;"), "{change}");
        }
        let steady = served(OUT_OF_REACH, [0, 0], |t| 0.11 + 1e-3 * (15.0 * t).sin());
        assert_eq!(causes(&steady), [Cause::WrongLens]);
    }

    #[test]
    fn settling_counts_from_the_request_to_start() {
        let mut evidence = served(TIME_IS_OVER, [0, 0], |_| 0.1);
        evidence.summary.settling_time_s = Some(7.5);
        assert!(speed(&evidence).starts_with("settled to 2 % after 7.50 s"), "{}", speed(&evidence));
        let events = [(2.0, "start on request"), (6.5, "start on request"), (7.8, "start on request")];
        evidence.summary.safety.events =
            events.map(|(time_s, event)| SafetyEvent { time_s, event: event.into() }).into();
        assert!(speed(&evidence).starts_with("settled to 2 % after 1.00 s"), "{}", speed(&evidence));
    }

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
