//! Simulated time: the loop over ticks that every simulation shares, and a whole run in one process; what a run has before it
//! ([`preflight`]), values for it ([`tune`]), a start and a goal for it ([`place`](mod@place)), and what it makes of faults ([`faults`]).

pub mod benchmark;
mod closed_loop;
mod commander;
pub mod faults;
mod hand_eye_session;
mod perfect_camera;
pub mod place;
pub mod preflight;
mod second_eye;
mod system;
pub mod tune;

pub use closed_loop::{ClosedLoop, frame_every, run};
pub use commander::{Commander, CommanderSight, WantedMotion};
pub use hand_eye_session::look_around;
pub use perfect_camera::perfect_measurement;
pub use system::{
    Drives, Moment, SimError, SystemRun, simulate_commanded, simulate_system, simulate_system_with,
};
