//! A target that moves by itself: its acceleration is estimated and carried on, so that the arm stays near it; one that leaps is found at its new place.

#![allow(clippy::unwrap_used)] // helpers of tests are tests

use std::ops::ControlFlow::Continue;
use std::path::Path;
use vservo::config::Config;
use vservo::control::outcome::Outcome;
use vservo::control::trace::Event;
use vservo::sim::{Moment, simulate_system};

/// Root mean square of the true feature error from 2 s to 6 s behind the target of `file` that moves as `motion` says, px.
fn error_behind(file: &str, motion: &[String], seed: u64) -> f64 {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("config/{file}.toml"));
    let mut set = vec![
        "servo.object.moves=true".into(),
        "goal.hold_s=60".into(),
        "run.duration_s=6".into(),
        format!("run.seed={seed}"),
    ];
    set.extend_from_slice(motion);
    let config = Config::load(Some(&path), &set).unwrap();
    let (mut ticks, mut count, mut squares) = (0, 0.0, 0.0);
    let run = simulate_system(&config, &mut |moment| {
        if let Moment::Tick(_, errors) = moment {
            ticks += 1;
            if (2000..6000).contains(&ticks) {
                squares += errors.feature_error_px.unwrap().powi(2);
                count += 1.0;
            }
        }
        Continue(())
    })
    .unwrap();
    assert_eq!(run.target_lost, 0, "{file} {motion:?}");
    f64::sqrt(squares / count)
}

/// Root mean square behind a circle at 0.5 Hz, px: half as much again as was measured.
const CIRCLE_PX: f64 = 4.0;

/// Half of what a constant velocity between measurements left, px: measured with the version before.
#[test]
fn errors_behind_a_pendulum_are_half_of_what_velocity_leaves() {
    for (file, m, hz, before_px) in [
        ("ur5", [0.0, 0.1, 0.0], 0.5, 9.1),
        ("ur5", [0.0, 0.05, 0.0], 0.5, 4.2),
        ("ur5", [0.0, 0.05, 0.0], 0.2, 0.74),
        ("ur5", [0.06, 0.0, 0.03], 0.4, 3.5),
        ("ur5", [0.04, 0.04, 0.0], 0.6, 7.4),
        ("panda", [0.0, 0.06, 0.0], 0.45, 3.9),
        ("default", [-0.04, 0.04, 0.03], 0.35, 1.2),
        ("default", [0.0, 0.1, 0.0], 0.5, 4.9),
        ("default", [0.0, 0.05, 0.0], 0.2, 0.43),
    ] {
        let motion = [
            "scene.motion.kind=pendulum".into(),
            format!("scene.motion.amplitude_m={m:?}"),
            format!("scene.motion.frequency_hz={hz}"),
        ];
        let px = error_behind(file, &motion, 61);
        assert!(px <= 0.5 * before_px, "{file} {m:?} {hz} Hz: {px} px, {before_px} px before");
    }
}

/// The guard of the image's border counts the motion in the image alone: with that of the arm behind the target it bent the way until the target was lost.
#[test]
fn the_guard_lets_the_arm_follow_a_circle() {
    for (file, radius_m, most_px) in [
        ("ur5", [0.0, 0.1, 0.0], CIRCLE_PX),
        ("ur5", [0.0, -0.05, 0.0], CIRCLE_PX),
        ("default", [-0.1, 0.0, 0.0], CIRCLE_PX),
        ("panda", [0.0, -0.05, 0.0], CIRCLE_PX),
    ] {
        let motion = [
            "scene.motion.kind=circle".into(),
            format!("scene.motion.radius_m={radius_m:?}"),
            "scene.motion.frequency_hz=0.5".into(),
        ];
        let px = error_behind(file, &motion, 62);
        assert!(px <= most_px, "{file} {radius_m:?}: {px} px");
    }
}

/// What is in view after it has leapt is found in the same frame, wherever the tracking windows are, and the run converges there.
#[test]
fn a_target_that_leaps_within_the_view_is_reached() {
    for (file, m, at_s, seed) in [
        ("ur5", [-0.05, 0.08, 0.0], 0.3, 71),
        ("ur5", [0.0, -0.07, 0.0], 1.7, 72),
        ("ur5-hybrid", [0.0, 0.07, 0.0], 0.35, 73),
        ("ur5-b", [0.02, -0.05, 0.02], 1.7, 74),
        ("panda", [0.06, 0.0, 0.0], 1.7, 75),
        ("scara-d", [0.05, 0.03, 0.0], 1.7, 76),
    ] {
        for moves in [false, true] {
            let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("config/{file}.toml"));
            let set = [
                format!("servo.object.moves={moves}"),
                "servo.depth=estimated".into(),
                "goal.hold_s=2".into(),
                "run.duration_s=6".into(),
                "scene.motion.kind=jump".into(),
                format!("scene.motion.displacement_m={m:?}"),
                format!("scene.motion.at_s={at_s}"),
                format!("run.seed={seed}"),
            ];
            let config = Config::load(Some(&path), &set).unwrap();
            let run = simulate_system(&config, &mut |_| Continue(())).unwrap();
            let what = format!("{file} {m:?} at {at_s} s, moves {moves}");
            assert_eq!(run.finish.outcome, Outcome::Converged, "{what}: {}", run.finish.reason);
            assert_eq!(run.target_lost, 0, "{what}");
        }
    }
}

/// What leaps out of the image is looked for about the place where it was, and the run converges there; without the search it is lost for good.
#[test]
fn a_target_that_leaps_out_of_view_is_looked_for() {
    for (file, m, at_s, seed) in [
        ("ur5", [0.06, -0.08, 0.0], 0.6, 81),
        ("ur5", [-0.07, -0.07, 0.01], 2.5, 82),
        ("ur5-hybrid", [0.09, 0.03, -0.01], 2.5, 83),
        ("ur5-b", [0.02, -0.09, 0.0], 2.5, 84),
        ("panda", [0.02, -0.1, 0.0], 0.6, 85),
        ("xarm7", [-0.02, 0.1, 0.0], 2.5, 86),
        ("scara-d", [-0.09, -0.04, 0.0], 2.5, 87),
    ] {
        for search_s in [10.0, 0.0] {
            let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("config/{file}.toml"));
            let set = [
                format!("servo.search_s={search_s:?}"),
                "goal.hold_s=2".into(),
                "run.duration_s=16".into(),
                "scene.motion.kind=jump".into(),
                format!("scene.motion.displacement_m={m:?}"),
                format!("scene.motion.at_s={at_s}"),
                format!("run.seed={seed}"),
            ];
            let config = Config::load(Some(&path), &set).unwrap();
            let limits: Vec<f64> = config.robot.joints.iter().map(|joint| joint.limits.velocity).collect();
            let (mut searches, mut fastest) = (false, 0.0_f64);
            let run = simulate_system(&config, &mut |moment| {
                if let Moment::Tick(trace, _) = moment {
                    for event in trace.events.iter() {
                        searches = match event {
                            Event::Searching => true,
                            Event::Resumed | Event::Returning => false,
                            _ => searches,
                        };
                    }
                    // What the way back had left is braked.
                    if searches {
                        let qd = trace.command.qd_r.iter().zip(&limits).map(|(qd, limit)| qd.abs() / limit);
                        fastest = fastest.max(qd.fold(0.0, f64::max));
                    }
                }
                Continue(())
            })
            .unwrap();
            let what = format!("{file} {m:?} at {at_s} s, {search_s} s");
            let looks = search_s > 0.0;
            assert_eq!(run.finish.outcome == Outcome::Converged, looks, "{what}: {}", run.finish.reason);
            assert!(fastest < 0.26, "{what}: {fastest}");
            assert!(run.target_lost > 0, "{what}");
        }
    }
}

/// The search comes to an end: the arm goes back to where it saw its target, which stays covered, and stands.
#[test]
fn a_target_that_stays_covered_is_looked_for_in_vain() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/ur5.toml");
    let set = [
        "servo.search_s=4",
        "goal.hold_s=60",
        "run.duration_s=14",
        "scene.occluder={from_s=2.5, until_s=90, center_m=[0.05,0.05], size_m=[0.14,0.14], height_m=0.0}",
    ];
    let config = Config::load(Some(&path), &set.map(String::from)).unwrap();
    let (mut events, mut q) = (Vec::new(), Vec::new());
    let run = simulate_system(&config, &mut |moment| {
        if let Moment::Tick(trace, _) = moment {
            events.extend(trace.events.iter());
            q.push(trace.joint_state.q);
        }
        Continue(())
    })
    .unwrap();
    assert_eq!(run.finish.reason, "run.duration_s is over: the target was lost");
    let loss = events.iter().position(|event| *event == Event::Holding).unwrap();
    // It rests at the goal, so that it looks around from there.
    assert_eq!(events[loss..], [Event::Holding, Event::Searching, Event::Returning]);
    let away = |k: usize| q[k].iter().zip(&q[q.len() - 1]).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(away(q.len() - 2000) < 2e-3, "it stands at the end");
    assert!(away(2499) < 0.1 && (3000..7000).map(away).fold(0.0, f64::max) > 0.15, "{}", away(2499));
}

/// What a run that follows is told to change is nothing that its file has already.
#[test]
fn a_run_that_stays_behind_its_object_is_told_what_is_left() {
    for moves in [false, true] {
        let set = [
            format!("servo.object.moves={moves}"),
            "goal.feature_error_px=0.01".into(),
            "run.duration_s=20".into(),
            "scene.motion.kind=pendulum".into(),
            "scene.motion.frequency_hz=0.5".into(),
            "scene.motion.amplitude_m=[0, 0.02, 0]".into(),
        ];
        let config = Config::load(None, &set).unwrap();
        let run = simulate_system(&config, &mut |_| Continue(())).unwrap();
        assert_eq!(run.finish.outcome, Outcome::NotConverged);
        let told = run.finish.reason;
        assert_eq!(told.contains("the object moves (servo.object.moves)"), !moves, "{told}");
        assert_eq!(told.contains("the arm follows the object"), moves, "{told}");
    }
}

/// Arms that begin to move with their first view, beside a conveyor that nobody told of: for a moment the image looks like that of a camera that is mounted turned by half a turn.
#[test]
fn an_untold_conveyor_at_the_start_is_no_wrong_mount() {
    for file in ["default", "ur5"] {
        for (speed_m_s, angle) in [(0.05, 120.0), (0.05, 0.0), (0.03, 60.0), (0.08, 240.0_f64)] {
            let (y, x) = angle.to_radians().sin_cos();
            let set = [
                "scene.motion.kind=conveyor".to_owned(),
                format!("scene.motion.velocity_m_s=[{:.4}, {:.4}, 0.0]", speed_m_s * x, speed_m_s * y),
                "run.duration_s=3".into(),
            ];
            let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("config/{file}.toml"));
            let config = Config::load(Some(&path), &set).unwrap();
            let run = simulate_system(&config, &mut |_| Continue(())).unwrap();
            assert_ne!(run.finish.outcome, Outcome::Fault, "{file} {speed_m_s} {angle}: {:?}", run.finish);
        }
    }
}
