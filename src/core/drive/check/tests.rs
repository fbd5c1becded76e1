//! Logs of a drive that keeps to its contract on a busy machine break nothing, and each of the violations that are planted in them is found by its rule.

use super::DriveRule as R;
use super::*;
use crate::drive::CommandMode;
use crate::linalg::Random;
use crate::messages::{DriveStateMsg, drive_flag};
use crate::time::{SpanNs, TICK};
use honest::{BEGIN, Machine, START, USUAL, arm, initial, log_of, ms, untouched};
use planted::{ended, phase_begin, violations};

mod honest;
mod planted;

fn broken(log: &DriveLog) -> Vec<R> {
    let found = judge(log).into_iter().filter(|f| f.verdict == RuleVerdict::Broken);
    let mut found: Vec<_> = found.map(|f| f.rule).collect();
    found.dedup();
    found
}

fn finding(log: &DriveLog, rule: R) -> RuleFinding {
    judge(log).into_iter().find(|f| f.rule == rule).unwrap()
}

#[test]
fn an_honest_drive_on_a_busy_machine_breaks_nothing() {
    for seed in 0..6 {
        for (period_ms, lag_ms) in [(1.0, 0.0), (1.0, 3.0), (2.0, 36.0), (8.0, 50.0), (0.5, 180.0)] {
            for mode in [CommandMode::Position, CommandMode::Velocity] {
                let late_ms = [0.1, 3.0, 25.0][seed as usize % 3];
                let log = log_of(Machine { period_ms, lag_ms, late_ms, mode, seed, ..USUAL }, &untouched);
                assert_eq!(broken(&log), [], "{seed} {period_ms} {lag_ms}: {:#?}", judge(&log));
                let lag = finding(&log, R::Lag).measured;
                let told: f64 =
                    lag.split("lead_ms = ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
                assert!((told - lag_ms).abs() <= 2.0, "{lag_ms}: {lag}");
            }
        }
        for trial in [DriveTrial::Silence, DriveTrial::WrongJoints, DriveTrial::NotFinite] {
            let log = log_of(Machine { trial, seed, ..USUAL }, &untouched);
            assert_eq!(broken(&log), [], "{trial:?}: {:#?}", judge(&log));
        }
    }
}

#[test]
fn all_rules_but_one_are_tested_by_the_four_trials() {
    let trials = [DriveTrial::Motion, DriveTrial::Silence, DriveTrial::WrongJoints, DriveTrial::NotFinite];
    let truth = |s: &mut DriveStateMsg, _: f64| {
        s.flags |= drive_flag::TRUTH;
        s.q_true = s.q;
    };
    let logs = trials.map(|trial| log_of(Machine { trial, ..USUAL }, &truth));
    let all = merged(logs.iter().flat_map(judge));
    let untested: Vec<_> =
        all.iter().filter(|f| f.verdict == RuleVerdict::NotTested).map(|f| f.rule).collect();
    assert_eq!(untested, [R::SilenceTold], "{all:#?}");
    assert_eq!(all.len(), R::ALL.len());
    assert!(R::ALL.is_sorted());
}

#[test]
fn each_planted_violation_is_found_by_its_rule() {
    let violations = violations();
    assert!(violations.len() >= 20);
    let mut wrong = Vec::new();
    for (what, trial, tweak, change, rules) in &violations {
        let mut log = log_of(Machine { trial: *trial, ..USUAL }, tweak);
        change(&mut log);
        let found: Vec<_> = judge(&log).into_iter().filter(|f| f.verdict == RuleVerdict::Broken).collect();
        if found.iter().map(|f| f.rule).ne(rules.iter().copied()) {
            wrong.push((what, found));
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
    // No rule is there in vain.
    let found: Vec<_> = violations.into_iter().flat_map(|(.., rules)| rules).collect();
    let in_vain: Vec<_> = R::ALL.iter().filter(|rule| !found.contains(rule)).collect();
    assert!(in_vain.is_empty(), "{in_vain:?}");
}

#[test]
fn a_reader_that_was_away_is_not_held_against_the_drive() {
    let mut log = log_of(USUAL, &untouched);
    log.received.retain(|r| !(2000..2040).contains(&r.state.tick));
    assert_eq!(broken(&log), [R::Sequence, R::Tick]);
    for r in log.received.iter_mut().filter(|r| (2040..2110).contains(&r.state.tick)) {
        r.batch = 70;
    }
    assert_eq!(broken(&log), [], "as many as can wait were taken at once");
    assert!(finding(&log, R::Sequence).measured.contains("40 lost here"));
}

#[test]
fn the_reason_of_an_end_is_told_where_it_is_found() {
    let mut log = log_of(Machine { trial: DriveTrial::Silence, ..USUAL }, &untouched);
    let from = phase_begin(&log, PhaseKind::Silence);
    ended(&mut log, from + ms(130.0), 4, Some("no command from control"));
    assert_eq!(broken(&log), []);
    assert!(finding(&log, R::SilenceTold).measured.contains("exit code 4: no command from control"));
    assert!(finding(&log, R::Silence).measured.contains("after 0.13 s"));

    let mut log = log_of(USUAL, &untouched);
    (log.received, log.phases) = (Vec::new(), Vec::new());
    ended(&mut log, BEGIN, 4, Some("the robot is powered off"));
    assert_eq!(broken(&log), [R::Answer]);
    assert!(finding(&log, R::Answer).measured.contains("exit code 4: the robot is powered off"));
}

#[test]
fn in_lockstep_every_command_has_its_answer() {
    let lockstep = Machine { lockstep: true, lag_ms: 1.0, late_ms: 0.1, ..USUAL };
    let log = log_of(lockstep, &untouched);
    assert_eq!(broken(&log), [], "{:#?}", judge(&log));
    let wrong = |s: &mut DriveStateMsg, t: f64| s.tick += u64::from(t > 100.0);
    assert_eq!(broken(&log_of(lockstep, &wrong)), [R::Tick]);
    let other_time = |s: &mut DriveStateMsg, _: f64| s.stamp = s.stamp + SpanNs(1);
    assert_eq!(broken(&log_of(lockstep, &other_time)), [R::Tick]);
    let mut log = log_of(lockstep, &untouched);
    log.received.pop();
    assert_eq!(broken(&log), [R::Tick]);
}

#[test]
#[allow(clippy::needless_range_loop)]
fn gentle_motions_stay_within_every_limit() {
    let mut rng = Random::new(5);
    for _ in 0..200 {
        let mut arm = arm();
        let mut state = initial();
        for (j, joint) in arm.joints.iter_mut().enumerate() {
            joint.limits.velocity = rng.between(0.01, 3.0);
            joint.limits.upper = joint.limits.lower + rng.between(1e-4, 3.0);
            state.q[j] = rng.between(joint.limits.lower, joint.limits.upper);
        }
        let plan = TrialPlan::new(DriveTrial::Motion, &arm, CommandMode::Position, true, &state);
        let end = plan.phases.last().unwrap().to;
        let mut before = plan.reference(SpanNs::ZERO);
        for k in 0..end.0 / TICK.0 {
            let (q, qd) = plan.reference(SpanNs(k * TICK.0));
            for (j, joint) in arm.joints.iter().enumerate() {
                let l = &joint.limits;
                assert!((l.lower..=l.upper).contains(&q[j]), "{q:?}");
                assert!(qd[j].abs() <= (0.25 * l.velocity).min(0.11), "{qd:?} {l:?}");
                let step = (q[j] - before.0[j]) * 1e3;
                assert!((step - 0.5 * (qd[j] + before.1[j])).abs() < 1e-3, "{step}");
                assert!((qd[j] - before.1[j]).abs() < 2e-3, "no jump");
            }
            before = (q, qd);
        }
        assert_eq!(before.0, plan.reference(SpanNs::ZERO).0, "it ends where it began");
    }
}

#[test]
fn an_arm_that_departs_is_given_up() {
    let (arm, state) = (arm(), initial());
    assert_eq!(departs(&arm, &START, &state), None);
    for (joint, by, gone) in [(0, 0.05, false), (0, 0.07, true), (2, 0.03, true), (3, f64::NAN, true)] {
        let mut state = state;
        state.q[joint] += by;
        assert_eq!(departs(&arm, &START, &state).is_some(), gone, "{joint} {by}");
    }
    assert!(departs(&arm, &START, &DriveStateMsg { q: [2.0; 7], ..state }).unwrap().contains("joint 1 (j0)"));
}
