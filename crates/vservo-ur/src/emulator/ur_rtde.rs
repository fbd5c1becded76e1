//! The program of `ur_rtde`, as far as a client of it needs it here: the protocol of its registers is served, its text is not run.
//!
//! ```text
//! int 0: command      0 none, 9 speedJ, 11 servoJ, 66 directTorque, 15 speedStop, 16 servoStop, 34 stopJ, 99 watchdog, 255 end
//! doubles from 0: speedJ qd a t; servoJ q v a t lookahead gain; directTorque, 6 each: torque, shares of viscous and Coulomb friction; stops a
//! out int 0: 1 ready for a command, 2 done with it
//! ```
//! Its registers begin at 0, or at 24 where its client asks for that: the text says which.

use super::core::Torque;
use super::motion::Motion;
use super::programs::{End, Host};
use crate::Joints;

/// Values of its first output register, by its own protocol.
const READY: i32 = 1;
const DONE: i32 = 2;

/// Serves a client until it ends the program.
pub(super) fn run(host: &mut Host<'_>, text: &str) -> Result<(), End> {
    let offset = if text.contains("reg_offset_int = 24") { 24 } else { 0 };
    let int = |host: &Host<'_>, i: usize| host.input_int(offset + i).unwrap_or(0);
    let double = |host: &Host<'_>, i: usize| host.input_double(offset + i).unwrap_or(0.0);
    let joints = |host: &Host<'_>| -> Joints { std::array::from_fn(|i| double(host, i)) };
    host.put_int(offset, READY);
    let mut executing = false;
    loop {
        let command = int(host, 0);
        match command {
            0 | 99 => {
                executing = false;
                host.put_int(offset, READY);
            }
            // Streamed: no word of being done.
            9 => {
                host.begin(Motion::Speed { qd: joints(host), acceleration: double(host, 6) })?;
                host.put_int(offset, READY);
            }
            11 => {
                let (lookahead_s, gain) = (double(host, 9), double(host, 10));
                host.begin(Motion::Servo { q: joints(host), lookahead_s, gain })?;
                host.put_int(offset, READY);
            }
            66 => {
                let six = |from: usize| -> Joints { std::array::from_fn(|i| double(host, from + i)) };
                let torque = Torque { tau: six(0), viscous_share: six(6), coulomb_share: six(12) };
                host.begin(Motion::Push(torque))?;
                host.put_int(offset, READY);
            }
            _ if executing => {}
            15 | 16 | 34 => {
                host.stop(double(host, 0).max(0.1))?;
                host.put_int(offset, DONE);
                executing = true;
            }
            255 => {
                host.put_int(offset, DONE);
                return Ok(());
            }
            other => return Err(End::Wrong(format!("ur_rtde's command {other} is not emulated"))),
        }
        host.sync()?;
    }
}
