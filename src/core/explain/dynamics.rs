//! Does the arm answer its torques as its model says? What is left of the torques, tau - (B(q) qdd + C qd + g + friction), tells what the model lacks:
//! ```text
//! rotors that nobody told   left_i = J_i qdd_i in every joint, at all frequencies
//! joints that yield         the same for the last joints, whose rotors are most of what their motors turn; of the others the links swing on their springs,
//!                           and what is left does not follow the motor's acceleration
//! a base that shakes        one frequency for the whole run, whatever the joints do, and in no joint like its acceleration
//! ```
//! Pushes and jams leave something once, friction something that changes its sign with the velocity, a late drive what no joint follows: none of these
//! is like an acceleration.

use super::{Cause, RunEvidence, RunFinding};
use crate::config::DriveKind;
use crate::dispatch_robot;
use crate::drive::CommandMode;
use crate::robot::{Robot, joint_in_words};
use nalgebra::SVector;
use std::f64::consts::TAU;

/// Ticks over which torques and accelerations are averaged. Chosen by hand: differences of velocities of a tick are mostly the encoders' steps, and what swings faster than
/// 100 Hz moves no arm.
const TICKS: usize = 5;
/// Half the width of the mean that is taken off, in such averages. Chosen by hand: slower than 4 Hz is motion, payload and friction.
const HALF_MEAN: usize = 25;
/// Fewest averages. Chosen by hand: half a second.
const FEWEST: usize = 100;
/// What is left of a joint's torque matters from this share of the torque that accelerates it. Chosen by hand: runs of arms that are as described leave 0.001.
const MATTERS: f64 = 0.2;
/// Correlation with the acceleration that makes it a rotor's. Measured, in runs of UR5, Panda, xArm7 and SCARA (what the tests plant are other draws): 0.99 and more for rotors, up
/// to 0.8 for the first joints of arms that fail because their joints yield, and 0.3 for bases that shake.
const LIKE_ROTOR: f64 = 0.99;
/// Correlation up to which it is none. Measured, see above.
const UNLIKE_ROTOR: f64 = 0.9;
/// A motor that needs so many times what the model tells turns little more than itself, and follows its torque though its joint yields. Measured: last joints of such arms have 2.3 to 14.
const TURNS_ITSELF: f64 = 2.0;
/// Correlation with the acceleration of a motor that follows its torque so. Measured: those joints have more, the others of such arms less.
const FOLLOWS: f64 = 0.8;
/// Share of what is left that one frequency takes where the base shakes. Measured: 0.9 and more there; a joint's swing has 0.5 of a whole run at most.
const ONE_FREQUENCY: f64 = 0.7;
/// Frequencies among which it is searched, Hz. Chosen by hand: machines and floors; what is slower is taken off, and 100 Hz is the fastest that is seen.
const FREQUENCIES_HZ: std::ops::Range<f64> = 2.0..60.0;

/// What is left of the torques of a joint.
#[derive(Debug, Clone, Copy)]
struct JointRest {
    /// Correlation with the acceleration.
    correlation: f64,
    /// The inertia that fits it, kg m^2 or kg.
    inertia: f64,
    /// Its size beside that of the torque that accelerates the joint.
    share: f64,
}

/// The same of a whole arm.
struct ArmRest<const N: usize> {
    joints: [JointRest; N],
    /// The frequency, Hz, that takes the greatest share of what is left, and that share.
    frequency: Option<(f64, f64)>,
}

pub(super) fn findings(evidence: &RunEvidence) -> Option<RunFinding> {
    let drive = &evidence.config.drive;
    if drive.mode != CommandMode::Torque || matches!(drive.kind, DriveKind::None | DriveKind::Replay) {
        return None;
    }
    dispatch_robot!(evidence.config.robot, |robot| of_robot(&robot, evidence)).ok().flatten()
}

fn of_robot<const N: usize>(robot: &Robot<N>, evidence: &RunEvidence) -> Option<RunFinding> {
    let ArmRest { joints, frequency } = rests(robot, evidence)?;
    let matter: Vec<(usize, JointRest)> =
        (0..).zip(joints).filter(|(_, rest)| rest.share > MATTERS).collect();
    let like: Vec<_> = matter.iter().filter(|(_, r)| r.correlation > LIKE_ROTOR).collect();
    let unlike = matter.iter().filter(|(_, r)| r.correlation < UNLIKE_ROTOR).count();
    let turns_itself = |(_, r): &(usize, JointRest)| r.share > TURNS_ITSELF && r.correlation > FOLLOWS;
    let list = |rests: &[&(usize, JointRest)], text: fn(&JointRest) -> String| {
        let words: Vec<_> = rests
            .iter()
            .map(|(i, rest)| format!("{}: {}", joint_in_words(robot.joint_names(), *i), text(rest)))
            .collect();
        words.join(", ")
    };
    let correlations = |rests: &[&(usize, JointRest)]| list(rests, |rest| format!("{:.2}", rest.correlation));
    let all: Vec<_> = matter.iter().collect();
    if let Some((hz, share)) =
        frequency.filter(|(_, share)| *share > ONE_FREQUENCY && like.is_empty() && matter.len() > 1)
    {
        return Some(RunFinding {
            cause: Cause::ShakingBase,
            what: format!("the base of the arm shakes, with {hz:.1} Hz"),
            evidence: format!(
                "what the model of the arm leaves of the torques swings with that frequency all the time ({:.0} % of it), whatever the joints do ({})",
                share * 100.0,
                list(&all, |rest| format!("{:.0} %", rest.share * 100.0))
            ),
            change: "no key: see to the foundation of the base, and to machines that shake it".into(),
        });
    }
    // An unknown payload has to be accelerated too.
    if like.len() > 1 && 2 * like.len() > matter.len() && evidence.summary.payload.is_none() {
        return Some(RunFinding {
            cause: Cause::UntoldRotors,
            what: "the motors' rotors have inertia that the robot file does not tell".into(),
            evidence: format!(
                "torques exceed those of the model in proportion to each joint's own acceleration (correlation: {}), as if there were kg m2 or kg more ({})",
                correlations(&like),
                list(&like, |rest| format!("{:.3}", rest.inertia))
            ),
            change: "armature_kg_m2_or_kg of each joint in the robot file".into(),
        });
    }
    let yields = evidence.has_failed() && 2 * unlike > matter.len() && matter.iter().any(turns_itself);
    yields.then(|| RunFinding {
        cause: Cause::ElasticJoints,
        what: "the joints yield: their gears are springs, on which the links swing".into(),
        evidence: format!(
            "what the model leaves of the torques follows the acceleration in joints whose motors turn little more than themselves, and not in the others \
             (correlation: {})",
            correlations(&all)
        ),
        change: "motion.natural_frequency_rad_s and servo.gain_1_s lower, motion.max_jerk_rad_s3_or_m_s3 lower; the drive's own loop, where it has one (drive.mode = \"velocity\" or \"position\")".into(),
    })
}

/// What is left in each joint, and the frequency that takes the greatest share of it, with that share.
fn rests<const N: usize>(robot: &Robot<N>, evidence: &RunEvidence) -> Option<ArmRest<N>> {
    let trace = &evidence.trace;
    let times = trace.numbers("time_s");
    let columns = |name: &str| (1..=N).map(|i| trace.numbers(&format!("{name}_{i}"))).collect::<Vec<_>>();
    let (q, qd, tau) = (columns("q"), columns("qd"), columns("tau"));
    let at = |columns: &[&[f64]], row: usize| {
        SVector::<f64, N>::from_fn(|i, _| {
            columns.get(i).and_then(|c| c.get(row)).copied().unwrap_or(f64::NAN)
        })
    };
    let mut series: Vec<[SVector<f64, N>; 3]> = Vec::new();
    let mut seconds = Vec::new();
    for row in (0..times.len().saturating_sub(TICKS)).step_by(TICKS) {
        let (first, last) = (at(&qd, row), at(&qd, row + TICKS));
        let span_s = times.get(row + TICKS)? - times.get(row)?;
        let (q, qd, qdd) = (at(&q, row + TICKS / 2), (first + last) / 2.0, (last - first) / span_s);
        let told = (row..row + TICKS).map(|row| at(&tau, row)).sum::<SVector<f64, N>>() / TICKS as f64;
        let model = robot.inverse_dynamics(&q, &qd, &qdd);
        let left = told - model - robot.friction_torque(&qd);
        let entry = [left, qdd, model - robot.gravity(&q)];
        if entry.iter().all(|v| v.iter().all(|x| x.is_finite())) {
            series.push(entry);
            seconds.push(*times.get(row)?);
        }
    }
    if series.len() < FEWEST {
        return None;
    }
    let fast = without_mean(&series);
    let square =
        |a: usize, b: usize, i: usize| fast.iter().map(|entry| entry[a][i] * entry[b][i]).sum::<f64>();
    let rests = std::array::from_fn(|i| {
        let (left, cross, own, model) = (square(0, 0, i), square(0, 1, i), square(1, 1, i), square(2, 2, i));
        JointRest {
            correlation: cross / (left * own).sqrt(),
            inertia: cross / own,
            share: (left / model).sqrt(),
        }
    });
    // Each joint weighs by its effort limit, so that small ones count.
    let limits = robot.limits();
    let weighed: Vec<SVector<f64, N>> =
        fast.iter().map(|entry| SVector::from_fn(|i, _| entry[0][i] / limits[i].effort)).collect();
    Some(ArmRest { joints: rests, frequency: strongest(&weighed, &seconds) })
}

/// The same without what changes slowly.
fn without_mean<const N: usize>(series: &[[SVector<f64, N>; 3]]) -> Vec<[SVector<f64, N>; 3]> {
    let fast = |i: usize| {
        let near = series
            .get(i.saturating_sub(HALF_MEAN)..(i + HALF_MEAN + 1).min(series.len()))
            .unwrap_or_default();
        std::array::from_fn(|k| {
            let mean = near.iter().map(|entry| entry[k]).sum::<SVector<f64, N>>() / near.len() as f64;
            series.get(i).map_or(mean, |entry| entry[k]) - mean
        })
    };
    (0..series.len()).map(fast).collect()
}

/// The frequency, Hz, whose sine and cosine take the greatest share of the squares, and that share.
fn strongest<const N: usize>(series: &[SVector<f64, N>], seconds: &[f64]) -> Option<(f64, f64)> {
    let whole: f64 = series.iter().map(SVector::norm_squared).sum();
    let length_s = seconds.last()? - seconds.first()?;
    // Half a period over the whole run, so that no frequency lies between two.
    let step = 0.5 / length_s;
    let count = ((FREQUENCIES_HZ.end - FREQUENCIES_HZ.start) / step) as usize;
    let share = |hz: f64| {
        let (mut cosine, mut sine) = (SVector::<f64, N>::zeros(), SVector::<f64, N>::zeros());
        for (x, t) in series.iter().zip(seconds) {
            let (s, c) = (TAU * hz * t).sin_cos();
            cosine += x * c;
            sine += x * s;
        }
        2.0 * (cosine.norm_squared() + sine.norm_squared()) / (series.len() as f64 * whole)
    };
    let all = (0..count).map(|k| FREQUENCIES_HZ.start + k as f64 * step).map(|hz| (hz, share(hz)));
    all.max_by(|a, b| a.1.total_cmp(&b.1))
}
