//! Something touches an arm that servoes: it is noticed, and the arm stops, goes back or floats, in every mode of the drive. The arm, its wall and its jam are
//! those of the simulated drive; forces are computed here from the flange's true position.

#![allow(clippy::unwrap_used, clippy::print_stdout)] // helpers of tests; numbers for people

use nalgebra::{SVector, Vector3};
use std::ops::ControlFlow;
use std::path::Path;
use vservo::config::Config;
use vservo::control::safety::Fault;
use vservo::messages::JointState;
use vservo::robot::Robot;
use vservo::sim::{Moment, simulate_system};

const STIFFNESS: f64 = 3e4;
const DAMPING: f64 = 100.0;

fn load(file: &str, set: &[String]) -> Config {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("config/{file}.toml"));
    // What an arm meets at a given time it shall meet at speed.
    let set = [&["servo.first_motion_m_s=0".to_owned()], set].concat();
    Config::load(Some(&path), &set).unwrap()
}

/// Place and velocity of the flange's origin in B, true ones.
fn flange(config: &Config, state: &JointState) -> (Vector3<f64>, Vector3<f64>) {
    fn of<const N: usize>(robot: &Robot<N>, state: &JointState) -> (Vector3<f64>, Vector3<f64>) {
        let vector = |x: &[f64]| SVector::<f64, N>::from_fn(|i, _| x[i]);
        let (q, qd) = (vector(&state.q_true), vector(&state.qd_true));
        (robot.forward(&q).translation.vector, robot.jacobian(&q).fixed_rows::<3>(0) * qd)
    }
    vservo::dispatch_robot!(config.robot, |robot| of(&robot, state)).unwrap()
}

/// What a run does that meets something.
#[derive(Debug, Default)]
struct Met {
    /// Ticks of the first touch, and of the fault.
    touched: Option<usize>,
    fault: Option<(usize, Fault)>,
    /// Force on the wall by the tick after the touch, N.
    force: Vec<f64>,
    /// Way of the flange along the direction of the wall at the end, m; positive is before it.
    before_it: f64,
    /// Largest joint speed at the end, rad/s or m/s.
    ends_with: f64,
}

fn meets(config: &Config, wall: Option<(Vector3<f64>, Vector3<f64>)>) -> Met {
    let (mut met, mut tick) = (Met::default(), 0);
    simulate_system(config, &mut |moment| {
        if let Moment::Tick(trace, _) = moment {
            tick += 1;
            let (p, v) = flange(config, &trace.joint_state);
            if let Some((point, normal)) = wall {
                met.before_it = (p - point).dot(&normal);
                let pressed = (-STIFFNESS * met.before_it - DAMPING * v.dot(&normal)).max(0.0);
                let force = if met.before_it < 0.0 { pressed } else { 0.0 };
                if force > 0.0 {
                    met.touched.get_or_insert(tick);
                }
                if met.touched.is_some() {
                    met.force.push(force);
                }
            }
            if let Some(fault) = trace.fault {
                met.fault.get_or_insert((tick, fault));
            }
            met.ends_with = trace.joint_state.qd_true.iter().fold(0.0, |most, qd| most.max(qd.abs()));
        }
        ControlFlow::Continue(())
    })
    .unwrap();
    met
}

/// The flange's place and direction of motion where it first moves with 0.25 m/s after `from` ticks.
fn on_the_way(config: &Config, from: usize) -> (Vector3<f64>, Vector3<f64>) {
    let mut way = Vec::new();
    simulate_system(config, &mut |moment| {
        if let Moment::Tick(trace, _) = moment {
            way.push(flange(config, &trace.joint_state));
        }
        ControlFlow::Continue(())
    })
    .unwrap();
    let (p, v) = way.iter().skip(from).find(|(_, v)| v.norm() >= 0.25).copied().unwrap();
    (p, -v.normalize())
}

/// What becomes of a run of `file` with a wall across the way of its flange.
fn with_a_wall(file: &str, set: &[&str]) -> Met {
    let mut set: Vec<_> = set.iter().map(ToString::to_string).collect();
    let (p, n) = on_the_way(&load(file, &set), 100);
    set.push(format!(
        "drive.simulated.wall={{point_m=[{},{},{}],normal=[{},{},{}],stiffness_n_m={STIFFNESS:?},damping_n_s_m={DAMPING:?}}}",
        p.x, p.y, p.z, n.x, n.y, n.z
    ));
    meets(&load(file, &set), Some((p, n)))
}

#[test]
fn a_wall_stops_the_arm_and_is_not_pressed_any_more() {
    for (file, mode, within, at_300_ms) in [
        ("ur5", "torque", 60, 30.0),
        ("panda", "torque", 70, 30.0),
        ("xarm7", "torque", 60, 30.0),
        ("panda", "velocity", 80, 30.0),
        ("xarm7", "velocity", 80, 30.0),
    ] {
        let met = with_a_wall(file, &[&format!("drive.mode={mode}")]);
        let (touched, (noticed, fault)) = (met.touched.unwrap(), met.fault.unwrap());
        println!(
            "{file} {mode}: {fault:?} after {} ms, {:.0} N at most, {:?} N after 300 ms",
            noticed - touched,
            met.force.iter().copied().fold(0.0, f64::max),
            met.force.get(300)
        );
        assert_eq!(fault, Fault::Contact, "{file} {mode}");
        assert!(noticed - touched <= within, "{file} {mode}: {} ms", noticed - touched);
        // A run whose arm is at rest before 300 ms have passed ends with its last force.
        let later = met.force.get(300).or(met.force.last()).unwrap();
        assert!(*later < at_300_ms, "{file} {mode}: {later} N");
        assert!(met.ends_with < 0.02, "{file} {mode}: ends with {}", met.ends_with);
    }
}

#[test]
fn an_arm_that_releases_goes_back_from_the_wall() {
    for mode in ["torque", "velocity"] {
        let met = with_a_wall("panda", &[&format!("drive.mode={mode}"), "safety.contact=release"]);
        assert_eq!(met.fault.unwrap().1, Fault::Contact);
        assert!(met.before_it > 1e-3, "{mode}: {} mm before it", 1e3 * met.before_it);
        assert!(met.ends_with < 0.02, "{mode}: {}", met.ends_with);
    }
}

/// What became of a joint that stands from a moment on.
#[derive(Debug)]
struct Jam {
    /// Speed of the joint when it was stopped, rad/s or m/s.
    speed: f64,
    /// Time until the fault, ms, and its kind.
    told: Option<(usize, Fault)>,
    /// The largest torque against it until then beyond that of gravity, as a share of its limit; 0 where torques are not known.
    share: f64,
}

fn jammed(file: &str, mode: &str, joint: usize, from: usize) -> Jam {
    let config = load(
        file,
        &[
            format!("drive.mode={mode}"),
            format!("drive.simulated.jam={{joint={joint},from_s={:?}}}", from as f64 * 1e-3),
        ],
    );
    fn beyond<const N: usize>(robot: &Robot<N>, state: &JointState, joint: usize) -> f64 {
        let q = SVector::<f64, N>::from_fn(|i, _| state.q_true[i]);
        (state.tau[joint] - robot.gravity(&q)[joint]).abs() / robot.limits()[joint].effort
    }
    let (mut jam, mut tick) = (Jam { speed: 0.0, told: None, share: 0.0 }, 0);
    simulate_system(&config, &mut |moment| {
        if let Moment::Tick(trace, _) = moment {
            let state = &trace.joint_state;
            tick += 1;
            if tick <= from {
                jam.speed = state.qd_true[joint].abs();
            } else if jam.told.is_none() {
                jam.told = trace.fault.map(|fault| (tick - from, fault));
                if mode == "torque" && tick > from + 1 {
                    let share = vservo::dispatch_robot!(config.robot, |robot| beyond(&robot, state, joint));
                    jam.share = jam.share.max(share.unwrap());
                }
            }
        }
        ControlFlow::Continue(())
    })
    .unwrap();
    jam
}

/// A joint that is on its way is told within a tenth of a second, whatever closes the loop. Slower ones are told later, and some had come to where they were to go.
#[test]
fn a_joint_that_is_stopped_in_its_motion_is_told_at_once() {
    for file in ["ur5", "panda", "xarm7"] {
        for mode in ["torque", "velocity", "position"] {
            let all = (0..6).flat_map(|joint| [250, 400].map(|from| (joint, from)));
            let mut fast = 0;
            for (joint, from) in all {
                let jam = jammed(file, mode, joint, from);
                println!("{file} {mode}, joint {joint} after {from} ms: {jam:.3?}");
                if jam.speed < 0.4 {
                    continue;
                }
                fast += 1;
                let (after, fault) = jam.told.unwrap();
                assert_eq!(fault, Fault::Contact, "{file} {mode} {joint} {from}");
                assert!(after <= 100, "{file} {mode} {joint} {from}: {after} ms");
                // An xArm7 needs more than that for the friction and the rotors that its file tells.
                assert!(file == "xarm7" || jam.share < 0.25, "{file} {mode} {joint} {from}: {}", jam.share);
            }
            assert!(fast >= 5, "{file} {mode}: {fast}");
        }
    }
}

/// A drive that closes its own loop and measures its torques: the force at the flange and its direction are told, and a wall is noticed sooner than by the lag alone. Without contact
/// nothing is told.
#[test]
fn torques_that_a_drive_measures_tell_the_force() {
    for file in ["ur5", "panda"] {
        for mode in ["velocity", "position"] {
            let [by_lag, by_torque] = ["false", "true"].map(|tells| {
                let met = with_a_wall(
                    file,
                    &[&format!("drive.mode={mode}"), &format!("drive.simulated.tells_torque={tells}")],
                );
                met.fault.unwrap().0 - met.touched.unwrap()
            });
            println!("{file} {mode}: {by_lag} ms by lag, {by_torque} ms by torque");
            assert!(by_torque < by_lag, "{file} {mode}: {by_torque} {by_lag}");
        }
    }
    let push = "drive.simulated.push={force_n=[0.0,0.0,-80.0],from_s=0.6,until_s=1.1}";
    for mode in ["torque", "velocity", "position"] {
        let tells = "drive.simulated.tells_torque=true".to_owned();
        let config =
            load("ur5", &[format!("drive.mode={mode}"), tells, push.into(), "safety.contact=ignore".into()]);
        let (mut told, mut tick) = (Vec::new(), 0);
        simulate_system(&config, &mut |moment| {
            if let Moment::Tick(trace, _) = moment {
                tick += 1;
                told.extend(trace.contact.map(|contact| (tick, contact)));
            }
            ControlFlow::Continue(())
        })
        .unwrap();
        assert!(told.iter().all(|(tick, _)| (600..1200).contains(tick)), "{mode}: {:?}", told.first());
        let last = told.iter().rev().find(|(tick, _)| (700..1100).contains(tick));
        let force = last.and_then(|(_, contact)| contact.force_B).unwrap();
        let along = force.normalize().dot(&-Vector3::z());
        println!("{mode}: {force:?}");
        assert!(along > 0.9 && (40.0..120.0).contains(&force.norm()), "{mode}: {force}");
    }
}

/// A push during a motion: an arm that is to ignore it converges all the same, and does not swing.
#[test]
fn a_push_that_is_ignored_is_given_way_to() {
    for file in ["ur5", "panda"] {
        let push = "drive.simulated.push={force_n=[0.0,0.0,-30.0],from_s=0.6,until_s=1.1}";
        let config = load(file, &["safety.contact=ignore".into(), push.into()]);
        let met = meets(&config, None);
        assert_eq!(met.fault, None, "{file}");
        assert!(met.ends_with < 0.02, "{file}: {}", met.ends_with);
    }
}

/// Joint speeds that are left some tenths of a second after a push in torque mode: nothing of it is kept. The way back of `release` takes up to a second.
#[test]
fn a_push_that_is_over_moves_the_arm_no_more() {
    let pushes = [("[55,-20,35]", 0.45, 0.8), ("[-30,60,25]", 0.5, 0.7), ("[25,-35,-60]", 0.4, 0.75)];
    let mut wrong = Vec::new();
    for arm in ["ur5", "panda", "xarm7"] {
        for (reaction, rests_within_s) in [("stop", 0.4), ("release", 1.3)] {
            for (force, from_s, until_s) in pushes {
                let push =
                    format!("drive.simulated.push={{force_n={force},from_s={from_s},until_s={until_s}}}");
                let reaction = format!("safety.contact={reaction}");
                let config = load(arm, &["drive.mode=torque".to_owned(), reaction.clone(), push]);
                let (mut tick, mut most, mut last, mut fault) = (0, 0.0_f64, f64::NAN, None);
                simulate_system(&config, &mut |moment| {
                    if let Moment::Tick(trace, _) = moment {
                        tick += 1;
                        fault = fault.or(trace.fault);
                        last = trace.joint_state.qd.iter().fold(0.0, |most: f64, qd| most.max(qd.abs()));
                        if f64::from(tick) * 1e-3 > until_s + rests_within_s {
                            most = most.max(last);
                        }
                    }
                    ControlFlow::Continue(())
                })
                .unwrap();
                // A run that ends sooner ends at rest, or is no good end.
                let most = most.max(last);
                if fault != Some(Fault::Contact) || most > 0.05 {
                    wrong.push(format!("{arm}, {reaction}, {force} N: {fault:?}, {most} rad/s"));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}
