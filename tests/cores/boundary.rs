//! The boundary to a real arm: what is judged is what the arm does.

#![allow(non_snake_case, clippy::unwrap_used, clippy::expect_used, clippy::panic)] // helpers of tests are tests

use crate::plant::{Over, Plant, config, run};
use nalgebra::SVector;
use std::ops::ControlFlow;
use vservo::config::Config;
use vservo::control::outcome::Outcome;
use vservo::control::safety::Fault;
use vservo::control::trace::Event;
use vservo::robot::Robot;
use vservo::sim::{Moment, simulate_system};

const FILES: [&str; 14] = [
    "default.toml",
    "scara-a.toml",
    "scara-b.toml",
    "scara-c.toml",
    "scara-d.toml",
    "scara-hybrid.toml",
    "scara-eye-to-hand.toml",
    "ur5.toml",
    "ur5-b.toml",
    "ur5-hybrid.toml",
    "panda.toml",
    "xarm7.toml",
    "pan_tilt.toml",
    "dot-grid.toml",
];

/// Calls a function that is generic in the number of joints.
macro_rules! with_robot {
    ($config:expr, |$robot:ident| $body:expr) => {
        vservo::dispatch_robot!($config.robot, |$robot| $body).unwrap()
    };
}

/// Largest shares of the limits on acceleration and jerk at the plant, and how the run ended.
fn shares<const N: usize>(config: &Config, robot: &Robot<N>, offset: f64) -> ([f64; 2], Over<N>) {
    let plant = Plant::new(config, robot, SVector::repeat(offset));
    let over = run(config, robot, plant, 20_000, &mut |_, m| m);
    (over.shares(&config.motion.max_acceleration, &config.motion.max_jerk), over)
}

#[test]
fn the_plant_keeps_the_limits_of_the_run_file() {
    for file in FILES {
        for gain in ["", "servo.gain_1_s=20.0"] {
            let set: Vec<_> = [gain].into_iter().filter(|set| !set.is_empty()).collect();
            let config = config(file, &set);
            let (shares, finish) = with_robot!(config, |robot| {
                let (shares, over) = shares(&config, &robot, 0.0);
                (shares, over.finish)
            });
            // Joints whose friction was probed stand some nanometres beside their reference when they begin to move: 2 % of jerk, in one tick.
            let most = if file == "xarm7.toml" { [1.002, 1.03] } else { [1.001, 1.01] };
            assert!(shares[0] <= most[0] && shares[1] <= most[1], "{file} {gain}: {shares:?}");
            assert_eq!(finish.unwrap().outcome, Outcome::Converged, "{file} {gain}");
        }
    }
}

/// Motion control in operational space: four, six and seven joints and two, also where the gain is high.
#[test]
fn the_plant_keeps_the_limits_in_operational_space() {
    for file in ["default.toml", "ur5.toml", "ur5-b.toml", "panda.toml", "xarm7.toml", "pan_tilt.toml"] {
        for gain in ["servo.gain_1_s=2.0", "servo.gain_1_s=20.0"] {
            let config = config(file, &["motion.controller=operational_space", gain]);
            let (shares, finish) = with_robot!(config, |robot| {
                let (shares, over) = shares(&config, &robot, 0.0);
                (shares, over.finish)
            });
            // As in joint space, above.
            let most = if file == "xarm7.toml" { [1.002, 1.03] } else { [1.001, 1.01] };
            assert!(shares[0] <= most[0] && shares[1] <= most[1], "{file} {gain}: {shares:?}");
            assert_eq!(finish.unwrap().outcome, Outcome::Converged, "{file} {gain}");
        }
    }
}

#[test]
fn an_unexpected_start_is_refused_unless_allowed() {
    for file in ["default.toml", "ur5.toml", "scara-a.toml", "panda.toml"] {
        let refused = config(file, &[]);
        with_robot!(refused, |robot| {
            let (_, over) = shares(&refused, &robot, 0.09);
            let finish = over.finish.unwrap();
            assert_eq!(finish.outcome, Outcome::Fault, "{file}");
            assert!(finish.reason.contains("robot.q_start_rad_or_m"), "{}", finish.reason);
            let moved = over.ticks.iter().map(|tick| (tick.q - over.ticks[0].q).amax()).fold(0.0, f64::max);
            assert!(moved < 1e-6, "{file}: an arm that is refused stands, and does not move by {moved}");
        });
        // A torque law at the limit of acceleration: its torque is for the posture at the begin of a tick, in which joints of 5 rad/s change masses by half a percent.
        let most = if file == "scara-a.toml" { 1.01 } else { 1.001 };
        let allowed = config(file, &["robot.start_elsewhere=true"]);
        with_robot!(allowed, |robot| {
            for offset in [0.09, -0.05, 0.019] {
                let (shares, over) = shares(&allowed, &robot, offset);
                let told = over.events.iter().any(|(_, event)| *event == Event::StartsElsewhere);
                assert_eq!(told, offset != 0.019, "{file} {offset}");
                assert!(shares[0] <= most && shares[1] <= 1.002, "{file} {offset}: {shares:?}");
                assert_eq!(over.finish.unwrap().outcome, Outcome::Converged, "{file} {offset}");
            }
        });
    }
}

/// A joint that jams on the way, as if its brake had fallen, and is released again.
#[test]
fn a_jam_is_a_fault_within_a_second_and_a_released_joint_stands() {
    for file in ["default.toml", "ur5.toml", "scara-a.toml", "scara-b.toml", "panda.toml", "ur5-hybrid.toml"]
    {
        let config = config(file, &[]);
        with_robot!(config, |robot| {
            for joint in 0..3 {
                jam(file, &config, &robot, joint);
            }
        });
    }
}

fn jam<const N: usize>(file: &str, config: &Config, robot: &Robot<N>, joint: usize) {
    let mut plant = Plant::new(config, robot, SVector::zeros());
    plant.jam = Box::new(move |tick| match tick {
        300 => Some(SVector::from_fn(|i, _| if i == joint { 1e5 } else { 0.0 })),
        1300 => Some(SVector::zeros()),
        _ => None,
    });
    let over = run(config, robot, plant, 6000, &mut |_, m| m);
    let fault = over.events.iter().find_map(|(tick, event)| match event {
        Event::Fault(fault) => Some((*tick, *fault)),
        _ => None,
    });
    // A joint that has nothing to do is not missed.
    let before = over.ticks.get(250..300).unwrap();
    let speed = before.iter().map(|tick| tick.qd[joint].abs()).fold(0.0, f64::max);
    if speed < 0.03 {
        return;
    }
    let (tick, _) = fault.unwrap_or_else(|| {
        panic!(
            "{file} joint {joint} at {speed}: {:?}, torque {:?}",
            over.finish,
            over.ticks.get(5000).map(|t| t.command.tau)
        )
    });
    assert!((300..=1300).contains(&tick), "{file} joint {joint}: {tick}");
    let last = over.ticks.last().unwrap();
    assert!(last.qd.amax() < 0.02, "{file} joint {joint}: {} at the last command", last.qd);
    // Gravity beside, it is pushed gently, on all the way to the fault and after.
    let (effort, coulomb) = (robot.limits()[joint].effort, robot.friction()[joint].coulomb);
    let push = over.ticks.iter().take(1300).skip(350);
    let push = push.map(|t| (t.command.tau - robot.gravity(&t.q))[joint].abs()).fold(0.0, f64::max);
    assert!(push < 0.25 * effort + 2.0 * coulomb, "{file} joint {joint}: {push} of {effort} N m");
    let released = over.ticks.iter().skip(1300).map(|tick| tick.qd.amax()).fold(0.0, f64::max);
    assert!(released < 0.05, "{file} joint {joint}: {released} after the release");
}

/// An arm that obeys late swings ever more: that is a fault, and it comes to rest.
#[test]
fn an_arm_that_thrashes_is_a_fault_and_is_brought_to_rest() {
    for delay in [20, 30] {
        let config = config("default.toml", &[&format!("drive.simulated.command_delay_ticks={delay}")]);
        with_robot!(config, |robot| {
            let plant = Plant::new(&config, &robot, SVector::zeros());
            let over = run(&config, &robot, plant, 30_000, &mut |_, m| m);
            let fastest = over
                .ticks
                .iter()
                .map(|tick| {
                    (0..tick.qd.len())
                        .map(|i| tick.qd[i].abs() / robot.limits()[i].velocity)
                        .fold(0.0, f64::max)
                })
                .fold(0.0, f64::max);
            let last = over.ticks.last().unwrap().qd.amax();
            let finish = over.finish.unwrap();
            if finish.outcome != Outcome::Converged {
                assert!(finish.outcome == Outcome::Fault && over.ticks.len() < 5000, "{finish:?}");
                assert!(fastest < 2.5, "told at 1.5 of the limit, and 20 ms late: {fastest}");
            }
            assert!(last < 0.02, "delay {delay}: {last} after {} ticks, {:?}", over.ticks.len(), over.events);
        });
    }
}

/// Loads beyond what the arms are made for, which their models do not know: whatever comes of it, the arm stands in the end.
#[test]
fn an_overloaded_arm_is_brought_to_rest() {
    let mut faults = 0;
    for (file, load_kg) in [
        ("xarm7.toml", 5.0),
        ("xarm7.toml", 8.0),
        ("xarm7.toml", 12.0),
        ("panda.toml", 8.0),
        ("ur5.toml", 15.0),
    ] {
        for friction in [0.7, 1.0, 1.3] {
            let set = [
                format!("drive.simulated.payload_kg={load_kg}"),
                format!("scene.arm.friction_scale={friction}"),
            ];
            let config = config(file, &set.each_ref().map(String::as_str));
            let mut last = None;
            let run = simulate_system(&config, &mut |moment| {
                if let Moment::Tick(trace, _) = moment {
                    last = Some(trace.joint_state.qd_true);
                }
                ControlFlow::Continue(())
            })
            .unwrap();
            let speed = last.unwrap().iter().fold(0.0f64, |most, qd| most.max(qd.abs()));
            assert!(speed < 0.02, "{file} {set:?}: {} rad/s after {:?}", speed, run.finish);
            faults += u32::from(run.finish.outcome == Outcome::Fault);
        }
    }
    assert!(faults >= 6, "these loads are too much for some: {faults}");
}

#[test]
fn an_arm_that_cannot_be_seen_any_more_is_brought_to_rest() {
    for file in ["default.toml", "ur5.toml", "scara-a.toml", "scara-c.toml", "panda.toml"] {
        for (what, value) in [("q", f64::NAN), ("qd", 1e200), ("qd", 1e6), ("q", 1.0)] {
            let config = config(file, &[]);
            with_robot!(config, |robot| {
                let mut plant = Plant::new(&config, &robot, SVector::zeros());
                plant.report = Box::new(move |tick, mut state| {
                    if tick >= 400 {
                        *(if what == "q" { &mut state.q[1] } else { &mut state.qd[1] }) += value;
                    }
                    state
                });
                let over = run(&config, &robot, plant, 30_000, &mut |_, m| m);
                let moving = over.ticks[399].qd.amax();
                let last = over.ticks.last().unwrap().qd.amax();
                let finish = over.finish.unwrap();
                assert_eq!(finish.outcome, Outcome::Fault);
                assert!(
                    [Fault::DriveStateNotFinite, Fault::DriveStateImplausible]
                        .iter()
                        .any(|f| f.describe() == finish.reason)
                );
                assert!(moving > 0.1 && last < 0.02, "{file} {what} {value}: {moving} -> {last}");
            });
        }
    }
}

/// What bounds the torque on joints that do not move once took the damping from joints that swing within a few milliradians.
#[test]
fn an_arm_that_a_high_gain_made_swing_comes_to_rest() {
    for file in ["default.toml", "ur5.toml", "panda.toml"] {
        for gain in [25.0, 40.0] {
            let gain = format!("servo.gain_1_s={gain}");
            let set = [
                "servo.update='frame'",
                &gain,
                "camera.latency_ms=80",
                "servo.visibility.guard=false",
                "run.duration_s=5",
            ];
            let run = simulate_system(&config(file, &set), &mut |_| ControlFlow::Continue(())).unwrap();
            let reason = run.finish.reason.to_string();
            assert!(!reason.contains("still moves"), "{file} {gain}: {reason}");
        }
    }
}
