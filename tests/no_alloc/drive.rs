//! The drives allocate neither when they are read nor when they are written.

#![allow(clippy::unwrap_used)]

use assert_no_alloc::assert_no_alloc;
use nalgebra::SVector;
use vservo::drive::{
    CommandMode, Drive, DriveCommand, DriveLink, EncoderModel, ExternalDrive, IdealDrive, SimulatedDrive,
    SimulatedDriveSettings,
};
use vservo::messages::{DriveCommandMsg, DriveStateMsg};
use vservo::time::{MonoNs, SpanNs};

struct Echo(DriveStateMsg);

impl DriveLink for Echo {
    fn receive(&mut self) -> Option<DriveStateMsg> {
        (self.0.tick == 0).then(|| {
            self.0.tick = 1;
            self.0
        })
    }

    fn send(&mut self, command: &DriveCommandMsg) {
        self.0 = DriveStateMsg {
            stamp: command.stamp,
            joints: command.joints,
            q: command.q_r,
            ..Default::default()
        };
    }
}

fn exercise<D: Drive<7>>(drive: &mut D) {
    let q = SVector::<f64, 7>::repeat(0.2);
    let command = DriveCommand { tau: q, q_r: q, qd_r: q * 0.1, qdd_r: q };
    assert_no_alloc(|| {
        for ms in 0..30 {
            drive.read(MonoNs(ms * 1_000_000));
            drive.write(&command);
        }
        drive.health();
        drive.end(&command);
    });
}

#[test]
fn reading_and_writing_do_not_allocate() {
    let q = SVector::<f64, 7>::repeat(0.2);
    for mode in CommandMode::ALL {
        let encoder = EncoderModel { step: SVector::repeat(1e-5), ..EncoderModel::exact() };
        let settings = SimulatedDriveSettings { mode, command_delay_ticks: 4, encoder, ..Default::default() };
        // The xArm has friction: that path is taken too.
        let robot = vservo::robot::load("xarm7").unwrap().build::<7>().unwrap();
        exercise(&mut SimulatedDrive::new(robot, q, settings).unwrap());
    }
    exercise(&mut IdealDrive::new(q).by_velocity());
    let link = Box::new(Echo(DriveStateMsg::default()));
    exercise(&mut ExternalDrive::new(link, CommandMode::Position, SpanNs(20_000_000), q));
}
