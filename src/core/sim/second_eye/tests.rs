//! Control by a camera in the hand and one beside the arm: `config/ur5-two-cameras.toml`.

use crate::config::Config;
use crate::control::outcome::Outcome;
use crate::control::trace::Event;
use crate::scene::Occluder;
use crate::sim::{Moment, SystemRun, simulate_system};
use crate::time::SpanNs;
use nalgebra::Vector2;
use std::ops::ControlFlow;

/// A start from which the camera in the hand does not see its target.
const BLIND: &str = "robot.q_start_rad_or_m=[0.4617,-1.7204,1.4481,-1.2809,-1.4676,0.9664]";

fn load(set: &[&str]) -> Config {
    let set: Vec<_> = set.iter().map(ToString::to_string).collect();
    let text = include_str!("../../../../config/ur5-two-cameras.toml");
    Config::parse("ur5-two-cameras.toml", text, std::path::Path::new("."), &set).unwrap()
}

/// What a run shows of its two cameras.
struct TwoViewRun {
    run: SystemRun,
    /// What was told of them, and when, s.
    told: Vec<(f64, Event)>,
    /// Distance of the arm from the first goal at each tick, m.
    off_m: Vec<f64>,
}

fn run(config: &Config) -> TwoViewRun {
    let (mut told, mut off_m) = (Vec::new(), Vec::new());
    let run = simulate_system(config, &mut |moment| {
        if let Moment::Tick(trace, errors) = moment {
            let of_cameras = |event: &Event| {
                use Event::{BothViews, Fault, FirstViewMissing, GainReduced, Holding, SecondViewMissing};
                matches!(
                    event,
                    FirstViewMissing | SecondViewMissing | BothViews | Holding | GainReduced | Fault(_)
                )
            };
            let events = trace.events.iter().filter(of_cameras);
            told.extend(events.map(|event| (trace.time.0 as f64 * 1e-9, event)));
            off_m.extend(errors.position_error_m);
        }
        ControlFlow::Continue(())
    });
    TwoViewRun { run: run.unwrap(), told, off_m }
}

impl TwoViewRun {
    /// Distance, m, and angle, deg, by which the arm is truly off the goal of the first camera and of the second one.
    fn off(&self) -> [(f64, f64); 2] {
        [self.run.errors, self.run.second_errors.unwrap()].map(|errors| {
            (errors.position_error_m.unwrap(), errors.orientation_error_rad.unwrap().to_degrees())
        })
    }

    fn events(&self) -> Vec<Event> {
        self.told.iter().map(|(_, event)| *event).collect()
    }

    fn in_words(&self) -> String {
        format!("{:?}: {} {:?} {:?}", self.run.finish.outcome, self.run.finish.reason, self.off(), self.told)
    }
}

fn cover(config: &mut Config, second: bool, from_s: f64, until_s: f64) {
    let occluder = Occluder {
        centre_m: Vector2::repeat(0.05),
        size_m: Vector2::repeat(0.3),
        height_m: 0.01,
        level: 140.0,
        from: SpanNs::from_s(from_s),
        until: SpanNs::from_s(until_s),
    };
    let cell = if second { &mut config.second_view.as_mut().unwrap().cell } else { config };
    cell.scene.as_mut().unwrap().occluders.push(occluder);
}

#[test]
fn two_cameras_bring_the_arm_to_both_goals() {
    for scheme in ["position_resolved_velocity", "image_resolved_velocity", "hybrid"] {
        let set = format!("servo.scheme={scheme}");
        let shown = run(&load(&[&set]));
        assert_eq!(shown.run.finish.outcome, Outcome::Converged, "{scheme} {}", shown.in_words());
        for (m, deg) in shown.off() {
            assert!(m < 0.5e-3 && deg < 0.1, "{scheme} {}", shown.in_words());
        }
        assert_eq!(shown.told, [], "{scheme}");
        assert_eq!(run(&load(&[&set])).run.state_hash, shown.run.state_hash, "it repeats to the bit");
    }
}

/// The camera beside the arm brings it near by itself; from where the other one sees its target both go on.
#[test]
fn the_camera_beside_the_arm_leads_to_the_view_of_the_other() {
    let shown = run(&load(&[BLIND]));
    assert_eq!(shown.run.finish.outcome, Outcome::Converged, "{}", shown.in_words());
    assert!(shown.off().iter().all(|(m, deg)| *m < 0.5e-3 && *deg < 0.1), "{}", shown.in_words());
    assert_eq!(shown.events(), [Event::FirstViewMissing, Event::BothViews]);
}

/// One camera that is covered on the way leaves the other in charge, and comes back without a jump.
#[test]
fn a_covered_camera_leaves_the_other_in_charge() {
    for (second, missing) in [(false, Event::FirstViewMissing), (true, Event::SecondViewMissing)] {
        let mut config = load(&[]);
        cover(&mut config, second, 0.3, 2.0);
        let shown = run(&config);
        assert_eq!(shown.run.finish.outcome, Outcome::Converged, "{}", shown.in_words());
        assert_eq!(shown.events(), [missing, Event::BothViews], "{}", shown.in_words());
        assert!(shown.off().iter().all(|(m, deg)| *m < 0.5e-3 && *deg < 0.1), "{}", shown.in_words());
        // Of the way that was left when it was covered most was gone when it was seen again.
        let [before, after] = [300, 1990].map(|tick| shown.off_m[tick]);
        assert!(after < 0.3 * before, "{before} {after}");
    }
}

/// What is covered to the end is the reason of the end; what the other has reached is told.
#[test]
fn a_camera_that_stays_covered_is_told_at_the_end() {
    for (second, words) in [
        (false, "the goal of the second camera was reached, and the first one does not see its target"),
        (true, "the goal of the first camera was reached, and the second one does not see its target"),
    ] {
        let mut config = load(&["run.duration_s=8"]);
        cover(&mut config, second, 0.3, 100.0);
        let shown = run(&config);
        assert_eq!(shown.run.finish.outcome, Outcome::NotConverged, "{}", shown.in_words());
        assert!(shown.run.finish.reason.contains(words), "{}", shown.in_words());
        let (m, deg) = shown.off()[usize::from(!second)];
        assert!(m < 0.5e-3 && deg < 0.1, "{}", shown.in_words());
    }
    let mut config = load(&["run.duration_s=4"]);
    cover(&mut config, false, 0.3, 100.0);
    cover(&mut config, true, 0.3, 100.0);
    let shown = run(&config);
    assert_eq!(shown.run.finish.outcome, Outcome::NotConverged, "{}", shown.in_words());
    assert!(shown.events().contains(&Event::Holding), "without both the arm holds: {}", shown.in_words());
    assert!(shown.run.finish.reason.contains("the target was lost"), "{}", shown.in_words());
}

/// Goals that lie 2 cm apart: the arm comes to rest between them, nearer to the one that counts more.
#[test]
fn goals_that_contradict_end_at_their_compromise() {
    let [x, y, z] = [0.0316, 0.067_121, 0.823_515_1 + 0.02];
    let apart = format!("second_view.desired.position_m=[{x},{y},{z}]");
    let mut before = 0.0;
    for weight in ["0.2", "1.0", "5.0"] {
        let shown = run(&load(&[&apart, &format!("second_view.weight={weight}"), "run.duration_s=12"]));
        assert_eq!(shown.run.finish.outcome, Outcome::NotConverged, "{}", shown.in_words());
        assert!(
            shown.run.finish.reason.contains("their goals cannot be met together"),
            "{}",
            shown.in_words()
        );
        // Noise of two cameras that pull may seem to be a swing, which is calmed; nothing else is told.
        assert!(shown.events().iter().all(|event| *event == Event::GainReduced), "{}", shown.in_words());
        let [(first_m, _), (second_m, _)] = shown.off();
        // A turn of the camera makes up for a part of the way: what is left of the two may be less than 2 cm together.
        assert!(first_m > before && first_m < 0.02 && second_m < 0.02, "{}", shown.in_words());
        before = first_m;
        let stands = shown.off_m[8000..11_900].iter().map(|m| (m - first_m).abs()).fold(0.0, f64::max);
        assert!(stands < 0.2e-3, "it stands: {stands}");
    }
}
