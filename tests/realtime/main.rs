//! The real-time clock: alone in its program, so that no other test of it loads the machine meanwhile.

#[path = "../common/mod.rs"]
mod common;
mod deadlines;
mod system_calls;
