//! What goes to the robot, and when: other programs, the speed slider, and the instants of the robot's cycles.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;

use common::{Q, drive, robot, settings, started};
use std::time::Duration;
use vservo_ur::emulator::Fault;
use vservo_ur::{ArmSettings, Command, Series};

fn swing(t: f64) -> Command {
    Command::keep([0.4 * (1.0 - (-t / 0.1).exp()), 0.0, 0.0, 0.0, 0.0, 0.0])
}

/// What else moves the arm is not ended without a word: the controller knows one program at a time.
#[test]
fn an_arm_that_another_program_has_is_refused() {
    let robot = robot(Series::ESeries, true);
    // It goes on however busy the machine is.
    let second = Duration::from_secs(1);
    let patient = ArmSettings { watchdog: second, silence: second, ..settings(&robot) };
    let mut first = started(patient).unwrap();
    let others = ArmSettings { registers: 0, ..settings(&robot) };
    std::thread::scope(|scope| {
        let moves = scope.spawn(|| drive(&mut first, 6.0, swing));
        let words = started(others).expect_err("the arm of another").to_string();
        assert!(
            words.contains("another program has the arm") && words.contains("program: Playing"),
            "{words}"
        );
        moves.join().unwrap().unwrap();
    });
    first.come_to_rest().unwrap();
    // Free again.
    started(others).unwrap().come_to_rest().unwrap();
}

#[test]
fn a_slider_that_is_moved_is_told() {
    let robot = robot(Series::ESeries, true);
    let mut arm = started(settings(&robot)).unwrap();
    assert_eq!(arm.slider_notice(), None);
    for (share, words) in [(0.3, "stands at 30 % now"), (1.0, "stands at 100 % again")] {
        robot.inject(Fault::Slider(share));
        drive(&mut arm, 0.1, |_| Command::Hold).unwrap();
        let told = arm.slider_notice().unwrap();
        assert!(told.contains(words), "{told}");
        assert_eq!(arm.slider_notice(), None, "once");
    }
    arm.come_to_rest().unwrap();
}

/// The newest command is now one, now three ticks on from the one before: what goes to the robot is of the instants of its cycles.
#[test]
fn commands_are_carried_on_to_the_robots_cycle() {
    let robot = robot(Series::ESeries, true);
    let mut arm = started(settings(&robot)).unwrap();
    let begin = arm.last().unwrap().stamp;
    // A motion of at most 2 rad/s2, of which the instants of what is handed over jump by 3 ms to and fro.
    let course = |t: f64| (0.5 * (1.0 - (2.0 * t).cos()), (2.0 * t).sin(), 2.0 * (2.0 * t).cos());
    let (mut velocities, mut k) = (Vec::new(), 0);
    while velocities.len() < 700 {
        let Some(state) = arm.next(Duration::from_millis(50)).unwrap() else { continue };
        k += 1;
        let at = state.stamp - begin - [0, 3_000_000, 1_000_000, 2_000_000][k % 4];
        let (dq, qd, qdd) = course(at as f64 * 1e-9);
        let (mut q, mut v, mut a) = (Q, [0.0; 6], [0.0; 6]);
        (q[0], v[0], a[0]) = (Q[0] + dq, qd, qdd);
        arm.command(Command::Position { q, qd: v, qdd: a, at: Some(begin + at) }).unwrap();
        velocities.push((state.robot_s, state.qd[0]));
    }
    arm.come_to_rest().unwrap();
    let accelerations = velocities.windows(2).skip(100).map(|w| (w[1].1 - w[0].1) / (w[1].0 - w[0].0));
    // A command that a busy machine sends too late stands for two cycles.
    let beyond = accelerations.clone().filter(|a| a.abs() > 3.0).count();
    let most = accelerations.fold(0.0, |most: f64, a| most.max(a.abs()));
    assert!(beyond < 60, "{beyond} of 600 cycles beyond 3 rad/s2, {most} at most, of a motion with 2");
}
