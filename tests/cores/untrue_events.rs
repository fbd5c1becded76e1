//! Events that must not be told: of a gain in a run without a goal, of a search for what is in view, of joints at their limits that are slower.

#![allow(non_snake_case)]
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use nalgebra::SVector;
use std::ops::ControlFlow::Continue;
use std::path::Path;
use vservo::config::{Config, assemble};
use vservo::control::lifecycle::Request;
use vservo::control::trace::Event;
use vservo::messages::{ControlCommand, ControlState, Measurement, TargetStatus};
use vservo::motion::Limit;
use vservo::robot::Robot;
use vservo::sim::{Moment, perfect_measurement, simulate_system};
use vservo::time::MonoNs;

fn config(file: &str, set: &[&str]) -> Config {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("config").join(file);
    Config::load(Some(&path), &set.iter().map(ToString::to_string).collect::<Vec<_>>()).unwrap()
}

/// The error of a calibration goes up and down with its motion, and nobody waits for it to fall.
#[test]
fn a_calibration_is_not_told_to_come_nearer() {
    let config =
        config("ur5.toml", &["run.task=calibrate_latency", "run.duration_s=20", "scene.motion.kind=still"]);
    let (mut events, mut moved) = (Vec::new(), false);
    let run = simulate_system(&config, &mut |moment| {
        if let Moment::Tick(trace, _) = moment {
            events.extend(trace.events.iter());
            moved |= trace.command.qd_r.iter().any(|qd| qd.abs() > 0.05);
        }
        Continue(())
    })
    .unwrap();
    assert!(moved, "{}", run.finish.reason);
    assert!(!events.contains(&Event::GainReduced), "{events:?}");
}

/// The arm servoes to one target, is sent to another that was never seen, and back to the first one, which is in view all the time.
#[test]
fn what_is_in_view_after_a_change_of_target_is_not_searched() {
    let config = config(
        "ur5.toml",
        &[
            "run.clock=lockstep",
            "run.serve=true",
            "targets.bin.kind=tags",
            "targets.bin.tags={size_m=0.06,first_id=7}",
            "scene.objects.bin={position_m=[0.5,0.9,-0.1],rotation_rpy_deg=[180,0,-90]}",
        ],
    );
    let robot: Robot<6> = config.robot.build().unwrap();
    let mut run = assemble::control_loop::<6>(&config, robot.clone()).unwrap();
    let X_WO = config.X_WO().unwrap();
    let points_O: Vec<_> = config.target.points().iter().map(|point| point.p_O).collect();
    let mut events = Vec::new();
    for k in 0..3500_u64 {
        let now = MonoNs(k as i64 * 1_000_000);
        let state = run.sense(k, now);
        let q = SVector::<f64, 6>::from_fn(|i, _| state.q[i]);
        let goal = |target| ControlCommand { target, ..ControlCommand::of(Request::Goal as u32) };
        match k {
            100 => run.ask(1, Request::Start, &ControlCommand::of(Request::Start as u32)).unwrap(),
            1000 => run.ask(2, Request::Goal, &goal(2)).unwrap(),
            2500 => run.ask(3, Request::Goal, &goal(1)).unwrap(),
            _ => {}
        }
        let X_CO = config.camera.mount.X_WC(&robot, &q).inv_mul(&X_WO);
        // The first frame that is searched for the new target comes after three periods.
        let m = match k {
            1000..2500 => Some(Measurement {
                exposure: now,
                status: TargetStatus::NoMatch as u32,
                target_number: 1,
                ..Measurement::default()
            }),
            2500..2620 => None,
            _ => perfect_measurement(&points_O, &X_CO, now),
        };
        let trace = run.act(now, m.as_ref().filter(|_| k % 40 == 0));
        events.extend(trace.events.iter().map(|event| (k, event)));
    }
    assert!(events.iter().any(|(k, event)| *k < 2500 && *event == Event::NeverSeen), "{events:?}");
    assert!(!events.iter().any(|(_, event)| *event == Event::Searching), "{events:?}");
    assert_eq!(run.state(), ControlState::Servoing, "{events:?}");
}

/// What a limit on the camera's speed slows down is not told as slowed down by joints, which are far from their limits then.
#[test]
fn a_joint_that_space_slows_down_is_not_at_its_velocity_limit() {
    let config = config(
        "ur5.toml",
        &[
            "workspace.camera_speed_m_s=0.03",
            "servo.gain_1_s=40",
            "servo.first_motion_m_s=0",
            "run.duration_s=4",
        ],
    );
    let limits: Vec<f64> = config.robot.joints.iter().map(|joint| joint.limits.velocity).collect();
    let (mut slowed, mut wrong) = (0, 0);
    simulate_system(&config, &mut |moment| {
        if let Moment::Tick(trace, _) = moment {
            let by_space = trace.limits.joints(Limit::Workspace) != 0;
            let shares = trace.command.qd_r.iter().zip(&limits).map(|(qd, limit)| qd.abs() / limit);
            slowed += usize::from(by_space);
            let is_told = trace.limits.joints(Limit::Velocity) != 0;
            wrong += usize::from(is_told && by_space && shares.fold(0.0, f64::max) < 0.5);
        }
        Continue(())
    })
    .unwrap();
    assert!(slowed > 100, "{slowed}");
    assert_eq!(wrong, 0, "of {slowed} ticks");
}
