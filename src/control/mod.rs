//! Control: from a measurement and the arm's state to the command of a tick, and how a run ends.
//!
//! ```text
//! [`control_loop`] one run: drive, controller, goal, what is counted      [`run_end`] every end is an arm at rest
//! [`controller`]   one tick: watch ─► lifecycle ─► behaviour ─► reference ─► joint control ─► gate
//! [`lifecycle`]    what the run is doing: a table                         [`behaviour`] why the arm moves
//! [`gate`]         the last thing before the drive
//! [`trace`]        what a tick leaves: the report reads it, control does not know the report
//! [`residual`]     an arm that stands before an error which stays
//! [`safety`]       faults and reactions, the watches over measurements and measured arm
//! ```

pub mod behaviour;
pub mod control_loop;
pub mod controller;
pub mod gate;
pub mod lifecycle;
pub mod measurement_log;
pub mod outcome;
mod records;
pub mod residual;
pub mod run_end;
pub mod safety;
pub mod trace;
pub mod truth;
