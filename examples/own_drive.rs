//! A closed loop with a drive of one's own: camera, vision and control are the library's, the arm is whoever implements [`Drive`].
//!
//! ```text
//! cargo run --release --example own_drive
//! ```
//! Here the drive is six joints that follow the commanded velocity by a first-order lag; in a cell it would speak to an arm.

#![allow(clippy::print_stdout)] // a program for a terminal

use nalgebra::SVector;
use vservo::prelude::*;

struct Lagging {
    q: SVector<f64, 6>,
    qd: SVector<f64, 6>,
    wanted: SVector<f64, 6>,
    last: MonoNs,
}

impl Drive<6> for Lagging {
    fn read(&mut self, now: MonoNs) -> DriveState<6> {
        let dt = (now - self.last).as_s();
        self.qd += (self.wanted - self.qd) * (dt / 0.005).min(1.0);
        self.q += self.qd * dt;
        self.last = now;
        DriveState { q: self.q, qd: self.qd, truth: Some((self.q, self.qd)) }
    }

    fn write(&mut self, command: &DriveCommand<6>) {
        self.wanted = command.qd_r;
    }

    /// In the order of `q`; others than the robot file's are refused.
    fn joint_names(&self) -> &[&str] {
        &[
            "shoulder_pan_joint",
            "shoulder_lift_joint",
            "elbow_joint",
            "wrist_1_joint",
            "wrist_2_joint",
            "wrist_3_joint",
        ]
    }

    fn modes(&self) -> &'static [CommandMode] {
        &[CommandMode::Velocity]
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let settings = ["servo.lead_ms=5", "drive.kind=ideal", "drive.mode=velocity"].map(String::from);
    let config = Config::load(Some("ur5".as_ref()), &settings)?;
    let q = assemble::q_start::<6>(&config)?;
    let drive = Lagging { q, qd: SVector::zeros(), wanted: SVector::zeros(), last: MonoNs::ZERO };
    let mut control = assemble::control_loop_with(&config, config.robot.build::<6>()?, Box::new(drive))?;
    let (mut camera, mut vision) = (assemble::synthetic_camera::<6>(&config)?, assemble::vision(&config));
    let (width_px, height_px) = config.camera.full_size_px();
    let mut pixels = vec![0; width_px as usize * height_px as usize];
    let mut seen = None;
    for tick in 0u64.. {
        let mid = MonoNs(TICK.0 * tick as i64);
        camera.arm(&control.sense(tick, mid));
        if tick.is_multiple_of(40) {
            let exposure = Exposure { frame_id: tick / 40, mid, span: config.camera.exposure };
            camera.expose(&exposure, &mut pixels);
            let header = FrameHeader {
                frame_id: exposure.frame_id,
                exposure: mid,
                width_px,
                height_px,
                ..FrameHeader::default()
            };
            let image = ImageView::new(&pixels, width_px as usize, height_px as usize)?;
            seen = Some(vision.process(&Frame { header, image }, &Prior::default()));
        }
        // what was exposed 20 ms ago has arrived
        let arrived = seen.take_if(|_| tick % 40 == 20);
        if let Some(finish) = control.act(mid, arrived.as_ref()).finish {
            let errors = control.final_errors();
            let mm = errors.position_error_m.unwrap_or(f64::NAN) * 1e3;
            println!(
                "{} ({}) after {:.3} s, {mm:.4} mm from the goal",
                finish.outcome.as_str(),
                finish.reason,
                (mid - MonoNs::ZERO).as_s()
            );
            break;
        }
    }
    Ok(())
}
