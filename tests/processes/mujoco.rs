//! UR5 and Panda in MuJoCo behind the external drive. Runs where the Python of `VSERVO_PYTHON` (else `python3`) has the
//! packages; says `skipped` where it has not, or fails if `VSERVO_REQUIRE_MUJOCO` is set.

#![allow(clippy::unwrap_used, clippy::print_stdout)] // a skipped test says so

use crate::common::{Instance, Run, assert_accurate, run};
use crate::drive_check::{checked, rules};
use std::path::{Path, PathBuf};
use std::process::Command;

/// The Python that has the packages.
fn python() -> Option<PathBuf> {
    let python = std::env::var_os("VSERVO_PYTHON").map_or_else(|| PathBuf::from("python3"), PathBuf::from);
    let output = Command::new(&python).args(["-c", "import mujoco, numpy, iceoryx2"]).output();
    if output.as_ref().is_ok_and(|o| o.status.success()) {
        return Some(python);
    }
    let why = output.map_or_else(|e| e.to_string(), |o| String::from_utf8_lossy(&o.stderr).into_owned());
    let why = why.lines().last().unwrap_or("no answer").to_string();
    assert!(std::env::var_os("VSERVO_REQUIRE_MUJOCO").is_none(), "{}: {why}", python.display());
    println!("skipped: {} has no mujoco, numpy and iceoryx2 ({why})", python.display());
    None
}

/// The shipped run file, with that Python and further arguments of the drive.
fn mujoco(python: &Path, arm: &str, drive: &[&str], extra: &[&str]) -> Run {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let file = root.join(format!("config/{arm}-mujoco.toml"));
    let config = vservo::config::Config::load(Some(&file), &[]).unwrap();
    let mut command = config.drive.external.command;
    assert_eq!(command[0], "python3");
    command[0] = python.to_str().unwrap().into();
    command.extend(drive.iter().map(|a| (*a).to_string()));
    let set = format!("drive.external.command={command:?}");
    run("mujoco", &[&[file.to_str().unwrap(), "--set", &set], extra].concat())
}

const LOCKSTEP: [&str; 2] = ["--clock", "lockstep"];

#[test]
fn both_arms_converge_under_load_and_repeat_bit_by_bit() {
    let Some(python) = python() else { return };
    for arm in ["ur5", "panda"] {
        let mut hashes = Vec::new();
        for drive in [&[][..], &["--payload-kg", "1"][..]] {
            let (a, b) = (mujoco(&python, arm, drive, &LOCKSTEP), mujoco(&python, arm, drive, &LOCKSTEP));
            assert_accurate(&a);
            assert_eq!(a.summary["state_hash"], b.summary["state_hash"], "{arm} {drive:?}");
            assert!(a.text().contains("external drive connected"), "{}", a.text());
            hashes.push(a.summary["state_hash"].clone());
        }
        assert_ne!(hashes[0], hashes[1], "{arm}: the load is felt");
    }
}

/// A robot that holds its weight by itself gets torques without it: the same motion, but for rounding, where the robot's model is that of the run file.
#[test]
fn an_arm_that_holds_its_weight_gets_the_rest() {
    let Some(python) = python() else { return };
    let contains = |what: &str| {
        let set = format!("drive.torque_contains={what}");
        mujoco(&python, "ur5", &[], &[&LOCKSTEP[..], &["--set", &set]].concat())
    };
    let (whole, rest) = (contains("[\"gravity\", \"friction\"]"), contains("[\"friction\"]"));
    assert_accurate(&rest);
    let settled = |run: &Run| crate::common::number(&run.summary, &["settling_time_s"]);
    assert!((settled(&whole) - settled(&rest)).abs() < 0.02, "{} {}", settled(&whole), settled(&rest));
}

#[test]
fn mujoco_and_the_built_in_arm_agree() {
    let Some(python) = python() else { return };
    for arm in ["ur5", "panda"] {
        let outside = mujoco(&python, arm, &[], &LOCKSTEP).summary;
        let inside = mujoco(&python, arm, &[], &[&LOCKSTEP[..], &["--set", "drive.kind=simulated"]].concat());
        // Two integrators of the same equations: the runs end at the same tick with the same errors.
        assert_eq!(outside["ticks"], inside.summary["ticks"], "{arm}");
        for key in ["feature_error_px", "position_error_m", "orientation_error_rad"] {
            let [a, b] = [&outside, &inside.summary].map(|s| s["final"][key].as_f64().unwrap());
            assert!((a - b).abs() <= 0.01 * b, "{arm} {key}: {a} {b}");
        }
    }
}

#[test]
fn in_real_time_it_converges_too() {
    let Some(python) = python() else { return };
    assert_accurate(&mujoco(&python, "ur5", &[], &["--set", "safety.drive_timeout_ms=1000"]));
}

/// In mode torque `vservo drive check` only holds the arm.
#[test]
fn the_drive_in_python_tells_its_properties() {
    let Some(python) = python() else { return };
    let program =
        ["--", python.to_str().unwrap(), "examples/mujoco/mujoco_drive.py", "config/robot/ur5.urdf"];
    let arguments = [&["config/ur5-mujoco.toml", "--no-motion"], &program[..]].concat();
    let (output, answer) = checked(&Instance::new("mujococheck"), &arguments);
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    let properties = answer["rules"].as_array().unwrap().iter().find(|r| r["rule"] == "properties").unwrap();
    assert_eq!(properties["measured"], "period_ms 1, lag_ms 0, watchdog_ms 100", "{answer:#}\n{told}");
    assert!(rules(&answer, "ok").contains(&"properties".to_owned()), "{answer:#}\n{told}");
}
