//! What the controller says about a stop, over its primary interface.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;

use common::{assert_at_rest, clock, drive, robot, settings, started, wait_until};
use std::net::{SocketAddr, TcpStream};
use std::time::Duration;
use vservo_ur::emulator::Fault;
use vservo_ur::primary::{self, ListenerNotice};
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
        let fast = |t: f64| Command::keep([4.0 * t.min(1.0), 0.0, 0.0, 0.0, 0.0, 0.0]);
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

/// Whatever is newly told of the way to the controller's words.
fn notice(arm: &mut Arm) -> ListenerNotice {
    let mut notice = None;
    wait_until("a notice", || {
        notice = arm.notice();
        notice.is_some()
    });
    notice.unwrap()
}

/// A firewall drops what asks for a connection; so does this kernel, once as many as a listener lets wait are there.
#[test]
fn nobody_waits_for_an_interface_that_is_not_let_through() {
    let robot = robot(Series::ESeries, true);
    robot.inject(Fault::SilentPrimaryFor(f64::INFINITY));
    // One client may already be on its way through the emulator.
    std::thread::sleep(Duration::from_millis(50));
    let address = SocketAddr::new(robot.address(), primary::PORT);
    let waiting: Vec<TcpStream> =
        std::iter::from_fn(|| TcpStream::connect_timeout(&address, Duration::from_millis(300)).ok())
            .take(10_000)
            .collect();
    let mut settings = settings(&robot);
    settings.patience = Duration::from_secs(20);
    let begin = clock();
    let mut arm = Arm::connect(settings).unwrap();
    assert!(clock() - begin < 10_000_000_000, "{} ns, {} wait", clock() - begin, waiting.len());
    let words = notice(&mut arm).to_string();
    assert!(
        words.contains("30001: connection timed out") && words.contains("Let port 30001 through"),
        "{words}"
    );
    assert_eq!(arm.notice(), None);
    // The arm moves all the same.
    arm.make_ready(false, &|| false).unwrap();
    arm.start().unwrap();
    drive(&mut arm, 0.2, |_| Command::keep([0.1, 0.0, 0.0, 0.0, 0.0, 0.0])).unwrap();
    arm.come_to_rest().unwrap();
    assert_at_rest(&robot);
}

/// A kernel takes connections in that nobody serves.
#[test]
fn an_interface_that_says_nothing_is_told() {
    let robot = robot(Series::Cb3, true);
    robot.inject(Fault::SilentPrimaryFor(f64::INFINITY));
    let mut arm = started(settings(&robot)).unwrap();
    let words = notice(&mut arm).to_string();
    assert!(words.contains("cannot be heard"), "{words}");
    arm.come_to_rest().unwrap();
}

#[test]
fn a_silent_interface_is_told_and_tried_again() {
    let robot = robot(Series::ESeries, true);
    let mut arm = started(settings(&robot)).unwrap();
    robot.inject(Fault::SilentPrimaryFor(3.0));
    let words = notice(&mut arm).to_string();
    assert!(words.contains("cannot be heard"), "{words}");
    assert_eq!(notice(&mut arm), ListenerNotice::HearsAgain);
    robot.inject(Fault::Stop(SafetyMode::ProtectiveStop));
    assert_eq!(heard(&mut arm), "C9999A0, stopped by the emulator, as it was asked to");
    arm.abandon();
    assert_at_rest(&robot);
}
