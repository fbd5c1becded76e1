//! An emulated robot by itself, with joints that follow at once: `cargo run -p vservo-ur --example emulate_ur -- 127.0.0.1 e-series`.

#![allow(clippy::print_stdout)] // a program for people

use std::error::Error;
use std::time::Duration;
use vservo_ur::Series;
use vservo_ur::emulator::{Emulator, EmulatorSettings, StiffJoints};

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let address = arguments.next().unwrap_or_else(|| "127.0.0.1".into()).parse()?;
    let series = if arguments.next().as_deref() == Some("cb3") { Series::Cb3 } else { Series::ESeries };
    let q = [0.4617, -1.7204, 1.4481, -1.2809, -1.8176, 0.9664];
    let settings =
        EmulatorSettings { address, series, q, running: true, joints: Box::new(StiffJoints::default()) };
    let robot = Emulator::start(settings)?;
    println!("a robot that is none listens on {address}");
    loop {
        robot.log().iter().for_each(|line| println!("{line}"));
        std::thread::sleep(Duration::from_millis(100));
    }
}
