//! Faults that are put into simulated cells on purpose: how runs end, what the true arm does, and that nothing changes outside of a fault's time.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // helpers of tests are tests

use std::ops::ControlFlow::{Break, Continue};
use std::path::Path;
use vservo::config::Config;
use vservo::control::outcome::Outcome;
use vservo::messages::JointState;
use vservo::sim::faults::{FAULT_CASES, FaultJob, FaultRun, jobs};
use vservo::sim::{Moment, simulate_system};

/// Flies `jobs` on two threads.
fn flown(jobs: &[FaultJob]) -> Vec<FaultRun> {
    let half = |jobs: &[FaultJob]| jobs.iter().map(|job| job.fly().unwrap()).collect::<Vec<_>>();
    let (a, b) = jobs.split_at(jobs.len() / 2);
    std::thread::scope(|scope| {
        let first = scope.spawn(|| half(a));
        let second = half(b);
        first.join().unwrap().into_iter().chain(second).collect()
    })
}

fn named(names: &[&str]) -> Vec<String> {
    names.iter().map(ToString::to_string).collect()
}

/// Whether a case is about frames or measurements.
fn is_seen(run: &FaultRun) -> bool {
    !(run.case.starts_with("encoder") || run.case.starts_with("torque") || run.case == "stale-state")
}

/// The campaign in short: every case, under an image-based and a position-based law, on an arm of six joints and on one of seven.
#[test]
fn every_fault_ends_as_it_should_within_limits() {
    let mut all = jobs(&[], &named(&["D-mean"]), &named(&["ur5"]), 1);
    all.extend(jobs(&[], &named(&["B"]), &named(&["panda"]), 1));
    let runs = flown(&all);
    assert_eq!(runs.len(), 2 * FAULT_CASES.len());
    for (run, job) in runs.iter().zip(&all) {
        let at = || format!("{run:?}\n{}", job.command());
        assert!(run.is_finite, "{}", at());
        assert!(run.commanded_by_limit < 1.0001, "{}", at());
        assert!(
            matches!(run.outcome, Outcome::Converged | Outcome::NotConverged | Outcome::Fault),
            "{}",
            at()
        );
        // An encoder that freezes before a drive that obeys torques: docs/safety.md tells what becomes of it.
        if run.case.starts_with("encoder-freeze") {
            continue;
        }
        // Nor can an arm rest whose motor is gone.
        let has_no_brake = job.case.ends.has_no_brake;
        assert!(run.is_right && (run.is_at_rest || has_no_brake), "{}", at());
        if has_no_brake {
            continue;
        }
        assert!(run.speed_by_limit < 1.1, "{}", at());
        if is_seen(run) {
            assert!(run.acceleration_by_limit < 1.1, "{}", at());
        }
    }
}

/// Measured joint states and images of a run, up to `ticks`.
fn states(set: &[&str], ticks: u64) -> (Vec<JointState>, Vec<Vec<u8>>) {
    let set = named(set);
    let config = Config::load(Some(Path::new("ur5")), &set).unwrap();
    let (mut states, mut images) = (Vec::new(), Vec::new());
    simulate_system(&config, &mut |moment| {
        match moment {
            Moment::Frame(_, image) => {
                images.push((0..image.height()).flat_map(|y| image.row(y)).copied().collect())
            }
            Moment::Tick(trace, _) => states.push(trace.joint_state),
        }
        if states.len() as u64 >= ticks { Break(()) } else { Continue(()) }
    })
    .unwrap();
    (states, images)
}

#[test]
fn before_its_time_a_fault_changes_not_one_bit() {
    let without = states(&[], 400);
    for case in FAULT_CASES.iter().filter(|case| !case.fault.is_empty()) {
        let fault = format!("faults=[{{from_s=0.3,{}}}]", case.fault);
        let with = states(&[&fault], 300);
        assert!(with.0.iter().zip(&without.0).all(|(a, b)| a == b), "{}", case.name);
        assert!(with.1.iter().zip(&without.1).all(|(a, b)| a == b), "{}", case.name);
    }
    let late = states(&["faults=[{kind=\"drop\",from_s=100.0}]"], 400);
    assert_eq!(late, without);
}

#[test]
fn the_same_seed_has_the_same_run_and_another_has_another() {
    let run = |seed: u64| {
        let job = jobs(&named(&["drop"]), &named(&["D-mean"]), &named(&["ur5"]), seed).pop().unwrap();
        job.fly().unwrap()
    };
    assert_eq!(run(1), run(1));
    assert_ne!(run(1).state_hash, run(2).state_hash);
}

#[test]
fn what_cannot_be_meant_is_refused_with_words() {
    let told = |faults: &str| {
        let set = named(&[faults, "run.clock=lockstep"]);
        Config::load(Some(Path::new("ur5")), &set).map(|_| ()).unwrap_err().to_string()
    };
    for (faults, words) in [
        ("faults=[{from_s=1.0}]", "faults[0].kind: is missing"),
        ("faults=[{kind=\"dropp\"}]", "dropp"),
        (
            "faults=[{kind=\"drop\",delay_ms=3.0}]",
            "faults[0].delay_ms: says nothing about a fault of this kind",
        ),
        ("faults=[{kind=\"drop\",probability=1.5}]", "faults[0].probability: 1.5 is out of range"),
        (
            "faults=[{kind=\"drop\"},{kind=\"delay\",delay_ms=9e9}]",
            "faults[1].delay_ms: 9000000000 is out of range",
        ),
        ("faults=[{kind=\"torque_loss\",joint=6}]", "faults[0].joint: 6 is out of range, allowed is 0 to 5"),
    ] {
        assert!(told(faults).contains(words), "{}", told(faults));
    }
    let many = format!("faults=[{}]", "{kind=\"drop\"},".repeat(17));
    assert!(told(&many).contains("at most 16"), "{}", told(&many));
    let ideal = Config::load(
        Some(Path::new("ur5")),
        &named(&["drive.kind=ideal", "faults=[{kind=\"stale_state\"}]"]),
    );
    assert!(ideal.unwrap_err().to_string().contains("needs drive.kind = \"simulated\""));
}
