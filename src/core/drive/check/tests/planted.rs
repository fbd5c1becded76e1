//! What a drive can do wrong, planted in the log of one that does nothing wrong.

#![allow(clippy::needless_range_loop)] // joints are numbered as in the states

use super::honest::{BEGIN, JOINTS, START, ms, untouched};
use crate::drive::check::DriveRule as R;
use crate::drive::check::*;
use crate::messages::{DriveStateMsg, DriveTextMsg, drive_flag, text_kind};
use crate::time::{MonoNs, SpanNs, TICK};

pub(super) type Tweak = fn(&mut DriveStateMsg, f64);
pub(super) type Change = fn(&mut DriveLog);

pub(super) fn ended(log: &mut DriveLog, at: MonoNs, code: u8, words: Option<&str>) {
    log.exit = ProgramExit::Ended { at, code: Some(code), words: words.map(Into::into) };
    log.received.retain(|r| r.at < at);
    log.until = log.until.min(at + ms(5.0));
}

fn named(names: &[&str]) -> DriveTextMsg {
    DriveTextMsg::of_joints(names)
}

pub(super) fn phase_begin(log: &DriveLog, wanted: PhaseKind) -> MonoNs {
    log.phases.iter().find(|p| p.kind == wanted).unwrap().from
}

pub(super) const NO_TWEAK: Tweak = untouched;
pub(super) const NO_CHANGE: Change = |_| {};

/// (what is planted, in which trial, how, the rules that find it)
pub(super) fn violations() -> Vec<(&'static str, DriveTrial, Tweak, Change, Vec<R>)> {
    use DriveTrial::{Motion, NotFinite, Silence, WrongJoints};
    vec![
        (
            "answers START by a state without INITIAL",
            Motion,
            |s, _| s.flags = 0,
            |log| log.phases.clear(),
            vec![R::Answer],
        ),
        ("answers late", Motion, NO_TWEAK, |log| log.arm.connect_timeout = ms(1.0), vec![R::Answer]),
        ("INITIAL of another tick", Motion, |s, t| s.tick += u64::from(t < 0.0), NO_CHANGE, vec![R::Answer]),
        (
            "answers the first START alone",
            Motion,
            NO_TWEAK,
            |log| {
                log.received.remove(1);
                for r in log.received.iter_mut().skip(1) {
                    r.state.sequence -= 1;
                }
            },
            vec![R::EveryStart],
        ),
        ("three joints", Motion, |s, _| s.joints = 3, NO_CHANGE, vec![R::Joints]),
        (
            "joints in another order",
            Motion,
            NO_TWEAK,
            |log| log.texts.iter_mut().for_each(|t| t.text = named(&["j1", "j0", "j2", "j3"])),
            vec![R::JointNames],
        ),
        (
            "joints of another robot",
            Motion,
            NO_TWEAK,
            |log| log.texts[1].text = named(&["axis_1", "axis_2", "axis_3", "axis_4"]),
            vec![R::JointNames],
        ),
        (
            "fewer names than joints",
            Motion,
            NO_TWEAK,
            |log| log.texts[0].text = named(&["j0", "j1", "j2"]),
            vec![R::JointNames],
        ),
        (
            "a joint that counts the other way round",
            Motion,
            NO_TWEAK,
            |log| log.texts[0].text.signs[2] = -1.0,
            vec![R::JointNames],
        ),
        (
            "a joint with another zero",
            Motion,
            NO_TWEAK,
            |log| log.texts[0].text.zero_offsets[1] = -1.5,
            vec![R::JointNames],
        ),
        (
            "names after the answer to START",
            Motion,
            NO_TWEAK,
            |log| log.texts.iter_mut().for_each(|t| t.at = t.at + ms(60.0)),
            vec![R::JointNames],
        ),
        (
            "another period than the drive has",
            Motion,
            NO_TWEAK,
            |log| {
                let text = DriveTextMsg::of_properties("period_ms 2");
                log.texts.push(ReceivedText { at: log.texts[0].at, text });
            },
            vec![R::Properties],
        ),
        (
            "a watchdog of a cycle",
            Motion,
            NO_TWEAK,
            |log| {
                let text = DriveTextMsg::of_properties("period_ms 1\nwatchdog_ms 1");
                log.texts.push(ReceivedText { at: log.texts[0].at, text });
            },
            vec![R::Properties],
        ),
        (
            "another lag than the arm has",
            Motion,
            NO_TWEAK,
            |log| {
                let text = DriveTextMsg::of_properties("period_ms 1\nwatchdog_ms 100\nlag_ms 38");
                log.texts
                    .iter_mut()
                    .filter(|t| t.text.kind == text_kind::PROPERTIES)
                    .for_each(|t| t.text = text);
            },
            vec![R::Lag],
        ),
        ("no modes", Motion, |s, _| s.modes = 0, NO_CHANGE, vec![R::Modes]),
        ("modes that there are not", Motion, |s, _| s.modes |= 32, NO_CHANGE, vec![R::Modes]),
        (
            "modes that change",
            Motion,
            |s, t| s.modes = if t > 900.0 { 0b111 } else { 0b110 },
            NO_CHANGE,
            vec![R::Modes],
        ),
        ("not the mode of the run file", Motion, |s, _| s.modes = 0b001, NO_CHANGE, vec![R::Modes]),
        ("flags that there are not", Motion, |s, _| s.flags |= 64, NO_CHANGE, vec![R::Flags]),
        (
            "INITIAL in the middle",
            Motion,
            |s, t| s.flags |= if t == 800.0 { drive_flag::INITIAL } else { 0 },
            |log| {
                for r in log.received.iter_mut().filter(|r| r.state.tick > 800) {
                    r.state.tick -= 1;
                }
            },
            vec![R::Flags],
        ),
        (
            "a state that no robot has",
            Motion,
            |s, t| s.robot_state = if t > 900.0 { 11 } else { 1 },
            NO_CHANGE,
            vec![R::RobotState],
        ),
        ("another arm", Motion, |s, _| s.arm = 1, NO_CHANGE, vec![R::Flags]),
        (
            "a torque that is none",
            Motion,
            |s, t| s.tau[1] = if t == 700.0 { f64::NAN } else { 0.0 },
            NO_CHANGE,
            vec![R::Finite],
        ),
        ("a posture beyond the limits", Motion, |s, _| s.q[0] += 4.0, NO_CHANGE, vec![R::Range]),
        (
            "a velocity beyond the limits",
            Motion,
            |s, t| {
                if t == 900.0 {
                    s.qd[1] = 40.0
                }
            },
            NO_CHANGE,
            vec![R::Range],
        ),
        (
            "the truth of another posture",
            Motion,
            |s, _| {
                s.flags |= drive_flag::TRUTH;
                s.q_true[0] = 2.0;
            },
            NO_CHANGE,
            vec![R::Truth],
        ),
        (
            "states that are never sent",
            Motion,
            NO_TWEAK,
            |log| log.received.retain(|r| r.state.sequence % 100 != 50),
            vec![R::Sequence, R::Tick],
        ),
        (
            "a sequence that stands",
            Motion,
            |s, _| s.sequence = s.sequence.min(500),
            NO_CHANGE,
            vec![R::Sequence],
        ),
        ("a sequence from 1", Motion, |s, _| s.sequence += 1, NO_CHANGE, vec![R::Sequence]),
        ("ticks of another count", Motion, |s, _| s.tick *= 2, NO_CHANGE, vec![R::Tick]),
        (
            "the time of day",
            Motion,
            |s, _| s.stamp = s.stamp + SpanNs(1_700_000_000_000_000_000),
            NO_CHANGE,
            vec![R::Clock],
        ),
        ("microseconds", Motion, |s, _| s.stamp.0 /= 1000, NO_CHANGE, vec![R::Clock]),
        ("stamps of the next state", Motion, |s, _| s.stamp = s.stamp + TICK, NO_CHANGE, vec![R::Future]),
        (
            "the same sample twice",
            Motion,
            |s, _| s.stamp.0 -= s.stamp.0 % 2_000_000,
            NO_CHANGE,
            vec![R::Rising],
        ),
        (
            "a stream that ends",
            Motion,
            NO_TWEAK,
            |log| log.received.retain(|r| r.state.tick < 1500),
            vec![R::Rate],
        ),
        (
            "a pause",
            Motion,
            NO_TWEAK,
            |log| {
                log.received.retain(|r| !(2000..2150).contains(&r.state.tick));
                for (i, r) in log.received.iter_mut().enumerate() {
                    r.state.sequence = i as u64;
                    r.state.tick -= if r.state.tick >= 2150 { 150 } else { 0 };
                }
            },
            vec![R::Rate],
        ),
        (
            "states from a long queue",
            Motion,
            NO_TWEAK,
            |log| {
                for r in &mut log.received {
                    r.at = r.at + ms(150.0);
                }
            },
            vec![R::Age],
        ),
        (
            "moves when it answers",
            Motion,
            |s, t| {
                if t < 0.0 {
                    s.qd[0] = 0.2
                }
            },
            NO_CHANGE,
            vec![R::Rest],
        ),
        (
            "sinks while it is held",
            Motion,
            |s, t| s.q[1] -= 1e-5 * t.clamp(0.0, 600.0),
            NO_CHANGE,
            vec![R::Hold],
        ),
        (
            "reports a velocity at rest",
            Motion,
            |s, t| s.qd[2] += if (0.0..600.0).contains(&t) { 0.02 } else { 0.0 },
            NO_CHANGE,
            vec![R::Hold],
        ),
        (
            "was given up",
            Motion,
            NO_TWEAK,
            |log| log.given_up = Some("joint 1 is elsewhere".into()),
            vec![R::Course],
        ),
        (
            "joints of another order",
            Motion,
            |s, _| {
                let (a, b) = (s.q[0] - START[0], s.q[3] - START[3]);
                (s.q[0], s.q[3]) = (START[0] + b, START[3] + a);
                s.qd.swap(0, 3);
            },
            NO_CHANGE,
            vec![R::Order],
        ),
        (
            "a joint that moves with another",
            Motion,
            |s, _| s.q[1] += 0.5 * (s.q[0] - START[0]),
            NO_CHANGE,
            vec![R::Order],
        ),
        (
            "a sign",
            Motion,
            |s, _| {
                s.q[3] = 2.0 * START[3] - s.q[3];
                s.qd[3] = -s.qd[3];
            },
            NO_CHANGE,
            vec![R::Sign],
        ),
        (
            "a gear that is not as told",
            Motion,
            |s, _| {
                for j in 0..JOINTS {
                    s.q[j] = START[j] + (s.q[j] - START[j]) / 1.5;
                    s.qd[j] /= 1.5;
                }
            },
            NO_CHANGE,
            vec![R::Follow],
        ),
        (
            "an arm that does not move",
            Motion,
            |s, _| (s.q, s.qd) = (START, [0.0; 7]),
            NO_CHANGE,
            vec![R::Follow],
        ),
        (
            "a limit that cuts the motion",
            Motion,
            |s, _| {
                let least = START[0] - 0.012;
                if s.q[0] < least {
                    (s.q[0], s.qd[0]) = (least, 0.0);
                }
            },
            NO_CHANGE,
            vec![R::Follow],
        ),
        ("stamps that are too old", Motion, |s, _| s.stamp.0 -= 40_000_000, NO_CHANGE, vec![R::Lag]),
        (
            "velocities in another unit",
            Motion,
            |s, _| s.qd.iter_mut().for_each(|v| *v *= 10.0),
            NO_CHANGE,
            vec![R::Velocity],
        ),
        (
            "velocities of the other sign",
            Motion,
            |s, _| s.qd.iter_mut().for_each(|v| *v = -*v),
            NO_CHANGE,
            vec![R::Velocity],
        ),
        ("no velocities", Motion, |s, _| s.qd = [0.0; 7], NO_CHANGE, vec![R::Velocity]),
        ("an early end", Motion, NO_TWEAK, |log| ended(log, BEGIN + ms(2000.0), 0, None), vec![R::Stays]),
        (
            "moves on after LAST",
            Motion,
            |s, t| s.q[0] += 1e-4 * (t - 7200.0).max(0.0) * 3.0,
            NO_CHANGE,
            vec![R::LastRest],
        ),
        ("never ends", Motion, NO_TWEAK, |log| log.exit = ProgramExit::Ran, vec![R::LastExit]),
        (
            "ends with another code",
            Motion,
            NO_TWEAK,
            |log| {
                if let ProgramExit::Ended { code, .. } = &mut log.exit {
                    *code = Some(1);
                }
            },
            vec![R::LastExit],
        ),
        (
            "goes on without commands",
            Silence,
            |s, t| s.q[0] += 0.02e-3 * (t - 1100.0).max(0.0),
            NO_CHANGE,
            vec![R::Silence],
        ),
        (
            "falls silent without commands",
            Silence,
            NO_TWEAK,
            |log| {
                let from = phase_begin(log, PhaseKind::Silence);
                log.received.retain(|r| r.at < from + ms(50.0));
                log.exit = ProgramExit::Ran;
            },
            vec![R::Silence],
        ),
        (
            "ends without a word",
            Silence,
            NO_TWEAK,
            |log| {
                let from = phase_begin(log, PhaseKind::Silence);
                ended(log, from + ms(300.0), 0, None);
            },
            vec![R::SilenceTold],
        ),
        (
            "obeys another count of joints",
            WrongJoints,
            |s, t| s.q[0] += 0.02e-3 * (t - 620.0).max(0.0),
            NO_CHANGE,
            vec![R::RefusesJoints],
        ),
        (
            "obeys numbers that are none",
            NotFinite,
            |s, t| {
                if t > 700.0 {
                    s.q[2] = f64::NAN
                }
            },
            NO_CHANGE,
            vec![R::Finite, R::RefusesNumbers],
        ),
    ]
}
