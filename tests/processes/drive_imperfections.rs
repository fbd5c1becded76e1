//! Arms that are not as the controller thinks: every imperfection of the simulated drive, alone and together, in every
//! command mode. They converge with the accuracy that is owed, and repeat.

#![allow(clippy::unwrap_used)]

use crate::common::{Instance, Run, assert_accurate, kill, run, vservo, wait_for_line};
use std::path::Path;
use std::process::Stdio;

fn lockstep(arm: &str, set: &[&str]) -> Run {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("config/{arm}.toml"));
    let mut arguments = vec![file.to_str().unwrap(), "--clock", "lockstep"];
    for s in set {
        arguments.extend(["--set", s]);
    }
    run("imperfect", &arguments)
}

/// A heavy load, coarse and noisy encoders, late commands.
const EVERYTHING: [&str; 5] = [
    "drive.simulated.payload_kg=1",
    "drive.simulated.payload_com_m=[0.02, 0.03, 0.06]",
    "drive.simulated.encoder_step_rad_or_m=[2e-5]",
    "drive.simulated.encoder_noise_sd_rad_or_m=[1e-5]",
    "drive.simulated.command_delay_ticks=2",
];

#[test]
fn everything_at_once_converges_in_every_mode_and_repeats() {
    for arm in ["default", "ur5", "panda"] {
        let mut hashes = Vec::new();
        for mode in ["torque", "velocity", "position"] {
            let mode = format!("drive.mode={mode}");
            let set = [&EVERYTHING[..], &[mode.as_str()]].concat();
            let r = lockstep(arm, &set);
            assert_accurate(&r);
            hashes.push(r.summary["state_hash"].clone());
        }
        let again = lockstep(arm, &[&EVERYTHING[..], &["drive.mode=torque"]].concat());
        assert_eq!(again.summary["state_hash"], hashes[0], "{arm}");
        assert!(hashes[0] != hashes[1] && hashes[1] != hashes[2], "{arm}: the mode makes a difference");
    }
}

#[test]
fn each_imperfection_alone_is_felt_and_mastered() {
    let exact = lockstep("ur5", &[]).summary["state_hash"].clone();
    for set in [EVERYTHING[0], EVERYTHING[2], EVERYTHING[3], EVERYTHING[4], "drive.simulated.substeps=3"] {
        let r = lockstep("ur5", &[set]);
        assert_accurate(&r);
        assert_ne!(r.summary["state_hash"], exact, "{set}");
    }
    // 10 N m s/rad and 1 N m on wrists of a few grams: the controller knows of it, and the integrator stands it.
    assert_accurate(&lockstep("xarm7", &[]));
    // Friction that the controller makes up for and that is not there.
    assert_accurate(&lockstep("panda", &["drive.simulated.friction=false"]));
    for mode in ["drive.mode=velocity", "drive.mode=position"] {
        assert_accurate(&lockstep("default", &["drive.kind=ideal", mode]));
    }
}

#[test]
fn wrong_values_are_refused() {
    for (set, message) in [
        ("drive.simulated.substeps=0", "drive.simulated.substeps: 0 is out of range"),
        ("drive.simulated.payload_kg=-1", "drive.simulated.payload_kg: -1 is out of range"),
        ("drive.simulated.command_delay_ticks=51", "out of range, allowed is 0 to 50"),
        ("drive.simulated.encoder_step_rad_or_m=[0, 0]", "has 2 entries, needs 1 or 4"),
        (
            "drive.simulated.encoder_noise_sd_rad_or_m=[-1]",
            "encoder_noise_sd_rad_or_m[0]: -1 is out of range",
        ),
        ("drive.simulated.velocity_filter_hz=nan", "NaN is out of range"),
        ("drive.simulated.servo_natural_frequency_rad_s=0", "is out of range"),
        ("drive.mode=force", "unknown variant `force`, expected one of `torque`, `velocity`, `position`"),
        ("drive.kind=real", "unknown variant `real`"),
        ("drive.external.answer_timeout_s=0", "drive.external.answer_timeout_s: 0 is out of range"),
        ("safety.drive_timeout_ms=1", "safety.drive_timeout_ms: 1 is out of range"),
    ] {
        let r = run("wrongdrive", &["--set", set]);
        assert_eq!(r.output.status.code(), Some(3), "{set}: {}", r.text());
        assert!(r.text().contains(message), "{set}: {}", r.text());
    }
}

#[test]
fn waiting_for_a_drive_that_never_comes_can_be_stopped() {
    for clock in ["lockstep", "realtime"] {
        let instance = Instance::new("nodrive");
        let mut child = vservo()
            .args(["run", "--clock", clock, "--instance", &instance.name, "--set", "drive.kind=external"])
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        wait_for_line(&mut child, "waiting for the external drive");
        kill(child.id() as i32, "INT");
        let output = child.wait_with_output().unwrap();
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(text.contains("outcome       stopped"), "{clock}: {text}");
        assert_eq!(output.status.code(), Some(6), "{clock}: {text}");
        instance.assert_gone();
    }
}

/// A wrist under a controller that is too stiff for late commands swings about its reference: it is told as that, and brought to rest.
#[test]
fn a_joint_that_swings_about_its_reference_is_a_fault() {
    let stiff = ["motion.natural_frequency_rad_s=120", "drive.simulated.command_delay_ticks=5"];
    let mut args = vec!["xarm7", "--clock", "lockstep", "--duration-s", "15"];
    stiff.iter().for_each(|value| args.extend(["--set", value]));
    let r = run("swing", &args);
    assert_eq!(r.summary["outcome"], "fault", "{}", r.text());
    assert!(r.summary["reason"].as_str().unwrap().contains("oscillates"), "{}", r.summary["reason"]);
    assert_eq!(r.summary["safety"]["state"], "fault", "it stands");
}
