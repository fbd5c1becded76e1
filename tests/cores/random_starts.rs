//! Starts all about the goal, with the target in view: velocity laws bring each home, and hardly lose the target on the way.

#![allow(non_snake_case, clippy::unwrap_used, clippy::panic)] // helpers of tests

use nalgebra::Vector3;
use std::ops::ControlFlow::Continue;
use std::path::Path;
use vservo::config::Config;
use vservo::control::outcome::Outcome;
use vservo::linalg::Random;
use vservo::messages::ControlState;
use vservo::sim::preflight::{Preflight, Reach};
use vservo::sim::{Moment, simulate_system};

/// How far a joint is from its place at the goal, rad.
const SPREAD: f64 = 1.0;

/// Largest tilt of the target against the image, rad: dots that are seen more aslant are ellipses that vision may not take for them.
const TILT: f64 = 1.1;

/// The run file `arm` from `count` postures in which all of the target is in the image, between 0.15 and 1.2 m away.
fn starts(arm: &str, count: usize, seed: u64, set: &[&str]) -> Vec<Config> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("config/{arm}.toml"));
    let given: Vec<String> =
        set.iter().map(|key| (*key).to_string()).chain(["run.duration_s=12".into()]).collect();
    let Reach::Within(goal) = Preflight::of(&Config::load(Some(&path), &given).unwrap()).unwrap().reach
    else {
        panic!("{arm}: the goal is within reach");
    };
    let mut random = Random::new(seed);
    let drawn = std::iter::repeat_with(|| {
        let q: Vec<f64> = goal.q.iter().map(|q| q + random.between(-SPREAD, SPREAD)).collect();
        let set: Vec<String> =
            given.iter().cloned().chain([format!("robot.q_start_rad_or_m={q:?}")]).collect();
        let config = Config::load(Some(&path), &set).ok()?;
        let view = Preflight::of(&config).ok()?.start?;
        let tilt = (view.X_CO.rotation * Vector3::z()).angle(&Vector3::z());
        let visible = view.visibility.front && view.visibility.room_px > 12.0 && tilt < TILT;
        (visible && (0.15..1.2).contains(&view.object_position_m[2])).then_some(config)
    });
    drawn.flatten().take(count).collect()
}

/// How many of the starts end at the goal, and how many lost the target on the way.
fn runs_of(configs: &[Config]) -> (usize, usize) {
    let (mut home, mut lost) = (0, 0);
    for config in configs {
        let mut returned = false;
        let run = simulate_system(config, &mut |moment| {
            if let Moment::Tick(trace, _) = moment {
                returned |= trace.state == ControlState::Returning;
            }
            Continue(())
        });
        home += usize::from(run.unwrap().finish.outcome == Outcome::Converged);
        lost += usize::from(returned);
    }
    (home, lost)
}

/// Torque laws on arms as they are, with a light wrist and more joints than a camera needs, beyond the limits of which they ask: A and C with the gains of docs/tuning.md.
#[test]
fn torque_laws_bring_arms_home() {
    let gains = [
        "servo.pd.position_stiffness_n_m=300",
        "servo.pd.orientation_stiffness_nm_rad=30",
        "servo.pd.position_damping_ns_m=150",
        "servo.pd.orientation_damping_nms_rad=15",
    ];
    for arm in ["ur5", "panda", "xarm7"] {
        for scheme in ["servo.scheme=position_pd", "servo.scheme=image_pd"] {
            let configs = starts(arm, 4, 20, &[&[scheme][..], &gains].concat());
            let (home, lost) = runs_of(&configs);
            assert_eq!(home, configs.len(), "{arm} {scheme}: {lost} lost their target");
        }
    }
}

#[test]
fn starts_in_view_come_home() {
    for (arm, scheme) in [
        ("ur5", "image_resolved_velocity"),
        ("xarm7", "image_resolved_velocity"),
        ("panda", "hybrid"),
        ("ur5", "position_resolved_velocity"),
    ] {
        let scheme = format!("servo.scheme={scheme}");
        let configs = starts(arm, 12, 20, &[&scheme]);
        let (home, lost) = runs_of(&configs);
        assert_eq!(home, configs.len(), "{arm} {scheme}: {lost} lost their target");
        assert!(lost <= 1, "{arm} {scheme}: {lost} of {} lost their target", configs.len());
    }
}
