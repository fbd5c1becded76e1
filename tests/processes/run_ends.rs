//! Every end of a run is an arm at rest: whatever ends it, the arm brakes within its limits as long as that takes, and the last
//! command finds the measured arm standing.

#![allow(clippy::unwrap_used, clippy::panic)] // helpers of tests are tests

use crate::common::seen;
use nalgebra::SVector;
use std::path::Path;
use vservo::config::Config;
use vservo::config::assemble;
use vservo::control::outcome::{Finish, Outcome};
use vservo::control::safety::Fault;
use vservo::messages::frame_flag;
use vservo::mission::LockstepRun;
use vservo::report::statistics::RunStatistics;
use vservo::time::MonoNs;

const MS: i64 = 1_000_000;
/// The arm is on its way at this tick.
const END_AT: i64 = 300;
/// From here on an arm counts as at rest, rad/s or m/s.
const REST: f64 = 0.02;

/// What ends the run.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Cause {
    TimeIsUp,
    Request,
    LastFrame,
    Deadlines,
    /// The goal is so lax that it is reached in motion.
    Goal,
}

/// How a run ended, as seen from outside.
struct End {
    finish: Finish,
    tick: i64,
    /// Measured speed at `END_AT` and at the last tick.
    speed: [f64; 2],
    /// Largest acceleration of the arm in units of its limit, in the whole run and in the way it ends.
    acceleration: f64,
    events: Vec<String>,
}

fn run<const N: usize>(
    config: &Config,
    robot: &vservo::robot::Robot<N>,
    mut control: LockstepRun<N>,
    cause: Cause,
) -> End {
    let limits = assemble::motion_limits(config, robot).unwrap();
    let (mut speed, mut acceleration, mut before) = ([0.0, 0.0], 0.0_f64, SVector::<f64, N>::zeros());
    let mut statistics = RunStatistics::new(Vec::new());
    for k in 0..60_000_i64 {
        let now = MonoNs(k * MS);
        let joint = control.sense(k as u64, now);
        let q = SVector::<f64, N>::from_fn(|i, _| joint.q_true[i]);
        let qd = SVector::<f64, N>::from_fn(|i, _| joint.qd_true[i]);
        speed[1] = qd.amax();
        if k == END_AT {
            speed[0] = qd.amax();
        }
        let share = ((qd - before) / 1e-3).component_div(&limits.acceleration).amax();
        let ending = k > END_AT || cause == Cause::Goal;
        acceleration = if ending { acceleration.max(share) } else { 0.0 };
        before = qd;
        match cause {
            Cause::Request if k == END_AT => control.stop("asked for"),
            Cause::Deadlines if k == END_AT => control.fail(Fault::DeadlinesMissed),
            _ => {}
        }
        let mut m = (k % 20 == 0).then(|| seen(config, robot, &q, k));
        if let Some(m) = m.as_mut().filter(|_| cause == Cause::LastFrame && k == END_AT) {
            m.flags |= frame_flag::LAST;
        }
        let trace = control.act(now, m.as_ref());
        statistics.note(&trace);
        if let Some(finish) = trace.finish {
            // What the drive makes of the end itself.
            let joint = control.sense(k as u64 + 1, MonoNs((k + 1) * MS));
            let after = SVector::<f64, N>::from_fn(|i, _| joint.qd_true[i]);
            let share = ((after - before) / 1e-3).component_div(&limits.acceleration).amax();
            acceleration = acceleration.max(share);
            let events =
                statistics.safety_report(control.state()).events.into_iter().map(|e| e.event).collect();
            return End { finish, tick: k, speed, acceleration, events };
        }
    }
    panic!("the run does not end: {cause:?}");
}

fn end(file: &str, set: &[&str], cause: Cause) -> End {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("config").join(file);
    let mut set: Vec<String> = set.iter().map(ToString::to_string).collect();
    if cause == Cause::TimeIsUp {
        set.push(format!("run.duration_s={}", END_AT as f64 * 1e-3));
    }
    if cause == Cause::Goal {
        set.extend(["goal.feature_error_px=100", "goal.hold_s=0.01"].map(String::from));
    }
    let config = Config::load(Some(&path), &set).unwrap();
    vservo::dispatch_robot!(config.robot, |robot| {
        let copy = robot.clone();
        run(&config, &copy, assemble::control_loop(&config, robot).unwrap(), cause)
    })
    .unwrap()
}

const CAUSES: [(Cause, Outcome, &str); 5] = [
    (Cause::TimeIsUp, Outcome::NotConverged, "run.duration_s is over"),
    (Cause::Request, Outcome::Stopped, "asked for"),
    (Cause::LastFrame, Outcome::NotConverged, "last frame"),
    (Cause::Deadlines, Outcome::Fault, "deadlines"),
    (Cause::Goal, Outcome::Converged, "the goal was reached"),
];

/// The default run at a gain at which it is quick.
const QUICK: [&str; 1] = ["servo.gain_1_s=10"];

#[test]
fn every_end_of_a_run_brakes_the_arm_within_its_limits() {
    for file in ["default.toml", "ur5.toml", "scara-b.toml", "scara-a.toml", "scara-c.toml"] {
        let torque_law = file.ends_with("-a.toml") || file.ends_with("-c.toml");
        for (cause, outcome, reason) in CAUSES {
            let quick: &[&str] = if torque_law { &[] } else { &QUICK };
            let e = end(file, quick, cause);
            let told = format!("{file} {cause:?}: {:?}", e.finish);
            if cause != Cause::Goal {
                assert!(e.speed[0] > 2.0 * REST, "{told}: it moved at {}", e.speed[0]);
                assert!(e.tick > END_AT, "{told}: at once, at tick {}", e.tick);
            }
            assert!(e.speed[1] < REST, "{told}: it moves at {}", e.speed[1]);
            assert_eq!(e.finish.outcome, outcome, "{told}");
            assert!(e.finish.reason.contains(reason), "{told}");
            // A request and a fault are events of safety; an end that was to be expected is none.
            let told_of = ["slows down", "deadlines"].iter().any(|w| e.events.iter().any(|e| e.contains(w)));
            assert_eq!(told_of, matches!(cause, Cause::Request | Cause::Deadlines), "{told}: {:?}", e.events);
            // Joint control follows its reference a tick late, which costs 5 %; a torque law has no such limit of its own.
            if !torque_law {
                assert!(e.acceleration < 1.1, "{told}: {} of the acceleration limit", e.acceleration);
            }
        }
    }
}

/// A joint that may change its acceleration only slowly needs more than the second after which a stop used to be cut.
#[test]
fn braking_takes_as_long_as_the_limits_say() {
    let slow = ["servo.gain_1_s=10", "motion.max_jerk_rad_s3_or_m_s3=[1.0,1.0,1.0,1.0]"];
    let e = end("default.toml", &slow, Cause::Request);
    assert!(e.tick > END_AT + 600, "{}", e.tick);
    assert!(e.speed[1] < REST, "{}", e.speed[1]);
}
