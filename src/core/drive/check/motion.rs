//! Rules about the arm's motion: it stands when it is held, and follows when it is moved.
//!
//! A joint that was commanded `q_r(t)` and answers `q(t)` is fitted by `q(t) = b + g q_r(t - tau)`: for each lag `tau` of a grid the least squares give `b`, `g`
//! and what is left; the lag with the least rest is the drive's. `g` tells sign and units, the rest tells whether the curve is the same. Reported
//! velocities are fitted by `c` times the difference of positions over 20 ms.

use super::log::{DriveLog, LoggedPhase};
use super::plan::PhaseKind;
use super::rule::{DriveRule, TrialFindings};
use crate::messages::{DriveStateMsg, MAX_JOINTS, drive_flag};
use crate::time::{MonoNs, SpanNs, TICK};

type Timed = (MonoNs, DriveStateMsg);

/// Strokes within which a held joint stands: 2 mrad. Chosen by hand: encoders and control loops move less, an arm that sinks moves more in half a second.
pub(super) const STANDS: f64 = 0.07;
/// Strokes a second within which a reported velocity is one of rest: 0.01 rad/s. Chosen by hand: noise of real drives is a tenth of that.
const RESTS: f64 = 0.33;
/// Lags that are looked for, and their step. Chosen by hand: servo.lead_ms beyond a quarter of a second would be another kind of drive; before zero an arm moves
/// before it is commanded, which only stamps can do.
const LAGS_MS: std::ops::RangeInclusive<i64> = -20..=250;
/// An arm that moves so much before its command has wrong stamps. Chosen by hand: rounding of periods is a millisecond or two.
const BEFORE_MS: i64 = -4;
/// Bounds of the gain. Chosen by hand: a loop without integral part leaves some hundredths, other units are far off.
const GAIN: std::ops::RangeInclusive<f64> = 0.9..=1.1;
/// Bounds of the factor of reported velocities. Chosen by hand: a filter takes some hundredths at this slow motion.
const VELOCITY_GAIN: std::ops::RangeInclusive<f64> = 0.8..=1.25;
/// What may be left of a motion, as a share of the stroke (root of the mean square), and of a velocity. Chosen by hand: friction leaves a twentieth.
const LEFT: f64 = 0.1;
const VELOCITY_LEFT: f64 = 0.3;
/// A joint that moves by less, as a share of what was commanded, does not move, and others may move by as much. Chosen by hand: coupling is a hundredth.
const MOVES: f64 = 0.2;
/// Time over which positions are differenced, ns. Chosen by hand: a sixtieth of the motion, and two states at 125 Hz.
const DIFFERENCE: SpanNs = SpanNs(20_000_000);
/// States of one motion that are fitted at most. Chosen by hand: more only take time.
const FITTED: usize = 400;
/// Fewer states of a motion tell nothing. Chosen by hand: 125 Hz give 180.
const FEWEST: usize = 20;
/// A motion in which commands or states paused for longer is not judged. Chosen by hand: an arm that goes on meanwhile is off by a sixth of its stroke, and the rule
/// about pauses is another one.
pub(super) const PAUSE: SpanNs = SpanNs(50_000_000);
/// Degrees in a radian, 180/pi, to tell one unit from the other; a tenth of it would do, since a gain is compared within a tenth.
const DEGREES: f64 = 57.3;

fn joint(values: &[f64; MAX_JOINTS], j: usize) -> f64 {
    values.get(j).copied().unwrap_or(f64::NAN)
}

fn range(states: &[Timed], j: usize) -> f64 {
    let values = states.iter().map(|(_, s)| joint(&s.q, j));
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v: f64| (l.min(v), h.max(v)));
    (high - low).max(0.0)
}

/// Rest at the start, and holding.
pub(super) fn standing(log: &DriveLog, findings: &mut TrialFindings) {
    if let Some(answer) = log.initial() {
        let moving =
            log.arm.joints.iter().zip(&answer.state.qd).zip(1..).find_map(|((facts, qd), number)| {
                (qd.abs() > RESTS * facts.stroke()).then(|| {
                    format!("joint {number} ({}) moves with {qd:.4} when it answers START", facts.name)
                })
            });
        findings.say(DriveRule::Rest, moving, "yes");
    }
    let (mut broken, mut most, mut tested) = (None, (0.0_f64, 0.0_f64), false);
    let mut first = true;
    for phase in log.phases_of(|kind| kind == PhaseKind::Hold) {
        // What was moved before has settled; what is held for the first time finds its place.
        let states = log.states_within(phase.from, phase.to);
        let begins_anew = std::mem::replace(&mut first, false);
        let [_, .., _] = states.as_slice() else { continue };
        tested = true;
        for (j, facts) in log.arm.joints.iter().enumerate() {
            let moved = range(&states, j) / facts.stroke();
            let mean = states.iter().map(|(_, s)| joint(&s.qd, j)).sum::<f64>() / states.len() as f64;
            let speed = mean.abs() / facts.stroke();
            most = (most.0.max(moved * facts.stroke()), most.1.max(mean.abs()));
            let when = if begins_anew { "after START" } else { "after the motion" };
            if !(moved <= STANDS) {
                broken.get_or_insert(format!(
                    "joint {} ({}) drifts by {:.4} {when}",
                    j + 1,
                    facts.name,
                    moved * facts.stroke()
                ));
            } else if !(speed <= RESTS) {
                broken.get_or_insert(format!(
                    "joint {} ({}) stands and reports {mean:.4} {when}",
                    j + 1,
                    facts.name
                ));
            }
        }
    }
    if tested {
        let measured = format!("within {:.1e}, reported velocities {:.1e} in the mean", most.0, most.1);
        findings.say_in_mode(DriveRule::Hold, broken, measured);
    }
}

/// A fit of one joint's motion.
#[derive(Debug, Clone, Copy)]
struct Fit {
    lag_ms: i64,
    gain: f64,
    /// Root of the mean square of what is left.
    left: f64,
}

/// The positions of one joint that were commanded, as a function of time.
struct CommandedCurve {
    times: Vec<MonoNs>,
    q_r: Vec<f64>,
}

impl CommandedCurve {
    fn of(log: &DriveLog, j: usize, from: MonoNs, to: MonoNs) -> Self {
        let ordinary = |flags: u32| flags & (drive_flag::START | drive_flag::LAST) == 0;
        let span = |stamp: MonoNs| stamp >= from && stamp <= to;
        let sent = log.sent.iter().map(|s| &s.command).filter(|c| ordinary(c.flags) && span(c.stamp));
        let (times, q_r) = sent.map(|c| (c.stamp, joint(&c.q_r, j))).unzip();
        Self { times, q_r }
    }

    fn at(&self, t: MonoNs) -> f64 {
        let next = self.times.partition_point(|time| *time <= t);
        let pair = |i: usize| Some((*self.times.get(i)?, *self.q_r.get(i)?));
        match (next.checked_sub(1).and_then(pair), pair(next)) {
            (Some((t0, a)), Some((t1, b))) => a + (b - a) * (t - t0).as_s() / (t1 - t0).as_s(),
            (Some((_, only)), None) | (None, Some((_, only))) => only,
            (None, None) => f64::NAN,
        }
    }
}

fn fit(commanded: &CommandedCurve, states: &[Timed], j: usize) -> Option<Fit> {
    let step = states.len().div_ceil(FITTED).max(1);
    let samples: Vec<(MonoNs, f64)> =
        states.iter().step_by(step).map(|(t, s)| (*t, joint(&s.q, j))).collect();
    let n = samples.len() as f64;
    let mut best: Option<Fit> = None;
    for lag_ms in LAGS_MS {
        let (mut x, mut y, mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for (t, q) in &samples {
            let r = commanded.at(*t + SpanNs(-lag_ms * TICK.0));
            (x, y) = (x + r, y + q);
            (xx, xy, yy) = (xx + r * r, xy + r * q, yy + q * q);
        }
        let (var_x, cov, var_y) = (xx / n - x * x / n / n, xy / n - x * y / n / n, yy / n - y * y / n / n);
        if var_x > 0.0 {
            let gain = cov / var_x;
            let left = (var_y - gain * cov).max(0.0).sqrt();
            if best.is_none_or(|b| left < b.left) {
                best = Some(Fit { lag_ms, gain, left });
            }
        }
    }
    best
}

/// The factor of reported velocities against differences of positions, and what is left as a share of them.
fn velocity(states: &[Timed], j: usize) -> Option<(f64, f64)> {
    let (mut dd, mut dv, mut vv) = (0.0, 0.0, 0.0);
    let mut begin = 0;
    for (end, (t1, last)) in states.iter().enumerate() {
        while states.get(begin + 1).is_some_and(|(t0, _)| *t1 - *t0 >= DIFFERENCE) {
            begin += 1;
        }
        let Some((t0, first)) = states.get(begin).filter(|(t0, _)| *t1 - *t0 >= DIFFERENCE) else { continue };
        // After a pause of the stream a difference is of another time than the velocity.
        if (*t1 - *t0).0 > 2 * DIFFERENCE.0 {
            continue;
        }
        let d = (joint(&last.q, j) - joint(&first.q, j)) / (*t1 - *t0).as_s();
        let between = states.get(begin..=end).unwrap_or_default();
        let v = between.iter().map(|(_, s)| joint(&s.qd, j)).sum::<f64>() / between.len() as f64;
        (dd, dv, vv) = (dd + d * d, dv + d * v, vv + v * v);
    }
    let factor = dv / dd;
    (dd > 0.0).then(|| (factor, ((vv - factor * dv).max(0.0) / dd).sqrt()))
}

/// Order, sign, size, lag and velocity of the gentle motions.
pub(super) fn following(log: &DriveLog, findings: &mut TrialFindings) {
    let rules = [DriveRule::Order, DriveRule::Sign, DriveRule::Follow, DriveRule::Lag, DriveRule::Velocity];
    let motions: Vec<_> = log.phases_of(|kind| matches!(kind, PhaseKind::Move(_))).collect();
    if motions.is_empty() {
        return;
    }
    let (mut broken, mut calm): ([Option<String>; 5], u32) = Default::default();
    let (mut lags, mut gains, mut rests, mut factors) = (Vec::new(), Vec::new(), 0.0_f64, Vec::new());
    for phase in motions {
        let PhaseKind::Move(j) = phase.kind else { continue };
        let states = log.states_within(phase.from, phase.to);
        if states.len() < FEWEST || log.pause(phase.from, phase.to) > PAUSE {
            continue;
        }
        calm += 1;
        let name = log.arm.joints.get(j).map_or("", |facts| facts.name.as_str());
        let called = format!("joint {} ({name})", j + 1);
        let mut say = |rule: DriveRule, text: String| {
            if let Some(place) = rules.iter().position(|r| *r == rule).and_then(|i| broken.get_mut(i)) {
                place.get_or_insert(text);
            }
        };
        let Some((fitted, stroke)) = moved(log, phase, &states, j, &called, &mut say) else { continue };
        let Fit { lag_ms, gain, left } = fitted;
        gains.push(gain);
        if gain < 0.0 {
            say(DriveRule::Sign, format!("{called} moves to the other side"));
        }
        let units = [(DEGREES, "degrees for radians"), (1.0 / DEGREES, "radians for degrees")];
        let unit = units.iter().find(|(f, _)| (gain.abs() / f - 1.0).abs() < LEFT).map(|(_, name)| *name);
        if let Some(unit) = unit {
            say(DriveRule::Follow, format!("{called} moves {gain:.3} times as far: {unit}"));
        } else if !GAIN.contains(&gain.abs()) {
            say(DriveRule::Follow, format!("{called} moves {gain:.3} times as far as commanded"));
        }
        let rest = left / (gain.abs() * stroke);
        rests = rests.max(rest);
        if !(rest <= LEFT) {
            say(
                DriveRule::Follow,
                format!("{called} is off its reference's curve by {rest:.2} of the motion"),
            );
        }
        lags.push(lag_ms);
        if lag_ms == *LAGS_MS.end() {
            say(DriveRule::Lag, format!("{called} lags by {lag_ms} ms or more"));
        } else if lag_ms < BEFORE_MS {
            say(
                DriveRule::Lag,
                format!("{called} moves {} ms before its command: stamps are too old", -lag_ms),
            );
        }
        if let Some((factor, left)) = velocity(&states, j) {
            factors.push(factor);
            if !VELOCITY_GAIN.contains(&factor) {
                say(
                    DriveRule::Velocity,
                    format!("{called} reports {factor:.3} times the derivative of its position"),
                );
            } else if !(left <= VELOCITY_LEFT) {
                say(
                    DriveRule::Velocity,
                    format!("{called} reports velocities off the derivative by {left:.2} of it"),
                );
            }
        }
    }
    if calm == 0 {
        return rules.iter().for_each(|rule| {
            findings.untested(*rule, "commands or states paused in every motion: this machine was too busy");
        });
    }
    let span = |values: &[f64]| {
        let (low, high) =
            values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
        format!("{low:.3} to {high:.3}")
    };
    lags.sort_unstable();
    let middle = lags.get(lags.len() / 2).copied().unwrap_or(0);
    let told = log.told();
    let told_ms = told.lag.map(|lag| lag.as_s() * 1e3);
    if let (Some(told_ms), [_, _, _, of_lag, _]) = (told_ms.filter(|_| !lags.is_empty()), &mut broken)
        && !told.agrees_with_lag(middle as f64)
    {
        let words = || format!("the drive tells a lag of {told_ms:.0} ms (`lag_ms`), and lags by {middle}");
        of_lag.get_or_insert_with(words);
    }
    let says = match told_ms {
        Some(told_ms) => format!("the drive tells {told_ms:.0}"),
        None => format!("the run file says {:.0}", log.arm.lead.as_s() * 1e3),
    };
    let range = format!("{} to {} ms", lags.first().unwrap_or(&0), lags.last().unwrap_or(&0));
    let measured = [
        format!("{} joints one after the other", gains.len()),
        "as commanded".into(),
        format!("{} times as far, {rests:.3} of the motion left", span(&gains)),
        format!("{range}; servo.lead_ms = {middle} fits, {says}"),
        format!("{} times the derivative of the position", span(&factors)),
    ];
    for ((rule, broken), measured) in rules.into_iter().zip(broken).zip(measured) {
        // Where no joint moved as it was commanded, what breaks a rule is all that is known.
        if broken.is_some() || !gains.is_empty() {
            findings.say_in_mode(rule, broken, measured);
        }
    }
}

/// The fit of a joint's motion and how far it was commanded; none where it is not the one that moved.
fn moved(
    log: &DriveLog,
    phase: &LoggedPhase,
    states: &[Timed],
    j: usize,
    called: &str,
    say: &mut impl FnMut(DriveRule, String),
) -> Option<(Fit, f64)> {
    let commanded = CommandedCurve::of(log, j, phase.from, phase.to);
    let (low, high) =
        commanded.q_r.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
    let stroke = high - low;
    if !(stroke > 0.0) {
        return None;
    }
    let strokes = |k: usize| log.arm.joints.get(k).map_or(1.0, |facts| facts.stroke());
    let share = |k: usize| range(states, k) / strokes(k) / (stroke / strokes(j));
    let others = (0..log.joints()).filter(|k| *k != j).max_by(|a, b| share(*a).total_cmp(&share(*b)));
    let other = others.filter(|k| share(*k) > MOVES);
    match (share(j) > MOVES, other) {
        (true, None) => {}
        (true, Some(k)) => say(DriveRule::Order, format!("joint {} moves with {called}", k + 1)),
        (false, Some(k)) => {
            say(DriveRule::Order, format!("joint {} moves in the place of {called}", k + 1));
            return None;
        }
        (false, None) => {
            say(DriveRule::Follow, format!("{called} does not move"));
            return None;
        }
    }
    Some((fit(&commanded, states, j)?, stroke))
}
