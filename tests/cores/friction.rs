//! Arms whose friction is not what their files say, in this process and with vision: each run converges. The acceleration at the plant stays
//! within 20 % of its limit of 10 rad/s^2 while commands are in time, and within its order with late ones. A dozen runs with all tests; more
//! scales and delays on all shipped arms by
//!
//! ```text
//! VSERVO_CAMPAIGN=1 cargo test --test cores friction:: -- --nocapture
//! ```

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout)] // helpers of tests; numbers for people

use std::ops::ControlFlow;
use std::path::Path;
use vservo::config::Config;
use vservo::control::outcome::Outcome;
use vservo::messages::MAX_JOINTS;
use vservo::sim::{Moment, simulate_system};

/// Run files of all shipped arms under torque control.
const ARMS: [&str; 5] = ["xarm7", "pan_tilt", "ur5", "panda", "scara-b"];

/// Largest acceleration of any joint in the mean of a tick, rad/s^2 or m/s^2, and how the run ended.
fn ran(file: &str, scale: f64, delay: usize, more: &[&str]) -> (f64, Outcome) {
    let friction = if scale == 0.0 {
        "drive.simulated.friction=false".to_owned()
    } else {
        format!("scene.arm.friction_scale={scale}")
    };
    let mut set = vec![friction, format!("drive.simulated.command_delay_ticks={delay}")];
    set.extend(more.iter().map(|key| (*key).to_owned()));
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("config/{file}.toml"));
    let config = Config::load(Some(&path), &set).unwrap_or_else(|e| panic!("{file}: {e}"));
    let (mut before, mut hardest) = (None::<[f64; MAX_JOINTS]>, 0.0_f64);
    let run = simulate_system(&config, &mut |moment| {
        if let Moment::Tick(trace, _) = moment {
            let qd = trace.joint_state.qd_true;
            for (qd, before) in qd.iter().zip(before.unwrap_or(qd)) {
                hardest = hardest.max((qd - before).abs() / 1e-3);
            }
            before = Some(qd);
        }
        ControlFlow::Continue(())
    })
    .unwrap();
    println!("{file:8} friction x {scale:<4} delay {delay}: {hardest:7.1} {}", run.finish.outcome.as_str());
    (hardest, run.finish.outcome)
}

#[test]
fn friction_that_is_not_as_believed_does_not_drive_an_arm_away() {
    let campaign = std::env::var_os("VSERVO_CAMPAIGN").is_some();
    let (arms, scales, delays): (&[_], &[_], &[_]) = if campaign {
        (&ARMS, &[0.0, 0.5, 0.7, 0.8, 1.0, 1.5, 2.0], &[0, 1, 2])
    } else {
        (&ARMS[..2], &[0.0, 0.5, 1.0, 2.0], &[0, 2])
    };
    let mut failures = Vec::new();
    for file in arms {
        for &scale in scales {
            for &delay in delays {
                let (hardest, outcome) = ran(file, scale, delay, &[]);
                if outcome != Outcome::Converged || hardest > if delay == 0 { 12.0 } else { 80.0 } {
                    failures.push(format!("{file} x {scale} delay {delay}: {hardest} {}", outcome.as_str()));
                }
            }
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

/// Payloads up to the rated ones, which the run file does not tell, under friction that is not as the file says. When torque control begins the arm sags:
/// until the payload is found, accelerations are those with which it falls.
#[test]
fn a_rated_payload_that_is_not_told_is_carried() {
    let campaign = std::env::var_os("VSERVO_CAMPAIGN").is_some();
    let scales: &[f64] = if campaign { &[0.0, 0.5, 0.8, 1.0, 1.5, 2.0] } else { &[0.5, 2.0] };
    let mut failures = Vec::new();
    for (file, rated_kg) in [("xarm7", 3.5), ("ur5", 5.0), ("panda", 3.0), ("scara-b", 2.0)] {
        for &scale in scales {
            for delay in [0, 2] {
                let payload = format!("drive.simulated.payload_kg={rated_kg}");
                let (hardest, outcome) = ran(file, scale, delay, &[&payload, "run.duration_s=30.0"]);
                if outcome != Outcome::Converged || hardest > 160.0 {
                    failures.push(format!("{file} x {scale} delay {delay}: {hardest} {}", outcome.as_str()));
                }
            }
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

/// Friction that sticks and slips (static friction above the sliding one), which the model does not have: an arm hunts about its goal, but it is neither
/// driven away nor shaken.
#[test]
fn joints_that_stick_and_slip_are_not_shaken() {
    let mut failures = Vec::new();
    for (scale, duration_s) in [(0.5, 30.0), (1.0, 30.0), (1.5, 10.0), (2.0, 10.0)] {
        let duration = format!("run.duration_s={duration_s}");
        let (hardest, outcome) = ran(
            "xarm7",
            scale,
            0,
            // How it hunts is chaotic: on other ways it leaps by up to 800 rad/s^2 (README, limits).
            &[
                "servo.interaction=current",
                "servo.first_motion_m_s=0",
                "drive.simulated.hard_friction=true",
                &duration,
            ],
        );
        if outcome == Outcome::Fault || (scale <= 1.0 && outcome != Outcome::Converged) || hardest > 250.0 {
            failures.push(format!("x {scale}: {hardest} {}", outcome.as_str()));
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

/// A payload that is told moves within the limits from the first tick on, and no faster than the efforts suffice for.
#[test]
fn a_payload_that_is_told_is_moved_within_the_limits() {
    for (file, kg) in [("xarm7", 3.5), ("ur5", 5.0), ("panda", 3.0)] {
        let tool = format!("tool.mass_kg={kg}");
        let (hardest, outcome) = ran(file, 1.0, 0, &[&tool, "tool.com_m=[0.02, -0.03, 0.06]"]);
        assert!(outcome == Outcome::Converged && hardest < 11.0, "{file}: {hardest} {}", outcome.as_str());
    }
}

/// A law that outputs torques has no reference by which friction is confirmed: the model is believed. Scheme A does not bring this arm to its
/// goal, but it does not shake it either. Of the law alone: an arm that goes back to where it saw its target and tries again comes to where this law throws it (README, limits).
#[test]
fn a_torque_law_does_not_shake_an_arm_with_much_friction() {
    let (hardest, outcome) =
        ran("xarm7", 1.0, 0, &["servo.scheme=\"position_pd\"", "servo.return_to_last_seen=false"]);
    assert!(hardest < 30.0, "{hardest} rad/s^2, {}", outcome.as_str());
}
