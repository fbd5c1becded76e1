//! What the controller says about a stop, over its primary interface.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;

use common::{assert_at_rest, drive, robot, settings, started, wait_until};
use vservo_ur::emulator::Fault;
use vservo_ur::{Arm, Command, Payload, SafetyMode, Series};

/// The next words of the controller.
fn heard(arm: &mut Arm) -> String {
    let mut words = None;
    wait_until("the controller's words", || {
        words = arm.heard().map(|message| message.to_string());
        words.is_some()
    });
    words.unwrap()
}

#[test]
fn a_stop_is_told_with_the_controllers_number_and_words() {
    for series in [Series::ESeries, Series::Cb3] {
        let robot = robot(series, true);
        let mut arm = started(settings(&robot)).unwrap();
        let fast = |t: f64| Command::Velocity([4.0 * t.min(1.0), 0.0, 0.0, 0.0, 0.0, 0.0]);
        let error = drive(&mut arm, 5.0, fast).expect_err("too fast").to_string();
        assert!(error.contains("protective stop while the arm moved"), "{error}");
        assert_eq!(heard(&mut arm), "C153A0, a joint's speed is beyond its limit");
        assert_eq!(arm.heard(), None);
        arm.abandon();
        assert_at_rest(&robot);
    }
}

#[test]
fn a_program_that_cannot_go_on_is_told_with_its_line() {
    let robot = robot(Series::ESeries, true);
    let mut arm = Arm::connect(settings(&robot)).unwrap();
    arm.set_payload(Some(Payload { mass_kg: 900.0, com_m: [0.0; 3], inertia_kg_m2: None }));
    arm.make_ready(false, &|| false).unwrap();
    arm.start().expect_err("a refusal");
    let words = heard(&mut arm);
    assert!(words.starts_with("line ") && words.ends_with("no arm carries 900 kg"), "{words}");
}

/// What was said before a driver came is no news to it.
#[test]
fn older_messages_are_not_told() {
    let robot = robot(Series::ESeries, true);
    robot.inject(Fault::Stop(SafetyMode::ProtectiveStop));
    let mut arm = Arm::connect(settings(&robot)).unwrap();
    std::thread::sleep(std::time::Duration::from_millis(200));
    assert_eq!(arm.heard(), None);
}
