//! A cycle allocates nothing.

#![allow(clippy::unwrap_used)]

mod common;

use assert_no_alloc::{AllocDisabler, assert_no_alloc};
use common::{Q, robot, settings, started};
use std::time::Duration;
use vservo_franka::{Command, CommandKind};

#[global_allocator]
static ALLOCATOR: AllocDisabler = AllocDisabler;

#[test]
fn a_cycle_allocates_nothing() {
    for kind in [CommandKind::Position, CommandKind::Velocity, CommandKind::Torque] {
        let robot = robot();
        let mut arm = started(settings(&robot), kind).unwrap();
        let commands = [
            Command::Hold,
            Command::stand_at(Q),
            Command::keep([0.1; 7]),
            Command::Torque([0.5; 7]),
            Command::keep([f64::NAN; 7]),
        ];
        for k in 0..200 {
            let command = commands[k / 8 % commands.len()];
            assert_no_alloc(|| {
                if arm.next(Duration::from_millis(20)).unwrap().is_some() {
                    arm.command(command).unwrap();
                }
            });
        }
        arm.come_to_rest().unwrap();
    }
}
