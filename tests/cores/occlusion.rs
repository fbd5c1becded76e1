//! A target that is partly hidden: a covered dot costs one feature and not the target, two stop the arm for as long as
//! they are covered, and of a grid half is enough.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // helpers of tests are tests

use std::ops::ControlFlow;
use std::path::Path;
use vservo::config::Config;
use vservo::control::outcome::Outcome;
use vservo::control::trace::Event;
use vservo::messages::{ControlState, JointState};
use vservo::sim::{Moment, SystemRun, simulate_system};

/// Each law, for m = 4 and m = 6.
const EVERY_SCHEME: [&str; 8] = [
    "textbook/scara-a.toml",
    "scara-b.toml",
    "textbook/scara-c.toml",
    "scara-d.toml",
    "scara-hybrid.toml",
    "default.toml",
    "ur5-b.toml",
    "ur5-hybrid.toml",
];

struct Watched {
    run: SystemRun,
    events: Vec<(f64, Event)>,
    /// Greatest measured joint speed from 1.4 s to 1.5 s, rad/s or m/s.
    speed_at_the_end_of_cover: f64,
}

fn watch(file: &str, set: &[String]) -> Watched {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("config").join(file);
    let mut set = [&["goal.hold_s=0.2".to_owned()], set].concat();
    // Slow enough that the arm is on its way while something is covered.
    if file.starts_with("textbook/") {
        set.extend(
            ["servo.update=predict", "camera.latency_ms=20", "camera.exposure_ms=4"].map(String::from),
        );
    } else if !file.starts_with("scara-") {
        set.push(format!("servo.gain_1_s={}", if file == "default.toml" { 2.0 } else { 1.0 }));
    }
    let config = Config::load(Some(&path), &set).unwrap_or_else(|e| panic!("{file}: {e}"));
    let (mut events, mut speed) = (Vec::new(), 0.0f64);
    let run = simulate_system(&config, &mut |moment| {
        if let Moment::Tick(trace, _) = moment {
            let time_s = trace.joint_state.tick as f64 * 1e-3;
            events.extend(trace.events.iter().map(|event| (time_s, event)));
            if (1.4..1.5).contains(&time_s) {
                speed = trace.joint_state.qd.iter().fold(speed, |most, qd| most.max(qd.abs()));
            }
        }
        ControlFlow::Continue(())
    })
    .unwrap();
    Watched { run, events, speed_at_the_end_of_cover: speed }
}

/// Something of `size` m before the target's place `center`, from `from` s to `until` s.
fn cover(center: [f64; 2], size: [f64; 2], from: f64, until: f64) -> Vec<String> {
    vec![format!(
        "scene.occluder={{from_s={from}, until_s={until}, center_m={center:?}, size_m={size:?}, height_m=0.0}}"
    )]
}

/// The same with an arm that stays where it lost its target.
fn holding(mut set: Vec<String>) -> Vec<String> {
    set.push("servo.return_to_last_seen=false".into());
    set
}

fn assert_there(what: &str, Watched { run, events, .. }: &Watched) {
    assert_eq!(run.finish.outcome, Outcome::Converged, "{what}: {run:?} {events:?}");
    let (position_m, angle) =
        (run.errors.position_error_m.unwrap(), run.errors.orientation_error_rad.unwrap());
    assert!(position_m < 1e-3 && angle < 2e-3, "{what}: {position_m} m, {angle} rad");
}

#[test]
fn any_dot_of_four_may_be_covered_for_a_second_in_any_scheme() {
    for file in EVERY_SCHEME {
        for center in [[0.0, 0.0], [0.1, 0.0], [0.1, 0.1], [0.0, 0.1]] {
            let what = format!("{file} without the dot at {center:?}");
            let watched = watch(file, &cover(center, [0.04, 0.04], 0.5, 1.5));
            assert_there(&what, &watched);
            let told: Vec<_> = watched.events.iter().map(|(_, event)| *event).collect();
            assert_eq!(told, [Event::Degraded, Event::WholeAgain], "{what}");
            assert!(watched.events[0].0 >= 0.5 && watched.events[1].0 < 1.7, "{what}: {:?}", watched.events);
        }
    }
}

#[test]
fn with_two_dots_occluded_the_arm_slows_holds_and_resumes() {
    for file in EVERY_SCHEME {
        for (center, size) in [([0.05, 0.0], [0.15, 0.04]), ([0.1, 0.05], [0.04, 0.15])] {
            let what = format!("{file}, two dots about {center:?}");
            let watched = watch(file, &holding(cover(center, size, 0.5, 1.5)));
            assert_there(&what, &watched);
            let told: Vec<_> = watched.events.iter().map(|(_, event)| *event).collect();
            assert_eq!(told, [Event::Holding, Event::Resumed], "{what}");
            assert!(
                watched.speed_at_the_end_of_cover < 0.02,
                "{what}: {}",
                watched.speed_at_the_end_of_cover
            );
            assert!(watched.run.target_lost > 0, "{what}");
        }
    }
}

/// The arm that has lost its target goes back to where it saw all of it, once, says so and stands there.
#[test]
fn an_arm_that_lost_its_target_returns_to_where_it_saw_it() {
    for (file, mode) in
        [("default.toml", "torque"), ("ur5-b.toml", "velocity"), ("scara-hybrid.toml", "torque")]
    {
        let mut set = cover([0.05, 0.0], [0.15, 0.04], 0.5, 6.0);
        set.extend(
            [
                "goal.hold_s=0.2",
                "servo.gain_1_s=2.0",
                "servo.return_to_last_seen=true",
                "servo.search_s=0",
                "run.duration_s=20.0",
            ]
            .map(String::from),
        );
        set.push(format!("drive.mode='{mode}'"));
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("config").join(file);
        let config = Config::load(Some(&path), &set).unwrap_or_else(|e| panic!("{file}: {e}"));
        let (mut events, mut states) = (Vec::new(), Vec::new());
        let run = simulate_system(&config, &mut |moment| {
            if let Moment::Tick(trace, _) = moment {
                events.extend(trace.events.iter());
                states.push((trace.state, trace.joint_state));
            }
            ControlFlow::Continue(())
        })
        .unwrap();
        assert_eq!(run.finish.outcome, Outcome::Converged, "{file}: {run:?}");
        assert_eq!(events, [Event::Holding, Event::Returning, Event::Resumed], "{file}");
        let (held, arm) = &states[5900];
        assert_eq!(*held, ControlState::Holding, "{file}");
        assert!(states[..5900].iter().any(|(s, _)| *s == ControlState::Returning), "{file}");
        let away =
            |other: &JointState| arm.q.iter().zip(other.q).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        let from_last_view = states[400..520].iter().map(|(_, s)| away(s)).fold(f64::INFINITY, f64::min);
        let farthest = states[520..5900].iter().map(|(_, s)| away(s)).fold(0.0, f64::max);
        assert!(from_last_view < 2e-3 && farthest > 5e-3, "{file}: {from_last_view} {farthest}");
        assert!(arm.qd.iter().all(|qd| qd.abs() < 0.02), "{file}: {:?}", arm.qd);
    }
}

/// Three dots do not begin a run, and do not go on for ever: what is known of the fourth grows old.
#[test]
fn a_dot_that_stays_hidden_stops_the_arm() {
    for file in ["default.toml", "ur5-b.toml"] {
        for center in [[0.0, 0.0], [0.1, 0.1]] {
            let late = watch(file, &cover(center, [0.04, 0.04], 0.0, 0.6));
            assert_there(file, &late);
            assert!(late.events.is_empty(), "{file}: {:?}", late.events);
            let ever = watch(
                file,
                &holding(
                    [cover(center, [0.04, 0.04], 0.5, 100.0), vec!["run.duration_s=8.0".into()]].concat(),
                ),
            );
            assert_eq!(ever.run.finish.outcome, Outcome::NotConverged, "{file}: {:?}", ever.run);
            assert!(ever.run.finish.reason.contains("too much of the target was hidden"), "{:?}", ever.run);
            let [(degraded, Event::Degraded), (holding, Event::Holding)] = ever.events[..] else {
                panic!("{file}: {:?}", ever.events)
            };
            // 3 s after the last whole view, and the timeout of measurements
            assert!((2.9..3.4).contains(&(holding - degraded)), "{file}: {degraded} s, {holding} s");
            // until then it went towards the goal
            let truth_m = ever.run.errors.position_error_m.unwrap();
            assert!(truth_m < 0.012, "{file}: {truth_m}");
        }
    }
}

fn grid(pitch_m: f64) -> Vec<String> {
    vec!["target.kind='dot_grid'".into(), format!("target.dot_grid={{columns=7, rows=5, pitch_m={pitch_m}}}")]
}

#[test]
fn half_a_grid_is_enough() {
    for (k, file) in EVERY_SCHEME.into_iter().enumerate() {
        let mut set = grid(0.02);
        if file == "textbook/scara-c.toml" {
            set.push("servo.points=[1, 7, 29, 35]".into());
        }
        let whole = watch(file, &set);
        assert_there(&format!("{file}, a grid"), &whole);
        assert!(whole.events.is_empty(), "{file}: {:?}", whole.events);
        // columns 0 to 3 of 7 are hidden, or the lower half, by turns of the files; all the time
        let (center, size) = [([0.03, 0.04], [0.075, 0.12]), ([0.06, 0.07], [0.16, 0.07])][k % 2];
        let what = format!("{file}, a grid hidden about {center:?}");
        let half = watch(file, &[set.clone(), cover(center, size, 0.0, 100.0)].concat());
        assert_there(&what, &half);
        assert!(matches!(half.events.as_slice(), [(_, Event::Degraded)]), "{what}: {:?}", half.events);
    }
}

/// The estimate of its motion lives on three dots and what is known of the fourth: neither arm nor windows lose the target.
#[test]
fn a_target_that_moves_is_followed_with_one_dot_covered() {
    let moving = [
        "scene.motion.kind='conveyor'",
        "scene.motion.velocity_m_s=[-0.05, -0.05, 0.0]",
        "servo.object.moves=true",
        "servo.depth='estimated'",
        "run.duration_s=5.0",
    ];
    for center in [[0.0, 0.0], [0.1, 0.0], [0.1, 0.1], [0.0, 0.1]] {
        for from in [0.5, 2.5] {
            let set =
                [moving.map(String::from).to_vec(), cover(center, [0.04, 0.04], from, from + 1.0)].concat();
            let Watched { run, events, .. } = watch("default.toml", &set);
            let told: Vec<_> = events.iter().map(|(_, event)| *event).collect();
            assert_eq!(told, [Event::Degraded, Event::WholeAgain], "{center:?} from {from} s");
            assert_eq!(run.target_lost, 0);
            let error_px = run.errors.feature_error_px.unwrap();
            assert!(error_px < 0.3, "{center:?} from {from} s: {error_px} px behind it at the end");
        }
    }
}
