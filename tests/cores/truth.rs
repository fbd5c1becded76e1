//! What is true in a simulated cell, apart from what the controller believes: every study of a wrong calibration is a run.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // helpers of tests are tests

use std::collections::VecDeque;
use std::path::Path;
use vservo::config::{Config, assemble};
use vservo::control::outcome::Outcome;
use vservo::imaging::ImageView;
use vservo::messages::FrameHeader;
use vservo::mission::FinalErrors;
use vservo::scene::Exposure;
use vservo::sim::{SystemRun, simulate_system};
use vservo::time::{MonoNs, TICK};
use vservo::vision::{Frame, Prior};

fn config(file: &str, set: &[&str]) -> Config {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("config").join(file);
    let set: Vec<_> = set.iter().map(ToString::to_string).collect();
    Config::load(Some(&path), &set).unwrap_or_else(|e| panic!("{file}: {e}"))
}

fn run(file: &str, set: &[&str]) -> SystemRun {
    let set = [&["goal.hold_s=0.2", "camera.synthetic.noise_sd_levels=0"], set].concat();
    simulate_system(&config(file, &set), &mut |_| std::ops::ControlFlow::Continue(())).unwrap()
}

/// A run that reached its goal as control sees it; its errors.
fn believes_to_be_there(file: &str, set: &[&str]) -> FinalErrors {
    let run = run(file, set);
    assert_eq!(run.finish.outcome, Outcome::Converged, "{file} {set:?}: {run:?}");
    assert!(run.errors.believed.feature_error_px.unwrap() < 0.1, "{file} {set:?}: {:?}", run.errors);
    run.errors
}

/// Where the target lies in the desired view: `servo.desired` of the SCARA's run files, m.
const DESIRED_M: [f64; 3] = [-0.1, 0.1, 0.6];

fn near(found: Option<f64>, expected: f64, tolerance: f64, what: &str) {
    let found = found.unwrap();
    assert!((found - expected).abs() <= tolerance, "{what}: {found}, expected {expected}");
}

const EVERY_SCHEME: [&str; 5] =
    ["scara-a.toml", "scara-b.toml", "scara-c.toml", "scara-d.toml", "scara-hybrid.toml"];

#[test]
fn what_is_not_said_is_as_believed() {
    let plain = run("scara-d.toml", &[]);
    let said = run(
        "scara-d.toml",
        &[
            "scene.camera.lens={fx_px=800.0, fy_px=800.0, cx_px=319.5, k1=-0.15}",
            "scene.camera.mount={position_m=[0.0, 0.0, 0.0]}",
            "scene.target={side_m=0.1, scale=1.0}",
            "scene.arm={model='scara', mass_scale=1.0, friction_scale=1.0, q_offset_rad_or_m=[0.0]}",
        ],
    );
    assert_eq!(plain, said, "to the last bit");
}

/// An image does not tell a larger target from a nearer one. A target 1.02 times as large as believed looks as desired from
/// 1.02 times as far, under every law: all of `p_DO` is stretched, so that the camera ends 2 % of its length off.
#[test]
fn a_larger_target_ends_farther_away_in_proportion() {
    let length_m = DESIRED_M.iter().map(|x| x * x).sum::<f64>().sqrt();
    for file in EVERY_SCHEME {
        let errors = believes_to_be_there(file, &["scene.target.scale=1.02", "goal.feature_error_px=0.05"]);
        near(errors.position_error_m, 0.02 * length_m, 2e-4, file);
        near(errors.orientation_error_rad, 0.0, 1e-3, file);
        near(errors.believed.position_error_m, 0.0, 3e-4, file);
    }
}

/// A focal length that is believed 10 % too short makes every direction 1/0.9 as steep as it is. The target faces the camera,
/// so that the image that is believed to be right shows it from 1/0.9 of the distance, and beside the axis by as much as
/// desired: `x / z` shrinks as `z` grows.
#[test]
fn a_short_focal_length_ends_farther_away_along_the_axis() {
    let lens = [
        "camera.lens={fx_px=720.0, fy_px=720.0, k1=0.0, k2=0.0}",
        "scene.camera.lens={fx_px=800.0, fy_px=800.0}",
    ];
    let expected_m = DESIRED_M[2] * (1.0 / 0.9 - 1.0);
    for file in EVERY_SCHEME {
        let errors = believes_to_be_there(file, &lens);
        near(errors.position_error_m, expected_m, 1e-3, file);
        near(errors.orientation_error_rad, 0.0, 2e-3, file);
    }
}

/// The camera's place on the flange only turns the way there: what the camera sees at the end is right, wherever it sits, and
/// so is its pose before the target.
#[test]
fn a_mount_that_is_off_bends_the_way_and_not_the_goal() {
    let mount = [
        "scene.camera.mount={position_m=[0.005, 0.0, 0.0], rotation_rpy_rad=[0.0, 0.0, 0.017453292519943295]}",
    ];
    for file in EVERY_SCHEME {
        let errors = believes_to_be_there(file, &mount);
        near(errors.feature_error_px, 0.0, 0.1, file);
        near(errors.position_error_m, 0.0, 3e-4, file);
        near(errors.orientation_error_rad, 0.0, 1e-3, file);
    }
}

/// Zeros of joints that are off by 10 mrad, links 5 % heavier, friction half as large again: the camera sees all of it.
#[test]
fn an_arm_that_is_not_its_model_still_gets_there() {
    for arm in [
        "scene.arm.q_offset_rad_or_m=[0.01, -0.01, 0.002, 0.01]",
        "scene.arm={mass_scale=1.05, friction_scale=1.5}",
    ] {
        let errors = believes_to_be_there("scara-d.toml", &[arm, "goal.feature_error_px=0.1"]);
        near(errors.position_error_m, 0.0, 1e-3, arm);
    }
    let offset = "scene.arm.q_offset_rad_or_m=[0.01]";
    let ideal = believes_to_be_there("scara-b.toml", &["drive.kind=ideal", offset]);
    near(ideal.position_error_m, 0.0, 3e-4, "ideal drive");
}

/// A robot file of its own for the arm that is there: a link 3 mm longer than believed.
#[test]
fn another_robot_file_may_stand_for_the_true_arm() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("longer.toml");
    let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/robot/scara.toml");
    let text = std::fs::read_to_string(shipped).unwrap();
    assert!(text.contains("a_m = 1.0"), "{text}");
    std::fs::write(&file, text.replacen("a_m = 1.0", "a_m = 1.003", 1)).unwrap();
    let set = format!("scene.arm.model={}", file.display());
    let errors = believes_to_be_there("scara-d.toml", &[&set]);
    near(errors.position_error_m, 0.0, 3e-4, "longer link");
}

#[test]
fn a_truth_that_cannot_be_is_refused_with_its_key() {
    let refused = |set: &[&str], words: &[&str]| {
        let set: Vec<_> = set.iter().map(ToString::to_string).collect();
        let error = Config::load(None, &set).unwrap_err().to_string();
        for word in words {
            assert!(error.contains(word), "{word}: {error}");
        }
    };
    refused(&["scene.camera.lens.fx_px=0"], &["scene.camera.lens.fx_px", "allowed is 1 to"]);
    refused(&["scene.camera.fx_px=800"], &["scene.camera.fx_px", "expected `lens` or `mount`"]);
    refused(&["scene.camera.mount.position_m=[0.0, 0.0, 900.0]"], &["scene.camera.mount.position_m[2]"]);
    refused(&["scene.target.radius_m=0.02"], &["scene.target", "P1's radius"]);
    refused(&["scene.target.scale=0"], &["scene.target.scale"]);
    refused(&["scene.arm.model=ur5"], &["scene.arm.model", "same kinds"]);
    refused(&["scene.arm.q_offset_rad_or_m=[0.1, 0.1]"], &["scene.arm.q_offset_rad_or_m", "needs 1 or 4"]);
    refused(
        &["drive.kind=external", "scene.arm.mass_scale=1.1"],
        &["scene.arm.mass_scale", "external drive is the drive's own"],
    );
    // What is looked at is what the true camera sees.
    refused(
        &["scene.camera.mount.position_m=[0.5, 0.0, 0.0]"],
        &["of the target lies outside the image at the start"],
    );
}

/// A run whose control knows of no truth, as before a real camera: the loop is closed all the same, and errors are those of
/// the last measurement.
#[test]
fn a_loop_that_knows_no_truth_closes_too() {
    let real =
        config("scara-d.toml", &["goal.hold_s=0.2", "scene.camera.mount.position_m=[0.005, 0.0, 0.0]"]);
    let mut known = real.clone();
    known.scene = None;
    assert!(known.closes_the_loop() && known.X_WO().is_none());
    let vision = &mut assemble::vision(&known);
    let mut camera = assemble::synthetic_camera::<4>(&real).unwrap();
    let mut control = assemble::control_loop::<4>(&known, real.robot.build().unwrap()).unwrap();
    let i = *known.camera.model.intrinsics();
    let (mut pixels, mut on_its_way) = (vec![0; i.width_px as usize * i.height_px as usize], VecDeque::new());
    let schedule = &known.camera.schedule;
    let finish = (0..20_000).find_map(|tick| {
        let now = MonoNs(TICK.0 * tick as i64);
        camera.arm(&control.sense(tick, now));
        if let Some(frame_id) = schedule.frame_at(tick) {
            camera.expose(&Exposure { frame_id, mid: now, span: known.camera.exposure }, &mut pixels);
            let (width_px, height_px) = (i.width_px, i.height_px);
            let header =
                FrameHeader { frame_id, exposure: now, width_px, height_px, ..FrameHeader::default() };
            let image = ImageView::new(&pixels, width_px as usize, height_px as usize).unwrap();
            let measurement = vision.process(&Frame { header, image }, &Prior::default());
            on_its_way.push_back((schedule.usable_tick(frame_id), measurement));
        }
        let arrived = on_its_way.pop_front_if(|(usable, _)| *usable <= tick).map(|(_, m)| m);
        control.act(now, arrived.as_ref()).finish
    });
    assert_eq!(finish.unwrap().outcome, Outcome::Converged, "{finish:?}");
    let errors = control.final_errors();
    assert!(errors.position_error_m.is_some());
    assert_eq!(errors.position_error_m, errors.believed.position_error_m);
    assert_eq!(errors.feature_error_px, errors.believed.feature_error_px);
}
