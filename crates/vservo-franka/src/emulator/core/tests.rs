//! Errors of the emulated controller.

use super::*;
use crate::emulator::LaggingJoints;

const Q: Joints = [0.1, -0.5, 0.0, -2.1, 0.1, 1.8, 0.2];

fn core() -> Core {
    Core::new(Q, JointLimits::fr3(), Box::new(LaggingJoints::at(Q)), MISSED_CYCLES)
}

fn begin(core: &mut Core, generator: MoveGenerator) {
    let controller = match generator {
        MoveGenerator::None => MoveController::External,
        _ => MoveController::JointImpedance,
    };
    core.request(5, &Request::Move { controller, generator });
    assert_eq!(core.replies.pop(), Some((RequestKind::Move, 5, MoveStatus::MotionStarted as u8)));
}

#[test]
fn commands_beyond_limits_are_a_reflex_of_their_name() {
    type Change = fn(&mut RobotCommand);
    let cases: [(MoveGenerator, Change, RobotError); 6] = [
        (MoveGenerator::JointPosition, |c| c.q_c[0] += 1e-3, RobotError::VelocityDiscontinuity),
        (MoveGenerator::JointPosition, |c| c.q_c[0] += 8e-6, RobotError::AccelerationDiscontinuity),
        (MoveGenerator::JointVelocity, |c| c.dq_c[1] = 0.05, RobotError::VelocityDiscontinuity),
        (MoveGenerator::JointVelocity, |c| c.dq_c[1] = 0.008, RobotError::AccelerationDiscontinuity),
        (MoveGenerator::None, |c| c.tau_c[6] = 1.5, RobotError::TorqueDiscontinuity),
        (MoveGenerator::JointPosition, |c| c.q_c[5] = 9.0, RobotError::CommandedPositionLimits),
    ];
    for (generator, change, error) in cases {
        let mut core = core();
        begin(&mut core, generator);
        let mut command = RobotCommand { q_c: Q, ..RobotCommand::new(0) };
        core.step(Some(&command), true);
        assert_eq!(core.state.mode, RobotMode::Move);
        change(&mut command);
        core.step(Some(&command), true);
        assert_eq!(core.state.mode, RobotMode::Reflex, "{error:?}");
        assert_ne!(core.state.errors & error.bit(), 0, "{error:?}: {:?}", core.log);
        assert_eq!(core.replies, [(RequestKind::Move, 5, MoveStatus::ReflexAborted as u8)]);
    }
}

#[test]
fn twenty_missed_cycles_end_a_motion_and_nineteen_do_not() {
    let mut core = core();
    begin(&mut core, MoveGenerator::JointVelocity);
    for _ in 0..100 {
        core.step(None, true); // before the first command nothing is missed
    }
    let command = RobotCommand::new(0);
    core.step(Some(&command), true);
    for _ in 0..19 {
        core.step(None, true);
    }
    core.step(Some(&command), true);
    assert_eq!(core.state.mode, RobotMode::Move);
    for _ in 0..19 {
        core.step(None, true);
    }
    assert_eq!(core.state.mode, RobotMode::Move);
    // Two commands and 38 cycles without.
    assert!((core.state.success_rate - 0.02).abs() < 1e-9, "{}", core.state.success_rate);
    core.step(None, true);
    assert_eq!(core.state.mode, RobotMode::Reflex);
    assert_eq!(core.state.errors, RobotError::Communication.bit());
}
