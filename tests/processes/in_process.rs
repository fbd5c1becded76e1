//! The cores in one process do to the last bit what the three processes do: there is one implementation of everything.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // helpers of tests are tests

use std::collections::BTreeSet;
use std::ops::ControlFlow;
use std::path::Path;
use vservo::config::Config;
use vservo::control::outcome::Outcome;
use vservo::sim::simulate_system;

/// Runs one file both ways, compares every joint state, and gives their hash.
fn agree(file: &str, settings: &[&str]) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("config").join(file);
    let owned: Vec<String> = settings.iter().map(ToString::to_string).collect();
    let config = Config::load(Some(&path), &owned).unwrap();
    let alone = simulate_system(&config, &mut |_| ControlFlow::Continue(())).unwrap();
    assert_eq!(alone.finish.outcome, Outcome::Converged, "{file} {settings:?}: {}", alone.finish.reason);
    assert!(alone.errors.position_error_m.unwrap() < 0.5e-3, "{file} {settings:?}: {:?}", alone.errors);

    let mut arguments = vec![path.to_str().unwrap(), "--clock", "lockstep"];
    settings.iter().for_each(|s| arguments.extend(["--set", s]));
    let run = crate::common::run("inproc", &arguments);
    assert_eq!(run.summary["state_hash"], alone.state_hash, "{file} {settings:?}: {}", run.text());
    // What else both tell is of the same states; decimal digits on the way cost the last bits.
    for (path, here) in [
        (&["settling_time_s"][..], alone.settling_time_s),
        (&["final", "position_error_m"], alone.errors.position_error_m),
        (&["final", "feature_error_px"], alone.errors.feature_error_px),
    ] {
        let there = crate::common::number(&run.summary, path);
        assert!((there - here.unwrap()).abs() < 1e-12, "{file} {settings:?} {path:?}: {there} {here:?}");
    }
    assert_eq!(run.summary["target_lost"].as_u64(), Some(alone.target_lost), "{file} {settings:?}");
    alone.state_hash
}

/// Velocity laws and torque laws, held, fresh and carried on, with cameras that are late by whole ticks and by parts of
/// them, and one that loses frames.
#[test]
fn one_process_and_three_processes_agree_to_the_last_bit() {
    let late = ["camera.latency_ms=55", "camera.rate_hz=30"];
    let irregular = ["camera.synthetic.latency_jitter_ms=25", "camera.synthetic.frame_loss=0.1"];
    let mut hashes = BTreeSet::new();
    let mut runs = 0;
    for update in ["servo.update=frame", "servo.update=tick", "servo.update=predict"] {
        for (file, camera) in [
            ("default.toml", late),
            ("default.toml", irregular),
            ("scara-b.toml", late),
            ("scara-hybrid.toml", late),
            // Torque laws, with gains that held torques bear.
            ("textbook/scara-a.toml", irregular),
            ("textbook/scara-c.toml", ["camera.latency_ms=7.5", "camera.rate_hz=30"]),
        ] {
            hashes.insert(agree(file, &[camera[0], camera[1], update]));
            runs += 1;
        }
    }
    assert_eq!(hashes.len(), runs, "each law, camera and policy moves the arm differently");
}

/// Faults that are put in on purpose, of each group, are the same in whatever process their part is.
#[test]
fn injected_faults_are_the_same_in_one_process_and_in_three() {
    let mut hashes = BTreeSet::new();
    let faults = [
        "{kind='drop',probability=0.5},{kind='delay',probability=0.3,delay_ms=70.0},{kind='corrupt',share=0.05}",
        "{kind='duplicate',probability=0.4},{kind='freeze',probability=0.4},{kind='torn',probability=0.3},{kind='black',probability=0.2}",
        "{kind='stale',probability=0.4},{kind='jump',probability=0.2,size_px=5.0},{kind='mislabelled',probability=0.2}",
        "{kind='encoder_offset',size_rad_or_m=0.002},{kind='torque_loss',share=0.1},{kind='stale_state',probability=0.1}",
    ];
    for list in faults {
        let set = format!("faults=[{list}]");
        hashes.insert(agree("ur5.toml", &[&set]));
        // A rate of which no period is a whole number of ticks.
        hashes.insert(agree("ur5.toml", &[&set, "camera.rate_hz=30", "run.seed=3"]));
    }
    assert_eq!(hashes.len(), 2 * faults.len(), "each fault moves the arm differently");
}
