//! An emulated robot at 127.0.0.1 until it is ended, with joints that lag: `cargo run -p vservo-franka --example emulate_franka [ADDRESS [MISSED_CYCLES]]`.

#![allow(clippy::print_stdout)] // it is for whoever looks at it

use std::error::Error;
use std::time::Duration;
use vservo_franka::emulator::{Emulator, EmulatorSettings};

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let address = arguments.next().unwrap_or_else(|| "127.0.0.1".into()).parse()?;
    let mut settings = EmulatorSettings::fr3(address, [0.1, -0.5, 0.0, -2.1, 0.1, 1.8, 0.2]);
    if let Some(cycles) = arguments.next() {
        settings.missed_cycles = cycles.parse()?;
    }
    let emulator = Emulator::start(settings)?;
    loop {
        for line in emulator.log() {
            println!("{line}");
        }
        std::thread::sleep(Duration::from_millis(20));
    }
}
