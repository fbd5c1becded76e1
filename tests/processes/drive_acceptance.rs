//! What a run over a robot's wire must be as good as: the arm's least time, the accuracy of a simulated arm, and a lag that is handed over whatever it is.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, non_snake_case)] // what is skipped is told

use crate::common::{Run, assert_accurate, number, was_held_up};
use crate::{drive_franka, drive_ur};
use nalgebra::SVector;
use vservo::config::Config;
use vservo::config::assemble::{motion_limits, q_start};
use vservo::motion::min_time_s;
use vservo::robot::Robot;
use vservo_ur::Series;

/// Runs that are begun before a machine counts as too busy.
const RUNS: usize = 6;
/// Settling time over the least time in which joints within these limits get from the start to the end.
const MOST: f64 = 1.6;
/// Distance of the true camera from its goal, m. A simulated arm ends 0.020 mm off its goal here, which is what the points of the drawn target are off by; noise of a measurement is twice that.
const MOST_OFF_M: f64 = 0.03e-3;

/// Whether this machine kept a run waiting, so that its time tells nothing: the loop slept too long, left ticks out, or states of the robot came late again and again.
fn is_delayed(run: &Run) -> bool {
    let s = &run.summary;
    let of = |key: &str| s[key].as_f64().unwrap_or(0.0);
    s["tick_us"]["wake"]["max"].as_f64().is_some_and(|us| us > 3e3)
        || of("skipped_ticks") > 5.0
        || of("late_drive_states") > 20.0
}

/// That one of the runs settles within its time, by its own clock, and that each ends where it should. `goes` gives a run and where the joints are after it. A run that this machine has
/// held up, so that ticks are missing or a state came late, is begun again; the machine must let one of them run.
fn is_as_good<const N: usize>(file: &str, goes: impl Fn() -> (Run, [f64; N])) {
    let config = Config::load(Some(file.as_ref()), &[]).unwrap();
    let robot: Robot<N> = config.robot.build().unwrap();
    let (limits, start) = (motion_limits(&config, &robot).unwrap(), q_start::<N>(&config).unwrap());
    let mut told = Vec::new();
    for _ in 0..RUNS {
        let (run, end) = goes();
        if run.summary["outcome"] == "fault" && was_held_up(&run.summary) {
            told.push("a fault".into());
            continue;
        }
        assert_accurate(&run);
        let end = SVector::from(end);
        let X_CO = config.camera.mount.X_WC(&robot, &end).inv_mul(&config.X_WO().unwrap());
        let desired = config.set_point.X_DO().unwrap();
        let off_m = (desired * X_CO.inverse()).translation.vector.norm();
        assert!(off_m < MOST_OFF_M, "{file}: {off_m} m off, as the joints tell\n{}", run.text());
        let settling_s = number(&run.summary, &["settling_time_s"]);
        let times = settling_s / min_time_s(&limits, &start, &end);
        if times <= MOST {
            println!("{file}: {times:.2} times the least time, {:.4} mm off", off_m * 1e3);
            return;
        }
        assert!(is_delayed(&run), "{file}: {times:.2} times the least time\n{}", run.text());
        told.push(format!("{times:.2}"));
    }
    println!("skipped: this machine has held up each run of {file} ({})", told.join(", "));
}

#[test]
fn a_ur_settles_within_its_time_and_as_exactly_as_simulated() {
    for mode in ["position", "velocity"] {
        let mode = format!("drive.mode={mode}");
        is_as_good("ur5e-emulated", || {
            let robot = drive_ur::robot(Series::ESeries);
            let run = drive_ur::run_with("uraccept", &robot, &["--set", &mode]);
            (run, robot.arm().0)
        });
    }
}

#[test]
fn a_franka_settles_in_time_and_as_exactly_as_simulated() {
    for mode in ["position", "velocity"] {
        let mode = format!("drive.mode={mode}");
        is_as_good("fr3-emulated", || {
            let robot = drive_franka::robot();
            let run = drive_franka::run_with("fraccept", &robot, &["--set", &mode]);
            (run, robot.arm().0)
        });
    }
}

/// The lag follows the driver's options: control looks as far ahead as the driver tells, and says what the run file says otherwise.
#[test]
fn a_lag_is_handed_over_by_the_driver() {
    let slow = ["--lookahead-s", "0.1", "--gain", "300"];
    let of = |set: &[&str]| {
        let robot = drive_ur::robot(Series::ESeries);
        let command = drive_ur::command(robot.address(), &slow);
        let run = crate::common::run(
            "urlag",
            &[&["config/ur5e-emulated.toml", "--set", &command], &drive_ur::PATIENT[..], set].concat(),
        );
        assert_accurate(&run);
        run
    };
    let r = of(&[]);
    assert!(
        r.text().contains("the drive's arm is 131 ms behind its commands: laws look so far ahead"),
        "{}",
        r.text()
    );
    assert!(
        r.text().contains("for the drive's lag a joint may be 0.52 rad or m from its reference"),
        "{}",
        r.text()
    );
    let told_s = number(&r.summary, &["settling_time_s"]);
    let r = of(&["--set", "servo.lead_ms=38"]);
    assert!(
        r.text().contains("131 ms behind its commands, and servo.lead_ms = 38 of the run file"),
        "{}",
        r.text()
    );
    let other_s = number(&r.summary, &["settling_time_s"]);
    assert!(told_s < other_s + 0.3, "{told_s} s with the lag that is told, {other_s} s with another");
}
