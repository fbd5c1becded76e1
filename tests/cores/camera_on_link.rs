//! A camera on a link before the wrist (`camera.mount.link`) in whole runs: the joints before it servo, those beyond it rest or serve another goal, and what
//! cannot be is told at its key.

#![allow(non_snake_case)]
#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout)] // helpers of tests are tests

use nalgebra::SVector;
use std::ops::ControlFlow::Continue;
use std::path::Path;
use vservo::config::Config;
use vservo::control::outcome::Outcome;
use vservo::geometry::{Pose, roll_pitch_yaw};
use vservo::robot::Mount;
use vservo::sim::preflight::{Preflight, Reach};
use vservo::sim::{Moment, SystemRun, simulate_system};

fn try_load(file: &str, set: &[String]) -> Result<Config, String> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("config/{file}.toml"));
    Config::load(Some(&path), set).map_err(|e| e.to_string())
}

fn load(file: &str, set: &[String]) -> Config {
    try_load(file, set).unwrap_or_else(|e| panic!("{e}"))
}

/// A shipped cell whose camera sits on the link behind `joints` joints, where the camera on the flange is in the posture of the goal. The arm starts with these
/// joints beside it: `--set` values, and the names of the joints beyond.
fn on_link<const N: usize>(file: &str, joints: usize, off: &[f64]) -> (Vec<String>, Vec<String>) {
    let config = load(file, &[]);
    let preflight = Preflight::of(&config).unwrap();
    let Reach::Within(goal) = preflight.reach else { panic!("{file}: {:?}", preflight.reach) };
    let robot = config.robot.build::<N>().unwrap();
    let q = SVector::<f64, N>::from_column_slice(&goal.q);
    let X_BC = config.camera.mount.X_BC(&robot, &q);
    let X_BL = config.robot.joints.iter().zip(&goal.q).take(joints);
    let X_BL = X_BL.fold(Pose::identity(), |X, (joint, q)| X * joint.X_PL(*q));
    let X_LC = X_BL.inverse() * X_BC;
    let p: [f64; 3] = X_LC.translation.vector.into();
    let rpy = roll_pitch_yaw(&X_LC.rotation.to_rotation_matrix());
    // As far beside the goal as the target is seen from.
    let set = [1.0, 0.8, 0.6, 0.45, 0.3, 0.2].map(|share| {
        // Joints beyond the camera have no share in that.
        let beside =
            |i: usize| off.get(i).copied().unwrap_or_default() * if i < joints { share } else { 1.0 };
        let start: Vec<f64> = goal.q.iter().enumerate().map(|(i, q)| q + beside(i)).collect();
        vec![
            format!("camera.mount.link=\"{}\"", config.robot.joints[joints - 1].link),
            format!("camera.mount.position_m={p:?}"),
            format!("camera.mount.rotation_rpy_rad={rpy:?}"),
            format!("robot.q_start_rad_or_m={start:?}"),
        ]
    });
    let is_seen = |set: &Vec<String>| {
        let ahead = try_load(file, set).ok().and_then(|config| Preflight::of(&config).ok());
        ahead.and_then(|ahead| ahead.start).is_some_and(|start| start.visibility.fault().is_none())
    };
    let set = set.into_iter().find(is_seen).unwrap();
    println!("{set:?}");
    (set, config.robot.joints.iter().skip(joints).map(|joint| joint.name.clone()).collect())
}

/// The positions of the reference and of the arm at a tick, rad or m.
type Positions = (Vec<f64>, Vec<f64>);

/// A run, with these at every tick.
fn run(config: &Config) -> (SystemRun, Vec<Positions>) {
    let (n, mut course) = (config.robot.joint_count(), Vec::new());
    let run = simulate_system(config, &mut |moment| {
        if let Moment::Tick(trace, _) = moment {
            course.push((trace.command.q_r[..n].to_vec(), trace.joint_state.q_true[..n].to_vec()));
        }
        Continue(())
    });
    (run.unwrap(), course)
}

/// With what the camera itself is off at the end, by forward kinematics that multiplies the frames of the robot file.
fn off_at_the_end(config: &Config, q: &[f64]) -> f64 {
    let Mount::EyeOnLink { joints, X_LC } = config.camera.mount else { panic!() };
    let links = config.robot.joints.iter().zip(q).take(joints);
    let X_BC = links.fold(Pose::identity(), |X, (joint, q)| X * joint.X_PL(*q)) * X_LC;
    let X_CO = X_BC.inverse() * config.scene.as_ref().unwrap().X_WO;
    (X_CO.translation.vector - config.set_point.X_DO().unwrap().translation.vector).norm()
}

/// The arm converges, and the joints beyond the camera rest.
fn converges(file: &str, joints: usize, set: &[String], scheme: &str) {
    let mut set = set.to_vec();
    set.push(format!("servo.scheme={scheme}"));
    let config = load(file, &set);
    let (run, course) = run(&config);
    let (first, last) = (course.first().unwrap(), course.last().unwrap());
    let off_m = off_at_the_end(&config, &last.1);
    println!(
        "{file}, {joints} joints, {scheme}: {:?} after {} ticks, {off_m:.6} m",
        run.finish,
        course.len()
    );
    assert_eq!(run.finish.outcome, Outcome::Converged, "{file} {scheme} {:?}", run.finish);
    assert!(off_m < 5e-4, "{file} {scheme}: {off_m} m");
    let moved = (0..joints).map(|i| (last.1[i] - first.1[i]).abs()).fold(0.0, f64::max);
    assert!(moved > 0.01, "{file} {scheme}: {moved}");
    for (reference, _) in &course {
        for (i, (now, before)) in reference.iter().zip(&first.0).enumerate().skip(joints) {
            assert!((now - before).abs() < 1e-9, "{file} {scheme}: joint {i} is moved");
        }
    }
}

const SCHEMES: [&str; 3] = ["image_resolved_velocity", "position_resolved_velocity", "hybrid"];

#[test]
fn a_ur5_with_its_camera_before_the_last_joints_converges() {
    for (joints, off) in [(5, [0.1, -0.06, 0.08, 0.05, 0.1]), (4, [0.06, 0.05, -0.06, 0.04, 0.0])] {
        let (set, _) = on_link::<6>("ur5", joints, &off);
        for scheme in SCHEMES {
            converges("ur5", joints, &set, scheme);
        }
    }
}

#[test]
fn a_panda_with_its_camera_before_the_wrist_converges() {
    let (set, _) = on_link::<7>("panda", 5, &[0.05, 0.04, -0.06, 0.05, 0.05]);
    converges("panda", 5, &set, SCHEMES[0]);
}

/// The true camera sits on the same link, turned with its holder about the axis of the joint before it, by 0.03 rad: that joint makes up for it.
#[test]
fn the_true_camera_sits_on_the_link_too() {
    let (mut set, _) = on_link::<6>("ur5", 5, &[0.1, -0.06, 0.08, 0.05, 0.1]);
    let told = *load("ur5", &set).camera.mount.pose();
    let holder = Pose::rotation(nalgebra::Vector3::z() * 0.03);
    let X_LC = holder * told;
    set.push(format!("scene.camera.mount.position_m={:?}", <[f64; 3]>::from(X_LC.translation.vector)));
    let rpy = roll_pitch_yaw(&X_LC.rotation.to_rotation_matrix());
    set.push(format!("scene.camera.mount.rotation_rpy_rad={rpy:?}"));
    let config = load("ur5", &set);
    let scene = config.scene.as_ref().unwrap();
    assert!(matches!(scene.mount, Mount::EyeOnLink { joints: 5, .. }), "{:?}", scene.mount);
    let (run, course) = run(&config);
    assert_eq!(run.finish.outcome, Outcome::Converged, "{:?}", run.finish);
    let q = &course.last().unwrap().1;
    let X_BL = config.robot.joints.iter().zip(q).take(5);
    let X_BC = X_BL.fold(Pose::identity(), |X, (joint, q)| X * joint.X_PL(*q)) * X_LC;
    let off = (X_BC.inverse() * scene.X_WO).inv_mul(config.set_point.X_DO().unwrap());
    assert!(off.translation.vector.norm() < 5e-4, "{off}");
    // The camera that is believed is beside the goal by what it is believed wrongly, there where the target lies.
    let (X_DO, lies) = (config.set_point.X_DO().unwrap(), told.inverse() * holder * told);
    let beside_m = ((lies * X_DO).translation.vector - X_DO.translation.vector).norm();
    assert!(
        (off_at_the_end(&config, q) - beside_m).abs() < 5e-4,
        "{} {beside_m}",
        off_at_the_end(&config, q)
    );
}

/// The last joint is beyond the camera and near the end of its range: its own goal is served, and the image is not disturbed.
#[test]
fn a_joint_beyond_the_camera_serves_another_goal() {
    let (set, _) = on_link::<6>("ur5", 5, &[0.1, -0.06, 0.08, 0.05, 0.1, 4.5]);
    let of = |gain: f64| {
        let set: Vec<_> = set.iter().cloned().chain([format!("servo.limit_avoidance_1_s={gain}")]).collect();
        let config = load("ur5", &set);
        let (run, course) = run(&config);
        assert_eq!(run.finish.outcome, Outcome::Converged, "{gain} {:?}", run.finish);
        let (first, last) = (course.first().unwrap(), course.last().unwrap());
        assert!(off_at_the_end(&config, &last.1) < 5e-4, "{gain}");
        (last.1[5] - first.1[5]).abs()
    };
    let (rests, moves) = (of(0.0), of(1.0));
    println!("beyond the camera: {rests:.6} rad and {moves:.3} rad");
    assert!(rests < 1e-3 && moves > 0.3, "{rests} {moves}");
}

/// What each of these is told at which key.
#[test]
fn what_a_camera_on_a_link_excludes_is_told() {
    let (set, beyond) = on_link::<6>("ur5", 5, &[]);
    assert_eq!(beyond, ["wrist_3_joint"]);
    let refusal = |more: &[&str]| {
        let set: Vec<String> = set.iter().cloned().chain(more.iter().map(|s| (*s).to_owned())).collect();
        try_load("ur5", &set).map(|config| config.warnings)
    };
    for (more, key, words) in [
        (&["camera.mount.link=elbow"][..], "camera.mount.link", "\"wrist_1_link\" (joint \"wrist_1_joint\")"),
        (&["scene.camera.mount.link=elbow"], "scene.camera.mount.link", "\"wrist_1_link\""),
        (&["camera.mount.kind=eye_to_hand", "scene.object.on=flange"], "camera.mount.link", "eye_to_hand"),
        (&["servo.scheme=image_pd"], "camera.mount.link", "wrist_3_joint"),
        (&["run.task=calibrate_hand_eye"], "camera.mount.link", "poses of the link"),
        (&["workspace.camera_speed_m_s=0.2"], "workspace.camera_speed_m_s", "flange_speed_m_s"),
    ] {
        let told = refusal(more).unwrap_err();
        assert!(told.contains(key) && told.contains(words), "{more:?}: {told}");
    }
    // Six numbers are asked of five joints, and that is said; of a camera behind all of them it is not.
    let doubts = |more: &[&str]| -> Vec<String> {
        let told = refusal(more).unwrap();
        told.iter().map(ToString::to_string).filter(|told| told.contains("degrees of freedom")).collect()
    };
    assert_eq!(doubts(&[]).len(), 1, "{:?}", doubts(&[]));
    assert!(doubts(&[])[0].contains("6 degrees of freedom, and 5 joints"), "{:?}", doubts(&[]));
    let last = load("ur5", &on_link::<6>("ur5", 6, &[]).0).warnings;
    assert!(last.iter().all(|told| !told.to_string().contains("degrees of freedom")), "{last:?}");
    let ahead = Preflight::of(&load("ur5", &set)).unwrap();
    assert!(ahead.notes.iter().any(|note| note.contains("wrist_3_joint") && note.contains("rest")));
}
