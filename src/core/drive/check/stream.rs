//! Rules about the stream of states: the answer to START, contents, counts, stamps.

use super::log::{DriveLog, OTHER_CLOCK, ProgramExit, ReceivedState, SentCommand};
use super::rule::{DriveRule, TrialFindings};
use crate::drive::{CommandMode, DriveProperties, check_joint_names};
use crate::messages::{DriveStateMsg, RobotState, drive_flag, text_kind};
use crate::time::{MonoNs, SpanNs, TICK};

/// Positions may be beyond a limit of the robot file by this, rad or m. Chosen by hand: files round their limits to hundredths.
const BEYOND_LIMIT: f64 = 0.02;
/// What is true may differ from what is measured by this, rad or m. Chosen by hand: coarse encoders and elastic joints differ by less, another posture by more.
const TRUTH_DIFFERS: f64 = 0.05;
/// A stamp is in the future when it is later than its arrival by more. Chosen by hand: drives that estimate the time of a robot's sample err by some hundred
/// microseconds; a state of the next tick is off by a millisecond.
const FUTURE: SpanNs = SpanNs(800_000);
/// Units that a stamp may be in by mistake, as nanoseconds each, because those are what the usual clock calls give.
const UNITS: [(i64, &str); 2] = [(1_000, "microseconds"), (1_000_000, "milliseconds")];
/// Nanoseconds since 1970 are later than this, and no machine runs for so long: 32 years.
const SINCE_1970: i64 = 1_000_000_000_000_000_000;

/// Quantiles of spans, ms.
fn spread(mut spans: Vec<SpanNs>) -> (String, SpanNs, SpanNs) {
    spans.sort_unstable();
    let at = |share: f64| {
        let place = (share * spans.len().saturating_sub(1) as f64).round() as usize;
        spans.get(place).copied().unwrap_or(SpanNs::ZERO)
    };
    let ms = |span: SpanNs| span.as_s() * 1e3;
    let text = format!("p50 {:.2}, p99 {:.2}, max {:.2} ms", ms(at(0.5)), ms(at(0.99)), ms(at(1.0)));
    (text, at(0.5), at(0.99))
}

fn first(log: &DriveLog, wrong: impl Fn(&DriveStateMsg) -> Option<String>) -> Option<String> {
    let told = log.received.iter().filter_map(|r| Some((r.state.sequence, wrong(&r.state)?)));
    let mut told = told.peekable();
    let (sequence, text) = told.peek().cloned()?;
    Some(format!("{text} (state {sequence}, one of {})", told.count()))
}

/// START and its answers.
pub(super) fn start(log: &DriveLog, findings: &mut TrialFindings) {
    let limit = log.arm.connect_timeout;
    let asked = log.flagged(drive_flag::START).map(|s| s.at);
    let answer = log.initial();
    let (broken, measured) = match (asked, answer) {
        (_, None) => {
            let why = match (&log.exit, &log.given_up) {
                (ProgramExit::Ended { code, words, .. }, _) => format!(
                    "no answer: the program ended with {}{}",
                    code.map_or("a signal".into(), |code| format!("exit code {code}")),
                    words.as_ref().map_or(String::new(), |words| format!(": {words}"))
                ),
                (_, Some(why)) => why.clone(),
                _ => format!("no state with INITIAL within {:.1} s", limit.as_s()),
            };
            (Some(why), String::new())
        }
        (Some(asked), Some(answer)) => {
            let took = answer.at - asked;
            let late = took > limit;
            let tick = answer.state.tick;
            let broken = if tick != 0 {
                Some(format!("the state with INITIAL has tick {tick}, not 0"))
            } else {
                late.then(|| format!("answered after {:.1} s", took.as_s()))
            };
            (broken, format!("after {:.1} ms", took.as_s() * 1e3))
        }
        (None, Some(_)) => (Some("INITIAL came before START".into()), String::new()),
    };
    findings.say(DriveRule::Answer, broken, measured);
    // A START that had to be repeated because no answer came is not one that was left unanswered.
    let is_start = |s: &&SentCommand| s.command.flags & drive_flag::START != 0;
    let again = log.sent.iter().filter(is_start).filter(|s| answer.is_some_and(|a| s.at > a.at)).count();
    let answers = log.received.iter().filter(|r| r.state.flags & drive_flag::INITIAL != 0).count();
    if again == 0 {
        findings.untested(DriveRule::EveryStart, "START was not sent again");
    } else {
        let broken = (answers < 1 + again).then(|| "START came again, and was not answered".into());
        findings.say(DriveRule::EveryStart, broken, format!("{} of {}", 1 + again, 1 + again));
    }
}

/// The names of the joints. Who tells none is taken at its word that it has those of the robot file.
pub(super) fn joint_names(log: &DriveLog, findings: &mut TrialFindings) {
    let mut told = log.texts.iter().filter(|t| t.text.kind == text_kind::JOINTS).peekable();
    let Some(first) = told.peek().copied() else {
        if !log.received.is_empty() {
            findings.untested(DriveRule::JointNames, "the drive tells none");
        }
        return;
    };
    let robot: Vec<_> = log.arm.joints.iter().map(|joint| joint.name.as_str()).collect();
    let wrong = told.find_map(|t| check_joint_names(&t.text, &robot).err());
    let late = log.initial().is_some_and(|initial| first.at > initial.at);
    let broken = wrong
        .map(|error| error.brief())
        .or_else(|| late.then(|| "they came after the state with INITIAL".into()));
    findings.say(DriveRule::JointNames, broken, first.text.names().join(", "));
}

/// What the drive tells of itself. Who tells nothing is taken for one that waits long enough.
pub(super) fn properties(log: &DriveLog, findings: &mut TrialFindings) {
    let mut told = log.texts.iter().filter(|t| t.text.kind == text_kind::PROPERTIES).peekable();
    let Some(first) = told.peek().map(|t| t.text.text()) else {
        if !log.received.is_empty() {
            findings.untested(DriveRule::Properties, "the drive tells none");
        }
        return;
    };
    let parsed: Result<Vec<_>, _> = told.map(|t| DriveProperties::parse(&t.text.text())).collect();
    let wrong = match &parsed {
        Err(error) => Some(error.to_string()),
        Ok(all) => all.iter().find_map(|told| {
            let refused = told.check(log.arm.joints.len()).err().map(|error| error.to_string());
            refused.or_else(|| other_period(log, told.period?))
        }),
    };
    findings.say(DriveRule::Properties, wrong, first.lines().collect::<Vec<_>>().join(", "));
}

/// That the states come with another period than the one that was told: by a fifth and more, in the middle of them.
fn other_period(log: &DriveLog, told: SpanNs) -> Option<String> {
    if log.has_other_clock() {
        return None; // another rule tells that
    }
    let end = log.ordinary_end();
    let stamps: Vec<_> = log.received.iter().filter(|r| r.at <= end).map(|r| r.state.stamp).collect();
    let mut periods: Vec<_> = stamps.iter().zip(stamps.iter().skip(1)).map(|(a, b)| *b - *a).collect();
    if periods.iter().any(|period| period.0 <= 0) {
        return None; // likewise
    }
    periods.sort_unstable();
    let middle = *periods.get(periods.len() / 2)?;
    let is_other = (middle.0 - told.0).abs() * 5 > told.0;
    is_other.then(|| {
        format!(
            "told is a state every {} ms, and every {:.3} ms comes one",
            told.as_s() * 1e3,
            middle.as_s() * 1e3
        )
    })
}

/// What single states contain.
pub(super) fn contents(log: &DriveLog, findings: &mut TrialFindings) {
    if log.received.is_empty() {
        return;
    }
    let joints = log.joints();
    let broken = first(log, |s| {
        (s.joints as usize != joints)
            .then(|| format!("{} joints, the robot of the run file has {joints}", s.joints))
    });
    findings.say(DriveRule::Joints, broken, joints.to_string());

    let known = CommandMode::ALL.iter().fold(0, |mask, mode| mask | mode.bit());
    let before = log.received.first().map_or(0, |r| r.state.modes);
    let broken = first(log, |s| match s.modes {
        0 => Some("no mode at all".into()),
        modes if modes & !known != 0 => Some(format!("unknown bits: {modes:#b}")),
        modes if modes != before => Some(format!("they change: {before:#b}, then {modes:#b}")),
        modes if modes & log.arm.wanted.bit() == 0 => {
            Some(format!("{} is not among them, and drive.mode asks for it", log.arm.wanted))
        }
        _ => None,
    });
    let names = CommandMode::ALL.into_iter().filter(|m| before & m.bit() != 0).map(CommandMode::as_str);
    findings.say(DriveRule::Modes, broken, names.collect::<Vec<_>>().join(", "));

    let starts = log.sent.iter().filter(|s| s.command.flags & drive_flag::START != 0).count();
    let answers = log.received.iter().filter(|r| r.state.flags & drive_flag::INITIAL != 0).count();
    let broken = first(log, |s| {
        if s.flags & !(drive_flag::TRUTH | drive_flag::INITIAL) != 0 {
            Some(format!("unknown flags: {:#b}", s.flags))
        } else {
            (s.arm != 0).then(|| format!("arm {}", s.arm))
        }
    });
    let broken =
        broken.or_else(|| (answers > starts).then(|| format!("{answers} INITIAL after {starts} STARTs")));
    findings.say(DriveRule::Flags, broken, "known ones");

    let mut told: Vec<RobotState> = Vec::new();
    for state in log.received.iter().map(|r| RobotState::from_code(r.state.robot_state)) {
        if !told.contains(&state) {
            told.push(state);
        }
    }
    let broken = first(log, |s| {
        let is_known = RobotState::ALL.iter().any(|state| *state as u32 == s.robot_state);
        (!is_known).then(|| format!("there is no robot_state {}", s.robot_state))
    });
    let names = told.into_iter().map(RobotState::as_str).collect::<Vec<_>>().join(", ");
    findings.say(DriveRule::RobotState, broken, if names == "unknown" { "not told".into() } else { names });

    // Whatever a drive makes of numbers that it should have refused is that rule's matter.
    let broken = first(log, |s| {
        let of = |v: &[f64]| v.iter().take(joints).any(|v| !v.is_finite());
        let truth = s.flags & drive_flag::TRUTH != 0 && (of(&s.q_true) || of(&s.qd_true));
        (of(&s.q) || of(&s.qd) || of(&s.tau) || truth).then(|| "a value is not finite".into())
    });
    findings.say(DriveRule::Finite, broken, "all");

    let broken = first(log, |s| {
        log.arm.joints.iter().zip(s.q.iter().zip(&s.qd)).zip(1..).find_map(|((joint, (q, qd)), number)| {
            let l = &joint.limits;
            let out = *q < l.lower - BEYOND_LIMIT || *q > l.upper + BEYOND_LIMIT;
            (out || qd.abs() > l.velocity).then(|| {
                format!(
                    "joint {number} ({}) at {q:.4}, moving with {qd:.4}; its limits are {:.4} to {:.4}, and {:.4}",
                    joint.name, l.lower, l.upper, l.velocity
                )
            })
        })
    });
    findings.say(DriveRule::Range, broken, "all");

    if log.received.iter().all(|r| r.state.flags & drive_flag::TRUTH == 0) {
        findings.untested(DriveRule::Truth, "no state has TRUTH");
    } else {
        let broken = first(log, |s| {
            let differs = s.q.iter().zip(&s.q_true).take(joints).any(|(q, t)| (q - t).abs() > TRUTH_DIFFERS);
            (s.flags & drive_flag::TRUTH != 0 && differs).then(|| "q_true is another posture than q".into())
        });
        findings.say(DriveRule::Truth, broken, "near");
    }
}

/// `sequence` and `tick`.
pub(super) fn counts(log: &DriveLog, findings: &mut TrialFindings) {
    let Some(begin) = log.received.first() else { return };
    let by_us = log.exit != ProgramExit::Unknown;
    let mut broken = (by_us && begin.state.sequence != 0)
        .then(|| format!("the first state has sequence {}, not 0", begin.state.sequence));
    let mut excused = 0;
    let pairs = || log.received.iter().zip(log.received.iter().skip(1));
    for (a, b) in pairs() {
        let (from, to) = (a.state.sequence, b.state.sequence);
        let what = match to.wrapping_sub(from) {
            1 => continue,
            0 => format!("sequence {to} twice"),
            _ if to < from => format!("sequence {to} after {from}"),
            step if DriveLog::reader_may_have_lost(b) => {
                excused += step - 1;
                continue;
            }
            _ => format!("sequence {to} after {from}: a gap"),
        };
        broken.get_or_insert(what);
    }
    let lost = if excused > 0 { format!(", {excused} lost here") } else { String::new() };
    findings.say(DriveRule::Sequence, broken, format!("{} states{lost}", log.received.len()));

    if log.arm.lockstep {
        return answers(log, findings);
    }
    let ticks: Vec<_> = log.ordinary().collect();
    let broken = ticks.iter().zip(ticks.iter().skip(1)).find_map(|(a, b)| {
        let (from, to) = (a.state.tick, b.state.tick);
        let next = to == from + 1 || (to > from && DriveLog::reader_may_have_lost(b));
        // A START begins anew.
        let anew =
            to <= 1 && log.sent.iter().any(|s| s.command.flags & drive_flag::START != 0 && s.at >= a.at);
        (!next && !anew).then(|| format!("tick {to} after {from}"))
    });
    if ticks.is_empty() {
        findings.untested(DriveRule::Tick, "no state but answers to START");
    } else {
        findings.say(DriveRule::Tick, broken, "counts the states");
    }
}

/// Lockstep: every command has one answer.
fn answers(log: &DriveLog, findings: &mut TrialFindings) {
    let wanted: Vec<_> =
        log.sent.iter().filter(|s| s.command.flags & (drive_flag::START | drive_flag::LAST) == 0).collect();
    let got: Vec<_> = log.ordinary().collect();
    let wrong = wanted.iter().zip(&got).find_map(|(sent, got)| {
        let (tick, stamp) = (sent.command.tick + 1, sent.command.stamp + TICK);
        if got.state.tick != tick {
            return Some(format!("the answer to tick {} has tick {}", sent.command.tick, got.state.tick));
        }
        (got.state.stamp != stamp).then(|| {
            format!("the answer to tick {} has another stamp than the command's plus 1 ms", sent.command.tick)
        })
    });
    let count =
        (wanted.len() != got.len()).then(|| format!("{} commands, {} answers", wanted.len(), got.len()));
    findings.say(
        DriveRule::Tick,
        wrong.or(count),
        format!("{} commands, each with one answer", wanted.len()),
    );
}

/// Stamps: clock, future, order, rate, age.
pub(super) fn stamps(log: &DriveLog, findings: &mut TrialFindings) {
    const RULES: [DriveRule; 5] =
        [DriveRule::Clock, DriveRule::Future, DriveRule::Rising, DriveRule::Rate, DriveRule::Age];
    if log.arm.lockstep {
        return RULES.iter().for_each(|rule| findings.untested(*rule, "the clock of lockstep is control's"));
    }
    let states: Vec<&ReceivedState> = log.ordinary().collect();
    let [one, .., _] = states.as_slice() else {
        return RULES.iter().for_each(|rule| findings.untested(*rule, "too few states came"));
    };
    let other = log.has_other_clock();
    let broken = other.then(|| clock_of(one));
    findings.say(DriveRule::Clock, broken, "ns");
    if other {
        for rule in [DriveRule::Future, DriveRule::Age] {
            findings.untested(rule, "stamps are of another clock");
        }
    } else {
        let ahead = states.iter().map(|r| r.state.stamp - r.at).filter(|ahead| *ahead > FUTURE);
        let (count, most) = ahead.fold((0, SpanNs::ZERO), |(n, most), ahead| (n + 1, most.max(ahead)));
        let broken = (count > 0)
            .then(|| format!("{count} of {} stamps, by up to {:.2} ms", states.len(), most.as_s() * 1e3));
        findings.say(DriveRule::Future, broken, "none");
        // The newest of those that were taken at once: the others waited for their reader.
        let newest = states.iter().filter(|r| r.of_batch == r.batch);
        let (text, _, p99) = spread(newest.map(|r| r.at - r.state.stamp).collect());
        findings.say(DriveRule::Age, (p99 > log.arm.drive_timeout).then(|| text.clone()), text);
    }
    let steps = || states.iter().zip(states.iter().skip(1)).map(|(a, b)| b.state.stamp - a.state.stamp);
    let back = steps().filter(|step| step.0 < 0).count();
    let same = steps().filter(|step| step.0 == 0).count();
    let broken = (back + same > 0)
        .then(|| format!("of {} stamps {same} equal the one before, {back} go back", states.len()));
    findings.say(DriveRule::Rising, broken, "all");
    rate(log, &states, findings);
}

fn rate(log: &DriveLog, states: &[&ReceivedState], findings: &mut TrialFindings) {
    let end = log.ordinary_end();
    let times: Vec<MonoNs> = states.iter().map(|r| r.at).filter(|at| *at <= end).collect();
    let periods: Vec<SpanNs> = if log.has_other_clock() {
        times.iter().zip(times.iter().skip(1)).map(|(a, b)| *b - *a).collect()
    } else {
        let stamps: Vec<_> = states.iter().filter(|r| r.at <= end).map(|r| r.state.stamp).collect();
        stamps.iter().zip(stamps.iter().skip(1)).map(|(a, b)| *b - *a).collect()
    };
    let pause = periods.iter().copied().max().unwrap_or(SpanNs::ZERO);
    let silent_at_the_end = times.last().map_or(SpanNs::ZERO, |last| end - *last);
    let longest = pause.max(silent_at_the_end);
    let (text, p50, _) = spread(periods);
    let broken = (longest > log.arm.drive_timeout).then(|| {
        format!(
            "no state for {:.0} ms; safety.drive_timeout_ms is {:.0} ({text})",
            longest.as_s() * 1e3,
            log.arm.drive_timeout.as_s() * 1e3
        )
    });
    // Rounded clocks of a robot may be a little slow; chosen by hand.
    let slow = if p50.as_s() > 1.05 * TICK.as_s() {
        "; ticks of 1 ms without a new state count as late"
    } else {
        ""
    };
    findings.say(DriveRule::Rate, broken, format!("period {text}{slow}"));
}

/// Which clock a stamp may be of.
fn clock_of(r: &ReceivedState) -> String {
    let (stamp, off) = (r.state.stamp.0, (r.at - r.state.stamp).as_s());
    for (unit, name) in UNITS {
        let ns = MonoNs(stamp.saturating_mul(unit));
        if (r.at - ns).0.unsigned_abs() < OTHER_CLOCK.0.unsigned_abs() {
            return format!("the stamps are in {name}");
        }
    }
    if stamp > SINCE_1970 {
        return "the stamps are of the time of day (CLOCK_REALTIME)".into();
    }
    format!("the stamps are {off:.1} s before their arrival: of another clock")
}
