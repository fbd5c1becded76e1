//! The driver against the emulator: it moves, it rests, and it ends in words whatever goes wrong.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;

use common::{Q, assert_at_rest, clock, drive, robot, settings, started, wait_until};
use std::time::Duration;
use vservo_ur::arm::Recovered;
use vservo_ur::emulator::Fault;
use vservo_ur::{Arm, Command, Payload, RobotMode, RuntimeState, SafetyMode, Series, UrError};

fn swing(t: f64) -> Command {
    let mut qd = [0.0; 6];
    qd[0] = 0.4 * (1.0 - (-t / 0.1).exp());
    Command::keep(qd)
}

#[test]
fn velocities_move_the_arm_and_it_rests() {
    for series in [Series::ESeries, Series::Cb3] {
        let robot = robot(series, true);
        let mut arm = started(settings(&robot)).unwrap();
        assert_eq!(arm.series(), series);
        drive(&mut arm, 1.0, swing).unwrap();
        let (q, qd) = robot.arm();
        // 0.4 rad/s for a second, less the time constant of the start, and the cycles of the way.
        assert!((q[0] - Q[0] - 0.4 * 0.9).abs() < 0.05, "{series:?}: {}", q[0] - Q[0]);
        assert!((qd[0] - 0.4).abs() < 1e-3, "{}", qd[0]);
        arm.come_to_rest().unwrap();
        assert_at_rest(&robot);
        assert_eq!(robot.modes(), (RobotMode::Running, SafetyMode::Normal, RuntimeState::Stopped));
        assert_eq!(robot.log(), [""; 0]);
    }
}

/// Behind a slow motion the arm stays by the stated lag of `servoj`, and a cycle or two of the way.
#[test]
fn positions_are_followed_with_the_stated_lag() {
    let robot = robot(Series::ESeries, true);
    let mut arm = started(settings(&robot)).unwrap();
    let goal = |t: f64| {
        let mut q = Q;
        q[1] += 0.2 * (1.0 - (std::f64::consts::PI * t / 2.0).cos()) / 2.0;
        q
    };
    let begin = arm.last().unwrap().robot_s;
    let (mut sum, mut weight) = (0.0, 0.0);
    drive(&mut arm, 1.9, |t| Command::stand_at(goal(t))).unwrap();
    // The lag as the time by which what is measured fits what was commanded, over the way back.
    let turn = arm.last().unwrap().robot_s - begin;
    let until = turn + 1.9;
    while let Some(s) = arm.next(Duration::from_millis(50)).unwrap() {
        let t = s.robot_s - begin;
        if t > until {
            break;
        }
        let speed = (goal(t + 1e-4)[1] - goal(t - 1e-4)[1]) / 2e-4;
        sum += speed * (goal(t)[1] - s.q[1]);
        weight += speed * speed;
        arm.command(Command::stand_at(goal(t))).unwrap();
    }
    let lag_s = sum / weight;
    assert!((0.030..0.050).contains(&lag_s), "{lag_s} s");
    arm.come_to_rest().unwrap();
    assert_at_rest(&robot);
}

#[test]
fn an_arm_without_power_is_enabled_only_where_that_is_allowed() {
    let robot = robot(Series::ESeries, false);
    let mut arm = Arm::connect(settings(&robot)).unwrap();
    let words = arm.make_ready(false, &|| false).unwrap_err().to_string();
    assert!(words.contains("powered off") && words.contains("--enable"), "{words}");
    assert_eq!(robot.modes().0, RobotMode::PowerOff);
    assert!(arm.make_ready(true, &|| false).unwrap());
    assert_eq!(robot.modes().0, RobotMode::Running);
    arm.start().unwrap();
    drive(&mut arm, 0.2, swing).unwrap();
    arm.come_to_rest().unwrap();
    assert_at_rest(&robot);
}

#[test]
fn a_stop_ends_the_wait_for_power_and_leaves_brakes_closed() {
    let robot = robot(Series::ESeries, false);
    let mut arm = Arm::connect(settings(&robot)).unwrap();
    // Asked for while the motors get power.
    let stop = || robot.modes().0 != RobotMode::PowerOff;
    assert!(!arm.make_ready(true, &stop).unwrap());
    std::thread::sleep(Duration::from_millis(500));
    assert!(matches!(robot.modes().0, RobotMode::PowerOn | RobotMode::Idle), "{:?}", robot.modes());
}

/// Registers of an earlier driver move nothing, and one that is killed leaves an arm that stops by itself.
#[test]
fn a_driver_that_dies_leaves_an_arm_at_rest() {
    let robot = robot(Series::ESeries, true);
    let mut arm = started(settings(&robot)).unwrap();
    drive(&mut arm, 0.5, swing).unwrap();
    drop(arm);
    assert_at_rest(&robot);
    let (q, _) = robot.arm();
    // 0.4 rad/s for the watchdog's 0.1 s, and the way of braking: v^2/2a; and what a busy machine adds.
    assert!(q[0] - Q[0] < 0.4 * 0.4 + 0.4 * (0.1 + 0.4 / 8.0) + 0.1, "{}", q[0] - Q[0]);
    let arm = started(settings(&robot)).unwrap();
    std::thread::sleep(Duration::from_millis(300));
    assert_eq!(robot.arm().0, q);
    drop(arm);
    assert_at_rest(&robot);
}

/// What goes wrong while the arm moves, the words it ends in, and how the arm is left.
#[test]
fn every_fault_in_motion_ends_at_rest_and_in_words() {
    let faults = [
        (Fault::Stop(SafetyMode::ProtectiveStop), "protective stop while the arm moved"),
        (Fault::Stop(SafetyMode::RobotEmergencyStop), "emergency stop of the robot while the arm moved"),
        (Fault::Stop(SafetyMode::SafeguardStop), "safeguard stop"),
        (Fault::PowerOff, "no longer running (the robot is powered off)"),
        (Fault::Reboot, "has closed the connection"),
        (Fault::ResetConnections, "has closed the connection"),
        (Fault::Mute, "no state came from the robot for"),
        (Fault::LateBy(0.5), "no state came from the robot for"),
        (Fault::Deaf, "it missed commands"),
        (Fault::StaleStamps, "repeats an old one"),
        (Fault::CutPackage, "does not speak RTDE"),
        (Fault::UnknownType, "unknown type"),
        (Fault::NotANumber, "not finite"),
        (Fault::JumpingJoint, "joint 1 from"),
        (Fault::StopProgram, "somebody has stopped it"),
        (Fault::PauseProgram, "paused it on the pendant"),
    ];
    for (fault, expected) in faults {
        let robot = robot(Series::ESeries, true);
        let mut arm = started(settings(&robot)).unwrap();
        drive(&mut arm, 0.4, swing).unwrap();
        assert!(robot.arm().1[0] > 0.3, "{fault:?}: the arm moves");
        robot.inject(fault);
        let error = drive(&mut arm, 5.0, swing).expect_err("a fault");
        let words = error.to_string();
        // A package that is cut takes the next one's begin into it: whatever that looks like, it is no state.
        let cut = fault == Fault::CutPackage;
        assert!(words.contains(expected) || cut && ends_a_cut(&error), "{fault:?}: {words}");
        arm.abandon();
        drop(arm);
        assert_at_rest(&robot);
        assert!(robot.arm().0.iter().all(|q| q.is_finite()));
    }
}

fn ends_a_cut(error: &UrError) -> bool {
    !matches!(error, UrError::Connect { .. })
}

/// What is wrong from the beginning: nothing moves, and the words say what to do.
#[test]
fn every_fault_before_the_start_is_refused_in_words() {
    let faults = [
        (Fault::Stop(SafetyMode::ProtectiveStop), "unlock the robot on the pendant"),
        (Fault::Stop(SafetyMode::RobotEmergencyStop), "emergency stop of the robot"),
        (Fault::PowerOff, "release its brakes on the pendant"),
        (Fault::RefusePrograms, "the program did not start within"),
        (Fault::WrongProtocol, "refuses the RTDE protocol version 2"),
        (Fault::OldSoftware, "is too old for this driver: it needs 3.9"),
        (Fault::RegistersInUse, "another program writes input_int_register_24"),
        (Fault::UnknownVariables, "does not know timestamp"),
        (Fault::SilentSetup, "does not answer within 3.0 s (what it will send)"),
        (Fault::LocalControl, "choose remote control on the pendant"),
        (Fault::SilentDashboard, "dashboard server at"),
        (Fault::Slider(0.5), "the speed slider of the pendant stands at 50 %"),
        (Fault::Mute, "does not start to send states"),
    ];
    for (fault, expected) in faults {
        let robot = robot(Series::ESeries, true);
        robot.inject(fault);
        let words = started(settings(&robot)).expect_err("a fault").to_string();
        assert!(words.contains(expected), "{fault:?}: {words}");
        assert_at_rest(&robot);
        assert_eq!(robot.arm().0, Q, "{fault:?}");
    }
}

/// Packages in pieces, and states that are lost, are no faults: the latter are counted.
#[test]
fn pieces_are_put_together_and_gaps_are_counted() {
    for fault in [Fault::HalfPackages, Fault::ByteByByte, Fault::LoseStates] {
        let robot = robot(Series::Cb3, true);
        robot.inject(fault);
        let mut arm = started(settings(&robot)).unwrap();
        let before = arm.missed().0;
        drive(&mut arm, 0.8, swing).unwrap();
        let missed = arm.missed().0 - before;
        arm.come_to_rest().unwrap();
        assert_at_rest(&robot);
        // 100 cycles, of which two of three are lost.
        match fault {
            Fault::LoseStates => assert!((60..=70).contains(&missed), "{missed}"),
            _ => assert_eq!(missed, 0, "{fault:?}"),
        }
    }
}

#[test]
fn a_protective_stop_is_unlocked_by_hand_after_its_time() {
    let robot = robot(Series::ESeries, true);
    robot.inject(Fault::Stop(SafetyMode::ProtectiveStop));
    let mut dashboard =
        vservo_ur::dashboard::Dashboard::connect(robot.address(), Duration::from_secs(3), clock).unwrap();
    assert_eq!(dashboard.safety_status().unwrap(), "PROTECTIVE_STOP");
    let words = dashboard.unlock_protective_stop().unwrap_err().to_string();
    assert!(words.contains("until 5s after"), "{words}");
    wait_until("the unlocking", || dashboard.unlock_protective_stop().is_ok());
    let mut arm = started(settings(&robot)).unwrap();
    drive(&mut arm, 0.2, swing).unwrap();
    arm.come_to_rest().unwrap();
    assert!(dashboard.version().unwrap().starts_with("5.26"));
    assert!(dashboard.program_state().unwrap().starts_with("STOPPED"));
}

/// Two drivers: the second finds the registers in use, and the first goes on.
#[test]
fn a_second_driver_is_refused() {
    let robot = robot(Series::ESeries, true);
    let mut arm = started(settings(&robot)).unwrap();
    let words = Arm::connect(settings(&robot)).expect_err("in use").to_string();
    assert!(words.contains("another program writes"), "{words}");
    drive(&mut arm, 0.2, swing).unwrap();
    arm.come_to_rest().unwrap();
    drop(arm);
    wait_until("registers that are free again", || started(settings(&robot)).is_ok());
}

/// A command of numbers that are none moves nothing; a jump, as of commands that were late, is approached at the speed of a joint.
#[test]
fn commands_that_are_none_or_jump_do_not_stop_the_arm() {
    let robot = robot(Series::ESeries, true);
    let mut arm = started(settings(&robot)).unwrap();
    drive(&mut arm, 0.2, |_| Command::keep([f64::NAN; 6])).unwrap();
    drive(&mut arm, 0.2, |_| Command::stand_at([f64::NAN; 6])).unwrap();
    assert_eq!(robot.arm().0, Q);
    let mut far = Q;
    far[0] += 0.4;
    far[3] -= 0.1;
    drive(&mut arm, 1.0, |_| Command::stand_at(far)).unwrap();
    let off = robot.arm().0.iter().zip(&far).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(off < 1e-3, "{off} rad");
    assert_eq!(robot.modes().1, SafetyMode::Normal, "{:?}", robot.log());
    arm.come_to_rest().unwrap();
    assert_at_rest(&robot);
}

/// A network that stands still while the arm moves, for less than the watchdog's time, and then brings what is newest: the robot neither sees a leap nor stops.
#[test]
fn a_network_that_stands_still_makes_no_leap() {
    let robot = robot(Series::ESeries, true);
    let mut arm = started(settings(&robot)).unwrap();
    let goal = |t: f64| {
        let mut q = Q;
        q[0] += 1.8 * (t - 0.3 * (1.0 - (-t / 0.3).exp()));
        q[5] -= 2.0 * (t - 0.3 * (1.0 - (-t / 0.3).exp()));
        Command::stand_at(q)
    };
    let mut stalls = [0.8, 1.1].into_iter().peekable();
    drive(&mut arm, 1.5, |t| {
        if stalls.next_if(|at| t > *at).is_some() {
            robot.inject(Fault::DeafFor(0.08));
        }
        goal(t)
    })
    .unwrap();
    assert_eq!(robot.modes().1, SafetyMode::Normal, "{:?}", robot.log());
    assert!(stalls.next().is_none());
    arm.come_to_rest().unwrap();
    assert_at_rest(&robot);
}

/// Programs that are wrong are told with their line, and move nothing: the interpreter runs what is sent, not what is meant.
#[test]
fn a_program_is_run_as_it_is_written() {
    use std::io::Write;
    let robot = robot(Series::ESeries, true);
    let send = |text: &str| {
        let address = (robot.address(), vservo_ur::program::PORT);
        std::net::TcpStream::connect(address).unwrap().write_all(text.as_bytes()).unwrap();
    };
    let told = |words: &str| {
        let mut log = Vec::new();
        wait_until(words, || {
            log.extend(robot.log());
            log.iter().any(|line| line.contains(words))
        });
    };
    send("def f():\n  speedj([1, 0, 0], 1)\nend\n");
    told("line 2: `qd` must be a list of 6 numbers");
    send("def f():\n  servoj([0, 0, 0, 0, 0, 0], 0, 0, 0.002, 0.01, 300)\nend\n");
    told("servoj takes a lookahead of 0.03 to 0.2 s");
    send("def f():\n  while True:\n    x = 1\n  end\nend\n");
    told("a loop without an end");
    send("def f(:\nend\n");
    told("a program was sent that is none: line 1");
    send("def f():\n  movel(1)\nend\n");
    told("`movel` is not emulated");
    assert_eq!(robot.arm().0, Q);
    // 0.3 rad/s for 0.2 s after 0.1 s of acceleration, by a function of its own, then a stop at 3 rad/s2.
    send(
        "def f():\n  def go(v, t):\n    local qd = [0, 0, 0, 0, 0, 0]\n    qd[5] = v\n    speedj(qd, a=3, t=t)\n    return v\n  end\n  \
         n = 0\n  while n < 10:\n    n = n + go(0.3, 0.03) / 0.3\n  end\n  stopj(3)\n  textmsg(\"done\")\nend\n",
    );
    told("done");
    let turned = robot.arm().0[5] - Q[5];
    assert!((turned - 0.3 * (0.3 - 0.05 + 0.05)).abs() < 0.01, "{turned}");
    assert_at_rest(&robot);
}

/// What hangs on the flange is told before the arm moves, with its inertia where the controller's software takes that, and once more with each program.
#[test]
fn a_payload_is_told_as_the_controller_takes_it() {
    let inertia = [2e-3, 3e-3, 1e-3, 1e-4, -2e-4, 0.0];
    let carried = Payload { mass_kg: 1.25, com_m: [0.01, -0.02, 0.065], inertia_kg_m2: Some(inertia) };
    for (series, told) in
        [(Series::ESeries, carried), (Series::Cb3, Payload { inertia_kg_m2: None, ..carried })]
    {
        let untold = robot(series, true);
        let before = untold.payload();
        started(settings(&untold)).unwrap().come_to_rest().unwrap();
        assert_eq!(untold.payload(), before, "who says nothing leaves it as it is set");
        let robot = robot(series, true);
        let mut set = settings(&robot);
        set.payload = Some(carried);
        let mut arm = started(set).unwrap();
        assert_eq!(robot.payload(), told);
        drive(&mut arm, 0.3, swing).unwrap();
        arm.come_to_rest().unwrap();
        arm.set_payload(Some(Payload { inertia_kg_m2: None, ..carried }));
        arm.start().unwrap();
        assert_eq!(
            robot.payload(),
            Payload { inertia_kg_m2: None, ..carried },
            "the next program tells the next one"
        );
        arm.come_to_rest().unwrap();
        assert_at_rest(&robot);
    }
}

#[test]
fn a_payload_that_no_arm_carries_keeps_it_from_moving() {
    let robot = robot(Series::ESeries, true);
    let mut set = settings(&robot);
    set.payload = Some(Payload { mass_kg: 900.0, com_m: [0.0; 3], inertia_kg_m2: None });
    let words = started(set).expect_err("a refusal").to_string();
    assert!(words.contains("the program did not start"), "{words}");
    let log = robot.log();
    assert!(log.iter().any(|line| line.contains("no arm carries 900 kg")), "{log:?}");
    assert_at_rest(&robot);
}

/// An emulated robot is for its machine alone.
#[test]
fn the_emulator_listens_on_loopback_addresses_alone() {
    use vservo_ur::emulator::{Emulator, EmulatorSettings, StiffJoints};
    for address in ["0.0.0.0", "192.168.1.5", "::"] {
        let joints = Box::new(StiffJoints::default());
        let settings = EmulatorSettings {
            address: address.parse().unwrap(),
            series: Series::Cb3,
            q: Q,
            running: true,
            joints,
        };
        let refused = Emulator::start(settings).err().expect("a refusal");
        assert!(refused.to_string().contains("no loopback address"), "{refused}");
    }
}

/// Takes states and recovers with them for so long, s, or until it is ready or fails.
fn recover(arm: &mut Arm, asked: bool, for_s: f64) -> Result<Recovered, UrError> {
    let until = clock() + (for_s * 1e9) as i64;
    while clock() < until {
        if arm.next(Duration::from_millis(20))?.is_some() && arm.recover(asked)? == Recovered::Ready {
            return Ok(Recovered::Ready);
        }
    }
    Ok(Recovered::Not)
}

/// In motion, until the robot stops.
fn halted(arm: &mut Arm, robot: &vservo_ur::emulator::Emulator, fault: Fault) -> UrError {
    drive(arm, 0.4, swing).unwrap();
    robot.inject(fault);
    let error = drive(arm, 5.0, swing).expect_err("a fault");
    assert!(error.is_of_the_robot(), "{error}");
    arm.halt();
    error
}

#[test]
fn a_protective_stop_is_unlocked_when_that_is_asked_for() {
    let robot = robot(Series::ESeries, true);
    let mut arm = started(settings(&robot)).unwrap();
    halted(&mut arm, &robot, Fault::Stop(SafetyMode::ProtectiveStop));
    assert!(arm.is_halted());
    assert_at_rest(&robot);
    let q = robot.arm().0;
    // Nobody has asked, however long ago it was.
    assert_eq!(recover(&mut arm, false, 6.0).unwrap(), Recovered::Not);
    assert_eq!((robot.modes().1, robot.arm().0), (SafetyMode::ProtectiveStop, q));
    assert_eq!(recover(&mut arm, true, 15.0).unwrap(), Recovered::Ready);
    assert!(!arm.is_halted());
    assert_eq!(robot.modes(), (RobotMode::Running, SafetyMode::Normal, RuntimeState::Playing));
    assert_eq!(robot.arm().0, q, "it is held");
    drive(&mut arm, 0.5, swing).unwrap();
    assert!(robot.arm().0[0] > q[0] + 0.05, "and obeys again");
    // Another one has five seconds of its own.
    halted(&mut arm, &robot, Fault::Stop(SafetyMode::ProtectiveStop));
    let begin = clock();
    assert_eq!(recover(&mut arm, true, 15.0).unwrap(), Recovered::Ready);
    assert!(clock() - begin > 4_900_000_000, "the maker's five seconds");
    arm.come_to_rest().unwrap();
    assert_at_rest(&robot);
    assert_eq!(robot.log(), [""; 0]);
}

#[test]
fn what_was_stopped_on_the_pendant_starts_again_when_asked() {
    for fault in [Fault::StopProgram, Fault::PauseProgram] {
        let robot = robot(Series::Cb3, true);
        let mut arm = started(settings(&robot)).unwrap();
        halted(&mut arm, &robot, fault);
        assert_eq!(recover(&mut arm, false, 0.5).unwrap(), Recovered::Not);
        assert_eq!(recover(&mut arm, true, 10.0).unwrap(), Recovered::Ready, "{fault:?}");
        arm.come_to_rest().unwrap();
        assert_at_rest(&robot);
    }
}

#[test]
fn emergency_stops_and_lost_power_are_not_cleared() {
    for fault in [Fault::Stop(SafetyMode::RobotEmergencyStop), Fault::PowerOff] {
        let robot = robot(Series::ESeries, true);
        let mut arm = started(settings(&robot)).unwrap();
        halted(&mut arm, &robot, fault);
        assert_eq!(recover(&mut arm, true, 6.0).unwrap(), Recovered::Not, "{fault:?}");
        assert_eq!(robot.modes().0, RobotMode::PowerOff, "{fault:?}");
        arm.abandon();
        assert_at_rest(&robot);
    }
}

#[test]
fn a_robot_that_refuses_to_come_back_says_why_once() {
    let robot = robot(Series::ESeries, true);
    let mut arm = started(settings(&robot)).unwrap();
    halted(&mut arm, &robot, Fault::StopProgram);
    robot.inject(Fault::LocalControl);
    let error = recover(&mut arm, true, 10.0).expect_err("local control");
    assert!(error.to_string().contains("choose remote control on the pendant"), "{error}");
    assert_eq!(recover(&mut arm, true, 0.5).unwrap(), Recovered::Not, "told once");
    assert_eq!(recover(&mut arm, false, 0.2).unwrap(), Recovered::Not);
    assert!(recover(&mut arm, true, 10.0).is_err(), "tried again when it is asked for again");
}

#[test]
fn a_stop_that_follows_an_unlocking_is_not_unlocked_too() {
    let robot = robot(Series::ESeries, true);
    let mut arm = started(settings(&robot)).unwrap();
    halted(&mut arm, &robot, Fault::Stop(SafetyMode::ProtectiveStop));
    let until = clock() + 20_000_000_000;
    while robot.modes().1 == SafetyMode::ProtectiveStop {
        assert!(clock() < until, "it is never unlocked");
        assert_eq!(recover(&mut arm, true, 0.02).unwrap(), Recovered::Not);
    }
    // What made it stop is still there.
    robot.inject(Fault::Stop(SafetyMode::ProtectiveStop));
    let words = recover(&mut arm, true, 20.0).expect_err("no way on").to_string();
    assert!(words.contains("protective stop"), "{words}");
    assert_eq!(recover(&mut arm, true, 6.0).unwrap(), Recovered::Not);
    assert_eq!(robot.modes().1, SafetyMode::ProtectiveStop);
}
