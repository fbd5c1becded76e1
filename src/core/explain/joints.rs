//! Do the joints do what they are told? The faults of a run, and what came before them in the joints' own records.

use super::{Cause, RunEvidence, RunFinding, median};
use crate::config::DriveKind;
use crate::control::outcome::Outcome;
use crate::control::safety::Fault;
use crate::drive::CommandMode;
use crate::robot::joint_in_words;

/// Ticks over which the answer to a torque is searched. Chosen by hand: a drive that is later than that moves no arm.
const LATEST: usize = 80;
/// Ticks from which on a drive is late. Derived: the torque of a tick acts from that tick on, and velocities that come from differences are a tick or two late.
const LATE: usize = 5;
/// Correlation of torque and acceleration that tells the delay. Chosen by hand: of arms without delay it is above 0.9, of one whose joints are held below 0.3.
const CLEAR: f64 = 0.7;
/// Without the delay the correlation must be worse by this factor. Chosen by hand: smooth motions correlate at any delay.
const WORSE: f64 = 0.8;
/// A joint that was stopped has less than this share of its last velocity a tick later. Chosen by hand: an arm that brakes within its limits has 0.9 of it.
const STOPPED_SHARE: f64 = 0.05;
/// And had this share of its fastest before. Chosen by hand: friction holds joints that are nearly at rest.
const MOVING_SHARE: f64 = 0.05;
/// Ticks for which it then stands. Chosen by hand: a joint that changes its direction stands for one or two.
const STANDS: usize = 20;

/// A joint that was never faster has not moved, rad/s or m/s. Chosen by hand.
const MOVES: f64 = 1e-2;
/// Ticks for which a reading that is stuck has stayed the same. Derived: so long control waits at least before it says so (`control/safety/encoders.rs`).
const STUCK_TICKS: usize = 30;

/// The columns of one joint.
struct JointColumns<'a> {
    number: usize,
    /// What it is called.
    called: String,
    q: &'a [f64],
    qd: &'a [f64],
    q_r: &'a [f64],
    qd_r: &'a [f64],
    tau: &'a [f64],
}

fn joints(evidence: &RunEvidence) -> Vec<JointColumns<'_>> {
    let names = evidence.config.robot.joint_names();
    let column = |name: &str, number: usize| evidence.trace.numbers(&format!("{name}_{number}"));
    let joint = |number| JointColumns {
        number,
        called: joint_in_words(&names, number - 1),
        q: column("q", number),
        qd: column("qd", number),
        q_r: column("q_r", number),
        qd_r: column("qd_r", number),
        tau: column("tau", number),
    };
    (1..=evidence.config.robot.joint_count()).map(joint).filter(|joint| !joint.q.is_empty()).collect()
}

pub(super) fn findings(evidence: &RunEvidence) -> Vec<RunFinding> {
    let joints = joints(evidence);
    let mut found = Vec::new();
    if evidence.config.drive.mode == CommandMode::Torque
        && !matches!(evidence.config.drive.kind, DriveKind::None | DriveKind::Replay)
    {
        found.extend(delay(&joints));
    }
    found.extend(encoders(evidence, &joints));
    found.extend(load(evidence));
    found.extend(fault(evidence, &joints));
    found.extend(earlier_fault(evidence));
    found
}

/// All faults.
fn faults() -> impl Iterator<Item = Fault> {
    (1..64).filter_map(Fault::from_code) // Chosen: more than there are codes.
}

/// The first fault of a run that went on after it.
fn earlier_fault(evidence: &RunEvidence) -> Option<RunFinding> {
    let RunEvidence { summary, .. } = evidence;
    let words: Vec<&str> = faults().map(Fault::describe).collect();
    let told = || summary.safety.events.iter().filter(|event| words.contains(&event.event.as_str()));
    let first = told().next().filter(|_| summary.outcome != Outcome::Fault)?;
    Some(RunFinding {
        cause: Cause::EarlierFault,
        what: format!("a fault stopped the arm on the way: {}", first.event),
        evidence: format!("at {:.3} s; {} in all, and the run went on", first.time_s, told().count()),
        change: "as it says, so that it does not come again".into(),
    })
}

/// The fault that ended the run.
fn fault(evidence: &RunEvidence, joints: &[JointColumns<'_>]) -> Option<RunFinding> {
    let summary = &evidence.summary;
    if summary.outcome != Outcome::Fault {
        return None;
    }
    // Behind it may stand which joint nobody could tell about.
    let fault = faults().find(|fault| summary.reason.starts_with(fault.describe()));
    let times = evidence.trace.numbers("time_s");
    if matches!(fault, Some(Fault::StuckReading | Fault::EncoderFrozen))
        && let Some((row, joint)) =
            joints.iter().filter_map(|joint| Some((stuck_from(joint)?, joint))).min_by_key(|(row, _)| *row)
    {
        return Some(RunFinding {
            cause: Cause::StuckReading,
            what: format!("the reading of {} is stuck: its encoder is frozen, or something holds the joint", joint.called),
            evidence: format!("it had moved, and has the same value to the last digit from {:.3} s on", times.get(row).copied().unwrap_or(f64::NAN)),
            change: "no key: see to its encoder and the cable, then to the joint, its brake and its drive; where it sticks, tell its friction in the robot file".into(),
        });
    }
    if matches!(fault, Some(Fault::DoesNotFollow | Fault::Contact | Fault::TrackingError))
        && let Some((joint, row, speed)) = joints.iter().find_map(stop)
    {
        return Some(RunFinding {
            cause: Cause::Jammed,
            what: format!(
                "{} was stopped from one tick to the next, and stands: it is jammed, braked, or ran against something hard",
                joint.called
            ),
            evidence: format!(
                "at {:.3} s it moved with {speed:.3} rad/s or m/s, a tick later not at all, and does not follow its reference any more",
                times.get(row).copied().unwrap_or(f64::NAN)
            ),
            change: "no key: free the joint, see to its brake and drive".into(),
        });
    }
    match fault {
        Some(Fault::DoesNotFollow | Fault::TrackingError | Fault::StuckReading) => Some(does_not_follow(evidence, joints)),
        Some(Fault::Contact) => Some(RunFinding {
            cause: Cause::Contact,
            what: "something touched the arm, or pushes it".into(),
            evidence: summary.contact.as_ref().map_or(summary.reason.clone(), |contact| contact.to_text()),
            change: "clear its way; safety.contact for an arm that is to be touched; [tool] and friction in the robot file where nothing does".into(),
        }),
        Some(Fault::DeadlinesMissed) => Some(RunFinding {
            cause: Cause::Deadlines,
            what: "control did not get its core in time".into(),
            evidence: format!(
                "{} deadlines were missed, more than safety.max_missed_deadlines_in_a_row ({}) in a row",
                summary.missed_deadlines, evidence.config.safety.max_missed_in_a_row
            ),
            change: "realtime.policy = \"enforce\", realtime.cpu; `vservo doctor` tells what the machine lacks".into(),
        }),
        _ => Some(RunFinding {
            cause: Cause::OtherFault,
            what: summary.reason.clone(),
            evidence: "the fault of the run".into(),
            change: "as it says".into(),
        }),
    }
}

/// The joint that is farthest from its reference, of those that hardly moved.
fn does_not_follow(evidence: &RunEvidence, joints: &[JointColumns<'_>]) -> RunFinding {
    let off = |joint: &&JointColumns<'_>| match (joint.q.last(), joint.q_r.last()) {
        (Some(q), Some(q_r)) => (q - q_r).abs(),
        _ => 0.0,
    };
    let worst = joints.iter().max_by(|a, b| off(a).total_cmp(&off(b)));
    let evidence = worst.map_or(String::new(), |joint| {
        let limit = evidence.config.robot.joints.get(joint.number - 1).map_or(f64::NAN, |j| j.limits.effort);
        format!(
            "{} was {:.4} rad or m from its reference at the end; its reference moved with up to {:.3}, it with {:.3} rad/s or m/s; its drive gave up \
             to {:.0} % of its largest effort",
            joint.called,
            off(&joint),
            greatest(joint.qd_r),
            greatest(joint.qd),
            100.0 * greatest(joint.tau) / limit,
        )
    });
    RunFinding {
        cause: Cause::Friction,
        what: "a joint does not get off: friction that nobody told, a brake, or a drive that is off".into(),
        evidence,
        change:
            "friction in the robot file (coulomb_n_m_or_n, viscous_...); a start that moves the joint by more"
                .into(),
    }
}

/// The row from which on a joint that had moved has the same reading to the end.
fn stuck_from(joint: &JointColumns<'_>) -> Option<usize> {
    let last = joint.q.last().filter(|_| greatest(joint.qd) > MOVES)?;
    let row = joint.q.iter().rposition(|q| q != last)? + 1;
    (joint.q.len() - row >= STUCK_TICKS).then_some(row)
}

/// Where a moving joint stood from one tick to the next, though its reference went on: the row, and its speed before.
fn stop<'a, 'b>(joint: &'b JointColumns<'a>) -> Option<(&'b JointColumns<'a>, usize, f64)> {
    let fastest = greatest(joint.qd);
    let speed = |row: usize| joint.qd.get(row).map_or(f64::NAN, |v| v.abs());
    let stopped = |row: &usize| {
        let before = speed(row - 1);
        let goes_on = joint.qd_r.get(*row).is_some_and(|v| v.abs() > 0.5 * before);
        let stands = (*row..row + STANDS).all(|later| speed(later) <= STOPPED_SHARE * before);
        before > MOVING_SHARE * fastest && goes_on && stands && fastest > MOVES
    };
    let row = (1..joint.qd.len()).find(stopped)?;
    Some((joint, row, speed(row - 1)))
}

fn greatest(values: &[f64]) -> f64 {
    values.iter().filter(|x| x.is_finite()).fold(0.0, |most: f64, x| most.max(x.abs()))
}

/// The delay from torque to acceleration, where it is clear in two joints or more.
fn delay(joints: &[JointColumns<'_>]) -> Option<RunFinding> {
    let late: Vec<(usize, f64)> = joints.iter().filter_map(late).collect();
    if late.len() < 2 {
        return None;
    }
    let ticks = median(late.iter().map(|(ticks, _)| *ticks as f64));
    let clear = median(late.iter().map(|(_, clear)| *clear));
    Some(RunFinding {
        cause: Cause::DriveDelay,
        what: format!("the drive obeys {ticks:.0} ms late"),
        evidence: format!(
            "joints accelerate as they were told {ticks:.0} ticks before (correlation {clear:.2}), in {} joints; a drive without delay answers within two",
            late.len()
        ),
        change: "shorten the way to the drive; else motion.natural_frequency_rad_s and servo.gain_1_s lower, motion.disturbance_rad_s = 0, servo.lead_ms".into(),
    })
}

/// Ticks by which a joint answers late, and its correlation there.
fn late(joint: &JointColumns<'_>) -> Option<(usize, f64)> {
    let acceleration: Vec<f64> = joint
        .qd
        .windows(2)
        .map(|pair| pair.iter().rev().copied().reduce(|b, a| b - a).unwrap_or(0.0))
        .collect();
    let at = |ticks: usize| correlation(joint.tau, acceleration.get(ticks..).unwrap_or_default());
    let (ticks, best) = (0..LATEST).map(|ticks| (ticks, at(ticks))).max_by(|a, b| a.1.total_cmp(&b.1))?;
    (ticks >= LATE && best > CLEAR && at(1) < WORSE * best).then_some((ticks, best))
}

/// Pearson's coefficient of the rows that both have.
fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let n = a.len().min(b.len()) as f64;
    let pairs = || a.iter().zip(b);
    let (sum_a, sum_b) = pairs().fold((0.0, 0.0), |(x, y), (a, b)| (x + a, y + b));
    let (mean_a, mean_b) = (sum_a / n, sum_b / n);
    let (ab, aa, bb) = pairs().fold((0.0, 0.0, 0.0), |(ab, aa, bb), (a, b)| {
        let (a, b) = (a - mean_a, b - mean_b);
        (ab + a * b, aa + a * a, bb + b * b)
    });
    let norm = (aa * bb).sqrt();
    if norm > 0.0 { ab / norm } else { 0.0 }
}

/// The step of encoders that are coarser than the run file says.
fn encoders(evidence: &RunEvidence, joints: &[JointColumns<'_>]) -> Option<RunFinding> {
    let told = &evidence.config.effective.motion.encoder_step_rad_or_m;
    let told = told.iter().copied().fold(0.0, f64::max);
    let step = |joint: &JointColumns<'_>| {
        let steps = joint.q.windows(2).filter_map(|pair| match pair {
            [a, b] if a != b => Some((b - a).abs()),
            _ => None,
        });
        let steps: Vec<f64> = steps.collect();
        // Chosen by hand: a finer step than 1e-5 rad or m disturbs no arm, because it is below what positions need at 1 kHz.
        let is_coarse = |step: f64| step > 1e-5;
        let least = steps.iter().copied().fold(f64::INFINITY, f64::min);
        // All are multiples of the least: steps, not motions.
        let multiple = |x: &f64| ((x / least) - (x / least).round()).abs() < 0.01; // chosen: positions have nine decimals
        (steps.len() > 3 && is_coarse(least) && steps.iter().all(multiple)).then_some(least)
    };
    let steps: Vec<f64> = joints.iter().filter_map(step).collect();
    let step = steps.iter().copied().fold(0.0, f64::max);
    if step <= 2.0 * told || (evidence.summary.outcome != Outcome::Fault && !evidence.has_failed()) {
        return None;
    }
    Some(RunFinding {
        cause: Cause::CoarseEncoders,
        what: "the encoders are coarser than the run file says: what control takes for motion are steps"
            .into(),
        evidence: format!(
            "positions change by multiples of {step:.2e} rad or m, motion.encoder_step_rad_or_m is {told}"
        ),
        change: format!(
            "motion.encoder_step_rad_or_m = [{step:.1e}], motion.natural_frequency_rad_s lower, or finer encoders"
        ),
    })
}

/// What it was found to carry.
fn load(evidence: &RunEvidence) -> Option<RunFinding> {
    let payload = evidence.summary.payload.as_ref()?;
    let com = match payload.com_m {
        Some([x, y, z]) => format!("tool.com_m = [{x:.3}, {y:.3}, {z:.3}]"),
        None => {
            "its centre of mass (tool.com_m) does not show in this motion: `vservo calibrate load` finds it"
                .into()
        }
    };
    Some(RunFinding {
        cause: Cause::Load,
        what: format!("the arm carries {:.2} kg that the run file does not tell", payload.mass_kg),
        evidence: format!(
            "the torques with which it stands and moves, against those of its model (standard deviation {:.2} kg)",
            payload.mass_sd_kg
        ),
        change: format!("tool.mass_kg = {:.2}; {com}", payload.mass_kg),
    })
}
