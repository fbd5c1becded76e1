//! Rules about ends: a trial that is given up, LAST, silence, and commands that no drive may obey.

use super::log::{DriveLog, ProgramExit};
use super::motion::{PAUSE, STANDS};
use super::plan::{CREEP_STROKES_S, DriveTrial, PhaseKind};
use super::rule::{DriveRule, TrialFindings};
use crate::messages::{DriveStateMsg, drive_flag};
use crate::time::{MonoNs, SpanNs};

/// Time in which a program ends after LAST. Chosen by hand: as long as the supervisor of a run waits for it.
pub const ENDS_WITHIN: SpanNs = SpanNs(4_000_000_000);
/// Time without commands after which the arm must stand. Chosen by hand: a tenth of a second until a drive notices, and the time to brake; a robot's own
/// watchdog takes up to a second only where it is set so.
const BRAKES_WITHIN: SpanNs = SpanNs(600_000_000);
/// Strokes by which an arm may move on commands that it must refuse: 3 mrad. Chosen by hand: what it does in the moment in which it ends; an arm that obeys goes three
/// times as far.
const REFUSES: f64 = 0.1;

/// How long before a trial was given up a pause is looked for: the hold before LAST, and a second. Chosen by hand.
const JUST_BEFORE: SpanNs = SpanNs(1_500_000_000);

fn most_moved(log: &DriveLog, states: &[(MonoNs, DriveStateMsg)]) -> Option<(usize, f64)> {
    let (_, first) = states.first()?;
    let joints = log.arm.joints.iter().enumerate();
    let moved = joints.map(|(j, facts)| {
        let from = first.q.get(j).copied().unwrap_or(f64::NAN);
        let off = states.iter().map(|(_, s)| {
            let off = (s.q.get(j).copied().unwrap_or(f64::NAN) - from).abs() / facts.stroke();
            // A position that is none is everywhere.
            if off.is_nan() { f64::INFINITY } else { off }
        });
        (j, off.fold(0.0, f64::max))
    });
    moved.max_by(|a, b| a.1.total_cmp(&b.1))
}

fn how_ended(code: Option<u8>, words: Option<&String>) -> String {
    let code = code.map_or("by a signal".into(), |code| format!("with exit code {code}"));
    words.map_or(code.clone(), |words| format!("{code}: {words}"))
}

/// Whether the trial came to its end.
pub(super) fn course(log: &DriveLog, findings: &mut TrialFindings) {
    if !log.phases.is_empty() && log.phases.iter().all(|p| !p.kind.is_odd()) {
        // What a pause of this machine's commands does is not the drive's fault.
        let last = log.flagged(drive_flag::LAST).map_or(log.until, |s| s.at);
        let pause = log.pause(last + SpanNs(-JUST_BEFORE.0), last);
        match &log.given_up {
            Some(why) if pause > PAUSE => {
                let busy = format!(
                    "{why}, after a pause of {:.0} ms: this machine was too busy",
                    pause.as_s() * 1e3
                );
                findings.untested(DriveRule::Course, &busy);
            }
            given_up => findings.say_in_mode(DriveRule::Course, given_up.clone(), "always"),
        }
    }
}

/// LAST and what comes before it.
pub(super) fn end(log: &DriveLog, findings: &mut TrialFindings) {
    if log.trial != DriveTrial::Motion || log.initial().is_none() {
        return;
    }
    let last = log.flagged(drive_flag::LAST).map(|s| s.at);
    match (&log.exit, last) {
        (ProgramExit::Ended { at, code, words }, last) if last.is_none_or(|last| *at < last) => {
            let how = format!("ended before LAST {}", how_ended(*code, words.as_ref()));
            return findings.say(DriveRule::Stays, Some(how), "");
        }
        (ProgramExit::Unknown, _) => {
            findings.untested(DriveRule::Stays, "the drive was started by hand");
            findings.untested(DriveRule::LastExit, "the drive was started by hand");
        }
        (exit, Some(last)) => {
            findings.say(DriveRule::Stays, None, "yes");
            let (broken, measured) = match exit {
                ProgramExit::Ended { at, code: Some(0), .. } if *at - last <= ENDS_WITHIN => {
                    (None, format!("{:.0} ms after it, exit code 0", (*at - last).as_s() * 1e3))
                }
                ProgramExit::Ended { at, code, words } => {
                    let how = how_ended(*code, words.as_ref());
                    (Some(format!("{:.1} s after it, {how}", (*at - last).as_s())), String::new())
                }
                _ => (Some(format!("still ran {:.0} s after it", ENDS_WITHIN.as_s())), String::new()),
            };
            findings.say(DriveRule::LastExit, broken, measured);
        }
        (_, None) => {}
    }
    let Some(last) = last else { return };
    let states = log.states_within(last, MonoNs(i64::MAX));
    match most_moved(log, &states) {
        Some((j, moved)) => {
            let broken =
                (moved > STANDS).then(|| format!("joint {} still moves, by {moved:.2} of a stroke", j + 1));
            findings.say(DriveRule::LastRest, broken, "stands");
        }
        None => findings.untested(DriveRule::LastRest, "no state came after LAST; it was held before"),
    }
}

/// What the drive does without commands.
pub(super) fn silence(log: &DriveLog, findings: &mut TrialFindings) {
    let Some(phase) = log.phases_of(|kind| kind == PhaseKind::Silence).next() else { return };
    let ended = match &log.exit {
        ProgramExit::Ended { at, code, words } if *at < phase.to + SpanNs::MILLISECOND => {
            Some((at, code, words))
        }
        _ => None,
    };
    let must_stand = phase.from + BRAKES_WITHIN;
    let states = log.states_within(must_stand, phase.to);
    let all = log.states_within(phase.from, phase.to);
    let creeps = log.phases_of(|kind| matches!(kind, PhaseKind::Creep(_))).next().is_some();
    let way = most_moved(log, &all).map_or(0.0, |(_, moved)| moved);
    // With a longer silence a creeping joint would go by this.
    let whole = CREEP_STROKES_S * (phase.to - must_stand).as_s();
    let (broken, measured) = match (most_moved(log, &states), ended) {
        (Some((j, moved)), _) if moved > STANDS => {
            let share =
                if creeps { format!(", {:.2} of its last velocity", moved / whole) } else { String::new() };
            (
                Some(format!(
                    "joint {} goes on {:.1} s after the last command{share}",
                    j + 1,
                    BRAKES_WITHIN.as_s()
                )),
                String::new(),
            )
        }
        (Some(_), None) => (
            None,
            format!(
                "stands {:.1} s after the last command, {way:.2} of a stroke on; stays and holds",
                BRAKES_WITHIN.as_s()
            ),
        ),
        (_, Some((at, ..))) if all.is_empty() || way <= 1.0 => (
            None,
            format!("{way:.2} of a stroke on; ended by itself after {:.2} s", (*at - phase.from).as_s()),
        ),
        (_, Some(_)) => (Some(format!("{way:.2} of a stroke on when it ended")), String::new()),
        (None, None) => (
            Some("no states any more, and the program still ran: nobody knows whether the arm stands".into()),
            String::new(),
        ),
    };
    let broken = broken.or_else(|| log.given_up.clone());
    findings.say(DriveRule::Silence, broken, measured);
    match ended {
        None => findings.untested(DriveRule::SilenceTold, "it did not end without commands, and need not"),
        Some((_, code, words)) => {
            let untold = *code == Some(0) || (code.is_some() && words.is_none());
            let how = how_ended(*code, words.as_ref());
            findings.say(
                DriveRule::SilenceTold,
                untold.then(|| format!("{how}, without a reason in drive.txt")),
                how,
            );
        }
    }
}

/// What the drive does on commands that it must not obey.
pub(super) fn refusal(log: &DriveLog, findings: &mut TrialFindings) {
    let rule = match log.trial {
        DriveTrial::WrongJoints => DriveRule::RefusesJoints,
        DriveTrial::NotFinite => DriveRule::RefusesNumbers,
        DriveTrial::Motion | DriveTrial::Silence => return,
    };
    let Some(phase) = log.phases_of(|kind| kind == PhaseKind::Refused).next() else { return };
    // From the last state before them on.
    let before = log.states_within(MonoNs(i64::MIN), phase.from);
    let mut states: Vec<_> = before.last().copied().into_iter().collect();
    states.extend(log.states_within(phase.from, phase.to));
    let ended = match &log.exit {
        ProgramExit::Ended { at, code, words }
            if log.flagged(drive_flag::LAST).is_none_or(|last| *at < last.at) =>
        {
            Some((at, how_ended(*code, words.as_ref())))
        }
        _ => None,
    };
    let (broken, measured) = match (most_moved(log, &states), ended) {
        (Some((j, moved)), _) if !(moved <= REFUSES) => {
            (Some(format!("joint {} obeys them: {moved:.2} of a stroke", j + 1)), String::new())
        }
        (_, Some((_, how))) => (None, format!("ended {how}")),
        (Some(_), None) => (None, "the arm stands".into()),
        (None, None) => (Some("no state came".into()), String::new()),
    };
    findings.say(rule, broken.or_else(|| log.given_up.clone()), measured);
}
