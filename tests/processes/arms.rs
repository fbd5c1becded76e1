//! The run files of the shipped arms: checked without complaint, converged in lockstep with the accuracy that is owed,
//! from where they say that they start, with the target in view all the way.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // helpers of tests are tests

use crate::common::{Run, assert_accurate, number, run, vservo};
use std::path::{Path, PathBuf};

const SIX_DOF: [&str; 3] = ["ur5", "panda", "xarm7"];

fn file(arm: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("config").join(format!("{arm}.toml"))
}

fn lockstep(arm: &str, set: &[&str]) -> Run {
    let path = file(arm);
    let mut arguments = vec![path.to_str().unwrap(), "--clock", "lockstep"];
    for s in set {
        arguments.extend(["--set", s]);
    }
    run(arm, &arguments)
}

#[test]
fn run_files_pass_the_check() {
    for arm in SIX_DOF.iter().chain(&["pan_tilt"]) {
        let output = vservo().arg("check").arg(file(arm)).output().unwrap();
        assert!(output.status.success(), "{arm}: {}", String::from_utf8_lossy(&output.stderr));
    }
}

#[test]
fn six_degrees_of_freedom_converge() {
    for arm in SIX_DOF {
        let r = lockstep(arm, &[]);
        assert_accurate(&r);
        assert_eq!(number(&r.summary, &["target_lost"]), 0.0, "{arm}: {}", r.summary);
    }
}

/// Other targets than dots: a chessboard of which a corner is hidden for a while, a tag among other tags and clutter, a cube of tags, a free
/// shape.
#[test]
fn chessboards_tags_and_shapes_are_servoed_on() {
    for target in ["chessboard", "tag", "tag-cube", "shape"] {
        let output = vservo().arg("check").arg(file(target)).output().unwrap();
        assert!(output.status.success(), "{target}: {}", String::from_utf8_lossy(&output.stderr));
        let r = lockstep(target, &[]);
        assert_eq!(r.summary["outcome"], "converged", "{target}: {}", r.summary);
        assert_eq!(number(&r.summary, &["target_lost"]), 0.0, "{target}: {}", r.summary);
        let off_m = number(&r.summary, &["final", "position_error_m"]);
        assert!(off_m < 0.002, "{target}: {off_m}");
    }
}

#[test]
fn the_ideal_drive_and_the_depth_of_the_goal_converge_too() {
    for arm in SIX_DOF {
        assert_accurate(&lockstep(arm, &["drive.kind=ideal"]));
        assert_accurate(&lockstep(arm, &["servo.depth=desired"]));
    }
}

#[test]
fn other_seeds_of_the_noise_converge() {
    for seed in ["run.seed=2", "run.seed=3"] {
        assert_accurate(&lockstep("ur5", &[seed]));
        assert_accurate(&lockstep("panda", &[seed]));
    }
}

#[test]
fn the_pan_tilt_head_centres_its_target() {
    for start in ["[0.25, 0.12]", "[0.7, 0.45]", "[0.3, 0.4]"] {
        let r = lockstep("pan_tilt", &[&format!("robot.q_start_rad_or_m={start}")]);
        assert_accurate(&r);
    }
}

/// What the run files promise of their start: 0.3 m and a turn about every axis away from the goal.
#[test]
#[allow(non_snake_case)]
fn the_start_is_far_from_the_goal() {
    use vservo::config::Config;
    for arm in SIX_DOF {
        let c = Config::load(Some(&file(arm)), &[]).unwrap();
        let X_BC = vservo::dispatch_robot!(c.robot, |robot| {
            c.camera.mount.X_BC(&robot, &nalgebra::SVector::from_column_slice(&c.start.q))
        })
        .unwrap();
        // X_DC = X_DO X_OB X_BC
        let X_DC = c.set_point.X_DO().unwrap() * c.X_WO().unwrap().inverse() * X_BC;
        let turn = X_DC.rotation.scaled_axis();
        assert!((X_DC.translation.vector.norm() - 0.3).abs() < 0.01, "{arm}: {X_DC}");
        assert!(turn.iter().all(|angle| angle.abs() > 0.1), "{arm}: {turn}");
    }
}

/// The law integrates: as long as the camera sees an error, the reference moves on. A load that the joint controller
/// does not know shifts the arm against its reference, but not against the image.
#[test]
fn an_unknown_payload_makes_no_lasting_error() {
    for arm in SIX_DOF {
        let loaded = lockstep(arm, &["drive.simulated.payload_kg=1"]);
        let s = &loaded.summary;
        assert_eq!(s["outcome"], "converged", "{arm}: {}", loaded.text());
        assert!(number(s, &["final", "position_error_m"]) < 5e-5, "{arm}: {s}");
        assert!(number(s, &["final", "orientation_error_rad"]) < 3e-4, "{arm}: {s}");
        // A Panda holds its goal in the mean: at the end it is anywhere in that.
        assert!(number(s, &["final", "feature_error_px"]) < 0.15, "{arm}: {s}");
    }
}

#[test]
fn every_joint_controller_converges() {
    for arm in ["ur5", "panda", "pan_tilt"] {
        assert_accurate(&lockstep(arm, &["motion.controller=pd_gravity"]));
        for mode in ["drive.mode=velocity", "drive.mode=position"] {
            assert_accurate(&lockstep(arm, &["motion.controller=pass_through", mode]));
        }
    }
    assert_accurate(&lockstep("ur5", &["motion.controller=pd_gravity", "drive.simulated.payload_kg=1"]));
    let gains = ["motion.stiffness_n_m_rad_or_n_m=[4.0]", "motion.damping_n_m_s_rad_or_n_s_m=[0.3]"];
    assert_accurate(&lockstep("pan_tilt", &[&["motion.controller=pd_gravity"], gains.as_slice()].concat()));
}

#[test]
fn a_controller_that_does_not_fit_the_drive_is_refused() {
    for (set, wanted) in [
        (vec!["motion.controller=pass_through"], "pass_through gives no torque"),
        (vec!["motion.stiffness_n_m_rad_or_n_m=[4.0]"], "is a gain of motion.controller = \"pd_gravity\""),
        (
            vec!["motion.controller=pd_gravity", "motion.damping_n_m_s_rad_or_n_s_m=[1.0, 2.0]"],
            "has 2 entries, needs 1 or 6",
        ),
        (vec!["motion.max_jerk_rad_s3_or_m_s3=[0.0]"], "max_jerk_rad_s3_or_m_s3[0]: 0 is out of range"),
    ] {
        let mut command = vservo();
        command.arg("check").arg(file("ur5"));
        for s in set {
            command.args(["--set", s]);
        }
        let output = command.output().unwrap();
        let text = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(3), "{text}");
        assert!(text.contains(wanted), "{text}");
    }
}
